# ruff: noqa: INP001  # a script, not a package
"""Generate the sample logs again, bit for bit: ``make sample-logs``.

Every number is a sum, product, quotient or square root of IEEE doubles, or a rounded random
number of a fixed seed, so processors and Python versions agree to the last bit; the containers
are written by the libraries pinned in .ci/constraints.txt. See quatprop/tools/simulation.py.
"""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from quatprop.tools.simulation import Gyroscope, Shape, simulate

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Sample:
    """One log: what `quatprop simulate` would be told."""

    log: str
    motion: str
    shape: Shape
    gyroscope: Gyroscope
    truth: str | None
    compression: str | None = None


TUMBLING = Shape(frequency=Fraction("0.4"), angle=Fraction(30), spin_frequency=Fraction("0.3"))
TEN_SECONDS = Gyroscope(sample_rate=Fraction(100), samples=1000)

SAMPLES = (
    Sample(
        "spin.csv",
        "spin",
        Shape(frequency=Fraction("0.25"), axis=(1.0, 2.0, 2.0)),
        TEN_SECONDS,
        "spin.truth.csv",
    ),
    Sample(
        "coning.mcap",
        "coning",
        Shape(frequency=Fraction(2), angle=Fraction(5)),
        TEN_SECONDS,
        "coning.truth.csv",
    ),
    Sample("tumbling.bag", "tumbling", TUMBLING, TEN_SECONDS, "tumbling.truth.csv", "lz4"),
    # The same recording in another container: one truth serves both.
    Sample("tumbling_ros2", "tumbling", TUMBLING, TEN_SECONDS, None),
    Sample(
        "rest.parquet",
        "rest",
        Shape(),
        Gyroscope(
            sample_rate=Fraction(100),
            samples=3000,
            noise=1e-4,
            bias=(0.001, -0.002, 0.0005),
            seed=1,
        ),
        "rest.truth.parquet",
    ),
)


def generate(folder: Path) -> None:
    """Write every sample log, and its truth, into a folder."""
    for sample in SAMPLES:
        target = folder / sample.log
        if target.is_dir():
            shutil.rmtree(target)
        simulate(
            target,
            sample.motion,
            sample.shape,
            sample.gyroscope,
            compression=sample.compression,
            truth=folder / sample.truth if sample.truth else None,
        )


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
