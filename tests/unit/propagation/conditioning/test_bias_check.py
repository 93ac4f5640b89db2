"""A bias that is given is compared with a rest at the beginning of the log."""

import json
import re

import numpy as np
import pytest
from make.ros import TF, imu_messages, write_messages
from scipy.spatial.transform import Rotation

from quatprop import GyroSeries, propagate
from quatprop.kinematics.quaternion import geodesic_angle

COUNT = 1000
T_NS = 10**18 + np.arange(COUNT) * 10_000_000
BIAS = np.array([0.02, -0.015, 0.01])
DEG = 180 / np.pi
VECTOR = "geometry_msgs/msg/Vector3Stamped"
MOUNT = Rotation.from_euler("xyz", [170, 20, 65], degrees=True)
pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")


def write(  # noqa: PLR0913  # what may be wrong
    path, biases, *, bias=BIAS, turn=0.0, frame="", transforms=()
):
    """Write rates of a body that rests and then moves, and biases."""
    rng = np.random.default_rng(5)
    t_s = np.arange(COUNT) / 100
    phase = t_s[:, None] * [2.0, 2.6, 1.4] + np.arange(3)
    rate = bias + np.clip(t_s - 5, 0, 1)[:, None] * np.sin(phase) + [0, 0, turn]
    rate = rate + rng.normal(0, 1e-3, (COUNT, 3))
    force = np.array([0, 0, 9.8]) + rng.normal(0, 0.02, (COUNT, 3))
    more = {"frame": "imu_link", "linear_acceleration": force.tolist()}
    messages = [*imu_messages(T_NS, rate, **more)]
    for t in T_NS[::50].tolist():
        stamped = {"header": {"stamp": t, "frame_id": frame}, "vector": list(biases)}
        messages.append(("/bias", VECTOR, t, stamped))
    return write_messages(path, [*transforms, *sorted(messages, key=lambda one: one[2])])


def told(path, **settings):
    """Return the remarks on biases, by their code, and the attitudes."""
    found = propagate(path, topic="/imu", **settings)
    codes = "bias-contradicts-rest", "bias-turned"
    return {one.code: str(one) for one in found.report.remarks if one.code in codes}, found


WRONG = {
    "is it in deg/s?": (BIAS * DEG, BIAS),
    "is it to be added?": (-BIAS, BIAS),
    "were they corrected already?": (BIAS, BIAS * 0),
    "is it of this sensor, in its axes and in rad/s?": (BIAS[[1, 2, 0]], BIAS),
}


@pytest.mark.thorough
@pytest.mark.parametrize("given", ["topic", "numbers"])
@pytest.mark.parametrize("cause", WRONG)
def test_a_bias_that_makes_the_rates_at_rest_larger_is_remarked_on(tmp_path, cause, given):
    """In deg/s, of the other sign, subtracted twice, about other axes: 56 to 180 deg, unsaid."""
    biases, bias = WRONG[cause]
    path = write(tmp_path / "log.mcap", biases, bias=bias)
    numbers = ",".join(repr(float(one)) for one in biases) + "rad/s"
    said, _ = told(path, bias="/bias" if given == "topic" else numbers)
    after, before = (np.linalg.norm(one) * DEG for one in (bias - biases, bias))
    text = said["bias-contradicts-rest"]
    found = re.match(
        r"the bias that is given leaves (.+) deg/s of the rates at rest, from \d+ to \d+ ns, and "
        r"without it they are (.+) deg/s: (.+\?) For the mean rate at rest use bias=.?static.?$",
        text,
    )
    assert found[3] == cause
    assert [float(found[1]), float(found[2])] == pytest.approx([after, before], rel=5e-3, abs=0.03)
    assert told(path, bias="static")[0] == {}


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.0, 0.6, 1.0, 1.4])
@pytest.mark.parametrize("turn", [0.0, 0.05, -0.3])
def test_a_bias_that_is_about_right_is_not_remarked_on(tmp_path, share, turn):
    """Also of a body that turns steadily, which looks like rest."""
    path = write(tmp_path / "log.mcap", BIAS * share, turn=turn)
    assert told(path, bias="/bias")[0] == {}


