"""Runs that are interrupted, lose their listeners, or whose log changes under them."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pyarrow.csv
import pytest
from make.logs import write_logs

import quatprop
from quatprop.errors import LogError
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import RateSelection
from quatprop.simulate.gyroscope import Gyroscope
from quatprop.simulate.motion import Shape
from quatprop.simulate.simulate import simulate

QUATPROP = Path(sys.executable).with_name("quatprop")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and devices of POSIX")
ENDS = {
    signal.SIGINT: (130, "Interrupted.\n"),
    signal.SIGTERM: (143, ""),
    signal.SIGHUP: (129, ""),
}
SHELL = "/bin/sh"
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no device that is always full")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return a folder with intact logs, two of them long enough to be interrupted."""
    folder = tmp_path_factory.mktemp("logs")
    write_logs(folder)
    for name, kind in {"long.csv": "csv", "long.mcap": "mcap"}.items():
        gyroscope = Gyroscope(100, 1_500_000)
        simulate(folder / name, "coning", Shape(), gyroscope, kind=kind, truth=None)
    return folder


def run(*arguments, **options):
    """Run the installed command; return its exit code and what it says."""
    environment = {**os.environ, "QUATPROP_TRACEBACK": ""}
    result = subprocess.run(
        [QUATPROP, *map(str, arguments)],
        check=False, env=environment, text=True, timeout=60, **{"capture_output": True, **options},
    )  # fmt: skip
    return result.returncode, result.stderr


@pytest.fixture(autouse=True)
def signals_are_heard():
    """Undo what nohup, or a shell that runs tests in the background, has ignored."""
    hangup = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGHUP, hangup)
    signal.signal(signal.SIGINT, interrupt)


@pytest.mark.parametrize("name", ["long.csv", "long.mcap"])
@pytest.mark.parametrize("number", ENDS)
def test_an_interrupted_run_leaves_the_old_result_and_nothing_else(logs, tmp_path, name, number):
    """Ctrl-C and a request to end are obeyed at once, with the exit codes that shells expect."""
    out = tmp_path / "out.csv"
    out.write_text("old")
    for wait in (0.02, 0.2):
        process = subprocess.Popen(
            [QUATPROP, "propagate", logs / name, "-o", out, "-q"],
            stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(tmp_path)},
        )  # fmt: skip
        began = time.monotonic()
        while len(list(tmp_path.iterdir())) == 1 and time.monotonic() < began + 20:
            time.sleep(0.005)
        time.sleep(wait)
        process.send_signal(number)
        _, shown = process.communicate(timeout=20)
        assert (process.returncode, shown) == ENDS[number]
        assert out.read_text() == "old"
        assert list(tmp_path.iterdir()) == [out]


