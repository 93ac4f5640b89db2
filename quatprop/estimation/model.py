"""The model of a gyroscope and of two clocks, and its parameters.

Calibrated rates are w = R (I + U) (w_raw - b). The bias b is in the axes of the raw rates. U is
upper triangular: its diagonal corrects the scale, the elements above it the angles between the axes
of the sensor, whose z axis defines the frame. R is the mounting: sensor to the body of the
reference. Every matrix of positive determinant has exactly one such R and U.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.estimation.cells import over_gap
from quatprop.kinematics.matrix_elements import rotation_elements
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    exp,
    log,
    multiply,
    normalize,
    rotation_matrix,
    shorter,
)
from quatprop.kinematics.resample import Listed, at_times
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.time_series import reblock
from quatprop.propagation.conditioning.corrections import corrected
from quatprop.settings.command_options import GROUPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Bool, Float64, Int64


OF_GROUP: Final = np.array([name for name, group in GROUPS.items() for _ in group.axes])
"""The group of each of the 14 parameters."""

UPPER: Final = np.triu_indices(3, 1)
"""Rows and columns of the misalignment in U."""


class FollowedMotion(NamedTuple):
    """The part of the motion that a reference follows.

    `motion`: projection on the axes about which both turn, in body axes, shape ``(3, 3)``;
        derivatives are taken with respect to this motion only
    `errors`: the axes about which errors count, as rows in body axes, shape ``(S, 3)``; rotation
        about other axes is not compared
    """

    motion: Float64
    errors: Float64


ALL: Final = FollowedMotion(np.eye(3), np.eye(3))
"""For a reference that follows all motion."""


class Model(NamedTuple):
    """Values of all parameters.

    `bias`: b, shape ``(3,)``, rad/s
    `scale_misalignment`: I + U, shape ``(3, 3)``
    `mount`: R, sensor to body, wxyz, shape ``(4,)``
    `added_ns`: added to the timestamps of the reference, ns, before the offset
    `offset`: added to them in the middle, s
    `drift`: what more is added for each second after it, s
    `middle_ns`: the middle of the reference, in its own clock, ns
    `jumps_ns`: times at which the bias jumps, in the clock of the rates, rising, ns
    `jumps`: by how much, shape ``(J, 3)``, rad/s; `bias` is the mean over the windows
    `parts`: share of the windows after each jump, shape ``(J,)``
    """

    bias: Float64 = np.zeros(3)
    scale_misalignment: Float64 = np.eye(3)
    mount: Float64 = IDENTITY
    added_ns: int = 0
    offset: float = 0.0
    drift: float = 0.0
    middle_ns: int = 0
    jumps_ns: tuple[int, ...] = ()
    jumps: Float64 = np.zeros((0, 3))
    parts: Float64 = np.zeros(0)

    @property
    def matrix(self) -> Float64:
        """R (I + U), shape ``(3, 3)``."""
        return np.asarray(rotation_matrix(self.mount) @ self.scale_misalignment)

    def with_increment(self, by: Float64) -> Model:
        """Return the model with increments of all parameters, ``(14,)``, in their order.

        Those of the jumps of the bias may follow, ``(14 + 3 J,)``.
        """
        by, jumps = by[: len(OF_GROUP)], by[len(OF_GROUP) :].reshape(-1, 3)
        shape = self.scale_misalignment + np.diag(by[OF_GROUP == "scale"])
        shape[UPPER] += by[OF_GROUP == "misalignment"]
        return self._replace(
            bias=self.bias + by[OF_GROUP == "bias"],
            scale_misalignment=shape,
            mount=normalize(multiply(exp(by[OF_GROUP == "mount"]), self.mount)),
            offset=self.offset + float(by[OF_GROUP == "offset"][0]),
            drift=self.drift + float(by[OF_GROUP == "drift"][0]),
            jumps=self.jumps + jumps if len(jumps) else self.jumps,
        )

    def jumping(self, at_ns: int, size: Float64, part: float) -> Model:
        """Return the model with one more jump of the bias, by `size`, rad/s, before `part`."""
        place = int(np.searchsorted(self.jumps_ns, at_ns))
        return self._replace(
            jumps_ns=(*self.jumps_ns[:place], at_ns, *self.jumps_ns[place:]),
            jumps=np.insert(self.jumps, place, size, axis=0),
            parts=np.insert(self.parts, place, part),
        )

    def without_jumps(self) -> Model:
        """Return the model with the mean bias alone."""
        return self._replace(jumps_ns=(), jumps=np.zeros((0, 3)), parts=np.zeros(0))

    @property
    def variation(self) -> Float64:
        """Covariance of the bias over the windows by its jumps, shape ``(3, 3)``."""
        shared = np.minimum.outer(self.parts, self.parts) - np.outer(self.parts, self.parts)
        return np.asarray(self.jumps.T @ shared @ self.jumps)

    def steadied(self, rates: GyroSeries) -> GyroSeries:
        """Return rates less what the bias differs from its mean."""
        if not self.jumps_ns:
            return rates
        after = rates.t_ns[:, None] > np.array(self.jumps_ns, np.int64)
        return rates.with_rate(rates.rate - (after - self.parts) @ self.jumps)

    @property
    def values(self) -> Float64:
        """All parameters, ``(14,)``; the mounting as a rotation vector."""
        scale, turn = self.scale_misalignment.diagonal() - 1, log(shorter(self.mount))
        clock = [self.offset, self.drift]
        return np.concatenate([self.bias, scale, self.scale_misalignment[UPPER], turn, clock])

    def times_of(self, t_ns: Int64) -> Int64:
        """Return timestamps of the reference in the clock of the rates, int64 ns."""
        since = (t_ns - self.middle_ns) / NS_PER_S
        moved = np.rint((self.offset + self.drift * since) * NS_PER_S).astype(np.int64)
        return np.asarray(t_ns + self.added_ns + moved)

    def by_rate(self) -> Float64:
        """Return the derivatives of calibrated rates by the parameters; 0 for the clock.

        `Returns`: shape ``(14, 3, 4)``: times 1 and the three components of the rate
        """
        change = np.zeros((len(OF_GROUP), 3, 4))
        change[OF_GROUP == "bias", :, 0] = -self.matrix.T
        change[OF_GROUP == "mount", :, 1:] = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
        inverse = np.linalg.inv(self.matrix)
        of_shape = np.einsum("im,nj->mnij", rotation_matrix(self.mount), inverse)
        change[OF_GROUP == "scale", :, 1:] = of_shape[range(3), range(3)]
        change[OF_GROUP == "misalignment", :, 1:] = of_shape[UPPER]
        return change


# Rotations over windows, from rates and from a reference, and their derivatives.
#
# The rotation over a window does not depend on the reference frame. Windows end at samples of the
# reference and the next one begins at the sample after that, so that no two share its noise.


METHOD: Final = "cubic"
"""The rule by which rates are integrated."""

LONGEST: Final = 1.5
"""Windows longer than this many times the nominal length, because of gaps, are omitted."""

MAX_WINDOWS: Final = 200_000
"""Maximum number of windows; of more, every second one or fewer are used, to bound memory."""

SPARE_NS: Final = 200_000_000
"""Margin around each window for a clock offset that is still unknown."""


class RotationWindows(NamedTuple):
    """Windows of a reference in order of time.

    `t_ns`: first and last time of each, in the clock of the reference, shape ``(M, 2)``, int64 ns
    `turn`: the rotation over each, in the body axes at its beginning, wxyz, shape ``(M, 4)``
    `length_ns`: their nominal length, ns
    """

    t_ns: Int64
    turn: Float64
    length_ns: int

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, chosen: Bool) -> RotationWindows:
        """Return some of the windows."""
        return RotationWindows(self.t_ns[chosen], self.turn[chosen], self.length_ns)


def windows_of(
    rates: GyroSeries, reference: AttitudeSeries, model: Model, length_ns: int
) -> RotationWindows:
    """Return consecutive windows of about a length that rates cover without a gap."""
    t_ns = reference.t_ns
    edges = np.searchsorted(t_ns, np.arange(t_ns[0], t_ns[-1], length_ns))
    rows = np.stack([edges[:-1], edges[1:] - 1], axis=1)
    span_ns = np.diff(t_ns[rows])[:, 0]
    usual = (span_ns > 0) & (span_ns <= LONGEST * length_ns) & (2 * span_ns >= length_ns)
    need_ns = model.times_of(t_ns[rows]) + np.array([-SPARE_NS, SPARE_NS])
    inside = (need_ns[:, 0] >= rates.t_ns[0]) & (need_ns[:, 1] <= rates.t_ns[-1])
    rows = rows[usual & inside & ~over_gap(rates.t_ns, *need_ns.T)]
    begin, end = rows[:: len(rows) // MAX_WINDOWS + 1].T
    turn = multiply(conjugate(reference.wxyz[begin]), reference.wxyz[end])
    return RotationWindows(np.stack([t_ns[begin], t_ns[end]], axis=1), turn, length_ns)


def joined(parts: list[RotationWindows]) -> RotationWindows:
    """Return the windows of several lengths, one after the other."""
    t_ns, turn = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return RotationWindows(t_ns, turn, 0)


def errors_of(
    rates: GyroSeries, windows: RotationWindows, model: Model, seen: FollowedMotion = ALL
) -> tuple[Float64, Float64]:
    """Return the differences between the rotations of calibrated rates and of the reference.

    `rates`: raw rates in order of time
    `seen`: the motion that the reference follows
    `Returns`: rotation vectors from the rates' rotation to the reference's, in the body axes at the
        ends of windows, about those axes that count, shape ``(M, S)``, rad; and their derivatives
        with respect to each parameter, shape ``(M, S, 14 + 3 J)``
    """
    counted = seen.errors.T @ seen.errors
    log_rates = model.steadied(rates)
    matrix = counted @ model.matrix
    calibrated = corrected(reblock([log_rates]), bias=model.bias, matrix=matrix)
    times = np.clip(model.times_of(windows.t_ns), rates.t_ns[0], rates.t_ns[-1])
    rising, place = np.unique(times, return_inverse=True)
    reached = _reached(calibrated, rising, seen.motion)
    q, rate, sums = (values[place.ravel()] for values in reached)
    begin, end = q[::2], q[1::2]
    turn = multiply(conjugate(begin), end)
    vectors = log(shorter(multiply(conjugate(turn), windows.turn)))
    by_parameter = counted @ model.by_rate()
    by_rate = np.einsum("minj,pjn->mip", sums[1::2] - sums[::2], by_parameter)
    slope = rotation_matrix(conjugate(end)) @ by_rate
    at_begin = np.einsum("mji,mj->mi", rotation_matrix(turn), rate[::2])
    since = (windows.t_ns - model.middle_ns)[..., None] / NS_PER_S
    slope[..., OF_GROUP == "offset"] = (rate[1::2] - at_begin)[..., None]
    drift = since[:, 1] * rate[1::2] - since[:, 0] * at_begin
    slope[..., OF_GROUP == "drift"] = drift[..., None]
    jumps = [
        slope[..., OF_GROUP == "bias"] * (_share_after(times, at_ns) - part)
        for at_ns, part in zip(model.jumps_ns, model.parts, strict=True)
    ]
    return vectors @ seen.errors.T, -seen.errors @ np.concatenate([slope, *jumps], axis=2)


def _share_after(times: Int64, at_ns: int) -> Float64:
    """Return the part of each window after a jump, ``(M, 1, 1)``."""
    begin, end = times.T
    after = np.clip((end - at_ns) / np.maximum(end - begin, 1), 0.0, 1.0)
    return np.asarray(after[:, None, None])


def turns_of(rates: GyroSeries, windows: RotationWindows, model: Model, method: str) -> Float64:
    """Return the rotations over windows by calibrated rates, wxyz, shape ``(M, 4)``."""
    log_rates = model.steadied(rates)
    calibrated = corrected(reblock([log_rates]), bias=model.bias, matrix=model.matrix)
    times = np.clip(model.times_of(windows.t_ns), rates.t_ns[0], rates.t_ns[-1])
    rising, place = np.unique(times, return_inverse=True)
    stream = Propagation(IDENTITY, method, "body").run(calibrated)
    reached = at_times(stream, Listed(rising), method=method, rates="body")
    wxyz = AttitudeSeries.joined([*reached]).wxyz[place.ravel()]
    return multiply(conjugate(wxyz[::2]), wxyz[1::2])


def _reached(
    rates: Iterable[GyroSeries], t_ns: Int64, seen: Float64
) -> tuple[Float64, Float64, Float64]:
    """Return the attitudes and integrals that rates lead to at some times, from any initial one.

    `t_ns`: rising times within those of the rates, shape ``(K,)``
    `seen`: by which rates are multiplied in all but the attitudes, shape ``(3, 3)``
    `Returns`: attitudes, ``(K, 4)``; rates, ``(K, 3)``; and the integral of R times 1 and times
        each component of the rate, ``(K, 3, 4, 3)``
    """
    found = np.empty((39, len(t_ns)))

    def passing() -> Iterator[tuple[GyroSeries, AttitudeSeries]]:
        before, total, first = None, np.zeros((36, 1)), 0
        for block, attitudes in Propagation(IDENTITY, METHOD, "body").run(rates):
            yield block, attitudes
            samples, q = block, attitudes
            if before is not None:
                # The interval between blocks belongs to the later one.
                samples = GyroSeries.joined([before[0], block])
                q = AttitudeSeries.joined([before[1], attitudes])
            before = block[-1:], attitudes[-1:]
            turn = rotation_elements(q.wxyz)
            every = np.concatenate([np.ones((1, len(samples))), seen @ samples.rate.T])
            after = every[:, 1:]
            if not samples.is_integrated(METHOD):
                after = (after + every[:, :-1]) / 2
            since_s = (samples.t_ns - samples.t_ns[0]) / NS_PER_S
            middle = (turn[:, 1:] + turn[:, :-1]) / 2
            steps = (middle[:, None] * (after * np.diff(since_s))).reshape(36, -1)
            sums = np.cumsum(np.concatenate([total, steps], axis=1), axis=1)
            total = sums[:, -1:]
            last = int(np.searchsorted(t_ns, samples.t_ns[-1], side="right"))
            at_s = (t_ns[first:last] - samples.t_ns[0]) / NS_PER_S
            for row, values in zip(found, (*every[1:], *sums), strict=True):
                row[first:last] = np.interp(at_s, since_s, values)
            first = last

    wanted = at_times(passing(), Listed(t_ns), method=METHOD, rates="body")
    q = AttitudeSeries.joined([*wanted]).wxyz
    # rows of R, factors, columns of R
    return q, found[:3].T, found[3:].T.reshape(-1, 3, 3, 4).swapaxes(2, 3)
