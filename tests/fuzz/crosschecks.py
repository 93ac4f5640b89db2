"""Cross-checks of simulated rigs: faults that are not found, and what is said that is not true.

``python -m fuzz.crosschecks [--first SEED] [--count N]`` (in ``tests/``): of four rigs one is
sound, two have one fault and one has two or three. Then the pulls of the numbers that are
stated: their errors over their standard deviations.
"""

import sys
from collections import Counter, defaultdict
from dataclasses import replace
from itertools import permutations, product

import numpy as np
from fuzz import seeds
from make.rigs import crosscheck

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotation_matrix, slerp
from quatprop.tools.crosscheck.sources import Source

DEG, HZ = np.pi / 180, 500
GYRO, ORIENTATION, MOCAP, OTHER = "/imu rates", "/imu orientation", "/mocap", "/imu2"

SIGNED = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
]
"""The 48 signed permutations of three axes."""

EXCLUDE = (
    {"deg/s", "pi/180", "scale", "dead"},
    {"axes", "mirrored", "inertial", "dead", "dead axis", "bias"},
    {"layout", "conjugate", "layout, conjugate", "inertial"},
    {"reversed", "late", "clock", "mount"},
    {"dead", "frozen"},
)
"""Faults of which a rig has one, as together they are another or cannot be seen."""

EQUAL = {
    # Of motion about one axis, half a turn about another looks like the conjugate.
    "conjugate": {("axes", ORIENTATION)},
    "mount": {("axes", MOCAP), ("mount", "/imu")},
    "late": {("offset", "/imu")},
    "clock": {("clock", "/imu")},
    "axes": {("axes", ORIENTATION), ("axes", "/imu"), ("reading", ORIENTATION), ("mount", GYRO)},
    "layout": {("axes", ORIENTATION)},
    "layout, conjugate": {("axes", ORIENTATION)},
    "reversed": {("reversed", "/imu")},
    "inertial": {("reading", ORIENTATION)},
}
"""Other true names of what was planted: either of two sources, or of the same rotation."""

PULLS = defaultdict(list)


def moving(random, kind):
    """Return times, s, rates and attitudes of a motion of one to two and a half minutes."""
    t_s = np.arange(0, random.uniform(60, 150), 1 / HZ)
    rate = np.zeros((len(t_s), 3))
    for frequency in np.exp(random.uniform(np.log(0.03), np.log(1.5), 12)):
        phase = 2 * np.pi * frequency * t_s[:, None] + random.uniform(0, 6.3, 3)
        rate += random.normal(size=3) * np.sin(phase)
    rate *= np.exp(random.uniform(np.log(8), np.log(60))) * DEG / rate.std(axis=0)
    rate *= [0.03, 0.03, 1.0] if kind == "planar" else 1.0
    return t_s, rate, attitudes(np.rint(t_s * 1e9).astype(np.int64), rate, method="coning")


def rates(random, motion, hz, name):
    """Return a gyroscope on a motion."""
    times = np.arange(2, motion[0][-1] - 2, 1 / hz) + random.uniform(0, 0.3) / hz
    values = np.stack([np.interp(times, motion[0], column) for column in motion[1].T], axis=1)
    noise = random.uniform(0.004, 0.02) * np.sqrt(hz) * DEG
    values += noise * random.normal(size=values.shape) + 0.05 * DEG * random.normal(size=3)
    return Source(name=name, kind="rates", device=_device(name), t_ns=_ns(times), values=values)


def orientation(random, motion, times, name, slow):
    """Return an orientation on a motion: its error is white, or that of a filter if `slow`, s."""
    t_s, _, wxyz = motion
    after = np.clip(np.searchsorted(t_s, times), 1, len(t_s) - 1)
    seen = slerp(wxyz[after - 1], wxyz[after], (times - t_s[after - 1]) * HZ)
    error = 0.05 * DEG * random.normal(size=(len(times), 3))
    if slow:
        count = round(slow / (times[1] - times[0]))
        error = [np.convolve(column, np.ones(count) / count, "same") for column in error.T]
        error = 0.5 * DEG * np.stack(error, axis=1) / np.std(error)
    frame = exp(np.array([0.0, 0.0, random.uniform(-3, 3)]))
    return Source(
        name=name, kind="orientation", device=_device(name), t_ns=_ns(times),
        values=multiply(frame, multiply(seen, exp(error))), layout="scalar-last",
    )  # fmt: skip


