"""Map a function over items on any executor, such as processes of our own.

``ProcessPoolExecutor`` is not used for them, since it fails all items when one process dies, and
cannot tell which item killed it.
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
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker, spawn
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

from quatprop.base.own_process import keep_freed_memory, raise_interruptions_of_destructors
from quatprop.base.threads import signals_blocked

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from types import FrameType

Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

KILLED = (
    "the process that ran it was killed; is there enough memory? Run fewer at a time, or on a "
    "machine with more memory"
)
"""Error for an item whose process died."""

GRACE_S = 10.0
"""Time for an interrupted process to clean up before it is killed, s."""

AGAIN_S = 1.0
"""Time after which it is interrupted again, s."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_CONTEXT = multiprocessing.get_context("spawn")
"""Processes are spawned, not forked, so that no locks are copied."""


class KilledError(Exception):
    """The process that ran a call was killed."""


class ThisProcess(Executor):
    """Runs each call at once, in this process."""

    def submit(
        self,
        fn: Callable[Arguments, Result],
        /,
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> Future[Result]:
        """Return the future of a call that has ended; its errors are raised here."""
        future = Future[Result]()
        future.set_result(fn(*args, **kwargs))
        return future


class Processes(Executor):
    """Processes of our own; one that dies fails only the call that it ran.

    Each has a thread of this process, which starts it when there is work, and waits for it.
    """

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count)
        self._own = threading.local()
        self._workers: list[_Worker] = []
        self._changing, self._ended = threading.Lock(), False

    def submit(
        self,
        fn: Callable[Arguments, Result],
        /,
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> Future[Result]:
        """Run a call in the next idle process; if that dies, the future has a KilledError."""
        with signals_blocked(_SIGNALS):  # a new thread inherits this: they reach the main thread
            return self._threads.submit(self._run, fn, partial(fn, *args, **kwargs))

    def _run(self, work: Callable[..., object], call: Callable[[], Result]) -> Result:
        with self._changing:
            if self._ended:
                raise KilledError
            worker = getattr(self._own, "worker", None)
            if worker is None:
                self._own.worker = worker = _Worker(work)
                self._workers.append(worker)
        try:
            return cast("Result", worker.result_of(call))
        except (EOFError, OSError) as error:
            with self._changing:
                del self._own.worker
                self._workers.remove(worker)
            worker.end()
            raise KilledError from error

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:  # noqa: ARG002
        """Interrupt what still runs, and wait until all processes have ended."""
        self._threads.shutdown(wait=False, cancel_futures=cancel_futures)
        with self._changing:
            self._ended, workers = True, [*self._workers]
            for worker in workers:
                worker.interrupt()
        self._threads.shutdown()
        for worker in workers:
            worker.end()


def own_executor(processes: int, items: int, *, isolated: bool = False) -> tuple[Executor, int]:
    """Return an executor for a number of items, and how many to submit ahead.

    `isolated`: use a child process even if there is only one
    """
    if items <= 1 or (processes == 1 and not isolated):
        return ThisProcess(), 1
    count = min(processes, items)
    return Processes(count), 2 * count  # a process continues before its result is used


def map_on(  # noqa: PLR0913  # keywords, each with a default
    executor: Executor,
    submit: Callable[[Item], Future[Any]],
    items: Sequence[Item],
    settle: Callable[[list[tuple[int, Future[Any]]]], list[tuple[int, Result]]],
    *,
    ahead: int,
    retries: int = 0,
) -> Generator[tuple[int, Result]]:
    """Yield the index and the result of each item as soon as it has ended.

    `submit`: submits an item to the executor
    `settle`: returns the results for indices and futures; called with all that have ended, even if
        the caller stops early
    `ahead`: number of items submitted at a time
    `retries`: number of retries of an item whose future has an error
    """
    rest, failures = iter(range(len(items))), Counter[int]()
    waiting: dict[Future[Any], int] = {}
    again: list[int] = []
    done: SimpleQueue[Future[Any]] = SimpleQueue()

    def start(index: int) -> None:
        future = submit(items[index])
        waiting[future] = index
        future.add_done_callback(done.put)

    def ended() -> Iterator[tuple[int, Future[Any]]]:
        for future in [done.get(), *(done.get() for _ in range(done.qsize()))]:
            index = waiting.pop(future)
            error = None if future.cancelled() else future.exception()
            if error is not None and not isinstance(error, BrokenExecutor):
                failures[index] += 1
                if failures[index] <= retries:
                    again.append(index)
                    continue
            yield index, future

    try:
        while True:
            for index in islice(rest, ahead - len(waiting)):
                start(index)
            if not waiting:
                return
            # Futures are let go at once: a cluster computes those again that it loses.
            yield from settle([*ended()])
            # Only then, since an executor may refuse them.
            while again:
                start(again.pop())
    finally:
        for future in waiting:
            future.cancel()
        if isinstance(executor, Processes):
            executor.shutdown()
        late = [(index, future) for future, index in waiting.items() if _has_result(future)]
        if late:
            settle(late)


def _has_result(future: Future[Any]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


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
    """Yield the index and the result of each item as soon as it is done in a process.

    `on_killed`: returns the result of an item whose process died
    `record`: called with each result, even if the caller stops early
    `isolated`: use a child process even if there is only one
    `retries`: number of retries of an item whose process died
    """
    executor, ahead = own_executor(processes, len(items), isolated=isolated)

    def settle(ended: list[tuple[int, Future[Any]]]) -> list[tuple[int, Result]]:
        results = list[tuple[int, Result]]()
        for index, future in ended:
            is_killed = isinstance(future.exception(), KilledError)
            results.append((index, on_killed(items[index]) if is_killed else future.result()))
            record(results[-1][1])
        return results

    def submit(item: Item) -> Future[Result]:
        return executor.submit(work, item)

    return map_on(executor, submit, items, settle, ahead=ahead, retries=retries)


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


class _Worker:
    """A process that works on one call at a time."""

    def __init__(self, work: Callable[..., object]) -> None:
        self._running = True
        self._connection, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(theirs,), daemon=True)
        if sys.platform != "win32":
            resource_tracker.ensure_running()  # its start unblocks signals
        with signals_blocked(_SIGNALS), _script_for(work):
            self._process.start()
        theirs.close()

    def result_of(self, call: Callable[[], object]) -> object:
        """Return the result of a call; raises EOFError or OSError if the process has died."""
        self._connection.send(call)
        waited = 0.0
        while not self._connection.poll(AGAIN_S):
            if not self._running:
                waited += AGAIN_S
                if waited >= GRACE_S:
                    raise EOFError
                # A signal just before a blocking system call does not interrupt it.
                self.interrupt()
        result, error = self._connection.recv()
        if error is not None:
            raise RuntimeError(error)
        return result

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
        self._connection.close()
        self._process.join(GRACE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _serve(connection: Connection) -> None:
    """Run calls until the other end of the connection is closed."""
    keep_freed_memory()
    interruption = _Interruption()
    threading.Thread(target=_watch_parent, daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt, EOFError, OSError):
        try:
            with signals_blocked(_SIGNALS, block=False):
                while True:
                    call = connection.recv()
                    interruption.busy = True
                    answer: tuple[object, str | None]
                    try:
                        answer = call(), None
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
        if sys.platform == "win32" or not hasattr(signal, "pthread_kill"):
            _thread.interrupt_main(signal.SIGTERM)
        else:
            # A signal to the thread itself also interrupts a blocking call.
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
        time.sleep(GRACE_S)
        os._exit(1)
