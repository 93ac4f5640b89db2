"""The noise that is stated of simulated gyroscopes; memory for a long log."""

import sys
from subprocess import run as run_process

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from make.gyro_noise import HZ, models, rates
from scipy.special import chdtri, ndtri

from quatprop.sensor_noise.allan import AllanSums
from quatprop.sensor_noise.covariance import covariances
from quatprop.sensor_noise.fit import fit
from quatprop.sensor_noise.result import terms_of

SAMPLES, LOGS = 1 << 15, 16
NAMES = {
    "Q": "quantisation", "N": "angle_random_walk", "B": "bias_instability", "K": "rate_random_walk",
}  # fmt: skip
COMPARISONS = 2 * len(NAMES)


MEASURED = """
import sys, quatprop
density = quatprop.noise(sys.argv[1]).combined.angle_random_walk
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(density.value, density.sigma, status["VmHWM"].split()[0])
"""
"""Prints what is stated, and the most memory, kB."""


class Errors:
    """What is stated, by what is true: for each term the errors in standard deviations.

    Of logarithms: the relative standard deviation of a variance does not depend on its value.
    """

    def __init__(self):
        self.parts = {name: [] for name in NAMES}
        self.bounds = []

    def add(self, terms, truth):
        """Add what is stated of one axis."""
        for short, name in NAMES.items():
            term, true = getattr(terms, name), getattr(truth, short)
            if term.value is not None and true:
                self.parts[short].append((np.log(term.value / true), term.relative))
            elif term.at_most is not None:
                self.bounds.append(true <= term.at_most)

    def faults(self, fault=1.0):
        """Return the terms whose errors, or whose mean error, are outside the 99.9 % band.

        `fault`: what is stated is multiplied by it
        """
        tail = 0.001 / 2 / COMPARISONS
        found = set()
        for name, pairs in self.parts.items():
            logs, sigmas = np.array(pairs).T
            z = (logs + np.log(fault)) / sigmas
            low, high = chdtri(len(z), [1 - tail, tail])
            if not low < (z**2).sum() < high or abs(z.sum()) > -ndtri(tail) * np.sqrt(len(z)):
                found.add(name)
        return found


def test_standard_deviations_and_values_hold():
    """Ten gyroscopes, 48 axes each: errors are as large as stated, and together below 5 %.

    Values that are 5 % off do not pass.
    """
    random = np.random.default_rng(7)
    errors, known = Errors(), covariances(1 << np.arange(14), [SAMPLES])
    for truth in models():
        together = AllanSums()
        for _ in range(LOGS):
            rate, alone = rates(truth, SAMPLES, random), AllanSums()
            together.begin_piece()
            for sums in (alone, together):
                sums.add(rate)
            m, variances = alone.variances()
            for axis in variances.T:
                if (found := fit(axis, known)) is not None:
                    errors.add(terms_of([found], 1 / HZ, m / HZ), truth)
        m, variances = together.variances()
        pieces = covariances(m, together.lengths)
        combined = terms_of([fit(axis, pieces) for axis in variances.T], 1 / HZ, m / HZ)
        for short, name in NAMES.items():
            if true := getattr(truth, short):
                term = getattr(combined, name)
                assert term.value == pytest.approx(true, rel=0.05), (truth, name)
                assert term.relative < 0.03, (truth, name)
    assert errors.faults() == set()
    assert errors.faults(1.05) == errors.faults(0.95) == {*NAMES}
    assert np.mean(errors.bounds) >= 0.95


def test_ten_million_samples(tmp_path):
    """In less than 300 MB."""
    random, path = np.random.default_rng(8), tmp_path / "long.parquet"
    samples = 10_000_000
    t_ns = np.arange(samples) * 5_000_000
    axes = {name: 1e-3 * random.standard_normal(samples) for name in ("wx", "wy", "wz")}
    # Nothing repeats itself: to look for that takes twice as long as to write it.
    plain = {"use_dictionary": False, "compression": "none"}
    pq.write_table(pa.table({"t_ns": t_ns, **axes}), path, **plain)
    done = run_process([sys.executable, "-c", MEASURED, path], check=True, capture_output=True)
    *_, facts = done.stdout.decode().splitlines()
    value, sigma, memory_kb = map(float, facts.split())
    assert abs(value - 1e-3 / np.sqrt(200)) < 4 * sigma
    assert memory_kb < 300 * 1024
