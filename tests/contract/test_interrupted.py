"""Runs that are interrupted, or lose their listeners."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pyarrow.csv
import pytest
from make.commands import INSTALLED, installed
from make.systems import SIGHUP, on_posix

import quatprop
from quatprop.tools.simulation import Gyroscope, Shape, simulate

pytestmark = on_posix
ENDS = {
    signal.SIGINT: (130, "Interrupted.\n"),
    signal.SIGTERM: (143, "Ended by SIGTERM.\n"),
    SIGHUP: (129, "Ended by SIGHUP.\n"),
}
SHELL = "/bin/sh"
FULL = Path("/dev/full")
TIMEOUT_S = 120
"""However busy the machine is, s."""
NEVER_DONE = """
import sys, time
def wait(event, _):
    while event == "os.rename":
        time.sleep(0.01)  # one sleep does not end by a signal that comes just before it
sys.addaudithook(wait)
from quatprop.cli import interruption, main
handle_signals = interruption.handle_signals
interruption.handle_signals = lambda: (handle_signals(), print(flush=True))
main()
"""
"""Runs the command line, but for its last step, so that a signal does not come too late."""
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no device that is always full")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return a folder with a small log, and two of more samples than a pipe holds."""
    folder = tmp_path_factory.mktemp("interrupted")
    for name, count in {"small.csv": 200, "long.csv": 200_000, "long.mcap": 200_000}.items():
        simulate(folder / name, "coning", Shape(), Gyroscope(100, count), truth=None)
    return folder


@pytest.fixture(autouse=True)
def signals_are_heard():
    """Undo what nohup, or a shell that runs tests in the background, has ignored."""
    hangup = signal.signal(SIGHUP, signal.SIG_DFL)
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(SIGHUP, hangup)
    signal.signal(signal.SIGINT, interrupt)


def in_shell(command):
    """Run a line of the shell."""
    return subprocess.run([SHELL, "-c", command], check=False, capture_output=True, text=True)


def never_done(log, out, **environment):
    """Start a run that does not end by itself; it prints a line once it handles signals."""
    return subprocess.Popen(  # -B: what it compiled would be renamed too
        [sys.executable, "-B", "-c", NEVER_DONE, "propagate", log, "-o", out, "-q"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "number", "wait"),
    [
        ("long.csv", signal.SIGINT, 0.02),
        ("long.csv", signal.SIGTERM, 0.1),
        ("long.mcap", SIGHUP, 0.1),
    ],
)
def test_an_interrupted_run_leaves_the_old_result_and_nothing_else(
    logs, tmp_path, name, number, wait
):
    """Ctrl-C and a request to end are obeyed at once, with the exit codes that shells expect."""
    out = tmp_path / "out.csv"
    out.write_text("old")
    process = never_done(logs / name, out, TMPDIR=str(tmp_path))
    began = time.monotonic()
    while len(list(tmp_path.iterdir())) == 1 and time.monotonic() < began + TIMEOUT_S:
        time.sleep(0.005)
    time.sleep(wait)
    process.send_signal(number)
    _, shown = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, shown) == ENDS[number]
    assert out.read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


def test_an_interruption_at_the_start_is_no_traceback(logs, tmp_path):
    """Ctrl-C is handled before anything large is imported."""
    for wait in (0, 0.1):
        process = never_done(logs / "long.mcap", tmp_path / "out.csv")
        process.stdout.readline()
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        _, shown = process.communicate(timeout=TIMEOUT_S)
        assert (process.returncode, shown) == ENDS[signal.SIGINT]
        assert list(tmp_path.iterdir()) == []


def test_an_interruption_inside_a_destructor_is_not_lost():
    """Python drops what a destructor raises; the run ends all the same."""
    code = (
        "import os, signal, sys, time\n"
        "from quatprop.cli.interruption import handle_signals, interruptible\n"
        "handle_signals()\n"
        "before = signal.getsignal(signal.SIGINT)\n"
        "class Closing:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGINT); time.sleep(0.01)\n"
        "with interruptible():\n"
        "    try:\n"
        "        Closing()\n"
        "        time.sleep(600)\n"
        "    except KeyboardInterrupt:\n"
        "        print('interrupted')\n"
        "print(signal.getsignal(signal.SIGINT) == before)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        check=False, capture_output=True, text=True, timeout=TIMEOUT_S,
    )  # fmt: skip
    assert (result.returncode, result.stdout, result.stderr) == (0, "interrupted\nTrue\n", "")


