"""Write a simulated log and its true attitudes.

Tables have timestamps in ns and rates in rad/s as ``t_ns,wx,wy,wz``. Containers have
``sensor_msgs/Imu`` on ``/imu``: the header timestamp is the sampling time, the log time the
arrival, a little later.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import OutputError, UsageError
from quatprop.base.places import is_stdout
from quatprop.base.progress import with_progress
from quatprop.base.provenance import as_json
from quatprop.base.rendering import count_text
from quatprop.base.text import listed, quoted
from quatprop.base.times import NS_PER_S, regular_stamps
from quatprop.kinematics.series import AttitudeSeries
from quatprop.writers import open_messages, open_table, open_writer
from quatprop.writers.base import FileWriter, attitude_messages, column_table
from quatprop.writers.formats import GENERAL_KINDS, WRITERS, Message, kind_of
from quatprop.writers.message_encoders import ABSENT, RosEncoder
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from quatprop.base.arrays import AnyArray, Float64, Int64, Records

    Motion = Callable[[Int64], tuple[Float64, Float64]]


# Phases that are exact for any duration, and sines that are the same on every machine.
#
# The phase ``f t`` of a rational frequency and an integer time is a ratio of integers, so whole
# turns are removed without rounding: after a day the phase is as accurate as in the first second.
# For the remainder, at most an eighth of a turn, a polynomial of IEEE additions and multiplications
# is used, which are rounded alike everywhere. The sines of math libraries differ between processors
# in the last place, and simulated logs must be reproducible to the byte.


_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(9)]
_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(9)]
"""Taylor coefficients; at an eighth of a turn the first omitted term is 5e-19 and 3e-20."""

# By number of quarter turns: cos = (c, -s, -c, s) and sin = (s, c, -s, -c).
_COSINE_SIGN = np.array([1.0, -1.0, -1.0, 1.0])
_SINE_SIGN = np.array([1.0, 1.0, -1.0, -1.0])


def of_time(elapsed_ns: Int64, frequency: Fraction) -> tuple[Float64, Float64]:
    """Return cosine and sine of the angle ``2 pi f t``.

    `elapsed_ns`: times, any shape, int64, ns
    `Returns`: two arrays of the shape of `elapsed_ns`, within 3e-16 of the true values
    """
    period = frequency.denominator * NS_PER_S
    if period * max(8, abs(frequency.numerator)) > np.iinfo(np.int64).max:
        raise UsageError(
            f"a frequency of {float(frequency)} Hz has too many digits to keep its phase exact; "
            "give it to three decimals"
        )
    return _of_ratio(elapsed_ns % period * frequency.numerator % period, period)


def of_degrees(angle: Fraction) -> tuple[float, float]:
    """Return cosine and sine of one angle in degrees."""
    turns = angle / 360 % 1
    cosine, sine = _of_ratio(np.array([turns.numerator]), turns.denominator)
    return float(cosine[0]), float(sine[0])


def _of_ratio(turns: Int64, period: int) -> tuple[Float64, Float64]:
    """Return cosine and sine of ``2 pi turns / period`` for ``0 <= turns < period``."""
    quarter = (8 * turns + period) // (2 * period)  # nearest number of quarter turns
    angle = (4 * turns - quarter * period) / period * (math.pi / 2)
    square = angle * angle
    cosine, sine = _polynomial(_COSINE, square), angle * _polynomial(_SINE, square)
    odd, quarter = quarter % 2 == 1, quarter % 4
    return (
        np.where(odd, sine, cosine) * _COSINE_SIGN[quarter] + 0.0,  # zeros lose their sign
        np.where(odd, cosine, sine) * _SINE_SIGN[quarter] + 0.0,
    )


def _polynomial(coefficients: list[float], square: Float64) -> Float64:
    total = np.full_like(square, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * square + coefficient
    return total


# Motions with closed formulas for both attitude and body rate.
#
# A motion is a function from elapsed time, ns, to body rate and attitude. Convention: ``wxyz`` is
# body -> reference, so that ``q' = 1/2 q w_B`` (source article, equation 12); rates are resolved in
# the body frame, in rad/s. The attitude at time zero is the identity: the reference frame is the
# body frame at the first sample.
#
# No code is shared with the propagation, which these motions test.


@dataclass(frozen=True, slots=True)
class Shape:
    """The parameters of the motions; each uses its own.

    `frequency`: revolutions per second, Hz: of the spin, of the coning, of the precession of a
        tumbling body
    `axis`: axis of the spin in the body, of any length but zero
    `angle`: degrees: half-angle of the cone, or nutation angle of a tumbling body
    `spin_frequency`: revolutions per second of a tumbling body about its own axis
    `walk`: strength of the random walk of the rate, rad/s/sqrt(s)
    """

    frequency: Fraction = Fraction(1, 2)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    angle: Fraction = Fraction(10)
    spin_frequency: Fraction = Fraction(1, 5)
    walk: float = 0.1
    seed: int = 0


def motion_named(name: str, shape: Shape) -> Motion:
    """Return a motion by name."""
    if name not in MOTIONS:
        raise UsageError(f"no motion {quoted(name)}; choose one of {listed(MOTIONS)}")
    return MOTIONS[name](shape)


def spin(axis: tuple[float, float, float], frequency: Fraction) -> Motion:
    """Return a constant rate about a body axis: ``q = cos(w t / 2) + u sin(w t / 2)``.

    References
    ----------
    Source article, equations 32 and 37.
    """
    length = math.sqrt(math.fsum(part * part for part in axis))
    if not (0.0 < length < math.inf):
        raise UsageError("the axis of a spin needs a direction; give three numbers, not all zero")
    unit = np.array(axis) / length
    rate = 2 * math.pi * float(frequency) * unit

    def motion(elapsed_ns: Int64) -> tuple[Float64, Float64]:
        cosine, sine = of_time(elapsed_ns, frequency / 2)
        parts = (cosine, *(part * sine for part in unit))
        return np.tile(rate, (len(elapsed_ns), 1)), np.stack(parts, axis=1)

    return motion


def precession(angle: Fraction, frequency: Fraction, spin_frequency: Fraction) -> Motion:
    """Return a regular precession: ``q = Rz(f) Rx(n) Rz(s)``, f and s linear in time.

    The body's z axis is at the angle n to a fixed axis and rotates about it at ``f' = 2 pi
    frequency``; the body rotates about its z axis at ``s' = 2 pi spin_frequency``. The Euler angles
    3-1-3 give, with c and s_n cosine and sine of n/2::

        q = [c cos((f+s)/2), s_n cos((f-s)/2), s_n sin((f-s)/2), c sin((f+s)/2)]
        w_B = [f' sin(n) sin(s), f' sin(n) cos(s), f' cos(n) + s']

    Two textbook motions are special cases. A free symmetric body tumbles like this if the ratio of
    its transverse and axial moments of inertia is ``A / C = 1 + s' / (f' cos n)``. With
    ``s' = -f'`` it is classical coning: the body axis describes a cone of half-angle n while the
    body does not rotate about it, and gyroscopes measure the z rate ``-f' (1 - cos n)``.

    References
    ----------
    Goldstein, Poole, Safko, Classical Mechanics, 3rd ed., sections 4.9 (rates of the Euler angles)
    and 5.6 (free symmetric body). Bortz, A New Mathematical Formulation for Strapdown Inertial
    Navigation, IEEE Trans. AES-7, 1971 (coning).
    """
    half_cosine, half_sine = of_degrees(angle / 2)
    full_cosine, full_sine = of_degrees(angle)
    precessing = 2 * math.pi * float(frequency)
    axial = precessing * full_cosine + 2 * math.pi * float(spin_frequency)
    transverse = precessing * full_sine
    # The formula begins at Rx(n): its conjugate on the left makes it begin at the identity.
    begin = np.array([half_cosine, -half_sine, 0.0, 0.0])

    def motion(elapsed_ns: Int64) -> tuple[Float64, Float64]:
        sum_cosine, sum_sine = of_time(elapsed_ns, (frequency + spin_frequency) / 2)
        gap_cosine, gap_sine = of_time(elapsed_ns, (frequency - spin_frequency) / 2)
        spin_cosine, spin_sine = of_time(elapsed_ns, spin_frequency)
        wxyz = np.stack(
            (
                half_cosine * sum_cosine,
                half_sine * gap_cosine,
                half_sine * gap_sine,
                half_cosine * sum_sine,
            ),
            axis=1,
        )
        rate = np.stack(
            (transverse * spin_sine, transverse * spin_cosine, np.full(len(wxyz), axial)), axis=1
        )
        return rate, hamilton(begin, wxyz)

    return motion


def random_walk(walk: float, seed: int) -> Motion:
    """Return a rate that is a random walk, constant from each sample to the next.

    The attitude is the product of the exact steps (source article, equation 36), in extended
    precision if the machine has it.

    `walk`: strength, rad/s/sqrt(s): the rate's standard deviation after one second, on each axis
    """
    # A different sequence from that of the gyroscope's noise with the same seed.
    random = np.random.default_rng((seed, 1))
    last = np.int64(0), np.zeros(3), np.array([1, 0, 0, 0], np.longdouble)

    def motion(elapsed_ns: Int64) -> tuple[Float64, Float64]:
        nonlocal last
        last_ns, last_rate, last_wxyz = last
        dt = np.diff(elapsed_ns, prepend=last_ns) / NS_PER_S
        increments = random.standard_normal((len(dt), 3)) * (walk * np.sqrt(dt))[:, None]
        rate = np.cumsum(np.vstack((last_rate, increments)), axis=0)
        steps = step(rate[:-1].astype(np.longdouble) * dt[:, None])
        steps[0] = hamilton(last_wxyz, steps[0])
        wxyz = running_product(steps)
        last = elapsed_ns[-1], rate[-1], wxyz[-1]
        return rate[1:], wxyz.astype(np.float64)

    return motion


MOTIONS: Mapping[str, Callable[[Shape], Motion]] = {
    "rest": lambda _shape: spin((0.0, 0.0, 1.0), Fraction(0)),
    "spin": lambda shape: spin(shape.axis, shape.frequency),
    "coning": lambda shape: precession(shape.angle, shape.frequency, -shape.frequency),
    "tumbling": lambda shape: precession(shape.angle, shape.frequency, shape.spin_frequency),
    "random-walk": lambda shape: random_walk(shape.walk, shape.seed),
}
"""All motions by name."""


def hamilton(left: AnyArray, right: AnyArray) -> AnyArray:
    """Return ``left right``, wxyz, ij = k; shapes ``(..., 4)`` broadcast.

    Written out, since sums of linear algebra libraries are rounded differently by processor.
    """
    a, b, c, d = np.moveaxis(left, -1, 0)
    w, x, y, z = np.moveaxis(right, -1, 0)
    return np.stack(
        (
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ),
        axis=-1,
    )


def step(rotvec: AnyArray) -> AnyArray:
    """Return the unit quaternions of rotation vectors, rad: source article, equation 35.

    `rotvec`: shape ``(N, 3)``
    """
    half = np.sqrt(np.sum(rotvec * rotvec, axis=-1, keepdims=True)) / 2
    with np.errstate(invalid="ignore"):
        factor = np.where(half > 0, np.sin(half) / (2 * half), 0.5)
    return np.concatenate((np.cos(half), factor * rotvec), axis=-1)


def running_product(steps: AnyArray) -> AnyArray:
    """Return ``steps[0] steps[1] ... steps[k]`` for every k, by doubling.

    `steps`: unit quaternions, shape ``(N, 4)``
    """
    product, reach = steps, 1
    while reach < len(steps):
        product = np.concatenate((product[:reach], hamilton(product[:-reach], product[reach:])))
        reach *= 2
    length = np.sqrt(np.sum(product * product, axis=-1, keepdims=True))
    result: AnyArray = product / length
    return result


# A motion sampled by a gyroscope with noise and bias, and the truth at the same times.


START_NS = 1_700_000_000_000_000_000
"""Default first timestamp: 2023-11-14T22:13:20Z. Fixed, so that logs are reproducible."""

BATCH = 1 << 16
"""Samples in a batch."""

NOISE_DECIMALS = 9
"""Noise is rounded to 1e-9 rad/s: its far tails are computed with a logarithm, whose last bits may
differ between machines."""


@dataclass(frozen=True, slots=True)
class Gyroscope:
    """A gyroscope, and the number of samples.

    `sample_rate`: samples per second, Hz. Sample k is taken at the whole ns at or before ``k /
        sample_rate``, and its timestamp is exact
    `start_ns`: first timestamp, ns
    `noise`: angle random walk, rad/s/sqrt(Hz): each sample of each axis has white noise of standard
        deviation ``noise * sqrt(sample_rate)``
    `bias`: added to the rate, rad/s
    """

    sample_rate: Fraction
    samples: int
    start_ns: int = START_NS
    noise: float = 0.0
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0

    def __post_init__(self) -> None:
        if BATCH * NS_PER_S * self.sample_rate.denominator > np.iinfo(np.int64).max:
            raise UsageError(
                f"a sample rate of {float(self.sample_rate)} Hz has too many digits to keep its "
                "timestamps exact; give it to three decimals"
            )
        last_ns = self.start_ns + int((self.samples - 1) * NS_PER_S / self.sample_rate)
        if not -(1 << 63) <= self.start_ns <= last_ns < (1 << 63) - _LATEST_NS:
            raise UsageError(
                f"the timestamps of {count_text(self.samples, 'sample')} from {self.start_ns} ns "
                "on exceed 64 bits; begin earlier, or take fewer"
            )

    @property
    def deviation(self) -> float:
        """Standard deviation of a sample's noise, rad/s."""
        return self.noise * math.sqrt(self.sample_rate)


