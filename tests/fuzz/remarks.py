"""Logs of sensors that are well: of none may a remark be made.

``make fuzz``, or ``python -m fuzz.remarks [--first SEED] [--count N]``. Each seed is a log: a
motion, a sample rate from 10 to 8,000 Hz, a step of the rates from 1e-5 to 1 deg/s, noise from none
to ten steps, stored in single or double precision. The remarks are printed.
"""

import sys
import warnings

import numpy as np
from fuzz import seeds

from quatprop import GyroSeries, propagate

RATES_HZ = (10, 25, 50, 100, 200, 400, 1000, 2000, 4000, 8000)
MOTIONS = ("swing", "pendulum", "vehicle", "turntable", "by hand", "rest")
SAMPLES = 6000
EVERY_RATE_EQUAL = {"frozen", "zero-rates"}
"""The remarks on a sensor at rest with less noise than a step, which are true of it."""


def shape(motion, t_s, rng, hertz):
    """Return rates of a motion that changes about so often a second, up to about 1, ``(N, 3)``."""
    part = t_s / t_s[-1]
    match motion:
        case "pendulum":  # all peaks are equal
            axis = np.eye(3)[rng.integers(3)]
            return np.sin(2 * np.pi * hertz * t_s + rng.uniform(0, 6))[:, None] * axis
        case "vehicle":
            walk, width = rng.normal(size=(len(t_s), 3)), max(int(1 / (t_s[1] * hertz * 4)), 1)
            for _ in range(3):
                walk = np.apply_along_axis(np.convolve, 0, walk, np.ones(width) / width, "same")
            return walk / np.abs(walk).max()
        case "turntable":  # rests, turns steadily, rests, turns steadily the other way, rests
            speed = [0, 0, 1, 1, 0, 0, -0.7, -0.7, 0, 0]
            at = [0, 0.2, 0.25, 0.45, 0.5, 0.6, 0.65, 0.85, 0.9, 1]
            axis = rng.normal(size=3)
            return np.interp(part, at, speed)[:, None] * axis / np.abs(axis).max()
        case "rest":
            return np.zeros((len(t_s), 3))
    waves = [
        rng.uniform(0.2, 1) * np.sin(2 * np.pi * rng.uniform(0.1, 1) * hertz * t_s + phase)
        for phase in rng.uniform(0, 2 * np.pi, 9)
    ]
    swing = np.transpose([sum(waves[axis::3]) for axis in range(3)])
    window = np.clip(3 - 10 * np.abs(part - 0.5), 0, 1)[:, None]
    return window**2 * (3 - 2 * window) * swing if motion == "by hand" else swing


def well_log(seed):
    """Return a log by its number, and how it was made."""
    rng = np.random.default_rng(seed)
    hz, motion = RATES_HZ[seed % len(RATES_HZ)], MOTIONS[seed % len(MOTIONS)]
    step = 10 ** rng.uniform(-5, 0)
    noise = step * rng.choice([0.0, 0.1, 0.3, 0.7, 2.0, 10.0])
    t_s = np.arange(SAMPLES) / hz
    # Slow enough for the sample rate; and no step from one sample to the next is large.
    hertz = min(hz / 40, rng.uniform(0.3, 5))
    largest = min(rng.uniform(30, 1500), 7.5 * hz)
    degrees = largest * shape(motion, t_s, rng, hertz) + noise * rng.normal(size=(SAMPLES, 3))
    degrees += rng.uniform(-1, 1, 3) * min(1.0, 20 * step)
    rate = np.radians(np.rint(degrees / step) * step)
    if rng.random() < 0.5:
        rate = rate.astype(np.float32)
    how = f"{motion} at {hz} Hz, {largest:.3g} deg/s, {hertz:.2g} Hz"
    how += f", step {step:.3g}, noise {noise:.3g}"
    return GyroSeries(np.rint(t_s * 1e9).astype(np.int64) + 1_700_000_000 * 10**9, rate), how


def false_remarks(seed):
    """Return the remarks on a log that are not true of it, and how it was made."""
    series, how = well_log(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        said = propagate(series).report.remarks
    is_constant = bool((series.rate == series.rate[0]).all())
    return [one for one in said if not (is_constant and one.code in EVERY_RATE_EQUAL)], how


def judged(seed):
    """Return the motion of a log, and the remarks on it that are not true."""
    said, how = false_remarks(seed)
    return how.partition(" at ")[0], "".join(f"{how}: {remark}; " for remark in said)


if __name__ == "__main__":
    sys.exit(bool(seeds.main(__doc__, judged)))
