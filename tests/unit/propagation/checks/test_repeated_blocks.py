"""Rows that are copies of others are found by their noise; motions that return are none."""

import re

import numpy as np
import pytest
from fuzz.remarks import well_log

from quatprop.propagation.checks.repeated_blocks import RepeatedBlocks
from quatprop.propagation.checks.samples import Samples

COUNT = 40_000
T_S = np.arange(COUNT) / 100
SMOOTH = 2 * np.sin(T_S[:, None] * [1.9, 2.3, 1.3] + [0, 1, 2])
"""Rates of a motion without noise, rad/s."""
NOISE = np.random.default_rng(7).normal(0, 0.01, (COUNT, 3))


def said(rate):
    """Return the remarks on rates."""
    found, t_ns = RepeatedBlocks(), np.arange(len(rate)) * 10_000_000
    for begin in range(0, len(rate), 16_384):
        part = slice(begin, begin + 16_384)
        found.add(Samples(np.ascontiguousarray(rate[part].T), t_ns[part]))
    return [str(one) for one in found.remarks()]


@pytest.mark.parametrize("begin", [1000, 16_200, 16_384, 30_000])
@pytest.mark.parametrize("lag", [600, 5000])
@pytest.mark.parametrize("step", [0, 1e-3, 5e-3])
def test_a_block_of_rows_that_is_repeated_is_found(begin, lag, step):
    """The times go on; its place is that of the copy."""
    rate = SMOOTH + NOISE
    rate = np.rint(rate / step) * step if step else rate
    rate[begin + lag : begin + lag + 500] = rate[begin : begin + 500]
    (one,) = said(rate)
    rows, copy, origin = map(int, re.findall(r"(\d+) (?:rows|ns)", one))
    assert copy - origin == lag * 10_000_000
    assert begin - 1 <= origin / 1e7 <= begin + 250
    assert 250 <= rows <= 502
    assert ", with their noise: were they recorded twice, " in one


@pytest.mark.parametrize("step", [0, 1e-3])
def test_packets_that_are_sent_again_are_counted(step):
    """One of ten packets replaces that behind it; a part of them is seen."""
    rate = SMOOTH + NOISE
    rate = np.rint(rate / step) * step if step else rate
    packets = rate.reshape(-1, 20, 3)
    packets[5::10] = packets[4::10]
    (one,) = said(packets.reshape(-1, 3))
    assert 20 <= int(re.search(r"the longest of (\d+) times", one)[1]) <= 200


def test_windows_that_overlap_are_found():
    """Each row is in two of them."""
    rate = SMOOTH + NOISE
    windows = np.concatenate([rate[k : k + 128] for k in range(0, 10_000, 64)])
    assert said(windows)[0].startswith("64 rows from t = ")


HEALTHY = {
    "a motion without noise": SMOOTH,
    "one that returns, in steps": np.rint(np.tile(SMOOTH[:400], (100, 1)) / 0.01) * 0.01,
    "a vibration that returns": np.tile(NOISE[:50], (800, 1)),
    "rest": NOISE * 0,
    "rest in coarse steps": np.rint(NOISE / 0.01) * 0.01,
    "rest in coarser steps": np.rint(NOISE / 0.03) * 0.03,
    "noise about one axis": NOISE * [0, 0, 1],
    "every fourth sample is new": np.repeat(SMOOTH[::4] + NOISE[::4], 4, axis=0),
    "damaged": np.where(np.random.default_rng(2).random((COUNT, 3)) < 0.1, np.nan, SMOOTH),
    "short": NOISE[:3],
    "no sample": NOISE[:0],
}


@pytest.mark.parametrize("what", HEALTHY)
def test_healthy_rates_have_no_copy(what):
    """Coarse sensors repeat rows, and motions return."""
    assert said(HEALTHY[what]) == []


def test_no_healthy_log_of_many_kinds_has_one():
    """Motions, rates, steps and noise at random."""
    assert not [how for seed in range(300) for log, how in [well_log(seed)] if said(log.rate)]


def test_all_of_a_long_copy_is_found():
    """Of many pairs of rows none was looked at, and a part at the end was named."""
    rate = SMOOTH + NOISE
    rate[16_384 : 16_384 + 14_000] = rate[1000:15_000]
    (one,) = said(rate)
    rows, copy, origin = map(int, re.findall(r"(\d+) (?:rows|ns)", one))
    assert copy - origin == 15_384 * 10_000_000
    assert rows > 13_500
