"""Where a propagation begins: given, from gravity, from the log itself, from another series."""

import math
import re

import numpy as np
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from quatprop.cli.commands import cli
from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply, rotate
from quatprop.pipeline.initial_attitude import InitialAttitude, level

G = 9.80665
COLUMNS = "t_ns,wx,wy,wz,accel_x,accel_y,accel_z\n"


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("heading", [0.0, 0.7, -3.0])
@pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (0.3, -0.2), (2.9, 1.2), (-1.0, -1.0)])
def test_level_is_roll_and_pitch_from_gravity(roll, pitch, heading, down):
    """The force that a body feels at a known zyx attitude gives that attitude back."""
    turns = exp(np.array([[0, 0, heading], [0, pitch, 0], [roll, 0, 0]], dtype=np.float64))
    truth = multiply(turns[0], multiply(turns[1], turns[2]))
    up = np.array([0.0, 0.0, -G if down else G])
    felt = rotate(truth * [1, -1, -1, -1], up)
    assert geodesic_angle(level(felt, heading, down=down), truth) < 1e-15


def run(*arguments):
    """Run `quatprop propagate`."""
    return CliRunner().invoke(cli, ["propagate", *map(str, arguments)])


@pytest.fixture
def resting(tmp_path):
    """Return a table of 2 s at rest, rolled by 30 degrees, and where to write."""
    force = [0.0, G * math.sin(math.radians(30)), G * math.cos(math.radians(30))]
    rows = [
        f"{k * 10_000_000},0,0,0,{','.join(str(f + 1e-3 * (k % 2)) for f in force)}\n"
        for k in range(200)
    ]
    path = tmp_path / "log.csv"
    path.write_text(COLUMNS + "".join(rows))
    return path, tmp_path / "out.csv"


def first_row(path):
    """Return the first attitude of a CSV, wxyz."""
    return [float(q) for q in path.read_text().splitlines()[1].split(",")[1:]]


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_length_that_rounding_to_three_decimals_explains_is_taken(sign):
    """A thousandth more or less than 1; beyond that it is no attitude."""
    assert InitialAttitude(wxyz=(0.0, 1 + sign * 0.00099, 0.0, 0.0)).wxyz[1] != 1
    with pytest.raises(UsageError, match=r" has the length (0\.99899|1\.00101), so it is not an "):
        InitialAttitude(wxyz=(0.0, 0.0, 0.0, 1 + sign * 0.00101))


def test_level_from_a_table(resting):
    """--q0 level takes roll and pitch from the columns of acceleration, heading from --heading."""
    log, out = resting
    result = run(log, "-o", out, "--q0", "level", "--heading", "90")
    assert result.exit_code == 0, result.output
    half_roll, half_heading = math.radians(15), math.radians(45)
    about_x = [math.cos(half_roll), math.sin(half_roll), 0, 0]
    about_z = [math.cos(half_heading), 0, 0, math.sin(half_heading)]
    assert geodesic_angle(first_row(out), multiply(about_z, about_x)) < 1e-3


def test_level_turns_with_the_mounting(resting):
    """The accelerometer is mounted as the gyroscope is: x,-y,-z turns the roll by 180 degrees."""
    log, out = resting
    run(log, "-o", out, "--q0", "level", "--mount", "x,-y,-z")
    expected = math.radians(30 - 180) / 2
    assert geodesic_angle(first_row(out), [math.cos(expected), math.sin(expected), 0, 0]) < 1e-3


def test_level_needs_rest(tmp_path):
    """A log that begins in motion tells no level, and says where to begin."""
    path = tmp_path / "log.csv"
    rows = [f"{k * 10_000_000},{math.sin(k)},0,0,0,0,{G}\n" for k in range(200)]
    path.write_text(COLUMNS + "".join(rows))
    result = run(path, "-o", tmp_path / "out.csv", "--q0", "level")
    assert result.exit_code == 2
    assert re.search(
        r"does not begin at rest .* choose --start at rest, or give --q0", result.stderr
    )


def test_level_needs_accelerations(tmp_path):
    """A log without an accelerometer says so."""
    path = tmp_path / "log.csv"
    path.write_text("t_ns,wx,wy,wz\n0,0,0,0\n10,0,0,0\n")
    result = run(path, "-o", tmp_path / "out.csv", "--q0", "level")
    assert result.exit_code == 2
    assert "it has no accelerations to take roll and pitch from; give --q0" in result.stderr


def test_a_series_as_the_beginning(resting, tmp_path):
    """--q0 FILE is the attitude of that series at the first sample, also between its rows."""
    log, out = resting
    other = tmp_path / "other.csv"
    other.write_text(
        f"t_ns,qw,qx,qy,qz\n-1000000000,1,0,0,0\n1000000000,{math.cos(0.5)},0,0,{math.sin(0.5)}\n"
    )
    assert run(log, "-o", out, "--q0", other).exit_code == 0
    assert geodesic_angle(first_row(out), [math.cos(0.25), 0, 0, math.sin(0.25)]) < 1e-15


