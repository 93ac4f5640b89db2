"""Criteria of a comparison: each judged by itself and named in the verdict, and coverage too."""

import json

import numpy as np
import pytest
from make.commands import refused, run
from make.tables import write_attitudes
from scipy.spatial.transform import Rotation

from quatprop.base.errors import UsageError
from quatprop.comparison.comparison import compare
from quatprop.kinematics.series import AttitudeSeries
from quatprop.settings.command_options import ComparisonSettings, angle_rad, comparison_settings

STEP_NS = 10_000_000
T_NS = 1_700_000_000_000_000_000 + STEP_NS * np.arange(2001)
SECONDS = STEP_NS * 1e-9 * np.arange(2001)
DEG = np.radians(1.0)


def series(angles_deg, t_ns=T_NS):
    """Return rotations about x by angles in deg."""
    vectors = np.radians(angles_deg)[:, None] * [[1.0, 0.0, 0.0]]
    return AttitudeSeries(t_ns, Rotation.from_rotvec(vectors).as_quat(scalar_first=True))


REST = series(np.zeros(2001))
RAMP = series(SECONDS / 20 * 2)
"""An error that grows to 2 deg in 20 s: RMS 2/sqrt(3), 95 % 1.9, 0.1 deg a second, 360 deg/h."""


def criteria(comparison):
    """Return setting -> value, limit and whether it passed."""
    return {one.setting: (one.value, one.limit, one.passed) for one in comparison.criteria}


@pytest.mark.parametrize(
    ("setting", "value", "options"),
    [
        ("tol", 2 * DEG, {}),
        ("rms_tol", 2 / np.sqrt(3) * DEG, {}),
        ("final_tol", 2 * DEG, {}),
        ("p95_tol", 1.9 * DEG, {}),
        ("window_tol", 0.1 * DEG, {"window": 10**9}),
        ("window_rms_tol", 0.1 * DEG, {"window": 10**9}),
        ("drift_tol", 360.0, {}),
    ],
)
def test_each_criterion_passes_at_its_value_and_fails_below_it(setting, value, options):
    """Limits 1 % above and below the true value decide, and the verdict has value and limit."""
    for factor, passed in ((1.01, True), (0.99, False)):
        settings = ComparisonSettings(**{setting: factor * value}, **options)
        comparison = compare(RAMP, REST, settings)
        found, limit, verdict = criteria(comparison)[setting]
        assert found == pytest.approx(value, rel=1e-3)
        assert (limit, verdict, comparison.passed) == (factor * value, passed, passed)
    assert compare(RAMP, REST, ComparisonSettings(**{setting: found}, **options)).passed


def test_drift_counts_in_both_directions():
    """An error that shrinks is a drift, too."""
    comparison = compare(series(2 - SECONDS / 20 * 2), REST, ComparisonSettings(drift_tol=300))
    assert comparison.drift_deg_h == pytest.approx(-360, rel=1e-6)
    assert not comparison.passed


def test_samples_that_are_gone_count():
    """A tenth of the samples covers a tenth of the reference, though it has all of its time."""
    thin = AttitudeSeries(REST.t_ns[::10], REST.wxyz[::10])
    comparison = compare(thin, REST, ComparisonSettings(match="exact", min_coverage=98))
    assert comparison.coverage.time == pytest.approx(100)
    assert comparison.coverage.samples == pytest.approx(100 * 201 / 2001)
    assert criteria(comparison)["min_coverage"] == (comparison.coverage.samples, 98, False)
    assert compare(thin, REST, ComparisonSettings(match="exact", min_coverage=10)).passed


@pytest.mark.parametrize("kept", [np.r_[:1800], np.r_[200:2001], np.r_[:500, 700:2001]])
def test_time_that_is_gone_counts(kept):
    """A recording that begins late, ends early, or has a gap covers nine tenths."""
    short = AttitudeSeries(REST.t_ns[kept] + 1, REST.wxyz[kept])
    comparison = compare(short, REST, ComparisonSettings(min_coverage=95))
    assert comparison.coverage.time == pytest.approx(90, abs=0.1)
    assert not comparison.passed


def test_a_longer_recording_covers_everything():
    """Attitudes outside the reference do not count."""
    reference = AttitudeSeries(REST.t_ns[500:1500], REST.wxyz[500:1500])
    comparison = compare(REST, reference, ComparisonSettings(min_coverage=100))
    assert (comparison.coverage.time, comparison.coverage.samples) == (100, 100)
    assert comparison.passed


