"""Whole commands on recordings, each against what users would take or a library needs."""

import sys
import tempfile
from pathlib import Path

from table import Table, command

HERE = Path(__file__).parent
PYTHON = [sys.executable, "-c"]
QUATPROP = [sys.executable, "-m", "quatprop"]

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


def measure(folder: Path, samples: int) -> None:
    """Print one table a log, and one for each other command."""
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
            table = Table(f"{title}, {samples:,} samples")
            for name, words in rows.items():
                seconds, megabytes = command(1 if "script" in name else repeats, words)
                table.row(name, seconds, samples, megabytes)
