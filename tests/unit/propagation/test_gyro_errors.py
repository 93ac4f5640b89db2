"""The errors of a gyroscope as users state them, and what a run says of the result."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from make.commands import refused, run
from make.tables import write_rates
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from quatprop import AttitudeSeries, GyroSeries, compare, propagate, read_attitudes, write
from quatprop.base.errors import RemarkWarning, UsageError
from quatprop.kinematics.quaternion import multiply
from quatprop.kinematics.uncertainty import ErrorGrowth, SensorErrors
from quatprop.propagation.gyro_errors import read_imu
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


DENSITY = "gyroscope_noise_density"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file or folder; check the path"),
        (b"\xff\xfe", "it is not UTF-8 text: byte 0"),
        (
            b"a: [1",
            ("it is neither YAML nor JSON: line 1: expected ',' or ']', but got '<stream end>'"),
        ),
        (b"- 1", "it holds no names with values"),
        (b"gyr_n: 1.0", f"it has none of the keys '{DENSITY}', 'gyroscope_random_walk'"),
        (
            b"imu0: {gyroscope_noise_density: 1}\nimu1: {gyroscope_noise_density: 2}",
            "it describes 2 IMUs",
        ),
        # As a script prints them that ends sentences with a full stop.
        (b"gyroscope_noise_density: 0.005.", f"{DENSITY}: '0.005.' is not a finite number"),
        (b"gyroscope_noise_density: [1, 2]", f"{DENSITY}: '1,2' is not a finite number"),
        (b"gyroscope_noise_density: -1", f"{DENSITY} is below 0"),
        (
            b"gyroscope_noise_density: 1e308",
            f"{DENSITY} is larger than that of a gyroscope can be",
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


# --- runs

UNCONFIRMED = pytest.mark.filterwarnings("ignore:series. no accelerometer and no orientation")
"""A rest that only the rates show is remarked on."""


def noisy(seconds=100, hz=100, density=2e-3, bias=0.01):
    """Return rates at rest, of a gyroscope with known errors."""
    random = np.random.default_rng(2)
    t_ns = np.arange(seconds * hz + 1) * (SECOND // hz)
    rate = bias + density * np.sqrt(hz) * random.normal(size=(len(t_ns), 3))
    return GyroSeries(t_ns, rate)


@UNCONFIRMED
def test_rest_gives_the_noise_and_what_is_left_of_the_bias(tmp_path):
    """If not given, N is the scatter times the root of the interval, and b is N / sqrt(T)."""
    report = propagate(noisy(), bias="static").report
    uncertainty, rest = report.uncertainty, report.correction.rest
    rest_s = (rest.last_ns - rest.first_ns) / 1e9
    assert uncertainty.origins == {"noise_density": "rest", "bias_sigma": "rest"}
    density, bias = uncertainty.errors.noise_density, uncertainty.errors.bias_sigma
    assert density == pytest.approx(2e-3, rel=4 / math.sqrt(6 * rest.samples))
    assert bias == pytest.approx(density / math.sqrt(rest_s), rel=1e-12)
    # Over the rest itself its mean takes the noise away.
    for given in ("static", "static@+20s..+60s", "static@+0s..+5s"):
        report = propagate(noisy(), bias=given).report
        uncertainty, rest = report.uncertainty, report.correction.rest
        density, bias = uncertainty.errors.noise_density, uncertainty.errors.bias_sigma
        away_s = 100 - (rest.last_ns - rest.first_ns) / 1e9
        sigma = math.hypot(density * math.sqrt(away_s + 0.01), bias * away_s)
        assert uncertainty.sigma_rad == pytest.approx([sigma] * 3, rel=0.02)
    # An option overrides the file, and the file the stationary period.
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR)
    settings = {"bias": "static", "imu": path, "random_walk": "1e-6rad/s/sqrt(s)"}
    told = propagate(noisy(), **settings).report.uncertainty
    assert told.errors == SensorErrors(1.6968e-4, 1.6968e-4 / math.sqrt(rest_s), 1e-6)
    origins = {"random_walk": "given", "noise_density": str(path), "bias_sigma": "rest"}
    assert told.origins == origins


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
    plain = propagate(series)
    assert (plain.covariance, plain.report.uncertainty) == (None, None)
    names = result.to_arrow().column_names
    assert names == ["t_ns", "qw", "qx", "qy", "qz", "sigma_x", "sigma_y", "sigma_z"]


def test_a_restart_after_a_gap_is_certain_again():
    """With on_gap split the attitude after the gap is q0, and known."""
    t_ns = np.concatenate([np.arange(100), np.arange(100) + 500]) * SECOND // 100
    series = GyroSeries(t_ns, np.tile(np.linspace(0.1, 0.2, 100), (3, 2)).T)
    with pytest.warns(RemarkWarning, match="restarted from q0"):
        result = propagate(series, sigma=True, noise_density=1e-3, on_gap="split")
    assert not result.covariance[[0, 100]].any()
    assert np.array_equal(result.covariance[100:], result.covariance[:100])


@pytest.mark.parametrize("options", [{}, {"rate": 333}, {"sigma_axes": "reference"}])
def test_variances_are_not_below_zero(tmp_path, options):
    """About axes that no error reaches they are rounding errors, whose square root was unknown."""
    random = np.random.default_rng(1)
    out = tmp_path / "out.parquet"
    for _ in range(10):
        rate = random.normal(size=(50, 1)) * [0, 0, 1]
        q0 = Rotation.random(rng=random).as_quat()
        series = GyroSeries(np.arange(50) * 10_000_000, rate)
        result = propagate(series, q0=q0, scale_sigma=1e-3, sigma=True, **options)
        variances = np.diagonal(result.covariance, axis1=1, axis2=2)
        assert (variances >= 0).all()
        np.testing.assert_allclose(variances[:, :2], 0, atol=1e-20)
        write(result, out)
        sigmas = pd.read_parquet(out)[["sigma_x", "sigma_y", "sigma_z"]].to_numpy()
        np.testing.assert_allclose((sigmas**2).sum(axis=1), variances.sum(axis=1), atol=1e-20)


@pytest.mark.parametrize("axes", [None, "body", "reference"])
def test_a_table_in_memory_has_the_standard_deviations_of_the_file(tmp_path, axes):
    """Those in memory were about body axes, and those in the file as asked for."""
    series = GyroSeries(np.arange(1001) * 20_000_000, np.tile([0, 0, math.pi / 40], (1001, 1)))
    with pytest.warns(RemarkWarning, match="every rate is the same"):
        result = propagate(series, sigma=True, q0_sigma="1deg,3deg,5deg", sigma_axes=axes)
    names, path = ["sigma_x", "sigma_y", "sigma_z"], tmp_path / "out.parquet"
    write(result, path)
    stored = pd.read_parquet(path)[names]
    assert result.to_pandas()[names].equals(stored)
    assert pd.DataFrame(result.to_arrow(scalar_first=False).to_pydict())[names].equals(stored)
    # A quarter of a turn about z, from the errors of q0 about reference axes.
    degrees = [1, 3, 5] if axes == "reference" else [3, 1, 5]
    np.testing.assert_allclose(np.degrees(stored.iloc[-1]), degrees, rtol=1e-9)


def test_settings_that_say_nothing_are_refused():
    """Nothing is made up of errors that nobody knows, and axes without columns do nothing."""
    with pytest.raises(UsageError) as error:
        propagate(noisy(1), sigma=True)
    assert str(error.value) == (
        "sigma needs the errors of the gyroscope; give noise_density, bias_sigma, random_walk, "
        "scale_sigma or misalignment_sigma, a file with imu, or bias='static'"
    )
    with pytest.raises(UsageError, match=r"^sigma_axes requires sigma$"):
        propagate(noisy(1), sigma_axes="reference")


def test_the_summary_and_the_report_say_it(tmp_path):
    """The 1-sigma of the final attitude, what contributes most, and what is known."""
    log = write_rates(tmp_path / "log.csv", [(k * 10**8, 0, 0, 0) for k in range(3601)])
    errors = ("--noise-density", "0.1deg/sqrt(h)", "--bias-sigma", "1deg/h")
    outputs = ("-o", tmp_path / "out.csv", "--report", tmp_path / "report.json")
    result = run("propagate", log, *outputs, "--rate-unit", "rad/s", *errors, code=0)
    # Six minutes: 0.1 sqrt(0.1) and 0.1 deg.
    sigma = f"{math.hypot(0.1 * math.sqrt(0.1), 0.1):.3g}"
    assert result.stderr.splitlines()[5:7] == [
        (
            f"1 sigma     x {sigma}  y {sigma}  z {sigma} deg about the body axes of the final "
            "attitude, 91% of the variance due to bias"
        ),
        "            from noise 0.1 deg/sqrt(h) (given), bias 1 deg/h (given)",
    ]
    uncertainty = json.loads((tmp_path / "report.json").read_text())["uncertainty"]
    assert uncertainty["largest"] == "bias_sigma"
    assert uncertainty["sigma_rad"] == pytest.approx([math.radians(0.105)] * 3, rel=0.002)


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        (("--q0-sigma", "1deg,2deg,179deg"), "x 1  y 2  z 179 deg about the body axes of the"),
        (("--q0-sigma", "1deg,2deg,181deg"), "x 1  y 2 deg about ... attitude, unknown about z,"),
        (("--q0-sigma", "181deg,2deg,9rad"), "y 2 deg about ... attitude, unknown about x and z,"),
        (
            ("--noise-density", "1e30rad/s/sqrt(Hz)", "--scale-sigma", "1e30%"),
            "the attitude is unknown: more than half a turn about every axis, 100% of the variance",
        ),
    ],
)
def test_a_standard_deviation_beyond_half_a_turn_is_not_a_number(tmp_path, errors, said):
    """It said that the attitude was known to 8000 deg."""
    log = write_rates(tmp_path / "log.csv", [(k * 10**8, 0, 0, 0) for k in range(9)])
    lines = run("propagate", log, "-o", tmp_path / "out.csv", *errors).stderr.splitlines()
    (line,) = (line for line in lines if line.startswith("1 sigma"))
    first, _, last = said.partition(" ... ")
    assert line.startswith(f"1 sigma     {first}")
    assert last in line


def test_errors_that_are_all_given_as_0_have_no_largest(tmp_path):
    """The summary said "0% of the variance by noise"."""
    log = write_rates(tmp_path / "log.csv", [(k * 10**8, 0, 0, 0.1 * k) for k in range(9)])
    options = ("--rate-unit", "rad/s", "--noise-density", "0deg/sqrt(h)")
    said = run("propagate", log, "-o", tmp_path / "out.csv", *options).stderr
    assert "z 0 deg about the body axes of the final attitude\n" in said


# --- outputs


SERIES = noisy(2)


@pytest.fixture(scope="module")
def arguments(tmp_path_factory):
    """Return a command line that propagates a short log with standard deviations."""
    log = tmp_path_factory.mktemp("log") / "log.csv"
    rows = zip(SERIES.t_ns.tolist(), SERIES.rate.tolist(), strict=True)
    write_rates(log, [[t, *rate] for t, rate in rows])
    errors = ("--noise-density", "1e-3rad/s/sqrt(Hz)", "--scale-sigma", "5%", "--sigma")
    return ["propagate", log, "--rate-unit", "rad/s", *errors]


def expected_of(**options):
    """Return what the library makes of the log, and its covariance about reference axes."""
    series = propagate(SERIES, sigma=True, noise_density=1e-3, scale_sigma=0.05, **options)
    turn = Rotation.from_quat(series.wxyz, scalar_first=True).as_matrix()
    return series, turn @ series.covariance @ turn.swapaxes(1, 2)


def deviations(covariance):
    """Return the roots of the diagonals."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


