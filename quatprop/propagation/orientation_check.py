"""Rates against a recorded orientation: another scale, unit, frame or choice of axes.

Nothing is changed here. A remedy is named only if the rates and the orientation agree with it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import (
    conjugate,
    from_matrix,
    geodesic_angle,
    log,
    multiply,
    shorter,
)
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS, axes_text
from quatprop.propagation.checks.units import other_unit
from quatprop.propagation.conditioning.frames import mount_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64, Intp


Series = TypeVar("Series", GyroSeries, AttitudeSeries)

COMPARED_SAMPLES = 20_000
"""Samples from the beginning of the log that are compared with its own orientation."""

AGREEING_SAMPLES = 2_000
"""Enough samples if both move and agree, or if no orientation is valid."""

MOVING = math.radians(1.0)
"""rad: an orientation that rotates less than this in a second is not compared."""

OFF_SCALE = 20.0
"""Where one of them rotates less than that, they differ by a larger ratio."""

SAME_SCALE = 1.4
"""Largest ratio of rates and orientation that agree: no sensor or filter is off by more."""

GAP = 10
"""An interval longer than so many median ones is a gap: what happens in it is not compared."""

SPANS_NS = (1_000_000_000, 200_000_000, 40_000_000, 8_000_000)
"""Rotations are compared over the first of these times, long enough for noise and short enough for
drift, in which the body hardly ever rotates further than :data:`WHOLE_TURN`."""

WHOLE_TURN = 2.5
"""rad: rotations of more are not compared by their axes, which turn over at half a turn."""

FEWEST = 50
"""Fewest rotations whose axes are compared."""

SAME_AXES = 0.8
"""Cosine between all rotations, as one vector, above which their axes are not in question."""

SHOWN = 0.95
"""Agreement, 1 for equal rotation vectors, which shows that other axes, or another unit or frame,
are meant."""

DISTINCT_AXES = 0.1
"""Smallest lead, in agreement, over all other axes."""

LARGEST_BIAS = math.radians(5.0)
"""rad/s: a constant difference that is smaller is a bias."""

LATEST_NS = 500_000_000
"""An orientation that agrees once it is shifted by less is late."""

MOST_SHIFTS = 25
"""Delays and advances that are tried."""

MOSTLY = 0.7
"""Share of rotations that agree where an orientation is settled."""

LEAST = math.radians(5.0)
"""rad/s: slower rotations may contradict each other for many reasons."""

FEWEST_SPANS = 8
"""Least duration of the rotations, in units of the time compared."""

FEWEST_SAMPLES = 4
"""Fewest samples in the time compared, so that the motion between them does not matter."""

OWN = "the log's own orientation"
"""How it is called in remarks."""

SAMPLES_OF_OTHER = 9
"""The same for an orientation with stamps of its own."""

OF_THE_MOUNTING = ("other-axes", "other-frame", "rates-contradict")
"""Remarks on the axes of the rates as they are in the log."""

OF_THE_ORIENTATION = (*OF_THE_MOUNTING, "rates-off-scale", "inverse-orientation")
"""All remarks on rates that rotate otherwise than the log's own orientation."""

_DEG = math.radians(1.0)


def against_orientation(  # noqa: PLR0913  # both series, and what is known of them
    batches: Iterable[GyroSeries],
    orientations: Iterable[AttitudeSeries],
    rates: str = "body",
    unit: str = "rad/s",
    *,
    name: str = "",
    mount: Float64 | None = None,
) -> Remark | None:
    """Return a remark if the rates rotate otherwise than the log's own orientation, or another.

    That is much less or more, about other axes, or in another frame.

    `batches`: rates from the beginning of the log, rad/s
    `rates`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    `unit`: their unit in the log
    `name`: of an orientation that is not the log's own, for remarks
    `mount`: by which the rates were turned already, shape ``(3, 3)``
    """
    gyro: list[GyroSeries] = []
    own: list[AttitudeSeries] = []
    batches, orientations = iter(batches), iter(orientations)
    compared = None
    for samples in (AGREEING_SAMPLES, COMPARED_SAMPLES):
        _extend(own, orientations, samples)
        if own:
            _extend(gyro, batches, samples)
        if not gyro:
            return None
        compared = _Comparison(
            GyroSeries.joined(gyro),
            AttitudeSeries.joined(own),
            rates=rates,
            unit=unit,
            name=name,
            mount=mount,
        )
        if compared.agree:
            return None
        if remark := compared.explained():
            return remark
    return None if compared is None else compared.unexplained()


