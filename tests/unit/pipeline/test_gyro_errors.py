"""The errors of a gyroscope as users state them, and what a run says of the result."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from rosbags.highlevel import AnyReader
from scipy.spatial.distance import mahalanobis
from scipy.spatial.transform import Rotation

from quatprop import AttitudeSeries, GyroSeries, compare, propagate, read_attitudes, write
from quatprop.cli.commands import cli
from quatprop.errors import DataLossWarning, LogError, RemarkWarning, UsageError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import multiply
from quatprop.kinematics.uncertainty import ErrorGrowth, SensorErrors
from quatprop.pipeline.gyro_errors import read_imu
from quatprop.settings import PROPAGATE
from quatprop.writers.formats import WRITERS

TABLES = [kind for kind, form in WRITERS.items() if form.columns]
SECOND = 1_000_000_000
KALIBR = """\
#Accelerometer
accelerometer_noise_density: 0.0018   #Noise density (continuous-time)
#Gyroscope
gyroscope_noise_density:     1.6968e-04
gyroscope_random_walk:       1.9393e-05

rostopic:                    /imu0      #the IMU ROS topic
update_rate:                 200.0      #Hz (for discretization of the values above)
"""


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("noise_density", "0.2deg/sqrt(h)", 0.2 / 60 * math.pi / 180),
        ("noise_density", "1.7e-4rad/s/sqrt(Hz)", 1.7e-4),
        ("noise_density", "1.7e-4 rad/sqrt(s)", 1.7e-4),
        ("noise_density", "3 mdeg/s/sqrt(Hz)", 0.003 * math.pi / 180),
        ("noise_density", "36deg/h/sqrt(Hz)", 0.01 * math.pi / 180),
        ("noise_density", "6e-2rad/sqrt(h)", 1e-3),
        ("noise_density", 2e-4, 2e-4),
        ("bias_sigma", "20deg/h", 20 / 206264.80624709636),
        ("bias_sigma", "0.5deg/s", math.radians(0.5)),
        ("bias_sigma", "3mrad/s", 3e-3),
        ("random_walk", "1e-5rad/s^2/sqrt(Hz)", 1e-5),
        ("random_walk", "1e-5rad/s/sqrt(s)", 1e-5),
        ("random_walk", "3deg/h/sqrt(h)", 3 / 206264.80624709636 / 60),
        ("scale_sigma", "1000ppm", 1e-3),
        ("scale_sigma", "0.1 %", 1e-3),
        ("scale_sigma", 0.0, 0.0),
    ],
)
def test_quantities_have_the_units_of_data_sheets(name, value, expected):
    """They become rad/s/sqrt(Hz), rad/s, rad/s^2/sqrt(Hz) and ratios."""
    assert PROPAGATE[name](value) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("noise_density", "0.2", ("'0.2' is not a noise density; write a number with its unit, "
         "such as 0.2deg/sqrt(h)")),
        ("noise_density", "0.2deg/h", ("'0.2deg/h' is not a noise density; write a number with its "
         "unit, such as 0.2deg/sqrt(h)")),
        ("bias_sigma", "20deg", ("'20deg' is not a rate; write a number with its unit, such as "
         "20deg/h")),
        ("random_walk", "1rad/s", ("'1rad/s' is not a rate random walk; write a number with its "
         "unit, such as 1e-5rad/s^2/sqrt(Hz)")),
        ("scale_sigma", "5", ("'5' is not a ratio; write a number with its unit, such as "
         "1000ppm or 0.1%")),
        ("scale_sigma", -1, "'-1' is below 0"),
        ("bias_sigma", "-1deg/h", ("'-1deg/h' is not a rate; write a number with its unit, such as "
         "20deg/h")),
    ],
)  # fmt: skip
def test_other_quantities_are_refused(name, value, message):
    """With an example of what is right."""
    with pytest.raises(UsageError) as error:
        PROPAGATE[name](value)
    assert str(error.value) == message


# --- files


@pytest.mark.parametrize(
    "text",
    [
        KALIBR,
        "%YAML:1.0\n---\n" + KALIBR,
        "imu0:\n" + "".join(f"  {line}\n" for line in KALIBR.splitlines()),
    ],
)
def test_files_of_kalibr_and_of_allan_variance_tools(tmp_path, text):
    """As Kalibr reads and writes them, and as OpenCV begins them."""
    path = tmp_path / "imu.yaml"
    path.write_text(text)
    assert read_imu(str(path)) == {"noise_density": 1.6968e-4, "random_walk": 1.9393e-5}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file or folder; check the path"),
        (b"\xff\xfe", "it is not UTF-8 text: byte 0"),
        (
            b"a: [1",
            "it is neither YAML nor JSON: line 1: expected ',' or ']', but got '<stream end>'",
        ),
        (b"- 1", "it holds no names with values"),
        (
            b"gyr_n: 1.0",
            "it has none of the keys 'gyroscope_noise_density', 'gyroscope_random_walk'",
        ),
        (
            b"imu0: {gyroscope_noise_density: 1}\nimu1: {gyroscope_noise_density: 2}",
            "it describes 2 IMUs",
        ),
    ],
)
def test_other_files_are_refused(tmp_path, content, message):
    """In one sentence with the name of the file."""
    path = tmp_path / "imu.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UsageError) as error:
        read_imu(str(path))
    assert str(error.value) == f"imu {path}: {message}"


@pytest.mark.parametrize(
    ("value", "message"),
    [("0.005.", "'0.005.' is not a finite number"), ("[1, 2]", "'1,2' is not a finite number")],
)
def test_values_that_are_no_numbers_are_refused(tmp_path, value, message):
    """A script that prints a full stop after each value, and several values."""
    path = tmp_path / "imu.yaml"
    path.write_text(f"gyroscope_noise_density: {value}\n")
    with pytest.raises(UsageError) as error:
        read_imu(str(path))
    assert str(error.value) == f"imu {path}: gyroscope_noise_density: {message}"


# --- runs

UNCONFIRMED = pytest.mark.filterwarnings("ignore:series. no accelerometer and no orientation")
"""A rest that only the rates show is remarked on."""


def noisy(seconds=100, hz=100, density=2e-3, bias=0.01):
    """Return rates at rest, of a gyroscope with known errors."""
    random = np.random.default_rng(1)
    t_ns = np.arange(seconds * hz + 1) * (SECOND // hz)
    rate = bias + density * np.sqrt(hz) * random.normal(size=(len(t_ns), 3))
    return GyroSeries(t_ns, rate)


@UNCONFIRMED
def test_rest_gives_the_noise_and_what_is_left_of_the_bias():
    """N is the scatter times the root of the interval, b is N / sqrt(T): for nothing."""
    report = propagate(noisy(), bias="static").report
    uncertainty, rest = report.uncertainty, report.conditioning.rest
    rest_s = (rest.last_ns - rest.first_ns) / 1e9
    assert uncertainty.origins == {"noise_density": "rest", "bias_sigma": "rest"}
    density, bias = uncertainty.errors.noise_density, uncertainty.errors.bias_sigma
    assert density == pytest.approx(2e-3, rel=4 / math.sqrt(6 * rest.samples))
    assert bias == pytest.approx(density / math.sqrt(rest_s), rel=1e-12)
    sigma = math.hypot(density * math.sqrt(100), bias * 100)
    assert uncertainty.sigma_rad == pytest.approx([sigma] * 3, rel=0.02)


@UNCONFIRMED
def test_what_is_given_goes_before_the_file_and_the_file_before_rest(tmp_path):
    """Each error has its own origin."""
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR)
    settings = {"bias": "static", "imu": path, "random_walk": "1e-6rad/s/sqrt(s)"}
    report = propagate(noisy(), **settings).report
    uncertainty, rest = report.uncertainty, report.conditioning.rest
    rest_s = (rest.last_ns - rest.first_ns) / 1e9
    assert uncertainty.origins == {
        "random_walk": "given", "noise_density": str(path), "bias_sigma": "rest"
    }  # fmt: skip
    assert uncertainty.errors == SensorErrors(1.6968e-4, 1.6968e-4 / math.sqrt(rest_s), 1e-6)


def test_the_series_has_its_covariance():
    """The same as of the growth itself, at the samples; the report has that of the last."""
    series = noisy(2)
    result = propagate(series, sigma=True, noise_density=1e-3, scale_sigma="1%", method="cubic")
    errors = SensorErrors(noise_density=1e-3, scale_sigma=0.01)
    expected = ErrorGrowth(errors, method="cubic").advance(series, result.wxyz)
    assert np.array_equal(result.covariance, expected)
    assert np.array_equal(result.sigma, np.sqrt(np.diagonal(expected, axis1=1, axis2=2)))
    uncertainty = result.report.uncertainty
    assert uncertainty.sigma_rad == pytest.approx(result.sigma[-1], rel=1e-14)
    assert uncertainty.largest == "noise_density"
    assert 0.5 < uncertainty.largest_share < 1
    assert propagate(series).covariance is None
    assert propagate(series).report.uncertainty is None
    names = result.to_arrow().column_names
    assert names == ["t_ns", "qw", "qx", "qy", "qz", "sigma_x", "sigma_y", "sigma_z"]


def test_every_nth_attitude_and_other_times_have_theirs():
    """Of every tenth sample the same; between samples N sqrt(t)."""
    series = GyroSeries(np.arange(1001) * SECOND // 100, np.tile([0.3, -0.2, 0.5], (1001, 1)))
    series = series.with_rate(series.rate + np.arange(1001)[:, None] * 1e-6)
    settings = {"sigma": True, "noise_density": 1e-3}
    whole = propagate(series, **settings)
    tenth = propagate(series, every=10, **settings)
    assert np.array_equal(tenth.covariance, whole.covariance[::10])
    other = propagate(series, rate=997, **settings)
    expected = 1e-3 * np.sqrt(other.t_ns / 1e9)
    np.testing.assert_allclose(other.sigma, np.tile(expected[:, None], 3), rtol=1e-9, atol=1e-12)


def test_other_times_are_between_the_samples():
    """With all errors, in motion, the covariance at 997 Hz follows that of the samples."""
    t_ns = np.arange(0, 5 * SECOND + 1, SECOND // 200)
    t_s = t_ns[:, None] / 1e9
    rate = np.sin(t_s * [1.0, 1.3, 0.7] + [0, 1, 2]) * 2
    settings = {
        "sigma": True, "noise_density": 1e-3, "bias_sigma": 1e-3, "random_walk": 1e-3,
        "scale_sigma": 1e-3, "method": "cubic",
    }  # fmt: skip
    dense = propagate(GyroSeries(t_ns, rate), **settings)
    sparse = propagate(GyroSeries(t_ns[::4], rate[::4]), rate=200, **settings)
    assert np.array_equal(sparse.t_ns, dense.t_ns)
    scale = np.trace(dense.covariance, axis1=1, axis2=2)[:, None, None]
    # Linear between samples: good to (h/t)^2.
    assert (np.abs(sparse.covariance - dense.covariance)[200:] < 1e-3 * scale[200:]).all()


def test_a_restart_after_a_gap_is_certain_again():
    """With on_gap split the attitude after the gap is q0, and known."""
    t_ns = np.concatenate([np.arange(100), np.arange(100) + 500]) * SECOND // 100
    series = GyroSeries(t_ns, np.tile(np.linspace(0.1, 0.2, 100), (3, 2)).T)
    with pytest.warns(UserWarning, match="restarted from q0"):
        result = propagate(series, sigma=True, noise_density=1e-3, on_gap="split")
    assert not result.covariance[[0, 100]].any()
    assert np.array_equal(result.covariance[100:], result.covariance[:100])


def test_standard_deviations_need_errors():
    """Nothing is made up."""
    with pytest.raises(UsageError) as error:
        propagate(noisy(1), sigma=True)
    assert str(error.value) == (
        "sigma needs the errors of the gyroscope; give noise_density, bias_sigma, random_walk or "
        "scale_sigma, a file with imu, or bias='static'"
    )


def test_the_summary_and_the_report_say_it(tmp_path):
    """The 1-sigma of the final attitude, what contributes most, and what is known."""
    log = tmp_path / "log.csv"
    log.write_text("t_ns,wx,wy,wz\n" + "".join(f"{k * 10**7},0,0,0\n" for k in range(36001)))
    arguments = ["propagate", str(log), "-o", str(tmp_path / "out.csv"), "--rate-unit", "rad/s"]
    arguments += ["--noise-density", "0.1deg/sqrt(h)", "--bias-sigma", "1deg/h"]
    result = CliRunner().invoke(cli, [*arguments, "--report", str(tmp_path / "report.json")])
    assert result.exit_code == 0, result.output
    # Six minutes: 0.1 sqrt(0.1) and 0.1 deg.
    sigma = f"{math.hypot(0.1 * math.sqrt(0.1), 0.1):.3g}"
    assert result.stderr.splitlines()[5:7] == [
        (
            f"1 sigma     x {sigma}  y {sigma}  z {sigma} deg about the body axes of the final "
            "attitude, 91% of the variance by bias"
        ),
        "            from noise 0.1 deg/sqrt(h) (given), bias 1 deg/h (given)",
    ]
    uncertainty = json.loads((tmp_path / "report.json").read_text())["uncertainty"]
    assert uncertainty["largest"] == "bias_sigma"
    assert uncertainty["sigma_rad"] == pytest.approx([math.radians(0.105)] * 3, rel=0.002)


# --- outputs


def run(tmp_path, name, *arguments):
    """Propagate a short log to a file, with the standard deviations; return its path."""
    log = tmp_path / "log.csv"
    series = noisy(2)
    rows = (f"{t},{x},{y},{z}\n" for t, (x, y, z) in zip(series.t_ns, series.rate, strict=True))
    log.write_text("t_ns,wx,wy,wz\n" + "".join(rows))
    out = tmp_path / name
    given = ["--rate-unit", "rad/s", "--noise-density", "1e-3rad/s/sqrt(Hz)", "--scale-sigma", "5%"]
    result = CliRunner().invoke(
        cli, ["propagate", str(log), "-o", str(out), *given, "--sigma", *arguments]
    )
    return out, result, propagate(series, sigma=True, noise_density=1e-3, scale_sigma=0.05)


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("axes", ["body", "reference"])
def test_every_table_has_the_columns(tmp_path, kind, axes):
    """sigma_x, sigma_y, sigma_z after the quaternion, rad, to the last bit of the library's."""
    out, result, expected = run(
        tmp_path, f"out{WRITERS[kind].suffixes[0]}", "--to", kind, "--sigma-axes", axes
    )
    assert result.exit_code == 0, result.output
    covariance = expected.covariance
    if axes == "reference":
        turn = Rotation.from_quat(expected.wxyz, scalar_first=True).as_matrix()
        covariance = turn @ covariance @ turn.swapaxes(1, 2)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    columns = {
        "csv": lambda: pd.read_csv(out),
        "tsv": lambda: pd.read_csv(out, sep="\t"),
        "jsonl": lambda: pd.DataFrame(map(json.loads, out.read_text().splitlines())),
        "parquet": lambda: pd.read_parquet(out),
        "feather": lambda: pd.read_feather(out),
        "npy": lambda: pd.DataFrame(np.load(out)),
        "npz": lambda: pd.DataFrame({k: v for k, v in np.load(out).items() if k != "quatprop"}),
    }[kind]()
    assert columns.columns[:5].tolist() == ["t_ns", "qw", "qx", "qy", "qz"]
    found = columns[["sigma_x", "sigma_y", "sigma_z"]].to_numpy()
    np.testing.assert_allclose(found, sigma, rtol=1e-12, atol=1e-18)
    assert len(columns.columns) == 8


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("out.tum", [],
         f"Error: --sigma: tum holds poses only; choose {', '.join(map(repr, TABLES))}"),
        ("out.mcap", [], ("Error: --sigma: QuaternionStamped has no covariance; choose "
         "'PoseWithCovarianceStamped', 'Imu' with --message")),
    ],
)  # fmt: skip
def test_outputs_without_a_place_for_them_are_refused(tmp_path, name, arguments, message):
    """Before anything is written."""
    out, result, _ = run(tmp_path, name, *arguments)
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1] == message
    assert not out.exists()


