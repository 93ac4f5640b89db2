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

EXPLAINED, CLOSELY = 0.3, 0.15
"""Share of the rates at rest that a likely cause may leave; and where only that cause tells."""

DEG = math.radians(1.0)

BEYOND = 30 * DEG
"""rad/s: data sheets of low-cost gyroscopes allow a bias of up to 20 deg/s."""


def bias_remarks(
    batches: Iterable[GyroSeries],
    inputs: GyroCorrectionInputs,
    bias_at: Callable[[Int64], Float64],
    frame: str,
) -> list[Remark]:
    """Return a remark if rates at rest are larger after a bias is subtracted than before.

    Or if they are what the bias is in another unit, or of the other sign; or if no gyroscope has
    such a bias.

    `batches`: rates from the beginning of the log, rad/s, sensor axes
    `bias_at`: returns the biases at times, ``(N, 3)``, rad/s
    `frame`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    """
    rows: list[tuple[Int64, Float64]] = []
    room = HEAD
    for batch in batches:
        rows.append((batch.t_ns[:room], batch.rate[:room]))
        room -= len(rows[-1][0])
        if not room:
            break
    if not rows:
        return []
    beginning = inputs._replace(orientation=None)
    if (read := inputs.force) is not None:
        last_ns = int(rows[-1][0][-1])
        beginning = beginning._replace(force=lambda: _until(read(), last_ns))
    static = StaticBias()
    sums = window_sums(rows, static.window_ns // 2)
    try:
        (rest,) = find_static_periods(sums, beginning, static, frame)
    except NoRestError:
        return _beyond(bias_at(rows[0][0][:1])[0])
    mean, bias = rest.mean_rad_s, bias_at(np.array([rest.first_ns, rest.last_ns])).mean(axis=0)
    before, after, size = (float(np.linalg.norm(one)) for one in (mean, mean - bias, bias))
    least, most = SHARES
    is_worse = after > WORSE * before and least * size <= after <= most * size
    # Rates alone do not tell a steady rotation from rest.
    is_shown = is_worse and "accelerometer" in rest.steady
    cause = _cause(mean, bias, EXPLAINED if is_shown else CLOSELY)
    if after <= LEAST or not (is_shown or cause):
        return _beyond(bias)
    text = (
        f"the bias that is given leaves {after / DEG:.3g} deg/s of the rates at rest, from "
        f"{rest.first_ns} to {rest.last_ns} ns, and without it they are {before / DEG:.3g} deg/s: "
        f"{cause or _other_cause(before, size)} For the mean rate at rest use "
        f"{Setting('bias', 'static')}"
    )
    return [Remark("bias-contradicts-rest", text)]


def _beyond(bias: Float64) -> list[Remark]:
    """Return a remark on a bias that is larger than those of gyroscopes."""
    if (size := float(np.linalg.norm(bias))) <= BEYOND:
        return []
    text = f"the bias that is given is {size / DEG:.3g} deg/s, more than gyroscopes have: is it in"
    return [Remark("bias-beyond-sensors", f"{text} deg/s, or not of a rest?")]


def _cause(mean: Float64, bias: Float64, share: float) -> str:
    """Return the cause that leaves at most a share of the rates, as a question; or nothing."""
    causes = {
        "is it in deg/s?": bias * DEG,
        "is it in rad/s?": bias / DEG,
        "is it to be added?": -bias,
    }
    left = {cause: float(np.linalg.norm(mean - other)) for cause, other in causes.items()}
    cause = min(left, key=left.__getitem__)
    return cause if left[cause] <= share * float(np.linalg.norm(mean)) else ""


def _other_cause(before: float, size: float) -> str:
    if before <= EXPLAINED * size:
        return "were they corrected already?"
    return "is it of this sensor, in its axes and in rad/s?"


def _until(rows: Rows, last_ns: int) -> Rows:
    """Yield rows up to a time."""
    for t_ns, values in rows:
        yield t_ns, values
        if t_ns[-1] > last_ns:
            return
