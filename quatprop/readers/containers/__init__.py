"""Containers of encoded messages: the bytes and the log time of each message."""
