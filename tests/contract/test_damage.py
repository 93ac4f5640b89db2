"""The rest of damaged logs: never a sample that was not there, never a silent loss."""

import gzip
import json
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from make.commands import refused, run
from make.formats import FORMATS, SAMPLES, samples
from make.tables import write_attitudes, write_rates
from make.walks import part_ends

from quatprop import propagate, read_rates
from quatprop.base.errors import DamagedLogError, LogError
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection

PARTS = {"db3_ros2": "db3_ros2.db3", "mcap_ros2": "mcap_ros2.mcap", "split_ros2": "split_1.mcap"}
"""The file that is damaged of a log that is a folder."""
TEXT = (".csv", ".tsv", ".jsonl")
DAMAGED = [name for name in FORMATS if name != "wal_ros2"]


def read(log):
    """Return stamps and rates, and whether a loss is told; None: the last number may be cut."""
    try:
        with open_log(log) as opened:
            batches = list(choose_rates(opened, RateSelection()).batches())
            lost = True if opened.losses else None if opened.remarks else False
    except LogError:
        return np.empty((0, 4)), True
    t_ns = np.concatenate([batch.t_ns for batch in batches] or [np.empty(0)])
    rate = np.concatenate([batch.rate for batch in batches] or [np.empty((0, 3))])
    # A log without any sample is refused by whoever wants them.
    return np.column_stack([t_ns.view(np.float64), rate]), lost if len(t_ns) else True


def copied(logs, name, folder):
    """Copy a log; return it, and the file of it that is to be damaged."""
    source, log = logs / name, folder / name
    if source.is_dir():
        shutil.copytree(source, log)
        return log, log / PARTS[name]
    return log, Path(shutil.copy(source, log))


def intact(logs, name):
    """Return what a log holds as :func:`read` does, after a look at it."""
    whole, lost = read(logs / name)
    expected = FORMATS[name].holds(samples())
    assert whole[:, 0].tobytes() == expected.t_ns.tobytes()
    assert whole[:, 1:].tobytes() == expected.rate.tobytes()
    assert lost is False
    return whole


def ends_a_row(name, data, ends):
    """Tell whether a log without an end of its own ends with a whole row, and says no more."""
    if name.endswith(TEXT):
        return data.endswith(b"\n") or (name.endswith(".jsonl") and data.endswith(b"}}"))
    return name == "gyro.ulg" and len(data) in ends


