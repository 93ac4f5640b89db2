"""Results are the same to the byte, however many threads there are and however a log is cut up."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from make.ulog import added, gyro, write
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from pyarrow import feather, parquet

from quatprop.concurrency import threads
from quatprop.conditioning import GyroCorrection
from quatprop.containers import first_blocks, ulog
from quatprop.containers.mcap import scan as mcap_scan
from quatprop.containers.rosbag1 import rebuild as rosbag1_rebuild
from quatprop.containers.rosbag2 import fetches
from quatprop.logs.open_log import open_log as opened
from quatprop.logs.signals.rates import choose_rates
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings, PropagationSettings
from quatprop.settings.selection import RateSelection
from quatprop.simulate.gyroscope import Gyroscope
from quatprop.simulate.motion import Shape
from quatprop.simulate.simulate import simulate
from quatprop.tables import arrow, jsonl, numpy_table, text_stream
from quatprop.tables.csv import log as csv

QUATPROP = Path(sys.executable).with_name("quatprop")
SAMPLES = 70_000
"""More than any reader gives at a time."""

LOGS = {"log.csv": "csv", "log.mcap": "mcap", "log.bag": "bag", "log_ros2": "rosbag2",
        "log.parquet": "parquet"}  # fmt: skip
TABLES = ("log.feather", "log.npy", "log.npz", "log.jsonl")
OUTPUTS = ("csv", "parquet", "feather", "mcap", "bag", "npy", "jsonl")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return a folder with a log of every kind."""
    folder = tmp_path_factory.mktemp("logs")
    for name, kind in LOGS.items():
        gyroscope = Gyroscope(200, SAMPLES, noise=1e-3)
        simulate(folder / name, "coning", Shape(), gyroscope, kind=kind, truth=None)
    table = parquet.read_table(folder / "log.parquet")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    feather.write_feather(table, folder / "log.feather", chunksize=20_000)
    records = np.asarray(np.rec.fromarrays(list(columns.values()), names=list(columns)))
    np.save(folder / "log.npy", records)
    np.savez(folder / "log.npz", **columns)
    table.to_pandas().to_json(
        folder / "log.jsonl", orient="records", lines=True, double_precision=15
    )
    stamps = (5_000 * np.arange(1, SAMPLES + 1)).tolist()
    write(folder / "log.ulg", added("sensor_gyro", 0, 1), *gyro(1, stamps, 1e-6))
    return folder


def result(log, target):
    """Return the bytes of the attitudes of a log."""
    tilted = GyroCorrection(bias=(1e-3, -2e-3, 3e-3), mount="0.8,0.36,-0.48,0")
    settings = PropagationSettings(method="coning", conditioning=tilted)
    run(Job(str(log), OutputSettings(str(target)), settings))
    content = target.read_bytes()
    target.unlink()
    return content


CUTS = {
    "2 threads": {(threads, "available_cores"): lambda: 2},
    "3 threads": {(threads, "available_cores"): lambda: 3},
    "8 threads": {(threads, "available_cores"): lambda: 8},
    "no threads": {(threads, "available_cores"): lambda: 1},
    "small": {
        (threads, "available_cores"): lambda: 2,
        (csv, "record_blocks"): partial(text_stream.record_blocks, size=1 << 12),
        (jsonl, "record_blocks"): partial(text_stream.record_blocks, size=1 << 12),
        (arrow, "BATCH_ROWS"): 999,
        (numpy_table, "BATCH_ROWS"): 999,
        (first_blocks, "ENOUGH_MESSAGES"): 10,
        (fetches, "FETCHES"): 1,
        (ulog, "BLOCK"): 501,
        (mcap_scan, "_LOOSE_SIZE"): 5000,
        (rosbag1_rebuild, "_LOOSE_SIZE"): 5000,
    },
    "large": {
        (csv, "record_blocks"): partial(text_stream.record_blocks, size=1 << 26),
        (jsonl, "record_blocks"): partial(text_stream.record_blocks, size=1 << 26),
        (arrow, "BATCH_ROWS"): 1 << 22,
        (numpy_table, "BATCH_ROWS"): 1 << 22,
        (first_blocks, "ENOUGH_MESSAGES"): 1 << 20,
        (fetches, "FETCHES"): 1 << 10,
        (ulog, "BLOCK"): 1 << 20,
        (mcap_scan, "_LOOSE_SIZE"): 1 << 28,
    },
}
"""What decides how much is read at a time, and by how many."""


@pytest.mark.parametrize("name", [*LOGS, *TABLES, "log.ulg"])
def test_what_is_read_at_a_time_changes_nothing(logs, tmp_path, monkeypatch, name):
    """Threads and sizes of batches leave every byte of the result as it is."""
    target = tmp_path / "out.parquet"
    usual = result(logs / name, target)
    for cut, settings in CUTS.items():
        with monkeypatch.context() as patched:
            for (module, setting), value in settings.items():
                assert hasattr(module, setting), (module, setting)
                patched.setattr(module, setting, value)
            cores = pa.cpu_count()
            pa.set_cpu_count(1 if cut == "no threads" else 2)
            try:
                assert result(logs / name, target) == usual, cut
            finally:
                pa.set_cpu_count(cores)


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_batches_change_no_output(logs, tmp_path, monkeypatch, suffix):
    """Every format is written in pieces of its own, not in those that come."""
    target = tmp_path / f"out.{suffix}"
    usual = result(logs / "log.parquet", target)
    for rows in (777, 1 << 22):
        monkeypatch.setattr(arrow, "BATCH_ROWS", rows)
        assert result(logs / "log.parquet", target) == usual


@pytest.mark.parametrize("name", ["log.csv", "log.mcap", "log.parquet"])
def test_one_thread_and_two_give_the_same_file(logs, tmp_path, name):
    """The installed command writes the same bytes on one core and on two."""
    files = []
    for cores in (1, 2):
        target = tmp_path / "out.parquet"
        subprocess.run(
            [QUATPROP, "propagate", logs / name, "-o", target, "--mount", "0.8,0.36,-0.48,0"],
            env={**os.environ, "OMP_NUM_THREADS": str(cores)},
            check=True,
            capture_output=True,
            preexec_fn=_on(cores),
        )
        files.append(target.read_bytes())
        target.unlink()
    assert files[0] == files[1]


def _on(cores):
    """Return what confines a process to so many cores, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        return None
    some = sorted(os.sched_getaffinity(0))[:cores]
    return partial(os.sched_setaffinity, 0, some)


@pytest.mark.parametrize("size", [1000, 100_000, 1 << 30, None])
def test_the_chunks_of_a_log_change_nothing(tmp_path, size):
    """The same messages give the same attitudes, in whatever chunks they were recorded."""
    usual, log = tmp_path / "log.mcap", tmp_path / "other.mcap"
    simulate(usual, "coning", Shape(), Gyroscope(200, 20_000, noise=1e-3), truth=None)
    with usual.open("rb") as source, log.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=size or 1,
            use_chunking=size is not None,
            compression=CompressionType.LZ4,
        )
        writer.start("ros2")
        ids = None
        for schema, channel, message in make_reader(source).iter_messages():
            if ids is None:
                one = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids = writer.register_channel(channel.topic, channel.message_encoding, one)
            writer.add_message(ids, message.log_time, message.data, message.publish_time)
        writer.finish()
    found, expected = (result(one, tmp_path / "out.csv") for one in (log, usual))
    assert found == expected
    with opened(log) as same:
        assert sum(len(batch) for batch in choose_rates(same, RateSelection()).batches()) == 20_000