def test_a_series_that_does_not_reach_is_refused(resting, tmp_path):
    """A series that ends before the first sample cannot say how to begin."""
    log, out = resting
    other = tmp_path / "other.csv"
    other.write_text("t_ns,qw,qx,qy,qz\n-20,1,0,0,0\n-10,1,0,0,0\n")
    result = run(log, "-o", out, "--q0", other)
    assert result.exit_code == 2
    assert str(other) in result.stderr
    assert not out.exists()


def test_the_log_s_own_orientation(shared_logs, tmp_path):
    """--q0 log begins from the orientation in the same messages; --start moves it along."""
    log = shared_logs / "husky" / "test1_husky.bag"
    out, own = tmp_path / "out.csv", tmp_path / "own.csv"
    converted = CliRunner().invoke(
        cli, ["convert", str(log), str(own), "-t", "/imu/data", "--layout", "scalar-first"]
    )
    assert converted.exit_code == 0, converted.output
    rows = {line.split(",")[0]: line.split(",")[1:] for line in own.read_text().splitlines()[1:]}
    for options in ([], ["--start", "+100s"]):
        result = run(log, "-o", out, "--q0", "log", *options)
        assert result.exit_code == 0, result.output
        stamp = out.read_text().splitlines()[1].split(",")[0]
        assert geodesic_angle(first_row(out), [float(q) for q in rows[stamp]]) < 1e-9


def imu_bag(path, orientations, rate=(0.1, 0.2, 0.3)):
    """Write Imu messages every 10 ms with these orientations, x, y, z, w."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind, types = "sensor_msgs/msg/Imu", store.types
    zeros, vector = np.zeros(9), types["geometry_msgs/msg/Vector3"]
    with Writer(path) as writer:
        connection = writer.add_connection("/imu", kind, typestore=store)
        for k, xyzw in enumerate(orientations):
            t_ns = 1_700_000_000_000_000_000 + k * 10_000_000
            time = types["builtin_interfaces/msg/Time"](*divmod(t_ns, 10**9))
            message = types[kind](
                types["std_msgs/msg/Header"](0, time, "imu"),
                types["geometry_msgs/msg/Quaternion"](*xyzw),
                *(zeros, vector(*rate), zeros, vector(0.0, 0.0, 9.8), zeros),
            )
            writer.write(connection, t_ns, bytes(store.serialize_ros1(message, kind)))
    return path


@pytest.mark.parametrize("mount", ["y,-x,z", "-z,y,x", "0.5,0.5,-0.5,0.5"])
def test_the_log_s_orientation_is_that_of_the_sensor(tmp_path, mount):
    """With a mounting m, v_body = m v_sensor, the body's attitude is q_log m*: by scipy."""
    log, out = tmp_path / "log.bag", tmp_path / "out.csv"
    sensor = Rotation.from_euler("zyx", [0.4, -0.3, 1.1])
    imu_bag(log, [sensor.as_quat()] * 20)
    axes = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
    if "x" in mount:
        rows = [np.array(axes[a.strip("-")]) * (-1 if "-" in a else 1) for a in mount.split(",")]
        to_body = Rotation.from_matrix(rows)
    else:
        w, x, y, z = map(float, mount.split(","))
        to_body = Rotation.from_quat([x, y, z, w])
    result = run(log, "-o", out, "--q0", "log", "--mount", mount)
    assert result.exit_code == 0, result.output
    x, y, z, w = (sensor * to_body.inv()).as_quat()
    assert geodesic_angle(first_row(out), [w, x, y, z]) < 1e-15


def test_a_gap_is_not_interpolated_across(resting, tmp_path):
    """Attitudes that are hours apart say nothing of the time between; 10 s are bridged."""
    log, out = resting
    other = tmp_path / "other.csv"
    other.write_text("t_ns,qw,qx,qy,qz\n-5000000000,1,0,0,0\n5000000000,1,0,0,0\n")
    assert run(log, "-o", out, "--q0", other).exit_code == 0
    other.write_text("t_ns,qw,qx,qy,qz\n-5000000000,1,0,0,0\n7200000000000,1,0,0,0\n")
    result = run(log, "-o", out, "--q0", other)
    assert result.exit_code == 2
    assert (
        f"{other}: 0 ns is in a gap of 7205 s between its attitudes; interpolation reaches over at "
        "most 10 s"
    ) in result.stderr


