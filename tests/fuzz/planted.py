"""Pairs of attitude series with a planted mistake, and none: simulated, and of recordings.

The gyroscopes have biases and noise, references have other frames, mountings and clocks; each pair
knows which names of causes are true of it.
"""

import tempfile
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
from make.mistakes import AXES, RECORDINGS, Recording
from pyarrow import parquet

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.quaternion import exp, multiply

ALIGNMENTS = ("none", "first", "yaw", "mean", "mount")
LONGEST = 3000
"""Samples of a recording at most."""


@dataclass(frozen=True)
class Source:
    """Attitudes that can be made again with other settings.

    `rates`, `propagate`: what they are propagated from and how, where they are
    `stored`: which of w, x, y, z are stored, in their order, and with which signs
    `read`: how they are read
    """

    series: AttitudeSeries | None = None
    rates: GyroSeries | None = None
    propagate: dict = field(default_factory=dict)
    stored: tuple = ((0, 1, 2, 3), (1, 1, 1, 1))
    read: dict = field(default_factory=lambda: {"from_layout": "scalar-first"})

    def attitudes(self) -> AttitudeSeries:
        """Return the attitudes as they are taken to be."""
        series = self.series or quatprop.propagate(self.rates, **self.propagate)
        order, signs = self.stored
        numbers = np.ascontiguousarray(series.wxyz[:, order] * signs)
        if self.read == {"from_layout": "scalar-first"}:
            return AttitudeSeries(series.t_ns, numbers)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "stored.parquet"
            columns = dict(zip("pqrs", numbers.T, strict=True))
            parquet.write_table(pa.table({"t": series.t_ns, **columns}), path)
            columns = {"time_col": "t", "time_unit": "ns", "quat_cols": "p,q,r,s"}
            found = quatprop.read_attitudes(path, **columns, **self.read)
        return AttitudeSeries(found.t_ns, found.wxyz, read_layout=found.read_layout)


@dataclass(frozen=True)
class Pair:
    """Two series: the names of the mistake that was planted, and of all else that is true."""

    title: str
    planted: frozenset
    true: frozenset
    a: Source
    b: Source
    options: dict


MOTIONS = {
    # Rates, rad/s, at times, s.
    "tumbling": lambda t: _waves(t, [1.3, 2.1, 0.7], [1, 1, 1]),
    "handheld": lambda t: _waves(t, [3.1, 5.0, 2.2], [0.5, 0.4, 0.6]),
    "vehicle": lambda t: _waves(t, [4.0, 3.0, 0.4], [0.02, 0.02, 0.5]),
    "planar": lambda t: _waves(t, [1.0, 1.0, 0.9], [0, 0, 1]),
    "spinning": lambda t: np.array([0, 0, np.pi]) + _waves(t, [1.0, 1.7, 0.3], [0.03, 0.03, 0.1]),
    "precession": lambda t: np.stack([np.cos(t / 2), np.sin(t / 2), 0 * t + 0.5], axis=1),
}


def _waves(t, frequencies, sizes):
    phase = t[:, None] * frequencies + [0.0, 1.0, 2.0]
    return (np.sin(phase) + 0.4 * np.sin(3.3 * phase + 1)) * sizes


def random_rotation(rng, degrees):
    """Return a rotation about an axis of any direction."""
    axis = rng.normal(size=3)
    return exp(np.radians(degrees) * axis / np.linalg.norm(axis))


@cache
def recorded(folder, name):
    """Return rates, a reference and a method of a recording."""
    found = Recording(folder, name)
    # Those of BROAD begin with a rest.
    part = slice(2000, 2000 + 2 * LONGEST, 2) if name.startswith("broad") else slice(LONGEST)
    return GyroSeries(found.t_ns, found.rate)[part], found.reference, found.method


