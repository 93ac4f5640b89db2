"""`quatprop compare`: options in, figures and exit code out; real recordings too."""

import json
from contextlib import nullcontext

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from quatprop.cli.commands import cli
from quatprop.errors import LogError
from quatprop.settings import ONE_SERIES
from quatprop.settings.spelling import option

FIRST_NS = 1_700_000_000_000_000_000


def run(*arguments):
    """Run the command line; errors come back as exit code and words."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def report(*arguments):
    """Return the JSON of a comparison that passes."""
    result = run("compare", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def write(path, rotation, t_ns):
    """Write rotations as a table of attitudes."""
    w, x, y, z = rotation.as_quat(scalar_first=True).T
    pyarrow.csv.write_csv(pa.table({"t_ns": t_ns, "qw": w, "qx": x, "qy": y, "qz": z}), path)
    return path


@pytest.fixture
def files(tmp_path):
    """Write a spin, and the same with 0.1 rad put on sample 30."""
    t_ns = FIRST_NS + 10_000_000 * np.arange(100)
    spin = Rotation.from_rotvec(np.arange(100)[:, None] * [[0.01, 0, 0.02]])
    bump = np.zeros((100, 3))
    bump[30] = [0, 0.1, 0]
    a = write(tmp_path / "a.csv", spin, t_ns)
    return a, write(tmp_path / "b.csv", spin * Rotation.from_rotvec(bump), t_ns)


def test_a_file_has_no_error_against_itself(files):
    """Exit code 0, and every line is there."""
    a, _ = files
    result = run("compare", a, a, "--tol", "1e-9rad")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0] == (
        f"A         {a} (csv): qw,qx,qy,qz quatprop, 100 samples over 990 ms; "
        "hamilton body-to-ref, scalar-first"
    )
    assert lines[2] == "matched   100 of 100 samples over 990 ms: equal stamps"
    assert [line.split()[0] for line in lines[4:10]] == [
        "max", "RMS", "mean", "median", "95", "final",
    ]  # fmt: skip
    assert lines[-1] == "passed    no error above the tolerance 1e-09 rad (5.72958e-08 deg)"


def test_above_the_tolerance_is_exit_code_1(files):
    """The first sample that exceeds it is named, and the likely cause."""
    result = run("compare", *files, "--tol", "0.1deg")
    assert result.exit_code == 1
    assert (
        "failed    above the tolerance 0.00174533 rad (0.1 deg), first at sample 30 of A, "
        "1700000000300000000 ns, 300 ms after the first: 0.1 rad (5.72958 deg)\n"
        "cause     likely (isolated samples): 1 of 100 samples carry the error, and the others are "
        "right\n"
    ) in result.stdout


def test_json_has_everything_a_script_needs(files):
    """Sources, association, figures, the worst place and the judgement are there."""
    result = run("compare", *files, "--tol", "0.1deg", "--json")
    assert result.exit_code == 1
    found = json.loads(result.stdout)
    assert found["error_rad"]["max"] == pytest.approx(0.1, abs=1e-12)
    assert found["worst"]["index"] == found["first_exceeding"]["index"] == 30
    assert (found["passed"], found["tolerance_rad"]) == (False, np.radians(0.1))
    assert found["a"]["samples"] == found["association"]["matched"] == 100
    assert found["likely_cause"]["name"] == "isolated samples"
    without_limit = run("compare", *files, "--json")
    assert without_limit.exit_code == 0
    assert json.loads(without_limit.stdout)["passed"] is None


def test_json_names_options(tmp_path):
    """As everything does that the command line writes."""
    samples, made = SAMPLE_LOGS, tmp_path / "start.csv"
    assert run("propagate", samples / "coning.mcap", "-o", made, "-q").exit_code == 0
    found = report(made, samples / "coning.truth.csv")
    assert found["likely_cause"]["remedy"] == (
        "if A was propagated, propagate it with --method quintic; if B was, with --method start"
    )


def test_quiet_leaves_the_exit_code(files):
    """Nothing is said with -q."""
    result = run("compare", *files, "--tol", "0.1deg", "-q")
    assert (result.exit_code, result.output) == (1, "")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--tol", "0.1"], "'0.1' is not an angle; write a number with its unit, such as 1e-9rad"),
        (["--time-offset", "soon"], "'soon' is not a duration; write a number with a unit"),
        (["--time-offset", "auto"], "A turns at a constant speed, which shows no time offset"),
        (["--align", "mount"], "the body turns about one axis only"),
        (["--window", "1h"], "no two pairs are 3600 s apart: they span 990 ms"),
        (["--quat-cols-b", "qw,qx"], "'qw,qx' does not name 3 or 4 columns A,B,C[,D]"),
        (["--topic-b", "/imu"], "is a table"),
    ],
)
def test_what_cannot_be_done_is_exit_code_2(files, options, words):
    """Wrong usage and impossible comparisons end in one sentence."""
    result = run("compare", files[0], files[0], *options)
    assert result.exit_code == 2
    assert words in result.output


def test_conventions_of_a_side_can_be_told(files, tmp_path):
    """A conjugate is none once its direction, or JPL, is said."""
    a, _ = files
    t_ns = FIRST_NS + 10_000_000 * np.arange(100)
    spin = Rotation.from_rotvec(np.arange(100)[:, None] * [[0.01, 0, 0.02]])
    conjugate = write(tmp_path / "conjugate.csv", spin.inv(), t_ns)
    assert run("compare", a, conjugate, "--tol", "1e-9rad").exit_code == 1
    for options in (["--from-direction-b", "ref-to-body"], ["--from-convention-b", "jpl"]):
        assert run("compare", a, conjugate, "--tol", "1e-9rad", *options).exit_code == 0


def test_a_layout_of_a_side_can_be_told(files, tmp_path):
    """Columns are taken in the order that is said."""
    a, _ = files
    table = pyarrow.csv.read_csv(a)
    renamed = table.select(["t_ns", "qx", "qy", "qz", "qw"]).rename_columns(["t_ns", *"abcd"])
    pyarrow.csv.write_csv(renamed, tmp_path / "abcd.csv")
    told = ["--quat-cols-b", "a,b,c,d", "--from-layout-b", "xyzw"]
    assert run("compare", a, tmp_path / "abcd.csv", "--tol", "1e-9rad", *told).exit_code == 0


def test_what_is_no_rotation_is_refused_or_left_out(files, tmp_path):
    """A row of zeros is refused; with --on-invalid drop it is left out, counted, exit code 3."""
    a, _ = files
    lines = a.read_text().splitlines()
    lines[41] = lines[41].split(",")[0] + ",0,0,0,0"
    holed = tmp_path / "holed.csv"
    holed.write_text("\n".join(lines) + "\n")
    refused = run("compare", a, holed)
    assert refused.exit_code == 2
    assert (
        "1 of 100 rows are invalid quaternions (1 all zero), the first is row 40" in refused.output
    )
    dropped = run("compare", a, holed, "--on-invalid", "drop", "--tol", "1e-9rad")
    assert dropped.exit_code == 3
    assert "lost      1 invalid quaternion of B\n" in dropped.stdout


@pytest.mark.parametrize(
    ("rows", "back", "lost"), [((40, 41), 0, 1), ((40, 40), 0, 0), ((1, 41), 1, 1)]
)
def test_an_attitude_at_the_stamp_of_another_is_lost(files, tmp_path, rows, back, lost):
    """It is left out: exit code 3; the same attitude twice is no loss."""
    a, _ = files
    lines = a.read_text().splitlines()
    stamp, attitude = (lines[row].split(",", 1) for row in rows)
    lines[41] = f"{stamp[0]},{attitude[1]}"
    repeated = tmp_path / "repeated.csv"
    repeated.write_text("\n".join(lines) + "\n")
    result = run("compare", repeated, a, "--tol", "1e-9rad")
    code = 3 if lost else 0
    assert result.exit_code == code
    assert result.stdout.splitlines()[-1] == (
        f"remark    A was sorted by time: its timestamps step back {back} times, and 1 repeated "
        f"ones were left out, {lost} of them with another attitude"
    )
    assert run("compare", repeated, a, "-q").exit_code == code
    picture = run("plot", repeated, "--reference", a, "-o", tmp_path / "error.svg")
    assert picture.exit_code == code, picture.output


def test_what_hardly_changes_the_error_is_no_likely_cause(tmp_path):
    """B is 30 ms late, which shows over short windows; A wanders by some 70 deg."""
    t_ns = FIRST_NS + 10_000_000 * np.arange(6000)
    seconds = np.arange(6000)[:, None] * 0.01
    motion = Rotation.from_rotvec(np.sin(seconds * [1.3, 2.1, 0.7]))
    wander = Rotation.from_rotvec(np.sin(seconds * [0.05, 0.04, 0.06] + [0, 1, 2]))
    a = write(tmp_path / "a.csv", wander * motion, t_ns)
    b = write(tmp_path / "b.csv", motion, t_ns + 30_000_000)
    found = report(a, b)["likely_cause"]
    assert found["name"] == "time offset"
    assert 0.9 < found["total_after"] / found["total_before"] < 1.1
    result = run("compare", a, b)
    assert "remark    explains little of the error (time offset): B is " in result.stdout
    assert "likely" not in result.stdout
    late = run("compare", write(tmp_path / "c.csv", motion, t_ns), b)
    assert "cause     likely (time offset): B is 30 ms late" in late.stdout


# Real recordings.


def propagated(tmp_path, log, *options):
    """Propagate a recording and return the file."""
    out = tmp_path / "propagated.parquet"
    result = run("propagate", log, "-o", out, "--method", "mean", "-q", *options)
    assert result.exit_code == 0, result.output
    return out


def degrees(angle):
    """Return an angle of a report in degrees."""
    return float(np.degrees(angle))


def test_a_flying_robot_against_motion_capture(shared_logs, tmp_path):
    """Vicon sits 1.4 deg off the gyroscope's axes, and its clock some 0.01 s from the log's."""
    log = shared_logs / "auk" / "auk.bag"
    found = report(
        propagated(tmp_path, log), log, "--topic-b", "/vicon/auk/auk", "--align", "mount",
        "--time-offset", "auto",
    )  # fmt: skip
    assert degrees(found["alignment"]["mount_rad"]) == pytest.approx(1.35, abs=0.1)
    assert degrees(found["alignment"]["mounting"]["std_rad"]) < 0.1
    assert found["time_offset"]["added_to_b_ns"] == pytest.approx(-14_700_000, abs=500_000)
    assert found["time_offset"]["found"]["correlation"] > 0.99


def test_a_drone_against_ground_truth(shared_logs, tmp_path):
    """With the true bias taken out, 1 s windows agree to 0.15 deg RMS."""
    folder = shared_logs / "csv" / "euroc_v102"
    truth = folder / "state_groundtruth_data.csv"
    table = pyarrow.csv.read_csv(truth)
    bias = ",".join(str(np.mean(table.column(column).to_numpy())) for column in (11, 12, 13))
    out = propagated(tmp_path, folder / "imu0_data.csv", "--bias", bias)
    found = report(out, truth, "--align", "mean", "--window", "1s")
    assert degrees(found["window"]["rms_rad"]) < 0.15
    assert degrees(found["error_rad"]["max"]) < 0.5
    assert found["association"]["matched"] == 1560


def test_the_bias_of_a_gyroscope_is_named(shared_logs, tmp_path):
    """Without its bias taken out, the same recording is wrong by the bias, and that is said."""
    folder = shared_logs / "csv" / "euroc_v102"
    out = propagated(tmp_path, folder / "imu0_data.csv")
    found = report(out, folder / "state_groundtruth_data.csv", "--align", "mean")
    assert found["likely_cause"]["name"] == "rate bias"
    assert found["likely_cause"]["rms_before"] > 100 * found["likely_cause"]["rms_after"]


@pytest.mark.parametrize(
    ("log", "against", "window_deg"),
    [
        (
            "csv/xio3/Inertial.csv",
            ["csv/xio3/Quaternion.csv", "--time-offset", "auto"],
            2.0,
        ),
        (
            "csv/px4/sample_sensor_combined_0.csv",
            ["csv/px4/sample_vehicle_attitude_0.csv"],
            0.3,
        ),
        ("husky/test1_husky.bag", ["husky/test1_husky.bag", "--topic-b", "/imu/data"], 0.8),
    ],
)
def test_filters_agree_over_short_windows(shared_logs, tmp_path, log, against, window_deg):
    """Over 1 s a filter's attitude and the gyroscope alone say the same."""
    out = propagated(tmp_path, shared_logs / log)
    reference, *options = against
    found = report(out, shared_logs / reference, "--align", "mean", "--window", "1s", *options)
    assert degrees(found["window"]["rms_rad"]) < window_deg


