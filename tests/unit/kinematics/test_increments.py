"""Rates and times to rotation vectors."""

import numpy as np
import pytest

from quatprop.kinematics.increments import rotation_vectors
from quatprop.settings.quantities import METHODS

T_NS = np.array([0, 500_000_000, 750_000_000])
RATE = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]])


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        # The default: sample k rules the interval that begins at it.
        ((), [[0.5, 0, 0], [0, 0.5, 0]]),
        (("start",), [[0.5, 0, 0], [0, 0.5, 0]]),
        (("end",), [[0, 1.0, 0], [0, 0, 1.0]]),
        (("mean",), [[0.25, 0.5, 0], [0, 0.25, 0.5]]),
        # The cross products are (0, 0, 2) over 1/2 s and (8, 0, 0) over 1/4 s.
        (("coning",), [[0.25, 0.5, 2 / 48], [8 / 192, 0.25, 0.5]]),
    ],
)
def test_each_method_by_hand(method, expected):
    """Every method gives the rotation vectors that its formula gives on paper."""
    assert np.allclose(rotation_vectors(T_NS, RATE, *method), expected, rtol=1e-15, atol=0)


@pytest.mark.parametrize("method", METHODS)
def test_what_every_method_keeps(method):
    """A constant rate turns by rate times interval; without an interval there is no rotation."""
    rate = np.tile([0.3, -0.2, 0.1], (3, 1))
    expected = rate[1:] * [[0.5], [0.25]]
    assert np.allclose(rotation_vectors(T_NS, rate, method), expected, rtol=4e-16, atol=0)
    for count in (0, 1):
        assert rotation_vectors(T_NS[:count], RATE[:count], method).shape == (0, 3)
    assert not rotation_vectors(np.array([7, 7]), RATE[:2], method).any()
    # Stamps of today in ns, too large for float64, give the same vectors to the bit.
    t_ns = T_NS + np.array([0, 1, 3])
    today = rotation_vectors(t_ns + 1_700_000_000_000_000_001, RATE, method)
    assert np.array_equal(today, rotation_vectors(t_ns, RATE, method))


def test_intervals_are_rounded_once():
    """An interval in seconds is the float64 nearest to its nanoseconds."""
    assert rotation_vectors(np.array([0, 9_999_999_999]), np.ones((2, 3)))[0, 0] == 9.999999999
