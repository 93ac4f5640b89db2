"""`quatprop convert` end to end: files in, files out, and messages."""

import json

import numpy as np
import pyarrow.parquet
import pytest
from make.commands import run
from make.small_files import ATTITUDES, QUATERNION
from make.tables import write_rates
from rosbags.highlevel import AnyReader

import quatprop
from quatprop.base.errors import UsageError

ROWS = ATTITUDES.splitlines()[1:]


def convert(*arguments, code=0, **options):
    """Return what a conversion says."""
    return run("convert", *arguments, code=code, **options).stderr


def table(tmp_path, rows=ROWS):
    """Write rows of attitudes."""
    return write_rates(tmp_path / "in.csv", rows, QUATERNION)


def rows(path):
    """Return the rows of a CSV file."""
    return path.read_text().splitlines()[1:]


def provenance(path):
    """Return what a Parquet file says about itself."""
    return json.loads(pyarrow.parquet.read_metadata(path).metadata[b"quatprop"])


def test_metadata_makes_options_needless_and_grows(tmp_path):
    """Parquet says what it holds; each conversion is added to what was there before."""
    source, jpl, plain = table(tmp_path), tmp_path / "jpl.parquet", tmp_path / "plain.parquet"
    convert(source, jpl, "--convention", "jpl", "--direction", "ref-to-body", "--layout", "xyzw")
    assert provenance(jpl)["convention"].items() >= {
        ("representation", "quaternion"), ("convention", "jpl"), ("direction", "ref-to-body"),
        ("layout", "scalar-last"),
    }  # fmt: skip
    assert provenance(jpl)["convention"]["columns"] == ["qx", "qy", "qz", "qw"]
    report = tmp_path / "report.json"
    convert(jpl, plain, "--report", report)
    grown = provenance(plain)
    assert json.loads(report.read_text()) == grown
    assert grown["convention"]["convention"] == "hamilton"
    assert grown["source"]["path"] == str(source)
    assert [step["source"]["path"] for step in grown["conversions"]] == [str(source), str(jpl)]
    assert [step["from"] for step in grown["conversions"]] == [
        {
            "representation": "quaternion", "layout": layout, "convention": convention,
            "direction": direction, "field": field,
        }
        for layout, convention, direction, field in (
            ("scalar-first", "hamilton", "body-to-ref", "qw,qx,qy,qz"),
            ("scalar-last", "jpl", "ref-to-body", "qx,qy,qz,qw"),
        )
    ]  # fmt: skip


@pytest.mark.parametrize("settled", ["--from-layout scalar-last", "--quat-cols qx,qy,qz,qw"])
def test_columns_reordered_behind_the_metadata_are_settled_by_naming_them(tmp_path, settled):
    """Then they are right."""
    source, good, bad = table(tmp_path), tmp_path / "good.parquet", tmp_path / "bad.parquet"
    convert(source, good)
    found = pyarrow.parquet.read_table(good).select(["t_ns", "qx", "qy", "qz", "qw"])
    said = {b"quatprop": json.dumps(provenance(good))}
    pyarrow.parquet.write_table(found.replace_schema_metadata(said), bad)
    convert(bad, tmp_path / "out.csv", *settled.split())
    assert (tmp_path / "out.csv").read_text() == source.read_text()


@pytest.mark.parametrize(
    ("sign", "expected"),
    [
        ("continuous", ["1,-1,0,0,0", "2,-0.8,-0.6,0,0", "3,-0.6,-0.8,0,0"]),
        ("positive", ["1,1,0,0,0", "2,0.8,0.6,0,0", "3,0.6,0.8,0,0"]),
    ],
)
def test_signs_are_chosen_on_the_way(tmp_path, sign, expected):
    """Continuous follows the row before, positive looks at w alone."""
    path, out = table(tmp_path, ["1,-1,0,0,0", "2,0.8,0.6,0,0", "3,0.6,0.8,0,0"]), tmp_path / "out"
    convert(path, out, "--to", "csv", "--sign", sign)
    found = np.loadtxt(out, delimiter=",", skiprows=1)
    assert found.tolist() == [[float(x) for x in row.split(",")] for row in expected]


