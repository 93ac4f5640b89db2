"""Options in a file: ``--config FILE.toml``, with the keys of a suite."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.help import GroupedOption
from quatprop.cli.types import PATH, content_of
from quatprop.provenance import as_json
from quatprop.settings.guarded_text import ContentError, read_toml
from quatprop.settings.rotations import file_beside
from quatprop.settings.spelling import option
from quatprop.stores.log_names import split_topic
from quatprop.text import did_you_mean, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping

ONE_RUN = {"config", "output", "folder", "into", "report", "plot", "help", "help_all"}
"""Parameters for a single run, which are not allowed in a file."""


def _read(ctx: click.Context, _parameter: click.Parameter, name: str | None) -> None:
    if name is None or ctx.resilient_parsing:
        return
    try:
        table = read_toml(content_of(name))
    except ContentError as error:
        raise click.UsageError(f"{plain(name)}: {error}") from error
    ctx.default_map = {**(ctx.default_map or {}), **_defaults(ctx, name, table)}


def _defaults(ctx: click.Context, name: str, table: Mapping[str, object]) -> dict[str, object]:
    """Return the defaults in a file, by parameter."""
    parameters = {
        option[2:]: parameter
        for parameter in ctx.command.params
        if isinstance(parameter, click.Option) and parameter.name not in ONE_RUN
        for option in parameter.opts
        if option.startswith("--")
    }
    defaults: dict[str, object] = {}
    for key, value in table.items():
        if key not in parameters:
            hint = did_you_mean(key, parameters, "the keys are options without their dashes")
            raise click.UsageError(f"{name}: no such key {quoted(key)}{hint}")
        parameter = str(parameters[key].name)
        if parameters[key].is_flag and not isinstance(value, bool):
            raise click.UsageError(f"{name}: {quoted(key)} is true or false, not {value!r}")
        text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        text = str(file_beside(parameter, text, Path(name).parent) or text)
        defaults[parameter] = value if isinstance(value, bool) else text
    return defaults


def config_of(path: str, provenance: Mapping[str, Any]) -> str:
    """Return the configuration that reproduces an output."""
    settings, source = provenance.get("settings"), provenance.get("source")
    if not isinstance(settings, dict) or not isinstance(source, dict):
        raise click.UsageError(
            f"{path}: it does not say with which options it was made; outputs of propagate do that "
            "in parquet, feather, npz, mcap and bags, and with --header-comment in text"
        )
    from shlex import quote

    log = "LOG" if source["kind"] == "series" else quote(plain(source["path"]))
    digest = f"; SHA-256 of the log: {source['sha256']}" if source["sha256"] else ""
    lines = [
        f"# quatprop propagate {log} -o OUT --config THIS_FILE",
        f"# by quatprop {plain(provenance['quatprop'])}{digest}",
    ]
    if provenance.get("conversions"):
        lines.append("# converted afterwards, which this does not repeat")
    for name, file in (provenance.get("files") or {}).items():
        state = _state(name, file)
        digests = {"ETag": file.get("etag"), "SHA-256": file["sha256"]}
        was = "".join(f"; its {key} was {value}" for key, value in digests.items() if value)
        lines.append(f"# {plain(name)}: {state}{was}")
        if state != UNCHANGED:
            click.echo(
                f"Warning: {plain(name)}, which {plain(path)} was made with: {state}",
                err=True,
            )
    paths = [value for value in provenance.get("files") or {} if not Path(value).is_absolute()]
    if {*paths} & {split_topic(one)[0] for one in settings.values() if isinstance(one, str)}:
        lines.append("# paths are as they were given: keep this file in the folder of that run")
    for name, value in settings.items():
        lines.append(f"{option(name)[2:]} = {json.dumps(value)}")
    return "\n".join(lines)


UNCHANGED = "unchanged"


def _state(path: str, file: Mapping[str, Any]) -> str:
    """Return a text on whether a file has changed since an output was made."""
    from quatprop.pipeline.report import digest_of_input

    if file["bytes"] is None:
        return "what it held is not known, as it was no file"
    now = as_json(digest_of_input(path))
    if now["bytes"] is None:
        return "it is missing"
    changed = any(now[key] != file.get(key) for key in now)
    return "it has changed since" if changed else UNCHANGED


config_option = click.option(
    "--config",
    cls=GroupedOption,
    group="Execution",
    common=False,
    type=PATH,
    metavar="FILE",
    is_eager=True,
    expose_value=False,
    callback=_read,
    help="Read options from a TOML file, with the same keys as a suite; paths are relative to it. "
    "The command line takes precedence; none unsets an option.  "
    "[default: none]",
)
