"""Topics that a log has already: nothing is added to them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


def refuse_taken(topic: str, taken: Iterable[str], path: Path) -> None:
    """Refuse a topic that a log has.

    Parameters
    ----------
    topic
        Where attitudes are to be published.
    taken
        The topics of the log.
    path
        The log, for the error.

    Raises
    ------
    UsageError
        It is one of them.
    """
    if topic in taken:
        raise UsageError(
            f"{plain(path)}: topic {quoted(topic)} is there already; choose another with "
            "--out-topic NAME"
        )
