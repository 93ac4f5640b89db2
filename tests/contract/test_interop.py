"""What is written opens in other people's software with the same numbers, and theirs in ours."""

import io
import json
import zipfile
from functools import partial

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from evo.core.trajectory import PosePath3D, PoseTrajectory3D
from evo.tools import file_interface
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from mcap.reader import NonSeekingReader, SeekingReader
from pyarrow import csv, feather, parquet
from pyarrow import json as arrow_json
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from quatprop import RemarkWarning, read_attitudes
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.series import AttitudeSeries
from quatprop.writers import open_writer

ROWS = 2_000
T_NS = 1_700_000_000_123_456_789 + np.arange(ROWS, dtype=np.int64) * 5_000_001
WXYZ = Rotation.random(ROWS, rng=8).as_quat(scalar_first=True)
NAMES = {"scalar-first": ["qw", "qx", "qy", "qz"], "scalar-last": ["qx", "qy", "qz", "qw"]}
STORED = {"scalar-first": WXYZ, "scalar-last": np.roll(WXYZ, -1, axis=1)}
VECTORS = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
XYZ = np.arange(9.0).reshape(3, 3)
PATH = PoseTrajectory3D(XYZ, WXYZ[:3], np.array([0.0, 0.1, 0.2]))


def written(folder, kind, layout=None, name=None):
    """Write the attitudes and return the file."""
    path = folder / (name or f"attitude.{kind}")
    with open_writer(path, kind, layout=layout) as writer:
        writer.write(AttitudeSeries(T_NS, WXYZ))
        writer.commit({"quatprop": "1.0"})
    return path


def _numpy_archive(path):
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files if name != "quatprop"}


def _numpy_records(path):
    rows = np.load(path)
    return {name: rows[name] for name in rows.dtype.names}


