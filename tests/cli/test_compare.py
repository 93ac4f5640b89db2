"""`quatprop compare`: options in, figures and exit code out; real recordings too."""

import json
from contextlib import nullcontext

import numpy as np
import pyarrow.csv
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from make.tables import write_attitudes
from scipy.spatial.transform import Rotation

from quatprop.base.errors import LogError
from quatprop.settings import option
from quatprop.settings.reading import ONE_SERIES

T_NS = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(100)
SPIN = Rotation.from_rotvec(np.arange(100)[:, None] * [[0.01, 0, 0.02]])
EXACT = ("--tol", "1e-9rad")


def write(path, rotation, t_ns=T_NS):
    """Write rotations as a table of attitudes."""
    return write_attitudes(path, t_ns, rotation.as_quat(scalar_first=True))


def report(*arguments):
    """Return the JSON of a comparison that passes."""
    return json.loads(run("compare", *arguments, "--json", code=0).stdout)


@pytest.fixture
def spin(tmp_path):
    """Write a spin."""
    return write(tmp_path / "a.csv", SPIN)


@pytest.fixture
def bumped(tmp_path):
    """Write the spin with 0.1 rad put on sample 30."""
    bump = np.zeros((100, 3))
    bump[30] = [0, 0.1, 0]
    return write(tmp_path / "b.csv", SPIN * Rotation.from_rotvec(bump))


def test_a_file_has_no_error_against_itself(spin):
    """Exit code 0, and every line is there."""
    lines = run("compare", spin, spin, *EXACT, code=0).stdout.splitlines()
    assert lines[0] == (
        f"A         {spin} (csv): qw,qx,qy,qz quatprop, 100 samples over 990 ms; "
        "hamilton body-to-ref, scalar-first"
    )
    assert lines[2] == "matched   100 of 100 samples over 990 ms: equal timestamps"
    names = ["max", "RMS", "mean", "median", "95", "final"]
    assert [line.split()[0] for line in lines[4:10]] == names
    assert lines[-1] == "passed    no error above the tolerance 1e-09 rad (5.72958e-08 deg)"


UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}


