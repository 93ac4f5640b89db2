"""Containers and tables: one file a format, one line of :data:`READERS` each."""
