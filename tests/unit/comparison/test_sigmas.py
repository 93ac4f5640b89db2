"""Errors in standard deviations of the attitudes: in memory, from files, as limits, in pictures."""

import json
import math

import numpy as np
import pytest
from make.commands import refused, run
from make.tables import write_attitudes, write_rates
from scipy.spatial.distance import mahalanobis
from scipy.spatial.transform import Rotation

from quatprop import AttitudeSeries, compare, read_attitudes, write
from quatprop.base.errors import DataLossWarning, LogError
from quatprop.kinematics.propagate import attitudes

SECOND = 1_000_000_000
HEADER = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z"


def turned(errors, covariance=None):
    """Return attitudes that are off by rotation vectors, once a second."""
    wxyz = Rotation.from_rotvec(errors).as_quat(scalar_first=True)
    return AttitudeSeries(np.arange(len(wxyz)) * SECOND, wxyz, covariance=covariance)


def test_an_error_is_given_in_standard_deviations():
    """A sum of squares on paper: 2 and 1 sigma about two axes are sqrt(5), 3 about one are 3."""
    covariance = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (4, 1, 1))
    covariance[0] = 0.0
    a = turned(np.zeros((4, 3)), covariance)
    errors = [[0, 0, 0], [0.02, 0.02, 0], [0, 0, 0.09], [0.01, 0, 0]]
    b = turned(errors)
    sigmas = compare(a, b).sigmas
    assert sigmas.final == pytest.approx(1, rel=1e-9)
    assert sigmas.max == pytest.approx(3, rel=1e-9)
    assert sigmas.rms == pytest.approx(math.sqrt((5 + 9 + 1) / 3), rel=1e-9)
    assert compare(b, a).sigmas.rms == pytest.approx(sigmas.rms, rel=1e-9)
    assert compare(b, b).sigmas is None
    both = compare(a, turned(errors, covariance)).sigmas
    assert both.rms == pytest.approx(sigmas.rms / math.sqrt(2), rel=1e-9)
    # Errors of 1 to 40 sigma: 95 % of them are up to 38.
    exact = turned(np.zeros((40, 3)), np.tile(1e-4 * np.eye(3), (40, 1, 1)))
    many = compare(exact, turned(np.outer(np.arange(1, 41), [0.01, 0, 0])), tol=9.0)
    assert many.sigmas.p95 == pytest.approx(38)
    assert not compare(a, b, max_sigma=2.99).passed
    assert compare(a, b, max_sigma=3.01).passed
    # The same limits on each statistic, as tolerances: 0 for the exact first attitude is left out.
    for setting, value in (("tol", 3), ("rms_tol", math.sqrt(5)), ("final_tol", 1)):
        for factor, passed in ((0.99, False), (1.01, True)):
            comparison = compare(a, b, **{setting: f"{factor * value}sigma"})
            (criterion,) = comparison.criteria
            assert (criterion.setting, criterion.unit) == (setting, "sigma")
            assert comparison.passed is passed
            assert comparison.tolerance_rad is None


def test_correlated_errors_are_a_mahalanobis_distance():
    """SciPy computes the same from the inverse of the covariance."""
    random = np.random.default_rng(3)
    factor = random.normal(size=(5, 3, 3)) * 1e-2
    covariance = factor @ factor.swapaxes(1, 2)
    errors = random.normal(size=(5, 3)) * 1e-2
    sigmas = compare(turned(np.zeros((5, 3)), covariance), turned(errors)).sigmas
    expected = [
        mahalanobis(error, np.zeros(3), np.linalg.inv(one))
        for error, one in zip(errors, covariance, strict=True)
    ]
    assert sigmas.max == pytest.approx(max(expected), rel=1e-9)
    assert sigmas.final == pytest.approx(expected[-1], rel=1e-9)
    one_sigma = np.linalg.norm(errors, axis=1) / expected
    np.testing.assert_allclose(sigmas.one_sigma_rad, one_sigma, rtol=1e-9)
    about_axes = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(sigmas.axes_rad, about_axes, rtol=1e-9)


