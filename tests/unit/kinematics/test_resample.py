"""Attitudes at other times, wherever batches end.

The values of each method are tested in ``contract/test_options_oracle.py``.
"""

import re
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.streams import propagated

from quatprop.base.errors import UsageError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, rotate, rotation_matrix
from quatprop.kinematics.resample import PIECE, Listed, Steady, at_times, every
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.time_series import reblock

S = 1_000_000_000


def jittered():
    """Return rates that change direction, at jittered stamps with a duplicate."""
    random = np.random.default_rng(1)
    t_ns = np.cumsum(random.integers(8_000_000, 12_000_000, 50))
    t_ns[7] = t_ns[6]
    return GyroSeries(t_ns, random.normal(0, 3, (50, 3)))


GYRO = jittered()


def resampled(gyro, times, method="start", rates="body", size=1000):
    """Return stamps and attitudes at times, from blocks of a given size."""
    blocks = list(reblock([gyro], size))
    (whole,) = propagated(blocks, method=method, rates=rates)
    parts = [whole[start : start + size] for start in range(0, len(whole), size)]
    out = list(at_times(zip(blocks, parts, strict=True), times, method=method, rates=rates))
    return np.concatenate([o.t_ns for o in out]), np.concatenate([o.wxyz for o in out])


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_what_is_between_samples_is_linear_in_the_axes_in_which_it_grows(rates):
    """Rates in reference axes were interpolated after they were turned to body axes."""
    t_ns = np.arange(51) * 20_000_000
    first, slope = np.array([[1.0, -2.0, 0.5], [3.0, 1.0, -2.0]])
    rate = first + np.outer(t_ns / 1e9, slope)
    wxyz = attitudes(t_ns, rate, method="coning", rates=rates)
    body = rate if rates == "body" else rotate(conjugate(wxyz), rate)

    def covariance(t_ns, wxyz):
        grown = (t_ns / 1e9)[:, None, None] * np.diag([1.0, 2.0, 5.0])
        turn = rotation_matrix(wxyz)
        return turn.swapaxes(1, 2) @ grown @ turn if rates == "body" else grown

    known = AttitudeSeries(t_ns, wxyz, rate=body, covariance=covariance(t_ns, wxyz))
    pairs = [(GyroSeries(t_ns, rate), known)]
    (found,) = at_times(pairs, Steady(Fraction(333)), method="coning", rates=rates)
    expected = first + np.outer(found.t_ns / 1e9, slope)
    if rates == "inertial":
        expected = rotate(conjugate(found.wxyz), expected)
    np.testing.assert_allclose(found.rate, expected, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, covariance(found.t_ns, found.wxyz), atol=1e-13)


def test_times_at_samples_are_the_samples():
    """To the bit; of equal timestamps the later one; outside of them nothing is known."""
    times = Listed(np.concatenate([[GYRO.t_ns[0] - 1], GYRO.t_ns, [GYRO.t_ns[-1] + 1]]))
    stamps, found = resampled(GYRO, times, "end")
    assert (stamps == GYRO.t_ns).all()
    expected = attitudes(GYRO.t_ns, GYRO.rate, method="end")
    expected[6] = expected[7]
    assert (found == expected).all()


@given(st.integers(1, 60), st.integers(1, 7), st.sampled_from(["start", "coning", "cubic"]))
def test_batches_do_not_matter(size, rate, method):
    """The same times and the same attitudes, to the bit, come out of any blocks."""
    one = resampled(GYRO, Steady(Fraction(1000, rate)), method, size=1000)
    other = resampled(GYRO, Steady(Fraction(1000, rate)), method, size=size)
    assert (one[0] == other[0]).all()
    assert (one[1] == other[1]).all()