def test_rows_that_are_no_rotations_can_be_dropped(tmp_path):
    """The exit code says that data was lost."""
    path, out = table(tmp_path, ["1,1,0,0,0", "2,0.8,0.6,0,0", "3,0,0,0,0"]), tmp_path / "out.csv"
    said = convert(path, out, "--on-invalid", "drop", code=3)
    assert "lost: 1 invalid quaternion: 1 zero" in said
    assert rows(out) == ["1,1,0,0,0", "2,0.8,0.6,0,0"]


def test_normalize_scales_what_has_another_length(tmp_path):
    """The summary says how far off it was."""
    path, out = table(tmp_path, ["1,2,0,0,0", "2,0.8,0.6,0,0"]), tmp_path / "out.csv"
    assert convert(path, out, "--normalize").splitlines()[1:] == [
        f"out  {out}: 2 rows; hamilton body-to-ref, quaternion, qw,qx,qy,qz",
        "warning: 1 row scaled to unit length, off by up to 1",
    ]
    assert rows(out) == ["1,1,0,0,0", "2,0.8,0.6,0,0"]


@pytest.mark.parametrize("message", ["PoseStamped", "TFMessage"])
@pytest.mark.parametrize("command", ["convert", "propagate"])
def test_messages_have_the_requested_type(tmp_path, command, message):
    """The type of the messages, their topic and their frames can be chosen, and their layout."""
    out = tmp_path / "out.bag"
    source = table(tmp_path, ["0,0,0,0,1"])
    if command == "propagate":
        source.write_text(f"t_ns,wx,wy,wz\n0,0,0,{np.pi}\n1000000000,0,0,0\n")
    words = f"--message {message} --out-topic /pose --frames map,imu --layout xyzw".split()
    target = [out] if command == "convert" else ["-o", out]
    run(command, source, *target, *words, code=0)
    with AnyReader([out]) as reader:
        *_, (connection, _, data) = reader.messages()
        found = reader.deserialize(data, connection.msgtype)
    assert (connection.topic, connection.msgtype.split("/")[-1]) == ("/pose", message)
    if message == "TFMessage":
        (found,) = found.transforms
        assert found.child_frame_id == "imu"
    assert found.header.frame_id == "map"
    q = found.transform.rotation if message == "TFMessage" else found.pose.orientation
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [0, 0, 1, 0], atol=1e-15)


def test_stdin_and_stdout_are_pipes():
    """A minus sign reads and writes CSV."""
    result = run("convert", "-", "-", "--layout", "xyzw", "-q", input=ATTITUDES, code=0)
    assert result.output == "t_ns,qx,qy,qz,qw\n1,0,0,0,1\n2,0.6,0,0,0.8\n"


def test_another_representation_is_refused(tmp_path):
    """In Python; the command lists its choices."""
    with pytest.raises(UsageError, match=r"^no representation 'rpy'; choose one of "):
        quatprop.convert(table(tmp_path), tmp_path / "out.csv", representation="rpy")


def test_a_comment_states_what_a_csv_cannot(tmp_path):
    """Without it, a remark says that the file does not record the JPL convention."""
    options = ("--convention", "jpl", "--header-comment")
    assert "does not record" not in convert(table(tmp_path), tmp_path / "out.csv", *options)


def test_rows_out_of_order_are_written_with_a_remark(tmp_path):
    """Nothing is lost: exit code 0, and a remark."""
    unordered = ["5,1,0,0,0", "5,0.8,0.6,0,0", "3,0.6,0.8,0,0", "9,1,0,0,0"]
    out = tmp_path / "out.csv"
    said = convert(table(tmp_path, unordered), out)
    assert rows(out) == unordered
    assert (
        "note: the timestamps step back 1 times and repeat the one before 1 times; all rows are "
        "written, in the order in which they are read" in said
    )
