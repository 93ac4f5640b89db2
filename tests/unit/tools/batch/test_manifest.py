"""The manifest of a batch, and what is up to date by it."""

import hashlib
import itertools
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from make.batches import UP_TO_DATE, batch, entries, outputs_in, said, spin
from make.commands import refused
from make.systems import on_posix

from quatprop.tools.batch import manifest, worker
from quatprop.tools.batch.manifest import Manifest, ManifestEntry, bucket_of, json_line, table_of


def test_the_manifest_has_a_line_for_each_log(tmp_path):
    """With what was read, done, written and lost."""
    good, torn = spin(tmp_path / "in" / "good.csv"), spin(tmp_path / "in" / "torn.csv")
    torn.write_text(torn.read_text() + "500000000,0\n")
    (tmp_path / "in" / "bad.csv").write_text("")
    out = tmp_path / "out"
    batch(tmp_path / "in", "-o", out, "--method", "mean", code=2)
    found = entries(out)
    assert {name: entry["state"] for name, entry in found.items()} == {
        "good.csv.parquet": "done", "torn.csv.parquet": "data lost", "bad.csv.parquet": "failed",
    }  # fmt: skip
    entry = found["good.csv.parquet"]
    assert {key: entry[key] for key in ("log", "samples", "rows", "span_s", "method", "error")} == {
        "log": "good.csv", "samples": 5, "rows": 5, "span_s": 0.4, "method": "mean", "error": None,
    }  # fmt: skip
    assert entry["sample_rate_hz"] == 10
    assert entry["final_wxyz"] == pytest.approx([0.9800665778, 0, 0, 0.1986693308])
    for name, path in (("log", good), ("output", out / "good.csv.parquet")):
        assert entry[f"{name}_bytes"] == path.stat().st_size
        assert entry[f"{name}_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found["torn.csv.parquet"]["losses"] == ["line 7: it has 2 columns instead of 4"]
    assert found["bad.csv.parquet"]["error"].endswith(
        "the file is empty; was the recording closed?"
    )
    assert entry["root"] == str(tmp_path / "in")
    assert {path.suffix for path in (out / "_manifest").iterdir()} == {".pq"}


def test_the_manifest_is_written_without_pandas(tmp_path):
    """Importing it takes longer than many logs."""
    code = (
        "import sys; from quatprop.tools.batch.manifest import Manifest; "
        "from quatprop.tools.batch.manifest import ManifestEntry; manifest = Manifest('out'); "
        "manifest.prepare(); manifest.record(ManifestEntry('done', '/', 'a', 'a', remarks=('é',)));"
        "manifest.collect(); sys.exit('pandas' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    assert entries(tmp_path / "out")["a"]["remarks"] == ["é"]
    assert len(Manifest(str(tmp_path / "none")).history()) == 0


def journal(out, *lines):
    """Write lines as a batch does that was killed."""
    (out / "_manifest").mkdir(parents=True, exist_ok=True)
    (out / "_manifest" / "1-killed.jsonl").write_bytes(b"".join(lines))


def test_the_lines_of_a_large_batch_become_parts_meanwhile(tmp_path, monkeypatch):
    """All lines were held at once, and parsed again for each part of the buckets."""
    monkeypatch.setattr(manifest, "PART_ENTRIES", 10)
    monkeypatch.setattr(manifest, "SLICE_ROWS", 25)
    monkeypatch.setattr(manifest, "MANY", 1000)
    parsed = []
    monkeypatch.setattr(manifest, "table_of", lambda text: parsed.append(text) or table_of(text))
    batch = Manifest(str(tmp_path))
    batch.prepare()
    of_bucket = {bucket_of(str(number)): str(number) for number in range(4000)}
    for number in range(100):
        name = of_bucket[256 * (number % 90) // 90]  # also the first bucket of each part
        batch.record(ManifestEntry("done", "/in", name, name))
    files = [path.suffix for path in (tmp_path / "_manifest").iterdir()]
    assert sorted(files) == [".jsonl"] + [".pq"] * 9
    batch.collect()
    assert [text.count(b"\n") for text in parsed] == [10] * 10
    assert [path.suffix for path in (tmp_path / "_manifest").iterdir()] == [".pq"] * 10
    assert batch.history().num_rows == 100
    slices = list(batch.slices(["state"]))
    assert len(slices) == 5
    assert [part.stop for part, _ in slices[:-1]] == [part.start for part, _ in slices[1:]]
    for part, known in slices:
        assert {bucket_of(name) in part for name in known} == {True}
    assert sum(len(known) for _, known in slices) == 90
    assert len(entries(tmp_path)) == 90


OPEN_FILES = Path("/proc/self/fd")


@pytest.mark.skipif(not OPEN_FILES.is_dir(), reason="open files are listed by Linux")
def test_a_batch_of_many_logs_has_no_more_files_open(tmp_path):
    """Each log has a line, which is written to a file that is opened for it."""
    batch = Manifest(str(tmp_path))
    batch.prepare()
    before = len([*OPEN_FILES.iterdir()])
    for number in range(100):
        batch.record(ManifestEntry("done", "/in", str(number), str(number)))
    assert len([*OPEN_FILES.iterdir()]) < before + 50


def test_an_entry_has_at_least_the_bytes_that_are_counted_on():
    """The number of entries in a file is estimated from its size."""
    entry = ManifestEntry("done", "", "", "", seconds=0.0, quatprop="1")
    assert len(json_line(entry.recorded(""))) >= manifest.LINE_BYTES


def test_a_line_that_was_cut_is_ignored(tmp_path):
    """A kill costs the line that was being written, and no other."""
    entry = ManifestEntry("done", "/in", "a.csv", "a.csv.parquet").recorded("1")
    line = json_line(entry)
    journal(tmp_path, line, line[:100])
    assert list(entries(tmp_path)) == ["a.csv.parquet"]
    assert Manifest(str(tmp_path)).history().num_rows == 1


OWN = ManifestEntry(
    "done", "/in", "a.csv", "b.parquet", samples=5, final_wxyz=(1, 0.5, 0, 0), remarks=("é",)
).recorded("1")
LINE = json_line(OWN)[:-1]

FOREIGN = [
    LINE.replace(b'"a.csv"', b"5"),
    LINE.replace(b'"done"', b'["done"]'),
    LINE.replace(b'"b.parquet"', b"null"),
    LINE.replace(b'"samples": 5', b'"samples": "many"'),
    LINE.replace(b'"samples": 5', b'"samples": 9223372036854775808'),
    LINE.replace(b'"bucket": %d' % OWN.bucket, b'"bucket": 256'),
    LINE.replace(b"[1, 0.5, 0, 0]", b'[1, "x"]'),
    LINE.replace(b'"a.csv"', b'"\\ud800"'),
    LINE.replace(b'"log": ', b'"log": "y", "log": '),
    LINE.replace(OWN.time.encode(), b"today"),
    b"[" * 100_000,
    b"9" * 5000,
    b"\xff\x00",
]


@pytest.mark.parametrize("line", FOREIGN, ids=range(len(FOREIGN)))
def test_a_line_that_no_batch_writes_is_reported(tmp_path, line):
    """A log that is a number, and 100,000 brackets, were bugs, or errors without a file."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    journal(out, b"\n" + line + b"\n" + line + b"\n" + LINE + b"\n")
    done = batch(path, "-o", out, "-q", code=0)
    assert done.stderr == (
        f"Warning: {out / '_manifest'}: 2 lines that no batch writes; ignored, so that a log may "
        "be propagated again\n"
    )
    assert sorted(entries(out)) == ["a.csv.parquet", "b.parquet"]
    assert entries(out)["b.parquet"]["final_wxyz"] == [1, 0.5, 0, 0]


@pytest.mark.parametrize(("days", "left"), [(6.9, ".jsonl"), (7.1, ".pq")])
def test_lines_of_a_batch_that_was_killed_are_merged_after_a_week(tmp_path, days, left):
    """Before, it may be one that another machine still runs."""
    journal(tmp_path, LINE, b"\n")
    (path,) = (tmp_path / "_manifest").iterdir()
    os.utime(path, (time.time() - days * 86_400,) * 2)
    Manifest(str(tmp_path)).collect()
    assert [path.suffix for path in (tmp_path / "_manifest").iterdir()] == [left]
    assert list(entries(tmp_path)) == ["b.parquet"]


@on_posix
def test_a_manifest_that_is_a_pipe_is_not_waited_for(tmp_path):
    """It would be read for ever."""
    (tmp_path / "out").mkdir()
    pipe = tmp_path / "out" / "_manifest"
    os.mkfifo(pipe)
    words = refused("batch", spin(tmp_path / "a.csv"), "-o", tmp_path / "out")
    assert words == f"Error: {pipe}: is not a folder; remove it"


def test_a_folder_in_the_manifest_is_passed_over(tmp_path):
    """It cannot be read as one of its files, whatever its name."""
    (tmp_path / "out" / "_manifest" / "1-copy.pq").mkdir(parents=True)
    batch(spin(tmp_path / "a.csv"), "-o", tmp_path / "out", code=0)
    assert list(entries(tmp_path / "out")) == ["a.csv.parquet"]


def test_a_log_whose_name_is_no_unicode_is_in_the_manifest(tmp_path):
    """Its line could not be read again, so that it was propagated by every batch."""
    spin(tmp_path / "in" / os.fsdecode(b"a\xff.csv"))
    batch(tmp_path / "in", "-o", tmp_path / "out", code=0)
    done = batch(tmp_path / "in", "-o", tmp_path / "out", "--skip-existing")
    assert done.stderr == UP_TO_DATE
    assert list(entries(tmp_path / "out")) == [r"a\xff.csv.parquet"]


# Outputs that are up to date


def test_existing_outputs_can_be_skipped(tmp_path):
    """After an interruption, only the remaining logs are propagated."""
    logs, out = [spin(tmp_path / f"{name}.csv") for name in "ab"], tmp_path / "out"
    batch(logs[0], "-o", out, "-q")
    before = (out / "a.csv.parquet").stat().st_mtime_ns
    done = batch(*logs, "-o", out, "--skip-existing")
    words = "1 of 1 logs done, 5 samples; 1 skipped, as their outputs are up to date"
    assert said(done) == words
    assert (out / "a.csv.parquet").stat().st_mtime_ns == before


def test_outputs_that_are_not_up_to_date_are_not_skipped(tmp_path):
    """Other options, another log of the same name, an output of someone else: propagated again."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"

    def skipped(*options):
        return batch(path, "-o", out, "--skip-existing", *options).stderr == UP_TO_DATE

    assert not skipped()
    assert skipped()
    # The number of threads makes no other output.
    assert skipped("--threads", "3")
    assert not skipped("--method", "mean")
    assert skipped("--method", "mean")
    spin(path, rate=3.0, samples=7)
    assert not skipped("--method", "mean")
    shutil.rmtree(out / "_manifest")
    assert not skipped("--method", "mean")
    (out / "a.csv.parquet").unlink()
    assert not skipped("--method", "mean")


def changing(monkeypatch, path, times):
    """Let a log be written again after each of so many readings."""
    run_job, count = worker.run, itertools.count(1)

    def run(job, **options):
        report = run_job(job, **options)
        if (number := next(count)) <= times:
            spin(path, rate=5.0, samples=9 + number)
        return report

    monkeypatch.setattr(worker, "run", run)


def test_a_log_that_changes_while_it_is_read_is_read_again(tmp_path, monkeypatch):
    """It was called done, with the attitudes of what it had been."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    changing(monkeypatch, path, 1)
    assert said(batch(path, "-o", out, code=0)) == "1 of 1 logs done, 10 samples"
    assert batch(path, "-o", out, "--skip-existing").stderr == UP_TO_DATE


def test_a_log_that_changes_before_it_is_hashed_is_read_again(tmp_path, monkeypatch):
    """Its digest was recorded with the attitudes of what it had been."""
    path, out, times = spin(tmp_path / "a.csv"), tmp_path / "out", []
    digest_of = worker.digest_of

    def late(place):
        times.append(place)
        if len(times) == 1:
            spin(path, rate=5.0, samples=9)
        return digest_of(place)

    monkeypatch.setattr(worker, "digest_of", late)
    batch(path, "-o", out, "--to", "csv", code=0)
    (entry,) = entries(out).values()
    assert entry["log_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert entry["samples"] == 9


def test_a_log_that_changes_all_the_time_is_not_done(tmp_path, monkeypatch):
    """Its recorder may still write to it."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    changing(monkeypatch, path, 99)
    done = batch(path, "-o", out, "-q", code=2)
    words = "it was written to while it was read; try again when it is complete"
    assert done.stderr == f"Error: {path}: {words}\n"
    assert outputs_in(out) == []


def test_a_log_at_an_address_is_skipped_too(tmp_path):
    """By its size and time; when nothing is left to do, a message says so."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    again = (path.as_uri(), "-o", out, "--skip-existing")
    batch(*again)
    assert batch(*again).stderr == UP_TO_DATE
    spin(path, rate=7.0)
    assert said(batch(*again)) == "1 of 1 logs done, 5 samples"


def test_files_of_settings_are_the_same_from_every_folder(tmp_path, monkeypatch):
    """A relative name is of the folder of the command, not of that of a worker."""
    here, there = tmp_path / "here", tmp_path / "there"
    for place in (here, there):
        spin(place / "a.csv")
        spin(place / "times.csv")
    monkeypatch.chdir(here)
    batch("a.csv", "--at", "times.csv", "-o", "out", code=0)
    monkeypatch.chdir(there)
    named = [here / "a.csv", "--at", here / "times.csv", "-o", here / "out"]
    assert batch(*named, "--skip-existing").stderr == UP_TO_DATE
