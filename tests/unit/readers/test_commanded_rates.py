"""Topics of estimated rates whose names say that they are commanded: named, or not read."""

import numpy as np
import pytest
from make.ros import imu_messages, write_messages

from quatprop import RemarkWarning, batch, propagate, read_rates
from quatprop.base.errors import UndeclaredError
from quatprop.base.text import in_python

COUNT = 60
T_NS = 10**18 + np.arange(COUNT) * 10_000_000
RATE = np.sin(np.arange(COUNT)[:, None] / 9 + np.arange(3))
NAMES = {
    **dict.fromkeys(("/cmd_vel", "/robot1/cmd_vel_mux/input", "/vel-cmd"), "cmd"),
    **dict.fromkeys(("/cmdVel", "/base/vel.cmd"), "cmd"),
    "/mavros/setpoint_velocity/out": "setpoint",
    "/twist_command": "command",
    "/teleop/twist": "teleop",
    "/desired_velocity": "desired",
}


def twists(topic):
    """Yield messages with rates of estimates or commands."""
    for t, rate in zip(T_NS.tolist(), RATE, strict=True):
        values = {"header": {"stamp": t, "frame_id": "base"}, "twist": {"angular": rate.tolist()}}
        yield topic, "geometry_msgs/msg/TwistStamped", t, values


@pytest.mark.parametrize("topic", NAMES)
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_rates_that_are_commanded_by_name_are_read_only_if_named(tmp_path, topic, suffix):
    """They were taken for the rates of the body, where the log has no others."""
    path = write_messages(tmp_path / f"log.{suffix}", twists(topic))
    with pytest.raises(UndeclaredError) as caught:
        propagate(path)
    assert in_python(f"{caught.value}") == (
        f"{path}: whether the rates of topic '{topic}' are those of the body ('{NAMES[topic]}' "
        f"does not tell) is not declared; specify it with topic='{topic}' if they are"
    )
    said = f"by the name of topic '{topic}' .* its rates are not measured on the body"
    with pytest.warns(RemarkWarning, match=said):
        assert np.array_equal(read_rates(path, topic=topic).rate, RATE)


def test_commands_beside_other_rates_are_ignored(tmp_path):
    """A log of both was refused as ambiguous; those of a gyroscope came first before, too."""
    both = sorted((*twists("/cmd_vel"), *twists("/odom_twist")), key=lambda one: one[2])
    path = write_messages(tmp_path / "log.bag", both)
    with pytest.warns(RemarkWarning, match=r"not measured on the body: '/cmd_vel'$"):
        assert np.array_equal(read_rates(path).rate, RATE)


def test_a_batch_of_all_topics_leaves_out_commands_too(tmp_path):
    """It wrote attitudes of /cmd_vel."""
    both = sorted((*twists("/cmd_vel"), *twists("/odom_twist")), key=lambda one: one[2])
    path = write_messages(tmp_path / "log.bag", both)
    (entry,) = batch(path, tmp_path / "out", topic="*", processes=1)
    assert "odom_twist" in str(entry.output)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("topic", ["/reference/imu", "/target/imu/data", "/desired_imu"])
def test_what_a_gyroscope_has_measured_is_no_command(tmp_path, topic):
    """Whatever its name: it may be that of a reference sensor."""
    messages = [(topic, *rest) for _, *rest in imu_messages(T_NS, RATE)]
    path = write_messages(tmp_path / "log.mcap", messages)
    assert np.array_equal(read_rates(path).rate, RATE)


@pytest.mark.parametrize("topic", ["/odom_twist", "/velocity_body", "/preferred_base"])
def test_other_names_of_estimates_say_nothing(tmp_path, topic):
    """Of a word that only begins as one for a command neither."""
    path = write_messages(tmp_path / "log.mcap", twists(topic))
    assert np.array_equal(read_rates(path).rate, RATE)
