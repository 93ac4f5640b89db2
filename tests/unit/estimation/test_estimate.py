"""The motion shows every parameter that is stated: simulated motions, faults and clocks."""

import re

import numpy as np
import pytest

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.base.errors import QuatpropError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, rotation_matrix, shorter

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")

HZ, SECONDS = 50, 60
T_S = np.arange(SECONDS * HZ) / HZ
T_NS = np.rint(T_S * 1e9).astype(np.int64)
GYRO, REFERENCE = 2e-3, 5e-4
BIAS = np.array([0.012, -0.02, 0.008])


def band(seed, rms, low=0.05, high=0.8):
    """Return a smooth rate with frequencies between two, Hz, shape ``(N, 3)``."""
    random = np.random.default_rng(seed)
    hertz = random.uniform(low, high, (20, 1, 3))
    waves = np.sin(2 * np.pi * hertz * T_S[:, None] + random.uniform(0, 6, (20, 1, 3)))
    return rms * np.sqrt(2 / 20) * waves.sum(axis=0)


def recorded(rate, *, shown=None, mount=(0.0, 0.0, 0.0), bias=BIAS):
    """Return noisy rates of a mounted gyroscope, and a reference.

    `shown`: rates that the reference shows; None: those of the body
    """
    random = np.random.default_rng(5)
    raw = rate @ rotation_matrix(exp(mount)) + bias + GYRO * random.normal(size=rate.shape)
    wxyz = attitudes(T_NS, rate if shown is None else shown, method="quintic")
    noise = exp(REFERENCE * random.normal(size=rate.shape) * (shown is None))
    return GyroSeries(T_NS, raw), AttitudeSeries(T_NS, multiply(wxyz, noise))


def timed(rates, reference, *, late_s=0.0, ppm=0.0):
    """Return the series with a late clock of the reference, which drifts."""
    late_ns = np.rint((late_s - ppm * 1e-6 * (T_S - T_S.mean())) * 1e9).astype(np.int64)
    return rates, AttitudeSeries(T_NS + late_ns, reference.wxyz)


def pulls(found, *, bias=BIAS, mount=(0.0, 0.0, 0.0), late_s=0.0, ppm=0.0):
    """Return (group, axis) -> error in standard deviations, of all that is stated."""
    turn = log(shorter(multiply(found.mount_wxyz, conjugate(exp(mount)))))
    errors = {"bias": found.bias_rad_s - bias, "mount": turn}
    stated = {}
    for one in found.parameters:
        if one.sigma is not None:
            truth = {"offset": -late_s, "drift": ppm * 1e-6}.get(one.group, 0.0)
            k = "xyz".find(one.axis or " ")
            error = errors[one.group][k] if one.group in errors else one.value - truth
            stated[one.group, one.axis] = error / one.sigma
    return stated


def largest(stated):
    """Return the largest error in standard deviations."""
    return max(map(abs, stated.values()))


