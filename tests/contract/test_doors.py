"""One recording, many doors: each command, function, suite and second input reads it alike."""

import gzip
import json
import re
import warnings
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from make.commands import run
from make.ros import imu_messages, write_messages
from make.tables import write_attitudes, write_rates

import quatprop
from quatprop import GyroSeries, QuatpropError

pytestmark = pytest.mark.usefixtures("no_causes")

COUNT, STEP = 1200, 20_000_000
T_NS = 1_700_000_000_000_000_000 + STEP * np.arange(COUNT)


def motion():
    """Return rates of a sensor that lies still for 12 s and is then turned, rad/s."""
    rate = np.random.default_rng(1).normal(0, 1e-3, (COUNT, 3))
    turning = np.arange(COUNT // 2)[:, None] * 0.02 * np.pi * [1, 1.3, 0.7] + [0, 1, 2]
    rate[COUNT // 2 :] += 1.5 * np.sin(turning)
    return rate


RATE = motion()
TRUTH = quatprop.propagate(GyroSeries(T_NS, RATE))


def table(path, t_ns=T_NS, rate=RATE):
    """Write rates, and return the path."""
    return write_rates(path, [(t, *w) for t, w in zip(t_ns.tolist(), rate.tolist(), strict=True)])


def messages(topic="/imu", t_ns=T_NS, rate=RATE):
    """Yield messages of a topic; the orientation is marked as absent."""
    absent = np.array([-1.0, *[0.0] * 8])
    for _, *message in imu_messages(t_ns, rate, orientation_covariance=absent):
        yield (topic, *message)


def with_nan():
    """Return rates some of which are absent."""
    rate = RATE.copy()
    rate[300:310] = np.nan
    return rate


def stepped():
    """Return timestamps that step back once."""
    return np.where(np.arange(COUNT) < 400, T_NS, T_NS - 500_000_000)


def damaged(path):
    """Flip a bit in the middle of a log."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 16
    path.write_bytes(data)
    return path


def compressed(path):
    """Compress a file."""
    target = path.with_name(f"{path.name}.gz")
    target.write_bytes(gzip.compress(path.read_bytes()))
    return target


KEPT = np.flatnonzero((np.arange(COUNT) < 800) | (np.arange(COUNT) >= 850))

LOGS = {
    "as it should be": lambda d: [table(d / "log.csv")],
    "damaged": lambda d: [damaged(write_messages(d / "log.mcap", messages()))],
    "stepping back": lambda d: [table(d / "log.csv", stepped())],
    "of two topics": lambda d: [
        write_messages(d / "log.bag", chain(messages("/a"), messages("/b")))
    ],
    "one of two topics": lambda d: [
        f"{write_messages(d / 'log.bag', chain(messages('/a'), messages('/b')))}:/b"
    ],
    "in packets": lambda d: [table(d / "log.csv", T_NS[np.arange(COUNT) // 10 * 10])],
    "with absent rates": lambda d: [table(d / "log.csv", rate=with_nan())],
    "with a gap": lambda d: [table(d / "log.csv", T_NS[KEPT], RATE[KEPT])],
    "in two files": lambda d: [
        table(d / "1.csv", T_NS[:600], RATE[:600]),
        table(d / "2.csv", T_NS[600:], RATE[600:]),
    ],
    "compressed": lambda d: [compressed(table(d / "log.csv"))],
    "with a wrong suffix": lambda d: [table(d / "log.csv").rename(d / "log.parquet")],
    "that is none": lambda d: [write_rates(d / "log.csv", [(1, 2)], "a,b")],
}


class Outcome(NamedTuple):
    """The outcome of reading a recording by a door.

    `samples`: how many samples it used; None if it refuses, or does not tell
    `lost`: places of losses
    `refusal`: the sentence up to the way out; "" if it does not refuse
    """

    samples: int | None = None
    lost: frozenset[str] = frozenset()
    refusal: str = ""


def fact(sentence, names):
    """Return a sentence without files, and without the way out."""
    sentence = re.sub(r"^(Error: |lost: )", "", sentence.strip())
    for name in sorted(map(str, names), key=len, reverse=True):
        sentence = sentence.replace(name.partition(":/")[0], "LOG")
    return re.split(r"; ", sentence)[0].replace("'", "")


def place(sentence):
    """Return where a loss is, by a sentence about it; None if it is about something else."""
    found = re.search(r"chunk at byte \d+", sentence)
    return found and found[0]


def called(function, names):
    """Return the outcome of a call of the library, which returns the number of samples or None."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            samples = function()
        except QuatpropError as error:
            return Outcome(refusal=fact(str(error), names))
    said = [warning.message for warning in caught]
    return Outcome(samples, frozenset(filter(None, (place(str(one)) for one in said))))


def ran(names, *arguments, at=""):
    """Return the outcome of a command line; `at`: where its report tells what it used."""
    result = run(*arguments)
    if result.exit_code == 2:
        return Outcome(refusal=fact(result.stderr, names))
    lines = [line for line in (result.stderr + result.stdout).splitlines() if place(line)]
    found = None if not at else int(re.search(at, result.stderr + result.stdout)[1])
    assert (result.exit_code == 3) == bool(lines)
    return Outcome(found, frozenset(map(place, lines)))


def log_of(names):
    """Return what the library takes: one name, or a list."""
    return [str(name) for name in names] if len(names) > 1 else str(names[0])


SUITE = """\
[defaults]
rate-unit = "rad/s"
[case.one]
log = {log}
reference-log = "truth.csv"
tol = "180deg"
"""


def checked(names, folder):
    """Check it as the case of a suite."""
    (folder / "suite.toml").write_text(SUITE.format(log=json.dumps(log_of(names))))
    write_attitudes(folder / "truth.csv", TRUTH.t_ns, TRUTH.wxyz)
    result = run("check", folder / "suite.toml", "--update", "--force", "--json")
    (case,) = json.loads(result.stdout)["cases"]
    if case["verdict"] == "error":
        return Outcome(refusal=fact(case["reason"], names))
    return Outcome(lost=frozenset("log" for note in case["notes"] if "data of" in note))


def batched(names, folder):
    """Propagate it in a batch."""
    (entry,) = quatprop.batch(log_of(names), folder / "out", processes=1, rate_unit="rad/s")
    if entry.state == "failed":
        return Outcome(refusal=fact(entry.error, names))
    losses = json.loads(entry.losses) if isinstance(entry.losses, str) else entry.losses
    return Outcome(entry.samples, frozenset(place(str(one)) for one in losses))


def surveyed(names, _folder):
    """List its signals."""
    try:
        survey = quatprop.info(log_of(names), **UNIT)
    except QuatpropError as error:
        return Outcome(refusal=fact(str(error), names))
    return Outcome(survey.sources[0].samples, frozenset(place(one.place) for one in survey.losses))


UNIT = {"rate_unit": "rad/s"}
OPTION = ("--rate-unit", "rad/s")

STRICT = {
    "propagate": lambda names, _: called(
        lambda: quatprop.propagate(log_of(names), **UNIT).report.counts.samples_used, names
    ),
    "quatprop propagate": lambda names, folder: ran(
        names, "propagate", *names, *OPTION, "-o", folder / "o.csv", at=r"samples +(\d+)"
    ),
    "noise": lambda names, _: called(lambda: quatprop.noise(log_of(names), **UNIT) and None, names),
    "quatprop noise": lambda names, _: ran(names, "noise", *names, *OPTION),
    "check": checked,
    "batch": batched,
}
"""Doors that apply the policies for timestamps and rates."""

OBSERVING = {
    "read_rates": lambda names, _: called(
        lambda: len(quatprop.read_rates(log_of(names), **UNIT)), names
    ),
    "info": surveyed,
    "plot": lambda names, _: called(lambda: quatprop.plot(log_of(names), **UNIT) and None, names),
}
"""Doors that show what is recorded."""


FILE_BY_FILE = {"check", "batch", "info", "plot"}
"""Doors that take each file as a recording of its own, or one file alone."""


@pytest.mark.parametrize("name", LOGS)
def test_every_door_reads_a_recording_alike(tmp_path, name):
    """The same samples are used and lost, and the same is refused, with the same words."""
    names = LOGS[name](tmp_path)
    expected = STRICT["propagate"](names, tmp_path)
    for door, enter in {**STRICT, **OBSERVING}.items():
        if len(names) > 1 and door in FILE_BY_FILE:
            continue
        found = enter(names, tmp_path)
        if door in OBSERVING and expected.refusal and not found.refusal:
            # They show what the policies refuse, and info shows every topic.
            assert found.samples in {None, COUNT}, door
            continue
        if door in OBSERVING and found.refusal:
            found = found._replace(refusal=found.refusal.replace("rates or attitudes", "rates"))
        assert found.refusal == expected.refusal, door
        # A note of a suite says that data are lost, and names the command that says which.
        lost = {"log"} if door == "check" and expected.lost else expected.lost
        assert found.lost == lost, door
        assert found.samples in {None, expected.samples}, door


# Attitudes: of one series, as A or B of a comparison, a reference, or the file next to a log.


def attitudes(path, t_ns=TRUTH.t_ns, wxyz=TRUTH.wxyz):
    """Write attitudes, and return the path."""
    return write_attitudes(path, t_ns, wxyz)


def imus(path, topics=("/imu",)):
    """Write messages with orientations and no rates, and return the path."""
    every = [[(topic, *one[1:]) for one in imu_messages(T_NS, (), TRUTH.wxyz)] for topic in topics]
    return write_messages(path, chain(*every))


def with_invalid():
    """Return attitudes of which some are zero."""
    wxyz = TRUTH.wxyz.copy()
    wxyz[100:103] = 0
    return wxyz


ATTITUDES = {
    "as it should be": lambda d: attitudes(d / "b.csv"),
    "damaged": lambda d: damaged(imus(d / "b.mcap")),
    "with invalid rows": lambda d: attitudes(d / "b.csv", wxyz=with_invalid()),
    "of two topics": lambda d: imus(d / "b.bag", ("/a", "/b")),
    "one of two topics": lambda d: f"{imus(d / 'b.bag', ('/a', '/b'))}:/b",
    "with a gap": lambda d: attitudes(d / "b.csv", T_NS[KEPT], TRUTH.wxyz[KEPT]),
    "compressed": lambda d: compressed(attitudes(d / "b.csv")),
    "with a wrong suffix": lambda d: attitudes(d / "b.csv").rename(d / "b.parquet"),
    "that is none": lambda d: write_rates(d / "b.csv", [(1, 2)], "a,b"),
}

DOORS = {
    "read_attitudes": lambda b, _: called(lambda: len(quatprop.read_attitudes(b)), [b]),
    "compare, A": lambda b, _: called(lambda: quatprop.compare(b, TRUTH) and None, [b]),
    "compare, B": lambda b, _: called(lambda: quatprop.compare(TRUTH, b) and None, [b]),
    "quatprop compare": lambda b, d: ran([b], "compare", attitudes(d / "t.csv"), b),
    "convert": lambda b, d: ran([b], "convert", b, d / "out.csv"),
    "reference of plot": lambda b, _: called(
        lambda: quatprop.plot(TRUTH, reference=b) and None, [b]
    ),
    "relative to": lambda b, d: ran(
        [b], "convert", attitudes(d / "t.csv"), d / "out.csv", "--relative-to", b
    ),
    "calibrate": lambda b, _: called(lambda: quatprop.calibrate(SERIES, b) and None, [b]),
}

OPTIONS_OF_FILES = {
    "q0": lambda b, _: called(lambda: quatprop.propagate(SERIES, q0=b) and None, [b]),
    "at": lambda b, _: called(lambda: quatprop.propagate(SERIES, at=b) and None, [b]),
}
SERIES = GyroSeries(T_NS, RATE)


TOLERANT = {"reference of plot", "q0", "at"}
"""Doors that leave out invalid rows: a picture, one attitude of a series, and its timestamps."""


@pytest.mark.parametrize("name", ATTITUDES)
def test_every_door_reads_attitudes_alike(tmp_path, name):
    """As A or B, as a reference, or next to a log: the same is lost and refused."""
    b = str(ATTITUDES[name](tmp_path))
    expected = DOORS["read_attitudes"](b, tmp_path)
    for door, enter in {**DOORS, **OPTIONS_OF_FILES}.items():
        found = enter(b, tmp_path)
        if name == "with invalid rows" and door in TOLERANT:
            assert found.refusal == ""
            continue
        assert found.refusal == expected.refusal, door
        if door != "reference of plot":  # which says that a part was not read
            assert found.lost == expected.lost, door
        assert found.samples in {None, expected.samples}, door


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("setting", ["q0", "at"])
def test_a_part_of_a_split_recording_is_a_second_input(tmp_path, setting):
    """However its path is spelled; it was read as all parts together, which is refused."""
    half = COUNT // 2
    names = [str(tmp_path / f"{k}.bag") for k in range(2)]
    for name, rows in zip(names, (slice(half), slice(half, None)), strict=True):
        write_messages(Path(name), imu_messages(T_NS[rows], RATE[rows], TRUTH.wxyz[rows]))
    found = [
        quatprop.propagate(names, **{setting: name})
        for name in (names[0], f"{tmp_path}/./0.bag", f"{names[0]}:/imu")
    ]
    assert len(found[0]) == (COUNT if setting == "q0" else half)
    for other in found[1:]:
        assert np.array_equal(other.wxyz, found[0].wxyz)
