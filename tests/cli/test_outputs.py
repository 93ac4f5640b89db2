"""The command line's way to every format: kinds, layouts, messages, comments."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from quatprop.cli.commands import cli
from quatprop.writers.formats import WRITERS

TEXT = ("csv", "tsv", "jsonl", "tum", "euroc")


@pytest.fixture
def log(tmp_path):
    """Return a log of three samples, a quarter of a turn about z each."""
    path = tmp_path / "log.csv"
    rows = "".join(f"{1_700_000_000_000_000_000 + k * 10**9},0,0,{np.pi / 2}\n" for k in range(3))
    path.write_text("t_ns,wx,wy,wz\n" + rows)
    return path


def run(*arguments):
    """Run the command as a user would."""
    return CliRunner().invoke(cli, ["propagate", *map(str, arguments)])


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_can_be_asked_for(tmp_path, log, kind):
    """--to is believed, and the output is there."""
    result = run(log, "-o", tmp_path / "out", "--to", kind, "-q")
    assert (result.exit_code, result.output) == (0, "")
    assert (tmp_path / "out").exists()


def test_a_name_without_a_suffix_is_a_ros2_bag(tmp_path, log):
    """As when simulating."""
    assert run(log, "-o", tmp_path / "out", "-q").exit_code == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "metadata.yaml",
        "out.db3",
    ]


@pytest.mark.parametrize("kind", TEXT)
def test_text_can_go_to_stdout(log, kind):
    """Every kind of text is data on stdout."""
    result = run(log, "-o", "-", "--to", kind, "-q")
    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) == 3 + (kind != "jsonl")


def test_a_prescribed_layout_is_taken_and_recorded(tmp_path, log):
    """Without --layout a message is scalar-last, and so its provenance says."""
    run(log, "-o", tmp_path / "out.mcap", "-q")
    with (tmp_path / "out.mcap").open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    assert json.loads(record.metadata["provenance"])["convention"]["layout"] == "scalar-last"


@pytest.mark.parametrize("name", ["out.tum", "out.mcap", "out.bag"])
@pytest.mark.parametrize("layout", ["scalar-first", "wxyz"])
def test_the_other_layout_is_refused_only_when_asked_for(tmp_path, log, name, layout):
    """Scalar-first is the default elsewhere, but here it must not be said."""
    result = run(log, "-o", tmp_path / name, "--layout", layout)
    assert result.exit_code == 2
    assert "scalar-last by its own definition" in result.stderr
    assert sorted(tmp_path.iterdir()) == [log]
    assert run(log, "-o", tmp_path / name, "--layout", "xyzw", "-q").exit_code == 0


def test_transforms_have_the_names_that_were_asked_for(tmp_path, log):
    """--message, --out-topic and --frames stand in the bag."""
    out = tmp_path / "out.bag"
    asked = ("--message", "TFMessage", "--out-topic", "/truth", "--frames", "map,base_link")
    assert run(log, "-o", out, "-q", *asked).exit_code == 0
    with AnyReader([out]) as reader:
        *_, (connection, _, data) = reader.messages()
        (transform,) = reader.deserialize(data, connection.msgtype).transforms
    assert connection.topic == "/truth"
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    rotation = transform.transform.rotation
    found = [rotation.x, rotation.y, rotation.z, rotation.w]
    # Two quarters of a turn about z: the body's x axis points to the reference's -x.
    np.testing.assert_allclose(found, [0, 0, 1, 0], atol=1e-15)


def test_frames_are_two_names(tmp_path, log):
    """One name is not enough."""
    result = run(log, "-o", tmp_path / "out.bag", "--frames", "map")
    assert result.exit_code == 2
    assert "--frames 'map' is not two names; write REFERENCE,BODY" in result.output


def test_a_header_comment_begins_the_text(tmp_path, log):
    """--header-comment puts the report ahead of the columns' names."""
    run(log, "-o", tmp_path / "out.csv", "--header-comment", "-q")
    first, names, *rows = (tmp_path / "out.csv").read_text().splitlines()
    report = json.loads(first.removeprefix("# quatprop "))
    assert report["convention"]["method"] == "start"
    assert report["result"]["samples"] == 3
    assert names == "t_ns,qw,qx,qy,qz"
    assert len(rows) == 3


@pytest.mark.parametrize("kind", TEXT)
def test_a_run_that_fails_says_nothing_on_stdout(tmp_path, kind):
    """The names of columns go out with the first rows, not ahead of an error."""
    log = tmp_path / "log.csv"
    log.write_text("t_ns,wx,wy,wz\n0,0,0,nan\n1000000,0,0,1\n")
    result = run(log, "-o", "-", "--to", kind)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "not finite" in result.stderr


@pytest.mark.parametrize("kind", ["csv", "tum"])
def test_a_series_without_rows_still_has_its_names(tmp_path, kind):
    """A file that was committed begins as every other."""
    from quatprop.writers import open_writer

    with open_writer(tmp_path / "a", kind) as writer:
        writer.commit({})
    first = {"csv": "t_ns,qw,qx,qy,qz\n", "tum": "# timestamp tx ty tz qx qy qz qw\n"}
    assert (tmp_path / "a").read_text() == first[kind]
