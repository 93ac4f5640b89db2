"""Damaged logs of every format give sentences, not tracebacks; `make fuzz` reads many more."""

import os

from fuzz.damage import fuzz

LOGS = 240


def test_damaged_logs_are_read_or_refused_within_bounds():
    """No damage leads to a traceback, a hang, boundless memory, leavings or an odd exit code."""
    problems = {}
    fuzz(range(LOGS), min(2, os.cpu_count() or 1), problems.__setitem__)
    assert sorted(problems) == list(range(LOGS))
    assert {seed: found.problem for seed, found in problems.items() if found.problem} == {}
