"""``quatprop simulate`` does what its options say, and says what they are."""

import pytest
from click.testing import CliRunner

from quatprop.cli import simulate as cli
from quatprop.simulate.motion import MOTIONS
from quatprop.writers.formats import WRITERS


def test_the_command_knows_every_motion():
    """The names that it lists without importing the motions are theirs."""
    assert tuple(MOTIONS) == cli.MOTIONS


def test_the_command_writes_log_and_truth(tmp_path):
    """Half a turn between samples, to the byte."""
    target = tmp_path / "spin.csv"
    result = CliRunner().invoke(
        cli.command,
        [str(target), "--frequency", "1", "--rate", "2", "--duration", "1.5s", "--start", "5"],
    )
    assert result.exit_code == 0, result.output
    truth = tmp_path / "spin.truth.csv"
    assert result.stderr == f"{target}: 3 samples of spin; the truth is in {truth}\n"
    assert target.read_bytes() == (
        b"t_ns,wx,wy,wz\n"
        b"5,0,0,6.283185307179586\n"
        b"500000005,0,0,6.283185307179586\n"
        b"1000000005,0,0,6.283185307179586\n"
    )
    assert truth.read_bytes() == (
        b"t_ns,qw,qx,qy,qz\n5,1,0,0,0\n500000005,0,0,0,1\n1000000005,-1,0,0,0\n"
    )


def test_the_command_writes_to_stdout():
    """A dash is CSV on stdout, without a truth."""
    result = CliRunner().invoke(cli.command, ["-", "--motion", "rest", "--samples", "1", "-q"])
    assert result.stdout == "t_ns,wx,wy,wz\n1700000000000000000,0,0,0\n"
    assert result.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--rate", "fast"],
            "Invalid value for '--rate': 'fast' is not a rate from 1e-9 to 1e9 Hz; write 100,",
        ),
        (["--angle", "wide"], "Invalid value for '--angle': 'wide' is not a number"),
        (["--seed", "-1"], "Invalid value for '--seed': -1 is not in the range x>=0"),
        (["--rate", "1e12"], "is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"),
        (["--rate", "0"], "is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"),
        (
            ["--start", "+10s"],
            "'+10s' is not a time; write RFC 3339 (2024-01-31T12:00:00Z) or integer nanoseconds",
        ),
        (["--start", "noon"], "'noon' is not a time"),
        (["--duration", "0s"], "'0s' is not a duration above 0"),
        (
            ["--samples", "5", "--duration", "1s"],
            "--samples and --duration exclude each other; give one of them",
        ),
        (["--motion", "coning", "--axis", "1,0,0"], "--axis goes with --motion spin"),
        (["--angle", "5"], "--angle goes with --motion coning or tumbling"),
        (["--motion", "rest", "--walk", "1"], "--walk goes with --motion random-walk"),
    ],
)
def test_wrong_usage_is_one_sentence(tmp_path, arguments, sentence):
    """Options that cannot be are refused with exit code 2 and nothing is written."""
    result = CliRunner().invoke(cli.command, [str(tmp_path / "a.csv"), *arguments])
    assert result.exit_code == 2
    assert sentence in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_formats_of_attitudes_alone_are_not_offered(tmp_path):
    """Where the suffix does not tell the format."""
    sentence = CliRunner().invoke(cli.command, [str(tmp_path / "a.ulg")]).exception
    kinds = [kind for kind in WRITERS if kind not in {"tum", "euroc", "kitti"}]
    assert str(sentence).endswith(
        ".npz, .mcap, .bag, none for a ROS 2 bag folder, or say to=" + " or ".join(map(repr, kinds))
    )


def test_every_option_says_its_default():
    """The help text is the documentation."""
    for option in cli.command.params[1:]:
        assert option.show_default or "[default: " in option.help or option.name == "help"
