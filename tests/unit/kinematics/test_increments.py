"""Rates and times to rotation vectors."""

import numpy as np
import pytest

from quatprop.errors import UsageError
from quatprop.kinematics.increments import rotation_vectors
from quatprop.settings import METHODS

T_NS = np.array([0, 500_000_000, 750_000_000])
RATE = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]])


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("start", [[0.5, 0, 0], [0, 0.5, 0]]),
        ("end", [[0, 1.0, 0], [0, 0, 1.0]]),
        ("mean", [[0.25, 0.5, 0], [0, 0.25, 0.5]]),
        # The cross products are (0, 0, 2) over 1/2 s and (8, 0, 0) over 1/4 s.
        ("coning", [[0.25, 0.5, 2 / 48], [8 / 192, 0.25, 0.5]]),
    ],
)
def test_each_method_by_hand(method, expected):
    """Every method gives the rotation vectors that its formula gives on paper."""
    assert np.allclose(rotation_vectors(T_NS, RATE, method), expected, rtol=1e-15, atol=0)


@pytest.mark.parametrize("method", METHODS)
def test_constant_rate_is_the_same_by_every_method(method):
    """A constant rate turns by rate times interval, whoever rules the interval."""
    rate = np.tile([0.3, -0.2, 0.1], (3, 1))
    expected = rate[1:] * [[0.5], [0.25]]
    assert np.allclose(rotation_vectors(T_NS, rate, method), expected, rtol=4e-16, atol=0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_samples_have_no_interval(method, count):
    """No samples and one sample give no rotation vectors."""
    assert rotation_vectors(T_NS[:count], RATE[:count], method).shape == (0, 3)


@pytest.mark.parametrize("method", METHODS)
def test_large_stamps_lose_nothing(method):
    """Stamps of today in ns, too large for float64, give the same vectors to the bit."""
    t_ns = T_NS + np.array([0, 1, 3])
    today = t_ns + 1_700_000_000_000_000_001
    assert np.array_equal(
        rotation_vectors(today, RATE, method), rotation_vectors(t_ns, RATE, method)
    )


def test_intervals_are_rounded_once():
    """An interval in seconds is the float64 nearest to its nanoseconds."""
    t_ns = np.array([0, 9_999_999_999])
    assert rotation_vectors(t_ns, np.ones((2, 3)))[0, 0] == 9.999999999


def test_start_is_the_default():
    """Unless told otherwise, sample k rules the interval that begins at it."""
    assert np.array_equal(rotation_vectors(T_NS, RATE), rotation_vectors(T_NS, RATE, "start"))


def test_no_time_turns_nothing():
    """A repeated stamp gives a zero rotation vector by every method."""
    t_ns = np.array([7, 7])
    assert not any(rotation_vectors(t_ns, RATE[:2], method).any() for method in METHODS)


def test_unknown_method_names_the_known_ones():
    """A method that does not exist is refused with those that do."""
    choices = "'start', 'end', 'mean', 'coning', 'cubic', 'quintic'"
    message = f"^there is no method 'rk4'; choose one of {choices}$"
    with pytest.raises(UsageError, match=message):
        rotation_vectors(T_NS, RATE, "rk4")
