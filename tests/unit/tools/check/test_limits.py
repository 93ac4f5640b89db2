"""Limits: what is left of each, those that are proposed, and what a limit hides."""

import re

import pyarrow.parquet as pq
import pytest
from make.commands import run
from make.suites import TRUTH, check, delay, pinned, repinned, stored, write_suite
from make.tables import write_attitudes, write_rates

from quatprop.tools.check.lock import sha256_of

LIMITS = """\
align = "first"
window = "1s"
window-rms-tol = "0.05deg"
drift-tol = "100deg/h"
min-coverage = 90
"""


def test_every_limit_is_shown_with_its_margin(folder):
    """`window-rms-tol`, which tells most regressions, was not in the line, nor what was left."""
    suite = pinned(folder, TRUTH + LIMITS)
    shown, explained = check(suite).stdout, check(suite, "--explain").stdout
    for label in ("RMS error over windows ", "drift ", "coverage 100 % (minimum 90 %)"):
        assert f"; {label}" in shown
    assert " (limit 0.05 deg, margin " in shown
    assert shown.count(", margin ") == 3
    for key in ("tol 0.1deg", "window-rms-tol 0.05deg", "drift-tol 100deg/h", "min-coverage 90"):
        (line,) = [line for line in explained.splitlines() if key in line.split(": ")[0]]
        assert "when it was pinned" in line
        assert (", margin " in line) == (key != "min-coverage 90")
    alone = TRUTH.replace("tol =", 'window = "1s"\nwindow-rms-tol =')
    assert check(write_suite(folder, alone)).exit_code == 0


@pytest.fixture
def drifting(folder):
    """Give a log with a bias, and its truth, relative to other frames."""
    log = folder / "logs" / "drift.csv"
    motion = ("--motion", "tumbling", "--duration", "20s", "--seed", "3")
    run("simulate", log, *motion, "--noise", "1e-3", code=0)
    return log, folder / "logs" / "drift.truth.csv"


def test_limits_are_proposed_that_find_a_delay(drifting, folder):
    """With `align = "first"` and a tolerance for the drift, 20 ms passed."""
    log, truth = drifting
    suite = folder / "ci.toml"
    result = check(suite, "--init", log, "--reference-log", truth)
    assert result.exit_code == 0, result.output
    text = suite.read_text()
    for key in ("tol", "rms-tol", "window-rms-tol"):
        found = re.search(rf'\n{key} = "(.*)deg"  # (.*) deg is measured: ', text)
        limit, measured = map(float, found.groups())
        assert 1.5 <= limit / measured < 1.6
    assert '\nwindow = "1s"\n' in text
    assert "\nmin-coverage = 99  # 100 % of the reference" in text
    assert check(suite).exit_code == 0
    delay(log, 20_000_000)
    result = check(suite, "--update", "-k", "drift-truth")
    assert result.exit_code == 1
    assert "RMS error over windows " in result.stdout.splitlines()[1]


def test_no_window_is_proposed_for_a_log_of_two_bursts(folder):
    """The suite was refused, and a shorter window advised, which --init does not take."""
    t_ns, truth, suite = [*range(5), 10**10], folder / "refs.csv", folder / "ci.toml"
    log = write_rates(folder / "bursts.csv", [(t, 0, 0, 0) for t in t_ns])
    write_attitudes(truth, t_ns, [(1, 0, 0, 0)] * len(t_ns))
    result = check(suite, "--init", log, "--reference-log", truth)
    assert result.exit_code == 0, result.output
    assert "window" not in suite.read_text()
    assert "\nrms-tol = " in suite.read_text()


BIAS = (
    r"likely \(rate bias\): the reference's body rates minus .*; if the log was propagated, "
    r"propagate it with --bias .*,0\.06999.*rad/s; if the reference was, "
)


