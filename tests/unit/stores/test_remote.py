"""Logs in object stores, tried on the one that is everywhere: the local file system."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS
from mcap.writer import CompressionType
from pyarrow import feather

from quatprop.cli.commands import cli
from quatprop.errors import LogError, OutputError, StoreError
from quatprop.logs.open_log import open_log
from quatprop.stores import transfers
from quatprop.stores.file_source import FileSource
from quatprop.stores.objects import _with_retry_limit, find, without_secret
from quatprop.stores.transfers import local_copy, put, upload
from quatprop.times import NS_PER_S


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch):
    """Keep temporary copies in a folder of the test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.parametrize("name", ["tumbling.bag", "tumbling_ros2", "spin.csv"])
def test_a_log_at_an_address_is_the_log(tmp_path, temporary, name):
    """The series is the same to the byte, the source is recorded as named, no copy stays."""
    near, far, report = tmp_path / "near.csv", tmp_path / "far.csv", tmp_path / "report.json"
    address = (SAMPLE_LOGS / name).as_uri()
    runner = CliRunner()
    runner.invoke(cli, ["propagate", str(SAMPLE_LOGS / name), "-o", str(near)])
    done = runner.invoke(cli, ["propagate", address, "-o", str(far), "--report", str(report)])
    assert done.exit_code == 0, done.output
    assert far.read_bytes() == near.read_bytes()
    assert json.loads(report.read_text())["source"]["path"] == address
    assert list(temporary.iterdir()) == []


LOGS = [
    "tumbling.bag", "tumbling_ros2", "coning.mcap", "spin.csv", "spin.parquet", "spin.feather",
]  # fmt: skip


@pytest.fixture
def uploaded(bucket, tmp_path):
    """Return a function that puts a log, and a copy of it in another format, into a bucket."""

    def put_log(name):
        path = SAMPLE_LOGS / name
        if path.suffix in {".parquet", ".feather"}:
            path = tmp_path / name
            table = pyarrow.csv.read_csv(SAMPLE_LOGS / "spin.csv")
            write = pyarrow.parquet.write_table if name.endswith("t") else feather.write_feather
            write(table, path)
        upload(path, f"{bucket}/logs/{name}")
        return path, f"{bucket}/logs/{name}"

    return put_log


@pytest.mark.parametrize("name", LOGS)
def test_a_log_in_a_store_is_the_log(tmp_path, temporary, uploaded, name):
    """The series is the same to the byte; what the store says of its content is recorded."""
    near, far, report = tmp_path / "near.csv", tmp_path / "far.csv", tmp_path / "report.json"
    path, address = uploaded(name)
    runner = CliRunner()
    runner.invoke(cli, ["propagate", str(path), "-o", str(near)])
    done = runner.invoke(cli, ["propagate", address, "-o", str(far), "--report", str(report)])
    assert done.exit_code == 0, done.output
    assert far.read_bytes() == near.read_bytes()
    source = json.loads(report.read_text())["source"]
    sizes = [file.stat().st_size for file in ([path] if path.is_file() else path.iterdir())]
    assert (source["path"], source["bytes"], source["sha256"]) == (address, sum(sizes), None)
    tags = [source] if path.is_file() else list(source["files"].values())
    assert [len(tag["etag"]) > 10 for tag in tags] == [True] * len(sizes)
    assert list(temporary.iterdir()) == []


