"""Alignment of frames: constant rotations by which two attitude series may differ.

A and B may have different reference frames, and different body frames fixed to each other:
q_A = r q_B m. On the left, r transforms from B's reference frame to A's; on the right, m transforms
from A's body frame to B's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S
from quatprop.estimation.cells import over_gap
from quatprop.kinematics.conventions import from_matrices
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    geodesic_angle,
    log,
    multiply,
    shorter,
)
from quatprop.kinematics.time_series import rms

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.comparison.association import Pairs
    from quatprop.kinematics.series import AttitudeSeries


MIN_MOTIONS = 10
"""Minimum number of relative rotations from which a mounting is estimated."""

MAX_MOTIONS = 20_000
"""Approximate number of relative rotations used of a long recording."""

MIN_TURN = np.radians(0.1)
"""RMS relative rotation, rad, below which the motion shows no mounting."""

MAX_TURN = np.radians(150.0)
"""Larger relative rotations, rad, are ignored: near half a turn their axes change sign."""

MIN_EXCITATION = 0.02
"""Minimum rotation about the second axis, as a share of the first."""

MIN_BLOCKS = 5
"""Minimum number of blocks of relative rotations for the jackknife."""

MAX_BLOCKS = 30
"""Maximum number of these blocks."""

MAX_STD = np.radians(5.0)
"""Maximum standard deviation of a mounting, rad."""

WAY_OUT = f"choose {Setting('align', 'mean')}, or a longer part of the recording"
"""Advice if the motion does not show the mounting."""


class MountingFit(NamedTuple):
    """How well a mounting was estimated from relative rotations.

    `motions`: number of relative rotations
    `turn_rad`: their RMS angle, rad
    `singular_values`: roots of the singular values of the fit: RMS sin(angle/2) about the three
        principal axes common to A and B, largest first. Two must be well above zero
    `std_rad`: standard deviation about the least certain axis, rad, by a block jackknife
    """

    motions: int
    turn_rad: float
    singular_values: list[float]
    std_rad: float


@dataclass(frozen=True, slots=True)
class Alignment:
    """Rotations that align B with A: q_A = r q_B m.

    `name`: one of :data:`quatprop.settings.command_options.ALIGNMENTS`
    `reference_wxyz`: r, B's reference -> A's reference, left factor, shape ``(4,)``
    `reference_rad`: angle of r, rad
    `mount_wxyz`: m, A's body -> B's body, right factor, shape ``(4,)``
    `mount_rad`: angle of m, rad
    `mounting`: how well m was estimated; None if it was not
    `range`: the pairs that were used: one of
        :data:`quatprop.settings.command_options.ALIGN_RANGES`
    """

    name: str
    reference_wxyz: Float64
    reference_rad: float = field(init=False)
    mount_wxyz: Float64 = field(default_factory=IDENTITY.copy)
    mount_rad: float = field(init=False)
    mounting: MountingFit | None = None
    range: str = "all"

    def __post_init__(self) -> None:
        angles = geodesic_angle(IDENTITY, [self.reference_wxyz, self.mount_wxyz])
        object.__setattr__(self, "reference_rad", float(angles[0]))
        object.__setattr__(self, "mount_rad", float(angles[1]))

    def apply(self, b: Float64) -> Float64:
        """Return r q_B m for attitudes wxyz, shape ``(N, 4)``."""
        turned = multiply(self.reference_wxyz, b)
        return multiply(turned, self.mount_wxyz) if self.mount_rad else turned


def align_pairs(name: str, pairs: Pairs, a: AttitudeSeries, b: AttitudeSeries) -> Alignment:
    """Return the rotations that align B with A, by pairs of both; as :func:`align`."""
    crossing = between_gaps(pairs.t_ns, a.t_ns, b.t_ns) if name == "mount" else None
    return align(name, pairs.a, pairs.b, crossing)


def align(name: str, a: Float64, b: Float64, crossing: Bool | None = None) -> Alignment:
    """Return the rotations that align B with A.

    `name`: ``"none"``; ``"first"``: r makes the first attitudes equal; ``"mean"``: r is the least
        squares fit over all; ``"yaw"``: the same, restricted to rotations about z; ``"mount"``: m
        from the relative rotations, then r as for mean
    `a`, `b`: unit quaternions wxyz at the same times, shape ``(N, 4)``
    `crossing`: which intervals between them are over a gap, shape ``(N - 1,)``; None: no interval
    """
    if name == "none":
        return Alignment(name, IDENTITY)
    if name == "first":
        return Alignment(name, multiply(a[0], conjugate(b[0])))
    if name == "mount":
        mount, fit = find_mounting(a, b, crossing)
        b = multiply(b, mount)
    else:
        mount, fit = IDENTITY, None
    apart = multiply(a, conjugate(b))
    reference = mean_heading(apart) if name == "yaw" else mean_rotation(apart)
    return Alignment(name, reference, mount, fit)


def aligned_rms(name: str, a: Float64, b: Float64) -> float:
    """Return the RMS angle between attitudes, rad, once B is aligned."""
    return rms_between(a, align(name, a, b).apply(b))


def rms_between(a: Float64, b: Float64) -> float:
    """Return the RMS angle between attitudes, rad."""
    return rms(geodesic_angle(a, b))


def mean_rotation(q: Float64) -> Float64:
    """Return the mean of rotations in the chordal sense.

    `q`: unit quaternions wxyz, shape ``(N, 4)``; their signs do not matter
    `Returns`: wxyz with w >= 0, shape ``(4,)``

    References
    ----------
    Markley, Cheng, Crassidis and Oshman, "Averaging quaternions", J. Guidance 30(4), 2007: the
    eigenvector of the largest eigenvalue of sum q q^T.
    """
    _, vectors = np.linalg.eigh(q.T @ q)
    return shorter(vectors[:, -1])


def mean_heading(q: Float64) -> Float64:
    """Return the rotation about the vertical nearest to the mean in the chordal sense.

    `q`: unit quaternions wxyz, shape ``(N, 4)``
    `Returns`: wxyz, shape ``(4,)``: as :func:`mean_rotation`, for w and z alone
    """
    _, vectors = np.linalg.eigh(q[:, [0, 3]].T @ q[:, [0, 3]])
    w, z = vectors[:, -1].tolist()
    return shorter([w, 0.0, 0.0, z])


def find_mounting(
    a: Float64, b: Float64, crossing: Bool | None = None
) -> tuple[Float64, MountingFit]:
    """Solve the hand-eye problem: estimate the mounting of body A in body B from motion.

    With q_A = r q_B m, rotations from sample i to j are a = m* b m: for any r, they have the same
    angle, and axes that m rotates into each other. Their vector parts are fitted by least squares.

    `a`, `b`: unit quaternions wxyz at the same times, shape ``(N, 4)``
    `crossing`: which intervals between them are over a gap: rotations over those are not used
    `Returns`: m, wxyz, shape ``(4,)``: A's body -> B's body

    References
    ----------
    Park and Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group", IEEE
    Trans. Robotics and Automation 10(5), 1994; here with sin(angle/2) in place of the angle, and
    Kabsch's solution by singular values. Efron and Stein, "The jackknife estimate of variance",
    Annals of Statistics 9(3), 1981.
    """
    # Rotations over few samples suffer from noise, and over many from drift: the residual decides.
    strides = [1 << power for power in range(32) if 2 << power <= len(a) - MIN_MOTIONS]
    gaps = np.zeros(len(a), np.int64)
    if crossing is not None:
        np.cumsum(crossing, out=gaps[1:])
    fits = [_fitted(*_relative(a, b, gaps, step), len(a) / step) for step in strides]
    if not fits:
        raise ComparisonError(
            f"a mounting needs {MIN_MOTIONS} relative rotations, and there are only {len(a)} "
            f"attitudes; {WAY_OUT}"
        )
    # If the motions are equal, every fit is exact, and only small rotations have to be avoided.
    best = min(
        range(len(fits)),
        key=lambda one: (fits[one][1].turn_rad < MIN_TURN, fits[one][1].std_rad),
    )
    mount, fit = fits[best]
    std = fit.std_rad
    if std < np.inf:
        independent = len(a) / strides[best]
        std = _jackknife(mount, *_relative(a, b, gaps, strides[best]), independent)
    # One of them may be too large: that for white noise, or that from few blocks.
    _refuse_unexcited(fit._replace(std_rad=min(std, fit.std_rad)))
    return from_matrices(mount.reshape(1, 9))[0], fit._replace(std_rad=std)


def _fitted(in_a: Float64, in_b: Float64, independent: float) -> tuple[Float64, MountingFit]:
    """Fit the mounting, as a matrix, to relative rotations; its uncertainty is for white noise.

    `independent`: number of them that do not overlap
    """
    x, y = in_a[:, 1:], in_b[:, 1:]
    if len(x) < MIN_MOTIONS:
        return np.eye(3), MountingFit(len(x), 0.0, [0.0, 0.0, 0.0], np.inf)
    mount, excited = kabsch(x, y)
    # Overlapping rotations are not independent.
    information = (excited[1] + excited[2]) * max(min(len(x), independent), 1.0)
    residual = float(((y - x @ mount.T) ** 2).sum(axis=1).mean()) / 3
    std = np.sqrt(residual / information) if information else np.inf
    angle = rms(geodesic_angle(IDENTITY, in_a))
    return mount, MountingFit(len(x), angle, np.sqrt(excited).tolist(), float(std))


def _relative(a: Float64, b: Float64, gaps: Int64, stride: int) -> tuple[Float64, Float64]:
    """Return q[i]* q[i + stride] of A and B with w >= 0, for at most about MAX_MOTIONS i.

    `gaps`: number of gaps before each attitude; rotations over gaps and large ones are left out
    """
    start = np.arange(0, len(a) - stride, max(len(a) // MAX_MOTIONS, 1))
    start = start[gaps[start] == gaps[start + stride]]
    in_a, in_b = (shorter(multiply(conjugate(q[start]), q[start + stride])) for q in (a, b))
    usable = (in_a[:, 0] > np.cos(MAX_TURN / 2)) & (in_b[:, 0] > np.cos(MAX_TURN / 2))
    return in_a[usable], in_b[usable]


def _jackknife(mount: Float64, in_a: Float64, in_b: Float64, independent: float) -> float:
    """Return the standard deviation of a mounting about its least certain axis, rad.

    Blocks of relative rotations are left out in turn, so it holds for noise of any colour.

    `mount`: the matrix that was fitted to all
    `independent`: number of relative rotations that do not overlap
    """
    count = int(np.clip(independent, MIN_BLOCKS, MAX_BLOCKS))
    edges = np.arange(count) * len(in_a) // count
    moments = np.add.reduceat(in_b[:, 1:, None] * in_a[:, None, 1:], edges)
    others = np.stack([_rotation(moments.sum(axis=0) - moment)[0] for moment in moments])
    turns = log(shorter(from_matrices((mount.T @ others).reshape(-1, 9))))
    covariance = (count - 1) / count * centred(turns).T @ centred(turns)
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def kabsch(x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Return the rotation matrix M with y = M x in the least squares sense, and its excitation.

    The excitation is the singular values of the mean of y x^T, shape ``(3,)``: unlike those of
    x x^T, they are not increased by independent noise in x and y.
    """
    return _rotation(y.T @ x / len(x))


