"""Cross-check logs, and write the picture and the configuration of propagate."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.base.errors import OutputError, UsageError
from quatprop.base.places import without_secret
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.settings import PROPAGATE, option
from quatprop.stores.objects import split_topic
from quatprop.tools.crosscheck.analysis import crosscheck_logs
from quatprop.tools.crosscheck.repairs import combined
from quatprop.writers.atomic import write_atomic
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.tools.crosscheck.result import CrossCheck
    from quatprop.tools.crosscheck.sources import Source


def crosscheck_files(
    logs: Sequence[str],
    values: Mapping[str, Any],
    plot: str | None,
    config: str | None,
    command: str,
) -> CrossCheck:
    """Cross-check logs, and write the requested files.

    `values`: parsed settings of a cross-check
    `plot`, `config`: where the picture and the configuration of propagate go; None is nowhere
    `command`: the command line
    """
    paths = [split_topic(name)[0] for name in logs]
    with ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.page import PictureFile, kind_of

            if kind_of(plot) == "html":
                kinds = "use .png, .svg or .pdf"
                raise OutputError(plot, f"a picture of a cross-check is an image; {kinds}")
            output = stack.enter_context(PictureFile(plot, paths, [config], command=command))
        analysis = crosscheck_logs(logs, values)
        result = analysis.result
        if plot is not None:
            from quatprop.tools.crosscheck.drawing import page_of

            names = [Path(without_secret(path)).name for path in paths]
            if (page := page_of(analysis, names)) is not None:
                output.commit(page)
            else:
                text = "a picture, as no two sources could be compared"
                result = replace(result, not_shown=(*result.not_shown, text))
        if config is not None:
            write_configuration(result, config, logs)
    return result


def configuration(result: CrossCheck) -> str:
    """Return a file for ``propagate --config``, which repairs the only gyroscope of a log.

    Of several gyroscopes, the only one that findings are about. Differences that no setting of
    propagate repairs, such as those of its clock, stand in comments.
    """
    found = result.settings()
    for finding in result.findings:
        if finding.code == "bias" and finding.settings:
            found.setdefault(finding.source, {}).update(finding.settings)
    rates = [one for one in result.sources if one.is_rates or "rates" in one.corrected]
    repairs = {one.name: combined(one, found) for one in rates}
    chosen = [one for one in rates if repairs[one.name]] if len(rates) > 1 else rates
    if not rates:
        raise UsageError("there is no gyroscope to write a configuration for")
    if not chosen:
        raise UsageError("no finding is about a gyroscope, so there is nothing to configure")
    if len(chosen) > 1:
        names = listed(one.name for one in chosen)
        raise UsageError(
            f"findings are about several gyroscopes: {names}; name one as LOG:TOPIC, or choose it "
            f"with {Setting('topic')}"
        )
    return "\n".join(_lines(chosen[0], repairs[chosen[0].name])) + "\n"


def write_configuration(result: CrossCheck, target: str, logs: Sequence[str]) -> None:
    """Write the configuration to a file or stdout, which replaces none of the logs."""
    refuse_overlap([split_topic(name)[0] for name in logs], [target])
    write_atomic(target, configuration(result))


def _lines(source: Source, repairs: dict[str, str]) -> Iterator[str]:
    yield "# quatprop propagate LOG -o OUT --config THIS_FILE"
    yield f"# by quatprop crosscheck, for {quoted(plain(source.name))}"
    settings = {**source.assumed, **repairs}
    if source.is_message:
        settings = {"topic": source.device, **settings}
    for name, value in settings.items():
        known = f"{option(name)[2:]} = {json.dumps(value)}"
        yield known if name in PROPAGATE else f"# not repaired by propagate: {known}"
