"""Attitudes between samples: as good as a rotation spline, and honest about what is left."""

import math
from fractions import Fraction

import numpy as np
import pytest
from make.motion import stamps
from scipy.spatial.transform import Rotation, RotationSpline

from quatprop import AttitudeSeries, compare
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply, slerp
from quatprop.kinematics.resample import interpolate
from quatprop.tools.simulation import Shape, motion_named

FINE_NS = 250_000
LENGTH = 24_001
SHAPE = Shape(Fraction(1))


def band(t_ns):
    """Return rates of 1 rad/s RMS in a band up to 5 Hz, ``(N, 3)``, rad/s."""
    random = np.random.default_rng(1)
    frequency, phase = random.uniform(0.1, 5, 40), random.uniform(0, 2 * np.pi, (3, 40))
    turns = 2 * np.pi * frequency * t_ns[:, None, None] / 1e9 + phase
    return np.cos(turns) @ np.full(40, math.sqrt(2 / 40))


@pytest.fixture(scope="session")
def motions():
    """Return attitudes every 0.25 ms of three motions; the method has no error to speak of."""
    t_ns = np.arange(LENGTH) * FINE_NS
    return t_ns, {
        "band": attitudes(t_ns, band(t_ns), method="quintic"),
        **{
            name: motion_named(name, Shape(Fraction(1)))(t_ns)[1] for name in ("coning", "tumbling")
        },
    }


@pytest.mark.parametrize("name", ["band", "coning", "tumbling"])
@pytest.mark.parametrize("step", [132, 40])
def test_half_way_between_samples_the_error_is_that_of_a_spline_or_less(motions, name, step):
    """30 and 100 Hz. Slerp was off by 0.46 and 0.04 deg in the band up to 5 Hz."""
    t_ns, truth = motions[0], motions[1][name]
    nodes = np.arange(0, LENGTH - step, step)
    middle = nodes[:-1] + step // 2
    series = AttitudeSeries(t_ns[nodes], truth[nodes])
    found = interpolate(series, t_ns[middle])
    errors = geodesic_angle(found.wxyz, truth[middle])
    spline = RotationSpline(t_ns[nodes] / 1e9, Rotation.from_quat(truth[nodes], scalar_first=True))
    of_spline = spline(t_ns[middle] / 1e9).as_quat(scalar_first=True)
    others = geodesic_angle(of_spline, truth[middle])
    inner = slice(4, -4)  # at its ends the spline is worse
    assert errors.max() < others.max() / 5
    assert errors[inner].max() < 1.1 * others[inner].max()
    assert errors.max() < found.interpolation_error_rad < 500 * errors.max()
    assert geodesic_angle(slerp(truth[nodes[:-1]], truth[nodes[1:]], [0.5] * len(middle)),
                          truth[middle]).max() > 10 * errors.max()  # fmt: skip


def test_stamps_that_jitter_cost_little(motions):
    """The polynomial is through the samples where they are."""
    t_ns, truth = motions[0], motions[1]["tumbling"]
    nodes = np.cumsum(np.random.default_rng(2).integers(30, 50, 500))
    series = AttitudeSeries(t_ns[nodes], truth[nodes])
    found = interpolate(series, t_ns[nodes[:-1] + 20])
    assert geodesic_angle(found.wxyz, truth[nodes[:-1] + 20]).max() < 1e-8


def test_signs_and_full_turns_change_nothing():
    """A body that turns by 150 deg between samples, whose quaternions come with either sign."""
    t_ns = stamps(10, 3)
    wxyz = exp(np.array([0.0, 0.0, math.radians(1500)]) * t_ns[:, None] / 1e9)
    wxyz[::3] *= -1
    middle = t_ns[:-1] + 30_000_000
    expected = exp(np.array([0.0, 0.0, math.radians(1500)]) * middle[:, None] / 1e9)
    assert (
        geodesic_angle(interpolate(AttitudeSeries(t_ns, wxyz), middle).wxyz, expected).max() < 1e-12
    )


@pytest.mark.parametrize("count", [2, 5])
def test_few_samples_are_slerp(count):
    """There is no polynomial through six."""
    t_ns = stamps(10, 1)[:count]
    wxyz = exp(np.random.default_rng(3).normal(size=(count, 3)))
    found = interpolate(AttitudeSeries(t_ns, wxyz), t_ns[:-1] + 25_000_000)
    held = slerp(wxyz[:-1], wxyz[1:], [0.25] * (count - 1))
    assert geodesic_angle(found.wxyz, held).max() < 1e-15
    at_samples = interpolate(AttitudeSeries(t_ns, wxyz), t_ns).wxyz
    np.testing.assert_allclose(at_samples, wxyz, rtol=0, atol=4e-16)
    assert (found.interpolation_error_rad == 0) == (count == 2)  # of two samples nothing is known


