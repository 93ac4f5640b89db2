"""The times to judge: errors of the pairs in them alone, as benchmarks with phases define them."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make.commands import run
from make.motion import SECOND, rotor, stamps
from make.places import SAMPLE_LOGS
from make.suites import TRUTH as TRUTH_CASE
from make.suites import check, pinned, write_suite
from make.tables import write_attitudes

from quatprop import AttitudeSeries, compare
from quatprop.base.errors import ComparisonError, UsageError
from quatprop.kinematics.quaternion import exp, multiply

T_NS = stamps(50, 4)
TRUTH = AttitudeSeries(T_NS, rotor(T_NS / 1e9)[0])
NOISE = np.random.default_rng(1).normal(0, 0.1, (len(T_NS), 3))
MOVES = np.isin(np.arange(len(T_NS)) // 25, [1, 2, 5, 7])
PHASES = "0.5s..1.48s,+2.5s..+2.98s,+3.5s..-20ms"
"""Those of MOVES, from the first and from the last sample."""


def noisy(offset_ns=0):
    """Return attitudes that are off by NOISE."""
    return AttitudeSeries(T_NS + offset_ns, multiply(exp(NOISE), TRUTH.wxyz))


def broad(estimate, truth, movement):
    """Return the RMS errors in total, heading and inclination, rad, by the code of BROAD.

    D. Laidig et al., Data 6 (2021) 72, eqs. 1 to 4.
    """
    a, (w, x, y, z) = estimate.T, truth.T * [[1], [-1], [-1], [-1]]
    scalar = a[0] * w - a[1] * x - a[2] * y - a[3] * z
    vertical = a[0] * z + a[1] * y - a[2] * x + a[3] * w
    total = 2 * np.arccos(np.abs(scalar))
    heading = 2 * np.arctan(np.abs(vertical / scalar))
    inclination = 2 * np.arccos(np.sqrt(scalar**2 + vertical**2))
    return [np.sqrt(np.mean(one[movement] ** 2)) for one in (total, heading, inclination)]


@pytest.mark.parametrize("offset_ns", [0, 7_000_000])
def test_the_errors_are_those_of_the_phases_of_movement(offset_ns):
    """Relative and absolute times, in A's clock, give the three metrics of BROAD."""
    edges = np.flatnonzero(np.diff(np.pad(MOVES, 1))).reshape(-1, 2)
    absolute = np.column_stack([T_NS[edges[:, 0]], T_NS[edges[:, 1] - 1]]) + offset_ns
    for judge in (PHASES, absolute, [(int(a), str(b)) for a, b in absolute]):
        found = compare(
            noisy(offset_ns), TRUTH, judge=judge, time_offset=offset_ns / SECOND, tol_heading=3
        )
        rms = found.error_rad.rms, found.parts.heading.rms, found.parts.inclination.rms
        assert rms == pytest.approx(broad(noisy().wxyz, TRUTH.wxyz, MOVES), rel=1e-9)
        assert found.judged.pairs == len(found.errors) == MOVES.sum()
        assert np.array_equal(found.judged.ranges_ns, absolute)
        assert found.matching.matched == len(T_NS)


def test_pairs_that_are_not_judged_change_nothing():
    """Not the worst sample, nor a cause, nor an alignment by what is judged; B is covered."""
    wrong = np.where(MOVES[:, None], noisy().wxyz, exp([1.0, 2.0, 0.5]))
    for align in ("none", "first", "yaw", "mean"):
        options = {"align": align, "judge": PHASES, "tol": "1deg", "min_coverage": 99}
        options["align_range"] = "judged"
        a, b = (compare(AttitudeSeries(T_NS, q), TRUTH, **options) for q in (wrong, noisy().wxyz))
        assert a.error_rad == b.error_rad
        assert (a.worst, a.first_exceeding, a.likely_cause) == (
            b.worst, b.first_exceeding, b.likely_cause)  # fmt: skip
        assert MOVES[a.worst.index]
        assert a.criteria[-1].passed