def test_axes_without_columns_are_refused():
    """A setting that would do nothing."""
    with pytest.raises(UsageError, match=r"^sigma_axes goes with sigma$"):
        propagate(noisy(1), sigma_axes="reference")


@pytest.mark.parametrize("name", ["out.mcap", "out.bag", "out"])
@pytest.mark.parametrize("frame", ["body", "inertial"])
def test_an_imu_has_orientation_covariance_and_rate(tmp_path, name, frame):
    """As a filter publishes it, in every container; rates in body axes."""
    out, result, _ = run(tmp_path, name, "--message", "Imu", "--rates", frame)
    assert result.exit_code == 0, result.output
    series = noisy(2)
    options = {"sigma": True, "noise_density": 1e-3, "scale_sigma": 0.05, "rates": frame}
    expected = propagate(series, **options)
    turn = Rotation.from_quat(expected.wxyz, scalar_first=True)
    rate = series.rate if frame == "body" else turn.inv().apply(series.rate.copy())
    matrix = turn.as_matrix()
    covariance = matrix @ expected.covariance @ matrix.swapaxes(1, 2)
    with AnyReader([out]) as reader:
        found = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()]
    assert {m.header.frame_id for m in found} == {"body"}
    np.testing.assert_allclose(
        [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in found],
        rate, atol=1e-15,
    )  # fmt: skip
    np.testing.assert_allclose(
        [m.orientation_covariance.reshape(3, 3) for m in found], covariance, atol=1e-18
    )
    assert not any(m.angular_velocity_covariance.any() for m in found)
    assert {m.linear_acceleration_covariance[0] for m in found} == {-1.0}


