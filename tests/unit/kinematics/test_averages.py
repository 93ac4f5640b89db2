"""Samples that are averages or increments over the intervals before their timestamps."""

import numpy as np
import pytest
from make.motion import SECOND, rotor_samples, stamps
from make.streams import segmented

from quatprop import propagate
from quatprop.kinematics.increments import MAX_SPAN_RATIO, rotation_vectors
from quatprop.kinematics.propagate import TILE
from quatprop.kinematics.quaternion import exp, geodesic_angle
from quatprop.kinematics.resample import Listed
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.time_series import BLOCK

KINDS = ("averages", "increments")


def series_of(kind, t_ns, rate, spans=None):
    """Return a series of samples of a kind; increments cover the intervals, or other spans."""
    steps = np.diff(t_ns, prepend=2 * t_ns[0] - t_ns[1])
    spans = steps if spans is None else np.full(len(t_ns), spans)
    return GyroSeries(t_ns, rate, spans if kind == "increments" else None, kind == "averages")


def vectors(series, method):
    """Return the rotation vectors of a series."""
    how = series.integration_time_ns, series.is_interval_average
    return rotation_vectors(series.t_ns, series.rate, method, how[0], is_interval_average=how[1])


def propagated(series, **how):
    """Return the attitudes at the samples."""
    return segmented([series], **{"method": "end", **how})[2]


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
@pytest.mark.parametrize("method", ["end", "coning", "cubic"])
def test_times_just_before_samples_lead_up_to_them(kind, method):
    """A nanosecond before each sample the attitude is the sample's, across blocks too."""
    t_ns = stamps(200, 2, jitter=0.3)
    if method == "cubic":
        t_ns = np.arange(BLOCK + 3) * 5_000_000
    series = rotor_samples(kind, t_ns)
    _, out_ns, before = segmented([series], Listed(t_ns[1:] - 1), method=method)
    assert np.array_equal(out_ns, t_ns[1:] - 1)
    assert geodesic_angle(before, propagated(series, method=method)[1:]).max() < 1.5e-8


@pytest.mark.parametrize("rates", ["body", "inertial"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", ["coning", "cubic"])
def test_the_same_bits_for_any_batch_and_any_end(kind, method, rates):
    """A prefix of the log is a prefix of the result: of cubic, all but the last attitude."""
    series = rotor_samples(kind, stamps(200, 170, jitter=0.3))
    how = {"method": method, "rates": rates, "sensitivity": False}
    whole = propagated(series, **how)
    batches = [series[start : start + 777] for start in range(0, len(series), 777)]
    assert segmented(batches, **how)[2].tobytes() == whole.tobytes()
    last = 1 if method == "cubic" else 0
    for count in (2, 3, TILE, TILE + 1, TILE + 2):
        part = propagated(series[:count], **how)
        assert part[: count - last].tobytes() == whole[: count - last].tobytes()


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
    """The kind of samples is kept in the series, and reported with the result."""
    series = rotor_samples(kind, stamps(50, 1))
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
