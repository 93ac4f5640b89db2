"""Errors that are put into a series come out as themselves, and so do their causes."""

import json
import re
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from make.commands import run
from make.tables import write_attitudes
from scipy.spatial.transform import Rotation

from quatprop.base.errors import ComparisonError
from quatprop.comparison.clock_offset import coarse_offset
from quatprop.comparison.comparison import compare
from quatprop.kinematics.series import AttitudeSeries
from quatprop.kinematics.time_series import BLOCK
from quatprop.settings.command_options import ComparisonSettings

SAMPLES = 2000
STEP_NS = 10_000_000
FIRST_NS = 1_700_000_000_000_000_000
T_NS = FIRST_NS + STEP_NS * np.arange(SAMPLES)
SECONDS = STEP_NS * 1e-9 * np.arange(SAMPLES)
EXACT = 1e-9


def rotations(wxyz):
    """Return rotations of an independent library."""
    return Rotation.from_quat(wxyz, scalar_first=True)


def series(rotation, t_ns=T_NS):
    """Return rotations as a series."""
    return AttitudeSeries(t_ns, rotation.as_quat(scalar_first=True))


def motion(t_s):
    """Return attitudes of a body that turns about all axes and never repeats itself."""
    angles = [
        sum(np.sin(f * t_s + phase) for f, phase in pairs)
        for pairs in (
            ((0.7, 0.0), (2.13, 1.0), (5.1, 0.3)),
            ((0.9, 0.5), (1.71, 2.0), (4.3, 0.1)),
            ((0.4, 1.5), (2.93, 0.2), (3.7, 2.2)),
        )
    ]
    return Rotation.from_euler("ZYX", np.stack(angles, axis=1) * [0.8, 0.5, 0.9])


TRUE = motion(SECONDS)
A = series(TRUE)
TURN = Rotation.from_rotvec([0.1, 0.2, -0.05])
TURN_RAD = float(TURN.magnitude())


def multiplied(steps, *, left=False):
    """Multiply rotation vectors up one by one, on the right or on the left."""
    each = [TRUE[0].as_matrix(), *Rotation.from_rotvec(steps).as_matrix()]
    product = accumulate(each, (lambda all_, step: step @ all_) if left else np.matmul)
    return Rotation.from_matrix(list(product))


FIRST, LAST = TRUE.as_quat(scalar_first=True), TRUE.as_quat(scalar_first=False)
CONJUGATE = np.array([-1, -1, -1, 1])
"""Signs of a conjugate, scalar-last."""

STEPS = (TRUE[:-1].inv() * TRUE[1:]).as_rotvec()


@pytest.mark.parametrize("count", [41, 20_002])
def test_statistics_are_those_of_numpy(count):
    """For errors in any order at any times, an odd and an even number of them."""
    random = np.random.default_rng(7)
    t_ns = FIRST_NS + np.cumsum(random.integers(1, 10**9, count))
    errors = random.permutation(np.linspace(0.01, 0.4, count))
    other = series(Rotation.from_rotvec(errors[:, None] * [0.6, 0, 0.8]), t_ns)
    found = compare(series(Rotation.identity(count), t_ns), other, ComparisonSettings(tol=1.0))
    expected = {
        "max": 0.4,
        "rms": np.sqrt(np.mean(errors**2)),
        "mean": errors.mean(),
        "median": np.median(errors),
        "p95": np.percentile(errors, 95),
        "final": errors[-1],
    }
    assert found.error_rad._asdict() == pytest.approx(expected, rel=1e-12)
    slope, _ = np.polyfit((t_ns - FIRST_NS) / 3.6e12, np.degrees(errors), 1)
    assert found.drift_deg_h == pytest.approx(slope, rel=1e-6)
    assert (found.worst.index, found.worst.at) == (np.argmax(errors), "A")


