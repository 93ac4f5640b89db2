"""Seeded regressions: which of them a suite catches, and whether its reports contradict each other.

``python -m fuzz.regressions`` (in ``tests/``) spoils each of five logs in sixty ways, each judged
by three kinds of case: the log pinned; made anew and compared with a stored reference; made anew
and compared with the truth, by the limits that ``--init`` proposes. Twenty harmless changes follow.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter, defaultdict
from functools import partial
from pathlib import Path

import numpy as np
from make.commands import run
from make.tables import write_rates
from make.verdicts import contradictions
from scipy.spatial.transform import Rotation

LOGS = {
    "spin": ("--motion", "spin"),
    "tumbling": ("--motion", "tumbling"),
    "coning": ("--motion", "coning"),
    "noisy": ("--motion", "tumbling", "--noise", "1e-4", "--seed", "4"),
    "slow": ("--motion", "tumbling", "--rate", "25", "--duration", "20s"),
}
"""Log -> how it is simulated."""

KINDS = ("pinned", "stored", "truth")


def turned(angle, t, w):
    """Mount the sensor otherwise."""
    return t, Rotation.from_rotvec([0, angle, 0], degrees=True).apply(w)


def cut(first, count, t, w):
    """Lose rows."""
    rows = np.r_[: int(first * len(t)), int(first * len(t)) + count : len(t)]
    return t[rows], w[rows]


def held(count, t, w):
    """Repeat a sample in place of those after it."""
    w = w.copy()
    w[len(w) // 3 : len(w) // 3 + count] = w[len(w) // 3]
    return t, w


def smoothed(count, t, w):
    """Filter the rates."""
    kernel = np.ones(count) / count
    return t, np.column_stack([np.convolve(axis, kernel, "full")[: len(t)] for axis in w.T])


def spiked(size, t, w):
    """Spoil one sample."""
    w = w.copy()
    w[len(w) // 2] += size
    return t, w


def axes(order, signs, t, w):
    """Exchange or reverse axes."""
    return t, w[:, order] * signs


def jittered(ns, t, w):
    """Let stamps be uncertain."""
    return t + np.random.default_rng(1).integers(-ns, ns + 1, len(t)), w


REGRESSIONS = {
    **{f"scale {x:g}": lambda t, w, x=x: (t, w * (1 + x)) for x in (1e-4, 1e-3, 5e-3, 2e-2, 0.2)},
    **{
        f"bias {x:g}": lambda t, w, x=x: (t, w + np.array([x, 0, 0]))
        for x in (1e-5, 1e-4, 1e-3, 1e-2, 0.1)
    },
    **{f"mount {x:g} deg": partial(turned, x) for x in (0.01, 0.1, 1, 5, 90)},
    **{f"delay {x} ms": lambda t, w, x=x: (t + x * 10**6, w) for x in (1, 5, 20, 100, 1000)},
    **{f"cut {x} rows": partial(cut, 0.5, x) for x in (1, 5, 23, 100, 240)},
    **{f"end {x} rows early": partial(cut, 0.0, x) for x in (1, 10, 100)},
    **{f"held {x} rows": partial(held, x) for x in (2, 5, 20, 100)},
    **{f"filter of {x}": partial(smoothed, x) for x in (2, 4, 8, 16)},
    **{f"spike {x:g}": partial(spiked, x) for x in (1e-2, 0.1, 1, 10, 100)},
    **{
        f"steps of {x:g}": lambda t, w, x=x: (t, np.round(w / x) * x)
        for x in (1e-4, 1e-3, 1e-2, 0.1)
    },
    **{
        f"range {x:g}": lambda t, w, x=x: (t, np.clip(w, *(np.array([-x, x]) * np.abs(w).max())))
        for x in (0.99, 0.9, 0.7)
    },
    **{f"clock {x:g}": lambda t, w, x=x: (t + (t - t[0]) * x // 10**6, w) for x in (10, 1000)},
    **{f"jitter {x} us": partial(jittered, x * 1000) for x in (10, 1000)},
    "x reversed": partial(axes, [0, 1, 2], [-1, 1, 1]),
    "z reversed": partial(axes, [0, 1, 2], [1, 1, -1]),
    "x and y exchanged": partial(axes, [1, 0, 2], [1, 1, 1]),
    "axes cycled": partial(axes, [1, 2, 0], [1, 1, 1]),
    "all reversed": partial(axes, [0, 1, 2], [-1, -1, -1]),
    "in deg/s": lambda t, w: (t, np.degrees(w)),
    "one axis is zero": lambda t, w: (t, w * [1, 1, 0]),
    "every second row": lambda t, w: (t[::2], w[::2]),
}
"""Name -> what is done to stamps and rates."""


def text_of(t, w, shown=repr):
    """Return the rows of a log."""
    return [[int(stamp), *map(shown, map(float, rate))] for stamp, rate in zip(t, w, strict=True)]


def more(t, w):
    """Record for longer."""
    return np.r_[t, t[-1] + np.arange(1, 6) * (t[1] - t[0])], np.r_[w, w[-5:]]


def rounded(digits):
    """Write rates with fewer digits."""
    return lambda t, w: text_of(t, w, lambda x: f"{x:.{digits}g}")


HEAD = "t_ns,wx,wy,wz"
HARMLESS = {
    "nothing": (HEAD, text_of, "\n"),
    "carriage returns": (HEAD, text_of, "\r\n"),
    **{f"{k} digits": (HEAD, rounded(k), "\n") for k in (9, 10, 12, 14, 17)},
    "exponents": (HEAD, lambda t, w: text_of(t, w, lambda x: f"{x:.16e}"), "\n"),
    "five rows more": (HEAD, lambda t, w: text_of(*more(t, w)), "\n"),
    "a column more": (f"{HEAD},temp", lambda t, w: [[*r, 20] for r in text_of(t, w)], "\n"),
    "a column before": (f"n,{HEAD}", lambda t, w: [[7, *r] for r in text_of(t, w)], "\n"),
    "columns in another order": (
        "wz,wy,wx,t_ns", lambda t, w: [row[::-1] for row in text_of(t, w)], "\n",
    ),
    "tabs": (HEAD.replace(",", "\t"), text_of, "\n"),
    "semicolons": (HEAD.replace(",", ";"), text_of, "\n"),
    "blanks": (HEAD.replace(",", ", "), text_of, "\n"),
    **{
        f"noise of {x:g}": (
            HEAD,
            lambda t, w, x=x: text_of(t, w + np.random.default_rng(2).normal(0, x, w.shape)),
            "\n",
        )
        for x in (1e-9, 1e-8, 1e-7)
    },
    "a jitter of 1 ns": (HEAD, lambda t, w: text_of(*jittered(1, t, w)), "\n"),
    "a scale of 1e-9": (HEAD, lambda t, w: text_of(t, w * (1 + 1e-9)), "\n"),
}  # fmt: skip
"""Name -> head, rows, and line ends of the same log, written otherwise."""


class Study:
    """A log with its suite, in a folder."""

    def __init__(self, folder, name):
        folder.mkdir()
        self.log, self.suite = folder / "log.csv", folder / "suite.toml"
        run("simulate", self.log, *LOGS[name], code=0)
        truth = folder / "log.truth.csv"
        run("check", self.suite, "--init", self.log, "--reference-log", truth, code=0)
        text = self.suite.read_text().replace("[case.log]", "[case.pinned]")
        free = '[case.stored]\nlog = "log.csv"\nreference = "refs/free.parquet"\npin-log = false\n'
        text = text.replace("[case.log-truth]", f"{free}\n[case.truth]") + "pin-log = false\n"
        text = text.replace('.parquet"\n', '.parquet"\ntol = "0.01deg"\n')
        self.suite.write_text(text)
        run("check", self.suite, "--update", "--force", code=0)
        rows = np.loadtxt(self.log, delimiter=",", skiprows=1, dtype=str)
        self.t, self.w = rows[:, 0].astype(np.int64), rows[:, 1:].astype(float)

    def spoiled(self, regression, *, compared):
        """Return the verdict of each kind of case, and contradictions, where all is compared."""
        write_rates(self.log, text_of(*REGRESSIONS[regression](self.t, self.w)))
        if not compared:
            report = json.loads(run("check", self.suite, "--json").stdout)
            return {case["name"]: case["verdict"] for case in report["cases"]}, []
        cases, wrong = contradictions(self.suite)
        return {kind: cases[kind]["verdict"] for kind in KINDS}, wrong

    def rewritten(self, harmless):
        """Return the verdict of the case with a stored reference, when the log says the same."""
        head, rows, ends = HARMLESS[harmless]
        separator = next((mark for mark in (", ", "\t", ";") if mark in head), ",")
        lines = [separator.join(map(str, row)) for row in rows(self.t, self.w)]
        self.log.write_bytes((ends.join([head, *lines]) + ends).encode())
        return run("check", self.suite, "-k", "stored").stdout


def main():
    """Spoil logs, and print what is caught."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--every", type=int, default=3, help="compare every form of each N-th")
    chosen = parser.parse_args()
    caught, invisible, wrong, alarms, judged = Counter(), defaultdict(list), [], [], 0
    with tempfile.TemporaryDirectory() as place:
        for name in LOGS:
            print(name, flush=True)
            study = Study(Path(place, name), name)
            for number, regression in enumerate(REGRESSIONS):
                compared = (number + len(name)) % chosen.every == 0
                verdicts, said = study.spoiled(regression, compared=compared)
                judged += 3 * compared
                wrong += [f"{name}, {regression}: {sentence}" for sentence in said]
                for kind, verdict in verdicts.items():
                    caught[kind] += verdict != "pass"
                    if verdict == "pass":
                        invisible[kind, regression].append(name)
            said = {harmless: study.rewritten(harmless) for harmless in HARMLESS}
            alarms += [f"{name}, {x}: {s}" for x, s in said.items() if not s.startswith("pass ")]
    total = len(LOGS) * len(REGRESSIONS)
    print(f"caught of {total}: {dict(caught)}")
    for (kind, regression), names in sorted(invisible.items()):
        print(f"invisible, {kind}: {regression}: {', '.join(names)}")
    print(
        f"{len(alarms)} false alarms in {len(LOGS) * len(HARMLESS)} harmless changes",
        *alarms,
        sep="\n",
    )
    print(f"{len(wrong)} contradictions in the reports of {judged} cases", *wrong, sep="\n")
    sys.exit(bool(wrong or alarms))


if __name__ == "__main__":
    main()
