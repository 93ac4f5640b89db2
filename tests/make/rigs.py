"""Simulated rigs of an IMU with an orientation and a motion capture, and faults of these."""

from dataclasses import replace
from functools import cache

import numpy as np

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotation_matrix, slerp
from quatprop.tools.crosscheck import analysis
from quatprop.tools.crosscheck.sources import Source

DEG, FINE, SECONDS = np.pi / 180, 500, 40
GYRO, ORIENTATION, MOCAP = "/imu rates", "/imu orientation", "/mocap"


@cache
def motion(seed=0, kind="full"):
    """Return times, s, rates and attitudes of a smooth motion; `kind`: full, planar or rests."""
    random = np.random.default_rng(seed)
    t_s = np.arange(SECONDS * FINE) / FINE
    rate = np.zeros((len(t_s), 3))
    for frequency in np.exp(random.uniform(np.log(0.05), np.log(1.5), 9)):
        phase = 2 * np.pi * frequency * t_s[:, None] + random.uniform(0, 6.3, 3)
        rate += random.normal(size=3) * np.sin(phase)
    rate *= 25 * DEG / rate.std(axis=0)
    rate *= [0.02, 0.02, 1.0] if kind == "planar" else 1.0
    if kind == "rests":
        rate *= np.clip(3 * np.sin(2 * np.pi * t_s / 15), 0, 1)[:, None]
    return t_s, rate, attitudes(np.rint(t_s * 1e9).astype(np.int64), rate, method="coning")


def attitudes_at(moving, times):
    """Return the attitudes of a motion at the given times, s."""
    t_s, _, wxyz = moving
    after = np.clip(np.searchsorted(t_s, times), 1, len(t_s) - 1)
    part = (times - t_s[after - 1]) * FINE
    return slerp(wxyz[after - 1], wxyz[after], np.clip(part, 0, 1))


def rig(seed=0, kind="full"):
    """Return rates and orientation of an IMU, and a motion capture, by name."""
    moving, random = motion(seed % 7, kind), np.random.default_rng(seed)
    times, capture_times = (
        np.arange(1, SECONDS - 1, 1 / hz) + random.uniform(0, 0.01) for hz in (100, 50)
    )
    rate = np.stack([np.interp(times, moving[0], column) for column in moving[1].T], axis=1)
    rate += 0.1 * DEG * random.normal(size=rate.shape) + 0.05 * DEG * random.normal(size=3)
    steps = random.normal(size=(len(times), 3))
    slow = np.stack([np.convolve(column, np.ones(200) / 200, "same") for column in steps.T], axis=1)
    estimated = multiply(attitudes_at(moving, times), exp(0.3 * DEG * slow / slow.std()))
    seen = attitudes_at(moving, capture_times)
    seen = multiply(seen, exp(0.03 * DEG * random.normal(size=(len(capture_times), 3))))
    frame = exp(np.array([0.0, 0.0, random.uniform(-3, 3)]))
    found = (
        Source(name=GYRO, kind="rates", device="/imu", t_ns=ns(times), values=rate),
        Source(
            name=ORIENTATION, kind="orientation", device="/imu", t_ns=ns(times),
            values=estimated, layout="scalar-last",
        ),
        Source(
            name=MOCAP, kind="orientation", device=MOCAP, t_ns=ns(capture_times),
            values=multiply(frame, seen), layout="scalar-last",
        ),
    )  # fmt: skip
    return {one.name: one for one in found}


def ns(times):
    """Return times in s as ns."""
    return np.rint(times * 1e9).astype(np.int64)


def with_values(name, change):
    """Return a function that changes the values of a source of a rig."""
    return lambda rig: rig | {name: replace(rig[name], values=change(rig[name].values))}


def _read_as(name, change):
    def faulty(rig):
        return rig | {
            name: replace(rig[name], values=change(rig[name].values), layout="scalar-first")
        }

    return faulty


def _late(rig, seconds=0.08):
    return rig | {MOCAP: replace(rig[MOCAP], t_ns=rig[MOCAP].t_ns + round(seconds * 1e9))}


def _slow_clock(rig, ratio=1e-3):
    t_ns = rig[MOCAP].t_ns
    return rig | {MOCAP: replace(rig[MOCAP], t_ns=t_ns + ns((t_ns - t_ns[0]) * 1e-9 * ratio))}


def _turning(rig):
    source = rig[ORIENTATION]
    seconds = (source.t_ns - source.t_ns[0])[:, None] * 1e-9
    turned = multiply(exp(seconds * np.array([[0, 0, 2 * DEG]])), source.values)
    return rig | {ORIENTATION: replace(source, values=turned)}


