"""Batches on executors that are given: threads, processes, and the workers of a Dask cluster."""

import sys
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pyarrow as pa
import pytest
from make.batches import entries, outputs_in, spin
from make.commands import refused, run

import quatprop
from quatprop import __version__
from quatprop.base.errors import QuatpropError, UsageError
from quatprop.tools.batch import worker
from quatprop.tools.batch.execution import dask_executor
from quatprop.tools.batch.tasks import BatchTask

LOCAL = {"processes": False, "dashboard_address": ":0"}


class Odd(Executor):
    """Whose calls run at once, unless what a test says happens instead."""

    def __init__(self, instead):
        """Take a function of the name of a log; it returns whether to run it."""
        self._instead = instead

    def submit(self, fn, /, *args, **_):
        """Return the future of a call that has ended."""
        future = Future()
        try:
            name = next(name for name in "abc" if f"{name}.csv".encode() in args[0])
            if self._instead(name, future):
                future.set_result(fn(*args))
        except Exception as error:  # noqa: BLE001  # as executors do
            future.set_exception(error)
        return future


@pytest.fixture
def logs(tmp_path):
    """Write three logs; return their folder."""
    for name in "abc":
        spin(tmp_path / "in" / f"{name}.csv", rate=ord(name))
    return tmp_path / "in"


def failing(error):
    """Return what lets one log raise an error."""

    def instead(name, _future):
        if name == "b":
            raise error
        return True

    return Odd(instead)


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_gives_the_same_files(logs, tmp_path, kind):
    """To the byte, with the same manifest but for its times."""
    with kind(2) as executor:
        made = quatprop.batch(logs, tmp_path / "there", executor=executor)
        assert executor.submit(abs, -1).result() == 1  # it is left open
        again = quatprop.batch(logs, tmp_path / "there", executor=executor, skip_existing=True)
    alone = quatprop.batch(logs, tmp_path / "here", processes=1)
    assert again == []
    own = {"time": "", "run": "", "seconds": 0}
    assert [one._replace(**own) for one in made] == [one._replace(**own) for one in alone]
    assert len(outputs_in(tmp_path / "here")) == 3
    for name in outputs_in(tmp_path / "here"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (RuntimeError("disk\x1b[31m"), r"its worker failed (RuntimeError: disk\x1b[31m)"),
        (ImportError("no quatprop"), "its worker cannot import quatprop (no quatprop); install it"),
    ],
)
def test_a_worker_without_the_package_fails_one_log(logs, tmp_path, error, reason):
    """One such worker ended the whole batch."""
    made = quatprop.batch(logs, tmp_path / "out", executor=failing(error))
    assert [entry.state for entry in made] == ["done", "failed", "done"]
    assert f"b.csv: {reason}" in made[1].error
    assert entries(tmp_path / "out")["b.csv.parquet"]["error"] == made[1].error


def test_an_output_that_is_not_visible_here_is_not_done(logs, tmp_path, monkeypatch):
    """A worker without the shared folder was believed if yesterday's output was there."""
    for name, value in (("PATIENCE_S", 0.02), ("LOOK_S", 0.01)):
        monkeypatch.setattr(f"quatprop.tools.batch.execution.{name}", value)
    quatprop.batch(logs, tmp_path / "out", processes=1)
    propagated = worker.propagate_log

    def elsewhere(task, settings):
        folder = tmp_path / "elsewhere" if task.log == "b.csv" else settings.folder
        return propagated(task, settings._replace(folder=str(folder)))

    monkeypatch.setattr(worker, "propagate_log", elsewhere)
    made = quatprop.batch(logs, tmp_path / "out", executor=Odd(lambda *_: True))
    assert [entry.state for entry in made] == ["done", "failed", "done"]
    words = "its worker has written an output that is not visible here; give workers the same"
    assert words in made[1].error
    assert outputs_in(tmp_path / "out") == ["a.csv.parquet", "c.csv.parquet"]


