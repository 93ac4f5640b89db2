"""Batches on the workers of a Dask cluster: what they may be without."""

import itertools
import sys
import time
from types import SimpleNamespace

import pytest
from make.batches import entries, spin
from make.commands import refused

from quatprop import __version__
from quatprop.base.errors import QuatpropError, UsageError
from quatprop.propagation.job import Job
from quatprop.propagation.settings import OutputSettings
from quatprop.tools.batch.execution import on_a_cluster, propagate_log, propagate_on_worker
from quatprop.tools.batch.log_search import BatchTask
from quatprop.tools.batch.manifest import Manifest
from quatprop.tools.batch.planning import BatchSettings


def settings_in(folder):
    """Return the settings of a batch with outputs in a folder."""
    return BatchSettings.of(Job("LOG", OutputSettings("OUT", to="npy")), str(folder))


SETTINGS = settings_in("OUT")

QUIET = {"processes": False, "dashboard_address": ":0"}


def tasks_of(folder, *names):
    """Return the tasks of new logs."""
    for name in names:
        spin(folder / f"{name}.csv")
    return [BatchTask(str(folder), f"{name}.csv", ".npy") for name in names]


def prepared(folder):
    """Return the manifest of a folder."""
    manifest = Manifest(str(folder))
    manifest.prepare()
    return manifest


def without_the_package(task, settings, _version):
    """Raise what a worker without this package does."""
    if task.name == "a.npy":
        raise ModuleNotFoundError("No module named 'quatprop'")
    return propagate_log(task, settings)


def without_the_folder(task, settings, _version):
    """Write to a folder that the client does not see."""
    if task.name == "a.npy":
        settings = settings._replace(folder=f"{settings.folder}/elsewhere")
    return propagate_log(task, settings)


def killed(task, settings, _version):
    """End as a log does whose workers were killed, one after the other."""
    if task.name == "a.npy":
        from distributed.scheduler import KilledWorker

        raise KilledWorker("a", SimpleNamespace(address="tcp://a:1"), 3)
    return propagate_log(task, settings)


def broken(task, settings, _version):
    """Raise what nobody expects."""
    if task.name == "a.npy":
        raise RuntimeError("disk\x1b[31m")
    return propagate_log(task, settings)


def timed_out(task, settings, _version):
    """Raise what a result raises that does not arrive."""
    if task.name == "a.npy":
        raise TimeoutError
    return propagate_log(task, settings)


@pytest.mark.parametrize(
    ("worker", "reason"),
    [
        (killed, "the workers that ran it were killed; do they have enough memory?"),
        (broken, r"the cluster failed (RuntimeError: disk\x1b[31m)"),
        (timed_out, "the cluster failed (TimeoutError: )"),
        (without_the_package, "its worker cannot import quatprop (No module named 'quatprop'); "),
        (without_the_folder, "its worker has written an output that is not visible here; give "),
    ],
)
def test_what_other_machines_cannot_do_is_an_outcome(tmp_path, monkeypatch, worker, reason):
    """A worker that does not share the folder was believed; one without the package ended all.

    One that was done before the client had looked at yesterday's output was not.
    """
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("quatprop.tools.batch.execution.propagate_on_worker", worker)
    for name, value in (("PATIENCE_S", 0.02), ("LOOK_S", 0.01)):
        monkeypatch.setattr(f"quatprop.tools.batch.execution.{name}", value)
    submit = distributed.Client.submit

    def submit_and_wait(*arguments, **options):
        future = submit(*arguments, **options)
        future.exception(timeout=60)
        return future

    monkeypatch.setattr(distributed.Client, "submit", submit_and_wait)
    tasks, manifest, settings = (
        tasks_of(tmp_path, "a", "b"),
        prepared(tmp_path),
        settings_in(tmp_path),
    )
    # Yesterday's output, of the same size.
    propagate_log(tasks[0], settings)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **QUIET) as cluster:
        results = dict(on_a_cluster(tasks, settings, cluster.scheduler_address, manifest))
    assert f"a.csv: {reason}" in str(results[0].entry.error)
    states = {name: entry["state"] for name, entry in entries(tmp_path).items()}
    assert states == {"a.npy": "failed", "b.npy": "done"}
    assert not (tmp_path / "a.npy").exists()


