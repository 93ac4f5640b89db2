"""`quatprop convert` end to end: files in, files out, and what is refused."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from click.testing import CliRunner
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from quatprop.cli.commands import cli
from quatprop.kinematics.quaternion import geodesic_angle

PLAIN = "t_ns,qw,qx,qy,qz\n1,1,0,0,0\n2,0.8,0.6,0,0\n"


def run(*arguments, code=0):
    """Run `quatprop convert` and return the result."""
    result = CliRunner().invoke(cli, ["convert", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result


def refused(*arguments):
    """Return the sentence with which a conversion is refused."""
    return run(*arguments, code=2).stderr


def table(tmp_path, text, name="in.csv"):
    """Write a text table."""
    path = tmp_path / name
    path.write_text(text)
    return path


def series(path):
    """Return stamps and stored quaternions of a CSV file."""
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    return [int(row[0]) for row in rows], np.array([[float(x) for x in row[1:]] for row in rows])


def provenance(path):
    """Return what a Parquet file says about itself."""
    return json.loads(pyarrow.parquet.read_metadata(path).metadata[b"quatprop"])


@pytest.fixture
def attitudes(tmp_path):
    """Return a CSV of random attitudes at awkward stamps."""
    random = np.random.default_rng(1)
    wxyz = random.normal(size=(1000, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    t_ns = 1_700_000_000_123_456_789 + np.cumsum(random.integers(1, 10**7, 1000))
    rows = [
        ",".join([str(t), *map(repr, row)])
        for t, row in zip(t_ns.tolist(), wxyz.tolist(), strict=True)
    ]
    return table(tmp_path, "t_ns,qw,qx,qy,qz\n" + "\n".join(rows) + "\n", "attitudes.csv")


@pytest.mark.parametrize("suffix", ["parquet", "feather", "csv", "tsv", "tum"])
@pytest.mark.parametrize("terms", [[], ["--convention", "jpl", "--layout", "scalar-last"]])
def test_there_and_back_is_the_same_to_the_bit(tmp_path, attitudes, suffix, terms):
    """Stamps and numbers survive every format, and another convention on the way."""
    if suffix == "tum":
        terms = []
    other, back = tmp_path / f"other.{suffix}", tmp_path / "back.csv"
    run(attitudes, other, *terms)
    said = ["--from-convention", "jpl"] if terms and suffix in {"csv", "tsv"} else []
    run(other, back, *said)
    expected, found = series(attitudes), series(back)
    assert found[0] == expected[0]
    assert (found[1] == expected[1]).all()


def test_metadata_makes_options_needless_and_grows(tmp_path, attitudes):
    """Parquet says what it holds; each conversion is added to what was there before."""
    jpl, plain = tmp_path / "jpl.parquet", tmp_path / "plain.parquet"
    run(attitudes, jpl, "--convention", "jpl", "--direction", "ref-to-body", "--layout", "xyzw")
    said = provenance(jpl)["convention"]
    assert {
        name: said[name] for name in ("representation", "convention", "direction", "layout")
    } == {
        "representation": "quaternion",
        "convention": "jpl",
        "direction": "ref-to-body",
        "layout": "scalar-last",
    }
    assert said["columns"] == ["qx", "qy", "qz", "qw"]
    run(jpl, plain)
    grown = provenance(plain)
    assert grown["convention"]["convention"] == "hamilton"
    assert grown["source"]["path"] == str(attitudes)
    assert [step["source"]["path"] for step in grown["conversions"]] == [str(attitudes), str(jpl)]
    assert [step["from"]["convention"] for step in grown["conversions"]] == ["hamilton", "jpl"]


def test_the_provenance_of_a_propagation_is_kept(tmp_path):
    """Method, q0 and counts of `propagate` are still there after a conversion."""
    log = table(tmp_path, "t_ns,wx,wy,wz\n0,0,0,1\n1000000000,0,0,1\n", "rates.csv")
    first, second = tmp_path / "a.parquet", tmp_path / "b.parquet"
    result = CliRunner().invoke(cli, ["propagate", str(log), "-o", str(first), "--method", "mean"])
    assert result.exit_code == 0, result.output
    run(first, second, "--layout", "scalar-last")
    before, after = provenance(first), provenance(second)
    assert after["source"] == before["source"]
    assert after["counts"] == before["counts"]
    assert after["convention"]["method"] == "mean"
    assert after["convention"]["layout"] == "scalar-last"


def test_provenance_travels_in_a_comment(tmp_path, attitudes):
    """A CSV with its report in a comment needs no options when it is read again."""
    jpl, back = tmp_path / "jpl.csv", tmp_path / "back.csv"
    run(attitudes, jpl, "--convention", "jpl", "--header-comment")
    assert jpl.read_text().startswith('# quatprop {"convention"')
    run(jpl, back)
    assert (
        back.read_text() == attitudes.read_text() or (series(back)[1] == series(attitudes)[1]).all()
    )


def test_metadata_that_contradicts_the_columns_is_refused(tmp_path, attitudes):
    """Columns reordered behind the metadata's back are settled by naming them."""
    good, bad = tmp_path / "good.parquet", tmp_path / "bad.parquet"
    run(attitudes, good)
    found = pyarrow.parquet.read_table(good).select(["t_ns", "qx", "qy", "qz", "qw"])
    said = {b"quatprop": json.dumps(provenance(good))}
    pyarrow.parquet.write_table(found.replace_schema_metadata(said), bad)
    sentence = refused(bad, tmp_path / "out.csv")
    assert (
        "the metadata say scalar-first, but the columns 'qx', 'qy', 'qz', 'qw' are scalar-last by "
        "name; settle it with --from-layout scalar-last" in sentence
    )
    run(bad, tmp_path / "out.csv", "--from-layout", "scalar-last")
    assert (series(tmp_path / "out.csv")[1] == series(attitudes)[1]).all()
    run(bad, tmp_path / "out.csv", "--quat-cols", "qx,qy,qz,qw")
    assert (series(tmp_path / "out.csv")[1] == series(attitudes)[1]).all()