def beside_images(path, compression, step_ns=10_000_000):
    """Write an MCAP of which body rates are 5 %, beside images."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=compression)
        writer.start()
        schema = writer.register_schema("", "", b"")
        image = writer.register_channel("/camera", "json", schema)
        schema = writer.register_schema(
            "imu",
            "jsonschema",
            b'{"type": "object", "properties": {"angular_velocity": {"type": "object", '
            b'"properties": {"x": {"type": "number"}, "y": {"type": "number"}, "z": '
            b'{"type": "number"}}}}}',
        )
        imu = writer.register_channel("/imu", "json", schema)
        noise = np.random.default_rng(1)
        for k in range(2000):
            ns = 10**18 + step_ns * k
            if k % 5 == 0:
                writer.add_message(image, ns, noise.bytes(50_000), ns)
            rate = {"x": 0.1, "y": 0.2, "z": np.sin(k)}
            message = {"angular_velocity": rate, "pad": "." * 400}
            writer.add_message(imu, ns, json.dumps(message).encode(), ns)
        writer.finish()


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_only_what_is_needed_of_a_log_is_read(
    tmp_path, bucket, store_server, monkeypatch, compression
):
    """Of a store hardly more bytes come than a file of this machine is read of."""
    path = tmp_path / "ride.mcap"
    beside_images(path, compression)
    upload(path, f"{bucket}/ride.mcap")
    read = 0
    read_file = FileSource._read  # noqa: SLF001

    def counting(self, length, start):
        nonlocal read
        read += length
        return read_file(self, length, start)

    outputs = [tmp_path / "near.csv", tmp_path / "far.csv"]
    options = ["--topic", "/imu", "--rate-field", "angular_velocity", "--rate-unit", "rad/s", "-o"]
    with monkeypatch.context() as patched:
        patched.setattr(FileSource, "_read", counting)
        patched.delattr(os, "preadv", raising=False)  # so that all is read there
        done = CliRunner().invoke(cli, ["propagate", str(path), *options, str(outputs[0])])
    assert done.exit_code == 0, done.output
    before = store_server.sent
    done = CliRunner().invoke(cli, ["propagate", f"{bucket}/ride.mcap", *options, str(outputs[1])])
    assert done.exit_code == 0, done.output
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert store_server.sent - before <= 1.3 * read


def test_a_folder_inside_a_bag_is_no_file_of_it(tmp_path):
    """What tools keep beside the files of a bag does not hinder its reading."""
    bag = shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", tmp_path / "bag")
    (bag / ".thumbnails").mkdir()
    with local_copy(bag.as_uri()) as copy:
        assert sorted(path.name for path in copy.iterdir()) == sorted(
            path.name for path in (SAMPLE_LOGS / "tumbling_ros2").iterdir()
        )


def test_what_is_not_there_is_said(tmp_path):
    """An address that the store does not know is one sentence."""
    address = (tmp_path / "none.bag").as_uri()
    with pytest.raises(StoreError) as caught, local_copy(address):
        pass
    assert str(caught.value) == f"{address}: there is no such object; check the address"


def test_a_store_that_is_not_known_is_said():
    """As is one that does not answer."""
    known = pytest.raises(StoreError, match=r"^nowhere://log.bag: there is no store of this kind")
    with known, local_copy("nowhere://log.bag"):
        pass


@pytest.mark.parametrize(
    "said",
    [
        "Retry policy exhausted, with a last message of Could not create a OAuth2 access token",
        "Unknown error: N5Azure4Core11Credentials23AuthenticationExceptionE: Failed to get token",
    ],
)
def test_missing_credentials_are_said(monkeypatch, said):
    """In the words of Google's and of Azure's libraries, none of which is an OSError."""

    def refuse(_address):
        raise pyarrow.ArrowException(said)

    monkeypatch.setattr("quatprop.stores.objects.locate", refuse)
    with pytest.raises(StoreError, match="no credentials for its store were found") as caught:
        find("abfs://container@account.dfs.core.windows.net/a.mcap")
    assert "abfs://container@account" in str(caught.value)
    monkeypatch.setattr("quatprop.stores.transfers.locate", refuse)
    with pytest.raises(OutputError, match=r"found \(.*\); log in with the store's own tools"):
        put("gs://bucket/a.parquet", b"")


def test_errors_name_the_address(tmp_path):
    """Not the copy that nobody knows of."""
    path = tmp_path / "log.mcap"
    path.write_bytes(b"#ROSBAG V2.1\n" + bytes(100))
    named = pytest.raises(LogError, match=rf"^{path.as_uri()}: its bag format is version 2.1")
    with named, open_log(path.as_uri()):
        pass


@pytest.mark.parametrize("name", ["tumbling.bag", "tumbling_ros2", "spin.csv"])
def test_errors_about_options_name_the_address(tmp_path, name):
    """They named the copy in the temporary folder."""
    address = (SAMPLE_LOGS / name).as_uri()
    column = name.endswith(".csv")
    words = ["--rate-cols", "a,b,c"] if column else ["--rate-field", "nope", "-t", "/imu"]
    out = tmp_path / "a.csv"
    result = CliRunner().invoke(cli, ["propagate", address, "-o", str(out), *words])
    reason = "--rate-cols asks for column 'a'" if column else "no message has a field 'nope'"
    assert result.exit_code == 2
    assert result.stderr.startswith(f"Error: {address}: {reason}")


@pytest.mark.parametrize(
    "words",
    [
        ("info", "LOG"),
        ("propagate", "LOG", "-o", "a.csv", "--report", "-", "-v"),
        ("batch", "LOG", "-o", "out", "--json", "-j", "1"),
        ("plot", "LOG", "-o", "rates.html"),
        ("plot", "LOG", "TRUTH", "--show", "attitude", "-o", "attitudes.html"),
        ("plot", "TRUTH", "--reference", "LOG", "-o", "error.html"),
        ("compare", "LOG", "TRUTH", "--json"),
        ("compare", "LOG", "TRUTH"),
        ("convert", "LOG", "converted.csv"),
    ],
)
def test_no_command_shows_a_key(words, tmp_path, monkeypatch, bucket):
    """Neither on the terminal nor in what is written is what an address carries."""
    log = "t_ns,wx,wy,wz,qw,qx,qy,qz\n0,0,0,1,1,0,0,0\n1000,0,0,1,1,0,0,0\n2000,0,0,1,1,0,0,0\n"
    truth = tmp_path / "truth.csv"
    truth.write_text(log)
    put(f"{bucket}/a.csv", log.encode())
    monkeypatch.chdir(tmp_path / "temporary")
    address = f"{bucket}/a.csv".replace("://", "://key:secret@")
    known = {"LOG": address, "TRUTH": str(truth)}
    result = CliRunner().invoke(cli, [known.get(word, word) for word in words])
    assert result.exit_code == 0, result.output
    assert "secret" not in result.output
    for path in Path().rglob("*"):
        assert path.is_dir() or b"secret" not in path.read_bytes(), path


def test_no_key_is_recorded():
    """An address may carry a key; what is written does not."""
    assert without_secret("s3://key:secret@bucket/a@b.mcap") == "s3://bucket/a@b.mcap"
    assert without_secret("logs/a@b.mcap") == "logs/a@b.mcap"


def test_a_store_that_does_not_answer_is_given_up_on():
    """Google's is asked again for a quarter of an hour, unless the address says otherwise."""
    assert _with_retry_limit("gs://logs/a.bag") == "gs://logs/a.bag?retry_limit_seconds=10"
    assert _with_retry_limit("gs://logs/a.bag?x=1") == "gs://logs/a.bag?x=1&retry_limit_seconds=10"
    assert _with_retry_limit("gs://a?retry_limit_seconds=99") == "gs://a?retry_limit_seconds=99"
    assert _with_retry_limit("s3://logs/a.bag") == "s3://logs/a.bag"


