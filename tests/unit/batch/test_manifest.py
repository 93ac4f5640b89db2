"""The manifest of a batch, and what is up to date by it."""

import hashlib
import os
import subprocess
import sys

import pyarrow.parquet
import pytest
from make.batches import batch, entries, said, spin
from make.commands import refused

from quatprop.batch import execution
from quatprop.batch.manifest import write_table

UP_TO_DATE = "nothing to do: its output is up to date\n"


def test_the_manifest_has_a_line_for_each_log(tmp_path):
    """With what was read, done, written and lost; manifest.parquet is the same as a table."""
    good, torn = spin(tmp_path / "in" / "good.csv"), spin(tmp_path / "in" / "torn.csv")
    torn.write_text(torn.read_text() + "500000000,0\n")
    (tmp_path / "in" / "bad.csv").write_text("")
    out = tmp_path / "out"
    batch(tmp_path / "in", "-o", out, "--method", "mean", code=2)
    found = entries(out)
    assert {name: entry["state"] for name, entry in found.items()} == {
        "good.parquet": "done", "torn.parquet": "data lost", "bad.parquet": "failed",
    }  # fmt: skip
    entry = found["good.parquet"]
    assert {key: entry[key] for key in ("log", "samples", "rows", "span_s", "method", "error")} == {
        "log": str(good), "samples": 5, "rows": 5, "span_s": 0.4, "method": "mean", "error": None,
    }  # fmt: skip
    assert entry["sample_rate_hz"] == 10
    assert entry["final_wxyz"] == pytest.approx([0.9800665778, 0, 0, 0.1986693308])
    for name, path in (("log", good), ("output", out / "good.parquet")):
        assert entry[f"{name}_bytes"] == path.stat().st_size
        assert entry[f"{name}_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found["torn.parquet"]["losses"] == ["line 7: it has 2 columns instead of 4"]
    assert found["bad.parquet"]["error"].endswith("the file is empty; was the recording closed?")
    table = pyarrow.parquet.read_table(out / "manifest.parquet").to_pylist()
    assert table == [found[name] for name in sorted(found)]


def test_the_table_of_the_manifest_is_written_without_pandas(tmp_path):
    """Importing it takes longer than many logs; a manifest without entries is an empty table."""
    code = (
        "import sys; from pathlib import Path; from quatprop.batch.manifest import write_table; "
        "write_table([{'log': 'a', 'remarks': ['é'], 'more': 1}], Path('one.parquet')); "
        "sys.exit('pandas' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    write_table([], tmp_path / "none.parquet")
    assert pyarrow.parquet.read_table(tmp_path / "none.parquet").num_rows == 0
    (row,) = pyarrow.parquet.read_table(tmp_path / "one.parquet").to_pylist()
    assert {name: value for name, value in row.items() if value is not None} == {
        "log": "a", "remarks": ["é"],
    }  # fmt: skip


def test_a_line_that_was_cut_is_ignored(tmp_path):
    """A kill costs the line that was being written, and no other."""
    logs, out = [spin(tmp_path / f"{name}.csv") for name in "ab"], tmp_path / "out"
    batch(logs[0], "-o", out)
    manifest = out / "manifest.jsonl"
    line = manifest.read_bytes()
    manifest.write_bytes(line + line[:100])
    batch(logs[1], "-o", out)
    assert list(entries(out)) == ["a.parquet", "b.parquet"]
    assert manifest.read_bytes().startswith(line + line[:100] + b"\n{")
    done = batch(*logs, "-o", out, "--skip-existing")
    assert done.stderr == "nothing to do: all 2 outputs are up to date\n"


FOREIGN = [
    b'{"state": "done", "log": 5, "output": "a.parquet"}',
    b'{"state": ["done"], "log": "x", "output": "a.parquet"}',
    b'{"state": "done", "log": "x", "output": null}',
    b'{"state": "done", "log": "x", "output": "a.parquet", "samples": "many"}',
    b'{"state": "done", "log": "x", "output": "a.parquet", "rows": 100000000000000000000}',
    b'{"state": "done", "log": "x", "output": "a.parquet", "final_wxyz": [1, "x"]}',
    b'{"state": "done", "log": "x", "output": "a.parquet", "span_s": NaN}',
    b'{"state": "done", "log": "\\ud800", "output": "a.parquet"}',
    b'{"state": "done", "log": "\\u0000", "output": "a.parquet"}',
    b'{"state": "done", "log": "x", "log": "y", "output": "a.parquet"}',
    b"[" * 100_000,
    b"9" * 5000,
    b"\xff\x00",
]


@pytest.mark.parametrize("line", FOREIGN, ids=range(len(FOREIGN)))
def test_a_line_that_no_batch_writes_is_said(tmp_path, line):
    """A log that is a number, and 100,000 brackets, were bugs, or errors without a file."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    out.mkdir()
    manifest = out / "manifest.jsonl"
    manifest.write_bytes(b"\n" + line + b"\n" + line + b"\n")
    done = batch(path, "-o", out, "-q", code=0)
    assert done.stderr == (
        f"Warning: {manifest}: line 2 and 1 more: not what a batch writes; ignored, so that a log "
        "may be propagated again\n"
    )
    assert list(entries(out)) == ["a.parquet"]


def test_a_manifest_that_is_a_pipe_is_not_waited_for(tmp_path):
    """It would be read for ever."""
    (tmp_path / "out").mkdir()
    pipe = tmp_path / "out" / "manifest.jsonl"
    os.mkfifo(pipe)
    words = refused("batch", spin(tmp_path / "a.csv"), "-o", tmp_path / "out")
    assert words == f"Error: {pipe}: is no file; remove it"


def test_a_log_whose_name_is_no_unicode_is_in_the_manifest(tmp_path):
    """Its line could not be read again, so that it was propagated by every batch."""
    spin(tmp_path / "in" / os.fsdecode(b"a\xff.csv"))
    batch(tmp_path / "in", "-o", tmp_path / "out", code=0)
    done = batch(tmp_path / "in", "-o", tmp_path / "out", "--skip-existing")
    assert done.stderr == UP_TO_DATE


# What is up to date


def test_what_is_there_can_be_skipped(tmp_path):
    """After an interruption only the rest is done."""
    logs, out = [spin(tmp_path / f"{name}.csv") for name in "ab"], tmp_path / "out"
    batch(logs[0], "-o", out, "-q")
    before = (out / "a.parquet").stat().st_mtime_ns
    done = batch(*logs, "-o", out, "--skip-existing")
    words = "1 of 1 logs done, 5 samples; 1 skipped, as their outputs are up to date"
    assert said(done) == words
    assert (out / "a.parquet").stat().st_mtime_ns == before


def test_what_would_be_otherwise_is_not_skipped(tmp_path):
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
    (out / "manifest.jsonl").write_text("nonsense")
    assert not skipped("--method", "mean")
    (out / "a.parquet").unlink()
    assert not skipped("--method", "mean")


def test_a_log_that_changes_while_it_is_read_is_not_the_one_that_was(tmp_path, monkeypatch):
    """What was noted is the log before the run, so the next run does it again."""
    path, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    run_job = execution.run

    def changing(job, **options):
        report = run_job(job, **options)
        spin(path, rate=5.0, samples=9)
        return report

    with monkeypatch.context() as patched:
        patched.setattr(execution, "run", changing)
        batch(path, "-o", out, "-q")
    assert said(batch(path, "-o", out, "--skip-existing")) == "1 of 1 logs done, 9 samples"


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