@pytest.mark.thorough
@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("axes", ["body", "reference"])
def test_every_table_has_the_columns(tmp_path, arguments, kind, axes):
    """They are sigma_x, sigma_y, sigma_z after the quaternion, rad, and are read again.

    About body axes, unless metadata say that they are about those of the reference.
    """
    out = tmp_path / f"out{WRITERS[kind].suffixes[0]}"
    run(*arguments, "-o", out, "--to", kind, "--sigma-axes", axes, code=0)
    expected, reference = expected_of()
    sigma = expected.sigma if axes == "body" else deviations(reference)
    columns = {
        "csv": lambda: pd.read_csv(out),
        "tsv": lambda: pd.read_csv(out, sep="\t"),
        "jsonl": lambda: pd.DataFrame(map(json.loads, out.read_text().splitlines())),
        "parquet": lambda: pd.read_parquet(out),
        "feather": lambda: pd.read_feather(out),
        "npy": lambda: pd.DataFrame(np.load(out)),
        "npz": lambda: pd.DataFrame({k: v for k, v in np.load(out).items() if k != "quatprop"}),
    }[kind]()
    names = ["t_ns", "qw", "qx", "qy", "qz", "sigma_x", "sigma_y", "sigma_z"]
    assert columns.columns.tolist() == names
    np.testing.assert_allclose(columns[names[5:]].to_numpy(), sigma, rtol=1e-12, atol=1e-18)
    if axes == "body":
        again = read_attitudes(out)
        np.testing.assert_allclose(again.sigma, sigma, rtol=1e-12)
        assert not again.covariance[:, [0, 0, 1], [1, 2, 2]].any()
    elif kind in {"parquet", "npz"}:
        turn = Rotation.from_quat(expected.wxyz, scalar_first=True).as_matrix()
        found = turn @ read_attitudes(out).covariance @ turn.swapaxes(1, 2)
        np.testing.assert_allclose(deviations(found), sigma, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(
    ("name", "message", "frame"),
    [
        ("out.mcap", "Imu", "body"),
        ("out.bag", "Imu", "inertial"),
        ("out", "PoseWithCovarianceStamped", "body"),
    ],
)
def test_messages_have_the_covariance(tmp_path, arguments, name, message, frame):
    """About reference axes; an Imu has body rates as well, as a filter publishes it."""
    out = tmp_path / name
    run(*arguments, "-o", out, "--message", message, "--rates", frame, code=0)
    expected, covariance = expected_of(rates=frame)
    with AnyReader([out]) as reader:
        found = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()]
    if message == "Imu":
        assert {one.header.frame_id for one in found} == {"body"}
        rates = [[getattr(one.angular_velocity, axis) for axis in "xyz"] for one in found]
        turn = Rotation.from_quat(expected.wxyz, scalar_first=True)
        rate = SERIES.rate if frame == "body" else turn.inv().apply(SERIES.rate.copy())
        np.testing.assert_allclose(rates, rate, atol=1e-15)
        written = [one.orientation_covariance.reshape(3, 3) for one in found]
        assert not any(one.angular_velocity_covariance.any() for one in found)
        assert {one.linear_acceleration_covariance[0] for one in found} == {-1.0}
    else:
        written = [one.pose.covariance.reshape(6, 6)[3:, 3:] for one in found]
    np.testing.assert_allclose(written, covariance, atol=1e-18)
    again = read_attitudes(out).covariance
    np.testing.assert_allclose(again, expected.covariance, rtol=1e-9, atol=1e-16)
    # An error is as many sigma as of the series in memory.
    turn = Rotation.from_rotvec([0.01, 0.02, -0.01]).as_quat(scalar_first=True)
    other = AttitudeSeries(expected.t_ns, multiply(expected.wxyz, turn))
    sigmas = compare(out, other).sigmas
    assert sigmas.rms == pytest.approx(compare(expected, other).sigmas.rms, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("out.tum", f"tum holds poses only; choose {', '.join(map(repr, TABLES))}"),
        (
            "out.mcap",
            (
                "QuaternionStamped has no covariance; choose 'PoseWithCovarianceStamped', "
                "'Imu' with --message"
            ),
        ),
    ],
)
def test_outputs_without_a_place_for_them_are_refused(tmp_path, arguments, name, sentence):
    """Before anything is written."""
    out = tmp_path / name
    assert refused(*arguments, "-o", out) == f"Error: --sigma: {sentence}"
    assert not out.exists()
