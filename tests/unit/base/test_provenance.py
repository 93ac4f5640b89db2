"""How a file came about: kept, read back and extended by every format that has room for it."""

import hashlib
import json
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from make.commands import refused, run
from make.reading import attitudes
from make.tables import write_rates
from make.writing import write_series
from mcap.writer import Writer as McapWriter

from quatprop import GyroSeries, propagate, read_rates
from quatprop.base.errors import DamagedLogError, UnreadableLogError, UsageError
from quatprop.base.provenance import Digest, as_json, background_digest, digest_of
from quatprop.base.text import Setting
from quatprop.base.times import Instant
from quatprop.kinematics.series import AttitudeSeries
from quatprop.readers.open_log import open_log
from quatprop.writers.formats import WRITERS, keeps_provenance

COMMENTED = {kind for kind, known in WRITERS.items() if known.comments}
CARRIERS = sorted({kind for kind, known in WRITERS.items() if known.keeps_provenance} | COMMENTED)
ROS = ("mcap", "bag", "rosbag2", "rosbag2-mcap")
ATTITUDES = AttitudeSeries(np.array([5, 6]), np.array([[1.0, 0, 0, 0], [0.6, 0.8, 0, 0]]))


def told(path):
    """Return what a file says of itself, as its reader gives it."""
    return attitudes(path)[0].provenance


def written(path, kind, said):
    """Write attitudes with any provenance."""
    return write_series(path, ATTITUDES, kind=kind, told=said, comment=kind in COMMENTED)


def place(folder, number, kind):
    """Return a name for a file of a kind, by which it can be told."""
    suffix = {"euroc": "euroc.csv"}.get(kind, kind)
    return folder / (f"{number}" if kind.startswith("rosbag2") else f"{number}.{suffix}")


@pytest.fixture
def rates(tmp_path):
    """Return a log of two samples."""
    return write_rates(tmp_path / "rates.csv", ["1000000000,0,0,1", "2000000000,0,0,1"])


@pytest.mark.parametrize("kind", CARRIERS)
def test_every_format_with_room_keeps_it_word_for_word(tmp_path, kind):
    """The reader returns the provenance of the writer, whatever letters are in it."""
    said = {"quatprop": "1", "path": "b\u00fcgel \u2028\n\t'\"#.bag", "numbers": [1.5, None]}
    assert told(written(tmp_path / "file", kind, said)) == said


@pytest.mark.parametrize("kind", CARRIERS)
def test_conversions_are_added_one_after_the_other(tmp_path, rates, kind):
    """Source, method and counts of the propagation stay; each conversion is one step of history."""
    first, second = place(tmp_path, 1, kind), place(tmp_path, 2, kind)
    last = tmp_path / "last.parquet"
    comment = ["--header-comment"] if kind in COMMENTED else []
    run("propagate", rates, "-o", first, "--to", kind, "--method", "mean", *comment, code=0)
    run("convert", first, second, "--to", kind, "--sign", "positive", *comment, code=0)
    run("convert", second, last, code=0)
    begun, end = told(first), told(last)
    for key in ("counts", "policy", "correction", "result", "source"):
        assert end[key] == begun[key]
    assert end["convention"]["method"] == "mean"
    steps = end["conversions"]
    assert [step["source"]["path"] for step in steps] == [str(first), str(second)]
    assert [step["source"]["sha256"] for step in steps] == [
        digest_of(first).sha256, digest_of(second).sha256,
    ]  # fmt: skip
    assert [step["to"]["sign"] for step in steps] == ["positive", "keep"]


@pytest.mark.parametrize("kind", sorted({*CARRIERS} - {*ROS, "tum", "euroc"}))
def test_numbers_of_another_convention_need_no_options(tmp_path, kind):
    """A table says what its numbers mean; who says otherwise is refused."""
    source = written(place(tmp_path, 1, kind), kind, {})
    jpl, back = place(tmp_path, 2, kind), place(tmp_path, 3, kind)
    comment = ["--header-comment"] if kind in COMMENTED else []
    run("convert", source, jpl, "--convention", "jpl", "--layout", "xyzw", *comment, code=0)
    run("convert", jpl, back, *comment, code=0)
    assert attitudes(back)[2].tolist() == ATTITUDES.wxyz.tolist()
    said = refused("convert", jpl, back, "--from-convention", "hamilton")
    assert "--from-convention says hamilton, but the metadata of the file says jpl" in said