def test_a_series_is_written_with_its_standard_deviations(tmp_path):
    """By the library too; a trajectory, which has no place for them, without."""
    result = propagate(noisy(1), sigma=True, noise_density=1e-3)
    write(result, tmp_path / "out.csv")
    write(result, tmp_path / "out.tum")
    names = (tmp_path / "out.csv").read_text().splitlines()[0]
    assert names == "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z"
    assert len((tmp_path / "out.tum").read_text().splitlines()[1].split()) == 8


# --- read again, and compared


@pytest.mark.parametrize("name", ["out.csv", "out.parquet", "out.npz"])
@pytest.mark.parametrize("axes", ["body", "reference"])
def test_standard_deviations_are_read_again(tmp_path, name, axes):
    """About body axes; metadata say where the columns are about those of the reference."""
    if (name, axes) == ("out.csv", "reference"):
        return
    out, result, expected = run(tmp_path, name, "--sigma-axes", axes)
    assert result.exit_code == 0, result.output
    series = read_attitudes(out)
    if axes == "body":
        np.testing.assert_allclose(series.sigma, expected.sigma, rtol=1e-12)
        assert not series.covariance[:, [0, 0, 1], [1, 2, 2]].any()
    else:
        turn = Rotation.from_quat(expected.wxyz, scalar_first=True).as_matrix()
        found = turn @ series.covariance @ turn.swapaxes(1, 2)
        wanted = turn @ expected.covariance @ turn.swapaxes(1, 2)
        diagonals = (np.diagonal(one, axis1=1, axis2=2) for one in (found, wanted))
        np.testing.assert_allclose(*diagonals, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("message", ["Imu", "PoseWithCovarianceStamped"])
@pytest.mark.parametrize("name", ["out.mcap", "out.bag", "out"])
def test_covariances_are_read_again_from_messages(tmp_path, name, message):
    """All of them, about body axes again: an error is as many sigma as of the series in memory."""
    out, result, expected = run(tmp_path, name, "--message", message)
    assert result.exit_code == 0, result.output
    series = read_attitudes(out)
    np.testing.assert_allclose(series.covariance, expected.covariance, rtol=1e-9, atol=1e-16)
    turn = Rotation.from_rotvec([0.01, 0.02, -0.01]).as_quat(scalar_first=True)
    other = AttitudeSeries(expected.t_ns, multiply(expected.wxyz, turn))
    sigmas = compare(out, other).sigmas
    assert sigmas.rms == pytest.approx(compare(expected, other).sigmas.rms, rel=1e-6)


def test_a_constant_of_the_driver_is_no_covariance(shared_logs):
    """What is the same in every message says nothing of the attitude."""
    log = shared_logs / "two_imus/test1_2014_xsens.bag"
    with AnyReader([log]) as reader:
        found = {
            tuple(reader.deserialize(data, c.msgtype).orientation_covariance)
            for c, _, data in reader.messages()
            if c.topic == "/xsens/imu_data"
        }
    assert len(found) == 1
    assert any(found.pop())
    with pytest.warns(RemarkWarning, match="it is taken as a constant of the driver"):
        assert read_attitudes(log, topic="/xsens/imu_data").covariance is None


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


def test_an_error_is_given_in_standard_deviations():
    """A sum of squares on paper: 2 and 1 sigma about two axes are sqrt(5), 3 about one are 3."""
    t_ns = np.arange(4) * SECOND
    identity = np.tile([1.0, 0, 0, 0], (4, 1))
    covariance = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (4, 1, 1))
    covariance[0] = 0.0
    error = Rotation.from_rotvec([[0, 0, 0], [0.02, 0.02, 0], [0, 0, 0.09], [0.01, 0, 0]])
    a = AttitudeSeries(t_ns, identity, covariance=covariance)
    b = AttitudeSeries(t_ns, np.roll(error.as_quat(), 1, axis=1))
    sigmas = compare(a, b).sigmas
    assert sigmas.final == pytest.approx(1, rel=1e-9)
    assert sigmas.max == pytest.approx(3, rel=1e-9)
    assert sigmas.rms == pytest.approx(math.sqrt((5 + 9 + 1) / 3), rel=1e-9)
    assert compare(b, a).sigmas.rms == pytest.approx(sigmas.rms, rel=1e-9)
    assert compare(b, b).sigmas is None
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
    both = compare(a, AttitudeSeries(t_ns, b.wxyz, covariance=covariance)).sigmas
    assert both.rms == pytest.approx(sigmas.rms / math.sqrt(2), rel=1e-9)


