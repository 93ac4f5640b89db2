"""Every remark in one table: what provokes it, and what is near to that and must not.

A remark is added with a row: its code, a log that has what it says, and one that is well, as
functions of a folder that return the remarks.
"""

import io
import json
import re
import struct
import sys
import warnings
from functools import partial
from types import SimpleNamespace

import h5py
import numpy as np
from make.mcap import Topic, write_topics
from make.ros import IMU, ROS2, TF, imu_messages, message, write_messages
from make.second_inputs import (
    BASE_TURNED,
    BIAS,
    STAMPS,
    Remarks,
    frozen,
    of_gyroscope,
    of_q0,
    of_vectors,
    swinging_after_rest,
    with_another_body,
)
from make.tables import write_attitudes, write_rates
from rosbags.typesys import get_types_from_msg, get_typestore
from rosbags.typesys.stores import Stores

import quatprop
from quatprop import AttitudeSeries, GyroSeries, compare, convert, propagate, read_attitudes
from quatprop.base.errors import Loss
from quatprop.comparison.comparison import compare as compare_series
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotate
from quatprop.propagation.survey import survey
from quatprop.settings.reading import READ_RATES, RateSelection
from quatprop.tools.check.judge import loss_notes

EPOCH = 1_700_000_000_000_000_000
SECOND, MS = 10**9, 10**6


def noise(scale, count=2000):
    """Return white noise, ``(count, 3)``."""
    return np.random.default_rng(3).normal(0, scale, (count, 3))


def swinging(hz=100, count=2000, peak=5.0, hertz=0.5):
    """Return the rates of a body that swings, ``(count, 3)``, rad/s."""
    return swinging_at(np.arange(count) * (SECOND / hz), peak, hertz)


def swinging_at(t_ns, peak=5.0, hertz=0.5):
    """Return the rates of that body at given times, rad/s."""
    angle = 2 * np.pi * hertz * np.asarray(t_ns - t_ns[0])[:, None] / SECOND
    return peak * np.sin(angle * [1.0, 1.3, 0.7] + [0, 1, 2])


def at_rest(rate, t_ns=None):
    """Return the remarks on the noise of rates in memory."""
    t_ns = stamps(len(rate)) if t_ns is None else t_ns
    return lambda _: quatprop.noise(GyroSeries(t_ns, rate)).remarks


def calibrated(t_ns):
    """Return the remarks on a calibration of swinging rates at given times."""
    rates = GyroSeries(t_ns, swinging_at(t_ns))
    reference = quatprop.propagate(rates[np.unique(t_ns, return_index=True)[1]], method="coning")
    return lambda _: quatprop.calibrate(rates, reference, estimate="bias").remarks


def calibrated_with(rate=None, shown=None, **options):
    """Return the remarks on rates that are changed, or of a reference that is.

    `rate`: what a function makes of the rates; `shown`: of those that the reference shows
    """
    t_ns = stamps(6000)
    true = sum(swinging_at(t_ns, 1.0, hertz) for hertz in (0.083, 0.217, 0.331))
    seen = true if shown is None else shown(true)
    reference = quatprop.propagate(GyroSeries(t_ns, seen), method="cubic")
    measured = (true if rate is None else rate(true)) + noise(2e-3, len(true))
    return lambda _: quatprop.calibrate(GyroSeries(t_ns, measured), reference, **options).remarks


def jumping(rate):
    """Return rates whose bias jumps by a degree a second in the middle."""
    return rate + np.radians(1.0) * (np.arange(len(rate)) > len(rate) / 2)[:, None]


def wobbling(rate):
    """Return the rates of a body that turns about z, and rolls and pitches to and fro."""
    angle = 2 * np.pi * np.arange(len(rate))[:, None] / 100 * [0.9, 1.3, 0.0]
    return rate * [0, 0, 1] + 0.05 * np.sin(angle)


def changing(rate):
    """Return rates whose scale is another one in every third of thirty parts."""
    part = np.arange(len(rate)) * 30 // len(rate) % 3 == 1
    return rate * np.where(part, 0.9985, 1.0005)[:, None]


def with_value(array, at, value):
    """Return an array with another value in a place."""
    array = np.array(array, float if np.asarray(array).dtype.kind == "f" else np.int64)
    array[at] = value
    return array


def filled_in(rate, begin, end):
    """Return rates with rows on the straight lines between those beside."""
    rate[begin:end] = np.linspace(rate[begin - 1], rate[end], end - begin + 2)[1:-1]
    return rate


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
        said = Remarks(propagate(series, **given))
        for remark in said:
            assert not OF_LOGS.search(remark), "it is refused for rates in memory"
        return said

    return made


def felt_by(*, own, force=(0.0, 0.0, 9.81)):
    """Return the remarks on a level start; `own`: whether those of the rates have forces."""

    def made(folder, **more):
        up = {"linear_acceleration": [[*force]] * 200}
        rates = imu_messages(stamps(200), noise(1e-3, 200), **(up if own else {}))
        messages = [("/gyro", *one) for _, *one in rates]
        messages += [("/accel", *one) for _, *one in imu_messages(stamps(200), **up)]
        path = write_messages(folder / "log.bag", messages)
        return rates_of(path, topic="/gyro", **({"q0": "level"} | more))

    return made