def _rotation(moment: Float64) -> tuple[Float64, Float64]:
    """Return the rotation matrix nearest to the mean of y x^T, and its singular values."""
    left, excited, right = np.linalg.svd(moment)
    if np.linalg.det(left) * np.linalg.det(right) < 0:
        left[:, 2] *= -1
    return left @ right, excited


def _refuse_unexcited(mounting: MountingFit) -> None:
    first, second, _ = mounting.singular_values
    if mounting.turn_rad < MIN_TURN:
        raise ComparisonError(
            f"the body turns by {np.degrees(mounting.turn_rad):.2g} deg only, which shows no "
            f"mounting; {WAY_OUT}"
        )
    if second < MIN_EXCITATION * first:
        raise ComparisonError(
            f"the body turns about one axis only (about the second by {second / first:.2%} of the "
            f"first), so the mounting about it cannot be determined; {WAY_OUT}"
        )
    if mounting.std_rad > MAX_STD:
        raise ComparisonError(
            f"the mounting cannot be determined better than to {np.degrees(mounting.std_rad):.2g} "
            f"deg: A and B hardly turn together, or about one axis only; {WAY_OUT}"
        )


# Rotations over windows, which are independent of reference frames and constant biases.
#
# The body angle of a series is the sum of its small rotations in the body frame; its difference
# over a window is the integral of the body rate. A constant bias adds a constant to all windows,
# which is removed with their mean; a slow drift hardly matters.