def test_an_error_where_sigma_is_zero_is_infinitely_many(tmp_path):
    """Beyond rounding: of the exact first attitude, and about an axis that is exact."""
    t_ns = np.arange(3) * SECOND
    covariance = np.array([np.zeros((3, 3)), *[np.diag([0, 1e-4, 1e-4])] * 2])
    a = AttitudeSeries(t_ns, np.tile([1.0, 0, 0, 0], (3, 1)), covariance=covariance)

    def against(*rotations):
        b = AttitudeSeries(t_ns, np.roll(Rotation.from_rotvec(rotations).as_quat(), 1, axis=1))
        return compare(a, b, max_sigma=3)

    assert against([9e-10, 0, 0], [9e-10, 0.02, 0], [0, 0, 0.01]).sigmas.max == pytest.approx(2)
    for row, errors in enumerate([[1.1e-9, 0, 0], [1.1e-9, 0.01, 0]]):
        rotations = np.zeros((3, 3))
        rotations[row] = errors
        comparison = against(*rotations)
        assert comparison.sigmas.max == comparison.sigmas.rms == math.inf
        assert comparison.sigmas.max_ns == row * SECOND
        assert not comparison.passed
        assert comparison.sigmas.one_sigma_rad[row] == 0
        report = json.loads(json.dumps(comparison.report(), allow_nan=False))
        assert report["sigmas"]["max"] is None
        assert report["criteria"][0]["value"] is None
    exact = AttitudeSeries(t_ns, a.wxyz, covariance=np.zeros((3, 3, 3)))
    assert compare(exact, a, max_sigma=3).sigmas.max == 0
    table, other = tmp_path / "a.csv", tmp_path / "b.csv"
    write(a, table)
    other.write_text("t_ns,qw,qx,qy,qz\n0,0,1,0,0\n1000000000,1,0,0,0\n2000000000,1,0,0,0\n")
    result = CliRunner().invoke(cli, ["compare", str(table), str(other), "--tol", "3sigma"])
    assert result.exit_code == 1
    assert (
        "sigma     the final error is 0 sigma, the largest infinitely many sigma (sigma is 0) at "
        "+0 ns\n"
        "failed    largest error infinitely many sigma (sigma is 0), at most 3 sigma\n"
    ) in result.stdout
    assert (
        "remark    the error at 0 ns is infinitely many sigma: the attitude is given as exact, "
        "with sigma 0, and the error is beyond rounding\n"
    ) in result.stdout