def _numpy_text(path):
    names = path.read_text().partition("\n")[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    stamps = np.loadtxt(path, delimiter=",", skiprows=1, usecols=0, dtype=np.int64)
    return {names[0]: stamps, **dict(zip(names[1:], rows.T[1:], strict=True))}


def _lines(path):
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _arrow(read):
    return lambda path: {k: v.to_numpy() for k, v in zip(*_parts(read(path)), strict=True)}


def _parts(table):
    return table.column_names, table.columns


def _pandas(read):
    return lambda path: {name: column.to_numpy() for name, column in read(path).items()}


def _polars(read):
    return lambda path: {column.name: column.to_numpy() for column in read(path)}


EXACT = {"float_precision": "round_trip"} if pd.__version__ < "3" else {}
"""Reads numbers to the last bit, as pandas 3 does by itself."""


READ = {
    ("csv", "numpy"): _numpy_text,
    ("csv", "pandas"): _pandas(partial(pd.read_csv, **EXACT)),
    ("csv", "polars"): _polars(pl.read_csv),
    ("csv", "pyarrow"): _arrow(csv.read_csv),
    ("tsv", "pandas"): _pandas(partial(pd.read_csv, sep="\t", **EXACT)),
    ("tsv", "polars"): _polars(lambda path: pl.read_csv(path, separator="\t")),
    ("jsonl", "json"): _lines,
    ("jsonl", "pandas"): _pandas(lambda path: pd.read_json(path, lines=True, precise_float=True)),
    ("jsonl", "polars"): _polars(pl.read_ndjson),
    ("jsonl", "pyarrow"): _arrow(arrow_json.read_json),
    ("parquet", "pyarrow"): _arrow(parquet.read_table),
    ("parquet", "pandas"): _pandas(pd.read_parquet),
    ("parquet", "polars"): _polars(pl.read_parquet),
    ("feather", "pyarrow"): _arrow(feather.read_table),
    ("feather", "pandas"): _pandas(pd.read_feather),
    ("feather", "polars"): _polars(pl.read_ipc),
    ("npy", "numpy"): _numpy_records,
    ("npz", "numpy"): _numpy_archive,
}


@pytest.mark.parametrize("layout", NAMES)
@pytest.mark.parametrize(("kind", "reader"), READ)
def test_tables_open_elsewhere(tmp_path, kind, reader, layout):
    """Names, order, types and every bit of stamps and components are the same."""
    found = READ[kind, reader](written(tmp_path, kind, layout))
    assert list(found) == ["t_ns", *NAMES[layout]]
    assert found["t_ns"].dtype == np.int64
    assert found["t_ns"].tolist() == T_NS.tolist()
    stored = np.column_stack([found[name] for name in NAMES[layout]])
    assert stored.tobytes() == STORED[layout].tobytes()


@pytest.mark.parametrize("layout", NAMES)
def test_scipy_turns_vectors_the_same_way(tmp_path, layout):
    """Rotation.from_quat with the scalar where the layout has it gives the matrices we write."""
    table = parquet.read_table(written(tmp_path, "parquet", layout))
    stored = np.column_stack([table[name] for name in NAMES[layout]])
    rotation = Rotation.from_quat(stored, scalar_first=layout == "scalar-first")
    matrices = tmp_path / "matrices.npy"
    run("convert", tmp_path / "attitude.parquet", matrices, "--as", "matrix", code=0)
    rows = np.load(matrices)
    expected = np.stack([rows[f"r{i}{j}"] for i in "123" for j in "123"], 1).reshape(-1, 3, 3)
    for vector in VECTORS:
        np.testing.assert_allclose(rotation.apply(vector), expected @ vector, atol=1e-15)


@pytest.mark.parametrize(
    ("form", "columns", "rebuild"),
    [
        ("euler-zyx", ("yaw_rad", "pitch_rad", "roll_rad"), partial(Rotation.from_euler, "ZYX")),
        (
            "euler-zyx --euler-unit deg",
            ("yaw_deg", "pitch_deg", "roll_deg"),
            partial(Rotation.from_euler, "ZYX", degrees=True),
        ),
        ("rotvec", [f"rotvec_{axis}_rad" for axis in "xyz"], Rotation.from_rotvec),
    ],
)
def test_angles_and_vectors_mean_to_scipy_what_they_are_called(tmp_path, form, columns, rebuild):
    """Columns yaw, pitch, roll are intrinsic ZYX; rotation vectors are scipy's."""
    target = tmp_path / "out.parquet"
    run("convert", written(tmp_path, "npz"), target, "--as", *form.split(), code=0)
    table = parquet.read_table(target)
    rows = np.column_stack([table[name] for name in columns])
    assert geodesic_angle(rebuild(rows).as_quat(scalar_first=True), WXYZ).max() < 2e-14


def test_evo_reads_trajectories(tmp_path):
    """TUM and EuRoC files have the same quaternions in evo; its stamps are float64 seconds."""
    tum = file_interface.read_tum_trajectory_file(written(tmp_path, "tum"))
    euroc = file_interface.read_euroc_csv_trajectory(written(tmp_path, "euroc", name="euroc.csv"))
    for found in (tum, euroc):
        valid, _ = found.check()
        assert valid
        np.testing.assert_array_equal(found.orientations_quat_wxyz, WXYZ)
        np.testing.assert_array_equal(found.positions_xyz, np.zeros((ROWS, 3)))
        np.testing.assert_allclose(found.timestamps, T_NS / 1e9, rtol=0, atol=2.4e-7)


@pytest.mark.parametrize("kind", ["bag", "rosbag2", "rosbag2-mcap"])
def test_rosbags_reads_every_message(tmp_path, kind):
    """AnyReader opens bags of both kinds, and each message has its stamp, frame and quaternion."""
    path = written(tmp_path, kind, name="attitude.bag" if kind == "bag" else "attitude")
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=store) as reader:
        assert reader.message_count == ROWS
        messages = [
            (log_ns, reader.deserialize(data, connection.msgtype))
            for connection, log_ns, data in reader.messages()
        ]
    stamps = [one.header.stamp for _, one in messages]
    assert [log_ns for log_ns, _ in messages] == T_NS.tolist()
    assert [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps] == T_NS.tolist()
    quaternions = [one.quaternion for _, one in messages]
    found = np.array([[q.w, q.x, q.y, q.z] for q in quaternions])
    assert found.tobytes() == WXYZ.tobytes()
    assert {one.header.frame_id for _, one in messages} == {"reference"}


