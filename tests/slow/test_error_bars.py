"""Stated errors are true: over many draws of noise, they are as large as stated."""

import os

import numpy as np
import pytest
from fuzz.calibrations import MOTIONS, judged, pair
from make.calibrations import MODELS, Ensemble, ensemble
from make.gyro_noise import HZ, models, rates
from make.rigs import DEG, FAULTS, GYRO, MOCAP, crosscheck, rig, with_values
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, ndtri

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.comparison.comparison import compare
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.settings.command_options import comparison_settings
from quatprop.tools.allan import AllanSums, covariances, fit
from quatprop.tools.sensor_noise import terms_of

RUNS = int(os.environ.get("CALIBRATIONS", "30"))
"""Calibrations of each model; `make thorough` makes 400."""

SAMPLES, LOGS = 1 << 15, 16
NAMES = {
    "Q": "quantisation", "N": "angle_random_walk", "B": "bias_instability", "K": "rate_random_walk",
}  # fmt: skip
COMPARISONS = 2 * len(NAMES)


def test_errors_of_a_time_offset_are_as_large_as_stated():
    """The normalised errors of eight noisy series have the right size."""
    seconds = np.arange(0, 30, 0.01)
    t_ns = (seconds * 1e9).round().astype(np.int64)
    phases = seconds[:, None] * [1.3, 2.1, 0.7] + [0.0, 1.0, 2.0]
    rates = np.sin(phases) + 0.4 * np.sin(3.3 * phases + 1)
    true_ns, squares = 12_300_000, []
    truth = quatprop.propagate(GyroSeries(t_ns, rates), method="cubic").wxyz
    turn = Rotation.from_rotvec([0.3, -2.0, 0.5]).as_quat(scalar_first=True)
    settings = comparison_settings(time_offset="auto", tol=10.0)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        measured = rates + 0.03 * rng.normal(size=rates.shape) + 0.01
        a = quatprop.propagate(GyroSeries(t_ns, measured), method="mean")
        noise = exp(np.radians(0.5) * rng.normal(size=rates.shape))
        b = AttitudeSeries(t_ns + true_ns, multiply(multiply(truth, noise), turn))
        offset = compare(AttitudeSeries(t_ns, a.wxyz), b, settings).time_offset
        squares.append(((offset.added_to_b_ns + true_ns) / offset.found.std_ns) ** 2)
    # chi-squared of 8 degrees of freedom: 99 % between 1.34 and 21.95
    assert 1.34 < np.sum(squares) < 21.95


def test_errors_of_calibrations_are_as_large_as_stated():
    """The normalised squared error is in the 99.9 % band, corrected for the number of bands.

    Of all models together, standard deviations that are 15 % off do not pass, nor 5 % of 400 runs.
    """
    each = [ensemble(names, RUNS) for names in MODELS]
    every = Ensemble(*map(sum, zip(*each, strict=True)))
    bands = len(each) + 1
    for one in (*each, every):
        assert one.is_exact(bands), one.squares / one.count
    fault = 0.15 if RUNS < 400 else 0.05
    assert not every.is_exact(bands, fault=1 - fault)
    assert not every.is_exact(bands, fault=1 + fault)


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("motion", MOTIONS)
def test_calibrations_state_what_the_motion_shows(motion):
    """Of bad clocks, outliers and gaps, and of a bias that walks; `make fuzz` tries 60 of each."""
    verdict = judged(pair(1000, motion))
    assert (*verdict.beyond, *verdict.unshown, verdict.is_worse) == ("",)


class Errors:
    """The errors of each term, in the standard deviations that are stated for it.

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


def test_errors_of_noise_terms_are_as_large_as_stated():
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


@pytest.mark.parametrize("draws", [5, pytest.param(12, marks=pytest.mark.thorough(keep=0))])
def test_errors_of_a_cross_check_are_as_large_as_stated(draws):
    """An offset, a mounting and a scale at once: some were a third, the rest taken as known."""
    turn = np.array([0.2, -0.1, 0.15])
    mounted = with_values(MOCAP, lambda wxyz: multiply(wxyz, exp(turn)))
    scaled = with_values(GYRO, lambda rate: rate / 1.1)
    errors = {"offset": [], "mount": [], "scale": []}
    for seed in range(2000, 2000 + draws):
        sources = scaled(FAULTS["late"][0](mounted(rig(seed))))
        said = {one.code: one.numbers for one in crosscheck([*sources.values()]).findings}
        factor = said["scale"]["factor"]
        for code, error, sigma in (
            ("offset", abs(said["offset"]["ms"]) - 80, said["offset"]["sigma_ms"]),
            (
                "mount",
                said["mount"]["deg"] - np.linalg.norm(turn) / DEG,
                said["mount"]["sigma_deg"],
            ),
            ("scale", max(factor, 1 / factor) - 1.1, said["scale"]["sigma"]),
        ):
            errors[code].append(error / sigma)
    lowest, highest = chdtri(draws, [0.999, 0.001])
    for code, each in errors.items():
        assert lowest < np.sum(np.square(each)) < highest, code
