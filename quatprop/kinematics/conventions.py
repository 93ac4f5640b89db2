"""Conventions of stored attitudes: layout, Hamilton or JPL, direction, representations.

Inside quatprop an attitude is a Hamilton quaternion q that transforms body coordinates to reference
coordinates, v_ref = q v_body q*. Other conventions store the same rotation as other numbers:

==========  ===========  =======
convention  direction    numbers
==========  ===========  =======
hamilton    body-to-ref  q
hamilton    ref-to-body  q*
jpl         ref-to-body  q
jpl         body-to-ref  q*
==========  ===========  =======

because a JPL quaternion with components p rotates vectors as the Hamilton quaternion p* does. The
order of the four numbers is a separate matter: :mod:`quatprop.kinematics.conventions`; so are other
representations of a rotation: :mod:`quatprop.kinematics.conventions`.

References
----------
Breckenridge, "Quaternions - Proposed Standard Conventions", JPL interoffice memorandum
343-79-1199, 1979. Solà, "Quaternion kinematics for the error-state Kalman filter",
arXiv:1711.02508, 2017.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import listed, quoted
from quatprop.kinematics.quaternion import (
    UNIT_TOLERANCE,
    conjugate,
    exp,
    from_matrix,
    log,
    multiply,
    nearest_rotations,
    normalize,
    rotation_matrix,
)
from quatprop.settings.quantities import CONVENTIONS, DIRECTIONS, EULER_SEQUENCES, LAYOUTS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from quatprop.base.arrays import Float64


@dataclass(frozen=True, slots=True)
class AttitudeConvention:
    """The convention and the direction of a quaternion, independent of its layout.

    `convention`: ``"hamilton"`` or ``"jpl"``
    `direction`: ``"body-to-ref"`` or ``"ref-to-body"``: that of the coordinate transformation
    """

    convention: str = "hamilton"
    direction: str = "body-to-ref"

    def __post_init__(self) -> None:
        for what, name, known in (("convention", self.convention, CONVENTIONS),
                                  ("direction", self.direction, DIRECTIONS)):  # fmt: skip
            if name not in known:
                raise UsageError(f"no {what} {quoted(name)}; choose one of {listed(known)}")

    @property
    def is_conjugate(self) -> bool:
        """Whether the numbers are q*, with q the attitude in Hamilton, body to reference."""
        return (self.convention == "jpl") != (self.direction == "ref-to-body")

    @property
    def description(self) -> str:
        """The formula that rotates a vector by the numbers q, in one line."""
        source, target = ("body", "ref") if self.direction == "body-to-ref" else ("ref", "body")
        if self.convention == "jpl":
            return f"JPL, ij = -k: v_{target} = q v_{source} q* in its product"
        return f"Hamilton, ij = k: v_{target} = q v_{source} q*"

    def converted(self, wxyz: Float64) -> Float64:
        """Convert attitudes to this convention, or numbers in this convention to attitudes.

        Conjugation is its own inverse and exact, so both directions are the same function.

        `wxyz`: quaternions, shape ``(..., 4)``, scalar first
        `Returns`: shape ``(..., 4)``
        """
        return conjugate(wxyz) if self.is_conjugate else wxyz


HAMILTON = AttitudeConvention()
"""The convention of attitudes inside quatprop."""


class Signs:
    """Chooses between q and -q, which are the same attitude, along a series.

    `sign`: ``"keep"``: no change; ``"positive"``: the first component that is not zero is positive,
        so w >= 0; ``"continuous"``: a non-negative dot product with the previous quaternion; the
        first is not changed
    """

    def __init__(self, sign: str) -> None:
        self._sign = sign
        self._last: Float64 | None = None
        self._flip = 1.0

    def applied(self, wxyz: Float64) -> Float64:
        """Return the next batch of the series with its signs chosen, shape ``(N, 4)``."""
        if self._sign == "keep" or not len(wxyz):
            return wxyz
        if self._sign == "positive":
            return _positive(wxyz)
        before = wxyz[:1] if self._last is None else self._last
        dots = np.einsum("ij,ij->i", np.concatenate([before, wxyz[:-1]]), wxyz)
        flips = self._flip * np.cumprod(np.where(dots < 0, -1.0, 1.0))
        self._last, self._flip = wxyz[-1:].copy(), float(flips[-1])
        signed: Float64 = wxyz * flips[:, None]
        return signed


def _positive(wxyz: Float64) -> Float64:
    """Return q or -q, such that the first component that is not zero is positive."""
    signed: Float64 = np.where(wxyz[:, :1] < 0, -wxyz, wxyz)
    (half_turns,) = np.nonzero(signed[:, 0] == 0)
    if len(half_turns):
        rows = signed[half_turns]
        first = np.argmax(rows != 0, axis=1)[:, None]
        negative = np.take_along_axis(rows, first, axis=1) < 0
        # Adding zero removes the sign of -0.0.
        signed[half_turns] = np.where(negative, -rows, rows) + 0.0
    return signed


# The storage order of quaternion components, independent of their convention.
#
# Inside quatprop there is one layout, ``wxyz``. Others exist only in the columns of files. A layout
# is an order of the same four numbers, never another rotation: conjugates and the JPL convention
# are not layouts.


class Layout(NamedTuple):
    """An order of the four components.

    `name`: ``"scalar-first"`` or ``"scalar-last"``, as in the provenance
    `order`: for each stored column, the index of its component in ``wxyz``
    """

    name: str
    order: tuple[int, int, int, int]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the stored columns, in order."""
        return tuple(("qw", "qx", "qy", "qz")[component] for component in self.order)


