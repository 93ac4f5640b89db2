"""Samples of a damaged log that are neither read nor reported as lost."""

import re
from functools import cache

from quatprop.errors import LogError, UsageError
from quatprop.formats import open_log
from quatprop.selection import AttitudeSelection, RateSelection
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.rates import choose_rates
from quatprop.signals.signal import AttitudeSignal

LENIENT = 2
"""Place of the propagation with lenient settings among the commands of a log."""

TEXTS = (".csv", ".tsv", ".tum", ".jsonl")


def unexplained_loss(log, intact, codes):
    """Return which samples of a damaged log are lost without a word; None where none are.

    Parameters
    ----------
    log
        The damaged log.
    intact
        The folder with the logs that it was made of.
    codes
        Exit codes of the commands that it met.
    """
    read = _read(log.path)
    if read is None:
        return None  # it is refused in a sentence
    count, losses, remarks = read
    if losses and codes[LENIENT] not in {2, 3}:
        return f"exit code {codes[LENIENT]} in spite of {losses}"
    if any(loss.messages is None for loss in losses):
        return None  # how many they are is not known
    held = sum(_held(log.path, intact / name) for name in log.origins)
    lost = sum(loss.messages for loss in losses)
    if count + lost >= held or (count + lost == held - 1 and remarks):
        return None
    return f"of {held} samples {count} are read and {lost} reported as lost: {losses} {remarks}"


def _held(path, intact):
    """Return how many samples of an intact log a damaged one still holds.

    In texts, where nothing tells that a row is missing, they are the rows that are whole.
    """
    name = re.sub(r"\.(gz|zst|lz4|bz2)$", "", path.name)
    if not name.endswith(TEXTS):
        return _count(intact)
    if name != path.name:
        return 0  # a damaged stream is a loss of its own
    text, rows = b"\n" + path.read_bytes(), intact.read_bytes()
    lines = rows.splitlines(keepends=True)[-_count(intact) :]
    if name.endswith(".tsv"):
        lines = [first + second for first, second in zip(*2 * [iter(lines)], strict=True)]
    return sum(b"\n" + line in text for line in lines)


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
