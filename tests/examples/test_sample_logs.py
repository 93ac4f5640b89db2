"""The sample logs are what the project generates, to the bit."""

import math
import os
import shutil
import stat
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from make.places import SAMPLE_LOGS
from scipy.spatial.transform import Rotation

from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings, PropagationSettings

NOT_GENERATED = {".gitattributes", "README.md", "demo.sh", "generate.py"}


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """Generate every sample log into a fresh folder, as the make target does."""
    folder = tmp_path_factory.mktemp("sample_logs")
    subprocess.run([sys.executable, SAMPLE_LOGS / "generate.py", folder], check=True)
    return folder


def files(folder):
    """Return the relative paths of all files of a folder."""
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_every_file_is_generated(generated):
    """Nothing is in the folder that the project cannot make again, but words and scripts."""
    assert files(SAMPLE_LOGS) - NOT_GENERATED == files(generated)


def test_every_byte_is_the_same(generated):
    """Generating them again gives the same files, bit for bit, with the versions of development."""
    pins = (SAMPLE_LOGS.parent / ".ci" / "constraints.txt").read_text().split()
    used = ("apsw", "lz4", "mcap", "numpy", "pyarrow", "rosbags", "zstandard")
    if not {f"{name}=={version(name)}" for name in used} <= set(pins):
        pytest.skip("other versions compress otherwise")
    differing = [
        name
        for name in sorted(files(generated))
        if (generated / name).read_bytes() != (SAMPLE_LOGS / name).read_bytes()
    ]
    assert differing == []


def test_they_stay_small():
    """A clone carries them: all together stay below 1.5 MB."""
    assert sum((SAMPLE_LOGS / name).stat().st_size for name in files(SAMPLE_LOGS)) < 1_500_000


def test_the_truth_starts_where_propagation_starts(generated):
    """Every truth begins with the identity, so that the default q0 is right."""
    for path in generated.glob("*.truth.csv"):
        first = pyarrow.csv.read_csv(path).slice(0, 1).to_pylist()[0]
        assert first == {"t_ns": 1_700_000_000_000_000_000, "qw": 1, "qx": 0, "qy": 0, "qz": 0}


def attitudes(path):
    """Return the attitudes of a table as rotations of an independent library."""
    read = pyarrow.parquet.read_table if path.suffix == ".parquet" else pyarrow.csv.read_csv
    table = read(path)
    columns = [table[name].to_numpy() for name in ("qx", "qy", "qz", "qw")]
    return Rotation.from_quat(np.column_stack(columns))


@pytest.mark.parametrize(
    ("log", "truth", "method", "bound"),
    [
        ("spin.csv", "spin.truth.csv", "start", 1e-14),
        ("spin.csv", "spin.truth.csv", "coning", 1e-14),
        # Fifty samples a turn: what is left is what the rate does between them.
        ("coning.mcap", "coning.truth.csv", "start", 1.2e-2),
        ("coning.mcap", "coning.truth.csv", "mean", 2.6e-3),
        ("coning.mcap", "coning.truth.csv", "coning", 1.3e-3),
        ("tumbling.bag", "tumbling.truth.csv", "start", 1e-2),
        ("tumbling.bag", "tumbling.truth.csv", "coning", 2e-4),
        ("tumbling_ros2", "tumbling.truth.csv", "coning", 2e-4),
        # 30 s of a bias of 2.3 mrad/s.
        ("rest.parquet", "rest.truth.parquet", "start", 7e-2),
    ],
)
def test_every_log_propagates_to_its_truth(tmp_path, log, truth, method, bound):
    """From the container to the attitude file, the error stays below what the motion explains."""
    result = tmp_path / "result.csv"
    settings = PropagationSettings(method=method)
    run(Job(str(SAMPLE_LOGS / log), OutputSettings(str(result)), settings))
    error = (attitudes(SAMPLE_LOGS / truth).inv() * attitudes(result)).magnitude()
    assert error.max() < bound


@pytest.mark.skipif(not shutil.which("awk"), reason="the demo needs a shell with awk")
def test_the_demo_shows_the_error_of_every_log(tmp_path):
    """Each line of its table has a log, a method, and the same angle in rad and in deg."""
    root = tmp_path / "clone"
    root.mkdir()
    shutil.copytree(SAMPLE_LOGS, root / "sample_logs")
    places = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [shutil.which("sh"), "sample_logs/demo.sh"],
        cwd=root, env={**os.environ, "PATH": places}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    rows = [line.split() for line in done.stdout.splitlines() if line.endswith(" deg")]
    table = [row for row in rows if len(row) == 6 and row[1] != "%"]
    assert len(table) == 9
    for _log, _method, radians, _rad, degrees, _deg in table:
        assert math.degrees(float(radians)) == pytest.approx(float(degrees), rel=1e-5, abs=1e-12)


def test_containers_do_not_matter(tmp_path):
    """The same recording as a ROS 1 and as a ROS 2 bag gives the same bytes."""
    results = []
    for log in ("tumbling.bag", "tumbling_ros2"):
        results.append(tmp_path / f"{log}.csv")
        run(Job(str(SAMPLE_LOGS / log), OutputSettings(str(results[-1]))))
    assert results[0].read_bytes() == results[1].read_bytes()


def test_the_demo_can_be_run():
    """``make demo`` calls a script that is executable."""
    assert (SAMPLE_LOGS / "demo.sh").stat().st_mode & stat.S_IXUSR
