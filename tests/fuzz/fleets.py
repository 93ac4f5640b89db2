"""Batches that are killed, shards over a folder that grows, and two batches at once.

    PYTHONPATH=tests python -m fuzz.fleets [KILLS]

What the manifest calls done must be there, at its size and right; at the end nothing is missing.
"""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from collections import Counter, deque
from pathlib import Path

from make.batches import entries, spin
from make.commands import INSTALLED, run

from quatprop.batching.manifest import Manifest


def begun(folder, out, *options):
    """Start a batch in a process of its own."""
    command = [INSTALLED, "batch", folder, "-o", out, "--to", "csv", "-q", "--skip-existing"]
    return subprocess.Popen([*map(str, command), *options], stderr=subprocess.DEVNULL)


def problems(folder, out, right, *, complete):
    """Return what the manifest says that is not so."""
    known = entries(out)
    done = {name for name, entry in known.items() if entry["state"] == "done"}
    found = [f"{name}: called done" for name in done
             if not (out / name).exists() or (out / name).read_bytes() != right
             or (out / name).stat().st_size != known[name]["output_bytes"]]  # fmt: skip
    if complete:
        found += [f"{log.name}: lost" for log in folder.iterdir() if log.name not in done]
    return found


def times_done(out):
    """Return how often each output was recorded as done."""
    return Counter(Manifest(str(out)).history()["output"].to_pylist())


def killed(folder, out, count, *options):
    """Kill a batch again and again, and yield each time; then let it end."""
    draw = random.Random(1)
    for number in range(count):
        process = begun(folder, out, "-j", "2", *options)
        time.sleep(draw.uniform(0.5, 1.5))
        if process.poll() is not None:
            spin(folder / f"more{number}.csv")
        process.kill()
        process.wait()
        time.sleep(0.3)  # its processes end by themselves
        yield
    assert begun(folder, out, "-j", "2", *options).wait() == 0


def kills(top, right, count):
    """Kill a batch that writes a file for each log."""
    found, out = [], top / "killed"
    for _ in killed(top / "in", out, count):
        if (out / "_manifest").exists():
            found += problems(top / "in", out, right, complete=False)
    return found + problems(top / "in", out, right, complete=True)


def dataset(top, count):
    """Kill a batch that writes a dataset: its files are those of a batch that was not killed."""
    options = ("--to", "parquet", "--dataset", "--buckets", "4")
    deque(killed(top / "in", top / "parts", count, *options), maxlen=0)
    assert begun(top / "in", top / "whole", *options).wait() == 0
    made, right = (
        {path.name: path.read_bytes() for path in (top / name).glob("*.parquet")}
        for name in ("parts", "whole")
    )
    left = [f"{path}: left" for path in (top / "parts" / "_parts").rglob("*.parquet")]
    return left + [
        f"{name}: other bytes" for name in {*made, *right} if made.get(name) != right.get(name)
    ]


def shards(top, right):
    """Start eight shards one after another while the folder grows; then all of them once more."""
    folder, out = top / "growing", top / "shards"
    for number in range(40):
        spin(folder / f"{number}.csv")
    started = []
    for part in range(8):
        started.append(begun(folder, out, "-j", "1", "--shard", f"{part + 1}/8"))
        for number in range(5):
            spin(folder / f"later{part}-{number}.csv")
        time.sleep(0.2)
    codes = [process.wait() for process in started]
    twice = [f"{name}: done {n} times" for name, n in times_done(out).items() if n > 1]
    again = (begun(folder, out, "-j", "1", "--shard", f"{part + 1}/8") for part in range(8))
    codes += [process.wait() for process in again]
    return twice + problems(folder, out, right, complete=True) + [f"exit {c}" for c in codes if c]


def at_once(top, right):
    """Run two batches over the same logs at once."""
    out = top / "two"
    codes = [process.wait() for process in [begun(top / "in", out, "-j", "1") for _ in range(2)]]
    return problems(top / "in", out, right, complete=True) + [f"exit {c}" for c in codes if c]


def main(count=20):
    """Run all; print what is wrong."""
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        log = spin(top / "one.csv")
        run("propagate", log, "-o", top / "right.csv", "-q", code=0)
        for number in range(300):
            spin(top / "in" / f"{number}.csv")
        right, failures = (top / "right.csv").read_bytes(), 0
        for name, found in (
            (f"{count} kills", kills(top, right, count)),
            (f"{count} kills of a dataset", dataset(top, count)),
            ("8 shards of a growing folder", shards(top, right)),
            ("2 batches at once", at_once(top, right)),
        ):
            print(f"{name}: {len(found)} wrong", *found[:5], sep="\n  ")
            failures += len(found)
    return failures


if __name__ == "__main__":
    sys.exit(bool(main(*map(int, sys.argv[1:]))))
