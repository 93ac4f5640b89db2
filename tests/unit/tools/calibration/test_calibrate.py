"""Calibrations of simulated gyroscopes: what is planted is found, with errors as stated."""

import json
from dataclasses import replace

import numpy as np
import pytest
from make.calibrations import EVERYTHING, LENGTH_NS, begun, ensemble, error_of, planted, recorded
from make.commands import run
from make.tables import write_attitudes, write_rates
from scipy.optimize import least_squares

import quatprop
from quatprop import AttitudeSeries, DataLossWarning, GyroSeries, RemarkWarning
from quatprop.base.errors import QuatpropError
from quatprop.estimation.fit import deviation, fit
from quatprop.estimation.model import OF_GROUP, Model, errors_of, windows_of
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.kinematics.time_series import BLOCK
from quatprop.settings.command_options import GROUPS


def simulated(seed=1, names=EVERYTHING, **options):
    """Return rates, reference and truth."""
    random = np.random.default_rng(seed)
    truth = planted(random, names)
    return *recorded(random, truth, **options), truth


def write_log(path, rates):
    """Write rates as a table."""
    rows = zip(rates.t_ns, rates.rate, strict=True)
    return write_rates(path, [[int(t), *map(float, rate)] for t, rate in rows])


def test_errors_are_as_large_as_stated():
    """A few runs; slow/ has many."""
    assert ensemble(EVERYTHING, 15).is_exact(1)


def test_a_noisy_heading_increases_only_the_errors_about_its_axis():
    """The standard deviation of each axis follows its noise, here 20 times as large about z."""
    noise = 2e-4 * np.array([1, 1, 20])
    rates, reference, truth = simulated(names=("bias",), axes=(0, 0, 1), gyro=1e-6, reference=noise)
    found = quatprop.calibrate(rates, reference, estimate="bias")
    sigma = np.array([one.sigma for one in found.parameters if one.group == "bias"])
    # Each is known to 10 % by 48 windows.
    assert sigma / sigma[2] == pytest.approx(noise / noise[2], rel=0.3)
    assert np.abs((found.bias_rad_s - truth.bias) / sigma).max() < 4


def test_slopes_are_those_of_differences():
    """The derivatives by one pass are those of the errors over windows."""
    rates, reference, truth = simulated(gyro=0, reference=0)
    data, priors = begun(rates, reference)
    windows = data.windows
    near = truth._replace(middle_ns=priors.centre.middle_ns)
    slope = errors_of(rates, windows, near)[1]
    for k in range(len(OF_GROUP)):
        by = 1e-4 * np.eye(len(OF_GROUP))[k]
        ends = [errors_of(rates, windows, near.with_increment(sign * by))[0] for sign in (1, -1)]
        measured = (ends[0] - ends[1]) / 2e-4
        assert slope[..., k] == pytest.approx(measured, abs=5e-3 * np.abs(measured).max())


def test_least_squares_of_scipy_finds_the_same():
    """With differences as derivatives, weights by the same noise, and the same priors."""
    rates, reference, _ = simulated()
    data, priors = begun(rates, reference)
    found = fit(data, priors, priors.centre)

    def residuals(by):
        model = priors.centre.with_increment(by)
        vectors = errors_of(rates, data.windows, model)[0][found.linear.used]
        off = deviation(model, priors.centre) / priors.sigma
        return np.append(vectors / np.sqrt(found.linear.noise * found.excess), off)

    start = deviation(found.model, priors.centre)
    other = priors.centre.with_increment(least_squares(residuals, start, x_scale="jac").x)
    sigma = np.sqrt(found.covariance.diagonal())
    assert np.abs(error_of(found.model, other) / sigma).max() < 0.03


@pytest.mark.parametrize(
    ("axes", "held"),
    [
        ((0.0, 0.0, 1.0), {("scale", "x"), ("scale", "y"), ("mount", "z")}),
        ((0.0, 0.0, 0.0), {("scale", "x"), ("scale", "y"), ("scale", "z"), ("offset", "")}),
    ],
)
def test_parameters_that_the_motion_does_not_show_are_not_determined(axes, held):
    """Of planar motion and of none, they have no standard deviation, and keep to their prior."""
    rates, reference, truth = simulated(names=("bias",), axes=axes)
    result = quatprop.calibrate(rates, reference, estimate="all")
    unshown = {(one.group, one.axis) for one in result.parameters if one.sigma is None}
    assert held <= unshown
    assert all(
        abs(one.value) < 3 * (GROUPS[one.group].prior or 0.01)
        for one in result.parameters
        if one.sigma is None
    )
    sigma = [one.sigma for one in result.parameters if one.group == "bias"]
    assert np.abs((result.bias_rad_s - truth.bias) / sigma).max() < 4


