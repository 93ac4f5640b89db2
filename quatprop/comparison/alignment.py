"""What two attitude series differ by and are not to be blamed for: frames.

A and B may be relative to different reference frames, and be attitudes of different body frames
that are fixed to each other: q_A = r q_B m. Here r turns coordinates of B's reference into
coordinates of A's, on the left; m turns coordinates of A's body into coordinates of B's, on the
right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import ComparisonError, UsageError, listed, quoted
from quatprop.quaternion import IDENTITY, conjugate, geodesic_angle, multiply, rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]

ALIGNMENTS = ("none", "first", "mean", "mount")
"""How B may be turned before it is compared."""

MIN_MOTIONS = 10
"""Fewer relative rotations do not make a mounting believable."""

MIN_TURN = np.radians(0.1)
"""RMS relative rotation, rad, below which there is no motion that could show a mounting."""

ENOUGH_TURN = np.radians(30.0)
"""RMS relative rotation, rad, that is looked for: large against noise, small against drift."""

MAX_TURN = np.radians(150.0)
"""Larger relative rotations are left out: near half a turn their axes change sign."""

MIN_EXCITATION = 0.02
"""Least rotation about the second axis, as a share of that about the first."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """How a mounting was found from relative rotations, and how well.

    Parameters
    ----------
    motions
        How many relative rotations.
    turn_rad
        Their RMS angle, rad.
    singular_values
        RMS of the relative rotations along their three principal axes, in units of sin(angle/2),
        largest first. Two have to be well above zero.
    std_rad
        Standard deviation of the mounting about its least certain axis, rad, from the residual.
    """

    motions: int
    turn_rad: float
    singular_values: list[float]
    std_rad: float


@dataclass(frozen=True, slots=True)
class Alignment:
    """Rotations that bring B to A: q_A = r q_B m.

    Parameters
    ----------
    name
        One of :data:`ALIGNMENTS`.
    reference
        r, wxyz, shape ``(4,)``: B's reference -> A's reference, multiplied on the left.
    mount
        m, wxyz, shape ``(4,)``: A's body -> B's body, multiplied on the right.
    mounting
        How m was found, where it was.
    """

    name: str
    reference: Float64
    mount: Float64
    mounting: Mounting | None = None

    def apply(self, b: Float64) -> Float64:
        """Return r q_B m for attitudes wxyz, shape ``(N, 4)``."""
        return multiply(multiply(self.reference, b), self.mount)


def align(name: str, a: Float64, b: Float64) -> Alignment:
    """Return the rotations that bring B to A.

    Parameters
    ----------
    name
        ``"none"``; ``"first"``: r makes the first attitudes the same; ``"mean"``: r is the least
        squares fit over all; ``"mount"``: m from the relative rotations, then r as for mean.
    a, b
        Unit quaternions wxyz at the same times, shape ``(N, 4)``.

    Raises
    ------
    ComparisonError
        The motion does not show a mounting.
    UsageError
        No such alignment.
    """
    match name:
        case "none":
            return Alignment(name, IDENTITY, IDENTITY)
        case "first":
            return Alignment(name, multiply(a[0], conjugate(b[0])), IDENTITY)
        case "mean":
            return Alignment(name, mean_rotation(multiply(a, conjugate(b))), IDENTITY)
        case "mount":
            mount, mounting = find_mounting(a, b)
            reference = mean_rotation(multiply(a, conjugate(multiply(b, mount))))
            return Alignment(name, reference, mount, mounting)
        case _:
            raise UsageError(f"no alignment {quoted(name)}; choose one of {listed(ALIGNMENTS)}")


def mean_rotation(q: Float64) -> Float64:
    """Return the rotation nearest to many in the chordal sense.

    Parameters
    ----------
    q
        Unit quaternions wxyz, shape ``(N, 4)``; their signs do not matter.

    Returns
    -------
    ndarray
        wxyz with w >= 0, shape ``(4,)``.

    References
    ----------
    Markley, Cheng, Crassidis and Oshman, "Averaging quaternions", J. Guidance 30(4), 2007: the
    eigenvector of the largest eigenvalue of sum q q^T.
    """
    _, vectors = np.linalg.eigh(q.T @ q)
    mean = vectors[:, -1]
    return np.asarray(mean * np.copysign(1.0, mean[0]))


def find_mounting(a: Float64, b: Float64) -> tuple[Float64, Mounting]:
    """Solve the hand-eye problem: how body A sits in body B, from rotations both went through.

    With q_A = r q_B m, rotations from sample i to j are a = m* b m: the same angle about axes
    that m turns into each other, whatever r is. Their vector parts are fitted by least squares.

    Parameters
    ----------
    a, b
        Unit quaternions wxyz at the same times, shape ``(N, 4)``.

    Returns
    -------
    mount : ndarray
        m, wxyz, shape ``(4,)``: A's body -> B's body.
    mounting : Mounting
        How well it is known.

    Raises
    ------
    ComparisonError
        Too little motion, or motion about one axis only.

    References
    ----------
    Park and Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group", IEEE
    Trans. Robotics and Automation 10(5), 1994; here with sin(angle/2) in place of the angle, and
    Kabsch's solution by singular values.
    """
    stride = _stride(a)
    in_a, in_b = _relative(a, stride), _relative(b, stride)
    usable = (in_a[:, 0] > np.cos(MAX_TURN / 2)) & (in_b[:, 0] > np.cos(MAX_TURN / 2))
    x, y = in_a[usable, 1:], in_b[usable, 1:]
    turn = _rms_angle(in_a[usable])
    squares = np.linalg.eigvalsh(x.T @ x / max(len(x), 1))[::-1]
    spread = np.sqrt(np.maximum(squares, 0.0))
    _refuse_unexcited(len(x), turn, spread)
    mount = _kabsch(x, y)
    residual = y - rotate(mount, x)
    # Overlapping rotations repeat each other: only every stride-th is new.
    independent = max(len(x) / stride, 1.0)
    weakest = spread[1] ** 2 + spread[2] ** 2
    std = np.sqrt((residual**2).sum(axis=1).mean() / 3 / (weakest * independent))
    return mount, Mounting(len(x), turn, spread.tolist(), float(std))


def _stride(a: Float64) -> int:
    """Return over how many samples to take rotations: as few as give enough of a turn."""
    stride = 1
    while len(a) - 2 * stride >= MIN_MOTIONS and _rms_angle(_relative(a, stride)) < ENOUGH_TURN:
        stride *= 2
    return stride


def _relative(q: Float64, stride: int) -> Float64:
    """Return q[i]* q[i + stride] with w >= 0."""
    step = multiply(conjugate(q[:-stride]), q[stride:])
    return np.asarray(step * np.where(step[:, :1] < 0, -1.0, 1.0))


def _rms_angle(q: Float64) -> float:
    angle = geodesic_angle(IDENTITY, q)
    return float(np.sqrt((angle**2).mean())) if len(angle) else 0.0


def _kabsch(x: Float64, y: Float64) -> Float64:
    """Return the rotation m with y = m x m* in the least squares sense, shape ``(4,)``."""
    left, _, right = np.linalg.svd(y.T @ x)
    flip = np.array([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)])
    return from_matrix((left * flip) @ right)


def from_matrix(matrix: Float64) -> Float64:
    """Return the quaternion of a rotation matrix, wxyz with w >= 0, shape ``(4,)``.

    References
    ----------
    Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", J. Guidance
    23(6), 2000: an eigenvector, good for every angle and nearest to what is not quite orthogonal.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    symmetric = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    _, vectors = np.linalg.eigh(symmetric)
    return np.asarray(vectors[:, -1] * np.copysign(1.0, vectors[0, -1]))


def _refuse_unexcited(motions: int, turn: float, spread: Float64) -> None:
    way_out = "choose --align mean, or a longer part of the recording"
    if motions < MIN_MOTIONS:
        raise ComparisonError(
            f"a mounting needs {MIN_MOTIONS} relative rotations, and there are {motions}; {way_out}"
        )
    if turn < MIN_TURN:
        raise ComparisonError(
            f"the body turns by {np.degrees(turn):.2g} deg only, which shows no mounting; {way_out}"
        )
    if spread[1] < MIN_EXCITATION * spread[0]:
        raise ComparisonError(
            "the body turns about one axis only (about the second by "
            f"{spread[1] / spread[0]:.2%} of the first), so the mounting about it cannot be told; "
            f"{way_out}"
        )