@pytest.mark.parametrize("align", ["none", "first"])
def test_error_vectors_are_about_the_body_axes(align):
    """They turn B, once aligned, into A; q and -q are the same attitude."""
    errors = 0.02 * np.sin(np.outer(SECONDS, [0.3, 0.5, 0.7]))
    signs = np.where(np.arange(SAMPLES) % 3, 1.0, -1.0)[:, None]
    reference = (TURN * TRUE if align == "first" else TRUE).as_quat(scalar_first=True)
    result = compare(
        series(TRUE * Rotation.from_rotvec(errors)),
        AttitudeSeries(T_NS, reference * signs),
        ComparisonSettings(align=align),
    )
    np.testing.assert_allclose(result.error_vectors, errors, atol=1e-12)


def test_a_series_has_no_error_against_itself():
    """All figures are zero to rounding, and nothing is to be explained."""
    found = compare(A, A)
    assert found.error_rad.max < 1e-15
    assert abs(found.drift_deg_h) < 1e-9
    assert found.matching.matched == SAMPLES
    assert (found.likely_cause, found.remarks, found.first_exceeding) == (None, (), None)
    # To compare two comparisons was an error about the truth of arrays.
    assert {found, replace(found)} > {found}


@pytest.mark.parametrize(
    ("turned", "cause"), [(TURN * TRUE, "reference frame"), (TRUE * TURN, "body frame")]
)
def test_a_constant_rotation_is_its_angle_everywhere(turned, cause):
    """Every figure of the error is the angle, the drift is none, and the frame is named."""
    found = compare(A, series(turned))
    for name in ("max", "rms", "mean", "median", "p95", "final"):
        assert getattr(found.error_rad, name) == pytest.approx(TURN_RAD, abs=EXACT)
    assert found.drift_deg_h == pytest.approx(0.0, abs=1e-6)
    assert found.likely_cause.name == cause
    assert f"{np.degrees(TURN_RAD):.6g} deg" in found.likely_cause.sentence


@pytest.mark.parametrize("align", ["first", "mean", "mount"])
def test_other_frames_can_be_aligned(align):
    """The first sample, the mean and the motion all find the rotations that were put in."""
    reference = Rotation.from_rotvec([0.3, 2.0, 0.1])
    other = reference * TRUE * TURN if align == "mount" else reference * TRUE
    found = compare(A, series(other), ComparisonSettings(align=align))
    assert found.error_rad.max < EXACT
    assert (rotations(found.alignment.reference_wxyz) * reference).magnitude() < EXACT
    if align == "mount":
        assert (rotations(found.alignment.mount_wxyz) * TURN).magnitude() < EXACT
        assert found.alignment.mounting.std_rad < EXACT


@pytest.mark.parametrize(("left", "frame"), [(False, "body"), (True, "reference")])
def test_a_ramp_is_its_drift(left, frame):
    """An error that grows by 100 deg/h has that drift, and is largest at the end."""
    ramp = Rotation.from_rotvec(np.radians(100) / 3600 * SECONDS[:, None] * [[0.6, 0, 0.8]])
    found = compare(A, series(ramp * TRUE if left else TRUE * ramp))
    assert found.drift_deg_h == pytest.approx(100, abs=1e-6)
    assert found.error_rad.final == pytest.approx(np.radians(100) / 3600 * SECONDS[-1], abs=EXACT)
    assert found.worst.index == SAMPLES - 1
    assert found.likely_cause.name == "drift"
    assert found.likely_cause.sentence.startswith(
        f"B drifts away at a steady 100 deg/h about an axis fixed in the {frame} frame;"
    )
    assert found.likely_cause.remedy.startswith("turn B back by 60, 0, 80 deg/h about the axes")


def test_signs_are_no_error():
    """If B is -A there is no error, and a remark explains the sign."""
    sign = np.where(np.arange(SAMPLES) % 3, 1.0, -1.0)
    found = compare(A, AttitudeSeries(T_NS, A.wxyz * sign[:, None]), ComparisonSettings(tol=1e-12))
    assert found.passed
    (remark,) = found.remarks
    assert remark.startswith("B has the opposite sign in 667 of 2000 samples: q and -q are the")