def test_jumps_and_gaps_of_the_reference_do_not_matter():
    """The reference jumps by 20 deg and back, and misses a second."""
    rates, reference, truth = simulated()
    wxyz = reference.wxyz.copy()
    for start in (200, 700, 1300):
        wxyz[start : start + 40] = multiply(wxyz[start : start + 40], exp([0.3, -0.2, 0.1]))
    spoiled = replace(reference, wxyz=wxyz)
    keep = np.ones(len(wxyz), bool)
    keep[900:1000] = False
    found = quatprop.calibrate(rates, spoiled[keep], window=f"{LENGTH_NS}ns")
    assert found.outliers > 2
    errors = zip(_ordered(found, error_of(_model(found), truth)), found.parameters, strict=True)
    pulls = [error / one.sigma for error, one in errors if one.sigma is not None]
    assert len(pulls) > 10
    assert np.abs(pulls).max() < 4.5


def test_mounted_at_a_right_angle_with_another_clock():
    """Both are far from the initial guess of the least squares fit."""
    truth = Model(bias=np.array([0.01, 0.02, -0.01]), mount=exp([0, 0, np.pi / 2]))
    rates, reference = recorded(np.random.default_rng(3), truth)
    late = replace(reference, t_ns=reference.t_ns + 5_000_000_000)
    found = quatprop.calibrate(rates, late)
    assert found.time_offset_ns == pytest.approx(-5e9, abs=1e6)
    assert np.abs(found.mount_wxyz - truth.mount).max() < 2e-3
    assert found.is_better


def test_a_calibrated_gyroscope_has_nothing_to_gain():
    """Then the errors over windows that were not used stay the same."""
    rates, reference, _ = simulated(names=())
    found = quatprop.calibrate(rates, reference)
    assert not found.is_better
    assert {found, replace(found)} > {found}
    assert found.rms_calibrated_rad == pytest.approx(found.rms_uncalibrated_rad, rel=0.1)


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_a_calibration_without_improvement_is_still_shown(tmp_path, seed):
    """Errors of 0 were "not determined" where windows that were not used became worse.

    A file is what they would be worse with: it is said, and the one that is there is kept.
    """
    rates, reference = recorded(np.random.default_rng(seed), Model())
    found = quatprop.calibrate(rates, reference)
    assert found.is_worse
    assert "file         not written: it makes windows that were not used worse, by" in str(found)
    assert "improvement" not in str(found)
    stated = [one for one in found.parameters if one.group != "drift"]
    assert all(abs(one.value) < 4 * one.sigma for one in stated)
    file = tmp_path / "calibration.yaml"
    file.write_text("old")
    with pytest.raises(QuatpropError, match="windows kept for validation are worse with it"):
        found.write(file)
    assert file.read_text() == "old"


def test_values_are_shown_although_their_file_is_refused(tmp_path):
    """A command with -o showed nothing of them."""
    rates, reference = recorded(np.random.default_rng(4), Model())
    log = write_log(tmp_path / "log.csv", rates)
    other = write_attitudes(tmp_path / "reference.csv", reference.t_ns, reference.wxyz)
    made = run("calibrate", log, other, "-o", tmp_path / "calibration.yaml", code=2)
    assert "bias         x " in made.stdout
    assert "worse with it; record for longer" in made.stderr


def _model(found):
    shape = np.linalg.inv(Model(mount=found.mount_wxyz).matrix) @ found.matrix
    offset = found.time_offset_ns / 1e9
    return Model(found.bias_rad_s, shape, found.mount_wxyz, 0, offset, found.clock_drift)


def _ordered(found, by_model):
    groups = dict.fromkeys(one.group for one in found.parameters)
    return np.concatenate([by_model[group == OF_GROUP] for group in groups])


def test_files_there_and_back(tmp_path):
    """The file that the command writes is read by propagate, and its error falls as stated."""
    rates, reference, truth = simulated(names=("bias", "scale", "mount"))
    log = write_log(tmp_path / "log.csv", rates)
    other = write_attitudes(tmp_path / "reference.csv", reference.t_ns, reference.wxyz)
    file = tmp_path / "calibration.yaml"
    report = json.loads(run("calibrate", log, other, "-o", file, "--json", code=0).stdout)
    assert report["rms_calibrated_rad"] < 0.2 * report["rms_uncalibrated_rad"]
    assert report["matrix"] == pytest.approx(truth.matrix, abs=0.01)
    window = {"window": f"{report['window_ns']}ns", "align": "mean"}
    errors = [
        quatprop.compare(quatprop.propagate(log, method="coning", **calibrated), other, **window)
        for calibrated in ({}, {"calibration": file})
    ]
    before, after = (each.window.rms_rad for each in errors)
    assert after < 0.25 * before


def test_the_summary_has_every_parameter(tmp_path):
    """Each with its sigma and unit, which are not determined, and the error before and after."""
    rates, reference, _ = simulated(names=("bias",), axes=(0, 0, 1))
    log = write_log(tmp_path / "log.csv", rates)
    other = write_attitudes(tmp_path / "reference.csv", reference.t_ns, reference.wxyz)
    lines = run("calibrate", log, other, code=0).stdout.splitlines()
    labels = [line.split()[0] for line in lines]
    assert labels[:2] == ["windows", "bias"]
    assert labels[-3:] == ["error", "improvement", "clock"]
    assert "scale x, scale y" in lines[labels.index("unknown")]
    # print() showed every number of the covariance.
    assert str(quatprop.calibrate(log, other)).splitlines() == lines


