"""The fit of terms: what is exact stays exact, what follows no slope is left out."""

import numpy as np
import pytest
from make.gyro_noise import HZ, Truth, rates
from scipy.special import chdtri, ndtr, ndtri

from quatprop.tools.allan import AllanSums, TermFit, chi_square, covariances, fit
from quatprop.tools.sensor_noise import terms_of

M = 1 << np.arange(14)
SAMPLES = 3 << 13


@pytest.fixture(scope="module")
def known():
    """Return the covariances of one piece."""
    return covariances(M, [SAMPLES])


TERMS = {
    "white": [0, 1, 0, 0, 0],
    "quantised": [9, 1, 0, 1e-4, 0],
    "nothing but quantised": [9, 0, 0, 0, 0],
    "flicker": [0, 1, 1e-2, 0, 0],
    "random walk": [0, 1, 0, 1e-3, 0],
    "ramp": [0, 1, 0, 0, 1e-6],
}


@pytest.mark.parametrize("name", TERMS)
@pytest.mark.parametrize("scale", [1e-16, 1.0, 1e6])
def test_exact_variances_give_their_terms(known, name, scale):
    """Whatever their size: a tactical gyroscope has 1e-13 of the variance of a toy."""
    terms = scale * np.array(TERMS[name], float)
    found = fit(known.laws @ terms, known)
    assert (found.first, found.has_unexplained_short_term) == (0, False)
    np.testing.assert_allclose(found.terms, terms, rtol=1e-6, atol=1e-3 * found.sigmas.min())
    shown = found.terms >= 2.33 * found.sigmas
    assert shown.tolist() == [term > 0 for term in TERMS[name]]


def test_standard_deviations_are_those_of_generalised_least_squares(known):
    """Those of undetermined terms are as if the terms were as large as their bounds."""
    terms = np.array(TERMS["quantised"], float)
    found = fit(known.laws @ terms, known)
    for term, (size, sigma) in enumerate(zip(terms, found.sigmas, strict=True)):
        at = terms + (size == 0) * ndtri(0.95) * sigma * np.eye(5)[term]
        information = known.laws.T @ np.linalg.solve(known.for_terms(at), known.laws)
        assert sigma**2 == pytest.approx(np.linalg.inv(information)[term, term], rel=0.1)


@pytest.mark.parametrize(("freedoms", "share"), [(1, 0.3), (2, 0.05), (5, 0.01), (50, 1e-3)])
def test_quantiles_are_those_of_scipy(freedoms, share):
    """About one standard deviation to either side; of one degree of freedom roughly."""
    for deviations in (-1.0, 0.0, 1.0, 2.33):
        exact = chdtri(freedoms, ndtr(-deviations))
        assert chi_square(freedoms, deviations) == pytest.approx(exact, rel=share)


@pytest.mark.parametrize("square", [1.01, 0.99, -1.0])
def test_a_term_is_shown_unless_one_in_a_hundred_cases_is_as_large(square):
    """Else it has a bound with 95 %; both in the units of data sheets, for samples 4 s apart."""
    sigma = 1 / ndtri(0.99)
    one = TermFit(
        np.full(5, square),
        np.full(5, sigma),
        1,
        has_unexplained_short_term=False,
        degrees_of_freedom=np.ones(3),
    )
    for fits in ([one, None], [one, one]):
        of_all = sigma / np.sqrt(2 if fits[1] else 1)
        *terms, from_s = terms_of(fits, 4.0, np.array([4.0, 8.0, 16.0]))
        assert from_s == 8.0
        for term, unit in zip(terms, (4.0, 2.0, 1.0, 0.5), strict=True):
            if square > ndtri(0.99) * of_all:
                assert term.value == pytest.approx(unit * np.sqrt(square))
                assert term.relative == pytest.approx(of_all / square / 2)
                assert term.at_most is None
            else:
                bound = unit * np.sqrt(max(square, 0) + ndtri(0.95) * of_all)
                assert term[:2] == (None, None)
                assert term.at_most == pytest.approx(bound, rel=1e-3)


def variances_of(rate):
    """Return the variances of one piece, and their covariances."""
    sums = AllanSums()
    sums.add(rate)
    m, variances = sums.variances()
    return variances, covariances(m, sums.lengths)


def test_a_vibration_and_a_filter_are_left_out():
    """A hum of 3 Hz and a filter of 5 samples: N is that of longer times, and which it is shows."""
    random = np.random.default_rng(5)
    truth = Truth(N=1e-4)
    rate = rates(truth, 30_000, random)
    hum = rate + 4e-4 * np.sin(2 * np.pi * 3 * np.arange(30_000) / HZ)[:, None]
    smooth = np.stack([np.convolve(axis, np.ones(5) / 5, "valid") for axis in rate.T], axis=1)
    for noise, above in ((hum, True), (smooth, False)):
        variances, known = variances_of(noise)
        for axis in variances.T:
            found = fit(axis, known)
            assert found.first > 0
            assert found.has_unexplained_short_term == above
            apart = (found.terms[1] / HZ - truth.N**2) / (found.sigmas[1] / HZ)
            assert abs(apart) < -ndtri(1e-3 / 12)
            assert np.isnan(found.terms[0])


def test_deviations_without_a_slope_have_no_terms():
    """A body swings all the time: no choice of times explains its deviation."""
    t = np.arange(3000) / HZ
    rate = np.stack([np.sin(0.7 * t), np.sin(2 * t), np.sin(t) ** 3], axis=1)
    variances, known = variances_of(
        rate + 1e-6 * np.random.default_rng(6).standard_normal((3000, 3))
    )
    assert [fit(axis, known) for axis in variances.T] == [None] * 3