def test_a_driver_that_scaled_its_rates_is_recognised(shared_logs, tmp_path):
    """Rates that were taken from degrees to radians once too often turn 57 times too slowly."""
    (log,) = (shared_logs / "nested_imu" / "kiran_11sec_motion").glob("*.mcap")
    out = propagated(tmp_path, log)
    found = report(out, log, "--topic-b", "/imu", "--align", "mean")
    assert found["likely_cause"]["name"] == "scale"
    assert "one of them took degrees for radians" in found["likely_cause"]["sentence"]


def two_topics(path):
    """Write a log that has attitudes on two topics."""
    rows = "t_ns,wx,wy,wz\n" + "".join(f"{t}0000000,0,0,1\n" for t in range(1, 5))
    rates, one = path.with_suffix(".csv"), path.with_name("one.mcap")
    rates.write_text(rows)
    assert run("propagate", rates, "-o", one, "--out-topic", "/one").exit_code == 0
    # The copy has rates on none of its topics: what is added is made from another file's.
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        with one.open("rb") as source:
            for schema, channel, message in make_reader(source).iter_messages():
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                for topic in ("/one", "/two"):
                    id_ = writer.register_channel(topic, channel.message_encoding, known)
                    writer.add_message(id_, message.log_time, message.data, message.log_time)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (("compare", "LOG", "TABLE"), "--topic-a"),
        (("compare", "TABLE", "LOG"), "--topic-b"),
        (("plot", "TABLE", "--reference", "LOG", "-o", "PIC"), "--topic-ref"),
        (("plot", "LOG", "--reference", "TABLE", "-o", "PIC"), "--topic"),
    ],
)
def test_the_option_that_settles_it_is_the_one_of_that_side(files, tmp_path, command, option):
    """Where two series are read, what is asked for is named as the command has it."""
    log = two_topics(tmp_path / "log.mcap")
    paths = {"LOG": log, "TABLE": files[0], "PIC": tmp_path / "error.svg"}
    result = run(*(paths.get(word, word) for word in command))
    assert result.exit_code == 2
    assert result.stderr == (
        f"Error: {log}: several topics carry attitudes: '/one', '/two'; choose one with {option}\n"
    )


