"""Speed side by side, in one run: quatprop against what users would take instead.

Run as ``make bench``. Times are of this machine; the ratios are the point. Logs of one million
messages are simulated once into ``.bench/``.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import accuracy
import commands
import decode
import mixed_logs
import product
import table_logs
import writers

PARTS = {
    "decode": decode,
    "product": product,
    "accuracy": accuracy,
    "writers": writers,
    "commands": commands,
    "tables": table_logs,
}
SOURCES = {
    "imu_zstd.mcap": ("--to", "mcap", "--compression", "zstd"),
    "imu_none.mcap": ("--to", "mcap", "--compression", "none"),
    "imu.bag": ("--to", "bag"),
    "imu_bz2.bag": ("--to", "bag", "--compression", "bz2"),
    "imu_lz4.bag": ("--to", "bag", "--compression", "lz4"),
    "imu_db3": ("--to", "rosbag2"),
    "imu.csv": ("--to", "csv"),
    "imu.parquet": ("--to", "parquet"),
    "imu.feather": ("--to", "feather"),
    "imu.jsonl": ("--to", "jsonl"),
}
MIXED = {
    "frames_zstd.mcap": (mixed_logs.varying_frames, 1),
    "images_zstd.mcap": (mixed_logs.with_images, 10),
    "images_none.mcap": (mixed_logs.with_images, 10),
    "odometry.mcap": (mixed_logs.odometry, 10),
    "imu.h5": (table_logs.as_hdf5, 1),
}
"""How each is written, and which part of the samples it has: pictures take room, Protobuf time."""


def make_logs(folder: Path, samples: int) -> None:
    """Simulate the logs that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, options in SOURCES.items():
        if not (folder / name).exists():
            print(f"making {folder / name}", flush=True)
            command = [sys.executable, "-m", "quatprop", "simulate", folder / name, "--motion",
                       "coning", "--noise", "1e-3", "--rate", "1000", "--samples", str(samples),
                       "--seed", "1", *options]  # fmt: skip
            subprocess.run(command, check=True)
    for name, (write, part) in MIXED.items():
        if not (folder / name).exists():
            print(f"making {folder / name}", flush=True)
            write(folder / name, samples // part)


def main() -> None:
    """Measure everything, or the parts that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", action="append", choices=list(PARTS), help="default: all")
    parser.add_argument("--samples", type=int, default=1_000_000)
    chosen = parser.parse_args()
    folder = Path(".bench") / str(chosen.samples)
    make_logs(folder, chosen.samples)
    for name in chosen.part or PARTS:
        PARTS[name].measure(folder, chosen.samples)


if __name__ == "__main__":
    main()
