"""Every option of propagate, alone and together, against an independent computation.

The reference (``options_reference.py``) is written from the documentation with SciPy alone. The
log rests for 1.3 s, then moves; it has repeated, late and missing samples, and rates that are NaN.
"""

import json
from fractions import Fraction

import numpy as np
import pytest
from fuzz.command_lines import IMU, ROS2, difference, message, series_file, written
from make.commands import run
from make.options_reference import NS, ordered, propagated
from mcap.writer import Writer as McapWriter
from rosbags.typesys import get_types_from_msg
from scipy.spatial.transform import Rotation

from quatprop import propagate
from quatprop.errors import TimelineError, UsageError
from quatprop.settings import PROPAGATE

RESTING, MOVING = 130, 150
BEGIN_NS = 1_700_000_000_123_456_789
BIAS = np.array([0.01, -0.02, 0.03])
MOUNT_QUATERNION = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_quat(scalar_first=True)


def recording(*, trouble):
    """Return the rows of a log, with or without trouble."""
    random = np.random.default_rng(7)
    n = RESTING + MOVING
    steps = random.integers(9_000_000, 11_000_000, n)
    if trouble:
        steps[[200, 230]] = 250_000_000, 120_000_000
        steps[[150, 210]] = 0
    t = BEGIN_NS + np.cumsum(steps)
    phase = np.arange(MOVING) / 15
    w = np.zeros((n, 3))
    w[RESTING:] = 3 * np.sin(phase[:, None] + np.arange(3)) - 3 * np.sin(np.arange(3))
    w += BIAS + random.normal(0, 1e-3, (n, 3))
    f = Rotation.from_euler("xyz", [0.4, -0.2, 0.0]).apply([0, 0, 9.81])
    f = f + random.normal(0, 1e-3, (n, 3))
    q = Rotation.from_rotvec(random.normal(0, 1e-3, (n, 3))) * Rotation.random(rng=random)
    if trouble:
        w[[20, 140, 141, 215], [0, 1, 2, 0]] = np.nan, np.nan, np.inf, np.nan
        for late, by in ((60, 25_000_000), (160, 33_000_000), (161, 31_000_000), (240, 45_000_000)):
            t[late] -= by
    return {"t": t, "w": w, "f": f, "q": q}


RAW = {trouble: recording(trouble=trouble) for trouble in (False, True)}


def assert_attitudes(series, expected):
    """Compare stamps, and attitudes to rounding."""
    t, attitudes = expected
    assert series.t_ns.tolist() == t.tolist()
    ours = Rotation.from_quat(series.wxyz, scalar_first=True)
    assert (attitudes.inv() * ours).magnitude().max() < 1e-11


def decimal(ns, digits):
    """Return ns with so many digits after the point, as text."""
    return f"{ns // 10**digits}.{ns % 10**digits:0{digits}d}" if digits else str(ns)


TIMES = {"t_ns": ("", 0), "t_us": ("us", 3), "t_ms": ("ms", 6), "t_s": ("s", 9), "clock": ("us", 3)}
"""Time columns: the unit to declare, where the name does not, and the digits after the point."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write the log in several spellings; return their paths and what the options must say."""
    folder = tmp_path_factory.mktemp("logs")
    made = {}
    for trouble, raw in RAW.items():
        rows = [raw["f"], raw["q"].as_quat(scalar_first=True)]
        for unit, scale in (("rad", 1.0), ("deg", 180 / np.pi)):
            for time, (_, digits) in TIMES.items():
                numbers = np.column_stack([raw["w"] * scale, *rows]).tolist()
                lines = [
                    ",".join([decimal(t, digits), *map(repr, row)])
                    for t, row in zip(raw["t"].tolist(), numbers, strict=True)
                ]
                header = f"{time},gx,gy,gz,accel_x,accel_y,accel_z,qw,qx,qy,qz"
                path = folder / f"{unit}_{time}_{trouble}.csv"
                made[unit, time, trouble] = written(path, header, lines)
    return made


def reading(unit, time):
    """Return the options that read a spelling of the log."""
    options = {"rate_cols": "gx,gy,gz", "rate_unit": f"{unit}/s", "time_col": time}
    return options | ({"time_unit": TIMES[time][0]} if TIMES[time][0] else {"time_unit": "ns"})


