"""``--bias``: in any unit; FILE or TOPIC, against NumPy's interpolation and truth."""

import struct
import warnings

import numpy as np
import pytest
from make import oracle, ulog
from make.ros import imu_messages, write_messages
from make.second_inputs import ESTIMATED, flight
from make.tables import write_rates

from quatprop import GyroSeries, propagate
from quatprop.base.errors import LogError, RemarkWarning, UsageError
from quatprop.tools.check.cases import load_cases

STAMPS = 1_000_000_000 + np.arange(200) * 10_000_000
BIAS_STAMPS = 1_300_000_000 + np.arange(11) * 130_000_000
"""Biases begin later than the rates, and end earlier."""
TRUE = np.sin(np.arange(200)[:, None] / 10 + np.arange(3))
BIASES = np.random.default_rng(2).normal(0, 0.1, (11, 3)).astype(np.float32).astype(np.float64)
RAW = TRUE + np.stack([np.interp(STAMPS, BIAS_STAMPS, axis) for axis in BIASES.T], axis=1)
SERIES = GyroSeries(STAMPS, RAW)
OKVIS = "#timestamp,b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1]"
TWO = ",".join(f"{gyro}_gyro_bias_{axis} [rad/s]" for gyro in "ab" for axis in "xyz")


def differs(series):
    """Return the largest angle between a series and the true attitudes, rad."""
    return oracle.angle(oracle.serial(STAMPS, TRUE), series.wxyz).max()


