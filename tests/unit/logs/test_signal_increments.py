"""Samples that the sensor has integrated: taken as they are, never integrated again."""

import numpy as np
import pytest
from make.streams import propagated

from quatprop.conditioning import conditioned
from quatprop.errors import SeriesError
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, log, multiply
from quatprop.kinematics.resample import Listed, at_times
from quatprop.series import GyroSeries
from quatprop.series.blocks import BLOCK, reblock
from quatprop.timeline import Timeline
from quatprop.timeline.counts import OBSERVE, Policy, remarks


def tumbling(count):
    """Return attitudes that turn about a moving axis, from the identity on."""
    t = np.linspace(0, 3, count)
    angle = np.stack([1.3 * np.sin(2 * t), 0.8 * t, 0.4 * (1 - np.cos(3 * t))], axis=1)
    attitude = multiply(exp(angle), exp(angle[:, ::-1].copy()))
    return multiply(conjugate(attitude[:1]), attitude)


def increments_of(wxyz, integration_time_ns, t_ns):
    """Return the samples of a sensor that integrates exactly."""
    steps = multiply(conjugate(wxyz[:-1]), wxyz[1:])
    turned = np.concatenate([np.full((1, 3), 0.7), log(steps)])
    return GyroSeries(t_ns, turned / (integration_time_ns / 1e9)[:, None], integration_time_ns)


def attitudes_of(batches, **options):
    """Return all attitudes of a stream."""
    return np.concatenate([series.wxyz for series in propagated(batches, **options)])


@pytest.mark.parametrize("method", ["start", "end", "mean"])
def test_increments_lead_to_the_true_attitude_whatever_the_stamps_say(method):
    """Stamps jitter by half an interval, the motion is no constant rate: every step is exact."""
    random = np.random.default_rng(5)
    truth = tumbling(40_000)
    integration_time_ns = random.integers(4_000_000, 6_000_000, len(truth))
    t_ns = np.cumsum(integration_time_ns) + random.integers(-1_900_000, 1_900_000, len(truth))
    series = increments_of(truth, integration_time_ns, t_ns)
    assert geodesic_angle(attitudes_of([series], method=method), truth).max() < 1e-12


def test_increments_in_the_reference_frame_multiply_on_the_left():
    """The same vectors, the other side: q[k+1] = dq[k] q[k]."""
    turned = np.array([[9.0, 9, 9], [0.3, -0.2, 0.9], [1.1, 0.4, -0.5]])
    integration_time_ns = np.full(3, 500_000_000)
    series = GyroSeries(np.arange(3) * 500_000_000, turned / 0.5, integration_time_ns)
    first, second = exp(turned[1:])
    expected = multiply(second, first)
    found = attitudes_of([series], rates="inertial")[-1]
    assert geodesic_angle(found, expected) < 1e-15


def test_a_message_that_repeats_turns_nothing():
    """An increment whose stamp was there before is the same increment."""
    integration_time_ns = np.full(3, 1_000_000_000)
    rate = np.array([[0, 0, 1.0]] * 3)
    series = GyroSeries(np.array([0, 5, 5]), rate, integration_time_ns)
    angle = 2 * np.arctan2(*attitudes_of([series])[-1, [3, 0]])
    assert angle == pytest.approx(1.0, abs=1e-15)