def chosen(seed):
    """Return options chosen at random, as `propagate` takes them, the same for the same seed."""
    random = np.random.default_rng(seed)

    def one_of(*values):
        return values[random.integers(len(values))]

    trouble = one_of(True, True, False)
    options = {
        "method": one_of(None, "start", "end", "mean", "coning", "cubic"),
        "rates": one_of(None, "body", "inertial"),
        "mount": one_of(None, "y,-x,z", ",".join(map(repr, MOUNT_QUATERNION.tolist()))),
        "bias": one_of(None, "given", "static", "series"),
        "calibration": one_of(None, None, "file"),
        "q0": one_of(None, "numbers", "scalar-last", "level", "log", "series"),
        "start": one_of(None, None, "+105ms", BEGIN_NS + 95_000_000),
        "end": one_of(None, None, "-104ms", BEGIN_NS + 2_500_000_000),
        "on_gap": one_of(None, "hold", "zero", "split"),
        "max_gap": one_of(None, None, "200ms", "10500us"),
        **one_of({}, {"every": 3}, {"rate": "59.94"}, {"rate": 400}, {"at": "stamps"}),
    }
    if trouble:
        options["on_backwards"] = one_of("drop", "sort")
        options["on_nonfinite"] = one_of("drop", "hold")
    if options["q0"] == "level":
        options |= {"heading": one_of(None, 30.0), "reference_z": one_of(None, "up", "down")}
    spelling = one_of("rad", "deg"), one_of(*TIMES)
    return {name: value for name, value in options.items() if value is not None}, trouble, spelling


def both(options, raw, unit, folder):
    """Return options as `propagate` takes them, and as the reference does."""
    given, expected = dict(options), dict(options)
    if options.get("bias") == "given":
        given["bias"] = BIAS * (1 if unit == "rad" else 180 / np.pi)
        expected["bias"] = BIAS
    if options.get("bias") == "series":
        t = BEGIN_NS + np.arange(4) * 600_000_000
        biases = np.random.default_rng(6).normal(0, 0.01, (4, 3))
        names = ",".join(f"gyro_bias_{axis} [rad/s]" for axis in "xyz")
        rows = [
            f"{at},{','.join(map(repr, row))}" for at, row in zip(t, biases.tolist(), strict=True)
        ]
        given["bias"] = written(folder / "bias.csv", f"t_ns,{names}", rows)
        after = (raw["t"] - BEGIN_NS) / NS
        known = np.arange(4) * 0.6
        expected["bias"] = np.stack([np.interp(after, known, axis) for axis in biases.T], axis=1)
    if (q0 := options.get("q0")) in {"numbers", "scalar-last"}:
        layout = {"scalar-last": "xyzw"} if q0 == "scalar-last" else {}
        q = Rotation.from_euler("xyz", [1.0, -0.5, 0.25])
        given["q0"] = expected["q0"] = q.as_quat(scalar_first=not layout).tolist()
        if layout:
            given["q0_layout"] = expected["q0_layout"] = layout[q0]
    if q0 == "series":
        t = BEGIN_NS + np.arange(-1, 5) * NS
        turns = Rotation.from_rotvec(np.arange(6)[:, None] * [0.3, -0.1, 0.2])
        given["q0"], expected["q0"] = series_file(folder / "q0.csv", t, turns), (t, turns)
    if "calibration" in options:
        given["calibration"] = folder / "calibration.json"
        matrix = np.eye(3) + np.random.default_rng(5).normal(0, 0.02, (3, 3))
        content = {"matrix": matrix.tolist(), "bias": (BIAS / 2).tolist()}
        given["calibration"].write_text(json.dumps(content))
        expected["calibration"] = matrix, BIAS / 2
    if "at" in options:
        t = np.random.default_rng(3).integers(raw["t"][0] - NS, raw["t"][-1] + NS, 300)
        t = np.concatenate([t, raw["t"][::7]])
        given["at"] = series_file(folder / "at.csv", t, Rotation.identity(len(t)))
        expected["at"] = (t, None)
    if "max_gap" in options:
        expected["max_gap"] = {"200ms": 200_000_000, "10500us": 10_500_000}[options["max_gap"]]
    return given, expected


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(130))
def test_options_together(seed, files, tmp_path):
    """Options in any combination give what each of them means."""
    options, trouble, (unit, time) = chosen(seed)
    raw = RAW[trouble]
    given, expected = both(options, raw, unit, tmp_path)
    if refusal := refused(given):
        with pytest.raises(UsageError, match=refusal):
            propagate(files[unit, time, trouble], **reading(unit, time), **given)
        return
    series = propagate(files[unit, time, trouble], **reading(unit, time), **given)
    if options.get("bias") == "static":
        rest = series.report.conditioning.rest
        inside = (raw["t"] >= rest.first_ns) & (raw["t"] <= rest.last_ns)
        inside &= np.isfinite(raw["w"]).all(axis=1)
        inside &= np.isin(np.arange(len(inside)), ordered(raw["t"], options))
        expected["bias"] = raw["w"][inside].mean(axis=0)
        assert BEGIN_NS < rest.first_ns < rest.last_ns < raw["t"][RESTING + 5]
    assert_attitudes(series, propagated(raw, expected))