SCALAR_FIRST = Layout("scalar-first", (0, 1, 2, 3))
SCALAR_LAST = Layout("scalar-last", (1, 2, 3, 0))

_NAMED = dict(zip(LAYOUTS, (SCALAR_FIRST, SCALAR_LAST) * 2, strict=True))


def layout_named(name: str) -> Layout:
    """Return the layout of a name."""
    if name not in LAYOUTS:
        raise UsageError(f"no layout {quoted(name)}; choose one of {listed(LAYOUTS)}")
    return _NAMED[name]


# Representations of a rotation other than a quaternion, and their inverses.
#
# Rotation vectors, Euler angles of every sequence, and matrices: each a set of columns whose names
# state their content and unit.


QUATERNION = "quaternion"
"""The representation that is not converted."""

NEAR_LOCK_DEG = 0.01
"""deg: within this angle of gimbal lock the first and third angle are hardly distinguishable."""

_ROUNDING = 1e-12
_SKEWED = 0.5
"""A matrix is not a rotation if an element of R'R - 1 is larger than this."""


def euler_angles(sequence: str, wxyz: Float64) -> Float64:
    """Return the angles of intrinsic rotations about three axes.

    For the sequence ``"xyz"`` q = q_x(first) q_y(second) q_z(third): about x, then about the new
    y, then about the newest z; scipy writes ``"XYZ"``. Extrinsic rotations, about fixed axes, have
    the same angles in reversed order. The half sum and the half difference of the first and the
    third angle are computed. In gimbal lock one of them is still exact; the other is undetermined,
    and is a result of rounding, or zero.

    `wxyz`: quaternions, shape ``(N, 4)``, of any length
    `Returns`: shape ``(N, 3)``, rad: the first and the third from -pi to pi. The second is from
        -pi/2 to pi/2 if all axes differ (Tait-Bryan angles), from 0 to pi if the first axis is the
        third (proper Euler angles)

    References
    ----------
    Bernardes and Viollet, "Quaternion to Euler angles conversion: A direct, general and
    computationally efficient method", PLoS ONE 17(11), 2022.
    """
    i, j, k = ("wxyz".index(axis) for axis in sequence)
    is_proper, other = i == k, 6 - i - j
    sign = (i - j) * (j - other) * (other - i) / 2
    w, first, second, third = wxyz[:, 0], wxyz[:, i], wxyz[:, j], wxyz[:, other]
    # Sine and cosine of the half sum and of the half difference, each pair times a factor. Adding
    # zero removes the sign of -0.0, which would change an angle of 0 to pi.
    if is_proper:
        half_sum, half_difference = (first, w), (sign * third, second)
    else:
        half_sum = (first + third, w + sign * second)
        half_difference = (first - third, w - sign * second)
    (plus, minus), (larger, smaller) = (
        [function(sine, cosine + 0.0) for sine, cosine in (half_sum, half_difference)]
        for function in (np.arctan2, np.hypot)
    )
    if is_proper or sign < 0:
        larger, smaller = smaller, larger
    middle = 2 * np.arctan2(larger, smaller) - (0.0 if is_proper else np.pi / 2)
    return np.stack(
        [_within_half_turn(plus + minus), middle, _within_half_turn(plus - minus)], axis=1
    )


def _within_half_turn(angle: Float64) -> Float64:
    wrapped: Float64 = angle - 2 * np.pi * np.rint(angle / (2 * np.pi))
    return wrapped


