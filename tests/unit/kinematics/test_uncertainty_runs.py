"""Covariances of whole runs against finite differences: the same runs, of rates with an error."""

from itertools import product

import numpy as np
import pytest
from make.motion import FRAMES, simulated
from make.tables import write_rates

from quatprop import GyroSeries, propagate
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply

CHANGE = 1e-6
ERRORS = {
    "bias_sigma": lambda rate: [np.broadcast_to(axis, rate.shape) for axis in np.eye(3)],
    "scale_sigma": lambda rate: [axis * rate for axis in np.eye(3)],
    "misalignment_sigma": lambda rate: [
        axis * np.roll(rate, -further, axis=1) for axis in np.eye(3) for further in (1, 2)
    ],
}
"""Error -> what a rate is off by where one of its parts is 1."""
Q0 = exp(np.array([0.5, -0.4, 1.0]))
OBLIQUE = exp(np.array([0.9, 0.3, -0.5]))
RUNS = {
    "start": {},
    "cubic": {"method": "cubic"},
    "tenth": {"every": 10},
    "dense": {"rate": 333, "method": "coning"},
    "coarse": {"rate": 7, "method": "coning"},
    "mounted": {"mount": OBLIQUE.tolist()},
    "averages": {},
    "increments": {},
    "calibrated": {"calibration": "calibration.yaml"},
    "gap holds": {"on_gap": "hold"},
    "gap is zero": {"on_gap": "zero"},
    "gap is zero, dense": {"on_gap": "zero", "rate": 333},
    "gap splits": {"on_gap": "split"},
    "gap splits, dense": {"on_gap": "split", "rate": 333},
}
# Rates in the reference frame are not rotated by the mounting.
CASES = [case for case in product(RUNS, FRAMES) if case != ("mounted", "inertial")]


@pytest.fixture
def calibration(tmp_path, monkeypatch):
    """Have a calibration at hand, of small misalignments."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "calibration.yaml").write_text(
        "matrix: [[1.001, 0.0005, 0], [0, 0.999, -0.0005], [0.0003, 0, 1.0002]]\nbias: [0, 0, 0.01]"
    )


def tumbling(name, frame):
    """Return the rates of a run, resolved in body axes or in reference axes."""
    t_ns, rate = simulated("tumbling", frame, 81, 25_000_000)
    if "gap" in name:
        t_ns = t_ns + 3 * 10**9 * (np.arange(len(t_ns)) > 40)
    # An increment may have been integrated over another time than there is between stamps.
    integration_time_ns = np.full(len(t_ns), 24_000_000) if name == "increments" else None
    return GyroSeries(t_ns, rate, integration_time_ns, is_interval_average=name == "averages")


def differences(series, error, **options):
    """Return the covariances of the attitudes, from those with each part of an error in turn."""
    true, changes = propagate(series, **options).wxyz, []
    for wrong in ERRORS[error](series.rate):
        wxyz = propagate(series.with_rate(series.rate + CHANGE * wrong), **options).wxyz
        changes.append(log(multiply(conjugate(true), wxyz)) / CHANGE)
    change = np.stack(changes, axis=2)
    return change @ change.swapaxes(1, 2)


def assert_close(found, expected):
    """Within 1 % of the largest number of each covariance, once there is one to speak of.

    Between samples covariances are linear, which is wrong by 1 % up to the sixth interval.
    """
    size = np.abs(expected).max(axis=(1, 2))
    told = size > 0.02 * size.max()
    assert np.count_nonzero(told) > len(told) / 2
    assert (np.abs(found - expected).max(axis=(1, 2)) <= 0.01 * size)[told].all()


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:series. 1 interval longer than 250 ms")
@pytest.mark.filterwarnings("ignore:series. the increments cover 1.92 s of the 2 s")
@pytest.mark.usefixtures("calibration")
@pytest.mark.parametrize(("name", "frame"), CASES)
def test_errors_of_whole_runs(name, frame):
    """Whatever is done to rates and attitudes.

    Scale factors were taken for those of body axes where the sensor's are others, rates were
    integrated across gaps without rotation, and increments over the time between their stamps.
    """
    options = {"rates": frame, "q0": Q0, **RUNS[name]}
    series = tumbling(name, frame)
    for error in ERRORS:
        if (name, error) == ("gap splits, dense", "misalignment_sigma"):
            continue  # bounded on this motion, so that the first intervals after a gap are told
        found = propagate(series, sigma=True, **{error: 1.0}, **options).covariance
        assert_close(found, differences(series, error, **options))


def test_the_mounting_of_a_logged_attitude_does_not_turn_inertial_rates(tmp_path):
    """It turns the attitude to begin from; scale factors belong to the axes of the rates."""
    series = tumbling("", "inertial")
    options = {"rates": "inertial", "sigma": True, "bias_sigma": 1e-3, "scale_sigma": 1e-3}
    rows = [[t, *rate, *Q0] for t, rate in zip(series.t_ns, series.rate.tolist(), strict=True)]
    log = write_rates(tmp_path / "log.csv", rows, "t_ns,wx,wy,wz,qw,qx,qy,qz")
    mounted = propagate(log, q0="log", mount=OBLIQUE.tolist(), rate_unit="rad/s", **options)
    expected = propagate(series, q0=multiply(Q0, conjugate(OBLIQUE)), **options)
    np.testing.assert_allclose(mounted.wxyz, expected.wxyz, atol=1e-14)
    np.testing.assert_allclose(mounted.covariance, expected.covariance, rtol=1e-9, atol=1e-18)
