"""What one pair of sources says: statements beyond doubt and tolerance, and what is not shown."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from quatprop.estimation.relation import BIAS, CLOCK, DRIFT, OFFSET, SCALE, TURN
from quatprop.estimation.turning import BODY, REFERENCE
from quatprop.kinematics.quaternion import from_matrix
from quatprop.tools.crosscheck.classes import (
    NEAR,
    SIGNED_PERMUTATIONS,
    Axes,
    Reading,
    axes_text,
    nearest_axes,
    readings_of,
    turn_angle,
)
from quatprop.tools.crosscheck.pairs import certain
from quatprop.tools.crosscheck.result import SIGNIFICANT, Tolerances

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.base.arrays import Float64
    from quatprop.estimation.relation import Relation
    from quatprop.tools.crosscheck.pairs import Pair
    from quatprop.tools.crosscheck.sources import Source

DEG: Final = math.radians(1.0)

UNIT: Final = 0.06
"""A scale whose logarithm is this near to that of 180/pi is a wrong unit."""

SURE: Final = 5 * DEG
"""A reading that leaves a smaller rotation between the axes of one device is certain."""

HALF: Final = 0.6
"""Offsets below this many intervals are of integration: half of one, where a filter puts its
attitude at the beginning or the end of a sample."""

BLIND: Final = 0.1
"""A rotation is not shown where its standard deviation is above this, rad."""

SAME: Final = 2e-3
"""Sources whose difference is below this share of their motion are made of one another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """How a statement reads if it is about one of the two sources.

    `text`: the statement about the source
    `settings`: what repairs it: setting -> value
    `remedy`: the same, as options of the commands that read it
    """

    text: str
    settings: Mapping[str, str] = field(default_factory=dict)
    remedy: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """One fact about a pair.

    `code`: as of :class:`.Finding`
    `a`, `b`: how it reads about each source; None: it cannot be about that one
    `numbers`: values with their standard deviations
    `is_sure`: whether no other reading explains it
    """

    code: str
    a: Side | None
    b: Side | None
    numbers: Mapping[str, Any] = field(default_factory=dict)
    is_sure: bool = True

    def about(self, side: str | None) -> Side:
        """Return how it reads about one side, ``"a"`` or ``"b"``, or about the only one."""
        if self.a is None or (self.b is not None and side == "b"):
            return self.b or Side(text="")
        return self.a


def statements_of(pair: Pair, tolerances: Tolerances) -> list[Statement]:
    """Return what a pair shows, beyond five standard deviations and the tolerances."""
    fit = pair.fit
    return [] if fit is None else [*_Statements(pair, fit, tolerances).every()]


def value_text(value: float, sigma: float, unit: str, factor: float = 1.0) -> str:
    """Return a value with its standard deviation, both with as many digits as are known."""
    shown = max(abs(sigma * factor), 1e-9)
    digits = min(6, max(0, 1 - math.floor(math.log10(shown))))
    return f"{value * factor:.{digits}f} +- {shown:.{digits}f}{unit}"