def test_an_undeclared_layout_is_asked_for_by_the_name_of_its_side(files, tmp_path):
    """So it is with every option that both sides have, even in an error that names several."""
    table = tmp_path / "plain.csv"
    table.write_text("1,1,0,0,0\n2,1,0,0,0\n")
    result = run("compare", files[0], table)
    assert result.exit_code == 2
    assert "name the columns with --quat-cols-b, --from-layout-b and --time-col-b" in result.stderr


OF_A_SIDE = {
    "--from": ("parquet", "kind", "parquet"),
    "--topic": ("/t", "topic", "/t"),
    "--msg-path": ("a.msg", "msg_path", "a.msg"),
    "--quat-field": ("a.b", "quat_field", "a.b"),
    "--quat-cols": ("1,2,3,4", "quat_cols", ("1", "2", "3", "4")),
    "--frame": ("map:base", "frame", "map:base"),
    "--from-layout": ("xyzw", "from_layout", "xyzw"),
    "--from-convention": ("jpl", "from_convention", "jpl"),
    "--from-direction": ("ref-to-body", "from_direction", "ref-to-body"),
    "--from-angle-unit": ("deg", "from_angle_unit", "deg"),
    "--from-euler": ("xyz", "from_euler", "xyz"),
    "--clock": ("publish", "clock", "publish"),
    "--time-field": ("a.t", "time_field", "a.t"),
    "--time-col": ("3", "time_col", "3"),
    "--time-unit": ("us", "time_unit", "us"),
    "--sample-rate": ("12.5", "sample_rate", 12.5),
    "--series": ("sensor=gyro", "series", "sensor=gyro"),
}
"""Option of a side -> what is given, where it arrives in what is read, and as what."""


