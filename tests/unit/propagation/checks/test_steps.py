"""The step of a gyroscope tells the unit of its rates."""

import math

import numpy as np
import pytest
from make.commands import run
from make.tables import write_rates

from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.checks.rate_checks import RateChecks

DATA_SHEETS = [
    *(deg_s / 2**15 for deg_s in (125, 245, 250, 300, 450, 500, 1000, 2000, 4000)),
    *(1 / per_deg_s for per_deg_s in (131, 131.2, 65.5, 65.6, 32.8, 16.4)),
    *(mdps / 1000 for mdps in (4.375, 8.75, 17.5, 35, 70)),
]
"""deg/s: of Bosch, Analog Devices and InvenSense by their ranges, of InvenSense and ST as given."""


def remarks(step, unit="rad/s", sizes=(500,)):
    """Return the remarks on rates in steps of a unit, in batches of some sizes."""
    scale = math.radians(1) if unit == "deg/s" else 1.0
    rate = np.random.default_rng(1).integers(-900, 900, (500, 3)) * step * scale
    series, found = GyroSeries(np.arange(500), rate), []
    for size in sizes:
        checks = RateChecks(unit)
        batches = [series[begin : begin + size] for begin in range(0, 500, size)]
        assert sum(map(len, checks.units.inspect_raw(batches))) == 500
        found.append(checks.units.step_remarks())
    assert found == [found[0]] * len(sizes)
    return found[0]


@pytest.mark.parametrize("step", DATA_SHEETS)
def test_a_step_is_known_in_the_wrong_unit_and_silent_in_its_own(step):
    """The attitudes were wrong by a factor of 57.3, silently."""
    for unit, size, other in (
        ("rad/s", step, "57.3 times as large as"),
        ("deg/s", math.radians(step), "57.3 times smaller than"),
    ):
        (remark,) = remarks(size, unit)
        assert remark.code == "unit-by-steps"
        assert f"in steps of {size:.6g} {unit}, {other} those of a common gyroscope" in remark
    assert remarks(step, "deg/s") == remarks(math.radians(step), "rad/s") == []


@pytest.mark.parametrize(("true", "taken"), [("deg/s", "rad/s"), ("rad/s", "deg/s")])
def test_the_remedy_holds(tmp_path, true, taken):
    """The unit of the remark can be given, and then there is no remark."""
    step = 500 / 32768 if true == "deg/s" else math.radians(500 / 32768)
    numbers = np.random.default_rng(1).integers(-900, 900, (500, 3)) * step
    rows = [[k * 10_000_000, *row] for k, row in enumerate(numbers.tolist())]
    log = write_rates(tmp_path / "log.csv", rows)
    line = ("propagate", log, "-o", tmp_path / "out.csv", "--rate-unit")
    remedy = f"those of a common gyroscope: if they are in {true}, use --rate-unit {true}"
    assert remedy in run(*line, taken, code=0).stderr
    assert "common gyroscope" not in run(*line, true, code=0).stderr


def test_only_a_step_that_is_close_is_known():
    """A data sheet gives 500/32768 as 0.01526, and 0.0153 is another; nor are ten others known."""
    assert remarks(0.01526)
    assert not remarks(0.0153)
    for step in np.geomspace(1e-5, 1, 10):
        assert not remarks(step)


def test_steps_do_not_depend_on_where_batches_end():
    """They were those of the first batch alone, which may be a row."""
    assert remarks(500 / 32768, sizes=(1, 7, 500))