MOTIONS = {
    "one axis": band(2, 0.7) * [0, 1, 0],
    "two axes": band(3, 0.7) * [1, 1, 0],
    "rest": np.zeros((len(T_S), 3)),
    "spin": np.tile([0.3, -0.4, 0.8], (len(T_S), 1)),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_stated_values_are_true(name):
    """Scale and bias about one axis, for example, or mounting and offset of a spin."""
    found = quatprop.calibrate(*recorded(MOTIONS[name]))
    assert largest(pulls(found)) < 4.5


def test_a_steady_spin_determines_neither_bias_nor_scale_along_it():
    """One trades for the other, and the trade is named."""
    rate = np.tile([0.0, 0.0, 1.0], (len(T_S), 1))
    found = quatprop.calibrate(*recorded(rate))
    stated = pulls(found)
    assert ("offset", "") not in stated
    assert any("bias z and scale z: 1 % trades for" in text for text in found.valleys)
    sigma = {(one.group, one.axis): one.sigma for one in found.parameters}
    assert sigma["bias", "z"] is None or sigma["bias", "z"] > 0.5 * 0.01


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_a_planar_reference_does_not_make_the_rates_planar(share):
    """It was a scale of -100 %, or -90 %, with a file that took roll and pitch away."""
    rate = band(4, 0.3, 0.02, 0.4) * [0, 0, 1] + band(5, 0.03, 0.8, 4) * [1, 1, 0]
    found = quatprop.calibrate(*recorded(rate, shown=rate * [share, share, 1]))
    stated = pulls(found)
    assert ("scale", "x") not in stated
    assert ("scale", "y") not in stated
    assert ("scale", "z") in stated
    assert largest(stated) < 4.5
    assert np.abs(np.linalg.svd(found.matrix)[1] - 1).max() < 0.05


def heading_only(tilt=0.15):
    """Return rates of a body that tilts while it turns, and the heading alone.

    `tilt`: RMS of roll and of pitch, rad
    """
    roll, pitch, _ = (tilt / 0.15 * band(11, 0.15)).T
    yaw = np.cumsum(band(12, 0.4, 0.02, 0.4)[:, 2]) / HZ
    heading = exp(np.stack([0 * yaw, 0 * yaw, yaw], axis=1))
    wxyz = heading
    for axis, angle in ((1, pitch), (0, roll)):
        wxyz = multiply(wxyz, exp(angle[:, None] * np.eye(3)[axis]))
    turns = log(shorter(multiply(conjugate(wxyz[:-1]), wxyz[1:]))) * HZ
    # The means over the intervals before and after a sample.
    rate = np.concatenate([turns[:1], (turns[1:] + turns[:-1]) / 2, turns[-1:]])
    noise = GYRO * np.random.default_rng(6).normal(size=rate.shape)
    return GyroSeries(T_NS, rate + BIAS + noise), AttitudeSeries(T_NS, heading)


@pytest.mark.parametrize("late_s", [0.0, 45.0])
def test_a_heading_alone_determines_only_rotations_about_its_axis(late_s):
    """Mountings were off by 60 deg, and biases about the other axes by 3 sigma."""
    found = quatprop.calibrate(*timed(*heading_only(), late_s=late_s))
    stated = pulls(found, late_s=late_s)
    assert set(stated) <= {("bias", "z"), ("scale", "z"), ("offset", ""), ("drift", "")}
    assert ("bias", "z") in stated
    assert largest(stated) < 4.5
    assert found.mount_wxyz == pytest.approx([1, 0, 0, 0], abs=1e-6)
    named = [one for one in found.remarks if one.code == "reference-axis"]
    assert len(named) == 2
    assert all("turns about (0.00, 0.00, 1.00) of its own frame alone" in one for one in named)


def test_noise_of_the_rates_does_not_bias_the_scale():
    """With quiet motion and a noisy gyroscope, each scale was 0.3 % too small: nearly a sigma.

    Noise of either sign, whose other errors are opposite: what is left of the mean is of its power,
    which of one seed scatters by 0.15 %.
    """
    errors = []
    for seed in range(8):
        rate = band(20 + seed, 0.05)
        noise = 0.012 * np.random.default_rng(seed).normal(size=rate.shape)
        _, reference = recorded(rate)
        for signed in (noise, -noise):
            found = quatprop.calibrate(GyroSeries(T_NS, rate + signed), reference)
            errors += [one.value for one in found.parameters if one.group == "scale"]
    assert abs(np.mean(errors)) < 5e-4


def test_the_clock_is_not_that_of_a_rotation_that_is_not_followed():
    """Pitching moves a part of the yaw to the x axis, where the errors are small.

    Over short windows, the offset was off by 11 ms.
    """
    rate = band(4, 0.4, 0.02, 0.5) * [0, 0, 1] + band(5, 0.05, 0.3, 4) * [0, 1, 0]
    rates, reference = recorded(rate, shown=rate * [0, 0, 1])
    heading = exp(0.002 * np.random.default_rng(8).normal(size=(len(T_S), 1)) * [0, 0, 1])
    noisy = AttitudeSeries(T_NS, multiply(reference.wxyz, heading))
    quiet = GyroSeries(T_NS, rate + BIAS + 0.05 * (rates.rate - rate - BIAS))
    found = quatprop.calibrate(quiet, noisy, window="100ms")
    assert largest(pulls(found)) < 4.5
    assert abs(found.time_offset_ns) < 5e6


def test_a_sensor_upside_down_is_mounted_so():
    """It was a scale of -200 %, which is no rotation."""
    rate = band(4, 0.5) * [0, 0, 1]
    found = quatprop.calibrate(*recorded(rate, mount=(np.pi, 0, 0)))
    assert np.linalg.det(found.matrix) == pytest.approx(1, abs=0.05)
    assert largest(pulls(found, mount=(np.pi, 0, 0))) < 4.5


def test_a_mirrored_axis_is_reported_and_not_written(tmp_path):
    """It was a scale of -200 %."""
    rates, reference = recorded(band(1, 0.7))
    found = quatprop.calibrate(GyroSeries(T_NS, rates.rate * [1, -1, 1]), reference)
    said = "the axes of the log are left-handed: y has the wrong sign"
    assert any(said in remark for remark in found.remarks)
    scales = [one.value for one in found.parameters if one.group == "scale"]
    assert np.abs(scales).max() < 0.01
    with pytest.raises(QuatpropError, match="which no calibration corrects"):
        found.write(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (180 / np.pi, "the rates of the log are 57.3 times as large as .* rate_unit='deg/s'"),
        (0.061, "times as large as the rotation of the reference; check their unit"),
    ],
)
def test_another_unit_is_suspected(factor, said):
    """It was a scale of -98 %."""
    rates, reference = recorded(band(1, 0.5))
    with pytest.raises(QuatpropError, match=said):
        quatprop.calibrate(GyroSeries(T_NS, rates.rate * factor), reference)


