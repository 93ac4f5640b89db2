"""An error that the integration method explains is not blamed on anything else."""

import numpy as np
import pytest
from make.commands import run

import quatprop
from quatprop.comparison import comparison

METHODS = ("start", "mean", "coning")
"""Methods whose better one is known, with an error of about that difference."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Simulate the example of the help of plot: a tumbling body with its truth."""
    log = tmp_path_factory.mktemp("demo") / "demo.bag"
    run("simulate", log, "--motion", "tumbling", code=0)
    return log, log.with_name("demo.truth.csv")


def advice_of(result):
    """Return the advice if the error is within what the method costs, else None."""
    cause = result.likely_cause
    return (
        cause.advice if cause and "within what the integration method" in cause.sentence else None
    )


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("side", ["a", "b"])
def test_an_error_within_the_sensitivity_has_no_other_cause(demo, method, side):
    """In memory, whole or in part; the method that is named reduces the error."""
    log, truth = demo
    made, truth = quatprop.propagate(log, method=method), quatprop.read_attitudes(truth)
    for one in (made, made[100:]):
        sides = {"a": one, "b": truth} if side == "a" else {"a": truth, "b": one}
        result = quatprop.compare(**sides)
        assert [one.name for one in result.likely_cause.chain] == ["method"]
        said = advice_of(result)
        assert f"the integration method of {side.upper()} ({method}) costs" in said
        better = said.split(f"; propagate {side.upper()} with method='")[1].strip("'")
        other = {**sides, side: quatprop.propagate(log, method=better)[len(made) - len(one) :]}
        assert quatprop.compare(**other).error_rad.max < result.error_rad.max / 10


@pytest.mark.parametrize("streamed", [False, True])
def test_a_file_states_the_sensitivity(demo, tmp_path, monkeypatch, streamed):
    """Compared in memory or while it is read; the option that is printed works."""
    log, truth = demo
    if streamed:
        monkeypatch.setattr("quatprop.comparison.file_comparison.SHORT", 100)
    out = tmp_path / "a.parquet"
    run("propagate", log, "-o", out, "--method", "coning", code=0)
    said = run("compare", out, truth, code=0).stdout
    assert said.count("likely (") == 1
    assert "within what the integration method of A (coning) costs, 0.00143 deg" in said
    option = said.split("; propagate A with ")[1].split()
    assert option == ["--method", "cubic"]
    out = tmp_path / "better.parquet"
    run("propagate", log, "-o", out, *option, code=0)
    assert "likely (" not in run("compare", out, truth, code=0).stdout


def test_no_cause_is_searched_for(demo, monkeypatch):
    """The search is most of the time of a comparison."""
    log, truth = demo
    monkeypatch.setattr(comparison, "likely_cause", lambda *_: pytest.fail("searched"))
    made = quatprop.propagate(log, method="coning")
    quatprop.compare(made, quatprop.read_attitudes(truth))


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ({"method": "coning", "bias": (1e-3, 0, 0)}, None),
        ({"method": "start", "bias": (1e-4, 0, 0)}, {"method": "start"}),
        ({"method": "cubic", "bias": (5e-7, 0, 0)}, None),
    ],
)
def test_other_errors_keep_their_cause(demo, a, b):
    """A bias that is more than the method costs, or that two series of one method differ by."""
    log, truth = demo
    made = quatprop.propagate(log, **a)
    other = quatprop.read_attitudes(truth) if b is None else quatprop.propagate(log, **b)
    result = quatprop.compare(made, other)
    assert advice_of(result) is None
    assert "rate bias" in result.likely_cause.name


def test_two_methods_cost_the_sum(demo):
    """Only the side with a share that matters is to be propagated again."""
    log, _ = demo
    start, coning = (quatprop.propagate(log, method=method) for method in ("start", "coning"))
    said = advice_of(quatprop.compare(start, coning))
    assert "propagate A with method='mean'" in said
    assert "B" not in said
    assert np.isclose(start.sensitivity.angle_rad, start.report.result.method_sensitivity_rad)