@pytest.mark.parametrize("way", ["cancelled", "broken", "shut down"])
def test_completed_logs_stay_if_an_executor_ends(logs, tmp_path, way):
    """The error is one sentence; another executor does the rest."""

    def instead(name, future):
        if name == "c" and way == "cancelled":
            future.cancel()
            future.set_running_or_notify_cancel()
            return False
        if name == "c":
            raise BrokenProcessPool("a process died")
        return True

    executor = Odd(instead)
    if way == "shut down":
        executor = ThreadPoolExecutor(1)
        executor.shutdown()
    words = r"the executor has ended \(.*\); finished logs are recorded: continue with skip_exist"
    with pytest.raises(QuatpropError, match=words):
        quatprop.batch(logs, tmp_path / "out", executor=executor, retries=1)
    with ThreadPoolExecutor(1) as other:
        made = quatprop.batch(logs, tmp_path / "out", executor=other, skip_existing=True)
    assert len(made) == (3 if way == "shut down" else 1)
    assert {entry["state"] for entry in entries(tmp_path / "out").values()} == {"done"}


def test_completed_logs_stay_if_an_executor_refuses_a_retry(logs, tmp_path):
    """Results that had come in with the failure were not recorded."""
    submitted = []

    class Once(ThreadPoolExecutor):
        def submit(self, fn, /, *args, **_):
            if len(submitted) == 3:
                raise RuntimeError("cannot schedule new futures after shutdown")
            submitted.append(args)
            future = Future()
            try:
                future.set_result(fn(*args) if b"b.csv" not in args[0] else 1 / 0)
            except ZeroDivisionError as error:
                future.set_exception(error)
            return future

    with pytest.raises(QuatpropError, match="finished logs are recorded"), Once(1) as executor:
        quatprop.batch(logs, tmp_path / "out", executor=executor, retries=1)
    assert [entry["state"] for entry in entries(tmp_path / "out").values()] == ["done"] * 2


def test_a_log_is_submitted_again_as_often_as_is_asked(logs, tmp_path):
    """A worker may be killed by another one's hunger for memory."""
    left = [2]

    def instead(name, _future):
        if name == "b" and left[0]:
            left[0] -= 1
            raise MemoryError
        return True

    made = quatprop.batch(logs, tmp_path / "1", executor=Odd(instead), retries=1)
    assert [entry.state for entry in made] == ["done", "failed", "done"]
    left[0] = 2
    made = quatprop.batch(logs, tmp_path / "2", executor=Odd(instead), retries=2)
    assert [entry.state for entry in made] == ["done"] * 3


def test_an_executor_has_its_own_workers(logs, tmp_path):
    """A number of processes next to it is refused."""
    with pytest.raises(UsageError, match="executor has its own workers; omit processes"):
        quatprop.batch(logs, tmp_path / "out", executor=Odd(None), processes=2)


@pytest.mark.parametrize(
    ("name", "here"),
    [("quatprop", __version__), ("numpy", np.__version__), ("pyarrow", pa.__version__)],
)
def test_a_worker_of_another_version_is_refused(name, here):
    """Its outputs would not have the same bytes."""
    packed = worker.pickle.dumps((None, {**worker.versions(), name: "0.0.1"}))
    assert worker.propagate_there(BatchTask("", "a.csv", ".csv"), packed).entry.error == (
        f"a.csv: its worker has {name} {here}, not 0.0.1; install the same version"
    )


def test_without_distributed_the_error_says_how_to_install_it(logs, tmp_path, monkeypatch):
    """Nothing is written."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = refused("batch", logs, "-o", tmp_path / "out", "--dask", "tcp://a:1")
    assert words.endswith("needs distributed, which is not installed; pip install distributed")
    assert not (tmp_path / "out").exists()


def test_a_cluster_without_workers_is_refused(monkeypatch):
    """One sentence in seconds for a cluster that does nothing."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("quatprop.tools.batch.execution.WORKERS_S", 0.2)
    words = r"has no workers; start some, and try again$"
    with (
        distributed.LocalCluster(n_workers=0, **LOCAL) as cluster,
        pytest.raises(UsageError, match=words),
        dask_executor(cluster.scheduler_address),
    ):
        pass


def test_a_cluster_that_loses_its_workers_goes_on_with_new_ones(logs, tmp_path):
    """Their unfinished logs are done by other workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **LOCAL) as cluster:
        run("batch", logs, "-o", tmp_path / "out", "--dask", cluster.scheduler_address, code=0)
        cluster.scale(0)
        cluster.scale(1)
        options = ("--dask", cluster.scheduler_address, "--method", "mean")
        run("batch", logs, "-o", tmp_path / "out", *options, code=0)
    assert {entry["method"] for entry in entries(tmp_path / "out").values()} == {"mean"}
