"""Samples that are missing in bursts too short to count as gaps."""

import re

import numpy as np
import pytest

import quatprop
from quatprop import GyroSeries

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")


def said_of(t_s, scale=1.0, **options):
    """Return what is said of missing samples of a body that is moved, at some times, s."""
    t_ns = 10**18 + np.rint(np.asarray(t_s) * 1e9).astype(np.int64)
    rate = scale * np.sin(np.asarray(t_s)[:, None] * [3.0, 4.1, 2.3] + np.arange(3))
    remarks = quatprop.propagate(GyroSeries(t_ns, rate), **options).report.remarks
    return [str(one) for one in remarks if one.code == "missing-samples"]


def times(hz, seconds, seed, lengths, between):
    """Return times of samples of which bursts are lost, s, and the number of the lost."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(hz * seconds) / hz + rng.normal(0, 0.02 / hz, hz * seconds)
    keep, at = np.ones(len(t_s), np.bool_), 40
    while at < len(t_s) - 60:
        count = rng.integers(*lengths)
        keep[at : at + count] = False
        at += count + rng.integers(*between)
    return t_s[keep], int((~keep).sum())


@pytest.mark.parametrize(
    ("hz", "seconds", "lengths", "between"),
    [(50, 60, (3, 9), (20, 80)), (100, 60, (8, 9), (20, 100)), (400, 40, (4, 7), (30, 60))],
)
@pytest.mark.parametrize("seed", range(4))
def test_bursts_of_missing_samples_are_counted(hz, seconds, lengths, between, seed):
    """Of a lossy network; the limit that is named counts them as gaps."""
    t_s, lost = times(hz, seconds, seed, lengths, between)
    (text,) = said_of(t_s)
    assert f"are missing: {lost} in " in text
    (limit,) = re.findall("max_gap='([0-9.]+)'", text)
    assert not said_of(t_s, max_gap=limit)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hz", [50, 100, 200, 400])
def test_logs_without_such_bursts_have_no_remark(hz, seed):
    """Single samples are lost, times are rounded or jitter, or the body is at rest."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(60 * hz) / hz
    assert not said_of(t_s)
    assert not said_of(t_s[rng.random(len(t_s)) > 0.1])
    assert not said_of(np.sort(t_s + rng.exponential(0.5 / hz, len(t_s))))
    assert not said_of(np.floor(t_s / 0.015625) * 0.015625)
    assert not said_of(np.cumsum(rng.uniform(0.5, 8, len(t_s))) / hz)
    assert not said_of(times(hz, 60, seed, (3, 9), (20, 80))[0], scale=1e-4)
    assert not said_of(times(hz, 60, seed, (3, 9), (2000, 2500))[0], scale=0.1)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("hz", "steps"), [(50, 6), (100, 9), (100, 8)])
def test_a_clock_that_is_set_by_less_than_a_gap_has_its_cost(hz, steps, seed):
    """As lost samples look the same; of a slow body nothing is said."""
    t_s = np.arange(60 * hz) / hz
    t_s[np.random.default_rng(seed).integers(hz, 59 * hz) :] += steps / hz
    (text,) = said_of(t_s, scale=2.0)
    assert f"are missing: {steps} in 1 place, " in text
    assert not said_of(t_s, scale=0.1)
