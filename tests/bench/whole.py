"""The whole command against the script that a user would write."""

import subprocess
import sys
import tempfile
from pathlib import Path

from table import Table, best_of

SCRIPT = Path(__file__).with_name("user_script.py")


def measure(folder: Path, samples: int) -> None:
    """Print one table a log, and one for a short log and for start-up."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        for name in ("imu_zstd.mcap", "imu.bag"):
            log = folder / name
            table = Table(f"the whole command on {name}, {samples:,} samples")
            for suffix in (".parquet", ".csv"):
                command = [sys.executable, "-m", "quatprop", "propagate", "-q", log,
                           "-o", out / f"a{suffix}"]  # fmt: skip
                seconds = best_of(3, lambda command=command: subprocess.run(command, check=True))
                table.row(f"quatprop propagate to {suffix}", seconds, samples)
            if name == "imu_zstd.mcap":
                command = [sys.executable, SCRIPT, log, out / "b.csv"]
                seconds = best_of(1, lambda command=command: subprocess.run(command, check=True))
                table.row("rosbags + scipy script to .csv", seconds, samples)
    print("\nstart-up, seconds")
    for name, command in {
        "python -c 'import click'": [sys.executable, "-c", "import click"],
        "quatprop --help": [Path(sys.executable).with_name("quatprop"), "--help"],
    }.items():
        seconds = best_of(
            10, lambda command=command: subprocess.run(command, check=True, capture_output=True)
        )
        print(f"  {name:42s} {seconds:10.3f}")