def record(
    motion: Motion, gyroscope: Gyroscope, q0: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
) -> Iterator[AttitudeSeries]:
    """Yield batches of true attitudes with measured rates.

    `q0`: true attitude at the first sample, body -> reference, wxyz; it is normalised
    """
    if not 0 < np.linalg.norm(q0) < np.inf:
        raise UsageError("q0 must be four finite numbers W,X,Y,Z, not all zero")
    random = np.random.default_rng(gyroscope.seed)
    first = np.array(q0, np.float64)
    for begin in range(0, gyroscope.samples, BATCH):
        end = min(begin + BATCH, gyroscope.samples)
        elapsed = regular_stamps(begin, end, gyroscope.sample_rate)
        rate, wxyz = motion(elapsed)
        if gyroscope.noise:
            noise = random.standard_normal(rate.shape) * gyroscope.deviation
            rate = rate + np.round(noise, NOISE_DECIMALS)
        t_ns = elapsed + gyroscope.start_ns
        measured = rate + np.array(gyroscope.bias)
        yield AttitudeSeries(t_ns, _unit(hamilton(first, wxyz)), rate=measured)


def samples_in(duration_ns: int, sample_rate: Fraction) -> int:
    """Return the number of samples in a duration, at least one."""
    return max(1, math.ceil(duration_ns * sample_rate / NS_PER_S))