LENGTHS_S = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Candidate lengths of windows, s; the one with the lowest uncertainty is used."""

MAX_SAMPLES = 100_000
"""Maximum number of samples of either series, from the start: over more, clocks drift."""

MAX_WINDOWS = 20_000
"""Maximum number of windows."""

MIN_LENGTHS = 20
"""Windows are shortened until this many fit into the common time."""

MIN_WINDOWS = 40
"""Minimum number of windows."""

PER_WINDOW = 4
"""Overlap: number of windows that begin within the length of one."""

EDGE = 0.2
"""Maximum share of the common time left free at each end for time offsets."""

MAX_EDGE_S = 0.5
"""Maximum time left free at each end, s: larger offsets could match another motion."""


class BodyAngle(NamedTuple):
    """The integral of a body rate.

    `seconds`: times since a common origin, shape ``(N,)``, s
    `angle`: integral up to these times in the body frame, shape ``(N, 3)``, rad
    """

    seconds: Float64
    angle: Float64

    def over(self, begin: Float64, length: float) -> Float64:
        """Return the integrals over windows without the effect of a bias, ``(M, 3)``, rad."""
        return centred(self.between(begin, begin + length))

    def between(self, begin: Float64, end: Float64) -> Float64:
        """Return the integrals between times, ``(M, 3)``, rad."""
        columns = [
            np.interp(end, self.seconds, angle) - np.interp(begin, self.seconds, angle)
            for angle in self.angle.T
        ]
        return np.stack(columns, axis=1)


def common_beginning(a: AttitudeSeries, b: AttitudeSeries) -> tuple[AttitudeSeries, AttitudeSeries]:
    """Return the start of the common time, at most :data:`MAX_SAMPLES` samples of each."""
    start = max(a.t_ns[0], b.t_ns[0])
    begins = [max(int(np.searchsorted(series.t_ns, start)) - 1, 0) for series in (a, b)]
    return a[begins[0] :][:MAX_SAMPLES], b[begins[1] :][:MAX_SAMPLES]


def window_grids(a: Float64, b: Float64) -> Iterator[tuple[float, Float64]]:
    """Yield lengths of windows, s, and the start times of windows of this length, s.

    `a`, `b`: times of two series, rising, s
    """
    interval = max(float(np.median(np.diff(times))) for times in (a, b))
    begin, end = max(a[0], b[0]), min(a[-1], b[-1])
    edge = min(MAX_EDGE_S, EDGE * (end - begin))
    longest = (end - begin) / MIN_LENGTHS
    lengths = sorted({max(min(length, longest), 2 * interval) for length in LENGTHS_S})
    for length in lengths:
        last = end - length - edge
        spacing = max(length / PER_WINDOW, (last - begin - edge) / MAX_WINDOWS)
        starts = np.arange(begin + edge, last, spacing)
        for times in (a, b):
            starts = starts[~over_gap(times, starts, starts + length)]
        if len(starts) < MIN_WINDOWS:
            return
        yield length, starts


def between_gaps(t_ns: Int64, a_ns: Int64, b_ns: Int64) -> Bool:
    """Return which intervals between the times of pairs contain a part of a gap of A or B.

    `t_ns`: times of the pairs, ns, shape ``(N,)``
    `a_ns`, `b_ns`: times of A and B in the same clock, ns
    """
    return over_gap(a_ns, t_ns[:-1], t_ns[1:]) | over_gap(b_ns, t_ns[:-1], t_ns[1:])


def centred(values: Float64) -> Float64:
    """Return rows minus their mean."""
    return np.asarray(values - values.mean(axis=0))


def body_angle(series: AttitudeSeries, first_ns: int) -> BodyAngle:
    """Return the body angle of a series, with times since `first_ns`."""
    total = np.zeros((3, len(series))).T  # by column, as each is interpolated
    np.cumsum(rotation_vectors_between(series.wxyz), axis=0, out=total[1:])
    return BodyAngle((series.t_ns - first_ns) / NS_PER_S, total)
