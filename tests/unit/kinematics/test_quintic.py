"""The method quintic: sixth order on smooth motion, at ends, at gaps and between samples too."""

import numpy as np
import pytest
from make.motion import SECOND, orders, rotor, stamps
from make.streams import IDENTITY, segmented

from quatprop.kinematics.increments import MAX_RATIO, quintic, quintic_of_averages, rotation_vectors
from quatprop.kinematics.propagate import TILE
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply
from quatprop.kinematics.resample import Listed
from quatprop.kinematics.series import GyroSeries

RATES_HZ = (16, 32, 64, 125)


def propagated(series, times=None, q0=IDENTITY, rates="body", batch=None):
    """Return stamps and attitudes of a run with the method."""
    size = batch or len(series)
    batches = [series[k : k + size] for k in range(0, len(series), size)]
    return segmented(batches, times, q0=q0, method="quintic", rates=rates)[1:]


def test_ends_and_gaps_are_of_full_order():
    """Seven samples between gaps are mostly ends."""
    errors = []
    for hz in RATES_HZ:
        interval = SECOND // hz
        t_ns = np.concatenate([np.arange(7) * interval + k * 60 * interval for k in range(4)])
        rate = rotor(t_ns / 1e9)[1]
        steps = exp(rotation_vectors(t_ns, rate, "quintic"))
        truth = rotor(t_ns / 1e9)[0]
        inside = np.diff(t_ns) == interval
        errors.append(geodesic_angle(multiply(truth[:-1], steps), truth[1:])[inside].max())
    # A step is of one order more than the sum of all.
    assert orders(errors).min() > 6.5


def test_a_polynomial_of_fifth_degree_is_exact():
    """About a fixed axis, wherever the six samples lie: the integral on paper."""
    random = np.random.default_rng(5)
    t_ns = np.cumsum(random.integers(8_000_000, 14_000_000, 9))
    polynomial = np.polynomial.Polynomial(random.normal(size=6), domain=[t_ns[0], t_ns[-1]])
    axis = np.array([2.0, -1.0, 2.0]) / 3
    rotvec = rotation_vectors(t_ns, polynomial(t_ns)[:, None] * axis, "quintic")
    integral = np.diff(polynomial.integ()(t_ns)) / 1e9
    np.testing.assert_allclose(rotvec, integral[:, None] * axis, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_fewer_than_six_samples_are_as_cubic(count):
    """There is no quintic through them."""
    t_ns, rate = stamps(100, 1)[:count], np.random.default_rng(7).normal(size=(count, 3))
    cubic = rotation_vectors(t_ns, rate, "cubic")
    assert np.array_equal(rotation_vectors(t_ns, rate, "quintic"), cubic)


@pytest.mark.parametrize("averages", [False, True])
def test_no_quintic_passes_over_a_long_interval(averages):
    """Polynomials end on both sides of it, and the interval itself is as cubic."""
    lengths = np.full(12, 10_000_000)
    lengths[6] *= MAX_RATIO + 0.1
    t_ns, rate = np.cumsum(lengths), np.random.default_rng(8).normal(size=(12, 3))
    options = {"is_interval_average": averages}
    cubic, found = (rotation_vectors(t_ns, rate, m, **options) for m in ("cubic", "quintic"))
    assert (cubic == found).all(axis=1).tolist() == [k == 5 for k in range(11)]
    alone = rotation_vectors(t_ns[:6], rate[:6], "quintic", **options)
    assert np.array_equal(found[:5], alone)


def test_intervals_longer_than_the_limit_are_gaps():
    """Only a longer one keeps polynomials from passing."""
    t_ns, rate = np.arange(12) * 10_000_000, np.random.default_rng(9).normal(size=(3, 12))
    for of in (quintic, quintic_of_averages):
        assert of(t_ns, rate, gap_ns=10_000_000).usable.all()
        assert not of(t_ns, rate, gap_ns=9_999_999).usable.any()


def test_next_to_a_lost_increment_there_is_no_quintic():
    """Where stamps are further apart than what was integrated, a rotation is missing."""
    t_ns = np.arange(13) * 10_000_000
    t_ns[7:] += 6_000_000
    integration_time_ns = np.full(13, 10_000_000)
    usable = quintic_of_averages(t_ns, np.ones((3, 13)), integration_time_ns).usable
    assert usable.tolist() == [True] * 12
    assert not quintic_of_averages(
        t_ns[4:11], np.ones((3, 7)), integration_time_ns[4:11]
    ).usable.any()


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("count", [TILE + k for k in (-1, 0, 1, 4, 5)])
def test_tiles_and_batches_change_nothing(count):
    """Neighbours are found across tiles, to the bit, with gaps in the stamps too."""
    random = np.random.default_rng(10)
    lengths = random.integers(4_000_000, 6_000_000, count + 50)
    lengths[random.integers(0, len(lengths), 300)] *= 10
    t_ns, rate = np.cumsum(lengths), random.normal(size=(len(lengths), 3))
    whole = GyroSeries(t_ns, rate)
    times = t_ns[:-1] + 1_234_567
    expected = propagated(whole)[1], propagated(whole, Listed(times))[1]
    assert np.array_equal(propagated(whole, batch=1009)[1], expected[0])
    assert np.array_equal(propagated(whole, Listed(times), batch=count)[1], expected[1])
    steps = exp(rotation_vectors(t_ns, rate, "quintic"))
    serial = multiply(expected[0][:-1], steps)
    assert geodesic_angle(serial, expected[0][1:]).max() < 1e-14
