"""A precessing rotor, of which attitudes and rates are known in closed form."""

import numpy as np

from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotate

SECOND = 1_000_000_000


IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


Z_AXIS = np.array([0.0, 0.0, 1.0])


def rotor(t_s):
    """Return true attitudes and body rates of a precessing rotor."""
    spin, precession, tilt = 4.1, 1.22, exp([1.2, 0, 0])
    t_s = t_s[:, None]
    wxyz = multiply(multiply(exp(precession * t_s * Z_AXIS), tilt), exp(spin * t_s * Z_AXIS))
    return wxyz, spin * Z_AXIS + rotate(conjugate(wxyz), precession * Z_AXIS)


def stamps(hz, seconds, jitter=0.0):
    """Return the stamps of so many seconds, each off by up to a share of half an interval."""
    t_ns = np.arange(seconds * hz + 1) * (SECOND // hz)
    off = np.random.default_rng(1).uniform(-jitter, jitter, len(t_ns)) * SECOND / hz / 2
    off[[0, -1]] = 0
    return t_ns + off.astype(np.int64)


def orders(errors):
    """Return the order of convergence from each error to that at twice the rate."""
    return np.log2(np.array(errors)[:-1] / errors[1:])
