"""Samples that are averages or increments over the intervals before their timestamps."""

from fractions import Fraction

import numpy as np
import pytest
from make.motion import RATES_HZ, SECOND, orders, rotor, stamps
from make.streams import segmented

from quatprop import propagate
from quatprop.kinematics.cubic import MAX_SPAN_RATIO
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.propagate import TILE
from quatprop.kinematics.quaternion import exp, geodesic_angle
from quatprop.kinematics.resample import Listed, Steady
from quatprop.series import GyroSeries
from quatprop.series.blocks import BLOCK

KINDS = ("averages", "increments")


def rotor_integral(t_s, spin=4.1, precession=1.22, tilt=1.2):
    """Return the integral of the body rate of make.motion.rotor."""
    across = precession * np.sin(tilt) / spin
    along = spin + precession * np.cos(tilt)
    return np.stack([-across * np.cos(spin * t_s), across * np.sin(spin * t_s), along * t_s], 1)


def series_of(kind, t_ns, rate, spans=None):
    """Return a series of samples of a kind; increments cover the intervals, or other spans."""
    steps = np.diff(t_ns, prepend=2 * t_ns[0] - t_ns[1])
    spans = steps if spans is None else np.full(len(t_ns), spans)
    return GyroSeries(t_ns, rate, spans if kind == "increments" else None, kind == "averages")


def integrated(t_ns, kind):
    """Return what a sensor on the rotor that integrates exactly gives at these stamps."""
    rate = np.diff(rotor_integral(t_ns / 1e9), axis=0) / (np.diff(t_ns) / 1e9)[:, None]
    # The first sample is about time before the log; whatever it is, no result may depend on it.
    return series_of(kind, t_ns, np.vstack([[9.0, -9.0, 9.0], rate]))


def vectors(series, method):
    """Return the rotation vectors of a series."""
    how = series.integration_time_ns, series.is_interval_average
    return rotation_vectors(series.t_ns, series.rate, method, how[0], is_interval_average=how[1])


def propagated(series, **how):
    """Return the attitudes at the samples."""
    return segmented([series], **{"method": "end", **how})[2]