def test_an_option_that_contradicts_the_metadata_is_refused(tmp_path, attitudes):
    """Metadata that says jpl is not overruled."""
    jpl = tmp_path / "jpl.parquet"
    run(attitudes, jpl, "--convention", "jpl")
    assert (
        "--from-convention says hamilton, but the metadata of the file says jpl; leave it out"
        in refused(jpl, tmp_path / "out.csv", "--from-convention", "hamilton")
    )


def test_damaged_metadata_is_refused(tmp_path):
    """Metadata under this package's key that is not JSON is damage."""
    path = tmp_path / "bad.parquet"
    columns = {name: [1.0, 0.0] for name in ("qw", "qx", "qy", "qz")}
    found = pa.table({"t_ns": [1, 2], **columns})
    pyarrow.parquet.write_table(found.replace_schema_metadata({b"quatprop": b"{"}), path)
    assert "its metadata 'quatprop' is not the JSON it should be" in refused(path, "-")


def test_euler_angles_in_degrees_are_those_of_scipy(tmp_path, attitudes):
    """Column names state angle and unit."""
    out = tmp_path / "euler.csv"
    run(attitudes, out, "--as", "euler-zyx", "--euler-unit", "deg")
    assert out.read_text().startswith("t_ns,yaw_deg,pitch_deg,roll_deg\n")
    expected = Rotation.from_quat(series(attitudes)[1], scalar_first=True)
    found = Rotation.from_euler("ZYX", series(out)[1], degrees=True)
    assert (expected * found.inv()).magnitude().max() < 1e-13


def test_rotation_vectors_are_those_of_scipy(tmp_path, attitudes):
    """The short ones, in rad."""
    out = tmp_path / "rotvec.csv"
    run(attitudes, out, "--as", "rotvec")
    assert out.read_text().startswith("t_ns,rotvec_x_rad,rotvec_y_rad,rotvec_z_rad\n")
    expected = Rotation.from_quat(series(attitudes)[1], scalar_first=True).as_rotvec()
    np.testing.assert_allclose(series(out)[1], expected, atol=1e-14)