@pytest.mark.parametrize(
    ("header", "scale", "unit_ns"),
    [
        (OKVIS, 1, 1),
        ("t_ns,gyro_bias_x [deg/s],gyro_bias_y [deg/s],gyro_bias_z [deg/s]", 180 / np.pi, 1),
        ("timestamp,gyro_bias[0],gyro_bias[1],gyro_bias[2]", 1, 1000),
    ],
)
def test_biases_of_a_table(header, scale, unit_ns, tmp_path):
    """Between its rows the bias is linear in time, outside it is the nearest; both are reported."""
    rows = zip(BIAS_STAMPS // unit_ns, (BIASES * scale).tolist(), strict=True)
    path = write_rates(tmp_path / "bias.csv", [[t, *bias] for t, bias in rows][::-1], header)
    with pytest.warns(RemarkWarning, match="take the nearest") as remarks:
        series = propagate(SERIES, bias=path)
    assert differs(series) < 1e-12
    assert (
        "30 samples before the first bias at 1300000000 ns and 39 samples after the last bias at "
        f"2600000000 ns take the nearest ({path}); are both on the same clock?"
    ) in str(remarks[0].message)
    report = series.report.correction
    assert report.bias_rad_s is None
    assert (report.bias_series.values, report.bias_series.outside_range) == (11, [30, 39])
    assert series.report.as_json()["correction"]["bias_series"]["first_ns"] == BIAS_STAMPS[0]


@pytest.mark.parametrize("hz", [0.5, 1, 2, 10])
@pytest.mark.parametrize("late", [0, 0.3, 1])
@pytest.mark.parametrize("early", [0, 0.7, 1])
def test_a_slow_series_ends_within_its_own_interval(hz, late, early):
    """Its first and last bias cannot be at those of the rates, which was said of every one."""
    step_ns = int(1e9 / hz)
    stamps = np.arange(0, 20 * step_ns, step_ns // 100)
    first_ns, last_ns = round(late * step_ns), int(stamps[-1]) - round(early * step_ns)
    known = np.arange(first_ns, last_ns + 1, step_ns)
    rates = GyroSeries(stamps, np.full((len(stamps), 3), 0.1))

    def remarks(shift_ns):
        biases = GyroSeries(known + shift_ns, np.full((len(known), 3), 0.1))
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", RemarkWarning)
            report = propagate(rates, bias=biases, method="start").report.correction.bias_series
        assert report.outside_range == [
            np.count_nonzero(stamps < report.first_ns),
            np.count_nonzero(stamps > report.last_ns),
        ]
        assert report.reach_ns == [max(0, report.first_ns), max(0, stamps[-1] - report.last_ns)]
        return [text for one in found if "same clock" in (text := str(one.message))]

    assert remarks(0) == []
    (ahead,) = remarks(3 * step_ns)
    assert f": {300 + 100 * late:.0f} samples before the first bias at " in ahead
    assert "after the last" not in ahead
    (behind,) = remarks(-5 * step_ns)
    assert "before the first" not in behind
    assert "samples after the last bias at" in behind


CONSTANT = np.array([0.02, -0.03, 0.04])
OF_CONSTANT = {"rad/s": 1.0, "mrad/s": 1000.0, "deg/s": 180 / np.pi, "deg/h": 3600 * 180 / np.pi}


@pytest.mark.parametrize("unit", ["", *OF_CONSTANT])
@pytest.mark.parametrize("of_log", ["rad/s", "deg/s"])
def test_a_constant_bias_is_in_its_unit_or_that_of_the_log(tmp_path, of_log, unit):
    """As text, as three parts, and in a suite; a unit was refused."""
    rows = np.column_stack([STAMPS.astype(object), (TRUE + CONSTANT) * OF_CONSTANT[of_log]])
    head = "t_ns," + ",".join(f"gyro_{axis} [{of_log}]" for axis in "xyz")
    log = write_rates(tmp_path / "log.csv", rows, head)
    numbers = [repr(float(one)) for one in CONSTANT * OF_CONSTANT[unit or of_log]]
    for bias in (",".join(numbers) + unit, [*numbers[:2], f"{numbers[2]} {unit}".strip()]):
        assert differs(propagate(log, bias=bias)) < 1e-12
    suite = tmp_path / "suite.toml"
    text = ",".join(numbers) + unit
    suite.write_text(f'[case.a]\nlog = "log.csv"\nreference = "a.parquet"\nbias = "{text}"\n')
    _, (case,) = load_cases(suite)
    given = case.propagation.correction.bias.rad_s(1 / OF_CONSTANT[of_log])
    assert given == pytest.approx(CONSTANT.tolist(), rel=1e-12)


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Write rates and biases as ROS 2 messages; the log times of the biases are 1 s later."""
    biases = zip(BIAS_STAMPS.tolist(), BIASES.tolist(), strict=True)
    kind = "geometry_msgs/msg/Vector3Stamped"
    late = [("/imu/bias", kind, t + 10**9, [[t, ""], bias]) for t, bias in biases]
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    return write_messages(path, [*imu_messages(STAMPS, RAW), *late])


@pytest.mark.filterwarnings("ignore")
def test_biases_on_a_topic(messages):
    """A topic of the log itself, on its header timestamps; a file with one such topic."""
    assert differs(propagate(messages, bias="/imu/bias")) < 1e-12
    assert differs(propagate(SERIES, bias=messages)) < 1e-12
    # By the clock of the log the biases come a second later.
    later = propagate(messages, bias="/imu/bias", clock="log").report.correction.bias_series
    assert later.first_ns == BIAS_STAMPS[0] + 10**9


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("topic", ["estimator_sensor_bias", "estimator_sensor_bias/0"])
def test_biases_of_the_estimator_of_px4(topic, tmp_path):
    """Those that it calls invalid do not count; the time is that of the sample."""
    rates = "vehicle_angular_velocity"
    valid = zip((BIAS_STAMPS // 1000).tolist(), BIASES, [True] * 11, strict=True)
    log = ulog.write(
        tmp_path / "log.ulg",
        ulog.record(b"F", ESTIMATED.encode()),
        ulog.added(rates, 0, 0),
        ulog.added("estimator_sensor_bias", 0, 1),
        *[
            ulog.data(rates, 0, timestamp=t + 5, timestamp_sample=t, xyz=rate)
            for t, rate in zip((STAMPS // 1000).tolist(), RAW, strict=True)
        ],
        *[
            ulog.record(b"D", struct.pack("<HQQI3f?", 1, t + 5000, t, 7, *bias, is_valid))
            for t, bias, is_valid in [*valid, (1_400_000, (9.0, 9.0, 9.0), False)]
        ],
    )
    # Rates are single precision in the file.
    assert differs(propagate(log, bias=topic, topic=rates, method="start")) < 1e-6


def of_other_sensor(log, topic, bias):
    """Return the remarks on biases of another gyroscope."""
    report = propagate(log, topic=topic, bias=bias).report
    return [str(one) for one in report.remarks if one.code == "bias-of-other-sensor"]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("samples", [200, 3000])
def test_biases_of_another_gyroscope_are_remarked_on(samples, tmp_path):
    """PX4 numbers its gyroscopes, in their messages and in those of an estimator."""
    log = flight(tmp_path, [1310988, 1310996], [1310988], samples)
    bias = "estimator_sensor_bias"
    (said,) = of_other_sensor(log, "sensor_gyro/1", bias)
    assert "with device ID 1310988, and the rates of 'sensor_gyro/1' are those of 1310996" in said
    assert said.endswith("for one gyroscope use topic='sensor_gyro/0'")
    assert not of_other_sensor(log, "sensor_gyro/0", bias)


@pytest.mark.filterwarnings("ignore")
def test_the_biases_of_the_same_gyroscope_are_named(tmp_path):
    """Each of several estimators has its own."""
    log = flight(tmp_path, [11, 12], [12, 11])
    (said,) = of_other_sensor(log, "sensor_gyro/1", "estimator_sensor_bias/1")
    assert "bias='estimator_sensor_bias/0' or topic='sensor_gyro/0'" in said
    assert not of_other_sensor(log, "sensor_gyro/1", "estimator_sensor_bias/0")
    with pytest.raises(UsageError, match="choose one of 'estimator_sensor_bias/0', 'estim"):
        propagate(log, topic="sensor_gyro/1", bias="estimator_sensor_bias")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("devices", "of_biases"), [([7], [0]), ([0], [7])])
def test_biases_of_a_gyroscope_without_a_number_are_not_remarked_on(devices, of_biases, tmp_path):
    """Zero is no number of a device."""
    assert not of_other_sensor(
        flight(tmp_path, devices, of_biases), "sensor_gyro", "estimator_sensor_bias"
    )


@pytest.mark.parametrize(
    ("name", "table", "reason"),
    [
        ("nowhere.csv", None, "is not three numbers X,Y,Z, static[:DUR], a file"),
        ("/imu", None, "messages of topic '/imu' are of type 'sensor_msgs/msg/Imu', of which no b"),
        ("a.csv", "t_ns,a,b,c\n0,1,2,3\n", "no columns are named as biases of a gyroscope"),
        ("a.csv", "t_ns,bg_x,bg_y,bg_z\n0,1,2,3\n", "the unit of 'bg_x', 'bg_y', 'bg_z' is not"),
        ("a.csv", f"{OKVIS}\n0,nan,2,3\n", "it has no valid biases"),
        ("a.csv", f"t_ns,{TWO}\n0,1,2,3,4,5,6\n", "; specify it with a table that holds one"),
    ],
)
def test_what_is_no_series_of_biases_is_refused(name, table, reason, messages, tmp_path):
    """One sentence each, with a way out."""
    path = name
    if table is not None:
        path = tmp_path / name
        path.write_text(table)
    with pytest.raises((UsageError, LogError)) as refused:
        propagate(messages, bias=path)
    assert reason in str(refused.value)


def test_a_file_of_biases_is_an_input_of_a_case(tmp_path):
    """A suite finds it next to itself, and pins it; a topic is no input."""
    (tmp_path / "bias.csv").touch()
    suite = tmp_path / "suite.toml"
    suite.write_text(
        "".join(
            f'[case.{name}]\nlog = "log.csv"\nreference = "{name}.parquet"\nbias = "{bias}"\n'
            for name, bias in (("a", "bias.csv"), ("b", "/imu/bias"), ("c", "static:250ms"))
        )
    )
    _, cases = load_cases(suite)
    assert [case.inputs.get("bias") for case in cases] == [str(tmp_path / "bias.csv"), None, None]
