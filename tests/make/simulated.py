"""Rates of simulated motions, resolved in either frame."""

from fractions import Fraction

import numpy as np

from quatprop.kinematics.quaternion import rotate
from quatprop.simulate.motion import Shape, motion_named

SHAPE = Shape(Fraction(1, 4), axis=(1.0, 2.0, 3.0), angle=Fraction(40), walk=1.0)


FRAMES = ("body", "inertial")


def simulated(motion, frame, count, interval_ns):
    """Return stamps and the rates of a motion, resolved in body axes or in reference axes."""
    t_ns = np.arange(count) * interval_ns
    rate, wxyz = motion_named(motion, SHAPE)(t_ns)
    return t_ns, rate if frame == "body" else rotate(wxyz, rate)