def rates_of(path, **options):
    """Read and propagate the rates of a log; return all remarks, also those issued as warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        said = Remarks(propagate(path, **options))
    warned = [one.message for one in caught if isinstance(one.message, quatprop.RemarkWarning)]
    assert [(one.code, str(one)) for one in warned] == [(r.code, f"{path}: {r}") for r in said]
    return said


def on_slope(degrees):
    """Return the remarks on headings as the attitudes of a body on a slope."""

    def made(folder, **more):
        pitched = exp([0, np.radians(degrees), 0])
        rate = np.clip(np.arange(200) - 120, 0, 1)[:, None] * swinging(count=200) * [0, 0, 0.3]
        force = [rotate(conjugate(pitched), [0.0, 0.0, 9.81]).tolist()] * 200
        messages = [*imu_messages(stamps(200), rate, linear_acceleration=force)]
        turns = attitudes(stamps(200), rate)
        for _, *imu in imu_messages(stamps(200), wxyz=turns):
            messages.append(("/base", *imu))
        path = write_messages(folder / "log.bag", sorted(messages, key=lambda one: one[2]))
        return rates_of(path, topic="/imu", **({"q0": "/base"} | more))

    return made


def of_frames(*angles, **options):
    """Propagate the rates of a sensor beside the attitudes of another frame.

    `angles`: rad about z, by which static transforms turn the one into the other
    """

    def made(folder, **more):
        turned = [[[0, "base"], "imu", ([0, 0, 0], exp([0, 0, z])[[1, 2, 3, 0]])] for z in angles]
        messages = [("/tf_static", TF, EPOCH - 9, [[one]]) for one in turned]
        for imu in imu_messages(stamps(200), swinging(count=200)):
            at = {"header": {"stamp": imu[2], "frame_id": "odom"}, "child_frame_id": "base"}
            own = {"pose": {"pose": {"orientation": [0.0, 0.0, 0.6, 0.8]}}}
            messages += [imu, ("/odom", "nav_msgs/msg/Odometry", imu[2], at | own)]
        path = write_messages(folder / "log.bag", messages)
        return rates_of(path, topic="/imu", **(options | more))

    return made


def of_inverse(folder, **more):
    """Propagate a log whose orientation is the inverse, or with what `convert` makes of it."""
    facts = inverted(swinging(peak=2.0))
    if more:
        rates = imu_messages(stamps(2000), facts["rate"], facts["wxyz"])
        path = write_messages(folder / "inverse.bag", rates)
        convert(path, folder / "turned.csv", **more)
        facts["wxyz"] = read_attitudes(folder / "turned.csv").wxyz
    said = of_messages(**facts)(folder)
    said.attitudes = AttitudeSeries(stamps(2000), facts["wxyz"])
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
            size = len(lines) // count
            path.write_text(lines[0] + "".join(lines[1:][number * size : (number + 1) * size]))
        return propagate(paths).report.remarks

    return made


def of_topics(*topics):
    """Propagate the first of topics, each of which is in a file of its own."""

    def made(folder):
        paths = []
        for number, topic in enumerate(topics):
            t_ns = stamps(200) + number * 3 * SECOND
            messages = [(topic, *one[1:]) for one in imu_messages(t_ns, swinging_at(t_ns))]
            paths.append(write_messages(folder / f"{number}.mcap", messages))
        return propagate(paths, topic=topics[0]).report.remarks

    return made


def of_clock(*, step=0, late=0, missing=0):
    """Propagate messages whose stamps step in the middle, or of which some are missing.

    `late`: by how much their times of recording step as well, ns
    """

    def made(folder, **more):
        k = np.arange(2400)
        keep = k % 40 >= missing
        is_later = k >= 1800
        t_ns = stamps(2400) + step * is_later
        recorded = stamps(2400) + MS + late * is_later
        rate = swinging(count=2400, peak=1.0)
        messages = imu_messages(t_ns[keep], rate[keep], recorded=recorded[keep])
        path = write_messages(folder / "log.mcap", messages)
        return rates_of(path, **more)

    return made


FROM_START = {"start": EPOCH}


def turned_from(row):
    """Return the messages of rates whose axes are others than before, from a row on."""
    rate = swinging(count=6000, peak=1.0, hertz=0.2)
    own = attitudes(stamps(6000), rate, method="mean")
    rate[row:] *= [1, -1, -1]
    return {"rate": rate, "wxyz": own, "t_ns": stamps(6000)}


def of_copies(count):
    """Propagate a table in two files, of which the second repeats so many rows of the first."""

    def made(folder):
        head, *lines = rows(60).splitlines(keepends=True)
        paths = [folder / "1.csv", folder / "2.csv"]
        for path, begin in zip(paths, (0, 30 - count), strict=True):
            path.write_text(head + "".join(lines[begin : begin + 30]))
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


def with_clock(speed):
    """Propagate Imu messages in wall time, recorded with the clock of a simulation at a speed."""

    def made(folder):
        t_ns = stamps(400)
        clock = (
            ("/clock", "rosgraph_msgs/msg/Clock", int(at), {"clock": int(speed * (at - t_ns[0]))})
            for at in t_ns
        )
        messages = [*imu_messages(t_ns=t_ns, rate=swinging(count=400)), *clock]
        path = write_messages(folder / "log.mcap", sorted(messages, key=lambda one: one[2]))
        return rates_of(path)

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
    """Convert attitudes from a table, with other columns next to them."""

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


def in_reference(rate):
    """Return the same with rates in reference axes."""
    facts = oriented(rate)
    return facts | {"rate": rotate(facts["wxyz"], rate)}


def inverted(rate):
    """Return the same with attitudes from reference to body."""
    facts = oriented(rate)
    return facts | {"wxyz": conjugate(facts["wxyz"])}


def next_to_gravity(rate, scale):
    """Return what messages have of a body on the spot: rates times a scale, and accelerations."""
    facts = oriented(rate, scale)
    gravity = rotate(conjugate(facts.pop("wxyz")), np.tile([0.0, 0.0, 9.81], (len(rate), 1)))
    return facts | {"linear_acceleration": gravity.tolist()}


def of_joined(angle):
    """Propagate a table of two recordings, between which the body was turned by an angle, rad."""

    def made(folder):
        facts = next_to_gravity(TUMBLING, 1.0)
        force = np.array(facts["linear_acceleration"])
        force[1000:] = rotate(exp(np.array([angle, 0, 0])), force[1000:])
        cells = np.column_stack([stamps(2000, first=0) / SECOND, TUMBLING, force])
        lines = [",".join(map(str, one)) for one in cells.tolist()]
        names = "t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
        return rates_of(write_rates(folder / "log.csv", lines, names))

    return made


def of_forces(name):
    """Begin level in a table whose forces have a name; of the axes, in capitals."""
    lines = [f"{k * 10},0.001,0.002,{k % 2 / 1000},0,0,-1" for k in range(300)]
    names = ",".join(map(name.format, "XYZ"))
    head = f"t_ms,wx_rad_s,wy_rad_s,wz_rad_s,{names}"
    return lambda folder: rates_of(write_rates(folder / "log.csv", lines, head), q0="level")


TWENTY = swinging(count=20)


def biases(folder, count, lost=0):
    """Write biases at the first stamps, except some from the tenth on."""
    t_ns = np.delete(stamps(count), slice(9, 9 + lost))
    lines = [(stamp, 0.01, 0, 0) for stamp in t_ns.tolist()]
    return write_rates(
        folder / "bias.csv",
        lines,
        "t_ns,gyro_bias_x [rad/s],gyro_bias_y [rad/s],gyro_bias_z [rad/s]",
    )


def between_attitudes(lost, folder, **options):
    """Propagate from an attitude between two, from which some are missing."""
    t_ns = np.delete(stamps(40) - MS, slice(1, 1 + lost))
    return in_memory(TWENTY, q0=still_body(t_ns), **options)(folder)


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
    """Return what gives 200 messages frames, one after the other."""

    def each(k, topic, kind, at, values):
        values["header"]["frame_id"] = frames[k * len(frames) // 200]
        return topic, kind, at, values

    return each


def covered(*first):
    """Return what gives messages a covariance of the rates that begins with these numbers."""

    def each(k, topic, kind, at, values):
        covariance = [first[k % len(first)]] * 9
        return topic, kind, at, values | {"angular_velocity_covariance": covariance}

    return each


def of_split(**options):
    """Propagate a log with the accelerations on a topic of their own."""

    def made(folder, **more):
        given = {"t_ns": stamps(200), "rate": swinging(count=200)}
        absent = [
            ("/accel", kind, t_ns, values | {"angular_velocity_covariance": [-1.0] * 9})
            for _, kind, t_ns, values in imu_messages(**given)
        ]
        present = [("/gyro", *rest) for _, *rest in imu_messages(**given)]
        return rates_of(write_messages(folder / "log.mcap", absent + present), **(options | more))

    return made


def with_sigmas(count, diagonal, odd):
    """Read attitudes with a covariance, which the last message has differently."""

    def made(folder):
        covariances = [np.diag(diagonal).ravel()] * (count - 1) + [np.diag(odd).ravel()]
        wxyz = np.tile([0.8, 0.6, 0, 0], (count, 1))
        messages = imu_messages(stamps(count), wxyz=wxyz, orientation_covariance=covariances)
        return warned(read_attitudes, write_messages(folder / "log.mcap", messages))

    return made


def of_own_type(definition, values, name="log.mcap", edit=bytes, **options):
    """Read messages of a type of its own, which have a header and these values."""

    def made(folder):
        stores = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
        for store in stores:
            text = f"std_msgs/Header header\n{definition}\n"
            store.register(get_types_from_msg(text, "p/msg/Own"))
        messages = [
            ("/imu", "p/msg/Own", at, {"header": {"stamp": at}, **values(k, rate)})
            for k, (at, rate) in enumerate(zip(stamps(20).tolist(), TWENTY, strict=True))
        ]
        path = write_messages(folder / name, messages, types=stores)
        path.write_bytes(edit(path.read_bytes()))
        return rates_of(path, **options)

    return made


def outer_stamps(first):
    """Read messages that hold an Imu, whose own stamps are zero at first and then good."""
    inner = with_value(stamps(20), slice(0, first), 0).tolist()

    def values(k, rate):
        return {"imu": {"header": {"stamp": inner[k]}, "angular_velocity": rate}}

    return of_own_type("sensor_msgs/Imu imu", values)


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


def of_text(_, data):
    """Return messages of text."""
    return "std_msgs/msg/String", "string data", [(at, bytes(8)) for at, _ in data[20:]]


def by_file(is_needed):
    """Read messages whose definition is in a file next to the log, or in the log."""

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
    options = {"rate_field": "w", "rate_unit": "rad/s"}
    definition = "geometry_msgs/Vector3 w"
    return of_own_type(definition, lambda _, rate: {"w": rate}, "log.bag", edit, **options)


def of_survey(folder, wxyz, t_ns=None):
    """Look at messages with rates and attitudes."""
    t_ns = stamps(len(wxyz)) if t_ns is None else t_ns
    messages = imu_messages(t_ns, swinging(count=len(wxyz)), wxyz)
    path = write_messages(folder / "log.mcap", messages)
    found = survey(str(path), None, RateSelection())
    return [remark for one in (*found.sources, *found.attitudes) for remark in one.remarks]


def beside_a_clock(jump):
    """Return a table with a second clock that jumps in the middle, s."""
    return "t_ms,gps_time_s,wx_rad_s,wy_rad_s,wz_rad_s\n" + "".join(
        f"{10 * k},{k / 100 + jump * (k > 2000) + 1e5},0.1,0.2,0.{k % 9}\n" for k in range(4000)
    )


TWICE = "{k},0.1,0.2,{k},0.1,0.3,{k}\n"


def two_sensors(end):
    """Return the header of a table with the rates of a second sensor, with an end of its names."""
    names = [f"w{axis}_rad_s" for axis in "xyz"]
    return ",".join(["t_ms", *names, *(f"{name}{end}" for name in names)]) + "\n"


def of_subjects(one, other):
    """Return a table with the label of a body, and from the middle on another one."""
    each = (f"{10 * k},{one if k < 2000 else other},0.1,0.2,0.{k % 9}\n" for k in range(4000))
    return f"t_ms,subject,wx_rad_s,wy_rad_s,wz_rad_s\n{''.join(each)}"


def counted(numbers, name="PacketCounter", head=""):
    """Return a table with a column that counts."""
    return f"{head}{name},wx_rad_s,wy_rad_s,wz_rad_s\n" + "".join(
        f"{n},0.1,0.2,0.{k % 9}\n" for k, n in enumerate(numbers)
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


def turned(*vector):
    """Return the truth, turned in its reference."""
    return AttitudeSeries(T_NS, multiply(exp(np.array(vector)), TURNED))


def poses(out):
    """Convert a trajectory."""
    lines = [f"{k}.5 1 2 {k} 0.6 0 0 0.8" for k in range(5)]
    return convert(write_rates(out.with_name("in.tum"), lines, "# poses"), out).remarks


DEG = np.pi / 180
STATIC = {"bias": "static"}
TUMBLING = 0.5 * np.sin(np.arange(2000)[:, None] / [30, 41, 57])
SLOW_TURN = np.tile([0.01, 0.02, 0.03], (1000, 1))
STILL_FORCE = {"linear_acceleration": [(0.0, 0.0, 9.81)] * 2500}
WAVES = swinging(count=2000, hz=200)
STILL = np.concatenate([np.full((1000, 3), 0.02), swinging(count=500)])
PEAK = integers(swinging(2000, 8000, 5.0, 0.4), 0.01)
"""Its rounded peaks are flat for many samples, and so are all its slow parts."""
RATES = {
    "zero-rates": (in_memory(np.zeros((50, 3))), in_memory(with_value(np.zeros((50, 3)), 9, 1e-9))),
    "beyond-range": (in_memory(swinging(2000, peak=80)), in_memory(swinging(2000, peak=60))),
    "frozen": (
        in_memory(np.tile([0.1, 0.2, 0.3], (200, 1))),
        in_memory(with_value(np.tile([0.1, 0.2, 0.3], (200, 1)), (7, 1), 0.2001)),
    ),
    # A motion about two axes that is simulated has no noise.
    "frozen-axis": (
        in_memory((swinging(peak=1.0) + noise(5e-3)) * [1, 0, 1]),
        in_memory(swinging(peak=1.0) * [1, 0, 1]),
    ),
    "filled-in": (
        in_memory(filled_in(swinging(peak=1.0) + noise(5e-3), 930, 980)),
        in_memory(filled_in(swinging(peak=1.0) + noise(5e-3), 930, 935)),
    ),
    # A motion that returns has other noise.
    "repeated-rows": (
        in_memory(np.tile(swinging(peak=1.0)[:800] + noise(5e-3)[:800], (2, 1))),
        in_memory(np.tile(swinging(peak=1.0)[:800], (2, 1)) + noise(5e-3)[:1600]),
    ),
    "dropout": (
        in_memory(with_value(swinging(peak=1.0), slice(930, 980), 0.0)),
        in_memory(with_value(swinging(peak=1.0), (slice(930, 980), 0), 0.0)),
    ),
    # A body that is hit goes on to swing.
    "spikes": (
        in_memory(with_value(swinging(peak=1.0), (700, 1), -20.0)),
        in_memory(with_value(swinging(peak=1.0), (slice(700, 703), 1), [-20.0, 8.0, -3.0])),
    ),
    # A body that is switched has the same rate before and after.
    "wrapped": (
        in_memory((swinging(peak=40.0, hertz=0.1) + 35) % 70 - 35),
        in_memory(np.sign(swinging(hertz=0.1)) * 35 + noise(0.05)),
    ),
    "alternating": (
        in_memory(swinging(peak=1.0) * np.tile([[1], [-1]], (1000, 1))),
        in_memory(swinging(peak=1.0) + noise(0.1)),
    ),
    # Rounded rates are often equal, too.
    "held-samples": (in_memory(WAVES[np.arange(2000) // 4 * 4], 200), in_memory(PEAK, 2000)),
    # Samples at the top of a rounded peak are equal, too.
    "saturated": (in_memory(np.clip(WAVES, -4, 4), 200), in_memory(PEAK, 2000)),
    # The peaks of a sine are equal, and 40 samples a turn have the same phases in all of them.
    "piled-up": (
        in_memory(clipped_and_calibrated(WAVES), 200),
        in_memory(swinging(25, hertz=0.625) * [0, 0, 1] + noise(1e-4), 25),
    ),
    "too-slow": (in_memory(swinging(2)), in_memory(swinging(20))),
    "unit-by-steps": (
        in_memory(integers(swinging(), 500 / 32768)),
        in_memory(integers(swinging(), 500 / 32768 * DEG)),
    ),
    "unit-changes": (
        in_memory((swinging(peak=0.3) + noise(1e-3)) * np.repeat([1, 1 / DEG], 1000)[:, None]),
        in_memory(swinging(peak=0.3) * np.repeat([1, 1 / DEG], 1000)[:, None] + noise(1e-3)),
    ),
    # All axes of a coarse sensor come in its steps.
    "cut-decimals": (
        in_memory(np.where([True, False, False], np.trunc(swinging()), swinging())),
        in_memory(np.trunc(swinging())),
    ),
    # All-zero twists next to an orientation were reported as scaled by pi/180.
    "rates-off-scale": (
        of_messages(**oriented(SLOW_TURN, DEG)),
        of_messages(**oriented(SLOW_TURN, 0.0)),
    ),
    # Of left-handed axes, the orientation may be the inverse.
    "other-axes": (
        of_messages(**oriented(swinging(peak=1.0), [1, -1, -1])),
        of_messages(**oriented(swinging(peak=1.0), [-1, -1, -1])),
    ),
    "gravity-off-scale": (
        of_messages(**next_to_gravity(TUMBLING, DEG)),
        of_messages(**next_to_gravity(TUMBLING, 1.4)),
    ),
    # About one axis, others are as likely.
    "reversed-forces": (of_forces("accelerometerAcceleration{}(G)"), of_forces("acc_{} [m/s^2]")),
    "recordings-joined": (of_joined(1.0), of_joined(0.3)),
    "gravity-other-axes": (
        of_messages(**next_to_gravity(TUMBLING, [1, -1, 1])),
        of_messages(**next_to_gravity(TUMBLING * [1, 0, 0], [-1, -1, 1])),
    ),
    "other-frame": (
        of_messages(**in_reference(swinging(peak=3.0))),
        of_messages(**in_reference(swinging(peak=3.0) * [0, 0, 1])),
    ),
    "rates-contradict": (
        of_messages(**oriented(swinging(peak=2.0), [1, 1, -1])),
        of_messages(**oriented(swinging(peak=2.0)) | {"rate": swinging(peak=2.0) + 0.03}),
    ),
    "inverse-orientation": (
        of_inverse,
        of_messages(**inverted(swinging(peak=0.3))),
    ),
    "orientation-invalid": (
        of_messages(wxyz=np.zeros((200, 4))),
        of_messages(wxyz=np.tile([1.0, 0, 0, 0], (200, 1))),
    ),
    "rest-moves": (
        in_memory(resting(), bias="static@+9s..+14s"),
        in_memory(resting(), bias="static@+1s..+9s"),
    ),
    "rest-unconfirmed": (
        in_memory(resting(), **STATIC),
        of_messages(count=2500, rate=resting(), **STILL_FORCE, options=STATIC),
    ),
    # As the sensor warms up, its bias changes by 0.025 deg/s: that of any MEMS does.
    "rests-differ": (
        in_memory(resting(0.15 * DEG), **STATIC),
        in_memory(resting(0.025 * DEG), **STATIC),
    ),
    "rest-coarse": (
        in_memory(integers(resting(), DEG), **STATIC),
        in_memory(integers(resting(), DEG / 131), **STATIC),
    ),
    "rest-one-value": (in_memory(STILL, **STATIC), in_memory(integers(STILL, DEG), **STATIC)),
    "method-differs": (
        in_memory(WAVES, averages=True, method="start"),
        in_memory(WAVES, averages=True, method="end"),
    ),
    "coning-added": (
        in_memory(WAVES, averages=True, method="coning"),
        in_memory(WAVES, method="coning"),
    ),
    "method-unused": (
        in_memory(TWENTY, spans=np.full(20, 10 * MS), method="mean"),
        in_memory(TWENTY, spans=np.full(20, 10 * MS)),
    ),
    "bias-ends": (
        in_memory(TWENTY, bias=lambda folder: biases(folder, 17)),
        in_memory(TWENTY, bias=lambda folder: biases(folder, 18)),
    ),
    "bias-beyond-sensors": (
        in_memory(WAVES, bias=[0.0, 0.0, 0.53]),
        in_memory(WAVES, bias=[0.0, 0.0, 0.52]),
    ),
    "bias-gaps": (
        in_memory(WAVES, bias=lambda folder: biases(folder, len(WAVES), 10)),
        in_memory(WAVES, bias=lambda folder: biases(folder, len(WAVES), 9)),
    ),
    # Ten intervals are bridged, as in a log; one more was, in silence, for up to 10 s.
    "q0-across-gap": (partial(between_attitudes, 10), partial(between_attitudes, 9)),
    "calibration-part": (
        in_memory(TWENTY, calibration=lambda folder: kalibr(folder, 1e-3)),
        in_memory(TWENTY, calibration=lambda folder: kalibr(folder, 0.0)),
    ),
}
AHEAD = with_value(stamps(20), 9, EPOCH + 3600 * SECOND)
BACK = with_value(stamps(20), 9, EPOCH)
GAP = stamps(20) + (np.arange(20) > 9) * 2 * SECOND
NAN = with_value(TWENTY, (9, 1), np.nan)
FIRST_PAUSE = stamps(100) + (np.arange(100) > 0) * 5 * SECOND
TICKS = stamps(4000, hz=200)
LATE = np.sort(TICKS + np.abs(np.random.default_rng(1).normal(0, MS, 4000)).astype(np.int64))
UNEVEN = EPOCH + np.cumsum(np.random.default_rng(1).integers(4 * MS, 6 * MS, 4000))
SEC_NANOSEC = "sec,nanosec,wx_rad_s,wy_rad_s,wz_rad_s\n"
PACKETS = of_messages(t_ns=np.repeat(stamps(40, hz=20), 5), recorded=stamps(200))
"""Five messages share each header timestamp."""
FAST = EPOCH + np.arange(200) * 12 * MS
"""Stamps of a clock that is a fifth too fast."""


TIME = {
    # As samples are stamped when they arrive; and as they are taken at uneven times.
    "jitter": (
        in_memory(swinging(200, 4000), t_ns=LATE),
        in_memory(swinging_at(UNEVEN), t_ns=UNEVEN),
    ),
    "repeated-stamps": (
        in_memory(TWENTY, t_ns=with_value(stamps(20), 9, stamps(20)[8])),
        in_memory(TWENTY, t_ns=with_value(stamps(20), 9, stamps(20)[8] + 1)),
    ),
    "stamp-outliers": (
        in_memory(TWENTY, t_ns=AHEAD, on_backwards="drop"),
        in_memory(TWENTY, t_ns=GAP, on_backwards="drop"),
    ),
    "stamps-back": (
        in_memory(TWENTY, t_ns=BACK, on_backwards="drop"),
        in_memory(TWENTY, t_ns=GAP, on_backwards="drop"),
    ),
    "nonfinite-rates": (
        in_memory(NAN, on_nonfinite="drop"),
        in_memory(TWENTY, on_nonfinite="drop"),
    ),
    "gaps": (
        in_memory(TWENTY, t_ns=GAP),
        in_memory(np.delete(TWENTY, range(5, 13), 0), t_ns=np.delete(stamps(20), range(5, 13))),
    ),
    "whole-seconds": (
        in_memory(WAVES[:400], t_ns=stamps(400) // SECOND * SECOND),
        in_memory(WAVES[:400] / 9, t_ns=stamps(400, hz=1)),
    ),
    "equal-stamps": (
        lambda f: of_survey(f, IDENTITY, np.full(200, EPOCH)),
        lambda f: of_survey(f, IDENTITY, with_value(np.full(200, EPOCH), 199, EPOCH + 1)),
    ),
    # Samples that arrive ten at a time; and each sample recorded ten times.
    "packets": (
        in_memory(swinging(count=400), t_ns=np.repeat(stamps(40, hz=10), 10)),
        in_memory(np.repeat(swinging(10, 40), 10, axis=0), t_ns=np.repeat(stamps(40, hz=10), 10)),
    ),
    # The seconds were written into both fields.
    "beyond-a-second": (
        of_table(rows(30, "1600000000,16000000{k:02},0.1,0.2,{k}\n", SEC_NANOSEC)),
        of_table(rows(30, "1600000000,9999999{k:02},0.1,0.2,{k}\n", SEC_NANOSEC)),
    ),
    "shared-stamps": (PACKETS, of_messages(t_ns=np.repeat(stamps(40, hz=20), 5))),
    "not-simulated-time": (with_clock(0.5), with_clock(1.0)),
    "range-of-other-clock": (
        of_messages(t_ns=stamps(200) + 18 * SECOND, recorded=stamps(200), options=FROM_START),
        of_messages(t_ns=stamps(200), recorded=stamps(200) + SECOND, options=FROM_START),
    ),
    "clock-step": (of_clock(step=80 * MS), of_clock(step=80 * MS, late=80 * MS)),
    "missing-samples": (of_clock(missing=5), of_clock(missing=1)),
    # A clock that is a fifth too fast; and one that is as fast within a thousandth.
    "unlike-log-times": (
        of_messages(t_ns=FAST, recorded=stamps(200)),
        of_messages(t_ns=stamps(200), recorded=stamps(200) + np.arange(200) * 10_000),
    ),
    # Of 10 Hz in microseconds, as integers of pandas may be; there was no remark.
    "sample-rate": (
        in_memory(TWENTY, t_ns=stamps(20, 10) // 1000),
        in_memory(TWENTY / 100, t_ns=stamps(20, 8000, first=2_000_000 * SECOND)),
    ),
    "increments-span": (
        in_memory(TWENTY, spans=np.full(20, 8 * MS)),
        in_memory(TWENTY, spans=np.full(20, 10 * MS)),
    ),
    "range-beyond-log": (
        in_memory(TWENTY, start=str(EPOCH - 1)),
        in_memory(TWENTY, start=str(EPOCH + 1)),
    ),
    "pause-at-end": (
        in_memory(swinging(count=100), t_ns=FIRST_PAUSE, start="+100ms"),
        in_memory(swinging(count=100), start="+100ms"),
    ),
    "part-read": (
        of_messages(count=999, t_ns=stamps(999, hz=1), options={"start": "+900s"}),
        of_messages(count=999, t_ns=stamps(999, hz=1)),
    ),
    "times-left-out": (
        in_memory(TWENTY, at=lambda folder: wanted(folder, 21)),
        in_memory(TWENTY, at=lambda folder: wanted(folder, 20)),
    ),
}
BACK_ON_THE_WAY = stamps(200) - (np.arange(200) > 90) * 115 * MS
DROP = {"on_backwards": "drop"}
LATE = stamps(20, first=2**63 - 200 * MS)
IDENTITY = np.tile([1.0, 0, 0, 0], (200, 1))
MOUNTED = {"mount": "x,-y,-z", "q0": "log"}


MESSAGES = {
    "several-frames": (
        of_messages(each=framed("left", "right")),
        of_messages(each=framed("/imu", "imu")),
    ),
    "other-clock": (
        of_messages(t_ns=stamps(200, first=60 * SECOND), recorded=stamps(200)),
        of_messages(t_ns=stamps(200), recorded=stamps(200) + 59 * 60 * SECOND),
    ),
    "zero-stamps": (
        of_messages(t_ns=with_value(stamps(200), slice(3), 0), recorded=stamps(200)),
        of_messages(t_ns=stamps(200, first=0) + 1),
    ),
    "stamp-unset": (outer_stamps(20), outer_stamps(0)),
    "marked-rates": (
        of_messages(each=covered(-1.0), options={"rate_field": "angular_velocity"}),
        of_messages(each=covered(0.0, 1e-6), options={"rate_field": "angular_velocity"}),
    ),
    "absent-rates": (of_split(), of_split(topic="/gyro")),
    "log-times-back": (
        of_messages("log.bag", t_ns=BACK_ON_THE_WAY, recorded=BACK_ON_THE_WAY, options=DROP),
        of_messages(
            "log.bag", t_ns=BACK_ON_THE_WAY + 10 * MS * (np.arange(200) > 90), options=DROP
        ),
    ),
    "clamped-times": (
        of_messages(t_ns=stamps(20), recorded=range(2**63, 2**63 + 20), count=20, rate=TWENTY),
        of_messages(
            t_ns=stamps(20), recorded=LATE, count=20, rate=TWENTY, options={"clock": "header"}
        ),
    ),
    "other-accelerometer": (felt_by(own=False), felt_by(own=True)),
    "level-upside-down": (
        felt_by(own=True, force=(0.0, 0.0, -9.81)),
        felt_by(own=True, force=(0.0, 8.9, -4.0)),
    ),
    "transforms-differ": (
        of_frames(0.3, 0.4, mount="tf:base"),
        of_frames(0.3, 0.3, mount="tf:base"),
    ),
    # The tracker repeats its last attitude; and it did so until before the start.
    "q0-settles-later": (of_q0(frozen(1400)), of_q0(frozen(750))),
    "q0-constant": (of_q0(lambda wxyz: wxyz * 0 + [0.6, 0, 0, 0.8]), of_q0(frozen(1400))),
    "q0-without-tilt": (on_slope(12.0), on_slope(8.0)),
    "q0-of-several-bodies": (of_q0(with_another_body), of_q0(np.array)),
    "at-other-clock": (
        of_vectors(BIAS, 8 * SECOND // 10, at="/vector"),
        of_vectors(BIAS, SECOND // 10, at="/vector"),
    ),
    "bias-contradicts-rest": (of_vectors(-BIAS, bias="/vector"), of_vectors(BIAS, bias="/vector")),
    "bias-of-other-frame": (
        of_vectors(BIAS, frame="base", bias="/vector"),
        of_vectors(BIAS, frame="imu_link", bias="/vector"),
    ),
    "bias-of-other-sensor": (of_gyroscope(11), of_gyroscope(12)),
    "bias-turned": (
        of_vectors(BIAS, frame="base", transforms=BASE_TURNED, bias="/vector"),
        of_vectors(BIAS, frame="imu_link", transforms=BASE_TURNED, bias="/vector"),
    ),
    "q0-turned": (of_frames(0.3, q0="/odom"), of_frames(0.0, q0="/odom")),
    "q0-of-other-frame": (of_frames(q0="/odom"), of_frames(0.3, q0="/odom")),
    "q0-of-body": (
        of_messages(**oriented(swinging(count=200), [1, -1, -1]), options=MOUNTED),
        of_messages(**oriented(swinging(count=200)), options=MOUNTED),
    ),
    "placeholder": (
        lambda f: of_survey(f, IDENTITY),
        lambda f: of_survey(f, with_value(IDENTITY, 199, [0, 1, 0, 0])),
    ),
    "invalid-quaternions": (
        lambda f: of_survey(f, with_value(IDENTITY, 9, 0.0)),
        lambda f: of_survey(f, with_value(IDENTITY, 9, [0, 1, 0, 0])),
    ),
    "constant-covariance": (
        with_sigmas(50, [1, 2, 3], [1, 2, 3]),
        with_sigmas(50, [1, 2, 3], [1, 2, 4]),
    ),
    "partial-covariance": (
        with_sigmas(50, [1, 2, 3], [1, 2, -1]),
        with_sigmas(50, [1, 2, 3], [np.nan] * 3),
    ),
    "several-definitions": (of_two(longer), of_two(of_text, "/words")),
    "several-types": (of_two(of_text), of_two(of_text, "/words")),
    "definition-file": (by_file(True), by_file(False)),
    "definition-md5": (own_type(other_definition), own_type(bytes)),
}
DEG_S = {"rate_unit": "deg/s"}
HZ = {"sample_rate": 100, **DEG_S}
GYRO = {"rate_cols": "w[0],w[1],w[2]", "rate_unit": "rad/s"}
ROLL_FIRST = {"rate_cols": "Roll,Pitch,Yaw", "rate_unit": "deg/s"}
STATED = "# Sample rate: 100 Hz\n"
GCSV = "GYROFLOW IMU LOG\nversion,1.3\norientation,{}\ntscale,0.001\ngscale,0.25\nt,gx,gy,gz,"
GCSV += "ax,ay,az\n"
PX4 = ",".join([*(f"delta_angle[{k}]" for k in range(3)), "delta_angle_dt", "timestamp_sample\n"])
FIFO = "timestamp_sample,x[0],x[1],y[0],y[1],z[0],z[1],dt,scale,samples\n"
ESTIMATED = ",".join(f"twist.twist.angular.{axis}" for axis in "xyz")
MEASURED = ",".join(f"imu.angular_velocity.{axis}" for axis in "xyz")
STAMP = "header.stamp.sec,header.stamp.nanosec"
WITH_EPOCH = "device_time (s),epoch (ms),wx_rad_s,wy_rad_s,wz_rad_s\n"
TWO_CLOCKS = "device_time (ms),server_time (s),wx_rad_s,wy_rad_s,wz_rad_s\n"
TWO_SENSORS = "t_ms,sensor,wx_rad_s,wy_rad_s,wz_rad_s\n"
TWO_SENSORS += "".join(f"{k},{'ab'[k % 2]},0.1,0.2,{k}\n" for k in range(40))
TWO_TOPICS = "t_ms,wx_rad_s,wy_rad_s,wz_rad_s,height\n"
TWO_TOPICS += "".join(f"{k}0,0.1,0.2,{k},\n{k}5,,,,9\n" for k in range(1, 40))
EVEN, MISSING = range(0, 60, 2), [k for k in range(60) if k % 10]
TABLES = {
    "several-files": (of_parts(2), of_parts(1)),
    "contradicts-later": (of_messages(**turned_from(4000)), of_messages(**turned_from(6000))),
    "files-without-topic": (of_topics("/imu", "/imu/data"), of_topics("/imu", "/imu")),
    "copies": (of_copies(3), of_copies(0)),
    "no-line-end": (of_table(rows()[:-1]), of_table(rows())),
    "scaled-unit": (
        of_table(rows(head="t_ms,wx [mdps],wy [mdps],wz [mdps]\n")),
        of_table(rows(head="t_ms,wx [deg/s],wy [deg/s],wz [deg/s]\n")),
    ),
    "unit-overruled": (of_table(rows(), **DEG_S), of_table(rows(), rate_unit="rad/s")),
    "numbers-as-text": (
        of_table(rows(30, '{{"t_ms":{k},"w":["0.1","0.2","0"]}}\n', ""), "w.jsonl", **GYRO),
        of_table(rows(30, '{{"t_ms":"{k}","w":[0.1,0.2,0],"a":"1"}}\n', ""), "w.jsonl", **GYRO),
    ),
    "axis-order": (
        of_table(rows(head="t_ms,Pitch,Roll,Yaw\n"), **ROLL_FIRST | {"rate_cols": "1,2,3"}),
        of_table(rows(head="t_ms,Pitch,Roll,Yaw\n"), **ROLL_FIRST),
    ),
    "frame-in-names": (
        of_table(rows(head="t_ms,wx_ned,wy_ned,wz_ned\n"), rate_cols="1,2,3", rate_unit="rad/s"),
        of_table(rows(head="t_ms,wx_frd,wy_frd,wz_frd\n"), rate_cols="1,2,3", rate_unit="rad/s"),
    ),
    "frame-in-header": (of_messages(frame="map"), of_messages(frame="base_link")),
    "role-in-names": (
        of_table(rows(head="t_ms,cmd_p,cmd_q,cmd_r\n"), rate_cols="1,2,3", rate_unit="rad/s"),
        of_table(rows(head="t_ms,raw_p,raw_q,raw_r\n"), rate_cols="1,2,3", rate_unit="rad/s"),
    ),
    "stated-mount": (
        of_table(rows(30, "{k},39,8,{k},0,0,0\n", GCSV.format("YxZ")), "log.gcsv"),
        of_table(rows(30, "{k},39,8,{k},0,0,0\n", GCSV.format("XYZ")), "log.gcsv"),
    ),
    "ignored-signals": (
        of_table(rows(30, "{k},0,1,2,3,4,5,{k}\n", f"{STAMP},{ESTIMATED},{MEASURED}\n")),
        of_table(rows(30, "{k},0,4,5,{k}\n", f"{STAMP},{MEASURED}\n")),
    ),
    "clock-stands": (
        of_table(rows(30, "0,1{k:02},0.1,0.2,{k}\n", WITH_EPOCH)),
        of_table(rows(30, "0.{k:03},1{k:02},0.1,0.2,{k}\n", WITH_EPOCH)),
    ),
    "clocks-differ": (
        of_table(rows(30, "{k},{k},0.1,0.2,0.{k}\n", TWO_CLOCKS)),
        of_table(rows(30, "{k},0.{k:03},0.1,0.2,0.{k}\n", TWO_CLOCKS)),
    ),
    "clocks-part": (of_table(beside_a_clock(1.5)), of_table(beside_a_clock(0.01))),
    "counter-gaps": (
        of_table(counted(MISSING), **HZ, time_col="PacketCounter"),
        of_table(counted(range(60)), **HZ, time_col="PacketCounter"),
    ),
    "counter-used": (
        of_table(counted(range(60)), **HZ),
        of_table(counted(range(60)), **HZ, time_col="none"),
    ),
    "counter-unused": (
        of_table(counted(EVEN, head=STATED)),
        of_table(counted(range(60), head=STATED)),
    ),
    "counter-at-rate": (
        of_table(counted(range(60), "timestamp", STATED)),
        of_table(counted(range(60), "timestamp_ms", STATED)),
    ),
    "counter-wrapped": (
        of_table(counted(((2**32 - 300 + 10 * k) % 2**32 for k in range(60)), "t_ms")),
        of_table(counted((2**32 - 900 + 10 * k for k in range(60)), "t_ms")),
    ),
    "ticks-at-rate": (
        of_table(counted((328 * k for k in range(60)), "tick"), time_col="tick", sample_rate=32768),
        of_table(counted(range(60), "t_ms")),
    ),
    "fast-rows": (
        of_table(counted((100 * k for k in range(60)), "time"), time_unit="us"),
        of_table(counted((125 * k for k in range(60)), "time"), time_unit="us"),
    ),
    "intervals-summed": (
        of_table(counted([5, 6] * 30, "dt_ms")),
        of_table(counted(range(60), "t_ms")),
    ),
    "time-of-day": (
        of_table(counted([f"10:00:{k:02}" for k in range(60)], "time")),
        of_table(counted([f"2024-01-01T10:00:{k:02}Z" for k in range(60)], "time")),
    ),
    "ticks-since": (
        of_table(counted((133 * 10**15 + 10**5 * k for k in range(60)), "t_100ns")),
        of_table(counted((16 * 10**15 + 10**5 * k for k in range(60)), "t_100ns")),
    ),
    "gps-time": (
        of_table(counted([f"2300,{k / 100}" for k in range(60)], "week,tow")),
        of_table(counted([f"2300,{k / 100}" for k in range(60)], "week,t_s")),
    ),
    "index-gaps": (
        of_table(counted(MISSING, "index", STATED)),
        of_table(counted(range(60), "index", STATED)),
    ),
    "repeated-rates": (
        of_table(rows(30, TWICE, two_sensors(".1")), rate_unit="rad/s"),
        of_table(rows(30, TWICE, two_sensors("_ref"))),
    ),
    "label-changes": (of_table(of_subjects("S1", "S2")), of_table(of_subjects("S1", "S1"))),
    "other-rate": (
        of_table(f"# Sampling rate: 50 Hz\n{rows()}", **HZ),
        of_table(f"# Sampling rate: 99 Hz\n{rows()}", **HZ),
    ),
    "stamps-unused": (of_table(rows(), **HZ), of_table(rows().replace("t_ms", "height"), **HZ)),
    "series-merged": (
        of_table(TWO_SENSORS, series="all"),
        of_table(TWO_SENSORS.replace(",b,", ",a,")),
    ),
    "numbers-alternate": (
        of_table(counted((f"{10 * (k // 2)},{k % 2}" for k in range(120)), "t_ms,part")),
        of_table(counted((f"{10 * k},{k % 2}" for k in range(120)), "t_ms,part")),
    ),
    "other-kinds": (of_table(TWO_TOPICS), of_table(re.sub(r".*,,,,9\n", "", TWO_TOPICS))),
    "other-series": (of_table(TWO_SENSORS, series="a"), of_table(TWO_SENSORS, series="all")),
    "increments": (
        of_table(rows(30, "0.001,0.002,0.00{k},5000,{k}5000\n", PX4), "log_vehicle_imu_0.csv"),
        of_table(rows(), "log_vehicle_imu_0.csv"),
    ),
    "bursts": (
        of_table(
            rows(30, "{k}000,1,2,3,4,5,{k},500,0.001,2\n", FIFO), "log_sensor_gyro_fifo_0.csv"
        ),
        of_table(rows(), "log_sensor_gyro_fifo_0.csv"),
    ),
    "external-link": (
        lambda f: of_hdf5(f, h5py.ExternalLink("other.h5", "/x")),
        lambda f: of_hdf5(f, h5py.SoftLink("/g")),
    ),
    "sign-unstored": (
        attitudes_of("{k},1,2,{k}\n", "t_ns,rotvec_x_deg,rotvec_y_deg,rotvec_z_deg\n"),
        attitudes_of("{k},1,2,{k}\n", "t_ns,yaw_deg,pitch_deg,roll_deg\n"),
    ),
    "angle-sequence": (
        attitudes_of("{k},1,2,{k}\n", "t_ns,yaw_deg,pitch_deg,roll_deg\n"),
        attitudes_of("{k},1,2,{k}\n", "t_ns,rotvec_x_deg,rotvec_y_deg,rotvec_z_deg\n"),
    ),
    "frames-by-type": (of_px4, attitudes_of()),
    "read-once": (of_survey_of_text("-"), of_survey_of_text("log.csv")),
}
TRUTH = AttitudeSeries(T_NS, TURNED)
SHIFTED = AttitudeSeries(T_NS[4:90:10] + 5 * MS, TURNED[4:90:10])
"""The truth at a tenth of its stamps, later by half an interval."""
UPRIGHT = np.tile(np.sqrt([0.5, 0, 0.5, 0]), (100, 1))
SIGMA = [np.full(100, 0.01)] * 3
SIGMA_HEAD = ",sigma_x,sigma_y,sigma_z"
EXACT = np.zeros((100, 3, 3))
CONVERSIONS = {
    "stamps-lost": (converted(T_NS, TURNED, "out.kitti"), converted(T_NS, TURNED, "out.tum")),
    "positions-lost": (lambda f: poses(f / "out.csv"), lambda f: poses(f / "out.tum")),
    "sigma-lost": (
        converted(T_NS, TURNED, "out.tum", SIGMA, SIGMA_HEAD),
        converted(T_NS, TURNED, "out.csv", SIGMA, SIGMA_HEAD),
    ),
    "columns-lost": (
        converted(T_NS, TURNED, more=SIGMA, head=",yaw_rad,pitch_rad,roll_rad"),
        converted(
            T_NS, TURNED, more=SIGMA, head=",yaw_rad,pitch_rad,roll_rad", extra_columns="euler-zyx"
        ),
    ),
    "gimbal-lock": (
        converted(T_NS, UPRIGHT, representation="euler-zyx"),
        converted(T_NS, multiply(UPRIGHT, exp([0, 2e-3, 0])), representation="euler-zyx"),
    ),
    "convention-unstated": (
        converted(T_NS, TURNED, convention="jpl"),
        converted(T_NS, TURNED, "out.parquet", convention="jpl"),
    ),
    "stamps-unordered": (
        converted(with_value(T_NS, 9, T_NS[8]), TURNED),
        converted(with_value(T_NS, 9, T_NS[8] + 1), TURNED),
    ),
    "not-covered": (
        converted(T_NS, TURNED, relative_to=still_body(T_NS[1:])),
        converted(T_NS, TURNED, relative_to=still_body(T_NS)),
    ),
    "gaps-kept": (
        converted(np.delete(T_NS, range(40, 60)), np.delete(TURNED, range(40, 60), 0), rate=50),
        converted(np.delete(T_NS, range(40, 45)), np.delete(TURNED, range(40, 45), 0), rate=50),
    ),
}


def tumbling(x, y, z, bias=0.0, most=1.0):
    """Return attitudes of rates about the three axes, of these sizes, and not above a limit."""
    t_ns = np.arange(2000) * 10 * MS
    rate = np.sin(t_ns[:, None] / 1e9 * [1.3, 2.1, 0.7]) * [x, y, z] + bias
    made = quatprop.propagate(quatprop.GyroSeries(t_ns, np.clip(rate, -most, most)))
    return AttitudeSeries(t_ns, made.wxyz)


def leaping(row):
    """Return the attitudes of these rates about three axes, turned by 0.5 rad from a row on."""
    series = tumbling(1, 1, 1)
    turn = exp(np.where(np.arange(2000) < row, 0.0, 0.5)[:, None] * [0, 0, 1])
    return AttitudeSeries(series.t_ns, multiply(turn, series.wxyz))


def lost(*, is_lost):
    """Return what `check` notes of a log of which something was lost, or nothing."""
    case = SimpleNamespace(log="a.bag", external=None, propagation=SimpleNamespace(inputs={}))
    losses = [Loss("chunk at byte 4096", "it is damaged")] if is_lost else []
    report = SimpleNamespace(losses=losses, counts=SimpleNamespace(dropped=0))
    return list(loss_notes(case, SimpleNamespace(report=report), None))


COMPARISONS = {
    "data-lost": (lambda _: lost(is_lost=True), lambda _: lost(is_lost=False)),
    "interpolated": (
        compared(TRUTH, SHIFTED, match="interpolate", tol="1e-9rad"),
        compared(TRUTH, SHIFTED, match="interpolate", tol="1deg"),
    ),
    "opposed-verticals": (
        compared(
            AttitudeSeries(T_NS, multiply(exp(noise(1e-4, 100)), turned(np.pi, 0, 0).wxyz)),
            TRUTH,
            align="yaw",
        ),
        compared(turned(0.9 * np.pi, 0, 0), TRUTH, align="yaw"),
    ),
    "opposite-signs": (compared(TRUTH, AttitudeSeries(T_NS, -TURNED)), compared(TRUTH, TRUTH)),
    "exact-sigma": (
        compared(AttitudeSeries(T_NS, TURNED, covariance=EXACT), turned(2e-9, 0, 0)),
        compared(AttitudeSeries(T_NS, TURNED, covariance=EXACT), turned(5e-10, 0, 0)),
    ),
    "dead-axis": (
        compared(tumbling(1, 0, 1), tumbling(1, 1, 1)),
        compared(tumbling(1, 0, 1), tumbling(1, 0, 1, 0.1)),
    ),
    "step-at-gap": (
        compared(tumbling(1, 1, 1)[np.r_[:900, 1000:2000]], leaping(900)),
        compared(tumbling(1, 1, 1)[np.r_[:900, 1000:2000]], tumbling(1, 1, 1, 0.1)),
    ),
    "motion-lost": (
        compared(tumbling(1, 1, 1, most=0.6), tumbling(1, 1, 1)),
        compared(tumbling(1, 1, 1, most=0.6), tumbling(1, 1, 1, 0.01, most=0.6)),
    ),
    "normalised": (
        lambda _: compare_series(TRUTH, AttitudeSeries(T_NS, 2 * TURNED)).remarks,
        lambda _: compare_series(TRUTH, AttitudeSeries(T_NS, (1 + 1e-9) * TURNED)).remarks,
    ),
    "omitted": (calibrated(np.sort(np.append(stamps(2000), EPOCH))), calibrated(stamps(2000))),
    "mirrored-axes": (
        calibrated_with(lambda rate: rate * [1, -1, 1]),
        calibrated_with(lambda rate: rate * [-1, -1, 1]),
    ),
    "bias-jumps": (calibrated_with(jumping), calibrated_with(lambda rate: rate + 0.02)),
    "reference-axis": (
        calibrated_with(wobbling, lambda rate: rate * [0, 0, 1]),
        calibrated_with(lambda rate: rate * [0, 0, 1], lambda rate: rate * [0, 0, 1]),
    ),
    "not-better": (calibrated_with(changing), calibrated_with()),
    "sorted": (compared(TRUTH, TRUTH[np.r_[1, 0, 2:100]]), compared(TRUTH, TRUTH)),
}
WHITE = noise(1e-3, 4000)
EVERY = stamps(4000)
NOISES = {
    # A gap is longer than ten intervals.
    "noise-gaps": (at_rest(WHITE, EVERY + (EVERY[2001] < EVERY) * 150 * MS),
                   at_rest(WHITE, EVERY + (EVERY[2001] < EVERY) * 80 * MS)),
    "noise-irregular": (at_rest(WHITE, np.repeat(EVERY[::2], 2)), at_rest(WHITE, EVERY)),
    "noise-steps": (at_rest(integers(WHITE / 5, 1e-3)), at_rest(integers(WHITE, 1e-3))),
    "noise-short-times": (at_rest((WHITE[2:] + WHITE[1:-1] + WHITE[:-2]) / 3), at_rest(WHITE)),
    "noise-warm-up": (at_rest(WHITE / 100 + 1e-2 * np.exp(-np.arange(4000)[:, None] / 500)),
                      at_rest(WHITE / 100 + 1e-6 * np.arange(4000)[:, None])),
    "noise-unexplained": (at_rest(WHITE * [1, 1, 0]), at_rest(WHITE * [1, 1, 0.01])),
}  # fmt: skip
TABLE = NOISES | RATES | TIME | MESSAGES | TABLES | CONVERSIONS | COMPARISONS
TOO_LARGE = of_messages(rate=swinging(count=200, peak=500))
IN_US = rows(30, "1700000000{k:02}0000,0.1,0.2,0.{k}\n", "t,wx_rad_s,wy_rad_s,wz_rad_s\n")
OF_THE_TABLE = ("transforms-differ", "q0-turned", "level-upside-down",
                "other-clock", "zero-stamps", "stated-mount", "clocks-differ",
                "clocks-part", "counter-used", "counter-unused", "index-gaps", "frame-in-names",
                "several-frames", "numbers-alternate", "label-changes", "repeated-rates",
                "frame-in-header", "other-axes", "other-frame")  # fmt: skip
REMEDIES = {
    "beyond-range": TOO_LARGE,
    "unit-by-steps": of_messages(rate=integers(swinging(count=200), 500 / 32768)),
    "rates-off-scale": of_messages(**oriented(SLOW_TURN, 1 / DEG)),
    "gravity-off-scale": of_messages(**next_to_gravity(TUMBLING, 1 / DEG)),
    "sample-rate": of_table(IN_US, time_unit="ns"),
    "shared-stamps": PACKETS,
    "q0-settles-later": of_q0(frozen(1400)),
    "at-other-clock": of_vectors(BIAS, 8 * SECOND // 10, at="/vector"),
    "bias-contradicts-rest": of_vectors(-BIAS, bias="/vector"),
    "bias-of-other-sensor": of_gyroscope(11),
    "clock-step": of_clock(step=80 * MS),
    "range-of-other-clock": of_messages(
        t_ns=stamps(200) + 18 * SECOND, recorded=stamps(200), options=FROM_START
    ),
    "missing-samples": of_clock(missing=5),
    "unlike-log-times": of_messages(t_ns=FAST, recorded=stamps(200)),
    "inverse-orientation": of_inverse,
    "q0-across-gap": partial(between_attitudes, 10),
    "q0-without-tilt": on_slope(12.0),
    **{code: TABLE[code][0] for code in OF_THE_TABLE},
}
"""Logs whose remark names a setting that removes it."""
SWINGING = AttitudeSeries(stamps(200), attitudes(stamps(200), swinging(count=200)))
AFTER_REST = AttitudeSeries(STAMPS, attitudes(STAMPS, swinging_after_rest()))


def true_of(rate, count=200, hz=100, **options):
    """Return the attitudes of rates at steady stamps."""
    t_ns = stamps(count, hz)
    return AttitudeSeries(t_ns, attitudes(t_ns, rate, **options))


TRUTHS = {
    "beyond-range": true_of(swinging(count=200, peak=500) * DEG),
    "unit-by-steps": true_of(integers(swinging(count=200), 500 / 32768) * DEG),
    "rates-off-scale": true_of(SLOW_TURN, 1000),
    "gravity-off-scale": true_of(TUMBLING, 2000),
    "shared-stamps": SWINGING,
    "q0-settles-later": AttitudeSeries(
        STAMPS, attitudes(STAMPS, swinging_after_rest(), method="mean")
    ),
    "at-other-clock": AttitudeSeries(STAMPS, attitudes(STAMPS, BIAS + swinging_after_rest(1e-3)))[
        10:3000:50
    ],
    "bias-contradicts-rest": AFTER_REST,
    "unlike-log-times": SWINGING,
    "level-upside-down": true_of(noise(1e-3, 200)),
    "inverse-orientation": true_of(swinging(peak=2.0), 2000),
    "other-clock": SWINGING,
    "zero-stamps": SWINGING,
    "other-axes": true_of(swinging(peak=1.0), 2000),
    "other-frame": true_of(swinging(peak=3.0), 2000),
}
"""The attitudes of the body in those logs, where they are known."""