@pytest.mark.parametrize("reader_of", [SeekingReader, NonSeekingReader])
def test_the_mcap_package_reads_every_message_and_every_checksum(tmp_path, reader_of):
    """Its readers pass over the file with CRCs validated, along the index and straight through."""
    path = written(tmp_path, "mcap")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("rb") as file:
        messages = list(reader_of(file, validate_crcs=True).iter_messages())
    assert [message.log_time for _, _, message in messages] == T_NS.tolist()
    schema, channel, _ = messages[0]
    assert (schema.name, schema.encoding) == ("geometry_msgs/msg/QuaternionStamped", "ros2msg")
    assert (channel.topic, channel.message_encoding) == ("/attitude", "cdr")
    found = [store.deserialize_cdr(one.data, schema.name).quaternion for _, _, one in messages]
    assert np.array([[q.w, q.x, q.y, q.z] for q in found]).tobytes() == WXYZ.tobytes()
    with path.open("rb") as file:
        records = list(SeekingReader(file, validate_crcs=True).iter_metadata())
    assert [json.loads(one.metadata["provenance"]) for one in records] == [{"quatprop": "1.0"}]


def test_provenance_is_where_other_software_finds_it(tmp_path):
    """Keys of a schema, a string in an archive: nothing of ours is needed to read it."""
    said = {"quatprop": "1.0"}
    metadata = parquet.read_metadata(written(tmp_path, "parquet")).metadata
    assert json.loads(metadata[b"quatprop"]) == said
    schema = pa.ipc.open_file(written(tmp_path, "feather")).schema
    assert json.loads(schema.metadata[b"quatprop"]) == said
    path = written(tmp_path, "npz")
    assert json.loads(str(np.load(path)["quatprop"])) == said
    assert zipfile.ZipFile(path).testzip() is None


def test_a_trajectory_of_evo_is_read_as_it_is(tmp_path):
    """As TUM, and as KITTI has them: twelve numbers a row and no time, which a rate gives."""
    path, kitti = tmp_path / "poses.tum", tmp_path / "poses.kitti"
    file_interface.write_tum_trajectory_file(path, PATH)
    np.testing.assert_allclose(read_attitudes(path).wxyz, WXYZ[:3], atol=1e-9)
    file_interface.write_kitti_poses_file(kitti, PosePath3D(XYZ, WXYZ[:3]))
    with pytest.warns(RemarkWarning, match="which of q and -q is meant is not stored"):
        series = read_attitudes(kitti, sample_rate=10)
    assert geodesic_angle(series.wxyz, WXYZ[:3]).max() < 1e-9
    np.testing.assert_array_equal(series.t_ns, [0, 100_000_000, 200_000_000])
    run("convert", kitti, path, "--sample-rate", "10", code=0)
    again = file_interface.read_tum_trajectory_file(path)
    np.testing.assert_allclose(again.positions_xyz, XYZ, atol=1e-9)
    kitti.rename(tmp_path / "poses.txt")
    with pytest.warns(RemarkWarning, match="which of q and -q is meant is not stored"):
        other = read_attitudes(tmp_path / "poses.txt", kind="kitti", sample_rate=10)
    np.testing.assert_array_equal(other.wxyz, series.wxyz)