@pytest.mark.parametrize(
    ("options", "count", "said"),
    [
        ({"estimate": "bias,scael"}, None, "did you mean 'scale'"),
        ({"window": "1m"}, None, "windows in common"),
        ({"estimate": "bias", "time_offset": "1h"}, None, "no time in common"),
        ({"estimate": "bias", "time_offset": "auto"}, None, "add offset to estimate, or give a"),
        ({"estimate": "scale"}, None, "none of the requested parameters can be estimated"),
        ({}, 59, "the log has 59 samples; a calibration needs at least 60: record for longer"),
        ({}, 60, "have no time in common, or too little; add their difference with time_offset$"),
    ],
)
def test_refusals(options, count, said):
    """Each is one sentence with a remedy."""
    axes = (0, 0, 0) if options.get("estimate") == "scale" else (1, 1, 1)
    rates, reference, _ = simulated(axes=axes)
    with pytest.raises(QuatpropError, match=said):
        quatprop.calibrate(rates[:count], reference, **options)


def test_a_clock_that_steps_back_is_refused():
    """As by propagate, with the same remedies; the rates were sorted silently."""
    rates, reference, _ = simulated()
    mixed = GyroSeries.joined([rates[500:], rates[:500]])
    with pytest.raises(QuatpropError, match="time steps back by 20 s at sample 1501"):
        quatprop.calibrate(mixed, reference)
    with pytest.warns(RemarkWarning, match="500 non-monotonic timestamps"):
        found = quatprop.calibrate(mixed, reference, on_backwards="sort")
    np.testing.assert_array_equal(found.matrix, quatprop.calibrate(rates, reference).matrix)
    with pytest.raises(QuatpropError, match="reference: time steps back"):
        quatprop.calibrate(rates, AttitudeSeries.joined([reference[500:], reference[:500]]))


def test_a_rate_that_is_not_finite_is_refused():
    """As by propagate; dropped and counted if a setting says so."""
    rates, reference, _ = simulated()
    rate = rates.rate.copy()
    rate[700, 1] = np.nan
    spoilt = GyroSeries(rates.t_ns, rate)
    with pytest.raises(QuatpropError, match=r"sample 700 \(t = 7000000000 ns\) is absent or not"):
        quatprop.calibrate(spoilt, reference)
    with (
        pytest.warns(DataLossWarning, match="1 rows were dropped"),
        pytest.warns(RemarkWarning, match="1 non-finite rate"),
    ):
        assert quatprop.calibrate(spoilt, reference, on_nonfinite="drop").dropped == 1


def test_samples_of_one_time_are_used_once():
    """The first of them, with a remark."""
    rates, reference, _ = simulated()
    twice = GyroSeries.joined([rates[:6], rates[5:]])
    with pytest.warns(RemarkWarning, match="omitted") as warned:
        found = quatprop.calibrate(twice, reference)
    assert [one.message.code for one in warned] == [one.code for one in found.remarks]
    assert "1 samples of the log were omitted: not finite, or of the same time" in found.remarks
    np.testing.assert_array_equal(found.matrix, quatprop.calibrate(rates, reference).matrix)


def test_windows_over_the_end_of_a_block_are_as_others():
    """The interval between two blocks belongs to the later one."""
    t_ns = np.arange(BLOCK + 1000) * 1_000_000
    rates = GyroSeries(t_ns, np.sin(np.outer(t_ns * 1e-9, [7, 3, 5])))
    late = rates[BLOCK - 1000 :]
    reference = AttitudeSeries(late.t_ns, quatprop.propagate(late, method="cubic").wxyz)
    windows = windows_of(late, reference, Model(), 300_000_000)
    assert len(windows) > 3
    for whole, part in zip(
        *(errors_of(each, windows, Model()) for each in (rates, late)), strict=True
    ):
        np.testing.assert_allclose(whole, part, rtol=0, atol=1e-9)


@pytest.mark.filterwarnings("ignore::quatprop.base.errors.RemarkWarning")  # of the truth
@pytest.mark.parametrize("turning", [0.0, np.pi], ids=["rest", "spin"])
def test_a_scale_that_noise_explains_is_not_determined(turning):
    """With an exact reference, the estimated scale was -100 %, so that no rate was left.

    A steady spin does not tell a bias from a scale along its axis, nor from a mounting across it.
    """
    t_ns, true = np.arange(6000) * 10**7, np.tile([0.0, 0.0, turning], (6000, 1))
    truth = quatprop.propagate(quatprop.GyroSeries(t_ns, true))
    noise = 1e-3 * (not turning) * np.random.default_rng(2).normal(size=true.shape)
    log = quatprop.GyroSeries(t_ns, true + np.array([0.01, 0.02, 0.0]) + noise)
    found = quatprop.calibrate(log, truth)
    shown = {one.group for one in found.parameters if one.sigma is not None}
    if turning:
        assert shown.isdisjoint({"bias", "offset", "drift"})
        return
    assert shown == {"bias"}
    sigmas = [one.sigma for one in found.parameters[:3]]
    assert (np.abs(found.bias_rad_s - [0.01, 0.02, 0.0]) < 4 * np.array(sigmas)).all()
