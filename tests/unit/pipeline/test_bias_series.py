"""``--bias FILE|TOPIC``: a bias that changes with time, against NumPy's interpolation and truth."""

import struct

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from quatprop import GyroSeries, propagate
from quatprop.check.cases import load_cases
from quatprop.errors import LogError, RemarkWarning, UsageError
from quatprop.settings import PROPAGATE

N = 200
STAMPS = 1_000_000_000 + np.arange(N) * 10_000_000
BIAS_STAMPS = 1_300_000_000 + np.arange(11) * 130_000_000
"""Biases begin later than the rates, and end earlier."""
TRUE = np.sin(np.arange(N)[:, None] / 10 + np.arange(3))
BIASES = np.random.default_rng(2).normal(0, 0.1, (11, 3)).astype(np.float32).astype(np.float64)
RAW = TRUE + np.stack([np.interp(STAMPS, BIAS_STAMPS, axis) for axis in BIASES.T], axis=1)
REMARK = (
    "30 samples before the first bias of {} at 1300000000 ns and 39 after the last at 2600000000 "
    "ns take the nearest; are both on the same clock?"
)


def true_attitudes():
    """Return the attitudes of the true rates, by the exact steps."""
    steps = Rotation.from_rotvec(TRUE[:-1] * 0.01)
    attitudes = [Rotation.identity()]
    for step in steps:
        attitudes.append(attitudes[-1] * step)
    return Rotation.concatenate(attitudes)


def differs(series):
    """Return the largest angle between a series and the true attitudes, rad."""
    ours = Rotation.from_quat(series.wxyz, scalar_first=True)
    return (true_attitudes().inv() * ours).magnitude().max()


def biases_csv(path, header, scale=1.0, unit_ns=1):
    """Write the biases as a table, in no order of time."""
    rows = [
        f"{t // unit_ns},{','.join(map(repr, (bias * scale).tolist()))}"
        for t, bias in zip(BIAS_STAMPS.tolist(), BIASES, strict=True)
    ]
    path.write_text("\n".join([header, *rows[::-1], ""]))
    return path


@pytest.mark.parametrize(
    ("header", "scale", "unit_ns"),
    [
        ("#timestamp,b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1]", 1, 1),
        ("t_ns,gyro_bias_x [deg/s],gyro_bias_y [deg/s],gyro_bias_z [deg/s]", 180 / np.pi, 1),
        ("timestamp,gyro_bias[0],gyro_bias[1],gyro_bias[2]", 1, 1000),
    ],
)
def test_biases_of_a_table(header, scale, unit_ns, tmp_path):
    """Between its rows the bias is linear in time, outside it is the nearest; both are said."""
    path = biases_csv(tmp_path / "bias.csv", header, scale, unit_ns)
    with pytest.warns(RemarkWarning, match="take the nearest") as remarks:
        series = propagate(GyroSeries(STAMPS, RAW), bias=path)
    assert differs(series) < 1e-12
    assert REMARK.format(path) in str(remarks[0].message)
    report = series.report.conditioning
    assert report.bias_rad_s is None
    assert (report.bias_series.values, report.bias_series.outside) == (11, [30, 39])
    assert series.report.as_json()["conditioning"]["bias_series"]["first_ns"] == BIAS_STAMPS[0]


