"""The step of a gyroscope tells the unit of its rates."""

import math

import numpy as np
import pytest
from make.commands import run
from make.tables import write_rates

from quatprop.pipeline.rate_checks import SENSITIVITIES, RateChecks
from quatprop.series import GyroSeries

REMARK = "those of a common gyroscope: if they are in "


def remarks_on(tmp_path, step, unit, head="t_ns,wx,wy,wz"):
    """Return what is said of a table in steps, read in a unit."""
    numbers = np.random.default_rng(1).integers(-900, 900, (500, 3)) * step
    rows = [[k * 10_000_000, *row] for k, row in enumerate(numbers.tolist())]
    log, out = write_rates(tmp_path / "log.csv", rows, head), tmp_path / "out.csv"
    return run("propagate", log, "-o", out, "--rate-unit", unit, code=0).stderr


@pytest.mark.parametrize(("true", "taken"), [("deg/s", "rad/s"), ("rad/s", "deg/s")])
def test_the_wrong_unit_is_named_and_the_right_one_is_not(tmp_path, true, taken):
    """A range of 500 deg/s in 16 bits: the attitudes were wrong by a factor of 57.3, silently."""
    step = 500 / 32768 if true == "deg/s" else math.radians(500 / 32768)
    said = remarks_on(tmp_path, step, taken)
    assert f"{REMARK}{true}, use --rate-unit {true}" in said
    # The remedy, applied.
    assert REMARK not in remarks_on(tmp_path, step, true)


def test_a_step_of_few_digits_is_known(tmp_path):
    """As a data sheet gives it: 0.0153 deg/s is 500/32768 to three digits, but not to four."""
    assert REMARK in remarks_on(tmp_path, 0.01526, "rad/s")
    assert REMARK not in remarks_on(tmp_path, 0.0153, "rad/s")


@pytest.mark.parametrize("sensitivity", SENSITIVITIES)
def test_every_known_step_is_silent_in_its_own_unit(tmp_path, sensitivity):
    """No sensitivity in one unit is that of another gyroscope in the other."""
    assert REMARK not in remarks_on(tmp_path, sensitivity, "deg/s")
    assert REMARK not in remarks_on(tmp_path, math.radians(sensitivity), "rad/s")


def test_any_other_step_is_silent(tmp_path):
    """Of ten, from coarse to fine."""
    for step in np.geomspace(1e-5, 1, 10):
        assert REMARK not in remarks_on(tmp_path, step, "rad/s")


def test_steps_do_not_depend_on_where_batches_end():
    """They were those of the first batch alone, which may be a row."""
    rate = np.random.default_rng(1).integers(-900, 900, (500, 3)) * (500 / 32768)
    series, found = GyroSeries(np.arange(500), rate), []
    for size in (1, 7, 500):
        checks = RateChecks()
        batches = [series[begin : begin + size] for begin in range(0, 500, size)]
        assert sum(map(len, checks.begun(batches))) == 500
        found.append(checks.step_remarks())
    assert [remark.code for remark in found[0]] == ["unit-by-steps"]
    assert found == [found[0]] * 3
