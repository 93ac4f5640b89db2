"""The manifest is proved: outputs exist, and belong to the logs as they are."""

import errno
import json
import os
import re
import shutil
import zlib
from concurrent.futures import ThreadPoolExecutor

import pyarrow.dataset
import pyarrow.parquet
import pytest
from make.batches import UP_TO_DATE, batch, entries, outputs_in, said, spin
from make.commands import refused
from make.documents import GUIDES
from make.places import SAMPLE_LOGS
from make.tables import write_attitudes

import quatprop
from quatprop import __version__
from quatprop.stores.remote import get, upload
from quatprop.tools.batch import log_search, worker
from quatprop.tools.batch.manifest import Manifest, ManifestEntry
from quatprop.tools.batch.tasks import BatchTask

FLEETS = GUIDES / "fleets.md"


def states(folder):
    """Return the state of each output."""
    return {name: entry["state"] for name, entry in entries(folder).items()}


@pytest.mark.parametrize("kept", [0, -9, None])
def test_an_output_that_was_cut_is_not_up_to_date(tmp_path, kept):
    """An output of 0 bytes was skipped: it was enough that there was one."""
    log, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    batch(log, "-o", out, code=0)
    place = out / "a.csv.parquet"
    before = place.read_bytes()
    place.unlink() if kept is None else place.write_bytes(before[:kept])
    assert said(batch(log, "-o", out, "--skip-existing")) == "1 of 1 logs done, 5 samples"
    assert place.read_bytes() == before


@pytest.mark.parametrize("at", ["folder", "store"])
def test_garbage_of_the_right_size_is_found_by_verify(tmp_path, bucket, at):
    """The manifest had the digest of the output, which was compared with nothing."""
    log, out = spin(tmp_path / "a.csv"), f"{bucket}/out" if at == "store" else tmp_path / "out"
    batch(log, "-o", out, code=0)
    place = tmp_path / "out" / "a.csv.parquet"
    place.parent.mkdir(exist_ok=True)
    if at == "store":
        place.write_bytes(get(f"{out}/a.csv.parquet"))
    place.write_bytes(bytes(place.stat().st_size))
    if at == "store":
        upload(place, f"{out}/a.csv.parquet")
    again = (log, "-o", out, "--skip-existing")
    assert batch(*again).stderr == UP_TO_DATE
    assert said(batch(*again, "--verify")) == "1 of 1 logs done, 5 samples"
    assert batch(*again, "--verify").stderr == UP_TO_DATE


@pytest.mark.parametrize("at", ["folder", "store"])
def test_a_log_that_fails_does_not_keep_an_output_that_looks_new(tmp_path, bucket, at):
    """Yesterday's output stayed where today's would be."""
    log, out = spin(tmp_path / "a.csv"), f"{bucket}/out" if at == "store" else tmp_path / "out"
    batch(log, "-o", out, code=0)
    log.write_text("nothing")
    batch(log, "-o", out, code=2)
    assert states(out) == {"a.csv.parquet": "failed"}
    if at == "store":
        assert len(get(f"{out}/_stale/a.csv.parquet.old")) > 1000
    else:
        assert outputs_in(out) == []
        assert (out / "_stale" / "a.csv.parquet.old").exists()
    spin(log)
    batch(log, "-o", out, "--skip-existing", code=0)
    assert states(out) == {"a.csv.parquet": "done"}


def test_a_log_that_is_gone_is_not_called_done(tmp_path):
    """It stayed as it was in the manifest; its output may be all there is of it, and stays."""
    logs, out = tmp_path / "in", tmp_path / "out"
    for name in "ab":
        spin(logs / f"{name}.csv")
    batch(logs, "-o", out, code=0)
    (logs / "b.csv").unlink()
    batch(logs / "a.csv", "-o", out, code=0)  # nobody looked for others
    assert states(out)["b.csv.parquet"] == "done"
    done = batch(logs, "-o", out, "--skip-existing", code=0)
    assert done.stderr == (
        "nothing to do: its output is up to date; 1 log is no longer there, and noted as deleted\n"
    )
    assert states(out) == {"a.csv.parquet": "done", "b.csv.parquet": "deleted"}
    assert outputs_in(out) == ["a.csv.parquet", "b.csv.parquet"]
    spin(logs / "b.csv")
    batch(logs, "-o", out, "--skip-existing", code=0)
    assert states(out) == {"a.csv.parquet": "done", "b.csv.parquet": "done"}


