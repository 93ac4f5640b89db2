"""Batches in several processes, that are killed, and on clusters."""

import os
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
from make.batches import batch, entries, outputs_in, said, spin
from make.commands import INSTALLED, installed, refused, run
from make.places import SAMPLE_LOGS
from make.systems import SIGKILL, on_posix

from quatprop.stores.objects import list_objects
from quatprop.stores.remote import upload
from quatprop.tools.batch.manifest import Manifest


def logs_in(folder, count):
    """Write logs that turn at different rates; return their folder."""
    for number in range(count):
        spin(folder / f"{number}.csv", rate=number)
    return folder


def test_each_log_gives_what_propagate_gives(tmp_path):
    """The files are the same to the byte."""
    logs, out = logs_in(tmp_path / "in", 3), tmp_path / "out"
    options = ("--to", "csv", "--method", "mean")
    done = run("batch", logs, "-o", out, "-j", 2, *options, code=0)
    for log in logs.iterdir():
        alone = tmp_path / "alone.csv"
        run("propagate", log, "-o", alone, *options, code=0)
        assert (out / f"{log.name}.csv").read_bytes() == alone.read_bytes()
    assert said(done) == "3 of 3 logs done, 15 samples"
    assert done.stdout == ""


def shards(folder, out, *options):
    """Run the two halves of a batch at once, as the machines of an array job do."""
    command = [INSTALLED, "batch", folder, "-o", out, "-q", "-j", "1", *options, "--shard"]
    parts = [subprocess.Popen([*command, part]) for part in ("1/2", "2/2")]
    assert [part.wait(60) for part in parts] == [0, 0]


def test_several_batches_write_to_one_store(bucket, tmp_path):
    """Each does its part, every log once; all of them are in one manifest."""
    out = f"{bucket}/out"
    shards(logs_in(tmp_path / "in", 6), out)
    names = [f"{number}.csv.parquet" for number in range(6)]
    assert Manifest(out).history()["output"].to_pylist() == names
    assert set(names) <= set(list_objects(out))


@pytest.mark.parametrize("name", ["coning.mcap", "rest.parquet"])
def test_a_dropped_connection_is_one_sentence(bucket, tmp_path, store_server, name):
    """It is neither damage of the log nor a bug, and there is no output."""
    upload(SAMPLE_LOGS / name, f"{bucket}/{name}")
    store_server.drop_after = store_server.sent
    try:
        words = refused("batch", f"{bucket}/{name}", "-o", tmp_path / "out", "-q")
    finally:
        store_server.drop_after = None
    assert words.startswith(f"Error: {bucket}/{name}: its store does not answer (")
    assert words.endswith("; check the network and the address of the store")
    assert not list((tmp_path / "out").glob("[!_]*"))


HOOK = """
import multiprocessing, os, sys
def kill(event, arguments):
    if event == "open" and str(arguments[0]).endswith("crash.csv"):
        if multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), 9)
sys.addaudithook(kill)
"""
HELD = """
import os, signal, sys, time
# A shell lets what it starts in the background ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)
parent = os.getppid()
def hold(event, arguments):
    while event == "os.rename" and os.path.basename(arguments[1])[0].isdigit():
        if len(os.listdir(os.path.dirname(arguments[1]))) < 9 or os.getppid() != parent:
            break
        time.sleep(0.05)
sys.addaudithook(hold)
"""
"""Lets a batch go no further than some outputs: it does not end before it is to be ended."""


