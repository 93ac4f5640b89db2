"""Samples of a damaged log that are neither read nor reported as lost."""

import io
import re
import struct
from functools import cache

from make import ulog
from mcap.reader import make_reader

from quatprop.base.errors import LogError, UsageError
from quatprop.readers.attitude_signals import choose_attitudes
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.signal import AttitudeSignal
from quatprop.settings.reading import AttitudeSelection, RateSelection

LENIENT = 2
"""Place of the propagation with lenient settings among the commands of a log."""

UNCOUNTED = (".csv", ".tsv", ".tum", ".jsonl", ".ulg", "bare.mcap")
"""Logs in which nothing says how many samples there are, so that one with fewer may be whole."""


def unexplained_loss(log, intact, codes):
    """Return which samples of a damaged log are lost without a word; None where none are.

    `intact`: folder with the logs that it was made of; `codes`: of the commands that it met
    """
    read = _read(log.path)
    if read is None:
        return None  # it is refused in a sentence
    count, losses, remarks = read
    if losses and codes[LENIENT] not in {2, 3}:
        return f"exit code {codes[LENIENT]} in spite of {losses}"
    if any(loss.messages is None for loss in losses):
        return None  # how many they are is not known
    held = _held(log.path, [intact / name for name in log.origins])
    lost = sum(loss.messages for loss in losses)
    if count + lost >= held or (count + lost == held - 1 and remarks):
        return None
    return f"of {held} samples {count} are read and {lost} reported as lost: {losses} {remarks}"


def _held(path, intact):
    """Return how many samples of some intact logs a damaged one still holds.

    Where nothing tells that a row or record is missing, they are those that are whole.
    """
    name = re.sub(r"\.(gz|zst|lz4|bz2)$", "", path.name)
    if not name.endswith(UNCOUNTED):
        return sum(map(_count, intact))
    if name != path.name:
        return 0  # a damaged stream is a loss of its own
    data = b"\n" + path.read_bytes()
    return sum(data.count(row) for row in set().union(*map(_rows, intact)))


def _rows(intact):
    """Return the bytes of the samples of a log; of lines with what comes before them."""
    data = intact.read_bytes()
    if intact.suffix == ".ulg":
        messages = ((begin, end) for kind, begin, end in ulog.walk(data) if kind == b"D")
        return {data[b - 3 : e] for b, e in messages if data[b : b + 2] == b"\1\0"}
    if intact.suffix == ".mcap":
        messages = (m for _, _, m in make_reader(io.BytesIO(data)).iter_messages())
        return {
            struct.pack("<BQHIQQ", 5, 22 + len(m.data), m.channel_id, m.sequence, m.log_time,
                        m.publish_time) + m.data for m in messages
        }  # fmt: skip
    lines = data.splitlines(keepends=True)[-_count(intact) * (1 + (intact.suffix == ".tsv")) :]
    if intact.suffix == ".tsv":
        lines = [first + second for first, second in zip(*2 * [iter(lines)], strict=True)]
    return {b"\n" + line for line in lines}


@cache
def _count(intact):
    return _read(intact)[0]


def _read(path):
    """Return the number of samples, the losses and the remarks; None where it is refused."""
    for choose, selection in (
        (choose_rates, RateSelection()),
        (choose_attitudes, AttitudeSelection()),
    ):
        try:
            with open_log(path) as log:
                signal = choose(log, selection)
                if isinstance(signal, AttitudeSignal):
                    count = sum(len(t_ns) for t_ns, *_ in signal.rows())
                else:
                    count = sum(len(batch.t_ns) for batch in signal.batches())
                if count:
                    return count, list(log.losses), list(log.remarks)
        except (LogError, UsageError):
            continue
    return None
