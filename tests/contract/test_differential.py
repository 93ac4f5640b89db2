"""Odd but valid logs, sample for sample against other readers: what differs must be a loss.

Each case is a seed. Its generator draws the oddities, writes the log with the format's own library,
and returns the path, the settings, and the samples that an independent reader finds in the file.
"""

import os
import random

import numpy as np
import pytest
from make.odd_messages import MESSAGE_LOGS
from make.odd_tables import TABLE_LOGS

from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection

COUNTS = {"mcap": 24, "bag": 12, "rosbag2": 10, "csv": 30, "arrow": 20, "numpy": 10, "jsonl": 16}
TIMES = int(os.environ.get("ODD_LOGS", "1"))
"""How many times as many logs of each kind are read; `make thorough` reads ten times as many."""

GENERATORS = {**MESSAGE_LOGS, **TABLE_LOGS}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "seed"),
    [(kind, seed) for kind, count in COUNTS.items() for seed in range(count * TIMES)],
)
def test_samples_are_those_of_another_reader(tmp_path, kind, seed):
    """Count, stamps and rates are the same, or the rows that differ are reported as lost."""
    rng = random.Random(f"{kind} {seed}")
    path, settings, expected, is_ordered = GENERATORS[kind](rng, tmp_path)
    # Frames and publishers of the messages are drawn, too.
    settings |= {"series": "all"} if kind in MESSAGE_LOGS else {}
    with open_log(path) as log:
        batches = list(choose_rates(log, RateSelection(**settings)).batches())
        lost = sum(loss.messages or 0 for loss in log.losses)
    read = [
        (t_ns, tuple(rate))
        for batch in batches
        for t_ns, rate in zip(batch.t_ns.tolist(), batch.rate.tolist(), strict=True)
    ]
    assert len(read) + lost == len(expected), log.losses
    if not is_ordered:
        read, expected = sorted(read), sorted(expected)
    if lost:
        assert set(read) <= set(expected)
    else:
        assert [t_ns for t_ns, _ in read] == [t_ns for t_ns, _ in expected]
        np.testing.assert_array_equal([r for _, r in read], [r for _, r in expected])