def simulated(rng, name, bias):
    """Return measured rates, a reference and a method."""
    hz = int(rng.choice([50, 100]))
    t_ns = np.round(np.arange(int(rng.choice([20, 40])) * hz) * 1e9 / hz).astype(np.int64)
    rate = MOTIONS[name](t_ns / 1e9)
    truth = quatprop.propagate(GyroSeries(t_ns, rate), method="quintic")
    wxyz = multiply(truth.wxyz, exp(rng.choice([0, 0.05, 0.3]) * 0.01745 * _normal(rng, rate)))
    reference = AttitudeSeries(t_ns, wxyz)
    if rng.random() < 0.3:
        reference = reference[:: int(rng.choice([2, 3]))]
    measured = rate + rng.choice([0, 0.002, 0.01]) * _normal(rng, rate) + bias
    return GyroSeries(t_ns, measured), reference, str(rng.choice(["mean", "coning", "cubic"]))


def _normal(rng, like):
    return rng.normal(size=like.shape)


FIRST, LAST = {"from_layout": "scalar-first"}, {"from_layout": "scalar-last"}
READINGS = {
    # How it is stored, and how it is read by mistake.
    "conjugate": (((0, 1, 2, 3), (1, -1, -1, -1)), FIRST),
    "layout": (((1, 2, 3, 0), (1, 1, 1, 1)), FIRST),
    "layout-first": (((0, 1, 2, 3), (1, 1, 1, 1)), LAST),
    "layout and conjugate": (((1, 2, 3, 0), (-1, -1, -1, 1)), FIRST),
}
KINDS = (
    *("none", "body frame", "reference frame", "conjugate", "conjugate of A", "layout"),
    *("layout-first", "layout and conjugate", "side", "rate sign", "axes", "axes", "scale"),
    *("rate bias", "drift", "time offset", "time offset", "clock drift", "method", "method of one"),
    *("isolated samples", "dead axis", "dead gyro", "missing samples", "saturation", "none"),
)
"""The planted mistakes, in turn."""

FINDINGS = {"dead axis", "dead gyro", "missing samples", "saturation"}
"""Mistakes that no option repairs."""