def _unit(wxyz: Float64) -> Float64:
    """Return rows scaled to unit length, with -0.0 replaced by 0.0."""
    w, x, y, z = wxyz.T
    length = np.sqrt(w * w + x * x + y * y + z * z)
    unit: Float64 = wxyz / length[:, None] + 0.0
    return unit


IDENTITY = (1.0, 0.0, 0.0, 0.0)


def truth_path(target: Path | str, kind: str | None = None) -> str | None:
    """Return the default path of the truth: the log's name with ``.truth.csv``.

    The truth of a Parquet log is Parquet as well; that of stdout, or of a folder without a name, is
    not written.
    """
    if is_stdout(target) or not Path(target).name:
        return None
    kind = kind_of(target, kind, GENERAL_KINDS)
    suffix = ".truth.parquet" if kind == "parquet" else ".truth.csv"
    path = Path(target)
    return str(path.with_name((path.name if kind.startswith("rosbag2") else path.stem) + suffix))


def simulate(  # noqa: PLR0913  # a complete recording
    target: Path | str,
    motion: str,
    shape: Shape,
    gyroscope: Gyroscope,
    *,
    q0: tuple[float, ...] = IDENTITY,
    kind: str | None = None,
    compression: str | None = None,
    truth: Path | str | None = None,
) -> None:
    """Write a log of a motion, and its true attitudes.

    `truth`: path of the true attitudes, scalar-first; None to omit them
    """
    refuse_overlap([], [str(target), None if truth is None else str(truth)])
    provenance = _provenance(motion, shape, gyroscope, q0)
    with ExitStack() as stack:
        log = stack.enter_context(
            open_log_writer(target, kind, deviation=gyroscope.deviation, compression=compression)
        )
        attitudes = [stack.enter_context(open_writer(truth))] if truth is not None else []
        recorded = record(motion_named(motion, shape), gyroscope, q0)
        for series in with_progress(recorded, gyroscope.samples):
            for writer in (log, *attitudes):
                writer.write(series)
        for writer in attitudes:
            writer.finish(provenance)
        # Logs of messages have no provenance, like those of recorders.
        log.finish({} if WRITERS[kind_of(target, kind)].encodings else provenance)
        for writer in (*attitudes, log):
            writer.publish()