# --- accuracy


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("method", "bounds", "order"),
    [
        ("end", [1.3e-2, 3.2e-3, 7.9e-4, 2.0e-4], 1.95),
        ("coning", [1.4e-4, 1.7e-5, 2.2e-6, 2.7e-7], 2.95),
        ("cubic", [2.0e-5, 1.3e-6, 8.0e-8, 5.0e-9], 3.8),
    ],
)
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_a_precessing_rotor(kind, method, bounds, order, jitter):
    """The worst error over 20 s, with a sensor that integrates exactly between its stamps."""
    errors = []
    for hz in RATES_HZ:
        t_ns = stamps(hz, 20, jitter)
        truth, _ = rotor(t_ns / 1e9)
        wxyz = propagated(integrated(t_ns, kind), q0=truth[0], method=method)
        errors.append(geodesic_angle(wxyz, truth).max())
    assert (np.array(errors) <= bounds).all()
    assert orders(errors).min() > order


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_alternating_intervals_are_of_full_order(kind, first):
    """The first and the last interval lost their correction: third order, worse than coning."""
    errors, of_coning = [], []
    for hz in RATES_HZ:
        steps = np.tile(np.array([6, 14]) * (SECOND // hz // 10), hz // 10 + 1)[first:]
        t_ns = np.concatenate([[0], np.cumsum(steps)])
        truth, series = rotor(t_ns / 1e9)[0], integrated(t_ns, kind)
        for method, found in (("cubic", errors), ("coning", of_coning)):
            wxyz = propagated(series, q0=truth[0], method=method)
            found.append(geodesic_angle(wxyz, truth).max())
    assert orders(errors).min() > 3.8
    assert (np.array(errors) < np.array(of_coning) / 4).all()


@pytest.mark.parametrize("kind", KINDS)
def test_even_intervals_have_the_weights_of_the_textbook(kind):
    """theta_k-1 x theta_k / 12 before, and half of that on each side; one-sided at the ends."""
    theta = np.random.default_rng(1).normal(size=(5, 3))
    series = series_of(kind, np.arange(5) * SECOND, theta)
    term = np.cross(theta[1:-1], theta[2:]) / 12
    zero = np.zeros((1, 3))
    before, after = np.concatenate([zero, term]), np.concatenate([term, zero])
    np.testing.assert_allclose(vectors(series, "coning"), theta[1:] + before, atol=1e-15)
    both = (before + after) / 2
    both[[0, -1]] *= 2
    np.testing.assert_allclose(vectors(series, "cubic"), theta[1:] + both, atol=1e-15)


@pytest.mark.parametrize("method", ["coning", "cubic"])
@pytest.mark.parametrize("kind", KINDS)
def test_no_term_reaches_across_repeated_stamps_and_lost_messages(kind, method):
    """Where the neighbouring interval is missing, the rotation vector is the increment itself."""
    theta = np.random.default_rng(2).normal(size=(4, 3))
    lost = int(4 * 1.1 * SECOND) if kind == "averages" else int(MAX_SPAN_RATIO * SECOND) + 1
    for steps in ([SECOND, 0, SECOND], [lost, SECOND, lost]):
        series = series_of(kind, np.concatenate([[0], np.cumsum(steps)]), theta, SECOND)
        plain, found = vectors(series, "end"), vectors(series, method)
        # Of a lost message the next increment is whole, and the one after it follows.
        follows = kind == "increments" and steps[1]
        expected = [not (follows and method == "cubic"), not follows, True]
        assert (plain == found).all(axis=1).tolist() == expected


# --- at other times, in other batches


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("method", "order"), [("end", 1.9), ("coning", 2.8), ("cubic", 3.7)])
def test_other_times_are_of_the_same_order(kind, method, order):
    """At 997 Hz between the samples: the rate within an interval follows from its neighbours.

    Within the first and the last interval, with a neighbour on one side, it is an order less.
    """
    errors = []
    for hz in RATES_HZ:
        t_ns = stamps(hz, 5, jitter=0.3)
        how = {"q0": rotor(t_ns[:1] / 1e9)[0][0], "method": method}
        _, out_ns, wxyz = segmented([integrated(t_ns, kind)], Steady(Fraction(997)), **how)
        inside = (out_ns > t_ns[1]) & (out_ns < t_ns[-2])
        errors.append(geodesic_angle(wxyz, rotor(out_ns / 1e9)[0])[inside].max())
    assert np.log2(errors[0] / errors[-1]) / 3 > order


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", ["end", "coning", "cubic"])
def test_times_just_before_samples_lead_up_to_them(kind, method):
    """A nanosecond before each sample the attitude is the sample's, across blocks too."""
    t_ns = stamps(200, 2, jitter=0.3)
    if method == "cubic":
        t_ns = np.arange(BLOCK + 3) * 5_000_000
    series = integrated(t_ns, kind)
    _, out_ns, before = segmented([series], Listed(t_ns[1:] - 1), method=method)
    assert np.array_equal(out_ns, t_ns[1:] - 1)
    assert geodesic_angle(before, propagated(series, method=method)[1:]).max() < 1.5e-8


@pytest.mark.parametrize("rates", ["body", "inertial"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", ["coning", "cubic"])
def test_the_same_bits_for_any_batch_and_any_end(kind, method, rates):
    """A prefix of the log is a prefix of the result: of cubic, all but the last attitude."""
    series = integrated(stamps(200, 170, jitter=0.3), kind)
    how = {"method": method, "rates": rates, "sensitivity": False}
    whole = propagated(series, **how)
    batches = [series[start : start + 777] for start in range(0, len(series), 777)]
    assert segmented(batches, **how)[2].tobytes() == whole.tobytes()
    last = 1 if method == "cubic" else 0
    for count in (2, 3, TILE, TILE + 1, TILE + 2):
        part = propagated(series[:count], **how)
        assert part[: count - last].tobytes() == whole[: count - last].tobytes()


@pytest.mark.parametrize("method", ["end", "coning", "cubic"])
def test_the_frames_agree(method):
    """The conjugate of body rates is inertial rates of the opposite sign, coning terms included."""
    series = integrated(stamps(50, 2), "averages")
    body = propagated(series, method=method)
    inertial = propagated(series.with_rate(-series.rate), method=method, rates="inertial")
    assert geodesic_angle(body, inertial * [1, -1, -1, -1]).max() < 1e-13


# --- what is chosen


@pytest.mark.parametrize(
    ("kind", "method", "used", "method_from", "warns"),
    [
        ("averages", None, "end", "log", None),
        ("averages", "end", "end", "given", None),
        ("averages", "mean", "mean", "given", "which is what method end assumes; method mean was"),
        ("averages", "cubic", "cubic", "given", "adds to averages the coning that a sensor leaves"),
        ("increments", None, "end", "log", None),
        ("increments", "start", "end", "log", "to which method start does not apply; end is used"),
        ("increments", "coning", "coning", "given", "adds to increments the coning"),
    ],
)
def test_series_in_memory_have_the_default_that_fits(kind, method, used, method_from, warns):
    """What the samples are is kept in the series, and said of the result."""
    series = integrated(stamps(50, 1), kind)
    if warns is None:
        result = propagate(series, method=method)
    else:
        with pytest.warns(UserWarning, match=warns):
            result = propagate(series, method=method)
    convention = result.report.convention
    assert (convention.method, convention.method_from) == (used, method_from)
    assert convention.samples == kind
    assert np.array_equal(result.wxyz, propagated(series, method=used))


def test_an_increment_is_turned_in_the_time_between_its_stamps():
    """However long it was integrated: 0.5 rad in 2 s are 0.25 rad after 1 s."""
    series = GyroSeries([0, 2 * SECOND], [[0, 0, 9.0], [0, 0, 0.5]], [SECOND, SECOND])
    _, _, wxyz = segmented([series], Listed(np.array([1, 2]) * SECOND), method="end")
    assert geodesic_angle(wxyz, exp([[0, 0, 0.25], [0, 0, 0.5]])).max() < 1e-15
