"""Options in a file."""

import hashlib
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS

from quatprop import GyroSeries, __version__, propagate, read_attitudes, write
from quatprop.cli.commands import cli


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
    log = SAMPLE_LOGS / "tumbling.bag"
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
        (None, "no such file or folder; check the path"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_sentence(tmp_path, text, sentence):
    """The key and the file are named, and nothing is written."""
    path = tmp_path / "run.toml"
    if text is not None:
        path.write_text(text)
    result = run("propagate", SAMPLE_LOGS / "spin.csv", "-o", tmp_path / "a.csv", "--config", path)
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
    done = run("propagate", SAMPLE_LOGS / "tumbling.bag", "-o", tmp_path / "a.csv", "--config",
               tmp_path / "run.toml")  # fmt: skip
    assert done.exit_code == 0, done.output


IMU = "gyroscope_noise_density: 1e-4\ngyroscope_random_walk: 1e-6\n"
RUNS = {
    "defaults": ("spin.csv", "a.parquet", ""),
    "config": ("tumbling.bag", "a.feather", "--config run.toml"),
    "times": ("tumbling.bag", "a.npz", "--start +1s --end -2500ms --rate 30000/1001 --layout xyzw"),
    "rest": ("rest.parquet", "a.parquet", "--bias static:500ms --every 3 --threads 1"),
    "bias": ("coning.mcap", "a.mcap", "--bias=0.1,-1e-3,0 --mount y,-x,z --max-gap 0.5s -t /imu"),
    "angles": ("tumbling.bag", "a.csv", "--with euler-zxz --euler-unit deg --header-comment"),
    "messages": ("tumbling.bag", "a.bag", "--message Imu --out-topic /x --frames map,imu"),
    "tum": ("tumbling.bag", "a.tum", "--header-comment --method mean"),
    "errors": (
        "tumbling.bag",
        "a.parquet",
        "--imu imu.yaml --bias-sigma 20deg/h --sigma --scale-sigma 0.1%",
    ),
    "at": ("tumbling.bag", "a.parquet", "--at first.csv --q0 first.csv"),
    "dashes": ("tumbling.bag", "a.parquet", "--q0 0.6,0,0.8,0 --on-gap zero --from bag"),
}


@pytest.mark.parametrize("name", RUNS)
def test_an_output_is_made_again_from_its_own_metadata(tmp_path, monkeypatch, name):
    """To the byte, whatever the options were and wherever they were given, in another folder."""
    monkeypatch.chdir(tmp_path)
    for file, text in (("imu.yaml", IMU), ("run.toml", CONFIG)):
        Path(file).write_text(text)
    Path("first.csv").write_text(
        "t_ns,qw,qx,qy,qz\n1700000000000000000,0,1,0,0\n1700000005000000000,0,1,0,0\n"
    )
    log, out, options = RUNS[name]
    made = run("propagate", SAMPLE_LOGS / log, "-o", out, *options.split())
    assert made.exit_code == 0, made.output
    shown = run("info", out, "--as-config")
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.startswith(f"# quatprop propagate {SAMPLE_LOGS / log} -o OUT --config")
    Path("again").mkdir()
    Path("again/again.toml").write_text(shown.stdout)
    monkeypatch.chdir("again")
    again = run("propagate", SAMPLE_LOGS / log, "-o", out, "--config", "again.toml")
    assert again.exit_code == 0, again.output
    if str(tmp_path) not in shown.stdout:
        assert Path(out).read_bytes() == (tmp_path / out).read_bytes()
    # Paths of files that options name are recorded in full then.
    expected, series = read_attitudes(tmp_path / out), read_attitudes(out)
    np.testing.assert_array_equal(series.t_ns, expected.t_ns)
    np.testing.assert_array_equal(series.wxyz, expected.wxyz)


def test_a_configuration_of_an_output_says_which_files_have_changed(tmp_path, monkeypatch):
    """Paths are those of the current folder; what a file held is compared with what it holds."""
    monkeypatch.chdir(tmp_path)
    Path("imu.yaml").write_text(IMU)
    Path("at.csv").write_text("t_ns,qw,qx,qy,qz\n1700000000000000000,0,1,0,0\n")
    log = SAMPLE_LOGS / "spin.csv"
    run("propagate", log, "-o", "a.parquet", "--imu", "imu.yaml", "--q0", "1,0,0,0",
        "--at", "at.csv")  # fmt: skip
    sums = {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in ("at.csv",
            "imu.yaml")}  # fmt: skip
    shown = run("info", "a.parquet", "--as-config")
    assert shown.stderr == ""
    assert shown.stdout.splitlines()[2:] == [
        f"# at.csv: unchanged; its SHA-256 was {sums['at.csv']}",
        f"# imu.yaml: unchanged; its SHA-256 was {sums['imu.yaml']}",
        f'at = "{tmp_path / "at.csv"}"',
        f'imu = "{tmp_path / "imu.yaml"}"',
        'layout = "scalar-first"',
        'q0 = "1,0,0,0"',
    ]
    Path("imu.yaml").write_text(IMU + "\n")
    Path("at.csv").unlink()
    shown = run("info", "a.parquet", "--as-config")
    assert shown.exit_code == 0
    assert shown.stdout.splitlines()[2:4] == [
        f"# at.csv: it is missing; its SHA-256 was {sums['at.csv']}",
        f"# imu.yaml: it has changed since; its SHA-256 was {sums['imu.yaml']}",
    ]
    assert shown.stderr == (
        "Warning: at.csv, which a.parquet was made with: it is missing\n"
        "Warning: imu.yaml, which a.parquet was made with: it has changed since\n"
    )


def test_settings_of_the_library_are_text_in_metadata(tmp_path):
    """Numbers get their unit, times are absolute, arrays are lists of numbers."""
    log = SAMPLE_LOGS / "tumbling.bag"
    start = datetime.fromtimestamp(1_700_000_001, UTC)
    series = propagate(log, start=start, bias=np.array([0.1, 0, 0]), rate=Fraction(30000, 1001),
                       max_gap=timedelta(seconds=1), noise_density=1e-3, sigma=True,
                       q0=[0.0, 1, 0, 0], scale_sigma=1e-3)  # fmt: skip
    write(series, tmp_path / "a.parquet")
    shown = run("info", tmp_path / "a.parquet", "--as-config").stdout
    assert shown.splitlines()[2:] == [
        'bias = "0.1,0.0,0.0"', 'max-gap = "1000000000ns"',
        'noise-density = "0.001rad/s/sqrt(Hz)"', 'q0 = "0.0,1.0,0.0,0.0"', 'rate = "30000/1001"',
        'scale-sigma = "1000.0ppm"', "sigma = true", 'start = "1700000001000000000"',
    ]  # fmt: skip
    (tmp_path / "a.toml").write_text(shown)
    again = run("propagate", log, "-o", tmp_path / "b.parquet", "--config", tmp_path / "a.toml")
    assert again.exit_code == 0, again.output
    np.testing.assert_array_equal(read_attitudes(tmp_path / "b.parquet").wxyz, series.wxyz)


def test_a_file_that_says_nothing_of_its_making_is_refused(tmp_path):
    """The sentence says which outputs do."""
    run("propagate", SAMPLE_LOGS / "spin.csv", "-o", tmp_path / "a.csv")
    result = run("info", tmp_path / "a.csv", "--as-config")
    assert result.exit_code == 2
    assert "it does not say with which options it was made; outputs of" in result.stderr
    result = run("info", tmp_path / "a.csv", tmp_path / "a.csv", "--as-config")
    assert "--as-config prints one file for one LOG" in result.stderr
    run("propagate", SAMPLE_LOGS / "spin.csv", "-o", tmp_path / "a.parquet", "--method", "mean")
    run("convert", tmp_path / "a.parquet", tmp_path / "b.npz")
    shown = run("info", tmp_path / "b.npz", "--as-config").stdout.splitlines()
    assert shown[2] == "# converted afterwards, which this does not repeat"
    assert shown[3:] == ['layout = "scalar-first"', 'method = "mean"']


def test_the_settings_of_rates_in_memory_are_for_any_log(tmp_path):
    """There is no log to name, and no digest of it."""
    rates = GyroSeries([0, 1_000_000], [[0, 0, 1]] * 2)
    write(propagate(rates, method="mean"), tmp_path / "a.parquet")
    assert run("info", tmp_path / "a.parquet", "--as-config").stdout.splitlines() == [
        "# quatprop propagate LOG -o OUT --config THIS_FILE",
        f"# by quatprop {__version__}",
        'method = "mean"',
    ]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("sigma = 1", "'sigma' is true or false, not 1"),
        ("quiet = 'no'", "'quiet' is true or false, not 'no'"),
    ],
)
def test_a_flag_is_true_or_false(tmp_path, line, reason):
    """As in a suite: a number of the option of the same name may be meant."""
    path = tmp_path / "a.toml"
    path.write_text(line)
    result = run("propagate", SAMPLE_LOGS / "spin.csv", "-o", tmp_path / "a.csv", "--config", path)
    assert (result.exit_code, result.stderr.splitlines()[-1]) == (2, f"Error: {path}: {reason}")


def test_a_configuration_may_begin_with_a_byte_order_mark(tmp_path):
    """Editors on Windows write one."""
    path = tmp_path / "a.toml"
    path.write_text('method = "mean"\n', encoding="utf-8-sig")
    result = run("propagate", SAMPLE_LOGS / "spin.csv", "-o", tmp_path / "a.csv", "--config", path)
    assert "method      mean" in result.stderr