@pytest.mark.parametrize(
    ("value", "shown"), [("-0.1", "-0.1"), ("nan", "nan"), ("", "nan"), ("inf", "inf")]
)
def test_columns_that_hold_no_standard_deviations_are_refused(tmp_path, value, shown):
    """With the row and the value; a row without an attitude needs none."""
    table = tmp_path / "a.csv"
    header = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z\n"
    table.write_text(f"{header}0,1,0,0,0,0,0,0\n5,1,0,0,0,0.1,{value},0.1\n9,1,0,0,0,0,0,0\n")
    with pytest.raises(LogError) as refused:
        read_attitudes(table)
    assert str(refused.value) == (
        f"{table}: sigma_y is {shown} in row 1 at 5 ns, which is not a standard deviation; correct "
        "it, or leave out the columns sigma_x, sigma_y, sigma_z"
    )
    table.write_text(f"{header}0,1,0,0,0,0,0,0\n5,nan,0,0,0,0.1,{value},0.1\n9,1,0,0,0,0,0,0\n")
    with pytest.warns(DataLossWarning, match="1 rows were dropped"):
        assert len(read_attitudes(table, on_invalid="drop")) == 2


def test_columns_of_zeros_are_standard_deviations(tmp_path):
    """Errors beyond rounding fail a limit in sigma, and others pass it."""
    exact, other = tmp_path / "a.csv", tmp_path / "b.csv"
    exact.write_text("t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z\n0,1,0,0,0,0,0,0\n5,1,0,0,0,0,0,0\n")
    for wxyz, passed in (("1,0,0,0", True), ("0,1,0,0", False)):
        other.write_text(f"t_ns,qw,qx,qy,qz\n0,1,0,0,0\n5,{wxyz}\n")
        assert compare(exact, other, tol="3sigma").passed is passed


