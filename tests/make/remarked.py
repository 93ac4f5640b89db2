"""Logs and results for the table of remarks: functions of a folder that give what is said."""

import io
import json
import re
import struct
import sys
import warnings

import h5py
import numpy as np
from make.mcap import Topic, write_topics
from make.ros import IMU, ROS1, ROS2, imu_messages, message, write_messages
from make.tables import write_attitudes, write_rates
from rosbags.typesys import get_types_from_msg, get_typestore
from rosbags.typesys.stores import Stores

import quatprop
from quatprop import AttitudeSeries, GyroSeries, compare, convert, propagate, read_attitudes
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.pipeline.survey import survey
from quatprop.settings.reading import READ_RATES
from quatprop.settings.selection import RateSelection

EPOCH = 1_700_000_000_000_000_000
SECOND, MS = 10**9, 10**6


def noise(scale, count=2000):
    """Return white noise, ``(count, 3)``."""
    return np.random.default_rng(3).normal(0, scale, (count, 3))


def swinging(hz=100, count=2000, peak=5.0, hertz=0.5):
    """Return the rates of a body that swings, ``(count, 3)``, rad/s."""
    t_ns = np.arange(count) * (SECOND / hz)
    return swinging_at(t_ns, peak, hertz)


def swinging_at(t_ns, peak=5.0, hertz=0.5):
    """Return the rates of that body at given times, rad/s."""
    angle = 2 * np.pi * hertz * np.asarray(t_ns - t_ns[0])[:, None] / SECOND
    return peak * np.sin(angle * [1.0, 1.3, 0.7] + [0, 1, 2])


def at_rest(rate, t_ns=None):
    """Return what is said of the noise of rates in memory."""
    t_ns = stamps(len(rate)) if t_ns is None else t_ns
    return lambda _: quatprop.noise(GyroSeries(t_ns, rate)).remarks


def calibrated(t_ns):
    """Return what is said of a calibration of swinging rates at given times."""
    rates = GyroSeries(t_ns, swinging_at(t_ns))
    reference = quatprop.propagate(rates[np.unique(t_ns, return_index=True)[1]], method="coning")
    return lambda _: quatprop.calibrate(rates, reference, estimate="bias").remarks


def with_value(array, at, value):
    """Return an array with another value in a place."""
    array = np.array(array, float if np.asarray(array).dtype.kind == "f" else np.int64)
    array[at] = value
    return array