def test_biases_about_axes_of_another_frame_are_turned_into_those_of_the_rates(tmp_path):
    """They were subtracted as they are: 114 deg, unsaid."""
    made = [[0, "base_link"], "imu_link", ([1, 2, 3], MOUNT.as_quat())]
    transforms = [("/tf_static", TF, int(T_NS[0]) - 10, [[made]])]
    path = write(tmp_path / "log.mcap", MOUNT.apply(BIAS), frame="base_link", transforms=transforms)
    said, found = told(path, bias="/bias")
    assert said == {
        "bias-turned": (
            "the biases are about axes of 'base_link', and the rates about those of 'imu_link': "
            f"they are turned by {MOUNT.magnitude() * DEG:.3g} deg, by the static transforms of "
            "the log"
        )
    }
    other = propagate(path, topic="/imu", bias=BIAS)
    assert geodesic_angle(found.wxyz, other.wxyz).max() < 1e-9


def test_biases_of_a_frame_that_nothing_relates_to_the_rates_are_remarked_on(tmp_path):
    """They were subtracted as they are, unsaid."""
    path = write(tmp_path / "log.mcap", BIAS, frame="base_link")
    found = propagate(path, topic="/imu", bias="/bias").report.remarks
    (said,) = [str(one) for one in found if one.code == "bias-of-other-frame"]
    assert said == (
        "the biases are about axes of 'base_link', and the rates about those of 'imu_link': they "
        "are subtracted as if these were the same"
    )


def in_memory(bias, *, turn=0.0, moving=0.0):
    """Return rates in memory, which no accelerometer confirms, of a rest or a steady turn."""
    t_s = np.arange(COUNT) / 100
    phase = t_s[:, None] * [2.0, 2.6, 1.4] + np.arange(3)
    motion = np.maximum(np.clip(t_s - 5, 0, 1), moving)[:, None] * np.sin(phase)
    noise = np.random.default_rng(8).normal(0, 1e-3, (COUNT, 3))
    return GyroSeries(T_NS, bias + motion + [0, 0, turn] + noise)


OTHER_UNIT = {"is it in deg/s?": BIAS * DEG, "is it in rad/s?": BIAS / DEG}


@pytest.mark.parametrize("cause", OTHER_UNIT)
def test_a_bias_in_another_unit_is_shown_by_the_rates_at_rest_alone(tmp_path, cause):
    """Without an accelerometer nothing was said: up to 66 deg/s."""
    biases = OTHER_UNIT[cause].tolist()
    calibration = tmp_path / "calibration.yaml"
    matrix = np.eye(3).tolist()
    calibration.write_text(json.dumps({"matrix": matrix, "bias": biases}))
    for given in ({"bias": biases}, {"calibration": calibration}):
        found = propagate(in_memory(BIAS), **given).report.remarks
        (said,) = [str(one) for one in found if one.code == "bias-contradicts-rest"]
        assert f" deg/s: {cause} For the mean rate at rest use bias=" in said
    with_force = write(tmp_path / "log.mcap", biases)
    assert cause in told(with_force, bias="/bias")[0]["bias-contradicts-rest"]


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0, 1.4])
@pytest.mark.parametrize("turn", [0.0, 0.05, -0.1, 0.19])
def test_rates_alone_do_not_contradict_a_bias_by_a_steady_turn(share, turn):
    """They look like those of a rest with another bias."""
    found = propagate(in_memory(BIAS, turn=turn), bias=BIAS * share).report.remarks
    assert not [one for one in found if one.code.startswith("bias-")]


@pytest.mark.parametrize(("degrees", "is_said"), [(29.9, False), (30.1, True)])
def test_a_bias_beyond_gyroscopes_is_remarked_on_without_a_rest(degrees, is_said):
    """Data sheets allow up to 20 deg/s; in deg/s a bias of 0.5 is read as 29 deg/s."""
    rates = in_memory(BIAS, moving=1.0)
    found = propagate(rates, bias=[0, degrees / DEG, 0]).report.remarks
    said = [str(one) for one in found if one.code == "bias-beyond-sensors"]
    text = f"the bias that is given is {degrees} deg/s, more than gyroscopes have"
    assert said == is_said * [f"{text}: is it in deg/s, or not of a rest?"]
