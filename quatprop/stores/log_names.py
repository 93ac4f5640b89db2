"""Names of logs that may include a topic: ``LOG:TOPIC``."""

from __future__ import annotations

import os.path
import re

from quatprop.errors import UsageError
from quatprop.stores.objects import exists, is_address, without_secret
from quatprop.text import plain, quoted


def split_topic(name: str, given: str | None = None) -> tuple[str, str | None]:
    """Return the path and the topic of a log, unless a file has the whole name.

    The topic of an address begins with a slash, since ports and keys also have colons.

    `given`: the topic of a setting; a different one in the name is refused
    """
    colons = list(re.finditer(":(?=/[^/])" if is_address(name) else ":(?=.)", name))
    if not colons or _is_there(name):
        return name, given
    ends = (colon.start() for colon in colons if _is_there(name[: colon.start()]))
    if (end := next(ends, None)) is None:
        return name, given
    topic = name[end + 1 :]
    if given not in (None, topic):
        raise UsageError(
            f"{plain(without_secret(name))}: another topic is given, {quoted(given)}; name one"
        )
    return name[:end], topic


def _is_there(name: str) -> bool:
    if is_address(name):
        return exists(name)
    # False, not an error, if a name is too long.
    return os.path.exists(name)  # noqa: PTH110