def test_only_logs_of_the_part_that_are_nowhere_are_gone(tmp_path):
    """Each part of a batch notes its own, and what stands at the place of a log is not judged."""
    logs, out = tmp_path / "in", tmp_path / "out"
    for name in "abcdef":
        spin(logs / f"{name}.csv")
    batch(logs, "-o", out, code=0)
    for name in "bcdef":
        (logs / f"{name}.csv").unlink()
    (logs / "f.csv").mkdir()
    gone = []
    for part in ("1/2", "2/2"):
        batch(logs, "-o", out, "--skip-existing", "--shard", part, code=None)
        gone.append({name for name, state in states(out).items() if state == "deleted"})
    assert set() < gone[0] < gone[1] == {f"{name}.csv.parquet" for name in "bcde"}


def test_links_to_folders_are_counted_and_not_followed(tmp_path):
    """They were skipped silently, and below ** a loop gave 41 outputs of one log."""
    spin(tmp_path / "in" / "deep" / "a.csv")
    (tmp_path / "in" / "deep" / "loop").symlink_to(tmp_path / "in")
    for given in (tmp_path / "in", f"{tmp_path}/in/**", f"{tmp_path}/in/**/*.csv"):
        out = tmp_path / "out"
        done = batch(given, "-o", out, code=0)
        assert said(done).startswith("1 of 1 logs done, 5 samples")
        assert said(done).endswith("ignored 1 link to folders") == ("*.csv" not in str(given))
        assert list(entries(out)) == ["deep/a.csv.parquet"]
        shutil.rmtree(out)
    # A part of a pattern that stands for the link follows it.
    done = batch(f"{tmp_path}/in/deep/l*/deep/*.csv", "-o", tmp_path / "out", code=0)
    assert list(entries(tmp_path / "out")) == ["loop/deep/a.csv.parquet"]


def test_a_batch_of_no_logs_is_an_error(tmp_path):
    """For a folder with other tables only, 0 of 0 logs were done, with code 0."""
    (tmp_path / "in").mkdir()
    for name in ("gps.csv", "notes.csv"):
        (tmp_path / "in" / name).write_text("t,lat\n0,1\n")
    done = batch(tmp_path / "in", "-o", tmp_path / "out", "-q", code=2)
    assert done.stderr.splitlines()[-1] == (
        "Error: there are no logs: ignored 2 tables without body rates; name the logs themselves"
    )


def test_metadata_of_something_else_make_no_bag(tmp_path, bucket):
    """Any metadata.yaml made its folder a bag, which failed, and hid what was below."""
    logs = tmp_path / "in"
    spin(logs / "deep" / "a.csv")
    spin(logs / "b.csv")
    (logs / "metadata.yaml").write_text("owner: me\n")
    shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", logs / "bag")
    spin(logs / "bag" / "near" / "c.csv")
    upload(logs, f"{bucket}/in")
    for given in (logs, f"{bucket}/in"):
        batch(given, "-o", tmp_path / "out", code=0)
        assert sorted(entries(tmp_path / "out")) == [
            "b.csv.parquet", "bag.parquet", "bag/near/c.csv.parquet", "deep/a.csv.parquet",
        ]  # fmt: skip
        shutil.rmtree(tmp_path / "out")


def test_a_folder_that_may_not_be_read_fails_alone(tmp_path, monkeypatch):
    """It stopped the batch before anything was done."""
    spin(tmp_path / "in" / "a.csv")
    spin(tmp_path / "in" / "closed.v2" / "b.csv")
    scan = os.scandir

    def closed(path):
        if str(path).endswith("closed.v2"):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(log_search.os, "scandir", closed)
    done = batch(tmp_path / "in", "-o", tmp_path / "out", code=2)
    assert f"Error: {tmp_path / 'in' / 'closed.v2'}: " in done.stderr
    assert said(done) == "1 of 2 logs done, 5 samples"
    assert states(tmp_path / "out") == {"a.csv.parquet": "done", "closed.v2.parquet": "failed"}


@pytest.mark.parametrize("written", [None, 9])
def test_a_full_disk_while_the_manifest_is_written_is_an_error(tmp_path, monkeypatch, written):
    """ENOSPC was reported as a bug; a log whose entry is not written is not called done."""
    log, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    write = os.write

    def full(file, data):
        if b'"state"' in data and not written:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, data[:written])

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        done = batch(log, "-o", out, "-q", code=2)
    assert done.stderr == (
        f"Error: {out / '_manifest'}: cannot be written: No space left on device\n"
    )
    assert said(batch(log, "-o", out, "--skip-existing")) == "1 of 1 logs done, 5 samples"