def test_signs_are_chosen_on_the_way(tmp_path):
    """Continuous follows the row before, positive looks at w alone."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n1,-1,0,0,0\n2,0.8,0.6,0,0\n3,0.6,0.8,0,0\n")
    out = tmp_path / "out.csv"
    run(path, out, "--sign", "continuous")
    assert series(out)[1].tolist() == [[-1, 0, 0, 0], [-0.8, -0.6, 0, 0], [-0.6, -0.8, 0, 0]]
    run(path, out, "--sign", "positive")
    assert series(out)[1].tolist() == [[1, 0, 0, 0], [0.8, 0.6, 0, 0], [0.6, 0.8, 0, 0]]


def test_rows_that_are_no_rotations_leave_the_old_file(tmp_path):
    """They are refused by default; dropped, the exit code says that data was lost."""
    path = table(tmp_path, PLAIN + "3,0,0,0,0\n")
    out = table(tmp_path, "old", "out.csv")
    assert (
        "1 of 3 rows are invalid quaternions (1 all zero), the first is row 2 at 3 ns"
        in refused(path, out)
    )
    assert out.read_text() == "old"
    result = run(path, out, "--on-invalid", "drop", code=3)
    assert "lost: 1 invalid quaternion: 1 zero" in result.stderr
    assert series(out)[0] == [1, 2]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["in.csv", "out.csv"]


def test_rates_without_an_attitude_are_to_be_propagated_first(tmp_path):
    """Where all rows are absent, leaving them out would leave nothing."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n1,nan,nan,nan,nan\n2,nan,nan,nan,nan\n")
    assert refused(path, tmp_path / "out.csv").endswith(
        "none of 2 rows holds an attitude (they are absent, not finite or no rotations); if the "
        "log holds body rates, propagate them first\n"
    )


