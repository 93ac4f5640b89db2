"""Every rate and attitude of real recordings, message for message, against rosbags."""

from itertools import islice
from operator import attrgetter

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from quatprop.readers.attitude_signals import attitude_candidates, choose_attitudes
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import rate_candidates
from quatprop.settings.reading import AttitudeSelection, RateSelection

SOURCES = {
    "auk/auk.bag": 3,
    "auk/auk_mcap_zstd": 3,
    "auk/auk_sqlite3": 3,
    "husky/test1_husky.bag": 4,
    "irregular/tilt_laser.bag": 5,
    "two_imus/test1_2014_xsens.bag": 8,
    "nested_imu/kiran_11sec_motion": 2,
    "rosbag2/geocam_all_types": 11,
    "rosbag2/plotjuggler_rosbag2_test": 3,
}
"""How many rates and attitudes each recording has; of transforms those below."""

FRAMES = {
    "irregular/tilt_laser.bag": [
        ("/tf", "/laser", ("/tilt_axis", "/laser")),
        ("/tf", "/tilt_base:/tilt_axis", ("/tilt_base", "/tilt_axis")),
    ],
    "rosbag2/geocam_all_types": [
        ("/test/tf2_msgs/tf_message", None, ("test_frame", "child_frame"))
    ],
}
"""The topics of transforms, what is asked for, and the frames that this means."""


def sources(log, name):
    """Yield topic, field and frames of every source of a log, and its first stamps and numbers."""
    for candidate in rate_candidates(log, RateSelection()):
        batch = next(candidate.signal().batches())
        yield candidate.topic, candidate.field, None, batch.t_ns, batch.rate
    for candidate in attitude_candidates(log, AttitudeSelection()):
        if candidate.field != "transforms":
            signal = candidate.signal()
            assert signal.layout == "scalar-last"
            yield candidate.topic, candidate.field, None, *next(iter(signal.rows()))
    for topic, frame, frames in FRAMES.get(name, []):
        signal = choose_attitudes(log, AttitudeSelection(topic=topic, frame=frame))
        yield topic, "transform.rotation", frames, *next(iter(signal.rows()))


def by_library(reader, topic, field, frames):
    """Return the header timestamps and the numbers of the first messages of a topic."""
    connections = [one for one in reader.connections if one.topic == topic]
    outer, _, _last = field.rpartition(".")
    found = []
    for connection, _, data in islice(reader.messages(connections=connections), 200):
        message = reader.deserialize(data, connection.msgtype)
        for one in message.transforms if frames else [message]:
            if frames in (None, (one.header.frame_id, getattr(one, "child_frame_id", ""))):
                vector = attrgetter(field)(one)
                # An Imu inside of another message has a header of its own.
                stamp = getattr(
                    attrgetter(outer)(one) if outer else one, "header", one.header
                ).stamp
                numbers = [getattr(vector, axis) for axis in "wxyz" if hasattr(vector, axis)]
                found.append((stamp.sec * 10**9 + stamp.nanosec, numbers))
    return found


@pytest.mark.parametrize("name", SOURCES)
def test_recordings_give_what_the_library_decodes(shared_logs, name):
    """Stamps and numbers are the same to the bit, in ROS 1, MCAP and SQLite."""
    path, count = shared_logs / name, 0
    store = get_typestore(Stores.ROS2_HUMBLE)
    with open_log(path) as log, AnyReader([path], default_typestore=store) as reader:
        for topic, field, frames, t_ns, numbers in sources(log, name):
            expected = by_library(reader, topic, field, frames)
            samples = zip(t_ns.tolist(), numbers.tolist(), strict=True)
            for sample, truth in zip(samples, expected, strict=False):
                assert sample == truth
            assert min(len(t_ns), len(expected)) > 1
            count += 1
    assert count == SOURCES[name]