def rig(random, kind):
    """Return the sources of a sound rig, by name."""
    motion = moving(random, kind)
    gyro = rates(random, motion, random.choice([50, 100, 200, 400]), GYRO)
    imu_times = gyro.t_ns * 1e-9
    times = np.arange(2, motion[0][-1] - 2, 1 / random.choice([30, 100, 120]))
    found = [gyro, orientation(random, motion, imu_times, ORIENTATION, 2.0)]
    found += [orientation(random, motion, times + 0.003, MOCAP, 0.0)]
    if random.random() < 0.5:
        found += [rates(random, motion, 100, OTHER)]
    return {one.name: one for one in found}


def _device(name):
    return name.partition(" ")[0]


def _ns(times):
    return np.rint(times * 1e9).astype(np.int64)


def _direction(random):
    axis = random.normal(size=3)
    return axis / np.linalg.norm(axis)


def _gyro(change):
    return lambda random, one: (GYRO, replace(one[GYRO], values=change(random, one[GYRO])), None)


def _orientation(change, layout="scalar-last"):
    return lambda random, one: (  # noqa: ARG005
        ORIENTATION,
        replace(one[ORIENTATION], values=change(one[ORIENTATION].values), layout=layout),
        None,
    )


def _turned_axes(sign):
    every = [one for one in SIGNED if np.linalg.det(one) * sign > 0 and (one != np.eye(3)).any()]
    return lambda random, one: one.values @ every[random.integers(len(every))].T


def _frozen(random, one):
    values, at = one.values.copy(), int(len(one.values) * random.uniform(0.2, 0.6))
    values[at : at + int(random.uniform(2, 8) / one.interval)] = values[at]
    return values


def _dead_axis(random, one):
    values = one.values.copy()
    values[:, random.integers(3)] = 0.01 * random.normal()
    return values


def _scale(random, one):
    factor = np.exp(random.choice([-1, 1]) * random.uniform(0.05, 0.3))
    return GYRO, replace(one[GYRO], values=factor * one[GYRO].values), ("factor", 1 / factor)


def _bias(random, one):
    bias = _direction(random) * random.uniform(0.8, 3) * DEG
    return GYRO, replace(one[GYRO], values=one[GYRO].values + bias), None


def _mount(random, one):
    turn = _direction(random) * random.uniform(6, 40) * DEG
    values = multiply(one[MOCAP].values, exp(turn))
    return MOCAP, replace(one[MOCAP], values=values), ("deg", np.linalg.norm(turn) / DEG)


def _late(random, one):
    offset = random.choice([-1, 1]) * random.uniform(0.03, 0.2)
    late = replace(one[MOCAP], t_ns=one[MOCAP].t_ns + round(offset * 1e9))
    return MOCAP, late, ("ms", 1e3 * abs(offset))


def _clock(random, one):
    ratio, t_ns = random.choice([-1, 1]) * random.uniform(4e-4, 2e-3), one[MOCAP].t_ns
    fast = t_ns + np.rint((t_ns - t_ns[0]) * ratio).astype(np.int64)
    return MOCAP, replace(one[MOCAP], t_ns=fast), ("ppm", 1e6 * abs(ratio))


def _reversed(random, one):  # noqa: ARG001
    return MOCAP, replace(one[MOCAP], values=one[MOCAP].values[::-1].copy()), None


def _turning(random, one):
    source = one[ORIENTATION]
    size = random.choice([-1, 1]) * random.uniform(0.6, 4)
    turn = (source.t_ns - source.t_ns[0])[:, None] * 1e-9 * np.array([[0, 0, size * DEG]])
    values = multiply(exp(turn), source.values)
    return ORIENTATION, replace(source, values=values), ("deg_s", abs(size))


