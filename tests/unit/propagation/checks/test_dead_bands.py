"""Sensors that show one value for all small rates are neither frozen nor dropping out."""

import numpy as np
import pytest
from make.motion import waves

from quatprop import GyroSeries, propagate

SHOWN = {"zero": 0.0, "their bias": [0.004, -0.003, 0.0021]}


def with_dead_band(seed, band, shown, together):
    """Return the rates of a body that turns now and then, about each axis by itself.

    `together`: whether only rows are shown as `shown` in which all rates are small
    """
    random = np.random.default_rng(seed)
    hz = (50, 100, 200)[seed % 3]
    t_s = np.arange(60 * hz) / hz
    moves = np.sin(t_s[:, None] * random.uniform(0.1, 0.6, 3) + random.uniform(0, 6, 3))
    rate = waves(random, t_s, 0.1, 2, random.uniform(0.2, 1)) * np.clip(4 * moves - 1, 0, 1)
    rate += random.normal(0, random.choice([0.0005, 0.002, 0.005]), rate.shape)
    is_small = np.abs(rate) < band
    if together:
        is_small = is_small.all(axis=1, keepdims=True)
    return GyroSeries(np.rint(t_s * 1e9).astype(np.int64), np.where(is_small, shown, rate))


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("shown", SHOWN)
@pytest.mark.parametrize("band", [0.01, 0.02, 0.05])
def test_a_dead_band_near_rest_is_no_defect(band, shown, together):
    """Of such logs, 35 of 108 were called frozen, or to have dropouts."""
    for seed in range(9):
        series = with_dead_band(seed, band, SHOWN[shown], together)
        said = {one.code for one in propagate(series).report.remarks}
        assert not said & {"frozen-axis", "dropout", "held-samples"}, (seed, said)
