"""Quaternion rates, and rates from attitudes: the article's equations and the way back."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from make.commands import refused, run
from make.tables import write_attitudes
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries
from quatprop.base.errors import SeriesError, UndeclaredError, UsageError
from quatprop.kinematics.propagate import (
    attitudes,
    omega_matrix,
    quaternion_rate,
    rate_matrix,
    rate_of,
    rates_between,
)
from quatprop.kinematics.quaternion import geodesic_angle, multiply

Q = Rotation.random(50, random_state=9).as_quat(scalar_first=True)
RATE = np.random.default_rng(8).normal(0, 2, (50, 3))
FRAMES = ["body", "inertial"]


@pytest.mark.parametrize("rates", FRAMES)
def test_checks_of_the_article(rates):
    """1: without a rate q' = 0; 3: -q has -q'; 5: the length is preserved."""
    assert (quaternion_rate(Q, np.zeros(3), rates=rates) == 0).all()
    q_rate = quaternion_rate(Q, RATE, rates=rates)
    assert (quaternion_rate(-Q, RATE, rates=rates) == -q_rate).all()
    np.testing.assert_allclose(rate_of(-Q, -q_rate, rates=rates), RATE, rtol=0, atol=1e-13)
    # The matrices on q are skew-symmetric (eq. 29), so q' is perpendicular to q.
    omega = omega_matrix(RATE, rates=rates)
    assert (omega == -omega.swapaxes(-1, -2)).all()
    np.testing.assert_allclose((Q * q_rate).sum(axis=1), 0, atol=1e-14)


@pytest.mark.parametrize("rates", FRAMES)
def test_the_matrices_are_products_of_quaternions(rates):
    """Eqs. 12 to 18 by the product, eqs. 23 to 26 on q, eqs. 27 and 28 on the rate."""
    pure = np.concatenate([np.zeros((50, 1)), RATE], axis=1)
    expected = (multiply(Q, pure) if rates == "body" else multiply(pure, Q)) / 2
    on_q = np.einsum("nij,nj->ni", omega_matrix(RATE, rates=rates), Q) / 2
    on_rate = np.einsum("nij,nj->ni", rate_matrix(Q, rates=rates), RATE)
    for found in (quaternion_rate(Q, RATE, rates=rates), on_q, on_rate):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_arguments_that_make_no_sense_are_refused():
    """In a sentence that names the argument; only the two frames of the article are known."""
    with pytest.raises(SeriesError, match=r"^Expected `t_ns` to have shape \(N,\), got \(2, 4\)$"):
        rates_between([[1, 0, 0, 0], [0, 0, 0, 1]], [0, 10])
    with pytest.raises(SeriesError, match=r"^Expected `wxyz` to have shape \(3, 4\), got"):
        rates_between([0, 10, 20], [[1, 0, 0, 0], [0, 0, 0, 1]])
    with pytest.raises(UsageError, match="there is no frame 'world'; choose one of 'body', 'iner"):
        quaternion_rate(Q, RATE, rates="world")


def series(count=2000):
    """Return attitudes of a tumbling body at irregular times, of either sign."""
    rng = np.random.default_rng(10)
    t_ns = 1_700_000_000_000_000_000 + np.cumsum(rng.integers(1_000_000, 20_000_000, count))
    rate = 3 * np.sin(np.arange(count)[:, None] * [0.031, 0.047, 0.023] + [0, 1, 2])
    wxyz = attitudes(t_ns, rate, q0=[0.5, 0.5, -0.5, 0.5])
    return AttitudeSeries(t_ns, wxyz * rng.choice([-1.0, 1.0], (count, 1)))


@pytest.mark.parametrize("rates", FRAMES)
def test_rates_between_agree_with_scipy(rates):
    """N attitudes have N - 1 rates between them."""
    given = series()
    turned = Rotation.from_quat(given.wxyz, scalar_first=True)
    steps = turned[:-1].inv() * turned[1:] if rates == "body" else turned[1:] * turned[:-1].inv()
    expected = steps.as_rotvec() / (np.diff(given.t_ns)[:, None] * 1e-9)
    np.testing.assert_allclose(
        rates_between(given.t_ns, given.wxyz, rates=rates), expected, rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("rates", FRAMES)
def test_propagated_rates_give_the_attitudes_back(tmp_path, rates, suffix):
    """From the first attitude on, by the method start, in as many rows."""
    given = series()
    source, out = tmp_path / "attitudes.parquet", tmp_path / f"rates.{suffix}"
    quatprop.write(given, source)
    run("convert", source, out, "--as", f"{rates}-rates", code=0)
    samples = out
    if rates == "inertial":
        with pytest.raises(UndeclaredError, match="about axes of the body or of 'ref' is not"):
            quatprop.read_rates(out)
    else:
        samples = quatprop.read_rates(out)
    again = quatprop.propagate(samples, method="start", rates=rates, q0=given.wxyz[0].tolist())
    assert (again.t_ns == given.t_ns).all()
    assert geodesic_angle(again.wxyz, given.wxyz).max() < 1e-12


def test_the_row_of_the_last_attitude_repeats_its_rate(tmp_path):
    """The rate after the last attitude is unknown; a single attitude has no rate."""
    out = tmp_path / "rates.csv"
    for count, last in ((2, [0, 0, np.pi]), (1, [0, 0, 0])):
        given = AttitudeSeries([10**9, 2 * 10**9][:count], [[1, 0, 0, 0], [0, 0, 0, 1]][:count])
        quatprop.write(given, tmp_path / "attitudes.csv")
        quatprop.convert(tmp_path / "attitudes.csv", out, representation="body-rates")
        rows = np.loadtxt(out, delimiter=",", skiprows=1, ndmin=2)
        assert rows.shape == (count, 4)
        np.testing.assert_allclose(rows[-1, 1:], last, atol=1e-15)
    assert out.read_text().startswith("t_ns,wx_rad_s,wy_rad_s,wz_rad_s\n")


@pytest.mark.parametrize("first", [0, 11])
def test_rates_between_the_parts_of_a_log_are_those_of_the_whole(tmp_path, first):
    """Of a first part without attitudes there are none."""
    turn = Rotation.from_rotvec(np.arange(30)[:, None] * [0.01, 0, 0])
    wxyz = turn.as_quat(scalar_first=True).T
    columns = {"t_ns": np.arange(30), **dict(zip(("qw", "qx", "qy", "qz"), wxyz, strict=True))}
    pq.write_table(pa.table(columns), tmp_path / "q.parquet", row_group_size=10)
    known = np.arange(first, 30)
    still = write_attitudes(tmp_path / "still.csv", known, [[1, 0, 0, 0]] * len(known))
    line = ("convert", tmp_path / "q.parquet", tmp_path / "w.csv", "--as", "body-rates")
    run(*line, "--relative-to", still, code=0)
    rows = np.loadtxt(tmp_path / "w.csv", delimiter=",", skiprows=1)
    assert rows[:, 0].tolist() == known.tolist()
    np.testing.assert_allclose(rows[:, 1:], [[1e7, 0, 0]] * len(known), rtol=1e-12)


def test_attitudes_of_one_time_have_no_rate_between_them(tmp_path):
    """Nothing is written."""
    out, rows = tmp_path / "rates.csv", [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    source = write_attitudes(tmp_path / "attitudes.csv", [1, 5, 5], rows)
    sentence = "no rate between two attitudes whose timestamps do not rise: 5 ns and then 5 ns"
    assert sentence in refused("convert", source, out, "--as", "body-rates")
    assert not out.exists()