@pytest.mark.parametrize("known", ["a", "b"])
def test_standard_deviations_are_of_the_axes_of_each_body(known):
    """By a mounting, those of B are turned into the axes of A, in which the errors are.

    They were not: an error of one deviation about a noisy axis was ten about a better one.
    """
    random = np.random.default_rng(1)
    t_ns = np.arange(2000) * SECOND
    true = Rotation.from_quat(attitudes(t_ns, random.normal(size=(2000, 3))), scalar_first=True)
    deviations = np.array([1e-3, 1e-4, 1e-4])
    error = Rotation.from_rotvec(random.normal(size=(2000, 3)) * deviations)
    mount = Rotation.from_rotvec([0.3, -1.2, 0.5])
    covariance = np.tile(np.diag(deviations**2), (2000, 1, 1))
    noisy = AttitudeSeries(t_ns, (true * error).as_quat(scalar_first=True), covariance=covariance)
    exact = AttitudeSeries(t_ns, (true * mount).as_quat(scalar_first=True))
    a, b = (noisy, exact) if known == "a" else (exact, noisy)
    # The mounting is estimated of the same attitudes, and not quite right.
    assert compare(a, b, align="mount").sigmas.rms == pytest.approx(math.sqrt(3), rel=0.2)


@pytest.mark.parametrize("row", [0, 1])
def test_an_error_where_sigma_is_zero_is_infinitely_many(row):
    """Beyond rounding: of the exact first attitude, and about an axis that is exact."""
    covariance = np.array([np.zeros((3, 3)), *[np.diag([0, 1e-4, 1e-4])] * 2])
    a = turned(np.zeros((3, 3)), covariance)
    rounded = compare(a, turned([[9e-10, 0, 0], [9e-10, 0.02, 0], [0, 0, 0.01]]), max_sigma=3)
    assert rounded.sigmas.max == pytest.approx(2)
    errors = np.zeros((3, 3))
    errors[row] = [1.1e-9, 0.01 * row, 0]
    comparison = compare(a, turned(errors), max_sigma=3)
    assert comparison.sigmas.max == comparison.sigmas.rms == math.inf
    assert comparison.sigmas.max_ns == row * SECOND
    assert not comparison.passed
    assert comparison.sigmas.one_sigma_rad[row] == 0
    report = json.loads(json.dumps(comparison.report(), allow_nan=False))
    assert report["sigmas"]["max"] is None
    assert report["criteria"][0]["value"] is None


def test_a_file_of_exact_attitudes_has_infinitely_many_sigma(tmp_path):
    """Columns of zeros are standard deviations: other attitudes fail every limit in sigma."""
    exact = write_rates(tmp_path / "a.csv", ["0,1,0,0,0,0,0,0", "5,1,0,0,0,0,0,0"], HEADER)
    other = write_attitudes(tmp_path / "b.csv", [0, 5], [[0, 1, 0, 0], [1, 0, 0, 0]])
    run("compare", exact, exact, "--tol", "3sigma", code=0)
    told = run("compare", exact, other, "--tol", "3sigma", code=1).stdout
    assert (
        ", the largest infinite in sigma (sigma is 0) at +0 ns\n"
        "failed    largest error infinite in sigma (sigma is 0), at most 3 sigma\n"
    ) in told
    assert (
        "remark    the error at 0 ns is infinite in sigma, because sigma is 0 there and the error "
        "is larger than rounding\n"
    ) in told


@pytest.mark.parametrize(
    ("value", "shown"), [("-0.1", "-0.1"), ("nan", "nan"), ("", "nan"), ("inf", "inf")]
)
def test_columns_that_hold_no_standard_deviations_are_refused(tmp_path, value, shown):
    """With the row and the value; a row without an attitude needs none."""
    rows = ["0,1,0,0,0,0,0,0", f"5,1,0,0,0,0.1,{value},0.1", "9,1,0,0,0,0,0,0"]
    table = write_rates(tmp_path / "a.csv", rows, HEADER)
    with pytest.raises(LogError) as error:
        read_attitudes(table)
    assert str(error.value) == (
        f"{table}: sigma_y is {shown} in row 1 at 5 ns, which is not a standard deviation; correct "
        "it, or omit the columns sigma_x, sigma_y, sigma_z"
    )
    write_rates(table, [row.replace("5,1", "5,nan") for row in rows], HEADER)
    with pytest.warns(DataLossWarning, match="1 rows were dropped"):
        assert len(read_attitudes(table, on_invalid="drop")) == 2


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_unknown_covariances_are_left_out(tmp_path, suffix):
    """They are neither exact nor as large as their neighbours, and come back from a table so."""
    covariance = np.tile(1e-4 * np.eye(3), (3, 1, 1))
    covariance[1] = np.nan
    table = tmp_path / f"a.{suffix}"
    write(turned(np.zeros((3, 3)), covariance), table)
    again = read_attitudes(table)
    np.testing.assert_allclose(again.covariance, covariance, rtol=1e-12)
    sigmas = compare(again, turned([[0.02, 0, 0], [1, 0, 0], [0.01, 0, 0]])).sigmas
    assert (sigmas.max, sigmas.final) == pytest.approx((2, 1), rel=1e-9)
    unknown = turned(np.zeros((3, 3)), np.full((3, 3, 3), np.nan))
    assert compare(unknown, turned(np.zeros((3, 3)))).sigmas is None


