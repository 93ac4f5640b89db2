"""Speed side by side, in one run: quatprop against what users would take instead.

Run as ``make bench``. Times are of this machine; the ratios are the point. Logs of one million
messages are simulated once into ``.bench/``.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import decode
import product
import whole

FOLDER = Path(".bench")
SAMPLES = 1_000_000
SOURCES = {
    "imu_zstd.mcap": ("--to", "mcap", "--compression", "zstd"),
    "imu_none.mcap": ("--to", "mcap", "--compression", "none"),
    "imu.bag": ("--to", "bag"),
    "imu_db3": ("--to", "rosbag2"),
}


def make_logs(samples: int) -> None:
    """Simulate the logs that are not there yet."""
    FOLDER.mkdir(exist_ok=True)
    for name, options in SOURCES.items():
        if not (FOLDER / name).exists():
            print(f"making {FOLDER / name}", flush=True)
            command = [sys.executable, "-m", "quatprop", "simulate", FOLDER / name, "--motion",
                       "coning", "--noise", "1e-3", "--rate", "1000", "--samples", str(samples),
                       "--seed", "1", *options]  # fmt: skip
            subprocess.run(command, check=True)


def main() -> None:
    """Measure everything, or the parts that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=["decode", "product", "whole"], default=[])
    parser.add_argument("--samples", type=int, default=SAMPLES)
    chosen = parser.parse_args()
    parts = chosen.parts or ["decode", "product", "whole"]
    if {"decode", "whole"} & set(parts):
        make_logs(chosen.samples)
    for name, part in (("decode", decode), ("product", product), ("whole", whole)):
        if name in parts:
            part.measure(FOLDER, chosen.samples)


if __name__ == "__main__":
    main()
