"""Parts of logs that are read by their index, and logs that have to be read as a whole."""

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from make.mcap import Topic, build, saved
from make.ros import IMU, ROS2, encoded, imu_messages, write_messages

from quatprop import DataLossWarning, propagate
from quatprop.base.errors import NoSamplesError, TimelineError

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
HZ1 = np.arange(1000) * 10**9 + 1_700_000_000 * 10**9


@pytest.mark.parametrize(("seconds", "is_part"), [(100, True), (187, True), (193, False)])
def test_up_to_a_quarter_of_a_log_is_read_alone(tmp_path, seconds, is_part):
    """Of 999 s, with a minute before it; the rest would be read twice."""
    log = write_messages(tmp_path / "log.mcap", imu_messages(HZ1, np.ones((1000, 3)) / 1000))
    found = propagate(log, start=f"-{seconds}s")
    assert found.t_ns.tolist() == HZ1[-seconds - 1 :].tolist()
    assert (found.report.correction.part is not None) == is_part
    with pytest.raises(NoSamplesError, match="1000 are before, 0 after"):
        propagate(log, start="+2000s")


@pytest.mark.parametrize("bad", [range(70), range(945, 1000), range(5, 995, 3)])
def test_messages_that_cannot_be_read_are_no_pause(tmp_path, bad):
    """A log with a damaged end, or with few samples a minute, was reported to end with a pause.

    What is between the ends had not been read.
    """
    (text, _), events = ROS2.generate_msgdef(IMU, ros_version=2), []
    for k, (_, _, at, values) in enumerate(imu_messages(HZ1, np.ones((1000, 3)) / 1000)):
        events.append((0, at, b"short" if k in bad else encoded(ROS2, IMU, values), at))
    topic = Topic(IMU, (), text.encode(), "ros2msg", "cdr")
    log = saved(tmp_path, build([("/imu", topic)], events, profile="ros2", chunk_size=8000))
    with pytest.warns(DataLossWarning):
        found = propagate(log, start="-100s")
    good = np.delete(HZ1, bad)
    assert found.t_ns.tolist() == good[good >= good[-1] - 100 * 10**9].tolist()
    part, remarks = found.report.correction.part, map(str, found.report.remarks)
    assert part is not None
    assert "pause" not in " ".join(remarks)


def test_a_part_of_a_table_is_not_read_alone_where_time_steps_back_before_it(tmp_path):
    """The policy is that of the whole log."""
    t_ns = 10**9 * np.r_[10_000:10_100, :9900]
    frame = pd.DataFrame({"t_ns": t_ns, "wx": 1e-6, "wy": 0.0, "wz": 0.0})
    for rows, is_refused in ((frame, True), (frame[100:], False)):
        rows.to_parquet(tmp_path / "log.parquet", row_group_size=100, index=False)
        if is_refused:
            with pytest.raises(TimelineError, match="time steps back by"):
                propagate(tmp_path / "log.parquet", start=10**12, end=1_099 * 10**9)
        else:
            found = propagate(tmp_path / "log.parquet", start=10**12, end=1_099 * 10**9)
            assert (found.t_ns // 10**9).tolist() == [*range(1000, 1100)]
            assert found.report.correction.part.leaves_out == (True, True)


def test_a_table_whose_beginning_is_damaged_begins_at_what_can_be_read(tmp_path):
    """Times from the first sample on counted from one near the end of the table."""
    t_ns, path = 10**9 * np.arange(1, 5001), tmp_path / "log.parquet"
    frame = pd.DataFrame({"t_ns": t_ns, "wx": 1e-6, "wy": 0.0, "wz": np.arange(5000.0) * 1e-9})
    frame.to_parquet(path, row_group_size=1000, index=False)
    content, file = bytearray(path.read_bytes()), pq.ParquetFile(path)
    begin = file.metadata.row_group(0).column(3).dictionary_page_offset
    content[begin : begin + 50] = b"\xff" * 50
    path.write_bytes(content)
    with pytest.warns(DataLossWarning, match="row group 0: it is damaged"):
        found = propagate(path, end="+20s")
    assert found.t_ns.tolist() == t_ns[1000:1021].tolist()