def from_euler(sequence: str, angles: Float64) -> Float64:
    """Return the quaternions of angles of any size: the inverse of :func:`euler_angles`.

    `angles`: in the order of the sequence, shape ``(N, 3)``, rad
    `Returns`: unit quaternions, shape ``(N, 4)``
    """
    steps = np.zeros((3, len(angles), 4))
    steps[:, :, 0] = np.cos(angles.T / 2)
    for step, axis, angle in zip(steps, sequence, angles.T, strict=True):
        step[:, "wxyz".index(axis)] = np.sin(angle / 2)
    return multiply(multiply(steps[0], steps[1]), steps[2])


def from_matrices(rows: Float64) -> Float64:
    """Return the quaternions of the rotations that are nearest to matrices, with w >= 0.

    Where R'R differs from 1 by more than the tolerance of a length, the length differs as much;
    reflections and matrices far from rotations give NaN.

    `rows`: matrices row by row, shape ``(N, 9)``
    `Returns`: shape ``(N, 4)``; of unit length if the matrix is a rotation, but for its noise
    """
    r = rows.reshape(-1, 3, 3)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(r.transpose(0, 2, 1) @ r - np.eye(3)).max(axis=(1, 2), initial=0.0)
        valid = (off <= _SKEWED) & (np.linalg.det(r) > 0)
    attitudes = np.full((len(r), 4), np.nan)
    attitudes[valid] = from_matrix(r[valid])
    noisy = valid & (off > _ROUNDING)
    attitudes[noisy] = nearest_rotations(r[noisy])
    attitudes *= 1 + np.where(off > UNIT_TOLERANCE, off, 0.0)[:, None]
    return attitudes


class Representation(NamedTuple):
    """A representation of a rotation other than a quaternion.

    `columns`: names of the columns, which state their content and unit
    `values`: converts unit quaternions, shape ``(N, 4)``, to the columns, shape ``(N, k)``
    `attitudes`: converts the columns to quaternions, of unit length if they are a rotation
    `signed`: whether q and -q have different values
    `lock_deg`: second angles, deg, at which the first and the third cannot be distinguished
    """

    columns: tuple[str, ...]
    values: Callable[[Float64], Float64]
    attitudes: Callable[[Float64], Float64]
    signed: bool = False
    lock_deg: tuple[int, ...] = ()

    def locked(self, values: Float64) -> int:
        """Return the number of rows of columns, shape ``(N, k)``, whose angles are not unique."""
        if not self.lock_deg:
            return 0
        second = values[:, 1] if self.columns[1].endswith("_deg") else np.degrees(values[:, 1])
        distance = np.abs(second[:, None] - self.lock_deg).min(axis=1, initial=np.inf)
        return int(np.count_nonzero(distance < NEAR_LOCK_DEG))


def _euler(sequence: str, unit: str) -> Representation:
    """Return the representation by angles of a sequence in a unit."""
    numbered = [f"euler_{sequence}_{place}" for place in (1, 2, 3)]
    names = ("yaw", "pitch", "roll") if sequence == "zyx" else numbered

    def values(wxyz: Float64) -> Float64:
        angles = euler_angles(sequence, wxyz)
        return np.degrees(angles) if unit == "deg" else angles

    def attitudes(angles: Float64) -> Float64:
        return from_euler(sequence, np.radians(angles) if unit == "deg" else angles)

    lock_deg = (0, 180) if sequence[0] == sequence[2] else (-90, 90)
    columns = tuple(f"{name}_{unit}" for name in names)
    return Representation(columns, values, attitudes, lock_deg=lock_deg)


REPRESENTATIONS: Mapping[str, Representation] = {
    "rotvec": Representation(
        ("rotvec_x_rad", "rotvec_y_rad", "rotvec_z_rad"),
        lambda wxyz: log(normalize(wxyz)),
        exp,
        signed=True,
    ),
    **{f"euler-{sequence}": _euler(sequence, "rad") for sequence in EULER_SEQUENCES},
    **{f"euler-{sequence}-deg": _euler(sequence, "deg") for sequence in EULER_SEQUENCES},
    "matrix": Representation(
        tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)),
        lambda wxyz: rotation_matrix(normalize(wxyz)).reshape(-1, 9),
        from_matrices,
    ),
}
"""All representations besides quaternions; matrices are stored row by row."""


# Mounting of the sensor: rotations from sensor to body axes.


AXES = {"x": 0, "y": 1, "z": 2}

