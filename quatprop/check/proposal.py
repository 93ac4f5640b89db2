"""Propose how a log is judged by an independent series, from what is measured."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from quatprop.check.case_run import MEASURE
from quatprop.comparison.compare import compare
from quatprop.errors import ComparisonError
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.series import AttitudeSeries

MARGIN = 1.5
"""Limit over what was measured: the share that a change may add before somebody looks at it."""

LEAST_TURN = math.radians(2.0)
"""Angle between two frames, rad, below which it is rather an error."""

WINDOW_NS = 1_000_000_000
PARTS = 5
"""A window is a second, or of a short log this part of its time."""

LEAST_DEG = 1e-6
"""Smallest limit that is proposed, deg: below are rounding errors."""


def propose_limits(log: str, reference: str) -> Iterator[str]:
    """Yield the lines of a case that say how it is aligned and judged, and why."""
    with TemporaryDirectory(prefix="quatprop-") as folder:
        output = str(Path(folder, "attitude.parquet"))
        run(Job(log, OutputSettings(output, to="parquet")))
        a = load_attitudes(AttitudeInput(output, "parquet")).series
    b = load_attitudes(AttitudeInput(reference, side="b")).series
    align, why = _alignment(a, b)
    yield f'align = "{align}"  # {why}'
    window_ns = min(WINDOW_NS, max(1, int(a.t_ns.max() - a.t_ns.min()) // PARTS))
    result = compare(a, b, replace(MEASURE, align=align, window=window_ns))
    window, covered = duration_text(window_ns).replace(" ", ""), result.coverage
    for key, error, reason in (
        ("tol", result.error_rad.max, "the worst error, with all drift"),
        ("rms-tol", result.error_rad.rms, "what a single sample does not decide"),
    ):
        yield _limit(key, error, reason)
    if result.window is not None:
        yield f'window = "{window}"'
        reason = "the rotation over each window: delays, axes and scales, which drift hides above"
        yield _limit("window-rms-tol", result.window.rms_rad, reason)
    least = covered.least
    yield (
        f"min-coverage = {math.floor(least) - 1}  # {least:.4g} % of the reference "
        "series is compared"
    )


def _limit(key: str, error: float, reason: str) -> str:
    measured = math.degrees(error)
    wanted = max(MARGIN * measured, LEAST_DEG)
    step = 10.0 ** (math.floor(math.log10(wanted)) - 1)
    limit = f"{math.ceil(wanted / step) * step:.2g}"
    return f'{key} = "{limit}deg"  # {measured:.3g} deg is measured: {reason}'


def _alignment(a: AttitudeSeries, b: AttitudeSeries) -> tuple[str, str]:
    """Return the alignment that takes out a turn of frames, not an error, and why."""
    # A body that turns about one axis only shows nothing of how it is mounted.
    with suppress(ComparisonError):
        turn = compare(a, b, replace(MEASURE, align="mount")).alignment.mount_rad
        if turn > LEAST_TURN:
            return "mount", f"the body frames are {math.degrees(turn):.3g} deg apart"
    turn = compare(a, b, replace(MEASURE, align="mean")).alignment.reference_rad
    if turn > LEAST_TURN:
        return "mean", f"the reference frames are {math.degrees(turn):.3g} deg apart"
    return "none", "both are relative to the same frames"