@pytest.mark.parametrize(
    ("count", "wrong", "is_named"), [(2000, 20, True), (2000, 21, False), (20, 1, True)]
)
def test_a_hundredth_of_the_samples_may_be_isolated(count, wrong, is_named):
    """One in any case; more are no exceptions."""
    wxyz = A.wxyz[:count].copy()
    wxyz[5 : 5 + wrong] = (TRUE[5 : 5 + wrong] * TURN).as_quat(scalar_first=True)
    cause = compare(A[:count], AttitudeSeries(T_NS[:count], wxyz)).likely_cause
    assert (cause is not None and cause.name == "isolated samples") == is_named


def test_one_bad_sample_is_found():
    """It is the worst, its error is what was put in, and the first above the tolerance."""
    wxyz = A.wxyz.copy()
    wxyz[77] = (TRUE[77] * Rotation.from_rotvec([0.02, 0, 0])).as_quat(scalar_first=True)
    found = compare(A, AttitudeSeries(T_NS, wxyz), ComparisonSettings(tol=1e-3))
    assert found.worst == found.first_exceeding
    assert (found.worst.index, found.worst.t_ns) == (77, T_NS[77])
    assert found.worst.error_rad == pytest.approx(0.02, abs=EXACT)
    assert found.error_rad.median < EXACT
    assert found.likely_cause.name == "isolated samples"
    assert found.likely_cause.sentence.startswith("1 of 2000 samples carry the error")


@pytest.mark.parametrize(("order", "dead", "other"), [(1, "A", "B"), (-1, "B", "A")])
@pytest.mark.parametrize("rate", [0, 0.5])
def test_a_series_of_constant_rate_next_to_one_that_turns_is_remarked_on(order, dead, other, rate):
    """A gyroscope that is dead or frozen explains more than any mistake."""
    steady = series(Rotation.from_rotvec(SECONDS[:, None] * [0, 0, rate]))
    assert compare(*(steady, A)[::order]).remarks == (
        f"{dead} turns at a constant rate and {other} does not: is {dead} a placeholder?",
    )


@pytest.mark.parametrize("epoch", [0, 12_345_678_901_234_567])
def test_a_time_shift_is_found(epoch):
    """Correlating angular speeds finds the offset of two clocks to a millionth of a sample."""
    late = AttitudeSeries(T_NS + 7_300_000 + epoch, A.wxyz)
    found = compare(A, late, ComparisonSettings(time_offset="auto"))
    assert found.time_offset.added_to_b_ns == pytest.approx(-7_300_000 - epoch, abs=10)
    assert found.time_offset.found.correlation > 0.999999
    assert found.error_rad.max < 1e-6
    # With the offset that was put in, stamps are equal again and nothing is interpolated.
    found = compare(A, late, ComparisonSettings(time_offset=-7_300_000 - epoch))
    assert found.matching.match == "exact"
    assert found.error_rad.max < 1e-15


@pytest.mark.parametrize("offset_ns", [0, 7_300_000])
def test_series_that_begin_at_other_times_are_of_one_clock(offset_ns):
    """Correlation finds the offset to the ns where it is a whole number of its steps, 50 ms."""
    later = AttitudeSeries(T_NS[100:] - offset_ns, A.wxyz[100:])
    for pair, sign in (((A, later), 1), ((later, A), -1)):
        coarse, runner_up = coarse_offset(*pair)
        assert coarse == sign * offset_ns
        assert 0 < runner_up < 0.9


def test_short_series_are_correlated_in_200_steps():
    """Here of 10 ms, so that correlation finds a lag of 30 ms to the ns."""
    t_ns = 1_000_000 * np.arange(2031)
    fast = series(motion(t_ns * 1e-9), t_ns)
    assert coarse_offset(fast, fast[30:])[0] == 0


def test_the_correlation_is_that_of_the_angular_speeds():
    """A sine of 4 s in B's speed is independent of those of 20 s and 10 s, over whole periods."""

    def angle(*parts):
        waves = (a / w * (1 - np.cos(w * SECONDS)) for a, w in parts)
        return (2 * SECONDS + sum(waves))[:, None] * [0, 0, 1]

    both = [(0.6, 0.1 * np.pi), (0.3, 0.2 * np.pi)]
    pair = (series(Rotation.from_rotvec(angle(*both, *own))) for own in ([], [(0.3, np.pi / 2)]))
    found = compare(*pair, ComparisonSettings(time_offset="auto")).time_offset
    common = 0.6**2 + 0.3**2
    expected = np.sqrt(common / (common + 0.3**2))
    assert found.found.correlation == pytest.approx(expected, abs=1e-3)


