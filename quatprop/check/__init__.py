"""Regression of recorded logs: a suite of cases, each held against a reference.

A case is a log, the options it is propagated with, and what it is compared with: a reference that
an update has stored, or a series from elsewhere, such as motion capture. What a case rests on is
pinned in a lock file beside the suite (:mod:`quatprop.check.lock`), so that nothing changes
unnoticed: not a log, not an option, not a reference.
"""
