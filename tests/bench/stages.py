"""The stages of one run, each by itself on one thread, against reading and unpacking alone."""

import tempfile
from collections import deque
from pathlib import Path

from decode import ours, read_and_decompress
from table import Table, best_of

from quatprop.concurrency.threads import use_threads
from quatprop.kinematics.propagate import Propagation
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.pipeline.rate_checks import RateChecks
from quatprop.provenance import digest_of
from quatprop.series import AttitudeSeries
from quatprop.settings.selection import RateSelection
from quatprop.timeline import Timeline
from quatprop.timeline.counts import Policy
from quatprop.writers import open_writer


def measure(folder: Path, samples: int) -> None:
    """Print one table of stages."""
    log = folder / "imu_zstd.mcap"
    with use_threads(1), open_log(log) as opened, tempfile.TemporaryDirectory() as scratch:
        batches = list(choose_rates(opened, RateSelection()).batches())
        blocks = list(Timeline(Policy(), log).apply(batches))
        attitudes = [series for _, series in propagation().run(blocks)]
        table = Table(f"stages of a run on {log.name}, one thread")
        for name, work in {
            "read, unpack and decode": lambda: ours(log),
            "  reading and unpacking alone": lambda: read_and_decompress(log),
            "plausibility checks": lambda: drain(RateChecks().observe(batches)),
            "timestamps": lambda: drain(Timeline(Policy(), log).apply(batches)),
            "increments and product": lambda: drain(propagation().run(blocks)),
            "Parquet": lambda: write(Path(scratch) / "a.parquet", attitudes),
            "CSV": lambda: write(Path(scratch) / "a.csv", attitudes),
            "SHA-256 of the log": lambda: digest_of(log),
        }.items():
            table.row(name, best_of(3, work), samples)


def propagation() -> Propagation:
    """Return what propagates, from the identity."""
    return Propagation([1, 0, 0, 0], "start", "body")


def drain(items: object) -> None:
    """Take all items and keep none."""
    deque(items, maxlen=0)


def write(path: Path, attitudes: list[AttitudeSeries]) -> None:
    """Write a file of attitudes."""
    with open_writer(path) as writer:
        for series in attitudes:
            writer.write(series)
        writer.commit({})