@pytest.mark.parametrize("kind", ROS)
def test_metadata_of_messages_are_believed_but_not_against_their_definition(
    tmp_path, monkeypatch, kind
):
    """They can be declared JPL; scalar-first, or invalid JSON, is settled by the user."""
    jpl = written(tmp_path / "jpl", kind, {"convention": {"convention": "jpl"}})
    source, _, wxyz, _ = attitudes(jpl)
    assert source.meaning.convention == "jpl"
    assert wxyz.tolist() == [[1, 0, 0, 0], [0.6, -0.8, 0, 0]]
    with pytest.raises(UsageError, match="from_convention says hamilton, but the metadata"):
        attitudes(jpl, from_convention="hamilton")

    first = written(tmp_path / "first", kind, {"convention": {"layout": "scalar-first"}})
    sentence = (
        "the metadata say scalar-first, but 'quaternion' of "
        "'geometry_msgs/msg/QuaternionStamped' is scalar-last by definition; settle it with "
        "from_layout='scalar-last'"
    )
    with pytest.raises(UsageError, match=sentence):
        told(first)
    assert len(attitudes(first, from_layout="scalar-last")[2]) == 2

    for module in ("mcap", "rosbag1", "rosbag2"):
        monkeypatch.setattr(f"quatprop.writers.{module}.provenance_json", lambda _provenance: "{")
    damaged = written(tmp_path / "damaged", kind, {"method": "start"})
    with pytest.raises(DamagedLogError, match="its metadata 'quatprop' is not the JSON it should"):
        told(damaged)


def test_metadata_of_another_topic_are_not_taken(tmp_path):
    """One file may hold several topics of ours and others; each has its own provenance."""
    path = tmp_path / "log.mcap"
    definition = "geometry_msgs/Quaternion quaternion\n"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2", "test")
        schema = writer.register_schema("geometry_msgs/msg/QuaternionStamped", "ros2msg",
                                        definition.encode())  # fmt: skip
        for topic in ("/a", "/b", "/c"):
            writer.register_channel(topic, "cdr", schema)
        for topic in ("/a", "/b"):
            said = {"provenance": json.dumps({"of": topic}), "topic": topic}
            writer.add_metadata("quatprop", said)
        writer.add_metadata("quatprop", {"something": "else"})
        writer.add_metadata("other", {"provenance": "{}"})
        writer.finish()
    with open_log(path) as log:
        assert [log.provenance(topic) for topic in ("/a", "/b", "/c")] == [
            {"of": "/a"}, {"of": "/b"}, {},
        ]  # fmt: skip


def test_a_cut_mcap_file_has_no_provenance_but_its_messages(tmp_path):
    """The index of the metadata is at the end of the file; the messages do not need it."""
    path = written(tmp_path / "log.mcap", "mcap", {"quatprop": "1"})
    path.write_bytes(path.read_bytes()[:-30])
    assert told(path) == {}


def test_a_provenance_of_an_archive_that_is_longer_than_any_is_not_unpacked(tmp_path, monkeypatch):
    """A few bytes of it may be gigabytes; here the limit is ten letters of four bytes."""
    monkeypatch.setattr("quatprop.readers.tables.numpy_table._LONGEST_PROVENANCE", 40)
    path = tmp_path / "log.npz"
    columns = {"t_ns": [1], "qw": [1.0], "qx": [0.0], "qy": [0.0], "qz": [0.0]}
    np.savez_compressed(path, **columns, quatprop='{"a": "b"}')
    assert told(path) == {"a": "b"}
    np.savez_compressed(path, **columns, quatprop='{"a":  "b"}')
    with pytest.raises(DamagedLogError, match="its metadata 'quatprop' is not the JSON"):
        told(path)


# By what a source can be told again.


def facts(path):
    """Return the size and the SHA-256 of a file."""
    content = Path(path).read_bytes()
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def test_files_next_to_the_log_are_recorded_too(tmp_path, monkeypatch):
    """The log, and what a setting names, are in metadata and reports with size and SHA-256."""
    monkeypatch.chdir(tmp_path)
    texts = {
        "q0.csv": "t_ns,qw,qx,qy,qz\n0,1,0,0,0\n3000000000,1,0,0,0\n",
        "at.csv": "t_ns,qw,qx,qy,qz\n1500000000,1,0,0,0\n",
        "bias.csv": "#timestamp,b_w_RS_S_x,b_w_RS_S_y,b_w_RS_S_z\n0,0,0,0\n3000000000,0,0,0\n",
        "calibration.yaml": "matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n",
        "imu.yaml": "gyroscope_noise_density: 1e-4\n",
    }
    for name, text in texts.items():
        Path(name).write_text(text)
    settings = {name.partition(".")[0]: name for name in texts}
    expected = {name: facts(name) for name in texts}
    options = [part for name, file in settings.items() for part in (f"--{name}", file)]
    write_rates(Path("rates.csv"), ["1000000000,0,0,0.1", "2000000000,0,0,0.1"])
    run("propagate", "rates.csv", "-o", "out.parquet", "--report", "out.json", *options, code=0)
    for said in (told("out.parquet"), json.loads(Path("out.json").read_text())):
        assert said["files"] == expected
        assert said["source"].items() >= facts("rates.csv").items()
        assert "digest" not in said["source"]
    rates = GyroSeries([10**9, 2 * 10**9], [[0, 0, 0.1], [0, 0, 0.2]])
    series = propagate(rates, **settings)
    assert as_json(series.report.files) == expected
    # In a batch files have names; one that begins like another keeps its own.
    named = series.report.with_display_names("LOG", {"imu": "X", "imu.yaml": "Y"})
    assert "Y" in named["settings"].values()
    assert propagate(rates, q0="1,0,0,0").report.files == {}


