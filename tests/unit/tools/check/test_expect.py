"""Expectations of a suite on a log without a reference: a gate for new logs."""

import json
import shutil

import numpy as np
import pytest
from make.rigs import DEG, FAULTS, GYRO, MOCAP, ORIENTATION, rig, with_values
from make.ros import imu_messages, write_messages
from make.suites import check, write_suite

from quatprop.kinematics.quaternion import exp, multiply

POSE = "geometry_msgs/msg/PoseStamped"
WELL = """\
[case.rig]
log = "rig.mcap"
topic = "/imu"

[case.rig.expect]
rate = "100Hz"
rate-tol = "1%"
gaps = 0
drops = 0
topics = ["/imu", "/mocap"]
unit = "rad/s"
agree = { offset = "20ms", mount = "3deg", orientation = "5deg" }
"""


def log_of(folder, sources):
    """Write a rig as a log of messages."""
    gyro, orientation, mocap = (sources[name] for name in (GYRO, ORIENTATION, MOCAP))
    messages = [*imu_messages(gyro.t_ns, gyro.values, orientation.values)]
    for t_ns, (w, *xyz) in zip(mocap.t_ns.tolist(), mocap.values.tolist(), strict=True):
        pose = {"header": {"stamp": t_ns}, "pose": {"orientation": [*xyz, w]}}
        messages.append(("/mocap", POSE, t_ns, pose))
    write_messages(folder / "rig.mcap", sorted(messages, key=lambda one: one[2]))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write a rig in which nothing is wrong."""
    folder = tmp_path_factory.mktemp("rig")
    log_of(folder, rig(3))
    return folder


@pytest.fixture
def well(written, tmp_path):
    """Give a folder with that log."""
    shutil.copy(written / "rig.mcap", tmp_path)
    return tmp_path


def judged(folder, text, code):
    """Return the result of the only case of a suite."""
    result = check(write_suite(folder, text), "--json")
    assert result.exit_code == code, result.output
    (case,) = json.loads(result.stdout)["cases"]
    return case


def test_a_log_as_expected_passes_without_a_reference(well):
    """There is nothing to pin, and an update changes nothing."""
    case = judged(well, WELL, 0)
    assert (case["verdict"], case["summary"]) == ("pass", "the log is as expected")
    assert check(well / "suite.toml", "--update").exit_code == 0
    explained = check(well / "suite.toml", "--explain")
    assert explained.exit_code == 0
    assert "expected   rate, rate-tol, gaps, drops, topics, unit, agree" in explained.output


@pytest.mark.parametrize(
    ("was", "now", "reason"),
    [
        ('rate = "100Hz"', "rate = 120", "the sample rate is 100 Hz, expected 120 Hz +- 1 %"),
        ('"/mocap"]', '"/lidar"]', "topic '/lidar' is missing; the topics are '/imu', '/mocap'"),
        ('unit = "rad/s"', 'unit = "deg/s"', "the rates are in rad/s, expected deg/s"),
    ],
)
def test_unmet_expectations_fail(well, was, now, reason):
    """The reason states the actual and the expected value."""
    text = WELL.split("agree", maxsplit=1)[0]
    case = judged(well, text.replace(was, now), 1)
    assert (case["verdict"], case["reason"]) == ("fail", reason)


def test_gaps_and_lost_samples_are_counted(tmp_path):
    """A pause is a gap, and a rate that is not finite is lost."""
    sources = rig(3)
    gyro = sources[GYRO]
    values = gyro.values.copy()
    values[[50, 60]] = np.nan
    kept = np.r_[0:1000, 1200 : len(gyro.t_ns)]
    messages = imu_messages(gyro.t_ns[kept], values[kept], sources[ORIENTATION].values[kept])
    write_messages(tmp_path / "rig.mcap", messages)
    text = WELL.split("topics", maxsplit=1)[0]
    reason = judged(tmp_path, text, 1)["reason"]
    assert reason.startswith("1 gap, expected at most 0, the first before ")
    assert reason.endswith("; 2 samples lost, expected at most 0")
    judged(tmp_path, text.replace("gaps = 0", "gaps = 1").replace("drops = 0", "drops = 2"), 0)


def test_a_loss_of_unknown_size_is_at_least_one_sample(well):
    """The end of a log that was cut off; its samples are not counted as none."""
    path = well / "rig.mcap"
    path.write_bytes(path.read_bytes()[:-30_000])
    text = WELL.split("gaps", maxsplit=1)[0] + "drops = 0\n"
    assert judged(well, text, 1)["reason"] == "at least 1 sample lost, expected at most 0"


def test_sources_have_to_agree(tmp_path):
    """Offsets and mountings beyond the limits fail, unless they are allowed."""
    turned = with_values(MOCAP, lambda wxyz: multiply(wxyz, exp(np.array([0.0, 6 * DEG, 0.0]))))
    log_of(tmp_path, FAULTS["late"][0](turned(rig(3))))
    reason = judged(tmp_path, WELL, 1)["reason"]
    assert "/mocap is mounted 6.0" in reason
    assert "/mocap is late by " in reason
    assert "(--time-offset -" in reason
    wide = WELL.replace('"20ms"', '"200ms"').replace('"3deg"', '"8deg"')
    judged(tmp_path, wide, 0)
    judged(tmp_path, f'{WELL}allow = ["mount", "offset"]\n', 0)


def test_noise_at_rest_is_limited(tmp_path):
    """The RMS of the noisiest axis in a rest."""
    random = np.random.default_rng(1)
    t_ns = np.arange(2000) * 10**7 + 10**9
    write_messages(
        tmp_path / "rig.mcap", imu_messages(t_ns, 0.2 * DEG * random.normal(size=(2000, 3)))
    )
    text = '[case.rig]\nlog = "rig.mcap"\n[case.rig.expect]\nnoise = "{}deg/s"\n'
    judged(tmp_path, text.format(0.25), 0)
    reason = judged(tmp_path, text.format(0.1), 1)["reason"]
    assert reason.startswith("the noise at rest is 0.2")
    assert reason.endswith(" deg/s, expected at most 0.1 deg/s")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("rat = 1", "'expect' has no key 'rat'"),
        ("gaps = -1", "'-1' is not a whole number; write 0 or more"),
        ('agree = { ofset = "20ms" }', "'ofset' is not a limit"),
        ('allow = ["everything"]', "'everything' is not one of"),
    ],
)
def test_refusals(well, line, sentence):
    """A mistake in the table is refused, with its key."""
    text = '[case.rig]\nlog = "rig.mcap"\n[case.rig.expect]\n' + line + "\n"
    assert sentence in judged(well, text, 2)["reason"]


def test_a_case_with_a_limit_still_needs_a_reference(well):
    """A tolerance without something to compare with would be ignored."""
    reason = judged(well, WELL.replace('topic = "/imu"', 'tol = "1deg"'), 2)["reason"]
    assert "there is no reference" in reason


def test_all_files_of_a_recording_are_read(tmp_path):
    """Its sources are not compared, since no file has them all."""
    gyro = rig(3)[GYRO]
    half = len(gyro.t_ns) // 2
    for k, rows in enumerate((slice(half), slice(half, None), slice(half + 200, None))):
        write_messages(tmp_path / f"{k}.mcap", imu_messages(gyro.t_ns[rows], gyro.values[rows]))
    log = 'log = ["0.mcap", "1.mcap"]'
    text = WELL.replace('log = "rig.mcap"', log).replace(', "/mocap"', "")
    case = judged(tmp_path, text, 2)
    assert case["reason"].endswith("'agree' compares the sources of one file; name one log")
    judged(tmp_path, text.split("agree", maxsplit=1)[0], 0)
    with_gap = text.split("agree", maxsplit=1)[0].replace("1.mcap", "2.mcap")
    assert judged(tmp_path, with_gap, 1)["reason"].startswith("1 gap, expected at most 0")
