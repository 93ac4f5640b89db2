"""Whole commands on every kind of log, each against a floor: what a library needs to read it."""

import sys
import tempfile
from pathlib import Path

from table import Table, command

QUATPROP = [sys.executable, "-m", "quatprop"]

ARROW_CSV = "import sys, pyarrow.csv as c; c.read_csv(sys.argv[1])"
ARROW_PARQUET = "import sys, pyarrow.parquet as p; p.read_table(sys.argv[1])"
ARROW_BOTH = "import sys, pyarrow.parquet as p; [p.read_table(name) for name in sys.argv[1:]]"
ARROW_COPY = """
import sys, pyarrow.parquet as p, pyarrow.csv as c
c.write_csv(p.read_table(sys.argv[1]), sys.argv[2])
"""
READ = """
import sys
with open(sys.argv[1], "rb", buffering=0) as file:
    while file.read(1 << 20): pass
"""
UNPACK_BAG = """
import sys
from pathlib import Path
from rosbags.rosbag1 import Reader
with Reader(Path(sys.argv[1])) as bag:
    for _ in bag.messages(): pass
"""
UNPACK_MCAP = """
import sys; sys.path.insert(0, sys.argv[2])
from pathlib import Path
from decode import read_and_decompress
read_and_decompress(Path(sys.argv[1]))
"""
SELECT = """
import sys; sys.path.insert(0, sys.argv[2])
from pathlib import Path
from decode import select_blobs
select_blobs(next(Path(sys.argv[1]).glob("*.db3")))
"""
HERE = Path(__file__).parent

FLOORS = {
    "imu_zstd.mcap": ("read and unpack alone", UNPACK_MCAP),
    "imu.bag": ("reading its bytes alone", READ),
    "imu_bz2.bag": ("rosbags Reader, messages not decoded", UNPACK_BAG),
    "imu_lz4.bag": ("rosbags Reader, messages not decoded", UNPACK_BAG),
    "imu_db3": ("SELECT of stamps and blobs alone", SELECT),
    "imu.csv": ("pyarrow.csv.read_csv", ARROW_CSV),
    "imu.parquet": ("pyarrow.parquet.read_table", ARROW_PARQUET),
}
"""Log -> what its floor is called, and the script that does it."""


def measure(folder: Path, samples: int) -> None:
    """Print one table a log, and one for each other command."""
    repeats = 3 if samples <= 10**6 else 1
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        for name, (floor, script) in FLOORS.items():
            log = folder / name
            table = Table(f"propagate {name} to Parquet, {samples:,} samples")
            run = [*QUATPROP, "propagate", "-q", log, "-o", out / "a.parquet"]
            for threads in (1, 2):
                ran = command(repeats, [*run, "--threads", threads])
                table.ran(f"quatprop, --threads {threads}", ran, samples)
            ran = command(repeats, [sys.executable, "-c", script, log, HERE])
            table.ran(floor, ran, samples)
        _others(folder / "imu_zstd.mcap", out, samples, repeats)


def _others(log: Path, out: Path, samples: int, repeats: int) -> None:
    a, b = out / "a.parquet", out / "b.parquet"
    command(1, [*QUATPROP, "propagate", "-q", log, "-o", a])
    command(1, [*QUATPROP, "propagate", "-q", log, "-o", b, "--method", "mean"])
    unpack = command(repeats, [sys.executable, "-c", UNPACK_MCAP, log, HERE])
    table = Table(f"info {log.name}")
    table.ran("quatprop info", command(repeats, [*QUATPROP, "info", log]), samples)
    table.ran("read and unpack alone", unpack, samples)
    table = Table(f"compare two Parquet files of {samples:,} attitudes")
    table.ran("quatprop compare", command(repeats, [*QUATPROP, "compare", a, b]), samples)
    ran = command(repeats, [sys.executable, "-c", ARROW_BOTH, a, b])
    table.ran("pyarrow.parquet.read_table of both", ran, samples)
    table = Table(f"convert Parquet to CSV, {samples:,} attitudes")
    run = [*QUATPROP, "convert", a, out / "c.csv", "--layout", "xyzw"]
    table.ran("quatprop convert", command(repeats, run), samples)
    ran = command(repeats, [sys.executable, "-c", ARROW_COPY, a, out / "d.csv"])
    table.ran("pyarrow read_table and write_csv", ran, samples)
    table = Table(f"the last second of {log.name}, per sample of the whole log")
    run = [*QUATPROP, "propagate", "-q", log, "-o", out / "e.parquet"]
    table.ran("quatprop propagate --start -1s", command(repeats, [*run, "--start", "-1s"]), samples)
    table.ran("the whole log", command(repeats, run), samples)
