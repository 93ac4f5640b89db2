"""A precessing rotor, of which attitudes and rates are known in closed form."""

import numpy as np

from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotate

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
