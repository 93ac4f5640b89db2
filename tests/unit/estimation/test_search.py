"""The search finds offset, rotation and mirrors of one motion, and says when several fit."""

import numpy as np
import pytest
from make.calibrations import motion

from quatprop import AttitudeSeries, GyroSeries
from quatprop.estimation.cells import cells_of_attitudes, cells_of_rates
from quatprop.estimation.covariances import kabsch
from quatprop.estimation.search import candidate_at, search, search_series
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, multiply, rotation_matrix

HZ = 100
TURN = exp([0.3, -1.2, 0.5])


def recorded(rate, wxyz, *, late_s=0.0, noise=0.02, seed=1):
    """Return rates of a mounted, noisy gyroscope, and the reference with a late clock."""
    t_ns = np.arange(len(rate)) * (10**9 // HZ)
    raw = rate @ rotation_matrix(TURN) + 0.01
    raw += noise * np.random.default_rng(seed).normal(size=raw.shape)
    return GyroSeries(t_ns, raw), AttitudeSeries(t_ns + round(late_s * 1e9), wxyz)


def of_motion(**options):
    """Return both series of a motion about all axes."""
    _, rate, wxyz = motion()
    every = slice(None, None, 20)
    return recorded(rate[every], wxyz[every], **options)


def of_gait(hertz=1.0, seconds=40, **options):
    """Return both series of a motion that repeats itself exactly."""
    phase = 2 * np.pi * hertz * np.arange(seconds * HZ) / HZ
    rate = np.stack([np.sin(phase), 0.5 * np.sin(2 * phase), 0.3 * np.cos(2 * phase)], axis=1)
    t_ns = np.arange(len(rate)) * (10**9 // HZ)
    return recorded(rate, attitudes(t_ns, rate, method="cubic"), **options)


@pytest.mark.parametrize("late_s", [0.0, -0.3, 5.0, 3000.0])
def test_offset_and_mounting_are_found_at_any_lag(late_s):
    """The clocks may begin anywhere; to a tenth of a cell and a degree."""
    found = search_series(*of_motion(late_s=late_s))
    assert found.is_found
    assert not found.is_mirrored
    best = found.candidates[0]
    assert best.offset_ns == pytest.approx(-late_s * 1e9, abs=0.1 * found.cell_ns)
    apart = rotation_matrix(TURN).T @ best.turn
    assert np.degrees(np.arccos((np.trace(apart) - 1) / 2)) < 1


@pytest.mark.parametrize("axis", range(3))
def test_a_mirrored_axis_is_found(axis):
    """No rotation undoes the sign of one axis."""
    rates, reference = of_motion(late_s=1.0)
    mirror = np.eye(3)
    mirror[axis, axis] = -1
    found = search_series(GyroSeries(rates.t_ns, rates.rate @ mirror), reference)
    assert found.is_mirrored
    np.testing.assert_allclose(found.candidates[0].turn, rotation_matrix(TURN) @ mirror, atol=0.02)


@pytest.mark.parametrize("hertz", [0.7, 1.0, 1.37])
@pytest.mark.parametrize("noise", [1e-4, 0.02])
def test_a_motion_that_repeats_itself_has_no_offset(hertz, noise):
    """Every period fits: the offset is not found, whatever its period is in cells."""
    found = search_series(*of_gait(hertz, late_s=0.1, noise=noise))
    assert found.is_repeating
    assert not found.is_found


def test_several_periods_are_listed():
    """They fit equally: those a period apart stand next to the best one."""
    found = search_series(*of_gait(late_s=0.1))
    offsets_s = np.array([one.offset_ns for one in found.candidates]) / 1e9
    assert len(offsets_s) > 2
    np.testing.assert_allclose(offsets_s + 0.1, np.round(offsets_s + 0.1), atol=5e-3)


@pytest.mark.parametrize("seed", range(6))
def test_unrelated_motions_have_no_offset(seed):
    """Smooth motions agree somewhere by chance, more than white noise does."""
    random, t_s = np.random.default_rng(seed), np.arange(60 * HZ) / HZ
    both = []
    for _ in range(2):
        phases = 2 * np.pi * random.uniform(0.05, 1, (20, 1, 3)) * t_s[:, None]
        both.append(np.sin(phases + random.uniform(0, 6, (20, 1, 3))).sum(axis=0) / 5)
    t_ns = np.arange(len(t_s)) * (10**9 // HZ)
    found = search_series(GyroSeries(t_ns, both[0]), AttitudeSeries(t_ns, attitudes(t_ns, both[1])))
    assert not found.is_found
    assert not found.is_repeating


@pytest.mark.parametrize("still", [0.0, 1.0])
def test_rest_and_a_steady_spin_have_no_offset(still):
    """Noise alone changes."""
    random, t_ns = np.random.default_rng(3), np.arange(4000) * (10**9 // HZ)
    rate = np.tile([0.0, 0.3 * still, still], (len(t_ns), 1))
    wxyz = multiply(attitudes(t_ns, rate), exp(1e-3 * random.normal(size=rate.shape)))
    found = search_series(
        GyroSeries(t_ns, rate + 1e-3 * random.normal(size=rate.shape)), AttitudeSeries(t_ns, wxyz)
    )
    assert not found.is_found
    assert not found.is_repeating


def test_what_the_motion_leaves_free_is_as_the_given_mounting():
    """About the only axis of motion nothing turns; upside down is half a turn, and no mirror."""
    covariance = np.diag([0.0, 0.0, 1.0])
    given = rotation_matrix(exp([0, 0, 0.4]))
    np.testing.assert_allclose(kabsch(covariance, given), given, atol=0.01)
    np.testing.assert_allclose(kabsch(-covariance, np.eye(3)), np.diag([1, -1, -1]), atol=1e-12)


def test_outliers_jumps_and_gaps_do_not_hide_the_offset():
    """One attitude in fifty is wrong, the frame jumps, and a second is missing."""
    rates, reference = of_motion(late_s=0.5)
    random, wxyz = np.random.default_rng(2), reference.wxyz.copy()
    wrong = random.choice(len(wxyz), len(wxyz) // 50, replace=False)
    wxyz[wrong] = multiply(wxyz[wrong], exp(random.normal(size=(len(wrong), 3))))
    wxyz[1200:] = multiply(exp([0.0, 0.0, 2.0]), wxyz[1200:])
    keep = np.ones(len(wxyz), bool)
    keep[600:700] = False
    found = search_series(rates, AttitudeSeries(reference.t_ns, wxyz)[keep])
    assert found.is_found
    assert found.candidates[0].offset_ns == pytest.approx(-5e8, abs=1e7)


def test_a_given_offset_has_its_own_rotation():
    """At the right one the best rotation is that of the mounting; outside there is none."""
    rates, reference = of_motion(late_s=0.4)
    a, b = cells_of_rates(rates, 40_000_000), cells_of_attitudes(reference, 40_000_000)
    found = candidate_at(a, b, -400_000_000)
    assert np.linalg.norm(found.turn - rotation_matrix(TURN)) < 0.05
    assert found.score > candidate_at(a, b, 400_000_000).score
    assert candidate_at(a, b, 10**12) is None
    assert search(a, b).rotated[0].score == pytest.approx(found.score, abs=1e-3)


def test_cells_hold_the_mean_rate():
    """Of a constant rate, the rate, whatever the grid of the samples."""
    rate = np.array([0.2, -0.1, 0.3])
    random = np.random.default_rng(5)
    t_ns = np.cumsum(random.integers(5_000_000, 15_000_000, 500))
    series = GyroSeries(t_ns, np.tile(rate, (500, 1)))
    reference = AttitudeSeries(t_ns, attitudes(t_ns, series.rate))
    for cells in (cells_of_rates(series, 70_000_000), cells_of_attitudes(reference, 70_000_000)):
        assert cells.known.all()
        np.testing.assert_allclose(cells.rate, np.tile(rate, (len(cells), 1)), atol=1e-9)
