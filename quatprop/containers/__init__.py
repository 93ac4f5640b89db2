"""Containers of encoded messages: the bytes of each message, and when it was recorded."""
