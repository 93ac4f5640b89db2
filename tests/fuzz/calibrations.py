"""Calibrations of simulated pairs: what is stated beyond its deviation, or not shown by the motion.

``python -m fuzz.calibrations [--first SEED] [--count N]`` (in ``tests/``): each motion in turn,
with a bias that walks and jumps, outliers, gaps, clocks that differ by minutes and drift.
"""

import sys
from typing import NamedTuple

import numpy as np
from fuzz import seeds
from scipy.signal import lfilter
from scipy.stats import binom
from scipy.stats import t as student

from quatprop import AttitudeSeries, GyroSeries, calibrate
from quatprop.base.errors import QuatpropError
from quatprop.estimation.fit import BLOCKS
from quatprop.estimation.model import OF_GROUP, Model
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, rotation_matrix, shorter
from quatprop.settings.command_options import GROUPS

MOTIONS = ("rich", "planar", "one axis", "gait", "spin", "rest", "heading")
"""The last one is a body that tilts, with a reference that has its heading alone."""

SINGLE = ("rich", "planar", "one axis", "heading")
"""Motions that do not repeat themselves: only one offset of the clocks fits."""

EACH = 60
"""Pairs of each motion."""

SECONDS, HZ = 90, 1000
SPARE = 5
"""Seconds by which the log is longer than its reference, at either end."""

DEG = np.pi / 180
BEYOND = 4.0
"""Deviations that are not to be seen but by chance."""

CHANCE = 2 * student.sf(BEYOND, BLOCKS - 1)
"""With which errors are beyond these: as many parts show the deviation."""

BETTER = 3.0
"""A parameter that noise this much smaller does not show must not be stated."""


WORSE = 1.05
"""Errors by which a file that was written would be missed."""


class Pair(NamedTuple):
    """A log and its reference, and what is true of them.

    `truth`: the errors that were planted
    `true`, `raw`: rates without noise, every 10 ms: of the body, and as the sensor has them
    `density`: noise of the rates, rad/s/sqrt(Hz)
    `noise`: of the reference, rad
    `shown`: which parameters an estimator would find with less noise, shape ``(14,)``
    `options`: what a user who knows the clock would give
    """

    rates: GyroSeries
    reference: AttitudeSeries
    truth: Model
    true: np.ndarray
    raw: np.ndarray
    density: float
    noise: float
    shown: np.ndarray
    options: dict


def _band(random, hi, rms):
    """Return a smooth series of frequencies up to `hi`, Hz."""
    count = SECONDS * HZ
    f = np.fft.rfftfreq(count, 1 / HZ)
    spectrum = np.zeros(len(f), complex)
    inside = (f > 0) & (f < hi)
    spectrum[inside] = random.normal(size=(2, inside.sum())).T @ [1, 1j]
    series = np.fft.irfft(spectrum, count)
    return np.append(series, series[0]) * rms / series.std()


def _moving(random, motion, t_s):
    """Return body rates of a motion, and the attitudes that a reference shows."""
    still = np.zeros_like(t_s)
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    if motion == "heading":
        roll, pitch = (_band(random, 1.0, random.uniform(2, 12) * DEG) for _ in range(2))
        yaw = np.cumsum(_band(random, 0.5, random.uniform(0.2, 0.6))) / HZ
        q = exp(np.stack([still, still, yaw], axis=1))
        for axis, angle in ((1, pitch), (0, roll)):
            q = multiply(q, exp(angle[:, None] * np.eye(3)[axis]))
        # Exact rates at the stamps, to fourth order of the step.
        steps = log(shorter(multiply(conjugate(q[:-1]), q[1:]))) * HZ
        rate = np.concatenate([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])
        return rate, exp(np.stack([still, still, yaw], axis=1))
    if motion == "rich":
        rate = np.stack(
            [_band(random, random.uniform(0.5, 3), random.uniform(0.3, 2)) for _ in "xyz"], 1
        )
    elif motion == "planar":
        rate = np.stack([still, still, _band(random, 0.5, 0.4)], axis=1)
    elif motion == "one axis":
        rate = _band(random, 1.0, 1.0)[:, None] * _direction(random)
    elif motion == "gait":
        phase = 2 * np.pi * random.uniform(0.7, 1.5) * t_s
        a, b, c = random.uniform(0, 6, 3)
        rate = np.stack([np.sin(phase + a), np.sin(2 * phase + b) / 2, 0.4 * np.cos(phase + c)], 1)
    elif motion == "spin":
        rate = np.tile(_direction(random) * random.uniform(0.5, 2), (len(t_s), 1))
    else:
        rate = np.zeros((len(t_s), 3))
    q = multiply(exp(random.normal(size=3)), attitudes(t_ns, rate, method="quintic"))
    return rate, q


def _direction(random):
    axis = random.normal(size=3)
    return axis / np.linalg.norm(axis)


