"""Which misreadings of a quaternion a gyroscope can tell apart, by enumeration."""

from itertools import permutations, product

import numpy as np
import pytest

from quatprop.kinematics.conventions import signed_axes
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.kinematics.quaternion import conjugate, exp, multiply
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS, axes_text
from quatprop.tools.crosscheck.classes import READINGS, nearest_axes

RANDOM = np.random.default_rng(2)
TRUE = np.cumsum(RANDOM.normal(size=(40, 3)) * 0.1, axis=0)
TRUE = multiply(exp(TRUE), exp(np.array([0.3, -0.8, 1.1])))
RATES = {
    axes: rotation_vectors_between(TRUE, rates=name)
    for axes, name in (("body", "body"), ("reference", "inertial"))
}


def seen_as(wxyz):
    """Return the axes and the matrix with which body turns give the true ones in those axes."""
    turns = rotation_vectors_between(wxyz)
    for axes, true in RATES.items():
        matrix = np.linalg.lstsq(turns, true, rcond=None)[0].T
        if np.abs(turns @ matrix.T - true).max() < 1e-9:
            return axes, tuple(np.rint(matrix).astype(int).ravel())
    raise AssertionError


def test_signed_permutations_of_components_are_48_classes():
    """A gyroscope distinguishes 48 classes of 8 among the 384, and two without known axes."""
    classes = {}
    for order in permutations(range(4)):
        for signs in product((1.0, -1.0), repeat=4):
            wxyz = TRUE[:, order] * signs
            classes.setdefault(seen_as(wxyz), []).append((order, signs))
    assert len(classes) == 48
    assert {len(members) for members in classes.values()} == {8}
    assert {axes for axes, _ in classes} == {"body", "reference"}


@pytest.mark.parametrize("layout", READINGS)
def test_readings_give_the_true_rate(layout):
    """Each reading states the axes in which the true body rate is found, and its rotation."""
    roll = -1 if layout == "scalar-last" else 1
    for reading in READINGS[layout]:
        settings = dict(reading.settings)
        meant = conjugate(TRUE) if "from_direction" in settings else TRUE
        read = np.roll(meant, -roll, axis=1) if "from_layout" in settings else meant
        own = "body" if reading.axes == "body" else "inertial"
        turns = rotation_vectors_between(read, rates=own)
        assert np.allclose(turns @ reading.matrix.T, RATES["body"], atol=1e-12), reading.name


def test_axes_are_written_as_they_are_read():
    """The text of an exchange of axes is that of --mount."""
    for matrix in SIGNED_PERMUTATIONS:
        assert np.array_equal(signed_axes(axes_text(matrix)), matrix)


def test_one_axis_of_motion_does_not_show_an_exchange_of_the_others():
    """About one axis alone, the simplest explanation is that no axes are exchanged."""
    half_turn = np.diag([-1.0, -1.0, 1.0])
    about_z = np.diag([0.0, 0.0, 1.0])
    assert nearest_axes(half_turn, about_z, 0.0, either_hand=True).are_same
    assert not nearest_axes(half_turn, np.eye(3), 0.0, either_hand=False).are_same