@pytest.mark.parametrize("option", ["--q0", "--at"])
def test_what_is_not_declared_of_a_series_is_said_to_convert(resting, tmp_path, option):
    """Propagate has no options about the attitudes of another file, and names none as its own."""
    log, out = resting
    other = tmp_path / "other.npy"
    np.save(other, np.arange(10.0).reshape(2, 5))
    result = run(log, "-o", out, option, other)
    assert result.exit_code == 2
    assert result.stderr.endswith(
        "name the columns with --quat-cols, --from-layout and --time-col of quatprop convert\n"
    )


def test_a_placeholder_is_no_orientation(tmp_path):
    """Drivers without an estimate leave the identity: it is flagged, and used for nothing."""
    log, out = imu_bag(tmp_path / "log.bag", [(0.0, 0.0, 0.0, 1.0)] * 50), tmp_path / "out.csv"
    flagged = "is the identity in every message: a placeholder, not an attitude"
    result = run(log, "-o", out, "--q0", "log")
    assert result.exit_code == 2
    assert f"the orientation of '/imu' {flagged}; give another --q0" in result.stderr
    assert not out.exists()
    assert run(log, "-o", out).exit_code == 0
    for sides in ((out, log), (log, out)):
        compared = CliRunner().invoke(cli, ["compare", *map(str, sides)])
        assert compared.exit_code == 2
        assert flagged in compared.stderr
    shown = CliRunner().invoke(cli, ["info", str(log)])
    assert f"it {flagged}" in shown.stdout


def test_an_orientation_that_is_level_for_a_while_is_one(tmp_path):
    """Only the identity in every message is a placeholder."""
    tilted = [(0.0, 0.0, 0.6, 0.8)]
    log = imu_bag(tmp_path / "log.bag", [(0.0, 0.0, 0.0, 1.0)] * 49 + tilted)
    assert run(log, "-o", tmp_path / "out.csv", "--q0", "log").exit_code == 0


def test_stdin_cannot_be_read_twice():
    """What needs a second look needs a file."""
    result = run("-", "-o", "-", "--q0", "level")
    assert result.exit_code == 2
    assert "stdin can be read only once" in result.stderr


@pytest.mark.parametrize(
    ("options", "first_ns"), [(["--on-nonfinite", "drop"], 10), (["--on-backwards", "sort"], -50)]
)
def test_the_attitude_is_that_of_the_first_sample_used(options, first_ns, tmp_path):
    """What the timestamp handling drops or moves does not say where the propagation begins."""
    log, other, out = tmp_path / "log.csv", tmp_path / "other.csv", tmp_path / "out.csv"
    rate = "nan" if "drop" in options else "0"
    rows = [f"0,{rate},0,0", "10,0,0,0", "20,0,0,0", *(["-50,0,0,0"] if rate == "0" else [])]
    log.write_text("\n".join(["t_ns,wx,wy,wz", *rows, ""]))
    half = [(t, math.radians(t) / 2) for t in range(-60, 61, 10)]
    other.write_text(
        "t_ns,qw,qx,qy,qz\n" + "".join(f"{t},{math.cos(a)},0,0,{math.sin(a)}\n" for t, a in half)
    )
    result = run(log, "-o", out, "--q0", other, *options)
    assert result.exit_code in (0, 3), result.output
    angle = math.radians(first_ns) / 2
    assert geodesic_angle(first_row(out), [math.cos(angle), 0, 0, math.sin(angle)]) < 1e-15


@pytest.mark.parametrize("choice", ["drop", "hold"])
def test_a_missing_rate_does_not_refuse_level(choice, resting):
    """One NaN in the first second is left out or replaced, as everywhere."""
    log, out = resting
    lines = log.read_text().splitlines(keepends=True)
    lines[30] = lines[30].replace(",0,0,0,", ",nan,0,0,")
    log.write_text("".join(lines))
    result = run(log, "-o", out, "--q0", "level", "--on-nonfinite", choice)
    assert result.exit_code in (0, 3), result.output
    expected = math.radians(15)
    assert geodesic_angle(first_row(out), [math.cos(expected), math.sin(expected), 0, 0]) < 1e-3


def test_level_of_a_sorted_log_is_that_of_its_earliest_second(resting):
    """Gravity is averaged from the earliest sample on, wherever in the log it is."""
    log, out = resting
    header, *rows = log.read_text().splitlines(keepends=True)
    tipped = [f"{(k - 300) * 10_000_000},0,0,0,0,{G},0\n" for k in range(150)]
    log.write_text("".join([header, *rows, *tipped]))
    result = run(log, "-o", out, "--q0", "level", "--on-backwards", "sort")
    assert result.exit_code == 0, result.output
    assert geodesic_angle(first_row(out), [math.sqrt(0.5), math.sqrt(0.5), 0, 0]) < 1e-3


