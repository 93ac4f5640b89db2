"""The library: read, propagate, convert, compare and write attitude from Python.

Thin wrappers around the code that the command line uses, with the same settings by the same names.
Values may be text, as on the command line, or Python objects.
"""
