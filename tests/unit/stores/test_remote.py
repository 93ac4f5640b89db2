"""Logs in object stores: one of this machine, and the local file system, which is one, too."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from make.commands import refused, run
from make.mcap import Topic, build
from make.places import SAMPLE_LOGS
from make.systems import on_posix
from mcap.writer import CompressionType
from pyarrow import feather

from quatprop.base.errors import LogError, OutputError, StoreError
from quatprop.base.places import without_secret
from quatprop.base.times import NS_PER_S
from quatprop.readers.open_log import open_log
from quatprop.stores.file_source import FileSource
from quatprop.stores.objects import _with_retry_limit, exists, find
from quatprop.stores.remote import RemoteSource, local_copy, move, put, remove, upload

pytestmark = pytest.mark.usefixtures("temporary")


@pytest.fixture
def fetched(monkeypatch):
    """Return the ranges that are requested of objects, as they are requested."""
    places, fetch = [], RemoteSource._fetch  # noqa: SLF001
    monkeypatch.setattr(
        RemoteSource, "_fetch", lambda *words: places.append(words[1:]) or fetch(*words)
    )
    return places


def assert_the_same(folder, near, far, *options):
    """Propagate two logs; return the report of the second."""
    outputs = [folder / "near.csv", folder / "far.csv"]
    report = folder / "report.json"
    for log, out in zip((near, far), outputs, strict=True):
        run("propagate", log, *options, "-o", out, "--report", report, code=0)
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    return json.loads(report.read_text())


@pytest.mark.parametrize(
    "name",
    ["tumbling.bag", "tumbling_ros2", "coning.mcap", "spin.csv", "spin.parquet", "spin.feather"],
)
def test_a_log_in_a_store_is_the_log(tmp_path, bucket, name):
    """The series is the same to the byte; what the store says of its content is recorded."""
    path = SAMPLE_LOGS / name
    if path.suffix in {".parquet", ".feather"}:
        path = tmp_path / name
        table = pyarrow.csv.read_csv(SAMPLE_LOGS / "spin.csv")
        write = pyarrow.parquet.write_table if name.endswith("t") else feather.write_feather
        write(table, path)
    address = f"{bucket}/logs/{name}"
    upload(path, address)
    source = assert_the_same(tmp_path, path, address)["source"]
    sizes = [file.stat().st_size for file in ([path] if path.is_file() else path.iterdir())]
    assert (source["path"], source["bytes"], source["sha256"]) == (address, sum(sizes), None)
    tags = [source] if path.is_file() else list(source["files"].values())
    assert [len(tag["etag"]) > 10 for tag in tags] == [True] * len(sizes)
    address = path.as_uri()
    assert assert_the_same(tmp_path, path, address)["source"]["path"] == address


def with_images(path, bucket, compression, count=500, step_ns=10_000_000, image=50_000):  # noqa: PLR0913, PLR0917
    """Write an MCAP of which body rates are 5 % or less, next to images; return its address."""
    noise, events = np.random.default_rng(1), []
    for k in range(count):
        ns = 10**18 + step_ns * k
        if k % 5 == 0:
            events.append((0, ns, noise.bytes(image)))
        events.append((1, ns, rates_message(k, 400)))
    topics = [("/camera", Topic("")), ("/imu", Topic(""))]
    path.write_bytes(build(topics, events, chunk_size=1 << 20, compression=compression))
    upload(path, f"{bucket}/ride.mcap")
    return f"{bucket}/ride.mcap"


def rates_message(k, pad):
    """Return body rates as JSON, and text that makes the message longer."""
    return json.dumps({"w": [0.1, 0.2, np.sin(k)], "pad": "." * pad}).encode()


RATES_OF_JSON = ["--topic", "/imu", "--rate-field", "w", "--rate-unit", "rad/s"]
CASES = {CompressionType.NONE: {"count": 100, "image": 800_000}, CompressionType.ZSTD: {}}


@pytest.mark.parametrize("compression", CASES)
def test_only_the_needed_parts_of_a_log_are_read(
    tmp_path, bucket, store_server, monkeypatch, compression
):
    """A store sends hardly more bytes than are read of a local file.

    Chunks that are not read whole are not compared with their checksums, which is reported.
    """
    path = tmp_path / "ride.mcap"
    address = with_images(path, bucket, compression, **CASES[compression])
    read = []
    read_file = FileSource._read  # noqa: SLF001
    monkeypatch.setattr(
        FileSource, "_read", lambda *words: read.append(words[1]) or read_file(*words)
    )
    monkeypatch.delattr(os, "preadv", raising=False)  # so that all is read there
    before = store_server.sent
    report = assert_the_same(tmp_path, path, address, *RATES_OF_JSON)
    assert store_server.sent - before <= 1.3 * sum(read)
    assert (report["unchecked_chunks"] > 1) == (compression is CompressionType.NONE)


def test_what_is_between_messages_is_read_where_requests_cost_more(tmp_path, bucket, store_server):
    """Each message between small pictures was a request of its own: 1,129 for 7 MB of a log."""
    path = tmp_path / "ride.mcap"
    address = with_images(path, bucket, CompressionType.NONE)
    sent, count = store_server.sent, len(store_server.requests)
    assert_the_same(tmp_path, path, address, *RATES_OF_JSON)
    assert store_server.sent - sent <= 1.05 * path.stat().st_size
    assert len(store_server.requests) - count <= 15


def test_chunks_without_the_topic_are_not_read(tmp_path, bucket, store_server):
    """After another topic had been looked into, what lay between its chunks was read, too."""
    path, address, noise = tmp_path / "ride.mcap", f"{bucket}/ride.mcap", np.random.default_rng(1)
    events, chunk = [], 1 << 20
    for k in range(160):
        if k % 10 == 0:  # a message of this size ends its chunk
            events += [(0, 10**18 + k * 10**7, noise.bytes(chunk)) for _ in range(2)]
        events.append((1, 10**18 + k * 10**7, rates_message(k, chunk if k % 10 == 9 else 0)))
    topics = [("/camera", Topic("")), ("/imu", Topic(""))]
    path.write_bytes(build(topics, events, chunk_size=chunk, compression=CompressionType.ZSTD))
    upload(path, address)
    before = store_server.sent
    assert_the_same(tmp_path, path, address, *RATES_OF_JSON)
    # The first picture shows that its topic, which no schema describes, has no attitudes.
    assert store_server.sent - before <= 1.2 * chunk


def test_ranges_are_put_together_in_requests_of_bounded_size(tmp_path, fetched):
    """Close ranges are one request, far ones are not, and only what was requested is returned."""
    path = tmp_path / "bytes"
    data = np.random.default_rng(1).bytes(6 << 20)
    path.write_bytes(data)
    begins = [*range(0, 4 << 20, 100_000), 6 << 19, 5 << 20]  # one step back, one far ahead
    ends = [begin + 100 for begin in begins]
    with RemoteSource(path.as_uri(), path) as source:
        wanted = b"".join(data[begin:end] for begin, end in zip(begins, ends, strict=True))
        del fetched[:]
        assert source.read_ranges(begins, ends) == wanted
    assert len(fetched) == 2 + 1 + 1
    assert max(end - begin for begin, end in fetched) <= 2 << 20


def test_no_more_is_read_ahead_than_is_allowed(tmp_path, monkeypatch, fetched):
    """However many ranges were announced: what follows is requested when it is nearer."""
    path, size = tmp_path / "bytes", 100_000
    with path.open("wb") as file:
        file.truncate(8 << 22)
    begins = [k << 22 for k in range(8)]
    monkeypatch.setattr("quatprop.stores.remote.AHEAD_BYTES", 3 * size // 2)
    monkeypatch.setattr("quatprop.stores.remote.REQUESTS", 1)  # one after the other
    with RemoteSource(path.as_uri(), path) as source:
        source.expect(begins, [begin + size for begin in begins])
        for k in (0, 1, 2, 3, 7):
            source.read(begins[k], size)
    assert [begin for begin, _ in fetched] == [*begins[:5], begins[7]]


def test_the_parts_that_were_read_last_are_kept(tmp_path, monkeypatch, fetched):
    """Beyond the bound the oldest are given up, and no more than that."""
    path = tmp_path / "bytes"
    size, count = 100_000, 8
    with path.open("wb") as file:
        file.truncate(count << 22)
    begins = [k << 22 for k in range(count)]
    with RemoteSource(path.as_uri(), path) as source:
        source.expect(begins, [begin + size for begin in begins])
        for begin in begins:
            source.read(begin, size)
        assert sorted(begin for begin, _ in fetched) == begins
        monkeypatch.setattr("quatprop.stores.remote.KEPT_BYTES", 4 * size)
        for k in (7, 4, 5, 6, 0, 7):
            source.read(begins[k], size)
    assert [begin for begin, _ in fetched[count:]] == [begins[0], begins[7]]


def test_an_object_of_which_many_small_parts_are_read_is_copied(tmp_path, temporary, fetched):
    """The thread that made the copy waited for itself: without an index, a run hung."""
    path = tmp_path / "bytes"
    data = np.random.default_rng(1).bytes(6 << 20)
    path.write_bytes(data)
    with RemoteSource(path.as_uri(), path) as source:
        for begin in range(1 << 20, 5 << 20, 1 << 15):
            assert source.read(begin, 4) == data[begin : begin + 4]
        (copy,) = temporary.rglob("bytes")
        assert copy.stat().st_size == len(data)
        requests = len(fetched)
        source.expect([0], [100])
        assert source.read_ranges([5, 9], [6, 12]) == data[5:6] + data[9:12]
        assert len(fetched) == requests < 70


def test_results_are_moved_and_removed(tmp_path, bucket):
    """An existing result is replaced; if it cannot be, the error names it."""
    (tmp_path / "old" / "sub").mkdir(parents=True)
    (tmp_path / "new").write_bytes(b"new")
    move(str(tmp_path / "new"), str(tmp_path / "old"))
    move(str(tmp_path / "old"), str(tmp_path / "deep" / "old"))
    assert (tmp_path / "deep" / "old").read_bytes() == b"new"
    with pytest.raises(OutputError, match="deep: cannot be removed: "):
        remove(str(tmp_path / "deep"))
    with pytest.raises(OutputError, match="new: cannot be written: No such file"):
        move(str(tmp_path / "none"), str(tmp_path / "new"))
    with pytest.raises(StoreError, match="its store does not permit that"):
        exists(bucket.replace("://", "://denied-"))


def test_a_time_range_is_all_that_is_read(tmp_path, bucket, store_server):
    """Of a long log with an index, --end moves little of what comes after it."""
    path = tmp_path / "ride.mcap"
    address = with_images(path, bucket, CompressionType.ZSTD, 1000, NS_PER_S)
    before = store_server.sent
    assert_the_same(tmp_path, path, address, *RATES_OF_JSON, "--end", "+1m")
    assert store_server.sent - before < 0.5 * path.stat().st_size


def test_the_parts_of_a_bag_are_read_in_ranges(tmp_path, temporary, bucket):
    """A ROS 2 bag of MCAP files: the same series, and of the parts no copy is made."""
    bag, address = tmp_path / "bag", f"{bucket}/bag"
    run("simulate", bag, "--to", "rosbag2-mcap", "--duration", "2s", code=0)
    upload(bag, address)
    assert_the_same(tmp_path, bag, address)
    with open_log(address) as log:
        (part,) = temporary.rglob("*.mcap")
        assert part.stat().st_size == 0
        assert len(log.channels()) == 1


def test_a_folder_inside_a_bag_is_no_file_of_it(tmp_path):
    """Files that tools keep next to those of a bag do not hinder reading it."""
    bag = shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", tmp_path / "bag")
    names = {path.name for path in bag.iterdir()}
    (bag / ".thumbnails").mkdir()
    with local_copy(bag.as_uri(), []) as copy:
        assert {path.name for path in copy.iterdir()} == names


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("file:///nowhere/none.bag", "no such object; check the address"),
        ("nowhere://log.bag", "unknown kind of store"),
    ],
)
def test_what_is_not_there_is_said(address, reason):
    """An address that the store does not know, and a store that is not known."""
    with pytest.raises(StoreError, match=f"^{address}: {reason}"), open_log(address):
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
    monkeypatch.setattr("quatprop.stores.remote.locate", refuse)
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
    words, reason = ["--rate-field", "nope", "-t", "/imu"], "no message has a field 'nope'"
    if name.endswith(".csv"):
        words, reason = ["--rate-cols", "a,b,c"], "--rate-cols asks for column 'a'"
    address = (SAMPLE_LOGS / name).as_uri()
    said = refused("propagate", address, "-o", tmp_path / "a.csv", *words)
    assert said.startswith(f"Error: {address}: {reason}")


@pytest.mark.parametrize(
    "words",
    [
        "info LOG",
        "propagate LOG -o a.csv --report - -v",
        "batch LOG -o out --json -j 1",
        "plot LOG -o rates.html",
        "plot LOG TRUTH --show attitude -o attitudes.html",
        "plot TRUTH --reference LOG -o error.html",
        "compare LOG TRUTH --json",
        "compare LOG TRUTH",
        "convert LOG converted.csv",
    ],
)
def test_no_command_shows_a_key(words, tmp_path, monkeypatch, bucket):
    """Neither on the terminal nor in what is written is what an address carries."""
    log = "t_ns,wx,wy,wz,qw,qx,qy,qz\n0,0,0,1,1,0,0,0\n1000,0,0,1,1,0,0,0\n2000,0,0,1,1,0,0,0\n"
    truth, folder = tmp_path / "truth.csv", tmp_path / "work"
    truth.write_text(log)
    put(f"{bucket}/a.csv", log.encode())
    folder.mkdir()
    monkeypatch.chdir(folder)
    address = f"{bucket}/a.csv".replace("://", "://key:secret@")
    known = {"LOG": address, "TRUTH": str(truth)}
    result = run(*(known.get(word, word) for word in words.split()), code=0)
    assert "secret" not in result.output
    for path in Path().rglob("*"):
        assert path.is_dir() or b"secret" not in path.read_bytes(), path


def test_an_at_sign_in_the_name_of_an_object_is_no_key():
    """Only what comes before the store is one."""
    assert without_secret("s3://key:secret@bucket/a@b.mcap") == "s3://bucket/a@b.mcap"
    assert without_secret("logs/a@b.mcap") == "logs/a@b.mcap"
    assert without_secret("abfs://logs:secret@host/a@b.mcap") == "abfs://logs@host/a@b.mcap"


def test_a_store_that_does_not_answer_is_given_up_on():
    """Google's is asked again for a quarter of an hour, unless the address says otherwise."""
    assert _with_retry_limit("gs://logs/a.bag") == "gs://logs/a.bag?retry_limit_seconds=10"
    assert _with_retry_limit("gs://logs/a.bag?x=1") == "gs://logs/a.bag?x=1&retry_limit_seconds=10"
    assert _with_retry_limit("gs://a?retry_limit_seconds=99") == "gs://a?retry_limit_seconds=99"
    assert _with_retry_limit("s3://logs/a.bag") == "s3://logs/a.bag"


def test_waiting_for_a_store_hears_ctrl_c(monkeypatch):
    """A thread of its library does not hold up the rest."""
    held = threading.Event()

    def fetch(*_):
        os.kill(os.getpid(), signal.SIGINT)
        held.wait(600)

    monkeypatch.setattr(RemoteSource, "_fetch", fetch)
    # A shell that runs the tests in the background has it ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt), open_log(f"file://{SAMPLE_LOGS}/tumbling.bag"):
        pass
    held.set()


@on_posix
def test_what_a_kill_leaves_is_removed_by_the_next_run(temporary):
    """Copies of logs are locked while they are used; what is not locked is nobody's."""
    code = (
        "import os, sys\n"
        "from quatprop.readers.open_log import open_log\n"
        "with open_log(sys.argv[1]):\n"
        "    os._exit(0)\n"
    )
    log = (SAMPLE_LOGS / "spin.csv").as_uri()
    environment = {**os.environ, "TMPDIR": str(temporary)}
    subprocess.run([sys.executable, "-c", code, log], check=True, env=environment)
    (stray,) = temporary.iterdir()
    with open_log(log) as opened:
        assert opened.path.exists()
        assert not stray.exists()
