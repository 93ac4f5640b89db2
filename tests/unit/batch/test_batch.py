"""Many logs at a time: on this machine, on a cluster, and what goes wrong with some of them."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pyarrow.parquet
import pytest
from click.testing import CliRunner

from quatprop import __version__
from quatprop.batch import execution as batch
from quatprop.batch.cluster import on_a_cluster, propagate_on_worker
from quatprop.batch.entries import ManifestEntry
from quatprop.batch.execution import output_paths, propagate_log, shard
from quatprop.batch.logs import LogSearch
from quatprop.batch.manifest import Manifest, write_table
from quatprop.batch.tasks import BatchSettings, BatchTask
from quatprop.cli.batch import command
from quatprop.cli.commands import cli
from quatprop.cli.propagate import command as propagate
from quatprop.errors import LogError, QuatpropError, UsageError
from quatprop.errors.third_party import TRACEBACK
from quatprop.pipeline.job import Job
from quatprop.pipeline.settings import OutputSettings

INSTALLED = Path(sys.executable).with_name("quatprop")
HEADER = "t_ns,wx,wy,wz\n"


def run(*arguments):
    """Run `quatprop batch` in this process."""
    return CliRunner().invoke(cli, ["batch", *map(str, arguments)])


def log(path, rate=1.0, samples=5):
    """Write a log that turns about z."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"{100_000_000 * k},0,0,{rate}\n" for k in range(samples)]
    path.write_text(HEADER + "".join(rows))
    return path


def task(path, output, name):
    """Return the task of a log."""
    return BatchTask(str(path), str(output), name)


SETTINGS = BatchSettings.of(Job("LOG", OutputSettings("OUT")))


def outputs_in(folder):
    """Return the names of the outputs, without the manifest."""
    return sorted(path.name for path in folder.glob("*.parquet") if path.stem != "manifest")


@pytest.mark.parametrize("processes", [1, 2])
def test_each_log_gives_what_propagate_gives(tmp_path, processes):
    """The files are the same to the byte, however many are made at a time."""
    logs = [log(tmp_path / f"{name}.csv", rate) for name, rate in (("a", 1), ("b", 2), ("c", 3))]
    out = tmp_path / "out"
    done = run(*logs, "-o", out, "--to", "csv", "--method", "mean", "-j", processes)
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in out.glob("*.csv")) == ["a.csv", "b.csv", "c.csv"]
    for path in logs:
        alone = tmp_path / "alone.csv"
        CliRunner().invoke(cli, ["propagate", str(path), "-o", str(alone), "--method", "mean"])
        assert (out / path.name).read_bytes() == alone.read_bytes()
    assert done.stderr.splitlines()[-1] == "3 of 3 logs done, 15 samples"
    assert done.stdout == ""


