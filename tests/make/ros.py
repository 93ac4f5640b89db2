"""Messages of ROS with one call, in the container that the name of the path tells."""

from functools import cache

import numpy as np
from make.mcap import Topic, build
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

IMU, TIME, TF = "sensor_msgs/msg/Imu", "builtin_interfaces/msg/Time", "tf2_msgs/msg/TFMessage"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))


def message(store, kind, values=()):
    """Return a message with some values, by name or in order; the others are zero or empty.

    A stamp may be given in ns.
    """
    fields = _fields(store, kind)
    if kind == TIME and isinstance(values, int):
        values = divmod(values, 10**9)
    elif not isinstance(values, dict) and next(iter(fields)) == "seq":
        values = (0, *values)
    given = values if isinstance(values, dict) else dict(zip(fields, values, strict=False))
    made = {
        name: _value(store, form, given[name]) if given.get(name) is not None else empty
        for name, (form, empty) in fields.items()
    }
    return store.types[kind](**made)


@cache
def _fields(store, kind):
    """Return form of each field, and what it is without a value: one for all messages."""
    return {name: (form, _value(store, form, None)) for name, form in store.fielddefs[kind][1]}


def _value(store, form, given):
    node, detail = form
    if node == Nodetype.NAME:
        return message(store, detail, () if given is None else given)
    if node == Nodetype.BASE:
        return given if given is not None else "" if detail[0] == "string" else 0
    (part, kind), count = detail
    if part == Nodetype.NAME:
        return [message(store, kind, one) for one in given or ()]
    array = np.zeros(count if given is None else max(count, len(given)), kind[0])
    array[: 0 if given is None else len(given)] = () if given is None else given
    return array


def encoded(store, kind, values=(), **options):
    """Return the bytes of a message, in the encoding of the types: that of ROS 1 or of ROS 2."""
    is_ros1 = store.fielddefs["std_msgs/msg/Header"][1][0][0] == "seq"
    serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    return bytes(serialize(message(store, kind, values), kind, **options))


def write_messages(path, messages, types=(ROS1, ROS2), published_ns=0):
    """Write ``(topic, type, log time in ns, values)``, in order; return the path.

    A bag of ROS 1 by its suffix, MCAP by its own, else a folder that is a bag of ROS 2. Messages
    are published so much after they are logged, which MCAP alone records.
    """
    store, channels = types[path.suffix != ".bag"], {}
    if path.suffix == ".mcap":
        events = []
        for topic, kind, at, values in messages:
            if topic not in channels:
                text, _ = store.generate_msgdef(kind, ros_version=2)
                channels[topic] = Topic(kind, (), text.encode(), "ros2msg", "cdr")
            data = encoded(store, kind, values)
            events.append((list(channels).index(topic), at, data, at + published_ns))
        path.write_bytes(build(channels.items(), events, profile="ros2", chunk_size=8000))
        return path
    of_ros2 = {"version": 9, "storage_plugin": StoragePlugin.SQLITE3}
    with Rosbag1Writer(path) if store is types[0] else Rosbag2Writer(path, **of_ros2) as writer:
        for topic, kind, at, values in messages:
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(channels[topic], at, encoded(store, kind, values))
    return path


def imu_messages(t_ns, rate=(), wxyz=(), *, recorded=None, frame="imu", **more):
    """Yield Imu messages on /imu for `write_messages`; recorded when they are stamped, by default.

    `more`: other fields, for all messages or, as a list, for each. Without attitudes orientations
    are the identity, without rates zero.
    """
    for k, t in enumerate(np.asarray(t_ns).tolist()):
        w, *xyz = wxyz[k] if len(wxyz) else (1.0, 0.0, 0.0, 0.0)
        values = {name: each[k] if isinstance(each, list) else each for name, each in more.items()}
        values |= {"header": {"stamp": t, "frame_id": frame}, "orientation": [*xyz, w]}
        values["angular_velocity"] = rate[k] if len(rate) else ()
        yield "/imu", IMU, t if recorded is None else int(recorded[k]), values