@pytest.mark.parametrize(("late_s", "ppm"), [(0.012, 0.0), (-4.0, -300.0), (37.005, 50.0)])
def test_offset_and_drift_of_the_clock_are_found(late_s, ppm):
    """A drift made others look unshown; and only what the coarse search left was printed."""
    found = quatprop.calibrate(*timed(*recorded(band(1, 0.7)), late_s=late_s, ppm=ppm))
    stated = pulls(found, late_s=late_s, ppm=ppm)
    assert largest(stated) < 4.5
    assert len(stated) == 14
    assert found.time_offset_ns == pytest.approx(-late_s * 1e9, abs=1e6)
    printed = next(line for line in str(found).splitlines() if line.startswith("offset"))
    assert float(printed.split()[1]) == pytest.approx(-late_s * 1e3, abs=1)


@pytest.mark.parametrize("shape", ["jump", "ramp"])
def test_a_bias_that_changes_is_reported(shape):
    """One bias was stated, with the standard deviation of a constant one."""
    after = {"jump": T_S > 25.0, "ramp": T_S / SECONDS}[shape][:, None] * np.radians([1, -2, 1])
    rates, reference = recorded(band(1, 0.7))
    found = quatprop.calibrate(GyroSeries(T_NS, rates.rate + after), reference)
    assert any("the bias is not constant" in remark for remark in found.remarks)
    stated = pulls(found, bias=BIAS + after.mean(axis=0))
    assert largest(stated) < 4.5
    sigma = [one.sigma for one in found.parameters if one.group == "bias"]
    assert (np.array(sigma) > 0.2 * np.radians([1, 2, 1])).all()
    if shape == "jump":
        after_s = re.search(r"([\d.]+) s after the first sample", " ".join(found.remarks))[1]
        assert float(after_s) == pytest.approx(25, abs=0.5)


def test_parts_between_jumps_of_the_bias_have_biases_of_their_own():
    """As the remark says: over the whole, the mean is worse than theirs, and than the first's."""
    after = (T_S > 25.0)[:, None] * np.radians([1, -2, 1])
    rates, reference = recorded(band(1, 0.7))
    log = GyroSeries(T_NS, rates.rate + after)
    (remark,) = (one for one in quatprop.calibrate(log, reference).remarks if "not constant" in one)
    assert "one by one, with start and end" in remark
    for part, bias in ({"end": "+25s"}, BIAS), ({"start": "+25.1s"}, BIAS + after[-1]):
        found = quatprop.calibrate(log, reference, **part)
        assert not any("not constant" in one for one in found.remarks)
        assert largest(pulls(found, bias=bias)) < 4.5