def test_a_source_is_not_read_twice_for_nothing(tmp_path, rates, monkeypatch):
    """A CSV keeps no provenance, so none is found out: unless a comment or a report asks for it."""
    began = []

    def begin(path, *, hashed=True):
        began.append(hashed)
        return background_digest(path, hashed=hashed)

    for module in ("quatprop.propagation.job", "quatprop.tools.conversion"):
        monkeypatch.setattr(f"{module}.background_digest", begin)
    out = tmp_path / "out.csv"
    for options in ([], ["--header-comment"], ["--report", tmp_path / "report.json"]):
        run("propagate", rates, "-o", out, *options, code=0)
        run("convert", out, tmp_path / "converted.csv", *options, code=0)
    assert began == [False, False, True, True, True, True]
    with background_digest(rates, hashed=False) as digest:
        assert digest() == Digest(rates.stat().st_size)
    assert not keeps_provenance("a.csv")
    assert keeps_provenance("a.csv", comment=True)
    assert keeps_provenance("a.npz")


def test_stdin_has_no_digest():
    """The report states that there is none."""
    words = ("propagate", "-", "-o", os.devnull, "--to", "csv", "-q", "--report", "-")
    result = run(*words, input="t_ns,wx,wy,wz\n1,0,0,1\n2,0,0,1\n", code=0)
    source = json.loads(result.stdout)["source"]
    assert (source["bytes"], source["sha256"]) == (None, None)


def test_every_file_of_a_folder_has_a_digest(tmp_path):
    """Each file has its own sum; that of all is what `sha256sum * | sha256sum` prints."""
    (tmp_path / "inner").mkdir()
    for name, text in (("b_0.db3", "one"), ("a.yaml", "two")):
        (tmp_path / name).write_text(text)
    parts = {name: facts(tmp_path / name) for name in ("a.yaml", "b_0.db3")}
    lines = "".join(f"{part['sha256']}  {name}\n" for name, part in parts.items())
    whole = {"bytes": 6, "sha256": hashlib.sha256(lines.encode()).hexdigest()}
    assert digest_of(tmp_path).as_json() == {**whole, "files": parts}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_not_waited_for(tmp_path):
    """Neither by itself nor in a folder; nothing is not there either."""
    os.mkfifo(tmp_path / "pipe")
    nothing = Digest()
    assert digest_of(tmp_path / "pipe") == nothing
    assert digest_of(tmp_path) == nothing
    assert digest_of(tmp_path / "none") == nothing
    with pytest.raises(UnreadableLogError, match="it cannot be read: 'File name too long'"):
        digest_of(tmp_path / ("x" * 300))


def test_a_run_that_fails_leaves_no_thread_behind(tmp_path, rates):
    """A large source is not read to its end for a result that there will not be."""
    read_rates(rates)  # the parser of CSV keeps the thread that it works in
    threads = set(threading.enumerate())
    with background_digest(rates):
        pass
    assert not set(threading.enumerate()) - threads
    (tmp_path / "bad.csv").write_text("t_ns,wx,wy,wz\n5,0,0,1\n1,0,0,1\n")
    run("propagate", tmp_path / "bad.csv", "-o", tmp_path / "out.parquet", code=2)
    assert not set(threading.enumerate()) - threads


def test_results_become_json_in_one_place():
    """Dataclasses, arrays, paths and sentences are JSON-ready, however they are nested."""
    place = Instant(5, "first")
    value = {"at": place, "q": np.array([1.0, 0.0]), "n": np.int64(3), "p": Path("a"), "x": (None,)}
    value["why"] = [f"use {Setting('clock', 'header|log')}"]
    assert json.loads(json.dumps(as_json(value))) == {
        "at": {"ns": 5, "origin": "first"},
        "q": [1.0, 0.0],
        "n": 3,
        "p": "a",
        "x": [None],
        "why": ["use clock='header' or 'log'"],
    }
