"""Standard deviations beside attitudes: kept where source and output have them, said where not."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import quatprop
from quatprop.cli import cli
from quatprop.kinematics.uncertainty import reference_covariance

LOST = "the standard deviations or covariances of the attitudes are not kept"
SIGMAS = ["sigma_x", "sigma_y", "sigma_z"]
HEADER = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z\n"
ROWS = ("0,1,0,0,0,0,0,0\n", "1000000000,0.6,0,0.8,0,0.1,0.2,0.3\n")
BESIDE = ("yaw_rad,pitch_rad,roll_rad\n", "0,0,0\n")


def convert(*arguments):
    """Return what `quatprop convert` says."""
    result = CliRunner().invoke(cli, ["convert", *map(str, arguments)])
    assert result.exit_code == 0, result.output
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
