"""Standard deviations beside attitudes: kept where source and output have them, said where not."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

import quatprop
from quatprop.cli.commands import cli
from quatprop.kinematics.uncertainty import reference_covariance

LOST = "the standard deviations or covariances of the attitudes are not kept"
SIGMAS = ["sigma_x", "sigma_y", "sigma_z"]
HEADER = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z\n"
ROWS = ("0,1,0,0,0,0,0,0\n", "1000000000,0.6,0,0.8,0,0.1,0.2,0.3\n")
BESIDE = ("yaw_rad,pitch_rad,roll_rad\n", "0,0,0\n")


def convert(*arguments, code=0):
    """Return what `quatprop convert` says."""
    result = CliRunner().invoke(cli, ["convert", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result.stderr


@pytest.fixture
def table(tmp_path):
    """Return a table with standard deviations about body axes."""
    path = tmp_path / "in.csv"
    path.write_text(HEADER + "".join(ROWS))
    return path


@pytest.mark.parametrize("name", ["out.csv", "out.parquet", "out.npz", "out.jsonl"])
def test_tables_keep_standard_deviations_to_the_bit(table, tmp_path, name):
    """There and back again they are the same numbers."""
    there, back = tmp_path / name, tmp_path / "back.csv"
    for source, out in ((table, there), (there, back)):
        said = convert(source, out)
        assert LOST not in said
        assert ",".join(("qw,qx,qy,qz", *SIGMAS)) in said
    assert [line.split(",")[5:] for line in back.read_text().splitlines()] == [
        SIGMAS, ["0", "0", "0"], ["0.1", "0.2", "0.3"]
    ]  # fmt: skip


@pytest.mark.parametrize("message", ["PoseWithCovarianceStamped", "Imu"])
def test_messages_keep_covariances(table, tmp_path, message):
    """About the axes of the reference there, about those of the body in a table."""
    there, back = tmp_path / "out.mcap", tmp_path / "back.csv"
    assert LOST not in convert(table, there, "--message", message)
    assert LOST not in convert(there, back)
    covariance = np.array([np.zeros((3, 3)), np.diag([0.01, 0.04, 0.09])])
    series = quatprop.read_attitudes(there)
    np.testing.assert_allclose(series.covariance, covariance, atol=1e-16)
    last = [float(number) for number in back.read_text().splitlines()[-1].split(",")[5:]]
    np.testing.assert_allclose(last, [0.1, 0.2, 0.3], rtol=1e-14)


def test_axes_of_the_reference_remain_theirs(tmp_path):
    """The metadata say about which axes they are, and still do."""
    rates = quatprop.GyroSeries([0, 10**9, 2 * 10**9], [[0.3, 0, 0], [0, 0.3, 0], [0, 0, 0]])
    made = quatprop.propagate(rates, noise_density=1e-3, scale_sigma=1e-2, sigma=True,
                              sigma_axes="reference")  # fmt: skip
    first, second = tmp_path / "a.parquet", tmp_path / "b.parquet"
    quatprop.write(made, first)
    convert(first, second)
    columns = [pq.read_table(path).select(SIGMAS).to_pandas() for path in (first, second)]
    np.testing.assert_allclose(*columns, rtol=1e-12)
    in_reference = reference_covariance(made.wxyz, made.covariance)
    variances = np.diagonal(in_reference, axis1=1, axis2=2)
    np.testing.assert_allclose(columns[0], np.sqrt(variances), rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("out.tum", []),
        ("out.mcap", []),
        ("out.csv", ["--as", "rotvec"]),
        ("out.csv", ["--direction", "ref-to-body"]),
        ("out.csv", ["--from-direction", "ref-to-body"]),
    ],
)
def test_an_output_without_standard_deviations_says_so(table, tmp_path, name, options):
    """As for positions."""
    assert LOST in convert(table, tmp_path / name, *options)


def test_covariances_that_an_output_has_no_place_for_are_said_to_be_lost(table, tmp_path):
    """Of messages as of tables."""
    convert(table, tmp_path / "in.mcap", "--message", "PoseWithCovarianceStamped")
    assert LOST in convert(tmp_path / "in.mcap", tmp_path / "out.tum")


def test_columns_of_other_representations_are_kept_by_writing_them_again(tmp_path):
    """The note names the columns and the option."""
    path, out = tmp_path / "in.csv", tmp_path / "out.csv"
    path.write_text("t_ns,qw,qx,qy,qz," + BESIDE[0] + "0,1,0,0,0," + BESIDE[1])
    assert (
        "note: columns 'yaw_rad', 'pitch_rad', 'roll_rad' are not kept; --with writes such ones"
    ) in convert(path, out)
    assert "not kept" not in convert(path, out, "--with", "euler-zyx")


@pytest.mark.parametrize("changes", [True, False])
@pytest.mark.parametrize("ours", [True, False])
def test_covariances_that_are_constant_at_first_are_kept(tmp_path, changes, ours):
    """A filter may be as sure of its attitude for long; only a driver says the same to the end.

    Of messages that this package wrote it is known that their covariances are none of a driver.
    """
    t_ns = np.arange(19_000, dtype=np.int64) * 10_000_000
    covariance = np.tile(np.diag([0.01, 0.04, 0.09]), (len(t_ns), 1, 1))
    if changes:
        covariance[-1] *= 4
    wxyz = np.tile([1.0, 0, 0, 0], (len(t_ns), 1))
    series = quatprop.AttitudeSeries(t_ns, wxyz, covariance=covariance)
    table, log, back = (tmp_path / name for name in ("in.parquet", "log.mcap", "back.parquet"))
    quatprop.write(series, table)
    convert(table, log, "--message", "PoseWithCovarianceStamped")
    if not ours:
        log.write_bytes(log.read_bytes().replace(b"quatprop", b"another."))
    is_constant = not (changes or ours)
    sentence = "the covariance of the orientation does not change in 19000 messages, so it is"
    assert (sentence in convert(log, back)) == is_constant
    sigmas = [name for name in pq.read_table(back).column_names if name in SIGMAS]
    assert sigmas == ([] if is_constant else SIGMAS)
    if is_constant:
        with pytest.warns(quatprop.RemarkWarning, match=sentence):
            assert quatprop.read_attitudes(log).covariance is None
    else:
        np.testing.assert_allclose(quatprop.read_attitudes(log).covariance, covariance, rtol=1e-14)


def test_covariances_that_are_known_in_part_are_said_to_be_unknown(tmp_path):
    """A row has three standard deviations or none; two of three would be lost unseen."""
    log = tmp_path / "log.mcap"
    diagonals = [[1.0, 4, 9], [1, 4, -1], [1, np.nan, 9], [-1, -1, -1], [np.nan] * 3]
    store = get_typestore(Stores.LATEST)
    make = store.types
    vector = make["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    with log.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        channel = writer.register_channel("/imu", "cdr", schema)
        for second, diagonal in enumerate(diagonals, 1):
            stamp = make["builtin_interfaces/msg/Time"](second, 0)
            message = make["sensor_msgs/msg/Imu"](
                make["std_msgs/msg/Header"](stamp, "imu"),
                make["geometry_msgs/msg/Quaternion"](0.0, 0.6, 0.0, 0.8),
                np.diag(np.array(diagonal, float)).ravel(),
                *(vector, np.zeros(9)) * 2,
            )
            data = bytes(store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
            writer.add_message(channel, second, data, second)
        writer.finish()
    sentence = "the covariances of 2 messages are known in part, which is not kept: they are taken"
    with pytest.warns((quatprop.RemarkWarning, quatprop.DataLossWarning)) as caught:
        series = quatprop.read_attitudes(log, on_invalid="drop")
    assert sum(sentence in str(one.message) for one in caught) == 1
    assert np.isfinite(series.covariance).all(axis=(1, 2)).tolist() == [True, False, False, False]
    assert convert(log, tmp_path / "back.csv", "--on-invalid", "drop", code=3).count(sentence) == 1


def test_messages_without_covariances_have_none_when_they_are_read_again(tmp_path):
    """An Imu has zeros then, which are not exact attitudes: nothing is lost, nothing is sigma."""
    table, log = tmp_path / "in.csv", tmp_path / "log.mcap"
    table.write_text("t_ns,qw,qx,qy,qz\n" + "".join(f"{t},0.6,0.8,0,0\n" for t in range(1, 4)))
    convert(table, log, "--message", "Imu")
    assert LOST not in convert(log, tmp_path / "back.tum")
    assert quatprop.read_attitudes(log).covariance is None