@pytest.mark.parametrize("first_s", [0, 1_700_000_000])
@pytest.mark.parametrize("wrong", ["a", "b"])
@pytest.mark.parametrize(
    ("read_as", "unit"),
    [("ns", "us"), ("ns", "ms"), ("ns", "s"), ("us", "ms"), ("us", "s"), ("ms", "s"), ("s", "ms")],
)
def test_times_in_another_unit_are_no_offset(tmp_path, first_s, wrong, read_as, unit):
    """An offset of 1.7e9 s was advised; the setting that is named now mends it as it is printed."""
    if first_s and read_as == "s":
        pytest.skip("milliseconds since 1970 in a column of seconds are refused beforehand")
    seconds = first_s + np.arange(100)
    rotation = SPIN.as_quat(scalar_first=True)
    for side in "ab":
        of_file, named = (unit, read_as) if side == wrong else ("s", "s")
        times = seconds * (10**9 // UNITS[of_file])
        write_attitudes(tmp_path / f"{side}.csv", times, rotation, f"t_{named},qw,qx,qy,qz")
    files = tmp_path / "a.csv", tmp_path / "b.csv"
    sentence = refused("compare", *files)
    ratio = max(UNITS[unit] / UNITS[read_as], UNITS[read_as] / UNITS[unit])
    assert f"are {ratio:,.0f} times smaller than those of" in sentence
    assert "time-offset" not in sentence
    assert (advice := f"--time-unit-{wrong} {unit}") in sentence
    assert report(*files, *advice.split(), *EXACT)["matching"]["matched"] == 100


def test_above_the_tolerance_is_exit_code_1(spin, bumped):
    """The first sample that exceeds it is named, and the likely cause; -q says nothing."""
    words = ("compare", spin, bumped, "--tol", "0.1deg")
    assert (
        "failed    above the tolerance 0.00174533 rad (0.1 deg), first at sample 30 of A, "
        "1700000000300000000 ns, 300 ms after the first: 0.1 rad (5.72958 deg)\n"
        "cause     likely (isolated samples): 1 of 100 samples carry the error, and the others are "
        "right; omit 1 sample of B\n"
    ) in run(*words, code=1).stdout
    assert run(*words, "-q", code=1).output == ""
    found = json.loads(run(*words, "--json", code=1).stdout)
    assert found["error_rad"]["max"] == pytest.approx(0.1, abs=1e-12)
    assert found["worst"]["index"] == found["first_exceeding"]["index"] == 30
    assert (found["passed"], found["tolerance_rad"]) == (False, np.radians(0.1))
    assert found["a"]["samples"] == found["matching"]["matched"] == 100
    assert found["likely_cause"]["name"] == "isolated samples"
    assert report(spin, bumped)["passed"] is None


def test_json_names_options(tmp_path):
    """Like everything that the command line writes."""
    made = tmp_path / "start.csv"
    run("propagate", SAMPLE_LOGS / "coning.mcap", "-o", made, "-q", code=0)
    assert report(made, SAMPLE_LOGS / "coning.truth.csv")["likely_cause"]["remedy"] == (
        "if A was propagated with method start, propagate it with --method quintic; if B was "
        "propagated with method quintic, with --method start"
    )


def test_invalid_quaternions_can_be_dropped(spin, tmp_path):
    """A row of zeros is then counted, with exit code 3."""
    lines = spin.read_text().splitlines()
    lines[41] = lines[41].split(",")[0] + ",0,0,0,0"
    holed = tmp_path / "holed.csv"
    holed.write_text("\n".join(lines) + "\n")
    result = run("compare", spin, holed, "--on-invalid", "drop", *EXACT, code=3)
    assert "lost      1 invalid quaternion of B\n" in result.stdout


@pytest.mark.parametrize(
    ("rows", "back", "lost"), [((40, 41), 0, 1), ((40, 40), 0, 0), ((1, 41), 1, 1)]
)
def test_an_attitude_at_the_stamp_of_another_is_lost(spin, tmp_path, rows, back, lost):
    """It is left out: exit code 3; the same attitude twice is no loss."""
    lines = spin.read_text().splitlines()
    stamp, attitude = (lines[row].split(",", 1) for row in rows)
    lines[41] = f"{stamp[0]},{attitude[1]}"
    repeated = tmp_path / "repeated.csv"
    repeated.write_text("\n".join(lines) + "\n")
    code = 3 if lost else 0
    is_sorted = "A was sorted by time: its timestamps step back 1 time; " * back
    assert run("compare", repeated, spin, *EXACT, code=code).stdout.splitlines()[-1] == (
        f"remark    {is_sorted}1 repeated timestamp of A omitted, {lost} with a different attitude"
    )
    run("compare", repeated, spin, "-q", code=code)
    run("plot", repeated, "--reference", spin, "-o", tmp_path / "error.svg", code=code)


def test_a_cause_must_reduce_the_error_noticeably(tmp_path):
    """B is 30 ms late, which shows over short windows; A wanders by some 70 deg."""
    t_ns = T_NS[0] + 10_000_000 * np.arange(6000)
    seconds = np.arange(6000)[:, None] * 0.01
    motion = Rotation.from_rotvec(np.sin(seconds * [1.3, 2.1, 0.7]))
    wander = Rotation.from_rotvec(np.sin(seconds * [0.05, 0.04, 0.06] + [0, 1, 2]))
    a = write(tmp_path / "a.csv", wander * motion, t_ns)
    b = write(tmp_path / "b.csv", motion, t_ns + 30_000_000)
    assert report(a, b)["likely_cause"] is None
    late = run("compare", write(tmp_path / "c.csv", motion, t_ns), b, code=0).stdout
    assert "cause     likely (time offset): B is 30 ms late" in late


# Real recordings.


def test_each_remedy_of_a_wrong_layout_of_either_removes_the_error(tmp_path):
    """B was reported as misread, though reading A differently makes them agree as well."""
    truth = np.loadtxt(SAMPLE_LOGS / "tumbling.truth.csv", delimiter=",", skiprows=1)[:100, 1:5]
    path = write_attitudes(tmp_path / "a.csv", T_NS, truth, "t_ns,a,b,c,d")

    def compared(code, **layouts):
        read = {"a": "scalar-last", "b": "scalar-first", **layouts}
        words = [f"--quat-cols-{side}=a,b,c,d --from-layout-{side}={read[side]}" for side in read]
        return run("compare", path, path, *" ".join(words).split(), *EXACT, code=code).output

    sentence = compared(1)
    for side, layout in (("b", "scalar-last"), ("a", "scalar-first")):
        assert f"with --from-layout-{side} {layout}" in sentence
        compared(0, **{side: layout})


def propagated(tmp_path, log, *options):
    """Propagate a recording and return the file."""
    out = tmp_path / "propagated.parquet"
    run("propagate", log, "-o", out, "--method", "mean", "-q", *options, code=0)
    return out


def test_a_flying_robot_against_motion_capture(shared_logs, tmp_path):
    """Vicon sits 1.4 deg off the gyroscope's axes, and its clock some 0.01 s from the log's."""
    log = shared_logs / "auk" / "auk.bag"
    options = ["--topic-b", "/vicon/auk/auk", "--align", "mount", "--time-offset", "auto"]
    found = report(propagated(tmp_path, log), log, *options)
    assert np.degrees(found["alignment"]["mount_rad"]) == pytest.approx(1.35, abs=0.1)
    assert np.degrees(found["alignment"]["mounting"]["std_rad"]) < 0.1
    assert found["time_offset"]["added_to_b_ns"] == pytest.approx(-14_700_000, abs=500_000)
    assert found["time_offset"]["found"]["correlation"] > 0.99


def test_a_drone_against_ground_truth(shared_logs, tmp_path):
    """With the true bias taken out, 1 s windows agree to 0.15 deg RMS; without, it is named."""
    folder = shared_logs / "csv" / "euroc_v102"
    log, truth = folder / "imu0_data.csv", folder / "state_groundtruth_data.csv"
    table = pyarrow.csv.read_csv(truth)
    bias = ",".join(str(np.mean(table.column(column).to_numpy())) for column in (11, 12, 13))
    out = propagated(tmp_path, log, "--bias", bias)
    found = report(out, truth, "--align", "mean", "--window", "1s")
    assert np.degrees(found["window"]["rms_rad"]) < 0.15
    assert np.degrees(found["error_rad"]["max"]) < 0.5
    assert found["matching"]["matched"] == 1560
    cause = report(propagated(tmp_path, log), truth, "--align", "mean")["likely_cause"]
    assert cause["name"] == "rate bias"
    assert cause["rms_before"] > 100 * cause["rms_after"]


GIVEN = {
    "--quat-cols": ("1,2,3,4", ("1", "2", "3", "4")),
    "--sample-rate": ("12.5", 12.5),
    "--from": ("parquet", "parquet"),
    "--frame": ("map:base", "map:base"),
    "--from-layout": ("xyzw", "xyzw"),
    "--from-convention": ("jpl", "jpl"),
    "--from-direction": ("ref-to-body", "ref-to-body"),
    "--from-angle-unit": ("deg", "deg"),
    "--from-euler": ("xyz", "xyz"),
    "--clock": ("publish", "publish"),
    "--time-unit": ("us", "us"),
    "--series": ("sensor=gyro", "sensor=gyro"),
}
"""Option of a side -> what is given, and as what it arrives; of others, any text is itself."""

ERROR = ("plot", "A", "--reference", "B", "-o", "error.svg")


@pytest.mark.parametrize(
    ("command", "suffix", "place"),
    [
        (("compare", "A", "B"), "-a", 0),
        (("compare", "A", "B"), "-b", 1),
        (ERROR, "-ref", 0),
        (ERROR, "", 1),
    ],
)
@pytest.mark.parametrize("name", ONE_SERIES)
def test_an_option_of_a_side_arrives_there_alone(command, suffix, place, name, monkeypatch):
    """A remark on one series is not attributed to the other."""
    asked = []

    def read(reading):
        asked.append(reading)
        if len(asked) == 2:
            raise LogError("here", "that is all")
        return nullcontext()

    monkeypatch.setattr("quatprop.comparison.file_comparison.open_attitudes", read)
    monkeypatch.setattr("quatprop.tools.plot.plotting.load_attitudes", read)
    given, expected = GIVEN.get(option(name), ("a.b", "a.b"))
    result = run(*command, option(name) + suffix, given, code=2)
    assert "that is all" in result.stderr
    values = [getattr(one if name == "kind" else one.selection, name) for one in asked]
    assert (values[place], values[1 - place]) == (expected, None)


def test_angles_have_no_opposite_sign(tmp_path):
    """Unlike the quaternions of a file."""
    t_ns, angles = np.arange(100) * 10**7, np.linspace(0.0, 300.0, 100)
    half = np.radians(angles) / 2
    zero = np.zeros(100)
    wxyz = -np.column_stack([np.cos(half), zero, zero, np.sin(half)])
    a, b = (
        write_attitudes(tmp_path / name, t_ns, sign * wxyz)
        for name, sign in [("a.csv", 1), ("b.csv", -1)]
    )
    assert "opposite sign" in run("compare", a, b, code=0).stdout
    rows = "\n".join(f"{t},{angle},0,0" for t, angle in zip(t_ns, angles, strict=True))
    c = tmp_path / "c.csv"
    c.write_text(f"t_ns,yaw_deg,pitch_deg,roll_deg\n{rows}\n")
    said = run("compare", a, c, "--from-euler-b", "zyx", code=0).stdout
    assert "opposite sign" not in said