@pytest.fixture
def messages(tmp_path):
    """Write rates and biases as ROS 2 messages; the log times of the biases are 1 s later."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, path = store.types, tmp_path / "log.mcap"
    stamp, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector = types["geometry_msgs/msg/Vector3"]
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()

        def channel(topic, kind):
            text, _ = store.generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            return writer.register_channel(topic, "cdr", schema), kind

        def add(topic, log_ns, message):
            number, kind = topic
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(number, log_time=log_ns, publish_time=log_ns, data=data)

        imu, bias = (
            channel("/imu", "sensor_msgs/msg/Imu"),
            channel("/imu/bias", "geometry_msgs/msg/Vector3Stamped"),
        )
        quaternion = types["geometry_msgs/msg/Quaternion"](x=0, y=0, z=0, w=1)
        zero, none = np.zeros(9), vector(0, 0, 0)
        for t, rate in zip(STAMPS.tolist(), RAW.tolist(), strict=True):
            at = header(stamp(*divmod(t, 10**9)), "")
            message = types[imu[1]](at, quaternion, zero, vector(*rate), zero, none, zero)
            add(imu, t, message)
        for t, value in zip(BIAS_STAMPS.tolist(), BIASES.tolist(), strict=True):
            at = header(stamp(*divmod(t, 10**9)), "")
            add(bias, t + 10**9, types[bias[1]](at, vector(*value)))
        writer.finish()
    return path


@pytest.mark.filterwarnings("ignore")
def test_biases_on_a_topic(messages):
    """A topic of the log itself, on its header stamps; a file with one such topic."""
    assert differs(propagate(messages, bias="/imu/bias")) < 1e-12
    assert differs(propagate(GyroSeries(STAMPS, RAW), bias=messages)) < 1e-12
    # By the clock of the log the biases come a second later.
    later = propagate(messages, bias="/imu/bias", clock="log").report.conditioning.bias_series
    assert later.first_ns == BIAS_STAMPS[0] + 10**9


def ulog(path):
    """Write rates and the biases of PX4's estimator, one of them invalid."""
    text = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)

    def record(kind, content):
        return struct.pack("<Hc", len(content), kind) + content

    text += record(b"B", bytes(40))
    rates = "sensor_combined:uint64_t timestamp;float[3] gyro_rad;"
    biases = (
        "estimator_sensor_bias:uint64_t timestamp;uint64_t timestamp_sample;"
        "uint32_t gyro_device_id;float[3] gyro_bias;bool gyro_bias_valid;"
    )
    text += record(b"F", rates.encode()) + record(b"F", biases.encode())
    text += record(b"A", struct.pack("<BH", 0, 0) + b"sensor_combined")
    text += record(b"A", struct.pack("<BH", 0, 1) + b"estimator_sensor_bias")
    for t, rate in zip((STAMPS // 1000).tolist(), RAW, strict=True):
        text += record(b"D", struct.pack("<HQ3f", 0, t, *rate))
    for t, bias in zip((BIAS_STAMPS // 1000).tolist(), BIASES, strict=True):
        text += record(b"D", struct.pack("<HQQI3f?", 1, t + 5000, t, 7, *bias, True))
    wrong = struct.pack("<HQQI3f?", 1, 0, 1_400_000, 7, 9.0, 9.0, 9.0, False)
    path.write_bytes(text + record(b"D", wrong))
    return path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("topic", ["estimator_sensor_bias", "estimator_sensor_bias/0"])
def test_biases_of_the_estimator_of_px4(topic, tmp_path):
    """Those that it calls invalid do not count; the time is that of the sample."""
    series = propagate(ulog(tmp_path / "log.ulg"), bias=topic, method="start")
    # Rates are single precision in the file.
    assert differs(series) < 1e-6


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nowhere.csv", "is neither three numbers X,Y,Z nor static[:DUR], no such file is there"),
        ("/imu", "messages of topic '/imu' are of type 'sensor_msgs/msg/Imu', of which no bias"),
        ("none.csv", "no columns are named as biases of a gyroscope"),
        ("unit.csv", "the unit of 'bg_x', 'bg_y', 'bg_z' is not declared"),
        ("nan.csv", "it has no valid biases"),
    ],
)
def test_what_is_no_series_of_biases_is_refused(name, reason, messages, tmp_path, monkeypatch):
    """One sentence each."""
    (tmp_path / "none.csv").write_text("t_ns,a,b,c\n0,1,2,3\n")
    (tmp_path / "unit.csv").write_text("t_ns,bg_x,bg_y,bg_z\n0,1,2,3\n")
    (tmp_path / "nan.csv").write_text("#timestamp,b_w_RS_S_x,b_w_RS_S_y,b_w_RS_S_z\n0,nan,2,3\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises((UsageError, LogError)) as refused:
        propagate(messages, bias=name)
    assert reason in str(refused.value)


def test_rates_in_memory_have_no_topics():
    """A name that is no file cannot be anything else."""
    with pytest.raises(UsageError, match="the log has no such topic"):
        propagate(GyroSeries(STAMPS, RAW), bias="/imu/bias")


def test_a_file_of_biases_is_an_input_of_a_case(tmp_path):
    """A suite names it beside itself, and pins it; a topic is no input."""
    (tmp_path / "log.csv").write_text("t_ns,wx,wy,wz\n0,0,0,1\n10,0,0,1\n")
    biases_csv(tmp_path / "bias.csv", "#timestamp,b_w_RS_S_x,b_w_RS_S_y,b_w_RS_S_z")
    suite = tmp_path / "suite.toml"
    suite.write_text(
        "".join(
            f'[case.{name}]\nlog = "log.csv"\nreference = "{name}.parquet"\nbias = "{bias}"\n'
            for name, bias in (("a", "bias.csv"), ("b", "/imu/bias"), ("c", "static:250ms"))
        )
    )
    _, cases = load_cases(suite)
    assert cases[0].inputs["bias"] == str(tmp_path / "bias.csv")
    assert [case.inputs.keys() & {"bias"} for case in cases[1:]] == [set(), set()]
    assert PROPAGATE["bias"]("/imu/bias") == "/imu/bias"


@pytest.mark.filterwarnings("ignore")
def test_the_true_bias_of_a_recording(shared_logs):
    """EuRoC's ground truth has the bias: without it 104 deg at the end, with it below half."""
    folder = shared_logs / "csv" / "euroc_v102"
    truth = folder / "state_groundtruth_data.csv"
    table = np.loadtxt(truth, delimiter=",", usecols=(0, 4, 5, 6, 7), dtype=np.longdouble)
    t = table[:, 0].astype(np.int64)
    true = Rotation.from_quat(table[:, 1:].astype(np.float64), scalar_first=True)
    options = {"q0": truth, "at": truth, "start": int(t[0]), "method": "coning"}

    def errors(**more):
        series = propagate(folder / "imu0_data.csv", **options, **more)
        both = np.isin(t, series.t_ns)
        ours = Rotation.from_quat(series.wxyz, scalar_first=True)
        return np.degrees((true[both].inv() * ours).magnitude())

    with_bias, without = errors(bias=truth), errors()
    assert without[-1] > 100
    assert with_bias.max() < 0.65
    assert with_bias[-1] < 0.5


def test_several_biases_in_a_file_are_refused_with_a_way_out(tmp_path):
    """No option chooses among the columns of a file beside the log."""
    names = ",".join(f"{gyro}_gyro_bias_{axis} [rad/s]" for gyro in "ab" for axis in "xyz")
    path = biases_csv(tmp_path / "bias.csv", f"t_ns,{names}")
    path.write_text(path.read_text().splitlines()[0] + "\n0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n")
    with pytest.raises(
        LogError, match=r"which set of biases .*; say it with a table that holds one"
    ):
        propagate(GyroSeries(STAMPS, RAW), bias=str(path))