def test_unknown_covariances_are_left_out():
    """They are neither exact nor as large as their neighbours."""
    t_ns = np.arange(3) * SECOND
    covariance = np.tile(1e-4 * np.eye(3), (3, 1, 1))
    covariance[1] = np.nan
    a = AttitudeSeries(t_ns, np.tile([1.0, 0, 0, 0], (3, 1)), covariance=covariance)
    errors = Rotation.from_rotvec([[0.02, 0, 0], [1, 0, 0], [0.01, 0, 0]])
    sigmas = compare(a, AttitudeSeries(t_ns, np.roll(errors.as_quat(), 1, axis=1))).sigmas
    assert (sigmas.max, sigmas.final) == pytest.approx((2, 1), rel=1e-9)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_unknown_standard_deviations_come_back_from_a_table(tmp_path, suffix):
    """As unknown: a table that this package writes is one that it reads."""
    covariance = np.tile(1e-4 * np.eye(3), (3, 1, 1))
    covariance[1] = np.nan
    wxyz = np.tile([1.0, 0, 0, 0], (3, 1))
    table = tmp_path / f"a.{suffix}"
    write(AttitudeSeries(np.arange(3) * SECOND, wxyz, covariance=covariance), table)
    np.testing.assert_allclose(read_attitudes(table).covariance, covariance, rtol=1e-12)


