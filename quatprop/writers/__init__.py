"""Attitude series to files: one file a format, one line of :data:`WRITERS` each."""