def test_what_a_constant_rate_leaves_of_a_steady_acceleration_is_known():
    """The angle is ``a t^2 / 2``; after a quarter of the interval h it is off by ``3/32 a h^2``."""
    t_ns = stamps(10, 1)[:5]
    wxyz = exp(np.array([0, 0, 0.7 / 2]) * (t_ns[:, None] / 1e9) ** 2)
    wanted = t_ns[:-1] + 25_000_000
    found = interpolate(AttitudeSeries(t_ns, wxyz), wanted)
    truth = exp(np.array([0, 0, 0.7 / 2]) * (wanted[:, None] / 1e9) ** 2)
    expected = 3 / 32 * 0.7 * 0.1**2
    assert geodesic_angle(found.wxyz, truth) == pytest.approx([expected] * len(wanted))
    assert found.interpolation_error_rad == pytest.approx(expected)


@pytest.mark.parametrize(("deviation", "follows"), [(0.95, True), (1.05, False)])
def test_what_deviates_by_more_than_a_radian_is_held(deviation, follows):
    """The third sample next to an interval is off by six times the change of the rate in it."""
    t_ns = stamps(10, 1)[:7]

    def turned(t_ns):
        return exp(np.array([0, 0, 1]) * np.polyval([deviation / 0.06, 3, 0], t_ns[:, None] / 1e9))

    middle = t_ns[2:4] + 50_000_000
    found = interpolate(AttitudeSeries(t_ns, turned(t_ns)), middle)
    error = geodesic_angle(found.wxyz, turned(middle)).max()
    assert (error < 1e-12) == follows
    assert (found.interpolation_error_rad > error / 2) != follows


def test_a_jump_is_not_smoothed():
    """Next to it the rate is held constant, as of motion that no polynomial follows."""
    t_ns = stamps(100, 1)
    wxyz = np.tile(exp([0.1, 0.2, 0.3]), (len(t_ns), 1))
    wxyz[50:] = multiply(wxyz[50:], exp([0, 0, 1.1]))
    found = interpolate(AttitudeSeries(t_ns, wxyz), t_ns[:-1] + 5_000_000).wxyz
    held = slerp(wxyz[:-1], wxyz[1:], [0.5] * 100)
    assert geodesic_angle(found, held).max() < 1e-15


@pytest.mark.parametrize("name", ["band", "coning", "tumbling"])
def test_a_jump_does_not_spread(motions, name):
    """A correction by 30 deg, as of a filter, cost up to 2.6 deg in two intervals next to it."""
    t_ns, truth = motions[0], motions[1][name].copy()
    truth[8010:] = multiply(exp([0, math.radians(30), 0]), truth[8010:])
    nodes, middle = np.arange(0, LENGTH, 40), np.arange(20, LENGTH, 40)
    found = interpolate(AttitudeSeries(t_ns[nodes], truth[nodes]), t_ns[middle]).wxyz
    errors = geodesic_angle(found, truth[middle])
    assert np.flatnonzero(errors > 1e-5).tolist() == [200]


@pytest.mark.parametrize(("tolerance", "remarked"), [("0.01deg", True), ("5deg", False)])
def test_a_significant_interpolation_error_is_remarked_on(motions, tolerance, remarked):
    """The same motion at other timestamps: all of the error comes from interpolation."""
    t_ns, truth = motions[0], motions[1]["band"]
    a, b = (AttitudeSeries(t_ns[first::132], truth[first::132]) for first in (66, 0))
    found = compare(a, b, tol=tolerance)
    said = [remark for remark in found.remarks if "interpolated" in remark]
    assert bool(said) == remarked
    if remarked:
        limit = float(said[0].split("of about ")[1].split(" deg")[0])
        assert math.degrees(found.error_rad.max) < limit < 0.1
        for share, is_said in ((9, True), (11, False)):
            near = compare(a, b, tol=f"{share * limit}deg")
            assert any("interpolated" in remark for remark in near.remarks) == is_said


@pytest.mark.parametrize("limit", ["rms_tol", "p95_tol", "final_tol", "tol_inclination"])
def test_the_interpolation_error_is_compared_with_every_limit(motions, limit):
    """The remark needed a tolerance."""
    t_ns, truth = motions[0], motions[1]["band"]
    a, b = (AttitudeSeries(t_ns[first::132], truth[first::132]) for first in (66, 0))
    found = compare(a, b, **{limit: "0.01deg"})
    assert any("interpolated" in remark for remark in found.remarks)


@pytest.mark.thorough
@pytest.mark.parametrize(("speed", "step"), [(1, 800), (20, 132)])
@pytest.mark.parametrize("count", [3, 5, 7, 100])
def test_where_the_rate_is_held_constant_the_error_is_stated_too(count, speed, step):
    """There was no remark if samples were too few, or the motion too fast for a polynomial."""
    t_ns = np.arange(count * step + 1) * FINE_NS
    truth = attitudes(t_ns, speed * band(t_ns), method="quintic")
    nodes = np.arange(0, len(t_ns) - step, step)
    found = interpolate(AttitudeSeries(t_ns[nodes], truth[nodes]), t_ns[nodes[:-1] + step // 2])
    worst = geodesic_angle(found.wxyz, truth[nodes[:-1] + step // 2]).max()
    assert worst < 4 * found.interpolation_error_rad
