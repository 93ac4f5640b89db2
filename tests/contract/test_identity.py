"""Results are the same to the byte, however many threads there are and however a log is cut up."""

import os
from functools import partial

import pyarrow as pa
import pytest
from make.commands import installed
from make.formats import FORMATS, PACK, samples

from quatprop.base import threads
from quatprop.propagation.job import Job, run
from quatprop.propagation.settings import OutputSettings, PropagationSettings
from quatprop.readers.containers import db3, mcap_scan, parts, rosbag1_rebuild, topic_table, ulog
from quatprop.readers.containers import mcap_records as mcap_chunks
from quatprop.readers.tables import arrow, csv, jsonl, numpy_table, text_rows
from quatprop.settings.bias import GivenBias
from quatprop.settings.reading import GyroCorrection

TURNED = "0.8,0.36,-0.48,0"
OUTPUTS = ("csv", "parquet", "feather", "mcap", "bag", "npy", "npz", "jsonl", "tum")


@pytest.fixture(scope="module")
def long_log(tmp_path_factory):
    """Return a log with more samples than any writer puts into a block."""
    log = tmp_path_factory.mktemp("long") / "log.parquet"
    FORMATS["plain.parquet"].write(log, samples(70_000))
    return log


def result(log, target):
    """Return the bytes of the attitudes of a log."""
    tilted = GyroCorrection(bias=GivenBias((1e-3, -2e-3, 3e-3)), mount=TURNED)
    settings = PropagationSettings(method="coning", correction=tilted)
    run(Job(str(log), OutputSettings(str(target)), settings))
    content = target.read_bytes()
    target.unlink()
    return content


SMALL = {
    (csv, "record_blocks"): partial(text_rows.record_blocks, size=1 << 12),
    (jsonl, "record_blocks"): partial(text_rows.record_blocks, size=1 << 12),
    (arrow, "BATCH_ROWS"): 99,
    (numpy_table, "BATCH_ROWS"): 99,
    (topic_table, "ENOUGH_MESSAGES"): 10,
    (db3, "FETCHES"): 1,
    (ulog, "BLOCK"): 51,
    (mcap_chunks, "_AT_ONCE"): 200,
    (mcap_scan, "_LOOSE_SIZE"): 5000,
    (rosbag1_rebuild, "_LOOSE_SIZE"): 5000,
    (parts, "GROUP"): 1,
}
"""Settings of how much is read at a time."""


@pytest.mark.parametrize("name", [name for name in FORMATS if not name.endswith(tuple(PACK))])
def test_what_is_read_at_a_time_changes_nothing(tmp_path, monkeypatch, name):
    """Threads and sizes of batches leave every byte of the result as it is."""
    log, target = tmp_path / name, tmp_path / "out.parquet"
    FORMATS[name].write(log, FORMATS[name].holds(samples(600)))
    monkeypatch.setattr(threads, "available_cores", lambda: 1)
    usual = result(log, target)
    for (module, setting), value in SMALL.items():
        monkeypatch.setattr(module, setting, value)
    for cores in (1, 8):
        monkeypatch.setattr(threads, "available_cores", lambda cores=cores: cores)
        before = pa.cpu_count()
        pa.set_cpu_count(cores)
        try:
            assert result(log, target) == usual, cores
        finally:
            pa.set_cpu_count(before)


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_batches_change_no_output(long_log, tmp_path, monkeypatch, suffix):
    """Every format is written in pieces of its own, not in those that come."""
    target = tmp_path / f"out.{suffix}"
    usual = result(long_log, target)
    monkeypatch.setattr(arrow, "BATCH_ROWS", 7777)
    assert result(long_log, target) == usual


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no way to take a core away")
def test_one_core_and_two_give_the_same_file(long_log, tmp_path):
    """The installed command writes the same bytes, whatever the libraries do with the cores."""
    files, target = [], tmp_path / "out.parquet"
    for cores in (1, 2):
        some = sorted(os.sched_getaffinity(0))[:cores]
        done = installed(
            "propagate", long_log, "-o", target, "--mount", TURNED,
            env={"OMP_NUM_THREADS": str(cores)},
            preexec_fn=partial(os.sched_setaffinity, 0, some),
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        files.append(target.read_bytes())
        target.unlink()
    assert files[0] == files[1]
