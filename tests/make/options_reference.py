"""The meaning of every option of propagate, computed again in the plainest way: for tests.

Written from the documentation, with SciPy's rotations and the oracle's rotation vectors, sample by
sample. Nothing of quatprop is used.
"""

from bisect import bisect_left
from fractions import Fraction
from itertools import pairwise
from math import radians

import numpy as np
from make.oracle import NS, rotation_vector
from scipy.spatial.transform import Rotation, Slerp

AXES = {"x": 0, "y": 1, "z": 2}


def propagated(raw, options):
    """Return the stamps and the rotations body -> reference that options lead to.

    `raw`: of every row in the order of the log ``t`` in int ns, ``w`` in rad/s, ``f``, the specific
        force, and ``q``, the orientation of the sensor as a Rotation
    `options`: as `quatprop.propagate` takes them; those that say where the numbers are in the file
        are passed over; ``bias`` in rad/s, series in files as ``(t, Rotation)``, a calibration as
        matrix and bias
    """
    mount = mounting(options.get("mount"))
    matrix, own_bias = options.get("calibration", (np.eye(3), (0, 0, 0)))
    rows, rate = used(raw["t"], raw["w"], options)
    t = raw["t"][rows]
    bias = np.broadcast_to(options.get("bias", own_bias), raw["w"].shape)
    rate = (rate - bias[rows]) @ matrix.T
    if options.get("rates", "body") == "body":
        rate = mount.apply(rate)
    of_log = options.get("q0") in ("level", "log")
    if options.get("rates") == "inertial" and "mount" in options and not of_log:
        raise Refused("a mount that turns nothing")
    q0 = initial(raw, options, int(t[0]), mount).as_matrix()
    steps = np.diff(t)
    usual = 10 * int(np.median(steps[steps > 0])) if (steps > 0).any() else 2**63 - 1
    limit, on_gap = options.get("max_gap", usual), options.get("on_gap", "hold")
    if on_gap == "error" and (steps > limit).any():
        raise Refused("a gap")
    cuts = np.flatnonzero(steps > limit) + 1 if on_gap in {"zero", "split"} else []
    wanted = times(t, options)
    stamps, attitudes, q = [], [], q0
    edges = [0, *cuts, len(t)]
    for first, last in pairwise(edges):
        q = q0 if on_gap == "split" else q
        piece = slice(first, last)
        at = t[piece] if wanted is None else wanted[(wanted >= t[first]) & (wanted <= t[last - 1])]
        rows, q = segment(t[piece], rate[piece], q, at, options)
        stamps += at.tolist()
        attitudes += rows
        if on_gap == "zero" and wanted is not None and last < len(t):
            inside = wanted[(wanted > t[last - 1]) & (wanted < t[last])].tolist()
            stamps += inside
            attitudes += [q] * len(inside)
    if not stamps:
        raise Refused("no attitude at the times asked for")
    keep = slice(None, None, options.get("every", 1))
    return np.array(stamps[keep]), Rotation.from_matrix(np.array(attitudes[keep]))


class Refused(Exception):  # noqa: N818  # that is what the command does
    """The requested policy is an error."""


def mounting(text):
    """Return the rotation from sensor to body axes."""
    if text is None:
        return Rotation.identity()
    parts = text.split(",")
    if len(parts) == 4:
        return Rotation.from_quat([float(part) for part in parts], scalar_first=True)
    matrix = np.zeros((3, 3))
    for row, part in enumerate(parts):
        matrix[row, AXES[part[-1]]] = -1 if part[0] == "-" else 1
    return Rotation.from_matrix(matrix)


def used(t, rate, options):
    """Return the rows that the policies and the part leave, in the order of use, and their rates.

    First what goes backwards, then the part, then what is not finite.
    """
    rows = ordered(t, options)
    if options.get("on_backwards", "error") == "error" and rows != list(range(len(t))):
        raise Refused("outliers, or stamps that go backwards")
    low, high = part(options, t, rows)
    rows = [row for row in rows if low <= int(t[row]) <= high]
    rates, last = {}, None
    for row in rows:
        if np.isfinite(rate[row]).all():
            rates[row] = last = rate[row]
        elif options.get("on_nonfinite") == "hold" and last is not None:
            rates[row] = last
        elif options.get("on_nonfinite") != "drop":
            raise Refused("a rate that is not finite")
    rows = [row for row in rows if row in rates]
    if not rows:
        raise Refused("no samples")
    return np.array(rows, int), np.array([rates[row] for row in rows])


def part(options, t, rows):
    """Return the first and the last stamp of the part, given the rows in order."""
    low, high = (
        instant(options[name], t, rows, name) if name in options else limit
        for name, limit in (("start", -(2**63)), ("end", 2**63))
    )
    second, first = int(t[rows[:2][-1]]), int(t[rows[0]])
    for name in ("start", "end"):
        ns = options[name][1] if is_date(options.get(name)) else options.get(name)
        if isinstance(ns, int) and 0 < ns < min(10**6, second):
            raise Refused("a number that is meant in seconds")
        if name == "start" and isinstance(ns, int) and ns > 0 and first // ns >= 100_000:
            raise Refused("a start that is meant in seconds")
    if low > high:
        raise Refused("a start after the end")
    return low, high