def stamps(count, hz=100, first=EPOCH):
    """Return steady stamps, ns."""
    return first + np.arange(count) * (SECOND // hz)


OF_LOGS = re.compile(rf"\b({'|'.join(name for name in READ_RATES if '_' in name)})\b")
"""Settings that are refused for rates in memory."""


def in_memory(rate, hz=100, t_ns=None, spans=None, *, averages=False, **options):
    """Propagate rates in memory."""

    def made(folder):
        times = stamps(len(rate), hz) if t_ns is None else t_ns
        series = GyroSeries(times, rate, spans, averages)
        given = {k: v(folder) if callable(v) else v for k, v in options.items()}
        said = propagate(series, **given).report.remarks
        for remark in said:
            assert not OF_LOGS.search(remark), "it is refused for rates in memory"
        return said

    return made


def rates_of(path, **options):
    """Read and propagate the rates of a log: all that is said of them, and as warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        said = propagate(path, **options).report.remarks
    warned = [one.message for one in caught if isinstance(one.message, quatprop.RemarkWarning)]
    assert [(one.code, str(one)) for one in warned] == [(r.code, f"{path}: {r}") for r in said]
    return said


def of_table(text, name="log.csv", **options):
    """Propagate a table."""

    def made(folder, **more):
        path = folder / name
        path.write_text(text)
        return rates_of(path, **(options | more))

    return made


def rows(count=30, cells="{k},0.1,0.2,{k}\n", head="t_ms,wx_rad_s,wy_rad_s,wz_rad_s\n"):
    """Return a table as text."""
    return head + "".join(cells.format(k=k) for k in range(count))


def of_parts(count):
    """Propagate a table that is in so many files."""

    def made(folder):
        lines = rows().splitlines(keepends=True)
        paths = [folder / f"{number}.csv" for number in range(count)]
        for number, path in enumerate(paths):
            path.write_text(lines[0] + "".join(lines[1:][number::count]))
        return propagate(paths).report.remarks

    return made


def of_messages(name="log.mcap", *, options=None, edit=bytes, each=None, count=200, **given):
    """Propagate Imu messages; `edit` changes the bytes of the file, `each` a message."""

    def made(folder, **more):
        fields = {"t_ns": stamps(count), "rate": swinging(count=count), **given}
        messages = imu_messages(**fields)
        if each is not None:
            messages = (each(k, *one) for k, one in enumerate(messages))
        path = write_messages(folder / name, messages)
        path.write_bytes(edit(path.read_bytes()))
        return rates_of(path, **((options or {}) | more))

    return made


def attitudes_of(cells="{k},1,0,0,0\n", head="t_ns,qw,qx,qy,qz\n", name="a.csv", count=5):
    """Read a table of attitudes."""

    def made(folder):
        (folder / name).write_text(rows(count, cells, head))
        return warned(read_attitudes, folder / name)

    return made


def warned(function, *args, **options):
    """Call a function, and return the remarks of which it warns."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        function(*args, **options)
    return [one.message for one in caught if isinstance(one.message, quatprop.RemarkWarning)]


def converted(t_ns, wxyz, to="out.csv", more=(), head="", **options):
    """Convert attitudes from a table, with other columns beside them."""

    def made(folder, **given):
        columns = [t_ns, *np.transpose(wxyz), *more]
        lines = [",".join(map(str, each)) for each in zip(*columns, strict=True)]
        path = write_rates(folder / "in.csv", lines, f"t_ns,qw,qx,qy,qz{head}")
        if "relative_to" in options:
            given["relative_to"] = options["relative_to"](folder)
        return convert(path, folder / to, **{**options, **given}).remarks

    return made


def still_body(t_ns):
    """Return what writes the attitudes of a body that does not turn."""
    lines = [f"{t},1,0,0,0" for t in t_ns]
    return lambda folder: write_rates(folder / "still.csv", lines, "t_ns,qw,qx,qy,qz")


def compared(a, b, **options):
    """Compare two series."""
    return lambda _: compare(a, b, **options).remarks


def clipped_and_calibrated(rate, largest=4.0):
    """Return rates that the sensor clipped, and a calibration spread over a few percent."""
    matrix = [[1.01, 0.012, -0.008], [0.009, 0.99, 0.011], [-0.01, 0.007, 1.02]]
    return np.clip(rate, -largest, largest) @ np.transpose(matrix) + noise(2e-3, len(rate))


def resting(change=0.0, motion=1.0):
    """Return 10 s of rest, 5 s of motion and 10 s of rest with another bias, at 100 Hz."""
    bias = np.array([0, 0, 2e-3])
    rest = noise(1e-3, 1000) + bias
    return np.concatenate(
        [rest, motion * swinging(count=500), rest[::-1] + np.array([0, 0, change])]
    )


def integers(rate, step):
    """Return rates in steps."""
    return np.rint(rate / step) * step


def oriented(rate, scale=1.0):
    """Return what messages have of a body: rates times a scale, and the attitudes."""
    t_ns = stamps(len(rate))
    return {"count": len(rate), "rate": rate * scale, "wxyz": attitudes(t_ns, rate)}


TWENTY = swinging(count=20)


def biases(folder, count):
    """Write biases at the first stamps."""
    lines = [(t_ns, 0.01, 0, 0) for t_ns in stamps(count).tolist()]
    return write_rates(
        folder / "bias.csv",
        lines,
        "t_ns,gyro_bias_x [rad/s],gyro_bias_y [rad/s],gyro_bias_z [rad/s]",
    )


def kalibr(folder, by_force):
    """Write a calibration as kalibr has it."""
    parts = {"M": np.eye(3).tolist(), "A": (by_force * np.eye(3)).tolist()}
    path = folder / "imu.yaml"
    path.write_text(json.dumps({"imu0": {"gyroscopes": parts}}))
    return path


def wanted(folder, count):
    """Write the stamps at which attitudes are wanted."""
    return write_attitudes(folder / "at.csv", stamps(count), np.tile([1.0, 0, 0, 0], (count, 1)))


def framed(*frames):
    """Return what gives messages frames in turn."""

    def each(k, topic, kind, at, values):
        values["header"]["frame_id"] = frames[k % len(frames)]
        return topic, kind, at, values

    return each


def covered(*first):
    """Return what gives messages a covariance of the rates that begins with these numbers."""

    def each(k, topic, kind, at, values):
        covariance = [first[k % len(first)]] * 9
        return topic, kind, at, values | {"angular_velocity_covariance": covariance}

    return each


def with_sigmas(count, diagonal, odd):
    """Read attitudes with a covariance, which the last message has differently."""

    def made(folder):
        covariances = [np.diag(diagonal).ravel()] * (count - 1) + [np.diag(odd).ravel()]
        wxyz = np.tile([0.8, 0.6, 0, 0], (count, 1))
        messages = imu_messages(stamps(count), wxyz=wxyz, orientation_covariance=covariances)
        return warned(read_attitudes, write_messages(folder / "log.mcap", messages))

    return made


def outer_stamps(first):
    """Read messages that hold an Imu, whose own stamps are these at first and then good."""

    def made(folder):
        store = get_typestore(Stores.ROS2_HUMBLE)
        store.register(
            get_types_from_msg("std_msgs/Header header\nsensor_msgs/Imu imu\n", "p/msg/Motion")
        )
        messages, inner = [], with_value(stamps(20), slice(0, first), 0).tolist()
        for at, own, rate in zip(stamps(20).tolist(), inner, TWENTY, strict=True):
            imu = {"header": {"stamp": own}, "angular_velocity": rate}
            messages.append(("/imu", "p/msg/Motion", at, {"header": {"stamp": at}, "imu": imu}))
        return rates_of(write_messages(folder / "log.mcap", messages, types=(ROS1, store)))

    return made


def of_two(second, topic="/imu"):
    """Read a log in which a topic has messages of a second definition or type."""

    def made(folder):
        text, _ = ROS2.generate_msgdef(IMU, ros_version=2)
        data = [
            (at, bytes(ROS2.serialize_cdr(message(ROS2, kind, values), kind)))
            for _, kind, at, values in imu_messages(stamps(40), swinging(count=40))
        ]
        name, definition, messages = second(text, data)
        topics = [
            ("/imu", Topic(IMU, data[:20], text.encode(), "ros2msg", "cdr")),
            (topic, Topic(name, messages, definition.encode(), "ros2msg", "cdr")),
        ]
        return rates_of(write_topics(folder / "log.mcap", topics, profile="ros2"))

    return made


def longer(text, data):
    """Return the second half of the messages, by a definition with another field."""
    more = text.replace("\n====", "\nuint8 more\n====", 1)
    return IMU, more, [(at, one + b"\0") for at, one in data[20:]]


def beside(_, data):
    """Return messages of text."""
    return "std_msgs/msg/String", "string data", [(at, bytes(8)) for at, _ in data[20:]]


def by_file(is_needed):
    """Read messages whose definition is in a file beside the log, or in the log."""

    def made(folder):
        (folder / "my_msgs" / "msg").mkdir(parents=True)
        text = "float64 x\nfloat64 y\nfloat64 z\n"
        (folder / "my_msgs" / "msg" / "Gyro.msg").write_text(text)
        data = [
            (at, b"\0\1\0\0" + struct.pack("<3d", *w))
            for at, w in zip(stamps(20).tolist(), TWENTY, strict=True)
        ]
        own = ("", "") if is_needed else (text, "ros2msg")
        topic = Topic("my_msgs/msg/Gyro", data, own[0].encode(), own[1], "cdr")
        path = write_topics(folder / "log.mcap", {"/gyro": topic}, profile="ros2")
        return rates_of(path, rate_field="x,y,z", rate_unit="rad/s", clock="log")

    return made


def other_definition(data):
    """Return a bag whose definition has another MD5 sum than is stated."""
    return re.sub(rb"md5sum=\w{32}", b"md5sum=" + b"0" * 32, data)


def own_type(edit):
    """Read a ROS 1 bag of a type of its own."""

    def made(folder):
        store = get_typestore(Stores.ROS1_NOETIC)
        store.register(
            get_types_from_msg(
                "Header header\ngeometry_msgs/Vector3 angular_velocity\n", "p/msg/Own"
            )
        )
        messages = [
            ("/imu", "p/msg/Own", t, {"header": {"stamp": t}, "angular_velocity": w})
            for t, w in zip(stamps(20).tolist(), TWENTY, strict=True)
        ]
        path = write_messages(folder / "log.bag", messages, types=(store, ROS2))
        path.write_bytes(edit(path.read_bytes()))
        return rates_of(path, rate_field="angular_velocity", rate_unit="rad/s")

    return made


def of_survey(folder, wxyz):
    """Look at messages with rates and attitudes."""
    path = write_messages(
        folder / "log.mcap", imu_messages(stamps(len(wxyz)), swinging(count=len(wxyz)), wxyz)
    )
    found = survey(str(path), None, RateSelection())
    return [remark for one in (*found.sources, *found.attitudes) for remark in one.remarks]


def counted(numbers, name="PacketCounter", head=""):
    """Return a table with a column that counts."""
    return f"{head}{name},wx_rad_s,wy_rad_s,wz_rad_s\n" + "".join(
        f"{n},0.1,0.2,0.{n % 9}\n" for n in numbers
    )


def of_survey_of_text(name):
    """Look at a table, which may be on stdin."""

    def made(folder):
        (folder / "log.csv").write_text(rows())
        path, stdin = name if name == "-" else str(folder / name), sys.stdin
        sys.stdin = io.TextIOWrapper(io.BytesIO(rows().encode()))
        try:
            return [
                one for each in survey(path, None, RateSelection()).sources for one in each.remarks
            ]
        finally:
            sys.stdin = stdin

    return made


def of_hdf5(folder, link):
    """Read a file with a link."""
    path = folder / "log.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["g"], file["other"] = stamps(20), TWENTY, link
    return rates_of(
        path, rate_cols="g[0],g[1],g[2]", time_col="t", rate_unit="rad/s", time_unit="ns"
    )


def of_px4(folder):
    """Read an attitude of PX4."""
    definition = b"uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n"
    data = b"\0\1\0\0" + struct.pack("<2Q4f", 9, 7, 0.5, -0.5, 0.5, 0.5)
    topic = Topic("px4_msgs/msg/VehicleAttitude", [data], definition, "ros2msg", "cdr")
    path = write_topics(folder / "log.mcap", {"/fmu/out/vehicle_attitude": topic})
    return warned(read_attitudes, path)


T_NS, TURNED = stamps(100), attitudes(stamps(100), swinging(count=100))


def shifted():
    """Return the truth at a tenth of its stamps, later by half an interval."""
    return AttitudeSeries(T_NS[4:90:10] + 5 * MS, TURNED[4:90:10])


def turned(*vector):
    """Return the truth, turned in its reference."""
    return AttitudeSeries(T_NS, multiply(exp(np.array(vector)), TURNED))


def poses(out):
    """Convert a trajectory."""
    lines = [f"{k}.5 1 2 {k} 0.6 0 0 0.8" for k in range(5)]
    return convert(write_rates(out.with_name("in.tum"), lines, "# poses"), out).remarks
