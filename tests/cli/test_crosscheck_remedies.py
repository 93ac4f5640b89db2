"""The lines that ``quatprop crosscheck`` prints lead to sound sources, followed as printed."""

import re
import shlex

import numpy as np
import pytest
from make.commands import run
from make.rigs import DEG, FAULTS, GYRO, MOCAP, ORIENTATION, rig, with_values
from make.tables import write_attitudes, write_rates

import quatprop
from quatprop.kinematics.quaternion import exp, multiply

BIAS = np.array([1.4, -0.6, 0.8])


def table(path, source):
    """Write a source as a table; return the path."""
    if not source.is_rates:
        return write_attitudes(path, source.t_ns, source.values)
    rows = [(t, *w) for t, w in zip(source.t_ns.tolist(), source.values.tolist(), strict=True)]
    return write_rates(path, rows, "t_ns,wx_rad_s,wy_rad_s,wz_rad_s")


def tables(folder, sources):
    """Write the gyroscope and the motion capture of a rig as tables; return the paths."""
    return [table(folder / f"{name}.csv", sources[key]) for name, key in
            (("imu", GYRO), ("mocap", MOCAP))]  # fmt: skip


def followed(*words, at_most=4):
    """Run a cross-check and every corrected line; return the command lines and the last output."""
    lines = [["crosscheck", *map(str, words)]]
    while True:
        said = run(*lines[-1])
        again = re.search(r"^corrected: quatprop (.*)$", said.stdout, re.MULTILINE)
        if again is None:
            return lines, said
        assert len(lines) < at_most, said.stdout
        lines.append(shlex.split(again[1]))


def test_the_corrected_line_repeats_what_was_given(tmp_path):
    """It lost limits, what is allowed and corrections, and so never came to an end."""
    mirrored = FAULTS["mirrored"][0](FAULTS["late"][0](FAULTS["mount"][0](rig(3))))
    logs = tables(tmp_path, FAULTS["scale"][0](mirrored))
    given = ("--correct", "imu.csv:scale=0.5", "--tol-mount=3deg", "--allow", "clock,bias")
    lines, said = followed(*logs, *given)
    assert said.exit_code == 0, said.stdout
    assert len(lines) > 2  # the mounting is seen once the axes are no longer mirrored
    for line in lines:
        assert {"--tol-mount=3deg", "--allow", "clock,bias"} < {*line}
        assert sum("imu.csv:scale" in word for word in line) == 1
    factor = next(word for word in lines[-1] if word.startswith("imu.csv:scale="))
    assert abs(1.1 * float(factor.partition("=")[2]) - 1) < 0.02


def test_corrections_on_corrections_are_combined(tmp_path):
    """A mounting that is half right, an offset, and a direction that was turned in error."""
    logs = tables(tmp_path, FAULTS["late"][0](rig(4)))
    given = ["mocap.csv:mount=y:20deg", "mocap.csv:time-offset=-50ms",
             "mocap.csv:from-direction=ref-to-body"]  # fmt: skip
    words = [part for one in given for part in ("--correct", one)]
    lines, said = followed(*logs, *words)
    assert said.exit_code == 0, said.stdout
    assert not any("from-direction" in word for word in lines[-1])
    offset = next(word for word in lines[-1] if word.startswith("mocap.csv:time-offset="))
    assert abs(float(offset.partition("=")[2].removesuffix("ms")) + 80) < 6


def test_an_offset_next_to_a_clock_rate_is_stated(tmp_path):
    """Of clocks that agree at no time of the log, the offset was hidden behind their rates."""
    sources = FAULTS["clock"][0](rig(5))
    both = sources | FAULTS["late"][0](sources)
    said = run("crosscheck", *tables(tmp_path, both), "--allow", "clock", code=1)
    late = re.search(r"is (?:late|early) by (.*?) \+- .* ms in the middle of the log", said.stdout)
    assert abs(float(late[1]) - 80 - 19) < 3  # and half of what the clock gains in 38 s
    assert "faster than" in said.stdout
    _, said = followed(*tables(tmp_path, both), "--allow", "clock")
    assert said.exit_code == 0
    drifting = run("crosscheck", *tables(tmp_path, sources), "--allow", "clock", code=0)
    assert "late" not in drifting.stdout
    assert "early" not in drifting.stdout


def wheels(folder):
    """Write a gyroscope upside down, and wheels that turn 1.15 times as far, with a pose."""
    sources = rig(5, "planar")
    slam = sources[MOCAP]
    seconds = (slam.t_ns - slam.t_ns[0]) * 1e-9
    yaw = np.unwrap(2 * np.arctan2(slam.values[:, 3], slam.values[:, 0]))
    # Drawn anew for each, as a second measurement has noise of its own.
    random = np.random.default_rng(3)
    frames = [1.15 * yaw, 1.15 * yaw, yaw]
    rates = 1.15 * np.gradient(yaw, seconds)
    noise = 0.3 * DEG * random.normal(size=len(rates))
    upside_down = with_values(GYRO, lambda w: w * [1, -1, -1])(sources)
    logs = [table(folder / "imu.csv", upside_down[GYRO])]
    for name, angle in zip(("wheels", "tf", "slam"), frames, strict=True):
        error = 0.02 * DEG * random.normal(size=len(angle))
        wxyz = exp((angle + error)[:, None] * np.array([0.0, 0.0, 1.0]))
        logs.append(write_attitudes(folder / f"{name}.csv", slam.t_ns, wxyz))
    rows = [(t, 0.0, 0.0, w) for t, w in zip(slam.t_ns.tolist(), rates + noise, strict=True)]
    logs.append(write_rates(folder / "turns.csv", rows, "t_ns,wx_rad_s,wy_rad_s,wz_rad_s"))
    return logs


