"""A bias that is given, against the rates at rest: it should leave hardly anything of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.propagation.conditioning.static_detection import NoRestError, find_static_periods
from quatprop.propagation.conditioning.static_period import ORDINARY_CHANGE, window_sums
from quatprop.settings.bias import StaticBias

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.conditioning.correction_inputs import GyroCorrectionInputs
    from quatprop.propagation.conditioning.static_period import Rows


HEAD = 20_000
"""Samples from the beginning of the log in which a rest is looked for."""

LEAST = 2 * ORDINARY_CHANGE
"""rad/s: what a bias leaves may have changed by as much since it was measured."""

WORSE = 1.2
"""What a wrong bias leaves at rest, relative to the rates themselves."""

SHARES = 0.5, 2.5
"""What a bias of the wrong unit, sign or axes leaves, as shares of it. A body that turns steadily,
and seems to be at rest, has any other share."""

EXPLAINED = 0.3
"""Share of the rates at rest that a likely cause may leave."""


def bias_remarks(
    batches: Iterable[GyroSeries],
    inputs: GyroCorrectionInputs,
    bias_at: Callable[[Int64], Float64],
    frame: str,
) -> list[Remark]:
    """Return a remark if rates at rest are larger after a bias is subtracted than before.

    `batches`: rates from the beginning of the log, rad/s, sensor axes
    `bias_at`: returns the biases at times, ``(N, 3)``, rad/s
    `frame`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    """
    rows: list[tuple[Int64, Float64]] = []
    for batch in batches:
        rows.append((batch.t_ns, batch.rate))
        if sum(len(t_ns) for t_ns, _ in rows) >= HEAD:
            break
    if not rows or inputs.force is None:
        return []
    last_ns, read = int(rows[-1][0][-1]), inputs.force
    beginning = inputs._replace(force=lambda: _until(read(), last_ns), orientation=None)
    static = StaticBias()
    sums = window_sums(rows, static.window_ns // 2)
    try:
        (rest,) = find_static_periods(sums, beginning, static, frame)
    except NoRestError:
        return []
    # Rates alone do not tell a steady rotation from rest.
    if "accelerometer" not in rest.steady:
        return []
    mean, bias = rest.mean_rad_s, bias_at(np.array([rest.first_ns, rest.last_ns])).mean(axis=0)
    before, after, size = (float(np.linalg.norm(one)) for one in (mean, mean - bias, bias))
    least, most = SHARES
    if after <= max(LEAST, WORSE * before) or not least * size <= after <= most * size:
        return []
    text = (
        f"the bias that is given leaves {math.degrees(after):.3g} deg/s of the rates at rest, from "
        f"{rest.first_ns} to {rest.last_ns} ns, and without it they are "
        f"{math.degrees(before):.3g} deg/s: {_cause(mean, bias)} For the mean rate at rest use "
        f"{Setting('bias', 'static')}"
    )
    return [Remark("bias-contradicts-rest", text)]


def _cause(mean: Float64, bias: Float64) -> str:
    """Return the likely cause, as a question."""
    before = float(np.linalg.norm(mean))
    causes = {
        "is it in deg/s?": bias * math.radians(1.0),
        "is it to be added?": -bias,
    }
    for cause, other in causes.items():
        if np.linalg.norm(mean - other) <= EXPLAINED * before:
            return cause
    if before <= EXPLAINED * float(np.linalg.norm(bias)):
        return "were they corrected already?"
    return "is it of this sensor, in its axes and in rad/s?"


def _until(rows: Rows, last_ns: int) -> Rows:
    """Yield rows up to a time."""
    for t_ns, values in rows:
        yield t_ns, values
        if t_ns[-1] > last_ns:
            return