# --- on the command line


@pytest.fixture
def series(tmp_path):
    """Write attitudes with standard deviations, others without, and those with an error."""
    covariance = np.arange(20)[:, None, None] * 1e-6 * np.eye(3)
    known, bare, off = tmp_path / "known.csv", tmp_path / "bare.csv", tmp_path / "off.csv"
    write(turned(np.zeros((20, 3)), covariance), known)
    write(turned(np.zeros((20, 3))), bare)
    write(turned(np.arange(20)[:, None] * [0, 0, 1e-3]), off)
    return known, bare, off


def test_limits_of_the_command_line(series):
    """Exit code 1 above the limit; without standard deviations there is nothing to judge."""
    known, bare, off = series
    for option, failed in (
        (("--max-sigma", "2"), "failed    largest error 4.36 sigma, at most 2 sigma\n"),
        (("--p95-tol", "0.01sigma"), "failed    95 % error 4.36 sigma, at most 0.01 sigma\n"),
    ):
        told = run("compare", known, off, *option, code=1).stdout
        assert "sigma     the final error is 4.36 sigma" in told
        assert failed in told
    assert refused("compare", known, bare, "--max-sigma", "0").endswith("not a number above 0")
    for option in (("--max-sigma", "2"), ("--tol", "3sigma")):
        assert refused("compare", bare, bare, *option) == (
            f"Error: neither series has standard deviations, which "
            f"{option[0] if option[1] == '2' else ' '.join(option)} needs; write them with --sigma"
        )
    assert refused("compare", known, bare, "--tol", "-3sigma").endswith(
        "'-3sigma' is not an error in standard deviations; write a number with its unit, such as "
        "3sigma"
    )


def test_a_suite_has_standard_deviations_by_its_settings(tmp_path):
    """With sigma and errors among them; without, the key is named, not the option."""
    log = write_rates(tmp_path / "log.csv", [(k * SECOND, 0, 0, 0) for k in range(3)])
    write_attitudes(tmp_path / "bare.csv", np.arange(3) * SECOND, np.eye(4)[[0, 0, 0]])
    suite = tmp_path / "suite.toml"
    case = f'[case.still]\nlog = "{log.name}"\nrate-unit = "rad/s"\nreference-log = "bare.csv"\n'
    suite.write_text(f"{case}max-sigma = 3\n")
    told = " ".join(run("check", suite, "--update").output.split())
    assert "standard deviations, which max-sigma needs; write them with sigma = true" in told
    errors = 'noise-density = "1e-3rad/s/sqrt(Hz)"\nscale-sigma = "5%"\nsigma = true\n'
    for limit in ("max-sigma = 3", 'tol = "3sigma"'):
        suite.write_text(f"{case}{errors}{limit}\n")
        run("check", suite, "--update", code=0)
        assert "largest error 0 sigma (limit 3 sigma)" in run("check", suite, "-v", code=0).output
    off = Rotation.from_rotvec([[0, 0, 0], [0, 0, 0], [1, 0, 0]]).as_quat(scalar_first=True)
    write_attitudes(tmp_path / "bare.csv", np.arange(3) * SECOND, off)
    assert "sigma, at most 3 sigma" in run("check", suite, "--update", code=1).output


def test_the_picture_shows_a_tolerance_in_sigma(tmp_path, series):
    """A line at so many times one standard deviation, of each series, and the verdict."""
    known, _, off = series
    picture = tmp_path / "picture.html"
    for number, limit in ((1, "5"), (2, "0.001")):
        options = ("--reference", off, "--tol", f"{limit}sigma", "-o", picture)
        run("plot", *[known] * number, *options, code=0)
        shown = picture.read_text()
        assert f"tolerance ({limit} sigma" in shown
        assert number > 1 or ": the largest is " in shown
        assert "largest error" in shown


def test_the_picture_of_an_error_shows_what_was_expected(tmp_path, series):
    """A band below a second line, with its name in the legend; none where nothing is known."""
    known, bare, _ = series
    for first in (known, bare):
        picture = tmp_path / f"{first.stem}.svg"
        run("compare", first, bare, "--plot", picture, code=0)
        for part in ("expected (1 sigma)", "FillBetweenPolyCollection"):
            assert (part in picture.read_text()) == (first == known)
