"""Files that logs are read from: opened once, read from several threads, recognised as files."""

import builtins
import errno
import gzip
import io
import os
import shutil
import struct
import threading
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
from make.camera_log import write_mcap
from make.commands import refused, run
from make.mcap import Topic, write_topics
from make.places import SAMPLE_LOGS
from make.systems import on_posix
from make.ulog import added, gyro, write
from make.worn import wear
from mcap.reader import make_reader

from quatprop import read_rates
from quatprop.base.errors import (
    DataLossWarning,
    LogError,
    RemarkWarning,
    UnknownFormatError,
    UnreadableLogError,
    UsageError,
)
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.open_log import open_log
from quatprop.stores.file_source import GAP, MAX_SECTORS, SHARE, FileSource, ranges_worth_reading
from quatprop.stores.kinds import kind_of

SIZE = 8 * GAP
"""Bytes of a chunk."""

needs_pipes = pytest.mark.skipif(not Path("/dev/fd").exists(), reason="no pipes of POSIX here")


@pytest.fixture
def opened(monkeypatch):
    """Return the names of all files that are opened."""
    names = []
    for module in (builtins, io, os):

        def noted(file, *arguments, original=module.open, **options):
            names.append(str(file))
            return original(file, *arguments, **options)

        monkeypatch.setattr(module, "open", noted)
    return names


@pytest.mark.parametrize(
    ("words", "times"),
    [
        ("propagate coning.mcap -o out.csv", 2),
        ("propagate tumbling.bag -o out.csv", 2),
        ("propagate gyro.ulg -o out.csv", 2),
        ("info coning.mcap", 1),
    ],
)
def test_a_run_opens_its_log_once(tmp_path, monkeypatch, opened, words, times):
    """Channels, messages and provenance share one open file.

    The SHA-256 of the log is taken in a thread that opens it for itself.
    """
    monkeypatch.chdir(tmp_path)
    log = words.split()[1]
    if log == "gyro.ulg":
        write(Path(log), added("sensor_gyro", 0, 1), *gyro(1, range(5000, 500_000, 5000), 1e-6))
    else:
        shutil.copy(SAMPLE_LOGS / log, log)
    opened.clear()
    run(*words.split(), code=0)
    assert opened.count(log) == times


