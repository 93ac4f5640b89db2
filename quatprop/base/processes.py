"""Map a function over items in processes.

``ProcessPoolExecutor`` is not used, since it fails all items when one process dies, and cannot tell
which item killed it.
"""

from __future__ import annotations

import _thread
import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import Counter
from multiprocessing import resource_tracker, spawn
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Generic, TypeVar

from quatprop.base.own_process import keep_freed_memory, raise_interruptions_of_destructors
from quatprop.base.threads import signals_blocked

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from types import FrameType

Item = TypeVar("Item")
Result = TypeVar("Result")

KILLED = (
    "the process that ran it was killed; is there enough memory? Run fewer at a time, or on a "
    "machine with more memory"
)
"""Error for an item whose process died."""

MAX_ON_WINDOWS = 61
"""Maximum number of processes on Windows, which can wait for 63 handles, two of them in use."""

GRACE_S = 10.0
"""Time for an interrupted process to clean up before it is killed, s."""

AGAIN_S = 1.0
"""Time after which it is interrupted again, s."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_CONTEXT = multiprocessing.get_context("spawn")
"""Processes are spawned, not forked, so that no locks are copied."""


def worker_count(wanted: int, items: int) -> int:
    """Return the number of processes for a number of items."""
    most = MAX_ON_WINDOWS if sys.platform == "win32" else wanted
    return min(wanted, items, most)


def map_processes(  # noqa: PLR0913  # keywords, each with a default
    work: Callable[[Item], Result],
    items: Sequence[Item],
    processes: int,
    on_killed: Callable[[Item], Result],
    *,
    record: Callable[[Result], None] = lambda _result: None,
    isolated: bool = False,
    retries: int = 0,
) -> Generator[tuple[int, Result]]:
    """Yield the index and the result of each item as soon as it is done.

    `on_killed`: returns the result of an item whose process died
    `record`: called with each result, even if the caller stops early
    `isolated`: use a child process even if there is only one
    `retries`: number of retries of an item whose process died
    """
    if len(items) <= 1 or (processes == 1 and not isolated):
        for index, item in enumerate(items):
            result = work(item)
            record(result)
            yield index, result
        return
    workers: list[_Worker[Item, Result]] = []
    try:
        for index in range(worker_count(processes, len(items))):
            workers.append(_Worker(work))
            workers[index].start(index, items[index])
        for index, result in _results(workers, items, on_killed, retries):
            record(result)
            yield index, result
    finally:
        for worker in workers:
            worker.interrupt()
        for worker in workers:
            with contextlib.suppress(EOFError, OSError, RuntimeError):
                record(worker.result())
            worker.end()


def _results(
    workers: list[_Worker[Item, Result]],
    items: Sequence[Item],
    on_killed: Callable[[Item], Result],
    retries: int,
) -> Iterator[tuple[int, Result]]:
    """Yield results, and give each idle worker the next item, or end it."""
    waiting, deaths = iter(range(len(workers), len(items))), Counter[int]()
    while workers:
        ready = wait([worker.connection for worker in workers])
        for worker in [worker for worker in workers if worker.connection in ready]:
            index = worker.index
            try:
                result = worker.result()
            except (EOFError, OSError):
                worker.restart()
                deaths[index] += 1
                if deaths[index] <= retries:
                    worker.start(index, items[index])
                    continue
                result = on_killed(items[index])
            # The worker continues before the result is used.
            if (following := next(waiting, None)) is None:
                workers.remove(worker)
                worker.end()
            else:
                worker.start(following, items[following])
            yield index, result


def in_order(results: Iterable[tuple[int, Result]]) -> Iterator[Result]:
    """Yield results in order of their indices."""
    early: dict[int, Result] = {}
    turn = 0
    for index, result in results:
        early[index] = result
        while turn in early:
            yield early.pop(turn)
            turn += 1


_PREPARING = threading.Lock()


@contextlib.contextmanager
def _script_for(work: Callable[..., object]) -> Iterator[None]:
    """Let processes that start in this block run the script of this one only if it has the work.

    Otherwise a script would begin again in each of them, unless all of it is below a condition.
    """
    if getattr(work, "__module__", None) == "__main__":
        yield
        return
    prepared = spawn.get_preparation_data

    def without_script(name: str) -> dict[str, object]:
        data = prepared(name)
        return {key: value for key, value in data.items() if not key.startswith("init_main")}

    with _PREPARING:
        spawn.get_preparation_data = without_script
        try:
            yield
        finally:
            spawn.get_preparation_data = prepared


class _Worker(Generic[Item, Result]):
    """A process that works on one item at a time.

    `connection`: readable when there is a result, or the process has died
    """

    def __init__(self, work: Callable[[Item], Result]) -> None:
        self._work = work
        self.index = -1
        self._running = True
        self._spawn()

    def _spawn(self) -> None:
        self.connection, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(theirs, self._work), daemon=True)
        if sys.platform != "win32":
            resource_tracker.ensure_running()  # its start unblocks signals
        with signals_blocked(_SIGNALS), _script_for(self._work):
            self._process.start()
        theirs.close()

    def restart(self) -> None:
        """Replace a process that has died."""
        self.end()
        self._spawn()

    def start(self, index: int, item: Item) -> None:
        """Send an item to the process; if it has died, :meth:`result` raises an error."""
        self.index = index
        with contextlib.suppress(OSError):
            self.connection.send(item)

    def result(self) -> Result:
        """Return the result of the item."""
        waited = 0.0
        while not self.connection.poll(None if self._running else AGAIN_S):
            waited += AGAIN_S
            if waited >= GRACE_S:
                raise EOFError
            # A signal just before a blocking system call does not interrupt it.
            self.interrupt()
        result, error = self.connection.recv()
        if error is not None:
            raise RuntimeError(error)
        return result  # type: ignore[no-any-return]

    def interrupt(self) -> None:
        """Ask the process to stop its work and clean up."""
        self._running = False
        if self._process.pid is not None and self._process.is_alive():
            if sys.platform == "win32":
                self._process.terminate()
            else:
                os.kill(self._process.pid, signal.SIGTERM)

    def end(self) -> None:
        """Close the connection, and wait for the end of the process."""
        self.connection.close()
        self._process.join(GRACE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _serve(connection: Connection, work: Callable[[Item], Result]) -> None:
    """Work on items until the other end of the connection is closed."""
    keep_freed_memory()
    interruption = _Interruption()
    threading.Thread(target=_watch_parent, daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt, EOFError, OSError):
        try:
            with signals_blocked(_SIGNALS, block=False):
                while True:
                    item = connection.recv()
                    interruption.busy = True
                    answer: tuple[Result | None, str | None]
                    try:
                        answer = work(item), None
                    except Exception:  # noqa: BLE001  # a bug, which the other process raises
                        answer = None, traceback.format_exc()
                    interruption.busy = False
                    connection.send(answer)
        finally:
            # A signal at the very end would raise outside of all this.
            interruption.stop()


class _Interruption:
    """Interrupts the work of this process once, so that cleanup is not interrupted.

    Ctrl-C reaches all processes of a terminal; an idle one ends with its connection.
    """

    def __init__(self) -> None:
        self.busy = self._interrupted = False
        raise_interruptions_of_destructors()
        for number in _SIGNALS:
            signal.signal(number, self._handle)

    def stop(self) -> None:
        """Ignore signals from now on."""
        self._interrupted = True

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if not self._interrupted and (self.busy or number == signal.SIGTERM):
            self._interrupted = True
            raise KeyboardInterrupt


def _watch_parent() -> None:
    """End this process when its parent has died."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        if sys.platform == "win32":
            _thread.interrupt_main(signal.SIGTERM)
        else:
            # A signal to the thread itself also interrupts a blocking call.
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
        time.sleep(GRACE_S)
        os._exit(1)