class _Statements:
    """The statements on one pair."""

    def __init__(self, pair: Pair, fit: Relation, tolerances: Tolerances) -> None:
        self._pair, self._fit, self._tolerances = pair, fit, tolerances
        self._a, self._b = pair.a, pair.b
        self._names = pair.a.name, pair.b.name

    def every(self) -> Iterator[Statement]:
        pair, fit = self._pair, self._fit
        if pair.status in {"weak", "unrelated"}:
            yield self._loose()
        if pair.status == "reversed":
            text = (
                f"runs backwards in time against {{other}} (correlation {pair.backwards:.2f} "
                f"reversed, {pair.agreement:.2f} as recorded)"
            )
            yield self._both("reversed", text, text)
        if pair.status != "related":
            return
        self._turn, self._same = fit.matrix, True
        if not fit.is_plain:
            yield from self._reading()
        yield from self._axes()
        scale = [*self._scale()]
        yield from scale
        yield from self._time()
        yield from self._constant(is_scaled=bool(scale))

    def _both(self, code: str, text_a: str, text_b: str, **numbers: Any) -> Statement:
        """Return a statement that may be about either source."""
        name_a, name_b = self._names
        side_a, side_b = text_a.format(other=name_b), text_b.format(other=name_a)
        return Statement(code=code, a=Side(text=side_a), b=Side(text=side_b), numbers=numbers)

    def _loose(self) -> Statement:
        pair, fit = self._pair, self._fit
        left = f"{100 * fit.score:.0f} % of the motion of {fit.motion / DEG:.3g} deg/s is left"
        text = f"turns have nothing in common with those of {{other}} ({left})"
        if pair.status == "weak":
            text = f"follows {{other}} only loosely ({left}), so nothing else is stated"
        return self._both(pair.status, text, text, residual=fit.score)

    # How the numbers of an orientation, or the axes of rates, were read.

    def _reading(self) -> Iterator[Statement]:
        """Yield how an orientation was misread, or that rates are those of the reference frame."""
        fit, a, b = self._fit, self._a, self._b
        if a.is_rates == b.is_rates:
            # Of two orientations, either may be conjugate: that looks the same.
            side = Side(
                text=f"is conjugate, or of another layout ({self._worse()})",
                settings={"from_direction": "ref-to-body"},
                remedy="--from-direction ref-to-body",
            )
            # Which one it is, and of which layout, decides about the axes: nothing is said of them.
            self._turn = np.eye(3)
            yield Statement(code="reading", a=side, b=side, is_sure=False)
            return
        is_b = not b.is_rates
        orientation = b if is_b else a
        options = [
            (reading, turn)
            for reading in readings_of(orientation.layout)
            if reading.axes == REFERENCE == (fit.axes_b if is_b else fit.axes_a)
            and np.linalg.det(
                turn := reading.matrix @ fit.matrix if is_b else fit.matrix @ reading.matrix.T
            )
            > 0
        ]
        if options:
            options.sort(key=lambda each: turn_angle(each[1]))
            yield self._misread(options, is_b=is_b)
        elif fit.hand > 0:
            side = Side(
                text=f"rates are about the axes of the reference frame ({self._worse()})",
                settings={"rates": "inertial"},
                remedy="--rates inertial",
            )
            self._turn = np.eye(3)
            one, other = (side, None) if is_b else (None, side)
            yield Statement(code="inertial", a=one, b=other)

    def _misread(self, options: list[tuple[Reading, Float64]], *, is_b: bool) -> Statement:
        best, turn = options[0]
        angle = turn_angle(turn)
        text = f"is {best.name} ({self._worse()})"
        is_sure = angle < SURE and self._pair.a.device == self._pair.b.device
        if angle > NEAR and self._pair.is_within:
            best, turn = next(each for each in options if each[0].name.startswith("conjugate"))
            axes = min(
                (each for each in SIGNED_PERMUTATIONS if np.linalg.det(each) > 0),
                key=lambda each: turn_angle(turn @ each.T),
            )
            own = axes if is_b else axes.T
            text = f"is {best.name} ({self._worse()}), and its axes {_named(own)} of the rates"
            self._turn, is_sure = np.eye(3), False
        else:
            self._turn = turn
            if not is_sure and options[1:]:
                others = "; ".join(
                    f"{each.name}: {turn_angle(its) / DEG:.0f} deg" for each, its in options[1:]
                )
                text += f"; the axes then differ by {angle / DEG:.0f} deg (if it is {others})"
        settings = dict(best.settings)
        side = Side(text=text, settings=settings, remedy=self._read_by(settings, is_b=is_b))
        one, other = (None, side) if is_b else (side, None)
        return Statement(code="reading", a=one, b=other, is_sure=is_sure)

    def _read_by(self, settings: Mapping[str, str], *, is_b: bool) -> str:
        """Return the options that read an orientation so."""
        source = self._b if is_b else self._a
        # The order in a message is fixed by its definition; only its publisher can correct it.
        if source.is_message and "from_layout" in settings:
            return "its publisher has to correct the order"
        return options_text(settings)

    def _worse(self) -> str:
        return f"{self._pair.as_read:.3g} times worse as read"

    # Axes.

    def _axes(self) -> Iterator[Statement]:
        """Yield how the axes of both differ."""
        if not (self._a.has_axes and self._b.has_axes):
            return
        fit, tolerance = self._fit, self._tolerances.mount
        axes = nearest_axes(
            self._turn, fit.excited, fit.noise / fit.scale, either_hand=self._pair.is_flat
        )
        self._same = axes.are_same
        sigma = float(np.linalg.norm(np.minimum(fit.sigma[TURN], 3.0)))
        limit = max(tolerance, SIGNIFICANT * min(sigma, 1.0), 0.3 * fit.score)
        numbers = {"deg": axes.angle / DEG, "sigma_deg": min(sigma, 3.0) / DEG}
        if axes.are_mirrored and not self._pair.is_flat:
            yield self._mirrored(axes, numbers)
        elif not axes.are_same and (axes.angle < NEAR or axes.angle < SIGNIFICANT * sigma):
            yield self._exchanged(axes, limit, sigma)
        elif not axes.are_same or axes.angle > limit:
            yield self._mounted(axes, sigma)

    def _mirrored(self, axes: Axes, numbers: Mapping[str, float]) -> Statement:
        side = {
            name: Side(text=f"axes are mirrored: its {_named(matrix)} of {other}")
            for name, matrix, other in (
                ("a", axes.matrix.T, self._names[1]),
                ("b", axes.matrix, self._names[0]),
            )
        }
        if self._a.is_rates and not self._b.is_rates:
            return Statement(code="mirrored", a=side["a"], b=None, numbers=numbers)
        return Statement(code="mirrored", a=side["a"], b=side["b"], numbers=numbers)

    def _exchanged(self, axes: Axes, limit: float, sigma: float) -> Statement:
        beside = f", within {axes.angle / DEG:.1f} deg" if axes.angle > limit else ""
        to_a, to_b = axes.matrix.T, axes.matrix
        if axes.is_partial and self._pair.is_flat:
            return self._one_axis(axes)
        also = self._as_reading()
        sides = [
            Side(
                text=f"its axes {_named(own)} of {other}{beside}{also}",
                settings={"mount": axes_text(back)},
                remedy=_mount_option(source, axes_text(back)),
            )
            for source, own, back, other in (
                (self._a, to_a, to_b, self._names[1]),
                (self._b, to_b, to_a, self._names[0]),
            )
        ]
        numbers = {
            "axes": axes_text(axes.matrix),
            "deg": axes.angle / DEG,
            "sigma_deg": min(sigma, 3.0) / DEG,
        }
        return Statement(code="axes", a=sides[0], b=sides[1], numbers=numbers)

    def _one_axis(self, axes: Axes) -> Statement:
        """Return that the common axis of motion has another name, which is all that is shown."""
        _, directions = np.linalg.eigh(self._fit.excited)
        of_a = directions[:, -1]
        of_b = self._turn @ of_a
        if _direction(of_b).startswith("-"):
            of_a, of_b = -of_a, -of_b
        text_a, text_b = _direction(of_a), _direction(of_b)
        back, there = axes_text(axes.matrix.T), axes_text(axes.matrix)
        return Statement(
            code="axes",
            a=Side(
                text=f"turns about its {text_a} as {self._names[1]} about {text_b}; the motion "
                "shows this axis only",
                settings={"mount": there},
                remedy=_mount_option(self._a, there),
            ),
            b=Side(
                text=f"turns about its {text_b} as {self._names[0]} about {text_a}; the motion "
                "shows this axis only",
                settings={"mount": back},
                remedy=_mount_option(self._b, back),
            ),
            is_sure=False,
        )

    def _as_reading(self) -> str:
        """Return that a misread layout looks the same, if it does."""
        fit, b = self._fit, self._b
        if b.is_rates or not self._a.is_rates or not fit.is_plain:
            return ""
        for reading in readings_of(b.layout):
            if reading.axes == BODY and reading.settings:
                turn = reading.matrix @ fit.matrix
                if np.linalg.det(turn) > 0 and turn_angle(turn) < SURE:
                    return f"; or {b.name} is {reading.name}, which looks the same to rates"
        return ""

    def _mounted(self, axes: Axes, sigma: float) -> Statement:
        angle = axes.angle if axes.is_partial else turn_angle(self._turn)
        text = f"is mounted {value_text(angle, min(sigma, 3.0), ' deg', 1 / DEG)} from {{other}}"
        sides = [
            Side(
                text=text.format(other=other),
                settings={"mount": (mount := _quaternion(matrix))},
                remedy=_mount_option(source, mount),
            )
            for source, matrix, other in (
                (self._a, self._turn, self._names[1]),
                (self._b, self._turn.T, self._names[0]),
            )
        ]
        numbers = {"deg": angle / DEG, "sigma_deg": min(sigma, 3.0) / DEG}
        return Statement(code="mount", a=sides[0], b=sides[1], numbers=numbers)

    # Scale and unit.

    def _scale(self) -> Iterator[Statement]:
        fit = self._fit
        size, sigma = abs(math.log(fit.scale)), float(fit.sigma[SCALE])
        limit = max(math.log1p(self._tolerances.scale), SIGNIFICANT * sigma, fit.score)
        if size < limit:
            return
        names, sides = self._names, []
        is_unit = abs(size - math.log(180 / math.pi)) < UNIT
        for source, other, factor in (
            (self._a, names[1], fit.scale),
            (self._b, names[0], 1 / fit.scale),
        ):
            shown = f"{factor:.4g} +- {factor * sigma:.1g}"
            if not is_unit:
                text = (
                    f"its turns times {value_text(factor, factor * sigma, '')} are those of {other}"
                )
                settings = {"scale": f"{factor:.6g}"} if source.is_rates else {}
                sides.append(Side(text=text, settings=settings))
            elif factor < 1:
                text = f"deg/s read as rad/s (times {shown} it turns as {other})"
                sides.append(
                    Side(text=text, settings={"rate_unit": "deg/s"}, remedy="--rate-unit deg/s")
                )
            else:
                text = f"scaled by pi/180 once too often (times {shown} it turns as {other})"
                sides.append(Side(text=text, settings={"scale": f"{180 / math.pi:.6f}"}))
        # An orientation has no unit; one of wheels may turn too far.
        only_rates = is_unit and self._a.is_rates != self._b.is_rates
        a = None if only_rates and not self._a.is_rates else sides[0]
        b = None if only_rates and not self._b.is_rates else sides[1]
        numbers = {"factor": fit.scale, "sigma": fit.scale * sigma}
        yield Statement(code="unit" if is_unit else "scale", a=a, b=b, numbers=numbers)

    # Clocks.

    def _time(self) -> Iterator[Statement]:
        pair, fit, limits = self._pair, self._fit, self._tolerances
        sigma, sigma_clock = float(fit.sigma[OFFSET]), float(fit.sigma[CLOCK])
        over = abs(fit.clock) * fit.span
        clock_limit = max(limits.clock, SIGNIFICANT * sigma_clock)
        if abs(fit.clock) > clock_limit and over > 3 * limits.offset:
            numbers = {"ppm": fit.clock * 1e6, "sigma_ppm": sigma_clock * 1e6}
            texts = [
                f"its clock runs {value_text(sign * fit.clock, sigma_clock, ' ppm', 1e6)} faster "
                f"than that of {{other}}: {1e3 * over:.3g} ms over the log"
                for sign in (1, -1)
            ]
            if not pair.is_far:
                yield self._both("clock", texts[0], texts[1], **numbers)
            return
        intervals = [each.interval for each in (self._a, self._b)]
        limit = max(limits.offset, HALF * max(intervals), SIGNIFICANT * sigma)
        if pair.is_far or pair.repeats or abs(fit.offset) < limit or sigma > 0.3:  # noqa: PLR2004
            return
        sides = []
        for other, added in ((self._names[1], -fit.offset), (self._names[0], fit.offset)):
            word = "early" if added > 0 else "late"
            text = f"is {word} by {value_text(abs(added), sigma, ' ms', 1e3)} against {other}"
            shift = f"{added * 1e3:.4g}ms"
            sides.append(
                Side(
                    text=text,
                    settings={"time_offset": shift},
                    remedy=f"--time-offset {shift}",
                )
            )
        numbers = {"ms": fit.offset * 1e3, "sigma_ms": sigma * 1e3}
        yield Statement(code="offset", a=sides[0], b=sides[1], numbers=numbers)

    # What is constant beside the motion.

    def _constant(self, *, is_scaled: bool) -> Iterator[Statement]:
        pair, fit, limits = self._pair, self._fit, self._tolerances
        own = self._a.is_rates and not self._b.is_rates
        if pair.steady in {"bias", "either", "both"}:
            is_blind = float(certain(fit.covariance)[0][-1]) > BLIND
            if own and is_blind and not (fit.is_plain and self._same):
                return
            turned = fit.matrix.T if own and not is_blind else np.eye(3)
            # A unit or a scale is corrected before the bias is.
            scale = 1.0 if is_scaled or not own else fit.scale
            bias = -turned @ fit.bias / scale if own else fit.bias
            sigma = np.sqrt(turned**2 @ fit.sigma[BIAS] ** 2) / scale
            at = int(np.argmax(np.abs(fit.bias) / np.maximum(fit.sigma[BIAS], 1e-9)))
            in_b = limits.bias * (max(1.0, fit.scale) if self._b.is_rates else 1.0)
            certainty = float(fit.sigma[BIAS][at])
            limit = max(in_b, SIGNIFICANT * certainty, 0.02 * fit.score)
            if abs(fit.bias[at]) > limit and certainty < 0.1:  # noqa: PLR2004  # rad/s: unknown
                yield self._bias(bias, sigma, own=own, is_scaled=is_scaled)
        size = float(np.linalg.norm(fit.drift))
        sigma_drift = float(np.linalg.norm(fit.sigma[DRIFT]))
        limit = max(limits.drift, SIGNIFICANT * sigma_drift)
        if pair.steady in {"drift", "both"} and size > limit and sigma_drift < 0.1:  # noqa: PLR2004
            about = ", ".join(f"{x / size:.2f}" for x in fit.drift)
            about = f" about ({about}) of its reference" if fit.is_plain else ""
            text = (
                f"turns {value_text(size, sigma_drift, ' deg/s', 1 / DEG)}{about} away from "
                f"{self._names[0]}: a heading correction, or drift"
            )
            numbers = {"deg_s": size / DEG, "sigma_deg_s": sigma_drift / DEG}
            yield Statement(code="drift", a=None, b=Side(text=text), numbers=numbers)

    def _bias(self, bias: Float64, sigma: Float64, *, own: bool, is_scaled: bool) -> Statement:
        fit, names = self._fit, self._names
        shown = np.ones(3, np.bool_) if own else fit.shown

        def texts(values: Float64) -> str:
            parts = [
                f"{'xyz'[k]} {value_text(values[k], sigma[k], '', 1 / DEG)}"
                for k in np.flatnonzero(shown)
            ]
            return f"bias {', '.join(parts)} deg/s"

        either = ""
        if self._pair.steady == "either":
            either = f", or {names[1]} turns away about its reference: the motion does not tell"
        numbers = {
            "bias_deg_s": [float(x) / DEG for x in bias],
            "sigma_deg_s": [float(x) / DEG for x in sigma],
        }
        if own:
            when = " once its scale is right" if is_scaled else ""
            subtracted = ",".join(f"{x / DEG:.4g}" for x in bias) + "deg/s"
            side = Side(
                text=f"{texts(bias)}{when} against {names[1]}{either}",
                settings={"bias": subtracted},
                remedy=f"--bias={subtracted}",
            )
            return Statement(code="bias", a=side, b=None, numbers=numbers)
        if self._b.is_rates and not self._a.is_rates:
            subtracted = ",".join(f"{x / DEG:.4g}" for x in bias * shown) + "deg/s"
            side = Side(
                text=f"{texts(bias)} against {names[0]}",
                settings={"bias": subtracted},
                remedy=f"--bias={subtracted}",
            )
            return Statement(code="bias", a=None, b=side, numbers=numbers)
        return Statement(
            code="bias",
            a=Side(text=f"{texts(-bias)} in the axes of {names[1]}, against it"),
            b=Side(text=f"{texts(bias)} against {names[0]}{either}"),
            numbers=numbers,
        )


