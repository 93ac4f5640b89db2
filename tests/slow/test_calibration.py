"""Hundreds of simulated gyroscopes: the errors of their calibrations are as large as stated."""

import pytest
from make.calibrations import MODELS, Ensemble, ensemble

RUNS = 400
COMPARISONS = len(MODELS) + 1


@pytest.fixture(scope="module")
def ensembles():
    """Return an ensemble of each model."""
    return [ensemble(names, RUNS) for names in MODELS]


def test_errors_are_as_large_as_stated(ensembles):
    """The normalised squared error is in the 99.9 % band, of each model."""
    for names, each in zip(MODELS, ensembles, strict=True):
        assert each.is_exact(COMPARISONS), (names, each.squares / each.count)


def test_sigmas_that_are_wrong_by_five_percent_are_noticed(ensembles):
    """In all models together: those that are too small, and those that are too large."""
    every = Ensemble(*map(sum, zip(*ensembles, strict=True)))
    assert every.is_exact(COMPARISONS)
    assert not every.is_exact(COMPARISONS, fault=1.05)
    assert not every.is_exact(COMPARISONS, fault=0.95)
