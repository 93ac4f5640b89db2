"""Containers of encoded messages: where the bytes of each message are, and when it was recorded."""
