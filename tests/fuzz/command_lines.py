"""Random command lines of ``propagate``, against what the documents say of each option.

``make fuzz``, or ``python -m fuzz.command_lines [--first SEED] [--count N]``. Each seed is a log,
whose stamps may jump, repeat and step back and whose rates may be missing, and a command line. The
exit code, the attitudes, and the log times of those that are added to a copy are those of
:mod:`options_reference`, which knows the documents alone.
"""

import json
import sys
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from click.testing import CliRunner
from fuzz import seeds
from make.options_reference import NS, Refused, ordered, part, propagated, used
from make.ros import imu_messages, write_messages
from make.tables import write_attitudes, write_rates
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from quatprop.cli.commands import cli

LOGGED = 7_000_000_000
"""Messages are recorded so much later than they are stamped, ns: on another clock."""
GROUP = 30
"""Rows in a group of a Parquet file: those that may have the range are read alone."""
KINDS = ("csv", "csv", "parquet", "mcap", "bag")
BIAS = np.array([0.01, -0.02, 0.03])
MOUNT = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_quat(scalar_first=True).tolist()
CALIBRATION = np.eye(3) + np.random.default_rng(5).normal(0, 0.02, (3, 3))
TIMES = {
    "t_ns": ("ns", 0),
    "t_us": ("us", 3),
    "t_ms": ("ms", 6),
    "t_s": ("s", 9),
    "clock": ("us", 3),
}
"""Time columns: their unit, and the digits after the point that keep ns."""


def recording(random):
    """Return the rows of a log that rests, then moves: stamps, rates, forces, orientations."""
    resting = int(random.choice([130, random.integers(20, 60)]))
    moving = int(random.integers(20, 80))
    n = resting + moving
    steps = random.integers(9_000_000, 11_000_000, n)
    for _ in range(random.choice([0, 0, 1, 3])):
        steps[random.integers(n)] = random.choice([0, 120_000_000, 900_000_000])
    t = int(random.choice([0, 3_000_000_000, 1_700_000_000_123_456_789])) + np.cumsum(steps)
    intact = t.copy()
    for _ in range(random.choice([0, 0, 1, 2, 4])):
        at, length = random.integers(n), random.choice([1, 1, 1, 2, 12])
        jump = random.choice([-400, -35, -25, 15, 90, 300, 990, 60_000])
        t[at : at + length] += int(jump) * 1_000_000
    if random.random() < 0.1 and t[0] < 60 * NS:
        t[0] = 0  # before the clock was set; a lasting jump from 1970 would ask for too many rows
    t = np.where(t < 0, intact, t)
    w = random.normal(BIAS, 1e-3, (n, 3))
    w[resting:] += 3 * np.sin(np.arange(moving)[:, None] / 15 + np.arange(3))
    for _ in range(random.choice([0, 0, 1, 3])):
        w[random.integers(n), random.integers(3)] = random.choice([np.nan, np.inf])
    f = Rotation.from_euler("xyz", [0.4, -0.2, 0.0]).apply([0, 0, 9.81])
    q = Rotation.from_rotvec(random.normal(0, 1e-3, (n, 3))) * Rotation.random(rng=random)
    return {"t": t, "w": w, "f": f + random.normal(0, 1e-3, (n, 3)), "q": q}


def moment(random, raw):
    """Return a time as it is written, and as the reference takes it."""
    t = raw["t"]
    span = int(np.quantile(t, 0.9) - np.quantile(t, 0.1))
    ns = int(random.integers(0, span + 1)) // 1_000_000 * 1_000_000
    form = random.choice(["+", "", "-", "ns", "date"])
    if form in {"+", "", "-"}:
        text = random.choice([f"{ns // 1_000_000}ms", f"{ns // NS}s{ns % NS // 1000}us"])
        return form + text, ("-" if form == "-" else "+", ns)
    ns = int(random.choice(t)) + int(random.integers(-20_000_000, 20_000_000))
    ns = max(ns, 1)
    if form == "ns":
        return str(ns), ns
    date = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=ns // NS)
    return f"{date:%Y-%m-%dT%H:%M:%S}.{ns % NS:09d}Z", ("date", ns)


