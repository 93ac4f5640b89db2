"""Batches here propagate their logs in this process; those of several are in slow/."""

import pytest

from quatprop.base.processes import ThisProcess


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Start no processes."""
    monkeypatch.setattr(
        "quatprop.tools.batch.execution.own_executor", lambda *_counts, **_: (ThisProcess(), 1)
    )