def _planted(random, motion):
    """Return a model, within the priors where the motion does not show it."""
    values = np.zeros(len(OF_GROUP))
    if random.random() < 0.15:  # a gyroscope without errors
        return Model()
    sizes = {"bias": 1 * DEG, "scale": 0.02, "misalignment": 1 * DEG, "drift": 30e-6}
    for name, size in sizes.items():
        values[name == OF_GROUP] = size * random.normal(size=(name == OF_GROUP).sum())
    is_free = motion in ("rich", "gait")
    angles = [0, 3, 20, 90, 170] if is_free else [0, 1, 3, 10]
    values[OF_GROUP == "mount"] = _direction(random) * random.choice(angles) * DEG
    if motion in SINGLE and random.random() < 0.3:
        values[OF_GROUP == "drift"] = random.choice([-300e-6, 300e-6])
    return Model().with_increment(values)


def pair(seed, motion):
    """Return a pair of a motion."""
    random = np.random.default_rng([48, MOTIONS.index(motion), seed])
    t_s = np.arange(SECONDS * HZ + 1) / HZ
    rate, of_reference = _moving(random, motion, t_s)
    truth, is_single = _planted(random, motion), motion in SINGLE
    log_hz, reference_hz = int(random.choice([100, 200])), int(random.choice([20, 50, 100]))
    density = 10 ** random.uniform(-3, -1.3) * DEG
    noise = 10 ** random.uniform(-2, 0) * DEG
    k = np.arange(0, len(t_s), HZ // log_hz)
    varies = _varying(random, t_s[k])
    raw = rate[k] @ np.linalg.inv(truth.matrix).T
    measured = raw + truth.bias + varies
    measured += random.normal(size=raw.shape) * density * np.sqrt(log_hz)
    j = np.arange(SPARE * HZ, len(t_s) - SPARE * HZ, HZ // reference_hz)
    # The bias that is true is its mean while the reference is there.
    during = (t_s[k] >= t_s[j[0]]) & (t_s[k] <= t_s[j[-1]])
    truth = truth._replace(bias=truth.bias + varies[during].mean(axis=0))
    offset = random.normal() / max(30, reference_hz)
    if is_single and random.random() < 0.5:
        offset += random.uniform(-200, 200)
    middle_s = t_s[j].mean()
    truth = truth._replace(offset=offset)
    errors = _errors(random, len(j), reference_hz, noise)
    wxyz = multiply(of_reference[j], exp(errors))
    # gyroscope's time = reference's + offset + drift (reference's - middle)
    since = (t_s[j] - middle_s) / (1 + truth.drift)
    t_reference = middle_s - offset + since
    keep = _without_gaps(random, t_s[j])
    log_ns, reference_ns = (np.rint((each + 1000) * 1e9) for each in (t_s[k], t_reference))
    log_kept = _without_gaps(random, t_s[k])
    raw_10ms = rate[::10] @ np.linalg.inv(truth.matrix).T + truth.bias
    # A user gives a clock that motion that repeats itself does not show.
    options = {} if is_single or motion in ("spin", "rest") else {"time_offset": "0s"}
    if motion in ("spin", "rest") and random.random() < 0.5:
        options = {"time_offset": "0s"}
    seen = rate if motion != "heading" else np.stack([0 * t_s, 0 * t_s, rate[:, 2]], axis=1)
    sigma = np.hypot(density, noise / np.sqrt(reference_hz)) / BETTER
    axes = [2] if motion == "heading" else [0, 1, 2]
    shown = _shown(seen[::20], truth, sigma, reference_hz, axes)
    return Pair(
        GyroSeries(log_ns.astype(np.int64), measured)[log_kept],
        AttitudeSeries(reference_ns.astype(np.int64), wxyz)[keep],
        truth, rate[::10], raw_10ms, density, noise, shown, options,
    )  # fmt: skip


def _varying(random, t_s):
    """Return by how much a bias differs from its beginning, rad/s."""
    varies = np.zeros((len(t_s), 3))
    kind = random.choice(["steady", "walks", "jumps"])
    if kind == "walks":
        steps = random.normal(size=varies.shape) * np.sqrt(np.diff(t_s, prepend=t_s[0]))[:, None]
        varies = np.cumsum(steps, axis=0) * 10 ** random.uniform(-3, -1.5) * DEG
    if kind == "jumps":
        at = random.uniform(0.15, 0.85) * SECONDS
        varies = (t_s[:, None] > at) * _direction(random) * random.uniform(0.1, 2) * DEG
    return varies


def _errors(random, count, hz, noise):
    """Return errors of a reference, rad: white, coloured, or with outliers."""
    errors = random.normal(size=(count, 3)) * noise
    kind = random.choice(["white", "coloured", "outliers"])
    if kind == "coloured":
        kept = np.exp(-1 / hz / random.uniform(0.1, 2))
        errors = 0.3 * errors + lfilter([np.sqrt(1 - kept**2)], [1, -kept], errors, axis=0)
    if kind == "outliers":
        wrong = random.random(count) < 0.01
        errors[wrong] += random.normal(size=(wrong.sum(), 3)) * 0.2
    return errors


def _without_gaps(random, t_s):
    """Return which samples are there."""
    keep = np.ones(len(t_s), np.bool_)
    for _ in range(random.integers(0, 3)):
        at = random.uniform(0.1, 0.9) * SECONDS
        keep &= (t_s < at) | (t_s > at + random.uniform(0.2, 4))
    return keep


def _shown(rate, truth, sigma, hz, axes):
    """Return what is known to half its prior by rates whose noise has this density, ``(14,)``."""
    prior = np.array([GROUPS[name].prior or 1 / hz for name in OF_GROUP])
    interval = 20 / HZ
    raw = rate @ np.linalg.inv(truth.matrix).T
    by = np.zeros((len(rate), 3, len(OF_GROUP)))
    by[..., OF_GROUP == "bias"] = -truth.matrix
    columns = rotation_matrix(truth.mount).T  # of R
    of_scale, of_angle = np.flatnonzero(OF_GROUP == "scale"), OF_GROUP == "misalignment"
    for axis in range(3):
        by[..., of_scale[axis]] = raw[:, axis, None] * columns[axis]
    of_upper = [raw[:, j, None] * columns[i] for i, j in zip(*np.triu_indices(3, 1), strict=True)]
    by[..., of_angle] = np.stack(of_upper, axis=2)
    by[..., OF_GROUP == "mount"] = np.cross(np.eye(3), rate[:, None]).swapaxes(1, 2)
    slope = np.gradient(rate, interval, axis=0)
    since = (np.arange(len(rate)) - len(rate) / 2) * interval
    by[..., OF_GROUP == "offset"] = slope[..., None]
    by[..., OF_GROUP == "drift"] = (slope * since[:, None])[..., None]
    rows = by[:, axes].reshape(-1, len(OF_GROUP)) * prior / (sigma / np.sqrt(interval))
    posterior = np.linalg.inv(rows.T @ rows + np.eye(len(OF_GROUP)))
    return posterior.diagonal() < 0.25


class Verdict(NamedTuple):
    """The faults of a calibration.

    `stated`: number of parameters with a standard deviation
    `beyond`, `unshown`: those with an error beyond, and those that are not shown
    `is_worse`: whether the file makes the rates worse
    `refusal`: the sentence; None
    """

    stated: int = 0
    beyond: tuple[str, ...] = ()
    unshown: tuple[str, ...] = ()
    is_worse: str = ""
    refusal: str | None = None
    pulls: tuple[float, ...] = ()


def judged(one):
    """Return the verdict on the calibration of a pair."""
    try:
        found = calibrate(one.rates, one.reference, **one.options)
    except QuatpropError as error:
        return Verdict(refusal=str(error))
    turn = log(shorter(multiply(found.mount_wxyz, conjugate(one.truth.mount))))
    true = one.truth.values
    errors = np.array([parameter.value for parameter in found.parameters]) - true
    errors[OF_GROUP == "mount"] = turn
    beyond, unshown, pulls = [], [], []
    for error, shown, (group, axis, _, sigma) in zip(
        errors, one.shown, found.parameters, strict=True
    ):
        if sigma is None:
            continue
        size = GROUPS[group].factor
        name = f"{group} {axis}".strip()
        text = f"{name} off by {error * size:+.3g} +- {sigma * size:.2g} ({error / sigma:+.1f})"
        pulls.append(error / sigma)
        if abs(error) > BEYOND * sigma:
            beyond.append(text)
        if not shown:
            unshown.append(text)
    return Verdict(
        len(pulls), tuple(beyond), tuple(unshown), _worse(one, found), None, tuple(pulls)
    )


def _worse(one, found):
    """Return how much worse windows are by a file, noise and all; nothing if they are not.

    Nor if the file is refused.
    """
    if found.is_worse:
        return ""
    length = found.window_ns / 1e9
    noise = np.sqrt(2) * one.noise / length + one.density / np.sqrt(length)
    after = (one.raw - found.bias_rad_s) @ found.matrix.T
    before, after = (
        np.sqrt(((each - one.true) ** 2).mean() + noise**2) for each in (one.raw, after)
    )
    return f"{before:.2g} to {after:.2g} rad/s" if after > WORSE * before else ""


class Study:
    """Verdicts on all pairs."""

    def __init__(self):
        self.stated = self.beyond = 0

    def told(self, seed):
        """Return the motion of a seed, and what is wrong."""
        motion = MOTIONS[seed % len(MOTIONS)]
        verdict = judged(pair(seed // len(MOTIONS), motion))
        self.stated += verdict.stated
        self.beyond += len(verdict.beyond)
        if verdict.refusal is not None:
            return f"{motion}, refused", None
        told = [f"beyond: {text}" for text in verdict.beyond]
        told += [f"not shown: {text}" for text in verdict.unshown]
        told += [f"worse: {verdict.is_worse}"] * bool(verdict.is_worse)
        return motion, f"{motion}: {'; '.join(told)}" if told else None

    @property
    def is_by_chance(self):
        """Whether as few are beyond as chance has, with 99.9 %."""
        return self.beyond <= binom.isf(0.001, max(self.stated, 1), CHANCE)


if __name__ == "__main__":
    study = Study()
    seeds.main(__doc__, study.told, EACH * len(MOTIONS))
    print(f"of {study.stated} stated parameters {study.beyond} are beyond {BEYOND:g} deviations")
    sys.exit(not study.is_by_chance)
