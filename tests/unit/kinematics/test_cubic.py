"""The method cubic: fourth order on smooth motion, at ends and next to gaps too."""

from fractions import Fraction

import numpy as np
import pytest
from make.motion import RATES_HZ, SECOND, orders, rotor, stamps
from make.streams import segmented

from quatprop.kinematics.increments import curvature, curvature_of_averages, rotation_vectors
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, multiply
from quatprop.kinematics.resample import Listed, Steady
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.time_series import BLOCK


def rotor_error(t_ns, method="cubic"):
    """Return the worst attitude error on the rotor, rad."""
    truth, rate = rotor(t_ns / 1e9)
    wxyz = attitudes(t_ns, rate, q0=truth[0], method=method)
    return geodesic_angle(wxyz, truth).max()


# --- accuracy


def test_the_formula_is_the_integral_of_the_cubic():
    """The part without the cross product, against the cubic through four samples on paper."""
    random = np.random.default_rng(2)
    for _ in range(20):
        t_ns = np.cumsum(random.integers(8_000_000, 20_000_000, 4))
        rate = random.normal(size=(4, 3))
        cubics = np.polynomial.polynomial.polyfit((t_ns - t_ns[1]) / 1e7, rate, 3)
        h = (t_ns[2] - t_ns[1]) / 1e7
        integral = 1e-2 * (cubics * (h ** np.arange(1, 5) / np.arange(1, 5))[:, None]).sum(axis=0)
        cross = (1e-2 * h) ** 2 / 12 * np.cross(rate[1], rate[2])
        rotvec = rotation_vectors(t_ns, rate, "cubic")[1]
        np.testing.assert_allclose(rotvec, integral + cross, rtol=0, atol=1e-13)


# --- where neighbours are missing


def test_the_ends_are_of_fourth_order_too():
    """Few intervals are mostly ends; as coning they would leave an error of third order."""
    logs = [np.arange(4) * (SECOND // hz) for hz in RATES_HZ]
    errors = [rotor_error(t_ns) for t_ns in logs]
    assert orders(errors).min() > 3.8
    assert (errors < np.array([rotor_error(t_ns, "coning") for t_ns in logs]) / 8).all()


def test_repeated_stamps_cost_no_order():
    """A sample that is there twice ends the parabolas on both of its sides."""
    logs = [stamps(hz, 4) for hz in RATES_HZ]
    errors = [rotor_error(np.sort(np.concatenate([t_ns, t_ns[7::10]]))) for t_ns in logs]
    assert orders(errors).min() > 3.8


@pytest.mark.parametrize(
    ("steps", "is_cubic"),
    [
        # Without three samples of similar spacing there is no parabola.
        ([1 / 4.1, 1, 1 / 4.1], [False, False, False]),
        ([4.1, 1, 4.1], [False, False, False]),
        ([1], [False]),
        # At an end, where there is one on one side alone, they must be more alike.
        ([1, 2.1, 1], [False, True, False]),
    ],
)
def test_neighbours_too_unlike_are_as_coning(steps, is_cubic):
    """A factor of 4 in the middle, of 2 at an end."""
    t_ns = np.cumsum([0, *np.array(steps) * 1e7]).astype(np.int64)
    rate = np.random.default_rng(3).normal(size=(len(t_ns), 3))
    cubic, coning = (rotation_vectors(t_ns, rate, method) for method in ("cubic", "coning"))
    assert (cubic != coning).any(axis=1).tolist() == is_cubic


def test_an_interval_as_long_as_the_limit_is_no_gap():
    """Only a longer one keeps parabolas from passing."""
    t_ns = np.arange(6) * 10_000_000
    rate = np.random.default_rng(5).normal(size=(3, 6))
    free, limited, cut = (curvature(t_ns, rate, gap_ns) for gap_ns in (None, 10_000_000, 9_999_999))
    assert np.array_equal(free.a, limited.a)
    assert np.array_equal(free.b, limited.b)
    assert not cut.a.any()
    assert not cut.b.any()


@pytest.mark.parametrize(
    ("stamp_ms", "is_there"), [(30, True), (35, True), (36, False), (40, False)]
)
def test_next_to_a_lost_increment_there_is_no_cubic(stamp_ms, is_there):
    """Stamps more than half an integration too far apart mean that a rotation is missing."""
    t_ns = np.array([0, 10, 20, stamp_ms]) * 1_000_000
    rate = np.array([[9.0, 1, 2, 4]] * 3)
    found = curvature_of_averages(t_ns, rate, np.full(4, 10_000_000))
    # The second divided difference of the angles, 1 and 2 rad/s over 10 ms each, is 50 rad/s^2.
    assert found.a[0, 0] == pytest.approx(50.0)
    assert (found.a[0, 2] != 0) == is_there


def test_increments_have_gaps_and_lost_messages():
    """No parabola passes through either: a long integration is a gap, and no message is lost."""
    t_ns = np.array([0, 10, 20, 40, 50, 60]) * 1_000_000
    spans = np.array([10, 10, 10, 20, 10, 10]) * 1_000_000
    rate = np.random.default_rng(5).normal(size=(3, 6))
    assert curvature_of_averages(t_ns, rate, spans).a[:, 2].all()
    # Only the ends, each with a parabola on its own side, are left.
    limited = curvature_of_averages(t_ns, rate, spans, gap_ns=15_000_000)
    assert limited.a.any(axis=0).tolist() == [True, True, False, True, True]


# --- at other times


def test_a_rate_that_is_a_parabola_is_followed_exactly_at_any_time():
    """About a fixed axis the angle is a polynomial: it is met at the ends and between samples."""
    t_ns = stamps(50, 4, jitter=0.3)
    polynomial = np.polynomial.Polynomial([1.0, -2.0, 1.5])
    axis = np.array([2.0, -1.0, 2.0]) / 3
    samples = GyroSeries(t_ns, polynomial(t_ns / 1e9)[:, None] * axis)
    for times in (Steady(Fraction(997)), Listed(t_ns[1:] - 1_234_567)):
        _, out_ns, wxyz = segmented([samples], times, method="cubic")
        angle = polynomial.integ()(out_ns / 1e9)[:, None]
        assert geodesic_angle(wxyz, exp(angle * axis)).max() < 1e-13


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("count", [BLOCK - 1, BLOCK, BLOCK + 1, BLOCK + 2])
def test_intervals_between_blocks_have_their_neighbours(count):
    """Where a block ends, attitudes at samples and between them follow the rotor as elsewhere."""
    t_ns = np.arange(count) * 5_000_000
    truth, rate = rotor(t_ns / 1e9)
    for times in (None, Listed(t_ns[:-1] + 2_000_000)):
        how = {"q0": truth[0], "method": "cubic"}
        _, out_ns, wxyz = segmented([GyroSeries(t_ns, rate)], times, **how)
        assert len(out_ns) == (count if times is None else count - 1)
        # Relative to the true motion, the attitude must not jump from one row to the next, as it
        # does by 2e-9 rad at the ends of the log, where neighbours are missing.
        drift = multiply(wxyz, conjugate(rotor(out_ns / 1e9)[0]))
        jumps = geodesic_angle(drift[1:], drift[:-1])
        assert jumps[2:-2].max() < 1e-10
        assert jumps.max() > 1e-9
