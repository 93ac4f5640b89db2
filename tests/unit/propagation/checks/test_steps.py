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


def cut(rate, axis=0, unit=1.0):
    """Return rates of which one axis is cut to whole numbers of a unit, rad/s."""
    rate = rate.copy()
    rate[:, axis] = np.trunc(rate[:, axis] / unit) * unit
    return rate


def motion(seed, count, peak, noise=0.004):
    """Return rates of a body that swings, rad/s."""
    rng = np.random.default_rng(seed)
    angle = np.arange(count)[:, None] * rng.uniform(0.005, 0.08, 3) + rng.uniform(0, 6, 3)
    return peak * np.sin(angle) + rng.normal(0, noise, (count, 3))


def cut_axes(rate):
    """Return the remarks on axes without decimals."""
    checks = RateChecks("rad/s")
    list(checks.units.inspect_raw([GyroSeries(np.arange(len(rate)), rate)]))
    return [one for one in checks.units.step_remarks() if one.code == "cut-decimals"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [600, 3000])
@pytest.mark.parametrize("decimals", [4, 17])
@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_lost_its_decimals_is_named(seed, count, decimals, axis):
    """Its column was exported as whole numbers."""
    (said,) = cut_axes(np.round(cut(motion(seed, count, 3.0), axis), decimals))
    assert said.startswith(f"axis {'xyz'[axis]} comes in steps of 1 rad/s, and the others in")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("peak", [0.02, 1.0, 30.0])
def test_no_axis_lost_its_decimals_in(seed, peak):
    """Steps of a sensor are those of all axes, and a body may turn about one of them."""
    rate = motion(seed, 3000, peak)
    lsb = math.radians(0.07)
    one = rate * [1, 0, 0]
    for healthy in (rate, np.round(rate / lsb) * lsb, np.trunc(rate), np.round(rate, 2), one,
                    np.round(one / lsb) * lsb, np.trunc(one), np.where(np.abs(rate) < 0.1, 0, rate),
                    rate * [1, 1e-3, 1e-3], np.round(rate * [30, 1, 1], 3),
                    cut(rate, 0, lsb)):  # fmt: skip
        assert cut_axes(healthy) == []
