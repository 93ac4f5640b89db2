"""An attitude series that gives the initial attitude is compared with the rates beside it."""

import re

import numpy as np
import pytest
from make.tables import write_rates

from quatprop import AttitudeSeries, GyroSeries, compare, propagate
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import (
    conjugate,
    exp,
    from_matrix,
    geodesic_angle,
    multiply,
    normalize,
    rotate,
)

HZ, SECOND = 200, 1_000_000_000
CODES = (
    *("other-axes", "inverse-orientation", "rates-contradict", "rates-off-scale"),
    *("q0-settles-later", "q0-of-several-bodies", "q0-constant", "q0-without-tilt"),
)


def motion(rng, seconds=40, rest=4, peak=1.0):
    """Return rates of a body that rests, and then swings and turns."""
    t_s = np.arange(seconds * HZ) / HZ
    sines = [
        np.sin(2 * np.pi * rng.uniform(0.1, 0.9, 3) * t_s[:, None] + rng.uniform(0, 6, 3))
        for _ in range(3)
    ]
    rate = np.clip(t_s - rest, 0, 1)[:, None] * peak * sum(sines)
    return GyroSeries(np.round(t_s * SECOND).astype(np.int64), rate)


def recorded(gyro, rng, *, hz=100, noise=1e-3):
    """Return attitudes of the same body, at stamps of their own."""
    true = attitudes(gyro.t_ns, gyro.rate, q0=exp([0.2, -0.1, 0.9]), method="mean")[:: HZ // hz]
    wxyz = multiply(true, exp(rng.normal(0, noise, (len(true), 3))))
    return AttitudeSeries(gyro.t_ns[:: HZ // hz], normalize(wxyz))


def told(gyro, series, **settings):
    """Return the remarks that contradict q0, by their code, and the attitudes."""
    found = propagate(gyro, q0=series, **settings)
    return {one.code: str(one) for one in found.report.remarks if one.code in CODES}, found


def other(series, wxyz, t_ns=None):
    """Return other attitudes at these or other times."""
    return AttitudeSeries(series.t_ns if t_ns is None else t_ns, wxyz)


pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
MOUNT = from_matrix(mounting("y,-x,z"))


@pytest.mark.parametrize("start", ["+0s", "+2s", "+11.113s"])
@pytest.mark.parametrize("hz", [20, 100])
@pytest.mark.parametrize("seed", range(4))
def test_attitudes_of_another_clock_rate_with_noise_and_bias_are_not_remarked_on(seed, hz, start):
    """Stamps between those of the rates, noise of a filter, a bias, an arbitrary heading."""
    rng = np.random.default_rng(seed)
    gyro = motion(rng, peak=rng.choice([0.05, 0.5, 3.0]))
    series = recorded(gyro, rng, hz=hz, noise=rng.choice([0, 1e-3, 0.02]))
    biased = gyro.with_rate(gyro.rate + rng.normal(0, 0.02, 3))
    shifted = AttitudeSeries(series.t_ns - 1_234_567, series.wxyz)
    assert told(biased, shifted, start=start)[0] == {}


@pytest.mark.parametrize("given", [None, "-y,x,z", "0.6,0,0.8,0"])
def test_attitudes_in_other_axes_name_the_mounting_that_makes_them_agree(given):
    """A rigid body of a tracker 90 deg off the sensor: 90 deg, unsaid; the remedy is applied."""
    rng = np.random.default_rng(1)
    gyro = motion(rng)
    true = recorded(gyro, rng)
    sensor = true.wxyz
    if given == "0.6,0,0.8,0":
        sensor = multiply(sensor, conjugate([0.6, 0, 0.8, 0]))
    series = other(true, multiply(sensor, conjugate(MOUNT)))
    said, _ = told(gyro, series, mount=given)
    text = said["other-axes"]
    assert re.match("the rates contradict the orientation of q0, by up to .* deg: they agree", text)
    mount = re.search("with mount=(.+)$", text)[1].strip("'")
    said, found = told(gyro, series, mount=mount, method="mean")
    assert said == {}
    assert geodesic_angle(found.wxyz[::2], series.wxyz).max() < 0.02


def test_inverse_attitudes_are_remarked_on():
    """From reference to body, instead of from body to reference."""
    rng = np.random.default_rng(1)
    gyro = motion(rng)
    series = recorded(gyro, rng)
    said, _ = told(gyro, other(series, conjugate(series.wxyz)))
    assert "agree with its inverse" in said["inverse-orientation"]


@pytest.mark.parametrize("late_s", [-7, 7, 18])
@pytest.mark.parametrize("seed", range(3))
def test_attitudes_on_a_clock_off_by_seconds_contradict_the_rates(seed, late_s):
    """The initial attitude was that of another time, unsaid: 107 to 159 deg."""
    rng = np.random.default_rng(seed)
    gyro = motion(rng, seconds=90)
    series = recorded(gyro, rng)
    late = other(series, series.wxyz, series.t_ns + late_s * SECOND)
    said, found = told(gyro, late, start="+20s")
    assert said["rates-contradict"].endswith(
        " deg: are both of the same body, on the same clock? quatprop crosscheck finds a constant "
        "rotation between them or a short delay, quatprop compare of the result with them also one "
        "of many seconds"
    )
    (delay,) = re.findall(r"B is (\S+) s .*(?:late|early)", str(compare(found, late)))
    assert abs(float(delay) - abs(late_s)) < 0.01


@pytest.mark.parametrize("fault", ["frozen", "settling"])
@pytest.mark.parametrize("seed", range(3))
def test_attitudes_that_agree_only_later_name_the_time(seed, fault):
    """A tracker repeats its last attitude, or a filter converges: the remedy is applied."""
    rng = np.random.default_rng(seed)
    gyro = motion(rng)
    series = recorded(gyro, rng)
    t_s, wxyz = series.t_ns / SECOND, series.wxyz.copy()
    if fault == "frozen":
        start = "+12s"
        wxyz[(t_s >= 8) & (t_s < 14)] = wxyz[t_s == 8]
    else:
        start = "+0s"
        wxyz = multiply(exp(np.exp(-t_s)[:, None] * [0.0, 0.4, 1.4]), wxyz)
    spoilt = other(series, wxyz)
    text = told(gyro, spoilt, start=start)[0]["q0-settles-later"]
    start = re.search(r"begin where they agree, with start=(.+)$", text)[1].strip("'")
    said, found = told(gyro, spoilt, start=start, method="mean")
    assert said == {}
    since = np.isin(series.t_ns, found.t_ns)
    same = found.wxyz[np.isin(found.t_ns, series.t_ns)]
    assert np.degrees(geodesic_angle(same, series.wxyz[since]).max()) < 2


@pytest.mark.parametrize("bodies", [2, 3])
def test_attitudes_of_several_bodies_by_turns_are_remarked_on(bodies):
    """A pose topic of two bodies: the initial attitude was between them, 71.5 deg off."""
    rng = np.random.default_rng(2)
    gyro = motion(rng)
    series = recorded(gyro, rng)
    wxyz = series.wxyz.copy()
    for body in range(1, bodies):
        wxyz[body::bodies] = multiply(exp([0, 0, 1.5 * body]), exp([0.1, 0, 0]))
    said, _ = told(gyro, other(series, wxyz), start="+10.003s")
    assert f": that of {bodies} bodies? the initial attitude is " in said["q0-of-several-bodies"]


LEVEL = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
"""Shares of the rates about x, y, z: a body that tumbles, and one that turns on level ground."""


def heading_of(series):
    """Return attitudes without roll and pitch, as planar odometry has them."""
    x, y, _ = rotate(series.wxyz, [1.0, 0.0, 0.0]).T
    return other(series, exp(np.arctan2(y, x)[:, None] * [0, 0, 1.0]))


@pytest.mark.parametrize("wxyz", [[0.6, 0, 0, 0.8], [0.5, 0.5, 0.5, 0.5]])
@pytest.mark.parametrize("share", LEVEL.tolist())
def test_an_orientation_that_stays_the_same_while_the_body_turns_is_remarked_on(wxyz, share):
    """Only the identity was refused as a placeholder."""
    gyro = motion(np.random.default_rng(3))
    gyro = gyro.with_rate(gyro.rate * share)
    constant = AttitudeSeries(gyro.t_ns[::4], np.tile(wxyz, (len(gyro) // 4, 1)))
    said, _ = told(gyro, constant)
    assert re.fullmatch(
        r"the orientation of q0 is the same 2000 times, while the body turns by up to .* deg in a "
        r"second: a placeholder, not an attitude\?",
        said["q0-constant"],
    )


@pytest.mark.parametrize("bias", [0.0, 0.08])
def test_an_orientation_that_stays_the_same_at_rest_is_not_remarked_on(bias):
    """Whatever the bias; of a filter that does not move below a limit."""
    gyro = motion(np.random.default_rng(3), peak=0.01)
    constant = AttitudeSeries(gyro.t_ns[::4], np.tile([0.6, 0, 0, 0.8], (len(gyro) // 4, 1)))
    assert told(gyro.with_rate(np.add(gyro.rate, [bias, 0, 0])), constant)[0] == {}


def test_headings_of_a_body_that_rolls_and_pitches_are_remarked_on():
    """An odometry in the plane: its initial attitude has no tilt, unsaid."""
    gyro = motion(np.random.default_rng(4), peak=0.3)
    true = recorded(gyro, np.random.default_rng(4), noise=0)
    said, _ = told(gyro, heading_of(true))
    assert (
        " is a heading, without roll and pitch, and the body turns by " in said["q0-without-tilt"]
    )
    assert told(gyro, true)[0] == {}


@pytest.mark.parametrize(("slope", "is_said"), [(3.0, False), (9.0, False), (11.0, True)])
@pytest.mark.parametrize("down", [1, -1])
def test_headings_of_a_body_on_a_slope_are_remarked_on_by_its_accelerometer(
    tmp_path, slope, is_said, down
):
    """The attitude by gravity with the heading that is named is the right one."""
    rng = np.random.default_rng(5)
    gyro = motion(rng, peak=0.5)
    tilt = multiply(exp([0, 0, 0.7]), exp([0, np.radians(slope), 0]))
    gyro = gyro.with_rate(gyro.rate * [0, 0, 1])
    true = AttitudeSeries(gyro.t_ns, attitudes(gyro.t_ns, gyro.rate, q0=tilt))
    force = rotate(conjugate(tilt), [0, 0, 9.8 * down]) + rng.normal(0, 0.02, (len(gyro), 3))
    columns = np.c_[gyro.t_ns, gyro.rate, force]
    rows = [[int(row[0]), *row[1:]] for row in columns.tolist()]
    log = write_rates(tmp_path / "log.csv", rows, "t_ns,wx,wy,wz,accel_x,accel_y,accel_z")
    said, _ = told(log, heading_of(true), rate_unit="rad/s")
    assert set(said) == ({"q0-without-tilt"} if is_said else set())
    if is_said:
        assert f" tilted by {slope:.2g}" in said["q0-without-tilt"]
        heading = re.search(r" and heading='?([\d.]+)'?;", said["q0-without-tilt"])[1]
        found = propagate(
            log,
            q0="level",
            heading=float(heading),
            rate_unit="rad/s",
            reference_z="up" if down > 0 else "down",
        )
        assert geodesic_angle(found.wxyz[0], tilt) < 5e-3
