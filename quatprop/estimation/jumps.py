"""Jumps of the bias of a gyroscope: the likelihood ratio of a step at every time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.estimation.fit import HUBER, REWEIGHTED, Data, Estimate, Priors, fit, groups_of

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64
    from quatprop.estimation.model import RotationWindows

PLACES: Final = 400
"""Places at which the bias may jump."""

EDGE: Final = 0.04
"""Share of the windows at either end in which no jump is looked for."""

MAX_JUMPS: Final = 5
"""Maximum number of jumps of the bias."""

JUMPED: Final = 30.0
"""Minimum likelihood ratio of a jump, twice its logarithm: 1 in 10,000 of 400 places."""


class Jump(NamedTuple):
    """The most likely jump of the bias.

    `at_ns`: when, in the clock of the reference, ns
    `part`: share of the windows after it
    `ratio`: twice the logarithm of the likelihood ratio, as of white noise with outliers
    `size`: its most likely size, shape ``(3,)``, rad/s
    """

    at_ns: int
    part: float
    ratio: float
    size: Float64


def with_jumps(data: Data, priors: Priors, found: Estimate) -> Estimate:
    """Return the estimate with those jumps of the bias that a likelihood ratio shows."""
    for _ in range(MAX_JUMPS):
        jump = likely_jump(data.windows, found, priors.jump)
        if jump.ratio < JUMPED:
            break
        at_ns = int(found.model.times_of(np.array([jump.at_ns]))[0])
        model = found.model.jumping(at_ns, jump.size, jump.part)
        more = fit(data, priors, model)
        place = 14 + 3 * model.jumps_ns.index(at_ns)
        rows = slice(place, place + 3)
        size = more.model.jumps.ravel()[place - 14 :][:3]
        by_size = float(size @ np.linalg.solve(more.covariance[rows, rows], size))
        # Errors that follow each other look like a jump for a while.
        if min(by_size, jump.ratio / more.excess) < JUMPED:
            break
        found = more
    return found


def likely_jump(windows: RotationWindows, found: Estimate, jump_sigma: float) -> Jump:
    """Return the jump of the bias that explains most of the remaining errors.

    Outliers are included: on the shorter side of a jump, all windows look like outliers.

    `jump_sigma`: prior of a jump, which is that of the bias, rad/s
    """
    linear = found.linear
    bias = np.flatnonzero(groups_of(found.free) == "bias")
    rows, count = linear.rows, len(linear.rows)
    power = np.cumsum(np.einsum("mip,miq->mpq", rows[..., bias], rows), axis=0)
    places = np.unique(np.linspace(EDGE * count, (1 - EDGE) * count, PLACES).astype(int))
    cross = power[-1] - power[places]
    white = np.linalg.inv(np.tensordot(rows, rows, ((0, 1), (0, 1))) + np.eye(rows.shape[2]))
    own = cross[..., bias] - cross @ white @ cross.swapaxes(1, 2) + np.eye(len(bias))
    likely = set()
    # Outliers hide a small jump, and their weights one that has few windows on one side.
    for errors in (linear.left, linear.left * _weights(linear.left)):
        scores = np.cumsum(np.einsum("mip,mi->mp", rows, errors), axis=0)
        # Without the part that the other parameters explain as well.
        others = cross @ white @ scores[-1]
        after = scores[-1, bias] - scores[places][:, bias] - others
        gain = np.einsum("ki,ki->k", after, np.linalg.solve(own, after[..., None])[..., 0])
        likely.add(int(places[np.argmax(gain)]))
    without, _ = _robust(rows, linear.left)
    jumps = []
    for place in sorted(likely):
        later = rows[..., bias] * (np.arange(count) > place)[:, None, None]
        loss, by = _robust(np.concatenate([rows, later], axis=2), linear.left)
        part = 1 - (place + 1) / count
        size = by[rows.shape[2] :] * jump_sigma
        jumps.append(Jump(int(windows.t_ns[place, 1]), part, without - loss, size))
    return max(jumps, key=lambda jump: jump.ratio)


def _weights(left: Float64) -> Float64:
    """Return Huber's weights of whitened errors, shape ``(M, 1)``."""
    size = np.linalg.norm(left, axis=1, keepdims=True)
    return np.asarray(HUBER / np.maximum(size, HUBER))


def _robust(rows: Float64, left: Float64) -> tuple[float, Float64]:
    """Return the loss of Huber's estimator and of its increments, and these, ``(P,)``.

    `rows`, `left`: whitened derivatives, ``(M, S, P)``, and errors, ``(M, S)``
    """
    by: Float64 = np.zeros(rows.shape[2])
    for _ in range(REWEIGHTED):
        weighted = rows * _weights(left + rows @ by)[..., None]
        power = np.tensordot(weighted, rows, ((0, 1), (0, 1)))
        score = np.tensordot(weighted, left, ((0, 1), (0, 1)))
        by = np.asarray(-np.linalg.solve(power + np.eye(len(by)), score), np.float64)
    size = np.linalg.norm(left + rows @ by, axis=1)
    within = np.minimum(size, HUBER)
    return float((within * (2 * size - within)).sum() + by @ by), by
