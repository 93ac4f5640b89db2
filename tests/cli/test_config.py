"""Options in a file, and the file of options that an output gives."""

import hashlib
import os
import shutil
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from make.commands import run
from make.places import SAMPLE_LOGS

from quatprop import GyroSeries, __version__, propagate, read_attitudes, write
from quatprop.base.errors import UsageError
from quatprop.propagation.configuration import config_of

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
OPTIONS = (
    "--method coning --start +1s --bias 0.01,0,-0.02 --rate 50 --on-gap zero --max-gap 200ms "
    "--layout scalar-last --q0"
)
IMU = "gyroscope_noise_density: 1e-4\ngyroscope_random_walk: 1e-6\n"
FILES = {
    "run.toml": CONFIG,
    "imu.yaml": IMU,
    "first.csv": "t_ns,qw,qx,qy,qz\n1700000000000000000,0,1,0,0\n1700000005000000000,0,1,0,0\n",
    "bias.csv": "#timestamp,b_w_RS_S_x,b_w_RS_S_y,b_w_RS_S_z\n"
    "1700000000000000000,0,0,0\n1700000009000000000,0,0,0\n",
    # Editors on Windows begin a file with a byte order mark.
    "mark.toml": '\ufeffmethod = "mean"\n',
    "bias.toml": 'bias = "bias.csv"\n',
    "imu.toml": 'imu = "imu.yaml"\n',
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Begin in a folder that has these files, and sample logs."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text)
    for name in ("spin.csv", "tumbling.bag", "coning.mcap", "rest.parquet"):
        Path(name).symlink_to(SAMPLE_LOGS / name)
    return tmp_path


def shown(*paths, code=0):
    """Return the lines of the configuration that an output gives."""
    return run("info", *paths, "--as-config", code=code).stdout.splitlines()


def test_a_file_gives_the_options_of_a_run(folder):
    """The output is that of the same options on the command line; those come first."""
    (folder / "settings").mkdir()
    for name in ("run.toml", "first.csv"):
        shutil.move(name, "settings")
    config = ("--config", folder / "settings" / "run.toml")
    options = [*OPTIONS.split(), folder / "settings" / "first.csv"]
    run("propagate", "tumbling.bag", "-o", "a.parquet", *options, code=0)
    run("propagate", "tumbling.bag", "-o", "b.parquet", *config, code=0)
    run("batch", "tumbling.bag", "-o", "out", *config, code=0)
    assert Path("b.parquet").read_bytes() == Path("a.parquet").read_bytes()
    # Where a batch ran is not in its outputs.
    assert pq.read_table("out/tumbling.bag.parquet").equals(pq.read_table("a.parquet"))
    again = run("propagate", "tumbling.bag", "-o", "c.csv", *config, "--method", "mean", "-v")
    assert "method      mean" in again.stderr


@pytest.mark.usefixtures("folder")
def test_none_takes_back_what_a_configuration_gives():
    """A rate in a file could be replaced, but not left out."""
    settings = {"rate": "50 Hz", "on-gap": "zero", "max-gap": "1s", "topic": "/imu"}
    Path("more.toml").write_text("".join(f'{key} = "{settings[key]}"\n' for key in settings))
    line = ("propagate", "tumbling.bag", "-o", "a.parquet", "--config", "more.toml")
    assert "500 attitudes written" in run(*line, code=0).stderr
    run(*line, *(text for name in settings for text in (f"--{name}", "none")), code=0)
    run("propagate", "tumbling.bag", "-o", "b.parquet", code=0)
    assert Path("a.parquet").read_bytes() == Path("b.parquet").read_bytes()


@pytest.mark.parametrize("name", ["bias.toml", "imu.toml", "mark.toml"])
def test_a_file_that_a_key_names_is_next_to_the_configuration(folder, monkeypatch, name):
    """Wherever the command is started: not there, it cannot be read."""
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    done = run("propagate", "../tumbling.bag", "-o", "a.csv", "--config", f"../{name}", code=0)
    assert ("method      mean" in done.stderr) == (name == "mark.toml")


RUNS = {
    "spin.csv -o a.parquet": "",
    "tumbling.bag -o a.feather": "--config run.toml",
    "tumbling.bag -o a.npz": "--start +1s --end -2500ms --rate 30000/1001 --layout xyzw",
    "rest.parquet -o a.parquet": "--bias static:500ms --every 3 --threads 1",
    "coning.mcap -o a.mcap": "--bias=0.1,-1e-3,0 --mount y,-x,z --max-gap 0.5s -t /imu",
    "spin.csv -o unit.parquet": "--bias=0.1,-1e-3,0.2deg/s",
    "tumbling.bag -o a.csv": "--with euler-zxz --euler-unit deg --header-comment",
    "tumbling.bag -o a.bag": "--message Imu --out-topic /x --frames map,imu",
    "tumbling.bag -o a.tum": "--header-comment --method mean",
    "tumbling.bag -o errors.parquet": "--imu imu.yaml --bias-sigma 20deg/h --sigma "
    "--scale-sigma 0.1% --misalignment-sigma 5mrad --q0-sigma 1deg,1deg,5deg",
    "tumbling.bag -o at.parquet": "--at first.csv --q0 first.csv",
    "tumbling.bag -o dashes.parquet": "--q0 0.6,0,0.8,0 --on-gap zero --from bag",
}


@pytest.mark.parametrize("words", RUNS)
def test_an_output_is_made_again_from_its_own_metadata(folder, words):
    """To the byte, whatever the options were; options that name files made it print full paths."""
    name, _, out = words.split()
    log = SAMPLE_LOGS / name
    run("propagate", log, "-o", out, *RUNS[words].split(), code=0)
    configuration = "\n".join(shown(out))
    assert configuration.startswith(f"# quatprop propagate {log} -o OUT --config")
    Path("again.toml").write_text(configuration)
    (folder / "again").mkdir()
    run("propagate", log, "-o", f"again/{out}", "--config", "again.toml", code=0)
    assert Path("again", out).read_bytes() == Path(out).read_bytes()


@pytest.mark.usefixtures("folder")
def test_a_configuration_of_an_output_says_which_files_have_changed():
    """Paths are those of the current folder; what a file held is compared with what it holds."""
    files = {"at": "first.csv", "imu": "imu.yaml"}
    options = [part for name, file in files.items() for part in (f"--{name}", file)]
    run("propagate", "spin.csv", "-o", "a.parquet", "--q0", "1,0,0,0", *options, code=0)
    sums = {file: hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in files.values()}

    def said(states):
        return [
            f"# {file}: {state}; its SHA-256 was {sums[file]}"
            for file, state in zip(sums, states, strict=True)
        ]

    assert shown("a.parquet")[2:] == [
        *said(["unchanged"] * 2),
        "# paths are as they were given: keep this file in the folder of that run",
        'at = "first.csv"',
        'imu = "imu.yaml"',
        'layout = "scalar-first"',
        'q0 = "1,0,0,0"',
    ]
    Path("imu.yaml").write_text(f"{IMU}\n")
    Path("first.csv").unlink()
    states = ["it is missing", "it has changed since"]
    assert shown("a.parquet")[2:4] == said(states)
    assert run("info", "a.parquet", "--as-config", code=0).stderr.splitlines() == [
        f"Warning: {file}, which a.parquet was made with: {state}"
        for file, state in zip(sums, states, strict=True)
    ]


@pytest.mark.usefixtures("folder")
def test_a_pipe_cannot_be_compared_afterwards():
    """It is not called missing, either."""
    out, into = os.pipe()
    os.write(into, Path("first.csv").read_bytes())
    os.close(into)
    run("propagate", "tumbling.bag", "-o", "a.parquet", "--at", f"/dev/fd/{out}", code=0)
    os.close(out)
    assert shown("a.parquet")[2:] == [
        f"# /dev/fd/{out}: what it held is not known, as it was no file",
        f'at = "/dev/fd/{out}"',
        'layout = "scalar-first"',
    ]


@pytest.mark.usefixtures("folder")
def test_settings_of_the_library_are_text_in_metadata():
    """Numbers get their unit, times are absolute, arrays are lists of numbers."""
    log = SAMPLE_LOGS / "tumbling.bag"
    start = datetime.fromtimestamp(1_700_000_001, UTC)
    series = propagate(log, start=start, bias=np.array([0.1, 0, 0]), rate=Fraction(30000, 1001),
                       max_gap=timedelta(seconds=1), noise_density=1e-3, sigma=True,
                       q0=[0.0, 1, 0, 0], scale_sigma=1e-3, q0_sigma=(1e-3, 1e-3, 0.1),
                       misalignment_sigma=5e-3)  # fmt: skip
    write(series, "a.parquet")
    assert shown("a.parquet")[2:] == [
        'bias = "0.1,0.0,0.0"', 'max-gap = "1000000000ns"', 'misalignment-sigma = "0.005rad"',
        'noise-density = "0.001rad/s/sqrt(Hz)"', 'q0 = "0.0,1.0,0.0,0.0"',
        'q0-sigma = "0.001rad,0.001rad,0.1rad"', 'rate = "30000/1001"',
        'scale-sigma = "1000.0ppm"', "sigma = true", 'start = "1700000001000000000"',
    ]  # fmt: skip
    Path("a.toml").write_text("\n".join(shown("a.parquet")))
    run("propagate", log, "-o", "b.parquet", "--config", "a.toml", code=0)
    np.testing.assert_array_equal(read_attitudes("b.parquet").wxyz, series.wxyz)
    # Of rates in memory there is no log to name, and no digest of it.
    rates = GyroSeries([0, 1_000_000], [[0, 0, 1]] * 2)
    write(propagate(rates, method="mean"), "c.parquet")
    assert shown("c.parquet") == [
        "# quatprop propagate LOG -o OUT --config THIS_FILE",
        f"# by quatprop {__version__}",
        'method = "mean"',
    ]


@pytest.mark.usefixtures("folder")
def test_a_conversion_keeps_the_settings_of_what_it_converts():
    """It says that they do not repeat the conversion."""
    run("propagate", "spin.csv", "-o", "a.parquet", "--method", "mean", code=0)
    run("convert", "a.parquet", "b.npz", code=0)
    assert shown("b.npz")[2:] == [
        "# converted afterwards, which this does not repeat",
        'layout = "scalar-first"',
        'method = "mean"',
    ]


SOURCE = {"kind": "series", "sha256": None}


@pytest.mark.parametrize("kept", [{}, {"settings": {"rate": "5"}}, {"source": SOURCE}])
def test_metadata_of_other_programs_is_not_a_configuration(kept):
    """It needs both; what an older version did not write is not missed."""
    with pytest.raises(UsageError, match="it does not say with which options it was made"):
        config_of("a.parquet", {"quatprop": "0", **kept})
    whole = {"quatprop": "0", "settings": {"rate": "5"}, "source": SOURCE}
    assert config_of("a.parquet", whole).text.splitlines()[2:] == ['rate = "5"']
