"""Propose the limits of a case with an independent series, from the measured errors."""

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
"""Ratio of a proposed limit to the measured error."""

MIN_FRAME_ANGLE = math.radians(2.0)
"""Angle between two frames, rad; a smaller one is taken for an error and not aligned."""

WINDOW_NS = 1_000_000_000
PARTS = 5
"""A window is a second, or in a short log a fifth of its length."""

LEAST_DEG = 1e-6
"""Smallest limit that is proposed, deg; smaller errors are rounding errors."""


def propose_limits(log: str, reference: str) -> Iterator[str]:
    """Yield the alignment and the limits as lines of a case, with the reasons as comments."""
    with TemporaryDirectory(prefix="quatprop-") as folder:
        output = str(Path(folder, "attitude.parquet"))
        run(Job(log, OutputSettings(output, to="parquet")))
        a = load_attitudes(AttitudeInput(output, "parquet")).series
    b = load_attitudes(AttitudeInput(reference, side="b")).series
    align, why = _alignment(a, b)
    yield f'align = "{align}"  # {why}'
    window_ns = min(WINDOW_NS, max(1, int(a.t_ns.max() - a.t_ns.min()) // PARTS))
    measure = replace(MEASURE, align=align, window=window_ns)
    try:
        result = compare(a, b, measure)
    except ComparisonError:  # in a log of bursts, no two samples may be a window apart
        result = compare(a, b, replace(measure, window=None))
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
    """Return the alignment for a rotation between the frames, and the reason for it."""
    # The mounting cannot be determined if the body turns about one axis only.
    with suppress(ComparisonError):
        angle = compare(a, b, replace(MEASURE, align="mount")).alignment.mount_rad
        if angle > MIN_FRAME_ANGLE:
            return "mount", f"the body frames are {math.degrees(angle):.3g} deg apart"
    angle = compare(a, b, replace(MEASURE, align="mean")).alignment.reference_rad
    if angle > MIN_FRAME_ANGLE:
        return "mean", f"the reference frames are {math.degrees(angle):.3g} deg apart"
    return "none", "both are relative to the same frames"
