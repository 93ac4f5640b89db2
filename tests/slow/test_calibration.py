"""Simulated gyroscopes: the errors of their calibrations are as large as stated."""

import pytest
from make.calibrations import MODELS, ensemble

RUNS = 60
"""Of each model; ``fuzz/calibrations.py`` makes 400, which also notice sigmas that are wrong by 5 %."""


@pytest.mark.parametrize("names", MODELS)
def test_errors_are_as_large_as_stated(names):
    """The normalised squared error is in the 99.9 % band, corrected for the number of models."""
    each = ensemble(names, RUNS)
    assert each.is_exact(len(MODELS)), each.squares / each.count
