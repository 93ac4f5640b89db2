"""The part of two series that is compared, and the rate at which the error is judged."""

import json

import numpy as np
import pytest
from make.commands import refused, run
from make.motion import SECOND, rotor, stamps
from make.tables import write_attitudes

from quatprop import AttitudeSeries, compare, plot
from quatprop.base.errors import ComparisonError, UsageError
from quatprop.kinematics.quaternion import exp, multiply


def exact(t_ns):
    """Return the attitudes of a rotor that spins faster and slower."""
    t_s = t_ns / 1e9
    return AttitudeSeries(t_ns, rotor(t_s + 0.2 * np.sin(1.7 * t_s))[0])


T_NS = stamps(50, 4)
NOISE = np.random.default_rng(1).normal(0, 0.1, (len(T_NS), 3))
TRUTH = exact(T_NS)
NOISY = AttitudeSeries(T_NS, multiply(TRUTH.wxyz, exp(NOISE)))
PART = slice(50, 151)
RANGE = {"start": "+1s", "end": "-1s"}


def later(series, offset_ns):
    """Return a series on another clock."""
    return AttitudeSeries(series.t_ns + offset_ns, series.wxyz)


@pytest.fixture
def files(tmp_path):
    """Return A and B as tables."""
    return [
        write_attitudes(tmp_path / name, series.t_ns, series.wxyz)
        for name, series in (("a.csv", NOISY), ("b.csv", TRUTH))
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("offset_ns", [0, 7 * SECOND])
@pytest.mark.parametrize("align", ["none", "first", "mean"])
def test_both_series_are_cut_before_they_are_aligned(align, offset_ns):
    """By times of A's clock; a mask of times leaves the alignment to all pairs."""
    whole, options = later(TRUTH, -offset_ns), {"align": align, "time_offset": f"{offset_ns}ns"}
    expected = compare(NOISY[PART], whole[PART], **options)
    absolute = {"start": int(T_NS[50]), "end": int(T_NS[150])}
    for given in (RANGE, absolute):
        found = compare(NOISY, whole, **given, **options)
        assert np.array_equal(found.errors, expected.errors)
        assert found.coverage == expected.coverage
        assert found.outside_range == 2 * (len(T_NS) - 101)


def test_files_are_cut_as_series_are(files):
    """The command line reports the number of omitted attitudes."""
    options = ("--start", "+1s", "--end", "-1s")
    (report,) = (json.loads(run("compare", *files, *options, "--json").stdout),)
    expected = compare(NOISY[PART], TRUTH[PART])
    assert report["error_rad"]["rms"] == pytest.approx(expected.error_rad.rms, rel=1e-12)
    said = run("compare", *files, *options, "--rate", "10Hz").stdout
    assert "200 attitudes outside it omitted" in said
    assert "21 of 21 samples over 2 s: interpolated at 10 Hz, B over at most 200 ms" in said


def test_the_offset_of_clocks_is_found_for_the_part():
    """B is cut where its own clock, set right, is within the range."""
    found = compare(TRUTH, later(TRUTH, -7 * SECOND), **RANGE, time_offset="auto")
    assert found.time_offset.added_to_b_ns == pytest.approx(7 * SECOND, abs=2e6)
    assert found.t_ns[0] >= T_NS[50]
    assert found.t_ns[-1] <= T_NS[150]


@pytest.mark.parametrize("rate", [10, 30, 333])
def test_the_error_is_judged_at_a_rate(rate):
    """The attitudes are exact without common timestamps; lower and higher rates work alike."""
    other = exact(stamps(60, 4) + 3_000_000)
    for a, b in ((TRUTH, other), (other, TRUTH)):
        found = compare(a, b, rate=rate)
        wanted = a.t_ns[0] + np.rint(np.arange(4 * rate + 1) * SECOND / rate).astype(np.int64)
        shared = (wanted >= max(a.t_ns[0], b.t_ns[0])) & (wanted <= min(a.t_ns[-1], b.t_ns[-1]))
        assert np.array_equal(found.t_ns, wanted[shared])
        assert found.error_rad.max < 1e-3
        assert found.matching.rate_hz == rate


def test_the_error_of_interpolating_a_is_remarked_on():
    """As for B."""
    remarks = compare(TRUTH[::4], TRUTH[::4], rate=100, tol="1e-6rad").remarks
    assert [one.code for one in remarks] == ["interpolated"]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"rate": 10, "match": "nearest"}, "rate requires match='interpolate'"),
        ({"start": "+3s", "end": "+1s"}, "start is 2 s after end; swap them"),
        ({"start": 4}, "start=.4. is a time of the log's clock in ns, not in seconds"),
        ({"start": "+2s", "time_offset": "-3s"}, "B has no attitude in the time range; it is from"),
    ],
)
def test_unusable_rates_and_ranges_are_refused(options, sentence):
    """Each error is one sentence with a remedy."""
    with pytest.raises((UsageError, ComparisonError), match=sentence):
        compare(TRUTH, TRUTH, **options)


def test_a_picture_of_errors_is_of_the_time_range(tmp_path, files):
    """Start and end were refused together with a reference."""
    out = tmp_path / "e.html"
    run("plot", files[0], "-o", out, "--reference", files[1], "--start", "+1s", "--rate", "10Hz")
    assert "interpolated at 10 Hz" in out.read_text()
    plot(files[0], output=tmp_path / "e.svg", reference=files[1], **RANGE)
    assert "--rate requires --reference" in refused("plot", files[0], "-o", out, "--rate", 10)
