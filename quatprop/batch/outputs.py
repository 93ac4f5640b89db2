"""The outputs of a batch: the name of each, and which machine of many makes it."""

from __future__ import annotations

import os.path
import re
from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.stores.objects import below, is_address, without_secret
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.batch.logs import FoundLog

OTHER_OUTPUT = (
    f"keep their folders in the names with {Setting('root', 'DIR')}, a folder above both, or "
    "write to another folder"
)
"""The way out where two logs have the same output."""


def output_paths(logs: Iterable[FoundLog], folder: str, suffix: str) -> list[str]:
    """Return the path of the output of each log."""
    paths: list[str] = []
    owners: dict[str, FoundLog] = {}
    for log in logs:
        name = log.name + suffix
        paths.append(below(folder, name) if is_address(folder) else os.path.join(folder, name))  # noqa: PTH118
        owner = owners.setdefault(log.name.lower(), log)
        if owner is not log:
            one, other, both = (
                quoted(without_secret(path)) for path in (owner.path, log.path, paths[-1])
            )
            folders = {os.path.dirname(path) for path in (owner.path, log.path)}  # noqa: PTH120
            way_out = OTHER_OUTPUT if len(folders) > 1 else "rename one of them"
            raise UsageError(f"{one} and {other} would both be written to {both}; {way_out}")
    return paths


def shard(logs: Iterable[FoundLog], text: str) -> list[FoundLog]:
    """Return one part of N of the logs: that of one machine of many, as in an array job.

    `text`: ``"I/N"``, the I-th part, from 1 to N
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
    part, parts = map(int, match.groups()) if match else (0, 0)
    if not 1 <= part <= parts:
        raise UsageError(f"{quoted(text)} is not I/N, from 1/N to N/N, for {Setting('shard')}")
    return sorted(logs, key=lambda log: log.name)[part - 1 :: parts]