def agree_only_mounted(
    batches: Iterable[GyroSeries], orientations: Iterable[AttitudeSeries], mount: Float64
) -> bool:
    """Return whether rates in sensor axes agree with the log's own orientation only once mounted.

    Then the orientation is that of the body already, not that of the sensor.

    `batches`, `orientations`: from the beginning of the log
    `mount`: sensor axes to body axes, shape ``(3, 3)``
    """
    gyro: list[GyroSeries] = []
    own: list[AttitudeSeries] = []
    _extend(own, iter(orientations), COMPARED_SAMPLES)
    _extend(gyro, iter(batches), COMPARED_SAMPLES)
    if not (gyro and own):
        return False
    turns = _small_turns(GyroSeries.joined(gyro), AttitudeSeries.joined(own))
    mounted = turns.mounted(mount).agreement
    is_shown = len(turns.paths) >= FEWEST and _rms(turns.by_orientation) > MOVING * turns.span_s
    return is_shown and mounted > SHOWN and mounted - turns.agreement > DISTINCT_AXES


class _Comparison:
    """Compares rates and orientations.

    `unit`: that of the rates in the log
    `name`: of an orientation that is not the log's own
    `mount`: by which the rates were turned already
    """

    def __init__(  # noqa: PLR0913  # what is compared, and how it is called
        self,
        gyro: GyroSeries,
        own: AttitudeSeries,
        *,
        rates: str,
        unit: str,
        name: str,
        mount: Float64 | None,
    ) -> None:
        self._gyro, self._own, self._rates, self._unit = gyro, own, rates, unit
        self._name, self._mount = name or OWN, mount
        # Of another orientation, crosscheck may still find the cause.
        self._otherwise = ", whatever the axes, the frame and the unit" * (not name)
        self._asked = "are both of the same sensor?"
        if name:
            self._asked = (
                "are both of the same body, on the same clock? quatprop crosscheck finds a "
                "constant rotation between them or a short delay, quatprop compare of the result "
                "with them also one of many seconds"
            )
        seconds = _turns(gyro, own, rates, SPANS_NS[0])
        moved = _rms(seconds.by_rates), _rms(seconds.by_orientation)
        # Rates that are all zero have their own remark. An orientation that never changes was not
        # estimated: many drivers leave it at identity.
        self._both_move = min(moved) > MOVING
        self._differ = (
            self._both_move
            or (moved[0] > 0 and moved[1] > max(MOVING, OFF_SCALE * moved[0]))
            or (moved[1] > MOVING / OFF_SCALE and moved[0] > OFF_SCALE * moved[1])
        )
        self._turns = _small_turns(gyro, own, rates) if self._differ else seconds
        self._ratio = self._turns.ratio

    @property
    def agree(self) -> bool:
        """Whether both move, equally."""
        is_alike = self._turns.cosine > SAME_AXES and 1 / SAME_SCALE < self._ratio < SAME_SCALE
        return self._both_move and is_alike

    def explained(self) -> Remark | None:
        """Return a remark if another unit, frame or choice of axes makes them agree."""
        if not self._differ:
            return None
        factors = (1.0, _DEG, 1 / _DEG)
        factor = min(factors, key=lambda factor: abs(math.log(factor * self._ratio)))
        gyro = self._gyro.with_rate(self._gyro.rate * factor)
        scaled = self._off_scale(1 / factor, other_unit(self._unit, are_too_large=factor < 1))
        if factor != 1 and _small_turns(gyro, self._own, self._rates).agreement > SHOWN:
            return Remark("rates-off-scale", scaled)
        begin = f"{self._contradiction}: they" if factor == 1 else f"{scaled}; then they"
        found = []
        frame, of = ("inertial", "reference") if self._rates == "body" else ("body", "body")
        if _small_turns(gyro, self._own, frame).agreement > SHOWN:
            way = f"as rates in {of} axes, with {Setting('rates', frame)}"
            found.append(Remark("other-frame", f"{begin} agree {way}"))
        if self._rates == "body" and (axes := _other_axes(gyro, self._own)):
            turn = (
                axes
                if self._mount is None
                else mount_text(from_matrix(mounting(axes) @ self._mount))
            )
            way = f"once the rates are turned into its axes, with {Setting('mount', turn)}"
            found.append(Remark("other-axes", f"{begin} agree {way}"))
        if not found and self._is_inverse(gyro):
            way = f"{Setting('from_direction', 'ref-to-body')} of quatprop convert"
            text = (
                f"{begin} agree with its inverse: it is from reference to body, and an initial "
                f"attitude that is taken from it is wrong; convert it, with {way}"
            )
            found.append(Remark("inverse-orientation", text))
        return found[0] if len(found) == 1 else None

    def _is_inverse(self, gyro: GyroSeries) -> bool:
        """Return whether rates agree with the inverse of the orientation, and only with that.

        Of small turns about a constant attitude, the inverse looks like mirrored axes.
        """
        inverse = AttitudeSeries(self._own.t_ns, conjugate(self._own.wxyz))
        turns = _small_turns(gyro, inverse, self._rates)
        as_it_is = _small_turns(gyro, self._own, self._rates).agreement_in_any_axes
        is_enough = len(turns.paths) >= FEWEST
        return is_enough and turns.agreement > max(SHOWN, as_it_is + DISTINCT_AXES)

    def unexplained(self) -> Remark | None:
        """Return a remark, unless a bias, a delay or a settling filter explains it."""
        # A bias that is not subtracted yet, a delay or noise may look the same.
        is_unclear = self._name != OWN and (
            not self._both_move
            or self._turns.cosine > SAME_AXES
            or self._turns.samples < SAMPLES_OF_OTHER
        )
        if not self._differ or is_unclear:
            return None
        asked = self._off_scale(self._ratio, self._asked)
        if not self._both_move:
            return Remark("rates-off-scale", asked)
        shifts = self._shifts()
        inverse = AttitudeSeries(self._own.t_ns, conjugate(self._own.wxyz))
        is_excused, may_be_inverse = (
            _small_turns(self._gyro, own, self._rates).excuse(shifts)
            for own in (self._own, inverse)
        )
        if self._turns.are_too_few or is_excused:
            return None
        if may_be_inverse:
            text = (
                f"{self._contradiction}: they agree with its inverse, but this motion does not "
                "tell that from rates about other axes, or with another sign; if the orientation "
                "is from reference to body, an initial attitude that is taken from it is wrong, if "
                "not, the attitudes are"
            )
            return Remark("rates-contradict", text)
        if self._turns.cosine > SAME_AXES:
            return Remark("rates-off-scale", asked)
        return Remark(
            "rates-contradict",
            f"{self._contradiction}{self._otherwise}: {self._asked}",
        )

    def _shifts(self) -> range:
        """Return by how many samples the orientation may be late or early."""
        stamps, _, _ = _common(self._gyro, self._own)
        most = int(LATEST_NS / max(float(np.median(np.diff(stamps))), 1.0))
        most = min(most, len(self._turns.paths) // 4)
        return range(-most, most + 1, max(most // MOST_SHIFTS, 1))

    @property
    def _contradiction(self) -> str:
        """The sentence on how far they differ."""
        _, places, own_places = _common(self._gyro, self._own)
        turned = attitudes(self._gyro.t_ns, self._gyro.rate, rates=self._rates)[places]
        since = (
            _difference(q[:1], q, is_inertial=self._rates == "inertial")
            for q in (turned, self._own.wxyz[own_places])
        )
        off = math.degrees(float(geodesic_angle(*since).max()))
        return f"the rates contradict {self._name}, by up to {off:.3g} deg"

    def _off_scale(self, ratio: float, why: str) -> str:
        """Return what to say of rates that are too large or too small by a ratio."""
        what, times = f"the rates rotate {{}} {self._name}", ratio
        if ratio < 1:
            what, times = f"{self._name} rotates {{}} its rates", 1 / ratio
            if self._name != OWN:
                what = f"{self._name} rotates {{}} the rates"
        return f"{what.format(f'{times:.3g} times as far as')}: {why}"


class _Turns(NamedTuple):
    """Rotation vectors by rates and by orientations over the same times, rad.

    They are in body axes, or of inertial rates in reference axes; none if they are unknown.

    `by_rates`, `by_orientation`: shape ``(N, 3)``
    `paths`: the angle through which the body went meanwhile, shape ``(N,)``, rad
    `span_s`: the usual time
    `samples`: in that time
    """

    by_rates: Float64
    by_orientation: Float64
    paths: Float64
    span_s: float
    samples: float

    @property
    def cosine(self) -> float:
        """Cosine between all rotations as one vector: 1 if they are about the same axes."""
        sizes = float((self.by_rates**2).sum() * (self.by_orientation**2).sum())
        product = float((self.by_rates * self.by_orientation).sum())
        return product / math.sqrt(sizes) if sizes else 1.0

    @property
    def agreement(self) -> float:
        """How well rotations agree: 1 if they are equal."""
        total = float((self.by_rates**2).sum() + (self.by_orientation**2).sum())
        product = float((self.by_rates * self.by_orientation).sum())
        return 2 * product / total if total else 1.0

    @property
    def agreement_in_any_axes(self) -> float:
        """How well they agree at best, about any other axes, also left-handed ones."""
        total = float((self.by_rates**2).sum() + (self.by_orientation**2).sum())
        product = float(np.linalg.norm(self.by_rates.T @ self.by_orientation, "nuc"))
        return 2 * product / total if total else 1.0

    @property
    def ratio(self) -> float:
        """How much further the rates turn; 1 if one of them does not."""
        by_rates, by_orientation = _rms(self.by_rates), _rms(self.by_orientation)
        return by_rates / by_orientation if by_rates and by_orientation else 1.0

    @property
    def are_too_few(self) -> bool:
        """Whether they are too few, too small or of too few samples to contradict each other."""
        small = min(_rms(self.by_rates), _rms(self.by_orientation)) < LEAST * self.span_s
        few = max(FEWEST, FEWEST_SPANS * self.samples)
        return small or len(self.paths) < few or self.samples < FEWEST_SAMPLES

    def excuse(self, shifts: Iterable[int]) -> bool:
        """Return whether they agree but for a bias, a delay, and what most of them do not show."""
        most = self.without_bias()
        return any(
            turns.cosine > SAME_AXES and 1 / SAME_SCALE < turns.ratio < SAME_SCALE
            for turns in (most.shifted(shift).without_the_worst() for shift in shifts)
        )

    def without_the_worst(self) -> _Turns:
        """Return those that agree best, as where a filter has settled."""
        apart = np.linalg.norm(self.by_rates - self.by_orientation, axis=1)
        best = np.argsort(apart, kind="stable")[: math.ceil(MOSTLY * len(apart))]
        return self._replace(by_rates=self.by_rates[best], by_orientation=self.by_orientation[best])

    def known(self) -> _Turns:
        """Return those of less than a turn."""
        turned, own, paths = (each[self.paths < WHOLE_TURN] for each in self[:3])
        return self._replace(by_rates=turned, by_orientation=own, paths=paths)

    def mounted(self, mount: Float64) -> _Turns:
        """Return them with rates about other axes."""
        return self._replace(by_rates=self.by_rates @ mount.T)

    def without_bias(self) -> _Turns:
        """Return them without the constant difference, as far as it may be a bias."""
        difference = np.median(self.by_rates - self.by_orientation, axis=0)
        size = float(np.linalg.norm(difference))
        share = min(1.0, LARGEST_BIAS * self.span_s / size) if size else 0.0
        return self._replace(by_rates=self.by_rates - share * difference)

    def shifted(self, shift: int) -> _Turns:
        """Return them with rates that are some samples late; if negative, early."""
        count = len(self.by_rates) - abs(shift)
        return self._replace(
            by_rates=self.by_rates[max(-shift, 0) :][:count],
            by_orientation=self.by_orientation[max(shift, 0) :][:count],
        )


def _common(gyro: GyroSeries, own: AttitudeSeries) -> tuple[Int64, Intp, Intp]:
    """Return the stamps of both, and their places in each."""
    stamps, places, own_places = np.intersect1d(gyro.t_ns, own.t_ns, return_indices=True)
    return stamps, places, own_places


def _turns(gyro: GyroSeries, own: AttitudeSeries, rates: str, span_ns: int) -> _Turns:
    """Return the rotations in a time; none of them are across a gap."""
    stamps, places, own_places = _common(gyro, own)
    if len(stamps) < 2 or not np.isfinite(gyro.rate).all() or (np.diff(gyro.t_ns) < 0).any():  # noqa: PLR2004
        return _Turns(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), 0.0, 0.0)
    intervals = np.diff(stamps)
    gaps = np.cumsum(np.append(0, intervals > GAP * np.median(intervals)))
    after = np.searchsorted(stamps, stamps + span_ns)
    begins = np.flatnonzero(after < len(stamps))
    begins = begins[gaps[begins] == gaps[after[begins]]]
    ends = after[begins]
    both = attitudes(gyro.t_ns, gyro.rate, rates=rates)[places], own.wxyz[own_places]
    by_rates, by_orientation = (
        log(_difference(q[begins], q[ends], is_inertial=rates == "inertial")) for q in both
    )
    steps = np.linalg.norm(gyro.rate[:-1], axis=1) * np.diff(gyro.t_ns) / NS_PER_S
    paths = (
        np.append(0.0, np.cumsum(steps))[places],
        np.append(0.0, np.cumsum(geodesic_angle(both[1][:-1], both[1][1:]))),
    )
    path = np.maximum(*(path[ends] - path[begins] for path in paths))
    span_s = float(np.median(stamps[ends] - stamps[begins])) / NS_PER_S if len(ends) else 0.0
    return _Turns(
        by_rates, by_orientation, path, span_s, float(np.mean(ends - begins)) if len(ends) else 0.0
    )


def _difference(first: Float64, last: Float64, *, is_inertial: bool) -> Float64:
    """Return rotations from the first attitudes to the last, in reference or in body axes."""
    return shorter(
        multiply(last, conjugate(first)) if is_inertial else multiply(conjugate(first), last)
    )


def _small_turns(gyro: GyroSeries, own: AttitudeSeries, rates: str = "body") -> _Turns:
    """Return rotations of less than a turn, over the longest time in which most of them are."""
    for span_ns in SPANS_NS:
        turns = _turns(gyro, own, rates, span_ns)
        known = turns.known()
        if 2 * len(known.paths) > len(turns.paths):
            break
    return known


def _other_axes(gyro: GyroSeries, own: AttitudeSeries) -> str | None:
    """Return the only choice of axes, as a mounting, that makes rates agree with orientations.

    Left-handed axes are not considered: an orientation from reference to body looks the same.
    """
    turns = _small_turns(gyro, own)
    if len(turns.paths) < FEWEST:
        return None
    right_handed = (each for each in SIGNED_PERMUTATIONS if np.linalg.det(each) > 0)
    every = map(axes_text, right_handed)
    found = sorted((turns.mounted(mounting(axes)).agreement, axes) for axes in every)
    (second, _), (best, axes) = found[-2:]
    # Without rotations about all axes, left-handed ones are as likely.
    shares = np.linalg.eigvalsh(turns.by_orientation.T @ turns.by_orientation)
    weakest = float(shares[0] / max(shares.sum(), MOVING))
    is_shown = best > max(SHOWN, 1 - weakest / 2) and best - second > DISTINCT_AXES
    return axes if is_shown and axes != "x,y,z" else None


def _extend(read: list[Series], batches: Iterator[Series], samples: int) -> None:
    """Read batches until they have a number of samples."""
    while sum(map(len, read)) < samples and (batch := next(batches, None)) is not None:
        read.append(batch)


def _rms(rotvec: Float64) -> float:
    return float(np.sqrt((rotvec**2).sum(axis=1).mean())) if len(rotvec) else 0.0
