"""Whole commands on recordings, each against what users would take or a library needs."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from table import PYTHON, QUATPROP, compared

HERE = Path(__file__).parent

READ = """
import sys
with open(sys.argv[1], "rb", buffering=0) as file:
    while file.read(1 << 20): pass
"""
UNPACK_BAG = """
import sys; from pathlib import Path; from rosbags.rosbag1 import Reader
with Reader(Path(sys.argv[1])) as bag:
    for _ in bag.messages(): pass
"""
DECODE = f"import sys; sys.path.insert(0, {str(HERE)!r}); from pathlib import Path; import decode; "
UNPACK_MCAP = DECODE + "decode.read_and_decompress(Path(sys.argv[1]))"
SELECT = DECODE + "decode.select_blobs(Path(sys.argv[1]))"

FLOORS = {
    "imu_zstd.mcap": ("read and unpack alone", UNPACK_MCAP),
    "imu.bag": ("reading its bytes alone", READ),
    "imu_bz2.bag": ("rosbags Reader, messages not decoded", UNPACK_BAG),
    "imu_lz4.bag": ("rosbags Reader, messages not decoded", UNPACK_BAG),
    "imu_db3": ("SELECT of stamps and blobs alone", SELECT),
}
"""Log -> what its floor is called, and the script that does it."""


SMALL_LOGS, SMALL_SAMPLES = 2000, 100


def measure(folder: Path, samples: int) -> None:
    """Print one table a log, and one for each other command."""
    _measure_small_logs()
    repeats = 3 if samples <= 10**6 else 1
    with tempfile.TemporaryDirectory() as scratch:
        a, b, out = (Path(scratch) / name for name in ("a.parquet", "b.parquet", "out.csv"))
        log = folder / "imu_zstd.mcap"
        run = [*QUATPROP, "propagate", "-q"]
        tables = {
            f"propagate {name} to Parquet": {
                "quatprop, --threads 1": [*run, folder / name, "-o", a, "--threads", 1],
                "quatprop, --threads 2": [*run, folder / name, "-o", b, "--threads", 2],
                floor: [*PYTHON, script, folder / name],
            }
            for name, (floor, script) in FLOORS.items()
        }
        tables[f"propagate {log.name} to CSV"] = {
            "quatprop": [*run, log, "-o", out],
            "rosbags + scipy script": [sys.executable, HERE / "user_script.py", log, out],
        }
        tables[f"info {log.name}"] = {
            "quatprop info": [*QUATPROP, "info", log],
            "read and unpack alone": [*PYTHON, UNPACK_MCAP, log],
        }
        tables[f"the last second of {log.name}"] = {
            "quatprop propagate --start -1s": [*run, log, "-o", a, "--start", "-1s"],
            "the whole log": [*run, log, "-o", a],
        }
        tables["start up, per sample of the log"] = {
            "quatprop --help": [*QUATPROP, "--help"],
            "import click": [*PYTHON, "import click"],
        }
        for title, rows in tables.items():
            compared(f"{title}, {samples:,} samples", rows, samples, repeats)


def _measure_small_logs() -> None:
    """Print the CPU time of a batch, per log."""
    title = f"batch of {SMALL_LOGS:,} logs of {SMALL_SAMPLES} samples, CPU time per log"
    for kind in ("csv", "mcap"):
        with tempfile.TemporaryDirectory() as scratch:
            one, logs = Path(scratch, f"one.{kind}"), Path(scratch, "logs")
            options = ["--samples", str(SMALL_SAMPLES), "--noise", "1e-3", "--seed", "1", "-q"]
            subprocess.run([*QUATPROP, "simulate", one, *options], check=True)
            logs.mkdir()
            for number in range(SMALL_LOGS):
                shutil.copy(one, logs / f"{number}.{kind}")
            words = [*QUATPROP, "batch", logs, "-o", Path(scratch, "out"), "-j", "1", "-q"]
            compared(f"{title}, {kind}", {"quatprop": words}, SMALL_LOGS, 1, is_cpu=True)