ANGLES = {
    "1e-9rad": 1e-9,
    "2mrad": 2e-3,
    "0.1deg": np.radians(0.1),
    ".5 deg": np.radians(0.5),
    "6 arcmin": np.radians(0.1),
    "36arcsec": np.radians(0.01),
}


def test_angles_have_the_units_of_data_sheets():
    """Radians, degrees and their parts; a bare number, or what is none, is not guessed at."""
    for text, rad in ANGLES.items():
        assert angle_rad(text) == pytest.approx(rad, rel=1e-15)
    for text in ("0.1", "deg", "-1deg", "nanrad", "1 grad", "\u0661deg"):
        with pytest.raises(
            UsageError, match=r"is not an angle; write a number with its unit, such"
        ):
            angle_rad(text)
    with pytest.raises(UsageError, match=r"^'1e999rad' is larger than an angle can be$"):
        angle_rad("1e999rad")


def test_drifts_have_units():
    """Degrees an hour, degrees a second, radians a second."""
    for text, deg_h in (("10deg/h", 10), ("0.1 deg/s", 360), ("1e-3rad/s", np.degrees(3.6))):
        assert comparison_settings(drift_tol=text).drift_tol == pytest.approx(deg_h, rel=1e-12)
    with pytest.raises(UsageError, match=r"^drift_tol: '10' is not a drift; write .* 10deg/h$"):
        comparison_settings(drift_tol="10")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return tables of RAMP and REST."""
    folder = tmp_path_factory.mktemp("criteria")
    series = {"a.csv": RAMP, "b.csv": REST}
    return [write_attitudes(folder / name, one.t_ns, one.wxyz) for name, one in series.items()]


@pytest.mark.parametrize("align", ["mean", "mount"])
def test_a_drift_is_not_judged_after_an_alignment_by_all_pairs(files, align):
    """The error of RAMP falls to its middle and then rises, so its slope means nothing."""
    sentence = (
        f"drift_tol needs align='none' or 'first': an alignment by all pairs (align={align!r}) "
        "removes part of the drift"
    )
    with pytest.raises(UsageError) as error:
        comparison_settings(drift_tol="10deg/h", align=align)
    assert str(error.value) == sentence
    told = refused("compare", *files, "--align", align, "--drift-tol", "10deg/h")
    options = sentence.replace("drift_tol", "--drift-tol").replace(
        "align='none' or 'first'", "--align none|first"
    )
    assert told.endswith(options.replace(f"align={align!r}", f"--align {align}"))


def test_an_alignment_by_all_pairs_leaves_no_drift_to_show(files):
    """Neither the text nor the JSON has one."""
    shown = run("compare", *files, "--align", "mean").stdout
    assert "\nerror " in shown
    assert "\ndrift " not in shown
    assert compare(RAMP, REST, ComparisonSettings(align="mean")).drift_deg_h is None


def test_the_command_line_names_each_criterion(files):
    """Every criterion has its line, and its entry in the JSON."""
    limits = ["--tol", "3deg", "--rms-tol", "1deg", "--final-tol", "2.1deg", "--p95-tol", "2deg",
              "--window", "1s", "--window-tol", "0.2deg", "--window-rms-tol", "0.05deg",
              "--drift-tol", "400deg/h", "--min-coverage", "99"]  # fmt: skip
    shown = run("compare", *files, *limits, code=1).stdout
    windows = "0.00174533 rad (0.1 deg)"
    assert [line for line in shown.splitlines() if line.startswith(("passed", "failed"))] == [
        "passed    no error above the tolerance 0.0523599 rad (3 deg)",
        "failed    RMS error 0.0201558 rad (1.15484 deg), at most 0.0174533 rad (1 deg)",
        "passed    final error 0.0349066 rad (2 deg), at most 0.0366519 rad (2.1 deg)",
        "passed    95 % error 0.0331613 rad (1.9 deg), at most 0.0349066 rad (2 deg)",
        f"passed    worst error over windows {windows}, at most 0.00349066 rad (0.2 deg)",
        f"failed    RMS error over windows {windows}, at most 0.000872665 rad (0.05 deg)",
        "passed    drift +360 deg/h, at most 400 deg/h",
        "passed    coverage 100 % of the time and 100 % of the samples of B, at least 99 %",
    ]
    report = json.loads(run("compare", *files, *limits, "--json").stdout)
    failed = [one["setting"] for one in report["criteria"] if not one["passed"]]
    assert failed == ["rms_tol", "window_rms_tol"]