def test_a_store_that_does_not_answer_is_asked_again(tmp_path, bucket, store_server, monkeypatch):
    """Repetitions were for processes that were killed; a burst of 503 failed its logs."""
    pauses = []

    def pause(seconds):
        pauses.append(seconds)
        store_server.before = lambda *_: "503 Slow Down" if len(pauses) < 6 else None

    address = spin(f"{bucket}/a.csv")
    monkeypatch.setattr(worker.time, "sleep", pause)
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    store_server.before = lambda _method, path: "503 Slow Down" if "a.csv" in path else None
    batch(address, "-o", tmp_path / "out", "--retries", "6", code=0)
    assert pauses == [1, 2, 4, 8, 16, 30]


def test_a_skipped_log_of_a_store_costs_no_request(tmp_path, bucket, store_server):
    """A new one cost six HEADs, then two, and one that was skipped two."""
    logs = f"{bucket}/in"
    for number in range(3):
        spin(f"{logs}/{number}.csv")
    upload(SAMPLE_LOGS / "coning.mcap", f"{logs}/3.mcap")
    rows = (f"{10_000_000 * k},0,0,{k % 7}\n" for k in range(90_000))  # more than is read at once
    (tmp_path / "long.csv").write_text(f"t_ns,wx,wy,wz\n{''.join(rows)}")
    upload(tmp_path / "long.csv", f"{logs}/4.csv")

    def heads(*given):
        before = len(store_server.requests)
        batch(*given, "--skip-existing", code=0)
        named = [path for method, path in store_server.requests[before:] if method == "HEAD"]
        return {number: sum(f"/{number}." in path for path in named) for number in range(5)}

    out = ("-o", tmp_path / "out")
    assert heads(logs, *out) == dict.fromkeys(range(5), 1)  # to open it
    # It was written in the minute of its reading, perhaps twice.
    assert max(heads(logs, *out).values()) <= 1
    store_server.age(bucket)
    assert heads(logs, *out) == dict.fromkeys(range(5), 1)
    assert heads(logs, *out) == dict.fromkeys(range(5), 0)
    # Of a log that is named its store is asked by opening it.
    named = (f"{logs}/3.mcap", f"{logs}/4.csv", "-o", tmp_path / "named")
    assert heads(*named)[3] == 1
    done = "nothing to do: all 2 outputs are up to date\n"
    assert batch(*named, "--skip-existing").stderr == done
    assert {name: entry["origin"] for name, entry in entries(tmp_path / "named").items()} == {
        name: entries(tmp_path / "out")[name]["origin"]
        for name in ("3.mcap.parquet", "4.csv.parquet")
    }


def test_outputs_are_the_same_wherever_they_are_made(tmp_path, bucket, monkeypatch):
    """The provenance had the path as typed, so bytes depended on the working directory."""
    logs = tmp_path / "in"
    for name in ("coning.mcap", "tumbling.bag", "spin.csv"):
        (logs / "deep").mkdir(parents=True, exist_ok=True)
        shutil.copyfile(SAMPLE_LOGS / name, logs / "deep" / name)
    upload(logs, f"{bucket}/in")
    monkeypatch.chdir(tmp_path)
    made = []
    for number, given in enumerate((logs, "in", f"{bucket}/in", "in/*/*")):
        out = tmp_path / f"out{number}"
        batch(given, "-o", out, code=0)
        made.append({path.name: path.read_bytes() for path in (out / "deep").iterdir()})
    assert len(made[0]) == 3
    assert made[1:] == made[:1] * 3


def test_files_next_to_the_logs_are_named_as_on_every_machine(tmp_path, bucket):
    """Calibrations, times and first attitudes were named by their absolute paths."""
    made = []
    for number, place in enumerate(("here", "deep/there", "here")):
        root = tmp_path / place
        spin(root / "in" / "a.csv")
        spin(root / "in" / "times.csv", samples=3)
        spin(root / "side" / "times.csv", samples=4)
        if number == 0:
            batch(root / "in" / "a.csv", "-o", root / "side", code=0)
        elif number == 1:
            shutil.copyfile(
                tmp_path / "here" / "side" / "a.csv.parquet", root / "side" / "a.csv.parquet"
            )
        logs = root / "in" / "a.csv"
        if number == 2:
            logs = f"{bucket}/in/a.csv"
            upload(root / "in" / "a.csv", logs)
        for times in ("in", "side"):
            files = ("--at", root / times / "times.csv", "--q0", root / "side" / "a.csv.parquet")
            out = root / f"out{number}{times}"
            batch(logs, "-o", out, *files, code=0)
            made.append((out / "a.csv.parquet").read_bytes())
            text = pyarrow.parquet.read_metadata(out / "a.csv.parquet").metadata[b"quatprop"]
            assert set(json.loads(text)["files"]) == {"a.csv.parquet", "times.csv"}
            assert str(tmp_path).encode() not in text
    assert made[2:] == made[:2] * 2
    task = BatchTask("/r", "a.csv")
    named = ["/r/a.csv", "/r/x/b.csv", "/s/1/b.csv", "/s/2/b.csv", "/s/c.csv"]
    assert worker.display_names(task, named) == [
        "a.csv",
        "x/b.csv",
        "1/b.csv",
        "2/b.csv",
        "s/c.csv",
    ]