_TURN = re.compile(r"(?P<axis>[xyz]):(?P<deg>[^,]+?)(deg)?")
"""A rotation about one axis."""


class FrameMounting(NamedTuple):
    """A mounting from the static transforms of a log.

    `matrix`: sensor axes to body axes, shape ``(3, 3)``
    `frames`: frames of the chain from the sensor's to the body's
    """

    matrix: Float64
    frames: tuple[str, ...]


NAMED = {
    "ned-to-enu": "y,x,-z",
    "enu-to-ned": "y,x,-z",
    "frd-to-flu": "x,-y,-z",
    "flu-to-frd": "x,-y,-z",
}
"""Name -> the old axes that become x, y and z."""


def signed_axes(text: str) -> Float64:
    """Return the matrix of axes such as ``"-z,y,x"``: the old ones that become x, y and z."""
    if (axes := _axes_of(text.split(","))) is None:
        raise UsageError(f"{quoted(text)} is not three signed axes; write them as x,-y,z")
    return axes


def _axes_of(parts: Sequence[str]) -> Float64 | None:
    """Return the matrix of three signed axes, ``(3, 3)``; None if they are anything else."""
    names = [part.strip() for part in parts]
    if sorted(name.lstrip("+-") for name in names) != [*AXES]:
        return None
    axes = np.zeros((3, 3))
    for row, name in zip(axes, names, strict=True):
        row[AXES[name[-1]]] = -1.0 if name.startswith("-") else 1.0
    return axes


def mounting(text: str, what: str = "mounting") -> Float64:
    """Return the rotation matrix from sensor to body axes, or from other old to new axes.

    `text`: three signed old axes that become the new x, y and z, such as ``"x,-y,-z"``; a unit
        quaternion ``"W,X,Y,Z"`` with v_body = m v_sensor m*; fixed-axis angles ``"rpy:R,P,Y"``,
        deg, Rz(Y) Ry(P) Rx(R), as in URDF, or ``"y:30deg"`` about one axis; a key of :data:`NAMED`
    `what`: name of the rotation in errors
    `Returns`: rotation matrix, shape ``(3, 3)``: rate_body = M rate_sensor
    """
    old_to_new = {"mounting": "sensor axes to body axes"}.get(what, "old axes to new ones")
    word = text.strip().lower()
    if turn := _TURN.fullmatch(word):
        word = "rpy:" + ",".join(turn["deg"] if axis == turn["axis"] else "0" for axis in AXES)
    parts = NAMED.get(word, word.removeprefix("rpy:")).split(",")
    is_angles = word.startswith("rpy:")
    if not is_angles and (axes := _axes_of(parts)) is not None:
        if np.linalg.det(axes) < 0:
            raise UsageError(
                f"the {what} {quoted(text)} is left-handed, so it is not a rotation; "
                "change one sign or swap two axes"
            )
        return axes
    numbers = np.zeros(0)
    with suppress(ValueError):
        numbers = np.array([float(part) for part in parts])
    if np.isfinite(numbers).all():
        if is_angles and numbers.shape == (3,):
            roll, pitch, yaw = exp(np.diag(np.radians(numbers)))
            return rotation_matrix(multiply(yaw, multiply(pitch, roll)))
        if numbers.shape in {(4,), (9,)} and numbers.any() and not is_angles:
            return _matrix(numbers, text, what)
    raise UsageError(
        f"{quoted(text)} is not a {what}; write three signed axes such as x,-y,-z, a quaternion "
        f"W,X,Y,Z that takes {old_to_new}, fixed-axis angles in deg such as rpy:0,30,0 "
        f"or y:30deg, "
        f"{', '.join(NAMED)}{', or tf:FRAME' if what == 'mounting' else ''}"
    )


def _matrix(numbers: Float64, text: str, what: str) -> Float64:
    """Return the rotation matrix of a quaternion, or of nine numbers."""
    wxyz = numbers
    if len(numbers) > len("wxyz"):
        wxyz = normalize(from_matrices(numbers)[0])
        if not np.abs(rotation_matrix(wxyz) - numbers.reshape(3, 3)).max() <= UNIT_TOLERANCE:
            raise UsageError(f"the {what} {quoted(text)} is not a rotation matrix")
    length = float(np.linalg.norm(wxyz))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise UsageError(
            f"the {what} {quoted(text)} has the length {length:.6g}, so it is not a rotation; "
            "scale it to 1"
        )
    return rotation_matrix(normalize(wxyz))
