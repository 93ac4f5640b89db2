"""Several files of which some lack the topic that is read."""

import numpy as np
import pytest
from make.ros import imu_messages, write_messages

import quatprop

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")


def said_of(folder, topics, wanted, count):
    """Return what is said of files, each with one of some topics, and how many samples are read."""
    paths = []
    for number, topic in enumerate(topics):
        t_ns = 10**18 + (number * count + np.arange(count)) * 10_000_000
        rate = np.sin(np.arange(count)[:, None] / 9 + np.arange(3))
        messages = [(topic, *one[1:]) for one in imu_messages(t_ns, rate)]
        paths.append(write_messages(folder / f"{number}.mcap", messages))
    report = quatprop.propagate(paths, topic=wanted).report
    said = [str(one) for one in report.remarks if one.code == "files-without-topic"]
    return said, report.result.samples


@pytest.mark.parametrize("count", [50, 3000])
def test_files_without_the_topic_are_named_with_the_topics_of_their_rates(tmp_path, count):
    """A recorder was started again with other names: half of the rates was left out in silence."""
    (said,), samples = said_of(tmp_path, ["/imu", "/imu/data", "/imu"], "/imu", count)
    assert samples == 2 * count
    assert f"{tmp_path / '1.mcap'} (its rates are on '/imu/data')" in said
    assert "0.mcap" not in said


@pytest.mark.parametrize("wanted", [None, "/imu"])
@pytest.mark.parametrize("parts", [1, 2, 5])
def test_parts_with_the_topic_have_no_remark(tmp_path, parts, wanted):
    """A recording that was split is well."""
    assert said_of(tmp_path, ["/imu"] * parts, wanted, 50) == ([], 50 * parts)


def test_the_topic_that_is_found_may_be_missing_in_a_file_as_well(tmp_path):
    """The other file has no rates at all, but messages."""
    t_ns = 10**18 + np.arange(100) * 10_000_000
    path = write_messages(tmp_path / "a.mcap", imu_messages(t_ns, np.ones((100, 3))))
    pose = {"header": {"stamp": int(t_ns[-1]) + 10}, "quaternion": [0.0, 0.0, 0.0, 1.0]}
    kind = "geometry_msgs/msg/QuaternionStamped"
    other = write_messages(tmp_path / "b.mcap", [("/q", kind, int(t_ns[-1]) + 10, pose)])
    remarks = quatprop.propagate([path, other]).report.remarks
    (said,) = [str(one) for one in remarks if one.code == "files-without-topic"]
    assert f"topic '/imu': {other}; propagate each by itself" in said