def refused(options):
    """Return the sentence with which a combination is refused, or None."""
    turns_rates = options.get("rates") != "inertial"
    if "mount" in options and not turns_rates and options.get("q0") not in ("level", "log"):
        return "rates resolved in the reference frame are not turned by mount"
    return None


LATE = np.flatnonzero(RAW[True]["t"] < np.maximum.accumulate(RAW[True]["t"])).tolist()
MISSING = np.flatnonzero(~np.isfinite(RAW[True]["w"]).all(axis=1)).tolist()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("on_nonfinite", ["drop", "hold"])
@pytest.mark.parametrize("on_backwards", ["drop", "sort", "error"])
def test_events_are_located_by_their_rows(on_backwards, on_nonfinite, files):
    """What is late or not finite is named by its row in the log, whatever was dropped before."""
    options = reading("rad", "t_ns") | {"on_nonfinite": on_nonfinite}
    path = files["rad", "t_ns", True]
    assert MISSING[0] < LATE[0]
    if on_backwards == "error":
        with pytest.raises(TimelineError, match=f"at sample {LATE[0]} "):
            propagate(path, **options)
        return
    counts = propagate(path, **options, on_backwards=on_backwards).report.counts
    assert (counts.backwards.count, counts.backwards.first_index) == (len(LATE), LATE[0])
    assert (counts.nonfinite.count, counts.nonfinite.first_index) == (len(MISSING), MISSING[0])


