"""Motions with closed formulas for both attitude and body rate.

A motion is a function from elapsed time, ns, to body rate and attitude. Convention: ``wxyz`` is
body -> reference, so that ``q' = 1/2 q w_B`` (source article, equation 12); rates are resolved in
the body frame, in rad/s. The attitude at time zero is the identity: the reference frame is the
body frame at the first sample.

No code is shared with the propagation, which these motions test.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UsageError
from quatprop.simulation import phase
from quatprop.text import listed, quoted
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from quatprop.arrays import AnyArray, Float64, Int64

    # Rate, shape (N, 3), rad/s, and wxyz, (N, 4), at increasing times since the first sample.
    Motion = Callable[[Int64], tuple[Float64, Float64]]


@dataclass(frozen=True, slots=True)
class Shape:
    """The parameters of the motions; each uses its own.

    `frequency`: revolutions per second, Hz: of the spin, of the coning, of the precession of a
        tumbling body
    `axis`: axis of the spin in the body, of any length but zero
    `angle`: degrees: half-angle of the cone, or nutation angle of a tumbling body
    `spin_frequency`: revolutions per second of a tumbling body about its own axis
    `walk`: strength of the random walk of the rate, rad/s/sqrt(s)
    """

    frequency: Fraction = Fraction(1, 2)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    angle: Fraction = Fraction(10)
    spin_frequency: Fraction = Fraction(1, 5)
    walk: float = 0.1
    seed: int = 0


def motion_named(name: str, shape: Shape) -> Motion:
    """Return a motion by name."""
    if name not in MOTIONS:
        raise UsageError(f"no motion {quoted(name)}; choose one of {listed(MOTIONS)}")
    return MOTIONS[name](shape)


def spin(axis: tuple[float, float, float], frequency: Fraction) -> Motion:
    """Return a constant rate about a body axis: ``q = cos(w t / 2) + u sin(w t / 2)``.

    References
    ----------
    Source article, equations 32 and 37.
    """
    length = math.sqrt(math.fsum(part * part for part in axis))
    if not (0.0 < length < math.inf):
        raise UsageError("the axis of a spin needs a direction; give three numbers, not all zero")
    unit = np.array(axis) / length
    rate = 2 * math.pi * float(frequency) * unit

    def motion(elapsed_ns: Int64) -> tuple[Float64, Float64]:
        cosine, sine = phase.of_time(elapsed_ns, frequency / 2)
        parts = (cosine, *(part * sine for part in unit))
        return np.tile(rate, (len(elapsed_ns), 1)), np.stack(parts, axis=1)

    return motion


def precession(angle: Fraction, frequency: Fraction, spin_frequency: Fraction) -> Motion:
    """Return a regular precession: ``q = Rz(f) Rx(n) Rz(s)``, f and s linear in time.

    The body's z axis is at the angle n to a fixed axis and rotates about it at ``f' = 2 pi
    frequency``; the body rotates about its z axis at ``s' = 2 pi spin_frequency``. The Euler angles
    3-1-3 give, with c and s_n cosine and sine of n/2::

        q = [c cos((f+s)/2), s_n cos((f-s)/2), s_n sin((f-s)/2), c sin((f+s)/2)]
        w_B = [f' sin(n) sin(s), f' sin(n) cos(s), f' cos(n) + s']

    Two textbook motions are special cases. A free symmetric body tumbles like this if the ratio of
    its transverse and axial moments of inertia is ``A / C = 1 + s' / (f' cos n)``. With
    ``s' = -f'`` it is classical coning: the body axis describes a cone of half-angle n while the
    body does not rotate about it, and gyroscopes measure the z rate ``-f' (1 - cos n)``.

    References
    ----------
    Goldstein, Poole, Safko, Classical Mechanics, 3rd ed., sections 4.9 (rates of the Euler angles)
    and 5.6 (free symmetric body). Bortz, A New Mathematical Formulation for Strapdown Inertial
    Navigation, IEEE Trans. AES-7, 1971 (coning).
    """
    half_cosine, half_sine = phase.of_degrees(angle / 2)
    full_cosine, full_sine = phase.of_degrees(angle)
    precessing = 2 * math.pi * float(frequency)
    axial = precessing * full_cosine + 2 * math.pi * float(spin_frequency)
    transverse = precessing * full_sine
    # The formula begins at Rx(n): its conjugate on the left makes it begin at the identity.
    begin = np.array([half_cosine, -half_sine, 0.0, 0.0])

    def motion(elapsed_ns: Int64) -> tuple[Float64, Float64]:
        sum_cosine, sum_sine = phase.of_time(elapsed_ns, (frequency + spin_frequency) / 2)
        gap_cosine, gap_sine = phase.of_time(elapsed_ns, (frequency - spin_frequency) / 2)
        spin_cosine, spin_sine = phase.of_time(elapsed_ns, spin_frequency)
        wxyz = np.stack(
            (
                half_cosine * sum_cosine,
                half_sine * gap_cosine,
                half_sine * gap_sine,
                half_cosine * sum_sine,
            ),
            axis=1,
        )
        rate = np.stack(
            (transverse * spin_sine, transverse * spin_cosine, np.full(len(wxyz), axial)), axis=1
        )
        return rate, hamilton(begin, wxyz)

    return motion


def random_walk(walk: float, seed: int) -> Motion:
    """Return a rate that is a random walk, constant from each sample to the next.

    The attitude is the product of the exact steps (source article, equation 36), in extended
    precision if the machine has it.

    `walk`: strength, rad/s/sqrt(s): the rate's standard deviation after one second, on each axis
    """
    # A different sequence from that of the gyroscope's noise with the same seed.
    random = np.random.default_rng((seed, 1))
    last = np.int64(0), np.zeros(3), np.array([1, 0, 0, 0], np.longdouble)

    def motion(elapsed_ns: Int64) -> tuple[Float64, Float64]:
        nonlocal last
        last_ns, last_rate, last_wxyz = last
        dt = np.diff(elapsed_ns, prepend=last_ns) / NS_PER_S
        increments = random.standard_normal((len(dt), 3)) * (walk * np.sqrt(dt))[:, None]
        rate = np.cumsum(np.vstack((last_rate, increments)), axis=0)
        steps = step(rate[:-1].astype(np.longdouble) * dt[:, None])
        steps[0] = hamilton(last_wxyz, steps[0])
        wxyz = running_product(steps)
        last = elapsed_ns[-1], rate[-1], wxyz[-1]
        return rate[1:], wxyz.astype(np.float64)

    return motion


MOTIONS: Mapping[str, Callable[[Shape], Motion]] = {
    "rest": lambda _shape: spin((0.0, 0.0, 1.0), Fraction(0)),
    "spin": lambda shape: spin(shape.axis, shape.frequency),
    "coning": lambda shape: precession(shape.angle, shape.frequency, -shape.frequency),
    "tumbling": lambda shape: precession(shape.angle, shape.frequency, shape.spin_frequency),
    "random-walk": lambda shape: random_walk(shape.walk, shape.seed),
}
"""All motions by name."""


def hamilton(left: AnyArray, right: AnyArray) -> AnyArray:
    """Return ``left right``, wxyz, ij = k; shapes ``(..., 4)`` broadcast.

    Written out, since sums of linear algebra libraries are rounded differently by processor.
    """
    a, b, c, d = np.moveaxis(left, -1, 0)
    w, x, y, z = np.moveaxis(right, -1, 0)
    return np.stack(
        (
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ),
        axis=-1,
    )


def step(rotvec: AnyArray) -> AnyArray:
    """Return the unit quaternions of rotation vectors, rad: source article, equation 35.

    `rotvec`: shape ``(N, 3)``
    """
    half = np.sqrt(np.sum(rotvec * rotvec, axis=-1, keepdims=True)) / 2
    with np.errstate(invalid="ignore"):
        factor = np.where(half > 0, np.sin(half) / (2 * half), 0.5)
    return np.concatenate((np.cos(half), factor * rotvec), axis=-1)


def running_product(steps: AnyArray) -> AnyArray:
    """Return ``steps[0] steps[1] ... steps[k]`` for every k, by doubling.

    `steps`: unit quaternions, shape ``(N, 4)``
    """
    product, reach = steps, 1
    while reach < len(steps):
        product = np.concatenate((product[:reach], hamilton(product[:-reach], product[reach:])))
        reach *= 2
    length = np.sqrt(np.sum(product * product, axis=-1, keepdims=True))
    result: AnyArray = product / length
    return result