def test_waiting_for_a_store_hears_ctrl_c(monkeypatch):
    """What its library does in a thread does not hold up the rest."""
    monkeypatch.setattr(transfers.shutil, "copyfileobj", lambda *_: time.sleep(60))
    # A shell that runs the tests in the background has it ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    began = time.monotonic()
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt), local_copy(f"file://{SAMPLE_LOGS}/tumbling.bag"):
        pass
    assert time.monotonic() - began < 30


def test_a_time_range_is_all_that_is_read(tmp_path, bucket, store_server):
    """Of a long log with an index, --end moves little of what comes after it."""
    path = tmp_path / "ride.mcap"
    beside_images(path, CompressionType.ZSTD, step_ns=NS_PER_S)
    upload(path, f"{bucket}/ride.mcap")
    options = ["--topic", "/imu", "--rate-field", "angular_velocity", "--rate-unit", "rad/s"]
    outputs = [tmp_path / "near.csv", tmp_path / "far.csv"]
    before = store_server.sent
    for log, out in zip((str(path), f"{bucket}/ride.mcap"), outputs, strict=True):
        words = ["propagate", log, *options, "--end", "+1m", "-o", str(out)]
        assert CliRunner().invoke(cli, words).exit_code == 0
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert store_server.sent - before < 0.5 * path.stat().st_size


def test_the_parts_of_a_bag_are_read_in_ranges(tmp_path, temporary, bucket):
    """A ROS 2 bag of MCAP files: the same series, and of the parts no copy is made."""
    bag, outputs = tmp_path / "bag", [tmp_path / "near.csv", tmp_path / "far.csv"]
    made = CliRunner().invoke(cli, ["simulate", str(bag), "--to", "rosbag2-mcap"])
    assert made.exit_code == 0, made.output
    upload(bag, f"{bucket}/bag")
    for log, out in zip((str(bag), f"{bucket}/bag"), outputs, strict=True):
        assert CliRunner().invoke(cli, ["propagate", log, "-o", str(out)]).exit_code == 0
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    with open_log(f"{bucket}/bag") as log:
        (part,) = temporary.rglob("*.mcap")
        assert part.stat().st_size == 0
        assert len(log.channels()) == 1
    assert list(temporary.iterdir()) == []


def test_what_a_kill_leaves_is_removed_by_the_next_run(temporary):
    """Copies of logs are locked while they are used; what is not locked is nobody's."""
    code = (
        "import os, sys\n"
        "from quatprop.stores.transfers import local_copy\n"
        "with local_copy(sys.argv[1]):\n"
        "    os._exit(0)\n"
    )
    log = (SAMPLE_LOGS / "spin.csv").as_uri()
    environment = {**os.environ, "TMPDIR": str(temporary)}
    subprocess.run([sys.executable, "-c", code, log], check=True, env=environment)
    (stray,) = temporary.iterdir()
    with local_copy(log) as copy:
        assert copy.exists()
        assert not stray.exists()
    assert list(temporary.iterdir()) == []
