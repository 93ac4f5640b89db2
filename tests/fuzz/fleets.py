"""Batches that are killed, over folders that grow and change, and on clusters that lose workers.

    cd tests && python -m fuzz.fleets [KILLS]

``make fuzz`` runs it. An output that a manifest calls done must exist with the size and SHA-256
that it records, made from the log of the size and time that it records. When a batch has ended,
nothing is missing, and nothing was done twice.
"""

import hashlib
import json
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

from make.batches import entries, spin
from make.commands import INSTALLED, run

from quatprop.tools.batch.manifest import Manifest
from quatprop.tools.batch.tasks import origin_of

RATES = range(5)
"""Of the logs, whose attitudes are known."""

LOGS = 300


def sha256(path):
    """Return the digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Fleet:
    """A folder of logs, and what is right for each that was ever in it.

    `right`: digest of a log -> digest of its attitudes
    """

    def __init__(self, folder, right, logs=LOGS):
        """Write the first logs."""
        self.folder, self.right = folder, right
        self._draw, self._written = random.Random(1), {}
        for number in range(logs):
            self.write(f"{number}.csv")

    def write(self, name):
        """Put a complete log in the place of any other."""
        log = spin(self.folder.parent / "new" / name, rate=self._draw.choice(RATES))
        self._written[name, origin_of(str(log))] = sha256(log)
        self.folder.mkdir(exist_ok=True)
        log.replace(self.folder / name)

    def write_over(self, name):
        """Write another log where there is one, as `cp` does: it is empty, then cut, then whole."""
        made = spin(self.folder.parent / "new" / name, rate=self._draw.choice(RATES))
        with (self.folder / name).open("wb") as stream:
            for line in made.read_bytes().splitlines(keepends=True):
                stream.write(line)
                stream.flush()
                time.sleep(0.001)
        self._written[name, origin_of(str(self.folder / name))] = sha256(made)

    def problems(self, out, *, is_complete=True):
        """Return what a manifest says that is not so, and what it does not say."""
        found, done = [], set()
        for name, entry in entries(out).items() if (out / "_manifest").exists() else ():
            if entry["state"] != "done":
                continue
            done.add(entry["log"])
            path = out / name
            made = (path.stat().st_size, sha256(path)) if path.exists() else None
            if made != (entry["output_bytes"], entry["output_sha256"]):
                found.append(f"{name}: its output is another one")
            if self._written.get((entry["log"], entry["origin"])) != entry["log_sha256"]:
                found.append(f"{name}: from another log than at the beginning")
            if self.right.get(entry["log_sha256"]) != entry["output_sha256"]:
                found.append(f"{name}: not the attitudes of its log")
        if is_complete:
            found += [f"{log.name}: lost" for log in self.folder.iterdir() if log.name not in done]
        left = [path for path in out.glob(".*") if path.is_file()]
        return found + [f"{path.name}: left" for path in left if is_complete]


def begun(fleet, out, *options):
    """Start a batch in a process of its own."""
    command = [INSTALLED, "batch", fleet.folder, "-o", out, "--to", "csv", "-q", "--skip-existing"]
    return subprocess.Popen([*map(str, [*command, *options])], stderr=subprocess.PIPE)


def ended(process, *, code=0):
    """Wait until a batch and its own processes have ended; return what it says if that is wrong."""
    said = process.communicate()[1].decode()
    return [] if process.returncode == code else [f"exit {process.returncode}: {said[:200]}"]


def done_twice(out):
    """Return the outputs that were recorded as done more than once."""
    counts = Counter(Manifest(str(out)).history()["output"].to_pylist())
    return [f"{name}: done {count} times" for name, count in counts.items() if count > 1]


def kills(top, right, count, processes):
    """Kill a batch at random moments while the folder grows, then let it end.

    Its outputs and its manifest are those of a batch that was not killed.
    """
    fleet, out, whole = Fleet(top / "in", right), top / "out", top / "whole"
    draw, found, killed = random.Random(2), [], 0
    while killed < count:
        process = begun(fleet, out, "-j", processes)
        # From its start-up to its last log, at about 5 ms a log.
        time.sleep(draw.uniform(0.2, 2.0))
        killed += process.poll() is None
        process.kill()
        process.communicate()  # to the end of its own processes, too
        for _ in range(20):
            fleet.write(f"more{killed}-{draw.randrange(1 << 30)}.csv")
        found += fleet.problems(out, is_complete=False)
    found += ended(begun(fleet, out, "-j", processes)) + ended(begun(fleet, whole, "-j", "2"))
    for told in (content, facts):
        found += [f"{name}: other {told.__name__}" for name, _ in told(out) ^ told(whole)]
    return found + fleet.problems(out) + done_twice(out)


def content(out):
    """Return the digest of each output."""
    return {(path.name, sha256(path)) for path in out.glob("*.csv")}


def facts(out):
    """Return what the manifest says of each output, without times and names of batches."""
    of_a_run = {"run", "time", "seconds"}
    return {
        (name, repr({key: value for key, value in entry.items() if key not in of_a_run}))
        for name, entry in entries(out).items()
    }


def kills_of_one(top, right, count):
    """Kill a batch with one process of its own."""
    return kills(top, right, count, "1")


def kills_of_two(top, right, count):
    """Kill a batch with two processes."""
    return kills(top, right, count, "2")


def shards(top, right, _count):
    """Start eight shards one after another while the folder grows; then all of them once more."""
    fleet, out = Fleet(top / "in", right, 100), top / "out"
    found = []
    for again in range(2):
        started = []
        for part in range(1, 9):
            started.append(begun(fleet, out, "-j", "1", "--shard", f"{part}/8"))
            for number in range(0 if again else 10):
                fleet.write(f"later{part}-{number}.csv")
            time.sleep(0.2)
        found += [problem for process in started for problem in ended(process)]
        found += fleet.problems(out, is_complete=bool(again))
    return found + done_twice(out)


def at_once(top, right, _count):
    """Run two batches over the same logs at once: each does them all, and both are right."""
    fleet, out = Fleet(top / "in", right), top / "out"
    both = [begun(fleet, out, "-j", "1") for _ in range(2)]
    return [problem for process in both for problem in ended(process)] + fleet.problems(out)


def changing(top, right, _count):
    """Replace logs, and write over them, while they are read; then once more when all is quiet."""
    fleet, out, stop = Fleet(top / "in", right), top / "out", threading.Event()

    def change():
        draw = random.Random(3)
        while not stop.wait(0.002):
            how = fleet.write if draw.random() < 0.5 else fleet.write_over
            how(f"{draw.randrange(LOGS)}.csv")

    thread = threading.Thread(target=change)
    thread.start()
    first = begun(fleet, out, "-j", "2")
    first.communicate()  # of some it may say that they are being written to
    stop.set()
    thread.join()
    found = fleet.problems(out, is_complete=False)
    return found + ended(begun(fleet, out, "-j", "2")) + fleet.problems(out)


def dask(program, file):
    """Start the scheduler of a Dask cluster, or a worker without anybody who would replace it."""
    command = [sys.executable, "-m", f"distributed.cli.dask_{program}", "--scheduler-file", file]
    options = {"scheduler": ["--port", "0"], "worker": ["--nthreads", "1", "--no-nanny"]}[program]
    return subprocess.Popen(
        [*map(str, command), "--no-dashboard", *options], stderr=subprocess.DEVNULL
    )


def lost_workers(top, right, count):
    """Kill workers of a Dask cluster at random moments; what fails by that is done afterwards."""
    fleet, out, draw = Fleet(top / "in", right, 4 * LOGS), top / "out", random.Random(4)
    scheduler = top / "scheduler.json"
    cluster, killed = dask("scheduler", scheduler), 0
    workers = [dask("worker", scheduler) for _ in range(2)]
    try:
        while not scheduler.exists():
            time.sleep(0.1)
        address = json.loads(scheduler.read_text())["address"]
        batch = begun(fleet, out, "--dask", address)
        while batch.poll() is None and killed < count:
            time.sleep(draw.uniform(1.0, 5.0))
            place = draw.randrange(2)
            workers[place].kill()
            workers[place].wait()
            workers[place], killed = dask("worker", scheduler), killed + 1
        batch.communicate()
        print(f"  {killed} workers killed, exit {batch.returncode}")
        found = fleet.problems(out, is_complete=False)
        told = {row["log"] for row in Manifest(str(out)).history().to_pylist()}
        found += [f"{log.name}: unsaid" for log in fleet.folder.iterdir() if log.name not in told]
        found += ended(begun(fleet, out, "--dask", address))
    finally:
        for process in [*workers, cluster]:
            process.kill()
            process.wait()
    return found + fleet.problems(out)


def main(count=20):
    """Run all; print what is wrong."""
    failures = 0
    every = kills_of_one, kills_of_two, shards, at_once, changing, lost_workers
    with tempfile.TemporaryDirectory() as folder:
        top, right = Path(folder), {}
        for rate in RATES:
            log, made = spin(top / "one.csv", rate=rate), top / "made.csv"
            run("propagate", log, "-o", made, "-q", code=0)
            right[sha256(log)] = sha256(made)
        for check in every:
            began = time.monotonic()
            (top / check.__name__).mkdir()
            found = check(top / check.__name__, right, count)
            took = time.monotonic() - began
            print(f"{check.__name__}: {len(found)} wrong, {took:.0f} s", *found[:5], sep="\n  ")
            failures += len(found)
    return failures


if __name__ == "__main__":
    sys.exit(bool(main(*map(int, sys.argv[1:]))))
