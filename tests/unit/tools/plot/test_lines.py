"""Lines that are drawn: breaks at gaps and at wraps, and nothing but the series in between."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quatprop.tools.plot.picture import Line, Unwrap, folded, gaps_in, line, lone_points
from quatprop.tools.plot.reduction import Reduction


def reduced(t_ns, *traces, bins=2048):
    """Return series as they are kept for a picture."""
    reduction = Reduction(len(traces), bins)
    reduction.add(np.asarray(t_ns, dtype=np.int64), np.array(traces, dtype=float))
    return reduction.result()


def wrapped(degrees):
    """Return angles from -180 up to 180."""
    return (np.asarray(degrees) + 180) % 360 - 180


def drawn_turning(degrees):
    """Return the line of an angle that is sampled each millisecond, and the bins it is kept in."""
    (continued,) = Unwrap(1).applied(wrapped(degrees)[None])
    kept = reduced(np.arange(len(degrees)) * 1_000_000, continued)
    return folded(line(kept, 0, 0)), len(kept)


angles = st.lists(st.floats(-179, 179), min_size=2, max_size=40)


@given(angles, st.lists(st.integers(0, 40), max_size=4))
def test_angles_are_continued_as_numpy_does_it(steps, cuts):
    """Whole turns are added as numpy.unwrap adds them, however the series was cut."""
    angle = wrapped(np.cumsum(steps))
    continuous = Unwrap(1)
    parts = np.split(angle, sorted(min(cut, len(angle)) for cut in cuts))
    got = np.concatenate([continuous.applied(part[None])[0] for part in parts])
    np.testing.assert_allclose(got, np.unwrap(angle, period=360), atol=1e-9)


def test_a_long_spin_is_counted_without_rounding():
    """After a hundred thousand turns an angle is what it was, to the last bit."""
    angle = np.tile([0.1, 120.1, -119.9], 100_000)
    assert Unwrap(1).applied(angle[None])[0][-1] == 360.0 * 100_000 - 119.9


def test_a_line_is_the_series_where_it_fits():
    """With a bin for two samples it is all samples in order; stamps keep their nanoseconds."""
    start = 1_700_000_000_000_000_000
    values = np.random.default_rng(2).normal(size=1000)
    got = line(reduced(start + np.arange(1000) * 7, values), 0, start)
    np.testing.assert_allclose(got.seconds, np.arange(1000) * 7e-9, rtol=1e-12)
    assert got.values.tolist() == values.tolist()


def test_a_line_breaks_at_gaps_which_are_returned():
    """An interval longer than the limit breaks the line; one of the limit does not."""
    kept = reduced([0, 10, 20, 120, 130, 231], [1, 1, 1, 1, 1, 1])
    assert np.isnan(line(kept, 0, 0, 100).values).tolist() == [False] * 5 + [True, False]
    assert gaps_in(kept, 100).tolist() == [[130, 231]]
    assert gaps_in(kept, None).tolist() == []


def test_gaps_are_found_in_a_long_series_too():
    """Where bins hold many samples, a gap between them has the stamps of its two ends."""
    t_ns = np.arange(100_000) * 1_000_000
    t_ns[60_000:] += 60_000_000_000
    kept = reduced(t_ns, np.zeros(100_000))
    assert gaps_in(kept, 10_000_000).tolist() == [[59_999_000_000, 120_000_000_000]]


def test_missing_values_break_a_line():
    """A NaN among the samples is a break, not a bridge; a sample between two would be no line."""
    got = line(reduced([0, 1, 2, 3], [1, np.nan, 2, 3]), 0, 0)
    np.testing.assert_array_equal(got.values[got.values.size - 3 :], [np.nan, 2, 3])
    drawn = Line(np.arange(6.0), np.array([1, np.nan, 2, np.nan, 3, 4]))
    assert lone_points(drawn).values.tolist() == [1, 2]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("to", "whole"), [(200.0, False), (560.0, True), (920.0, True)])
def test_a_wrap_is_cut_at_the_edges_of_its_range(sign, to, whole):
    """It leaves at 180 degrees and comes back at -180; of several turns it has been everywhere."""
    drawn = folded(Line(np.array([0.0, 1.0]), sign * np.array([170.0, to])))
    middle = [-180.0, 180.0, np.nan] if whole else []
    expected = [170.0, 180.0, np.nan, *middle, -180.0, -160.0]
    np.testing.assert_allclose(drawn.values * sign, expected)
    if not whole:
        np.testing.assert_allclose(drawn.seconds, [0, 1 / 3, np.nan, 1 / 3, 1])


@pytest.mark.parametrize("samples", [500, 5_000, 100_000])
def test_wraps_draw_no_bars(samples):
    """An angle that goes around ten times is ten slopes, however many samples are in a bin."""
    drawn, _ = drawn_turning(np.linspace(0, 3600, samples))
    assert np.nanmax(np.abs(np.diff(drawn.values))) < 3600 / min(samples, 500) * 1.5
    assert np.nanmin(drawn.values) == -180
    assert np.nanmax(drawn.values) == 180
    assert np.isnan(drawn.values).sum() == 10


def test_a_fast_spin_is_a_full_band():
    """Where an angle goes around within a bin, the bin is drawn over its whole range."""
    drawn, bins = drawn_turning(np.arange(100_000) * 100.0)
    assert (np.abs(np.diff(drawn.values)) == 360).sum() >= bins


@given(angles, st.integers(2, 30))
def test_a_drawn_angle_is_the_angle(steps, bins):
    """Folded points are the angles of the line they come from, at the same times, but for cuts."""
    angle = np.cumsum(steps)
    before = line(reduced(np.arange(len(angle)) * 1_000_000_000, angle, bins=bins), 0, 0)
    after = folded(before)
    assert (np.abs(after.values[np.isfinite(after.values)]) <= 180).all()
    want, got = (
        set(zip(one.seconds.tolist(), wrapped(one.values).round(6).tolist(), strict=True))
        for one in (before, after)
    )
    assert {(t, v) for t, v in want if abs(v) < 179.999} <= got