@pytest.mark.parametrize("name", [name for name in DAMAGED if name != "split_ros2"])
def test_a_cut_log_gives_the_samples_before_the_cut_and_says_that_it_is_cut(logs, tmp_path, name):
    """Wherever a log ends, its samples are the first of the whole, and nothing is lost silently."""
    whole = intact(logs, name)
    log, part = copied(logs, name, tmp_path)
    data, parts = part.read_bytes(), part_ends(part)
    ends = {end for end, _ in parts}
    places = [*sorted(ends)[:: max(1, len(ends) // 4)], *np.linspace(0, len(data), 7)[:-1]]
    places += np.geomspace(4, len(data), 9)[:-1].tolist()  # where the structure is
    wrong = []
    for size in {int(place) - by for place in places for by in (0, place in ends)}:
        part.write_bytes(data[:size])
        found, lost = read(log)
        count = len(found)
        least = max((number for end, number in parts if end <= size), default=0)
        if lost is None:  # what is told then is that the last number may be cut
            found[-1, -1] = whole[count - 1, -1]
        if (
            count < least
            or found.tobytes() != whole[:count].tobytes()
            or (count < len(whole) and lost is False and not ends_a_row(name, data[:size], ends))
        ):
            wrong.append((size, count, least, lost))
    assert wrong == []


@pytest.mark.parametrize("name", [name for name in DAMAGED if FORMATS[name].checked])
def test_no_damaged_byte_of_a_log_with_checksums_changes_a_sample(logs, tmp_path, name):
    """All that was written is read and nothing else, or a loss is told."""
    whole = intact(logs, name)
    log, part = copied(logs, name, tmp_path)
    data, wrong = part.read_bytes(), []
    for place in np.linspace(0, len(data) - 1, 41).astype(int).tolist():
        part.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        found, lost = read(log)
        if not lost and found.tobytes() != whole.tobytes():
            wrong.append(place)
    assert wrong == []


CHANGING = [name for name in FORMATS if not name.endswith(("ros2", ".gz", ".zst", ".lz4", ".bz2"))]
SHRINKING = """
import os, sys
from quatprop.base.errors import LogError
from quatprop.readers.open_log import open_log
from quatprop.settings.reading import RateSelection
from quatprop.readers.rate_signals import choose_rates
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
            lost = bool(log.losses or log.remarks)
    except LogError:
        pass
    print(count, lost, flush=True)
"""


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
        assert (lost == "True") == (int(count) < SAMPLES), name


@pytest.mark.parametrize("name", CHANGING)
def test_a_log_that_grows_while_it_is_read_gives_what_was_there(logs, tmp_path, name):
    """A recorder that goes on writing does no harm, and adds nothing to what was opened."""
    log = Path(shutil.copyfile(logs / name, tmp_path / name))
    try:
        with open_log(log) as opened:
            batches = choose_rates(opened, RateSelection()).batches()
            with log.open("ab") as file:
                file.write((logs / name).read_bytes())
            assert sum(len(batch) for batch in batches) == SAMPLES
    except LogError:
        assert name.endswith((".npz", ".parquet", ".feather"))


@pytest.mark.parametrize("name", [name for name in DAMAGED if name != "split_ros2"])
def test_what_a_damaged_file_of_times_lacks_is_lost_of_the_run(logs, tmp_path, name):
    """Of `--at` in every format: it was left out in silence, and so were its times."""
    log, part = copied(logs, name, tmp_path)
    data, whole = part.read_bytes(), samples()
    for place in (len(data) // 2, len(data) * 6 // 7):
        part.write_bytes(data[:place])
        found, lost = read(log)
        if not len(found):
            continue
        with warnings.catch_warnings(record=True):
            warnings.simplefilter("always")
            report = propagate(whole, at=log).report
        assert report.result.rows == len(found)
        assert report.data_lost == bool(lost)
        assert all(loss.place.startswith(f"{log}, ") for loss in report.losses)
        assert lost is not None or [one.code for one in report.remarks] == ["no-line-end"]


@pytest.mark.parametrize(("at", "width"), [(2, 1), (150, 7), (300, 99)])
@pytest.mark.parametrize("option", ["q0", "at", "bias"])
def test_rows_that_are_lost_of_another_file_are_lost_of_the_run(tmp_path, option, at, width):
    """Wherever they are, also after the attitude for `--q0`; they were ignored, exit code 0."""
    t_ns, rate = 10**9 + np.arange(400) * 10**7, np.zeros((400, 3))
    log = write_rates(tmp_path / "log.csv", np.column_stack([t_ns, rate]).astype(int))
    other = write_attitudes(tmp_path / "other.csv", t_ns, np.tile([1.0, 0, 0, 0], (400, 1)))
    if option == "bias":
        head = "t_ns," + ",".join(f"gyro_bias_{axis} [rad/s]" for axis in "xyz")
        write_rates(other, np.column_stack([t_ns, rate]).astype(int), head)
    lines = other.read_text().splitlines()
    lines[at : at + width] = [f"?;{line}" for line in lines[at : at + width]]
    other.write_text("\n".join([*lines, ""]))
    report = tmp_path / "report.json"
    out = tmp_path / "out.csv"
    said = run("propagate", log, "-o", out, f"--{option}", other, "--report", report, code=3)
    assert f"lost: {other}, line" in said.stderr
    losses = json.loads(report.read_text())["losses"]
    assert sum(loss["messages"] for loss in losses) == width


RATES_LOST = {
    "an archive without its last arrays": ("cut.npz", "its directory is damaged"),
    "the end of a compressed table": ("end.csv.gz", "does not begin like a .gz file"),
    "a header that was cut off": ("head.csv.gz", "its gz data is damaged or cut off"),
    "the first line of compressed objects": ("head.jsonl.gz", "its gz data is damaged or cut off"),
}


@pytest.mark.parametrize("damage", RATES_LOST)
@pytest.mark.parametrize("command", ["info {}", "propagate {} -o {}.out.csv", "plot {} -o {}.svg"])
def test_a_log_that_may_have_lost_its_rates_is_damaged(tmp_path, damage, command):
    """Each was reported to have no rates, like a table of something else."""
    name, reason = RATES_LOST[damage]
    rows = [(10**7 * k, k % 7, k % 5, k % 3) for k in range(200)]
    text = "t_ns,wx,wy,wz\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    if name == "cut.npz":
        names = ("t_ns", "wx", "wy", "wz")
        np.savez(tmp_path / name, **dict(zip(names, np.array(rows).T, strict=True)))
        data = (tmp_path / name).read_bytes()
        data = data[: data.index(b"wz.npy") - 30]
    elif name == "end.csv.gz":
        data = gzip.compress(text.encode())[7:]
    elif name == "head.csv.gz":
        data = stored(text)[: text.index("wz") + 15]
    else:
        data = stored('{"t_ns":0,"a":1}\n' + '{"t_ns":1,"wx":1,"wy":2,"wz":3}\n')[: 15 + 20]
    (tmp_path / name).write_bytes(data)
    assert reason in refused(*command.replace("{}", str(tmp_path / name)).split())
    with pytest.raises(DamagedLogError, match=reason):
        read_rates(tmp_path / name)


def stored(text):
    """Return a text in a gzip file, uncompressed."""
    return gzip.compress(text.encode(), compresslevel=0)
