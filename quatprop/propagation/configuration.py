"""The configuration with which an output was made, from its provenance."""

from __future__ import annotations

import json
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base.errors import UsageError
from quatprop.base.provenance import as_json
from quatprop.base.text import plain
from quatprop.propagation.report import digest_of_input
from quatprop.settings import option
from quatprop.stores.objects import split_topic

if TYPE_CHECKING:
    from collections.abc import Mapping


class Configuration(NamedTuple):
    """A file for ``propagate --config``.

    `text`: its content
    `changed`: on each file that has changed since, a sentence
    """

    text: str
    changed: tuple[str, ...]


def config_of(path: str, provenance: Mapping[str, Any]) -> Configuration:
    """Return the configuration that reproduces an output.

    `path`: of the output
    """
    settings, source = provenance.get("settings"), provenance.get("source")
    if not isinstance(settings, dict) or not isinstance(source, dict):
        raise UsageError(
            f"{path}: it does not say with which options it was made; outputs of propagate do that "
            "in parquet, feather, npz, mcap and bags, and with --header-comment in text"
        )
    log = "LOG" if source["kind"] == "series" else quote(plain(source["path"]))
    digest = f"; SHA-256 of the log: {source['sha256']}" if source["sha256"] else ""
    lines = [
        f"# quatprop propagate {log} -o OUT --config THIS_FILE",
        f"# by quatprop {plain(provenance['quatprop'])}{digest}",
    ]
    if provenance.get("conversions"):
        lines.append("# converted afterwards, which this does not repeat")
    changed = []
    for name, file in (provenance.get("files") or {}).items():
        state = _state(name, file)
        digests = {"ETag": file.get("etag"), "SHA-256": file["sha256"]}
        was = "".join(f"; its {key} was {value}" for key, value in digests.items() if value)
        lines.append(f"# {plain(name)}: {state}{was}")
        if state != UNCHANGED:
            changed.append(f"{plain(name)}, which {plain(path)} was made with: {state}")
    paths = [value for value in provenance.get("files") or {} if not Path(value).is_absolute()]
    if {*paths} & {split_topic(one)[0] for one in settings.values() if isinstance(one, str)}:
        lines.append("# paths are as they were given: keep this file in the folder of that run")
    for name, value in settings.items():
        lines.append(f"{option(name)[2:]} = {json.dumps(value)}")
    return Configuration("\n".join(lines), tuple(changed))


UNCHANGED = "unchanged"


def _state(path: str, file: Mapping[str, Any]) -> str:
    """Return a text on whether a file has changed since an output was made."""
    if file["bytes"] is None:
        return "what it held is not known, as it was no file"
    now = as_json(digest_of_input(path))
    if now["bytes"] is None:
        return "it is missing"
    changed = any(now[key] != file.get(key) for key in now)
    return "it has changed since" if changed else UNCHANGED