def test_a_log_that_is_another_input_too_has_one_name(tmp_path):
    """With the log for --at, all files next to the logs were named by their absolute paths."""
    log = spin(tmp_path / "in" / "a.csv")
    start = write_attitudes(tmp_path / "start.csv", [0], [[1, 0, 0, 0]])
    batch(log, "-o", tmp_path / "out", "--at", log, "--q0", start, code=0)
    text = pyarrow.parquet.read_metadata(tmp_path / "out" / "a.csv.parquet").metadata[b"quatprop"]
    assert set(json.loads(text)["files"]) == {"a.csv", "start.csv"}


def test_the_outputs_are_one_dataset(tmp_path):
    """The manifest was a table among them."""
    polars, pandas = pytest.importorskip("polars"), pytest.importorskip("pandas")
    out = tmp_path / "out"
    for name in ("a.csv", "b/c.csv"):
        spin(tmp_path / "in" / name)
    batch(tmp_path / "in", "-o", out, code=0)
    spin(tmp_path / "in" / "a.csv", samples=7).write_text("nothing")
    batch(tmp_path / "in", "-o", out, code=2)
    spin(tmp_path / "in" / "a.csv", samples=7)
    batch(tmp_path / "in", "-o", out, code=0)
    assert (out / "_stale" / "a.csv.parquet.old").exists()
    assert pyarrow.dataset.dataset(out).count_rows() == 12
    assert len(pandas.read_parquet(out)) == 12
    assert len(polars.scan_parquet(out / "**" / "*.parquet").collect()) == 12


SQL = re.findall(r"```sql\n(.*?)```", FLEETS.read_text(), re.DOTALL)


def test_the_queries_of_the_document_give_the_right_answers(tmp_path, monkeypatch):
    """The manifest had neither times nor batches, nor earlier entries."""
    duckdb = pytest.importorskip("duckdb")
    monkeypatch.chdir(tmp_path)
    for name in ("changed", "new", "same", "torn"):
        log = spin(tmp_path / "in" / f"{name}.csv")
    log.write_text(log.read_text() + "500000000,0\n")
    batch("in", "-o", "before", code=3)
    manifest = Manifest("attitudes")
    manifest.prepare()
    for name in ("changed.csv.parquet", "same.csv.parquet"):
        digest = "0" if name.startswith("c") else entries("before")[name]["attitudes_crc32"]
        before = ManifestEntry("done", "in", "x", name, attitudes_crc32=digest)
        manifest.record(before._replace(quatprop="0.0.9"))
    manifest.collect()
    (tmp_path / "expected.toml").write_text("gaps = 0\ndrops = 0\n")
    batch("in", "-o", "attitudes", "--expect", "expected.toml", code=1)
    lost, unmet, new, changed = (duckdb.sql(query).fetchall() for query in SQL[:4])
    assert unmet == [("torn.csv.parquet", ["1 sample lost, expected at most 0"])]
    assert lost == [("torn.csv.parquet", ["line 7: it has 2 columns instead of 4"])]
    assert sorted(new) == [("new.csv.parquet",), ("torn.csv.parquet",)]
    assert [(name, sorted(versions)) for name, versions in changed] == [
        ("changed.csv.parquet", sorted(["0.0.9", __version__])),
    ]


def test_many_batches_leave_few_files(tmp_path):
    """The entries of all are merged, and none is lost."""
    out, log = tmp_path / "out", spin(tmp_path / "a.csv")
    batch(log, "-o", out, code=0)
    first = entries(out)["a.csv.parquet"]
    for number in range(40):
        manifest = Manifest(str(out))
        entry = ManifestEntry("done", "/in", f"{number % 30}.csv", f"{number % 30}.npy")
        manifest.record(entry)
        manifest.collect()
    assert len(list((out / "_manifest").iterdir())) < 20
    history = Manifest(str(out)).history()
    assert len(history) == 41
    assert len(entries(out)) == 31
    assert entries(out)["a.csv.parquet"] == first
    assert refused("batch", log, "-o", out / "_manifest", "--shard", "2/1").startswith("Error: ")


