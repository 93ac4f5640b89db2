"""Rates against what stands beside them, from the first sample to the last.

That is an orientation, or the forces of an accelerometer. The beginning is compared by
:mod:`.orientation_check` and :mod:`.gravity_check`; here, what changes later: the axes or the unit
of a driver that was configured anew, or a recording to which another was joined. Memory is
constant, and the cost small: most blocks are passed by one coarse comparison.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S, open_range
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, log, multiply, rotate, shorter
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.gravity_check import SPAN, TURNED, against_gravity, directions
from quatprop.propagation.orientation_check import (
    AGREEING_SAMPLES,
    COMPARED_SAMPLES,
    MOVING,
    SAME_AXES,
    SAME_SCALE,
    against_orientation,
)
from quatprop.timeline.stamps import spread

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64


BIN_NS = 100_000_000
"""Rates are summed, and forces averaged, over this time, in which a body hardly turns far."""

FEWEST_STEPS = 4
"""Fewest samples in that time."""

SOME = 7
"""Of the intervals, so many times fewer tell the usual one."""

CHUNK = 16 * AGREEING_SAMPLES
"""Samples that are looked at together."""

UNIT = 1e-3
"""Largest error of the norm of a quaternion that is compared."""

SKIPPED = 9
"""So many times as many samples are skipped after a disagreement with an excuse."""

SIDE = 15
"""Bins on either side of a jump, in which a direction does not move but for the rates."""

JUMPED = math.radians(25.0)
"""rad: a vehicle that stops has smaller jumps while its forces look like gravity."""

CLEAR = 5.0
"""How many times as large a jump is as the scatter beside it."""

KNOWN = 0.6
"""Share of the bins on either side of a jump whose direction is known."""

UP = np.array([0.0, 0.0, 1.0])
"""In reference axes. A filter that is reset turns about it, so what is joined there is not told."""


class _Bins(NamedTuple):
    """Samples at equal distances, and the rotation by the rates from each to the next.

    `at`: their places, shape ``(N,)``; `t_ns`: their stamps
    `step`, `span_s`: samples between them, and the usual time, s
    `turned`: rotation vectors, rad, shape ``(N - 1, 3)``, zero where they are not known
    `known`: if they are known, shape ``(N - 1,)``
    """

    at: Int64
    t_ns: Int64
    step: int
    span_s: float
    turned: Float64
    known: Bool

    @property
    def wxyz(self) -> Float64:
        """Attitudes by the rates."""
        seconds = np.arange(len(self.at)) * NS_PER_S
        return attitudes(seconds, np.concatenate([self.turned, np.zeros((1, 3))]))

    def are_whole(self, count: int) -> Bool:
        """Return whether all is known, without a gap, from each sample to the one after some."""
        gaps = np.append(0, np.cumsum(~self.known))
        lasted = self.t_ns[count:] - self.t_ns[:-count]
        is_short: Bool = lasted < 1.2 * count * self.span_s * NS_PER_S
        is_short &= gaps[count:] == gaps[:-count]
        return is_short


class DirectionWatch(ABC):
    """Compares rates with what stands beside them, batch by batch.

    `unit`: that of the rates in the log
    `start_ns`, `end_ns`: the range that is compared, ns; None: open
    """

    what: ClassVar[str]
    """How it is called in remarks."""

    jumps: ClassVar[str]
    """What of it jumps, where recordings were joined."""

    least: ClassVar[float]
    """Slowest change that is compared, rad/s."""

    def __init__(self, unit: str, start_ns: int | None, end_ns: int | None) -> None:
        self._unit = unit
        self._range = open_range(start_ns, end_ns)
        self._have_agreed = False
        self._waiting: list[tuple[Int64, Float64, Float64]] = []
        self._held: list[tuple[Int64, Float64, Float64]] = []
        self._seen = self._count = self._skip = 0
        self._remark: Remark | None = None
        self._joint: Remark | None = None

    def _bins(self, t_ns: Int64, rate: Float64, beside: Float64) -> _Bins | None:  # noqa: ARG002  # of some kinds
        """Return the rotations by the rates in axes of the body; None: too few samples."""
        return _bins(t_ns, rate)

    @abstractmethod
    def _turns(self, bins: _Bins, beside: Float64) -> tuple[Float64, Float64, int]:
        """Return changes by the rates and beside them, ``(N, 3)``, and bins in each change.

        Changes that are not known are zero.
        """

    @abstractmethod
    def _against(self, t_ns: Int64, rate: Float64, beside: Float64) -> Remark | None:
        """Return a remark if samples contradict what is beside them, as at the beginning."""

    @abstractmethod
    def _directions(self, bins: _Bins, beside: Float64) -> tuple[Float64, Bool]:
        """Return directions of the reference as the body sees them, and if they are known."""

    @abstractmethod
    def _raw_directions(self, beside: Float64) -> Float64:
        """Return the same for each sample."""

    def add(self, t_ns: Int64, rate: Float64, beside: Float64) -> None:
        """Add samples, rad/s, and the force beside each, or its orientation, wxyz."""
        if self._remark is not None and self._joint is not None:
            return
        start, end = self._range
        inside = (t_ns >= start) & (t_ns <= end)
        part = slice(None) if inside.all() else inside
        # Copied, since rates are corrected in place.
        self._waiting.append((t_ns[part], rate[part].copy(), beside[part]))
        self._count += len(self._waiting[-1][0])
        if self._count >= CHUNK:
            self._look(at_end=False)

    def remarks(self) -> list[Remark]:
        """Return the remarks on what is beside the samples, after the last batch."""
        if self._waiting:
            self._look(at_end=True)
            self._judge()
        self._waiting, self._held, self._seen, self._count = [], [], 0, 0
        return [one for one in (self._remark, self._joint) if one is not None]

    def _look(self, *, at_end: bool) -> None:
        """Look at whole blocks of what is waiting, or at all of it.

        Some blocks wait for another look, since changes are seen only with what is around them.
        """
        t_ns, rate, beside = map(np.concatenate, zip(*self._waiting, strict=True))
        whole = len(t_ns) if at_end else len(t_ns) - len(t_ns) % AGREEING_SAMPLES
        again = AGREEING_SAMPLES
        if (bins := self._bins(t_ns[:whole], rate[:whole], beside)) is not None:
            agree, contradict, jumps = self._compare(bins, beside, -(-whole // AGREEING_SAMPLES))
            for k in range(self._seen // AGREEING_SAMPLES, len(agree)):
                begin = k * AGREEING_SAMPLES
                if self._skip:
                    self._skip -= 1
                elif self._remark is None and (self._held or contradict[k]):
                    # It may begin to contradict in the block before.
                    begin = begin if self._held else max(begin - AGREEING_SAMPLES, 0)
                    part = slice(begin, min((k + 1) * AGREEING_SAMPLES, whole))
                    self._held.append((t_ns[part], rate[part], beside[part]))
                    if sum(len(t_ns) for t_ns, _, _ in self._held) >= COMPARED_SAMPLES:
                        self._judge()
                else:
                    self._have_agreed |= bool(agree[k])
            if jumps and self._joint is None:
                self._joint = self._joined(bins, t_ns, beside)
            again *= min(-(-2 * (SIDE + 1) * bins.step // again), CHUNK // again // 2)
        first = max(whole - again, 0)
        self._waiting = [(t_ns[first:], rate[first:], beside[first:])]
        self._seen, self._count = whole - first, len(t_ns) - whole

    def _compare(self, bins: _Bins, beside: Float64, blocks: int) -> tuple[Bool, Bool, bool]:
        """Return which blocks agree, which contradict each other, and if a change may be a jump."""
        by_rates, own, lag = self._turns(bins, beside)
        block = bins.at[: len(own)] // AGREEING_SAMPLES
        count = np.maximum(np.bincount(block, minlength=blocks), 1)
        squares = [_dot(by_rates, by_rates), _dot(own, own), _dot(by_rates, own)]
        *sums, product = (np.bincount(block, one, blocks) / count for one in squares)
        sizes = [np.sqrt(one) for one in sums]
        is_alike = product > SAME_AXES * sizes[0] * sizes[1]
        is_alike &= (sizes[0] < sizes[1] * SAME_SCALE) & (sizes[1] < sizes[0] * SAME_SCALE)
        moves = np.maximum(*sizes) > self.least * lag * bins.span_s
        # The square of the chord between both.
        apart = squares[0] + squares[1] - 2 * squares[2]
        jumps = bool((apart > (2 * math.sin(JUMPED / 2)) ** 2).any())
        return moves & is_alike, moves & ~is_alike, jumps

    def _judge(self) -> None:
        """Compare what is held as the beginning is compared."""
        if not self._held:
            return
        t_ns, rate, beside = map(np.concatenate, zip(*self._held, strict=True))
        self._skip = SKIPPED * len(self._held)
        self._held = []
        if not (np.diff(t_ns) > 0).all():
            return
        first = self._begin(t_ns, rate, beside)
        found = self._against(t_ns[first:], rate[first:], beside[first:])
        if found is not None and (self._have_agreed or first):
            begin = int(t_ns[first])
            parts = f"{Setting('end', str(begin))} and {Setting('start', str(begin))}"
            text = (
                f"rates and {self.what} agree until about {begin} ns only: propagate both parts by "
                f"themselves, with {parts}; after that, {found}"
            )
            found = Remark("contradicts-later", text)
        self._remark = found

    def _begin(self, t_ns: Int64, rate: Float64, beside: Float64) -> int:
        """Return from which row on changes differ by most of their size, and before which not."""
        bins = self._bins(t_ns, rate, beside)
        if bins is None:
            return 0
        by_rates, own, lag = self._turns(bins, beside)
        apart, *sizes = (_dot(one, one) for one in (by_rates - own, by_rates, own))
        differ = apart - np.maximum(*sizes) / 4
        before = int(np.argmin(np.append(0, np.cumsum(differ))))
        return int(bins.at[before + lag // 2]) if 0 < before < len(differ) else 0

    def _joined(self, bins: _Bins, t_ns: Int64, beside: Float64) -> Remark | None:
        """Return a remark if a direction is another from a bin on, but the rates do not turn."""
        found = _jump(bins, *self._directions(bins, beside))
        if found is None:
            return None
        begin, end, angle, turned = found
        near = self._raw_directions(beside[begin : end + 1])
        at_ns = int(t_ns[begin + 1 + np.linalg.norm(np.diff(near, axis=0), axis=1).argmax()])
        return Remark(
            "recordings-joined",
            f"{self.jumps} next to the rates jumps by {math.degrees(angle):.3g} deg at about "
            f"t = {at_ns} ns, while the rates turn by {math.degrees(turned):.2g}: were two "
            "recordings joined there, between which the body was turned? of that turn the rates "
            "show nothing, so every attitude after it is wrong: propagate both parts by "
            f"themselves, with {Setting('end', str(at_ns - 1))} and "
            f"{Setting('start', str(at_ns))}",
        )


class OrientationWatch(DirectionWatch):
    """Compares rates with an orientation.

    `rates`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    """

    what = "orientation"
    jumps = "up, in the orientation"
    least = MOVING

    def __init__(self, rates: str, unit: str, start_ns: int | None, end_ns: int | None) -> None:
        super().__init__(unit, start_ns, end_ns)
        self._rates = rates

    def _bins(self, t_ns: Int64, rate: Float64, beside: Float64) -> _Bins | None:
        bins = super()._bins(t_ns, rate, beside)
        if bins is None or self._rates == "body":
            return bins
        return bins._replace(turned=rotate(conjugate(beside[bins.at[:-1]]), bins.turned))

    def _turns(self, bins: _Bins, beside: Float64) -> tuple[Float64, Float64, int]:
        own = beside[bins.at]
        first, last = own[:-1], own[1:]
        is_unit = _are_unit(own)
        known = (is_unit[:-1] & is_unit[1:] & bins.known)[:, None]
        return bins.turned * known, log(shorter(multiply(conjugate(first), last))) * known, 1

    def _against(self, t_ns: Int64, rate: Float64, beside: Float64) -> Remark | None:
        if not _are_unit(beside).all():
            return None
        gyro, own = GyroSeries(t_ns, rate), AttitudeSeries(t_ns, beside)
        return against_orientation([gyro], [own], self._rates, self._unit)

    def _directions(self, bins: _Bins, beside: Float64) -> tuple[Float64, Bool]:
        own = beside[bins.at]
        # Until a filter starts, many drivers write the identity.
        return self._raw_directions(own), _are_unit(own) & own[:, 1:].any(axis=1)

    def _raw_directions(self, beside: Float64) -> Float64:
        return rotate(conjugate(beside), UP)


class ForceWatch(DirectionWatch):
    """Compares body rates with specific forces: gravity turns as the rates say."""

    what = "accelerometer"
    jumps = "gravity, in the accelerometer"
    least = TURNED / SPAN

    def _turns(self, bins: _Bins, beside: Float64) -> tuple[Float64, Float64, int]:
        gravity, is_steady = self._directions(bins, beside)
        lag = max(round(SPAN / bins.span_s), 1)
        q, first, last = bins.wxyz, gravity[:-lag], gravity[lag:]
        known = (is_steady[:-lag] & is_steady[lag:] & bins.are_whole(lag))[:, None]
        by_rates = rotate(multiply(conjugate(q[lag:]), q[:-lag]), first) - first
        return np.where(known, by_rates, 0.0), np.where(known, last - first, 0.0), lag

    def _against(self, t_ns: Int64, rate: Float64, beside: Float64) -> Remark | None:
        return against_gravity(GyroSeries(t_ns, rate), t_ns, beside, self._unit)

    def _directions(self, bins: _Bins, beside: Float64) -> tuple[Float64, Bool]:
        # Of a fast sensor, some samples are enough.
        stride = max(bins.step // 9, 1)
        each = beside[: len(bins.at) * bins.step].reshape(-1, bins.step, 3)
        return directions(each[:, bins.step // 2 % stride :: stride].mean(axis=1))

    def _raw_directions(self, beside: Float64) -> Float64:
        return beside


def _are_unit(wxyz: Float64) -> Bool:
    are_unit: Bool = np.abs(_dot(wxyz, wxyz) - 1) < 2 * UNIT
    return are_unit


def _dot(a: Float64, b: Float64) -> Float64:
    """Return the products of vectors, ``(N,)``."""
    products: Float64 = np.einsum("ij,ij->i", a, b)
    return products


def _bins(t_ns: Int64, rate: Float64) -> _Bins | None:
    """Return the rotations by the rates; None if there are too few samples."""
    steps = np.diff(t_ns)
    if len(steps) < 2 * FEWEST_STEPS or (usual := spread(steps[::SOME])[1]) <= 0:
        return None
    step = max(round(BIN_NS / usual), FEWEST_STEPS)
    count = len(t_ns) // step
    if count < 2:  # noqa: PLR2004  # no rotation
        return None
    at = step // 2 + step * np.arange(count)
    steps = steps[at[0] : at[-1]].reshape(-1, step)
    turned = np.einsum("ks,ksi->ki", steps / NS_PER_S, rate[at[0] : at[-1]].reshape(-1, step, 3))
    known = np.isfinite(turned).all(axis=1)
    if (is_back := steps <= 0).any():
        known &= ~is_back.any(axis=1)
    turned[~known] = 0.0
    return _Bins(at, t_ns[at], step, step * usual / NS_PER_S, turned, known)


def _jump(bins: _Bins, own: Float64, known: Bool) -> tuple[int, int, float, float] | None:
    """Return where a direction in the body is another, though the rates do not turn as far.

    That is the samples between which it jumps, by how much, and how far the rates turn, rad.
    """
    if len(own) < 2 * SIDE + 1:
        return None
    there = rotate(bins.wxyz, np.where(known[:, None], own, 0.0))
    sums = np.cumsum(np.column_stack([there, known]), axis=0)
    sums = np.concatenate([np.zeros((1, 4)), sums])
    at = np.arange(SIDE, len(own) - SIDE)
    sides = sums[at] - sums[at - SIDE], sums[at + 1 + SIDE] - sums[at + 1]
    before, after = (one[:, :3] / np.maximum(one[:, 3:], 1.0) for one in sides)
    lengths = [np.linalg.norm(one, axis=1) for one in (before, after)]
    cosine = _dot(before, after) / np.maximum(lengths[0] * lengths[1], 0.01)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    scatter = np.sqrt(2 * np.maximum(1 - np.minimum(*lengths), 0.0))
    # A force that is fixed to the body turns as the rates do.
    sizes = np.linalg.norm(bins.turned, axis=1)
    turned = sizes[at - 1] + sizes[at]
    is_jump = np.minimum(*(one[:, 3] for one in sides)) > KNOWN * SIDE
    is_jump &= bins.are_whole(2 * SIDE) & (angle > np.maximum(JUMPED + turned, CLEAR * scatter))
    for side, near in ((before, at - 1), (after, at + 1)):
        along = _dot(side, there[near])
        is_jump &= known[near] & (along > np.cos(angle / CLEAR))
    if not is_jump.any():
        return None
    k = int(np.argmax(np.where(is_jump, angle - CLEAR * scatter, -np.inf)))
    begin, end = bins.at[at[k] - 1 : at[k] + 2 : 2].tolist()
    return begin, end, float(angle[k]), float(turned[k])
