"""Every option of propagate, alone and together, against an independent computation.

The reference (``make/options_reference.py``) is written from the documentation, without quatprop.
Random logs and command lines are those of ``fuzz/command_lines.py``; what it cannot say is here.
"""

from fractions import Fraction

import numpy as np
import pytest
from fuzz.command_lines import command_line, difference, recording, write_log
from make.commands import run
from make.options_reference import NS, propagated
from make.ros import IMU, ROS1, imu_messages, write_messages
from make.tables import write_rates
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from quatprop import propagate
from quatprop.base.errors import TimelineError
from quatprop.settings import PROPAGATE


def log(late=(), missing=()):
    """Return the rows of a log that rests, then turns; some are late, some have no rates."""
    random = np.random.default_rng(7)
    t = 1_700_000_000_123_456_789 + np.cumsum(random.integers(9_000_000, 11_000_000, 280))
    t[list(late)] -= 31_000_000
    w = 3 * np.sin(np.arange(280)[:, None] / 15 + np.arange(3))
    w[list(missing)] = np.nan
    w[:130] *= 1e-3
    f = Rotation.from_euler("xyz", [0.4, -0.2, 0.0]).apply([0, 0, 9.81])
    q = Rotation.from_rotvec(random.normal(0, 1e-3, (280, 3))) * Rotation.random(rng=random)
    return {"t": t, "w": w, "f": f + random.normal(0, 1e-3, (280, 3)), "q": q}


RAW = log()


def agree(t_ns, wxyz, raw, options):
    """Tell whether stamps and attitudes are those of the reference."""
    t, attitudes = propagated(raw, options)
    ours = Rotation.from_quat(wxyz, scalar_first=True)
    return t_ns.tolist() == t.tolist() and (attitudes.inv() * ours).magnitude().max() < 1e-11


def as_table(path, raw):
    """Write stamps and rates."""
    rows = zip(raw["t"].tolist(), raw["w"].tolist(), strict=True)
    return write_rates(path, [[t, *w] for t, w in rows], "t_ns,wx_rad_s,wy_rad_s,wz_rad_s")


@pytest.mark.thorough(keep=60)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(120))
def test_command_lines_do_what_the_documents_say(seed, tmp_path):
    """Random logs and options together, with errors and copies; `make fuzz` runs 2,000."""
    code, told = difference(seed, tmp_path)
    assert told is None
    assert code in {0, 2, 3}


LATE, MISSING = [60, 160, 161, 240], [20, 140, 141, 215]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("on_nonfinite", ["drop", "hold"])
@pytest.mark.parametrize("on_backwards", ["drop", "sort", "error"])
def test_events_are_located_by_their_rows(on_backwards, on_nonfinite, tmp_path):
    """A late or non-finite sample is named by its row in the log, whatever was dropped before."""
    path = as_table(tmp_path / "log.csv", log(late=LATE, missing=MISSING))
    if on_backwards == "error":
        with pytest.raises(TimelineError, match=f"at sample {LATE[0]} "):
            propagate(path, on_nonfinite=on_nonfinite)
        return
    counts = propagate(path, on_nonfinite=on_nonfinite, on_backwards=on_backwards).report.counts
    assert (counts.backwards.count, counts.backwards.first_index) == (len(LATE), LATE[0])
    assert (counts.nonfinite.count, counts.nonfinite.first_index) == (len(MISSING), MISSING[0])


