"""Simulated gyroscopes: the errors of their calibrations are as large as stated."""

import os

from make.calibrations import MODELS, Ensemble, ensemble

RUNS = int(os.environ.get("CALIBRATIONS", "30"))
"""Of each model; `make fuzz` makes 400."""


def test_errors_are_as_large_as_stated():
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
