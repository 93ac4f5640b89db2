"""Batches here propagate their logs in this process; those of several are in slow/."""

import pytest


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Start no processes."""

    def map_here(work, tasks, *_arguments, **_options):
        for index, task in enumerate(tasks):
            yield index, work(task)

    monkeypatch.setattr("quatprop.tools.batch.execution.map_processes", map_here)