def command_line(random, raw, folder, kind):
    """Return options of ``propagate`` by name: as they are written, and for the reference."""

    def one_of(*values):
        return values[random.integers(len(values))]

    plain = {
        "method": one_of(None, "start", "end", "mean", "coning", "cubic", "quintic"),
        "rates": one_of(None, None, "body", "inertial"),
        "mount": one_of(None, None, "y,-x,z", ",".join(map(repr, MOUNT))),
        "on_backwards": one_of(None, *["drop", "sort"] * 4),
        "on_nonfinite": one_of(None, *["drop", "hold"] * 4),
        "on_gap": one_of(None, None, "hold", "zero", "split", "error"),
        **one_of({}, {}, {"every": 3}, {"rate": "59.94"}, {"rate": "400"}, {"at": "series"}),
    }
    given = {name: value for name, value in plain.items() if value is not None}
    expected = dict(given)
    for name in ("start", "end"):
        if random.random() < 0.3:
            given[name], expected[name] = moment(random, raw)
    if random.random() < 0.3:
        given["max_gap"], expected["max_gap"] = one_of(
            ("200ms", 200_000_000), ("15ms", 15_000_000), ("10500us", 10_500_000)
        )
    corrections(random, raw, folder, (given, expected))
    beginning(random, raw, folder, (given, expected))
    if "at" in given:
        begin, last = span(raw)
        t = np.concatenate([random.integers(begin - NS // 2, last + NS // 2, 20), raw["t"][::7]])
        given["at"] = series_file(folder / "at.csv", t, Rotation.identity(len(t)))
        expected["at"] = (t, None)
    expected["to_messages"] = kind in {"mcap", "bag"} and random.random() < 0.7
    return given, expected


def span(raw):
    """Return from when to when a log is, but for stamps that jump."""
    return int(raw["t"].min()), int(np.quantile(raw["t"], 0.9))


def corrections(random, raw, folder, options):
    """Choose a bias, and a calibration."""
    given, expected = options
    choice = random.choice(["none", "none", "given", "static", "series"])
    if choice == "given":
        given["bias"], expected["bias"] = ",".join(map(repr, BIAS.tolist())), BIAS
    elif choice == "static":
        given["bias"] = "static:100ms"
    elif choice == "series":
        begin, last = span(raw)
        known, biases = np.linspace(begin, last, 4).astype(np.int64), random.normal(0, 0.01, (4, 3))
        rows = [[t, *row] for t, row in zip(known, biases.tolist(), strict=True)]
        names = ",".join(f"gyro_bias_{axis} [rad/s]" for axis in "xyz")
        given["bias"] = write_rates(folder / "bias.csv", rows, f"t_ns,{names}")
        after = (raw["t"] - begin) / NS
        axes = [np.interp(after, (known - begin) / NS, axis) for axis in biases.T]
        expected["bias"] = np.stack(axes, axis=1)
    if random.random() < 0.2:
        given["calibration"] = folder / "calibration.json"
        content = {"matrix": CALIBRATION.tolist(), "bias": (BIAS / 2).tolist()}
        given["calibration"].write_text(json.dumps(content))
        expected["calibration"] = CALIBRATION, BIAS / 2


def beginning(random, raw, folder, options):
    """Choose where to begin."""
    given, expected = options
    choice = random.choice(["none", "numbers", "scalar-last", "level", "level", "log", "series"])
    if choice in {"numbers", "scalar-last"}:
        given["q0"], expected["q0"] = "0.48,0.6,0.64,0", [0.48, 0.6, 0.64, 0]
        if choice == "scalar-last":
            given["q0_layout"] = expected["q0_layout"] = random.choice(["xyzw", "scalar-last"])
    elif choice == "level":
        level = {"q0": "level", "heading": 30.0, "reference_z": str(random.choice(["up", "down"]))}
        for name, value in level.items():
            if name == "q0" or random.random() < 0.6:
                given[name] = expected[name] = value
    elif choice == "log":
        given["q0"] = expected["q0"] = "log"
    elif choice == "series":
        t = span(raw)[0] + np.arange(-1, 3) * NS
        turns = Rotation.from_rotvec(np.arange(4)[:, None] * [0.3, -0.1, 0.2])
        given["q0"], expected["q0"] = series_file(folder / "q0.csv", t, turns), (t, turns)


def series_file(path, t, q):
    """Write a series of attitudes; return its path."""
    return write_attitudes(path, t, q.as_quat(scalar_first=True))


def write_log(path, raw, random):
    """Write rows as a table or as messages; return the options that read it.

    In text, rates may be in deg/s, and times in any unit; a bias that is given is in that of rates.
    """
    wxyz = raw["q"].as_quat(scalar_first=True)
    if path.suffix not in {".csv", ".parquet"}:
        times = {"recorded": recorded_ns(raw), "linear_acceleration": list(raw["f"])}
        write_messages(path, imu_messages(raw["t"], raw["w"], wxyz, **times))
        return {}
    names = ["gx", "gy", "gz", "accel_x", "accel_y", "accel_z", "qw", "qx", "qy", "qz"]
    values = [raw["f"], wxyz]
    if path.suffix == ".parquet":
        values = np.column_stack([raw["w"], *values])
        columns = {"t_ns": raw["t"], **dict(zip(names, values.T, strict=True))}
        pa.parquet.write_table(pa.table(columns), path, row_group_size=GROUP)
        return {"rate_cols": "gx,gy,gz", "rate_unit": "rad/s"}
    time, degrees = str(random.choice(list(TIMES))), bool(random.integers(2))
    unit, digits = TIMES[time]
    values = np.column_stack([np.degrees(raw["w"]) if degrees else raw["w"], *values])
    stamps = [
        f"{t // 10**digits}.{t % 10**digits:0{digits}d}" if digits else t for t in raw["t"].tolist()
    ]
    rows = zip(stamps, values.tolist(), strict=True)
    write_rates(path, [[t, *row] for t, row in rows], ",".join([time, *names]))
    units = {"rate_unit": "deg/s" if degrees else "rad/s", "time_unit": unit}
    return {"rate_cols": "gx,gy,gz", "time_col": time, **units}


def recorded_ns(raw):
    """Return when the messages of rows are recorded: in their order."""
    n = len(raw["t"])
    return LOGGED + np.arange(n) * 10_000_000 + np.arange(n) % 7 * 1000


def difference(seed, folder):
    """Return the exit code of a command line, and what it does otherwise than the documents say."""
    random = np.random.default_rng(seed)
    raw, kind = recording(random), KINDS[random.integers(len(KINDS))]
    log, report = folder / f"log.{kind}", folder / "report.json"
    given, options = command_line(random, raw, folder, kind)
    out = folder / (f"out.{kind}" if options["to_messages"] else "out.csv")
    given |= write_log(log, raw, random)
    if given.get("rate_unit") == "deg/s" and not np.ndim(options.get("bias", [[0]])) > 1:
        given["bias"] = ",".join(map(repr, np.degrees(BIAS).tolist()))
    given["output"] = out
    line = [f"--{name.replace('_', '-')}={value}" for name, value in given.items()]
    result = CliRunner().invoke(cli, ["propagate", str(log), *line, f"--report={report}"])
    told = f"propagate {' '.join(line)}: exit code {result.exit_code}, {result.stderr.strip()}"
    if result.exit_code == 1 or "This is a bug" in result.stderr:
        return result.exit_code, told
    if given.get("bias") == "static:100ms" or given.get("q0") == "level":
        if "rest" in result.stderr and result.exit_code == 2:
            return 2, None  # what counts as rest is tested elsewhere
        if result.exit_code != 2 and "bias" not in options and "bias" in given:
            rest = json.loads(report.read_text())["correction"]["rest"]
            inside = (raw["t"] >= rest["first_ns"]) & (raw["t"] <= rest["last_ns"])
            inside &= np.isfinite(raw["w"]).all(axis=1)
            inside &= np.isin(np.arange(len(inside)), ordered(raw["t"], options))
            options["bias"] = raw["w"][inside].mean(axis=0)
    if result.exit_code != 2 and json.loads(report.read_text())["correction"]["part"]:
        raw, options = read_in_part(raw, options, json.loads(report.read_text())["correction"])
    return result.exit_code, compared(result.exit_code, raw, options, out, told)


def read_in_part(raw, options, told):
    """Return the rows that were read, by the stamps of row groups, and the options in ns."""
    limits = {"start": told["start_ns"], "end": told["end_ns"]}
    options = options | {name: ("date", ns) for name, ns in limits.items() if ns is not None}
    low, high = limits["start"] or 0, limits["end"] or 2**62
    every = np.arange(len(raw["t"]))
    groups = [every[k : k + GROUP] for k in range(0, len(every), GROUP)]
    inside = [g for g in groups if raw["t"][g].max() >= low and raw["t"][g].min() <= high]
    rows = np.concatenate(inside)
    part = {name: values[rows] for name, values in raw.items()}
    if np.ndim(options.get("bias")) > 1:
        options["bias"] = options["bias"][rows]
    return part, options


def compared(code, raw, options, out, told):
    """Return how a result differs from what is expected; None where it does not."""
    try:
        expected_t, expected_q = propagated(raw, options)
    except Refused as refused:
        return None if code == 2 else f"{told}; expected to be refused: {refused}"
    if code != exit_code(raw, options):
        return f"{told}; expected exit code {exit_code(raw, options)}"
    t, q = attitudes(out)
    if t != expected_t.tolist():
        return f"{told}; {len(t)} stamps, {len(expected_t)} expected"
    error = (expected_q.inv() * q).magnitude().max()
    return None if error < 1e-11 else f"{told}; attitudes differ by {error:.3g} rad"


def exit_code(raw, options):
    """Return the exit code: 3 where samples of the range, or that are wrong, were dropped."""
    rows, _ = used(raw["t"], raw["w"], options)
    left = ordered(raw["t"], options)
    low, high = part(options, raw["t"], left)
    inside = [row for row in left if low <= raw["t"][row] <= high]
    return 3 if len(left) < len(raw["t"]) or len(rows) < len(inside) else 0


def attitudes(path):
    """Return stamps and rotations of what was written."""
    if path.suffix == ".csv":
        rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
        wxyz = np.array([list(map(float, row[1:5])) for row in rows])
        return [int(row[0]) for row in rows], Rotation.from_quat(wxyz, scalar_first=True)
    t, wxyz = [], []
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            found = reader.deserialize(data, connection.msgtype)
            t.append(found.header.stamp.sec * NS + found.header.stamp.nanosec)
            part = found.quaternion
            wxyz.append([part.w, part.x, part.y, part.z])
    return t, Rotation.from_quat(wxyz, scalar_first=True)


def judged(seed):
    """Return the exit code of a command line, and how it differs from the documents."""
    with tempfile.TemporaryDirectory() as folder:
        return difference(seed, Path(folder))


if __name__ == "__main__":
    sys.exit(bool(seeds.main(__doc__, judged)))