@pytest.mark.usefixtures("causes")
@pytest.mark.parametrize(
    ("planted", "cause"),
    [
        (("coning", "--bias", "0,0,0.07"), BIAS),
        (("tumbling",), "they may be of two motions"),
    ],
)
def test_no_limit_is_proposed_for_an_error_that_would_hide_everything(folder, planted, cause):
    """EuRoC without its bias is 69 deg wrong, and got a limit of 110 deg that it passed."""
    log, truth, suite = folder / "wrong.csv", folder / "right.truth.csv", folder / "ci.toml"
    for name, motion in (("wrong", planted), ("right", ("coning",))):
        run("simulate", folder / f"{name}.csv", "--duration", "60s", "--motion", *motion, code=0)
    result = check(suite, "--init", log, "--reference-log", truth)
    assert result.exit_code == 2, result.output
    about = r"wrong\.csv differs from \S+right\.truth\.csv by up to [\d.]+ deg"
    advice = (
        "correct this first, with the options of propagate and compare, or write the case and its "
        "limits yourself"
    )
    assert re.search(
        f"{about}, so no limit would find a regression; {cause}.*; {advice}\n", result.output
    )
    assert not suite.exists()


@pytest.mark.parametrize(
    ("turned", "align", "why"),
    [
        (("--left", "z:40deg"), "mean", "the reference frames are 39."),
        (("--right", "x:2.5deg"), "mount", "the body frames are 2.5"),
        (("--right", "x:1.5deg"), "none", "both are relative to the same frames"),
    ],
)
def test_frames_that_differ_are_aligned_and_reported(drifting, folder, turned, align, why):
    """The limits apply to the remaining error."""
    log, truth = drifting
    run("convert", truth, folder / "refs.csv", *turned, code=0)
    result = check(folder / "ci.toml", "--init", log, "--reference-log", folder / "refs.csv")
    assert result.exit_code == 0, result.output
    (line,) = [line for line in (folder / "ci.toml").read_text().splitlines() if "align" in line]
    assert line.startswith(f'align = "{align}"  # {why}')


@pytest.mark.parametrize(("rows", "code"), [(slice(100), 1), (slice(600), 0)])
@pytest.mark.parametrize("swapped", [False, True])
def test_a_limit_requires_sufficient_coverage(folder, rows, code, swapped):
    """With 90 % of A missing, `compare --tol` passed without a remark."""
    truth = folder / "logs" / "spin.truth.csv"
    head, *lines = truth.read_text().splitlines()
    part = folder / "part.csv"
    part.write_text("\n".join([head, *lines[rows]]) + "\n")
    pair = [truth, part] if swapped else [part, truth]
    assert run("compare", *pair, "-q").exit_code == 0
    result = run("compare", *pair, "--tol", "1deg")
    assert result.exit_code == code, result.output
    assert ("failed" in result.output) == bool(code)
    if code:
        share = "100 % of the time and 100 % of the samples of B and 9.91 % of the time of A"
        assert (share if swapped else "coverage 9.91 % of the time") in result.output
    assert run("compare", *pair, "--tol", "1deg", "--min-coverage", "0").exit_code == 0


def test_the_rotation_that_an_alignment_removes_is_reported(drifting, folder):
    """A delay of 20 ms and swapped axes passed as `0 deg of 0.01 deg`."""
    keys = ("pin-log = false", 'tol = "0.01deg"', 'time-offset = "auto"', 'align = "mount"')
    suite = pinned(folder, stored("drift", "drift.csv", *keys))
    log, _ = drifting
    delay(log, 20_000_000)
    head, *rows = log.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    turned = [f"{t},{x},{-float(y)!r},{-float(z)!r}" for t, x, y, z, *_ in cells]
    log.write_text("\n".join([",".join(head.split(",")[:4]), *turned]) + "\n")
    passed = check(suite)
    assert passed.exit_code == 0
    (moved,) = re.findall("; with the reference timestamps shifted by (.*?) ms; ", passed.stdout)
    (turned_by,) = re.findall(
        "; with the body frame of the reference attitudes rotated by (.*?) deg\n", passed.stdout
    )
    assert float(moved) == pytest.approx(20, abs=0.1)
    assert float(turned_by) == pytest.approx(180, abs=0.01)


def test_a_reference_of_another_origin_fails(folder):
    """With the lock's SHA-256 edited, one without metadata passed; the lock's angles were old."""
    suite = pinned(folder, stored())
    path = folder / "refs/spin.parquet"
    pq.write_table(pq.read_table(path).replace_schema_metadata(None), path)
    repinned(suite, "spin", reference=sha256_of(str(path)))
    result = check(suite)
    assert result.exit_code == 1
    assert "the reference file does not say what it was made from" in result.stdout
