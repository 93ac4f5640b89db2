"""How a pair was read: layouts and directions, exchanged and mirrored axes, and mountings."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from quatprop.estimation.relation import TURN
from quatprop.estimation.turning import BODY, REFERENCE
from quatprop.kinematics.quaternion import from_matrix, log
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS, axes_text
from quatprop.tools.crosscheck.classes import (
    NEAR,
    Axes,
    Reading,
    nearest_axes,
    readings_of,
    turn_angle,
)
from quatprop.tools.crosscheck.pair import (
    DEG,
    SIGNIFICANT,
    Side,
    Statement,
    Tolerances,
    repairable,
    value_text,
)
from quatprop.tools.crosscheck.repairs import mounting_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.base.arrays import Float64
    from quatprop.estimation.relation import Relation
    from quatprop.tools.crosscheck.pair import Pair
    from quatprop.tools.crosscheck.sources import Source

SURE: Final = 5 * DEG
"""A reading that leaves a smaller rotation between the axes of one device is certain."""


TRADED: Final = 10.0
"""Standard deviations are larger by this factor where the motion trades two differences."""


class AxesOfPair:
    """The statements about readings and axes of one pair."""

    def __init__(self, pair: Pair, fit: Relation, tolerances: Tolerances) -> None:
        self._pair, self._fit, self._tolerances = pair, fit, tolerances
        self._a, self._b = pair.a, pair.b
        self._names = pair.a.name, pair.b.name

    def _measured(self, of: slice | int) -> Relation:
        """Return the fit whose deviations contain what is not stated, if it determines a number.

        Where the motion trades differences for one another, that of the stated ones is left.
        """
        full, stated = self._pair.fit, self._fit
        if full is None or not np.all(full.free[of]):
            return stated
        is_traded = np.max(full.sigma[of]) > TRADED * np.max(stated.sigma[of])
        return stated if is_traded else full

    def _both(self, code: str, text_a: str, text_b: str, **numbers: Any) -> Statement:
        """Return a statement that may be about either source."""
        name_a, name_b = self._names
        side_a, side_b = text_a.format(other=name_b), text_b.format(other=name_a)
        return Statement(code=code, a=Side(text=side_a), b=Side(text=side_b), numbers=numbers)

    # How the numbers of an orientation, or the axes of rates, were read.

    def _reading(self) -> Iterator[Statement]:
        """Yield how an orientation was misread, or that rates are those of the reference frame."""
        fit, a, b = self._fit, self._a, self._b
        if a.is_rates == b.is_rates:
            # Of two orientations, either may be conjugate: that looks the same.
            text = f"is conjugate, or of another layout ({self._worse()})"
            side = repairable(text, {"from_direction": "ref-to-body"})
            # The axes depend on which one it is, and on its layout: no statement on them.
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
            text = f"rates are about the axes of the reference frame ({self._worse()})"
            self._turn = np.eye(3)
            side = repairable(text, {"rates": "inertial"})
            yield Statement.one_sided("inertial", side, of_a=is_b)

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
            text = (
                f"is {best.name} ({self._worse()}), and its axes {_axes_sentence(own)} of the rates"
            )
            self._turn, is_sure = np.eye(3), False
        else:
            self._turn = turn
            if not is_sure and options[1:]:
                others = "; ".join(
                    f"{each.name}: {turn_angle(its) / DEG:.0f} deg" for each, its in options[1:]
                )
                text += f"; the axes then differ by {angle / DEG:.0f} deg (if it is {others})"
        side, source = repairable(text, dict(best.settings)), self._b if is_b else self._a
        # The order in a message is fixed by its definition; only its publisher can correct it.
        if source.is_message and "from_layout" in side.settings:
            side = replace(side, remedy="its publisher has to correct the order")
        return Statement.one_sided("reading", side, of_a=not is_b, is_sure=is_sure)

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
        certain = float(np.linalg.norm(np.minimum(self._measured(TURN).sigma[TURN], 3.0)))
        numbers = {"deg": axes.angle / DEG, "sigma_deg": min(certain, 3.0) / DEG}
        if axes.are_mirrored and not self._pair.is_flat:
            yield self._mirrored(axes, numbers)
        elif not axes.are_same and (axes.angle < NEAR or axes.angle < SIGNIFICANT * sigma):
            yield self._exchanged(axes, limit, sigma)
        elif not axes.are_same or axes.angle > limit:
            yield self._mounted(axes)

    def _mirrored(self, axes: Axes, numbers: Mapping[str, float]) -> Statement:
        side = {
            name: Side(
                text=f"axes are mirrored: its {_axes_sentence(back.T)} of {other}",
                settings={"axes": axes_text(back)} if source.is_rates else {},
            )
            for name, source, back, other in (
                ("a", self._a, axes.matrix, self._names[1]),
                ("b", self._b, axes.matrix.T, self._names[0]),
            )
        }
        if self._a.is_rates and not self._b.is_rates:
            return Statement(code="mirrored", a=side["a"], b=None, numbers=numbers)
        return Statement(code="mirrored", a=side["a"], b=side["b"], numbers=numbers)

    def _exchanged(self, axes: Axes, limit: float, sigma: float) -> Statement:
        within = f", within {axes.angle / DEG:.1f} deg" if axes.angle > limit else ""
        to_a, to_b = axes.matrix.T, axes.matrix
        if axes.is_partial and self._pair.is_flat:
            return self._one_axis(axes)
        also = self._as_reading()
        sides = [
            _turned(
                source, f"its axes {_axes_sentence(own)} of {other}{within}{also}", axes_text(back)
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
        sides = [
            _turned(
                source,
                f"turns about its {own} as {other} about {its}; the motion shows this axis only",
                mount,
            )
            for source, own, other, its, mount in (
                (self._a, text_a, self._names[1], text_b, there),
                (self._b, text_b, self._names[0], text_a, back),
            )
        ]
        return Statement(code="axes", a=sides[0], b=sides[1], is_sure=False)

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

    def _mounted(self, axes: Axes) -> Statement:
        angle = axes.angle if axes.is_partial else turn_angle(self._turn)
        about = log(from_matrix(self._turn)) / max(turn_angle(self._turn), 1e-9)
        sigma = float(np.linalg.norm(self._measured(TURN).sigma[TURN] * about))
        text = f"is mounted {value_text(angle, min(sigma, 3.0), ' deg', 1 / DEG)} from {{other}}"
        sides = [
            _turned(source, text.format(other=other), mounting_text(matrix))
            for source, matrix, other in (
                (self._a, self._turn, self._names[1]),
                (self._b, self._turn.T, self._names[0]),
            )
        ]
        numbers = {"deg": angle / DEG, "sigma_deg": min(sigma, 3.0) / DEG}
        return Statement(code="mount", a=sides[0], b=sides[1], numbers=numbers)


def _axes_sentence(axes: Float64) -> str:
    """Return the axes of a source, ``"x, y, z are y, -x, z"``, in those of another."""
    return f"x, y, z are {axes_text(axes).replace(',', ', ')}"


def _direction(vector: Float64) -> str:
    """Return the axis that is nearest to a direction."""
    at = int(np.argmax(np.abs(vector)))
    return ("-" if vector[at] < 0 else "") + "xyz"[at]


def _turned(source: Source, text: str, mount: str) -> Side:
    """Return a side that a mounting repairs."""
    remedy = f"--mount={mount}" if source.is_rates else f"convert --right={mount}"
    return Side(text=text, settings={"mount": mount}, remedy=remedy)