def test_one_log_that_fails_does_not_stop_the_others(tmp_path):
    """Its error is shown, the others are done, and the exit code is 2."""
    good, bad = log(tmp_path / "good.csv"), tmp_path / "bad.csv"
    bad.write_text("0,20\n1,21\n2,22\n")
    done = run(bad, good, "-o", tmp_path / "out", "-q")
    assert done.exit_code == 2
    assert done.stderr == (
        f"Error: {bad}: no body rates found; its columns are '0', '1'; "
        "name the columns with --rate-cols and --time-col\n"
    )
    assert outputs_in(tmp_path / "out") == ["good.parquet"]
    assert done.stderr == f"Error: {entries(tmp_path / 'out')['bad.parquet']['error']}\n"


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (
            ZeroDivisionError("by zero"),
            "{log}: This is a bug in quatprop (ZeroDivisionError: ",
        ),
        (pyarrow.ArrowInvalid("no"), "{log}: Columns cannot be used (no)"),
        (MemoryError(), "{log}: There is not enough memory; choose fewer columns or topics"),
        (
            OSError(28, "No space left on device", "far/a"),
            "{log}: far/a: system error (No space",
        ),
    ],
)
def test_what_nobody_expected_does_not_stop_the_others(tmp_path, monkeypatch, error, sentence):
    """Errors that are none of a log, too, are those of one log of many."""

    def fails(job, **options):
        if job.log.endswith("bad.csv"):
            raise error
        return run_job(job, **options)

    monkeypatch.delenv(TRACEBACK, raising=False)
    run_job = batch.run
    monkeypatch.setattr(batch, "run", fails)
    bad, good = (str(log(tmp_path / name)) for name in ("bad.csv", "good.csv"))
    tasks = [task(name, tmp_path / "out.csv", "out.csv") for name in (bad, good)]
    results = [propagate_log(task, SETTINGS) for task in tasks]
    assert str(results[0].entry.error).startswith(sentence.format(log=bad))
    assert not results[1].entry.error
    # One log is propagated in this process.
    done = run(bad, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert f"Error: {sentence.format(log=bad)}" in done.stderr


def test_an_output_below_a_file_is_an_error_of_its_log(tmp_path):
    """Where the folder of an output cannot be made, its log says so, and the others are done."""
    first, _ = (log(tmp_path / "runs" / name / "imu.csv") for name in "12")
    out = tmp_path / "out"
    out.mkdir()
    (out / "1").write_text("in the way")
    done = run(tmp_path / "runs", "-o", out, "-j", "1")
    assert done.exit_code == 2
    assert f"Error: {first}: {out / '1'}: system error (" in done.stderr
    assert (out / "2" / "imu.parquet").exists()


def test_lost_data_of_any_log_is_code_3(tmp_path):
    """As for one log: all that can be saved is there, and the code tells."""
    torn = log(tmp_path / "torn.csv")
    torn.write_text(torn.read_text() + "500000000,0\n")
    done = run(torn, log(tmp_path / "whole.csv"), "-o", tmp_path / "out", "-j", "1")
    assert done.exit_code == 3
    assert "lost: line 7: it has 2 columns instead of 4" in done.stderr
    done = run(torn, tmp_path / "whole.csv", "-o", tmp_path / "out", "--skip-existing")
    assert done.exit_code == 3
    assert done.stderr == (
        "nothing to do: all 2 outputs are up to date; data was lost in 1 of them\n"
    )


# Which logs there are, and the names of their outputs.


def names(*given, root=None, output=""):
    """Return the names of the outputs of what was found."""
    search = LogSearch(root, output)
    for name in given:
        search.add(str(name))
    return [log.name for log in search.logs]


def test_a_folder_is_searched_for_logs(tmp_path):
    """Bag folders are one log; what is no log is counted; the outputs are no logs."""
    for name in ("b/imu.csv", "b/c/imu.csv", "a.MCAP", "x.bag.zst", "rec.bag.active", "b/.imu.csv"):
        log(tmp_path / name)
    log(tmp_path / "ride" / "metadata.yaml")
    log(tmp_path / "ride" / "ride_0.db3")
    log(tmp_path / ".git" / "x.csv")
    log(tmp_path / "out" / "a.parquet")
    (tmp_path / "README").write_text("text")
    (tmp_path / "unnamed").write_bytes(b"\x89MCAP0\r\n")
    search = LogSearch(output=str(tmp_path / "out"))
    search.add(str(tmp_path))
    assert [found.name for found in search.logs] == [
        "a", "rec", "unnamed", "x", "b/imu", "b/c/imu", "ride",
    ]  # fmt: skip
    assert search.other_files == 2  # one of them hidden
    assert names(tmp_path / "ride") == ["ride"]
    assert names(tmp_path / "b", tmp_path / "b" / "imu.csv") == ["imu", "c/imu"]


def test_patterns_are_expanded(tmp_path):
    """As a shell that knows ** does it; names are paths below the fixed part."""
    for name in ("mon/1/imu.csv", "mon/2/imu.csv", "tue/imu.csv", "tue/gps.csv", "a[1].csv"):
        log(tmp_path / name)
    assert names(tmp_path / "*" / "*" / "imu.csv") == ["mon/1/imu", "mon/2/imu"]
    assert names(tmp_path / "**" / "imu.csv") == ["mon/1/imu", "mon/2/imu", "tue/imu"]
    assert names(tmp_path / "mon" / "**") == ["1/imu", "2/imu"]
    assert names(tmp_path / "t*") == ["tue/gps", "tue/imu"]
    assert names(tmp_path / "a[1].csv") == ["a[1]"]
    with pytest.raises(UsageError, match=r"nothing matches '.*nothing\*'; check the pattern"):
        names(tmp_path / "nothing*")


def test_a_root_keeps_folders_in_names(tmp_path):
    """A log that is not below the root is refused."""
    first, second = log(tmp_path / "mon" / "imu.csv"), log(tmp_path / "tue" / "imu.csv")
    assert names(first, second) == ["imu", "imu"]
    assert names(first, second, root=tmp_path) == ["mon/imu", "tue/imu"]
    assert names(tmp_path / "mon", root=tmp_path) == ["mon/imu"]
    said = (
        r"does not lie in '.*mon'; choose another root \(names are relative to the current folder\)"
    )
    with pytest.raises(UsageError, match=said):
        names(first, second, root=tmp_path / "mon")


def test_a_name_depends_on_its_own_log_alone(tmp_path):
    """The same log has the same name in a folder, a pattern, and in any part of them."""
    for day in "abcdef":
        log(tmp_path / day / "imu.csv")
    every = names(tmp_path)
    assert every == names(tmp_path / "*" / "imu.csv") == [f"{day}/imu" for day in "abcdef"]
    search = LogSearch()
    search.add(str(tmp_path))
    parts = [shard(search.logs, f"{part}/4") for part in (1, 2, 3, 4)]
    assert sorted(found.name for part in parts for found in part) == every
    assert [len(part) for part in parts] == [2, 2, 1, 1]


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "-1/2", "a/b", "1/0"])
def test_a_part_is_one_of_n(text):
    """Anything else is refused."""
    with pytest.raises(UsageError, match=r"is not I/N, from 1/N to N/N, for shard"):
        shard([], text)


def test_compressed_logs_lose_both_suffixes(tmp_path):
    """A folder is named by its whole name, a file without the suffixes of its format."""
    (tmp_path / "bag.v2").mkdir()
    log(tmp_path / "bag.v2" / "metadata.yaml")
    paths = [tmp_path / name for name in ("a.mcap.zst", "bag.v2", "b.bag")]
    assert names(*paths) == ["a", "bag.v2", "b"]


def test_addresses_give_names_without_what_opens_them():
    """What an address says of its store is no part of a file's name."""
    logs = ["s3://key:secret@logs/a.mcap?chunk=eu.west/1", "s3://logs/d/b.bag.zst?a=b.c"]
    assert names(*logs) == ["a", "b"]
    assert names(*logs, root="s3://logs") == ["a", "d/b"]


def test_logs_of_a_pattern_keep_their_folders(tmp_path):
    """A folder for each run is how recordings are kept."""
    for day in ("monday", "tuesday"):
        log(tmp_path / day / "imu.csv")
    done = run(tmp_path / "*" / "imu.csv", "-o", tmp_path / "out", "-q", "-j", "1")
    assert done.exit_code == 0
    found = sorted((tmp_path / "out").rglob("imu.parquet"))
    assert found == [tmp_path / "out" / day / "imu.parquet" for day in ("monday", "tuesday")]


