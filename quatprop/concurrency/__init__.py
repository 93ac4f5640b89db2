"""Work side by side: in threads of this process, and in processes of this machine."""


def keep_freed_memory() -> None:
    """Let the C library keep freed memory, up to 64 MB: for processes of this package's own.

    To give chunks of logs back to the system, and to have their pages cleared again, would cost as
    much as decompressing them. glibc keeps twice the largest block that was ever freed; this one is
    never touched.
    """
    bytes((1 << 25) - (1 << 13))