@pytest.mark.parametrize("positional", [True, False])
def test_threads_read_at_their_own_places(tmp_path, monkeypatch, positional):
    """No thread moves the place at which another reads, nor where reads have no place of theirs."""
    if not positional:
        monkeypatch.delattr("os.pread", raising=False)
    path = tmp_path / "numbers"
    path.write_bytes(b"".join(number.to_bytes(4, "big") for number in range(50_000)))
    wrong = []

    def read(first):
        numbers = range(first, 50_000, 7)
        wrong.extend(n for n in numbers if source.read(4 * n, 4) != n.to_bytes(4, "big"))

    with FileSource(path) as source:
        threads = [threading.Thread(target=read, args=(first,)) for first in range(7)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert wrong == []


def test_reading_ends_with_the_file(tmp_path):
    """Beyond the end there is nothing, and no error, even where the system takes no such place."""
    path = tmp_path / "file"
    path.write_bytes(b"0123")
    with FileSource(path) as source:
        assert source.size == 4
        assert source.read(2, 10) == b"23"
        assert source.read(4, 4) == source.read(9, 1) == source.read(2**63, 4) == b""
    source.close()


@pytest.mark.parametrize(
    ("head", "is_text"),
    [
        # A letter of four bytes may be cut at the end of what is looked at.
        *((b"t " + "\U0001f4c8".encode()[:count], True) for count in (1, 2, 3, 4)),
        (b"t \xf0abc", False),
        (b"t\t\r\n\f", True),
        (b"t\x0b", False),
    ],
)
def test_what_is_text_is_a_table_whatever_its_name(head, is_text):
    """Text of UTF-8 has no control characters but blanks."""
    with nullcontext() if is_text else pytest.raises(UnknownFormatError):
        assert kind_of(Path("log"), head) == "csv"


@pytest.mark.parametrize(
    ("starts", "ends", "begins"),
    [
        ([10, 30], [20, 40], [10]),
        ([10, 20 + GAP], [20, 30 + GAP], [10]),
        ([10, 21 + GAP], [20, 30 + GAP], [10, 21 + GAP]),
        ([10, 30, 15], [20, 40, 25], [10, 15]),  # out of order
        ([0], [SIZE // SHARE], [0]),
        ([1], [SIZE // SHARE + 2], None),
        ([SIZE - 10], [SIZE], [SIZE - 10]),
        ([SIZE - 10], [SIZE + 1], None),
        ([-1], [10], None),
        ([20, 40], [10, 50], None),
        ([], [], None),
    ],
)
def test_parts_of_a_chunk_are_read_apart_where_they_are_in_it_and_few(starts, ends, begins):
    """An index may be wrong about them."""
    places = np.array(starts, np.int64), np.array(ends, np.int64)
    found = ranges_worth_reading(*places, SIZE)
    assert (None if found is None else found.begins.tolist()) == begins
    if found is not None:
        data = np.random.default_rng(2).integers(0, 256, SIZE, np.uint8)
        joined = found.of(data)
        assert found.size == len(joined)
        for start, end, moved in zip(starts, ends, found.moved, strict=True):
            assert joined[start - moved : end - moved].tolist() == data[start:end].tolist()


@on_posix
@needs_pipes
def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    """A search through folders hung at the first one, and so did a run that named one."""
    shutil.copy(SAMPLE_LOGS / "spin.csv", tmp_path / "log.csv")
    for name in ("pipe.csv", "pipe"):
        os.mkfifo(tmp_path / name)
    reason = "it is a pipe or a device, not a file; name a file, or - with stdin from it"
    with pytest.raises(UnreadableLogError) as error:
        open_log(tmp_path / "pipe").__enter__()
    assert str(error.value) == f"{tmp_path}/pipe: {reason}"
    result = run("batch", tmp_path, "-o", tmp_path / "out", "-j", "1", code=0)
    assert result.output.endswith("; ignored 2 other files\n")
    assert (tmp_path / "out" / "log.csv.parquet").exists()


@contextmanager
def pipe_with(data):
    """Give the name of a pipe of the shell, as ``<(...)`` is one, out of which bytes come."""
    end, other = os.pipe()
    with os.fdopen(other, "wb") as file:
        file.write(data)
    try:
        yield f"/dev/fd/{end}"
    finally:
        os.close(end)


@needs_pipes
@pytest.mark.parametrize("kind", ["csv", "bag", "parquet"])
def test_a_pipe_of_the_shell_is_read(tmp_path, kind):
    """Of a process in the place of a file, such as <(zcat log.csv.gz), only - was read."""
    log = tmp_path / f"log.{kind}"
    run("simulate", log, "--duration", "1s", code=0)
    assert log.stat().st_size < 1 << 16  # all of a pipe is written before it is read
    outs = [tmp_path / "file.csv", tmp_path / "pipe.csv"]
    with pipe_with(log.read_bytes()) as pipe:
        for path, out in zip((log, pipe), outs, strict=True):
            assert run("propagate", path, "-o", out, "-q", code=0).stderr == ""
    assert outs[0].read_bytes() == outs[1].read_bytes()


@needs_pipes
def test_what_reads_a_pipe_twice_is_refused(tmp_path):
    """As of stdin, and before it is read."""
    with pipe_with(b"t_ns,wx,wy,wz\n") as pipe:
        said = refused("propagate", pipe, "-o", tmp_path / "a.csv", "--bias", "static")
    assert said.startswith("Error: a pipe can be read only once; --bias static, ")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--rate-field", "nope"], "PATH: no message has a field 'nope'"),
        (["--clock", "publish"], "PATH: a log of kind bag does not record when"),
        (["--mount", "tf:base_link"], "PATH: no static transforms lead from"),
        (["-t", "/none"], "PATH: no topic '/none' that carries body rates"),
        (["--at", "other.csv"], "other.csv: no attitudes found"),
        (["--at", "other.csv.gz"], "other.csv.gz: no attitudes found"),
    ],
)
@pytest.mark.parametrize("is_pipe", [False, True])
def test_errors_name_the_file_that_was_given(tmp_path, monkeypatch, is_pipe, words, reason):
    """Errors about options named its temporary copy, and those about other files the log."""
    monkeypatch.chdir(tmp_path)
    Path("other.csv").write_bytes(b"a,b\n1,2\n")
    Path("other.csv.gz").write_bytes(gzip.compress(b"a,b\n1,2\n"))
    run("simulate", "log.bag", "--duration", "1s", code=0)
    data = Path("log.bag").read_bytes()
    Path("log.bag.gz").write_bytes(gzip.compress(data))
    with pipe_with(data) as pipe:
        path = pipe if is_pipe else "log.bag.gz"
        said = refused("propagate", path, "-o", "a.csv", *words)
    assert said.startswith(f"Error: {reason.replace('PATH', path)}")


@pytest.mark.parametrize("log", ["spin.csv", "rest.parquet", "tumbling.bag"])
def test_definitions_that_are_not_there_are_missed_by_every_kind(tmp_path, log):
    """The option was ignored where a table was read."""
    missing = str(tmp_path / "nowhere")
    with pytest.raises(UsageError) as error:
        open_log(SAMPLE_LOGS / log, msg_path=missing).__enter__()
    assert str(error.value) == f"{missing}: no such file or folder; check msg_path"


def test_a_topic_of_two_types_is_remarked_on(tmp_path):
    """Its messages of the other type are not silently left out."""
    other = Topic("std_msgs/msg/String", [bytes(8)], b"string data", "ros2msg", "cdr")
    write_topics(tmp_path / "other.mcap", {"/imu": other}, profile="ros2")
    log = write_mcap(tmp_path / "log.mcap", count=40)
    log.write_bytes(log.read_bytes() + (tmp_path / "other.mcap").read_bytes())
    with open_log(log) as read:
        (remark,) = read.remarks
    assert remark == (
        "topic '/imu' was recorded with several types, which are read separately: "
        "'sensor_msgs/msg/Imu', 'std_msgs/msg/String'"
    )


def test_a_topic_with_two_definitions_is_read_by_both(tmp_path, monkeypatch):
    """Each recorder writes the definition that it has; messages come in order of their times."""
    log, other = write_mcap(tmp_path / "log.mcap", count=40), tmp_path / "other.mcap"
    read = []
    original = McapLog.blocks
    monkeypatch.setattr(McapLog, "blocks", lambda *one: read.append(one) or original(*one))
    expected = read_rates(log, topic="/imu")
    reads_of_one = len(read)
    with log.open("rb") as file:
        messages = list(make_reader(file).iter_messages(topics=["/imu"]))
    schema = messages[0][0]
    longer = schema.data.replace(b"float64[9] orientation_cov", b"float64[10] orientation_cov")
    assert longer != schema.data
    at = messages[0][2].data.index(struct.pack("<d", expected.rate[0, 0]))
    timed = [
        (message.log_time, message.data[:at] + k % 2 * bytes(8) + message.data[at:])
        for k, (_, _, message) in enumerate(messages)
    ]
    halves = {schema.data: timed[::2], longer: timed[1::2]}
    topics = [
        ("/imu", Topic(schema.name, half, text, "ros2msg", "cdr")) for text, half in halves.items()
    ]
    write_topics(other, topics, profile="ros2")
    recorded = "topic '/imu' was recorded with 2 different message definitions, "
    with pytest.warns(RemarkWarning, match=recorded + "each of which was read by its own"):
        found = read_rates(other)
    assert len(read) == 3 * reads_of_one
    assert found.t_ns.tolist() == expected.t_ns.tolist()
    assert found.rate.tolist() == expected.rate.tolist()
    # Of attitudes neither --topic nor --quat-field could tell one from the other.
    assert refused("convert", other, tmp_path / "out.csv") == (
        f"Error: {other}: {recorded}which cannot be merged; write the messages of each to a "
        "log of its own, by their times with `mcap filter`, or with `rosbag filter`"
    )


def test_a_file_that_cannot_be_read_at_all_is_refused(monkeypatch):
    """Before its kind is known."""
    log = SAMPLE_LOGS / "spin.csv"
    wear(monkeypatch)
    sentence = f"Error: {log}: it cannot be read: 'Input/output error'"
    assert refused("info", log) == sentence


@pytest.mark.parametrize("name", ["coning.mcap", "tumbling.bag"])
def test_a_place_that_cannot_be_read_is_lost_with_its_reason(monkeypatch, name):
    """As on a worn memory card: the file is opened, and one chunk of it is not read."""
    read = FileSource.read

    def fail(source, start, length):
        if start <= 20_000 < start + length < source.size:
            raise OSError(errno.EIO, "Input/output error")
        return read(source, start, length)

    monkeypatch.setattr(FileSource, "read", fail)
    log = SAMPLE_LOGS / name
    with pytest.warns(
        DataLossWarning, match=r": it cannot be read: 'Input/output error' \(1,000 lost\)$"
    ):
        read_rates(log)


@pytest.mark.parametrize("sectors", [0, MAX_SECTORS])
@pytest.mark.parametrize(("name", "reads"), [("coning.mcap", 5), ("tumbling.bag", 8), ("a.ulg", 4)])
def test_a_file_that_cannot_be_read_any_more_is_refused(
    tmp_path, monkeypatch, name, reads, sectors
):
    """Of a bag, it was called an error of this program."""
    monkeypatch.setattr("quatprop.stores.file_source.MAX_SECTORS", sectors)
    path, read = SAMPLE_LOGS / name, FileSource.read
    if name == "a.ulg":
        path = write(tmp_path / name, *gyro(1, range(1000, 9000, 1000)))
    for good in range(reads):
        left = iter(range(good))

        def fail(source, start, length, left=left):
            if next(left, None) is None:
                raise OSError(errno.EIO, "Input/output error")
            return read(source, start, length)

        monkeypatch.setattr(FileSource, "read", fail)
        words = "it cannot be read: 'Input/output error'$" if good < 2 else None
        with pytest.raises(LogError, match=words):
            read_rates(path)
