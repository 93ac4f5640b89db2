"""Positions beside attitudes: kept where source and output have them, said where not."""

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.highlevel import AnyReader

import quatprop
from quatprop.cli.commands import cli
from quatprop.errors import SeriesError

LOST = "the positions beside the attitudes are not kept: the output has no place for them"


def convert(*arguments, code=0):
    """Run `quatprop convert`."""
    result = CliRunner().invoke(cli, ["convert", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result


def trajectory(path):
    """Return the rows of a TUM trajectory as text."""
    return [line.split() for line in path.read_text().splitlines()[1:]]


@pytest.fixture(scope="module")
def vicon(shared_logs, tmp_path_factory):
    """Return the Vicon poses of a recording: as rosbags reads them, and as a TUM trajectory."""
    log = shared_logs / "auk" / "auk.bag"
    with AnyReader([log]) as reader:
        chosen = [one for one in reader.connections if one.topic == "/vicon/auk/auk"]
        messages = [reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages(chosen)]
    points = [one.transform.translation for one in messages]
    path = tmp_path_factory.mktemp("vicon") / "vicon.tum"
    assert LOST not in convert(log, path, "-t", "/vicon/auk/auk").stderr
    return np.array([[p.x, p.y, p.z] for p in points]), path


def test_a_vicon_topic_becomes_a_trajectory_with_its_positions(vicon):
    """To the bit: each number is the shortest decimal that reads back as the same."""
    expected, path = vicon
    assert np.abs(expected).max() > 0.1
    assert (np.array(trajectory(path))[:, 1:4].astype(float) == expected).all()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("euroc.csv", ["--to", "euroc"]),
        ("pose.mcap", ["--message", "PoseStamped"]),
        ("pose.bag", ["--message", "PoseStamped"]),
        ("tf.mcap", ["--message", "TFMessage"]),
    ],
)
def test_formats_with_positions_give_them_back(vicon, tmp_path, name, options):
    """There and back again is the same trajectory, to the byte."""
    _, path = vicon
    there, back = tmp_path / name, tmp_path / "back.tum"
    assert LOST not in convert(path, there, *options).stderr
    assert LOST not in convert(there, back).stderr
    assert back.read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("out.csv", ["--layout", "wxyz"]),
        ("out.parquet", []),
        ("out.mcap", ["--message", "QuaternionStamped"]),
        ("out.mcap", ["--message", "PoseInFrame"]),
        ("out.csv", ["--as", "rotvec"]),
        ("out.tum", ["--from-direction", "ref-to-body"]),
    ],
)
def test_an_output_without_positions_says_so(vicon, tmp_path, name, options):
    """Also one whose positions would be those of another frame: they are zero then."""
    out = tmp_path / name
    assert LOST in convert(vicon[1], out, *options).stderr
    if name.endswith("tum"):
        assert {tuple(row[1:4]) for row in trajectory(out)} == {("0", "0", "0")}


def test_attitudes_without_positions_are_at_the_origin(tmp_path):
    """Nothing is lost, so nothing is said."""
    path, out = tmp_path / "in.csv", tmp_path / "out.tum"
    path.write_text("t_ns,qw,qx,qy,qz\n0,1,0,0,0\n1000000000,0,1,0,0\n")
    assert LOST not in convert(path, out).stderr
    assert [row[1:4] for row in trajectory(out)] == [["0"] * 3] * 2


def test_a_ground_truth_keeps_its_positions(tmp_path):
    """Columns with a unit in their names; attitudes that are dropped take theirs along."""
    path, out = tmp_path / "truth.csv", tmp_path / "out.tum"
    path.write_text(
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
        "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
        "1000000000,1.5,2.5,-3.25,1,0,0,0\n2000000000,9,9,9,0,0,0,0\n3000000000,4,5,6,0,1,0,0\n"
    )
    convert(path, out, "--on-invalid", "drop", code=3)
    assert [row[:4] for row in trajectory(out)] == [
        ["1.000000000", "1.5", "2.5", "-3.25"], ["3.000000000", "4", "5", "6"]
    ]  # fmt: skip


def test_the_library_reads_and_writes_positions(vicon, tmp_path):
    """Attitudes in memory have them too."""
    expected, path = vicon
    series = quatprop.read_attitudes(path)
    assert (series.position == expected).all()
    quatprop.write(series, tmp_path / "again.tum")
    assert (tmp_path / "again.tum").read_bytes() == path.read_bytes()
    assert quatprop.AttitudeSeries([0], [[1, 0, 0, 0]]).position is None
    with pytest.raises(SeriesError, match="position"):
        quatprop.AttitudeSeries([0], [[1, 0, 0, 0]], [[1, 2]])
