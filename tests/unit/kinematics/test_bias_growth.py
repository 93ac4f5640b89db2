"""The error of a bias that is known from rests, against the sum over all pairs of samples."""

from itertools import pairwise, product

import numpy as np
import pytest
from make.motion import FRAMES, simulated

from quatprop.kinematics.matrix_elements import TILE
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import rotation_matrix
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.uncertainty import ErrorGrowth, RestErrors, SensorErrors
from quatprop.tools.simulation import MOTIONS

COUNT, INTERVAL_NS = 401, 25_000_000
H = INTERVAL_NS / 1e9
RESTS = np.array([[60, 100], [180, 199], [300, 330]])
"""First and last samples of the rests."""
SIGMA, WALK = np.array([3e-4, 6e-4, 2e-4]), np.array([5e-4, 3e-4])


def rests(fault, *, interpolated):
    """Return what is known from the rests."""
    first, end = (RESTS * INTERVAL_NS).T
    return RestErrors(first, end, fault * SIGMA, fault * WALK, interpolated)


def kernel(t, *, interpolated):
    """Return the covariance of the error of the bias at any two times, s, by its definition."""
    first, last = RESTS.T * H
    beyond = np.sqrt((WALK**2 * (first[1:] - last[:-1])).sum() / (first[1:] - last[:-1]).sum())
    total = of_walk(beyond, (-1.0, first[0]), "until", t)
    total += of_walk(beyond, (last[-1], 99.0), "since", t)
    for begin, end, walk in zip(last, first[1:], WALK, strict=False):
        if interpolated:
            total += of_walk(walk, (begin, end), "between", t)
        else:
            total += of_walk(walk, (begin, (begin + end) / 2), "since", t)
            total += of_walk(walk, ((begin + end) / 2, end), "until", t)
    for k, sigma in enumerate(SIGMA):
        if interpolated:
            shape = np.interp(t, np.ravel(RESTS * H), np.repeat(np.eye(3)[k], 2))
        else:
            middles = [(a[1] + b[0]) / 2 * H for a, b in pairwise(RESTS)]
            shape = np.searchsorted(middles, t) == k
        total += sigma**2 * np.outer(shape, shape)
    inside = ((t[:, None] > first) & (t[:, None] < last)).any(axis=1)
    total[inside] = total[:, inside] = 0.0
    return total


def of_walk(walk, ends, kind, t):
    """Return the covariance of a random walk that is known to be zero at one end, or both."""
    (begin, end), early, late = ends, np.minimum.outer(t, t), np.maximum.outer(t, t)
    inside = (early > begin) & (late < end)
    size = {
        "since": early - begin,
        "until": end - late,
        "between": (early - begin) * (end - late) / (end - begin),
    }[kind]
    return walk**2 * np.where(inside, size, 0.0)


def predicted(motion, frame, fault=1.0, *, interpolated):
    """Return the attitudes, and the covariances that are predicted of them."""
    t_ns, rate = simulated(motion, frame, COUNT, INTERVAL_NS)
    wxyz = attitudes(t_ns, rate, method="mean", rates=frame)
    known = rests(fault, interpolated=interpolated)
    growth = ErrorGrowth(SensorErrors(bias_sigma=fault * 6e-4), frame, "mean", rests=known)
    return wxyz, growth.advance(GyroSeries(t_ns, rate), wxyz)[50::50], growth


def by_pairs(wxyz, frame, *, interpolated):
    """Return the covariances by all pairs of samples."""
    turn = rotation_matrix(wxyz)
    turn = turn if frame == "body" else turn.swapaxes(1, 2)
    steps = (turn[1:] + turn[:-1]) / 2 * H
    cov = kernel((np.arange(COUNT - 1) + 0.5) * H, interpolated=interpolated)
    fixed = [
        np.einsum("kij,kl,lmj->im", steps[:n], cov[:n, :n], steps[:n], optimize=True)
        for n in range(50, COUNT, 50)
    ]
    to_body = turn[50::50] if frame == "body" else np.eye(3)
    return to_body.swapaxes(-1, -2) @ fixed @ to_body


@pytest.mark.thorough
@pytest.mark.parametrize(("motion", "frame"), list(product(MOTIONS, FRAMES)))
@pytest.mark.parametrize("interpolated", [False, True])
def test_the_error_of_a_bias_that_is_known_from_rests(motion, frame, interpolated):
    """To 1 % of the largest number of each covariance; 5 % too many or too few are found."""
    wxyz, found, growth = predicted(motion, frame, interpolated=interpolated)
    expected = by_pairs(wxyz, frame, interpolated=interpolated)
    size = np.abs(expected).max(axis=(1, 2))
    assert (np.abs(found - expected).max(axis=(1, 2)) <= 0.01 * size).all()
    assert sum(growth.variances.values()) == pytest.approx(np.trace(found[-1]), rel=1e-9)
    for fault in (0.95, 1.05):
        _, wrong, _ = predicted(motion, frame, fault, interpolated=interpolated)
        assert (np.abs(wrong - expected).max(axis=(1, 2)) > 0.01 * size).all()


@pytest.mark.parametrize("interpolated", [False, True])
def test_the_same_bits_wherever_batches_end(interpolated):
    """And for the last sample alone, and for the first samples of a log."""
    t_ns, rate = simulated("tumbling", "body", 2 * TILE + 17, INTERVAL_NS)
    wxyz = attitudes(t_ns, rate, method="start", rates="body")
    first = (
        np.array([[10, 200], [TILE - 7, TILE + 100], [2 * TILE + 3, 2 * TILE + 9]]) * INTERVAL_NS
    )
    errors = SensorErrors(1e-3, 3e-4, 1e-4)
    known = RestErrors(*first.T, SIGMA, WALK, interpolated)
    series = GyroSeries(t_ns, rate)
    whole = ErrorGrowth(errors, rests=known).advance(series, wxyz)
    growth = ErrorGrowth(errors, rests=known)
    parts = [
        growth.advance(series[k : k + TILE], wxyz[k : k + TILE]) for k in range(0, len(t_ns), TILE)
    ]
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert (
        ErrorGrowth(errors, rests=known).advance(series, wxyz, to_end=True)[0].tobytes()
        == whole[-1].tobytes()
    )
    count = TILE + 50
    part = ErrorGrowth(errors, rests=known).advance(series[:count], wxyz[:count])
    assert part.tobytes() == whole[:count].tobytes()


@pytest.mark.parametrize("interval", [0, 1])
def test_noise_within_a_rest_is_less_its_mean(interval):
    """N^2 (L - L^2 / T) after the part L of a rest of mean time T, wherever the log begins."""
    t_ns = np.arange(201) * 10_000_000
    series, wxyz = GyroSeries(t_ns, np.zeros((201, 3))), np.tile([1.0, 0, 0, 0], (201, 1))
    for begin in (-50, 0, 40):
        known = RestErrors(*np.array([[begin], [120]]) * 10_000_000, np.zeros(1), np.zeros(0))
        known = known._replace(interval_ns=interval * 10_000_000)
        growth = ErrorGrowth(SensorErrors(noise_density=2e-3), rests=known)
        found = growth.advance(series, wxyz)[:, 0, 0]
        part = np.clip(np.arange(201) - max(begin, 0), 0, 120 - max(begin, 0)) / 100
        before, after = min(max(begin, 0), 200) / 100, np.clip(np.arange(201) - 120, 0, None) / 100
        outside = np.minimum(np.arange(201) / 100, before) + after
        expected = 4e-6 * (outside + part - part**2 / ((120 - begin + interval) / 100))
        np.testing.assert_allclose(found, expected, atol=1e-14)