def test_correlated_errors_are_a_mahalanobis_distance():
    """As SciPy computes it from the inverse of the covariance."""
    random = np.random.default_rng(3)
    factor = random.normal(size=(5, 3, 3)) * 1e-2
    covariance = factor @ factor.swapaxes(1, 2)
    errors = random.normal(size=(5, 3)) * 1e-2
    t_ns = np.arange(5) * SECOND
    a = AttitudeSeries(t_ns, np.tile([1.0, 0, 0, 0], (5, 1)), covariance=covariance)
    b = AttitudeSeries(t_ns, np.roll(Rotation.from_rotvec(errors).as_quat(), 1, axis=1))
    expected = [
        mahalanobis(error, np.zeros(3), np.linalg.inv(one))
        for error, one in zip(errors, covariance, strict=True)
    ]
    sigmas = compare(a, b).sigmas
    assert sigmas.max == pytest.approx(max(expected), rel=1e-9)
    assert sigmas.final == pytest.approx(expected[-1], rel=1e-9)
    one_sigma = np.linalg.norm(errors, axis=1) / expected
    np.testing.assert_allclose(sigmas.one_sigma_rad, one_sigma, rtol=1e-9)
    about_axes = np.sqrt([np.diag(one) for one in covariance])
    np.testing.assert_allclose(sigmas.axes_rad, about_axes, rtol=1e-9)


