"""Rates to attitudes, in memory: the tiled product against loops."""

import math
from pathlib import Path

import numba
import numpy as np
from accuracy import scipy_loop
from ahrs.filters import AngularRate
from table import Table, best_of

from quatprop.kinematics.propagate import attitudes

IDENTITY = [1.0, 0.0, 0.0, 0.0]
SLOW_SAMPLES = 20_000
"""Loops of microseconds a sample are timed on so many."""


def loop(t_ns, rate, out):
    """Multiply step by step, with arrays or with lists."""
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    out[0] = (w, x, y, z)
    for k in range(len(t_ns) - 1):
        half_dt = (t_ns[k + 1] - t_ns[k]) * 0.5e-9
        a, b, c = rate[k][0] * half_dt, rate[k][1] * half_dt, rate[k][2] * half_dt
        half = math.sqrt(a * a + b * b + c * c)
        sinc = math.sin(half) / half if half > 0 else 1.0
        d, a, b, c = math.cos(half), a * sinc, b * sinc, c * sinc
        w, x, y, z = (
            w * d - x * a - y * b - z * c,
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
        )
        length = math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / length, x / length, y / length, z / length
        out[k + 1] = (w, x, y, z)


def measure(_folder: Path, samples: int) -> None:
    """Print one table of products."""
    t_ns = np.arange(samples, dtype=np.int64) * 1_000_000
    rate = np.random.default_rng(1).normal(0.0, 1.0, (samples, 3))
    out = np.empty((samples, 4))
    compiled = numba.njit(loop)
    compiled(t_ns[:2], rate[:2], out)
    table = Table(f"increments and product of {samples:,} samples, one thread")
    for method in ("start", "coning", "cubic", "quintic"):
        seconds = best_of(5, lambda method=method: attitudes(t_ns, rate, method=method))
        table.row(f"quatprop, {method}", seconds, samples)
    table.row("numba serial loop", best_of(5, lambda: compiled(t_ns, rate, out)), samples)
    few = t_ns[:SLOW_SAMPLES], rate[:SLOW_SAMPLES]
    lists = [*(one.tolist() for one in few), [()] * SLOW_SAMPLES]
    for name, work in {
        "plain Python loop": lambda: loop(*lists),
        "scipy Rotation loop": lambda: scipy_loop(*few, IDENTITY, "start"),
        "ahrs AngularRate": lambda: AngularRate(gyr=few[1], frequency=1000.0),
    }.items():
        table.row(name, best_of(2, work), len(few[0]))
