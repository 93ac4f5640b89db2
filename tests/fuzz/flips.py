"""Damaged structure of logs, bit by bit and cut by cut, and what comes of reading each file.

A format is a module with two functions: ``layouts()`` returns small logs by name, each with
:data:`SAMPLES` samples; ``heads(data)`` returns the positions of the bytes that are structure
rather than values, or, better, what each of them is by position. A module may name, in
``UNNOTICED``, what a format cannot notice, with the reason, by the names that ``heads`` gives;
formats.md shows that. Where it has ``ends(data)``, logs are cut at every byte of the last and the
next :data:`CUTS` around each of these places, which are the ends of chunks.

``python -m fuzz.flips [FORMAT...]`` reads every flip, as ``make fuzz`` does; the tests read a few.
"""

import argparse
import importlib
import os
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

import quatprop

SAMPLES = 200
RATES = np.arange(1, SAMPLES + 1)
"""Rates about x, rad/s, by which every sample is told; the other two are 0."""
SPACING_NS = 10_000_000
CUTS = 64
"""Bytes before and behind the end of a chunk at which logs are cut."""

FORMATS = {
    "bag": ("fuzz.flips_rosbag1", ".bag"),
    "mcap": ("fuzz.flips_mcap", ".mcap"),
    "db3": ("fuzz.flips_db3", ".db3"),
    "ulog": ("fuzz.flips_ulog", ".ulg"),
}
"""Modules and suffixes."""

TABLE = r"(?m)^\| format \| damaged \| read as \|\n(?:\|.*\n)+"
"""Of what formats cannot notice, in formats.md."""

HARMLESS, DETECTED, REFUSED = "harmless", "detected", "refused"
GOOD = {HARMLESS, DETECTED, REFUSED}
"""Verdicts that are right of any flip; the others are not."""


def series():
    """Return the samples of a log of messages."""
    t_ns = 1_700_000_000_000_000_000 + SPACING_NS * np.arange(SAMPLES)
    return quatprop.GyroSeries(t_ns, RATES[:, None] * [1.0, 0.0, 0.0])


class Reading(NamedTuple):
    """The outcome of a log for a user: samples and warnings, or an error."""

    t_ns: np.ndarray
    rate: np.ndarray
    losses: tuple[tuple[str, int | None], ...] = ()
    error: str = ""
    is_crash: bool = False


class Flip(NamedTuple):
    """One bit of a layout, what it is part of, and the verdict; of a cut, the bit is None."""

    layout: str
    position: int
    bit: int | None
    name: str
    verdict: str = ""
    detail: str = ""


def read(path, options):
    """Return what :func:`quatprop.read_rates` gives, and what it warns of as lost."""
    empty = np.zeros(0, np.int64), np.zeros((0, 3))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            series = quatprop.read_rates(path, **options)
        except quatprop.QuatpropError as error:
            return Reading(*empty, error=str(error))
        except Exception as error:  # noqa: BLE001  # whatever it is, it is a finding
            return Reading(*empty, error=repr(error), is_crash=True)
    losses = tuple(
        (str(one.message), one.message.messages)
        for one in caught
        if isinstance(one.message, quatprop.DataLossWarning)
    )
    return Reading(series.t_ns, series.rate, losses)


def verdict(found, intact, is_counted):
    """Return what a flip did to a log.

    ``harmless``: all samples are there; ``detected``: the missing ones are lost by a warning, or
    stamps step back, which every propagation refuses; ``refused`` in one sentence; and what must
    not be: ``wrong`` samples, ``silent`` loss, ``crash``, or a ``count`` of a loss that is wrong
    or, where the file states how many samples there are (`is_counted`), could be known.
    """
    if found.is_crash or "\n" in found.error:
        return "crash"
    if found.error:
        return REFUSED
    stamps = dict(zip(intact.rate[:, 0].tolist(), intact.t_ns.tolist(), strict=True))
    samples = found.rate[:, 0].tolist()
    if (
        found.rate[:, 1:].any()
        or len(set(samples)) < len(samples)
        or [stamps.get(x) for x in samples] != found.t_ns.tolist()
    ):
        return "wrong"
    missing = len(intact.t_ns) - len(samples)
    losses = set(found.losses) - set(intact.losses)
    if not missing:
        # Stamps that step back are refused wherever they are used.
        return HARMLESS if (np.diff(found.t_ns) > 0).all() else DETECTED
    if not losses:
        return "silent"
    counts = [count for _, count in losses]
    known = sum(filter(None, counts))
    is_known = known >= missing or (not is_counted and None in counts)
    return DETECTED if is_known else "count"