def test_an_interruption_at_the_start_is_no_traceback(logs, tmp_path):
    """Ctrl-C is handled before anything large is imported."""
    code = "from quatprop.cli import main; print(flush=True); main()"
    run_it = ["propagate", logs / "long.mcap", "-o", tmp_path / "out.csv"]
    for wait in (0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3):
        process = subprocess.Popen(
            [sys.executable, "-c", code, *run_it],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        process.stdout.readline()
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        _, shown = process.communicate(timeout=20)
        assert process.returncode in ({130} if wait else {130, -signal.SIGINT})
        if process.returncode == 130:
            assert shown == "Interrupted.\n"
        assert list(tmp_path.iterdir()) == []


def test_an_interruption_inside_a_destructor_is_not_lost():
    """Python drops what a destructor raises; the run ends all the same."""
    code = (
        "import os, signal, sys, time\n"
        "from quatprop.cli.interruption import handle_signals, interruptible\n"
        "handle_signals()\n"
        "class Closing:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGINT); time.sleep(0.01)\n"
        "with interruptible():\n"
        "    try:\n"
        "        Closing()\n"
        "        time.sleep(10)\n"
        "    except KeyboardInterrupt:\n"
        "        print('interrupted')\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=20
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "interrupted\n", "")


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


def test_a_closed_stdout_is_a_sentence(logs, tmp_path):
    """What would go there is refused; a file of its own is written as always."""
    out = tmp_path / "out.csv"
    for target, expected in (("-", 2), (out, 0)):
        command = f"'{QUATPROP}' propagate '{logs / 'small.csv'}' -o '{target}' -q >&-"
        result = subprocess.run([SHELL, "-c", command], check=False, capture_output=True, text=True)
        assert result.returncode == expected
        assert result.stderr == (
            "Error: -: standard output is closed; name a file\n" if expected else ""
        )
    assert out.read_text().count("\n") == 201


def test_a_reader_that_has_gone_is_no_error(logs):
    """`| head` takes what it wants, and the run ends without a word."""
    process = subprocess.Popen(
        [QUATPROP, "propagate", logs / "long.csv", "-o", "-", "-q"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == b"t_ns,qw,qx,qy,qz\n"
    process.stdout.close()
    assert (process.wait(20), process.stderr.read()) == (0, b"")
    process.stderr.close()


@needs_full
@pytest.mark.parametrize("command", ["info", "propagate"])
def test_a_full_disk_behind_stdout_is_a_sentence(logs, command):
    """What cannot be written is told, with exit code 2."""
    output = ("-o", "-") if command == "propagate" else ()
    with FULL.open("w") as full:
        code, said = run(
            command, logs / "small.csv", *output,
            capture_output=False, stdout=full, stderr=subprocess.PIPE,
        )  # fmt: skip
    assert code == 2
    assert "No space left on device" in said
    assert said.count("Error: ") == 1
    assert "Traceback" not in said


@needs_full
def test_words_that_cannot_be_said_do_not_pass_for_a_failed_comparison(logs, tmp_path):
    """Exit code 1 means that series differ; a full disk behind stderr is none of that."""
    with FULL.open("w") as full:
        code, _ = run(
            "propagate", logs / "small.csv", "-o", tmp_path / "out.csv",
            capture_output=False, stdout=full, stderr=full,
        )  # fmt: skip
    assert code == 2


def test_without_stderr_a_run_does_its_work(logs, tmp_path):
    """Daemons close what they do not need."""
    out = tmp_path / "out.csv"
    command = f"'{QUATPROP}' propagate '{logs / 'small.csv'}' -o '{out}' 2>&-"
    assert subprocess.run([SHELL, "-c", command], check=False).returncode == 0
    assert out.read_text().count("\n") == 201


@pytest.mark.parametrize("suffix", ["csv", "parquet", "feather", "mcap", "bag", "npy", "npz"])
def test_a_disk_that_fills_up_leaves_the_old_result(logs, tmp_path, suffix):
    """A result that has no room is told in a sentence, and leaves nothing of itself."""
    out = tmp_path / f"out.{suffix}"
    out.write_text("old")
    command = f"ulimit -f 400; exec '{QUATPROP}' propagate '{logs / 'long.mcap'}' -o '{out}' -q"
    result = subprocess.run([SHELL, "-c", command], check=False, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == f"Error: {out}: cannot be written: File too large\n"
    assert out.read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


CHANGING = ["small.csv", "mcap-zstd.mcap", "mcap-none.mcap", "mcap-unchunked.mcap",
            "bag-none.bag", "bag-lz4.bag", "small.db3", "plain.parquet", "uncompressed.feather",
            "gyro.ulg", "rows.jsonl", "records.npy", "stored.npz"]  # fmt: skip


SHRINKING = """
import os, sys
from quatprop.errors import LogError
from quatprop.logs.open_log import open_log
from quatprop.settings.selection import RateSelection
from quatprop.logs.signals.rates import choose_rates
for path in sys.argv[1:]:
    count, lost = 0, True
    try:
        with open_log(path) as log:
            batches = choose_rates(log, RateSelection()).batches()
            # These logs are so small that all of them is held since the rates were chosen.
            for table in log.tables():
                if hasattr(table, "release"):
                    table.release()
            os.truncate(path, os.path.getsize(path) // 2)
            count = sum(len(batch) for batch in batches)
            lost = bool(log.losses)
    except LogError:
        pass
    print(count, lost, flush=True)
"""


def samples_of(log, meanwhile=None):
    """Return how many samples are read of a log that changes after it was opened, or 0."""
    with suppress(LogError), open_log(log) as opened:
        batches = choose_rates(opened, RateSelection()).batches()
        if meanwhile:
            meanwhile()
        return sum(len(batch) for batch in batches)
    return 0


def test_logs_that_become_shorter_while_they_are_read_end_early(logs, tmp_path):
    """Nothing dies of it, and what is missing is told."""
    copies = [shutil.copyfile(logs / name, tmp_path / name) for name in CHANGING]
    # In a process of its own: a file that is mapped and becomes shorter would end it.
    result = subprocess.run(
        [sys.executable, "-c", SHRINKING, *copies], check=False, capture_output=True, text=True
    )
    assert (result.returncode, result.stderr) == (0, ""), result.stdout
    for name, line in zip(CHANGING, result.stdout.splitlines(), strict=True):
        count, lost = line.split()
        assert (lost == "True") == (int(count) < samples_of(logs / name)), name
        assert lost == "True" or name == "small.db3", name


@pytest.mark.parametrize("name", CHANGING)
def test_a_log_that_grows_while_it_is_read_gives_what_was_there(logs, tmp_path, name):
    """A recorder that goes on writing does no harm."""
    log = shutil.copyfile(logs / name, tmp_path / name)

    def grow():
        with log.open("ab") as file:
            file.write((logs / name).read_bytes()[-1000:])

    count = samples_of(log, grow)
    assert count >= samples_of(logs / name) - 1 or name.endswith((".npz", ".parquet", ".feather"))