@pytest.mark.parametrize(
    "side",
    [
        (("compare", "A", "B"), "-a", 0),
        (("compare", "A", "B"), "-b", 1),
        (("plot", "A", "--reference", "B", "-o", "error.svg"), "-ref", 0),
        (("plot", "A", "--reference", "B", "-o", "error.svg"), "", 1),
    ],
)
@pytest.mark.parametrize("option", OF_A_SIDE)
def test_an_option_of_a_side_arrives_there_alone(side, option, monkeypatch, tmp_path):
    """What is said of one series is said of that one: of the other all is as it is by itself."""
    asked = []

    def read(reading):
        asked.append(reading)
        if len(asked) == 2:
            raise LogError("here", "that is all")
        return nullcontext()

    monkeypatch.setattr("quatprop.comparison.files.open_attitudes", read)
    monkeypatch.setattr("quatprop.plot.plot.load_attitudes", read)
    monkeypatch.chdir(tmp_path)
    (command, suffix, place), (given, where, expected) = side, OF_A_SIDE[option]
    result = run(*command, option + suffix, given)
    assert "that is all" in result.stderr

    def value(reading):
        holder = reading if where == "kind" else reading.selection
        return getattr(holder, where)

    assert value(asked[place]) == expected
    assert value(asked[1 - place]) is None


def test_every_option_of_a_side_is_tried():
    """The table above has all of them."""
    assert OF_A_SIDE.keys() == {option(name) for name in ONE_SERIES}


@pytest.mark.parametrize(
    "words",
    [
        ("compare", "-", "-"),
        ("plot", "-", "-", "-o", "error.svg"),
        ("plot", "-", "--reference", "-", "-o", "error.svg"),
    ],
)
def test_stdin_is_one_series(words):
    """It is empty when it has been read: it is not the log that would be to blame."""
    result = CliRunner().invoke(cli, words, input="t_ns,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n")
    assert result.exit_code == 2
    assert result.stderr.endswith("Error: stdin can be read only once; name files for the others\n")