def test_a_batch_that_ends_reads_no_entries_of_others(tmp_path):
    """Each end read and wrote all entries there were, of a fleet of 0.7 million for minutes."""
    out = tmp_path / "out"
    batch(spin(tmp_path / "a.csv"), "-o", out, code=0)
    (part,) = (out / "_manifest").iterdir()
    content = part.read_bytes()
    part.write_bytes(bytes(len(content)))  # reading it would fail
    manifest = Manifest(str(out))
    manifest.record(ManifestEntry("done", "/in", "b.csv", "b.npy"))
    manifest.collect()
    part.write_bytes(content)
    assert {*entries(out)} == {"a.csv.parquet", "b.npy"}
    assert len(list((out / "_manifest").iterdir())) == 2


def test_batches_that_end_at_once_lose_nothing(tmp_path):
    """One merges what another one reads, or merges as well."""

    def end(number):
        for turn in range(12):
            manifest = Manifest(str(tmp_path))
            name = f"{number}-{turn}"
            manifest.record(ManifestEntry("done", "/in", f"{name}.csv", f"{name}.npy"))
            ((_, known),) = manifest.slices(["state"])
            assert f"{name}.npy" in known
            manifest.collect()

    Manifest(str(tmp_path)).prepare()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(end, range(4)))
    history = Manifest(str(tmp_path)).history()["output"].to_pylist()
    assert history == sorted(f"{number}-{turn}.npy" for number in range(4) for turn in range(12))


def test_a_kill_while_parts_are_merged_loses_nothing(tmp_path, monkeypatch):
    """They were removed before the new one was in its place."""
    manifest = Manifest(str(tmp_path))
    manifest.prepare()
    manifest.record(ManifestEntry("done", "/in", "a.csv", "a.npy"))

    def killed(_output):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("quatprop.writers.atomic.OutputFile.publish", killed)
        with pytest.raises(KeyboardInterrupt):
            manifest.collect()
    assert list(entries(tmp_path)) == ["a.npy"]


def test_the_digest_of_attitudes_is_that_of_their_numbers(tmp_path):
    """In every format and layout, and whatever else is in a file."""
    log, found = spin(tmp_path / "in" / "a.csv", samples=700), set()
    for number, options in enumerate(
        (["--to", "csv"], ["--to", "npy", "--layout", "xyzw"], ["--with", "euler-zyx"])
    ):
        batch(log, "-o", tmp_path / str(number), *options, code=0)
        (entry,) = entries(tmp_path / str(number)).values()
        found.add(entry["attitudes_crc32"])
    with pytest.warns(quatprop.RemarkWarning, match="frozen"):
        series = quatprop.propagate(log)
    numbers = (series.t_ns.astype("<i8").tobytes(), series.wxyz.astype("<f8").tobytes())
    assert found == {"".join(f"{zlib.crc32(data):08x}" for data in numbers)}
    batch(log, "-o", tmp_path / "other", "--method", "mean", "--bias", "0,0,1e-9", code=0)
    (entry,) = entries(tmp_path / "other").values()
    assert entry["attitudes_crc32"] not in found


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data.split(b"\n", 1)[1],
        lambda _data: b"a,b\n1,2\n",
        lambda _data: b"nothing",
        lambda data: data.replace(b"wx,wy,wz", b"ax,ay,az"),
    ],
)
def test_a_log_that_was_done_and_has_lost_its_rates_has_failed(tmp_path, damage):
    """It was a table without rates then: exit code 0, and its output was gone."""
    log, out = spin(tmp_path / "in" / "a.csv"), tmp_path / "out"
    whole = log.read_bytes()
    batch(tmp_path / "in", "-o", out, code=0)
    log.write_bytes(damage(whole))
    for _ in range(2):  # also if it failed the last time
        said = batch(tmp_path / "in", "-o", out, "--skip-existing", code=2).stderr
        assert f"{log}: " in said
        assert "it was done in an earlier batch: is it damaged?" in said
        assert entries(out)["a.csv.parquet"]["state"] == "failed"
    log.write_bytes(whole)
    batch(tmp_path / "in", "-o", out, "--skip-existing", code=0)
    (tmp_path / "in" / "b.csv").write_text("a,b\n1,2\n")
    batch(tmp_path / "in", "-o", out, code=0)
    assert entries(out)["b.csv.parquet"]["state"] == "no rates"
