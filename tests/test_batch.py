"""Many logs at a time: on this machine, on a cluster, and what goes wrong with some of them."""

import json
import subprocess
import sys
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path, PureWindowsPath

import pyarrow.parquet
import pytest
from click.testing import CliRunner

from quatprop.batch import run as batch
from quatprop.batch.run import below_shared, on_a_cluster, outputs, propagated
from quatprop.cli import cli
from quatprop.cli.batch import command
from quatprop.cli.propagate import command as propagate
from quatprop.errors import LogError, UsageError
from quatprop.pipeline.job import Job
from quatprop.pipeline.settings import OutputSettings
from quatprop.third_party_errors import TRACEBACK

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
    """Its sentence is said, the others are done, and the exit code is 2."""
    good, bad = log(tmp_path / "good.csv"), tmp_path / "bad.csv"
    bad.write_text("0,20\n1,21\n2,22\n")
    done = run(bad, good, "-o", tmp_path / "out", "-q")
    assert done.exit_code == 2
    assert done.stderr == (
        f"Error: {bad}: no body rates found; its columns are '0', '1'; "
        "name the columns with --rate-cols and --time-col\n"
    )
    assert [path.name for path in (tmp_path / "out").glob("*.parquet")] == ["good.parquet"]


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

    def fails(job):
        if job.log.endswith("bad.csv"):
            raise error
        return run_job(job)

    monkeypatch.delenv(TRACEBACK, raising=False)
    run_job = batch.run
    monkeypatch.setattr(batch, "run", fails)
    bad, good = (str(log(tmp_path / name)) for name in ("bad.csv", "good.csv"))
    outcomes = [
        propagated(Job(name, OutputSettings(str(tmp_path / "out.csv")))) for name in (bad, good)
    ]
    assert str(outcomes[0].error).startswith(sentence.format(log=bad))
    assert not outcomes[1].error
    # One log is propagated in this process.
    done = run(bad, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert f"Error: {sentence.format(log=bad)}" in done.stderr


def test_an_output_below_a_file_is_told(tmp_path):
    """Where the folder of an output cannot be made, its log says so, and the others are done."""
    first = log(tmp_path / "runs" / "1" / "imu.csv")
    second = log(tmp_path / "runs" / "2" / "imu.csv")
    out = tmp_path / "out"
    out.mkdir()
    (out / "1").write_text("in the way")
    done = run(first, second, "-o", out, "-j", "1")
    assert done.exit_code == 2
    assert f"Error: {first}: {out / '1'}: system error (" in done.stderr
    assert (out / "2" / "imu.parquet").exists()


def test_lost_data_of_any_log_is_code_3(tmp_path):
    """As for one log: all that can be saved is there, and the code tells."""
    torn = log(tmp_path / "torn.csv")
    torn.write_text(torn.read_text() + "500000000,0\n")
    done = run(torn, log(tmp_path / "whole.csv"), "-o", tmp_path / "out")
    assert done.exit_code == 3
    assert "lost: line 7: it has 2 columns instead of 4" in done.stderr


def test_logs_of_the_same_name_keep_their_folders(tmp_path):
    """A folder for each run is how recordings are kept."""
    logs = [log(tmp_path / run_ / "imu.csv") for run_ in ("monday", "tuesday")]
    assert run(*logs, "-o", tmp_path / "out", "-q").exit_code == 0
    found = sorted((tmp_path / "out").rglob("*.parquet"))
    assert found == [tmp_path / "out" / day / "imu.parquet" for day in ("monday", "tuesday")]


def test_packed_logs_lose_both_suffixes(tmp_path):
    """A log is named without its packing; a folder by its whole name."""
    (tmp_path / "bag.v2").mkdir()
    logs = [str(tmp_path / "a.mcap.zst"), str(tmp_path / "bag.v2"), str(tmp_path / "b.bag")]
    names = [path.name for path in outputs(logs, Path("out"), ".npy")]
    assert names == ["a.npy", "bag.v2.npy", "b.npy"]


def test_logs_of_the_same_name_may_be_on_several_drives():
    """Of paths that have no folder in common, all folders are kept, but not the drive."""
    places = [PureWindowsPath(name) for name in ("C:/runs/1/imu.bag", "D:/runs/2/imu.bag")]
    assert [path.as_posix() for path in below_shared(places)] == ["1", "2"]
    places = [PureWindowsPath(name) for name in ("C:/a/imu.bag", "D:/b/c/imu.bag")]
    assert [path.as_posix() for path in below_shared(places)] == ["a", "b/c"]


def test_addresses_give_names_without_what_opens_them():
    """What an address says of its store is no part of a file's name."""
    logs = ["s3://key:secret@logs/a.mcap?region=eu.west/1", "s3://logs/b.bag.zst?a=b.c"]
    assert outputs(logs, Path("out"), ".npy") == [Path("out/a.npy"), Path("out/b.npy")]


def test_keys_in_addresses_are_not_shown(tmp_path):
    """Neither where the log is told of, nor in its error, nor in the report."""
    address = "nowhere://key:secret@logs/a.mcap"
    done = run(address, "-o", tmp_path, "--json", "-j", "1")
    assert done.exit_code == 2
    assert "secret" not in done.stdout + done.stderr
    assert "nowhere://logs/a.mcap: it cannot be read from its store (" in done.stderr
    assert json.loads(done.stdout)[0]["log"] == "nowhere://logs/a.mcap"


def test_two_logs_never_share_an_output(tmp_path):
    """Neither one log twice nor two that differ in their suffix alone."""
    one, other = log(tmp_path / "a.csv"), log(tmp_path / "a.txt")
    twice = run(one, one, "-o", tmp_path / "out")
    assert (twice.exit_code, twice.stderr) == (
        2,
        f"Error: '{one}' is named 2 times; name each log once\n",
    )
    assert not (tmp_path / "out").exists()
    assert run(one, other, "-o", tmp_path / "out", "-q").exit_code == 0
    assert sorted(path.name for path in (tmp_path / "out").glob("*.parquet")) == [
        "a.csv.parquet",
        "a.txt.parquet",
    ]


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
    done = run(first, other, "-o", tmp_path / "out", "--to", "csv")
    assert done.exit_code == 2
    assert done.stderr.endswith(f"{other}: this is an input of the run; choose another output\n")
    assert other.read_bytes() == before


def test_names_that_differ_in_case_only_keep_their_folders():
    """On many disks they are one name."""
    placed = outputs(["1/IMU.bag", "2/imu.bag"], Path("out"), ".npy")
    assert placed == [Path("out/1/IMU.npy"), Path("out/2/imu.npy")]


def test_what_is_there_can_be_skipped(tmp_path):
    """After an interruption only the rest is done."""
    logs = [log(tmp_path / f"{name}.csv") for name in "ab"]
    run(logs[0], "-o", tmp_path / "out", "-q")
    before = (tmp_path / "out" / "a.parquet").stat().st_mtime_ns
    done = run(*logs, "-o", tmp_path / "out", "--skip-existing")
    assert done.stderr.splitlines()[-1] == (
        "1 of 1 logs done, 5 samples; 1 skipped, as their outputs are as they would be"
    )
    assert (tmp_path / "out" / "a.parquet").stat().st_mtime_ns == before


def test_what_would_be_otherwise_is_not_skipped(tmp_path):
    """Other options, another log of the same name, an output of someone else: made anew."""
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
    (out / ".quatprop-batch.json").write_text("nonsense")
    assert not skipped("--method", "mean")
    (out / "a.parquet").unlink()
    assert not skipped("--method", "mean")


def test_a_log_that_changes_while_it_is_read_is_not_the_one_that_was(tmp_path, monkeypatch):
    """What was noted is the log before the run, so the next run does it again."""
    path, out = log(tmp_path / "a.csv"), tmp_path / "out"

    def changing(job):
        outcome = propagated(job)
        log(path, rate=5.0, samples=9)
        return outcome

    with monkeypatch.context() as patched:
        patched.setattr(batch, "propagated", changing)
        run(path, "-o", out, "-j", 1, "-q")
    done = run(path, "-o", out, "--skip-existing")
    assert done.stderr.splitlines()[-1] == "1 of 1 logs done, 9 samples"


def test_a_log_at_an_address_is_never_skipped(tmp_path):
    """Nobody here sees whether it has changed; and when nothing is left to do, that is said."""
    path, out = log(tmp_path / "a.csv"), tmp_path / "out"
    for _ in range(2):
        done = run(path.as_uri(), "-o", out, "--skip-existing")
        assert done.stderr.splitlines()[-1] == "1 of 1 logs done, 5 samples"
    run(path, "-o", out, "-q")
    done = run(path, "-o", out, "--skip-existing")
    assert done.stderr == "nothing to do: all 1 outputs are as they would be\n"


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
    shown = run("--help").stdout
    for option in ("--method", "--q0", "--bias", "--on-gap", "--rate-unit", "--every", "--layout"):
        assert option in shown
    assert "--into" not in shown
    done = run(log(tmp_path / "a.csv"), "-o", tmp_path / "out", "--every", "2", "-q")
    assert done.exit_code == 0
    assert pyarrow.parquet.read_table(tmp_path / "out" / "a.parquet").num_rows == 3


ONE_LOG = {"output", "to", "into", "report", "plot", "quiet", "verbose"}
"""Options of propagate that are about one log: batch has its own of some of them, or none."""

EVERY_LOG = {
    "--layout": "xyzw", "--header-comment": None, "--message": "TFMessage", "--out-topic": "/q",
    "--frames": "map,base", "--method": "coning", "--rates": "inertial", "--q0": "0,1,0,0",
    "--heading": "90", "--reference-z": "down", "--q0-layout": "xyzw", "--bias": "1,2,3",
    "--mount": "x,-y,-z", "--start": "+1s", "--end": "-1s", "--on-backwards": "drop",
    "--on-nonfinite": "hold", "--max-gap": "2s", "--on-gap": "zero", "--every": "3",
    "--rate": "50", "--at": __file__, "--from": "csv", "--topic": "/imu", "--rate-field": "a.b",
    "--time-field": "a.t", "--rate-cols": "1,2,3", "--time-col": "0", "--rate-unit": "deg/s",
    "--time-unit": "ms", "--sample-rate": "10", "--clock": "log",
}  # fmt: skip
"""Option of propagate that holds for every log -> a value that is not its default."""

WITH = {
    "--heading": ("--q0", "level"),
    "--reference-z": ("--q0", "level"),
    "--q0-layout": ("--q0", "1,0,0,0"),
}
"""What an option goes with."""


def test_every_option_of_propagate_holds_for_every_log_or_is_about_one():
    """Whoever adds an option to propagate has to decide here which it is."""
    names = {name for option in propagate.params for name in option.opts if name.startswith("--")}
    assert names == EVERY_LOG.keys() | {f"--{name}" for name in ONE_LOG}
    own = {name for option in command.params for name in option.opts if name.startswith("--")}
    assert own == EVERY_LOG.keys() | {"--output", "--to", "--quiet", "--json", "--dask",
                                      "--skip-existing"}  # fmt: skip


@pytest.mark.parametrize("option", EVERY_LOG)
def test_an_option_means_what_it_means_to_propagate(option, tmp_path, monkeypatch):
    """It makes the same job of a log, and another one than without it."""
    jobs = []

    def record(job, *_, **__):
        jobs.append(job)
        raise LogError(job.log, "that is all")

    monkeypatch.setattr("quatprop.pipeline.job.run", record)
    monkeypatch.setattr("quatprop.batch.run.run", record)
    value, beside = EVERY_LOG[option], WITH.get(option, ())
    said = [option] if value is None else [option, value]
    out = tmp_path / "a.parquet"
    for words in (said, []):
        CliRunner().invoke(cli, ["propagate", "a.csv", "-o", str(out), *beside, *words])
        run("a.csv", "-o", tmp_path, *beside, *words)
    alone, among, plain, plain_among = [
        replace(job, output=replace(job.output, to=None)) for job in jobs
    ]
    assert alone == among
    assert plain == plain_among
    assert alone != plain


def test_the_installed_command_runs_processes(tmp_path):
    """Two processes, started afresh by the command itself."""
    logs = [log(tmp_path / f"{name}.csv") for name in "abc"]
    command = [INSTALLED, "batch", *logs, "-o", tmp_path / "out", "-j", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "out").glob("*.parquet"))) == 3


