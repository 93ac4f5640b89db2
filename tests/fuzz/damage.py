"""Read damaged logs: ``make fuzz``, or ``python -m fuzz.damage [--first SEED] [--count N]``.

Each seed is one damaged log, which goes through ``info``, ``propagate`` and, in turn, one of
``convert``, ``compare`` and ``plot``, in a process of its own with bounded memory and time.
Whatever is not a sentence and an exit code of 0, 2 or 3 is told with its seed, and so are samples
that are neither read nor reported as lost; ``--keep FOLDER`` keeps the log.
"""

import argparse
import faulthandler
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from itertools import count
from pathlib import Path
from typing import NamedTuple

SECONDS = 10
"""Of processor time for a command: on a busy machine it may take longer."""
WAIT = 20 * SECONDS
"""Seconds for all commands of a log: a process that waits for something takes no time."""
MEMORY = 4 << 30
LOGS_A_PROCESS = 1000
"""After so many, another process: allocators keep the addresses that a claim once took."""

LENIENT = ("--on-nonfinite", "drop", "--on-backwards", "drop")
COMMANDS = (("info",), ("propagate",), ("propagate", *LENIENT))
TURNS = (("convert",), ("compare",), ("plot",))
"""Commands of which each log meets one."""


OUTPUTS = {"propagate": ".csv", "convert": ".csv", "plot": ".svg"}


class Hang(BaseException):
    """A command takes too long; no handler of errors catches it."""


class Found(NamedTuple):
    """The outcome of a damaged log: a problem or None, exit codes, time, peak memory."""

    problem: str | None
    codes: tuple[int, ...] = ()
    seconds: float = 0.0
    memory: int = 0


def _bounded():
    """Begin a process that reads damaged logs."""
    import resource  # not on Windows

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.environ["QUATPROP_TRACEBACK"] = "1"
    signal.signal(signal.SIGPROF, _interrupt)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", ResourceWarning)


def _found(intact, seed):
    """Return what comes of reading the damaged log of a seed."""
    import resource

    from fuzz.losses import unexplained_loss
    from make.damaged_logs import write_damaged

    # Says where it hangs, should the alarm not get through.
    faulthandler.dump_traceback_later(WAIT - SECONDS)
    with tempfile.TemporaryDirectory() as folder:
        log = write_damaged(seed, intact, Path(folder))
        began = time.perf_counter()
        found, codes = problem(log.path, Path(folder), seed)
        found = found or unexplained_loss(log, intact, codes)
        seconds = time.perf_counter() - began
    faulthandler.cancel_dump_traceback_later()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    return Found(found, codes, seconds, memory)


def _interrupt(_number, _frame):
    raise Hang


def problem(log, folder, seed):
    """Return what is wrong with how a log is read, None where nothing is, and the exit codes.

    `folder`: where results may go; `seed`: decides about one of the commands
    """
    from click.testing import CliRunner

    from quatprop.cli.commands import cli

    scratch = folder / "scratch"
    # Formats that can be streams are read from one as well.
    texts = (("propagate", "-"),) if set(log.suffixes) & {".csv", ".tsv"} else ()
    codes = []
    # Every format meets each: the names of the logs go round with the seeds.
    turn = TURNS[random.Random(seed).randrange(len(TURNS))]
    for arguments in (*COMMANDS, turn, *texts):
        scratch.mkdir()
        tempfile.tempdir = str(scratch)
        is_stream = "-" in arguments
        command = [*arguments] if is_stream else [*arguments, str(log)]
        out = f"out{OUTPUTS.get(arguments[0], '')}"
        if arguments[0] == "compare":
            command.append(str(log))
        elif arguments[0] == "convert":
            command.append(str(scratch / out))
        elif arguments[0] != "info":
            command += ["-o", str(scratch / out)]
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            stdin = log.read_bytes() if is_stream else None
            result = CliRunner().invoke(cli, command, input=stdin)
        except Hang:
            return f"{arguments[0]} hangs\n{traceback.format_exc()}", codes
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            tempfile.tempdir = None
        names = sorted(path.name for path in scratch.iterdir())
        wrong = _wrong(result, names, [out] if arguments[0] in OUTPUTS else [])
        if wrong:
            return f"{' '.join(arguments)}: {wrong}", codes
        codes.append(result.exit_code)
        shutil.rmtree(scratch)
    return None, codes


def _wrong(result, left, outputs):
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return "".join(traceback.format_exception(*result.exc_info))
    if result.exit_code not in {0, 2, 3}:  # compare has no criteria here that could fail
        return f"exit code {result.exit_code}"
    if any(not one.isprintable() for one in result.output.replace("\n", "")):
        return f"unprintable output {result.output!r}"
    wanted = outputs if result.exit_code != 2 else []
    return f"exit code {result.exit_code} leaves {left}" if left != wanted else None


def fuzz(seeds, workers, tell):
    """Read the damaged logs of some seeds; `tell` is called with each seed and what was found."""
    from make.damaged_logs import write_logs

    with tempfile.TemporaryDirectory() as folder:
        write_logs(Path(folder))
        spawn = multiprocessing.get_context("spawn")
        with spawn.Pool(workers, _bounded, maxtasksperchild=LOGS_A_PROCESS) as pool:
            asked = [(seed, pool.apply_async(_found, (Path(folder), seed))) for seed in seeds]
            for seed, result in asked:
                try:
                    found = result.get(WAIT)
                except multiprocessing.TimeoutError:
                    found = Found("the process dies or hangs")
                tell(seed, found)


def main():
    """Read damaged logs and tell what goes wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--count", type=int, default=10_000, help="how many (default: 10,000)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--keep", type=Path, help="folder to write the damaged logs to, unread")
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.count)
    if chosen.keep:
        from make.damaged_logs import write_damaged, write_logs

        with tempfile.TemporaryDirectory() as folder:
            write_logs(Path(folder))
            for seed in seeds:
                target = chosen.keep / str(seed)
                target.mkdir(parents=True)
                print(write_damaged(seed, Path(folder), target).path)
        return
    done, failed, codes, worst = count(1), [], Counter(), {"seconds": (0,), "memory": (0,)}

    def tell(seed, found):
        number = next(done)
        codes.update(found.codes)
        for name, so_far in worst.items():
            worst[name] = max(so_far, (getattr(found, name), seed))
        if found.problem:
            failed.append(seed)
            print(f"seed {seed}: {found.problem}", flush=True)
        if number % 1000 == 0:
            print(f"{number} logs, {len(failed)} problems", flush=True)

    fuzz(seeds, chosen.workers, tell)
    print(f"{len(seeds)} logs, {len(failed)} problems: seeds {failed}")
    print(f"exit codes {dict(sorted(codes.items()))}")
    print(f"worst log (all commands): {worst['seconds'][0]:.1f} s, seed {worst['seconds'][1:]}")
    print(f"most memory of a process: {worst['memory'][0] >> 20} MB, seed {worst['memory'][1:]}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