@pytest.mark.thorough
@pytest.mark.parametrize("motion", ["rich", "rest"])
@pytest.mark.parametrize("share", [0.06, 0.1, 0.5, 0.9, 0.94])
@pytest.mark.parametrize("size", [0.3, 2.0])
def test_a_bias_that_jumps_early_or_late_is_reported(motion, share, size):
    """The few windows before, or after, were outliers: the bias of the others had a small sigma."""
    rate = band(1, 0.7) * (motion == "rich")
    after = (share * SECONDS < T_S)[:, None] * np.radians(size) * np.array([0.4, -0.8, 0.4])
    rates, reference = recorded(rate)
    found = quatprop.calibrate(GyroSeries(T_NS, rates.rate + after), reference)
    assert any("the bias is not constant" in remark for remark in found.remarks)
    assert largest(pulls(found, bias=BIAS + after.mean(axis=0))) < 4.5


def test_a_bias_that_jumps_is_no_rotation_that_the_reference_does_not_follow():
    """Mounted with a tilt, planar motion seemed to be more than that: its scale was off by 7 sigma.

    The jump spoilt the ratio in which the rotation is on two axes of the gyroscope.
    """
    mount = np.radians([6.5, -6.9, 3.2])
    rate = band(4, 0.4, 0.02, 0.3) * [0, 0, 1]
    rates, reference = recorded(rate, mount=mount)
    after = (T_S > 0.21 * SECONDS)[:, None] * np.radians([-0.5, -1.0, -0.6])
    quiet = rate @ rotation_matrix(exp(mount)) + BIAS
    log = GyroSeries(T_NS, quiet + 0.1 * (rates.rate - quiet) + after)
    found = quatprop.calibrate(log, reference)
    assert not any(one.code == "reference-axis" for one in found.remarks)
    stated = pulls(found, bias=BIAS + after.mean(axis=0), mount=mount)
    assert ("mount", "x") in stated
    assert largest(stated) < 4.5


def test_the_gain_of_the_file_is_without_the_clock():
    """A late clock alone: the file, which does not hold it, brings nothing."""
    rates, reference = timed(*recorded(band(1, 0.7), bias=np.zeros(3)), late_s=0.03)
    found = quatprop.calibrate(rates, reference, window="100ms")
    assert found.rms_clock_corrected_rad < 0.2 * found.rms_uncalibrated_rad
    assert (
        abs(found.rms_clock_corrected_rad - found.rms_calibrated_rad)
        < 0.05 * found.rms_clock_corrected_rad
    )
    assert not found.is_better


def test_a_prior_decides_what_is_determined():
    """Half of it is the limit; the standard deviations of the others follow it."""
    rate = np.tile([0.0, 0.0, 1.0], (len(T_S), 1))
    rates, reference = recorded(rate)
    sigmas = []
    for scale in ("0.1%", "1%"):
        prior = f"scale={scale},mount=0.1deg"
        found = quatprop.calibrate(rates, reference, prior=prior, time_offset=0)
        sigmas.append({(one.group, one.axis): one.sigma for one in found.parameters})
    # Of a spin at 1 rad/s, a part in a thousand of the scale is 1e-3 rad/s of the bias.
    assert sigmas[0]["bias", "z"] == pytest.approx(1e-3, rel=0.1)
    assert sigmas[1]["bias", "z"] == pytest.approx(1e-2, rel=0.1)


def test_errors_of_the_integration_are_a_part_of_sigma():
    """A nearly perfect gyroscope, sampled slowly: its scale was off by seven sigma."""
    fine_s = np.arange(SECONDS * HZ * 8) / (HZ * 8)
    hertz = np.random.default_rng(3).uniform(0.1, 3, (12, 1, 3))
    rate = np.sin(2 * np.pi * hertz * fine_s[:, None]).sum(axis=0)
    wxyz = attitudes(np.rint(fine_s * 1e9).astype(np.int64), rate, method="quintic")[::8]
    noise = 1e-4 * np.random.default_rng(4).normal(size=(len(T_S), 3))
    found = quatprop.calibrate(GyroSeries(T_NS, rate[::8] + noise), AttitudeSeries(T_NS, wxyz))
    assert largest(pulls(found, bias=np.zeros(3))) < 4.5