def ordered(t, options):
    """Return the rows that --on-backwards leaves, in the order of use."""
    stamps, ahead = t.tolist(), outliers(t.tolist())
    back = sum(b < a for a, b in pairwise(stamps)), sum(b > a for a, b in pairwise(stamps))
    if options.get("on_backwards") == "sort" and ahead and back[0] > back[1]:
        ahead = {len(t) - 1 - row for row in outliers(stamps[::-1])}
    kept = [row for row in range(len(t)) if row not in ahead]
    if options.get("on_backwards") == "sort":
        others = sorted(stamps[row] for row in kept)
        intervals = [b - a for a, b in pairwise(others) if b > a]
        last, median = others[-1], np.median(intervals)
        longest = max(1.5 * median, *(each for each in intervals if each <= 10 * median))
        for row in sorted(ahead, key=stamps.__getitem__):
            after = bisect_left(others, stamps[row])
            inside = 0 < after < len(others)
            if inside and others[after] - others[after - 1] > 1.5 * median:
                kept.append(row)
            elif others[-1] < stamps[row] <= last + longest:
                kept, last = [*kept, row], stamps[row]
        return sorted(sorted(kept), key=stamps.__getitem__)
    rows = kept[:1]
    for row in kept[1:]:
        if stamps[row] >= stamps[rows[-1]]:
            rows.append(row)
    return rows


def outliers(t):
    """Return the rows whose stamps jump ahead, which the next ones contradict."""
    found = set()
    for j in range(1, len(t)):
        if t[j] >= t[j - 1]:
            continue
        following = sorted(t[j : j + 8])
        middle = following[(len(following) - 1) // 2]
        k = j
        while k > 0 and t[k - 1] > middle:
            k -= 1
        run = j - k
        if not 0 < run <= 32:
            continue
        before = t[k - 1] if k else middle
        following = t[j : j + max(run + 1, 8)]
        back = [s for s in following if s <= before or s - before < t[k] - s]
        contradicts = t[j] in back and 2 * len(back) > len(following)
        enough = len(back) >= run if k else len(back) > run
        span = max(max(back, default=before) - before, 0)
        far = 10 * span < (t[k] - before) * len(back) and (span > 0 or len(back) >= 8)
        if contradicts and enough and far:
            found.update(range(k, j))
    return found


def is_date(value):
    """Tell whether a time is a date with its ns."""
    return isinstance(value, tuple) and value[0] == "date"


def instant(value, t, rows, name):
    """Return an instant on the clock of the log: ns, or from an end of the log such as +200ms."""
    if isinstance(value, int):
        return value
    if isinstance(value, str):
        value = value[0], abs(int(value.removesuffix("ms"))) * NS // 1000
    origin, ns = value
    first, last = int(t[rows[0]]), int(t[rows[-1]])
    # A start that is longer ago than the log is its first sample.
    return {"date": ns, "+": first + ns, "-": max(last - ns, first if name == "start" else 0)}[
        origin
    ]


def initial(raw, options, t0, mount):
    """Return the attitude at the first sample used."""
    q0 = options.get("q0", (1, 0, 0, 0))
    if q0 == "log":
        row = np.flatnonzero(raw["t"] == t0)[0]
        return raw["q"][row] * mount.inv()
    if q0 == "level":
        first = (raw["t"] >= t0) & (raw["t"] <= t0 + NS)
        down = options.get("reference_z") == "down"
        # The shortest turn that brings the force upright, and the heading that then remains.
        x, y, z = mount.apply(raw["f"][first].mean(axis=0)) * (-1 if down else 1)
        roll, pitch = np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))
        return Rotation.from_euler("ZYX", [radians(options.get("heading", 0)), pitch, roll])
    if isinstance(q0[1], Rotation):
        if not q0[0][0] <= t0 <= q0[0][-1]:
            raise Refused("a first sample outside of the series")
        # As floats, stamps of today would be 256 ns apart.
        return Slerp((q0[0] - t0) / NS, q0[1])(0.0)
    return Rotation.from_quat(
        q0, scalar_first=options.get("q0_layout", "wxyz") in {"wxyz", "scalar-first"}
    )


def times(t, options):
    """Return the stamps at which attitudes are wanted; None for those of the samples."""
    if "rate" in options:
        rate = Fraction(str(options["rate"]))
        count = int((int(t[-1] - t[0]) + 1) * rate / NS) + 2
        wanted = np.array([int(t[0]) + round(k * NS / rate) for k in range(count)])
        return wanted[wanted <= t[-1]]
    if "at" in options:
        return np.sort(options["at"][0])
    return None


def segment(t, rate, q, at, options):
    """Return the attitudes at some stamps within samples without gaps, and the last attitude."""
    body = options.get("rates", "body") == "body"
    how = options.get("method", "start"), 1 if body else -1
    whole = matrices([rotation_vector(t, rate, k, ns, *how) for k, ns in enumerate(np.diff(t))])
    before = np.searchsorted(t, at, side="right") - 1
    part = matrices(
        [
            rotation_vector(t, rate, k, ns - t[k], *how) if ns > t[k] else np.zeros(3)
            for k, ns in zip(before, at, strict=True)
        ]
    )
    attitudes = [q]
    for step in whole:
        attitudes.append(attitudes[-1] @ step if body else step @ attitudes[-1])
    rows = [
        attitudes[k] @ step if body else step @ attitudes[k]
        for k, step in zip(before, part, strict=True)
    ]
    return rows, attitudes[-1]


def matrices(rotvecs):
    """Return rotation matrices of rotation vectors."""
    rows = np.reshape(rotvecs, (-1, 3)).astype(float)
    return Rotation.from_rotvec(rows).as_matrix() if len(rows) else []
