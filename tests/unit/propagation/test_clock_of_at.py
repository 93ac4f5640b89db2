"""Times of ``--at`` that are later than their recording are of another clock."""

import re

import numpy as np
import pytest
from make.ros import imu_messages, write_messages

from quatprop import propagate

T_NS = 10**18 + np.arange(500) * 10_000_000
RATE = np.sin(np.arange(500)[:, None] / 30 + np.arange(3))
VECTOR = "geometry_msgs/msg/Vector3Stamped"
pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")


def told(path, ahead_s, *, rates_ahead_s=0.0, **settings):
    """Return the remark on the clock of the times, if any, and the attitudes."""
    messages = [*imu_messages(T_NS + round(rates_ahead_s * 1e9), RATE, recorded=T_NS + 2_000_000)]
    for t in T_NS[10:400:10].tolist():
        stamped = {"header": {"stamp": t + round(ahead_s * 1e9)}, "vector": [0.0, 0.0, 0.0]}
        messages.append(("/trigger", VECTOR, t + 2_000_000, stamped))
    write_messages(path, sorted(messages, key=lambda one: one[2]))
    found = propagate(path, at="/trigger", **settings)
    return [str(one) for one in found.report.remarks if one.code == "at-other-clock"], found


def test_times_that_are_later_than_their_recording_are_remarked_on(tmp_path):
    """Each attitude was that of 0.8 s after its trigger, unsaid; the remedy is applied."""
    (said,), _ = told(tmp_path / "log.mcap", 0.8)
    assert said == (
        "the times of '/trigger' for at are 798 ms later than those of their recording, and the "
        "times of the rates are not: another clock? for the times of recording of both choose "
        "clock='log'"
    )
    clock = re.search(r"clock='(\w+)'$", said)[1]
    said, found = told(tmp_path / "log.mcap", 0.8, clock=clock)
    assert said == []
    np.testing.assert_array_equal(found.t_ns, T_NS[10:400:10] + 2_000_000)


@pytest.mark.parametrize(("ahead", "of_rates"), [(0, 0), (0.15, 0), (-0.5, 0), (1, 1), (0, -0.5)])
def test_late_messages_and_a_common_clock_are_not_remarked_on(tmp_path, ahead, of_rates):
    """Messages are recorded after their times; a clock that all share may be another."""
    assert told(tmp_path / "log.mcap", ahead, rates_ahead_s=of_rates)[0] == []
