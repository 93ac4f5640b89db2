"""Help: groups of options, one screen of common ones, examples that run, names that were meant."""

import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner
from make.into_logs import IMU, imu_message, moments
from make.places import ROOT
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from quatprop.cli.commands import COMMANDS, cli
from quatprop.cli.help import GROUPS
from quatprop.comparison.settings import COMPARE
from quatprop.settings import PROPAGATE, READ_ATTITUDES

SCREEN = 60
"""Lines of a terminal window."""


def run(*arguments, width=80, **environment):
    """Return the output of quatprop on a terminal of this width."""
    runner = CliRunner(env=environment)
    return runner.invoke(cli, arguments, prog_name="quatprop", color=True, terminal_width=width)


def test_every_setting_has_a_group_in_help():
    """Its row says which, and that is one of those that help has."""
    keywords = {**PROPAGATE, **COMPARE, **READ_ATTITUDES}.values()
    assert {keyword.group for keyword in keywords} <= {*GROUPS}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("width", [80, 120])
def test_help_fits_the_terminal(name, width):
    """Every line fits, examples too; the common options are one screen."""
    common = run(name, "--help", width=width, NO_COLOR="1").output.splitlines()
    assert name == "check" or len(common) <= SCREEN
    whole = run(name, "--help-all", width=width, NO_COLOR="1").output.splitlines()
    for line in [*common, *whole]:
        assert len(line) <= width or line.strip().startswith("--"), line
    assert width == 80 or max(map(len, whole)) > 80


def test_long_examples_go_on_in_a_second_line():
    """They can be copied as they are."""
    shown = run("check", "--help", width=60, NO_COLOR="1").output
    first = "  quatprop check suite.toml --init sample_logs/spin.csv"
    assert f"\n{first} \\\n    sample_logs/tumbling.bag\n" in shown


@pytest.mark.parametrize("name", ["propagate", "batch", "convert", "compare", "plot"])
def test_help_all_shows_every_option(name):
    """The common ones are among them, in the same groups."""
    command = cli.get_command(None, name)
    options = {option for p in command.params for option in p.opts if option.startswith("--")}
    common, whole = (run(name, flag, NO_COLOR="1").output for flag in ("--help", "--help-all"))
    assert {option for option in options if f"{option} " in whole} == options
    shown = {option for option in options if f"{option} " in common}
    assert shown
    assert shown < options


def test_help_is_coloured_unless_no_color_is_set():
    """On a terminal; NO_COLOR with any value turns colours off, an empty one does not."""
    assert "\x1b[1mInput\x1b[0m:" in run("propagate", "--help").output
    assert "\x1b[1mCommands\x1b[0m:" in run("--help").output
    assert "\x1b" in run("--help", NO_COLOR="").output
    assert "\x1b" not in run("propagate", "--help", NO_COLOR="1").output
    assert "\x1b" not in run("--help", NO_COLOR="1").output


def test_the_examples_of_every_command_run(tmp_path, monkeypatch):
    """One after the other, in a folder that has the sample logs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    for name in COMMANDS:
        examples = cli.get_command(None, name).examples
        assert examples, name
        for line in examples:
            program, *arguments = shlex.split(line)
            assert program == "quatprop"
            done = run(*arguments)
            assert done.exit_code == 0, (line, done.stderr)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["propagat"], "No such command 'propagat'; did you mean 'propagate'?"),
        (["draw"], "No such command 'draw'; quatprop --help lists the commands"),
        (["propagate", "--metod", "x"], "No such option '--metod'; did you mean '--method'?"),
        (["propagate", "--on-gaps", "x"], "No such option '--on-gaps'; did you mean '--on-gap'?"),
        (["propagate", "--zzz"], "No such option '--zzz'"),
        (["propagate", "x", "--method", "conning"], "'quintic'; did you mean 'coning'?"),
        (["info", "--frame", "x"], "No such option '--frame'"),
        (["compare", "--topic", "x"], "No such option '--topic'; did you mean '--topic-a'?"),
        (["compare", "-t", "x"], "No such option '-t'; did you mean '--topic-a'?"),
        (["convert", "--as", "euler", "x"], "did you mean 'euler-zyx'?"),
    ],
)  # fmt: skip
def test_the_name_that_was_meant_is_suggested(arguments, sentence):
    """Of commands, options and choices: the one that is nearest, or none."""
    result = run(*arguments)
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert line.endswith(sentence)


def write_bag(path):
    """Write a ROS 1 bag with two gyroscopes."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as writer:
        for topic in ("/cam/imu", "/imu_raw"):
            connection = writer.add_connection(topic, IMU, typestore=store)
            for stamp, logged in moments(3):
                writer.write(connection, logged, imu_message(store, stamp, ros1=True))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["log.bag", "-t", "imu"], "one of '/cam/imu', '/imu_raw'; did you mean '/cam/imu'?"),
        (["log.bag", "-t", "/imuraw"], "did you mean '/imu_raw'?"),
        (["log.csv", "--rate-cols", "gx,gy,gzz"], "'gx', 'gy', 'gz'; did you mean 'gz'?"),
        (
            ["log.bag", "-t", "/imu_raw", "--time-field", "header.stmp"],
            "has 'seq', 'stamp', 'frame_id'; did you mean 'stamp'?",
        ),
    ],
)
def test_topics_columns_and_fields_are_suggested(tmp_path, monkeypatch, arguments, sentence):
    """As they are in the log."""
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t_ns,gx,gy,gz\n0,0,0,1\n1000000,0,0,1\n")
    write_bag("log.bag")
    result = run("propagate", *arguments, "--rate-unit", "rad/s", "-o", "x.csv")
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert line.endswith(sentence)


@pytest.mark.parametrize("command", ["info", "propagate", "convert", "compare"])
def test_long_lists_of_choices_are_wrapped(command):
    """They are in the text, not beside the name of the option."""
    shown = run(command, "--help-all", NO_COLOR="1").stdout
    assert [line for line in shown.splitlines() if len(line) > 80] == []