def test_logs_can_be_listed(tmp_path):
    """In a file or on stdin, one a line, beside others."""
    logs = [log(tmp_path / f"{name}.csv") for name in "abc"]
    (tmp_path / "list").write_text(f"{logs[0]}\n\n{logs[1]}\n")
    done = run(logs[2], "--list", tmp_path / "list", "-o", tmp_path / "out", "-j", "1")
    assert done.stderr.splitlines()[-1] == "3 of 3 logs done, 15 samples"
    arguments = ["batch", "--list", "-", "-o", str(tmp_path / "two"), "-j", "1"]
    done = CliRunner().invoke(cli, arguments, input=f"{logs[0]}\n{logs[1]}")
    assert done.stderr.splitlines()[-1] == "2 of 2 logs done, 10 samples"
    missing = run("--list", tmp_path / "nope", "-o", tmp_path / "out")
    assert missing.exit_code == 2
    assert missing.stderr == (
        f"Error: {tmp_path / 'nope'}: no such file or folder; check the path\n"
    )
    assert "there are no logs; name files, folders or patterns" in run("-o", "x").stderr
    (tmp_path / "empty").mkdir()
    empty = run(tmp_path / "empty", "-o", "x").stderr
    assert "there are no logs in '" in empty
    assert "empty'; name files" in empty


def test_a_batch_takes_the_cores_that_it_may_use(tmp_path, monkeypatch):
    """As in a job of which the scheduler says on how many cores it runs."""
    counts = []

    def noted(_tasks, _settings, processes, *_options):
        counts.append(processes)
        yield from ()

    monkeypatch.setattr("quatprop.batch.execution.on_this_machine", noted)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {1, 4, 6}, raising=False)
    source = log(tmp_path / "a.csv")
    run(source, "-o", tmp_path / "out", "-q")
    run(source, "-o", tmp_path / "out", "-q", "-j", 5)
    assert counts == [3, 5]


def test_tables_without_rates_in_a_folder_are_no_logs(tmp_path):
    """They are counted; one that is named is an error."""
    log(tmp_path / "in" / "imu.csv")
    gps = tmp_path / "in" / "gps.csv"
    gps.write_text("t,lat,lon\n0,1,2\n")
    (tmp_path / "in" / "note.md").write_text("words")
    done = run(tmp_path / "in", "-o", tmp_path / "out", "-j", "1")
    assert (done.exit_code, done.stderr.splitlines()[-1]) == (
        0,
        "1 of 1 logs done, 5 samples; ignored 1 table without body rates and 1 other file",
    )  # fmt: skip
    assert entries(tmp_path / "out")["gps.parquet"]["state"] == "no rates"
    assert run(gps, "-o", tmp_path / "out").exit_code == 2


def test_a_folder_of_logs_takes_no_outputs(tmp_path):
    """The outputs would be logs of the next run."""
    log(tmp_path / "a.csv")
    done = run(tmp_path, "-o", tmp_path)
    assert done.exit_code == 2
    assert f"outputs in '{tmp_path}' would lie among the logs; choose --output" in done.stderr


def test_keys_in_addresses_are_not_shown(tmp_path):
    """Neither with the name of the log, nor in its error, nor in the report."""
    address = "nowhere://key:secret@logs/a.mcap"
    done = run(address, "-o", tmp_path, "--json", "-j", "1")
    assert done.exit_code == 2
    assert "secret" not in done.stdout + done.stderr
    assert "nowhere://logs/a.mcap: there is no store of this kind (" in done.stderr
    assert json.loads(done.stdout)[0]["log"] == "nowhere://logs/a.mcap"


def test_two_logs_never_share_an_output(tmp_path):
    """They are refused before anything runs; one log that is named twice is one."""
    one, other = log(tmp_path / "a.csv"), log(tmp_path / "a.txt")
    out = tmp_path / "out"
    done = run(one, other, "-o", out)
    assert done.exit_code == 2
    assert done.stderr == (
        f"Error: '{one}' and '{other}' would both be written to '{out / 'a.parquet'}'; rename one "
        "of them\n"
    )
    other = log(tmp_path / "b" / "a.csv")
    assert run(one, other, "-o", out).stderr == (
        f"Error: '{one}' and '{other}' would both be written to '{out / 'a.parquet'}'; keep their "
        "folders in the names with --root DIR, a folder above both, or write to another folder\n"
    )
    assert not out.exists()
    assert run(one, tmp_path / "." / "a.csv", "-o", out, "-q").exit_code == 0
    assert len(entries(out)) == 1


