"""Threads and processes."""


def keep_freed_memory() -> None:
    """Let the C library keep up to 64 MB of freed memory, for quatprop's own processes.

    Returning the memory of chunks to the system, which clears its pages again, would take as long
    as decompressing them. glibc keeps twice the size of the largest block ever freed: this one.
    """
    bytes((1 << 25) - (1 << 13))
