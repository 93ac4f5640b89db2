"""Accuracy of integrators on sampled rates: a precessing rotor, whose attitude is known exactly."""

import time
from pathlib import Path

import numpy as np
from ahrs.filters import AngularRate
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, multiply, rotate

RATES_HZ = (50, 100, 200, 400)
SECONDS = 20
SPIN, PRECESSION, TILT = 4.1, 1.22, 1.2
"""rad/s, rad/s, rad."""
Z_AXIS = np.array([0.0, 0.0, 1.0])


def rotor(t_ns):
    """Return the true attitudes and body rates, exact to rounding."""
    t_s = t_ns[:, None] / 1e9
    tilt = exp([TILT, 0, 0])
    wxyz = multiply(multiply(exp(PRECESSION * t_s * Z_AXIS), tilt), exp(SPIN * t_s * Z_AXIS))
    return wxyz, SPIN * Z_AXIS + rotate(conjugate(wxyz), PRECESSION * Z_AXIS)


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
    """Interpolate the rates by a spline and integrate that, as the package quaternion does."""
    t_s = t_ns / 1e9
    rates = CubicSpline(t_s, rate)

    def derivative(t, q):
        return multiply(q, [0, *rates(t) / 2])

    solution = solve_ivp(derivative, (t_s[0], t_s[-1]), q0, "DOP853", t_s, rtol=1e-12, atol=1e-12)
    return solution.y.T


INTEGRATORS = {
    **{
        f"quatprop {method}": lambda t, w, q0, method=method: attitudes(t, w, q0=q0, method=method)
        for method in ("start", "mean", "coning", "cubic", "quintic")
    },
    "scipy Rotation, start": lambda t, w, q0: scipy_loop(t, w, q0, "start"),
    "scipy Rotation, mean": lambda t, w, q0: scipy_loop(t, w, q0, "mean"),
    "ahrs AngularRate": ahrs_closed,
    "spline, then DOP853": spline,
}


def measure(_folder: Path, _samples: int) -> None:
    """Print the worst error over the motion at each sample rate, and the time."""
    print(f"\nworst error over {SECONDS} s of a precessing rotor, rad, sampled at")
    print(f"{'':24}" + "".join(f"{f'{hz} Hz':>12}" for hz in RATES_HZ) + f"{'us/sample':>12}")
    for name, integrate in INTEGRATORS.items():
        errors = []
        for hz in RATES_HZ:
            t_ns = np.arange(SECONDS * hz + 1) * (1_000_000_000 // hz)
            truth, rate = rotor(t_ns)
            began = time.perf_counter()
            wxyz = integrate(t_ns, rate, truth[0])
            elapsed = time.perf_counter() - began
            errors.append(geodesic_angle(wxyz, truth).max())
        cells = "".join(f"{error:12.1e}" for error in errors)
        print(f"{name:24}{cells}{1e6 * elapsed / len(t_ns):12.2f}")