def test_a_second_and_a_half_of_motion_shows_an_offset():
    """A share of a short time is left free at each end, not half a second."""
    late = AttitudeSeries(T_NS[:150] + 7_300_000, A.wxyz[:150])
    found = compare(A[:150], late, ComparisonSettings(time_offset="auto")).time_offset
    assert found.added_to_b_ns == pytest.approx(-7_300_000, abs=10)


def test_the_offset_of_two_frames_and_rates_is_found():
    """Neither frames, nor other sample rates, nor six decimals hide the offset or the mounting."""
    t_s = SECONDS[::3] + 0.004
    other = Rotation.from_rotvec([0.3, 2.0, 0.1]) * motion(t_s) * TURN
    coarse = AttitudeSeries(T_NS[::3], other.as_quat(scalar_first=True).round(6))
    found = compare(A, coarse, ComparisonSettings(align="mount", time_offset="auto"))
    assert found.matching.at == "B"
    assert found.time_offset.added_to_b_ns == pytest.approx(4_000_000, abs=100_000)
    assert (rotations(found.alignment.mount_wxyz) * TURN).magnitude() < 1e-4
    assert found.error_rad.max < 2e-3


def test_the_summary_shows_how_certain_an_estimate_is(tmp_path):
    """It has the uncertainties of offset and mounting, and the axes about which the body turns."""
    other = motion(SECONDS[::3] + 0.004) * TURN
    a = write_attitudes(tmp_path / "a.csv", T_NS, A.wxyz)
    b = write_attitudes(tmp_path / "b.csv", T_NS[::3], other.as_quat(scalar_first=True))
    shown = run("compare", a, b, "--align", "mount", "--time-offset", "auto", code=0).stdout
    offset = r"offset    (4|3.9+|4.0+\d*) ms added to B's timestamps \+- [\d.]+ [nu]s, estimated "
    assert re.search(
        f"{offset}from angular speeds: correlation 1.0000, next best elsewhere 0.", shown
    )
    assert re.search(
        r"rotations of [\d.]+ deg \(RMS\), their axes in the ratio 1 : 0\.\d+ : 0\.\d+; \+- ", shown
    )


@pytest.mark.parametrize(
    ("a", "b", "sentence"),
    [
        (A[:16], A[:16], "can be estimated from 16 intervals or more, and one of the series is"),
        (A[:20], A[:20], "A and B have too few windows of common motion to estimate a time offset"),
        (A, series(motion(100 + 1.3 * SECONDS)), r"correlate at no time offset \(at best 0\.\d+\)"),
        (series(Rotation.identity(SAMPLES)), A, "the speed of A is constant, which shows no"),
        (series(motion(SECONDS % 5)), series(motion(SECONDS % 5)), "the motion repeats itself: "),
    ],
)
def test_offsets_that_the_motion_does_not_show_are_refused(a, b, sentence):
    """The remedy is to give the offset."""
    with pytest.raises(
        ComparisonError, match=f"{sentence}.*give the offset with time_offset='DUR'"
    ):
        compare(a, b, ComparisonSettings(time_offset="auto"))