def test_a_cluster_without_workers_or_scheduler(tmp_path, monkeypatch):
    """One sentence in seconds for a cluster that does nothing, and for one that goes."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("quatprop.tools.batch.execution.WORKERS_S", 0.2)
    tasks, manifest = tasks_of(tmp_path, "a"), prepared(tmp_path)
    with distributed.LocalCluster(n_workers=0, **QUIET) as cluster:
        results = on_a_cluster(tasks, settings_in(tmp_path), cluster.scheduler_address, manifest)
        with pytest.raises(UsageError, match=r"has no workers; start some, and try again$"):
            list(results)
    cancelled = distributed.client.FutureCancelledError("a", "lost")
    monkeypatch.setattr(
        distributed.Future, "result", lambda *_, **__: (_ for _ in ()).throw(cancelled)
    )
    with distributed.LocalCluster(n_workers=1, **QUIET) as cluster:
        results = on_a_cluster(tasks, settings_in(tmp_path), cluster.scheduler_address, manifest)
        with pytest.raises(QuatpropError, match="no longer answers; finished logs are recorded"):
            list(results)


def test_a_cluster_that_loses_its_workers_is_not_waited_for_for_ever(tmp_path, monkeypatch):
    """It was, without a word; what was done is recorded."""
    distributed = pytest.importorskip("distributed")
    for name, value in (("AHEAD", 1), ("IDLE_S", 0.1), ("AGAIN_S", 0.2)):
        monkeypatch.setattr(f"quatprop.tools.batch.execution.{name}", value)
    tasks, manifest = tasks_of(tmp_path, "a", "b", "c"), prepared(tmp_path)
    with distributed.LocalCluster(n_workers=1, **QUIET) as cluster:
        results = on_a_cluster(tasks, settings_in(tmp_path), cluster.scheduler_address, manifest)
        next(results)
        cluster.scale(0)
        with pytest.raises(QuatpropError, match="has lost its workers; finished logs are recorded"):
            list(results)
    assert entries(tmp_path)["a.npy"]["state"] == "done"


def test_a_result_that_does_not_arrive_is_waited_for_again(tmp_path, monkeypatch):
    """One that was lost with the last worker was waited for for ever."""
    distributed = pytest.importorskip("distributed")
    result, lost = distributed.Future.result, []

    def lost_at_first(future, timeout):
        lost.append(timeout)
        if len(lost) == 1:
            raise TimeoutError
        return result(future, timeout)

    monkeypatch.setattr(distributed.Future, "result", lost_at_first)
    tasks, manifest = tasks_of(tmp_path, "a"), prepared(tmp_path)
    with distributed.LocalCluster(n_workers=1, **QUIET) as cluster:
        address = cluster.scheduler_address
        ((_, found),) = on_a_cluster(tasks, settings_in(tmp_path), address, manifest)
    assert (found.entry.state, lost) == ("done", [60.0, 60.0])


ASKED = []


def slow(task, settings, _version):
    """Take as long as it takes to be asked for three times."""
    while len(ASKED) < 4:
        time.sleep(0.001)
    return propagate_log(task, settings)


def test_a_log_that_takes_long_is_waited_for(tmp_path, monkeypatch):
    """A cluster is asked now and then whether it has workers, not all the time."""
    distributed = pytest.importorskip("distributed")
    wait = distributed.Client.wait_for_workers

    def noted(*arguments, **options):
        ASKED.append(time.monotonic())
        return wait(*arguments, **options)

    ASKED.clear()
    monkeypatch.setattr("quatprop.tools.batch.execution.propagate_on_worker", slow)
    monkeypatch.setattr("quatprop.tools.batch.execution.IDLE_S", 0.03)
    monkeypatch.setattr(distributed.Client, "wait_for_workers", noted)
    tasks, manifest = tasks_of(tmp_path, "a"), prepared(tmp_path)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **QUIET) as cluster:
        list(on_a_cluster(tasks, settings_in(tmp_path), cluster.scheduler_address, manifest))
    assert entries(tmp_path)["a.npy"]["state"] == "done"
    assert min(after - before for before, after in itertools.pairwise(ASKED)) > 0.03


def test_without_distributed_the_way_to_it_is_told(tmp_path, monkeypatch):
    """Nothing is written."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = refused(
        "batch", spin(tmp_path / "a.csv"), "-o", tmp_path / "out", "--dask", "tcp://a:1"
    )
    assert words.endswith("needs distributed, which is not installed; pip install distributed")


def test_a_worker_of_another_version_is_refused():
    """Its outputs would be those of another version."""
    there = BatchTask("", "a.csv", ".csv")
    assert propagate_on_worker(there, SETTINGS, "0.0.1").entry.error == (
        f"a.csv: its worker has quatprop {__version__}, not 0.0.1; install the same version"
    )