def test_between_samples_mean_is_as_good_as_at_samples():
    """The mean rate was held: 1.75 times the error of a swing about one axis."""
    t_ns, axis = np.arange(401) * 10_000_000, np.array([2.0, -1.0, 2.0]) / 3
    rate = 3 * np.sin(9 * t_ns / 1e9)[:, None] * axis

    def worst(t_ns, wxyz):
        truth = exp((1 - np.cos(9 * t_ns / 1e9))[:, None] / 3 * axis)
        return geodesic_angle(wxyz, truth).max()

    between = t_ns[:-1] + 4_000_000
    found = resampled(GyroSeries(t_ns, rate), Listed(between), "mean")
    at_samples = worst(t_ns, attitudes(t_ns, rate, method="mean"))
    assert worst(*found) < 1.01 * at_samples


def test_steady_times_do_not_drift():
    """The k-th of 29.97 times a second is k / 29.97 s to the nearest ns, after a million too."""
    steady, end_s = Steady(Fraction(2997, 100)), 33_367
    t_ns = np.concatenate(
        [piece for end in (1, 2, end_s) for piece in steady.up_to(5, 5 + end * S)]
    )
    assert len(t_ns) == end_s * 2997 // 100 + 1
    for k in (*range(100), *range(len(t_ns) - 20_000, len(t_ns))):
        assert t_ns[k] == 5 + round(Fraction(k * 100 * S, 2997))


@pytest.mark.parametrize(
    ("hz", "stamps"),
    [
        # Ten thousand times a sample are the most, though each interval may be short enough.
        (10**9, np.arange(1001) * 9_999),
        (10**9, np.arange(2001) * 9_999),
        # Ten million between two samples; one more comes from a wrong timestamp.
        (1, np.array([7])),
        (1, np.array([0, 10_000_000 * S])),
    ],
)
def test_as_many_times_as_samples_could_mean_are_taken(hz, stamps):
    """There is no remark on them."""
    Steady(Fraction(hz)).refuse_excess(stamps)


@pytest.mark.parametrize(
    ("hz", "stamps", "sentence"),
    [
        (
            10**9,
            np.arange(1001) * 10_011,
            "between 1001 samples from 0 to 10011000 ns there would be 10,011,000 attitudes at",
        ),
        (
            1,
            np.array([-S, 0, 10_000_001 * S, 10_000_002 * S]),
            (
                "between the samples at 0 and 10000001000000000 ns there would be 10,000,001 "
                "attitudes at 1 Hz; is a timestamp wrong? Choose on_gap='split', a lower rate, or "
                "omit a part with start or end"
            ),
        ),
        # Of a rate that is no whole number, to the last of the times.
        (Fraction(1000, 3), np.array([0, 30_000 * S + 9_000_000]), "10,000,003 attitudes at 333.3"),
    ],
)
def test_more_times_than_samples_could_mean_are_refused(hz, stamps, sentence):
    """The interval is named, with every way out."""
    with pytest.raises(UsageError, match=re.escape(sentence)):
        Steady(Fraction(hz)).refuse_excess(stamps)


@pytest.mark.parametrize("times", [Steady(Fraction(10**9)), Listed(np.arange(1_000_000))])
def test_however_many_times_come_in_pieces(times):
    """A thousand times a sample, and memory is bounded all the same."""
    gyro = GyroSeries(np.arange(0, 10**6, 1000), np.ones((1000, 3)))
    pairs = [(gyro, AttitudeSeries(gyro.t_ns, np.tile([1.0, 0, 0, 0], (1000, 1))))]
    sizes = [len(part) for part in at_times(pairs, times, method="start", rates="body")]
    assert sum(sizes) == 10**6 - 999
    assert max(sizes) <= PIECE


@given(st.lists(st.integers(0, 9), max_size=8), st.integers(1, 7))
def test_every_nth_attitude(sizes, step):
    """Every n-th sample is kept, counted over all batches, the first among them."""
    total = sum(sizes)
    whole = AttitudeSeries(np.arange(total), np.tile([1.0, 0, 0, 0], (total, 1)))
    batches = [whole[a:b] for a, b in pairwise(np.cumsum([0, *sizes]))]
    kept = [int(t) for batch in every(batches, step) for t in batch.t_ns]
    assert kept == list(range(0, total, step))