def test_one_side_of_a_difference_is_corrected(tmp_path):
    """Both sides of one scale were, which made two sound sources contradict each other."""
    logs = wheels(tmp_path)
    before = run("crosscheck", *logs, code=1).stdout
    scaled = re.findall(r"--correct (\S+):scale=", before)
    assert scaled in (["turns.csv"], ["imu.csv"])
    assert re.findall(r"--correct (\S+):mount=", before) == ["imu.csv"]
    lines, said = followed(*logs)
    assert "fault" not in said.stdout
    assert sum("scale=" in word for word in lines[-1]) == 1


@pytest.mark.thorough(keep=1)
@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize("faults", [("axes",), ("axes", "deg/s read as rad/s"), ("mount",)])
def test_propagate_takes_all_options_as_printed(tmp_path, faults):
    """The bias is that of the rates as recorded, before and after they are corrected."""
    sources = with_values(GYRO, lambda w: w + BIAS * DEG)(rig(4))
    for name in faults:
        sources = FAULTS[name][0](sources)
    logs = tables(tmp_path, sources)
    lines, _ = followed(*logs)
    found = [run(*line).stdout for line in lines]
    biases = [re.search(r"--bias=(\S+)", one)[1] for one in found]
    numbers = [np.array([*map(float, one.removesuffix("deg/s").split(","))]) for one in biases]
    assert all(np.allclose(one, numbers[0], atol=0.1) for one in numbers)
    corrections = dict(
        re.fullmatch(r"imu\.csv:(.*?)=(.*)", one).groups()
        for one in lines[-1]
        if one.startswith("imu.csv:")
    )
    options = [part for name, value in corrections.items() for part in (f"--{name}", value)]
    errors = []
    for also in ([], [f"--bias={biases[-1]}"]):
        out = tmp_path / f"out{len(errors)}.csv"
        words = ("--method", "coning", *options, *also)
        run("propagate", logs[0], "-o", out, *words, code=0)
        errors.append(quatprop.compare(out, logs[1], align="mount").error_rad.rms)
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_a_bias_next_to_a_scale_is_that_of_the_rates(tmp_path):
    """It was the one after the scale, which propagate has no option for."""
    biased = with_values(GYRO, lambda w: w + BIAS * DEG)
    scaled = with_values(GYRO, lambda w: 1.2 * w)(rig(4))
    lines, _ = followed(*tables(tmp_path, biased(scaled)))
    assert len(lines) > 1
    for line in lines:
        text = re.search(r"--bias=(\S+)deg/s", run(*line).stdout)[1]
        # The rig itself has a bias of about 0.05 deg/s.
        assert np.allclose([*map(float, text.split(","))], BIAS, atol=0.2)


def test_a_configuration_has_the_bias_and_what_was_corrected(tmp_path):
    """The same one is written before and after the corrections, of sources that are consistent."""
    biased = with_values(GYRO, lambda w: w + BIAS * DEG)(rig(8))
    logs = tables(tmp_path, FAULTS["axes"][0](biased))
    logs.append(table(tmp_path / "filter.csv", biased[ORIENTATION]))
    lines, _ = followed(*logs)
    texts = []
    for line in lines:
        run(*line, "--write-config", tmp_path / "made.toml")
        texts.append((tmp_path / "made.toml").read_text())
    assert len(texts) > 1
    for text in texts:
        assert 'mount = "-y,x,z"' in text
        bias = re.search(r'^bias = "(.*)deg/s"$', text, re.MULTILINE)[1]
        assert np.allclose([*map(float, bias.split(","))], BIAS[[1, 0, 2]] * [1, -1, 1], atol=0.3)


def test_mirrored_axes_are_corrected_for_trial(tmp_path):
    """A mounting behind them was not seen, as nothing could be tried."""
    logs = tables(tmp_path, FAULTS["mirrored"][0](FAULTS["mount"][0](rig(3))))
    lines, said = followed(*logs)
    assert any(word.startswith("imu.csv:axes=") for word in lines[1])
    assert any(":mount=" in word for word in lines[-1])
    assert said.exit_code == 0


def test_a_wrong_layout_is_read_in_the_right_one(tmp_path):
    """It was repaired as a conjugate with a mounting that nothing has."""
    capture = rig(6)[MOCAP]
    turned = multiply(capture.values, exp(np.array([0.0, 0.0, np.pi / 4])))
    first, second = (tmp_path / name for name in ("capture.csv", "filter.csv"))
    write_attitudes(first, capture.t_ns, np.roll(turned, -1, axis=1))
    error = 1e-3 * np.random.default_rng(1).normal(size=(len(capture.t_ns), 3))
    estimated = multiply(capture.values, exp(error))
    write_attitudes(second, capture.t_ns + 10**5, estimated)
    logs = (table(tmp_path / "imu.csv", rig(6)[GYRO]), second, first)
    lines, said = followed(*logs)
    assert said.exit_code == 0
    assert "capture.csv:from-layout=scalar-last" in lines[-1]
    angle = re.search(r"is mounted ([\d.]+) \+- ", run(*lines[0]).stdout)[1]
    assert abs(float(angle) - 45) < 0.1


def test_what_is_not_shown_is_said_of_consistent_sources_too(tmp_path):
    """It was listed only if something differs."""
    _, _, frame, _, turns = wheels(tmp_path)
    said = run("crosscheck", frame, turns, code=0).stdout.splitlines()
    assert said[0] == "2 sources of rotation, consistent"
    assert said[1].startswith("not shown: the rotation about z, or mirrored axes, of ")