class Format(NamedTuple):
    """A module of a format, and the suffix of its logs."""

    name: str
    module: object
    suffix: str

    @classmethod
    @cache
    def named(cls, name):
        """Return a format of the table."""
        module, suffix = FORMATS[name]
        return cls(name, importlib.import_module(module), suffix)

    def flips(self):
        """Yield every bit of the structure of every layout."""
        for layout, data in self.module.layouts().items():
            heads = self.module.heads(data)
            for position in sorted(heads):
                name = heads[position] if isinstance(heads, Mapping) else ""
                for bit in range(8):
                    yield Flip(layout, position, bit, name)
            ends = self.module.ends(data) if hasattr(self.module, "ends") else ()
            for position in sorted({end + k for end in ends for k in range(-CUTS, CUTS + 1)}):
                if position < len(data):
                    name = "cut after a chunk" if position in ends else "cut"
                    yield Flip(layout, position, None, name)

    def unnoticed(self):
        """Return what the format cannot notice, with the reasons."""
        return getattr(self.module, "UNNOTICED", {})

    def judged(self, flips, folder):
        """Yield some flips with their verdicts; the files are written into a folder."""
        layouts = self.module.layouts()
        counted = getattr(self.module, "COUNTED", layouts)
        path = Path(folder) / f"flipped{self.suffix}"
        intact = {}
        for flip in flips:
            options = getattr(self.module, "OPTIONS", {}).get(flip.layout, {})
            if flip.layout not in intact:
                path.write_bytes(layouts[flip.layout])
                intact[flip.layout] = whole(read(path, options))
            data = bytearray(layouts[flip.layout])
            if flip.bit is None:
                del data[flip.position :]
            else:
                data[flip.position] ^= 1 << flip.bit
            path.write_bytes(data)
            found = read(path, options)
            is_counted = flip.layout in counted and flip.bit is not None
            result = verdict(found, intact[flip.layout], is_counted)
            detail = found.error or f"{len(found.t_ns)} samples, {found.losses}"
            yield flip._replace(verdict=result, detail=detail)


def whole(reading):
    """Return the reading of an intact log, which has every sample."""
    assert not reading.error, reading.error
    assert reading.rate[:, 0].tolist() == RATES.tolist()
    assert (np.diff(reading.t_ns) == SPACING_NS).all()
    return reading


def sample(name, count, most):
    """Return a flip of each thing that a byte of a format can be, and about so many of all.

    `most`: how many things there may be; of more, some are left out at a steady beat
    """
    flips, things = list(Format.named(name).flips()), {}
    for flip in flips:
        things.setdefault(flip.name, []).append(flip)
    # Steps that are odd meet every bit, and every layout.
    one_each = [some[701 * k % len(some)] for k, some in enumerate(things.values())]
    one_each = one_each[:: -(-len(one_each) // most)]
    return one_each + flips[:: max(1, len(flips) // count) | 1]


def unnoticed_table():
    """Return the table of what formats cannot notice, as formats.md shows it."""
    rows = [
        f"| {Format.named(name).module.TITLE} | {name_of_part} | {reason} |\n"
        for name in FORMATS
        for name_of_part, reason in Format.named(name).unnoticed().items()
    ]
    return "".join(["| format | damaged | read as |\n|---|---|---|\n", *rows])


def problems(flips, unnoticed):
    """Return the flips that were neither harmless nor detected, nor are known to be unnoticed."""
    return [flip for flip in flips if flip.verdict not in GOOD and flip.name not in unnoticed]


def _judged(name, flips):
    with tempfile.TemporaryDirectory() as folder:
        return list(Format.named(name).judged(flips, folder))


def main(names, every):
    """Read every flip of some formats, or one of so many; return how many were wrong."""
    wrong = 0
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        for name in names:
            flips = list(Format.named(name).flips())[::every]
            parts = [flips[begin : begin + 500] for begin in range(0, len(flips), 500)]
            judged = [one for part in pool.map(_judged, [name] * len(parts), parts) for one in part]
            counts = Counter((flip.layout, flip.verdict) for flip in judged)
            for (layout, result), count in sorted(counts.items()):
                print(f"{name} {layout}: {count} {result}", flush=True)
            unnoticed = Format.named(name).unnoticed()
            found = problems(judged, unnoticed)
            for flip in found[:200]:
                print(f"  {flip}", flush=True)
            never = unnoticed.keys() - {flip.name for flip in judged if flip.verdict not in GOOD}
            if never and every == 1:
                print(f"  every flip is noticed after all: {sorted(never)}")
            wrong += len(found) + (len(never) if every == 1 else 0)
    print(f"{wrong} flips that nothing explains")
    return wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", help=f"of {', '.join(FORMATS)} (default: all)")
    parser.add_argument("--every", type=int, default=1, help="read one of so many (default: 1)")
    chosen = parser.parse_args()
    sys.exit(bool(main(chosen.formats or list(FORMATS), chosen.every)))
