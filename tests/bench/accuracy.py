"""Accuracy of integrators on sampled rates of motions whose attitudes are known."""

import math
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import quaternion
from ahrs.filters import AngularRate
from make.motion import rotor
from scipy.spatial.transform import Rotation

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, geodesic_angle
from quatprop.tools.simulation import Shape, motion_named

SECONDS = 20
FINER = 20
"""Samples of the true motion for each of the rates: its error is 20^6 times smaller."""


def scipy_loop(t_ns, rate, q0, rule):
    """Multiply step by step with scipy's Rotation."""
    steps = np.diff(t_ns)[:, None] / 1e9
    means = {"start": rate[:-1], "mean": (rate[:-1] + rate[1:]) / 2}[rule]
    attitude = Rotation.from_quat(q0, scalar_first=True)
    out = [attitude]
    for step in Rotation.from_rotvec(means * steps):
        attitude = attitude * step
        out.append(attitude)
    return Rotation.concatenate(out).as_quat(scalar_first=True)


def ahrs_closed(t_ns, rate, q0):
    """Return what the package ahrs gives: the closed form of the rate at each interval's end."""
    frequency = 1e9 / (t_ns[1] - t_ns[0])
    return AngularRate(gyr=rate, q0=q0, frequency=frequency, method="closed").Q


def spline(t_ns, rate, q0):
    """Return what the package quaternion gives: a spline of the rates, integrated numerically."""
    t_s = t_ns / 1e9
    # It takes rates in reference axes: those of the reference as seen from the body.
    start = quaternion.from_float_array(conjugate(q0))
    _, inverse = quaternion.integrate_angular_velocity((t_s, -rate), t_s[0], t_s[-1], start)
    return conjugate(quaternion.as_float_array(inverse))


def band(t_ns):
    """Return rates of 2 rad/s RMS about each axis, of 0.1 to 20 Hz, and true attitudes."""
    fine_ns = np.linspace(0, t_ns[-1], FINER * (len(t_ns) - 1) + 1).astype(np.int64)
    random = np.random.default_rng(2)
    frequency, phase = random.uniform(0.1, 20, 40), random.uniform(0, 2 * np.pi, (3, 40, 1))
    turns = 2 * np.pi * frequency[:, None] * (fine_ns / 1e9) + phase
    rate = 2 * math.sqrt(2 / 40) * np.cos(turns, out=turns).sum(axis=1).T
    wxyz = attitudes(fine_ns, rate, method="quintic")
    return rate[::FINER], wxyz[::FINER]


INTEGRATORS = {
    **{
        f"quatprop {method}": lambda t, w, q0, method=method: attitudes(t, w, q0=q0, method=method)
        for method in ("start", "mean", "coning", "cubic", "quintic")
    },
    "scipy Rotation, start": lambda t, w, q0: scipy_loop(t, w, q0, "start"),
    "scipy Rotation, mean": lambda t, w, q0: scipy_loop(t, w, q0, "mean"),
    "ahrs AngularRate": ahrs_closed,
    "numpy-quaternion, spline": spline,
}


COLUMNS = {
    **{f"rotor {hz} Hz": (lambda t_ns: rotor(t_ns / 1e9)[::-1], hz) for hz in (50, 100, 200, 400)},
    "tumbling 100": (motion_named("tumbling", Shape()), 100),
    "coning 200": (motion_named("coning", Shape(Fraction(2))), 200),
    "band 200": (band, 200),
}
"""The true motion and how often it is sampled, Hz: coning at 2 Hz, and a band up to 20 Hz."""


def measure(_folder: Path, _samples: int) -> None:
    """Print the worst error over each motion, and the time of all."""
    print(f"\nworst error over {SECONDS} s, rad, and CPU time")
    print(f"{'':24}" + "".join(f"{name:>13}" for name in COLUMNS) + f"{'us/sample':>12}")
    sampled = []
    for motion, hz in COLUMNS.values():
        t_ns = np.arange(SECONDS * hz + 1) * (1_000_000_000 // hz)
        sampled.append((t_ns, *motion(t_ns)))
    for name, integrate in INTEGRATORS.items():
        began = time.process_time()
        found = [integrate(t_ns, rate, truth[0]) for t_ns, rate, truth in sampled]
        elapsed = time.process_time() - began
        samples = sum(len(t_ns) for t_ns, _, _ in sampled)
        errors = (geodesic_angle(a, b[2]).max() for a, b in zip(found, sampled, strict=True))
        cells = "".join(f"{error:13.1e}" for error in errors)
        print(f"{name:24}{cells}{1e6 * elapsed / samples:12.2f}")
