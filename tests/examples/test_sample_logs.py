"""The sample logs are what the project generates, to the bit."""

import subprocess
import sys
import zlib
from importlib.metadata import version

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from make.commands import run
from make.places import SAMPLE_LOGS
from scipy.spatial.transform import Rotation

NOT_GENERATED = {".gitattributes", "README.md", "demo.sh", "generate.py"}

SINES = 1_097_573_778
"""CRC-32 of sines and cosines where the sample logs were generated."""


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
    """Only texts and scripts are not generated; a clone carries less than 1.5 MB."""
    assert files(SAMPLE_LOGS) - NOT_GENERATED == files(generated)
    assert sum((SAMPLE_LOGS / name).stat().st_size for name in files(SAMPLE_LOGS)) < 1_500_000


def test_every_byte_is_the_same(generated):
    """Generating them again gives the same files, bit for bit, with the versions of development."""
    pins = (SAMPLE_LOGS.parent / ".ci" / "constraints.txt").read_text().split()
    used = ("apsw", "lz4", "mcap", "numpy", "pyarrow", "rosbags", "zstandard")
    if not {f"{name}=={version(name)}" for name in used} <= set(pins):
        pytest.skip("other versions compress otherwise")
    angles = np.linspace(0, 7, 4001)
    if zlib.crc32(np.sin(angles).tobytes() + np.cos(angles).tobytes()) != SINES:
        pytest.skip("sin and cos of another system or processor round the last bit otherwise")
    for name in sorted(files(generated)):
        assert (generated / name).read_bytes() == (SAMPLE_LOGS / name).read_bytes(), name


def test_the_truth_starts_where_propagation_starts(generated):
    """Every truth begins with the identity, so that the default q0 is right."""
    for path in generated.glob("*.truth.csv"):
        first = pyarrow.csv.read_csv(path).slice(0, 1).to_pylist()[0]
        assert first == {"t_ns": 1_700_000_000_000_000_000, "qw": 1, "qx": 0, "qy": 0, "qz": 0}


def rotations(path):
    """Return the attitudes of a table as rotations of an independent library."""
    read = pyarrow.parquet.read_table if path.suffix == ".parquet" else pyarrow.csv.read_csv
    columns = read(path).select(["qx", "qy", "qz", "qw"]).columns
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
    run("propagate", SAMPLE_LOGS / log, "-o", result, "--method", method, code=0)
    error = (rotations(SAMPLE_LOGS / truth).inv() * rotations(result)).magnitude()
    assert error.max() < bound