def _provenance(
    motion: str, shape: Shape, gyroscope: Gyroscope, q0: tuple[float, ...]
) -> dict[str, object]:
    """Return the parameters, JSON-ready; without a version, so that the bytes are the same."""
    return {
        "simulated": motion,
        "motion": as_json(shape),
        "gyroscope": as_json(gyroscope),
        "convention": {
            "attitude": "body to reference: v_ref = q v_body q*",
            "product": "Hamilton, ij = k",
            "rates": "body, rad/s",
            "layout": "scalar-first",
            "q0_wxyz": list(q0),
        },
    }


RATE_COLUMNS = ("wx", "wy", "wz")

DEFAULT_COMPRESSIONS = {"rosbag2-mcap": "none"}
"""Compressions of recorders that differ from the default of the attitude writer."""

GRAVITY = 9.80665
"""Standard gravity, m/s^2."""

_TRANSPORT_NS = 1_000_000
_JITTER_NS = 100_000
_LATEST_NS = _TRANSPORT_NS + _JITTER_NS
"""Messages arrive before so long after their timestamps."""
_HASH_MULTIPLIER = 0x9E3779B1
"""Multiplier of Fibonacci hashing (Knuth, The Art of Computer Programming, 6.4)."""


class ImuEncoder(RosEncoder):
    """Encodes samples as messages on ``/imu``.

    The orientation is marked as unknown; the acceleration is the reaction to gravity of a sensor
    that only rotates, in a reference frame whose z axis points up.

    `deviation`: standard deviation of the rates' noise, rad/s, for the covariance
    `ros1`: whether in the encoding of ROS 1 rather than CDR, of ROS 2
    """

    def __init__(self, deviation: float, *, ros1: bool) -> None:
        constants = {
            "covariance": np.reshape(ABSENT, (3, 3)),
            "rate_covariance": (deviation**2 * np.eye(3)).ravel(),
        }
        super().__init__(Message("Imu", "/imu", child="imu"), ros1=ros1, constants=constants)

    def encode(self, series: AttitudeSeries, target: Path | str) -> Records:
        """Return the messages of a batch of true attitudes and measured rates, shape ``(N,)``."""
        rows = self._stamped(series.t_ns, target)
        rows["rate"], rows["acceleration"] = series.rate, _reaction(series.wxyz)
        return rows