@pytest.mark.parametrize("again", ["pass", "print(len(quatprop.read_rates(sys.argv[1])))"])
def test_an_interruption_while_the_csv_parser_gets_its_thread_ends_the_process(logs, again):
    """The thread was unknown to its pool, and the process waited for it for ever.

    Unless another table was read; this must be possible, as in a notebook.
    """
    code = (
        "import sys, threading, quatprop\n"
        "start = threading.Thread.start\n"
        "def interrupted(thread):\n"
        "    start(thread)\n"
        "    raise KeyboardInterrupt\n"
        "threading.Thread.start = interrupted\n"
        "try:\n"
        "    quatprop.read_rates(sys.argv[1])\n"
        "except KeyboardInterrupt:\n"
        "    threading.Thread.start = start\n"
        f"    {again}\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, logs / "small.csv"],
        check=False, capture_output=True, text=True, timeout=TIMEOUT_S,
    )  # fmt: skip
    said = "" if again == "pass" else "200\n"
    assert (result.returncode, result.stdout, result.stderr) == (0, said, "")


def test_the_csv_parser_leaves_signals_alone(logs, monkeypatch):
    """It takes over those of the main thread while it parses, and is called in another."""
    threads = []
    read_csv = pyarrow.csv.read_csv

    def noted(*arguments, **options):
        threads.append(threading.current_thread())
        return read_csv(*arguments, **options)

    monkeypatch.setattr(pyarrow.csv, "read_csv", noted)
    assert len(quatprop.read_rates(logs / "small.csv")) == 200
    assert threads
    assert threading.main_thread() not in threads


@pytest.mark.parametrize(
    ("closed", "is_piped", "said"),
    [
        ("-q >&-", True, "Error: -: standard output is closed; name a file\n"),
        ("-q >&-", False, ""),
        ("2>&-", False, ""),
    ],
)
def test_daemons_close_what_they_do_not_need(logs, tmp_path, closed, is_piped, said):
    """An output for it is refused; a file of its own is written as always."""
    out = tmp_path / "out.csv"
    target = "-" if is_piped else out
    result = in_shell(f"'{INSTALLED}' propagate '{logs / 'small.csv'}' -o '{target}' {closed}")
    assert (result.returncode, result.stderr) == (2 if said else 0, said)
    assert is_piped or out.read_text().count("\n") == 201


def test_a_reader_that_has_gone_is_no_error(logs):
    """`| head` takes what it wants, and the run ends without a word."""
    process = subprocess.Popen(
        [INSTALLED, "propagate", logs / "long.csv", "-o", "-", "-q"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == b"t_ns,qw,qx,qy,qz\n"
    process.stdout.close()
    assert (process.wait(TIMEOUT_S), process.stderr.read()) == (0, b"")
    process.stderr.close()


@needs_full
@pytest.mark.parametrize(
    "arguments",
    [("info", "small.csv"), ("propagate", "small.csv", "-o", "-"), ("--help",), ("--version",)],
)
def test_a_full_disk_behind_stdout_is_a_sentence(logs, monkeypatch, arguments):
    """Output that cannot be written is an error, exit code 2; for --help there was no message."""
    monkeypatch.chdir(logs)
    options = {"capture_output": False, "stderr": subprocess.PIPE}
    with FULL.open("w") as full:
        done = installed(*arguments, stdout=full, **options)
    assert done.returncode == 2
    assert "No space left on device" in done.stderr
    assert done.stderr.count("Error: ") == 1
    assert "Traceback" not in done.stderr


@needs_full
def test_words_that_cannot_be_said_do_not_pass_for_a_failed_comparison(logs, tmp_path):
    """Exit code 1 means that series differ; a full disk behind stderr is none of that."""
    options = {"capture_output": False}
    with FULL.open("w") as full:
        arguments = ("propagate", logs / "small.csv", "-o", tmp_path / "out.csv")
        assert installed(*arguments, stdout=full, stderr=full, **options).returncode == 2


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mcap", "npz"])
def test_a_disk_that_fills_up_leaves_the_old_result(logs, tmp_path, suffix):
    """A result that has no room is told in a sentence, and leaves nothing of itself."""
    out = tmp_path / f"out.{suffix}"
    out.write_text("old")
    command = f"ulimit -f 400; exec '{INSTALLED}' propagate '{logs / 'long.mcap'}' -o '{out}' -q"
    result = in_shell(command)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == f"Error: {out}: cannot be written: File too large\n"
    assert out.read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]