def test_increments_do_not_depend_on_where_batches_end():
    """Bit for bit, across tiles and blocks."""
    truth = tumbling(40_000)
    integration_time_ns = np.full(len(truth), 1_000_000)
    series = increments_of(truth, integration_time_ns, np.arange(len(truth)) * 1_000_000)
    cuts = [series[start : start + 777] for start in range(0, len(series), 777)]
    assert (attitudes_of(cuts) == attitudes_of([series])).all()
    (block,) = reblock(cuts)
    assert (block.integration_time_ns == integration_time_ns).all()


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_between_samples_an_increment_is_shared_by_time(rates):
    """The stamps lie half as far apart again as the sensor integrates; blocks are crossed."""
    count = BLOCK + 10
    series = GyroSeries(
        np.arange(count) * 15_000_000,
        np.tile([[0, 0, 0.08]], (count, 1)),
        np.full(count, 10_000_000),
    )
    passed = np.array([0, 0.2, 1, 1.4, BLOCK - 0.75, BLOCK + 9])
    found = at_times(
        zip(reblock([series]), propagated([series], rates=rates), strict=True),
        Listed((passed * 15_000_000).astype(np.int64)),
        method="start",
        rates=rates,
    )
    wxyz = np.concatenate([part.wxyz for part in found])
    truth = exp(np.stack([0 * passed, 0 * passed, 0.0008 * passed], axis=1))
    assert geodesic_angle(wxyz, truth).max() < 1e-12


def test_a_bias_is_a_rate_times_the_time_of_integration():
    """Bias and mounting do to increments what they do to rates."""
    integration_time_ns = np.array([1_000_000_000, 250_000_000])
    turned = np.array([[0.5, 0, 0], [0.5, 0, 0]])
    series = GyroSeries(
        np.array([0, 10]), turned / (integration_time_ns / 1e9)[:, None], integration_time_ns
    )
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    (found,) = conditioned([series], bias=np.array([0.4, 0, 0]), matrix=turn)
    increment = found.rate * (found.integration_time_ns / 1e9)[:, None]
    np.testing.assert_allclose(increment, [[0, -0.1, 0], [0, -0.4, 0]], atol=1e-16)


@pytest.mark.parametrize("backwards", ["drop", "sort"])
def test_the_timeline_keeps_increments_whole(backwards):
    """Dropping, sorting and holding carry the time of integration along."""
    t_ns = np.array([0, 10, 5, 20, 30])
    rate = np.ones((5, 3))
    rate[3] = np.nan
    series = GyroSeries(t_ns, rate, np.array([1, 2, 3, 4, 5]))
    timeline = Timeline(Policy(on_backwards=backwards, on_nonfinite="hold"), "log")
    (found,) = timeline.apply([series])
    kept = {"drop": [1, 2, 4, 5], "sort": [1, 3, 2, 4, 5]}[backwards]
    assert found.integration_time_ns.tolist() == kept
    assert timeline.counts.integrated_ns == sum(kept[1:])


COVERED = "the increments cover {} s of the 8 s between the first timestamp and the last"


@pytest.mark.parametrize(
    ("integrated_ns", "said"),
    [
        # A lost message is a lost rotation, which no method can hold across.
        ([3 * 10**9] * 3, COVERED.format(6) + ": no rotation is assumed for the rest"),
        # Intervals that were integrated twice are not rest.
        ([5 * 10**9] * 3, COVERED.format(10)),
        # Less than a thousandth of the time may be missing, or covered twice.
        *(([4 * 10**9] * 2 + [4 * 10**9 - missed], "") for missed in (0, 7_999_999, -7_999_999)),
    ],
)
def test_time_that_increments_do_not_cover_once_is_remarked_on(integrated_ns, said):
    """The path is what was integrated, whatever the stamps say."""
    series = GyroSeries(
        np.array([0, 4, 8]) * 10**9, np.ones((3, 3)), np.array(integrated_ns, np.int64)
    )
    timeline = Timeline(OBSERVE, "log")
    list(timeline.apply([series]))
    assert timeline.counts.integrated_ns == sum(integrated_ns[1:])
    turned = sum(integrated_ns[1:]) / 1e9 * 3**0.5
    assert timeline.counts.path_angle_rad == pytest.approx(turned)
    assert [str(remark) for remark in remarks(timeline.counts, OBSERVE)] == [said] * bool(said)


def test_spans_have_one_row_a_sample():
    """The series is validated at birth."""
    with pytest.raises(
        SeriesError, match=r"^Expected `integration_time_ns` of shape \(2,\), got \(1,\)$"
    ):
        GyroSeries(np.array([0, 1]), np.zeros((2, 3)), np.array([1]))