def arrival_ns(t_ns: Int64) -> Int64:
    """Return the arrival time of each message: 1 to 1.1 ms after its timestamp, with jitter.

    The jitter is a hash of the timestamp, not a random number, so that it depends on neither seed
    nor batches. Up to 10 kHz messages arrive in order.
    """
    return t_ns + _TRANSPORT_NS + (t_ns * _HASH_MULTIPLIER & 0xFFFFFFFF) % _JITTER_NS


def _reaction(wxyz: Float64) -> Float64:
    """Return the upward reaction to gravity in the body frame, m/s^2: ``q* (0, 0, g) q``."""
    w, x, y, z = wxyz.T
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return GRAVITY * np.stack(up, axis=1)


def open_log_writer(
    target: Path | str,
    kind: str | None = None,
    *,
    deviation: float = 0.0,
    compression: str | None = None,
) -> FileWriter:
    """Open a writer of a simulated log.

    `target`: path, or ``"-"`` for stdout
    `kind`: one of :data:`quatprop.writers.formats.GENERAL_KINDS`; None takes it from the
        suffix of `target`
    `deviation`: standard deviation of the rates' noise, rad/s, for the messages' covariance
    `compression`: ``"none"``, ``"lz4"``, ``"zstd"`` or ``"bz2"``; None for the kind's default
    """
    kind = kind_of(target, kind, GENERAL_KINDS)
    if kind not in GENERAL_KINDS:
        raise OutputError(
            target, f"kind {quoted(kind)} holds attitudes only; choose {listed(GENERAL_KINDS)}"
        )
    compressions = WRITERS[kind].compressions
    if compression not in (None, *compressions):
        raise UsageError(
            f"a {kind} log cannot be compressed with {quoted(compression)}; "
            f"choose {listed(compressions)}"
        )
    if WRITERS[kind].columns:
        return column_table(open_table(target, RATE_COLUMNS, kind), lambda series: series.rate)
    encoder = ImuEncoder(deviation, ros1="ros1" in WRITERS[kind].encodings)
    compression = compression or DEFAULT_COMPRESSIONS.get(kind)
    container = open_messages(target, kind, encoder.topic, compression)
    return attitude_messages(container, encoder, target, lambda series: arrival_ns(series.t_ns))