def test_a_cluster_that_is_not_there(tmp_path):
    """The address is named."""
    pytest.importorskip("distributed")
    job = Job(str(log(tmp_path / "a.csv")), OutputSettings(str(tmp_path / "a.npy")))
    with pytest.raises(UsageError, match="no Dask scheduler answers at 'nonsense'"):
        list(on_a_cluster([job], "nonsense"))


def test_what_other_machines_raise_is_an_outcome(tmp_path, monkeypatch):
    """A worker without this package, or a scheduler that goes, is told for each log."""
    distributed = pytest.importorskip("distributed")

    class Client:
        def __init__(self, *_, **__):
            pass

        __enter__ = __exit__ = __init__

        def map(self, _work, jobs, **_):
            futures = [Future() for _ in jobs]
            futures[0].set_exception(ModuleNotFoundError("No module named 'quatprop'"))
            futures[1].set_exception(distributed.client.FutureCancelledError("b", "lost"))
            return futures

    monkeypatch.setattr(distributed, "Client", Client)
    monkeypatch.setattr(Client, "__enter__", lambda self: self)
    jobs = [Job(name, OutputSettings(str(tmp_path / name))) for name in ("a", "b")]
    errors = [outcome.error for outcome in on_a_cluster(jobs, "here")]
    assert errors[0] == (
        "a: the cluster did not do it (ModuleNotFoundError: No module named 'quatprop')"
    )
    assert errors[1].startswith("b: the cluster did not do it (FutureCancelledError: ")


CLUSTER = """
import subprocess, sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
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
    assert run(*logs, "--to", "csv", "-o", tmp_path / "near", "-q").exit_code == 0
    for path in logs:
        far, near = (tmp_path / where / path.name for where in ("far", "near"))
        assert far.read_bytes() == near.read_bytes()