def test_an_output_of_another_log_is_not_replaced(tmp_path):
    """One log at a time, too: the manifest knows whose output it is."""
    one, other = log(tmp_path / "1" / "imu.csv"), log(tmp_path / "2" / "imu.csv")
    assert run(one, "-o", tmp_path / "out").exit_code == 0
    done = run(other, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert f"was made from '{one}', not from '{other}'; keep their folders" in done.stderr
    assert run(other, "-o", tmp_path / "out", "--root", tmp_path).exit_code == 0
    assert run(one, "-o", tmp_path / "out").exit_code == 0


def test_outputs_do_not_replace_logs(tmp_path):
    """DIR may be where the logs are, but not if an output would have the name of one."""
    path = log(tmp_path / "a.csv")
    done = run(path, "-o", tmp_path, "--to", "csv")
    assert done.exit_code == 2
    assert "this is an input of the run; choose another output" in done.stderr


def test_outputs_do_not_replace_other_logs(tmp_path):
    """Nor may the output of one log have the name of another log."""
    first, other = log(tmp_path / "x" / "a.csv"), log(tmp_path / "out" / "x" / "a.csv", 2)
    before = other.read_bytes()
    options = ("-o", tmp_path / "out", "--to", "csv", "--root", tmp_path)
    done = run(first, other, *options)
    assert done.exit_code == 2
    assert done.stderr.endswith(f"{other}: this is an input of the run; choose another output\n")
    assert other.read_bytes() == before


def test_names_that_differ_in_case_only_are_refused(tmp_path):
    """On many disks they are one name."""
    search = LogSearch()
    for name in ("1/IMU.bag", "2/imu.bag"):
        search.add(str(tmp_path / name))
    with pytest.raises(UsageError, match=r"would both be written to 'out/imu\.npy'"):
        output_paths(search.logs, "out", ".npy")


@pytest.mark.parametrize("command", ["propagate", "info"])
def test_one_log_of_a_folder_is_not_taken_for_all(tmp_path, command):
    """The other commands refuse a folder with several logs, and name them."""
    log(tmp_path / "in" / "a.csv")
    log(tmp_path / "in" / "b.mcap")
    (tmp_path / "in" / "b.truth.csv").touch()
    (tmp_path / "in" / "c").mkdir()
    (tmp_path / "in" / "c" / "metadata.yaml").touch()
    output = ["-o", str(tmp_path / "out.csv")] if command == "propagate" else []
    done = CliRunner().invoke(cli, [command, str(tmp_path / "in"), *output])
    assert done.exit_code == 2
    assert done.stderr == (
        f"Error: {tmp_path / 'in'}: the folder holds several logs: 'a.csv', 'b.mcap', 'c'; "
        "name one, or use quatprop batch\n"
    )


# The manifest.


def entries(folder):
    """Return the entries of a manifest."""
    return Manifest(str(folder)).entries()


def test_the_manifest_has_a_line_for_each_log(tmp_path):
    """With what was read, done, written and lost; manifest.parquet is the same as a table."""
    good, torn = log(tmp_path / "in" / "good.csv"), log(tmp_path / "in" / "torn.csv")
    torn.write_text(torn.read_text() + "500000000,0\n")
    (tmp_path / "in" / "bad.csv").write_text("")
    out = tmp_path / "out"
    assert run(tmp_path / "in", "-o", out, "--method", "mean", "-j", "1").exit_code == 2
    found = entries(out)
    assert {name: entry["state"] for name, entry in found.items()} == {
        "good.parquet": "done", "torn.parquet": "data lost", "bad.parquet": "failed",
    }  # fmt: skip
    entry = found["good.parquet"]
    assert {key: entry[key] for key in ("log", "samples", "rows", "span_s", "method", "error")} == {
        "log": str(good), "samples": 5, "rows": 5, "span_s": 0.4, "method": "mean", "error": None,
    }  # fmt: skip
    assert entry["final_wxyz"] == pytest.approx([0.9800665778, 0, 0, 0.1986693308])
    for name in ("log", "output"):
        path = good if name == "log" else out / "good.parquet"
        assert entry[f"{name}_bytes"] == path.stat().st_size
        assert entry[f"{name}_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found["torn.parquet"]["losses"] == ["line 7: it has 2 columns instead of 4"]
    assert found["bad.parquet"]["error"].endswith("the file is empty; was the recording closed?")
    table = pyarrow.parquet.read_table(out / "manifest.parquet").to_pylist()
    assert [row["output"] for row in table] == sorted(found)
    assert [{**row} for row in table] == [found[row["output"]] for row in table]


def test_the_table_of_the_manifest_is_written_without_pandas(tmp_path):
    """Importing it takes longer than many logs; a manifest without entries is an empty table."""
    code = (
        "import sys; from pathlib import Path; from quatprop.batch.manifest import write_table; "
        "write_table([], Path('none.parquet')); "
        "write_table([{'log': 'a', 'remarks': ['é'], 'more': 1}], Path('one.parquet')); "
        "sys.exit('pandas' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    assert pyarrow.parquet.read_table(tmp_path / "none.parquet").num_rows == 0
    (row,) = pyarrow.parquet.read_table(tmp_path / "one.parquet").to_pylist()
    assert {name: value for name, value in row.items() if value is not None} == {
        "log": "a", "remarks": ["é"],
    }  # fmt: skip


def test_a_topic_is_no_matter_of_tables(tmp_path):
    """Those in a folder are not meant; one that is named is refused before anything is done."""
    table, out = log(tmp_path / "logs" / "a.csv"), tmp_path / "out"
    recorded = tmp_path / "logs" / "b.mcap"
    simulate = ["simulate", str(recorded), "--samples", "5", "--truth", "none"]
    assert CliRunner().invoke(cli, simulate).exit_code == 0
    done = run(tmp_path / "logs", "-o", out, "--topic", "/imu")
    assert done.exit_code == 0, done.output
    assert done.stderr.splitlines()[-1] == "1 of 1 logs done, 5 samples; ignored 1 other file"
    done = run(recorded, table, "-o", tmp_path / "none", "--topic", "/imu")
    assert done.exit_code == 2
    assert done.stderr == (
        f"Error: '{table}' is a table, and --topic is for logs of messages; propagate tables by "
        "themselves\n"
    )
    assert not (tmp_path / "none").exists()


def test_a_line_that_was_cut_is_ignored(tmp_path):
    """A kill costs the line that was being written, and no other."""
    logs, out = [log(tmp_path / f"{name}.csv") for name in "ab"], tmp_path / "out"
    run(logs[0], "-o", out)
    manifest = out / "manifest.jsonl"
    line = manifest.read_bytes()
    manifest.write_bytes(line + line[:100])
    run(logs[1], "-o", out)
    assert list(entries(out)) == ["a.parquet", "b.parquet"]
    assert manifest.read_bytes().startswith(line + line[:100] + b"\n{")
    done = run(*logs, "-o", out, "--skip-existing")
    assert done.stderr == "nothing to do: all 2 outputs are up to date\n"


def test_several_batches_write_to_one_folder(tmp_path):
    """As the machines of an array job do: each its part, all of them in one manifest."""
    for number in range(12):
        log(tmp_path / "in" / f"{number}.csv")
    out = tmp_path / "out"
    shards = [
        subprocess.Popen([INSTALLED, "batch", tmp_path / "in", "-o", out, "-q", "-j", "1",
                          "--shard", f"{part}/2"])
        for part in (1, 2)
    ]  # fmt: skip
    assert [part.wait() for part in shards] == [0, 0]
    assert len(outputs_in(out)) == 12
    assert len((out / "manifest.jsonl").read_text().splitlines()) == 12
    assert len(entries(out)) == 12
    assert pyarrow.parquet.read_table(out / "manifest.parquet").num_rows == 12


def test_a_table_of_fewer_entries_does_not_replace_one_of_more(tmp_path, monkeypatch):
    """A batch that ends while another one writes its table waits for it."""
    program = """
import sys
from quatprop.batch.entries import ManifestEntry
from quatprop.batch.manifest import Manifest
manifest = Manifest(sys.argv[1])
manifest.record(ManifestEntry("done", "/b.csv", "b.parquet"))
manifest.write_table()
"""
    others = []

    def slow(entries, path):
        others.append(subprocess.Popen([sys.executable, "-c", program, tmp_path]))
        with suppress(subprocess.TimeoutExpired):
            others[0].wait(1.5)
        write_table(entries, path)

    manifest = Manifest(str(tmp_path))
    manifest.record(ManifestEntry("done", "/a.csv", "a.parquet"))
    monkeypatch.setattr("quatprop.batch.manifest.write_table", slow)
    manifest.write_table()
    assert others[0].wait(60) == 0
    assert pyarrow.parquet.read_table(tmp_path / "manifest.parquet").num_rows == 2


def test_what_is_there_can_be_skipped(tmp_path):
    """After an interruption only the rest is done."""
    logs = [log(tmp_path / f"{name}.csv") for name in "ab"]
    run(logs[0], "-o", tmp_path / "out", "-q")
    before = (tmp_path / "out" / "a.parquet").stat().st_mtime_ns
    done = run(*logs, "-o", tmp_path / "out", "--skip-existing")
    assert done.stderr.splitlines()[-1] == (
        "1 of 1 logs done, 5 samples; 1 skipped, as their outputs are up to date"
    )
    assert (tmp_path / "out" / "a.parquet").stat().st_mtime_ns == before


def test_what_would_be_otherwise_is_not_skipped(tmp_path):
    """Other options, another log of the same name, an output of someone else: propagated again."""
    path, out = log(tmp_path / "a.csv"), tmp_path / "out"
    again = ("-o", out, "--skip-existing")

    def skipped(*options):
        return "nothing to do" in run(path, *again, *options).stderr

    assert not skipped()
    assert skipped()
    assert not skipped("--method", "mean")
    assert skipped("--method", "mean")
    log(path, rate=3.0, samples=7)
    assert not skipped("--method", "mean")
    (out / "manifest.jsonl").write_text("nonsense")
    assert not skipped("--method", "mean")
    (out / "a.parquet").unlink()
    assert not skipped("--method", "mean")


def test_a_log_that_changes_while_it_is_read_is_not_the_one_that_was(tmp_path, monkeypatch):
    """What was noted is the log before the run, so the next run does it again."""
    path, out = log(tmp_path / "a.csv"), tmp_path / "out"

    def changing(job, **options):
        report = run_job(job, **options)
        log(path, rate=5.0, samples=9)
        return report

    run_job = batch.run
    with monkeypatch.context() as patched:
        patched.setattr(batch, "run", changing)
        run(path, "-o", out, "-j", 1, "-q")
    done = run(path, "-o", out, "--skip-existing")
    assert done.stderr.splitlines()[-1] == "1 of 1 logs done, 9 samples"


def test_a_log_at_an_address_is_skipped_too(tmp_path):
    """By its size and time; when nothing is left to do, a message says so."""
    path, out = log(tmp_path / "a.csv"), tmp_path / "out"
    for _ in range(2):
        done = run(path.as_uri(), "-o", out, "--skip-existing")
    assert done.stderr == "nothing to do: its output is up to date\n"
    log(path, rate=7.0)
    done = run(path.as_uri(), "-o", out, "--skip-existing")
    assert done.stderr.splitlines()[-1] == "1 of 1 logs done, 5 samples"


def test_the_folder_of_outputs_is_no_file(tmp_path):
    """Said before anything is done."""
    path = log(tmp_path / "a.csv")
    done = run(path, "-o", path)
    assert done.exit_code == 2
    assert f"-o {path} is a file; name a folder for the outputs" in done.stderr


def test_the_reports_are_json(tmp_path):
    """One object for each log, in their order."""
    good, bad = log(tmp_path / "good.csv"), tmp_path / "bad.csv"
    bad.write_text("")
    found = json.loads(run(bad, good, "-o", tmp_path / "out", "--json", "-q").stdout)
    assert [one["log"] for one in found] == [str(bad), str(good)]
    assert found[0]["error"].endswith("the file is empty; was the recording closed?")
    assert found[1]["report"]["result"]["samples"] == 5


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-"], "stdin is one log; give it to quatprop propagate"),
        (["a.csv", "-j", "2", "--dask", "tcp://x:1"], "-j is for this machine; leave it out with"),
        (["a.csv", "--heading", "5"], "--heading goes with --q0 level"),
    ],
)
def test_wrong_usage_is_one_sentence(tmp_path, arguments, sentence):
    """Options that cannot be are refused before any log is read."""
    done = run(*arguments, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert sentence in done.stderr


def test_the_options_are_those_of_propagate(tmp_path):
    """What holds for one log holds for many, and help shows it."""
    shown = run("--help-all").stdout
    for option in ("--method", "--q0", "--bias", "--on-gap", "--rate-unit", "--every", "--layout"):
        assert option in shown
    assert "--into" not in shown
    done = run(log(tmp_path / "a.csv"), "-o", tmp_path / "out", "--every", "2", "-q")
    assert done.exit_code == 0
    assert pyarrow.parquet.read_table(tmp_path / "out" / "a.parquet").num_rows == 3


ONE_LOG = {"output", "to", "into", "report", "plot", "quiet", "verbose"}
"""Options of propagate that are about one log: batch has its own of some of them, or none."""

EVERY_LOG = {
    "--layout": "xyzw", "--with": "rotvec", "--euler-unit": "deg", "--header-comment": None,
    "--message": "TFMessage", "--out-topic": "/q",
    "--frames": "map,base", "--method": "coning", "--rates": "inertial", "--q0": "0,1,0,0",
    "--heading": "90", "--reference-z": "down", "--q0-layout": "xyzw", "--bias": "1,2,3",
    "--calibration": __file__, "--imu": __file__, "--sigma": None, "--sigma-axes": "reference",
    "--noise-density": "0.2deg/sqrt(h)", "--bias-sigma": "20deg/h", "--scale-sigma": "1000ppm",
    "--random-walk": "1e-5rad/s/sqrt(s)",
    "--mount": "x,-y,-z", "--start": "+1s", "--end": "-1s", "--on-backwards": "drop",
    "--on-nonfinite": "hold", "--max-gap": "2s", "--on-gap": "zero", "--every": "3",
    "--rate": "50", "--at": __file__, "--from": "csv", "--topic": "/imu",
    "--msg-path": __file__, "--rate-field": "a.b", "--series": "gyro",
    "--time-field": "a.t", "--rate-cols": "1,2,3", "--time-col": "0", "--rate-unit": "deg/s",
    "--time-unit": "ms", "--sample-rate": "10", "--clock": "log",
}  # fmt: skip
"""Option of propagate that holds for every log -> a value that is not its default."""

WITH = {
    "--heading": ("--q0", "level"),
    "--reference-z": ("--q0", "level"),
    "--q0-layout": ("--q0", "1,0,0,0"),
    "--euler-unit": ("--with", "euler-zyx"),
    "--sigma": ("--noise-density", "0.2deg/sqrt(h)"),
    "--sigma-axes": ("--sigma", "--noise-density", "0.2deg/sqrt(h)"),
}
"""What an option goes with."""


def test_every_option_of_propagate_holds_for_every_log_or_is_about_one():
    """Whoever adds an option to propagate has to decide here which it is."""
    names = {name for option in propagate.params for name in option.opts if name.startswith("--")}
    elsewhere = {"--config", "--threads"} | {f"--{name}" for name in ONE_LOG}
    assert names == EVERY_LOG.keys() | elsewhere
    own = {name for option in command.params for name in option.opts if name.startswith("--")}
    assert own == EVERY_LOG.keys() | {"--config", "--output", "--to", "--quiet", "--json", "--dask",
                                      "--skip-existing", "--list", "--root", "--shard",
                                      "--retries", "--threads"}  # fmt: skip


@pytest.mark.parametrize("option", EVERY_LOG)
def test_an_option_means_what_it_means_to_propagate(option, tmp_path, monkeypatch):
    """It makes the same job of a log, and another one than without it."""
    jobs = []

    def record(job, *_, **__):
        jobs.append(job)
        raise LogError(job.log, "that is all")

    monkeypatch.setattr("quatprop.pipeline.job.run", record)
    monkeypatch.setattr("quatprop.batch.execution.run", record)
    value, beside = EVERY_LOG[option], WITH.get(option, ())
    said = [option] if value is None else [option, value]
    out = tmp_path / "a.parquet"
    for words in (said, []):
        CliRunner().invoke(cli, ["propagate", "a.mcap", "-o", str(out), *beside, *words])
        run("a.mcap", "-o", tmp_path, *beside, *words)
    alone, among, plain, plain_among = [
        job._replace(output=job.output._replace(to=None)) for job in jobs
    ]
    assert alone == among
    assert plain == plain_among
    assert alone != plain


def test_the_number_of_threads_makes_no_other_output(tmp_path):
    """The cores are shared among the logs unless it is said how many; nothing is done again."""
    path = log(tmp_path / "a.csv")
    assert run(path, "-o", tmp_path / "out", "--threads", "3", "-q").exit_code == 0
    first = (tmp_path / "out" / "a.parquet").read_bytes()
    assert "up to date" in run(path, "-o", tmp_path / "out", "--skip-existing").stderr
    assert run(path, "-o", tmp_path / "out", "--threads", "1", "-q").exit_code == 0
    assert (tmp_path / "out" / "a.parquet").read_bytes() == first
    assert SETTINGS.with_threads(4).job.settings.threads == 4
    assert SETTINGS.with_threads(2).with_threads(4).job.settings.threads == 2


def test_the_installed_command_runs_processes(tmp_path):
    """Two processes, started afresh by the command itself."""
    logs = [log(tmp_path / f"{name}.csv") for name in "abc"]
    command = [INSTALLED, "batch", *logs, "-o", tmp_path / "out", "-j", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(outputs_in(tmp_path / "out")) == 3


def test_a_cluster_that_is_not_there(tmp_path):
    """The address is named."""
    pytest.importorskip("distributed")
    far = task(log(tmp_path / "a.csv"), tmp_path / "a.npy", "a.npy")
    with pytest.raises(UsageError, match="no Dask scheduler answers at 'nonsense'"):
        list(on_a_cluster([far], SETTINGS, "nonsense", Manifest(str(tmp_path))))
    code = "from quatprop.batch.cluster import _client; _client('nonsense')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=15, check=False
    )
    assert "Exception ignored" not in done.stderr


def raising(task, settings, _version):
    """Raise what a worker without this package does."""
    if task.name == "a":
        raise ModuleNotFoundError("No module named 'quatprop'")
    return propagate_log(task, settings)


def test_what_other_machines_raise_is_an_outcome(tmp_path, monkeypatch):
    """A worker without this package is an error of the log; others are done, and recorded."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("quatprop.batch.cluster.propagate_on_worker", raising)
    tasks = [task(log(tmp_path / f"{n}.csv"), tmp_path / f"{n}.npy", n) for n in ("a", "b")]
    manifest = Manifest(str(tmp_path))
    quiet = {"processes": False, "dashboard_address": None, "threads_per_worker": 1}
    with distributed.LocalCluster(n_workers=1, **quiet) as cluster:
        results = dict(on_a_cluster(tasks, SETTINGS, cluster.scheduler_address, manifest))
    assert str(results[0].entry.error).endswith(
        "a.csv: the cluster failed (ModuleNotFoundError: No module named 'quatprop')"
    )
    assert not results[1].entry.error
    assert {n: entry["state"] for n, entry in entries(tmp_path).items()} == {
        "a": "failed", "b": "done",
    }  # fmt: skip


def test_a_cluster_without_workers_or_scheduler(tmp_path, monkeypatch):
    """One sentence in seconds for a cluster that does nothing, and for one that goes."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("quatprop.batch.cluster.WORKERS_S", 0.5)
    far = task(log(tmp_path / "a.csv"), tmp_path / "a.npy", "a.npy")
    manifest = Manifest(str(tmp_path))
    quiet = {"processes": False, "dashboard_address": None}
    with distributed.LocalCluster(n_workers=0, **quiet) as cluster:
        results = on_a_cluster([far], SETTINGS, cluster.scheduler_address, manifest)
        with pytest.raises(UsageError, match=r"has no workers; start some, and try again$"):
            list(results)
    cancelled = distributed.client.FutureCancelledError("a", "lost")
    monkeypatch.setattr(distributed.Future, "result", lambda _: (_ for _ in ()).throw(cancelled))
    with distributed.LocalCluster(n_workers=1, **quiet) as cluster:
        results = on_a_cluster([far], SETTINGS, cluster.scheduler_address, manifest)
        with pytest.raises(QuatpropError, match="no longer answers; what is done is recorded"):
            list(results)


def test_files_of_settings_are_the_same_from_every_folder(tmp_path, monkeypatch):
    """A relative name is of the folder of the command, not of that of a worker."""
    for place in (tmp_path / "here", tmp_path / "there"):
        log(place / "a.csv")
        log(place / "times.csv")
    monkeypatch.chdir(tmp_path / "here")
    assert run("a.csv", "--at", "times.csv", "-o", "out", "-j", "1").exit_code == 0
    monkeypatch.chdir(tmp_path / "there")
    again = ["-o", tmp_path / "here" / "out", "--skip-existing", "-j", "1"]
    named = [tmp_path / "here" / "a.csv", "--at", tmp_path / "here" / "times.csv"]
    assert run(*named, *again).stderr == "nothing to do: its output is up to date\n"


def test_a_worker_of_another_version_is_refused(tmp_path):
    """Its outputs would be those of another version."""
    there = task("a.csv", tmp_path / "a.csv", "a.csv")
    result = propagate_on_worker(there, SETTINGS, "0.0.1")
    assert result.entry.error == (
        f"a.csv: its worker has quatprop {__version__}, not 0.0.1; install the same version"
    )


CLUSTER = """
import subprocess, sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        command = [*sys.argv[1:], "--dask", cluster.scheduler_address]
        sys.exit(subprocess.run(command).returncode)
"""


def test_a_cluster_gives_the_same_files(tmp_path):
    """The workers of a Dask cluster write what this machine writes, to the byte."""
    pytest.importorskip("distributed")
    logs = [log(tmp_path / f"{name}.csv", k) for k, name in enumerate("abcd")]
    bad = tmp_path / "bad.csv"
    bad.write_text("")
    script = tmp_path / "cluster.py"
    script.write_text(CLUSTER)
    command = [INSTALLED, "batch", *logs, bad, "--to", "csv", "-o"]
    done = subprocess.run(
        [sys.executable, script, *command, tmp_path / "far"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 2, done.stderr
    assert "4 of 5 logs done, 20 samples" in done.stderr
    assert run(*logs, "--to", "csv", "-o", tmp_path / "near", "-q", "-j", "1").exit_code == 0
    for path in logs:
        far, near = (tmp_path / where / path.name for where in ("far", "near"))
        assert far.read_bytes() == near.read_bytes()


HOOK = """
import multiprocessing, os, sys
def kill(event, arguments):
    if event == "open" and str(arguments[0]).endswith("crash.csv"):
        if multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), 9)
sys.addaudithook(kill)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_log_that_kills_its_process_fails_alone(tmp_path, processes):
    """All others are done, and the batch says which was killed, at once and at the end."""
    (tmp_path / "sitecustomize.py").write_text(HOOK)
    for number in range(9):
        log(tmp_path / "in" / f"{number}.csv")
    log(tmp_path / "in" / "crash.csv")
    environment = {
        **os.environ,
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
    }
    command = [sys.executable, "-m", "quatprop", "batch", tmp_path / "in", "-o", tmp_path / "out"]
    done = subprocess.run(
        [*command, "-j", processes], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 2, done.stderr
    reason = f"{tmp_path / 'in' / 'crash.csv'}: the process that ran it was killed; is there enough"
    assert f"\nError: {reason}" in done.stderr
    assert done.stderr.splitlines()[-3:-1] == ["1 failed:", done.stderr.splitlines()[-2]]
    assert done.stderr.splitlines()[-2].startswith(f"  {reason}")
    assert done.stderr.splitlines()[-1] == "9 of 10 logs done, 45 samples"
    states = [entry["state"] for entry in entries(tmp_path / "out").values()]
    assert sorted(states) == ["done"] * 9 + ["failed"]


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_batch_that_was_ended_goes_on_where_it_was(tmp_path, number):
    """Nothing that was done is done again, nothing half-written stays, and no process either."""
    for name in range(40):
        log(tmp_path / "in" / f"{name}.csv", rate=name, samples=50)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "quatprop", "batch", tmp_path / "in", "-o", out, "-j", "2"]
    process = subprocess.Popen([*command, "-q"], stderr=subprocess.DEVNULL)
    end = time.monotonic() + 60
    while not out.exists() or len(entries(out)) < 5:
        assert time.monotonic() < end
        time.sleep(0.01)
    process.send_signal(number)
    process.wait(30)
    before = None if number == signal.SIGKILL else len(entries(out))
    while before != (before := len(entries(out))):
        time.sleep(1)  # until the processes of a killed batch have ended
    # What was complete an instant before it was recorded is done again.
    assert before <= len(outputs_in(out)) <= before + 2
    assert before < 40
    done = run(tmp_path / "in", "-o", out, "-j", "2", "--skip-existing")
    assert done.exit_code == 0, done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"{40 - before} of {40 - before} logs done")
    assert sorted(path.suffix for path in out.iterdir()) == [".jsonl", *[".parquet"] * 41]
    again = run(tmp_path / "in", "-o", tmp_path / "again", "-j", "1", "-q")
    assert again.exit_code == 0
    for name in outputs_in(out):
        assert (out / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_options_that_fit_no_log_are_refused_once(tmp_path):
    """Before anything is run or written."""
    for name in ("a.csv", "b.csv"):
        log(tmp_path / "logs" / name)
    result = run(tmp_path / "logs", "-o", tmp_path / "out", "--sigma")
    assert result.exit_code == 2
    assert result.output.count("--sigma needs the errors of the gyroscope; give") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["a.parquet", "sub", "manifest.jsonl", "manifest.parquet"])
def test_links_in_the_folder_of_outputs_are_not_followed_out_of_it(tmp_path, name):
    """Files outside were replaced through links, which anyone who writes there may put there."""
    log(tmp_path / "in" / "a.csv")
    log(tmp_path / "in" / "sub" / "b.csv")
    out, outside = tmp_path / "out", tmp_path / "outside"
    (tmp_path / "real").mkdir()
    out.symlink_to("real")  # the folder itself may be a link
    target = outside if name == "sub" else outside / "file"
    outside.mkdir()
    if name != "sub":
        target.write_text("precious")
    (out / name).symlink_to(target)
    done = run(tmp_path / "in", "-o", out)
    assert done.exit_code == 2
    place = target / "b.parquet" if name == "sub" else target
    shown = out / "sub" / "b.parquet" if name == "sub" else out / name
    assert (
        f"Error: {shown}: {place} is written to, which is not in {tmp_path / 'real'}; remove the "
        "link or the path that leads there\n"
    ) in done.stderr
    assert [path.name for path in outside.iterdir()] == ["file"] * (name != "sub")
    assert name == "sub" or target.read_text() == "precious"
    written = {path.name for path in out.rglob("*.parquet") if not path.is_symlink()}
    one = {"a.parquet": {"b.parquet"}, "sub": {"a.parquet"}}
    assert written - {"manifest.parquet"} == one.get(name, set())


def test_a_manifest_that_is_a_pipe_is_not_waited_for(tmp_path):
    """It would be read for ever."""
    (tmp_path / "out").mkdir()
    pipe = tmp_path / "out" / "manifest.jsonl"
    os.mkfifo(pipe)
    done = run(log(tmp_path / "a.csv"), "-o", tmp_path / "out")
    assert (done.exit_code, done.stderr) == (2, f"Error: {pipe}: is no file; remove it\n")


@pytest.mark.parametrize(
    "line",
    [
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
    ],
    ids=range(13),
)
def test_a_line_that_no_batch_writes_is_said(tmp_path, line):
    """A log that is a number, and 100,000 brackets, were bugs, or errors without a file."""
    path, out = log(tmp_path / "a.csv"), tmp_path / "out"
    out.mkdir()
    manifest = out / "manifest.jsonl"
    manifest.write_bytes(b"\n" + line + b"\n" + line + b"\n")
    done = run(path, "-o", out, "-q")
    assert done.exit_code == 0
    assert done.stderr == (
        f"Warning: {manifest}: line 2 and 1 more: not what a batch writes; ignored, so that a log "
        "may be propagated again\n"
    )
    assert list(entries(out)) == ["a.parquet"]


def test_a_log_whose_name_is_no_unicode_is_in_the_manifest(tmp_path):
    """Its line could not be read again, so that it was propagated by every batch."""
    name = os.fsdecode(b"a\xff.csv")
    log(tmp_path / "in" / name)
    assert run(tmp_path / "in", "-o", tmp_path / "out").exit_code == 0
    done = run(tmp_path / "in", "-o", tmp_path / "out", "--skip-existing")
    assert done.stderr == "nothing to do: its output is up to date\n"