def hooked(folder, code):
    """Return an environment whose processes run some code when they start."""
    (folder / "sitecustomize.py").write_text(code)
    return {"PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}


@on_posix
@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_log_that_kills_its_process_fails_alone(tmp_path, processes):
    """All others are done, and the batch says which was killed, at once and at the end."""
    logs, out = logs_in(tmp_path / "in", 5), tmp_path / "out"
    crash = spin(logs / "crash.csv")
    done = installed("batch", logs, "-o", out, "-j", processes, env=hooked(tmp_path, HOOK))
    assert done.returncode == 2, done.stderr
    reason = f"{crash}: the process that ran it was killed; is there enough"
    assert f"\nError: {reason}" in done.stderr
    count, which, last = done.stderr.splitlines()[-3:]
    assert (count, last) == ("1 failed:", "5 of 6 logs done, 25 samples")
    assert which.startswith(f"  {reason}")
    states = [entry["state"] for entry in entries(out).values()]
    assert sorted(states) == ["done"] * 5 + ["failed"]


@on_posix
@pytest.mark.parametrize("number", [SIGKILL, signal.SIGTERM])
def test_a_batch_that_was_ended_goes_on_where_it_was(tmp_path, number):
    """Nothing that was done is done again, nothing half-written stays, and no process either.

    At a SIGTERM, which schedulers send, it ended without a word.
    """
    logs, out = logs_in(tmp_path / "in", 12), tmp_path / "out"
    command = [INSTALLED, "batch", logs, "-o", out, "-j", "2", "-q"]
    environment = {**os.environ, **hooked(tmp_path, HELD)}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, env=environment)
    end = time.monotonic() + 240
    while not out.exists() or len(entries(out)) < 3:
        assert time.monotonic() < end
        time.sleep(0.01)
    process.send_signal(number)
    # To the end of stderr, which the processes of a killed batch hold as well: they remove what is
    # half-written.
    _, shown = process.communicate(timeout=120)
    assert shown.endswith(b"Ended by SIGTERM.\n") == (number == signal.SIGTERM)
    assert not any(out.glob(".*"))
    before = len(entries(out))
    # An output that was complete just before it was recorded is made again.
    assert before <= len(outputs_in(out)) <= before + 2
    assert before < 12
    done = run("batch", logs, "-o", out, "-j", "1", "--skip-existing", code=0)
    assert said(done).startswith(f"{12 - before} of {12 - before} logs done")
    assert sorted(path.suffix for path in out.iterdir()) == ["", *[".parquet"] * 12]
    again = tmp_path / "again"
    batch(logs, "-o", again, "-q", code=0)
    for name in outputs_in(out):
        assert (out / name).read_bytes() == (again / name).read_bytes()


CLUSTER = """
import subprocess, sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", processes=False,
        protocol="tcp",
    ) as cluster:
        command = [*sys.argv[1:], "--dask", cluster.scheduler_address]
        sys.exit(subprocess.run(command).returncode)
"""


def test_a_cluster_gives_the_same_files(tmp_path):
    """The workers of a Dask cluster write what this machine writes, to the byte."""
    pytest.importorskip("distributed")
    logs, far, near = logs_in(tmp_path / "in", 3), tmp_path / "far", tmp_path / "near"
    bad = tmp_path / "bad.csv"
    bad.write_text("")
    (tmp_path / "cluster.py").write_text(CLUSTER)
    batch_there = [INSTALLED, "batch", logs, bad, "--to", "csv", "-o", far]
    done = subprocess.run(
        [sys.executable, tmp_path / "cluster.py", *batch_there],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "3 of 4 logs done, 15 samples" in done.stderr
    batch(logs, "--to", "csv", "-o", near, "-q", code=0)
    for log in logs.iterdir():
        assert (far / f"{log.name}.csv").read_bytes() == (near / f"{log.name}.csv").read_bytes()


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    """Each process ran it again and failed, and memory was blamed."""
    spin(tmp_path / "a.csv")
    spin(tmp_path / "b.csv")
    script = tmp_path / "script.py"
    call = "quatprop.batch('*.csv', output='out', processes=2)"
    script.write_text(f"import quatprop\nprint('begun')\n{call}\n")
    done = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("begun\n", "")
    assert sum(len(pd.read_parquet(path)) for path in (tmp_path / "out").glob("*.parquet")) == 10


def test_a_cluster_that_is_not_there():
    """The address is named."""
    pytest.importorskip("distributed")
    words = "UsageError: no Dask scheduler answers at 'nonsense'"
    code = (
        "from quatprop.tools.batch.execution import dask_executor as d; d('nonsense').__enter__()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert words in done.stderr
    assert "Exception ignored" not in done.stderr
