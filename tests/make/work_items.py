"""Work for processes of their own, which import this module and no test framework."""

import os
import signal
import time
from pathlib import Path


def work(item):
    """Kill this process, or fail, where an item says so."""
    if item == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if isinstance(item, Path):  # killed at the first try only
        if not item.exists():
            item.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return "again"
    if item == "bug":
        raise ValueError(item)
    return (item, os.getpid())


class EndsItself:
    """Whose destructor the process is told to end in."""

    def __del__(self):
        """Send the signal."""
        os.kill(os.getpid(), signal.SIGTERM)


class FailsItself:
    """Whose destructor has a bug, of which Python prints a note."""

    def __del__(self):
        """Raise an error."""
        raise ValueError


def work_on_after_destructor(item):
    """Work for a minute where an item has a destructor that is interrupted."""
    if item == "failing":
        thing = FailsItself()
        del thing
        time.sleep(0.1)
    if item == "interrupted":
        thing = EndsItself()
        del thing
        for _ in range(6000):
            time.sleep(0.01)
    return item


def work_on_after_lost_signal(item):
    """Miss the first signal, then work for a minute and tidy up; fail once another has begun."""
    begun, tidied = item
    if tidied:
        missed = signal.signal(signal.SIGTERM, lambda *_: signal.signal(signal.SIGTERM, missed))
        begun.touch()
        try:
            for _ in range(6000):
                time.sleep(0.01)
        finally:
            tidied.touch()
    while not begun.exists():
        time.sleep(0.01)
    raise ValueError("bug")


def work_on_whatever_comes(item):
    """Take no notice of signals; fail once another does so."""
    begun, ignores = item
    if ignores:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        begun.touch()
        time.sleep(600)
    while not begun.exists():
        time.sleep(0.01)
    raise ValueError("bug")