LOG_NS, PUBLISH_NS = 7_000_000, 3_000_000


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Write the log as messages on three topics, whose three times all differ; return its path."""
    raw = RAW[False]
    ROS2.register(get_types_from_msg("builtin_interfaces/Time when\nfloat64[3] gyro", LAB_TYPE))
    path = tmp_path_factory.mktemp("messages") / "log.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        for topic, kind in {"/imu": IMU, "/other": IMU, "/lab": LAB_TYPE}.items():
            text, _ = ROS2.generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for k, t in enumerate(raw["t"].tolist()):
                if kind == IMU:
                    one = message(ROS2, raw, k)
                else:  # in deg/s
                    stamp = ROS2.types["builtin_interfaces/msg/Time"](*divmod(t, NS))
                    one = ROS2.types[LAB_TYPE](when=stamp, gyro=np.degrees(raw["w"][k]))
                data = bytes(ROS2.serialize_cdr(one, kind))
                writer.add_message(channel, t + LOG_NS, data, t + PUBLISH_NS, k)
        writer.finish()
    return path


LAB_TYPE = "lab/msg/Gyro"
LAB = {"topic": "/lab", "rate_field": "gyro", "rate_unit": "deg/s"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("q0", [None, "log", "level"])
@pytest.mark.parametrize(
    ("options", "delay_ns"),
    [
        ({"topic": "/imu"}, 0),
        ({"topic": "/other", "kind": "mcap"}, 0),
        ({"topic": "/imu", "clock": "header"}, 0),
        ({"topic": "/imu", "clock": "log"}, LOG_NS),
        ({"topic": "/imu", "clock": "publish"}, PUBLISH_NS),
        ({"topic": "/imu", "time_field": "header.stamp"}, 0),
        (LAB | {"time_field": "when"}, 0),
        (LAB | {"clock": "log"}, LOG_NS),
    ],
)
def test_which_messages_and_which_time(options, delay_ns, q0, messages):
    """The topic, the field and the clock that are asked for, for rates and what is beside them."""
    raw = RAW[False] | {"t": RAW[False]["t"] + delay_ns}
    given = {"mount": "y,-x,z", "start": "+100ms"}
    if q0 is not None and "rate_field" not in options:
        given["q0"] = q0  # messages of the laboratory have rates alone
    series = propagate(messages, **options, **given)
    assert_attitudes(series, propagated(raw, given))


@pytest.mark.parametrize("hz", ["100", "29.97", "30000/1001"])
def test_rows_without_a_time(hz, files, tmp_path):
    """Row k of a table without a time is at k / --sample-rate, rounded to the nearest ns."""
    rows = [row.split(",")[1:4] for row in files["rad", "t_ns", False].read_text().splitlines()]
    path = written(tmp_path / "rows.csv", ",".join(rows[0]), map(",".join, rows[1:]))
    series = propagate(path, sample_rate=hz, rate_unit="rad/s", rate_cols=("gx", "gy", "gz"))
    t = np.array([round(k * NS / Fraction(hz)) for k in range(len(RAW[False]["t"]))])
    assert_attitudes(series, propagated(RAW[False] | {"t": t}, {}))


@pytest.mark.parametrize("series", ["gyro", "kind=gyro"])
@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_one_of_the_series_of_a_table(series, files, tmp_path):
    """Rows of others between its own change nothing."""
    header, *rows = files["rad", "t_ns", False].read_text().splitlines()
    others = [",".join(["0", *row.split(",")[1:]]) for row in rows]
    turns = (line for pair in zip(rows, others, strict=True) for line in pair)
    kinds = (f"{line},{('gyro', 'acc')[k % 2]}" for k, line in enumerate(turns))
    path = written(tmp_path / "two.csv", f"{header},kind", kinds)
    made = propagate(path, series=series, **reading("rad", "t_ns"))
    assert_attitudes(made, propagated(RAW[False], {}))


@pytest.mark.parametrize("layout", [None, "scalar-first", "wxyz", "scalar-last", "xyzw"])
def test_the_layout_that_is_written(layout, files, tmp_path):
    """The four columns are in the order asked for, under their names."""
    out = tmp_path / "out.csv"
    options = reading("rad", "t_ns") | {"output": out} | ({"layout": layout} if layout else {})
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]
    run("propagate", files["rad", "t_ns", False], *arguments, code=0)
    header, *rows = out.read_text().splitlines()
    scalar_first = layout in {None, "scalar-first", "wxyz"}
    assert header == ("t_ns,qw,qx,qy,qz" if scalar_first else "t_ns,qx,qy,qz,qw")
    numbers = [list(map(float, row.split(",")[1:])) for row in rows]
    _, attitudes = propagated(RAW[False], {})
    ours = Rotation.from_quat(numbers, scalar_first=scalar_first)
    assert (attitudes.inv() * ours).magnitude().max() < 1e-11


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(60))
def test_command_lines_do_what_the_documents_say(seed, tmp_path):
    """Random logs and options together, with errors and copies; `make fuzz` runs 2,000."""
    code, told = difference(seed, tmp_path)
    assert told is None
    assert code in {0, 2, 3}


def test_every_option_is_in_some_test():
    """A new option of propagate has to be tested here too, or to be named with where it is."""
    elsewhere = {"msg_path": "test_msg_files.py", "threads": "test_threads.py"}
    errors = ("noise_density", "bias_sigma", "random_walk", "scale_sigma", "imu", "sigma")
    elsewhere |= dict.fromkeys((*errors, "sigma_axes"), "test_gyro_errors.py")
    here = {"rate_cols", "rate_unit", "time_col", "time_unit", "sample_rate", "q0_layout"}
    here |= {"series", "topic", "kind", "clock", "time_field", "rate_field"}
    for seed in range(130):
        here |= chosen(seed)[0].keys()
    assert set(PROPAGATE) == here | elsewhere.keys()
