"""Attitudes to files: the whole writers against the libraries' own on what is ready."""

import tempfile
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from mcap.writer import Writer
from table import Table, median_of

from quatprop.kinematics.series import AttitudeSeries
from quatprop.writers import attitude_encoder, open_writer
from quatprop.writers.formats import Message

BATCH = 1 << 16
NUMBERS = count()

SLOW_SAMPLES = 100_000
"""The library's MCAP writer is timed on so many messages."""


def attitudes(samples: int) -> AttitudeSeries:
    """Return a smooth tumble with noise in its last bits, at 1 kHz."""
    t_ns = 1_700_000_000_000_000_000 + np.arange(samples, dtype=np.int64) * 1_000_000
    phase = np.arange(samples) * 1e-3
    noise = np.random.default_rng(1).normal(0.0, 1e-4, (samples, 4))
    wxyz = np.stack([np.cos(phase), np.sin(phase), np.cos(3 * phase), np.sin(2 * phase)], axis=1)
    wxyz += noise
    return AttitudeSeries(t_ns, wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True))


def fresh(folder: Path, suffix: str) -> Path:
    """Return the path of a file that is not there: to replace a large one takes its time, too."""
    return folder / f"{next(NUMBERS)}{suffix}"


def ours(series: AttitudeSeries, path: Path, message: Message | None = None) -> None:
    """Write batch after batch, as propagating does."""
    with open_writer(path, message=message) as writer:
        for begin in range(0, len(series), BATCH):
            rows = slice(begin, begin + BATCH)
            writer.write(AttitudeSeries(series.t_ns[rows], series.wxyz[rows]))
        writer.commit({})


def with_mcap(
    path: Path, stamps: list[int], messages: list[bytes], schema: tuple[str, ...]
) -> None:
    """Write messages that are encoded already, one after the other."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channel = writer.register_channel("/attitude", "cdr", writer.register_schema(*schema))
        for k, (stamp, data) in enumerate(zip(stamps, messages, strict=True)):
            writer.add_message(channel, stamp, data, stamp, k)
        writer.finish()


def measure(_folder: Path, samples: int) -> None:
    """Print one table a format."""
    series = attitudes(samples)
    columns = [series.t_ns, *(np.ascontiguousarray(column) for column in series.wxyz.T)]
    ready = pa.table([pa.array(column) for column in columns], ["t_ns", "qw", "qx", "qy", "qz"])
    plain = {"compression": "zstd", "use_dictionary": False}
    to_parquet = pyarrow.parquet.write_table
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        _mcap(out, series)
        for suffix, peers in {
            ".csv": {"write_csv, columns ready": partial(pyarrow.csv.write_csv, ready)},
            ".parquet": {
                "write_table, as it comes": partial(to_parquet, ready),
                "write_table, zstd, no dictionary": partial(to_parquet, ready, **plain),
            },
        }.items():
            table = Table(f"attitudes to {suffix}, {samples:,} rows")
            for name, write in {"quatprop": partial(ours, series), **peers}.items():
                seconds = median_of(5, lambda write=write, end=suffix: write(fresh(out, end)))
                table.row(name, seconds, samples)


def _mcap(out: Path, series: AttitudeSeries) -> None:
    table = Table(f"attitudes to MCAP, {len(series):,} messages, zstd")
    for name in ("QuaternionStamped", "FrameTransform"):
        write = partial(ours, series, message=Message(name))
        seconds = median_of(5, lambda write=write: write(fresh(out, ".mcap")))
        table.row(f"quatprop, {name}", seconds, len(series))
    few = AttitudeSeries(series.t_ns[:SLOW_SAMPLES], series.wxyz[:SLOW_SAMPLES])
    encoder = attitude_encoder(Message(), ("cdr",))
    messages = [row.tobytes() for row in encoder.encode(few, out)]
    stamps = few.t_ns.tolist()
    topic = encoder.topic
    schema = (topic.type_name, topic.schema_encoding, topic.schema)
    seconds = median_of(3, lambda: with_mcap(fresh(out, ".mcap"), stamps, messages, schema))
    table.row("mcap Writer, messages ready", seconds, len(few))