def _inertial(rig):
    rate, wxyz = rig[GYRO].values, rig[ORIENTATION].values
    turned = np.einsum("nij,nj->ni", rotation_matrix(wxyz), rate)
    return rig | {GYRO: replace(rig[GYRO], values=turned)}


def _frozen(rate):
    rate = rate.copy()
    rate[1500:1900] = rate[1500]
    return rate


def _spiked(rate):
    rate = rate.copy()
    rate[[100, 3000]] = 1e12
    return rate


FAULTS = {
    "deg/s read as rad/s": (with_values(GYRO, lambda w: w / DEG), "unit", GYRO),
    "scaled by pi/180 twice": (with_values(GYRO, lambda w: w * DEG), "unit", GYRO),
    "scale": (with_values(GYRO, lambda w: 1.1 * w), "scale", GYRO),
    "axes": (with_values(GYRO, lambda w: w[:, [1, 0, 2]] * [1, -1, 1]), "axes", GYRO),
    "mirrored": (with_values(GYRO, lambda w: w * [1, -1, 1]), "mirrored", GYRO),
    "bias": (with_values(GYRO, lambda w: w + 1.5 * DEG), "bias", GYRO),
    "dead": (with_values(GYRO, lambda w: 0 * w), "dead", GYRO),
    "dead axis": (with_values(GYRO, lambda w: w * [1, 1, 0]), "dead-axis", GYRO),
    "frozen": (with_values(GYRO, _frozen), "frozen", GYRO),
    "damaged samples": (with_values(GYRO, _spiked), "spikes", GYRO),
    "inertial": (_inertial, "inertial", GYRO),
    "conjugate": (with_values(ORIENTATION, conjugate), "reading", ORIENTATION),
    "layout": (_read_as(ORIENTATION, lambda q: np.roll(q, -1, axis=1)), "reading", ORIENTATION),
    "turns away": (_turning, "drift", ORIENTATION),
    "mount": (
        with_values(MOCAP, lambda q: multiply(q, exp(np.array([0.2, -0.1, 0.1])))), "mount", MOCAP),
    "late": (_late, "offset", MOCAP),
    "clock": (_slow_clock, "clock", MOCAP),
    "reversed": (with_values(MOCAP, lambda q: q[::-1].copy()), "reversed", MOCAP),
}  # fmt: skip
"""Name of a fault -> what makes it, the code of its finding, and the source that it is about."""


def _after(name, change):
    """Return a function that changes the values of a source from the middle of a rig on."""

    def faulty(rig):
        values = rig[name].values.copy()
        half = len(values) // 2
        values[half:] = change(values[half:])
        return rig | {name: replace(rig[name], values=values)}

    return faulty


def later(rig, seconds):
    """Return a rig whose motion capture is late from its middle on, s."""
    t_ns = rig[MOCAP].t_ns.copy()
    t_ns[len(t_ns) // 2 :] += round(seconds * 1e9)
    return rig | {MOCAP: replace(rig[MOCAP], t_ns=t_ns)}


CHANGES = {
    "scale": (_after(GYRO, lambda w: 3 * w), GYRO, "it turns 3.0"),
    "unit": (_after(GYRO, lambda w: w / DEG), GYRO, "it turns 57."),
    "axes": (_after(GYRO, lambda w: w[:, [1, 0, 2]] * [1, -1, 1]), GYRO, "its axes are turned by"),
    "mirror": (_after(GYRO, lambda w: w * [1, -1, 1]), GYRO, "its axes are mirrored"),
    "mount": (
        _after(MOCAP, lambda q: multiply(q, exp(np.array([0.2, -0.1, 0.1])))), MOCAP,
        "its axes are turned by 14"),
    "offset": (lambda rig: later(rig, 0.08), MOCAP, "it is late by another (80|79.9)"),
    "short offset": (lambda rig: later(rig, 0.03), MOCAP, "it is late by another (30|29.9)"),
    "long offset": (lambda rig: later(rig, 2.0), MOCAP, "it is late by another 2000 ms"),
    "conjugate": (_after(ORIENTATION, conjugate), ORIENTATION, "it has another direction"),
}  # fmt: skip
"""Change in the middle of a log -> the function that makes it, the source, and the finding."""


def crosscheck(sources, **options):
    """Return the cross-check of sources."""
    return analysis.crosscheck(sources, **options).result