@pytest.mark.parametrize(
    ("options", "first", "last"),
    [(["--start", "+20ns"], 20, 40), (["--end", "-20ns"], 0, 20), (["--end", "+10ns"], 0, 10)],
)
def test_relative_times_count_from_the_earliest_and_latest_sample(options, first, last, tmp_path):
    """Wherever those are in the log."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text("t_ns,wx,wy,wz\n" + "".join(f"{t},0,0,0\n" for t in (10, 20, 0, 40, 30)))
    result = run(log, "-o", out, "--on-backwards", "sort", *options)
    assert result.exit_code == 0, result.output
    stamps = [int(line.split(",")[0]) for line in out.read_text().splitlines()[1:]]
    assert stamps == list(range(first, last + 1, 10))


def test_a_log_without_an_orientation_beside_its_rates_says_what_to_give(shared_logs, tmp_path):
    """Topics of attitudes without rates are no way out, since the rates have their own topic."""
    log = shared_logs / "ulog" / "sample.ulg"
    result = run(log, "-o", tmp_path / "out.csv", "--q0", "log")
    assert result.exit_code == 2
    assert result.stderr == (
        f"Error: {log}: there is no orientation beside the rates of 'sensor_combined/0'; give "
        "another --q0, such as a file of attitudes\n"
    )


@pytest.mark.parametrize(
    ("wanted", "origin"),
    [
        (InitialAttitude(), "identity"),
        (InitialAttitude(wxyz=(0.0, 1.0, 0.0, 0.0)), "given"),
        (InitialAttitude("log"), "log"),
        (
            InitialAttitude("level", heading=math.pi / 2, down=True),
            "level, reference z down, heading 90 deg",
        ),
    ],
)
def test_the_report_names_where_q0_is_from(wanted, origin):
    """Nothing is called given that was not."""
    assert wanted.origin == origin


def test_q0_is_the_attitude_of_a_topic_of_the_log(tmp_path):
    """Interpolated at the first sample that is used, as from a file; the report names the topic."""
    both, out = tmp_path / "both.bag", tmp_path / "out.csv"
    assert run(SAMPLE_LOGS / "tumbling.bag", "--into", both, "--method", "coning").exit_code == 0
    run(both, "-o", tmp_path / "whole.csv", "-t", "/imu", "--method", "coning")
    result = run(both, "-o", out, "-t", "/imu", "--start", "+5s", "--q0", "/attitude")
    assert result.exit_code == 0, result.output
    assert ", from /attitude" in result.stderr
    rows = (tmp_path / "whole.csv").read_text().splitlines()[1:]
    expected = [float(q) for q in rows[500].split(",")[1:]]
    np.testing.assert_allclose(first_row(out), expected, atol=1e-15)
    config = tmp_path / "a.toml"
    config.write_text('q0 = "/attitude"\n')
    again = tmp_path / "again.csv"
    run(both, "-o", again, "-t", "/imu", "--start", "+5s", "--config", config)
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.parametrize(
    ("q0", "sentence"),
    [
        ("/vicon", "--q0 /vicon is neither four numbers W,X,Y,Z nor level or log, no such file"),
        ("levle", "--q0 levle is neither four numbers W,X,Y,Z nor level or log, no such file"),
        (
            "/imu",
            "'/imu' has no orientation: 1000 of 1000 rows are invalid quaternions (1000 ",
        ),
    ],
)
def test_a_name_that_is_no_series_is_refused(tmp_path, q0, sentence):
    """Neither a file nor a topic, or a topic without attitudes."""
    out = tmp_path / "out.csv"
    result = run(SAMPLE_LOGS / "tumbling.bag", "-o", out, "--q0", q0)
    assert result.exit_code == 2
    assert sentence in result.stderr
    assert not out.exists()


def test_a_series_that_begins_later_says_by_how_much(tmp_path):
    """In seconds, beside the two stamps."""
    late = tmp_path / "late.csv"
    late.write_text("t_ns,qw,qx,qy,qz\n1700000015000000000,1,0,0,0\n1700000016000000000,1,0,0,0\n")
    result = run(SAMPLE_LOGS / "tumbling.bag", "-o", tmp_path / "out.csv", "--q0", late)
    assert (
        "late.csv: its first attitude is 15 s after the first sample that is used "
        "(1700000015000000000 and 1700000000000000000 ns); are both on the same clock? "
        "If so, begin there with --start 1700000015000000000\n"
    ) in result.stderr


def test_no_start_is_advised_that_is_years_after_the_log(tmp_path):
    """Such clocks have nothing in common."""
    late = tmp_path / "late.csv"
    late.write_text("t_ns,qw,qx,qy,qz\n2000000000000000000,1,0,0,0\n2000000001000000000,1,0,0,0\n")
    result = run(SAMPLE_LOGS / "tumbling.bag", "-o", tmp_path / "out.csv", "--q0", late)
    assert result.stderr.endswith("1700000000000000000 ns); are both on the same clock?\n")