LOG_NS, PUBLISH_NS = 7_000_000, 3_000_000


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Write the log as messages on three topics, whose three times all differ; return its path."""
    store, raw = get_typestore(Stores.ROS2_HUMBLE), RAW
    store.register(
        get_types_from_msg("builtin_interfaces/Time when\nfloat64[3] gyro", "lab/msg/Gyro")
    )
    wxyz = raw["q"].as_quat(scalar_first=True)
    imu = imu_messages(
        raw["t"], raw["w"], wxyz, recorded=raw["t"] + LOG_NS, linear_acceleration=list(raw["f"])
    )
    every = []
    for k, (topic, kind, at, values) in enumerate(imu):
        lab = {"when": int(raw["t"][k]), "gyro": np.degrees(raw["w"][k])}
        every += [(topic, kind, at, values), ("/other", IMU, at, values)]
        every += [("/lab", "lab/msg/Gyro", at, lab)]
    path = tmp_path_factory.mktemp("messages") / "log.mcap"
    return write_messages(path, every, types=(ROS1, store), published_ns=PUBLISH_NS - LOG_NS)


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
    """The topic, the field and the clock that are asked for, for rates and what is next to them."""
    raw = RAW | {"t": RAW["t"] + delay_ns}
    given = {"mount": "y,-x,z", "start": "+100ms"}
    if q0 is not None and "rate_field" not in options:
        given["q0"] = q0  # messages of the laboratory have rates alone
    series = propagate(messages, **options, **given)
    assert agree(series.t_ns, series.wxyz, raw, given)


@pytest.mark.parametrize("hz", ["100", "29.97", "30000/1001"])
def test_rows_without_a_time(hz, tmp_path):
    """Row k of a table without a time is at k / --sample-rate, rounded to the nearest ns."""
    raw = RAW
    path = write_rates(tmp_path / "rows.csv", raw["w"].tolist(), "gx,gy,gz")
    series = propagate(path, sample_rate=hz, rate_unit="rad/s", rate_cols=("gx", "gy", "gz"))
    t = np.array([round(k * NS / Fraction(hz)) for k in range(len(raw["t"]))])
    assert agree(series.t_ns, series.wxyz, raw | {"t": t}, {})


@pytest.mark.parametrize("series", ["gyro", "kind=gyro"])
@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_one_of_the_series_of_a_table(series, tmp_path):
    """Rows of others between its own change nothing."""
    header, *rows = as_table(tmp_path / "log.csv", RAW).read_text().splitlines()
    both = ([f"{row},gyro", f"0,{row.partition(',')[2]},acc"] for row in rows)
    turns = [row for pair in both for row in pair]
    made = propagate(write_rates(tmp_path / "two.csv", turns, f"{header},kind"), series=series)
    assert agree(made.t_ns, made.wxyz, RAW, {})


@pytest.mark.parametrize("layout", [None, "scalar-first", "wxyz", "scalar-last", "xyzw"])
def test_the_layout_that_is_written(layout, tmp_path):
    """The four columns are in the order asked for, under their names."""
    out = tmp_path / "out.csv"
    asked = ("--layout", layout) if layout else ()
    run("propagate", as_table(tmp_path / "log.csv", RAW), "-o", out, *asked, code=0)
    header, *rows = out.read_text().splitlines()
    scalar_last = layout in {"scalar-last", "xyzw"}
    assert header == ("t_ns,qx,qy,qz,qw" if scalar_last else "t_ns,qw,qx,qy,qz")
    q = np.array([row.split(",")[1:] for row in rows], dtype=np.float64)
    t_ns = np.array([int(row.split(",")[0]) for row in rows])
    assert agree(t_ns, np.roll(q, scalar_last, axis=1), RAW, {})


def test_every_option_is_in_some_test(tmp_path):
    """A new option of propagate has to be tested here too, or to be named with where it is."""
    elsewhere = {"msg_path": "test_msg_files.py", "threads": "test_threads.py"}
    elsewhere |= {"earth_rate": "test_earth_rate.py", "accel_cols": "test_hdf5.py"}
    elsewhere |= {"regular_time": "test_steady_clock.py", "in_sequence": "test_several_files.py"}
    errors = ("noise_density", "bias_sigma", "random_walk", "scale_sigma", "imu", "sigma")
    errors += ("misalignment_sigma", "q0_sigma", "sigma_axes")
    elsewhere |= dict.fromkeys(errors, "test_gyro_errors.py")
    here = {"sample_rate", "series", "topic", "kind", "clock", "time_field", "rate_field"}
    for seed in range(40):
        random = np.random.default_rng(seed)
        raw = recording(random)
        here |= command_line(random, raw, tmp_path, "csv")[0].keys()
        here |= write_log(tmp_path / "log.csv", raw, random).keys()
    assert set(PROPAGATE) == here | elsewhere.keys()
