"""Work in processes: what dies, dies alone."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from make.systems import SIGKILL, on_posix
from make.work_items import (
    work,
    work_on_after_destructor,
    work_on_after_lost_signal,
    work_on_whatever_comes,
)

from quatprop.base.processes import in_order, map_processes


def killed(item):
    """Return the result of an item whose process was killed."""
    return f"{item}: no result"


@on_posix
@pytest.mark.parametrize("processes", [1, 3])
def test_a_process_that_dies_takes_no_other_item_with_it(processes):
    """Every other item has its result, the last ones from fresh processes."""
    items = [0, "killed", 2, "killed", 4]
    found = dict(map_processes(work, items, processes, killed, isolated=True))
    assert sorted(found) == list(range(5))
    assert [found[1], found[3]] == ["killed: no result"] * 2
    done = [found[index] for index in (0, 2, 4)]
    assert [item for item, _ in done] == [0, 2, 4]
    assert os.getpid() not in {process for _, process in done}


@on_posix
def test_an_interruption_inside_a_destructor_ends_the_process():
    """Python drops it there: the process went on until it was killed, and left its files."""
    items = ["interrupted", "failing"]
    found = dict(map_processes(work_on_after_destructor, items, 2, killed))
    assert found == {0: "interrupted: no result", 1: "failing"}


@on_posix
def test_processes_start_with_interruptions_blocked(tmp_path):
    """In the first they were not: one that came while a thread started made it hang at its end."""
    script = tmp_path / "script.py"
    script.write_text(
        "import signal\n"
        "from quatprop.base.processes import map_processes\n"
        "blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
        "def work(_item):\n"
        "    return sorted(number.name for number in blocked)\n"
        "if __name__ == '__main__':\n"
        "    print(sorted(map_processes(work, 'ab', 2, print)))\n"
    )
    done = subprocess.run([sys.executable, script], check=False, capture_output=True, text=True)
    assert done.stdout == "[(0, ['SIGINT', 'SIGTERM']), (1, ['SIGINT', 'SIGTERM'])]\n"
    assert done.stderr == ""


@on_posix
def test_an_interruption_that_was_missed_comes_again(tmp_path):
    """One that came just before a system call did not end it, and the process was killed."""
    items = [(tmp_path / "begun", tmp_path / "tidied"), (tmp_path / "begun", None)]
    with pytest.raises(RuntimeError, match="ValueError: bug"):
        list(map_processes(work_on_after_lost_signal, items, 2, killed))
    assert (tmp_path / "tidied").exists()


@on_posix
def test_a_process_that_does_not_end_is_killed(tmp_path, monkeypatch):
    """It has some time to clean up, and the batch ends all the same."""
    for name in ("GRACE_S", "AGAIN_S"):
        monkeypatch.setattr(f"quatprop.base.processes.{name}", 0.1)
    items = [(tmp_path / "begun", True), (tmp_path / "begun", False)]
    with pytest.raises(RuntimeError, match="ValueError: bug"):
        list(map_processes(work_on_whatever_comes, items, 2, killed))
    assert multiprocessing.active_children() == []


@on_posix
@pytest.mark.parametrize("retries", [{}, {"retries": 1}])
def test_an_item_can_be_tried_again(tmp_path, retries):
    """A process that was killed once may have met another one's hunger for memory."""
    items = [tmp_path / "once", 1]
    found = dict(map_processes(work, items, 2, killed, **retries))[0]
    assert found == ("again" if retries else f"{tmp_path / 'once'}: no result")


def test_one_process_is_this_one():
    """Nothing is started for one process, or one item."""
    assert dict(map_processes(work, [1, 2], 1, killed))[0] == (1, os.getpid())
    assert dict(map_processes(work, [1], 4, killed, isolated=True))[0] == (1, os.getpid())


def test_a_bug_in_a_process_is_shown():
    """Its traceback comes over."""
    with pytest.raises(RuntimeError, match=r"in work\n.*\nValueError: bug"):
        list(map_processes(work, ["bug", 1], 2, killed))


def test_results_can_be_put_in_order():
    """Each comes as soon as those before are there."""
    seen = []

    def results():
        for index in (1, 0, 3, 2):
            seen.append(index)
            yield index, "abcd"[index]

    ordered = in_order(results())
    assert (next(ordered), seen) == ("a", [1, 0])
    assert (next(ordered), seen) == ("b", [1, 0])
    assert list(ordered) == ["c", "d"]


WAITS = """
import os, signal, sys, time
from pathlib import Path
from quatprop.base.processes import map_processes
def work(folder):
    path = Path(folder, f"{os.getpid()}")
    try:
        path.touch()
        time.sleep(600)
    finally:
        path.rename(path.with_suffix(".tidy"))
if __name__ == "__main__":
    # A shell lets what it starts in the background ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    list(map_processes(work, [sys.argv[1]] * 4, 2, print))
"""


@on_posix
@pytest.mark.parametrize("number", [SIGKILL, signal.SIGINT])
def test_no_process_outlives_its_parent(tmp_path, number):
    """However the parent ends, the others remove what is half-written, and end."""
    (tmp_path / "waits.py").write_text(WAITS)
    folder = tmp_path / "out"
    folder.mkdir()
    process = subprocess.Popen(
        [sys.executable, tmp_path / "waits.py", folder], stderr=subprocess.DEVNULL
    )
    until(lambda: len(list(folder.iterdir())) == 2)
    process.send_signal(number)
    process.wait(120)
    until(lambda: {path.suffix for path in folder.iterdir()} == {".tidy"})
    until(lambda: not any(alive(int(path.stem)) for path in folder.iterdir()))
    assert len(list(folder.iterdir())) == 2


def until(condition):
    """Wait for a condition."""
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def alive(pid):
    """Tell whether there is a process, which is no zombie."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
