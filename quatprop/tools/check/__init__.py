"""Regression of recorded logs: a suite of cases, each compared with a reference.

A case is a log, the settings with which it is propagated, and what the attitudes are compared with:
a reference that an update has stored, or an independent series, such as motion capture. A lock
file next to the suite pins what a case depends on (:mod:`.lock`), so that no log,
option or reference changes unnoticed.
"""