def _inertial(random, one):  # noqa: ARG001
    turned = np.einsum("nij,nj->ni", rotation_matrix(one[ORIENTATION].values), one[GYRO].values)
    return GYRO, replace(one[GYRO], values=turned), None


FAULTS = {
    "deg/s": ("unit", _gyro(lambda _, one: one.values / DEG)),
    "pi/180": ("unit", _gyro(lambda _, one: one.values * DEG)),
    "scale": ("scale", _scale),
    "axes": ("axes", _gyro(_turned_axes(1))),
    "mirrored": ("mirrored", _gyro(_turned_axes(-1))),
    "bias": ("bias", _bias),
    "dead": ("dead", _gyro(lambda _, one: 0 * one.values)),
    "dead axis": ("dead-axis", _gyro(_dead_axis)),
    "frozen": ("frozen", _gyro(_frozen)),
    "inertial": ("inertial", _inertial),
    "conjugate": ("reading", _orientation(conjugate)),
    "layout": ("reading", _orientation(lambda q: np.roll(q, -1, axis=1), "scalar-first")),
    "layout, conjugate": (
        "reading", _orientation(lambda q: np.roll(conjugate(q), -1, axis=1), "scalar-first")),
    "turns": ("drift", _turning),
    "mount": ("mount", _mount),
    "late": ("offset", _late),
    "clock": ("clock", _clock),
    "reversed": ("reversed", _reversed),
}  # fmt: skip
"""Fault -> the code of its finding, and what makes it."""


def _chosen(random, seed):
    """Return the faults of a rig."""
    names = [*FAULTS]
    if seed % 4 < 2:  # one fault in half of the rigs
        return [names[seed // 2 % len(names)]]
    kept = []
    if seed % 4 == 3:
        for name in random.permutation(names)[: random.integers(2, 4)]:
            if not any(name in each and set(kept) & each for each in EXCLUDE):
                kept.append(str(name))
    return kept


def judged(seed):
    """Return the kind of a rig, and what of it was missed or is not true."""
    random = np.random.default_rng([seed, 49])
    kind = "planar" if seed % 10 == 9 else "full"
    faulty, wanted = rig(random, kind), {}
    faults = _chosen(random, seed)
    for name in sorted(faults, key=lambda one: one in {"deg/s", "pi/180"}):
        source, changed, number = FAULTS[name][1](random, faulty)
        faulty[source] = changed
        wanted[name] = ({(FAULTS[name][0], source), *EQUAL.get(name, set())}, number)
    findings = [*crosscheck([*faulty.values()]).findings]
    missed = []
    for name, (codes, number) in wanted.items():
        hit = next((one for one in findings if (one.code, one.source) in codes), None)
        if hit is None:
            missed.append(name)
            continue
        findings.remove(hit)
        if number and hit.code == FAULTS[name][0]:
            stated = hit.numbers[number[0]]
            sigma = hit.numbers[f"sigma_{number[0]}" if number[0] != "factor" else "sigma"]
            near = min((stated, 1 / stated), key=lambda x: abs(x - number[1]))
            value = near if number[0] == "factor" else abs(stated)
            PULLS[name].append((value - number[1]) / sigma)
    untrue = [f"{one.code} of {one.source}: {one.text}" for one in findings]
    told = "; ".join([*(f"missed {one}" for one in missed), *untrue])
    return (f"{len(faults)} faults" if faults else "sound"), told and f"{kind} {faults}: {told}"


if __name__ == "__main__":
    found = seeds.main(__doc__, judged, count=100)
    for name, pulls in PULLS.items():
        beyond = Counter(abs(one) > 4 for one in pulls)[True]
        size = np.sqrt(np.mean(np.square(pulls)))
        print(f"{name}: {len(pulls)} numbers, pull {size:.2f}, {beyond} beyond 4 sigma")
    sys.exit(bool(found))