@given(
    align=st.sampled_from(["first", "yaw", "mean", "mount"]),
    jump=st.floats(-0.4, 0.4),
    begin=st.integers(0, 150),
    count=st.integers(20, 50),
)
@settings(max_examples=12, deadline=None)
def test_judged_errors_are_those_of_an_alignment_by_all_pairs(align, jump, begin, count):
    """A part that is off by half a radian was aligned by itself, and had no error."""
    heading = np.where(np.arange(len(T_NS)) < 100, 0.0, jump)[:, None] * [0, 0, 1]
    a = AttitudeSeries(T_NS, multiply(exp(heading), TRUTH.wxyz))
    ranges = [(int(T_NS[begin]), int(T_NS[begin + count - 1]))]
    part = slice(begin, begin + count)
    whole, found = (compare(a, TRUTH, align=align, judge=judge) for judge in ([], ranges))
    assert np.array_equal(found.errors, whole.errors[part])
    assert np.array_equal(found.alignment.reference_wxyz, whole.alignment.reference_wxyz)
    own, cut = (
        compare(a, TRUTH, align=align, judge=ranges, align_range="judged"),
        compare(a[part], TRUTH[part], align=align),
    )
    assert own.errors == pytest.approx(cut.errors, abs=1e-12)


def test_by_which_pairs_is_stated(tmp_path):
    """In the text and in JSON, whichever it is."""
    a = write_attitudes(tmp_path / "a.csv", T_NS, noisy().wxyz)
    b = write_attitudes(tmp_path / "b.csv", T_NS, TRUTH.wxyz)
    words = "compare", a, b, "--align", "mean", "--judge", PHASES
    for name, by in (("all", "all of them"), ("judged", "those judged")):
        chosen = *words, "--align-range", name
        assert f"100 of them, in 3 time ranges; B is aligned by {by}\n" in run(*chosen).stdout
        report = json.loads(run(*chosen, "--json").stdout)
        assert report["alignment"]["range"] == name
        assert report["judged"]["pairs"] == 100


def test_command_and_suite(tmp_path):
    """An option, a key and JSON; a file is not compared while it is read."""
    a = write_attitudes(tmp_path / "a.csv", T_NS, noisy().wxyz)
    b = write_attitudes(tmp_path / "b.csv", T_NS, TRUTH.wxyz)
    shown = run("compare", a, b, "--judge", PHASES).stdout
    assert "judged    100 of them, in 3 time ranges\n" in shown
    result = json.loads(run("compare", a, b, "--judge", PHASES, "--json").stdout)
    assert result["judged"]["ranges_ns"][0] == [SECOND // 2, 1_480_000_000]
    for name in ("coning.truth.csv", "coning.mcap"):
        shutil.copy(SAMPLE_LOGS / name, tmp_path)
    case = TRUTH_CASE.replace("logs/", "")
    judged = f'{case}judge = ["+1s..+2s", "+3s..-1s"]\nalign-range = "judged"\n'
    assert check(pinned(tmp_path, judged)).exit_code == 0
    outside = check(write_suite(tmp_path, f'{case}judge = "+1h..+2h"\n'))
    assert "no pair of attitudes is in the time ranges of judge;" in outside.output


@pytest.mark.parametrize("left", [0, 1])
def test_a_range_in_a_gap_of_the_reference_is_judged(left):
    """With no sample of the reference in it, the cause of the error was an internal error."""
    inside = np.flatnonzero((T_NS > SECOND) & (T_NS < 3 * SECOND))
    gap = TRUTH[np.delete(np.arange(len(T_NS)), inside[left:])]
    options = {"match": "interpolate", "max_dt": 3, "judge": "1.01s..2.5s"}
    found = compare(noisy()[::2], gap, **options)
    assert found.judged.pairs == 37
    assert found.likely_cause is None
    assert found.coverage.time == 100


@pytest.mark.parametrize(
    ("judge", "error", "message"),
    [
        (
            "+1s",
            UsageError,
            r"judge: '\+1s' is not a time range; write START\.\.END, as \+10",
        ),
        ("+1s..", UsageError, "judge: '' is "),
        (["+1s", "+2s"], UsageError, r"judge: '\+1s' is not a time range"),
        (5, UsageError, "judge: '5' is not a time range"),
        (
            "+2s..+1s",
            UsageError,
            r"judge='\+2000000000ns\.\.\+10*ns' ends 1 s before it beg",
        ),
        ("+5s..+6s", ComparisonError, "no pair of attitudes is in the time ranges of judge; the "),
    ],
)
def test_invalid_ranges_are_refused(judge, error, message):
    """The error is one sentence about the range."""
    with pytest.raises(error, match=message):
        compare(noisy(), TRUTH, judge=judge)