BIAS = np.radians([36, 72, 0]) / 3600 * 0.01
MISREAD = {
    "conjugate": (TRUE.inv(), "conjugate", ""),
    # Rotations over windows do not depend on the reference frame.
    "conjugate in another frame": ((TURN * TRUE).inv(), "conjugate", ""),
    "last as first": (rotations(LAST), "layout", ""),
    "first as last": (rotations(FIRST[:, [3, 0, 1, 2]]), "layout-first", ""),
    "last as first, conjugate": (rotations(LAST * CONJUGATE), "layout and conjugate", ""),
    "first as last, conjugate": (
        rotations((FIRST * CONJUGATE[[3, 0, 1, 2]])[:, [3, 0, 1, 2]]),
        "layout-first and conjugate",
        "",
    ),
    "wrong side": (multiplied(STEPS, left=True), "side", "treats the rates as body-frame"),
    "factor": (multiplied(2 * STEPS), "scale", "2 times as fast as A: a factor 1/2 is missing"),
    "degrees": (
        multiplied(np.radians(STEPS)),
        "scale",
        "0.0174533 times as fast as A: one of them took degrees for radians",
    ),
    "bias": (multiplied(STEPS + BIAS), "rate bias", "minus A's are a constant 36, 72, "),
}
"""Attitudes with a mistake, the cause that is named, and what its sentence says."""

NEARLY_EXACT = 1e-7
"""rad: numbers in remedies have six digits."""


@pytest.mark.parametrize(("wrong", "cause", "words"), MISREAD.values(), ids=MISREAD)
def test_mistakes_are_named_and_their_error_is_the_angle(wrong, cause, words):
    """A conjugate (or JPL numbers), both wrong layouts, and what propagation may get wrong."""
    layout = "scalar-last" if cause.startswith("layout-first") else None
    found = compare(A, replace(series(wrong), read_layout=layout))
    errors = (TRUE.inv() * wrong).magnitude()
    assert found.error_rad.max == pytest.approx(errors.max(), abs=EXACT)
    assert found.error_rad.rms == pytest.approx(np.sqrt((errors**2).mean()), abs=EXACT)
    assert found.likely_cause.name == cause
    assert words in found.likely_cause.sentence
    assert (found.likely_cause.also or found.likely_cause).rms_after < NEARLY_EXACT


def test_only_errors_with_a_pattern_that_matter_are_explained():
    """Noise has no cause, and none is looked for where the comparison passes."""
    noise = Rotation.from_rotvec(np.random.default_rng(1).normal(size=(SAMPLES, 3)) * 0.01)
    assert compare(A, series(TRUE * noise)).likely_cause is None
    found = compare(A, series(TURN * TRUE), ComparisonSettings(tol=1.0))
    assert (found.passed, found.likely_cause) == (True, None)
    # Fewer than ten attitudes are explained by almost anything.
    for count in (9, 10):
        few = compare(A[:count], series(TURN * TRUE)[:count])
        assert (few.likely_cause is not None) == (count == 10)


def test_windows_see_neither_frames_nor_drift_before_them():
    """Over a window of 1 s an error that grows by 0.01 rad/s is 0.01 rad, wherever it stands."""
    ramp = Rotation.from_rotvec(0.01 * SECONDS[:, None] * [[0, 0, 1]])
    found = compare(A, series(TURN * TRUE * ramp), ComparisonSettings(window=1_000_000_000))
    assert found.window.count == SAMPLES - 100
    assert found.window.rms_rad <= found.window.max_rad
    # The axis of the ramp is turned by the body's own turn over the window.
    exact = TRUE[:-100].inv() * TRUE[100:]
    drifted = (TRUE * ramp)[:-100].inv() * (TRUE * ramp)[100:]
    errors = (exact.inv() * drifted).magnitude()
    assert found.window.max_rad == pytest.approx(errors.max(), abs=EXACT)
    assert found.window.worst_ns == T_NS[np.argmax(errors)]


def test_windows_that_end_in_a_gap_are_left_out():
    """Those that end late by more than an interval; by one, as in a gap of one sample, they do."""
    kept = np.delete(np.arange(SAMPLES), [*range(500, 530), 700])
    found = compare(A[kept], A[kept], ComparisonSettings(window=1_000_000_000))
    late = [kept[kept >= row + 100].min(initial=2 * SAMPLES) - row - 100 for row in kept]
    assert found.window.begins_ns.tolist() == T_NS[kept[np.array(late) <= 1]].tolist()


def test_the_report_is_json():
    """The report of everything goes into JSON and back without a change."""
    settings = ComparisonSettings(
        align="mount", time_offset="auto", window=10**9, tol=1e-9, match="interpolate"
    )
    report = compare(A, series(TRUE.inv()), settings).report()
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert report["passed"] is False


