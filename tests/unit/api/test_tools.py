"""`info`, `plot` and `simulate` of the library do what the commands of these names do."""

import json
import re
import warnings

import numpy as np
import pytest
from make.commands import run
from make.places import SAMPLE_LOGS

import quatprop
from quatprop.errors import UsageError

BAG, TRUTH = SAMPLE_LOGS / "tumbling.bag", SAMPLE_LOGS / "tumbling.truth.csv"


def test_functions_stay_functions_when_what_they_use_is_imported(tmp_path):
    """A package of the same name took their place once it was imported."""
    quatprop.plot(BAG, tmp_path / "a.svg")
    quatprop.simulate(samples=3)
    quatprop.info(BAG)
    assert all(callable(getattr(quatprop, name)) for name in ("plot", "simulate", "info"))


def test_info_has_what_the_command_prints(tmp_path):
    """The same survey, with settings as keywords; short when shown."""
    found = quatprop.info(BAG)
    told = json.loads(run("info", "--json", BAG).stdout)[0]
    assert [one.samples for one in found.sources] == [one["samples"] for one in told["sources"]]
    assert repr(found) == f"<LogSurvey: {BAG} (bag): '/imu (1000)'>"
    odd = tmp_path / "odd.csv"
    odd.write_text("t_ns,gyr_x,gyr_y,gyr_z\n" + "".join(f"{k},1,2,{k}\n" for k in range(9)))
    (source,) = quatprop.info(odd).sources
    assert "rate_unit='rad/s' or 'deg/s'" in source.missing


def test_simulate_gives_what_the_command_writes(tmp_path):
    """To the bit, noise and all."""
    out = tmp_path / "a.parquet"
    options = "--motion tumbling --rate 50 --duration 2s --noise 1e-3 --bias 0.1,0,0 --seed 3"
    run("simulate", out, *options.split())
    rates, truth = quatprop.simulate(
        motion="tumbling", rate=50, duration="2s", noise=1e-3, bias=np.array([0.1, 0, 0]), seed=3
    )
    assert rates == quatprop.read_rates(out)
    assert truth == quatprop.read_attitudes(tmp_path / "a.truth.parquet")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"axis": "1,0,0", "motion": "rest"}, "axis goes with motion='spin'"),
        ({"samples": 3, "duration": "1s"}, "samples and duration exclude each other"),
        ({"noise": -1}, "noise: '-1' is below 0"),
        ({"start": "+5s"}, "start: '+5s' is not a time"),
        ({"bais": 1}, "there is no setting 'bais'; did you mean 'bias'"),
    ],
)
def test_simulations_that_make_no_sense_are_refused(options, reason):
    """In the words of Python."""
    with pytest.raises(UsageError, match=reason.replace("+", r"\+")):
        quatprop.simulate(**options)


def test_plot_draws_what_the_command_draws(tmp_path):
    """The same lines."""
    for words, options in (
        (["--start", "+1s"], {"start": "+1s"}),
        (["--show", "rates"], {"show": "rates"}),
    ):
        ours, theirs = tmp_path / "ours.svg", tmp_path / "theirs.svg"
        quatprop.plot(BAG, ours, **options)
        run("plot", BAG, "-o", theirs, *words)
        drawn = [re.findall(r' d="[^"]*"', path.read_text()) for path in (ours, theirs)]
        assert drawn[0] == drawn[1] != []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quatprop.plot([TRUTH, TRUTH], tmp_path / "errors.png", reference=TRUTH)
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")


def test_a_plot_refuses_what_does_not_go_together(tmp_path):
    """As the command does."""
    with pytest.raises(UsageError, match="does not go with"):
        quatprop.plot(TRUTH, tmp_path / "a.png", components=True, unwrap=True)


def test_a_report_is_short_when_shown():
    """It filled pages of a notebook."""
    report = quatprop.propagate(BAG).report
    assert repr(report) == "<RunReport: 1,000 attitudes of 1,000 samples by method start>"


def test_warnings_point_at_the_line_of_the_user(tmp_path):
    """Of every function: not at a line of the library."""
    gappy = tmp_path / "gappy.csv"
    times = [*range(100), *range(500, 600)]
    gappy.write_text("t_ns,wx,wy,wz\n" + "".join(f"{k}000000,0,0.5,{k % 9}\n" for k in times))
    for call in (
        lambda: quatprop.propagate(gappy, rate_unit="rad/s"),
        lambda: quatprop.plot(gappy, tmp_path / "a.png", rate_unit="rad/s"),
    ):
        with pytest.warns(quatprop.RemarkWarning) as caught:
            call()
        assert {one.filename for one in caught} == {__file__}
