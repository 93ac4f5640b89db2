"""Attitudes that are the identity until a filter starts are not taken as q0."""

import re

import numpy as np
import pytest
from make.ros import imu_messages, write_messages
from make.tables import write_attitudes

from quatprop import AttitudeSeries, propagate
from quatprop.base.errors import LogError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle
from quatprop.propagation.other_logs import attitude_in

COUNT = 400
T_NS = 10**18 + np.arange(COUNT) * 10_000_000
RATE = 0.8 * np.sin(np.arange(COUNT)[:, None] / 40 + np.arange(3))
TRUE = attitudes(T_NS, RATE, q0=exp([0.4, -0.3, 1.1]), method="mean")
UNIT = np.array([1.0, 0, 0, 0])


def late(count, sign=1.0):
    """Return the attitudes of a filter that starts after so many samples."""
    return np.where(np.arange(COUNT)[:, None] < count, sign * UNIT, TRUE)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("count", [1, 2, 50, 390])
@pytest.mark.parametrize("q0", ["log", "/imu", "file"])
def test_an_identity_that_jumps_is_refused_with_the_start_of_the_filter(tmp_path, q0, count, sign):
    """It was taken, 70 deg off, without a word; what is advised begins at the first estimate."""
    wxyz = late(count, sign)
    path = write_messages(tmp_path / "log.bag", imu_messages(T_NS, RATE, wxyz))
    if q0 == "file":
        q0 = write_attitudes(tmp_path / "other.csv", T_NS, wxyz)
    with pytest.raises(LogError, match="its attitudes are the identity until they jump by") as said:
        propagate(path, q0=q0)
    (start,) = re.findall(r"begin there with start='(\d+)', or give another q0$", f"{said.value}")
    assert int(start) == T_NS[count]
    found = propagate(path, q0=q0, start=start, method="mean")
    assert geodesic_angle(found.wxyz, TRUE[count:]).max() < 1e-9


def test_an_identity_at_the_first_sample_is_judged_by_those_that_follow():
    """The whole series was read, though the body only begins to turn from there."""
    turning = attitudes(T_NS, RATE, method="mean")
    batches = iter([AttitudeSeries(T_NS[[k]], turning[[k]]) for k in range(COUNT)])
    assert (attitude_in(batches, int(T_NS[0]), "log") == UNIT).all()
    assert len([*batches]) == COUNT - 21


@pytest.mark.parametrize("size", [1, 3, 17, COUNT])
def test_a_time_between_the_identity_and_the_jump_is_refused_whatever_the_batches(size):
    """And one behind the jump is not."""
    series = AttitudeSeries(T_NS, late(60))
    batches = [series[k : k + size] for k in range(0, COUNT, size)]
    for at in (T_NS[0], T_NS[59], T_NS[60] - 1):
        with pytest.raises(LogError, match=f"at {T_NS[60]} ns: placeholders, not attitudes"):
            attitude_in(iter(batches), int(at), "log")
    for at in (T_NS[60], T_NS[60] + 1, T_NS[200]):
        assert np.isfinite(attitude_in(iter(batches), int(at), "log")).all()


HEALTHY = {
    "it starts from the identity": (T_NS, attitudes(T_NS, RATE)),
    "it rests at first": (T_NS, attitudes(T_NS, RATE * (np.arange(COUNT) > 99)[:, None])),
    "it starts to turn fast": (
        T_NS,
        attitudes(T_NS, 5 * (np.arange(COUNT) > 99)[:, None] + 0 * RATE),
    ),
    "it was moved in a gap": (T_NS + (np.arange(COUNT) > 49) * 10**9, late(50)),
    "it never moves": (T_NS, late(COUNT)),
    "it moves at the very end": (T_NS, late(COUNT - 1)),
    "it is coarse": (T_NS[::40], attitudes(T_NS, RATE)[::40]),
}


@pytest.mark.parametrize("name", HEALTHY)
def test_an_identity_that_is_true_is_taken(name):
    """Of a simulation, of a series that begins there, or before a gap."""
    t_ns, wxyz = HEALTHY[name]
    assert geodesic_angle(attitude_in([AttitudeSeries(t_ns, wxyz)], int(t_ns[0]), "log"), UNIT) == 0