def test_series_that_cannot_be_compared_are_refused():
    """Zeros and NaN are located and counted; nothing, and windows that do not fit, are named."""
    for bad in ([0, 0, 0, 0], [np.nan, 0, 0, 1]):
        wxyz = A.wxyz.copy()
        wxyz[5] = wxyz[9] = bad
        sentence = (
            r"^B has 2 of 2000 rows that are not attitudes \(zero or not a number\), the first at "
            r"index 5; omit them$"
        )
        with pytest.raises(ComparisonError, match=sentence):
            compare(A, AttitudeSeries(T_NS, wxyz))
    with pytest.raises(ComparisonError, match=r"^B has no attitudes; check what was selected$"):
        compare(A, AttitudeSeries(T_NS[:0], A.wxyz[:0]))
    sentence = r"^no two pairs are 60 s apart: they span 19.99 s; choose a shorter window$"
    with pytest.raises(ComparisonError, match=sentence):
        compare(A, A, ComparisonSettings(window=60_000_000_000))


def test_timestamps_are_put_in_order():
    """Backward steps and repetitions are repaired, counted and reported."""
    order = np.arange(SAMPLES)
    order[[10, 11]] = [11, 10]
    order[20] = 19
    found = compare(A, AttitudeSeries(T_NS[order], A.wxyz[order]))
    assert found.error_rad.max < 1e-15
    assert found.matching.matched == SAMPLES - 1
    (remark,) = found.remarks
    assert remark == (
        "B was sorted by time: its timestamps step back 1 time; 1 repeated timestamp of B omitted, "
        "0 with a different attitude"
    )
    assert found.omitted_duplicates == 0
    # A repeated timestamp of another attitude is a loss, in either series.
    twice = AttitudeSeries(T_NS[np.r_[:50, 49]], A.wxyz[:51])
    assert compare(twice, twice).omitted_duplicates == 2


def test_other_lengths_are_normalised_and_reported():
    """Quaternions of length 2 are the same attitudes."""
    found = compare(A, AttitudeSeries(T_NS, 2 * A.wxyz))
    assert found.error_rad.max < 1e-15
    assert found.remarks == ("B is not of unit length, by up to 1; normalised",)


@pytest.mark.parametrize("piece", [7, 50, 101])
def test_statistics_do_not_depend_on_the_pieces_in_which_they_are_computed(monkeypatch, piece):
    """Also where the last of them is full."""
    angles = np.linspace(0, 1, 100) ** 2
    turned = Rotation.from_rotvec(np.outer(angles, [0, 0, 1]))
    other = AttitudeSeries(np.arange(100) * 10**9, turned.as_quat(scalar_first=True))
    still = AttitudeSeries(other.t_ns, np.tile([1.0, 0, 0, 0], (100, 1)))
    monkeypatch.setattr("quatprop.comparison.statistics.PIECE", piece)
    found = compare(still, other).error_rad
    exact = angles.mean(), np.sqrt((angles**2).mean()), 1.0
    assert (found.mean, found.rms, found.final) == pytest.approx(exact, rel=1e-12)


def test_long_series_are_compared_to_their_ends():
    """Errors and signs count in every block that is computed apart, and so does the last row."""
    rows = 2 * BLOCK + 3
    wxyz = np.tile([2.0, 0.0, 0.0, 0.0], (rows, 1))
    other = np.tile([-1.0, 0.0, 0.0, 0.0], (rows, 1))
    for row, angle in ((0, 0.01), (BLOCK, 0.02), (rows - 1, 0.03)):
        other[row] = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
    t_ns = np.arange(rows)
    found = compare(AttitudeSeries(t_ns, wxyz), AttitudeSeries(t_ns, other))
    assert np.flatnonzero(found.errors).tolist() == [0, BLOCK, rows - 1]
    assert found.errors[[0, BLOCK, -1]] == pytest.approx([0.01, 0.02, 0.03], rel=1e-12)
    assert found.remarks[-1].startswith(f"B has the opposite sign in {rows - 3} of {rows} samples")