def test_normalize_scales_what_has_another_length(tmp_path):
    """The summary says how far off it was."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n1,2,0,0,0\n2,0.8,0.6,0,0\n")
    out = tmp_path / "out.csv"
    result = run(path, out, "--normalize")
    assert series(out)[1].tolist() == [[1, 0, 0, 0], [0.8, 0.6, 0, 0]]
    assert result.stderr.splitlines()[1:] == [
        f"out  {out}: 2 rows; hamilton body-to-ref, quaternion, qw,qx,qy,qz",
        "warning: 1 row scaled to unit length, off by up to 1",
    ]


def test_formats_that_only_hold_attitudes_say_so(tmp_path):
    """TUM has one meaning, by its own definition."""
    path = table(tmp_path, PLAIN)
    sentence = refused(path, tmp_path / "out.tum", "--convention", "jpl")
    assert "kind 'tum' holds Hamilton quaternions body to reference by its own" in sentence
    assert "kind 'tum' holds quaternions only" in refused(
        path, tmp_path / "out.tum", "--as", "matrix"
    )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--layout", "wxyz"], "--layout is about quaternions and matrix has none; leave it out"),
        (["--convention", "jpl"], "--convention is about quaternions and matrix has none"),
        (["--sign", "positive"], "--sign is about quaternions and matrix has none; leave it out"),
        (["--euler-unit", "deg"], "--euler-unit goes with euler-zyx and other"),
        (["--message", "TFMessage"], "--message is about quaternions and matrix has none"),
    ],
)
def test_options_without_meaning_are_refused(tmp_path, options, sentence):
    """What would change nothing is a mistake."""
    assert sentence in refused(table(tmp_path, PLAIN), "-", "--as", "matrix", *options)


def test_messages_are_what_was_asked_for(tmp_path):
    """The type of the messages, their topic and their frames can be chosen."""
    out = tmp_path / "out.bag"
    chosen = ("--message", "PoseStamped", "--out-topic", "/pose", "--frames", "map,imu")
    run(table(tmp_path, PLAIN), out, *chosen)
    with AnyReader([out]) as reader:
        (connection,) = reader.connections
        _, _, data = next(reader.messages())
        pose = reader.deserialize(data, connection.msgtype)
    assert (connection.topic, connection.msgtype) == ("/pose", "geometry_msgs/msg/PoseStamped")
    assert pose.header.frame_id == "map"


@pytest.mark.parametrize("terms", [[], ["--convention", "jpl"]])
def test_a_table_holds_no_messages(tmp_path, terms):
    """Messages are for logs of messages, whatever the numbers mean."""
    sentence = refused(
        table(tmp_path, PLAIN), tmp_path / "out.csv", "--message", "TFMessage", *terms
    )
    assert "csv holds no messages; leave --message, --out-topic and --frames out" in sentence


def test_the_input_is_not_replaced(tmp_path):
    """Neither by its name nor by a link to it."""
    path = table(tmp_path, PLAIN)
    link = tmp_path / "link.csv"
    link.symlink_to(path)
    assert "this is an input of the run; choose another output" in refused(path, link)
    assert path.read_text() == PLAIN


def test_stdin_and_stdout_are_pipes(tmp_path):
    """A minus sign reads and writes CSV."""
    result = CliRunner().invoke(cli, ["convert", "-", "-", "--layout", "xyzw", "-q"], input=PLAIN)
    assert result.exit_code == 0, result.output
    assert result.stdout == "t_ns,qx,qy,qz,qw\n1,0,0,0,1\n2,0.6,0,0,0.8\n"
    assert list(tmp_path.iterdir()) == []


def test_an_empty_series_is_refused(tmp_path):
    """A header alone is no series."""
    assert "no samples in 'qw,qx,qy,qz'" in refused(
        table(tmp_path, "t_ns,qw,qx,qy,qz\n"), tmp_path / "out.csv"
    )


def test_a_bag_becomes_a_trajectory(shared_logs, tmp_path):
    """The Vicon topic of a real bag as TUM, and back: stamps and attitudes are the same."""
    tum, back, direct = tmp_path / "v.tum", tmp_path / "back.csv", tmp_path / "direct.csv"
    log = shared_logs / "auk" / "auk.bag"
    run(log, tum, "-t", "/vicon/auk/auk")
    run(tum, back)
    run(log, direct, "-t", "/vicon/auk/auk")
    assert back.read_bytes() == direct.read_bytes()
    assert len(series(back)[0]) == 11161


def test_the_report_is_the_provenance(tmp_path):
    """--report writes what Parquet keeps."""
    path, out, report = table(tmp_path, PLAIN), tmp_path / "out.parquet", tmp_path / "report.json"
    run(path, out, "--report", report)
    assert json.loads(report.read_text()) == provenance(out)
    source = provenance(out)["source"]
    assert source["bytes"] == len(PLAIN)
    assert len(source["sha256"]) == 64


def test_the_rotation_is_the_same_in_every_representation(tmp_path, attitudes):
    """Matrices row by row are scipy's."""
    out = tmp_path / "matrix.csv"
    run(attitudes, out, "--as", "matrix")
    found = Rotation.from_matrix(series(out)[1].reshape(-1, 3, 3)).as_quat(scalar_first=True)
    assert geodesic_angle(found, series(attitudes)[1]).max() < 1e-14


def test_a_file_that_forgets_what_its_numbers_mean_is_remarked_on(tmp_path):
    """A CSV of JPL quaternions reads back as Hamilton, unless it says so."""
    path = table(tmp_path, PLAIN)
    said = "note: the file cannot state that it is jpl body-to-ref, so its reader has to"
    assert said in run(path, tmp_path / "a.csv", "--convention", "jpl").stderr
    for out, more in (("b.csv", ["--header-comment"]), ("c.parquet", [])):
        told = run(path, tmp_path / out, "--convention", "jpl", *more).stderr
        assert "cannot say" not in told
    assert "cannot say" not in run(path, tmp_path / "d.csv").stderr


def test_rows_out_of_order_are_written_as_they_are_and_said(tmp_path):
    """Nothing is lost: exit code 0, and a remark."""
    rows = "t_ns,qw,qx,qy,qz\n5,1,0,0,0\n5,0.8,0.6,0,0\n3,0.6,0.8,0,0\n9,1,0,0,0\n"
    out = tmp_path / "out.csv"
    result = run(table(tmp_path, rows), out)
    assert series(out)[0] == [5, 5, 3, 9]
    assert (
        "the timestamps step back 1 times and repeat the one before 1 times; all rows are written, "
        "in the order in which they are read" in result.stderr
    )
    assert "timestamps step back" not in run(table(tmp_path, PLAIN), tmp_path / "other.csv").stderr
