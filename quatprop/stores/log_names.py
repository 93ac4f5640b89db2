"""Names of logs on a command line, which may name a topic, too: ``LOG:TOPIC``."""

from __future__ import annotations

import os.path
import re

from quatprop.errors import UsageError
from quatprop.stores.objects import exists, is_address, without_secret
from quatprop.text import plain, quoted


def split_topic(name: str, given: str | None = None) -> tuple[str, str | None]:
    """Return the path and the topic of a log; a file of the whole name has no topic in its name.

    The topic of an address begins with a slash: its other colons are those of ports and of keys.

    `given`: the topic that is named elsewhere: refused if the name has another
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
    # False, not an error, where a name is too long.
    return os.path.exists(name)  # noqa: PTH110
