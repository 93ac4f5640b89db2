"""Options in a file."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from quatprop.cli import cli

SAMPLES = Path(__file__).parent.parent / "sample_logs"


def run(*arguments):
    """Return the result of a command."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


CONFIG = """
method = "coning"
start = "+1s"
bias = [0.01, 0, -0.02]
rate = 50
on-gap = "zero"
max-gap = "200ms"
q0 = "first.csv"
layout = "scalar-last"
"""


def test_a_file_gives_the_options_of_a_run(tmp_path):
    """The output is that of the same options on the command line; those come first."""
    log = SAMPLES / "tumbling.bag"
    folder = tmp_path / "settings"
    folder.mkdir()
    (folder / "run.toml").write_text(CONFIG)
    (folder / "first.csv").write_text(
        "t_ns,qw,qx,qy,qz\n1700000000000000000,0,1,0,0\n1700000005000000000,0,1,0,0\n"
    )
    options = ["--method", "coning", "--start", "+1s", "--bias", "0.01,0,-0.02", "--rate", "50",
               "--on-gap", "zero", "--max-gap", "200ms", "--q0", folder / "first.csv",
               "--layout", "scalar-last"]  # fmt: skip
    for name, given in (("a", options), ("b", ["--config", folder / "run.toml"])):
        done = run("propagate", log, "-o", tmp_path / f"{name}.parquet", *given)
        assert done.exit_code == 0, done.output
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    again = run("propagate", log, "-o", tmp_path / "c.csv", "--config", folder / "run.toml",
                "--method", "mean", "-v")  # fmt: skip
    assert "method      mean" in again.stderr
    batch = run("batch", log, "-o", tmp_path / "out", "--config", folder / "run.toml")
    assert batch.exit_code == 0, batch.output
    assert (tmp_path / "out" / "tumbling.parquet").read_bytes() == (
        tmp_path / "a.parquet"
    ).read_bytes()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("metod = 'end'", "no such key 'metod'; did you mean 'method'?"),
        ("output = 'x.csv'", "no such key 'output'; "),
        ("method = 'rk4'", "Invalid value for '--method': 'rk4' is not one of"),
        ("max-gap = 5", "Invalid value for '--max-gap': "),
        ("method", "it is not TOML: "),
        (None, "it cannot be read: No such file"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_sentence(tmp_path, text, sentence):
    """The key and the file are named, and nothing is written."""
    path = tmp_path / "run.toml"
    if text is not None:
        path.write_text(text)
    result = run("propagate", SAMPLES / "spin.csv", "-o", tmp_path / "a.csv", "--config", path)
    assert result.exit_code == 2
    assert sentence in result.stderr.splitlines()[-1]
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.parametrize("key", ["bias", "imu"])
def test_a_file_that_a_key_names_is_beside_the_configuration(tmp_path, key):
    """Wherever the command is started: not there, it cannot be read."""
    (tmp_path / "imu.yaml").write_text("gyroscope_noise_density: 1e-4\n")
    (tmp_path / "bias.csv").write_text(
        "#timestamp,b_w_RS_S_x,b_w_RS_S_y,b_w_RS_S_z\n"
        "1700000000000000000,0,0,0\n1700000009000000000,0,0,0\n"
    )
    name = {"bias": "bias.csv", "imu": "imu.yaml"}[key]
    (tmp_path / "run.toml").write_text(f'{key} = "{name}"\n')
    done = run("propagate", SAMPLES / "tumbling.bag", "-o", tmp_path / "a.csv", "--config",
               tmp_path / "run.toml")  # fmt: skip
    assert done.exit_code == 0, done.output
