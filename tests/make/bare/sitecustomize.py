"""Takes away, from every process that has this folder in PYTHONPATH, what only POSIX has.

What Python's own modules use to start and to end processes stays: `_posixsubprocess`, SIGKILL.
"""

import os
import signal
import sys

MODULES = ("fcntl", "resource")
CALLS = (
    "fork", "forkpty", "geteuid", "mkfifo", "mknod", "pread", "preadv", "O_NOFOLLOW",
    "O_NONBLOCK", "sched_getaffinity", "sched_setaffinity",
)  # fmt: skip
SIGNALS = (
    "SIGALRM", "SIGHUP", "SIGUSR1", "SIGPIPE", "ITIMER_REAL", "setitimer", "alarm", "pthread_kill",
    "pthread_sigmask", "sigwait", "SIG_BLOCK", "SIG_UNBLOCK", "SIG_SETMASK",
)  # fmt: skip

for name in MODULES:
    sys.modules[name] = None
for module, names in ((os, CALLS), (signal, SIGNALS)):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
