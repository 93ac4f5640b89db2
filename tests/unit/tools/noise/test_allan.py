"""Overlapping Allan variance, in batches and pieces, and how far it scatters."""

import numpy as np
import pytest
from make.gyro_noise import HZ, Truth, rates
from scipy.special import ndtri

from quatprop.tools.allan import OVERLAP, AllanSums, covariances

RUNS = 400
CONFIDENCE = 1e-3


def sums_of(*pieces, batch=1000):
    """Return the sums over pieces, ``(N, 3)``, that come in batches."""
    sums = AllanSums()
    for piece in pieces:
        sums.begin_piece()
        for start in range(0, len(piece), batch):
            sums.add(piece[start : start + batch])
    return sums


def by_definition(m, *pieces):
    """Return half the mean square of what neighbouring averages over m samples differ by."""
    squares = []
    for piece in pieces:
        windows = np.lib.stride_tricks.sliding_window_view(piece, m, axis=0).mean(axis=-1)
        squares.append((windows[m:] - windows[:-m]) ** 2)
    return np.concatenate(squares).mean(axis=0) / 2


@pytest.mark.parametrize("batch", [1, 7, 1000, 5000])
def test_it_is_the_overlapping_variance_however_samples_arrive(batch):
    """Pieces are independent of each other, and are read in batches."""
    random = np.random.default_rng(1)
    pieces = [random.standard_normal((n, 3)) + 5 for n in (700, 3, 90, 1)]
    m, variances = sums_of(*pieces, batch=batch).variances()
    assert m.tolist() == [1, 2, 4, 8, 16, 32, 64, 128, 256][: len(m)]
    assert len(m) == 8
    for each, variance in zip(m[m <= OVERLAP], variances, strict=False):
        long = [piece for piece in pieces if len(piece) >= 2 * each]
        np.testing.assert_allclose(variance, by_definition(each, *long), rtol=1e-10)


def test_long_averages_overlap_often_enough():
    """Those that begin at every sixteenth of them differ from all by far less than they scatter."""
    random = np.random.default_rng(2)
    noise = rates(Truth(N=1e-4, K=1e-4), 6000, random)
    m, variances = sums_of(noise).variances()
    freedoms = 6000 / m
    for each, variance, free in zip(m, variances, freedoms, strict=True):
        exact = by_definition(each, noise)
        assert (np.abs(variance / exact - 1) < 0.35 * np.sqrt(2 / free)).all()


def test_a_ramp_has_its_closed_form():
    """R tau / sqrt(2), at all times and to the last digits: nothing of it is random."""
    truth = Truth(R=3e-6)
    m, variances = sums_of(rates(truth, 10_000, np.random.default_rng(3))).variances()
    exact = truth.deviation(m / HZ)
    np.testing.assert_allclose(np.sqrt(variances), np.repeat(exact[:, None], 3, axis=1), rtol=1e-6)


TRUTHS = {
    "white": Truth(N=1.7e-4),
    "random walk": Truth(K=2e-5),
    "quantised": Truth(Q=1e-6),
    "mixed": Truth(Q=1e-6, N=1e-5, K=3e-5),
    "warming up": Truth(N=1e-5, R=1e-4),
}


@pytest.fixture(scope="module", params=TRUTHS)
def runs(request):
    """Return a truth, averaging times, and the variances of many runs of two pieces."""
    truth, random = TRUTHS[request.param], np.random.default_rng(4)
    found = []
    for _ in range(-(-RUNS // 3)):
        sums = sums_of(rates(truth, 900, random), rates(truth, 300, random))
        m, variances = sums.variances()
        found.append(variances.T)
    return truth, m, np.concatenate(found), sums.lengths


def test_deviations_have_their_closed_forms(runs):
    """N / sqrt(tau), K sqrt(tau / 3), sqrt(3) Q / tau: the mean of many runs, in its band."""
    truth, m, variances, _ = runs
    error = variances.std(axis=0) / np.sqrt(len(variances))
    apart = (variances.mean(axis=0) - truth.deviation(m / HZ) ** 2) / error
    assert np.abs(apart).max() < -ndtri(CONFIDENCE / 2 / len(m) / len(TRUTHS))


def test_the_scatter_of_deviations_agrees_with_their_covariance(runs):
    """The variance of each over the runs, and the correlations between them."""
    truth, m, variances, lengths = runs
    found = covariances(m, lengths)
    terms = np.array([(truth.Q * HZ) ** 2, truth.N**2 * HZ, truth.B**2, truth.K**2 / HZ])
    terms = np.append(terms, (truth.R / HZ) ** 2)
    np.testing.assert_allclose(found.laws @ terms, truth.deviation(m / HZ) ** 2)
    covariance = found.for_terms(terms)
    single = variances.var(axis=0, ddof=1) / covariance.diagonal()
    # A variance of few degrees of freedom scatters in its own scatter: by the kurtosis of its run.
    kurtosis = 3 + 12 / (2 * (found.laws @ terms) ** 2 / covariance.diagonal())
    band = -ndtri(CONFIDENCE / 2 / len(m) / len(TRUTHS)) * np.sqrt((kurtosis - 1) / len(variances))
    assert (np.abs(single - 1) < band).all()
    scales = np.sqrt(covariance.diagonal())
    seen = np.corrcoef(variances.T)
    expected = covariance / np.outer(scales, scales)
    room = -ndtri(CONFIDENCE / 2 / len(m) ** 2 / len(TRUTHS)) * 1.6 / np.sqrt(len(variances))
    assert np.abs(seen - expected).max() < room