def pair(number: int, folder: Path | None) -> Pair:
    """Return a pair; the same for the same number.

    `folder`: of the recordings; None: all are simulated
    """
    rng = np.random.default_rng([27, number])
    kind = KINDS[number % len(KINDS)]
    names = [*MOTIONS, *(RECORDINGS if folder else ())]
    name = str(rng.choice(names))
    align = ALIGNMENTS[number // len(KINDS) % len(ALIGNMENTS)]
    is_true = set()
    bias = np.zeros(3)
    if kind == "rate bias" or rng.random() < 0.4:
        bias = rng.normal(size=3) * float(rng.choice([0.002, 0.01]))
        is_true |= {"rate bias", "drift"}
    if name in MOTIONS:
        rates, reference, method = simulated(rng, name, bias)
        is_true.add("method")  # that of the reference is another
    else:
        rates, reference, method = recorded(folder, name)
        rates = GyroSeries(rates.t_ns, rates.rate + bias)
        is_true |= {"rate bias", "drift", "reference frame"}
    if kind == "body frame" or rng.random() < 0.3:
        mount = random_rotation(rng, rng.uniform(5, 120))
        reference = AttitudeSeries(reference.t_ns, multiply(reference.wxyz, mount))
        is_true.add("body frame")
    if kind == "reference frame" or rng.random() < 0.4:
        turned = multiply(random_rotation(rng, rng.uniform(3, 170)), reference.wxyz)
        reference = AttitudeSeries(reference.t_ns, turned)
        is_true.add("reference frame")
    a, b = Source(rates=rates, propagate={"method": method}), Source(reference)
    planted, a, b = _plant(kind, rng, a, b)
    if planted & READINGS.keys() and is_true & {"body frame", "reference frame"}:
        # The conjugate of q m is m* q*: the one frame takes the place of the other.
        is_true |= {"body frame", "reference frame"}
    if (
        kind == "dead gyro"
    ):  # at a constant rate or at none; the other axes of a dead one have theirs
        of_rates = {"rate bias", "drift"}
        is_true = is_true | of_rates if a.rates.rate.any() else is_true - of_rates
    title = f"{number} {kind} in {name}, align {align}, {sorted(is_true)}"
    return Pair(title, frozenset(planted), frozenset(is_true | planted), a, b, {"align": align})


def _plant(kind, rng, a, b):  # noqa: PLR0911, PLR0912  # one mistake after the other
    rates, reference = a.rates, b.series

    def with_rates(rate):
        return replace(a, rates=GyroSeries(rates.t_ns, rate))

    match kind:
        case "conjugate" | "layout" | "layout-first" | "layout and conjugate":
            stored, read = READINGS[kind]
            return {kind}, a, replace(b, stored=stored, read=read)
        case "conjugate of A":
            return {"conjugate"}, replace(a, stored=READINGS["conjugate"][0]), b
        case "side":
            return {kind}, replace(a, propagate={**a.propagate, "rates": "inertial"}), b
        case "rate sign":
            return {kind}, with_rates(-rates.rate), b
        case "axes":
            matrix = np.array(AXES[str(rng.choice(list(AXES)))])
            names = {kind, "body frame"} if np.linalg.det(matrix) > 0 else {kind, "rate sign"}
            return names, with_rates(rates.rate @ matrix.T), b
        case "scale":
            factor = float(rng.choice([np.pi / 180, 0.5, 2.0, 1.1, 0.96]))
            return {kind}, with_rates(rates.rate * factor), b
        case "drift":
            seconds = (reference.t_ns - reference.t_ns[0])[:, None] / 1e9
            ramp = exp(seconds * rng.normal(size=3) * 0.003)
            wxyz = multiply(ramp, reference.wxyz)
            return {kind}, a, Source(AttitudeSeries(reference.t_ns, wxyz))
        case "time offset":
            offset_ns = int(rng.choice([-1, 1]) * rng.uniform(30, 300) * 1e6)
            return {kind}, a, Source(AttitudeSeries(reference.t_ns + offset_ns, reference.wxyz))
        case "clock drift":
            ratio = float(rng.choice([-1500, -800, 800, 1500])) * 1e-6
            since = reference.t_ns - reference.t_ns[0]
            t_ns = reference.t_ns + np.round(ratio * since).astype(np.int64)
            return {kind}, a, Source(AttitudeSeries(t_ns, reference.wxyz))
        case "method" | "method of one":
            of_a, of_b = rng.choice(["start", "end", "mean", "coning", "cubic"], 2, replace=False)
            a = replace(a, propagate={"method": str(of_a)})
            if kind == "method":
                return {"method"}, a, replace(a, propagate={"method": str(of_b)})
            made = replace(a, propagate={"method": str(of_b)}).attitudes()
            wxyz = multiply(made.wxyz, exp(1e-5 * _normal(rng, made.wxyz[:, 1:])))
            return {"method"}, a, Source(AttitudeSeries(made.t_ns, wxyz))
        case "isolated samples":
            wxyz = reference.wxyz.copy()
            rows = rng.choice(len(wxyz), 3, replace=False)
            wxyz[rows] = multiply(wxyz[rows], random_rotation(rng, 150))
            return {kind}, a, Source(AttitudeSeries(reference.t_ns, wxyz))
        case "dead axis":
            return {kind}, with_rates(rates.rate * (np.arange(3) != rng.integers(3))), b
        case "dead gyro":
            return {kind}, with_rates(rates.rate * 0 + float(rng.choice([0, 0.01]))), b
        case "saturation":
            most = 0.5 * float(np.abs(rates.rate).max())
            return {kind}, with_rates(np.clip(rates.rate, -most, most)), b
        case "missing samples":
            rows = np.ones(len(rates), bool)
            for begin in rng.choice(len(rates) - 20, 5, replace=False):
                rows[begin + 1 : begin + 1 + len(rates) // 50] = False
            return {kind}, replace(a, rates=rates[rows]), b
        case "body frame" | "reference frame" | "rate bias":
            return {kind}, a, b
        case _:
            return set(), a, b
