"""Recordings with a reference: the error over windows that were not used does not grow."""

import numpy as np
import pytest
from make.commands import run
from make.mistakes import RECORDINGS, Recording

from quatprop import GyroSeries, calibrate

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")

BROAD = ("broad05", "broad18")
LARGEST_SIGMA = {
    "bias": 5e-4, "scale": 0.01, "misalignment": 0.01, "mount": 0.12, "offset": 0.002,
    "drift": 2e-5,
}  # fmt: skip
"""Of half a minute with slow motion: SI units."""


def recorded(folder, name):
    """Return rates and reference of a recording."""
    recording = Recording(folder, name)
    averages = recording.method == "end"
    rates = GyroSeries(recording.t_ns, recording.rate, is_interval_average=averages)
    return rates, recording.reference


@pytest.mark.parametrize("name", RECORDINGS)
def test_no_recording_is_worse_by_more_than_its_sigma(shared_logs, name):
    """Those of BROAD and EuRoC, whose references were not made from the rates, are better."""
    found = calibrate(*recorded(shared_logs, name))
    assert found.rms_calibrated_rad - found.rms_clock_corrected_rad <= max(
        found.gain_sigma_rad, 1e-7
    )
    # With the clock, whose error has its own deviation: 2 of both, as the shortest have 19 windows.
    both = np.hypot(found.gain_sigma_rad, found.clock_gain_sigma_rad)
    assert found.rms_calibrated_rad - found.rms_uncalibrated_rad <= max(2 * both, 1e-7)
    if name in {*BROAD, "euroc", "px4"}:
        assert found.is_better


def test_the_bias_is_that_of_the_ground_truth(shared_logs):
    """EuRoC's own estimate of it, by cameras and Vicon, stands next to its attitudes."""
    folder = shared_logs / "csv/euroc_v102"
    truth = folder / "state_groundtruth_data.csv"
    rows = np.genfromtxt(truth, delimiter=",", skip_header=1)
    found = calibrate(folder / "imu0_data.csv", truth, estimate="bias,offset")
    np.testing.assert_allclose(found.bias_rad_s, rows[:, 11:14].mean(axis=0), atol=5e-4)


def test_what_is_shown_is_shown_in_the_final_fit(shared_logs):
    """Half of its windows were left out, and a scale was stated as 40 % +- 33 %."""
    rates, reference = recorded(shared_logs, "px4")
    for one in calibrate(rates[:3000], reference).parameters:
        assert one.sigma is None or one.sigma <= LARGEST_SIGMA[one.group]


def test_two_trials_of_one_sensor_have_the_same_bias(shared_logs):
    """Within four of their standard deviations, on each axis."""
    biases = []
    for name in BROAD:
        found = calibrate(*recorded(shared_logs, name))
        sigma = [one.sigma for one in found.parameters if one.group == "bias"]
        biases.append((found.bias_rad_s, np.array(sigma)))
    (first, s), (second, t) = biases
    assert (np.abs(first - second) < 4 * np.hypot(s, t)).all()


def test_covariances_do_not_matter(shared_logs):
    """A driver's constant covariance was warned of, though only attitudes are used."""
    log = f"{shared_logs / 'two_imus/test1_2014_xsens.bag'}:/xsens/imu_data"
    assert "covariance" not in run("calibrate", log, log, "--estimate", "bias", code=0).stderr