def test_a_trajectory_of_kitti_needs_a_rate_and_twelve_columns(tmp_path):
    """What is missing is named."""
    path = tmp_path / "poses.kitti"
    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    rate = "or --sample-rate HZ for rows at a steady rate"
    assert rate in refused("convert", path, "-")
    path.write_text("1 0 0 0\n")
    columns = "it has 4 columns, and a KITTI trajectory has 12: r11 r12 r13 tx"
    assert columns in refused("convert", path, "-")


def test_a_trajectory_is_written_as_kitti_has_them(tmp_path):
    """It finds nothing to complain about; quatprop reads KITTI again, given a rate."""
    source, path = tmp_path / "poses.tum", tmp_path / "poses.kitti"
    file_interface.write_tum_trajectory_file(source, PATH)
    lost = "the timestamps are not kept: kitti has no place for them"
    assert lost in run("propagate", SAMPLE_LOGS / "spin.csv", "-o", path, code=0).stderr
    assert lost in run("convert", source, path, code=0).stderr
    found = file_interface.read_kitti_poses_file(path)
    is_valid, said = found.check()
    assert is_valid
    assert said["SE(3) conform"] == "yes"
    np.testing.assert_allclose(found.positions_xyz, XYZ, atol=1e-15)
    expected = Rotation.from_quat(WXYZ[:3], scalar_first=True).as_matrix()
    np.testing.assert_allclose(np.array(found.poses_se3)[:, :3, :3], expected, atol=1e-9)
    again = tmp_path / "again.kitti"
    run("convert", path, again, "--sample-rate", "10", code=0)
    np.testing.assert_allclose(np.loadtxt(again), np.loadtxt(path), atol=1e-15)


def test_attitudes_become_rows_of_kitti_at_the_origin(tmp_path):
    """A quarter turn about z takes x to y; the rows of the matrix follow one another."""
    log, path = tmp_path / "spin.csv", tmp_path / "spin.kitti"
    run("simulate", log, "--frequency", "0.25", "--duration", "2s", "--rate", "1", code=0)
    run("propagate", log, "-o", path, code=0)
    rows = np.loadtxt(path).round(12) + 0.0
    assert rows.tolist() == [
        [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0],
        [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0],
    ]
    truth = tmp_path / "spin.truth.csv"
    sentence = refused("convert", truth, "-", "--to", "kitti", "--header-comment")
    assert "kitti has no comments; leave --header-comment out" in sentence


def test_columns_that_are_only_components_mean_a_quaternion_where_one_is_asked_for(tmp_path):
    """As NGIMU's quaternion.csv has them; by themselves they are not taken for one."""
    path = tmp_path / "quaternion.csv"
    frame = pd.DataFrame(WXYZ[:3], columns=list("WXYZ"))
    frame.insert(0, "Time (s)", [0.0, 0.1, 0.2])
    frame.to_csv(path, index=False)
    for columns in ("W,X,Y,Z", "X,Y,Z,W"):
        series = read_attitudes(path, quat_cols=columns)
        np.testing.assert_array_equal(series.wxyz, WXYZ[:3])
    refused("convert", path, "-")


@pytest.mark.parametrize("kind", ["parquet", "feather", "mcap", "csv"])
def test_a_format_is_written_to_a_pipe(tmp_path, kind):
    """The bytes are those of the file; tables open in pandas and polars without an option."""
    log, out = SAMPLE_LOGS / "coning.mcap", tmp_path / f"a.{kind}"
    run("propagate", log, "-o", out, "-q", code=0)
    data = run("propagate", log, "-o", "-", "--to", kind, "-q", code=0).stdout_bytes
    assert data == out.read_bytes()
    if kind in {"parquet", "csv"}:
        read = {"parquet": pl.read_parquet, "csv": pl.read_csv}[kind]
        assert read(io.BytesIO(data)).schema["t_ns"] == pl.Int64
        read = {"parquet": pd.read_parquet, "csv": pd.read_csv}[kind]
        assert read(io.BytesIO(data))["t_ns"].dtype == np.int64