def _named(axes: Float64) -> str:
    """Return what the axes of a source are, ``"x, y, z are y, -x, z"``, in those of another."""
    return f"x, y, z are {axes_text(axes).replace(',', ', ')}"


def _direction(vector: Float64) -> str:
    """Return the axis that is nearest to a direction."""
    at = int(np.argmax(np.abs(vector)))
    return ("-" if vector[at] < 0 else "") + "xyz"[at]


def _quaternion(matrix: Float64) -> str:
    return ",".join(f"{x:.5f}" for x in from_matrix(matrix))


def _mount_option(source: Source, mount: str) -> str:
    return f"--mount={mount}" if source.is_rates else f"convert --right={mount}"


def options_text(settings: Mapping[str, str]) -> str:
    """Return settings as options."""
    return " ".join(f"--{name.replace('_', '-')} {value}" for name, value in settings.items())


def not_shown(pair: Pair) -> Iterator[tuple[str, str, str]]:
    """Yield what the motion of a pair does not show, of which source, and against which."""
    for text in _not_shown(pair):
        yield text, pair.b.name, pair.a.name


def _not_shown(pair: Pair) -> Iterator[str]:
    fit = pair.fit
    if fit is None or pair.status == "at rest":
        yield "anything, as there is too little motion in common,"
        return
    if pair.status == "repeating":
        yield "anything, as the motion repeats itself,"
    if pair.status != "related":
        return
    sigma, directions = certain(fit.covariance)
    if sigma[-1] > BLIND:
        mirrors = ", or mirrored axes," if pair.is_flat else ""
        yield f"the rotation about {_about(directions[:, -1])}{mirrors}"
    elif pair.is_flat:
        yield "mirrored axes"
    if pair.is_far:
        offset = value_text(fit.offset, float(fit.sigma[OFFSET]), " s")
        yield f"a common clock (the zeros differ by {offset})"
    elif pair.repeats:
        yield "the clock offset, as the motion repeats itself,"
    elif fit.sigma[OFFSET] > 0.02:  # noqa: PLR2004  # s
        yield f"the clock offset better than {1e3 * fit.sigma[OFFSET]:.0f} ms"
    if fit.score < SAME and pair.a.device != pair.b.device:
        yield "a second measurement (one is made of the other)"


def _about(direction: Float64) -> str:
    """Return a direction: an axis if it is one, else its components."""
    at = int(np.argmax(np.abs(direction)))
    if abs(direction[at]) > 0.99:  # noqa: PLR2004  # 8 deg
        return "xyz"[at]
    return f"({', '.join(f'{x:.2f}' for x in direction)})"