def test_errors_of_a_simulated_sensor_are_as_large_as_expected():
    """A noisy series against the true one: its own standard deviations explain its error."""
    random = np.random.default_rng(7)
    t_ns = np.arange(0, 100 * SECOND + 1, SECOND // 50)
    rate = np.sin(t_ns[:, None] / 1e9 * [0.5, 0.7, 0.3] + [0, 1, 2])
    noisy_rate = rate + 1e-3 * math.sqrt(50) * random.normal(size=rate.shape)
    truth = propagate(GyroSeries(t_ns, rate), method="cubic")
    found = propagate(GyroSeries(t_ns, noisy_rate), method="cubic", sigma=True, noise_density=1e-3)
    sigmas = compare(found, truth).sigmas
    assert 0.4 * math.sqrt(3) < sigmas.rms < 1.8 * math.sqrt(3)
    half = propagate(GyroSeries(t_ns, noisy_rate), method="cubic", sigma=True, noise_density=5e-4)
    assert compare(half, truth).sigmas.rms == pytest.approx(2 * sigmas.rms, rel=1e-6)


def test_compare_and_its_limit_on_the_command_line(tmp_path):
    """The final error, and exit code 1 above the limit."""
    out, _, _ = run(tmp_path, "out.csv")
    truth = tmp_path / "truth.csv"
    rows = out.read_text().splitlines()[1:]
    stamps = [row.split(",")[0] for row in rows]
    truth.write_text("t_ns,qw,qx,qy,qz\n" + "".join(f"{t},1,0,0,0\n" for t in stamps))
    result = CliRunner().invoke(cli, ["compare", str(out), str(truth), "--max-sigma", "2"])
    assert result.exit_code == 1
    assert "sigma     the final error is " in result.stdout
    assert "failed    largest error " in result.stdout
    result = CliRunner().invoke(cli, ["compare", str(out), str(truth), "--p95-tol", "0.01sigma"])
    assert result.exit_code == 1
    assert "failed    95 % error " in result.stdout
    assert " sigma, at most 0.01 sigma\n" in result.stdout
    for option, named in (
        (["--max-sigma", "2"], "--max-sigma"),
        (["--tol", "3sigma"], "--tol 3sigma"),
    ):
        result = CliRunner().invoke(cli, ["compare", str(truth), str(truth), *option])
        assert result.exit_code == 2
        assert result.stderr.splitlines()[-1] == (
            f"Error: neither series has standard deviations, which {named} needs; write them with "
            "--sigma"
        )
    result = CliRunner().invoke(cli, ["compare", str(out), str(truth), "--tol", "-3sigma"])
    assert result.stderr.splitlines()[-1].endswith(
        "'-3sigma' is not an error in standard deviations; write a number with its unit, such as "
        "3sigma"
    )


@pytest.mark.parametrize("limit", ["max-sigma = 0.1", 'tol = "0.1sigma"'])
def test_a_suite_has_the_limit(tmp_path, limit):
    """With sigma and the errors among the settings of a case, and a reference of its own."""
    out, _, _ = run(tmp_path, "out.csv")
    suite = tmp_path / "suite.toml"
    suite.write_text(
        f"""[case.still]
log = "log.csv"
rate-unit = "rad/s"
noise-density = "1e-3rad/s/sqrt(Hz)"
scale-sigma = "5%"
sigma = true
reference-log = "out.csv"
{limit}
"""
    )
    for arguments in (["--update"], []):
        result = CliRunner().invoke(cli, ["check", str(suite), *arguments])
        assert result.exit_code == 0, result.output
    result = CliRunner().invoke(cli, ["check", str(suite), "-v"])
    # The reference has the digits of the log's attitudes, not their last bits.
    shown = re.search(r"at \+0 ns, largest error (\S+) of 0\.1 sigma\n", result.output)
    assert float(shown[1]) < 1e-9
    # An error of 1 rad at the end is far more than the errors of the sensor explain.
    *before, last = out.read_text().splitlines()
    stamp, *_ = last.split(",")
    sigma = last.split(",")[5:]
    changed = ",".join([stamp, "0.8775825618903728", "0.479425538604203", "0", "0", *sigma])
    out.write_text("\n".join([*before, changed, ""]))
    result = CliRunner().invoke(cli, ["check", str(suite), "--update"])
    assert result.exit_code == 1
    assert "sigma, at most 0.1 sigma" in result.output


def test_a_suite_says_which_key_gives_standard_deviations(tmp_path):
    """Not the option of the command line, nor the name alone."""
    log, suite = tmp_path / "log.csv", tmp_path / "suite.toml"
    log.write_text("t_ns,wx,wy,wz\n" + "".join(f"{row * SECOND},0,0,0\n" for row in range(3)))
    bare = tmp_path / "bare.csv"
    bare.write_text("t_ns,qw,qx,qy,qz\n" + "".join(f"{row * SECOND},1,0,0,0\n" for row in range(3)))
    suite.write_text(
        '[case.still]\nlog = "log.csv"\nrate-unit = "rad/s"\nreference-log = "bare.csv"\n'
        "max-sigma = 3\n"
    )
    result = CliRunner().invoke(cli, ["check", str(suite), "--update"])
    assert "neither series has standard deviations, which max-sigma needs; write them with " in (
        " ".join(result.output.split())
    )
    assert "sigma = true" in result.output


def test_the_picture_shows_a_tolerance_in_sigma(tmp_path):
    """A line at so many times one standard deviation, of each series, and the verdict."""
    out, _, _ = run(tmp_path, "out.csv")
    for number, limit in ((1, "3sigma"), (2, "0.001sigma")):
        picture = tmp_path / f"{number}.html"
        arguments = ["plot", *[str(out)] * number, "--reference", str(tmp_path / "turned.csv")]
        rows = [row.split(",")[:5] for row in out.read_text().splitlines()]
        turned = [[*row[:1], "0.99999", "0.004472125", "0", "0"] for row in rows[2:]]
        text = "\n".join(",".join(row) for row in [*rows[:2], *turned])
        (tmp_path / "turned.csv").write_text(text + "\n")
        result = CliRunner().invoke(cli, [*arguments, "--tol", limit, "-o", str(picture)])
        assert result.exit_code in {0, 1}, result.output
        shown = picture.read_text()
        assert f"tolerance ({limit.replace('sigma', ' sigma')}" in shown
        assert number > 1 or ": the largest is " in shown
        assert "largest error" in shown


def test_the_picture_of_an_error_shows_what_was_expected(tmp_path):
    """A band below a second line, with its name in the legend; none where nothing is known."""
    out, _, _ = run(tmp_path, "out.csv")
    for name, other in (("known.svg", out), ("unknown.svg", tmp_path / "bare.csv")):
        rows = (row.rsplit(",", 3)[0] for row in out.read_text().splitlines())
        (tmp_path / "bare.csv").write_text("\n".join(rows) + "\n")
        arguments = ["compare", str(other), str(tmp_path / "bare.csv"), "--plot"]
        result = CliRunner().invoke(cli, [*arguments, str(tmp_path / name)])
        assert result.exit_code == 0, result.output
        picture = (tmp_path / name).read_text()
        assert ("expected (1 sigma)" in picture) == (name == "known.svg")
        assert ("FillBetweenPolyCollection" in picture) == (name == "known.svg")


@pytest.mark.parametrize("options", [{}, {"rate": 333}, {"sigma_axes": "reference"}])
def test_variances_are_not_below_zero(tmp_path, options):
    """About axes that no error reaches they are rounding errors, whose square root was unknown."""
    random = np.random.default_rng(1)
    out = tmp_path / "out.parquet"
    for _ in range(20):
        rate = np.zeros((50, 3))
        rate[:, 2] = random.normal(size=50)
        q0 = random.normal(size=4)
        q0 /= np.linalg.norm(q0)
        series = GyroSeries(np.arange(50) * 10_000_000, rate)
        result = propagate(series, q0=q0, scale_sigma=1e-3, sigma=True, **options)
        variances = np.diagonal(result.covariance, axis1=1, axis2=2)
        assert (variances >= 0).all()
        np.testing.assert_allclose(variances[:, :2], 0, atol=1e-20)
        write(result, out)
        sigmas = pd.read_parquet(out)[["sigma_x", "sigma_y", "sigma_z"]].to_numpy()
        np.testing.assert_allclose((sigmas**2).sum(axis=1), variances.sum(axis=1), atol=1e-20)
