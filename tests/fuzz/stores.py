"""Batches over a store that refuses, resets, hangs, delays and swaps; every output is held.

    cd tests && python -m fuzz.stores [LOGS]

``make fuzz`` runs it. For each kind of fault one batch with ``--retries 3`` over so many logs: how
many are done, that each of them is right, to the byte, and that what is not done is named.
"""

from __future__ import annotations

import contextlib
import logging
import os
import random
import sys
import tempfile
import threading
import time
from pathlib import Path

from make.batches import entries, spin
from make.commands import run
from make.store_server import RESET, StoreServer

BURST_S, HANG_S = 5.0, 40.0


class Faults:
    """Answers some requests for logs otherwise than they should be.

    `rate`: of all requests
    """

    def __init__(self, kind, rate, seed=1):
        """Draw by a seed."""
        self.kind, self.rate, self._random = kind, rate, random.Random(seed)
        self._began, self._lock, self.count = time.monotonic(), threading.Lock(), 0

    def __call__(self, _method, path):
        """Return the status of the answer, if it is not that of the store."""
        if ".csv" not in path:
            return None
        with self._lock:
            hit = self._random.random() < self.rate
            self.count += hit
        if self.kind == "burst":
            return "503 Slow Down" if time.monotonic() - self._began < BURST_S else None
        if hit and self.kind in {"hang", "delay"}:
            time.sleep(HANG_S if self.kind == "hang" else 0.3)
        statuses = {"refuse": "503 Slow Down", "reset": RESET}
        return statuses.get(self.kind) if hit else None


def swapping(bucket, logs, stop):
    """Write logs again with other rates until told to stop."""
    draw = random.Random(2)
    while not stop.is_set():
        with contextlib.suppress(Exception):
            spin(f"{bucket}/in/{draw.randrange(logs)}.csv", rate=draw.choice([1.0, 2.0]))
        stop.wait(0.01)


def batch_with(server, kind, rate, logs):
    """Run one batch; print what became of it; return whether all is as it should be."""
    bucket, right = server.bucket(f"faults{kind}{round(rate * 100)}"), {}
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        for number in range(logs):
            spin(f"{bucket}/in/{number}.csv")
        for turn in (1.0, 2.0):
            log = spin(top / "one.csv", rate=turn)
            run("propagate", log, "-o", top / f"{turn}.csv", "-q", code=0)
            right[turn] = (top / f"{turn}.csv").read_bytes()
        stop, out = threading.Event(), top / "out"
        if kind == "swap":
            thread = threading.Thread(target=swapping, args=(bucket, logs, stop))
            thread.start()
        began, server.before = time.monotonic(), Faults(kind, rate)
        arguments = ["batch", f"{bucket}/in", "-o", out, "--to", "csv", "-q", "--retries", "3"]
        result = run(*arguments, "-j", "2")
        took, faults = time.monotonic() - began, server.before.count
        server.before = lambda _method, _path: None
        stop.set()
        done = {name for name, entry in entries(out).items() if entry["state"] == "done"}
        wrong = [name for name in done if (out / name).read_bytes() not in right.values()]
        unsaid = [k for k in range(logs) if f"{k}.csv" not in done
                  and f"/{k}.csv:" not in result.stderr]  # fmt: skip
    print(
        f"{kind:>7} {rate:4.0%}: {len(done)} of {logs} done, {len(wrong)} wrong, {len(unsaid)} "
        f"neither done nor named, {faults} faults, {took:.0f} s, exit {result.exit_code}"
    )
    return not wrong and not unsaid


def main(logs=200):
    """Run a batch for each kind of fault."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)  # else a line for each request
    os.environ.pop("AWS_MAX_ATTEMPTS", None)
    server = StoreServer()
    os.environ.pop("AWS_MAX_ATTEMPTS")
    kinds = [("refuse", 0.01), ("refuse", 0.1), ("burst", 1), ("refuse", 0.3), ("swap", 0),
             ("delay", 0.1), ("reset", 0.1), ("hang", 0.01)]  # fmt: skip
    results = [batch_with(server, kind, rate, logs) for kind, rate in kinds]
    return all(results)


if __name__ == "__main__":
    sys.exit(not main(*map(int, sys.argv[1:])))
