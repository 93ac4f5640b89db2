"""Motions of which attitudes and rates are known: a precessing rotor, and those to be simulated."""

from fractions import Fraction

import numpy as np

from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotate
from quatprop.kinematics.series import GyroSeries
from quatprop.tools.simulation import Shape, motion_named

SECOND = 1_000_000_000
RATES_HZ = (50, 100, 200, 400)
Z_AXIS = np.array([0.0, 0.0, 1.0])


def rotor(t_s, rates="body", spin=4.1, precession=1.22, tilt=1.2):
    """Return true attitudes and rates of a rotor whose axis precesses about the reference's z."""
    t_s = t_s[:, None]
    turned, spun = exp(precession * t_s * Z_AXIS), exp(spin * t_s * Z_AXIS)
    wxyz = multiply(multiply(turned, exp([tilt, 0, 0])), spun)
    rate = spin * Z_AXIS + rotate(conjugate(wxyz), precession * Z_AXIS)
    return wxyz, rate if rates == "body" else rotate(wxyz, rate)


def stamps(hz, seconds, jitter=0.0):
    """Return the stamps of so many seconds, each off by up to a share of half an interval."""
    t_ns = np.arange(seconds * hz + 1) * (SECOND // hz)
    off = np.random.default_rng(1).uniform(-jitter, jitter, len(t_ns)) * SECOND / hz / 2
    off[[0, -1]] = 0
    return t_ns + off.astype(np.int64)


def orders(errors):
    """Return the order of convergence from each error to that at twice the rate."""
    return np.log2(np.array(errors)[:-1] / errors[1:])


FRAMES = ("body", "inertial")


def simulated(motion, frame, count, interval_ns):
    """Return stamps and the rates of a motion, resolved in body axes or in reference axes."""
    t_ns = np.arange(count) * interval_ns
    shape = Shape(Fraction(1, 4), axis=(1.0, 2.0, 3.0), angle=Fraction(40), walk=1.0)
    rate, wxyz = motion_named(motion, shape)(t_ns)
    return t_ns, rate if frame == "body" else rotate(wxyz, rate)


def rotor_samples(kind, t_ns):
    """Return what a gyroscope on the rotor gives: rates in a frame, or averages or increments.

    Those are exact: differences of the integral of the body rate. The first is about time before
    the log; whatever it is, no result may depend on it.
    """
    if kind in FRAMES:
        return GyroSeries(t_ns, rotor(t_ns / 1e9, kind)[1])
    rate = np.diff(_rotor_integral(t_ns / 1e9), axis=0) / (np.diff(t_ns) / 1e9)[:, None]
    rate = np.vstack([[9.0, -9.0, 9.0], rate])
    spans = np.diff(t_ns, prepend=2 * t_ns[0] - t_ns[1]) if kind == "increments" else None
    return GyroSeries(t_ns, rate, spans, kind == "averages")


def _rotor_integral(t_s, spin=4.1, precession=1.22, tilt=1.2):
    across = precession * np.sin(tilt) / spin
    along = spin + precession * np.cos(tilt)
    return np.stack([-across * np.cos(spin * t_s), across * np.sin(spin * t_s), along * t_s], 1)


def waves(random, t_s, low, high, rms):
    """Return a sum of waves of some frequencies, Hz, shape ``(N, 3)``."""
    total = np.zeros((len(t_s), 3))
    for frequency in np.exp(random.uniform(np.log(low), np.log(high), 6)):
        phase = 2 * np.pi * frequency * t_s[:, None] + random.uniform(0, 6.3, 3)
        total += random.normal(size=3) * np.sin(phase)
    return rms * total / total.std(axis=0)
