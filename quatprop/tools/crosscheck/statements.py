"""Statements on one pair of sources, significant and beyond tolerance, and open questions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.estimation.relation import BIAS, CLOCK, DRIFT, OFFSET, SCALE
from quatprop.tools.crosscheck.axes_of_pair import AxesOfPair
from quatprop.tools.crosscheck.pair import (
    DEG,
    SIGNIFICANT,
    Side,
    Statement,
    Tolerances,
    repairable,
    value_text,
)
from quatprop.tools.crosscheck.repairs import as_recorded

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Float64
    from quatprop.tools.crosscheck.pair import Pair

UNIT: Final = 0.06
"""A scale whose logarithm is this near to that of 180/pi is a wrong unit."""

HALF: Final = 0.6
"""Offsets below this many intervals are of integration: half of one, where a filter puts its
attitude at the beginning or the end of a sample."""

BEYOND: Final = 3.0
"""Standard deviations by which an offset must exceed the tolerance."""

BLIND: Final = 0.1
"""A rotation is not shown where its standard deviation is above this, rad."""


def statements_of(pair: Pair, tolerances: Tolerances) -> list[Statement]:
    """Return the statements on a pair, beyond five standard deviations and the tolerances."""
    fit = pair.stated
    return [] if fit is None else [*_Statements(pair, fit, tolerances).every()]


class _Statements(AxesOfPair):
    """The statements on one pair."""

    def every(self) -> Iterator[Statement]:
        pair, fit = self._pair, self._fit
        if pair.status in {"weak", "unrelated"}:
            yield self._weak()
        if pair.change is not None:
            change = pair.change
            texts = [f"differs along the log: from {change.at:.3f} s on, {one}, against {{other}}"
                     for one in (change.of_a, change.of_b)]  # fmt: skip
            yield self._both("changes", *texts, seconds=change.at)
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
        yield from self._scale()
        yield from self._time()
        yield from self._constant()

    def _weak(self) -> Statement:
        pair, fit = self._pair, self._fit
        share = "all" if fit.score >= 1 else f"{100 * fit.score:.0f} %"
        left = f"{share} of the motion of {fit.motion / DEG:.3g} deg/s is left"
        text = f"rates have nothing in common with those of {{other}} ({left})"
        if pair.status == "weak":
            text = f"follows {{other}} only loosely ({left}), so nothing else is stated"
        return self._both(pair.status, text, text, residual=fit.score)

    # Scale and unit.

    def _scale(self) -> Iterator[Statement]:
        fit = self._fit
        size, sigma = abs(math.log(fit.scale)), float(fit.sigma[SCALE])
        limit = max(math.log1p(self._tolerances.scale), SIGNIFICANT * sigma, fit.score)
        if size < limit:
            return
        names, sides = self._names, []
        is_unit = abs(size - math.log(180 / math.pi)) < UNIT
        fit = self._pair.fit if is_unit and self._pair.fit else self._measured(SCALE)
        sigma = float(fit.sigma[SCALE])
        for source, other, factor in (
            (self._a, names[1], fit.scale),
            (self._b, names[0], 1 / fit.scale),
        ):
            shown = f"{factor:.4g} +- {factor * sigma:.1g}"
            if not is_unit:
                times = value_text(factor, factor * sigma, "")
                text = f"its rates times {times} match those of {other}"
                settings = {"scale": f"{factor:.6g}"} if source.is_rates else {}
                sides.append(Side(text=text, settings=settings))
            elif factor < 1:
                text = f"deg/s read as rad/s (its rates times {shown} match those of {other})"
                sides.append(repairable(text, {"rate_unit": "deg/s"}))
            else:
                text = f"is scaled by pi/180 once too often ({shown} times slower than {other})"
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
        is_drifting = abs(fit.clock) > clock_limit and over > 3 * limits.offset
        if is_drifting and not pair.is_stepping:
            fit = self._measured(CLOCK)
            sigma_clock = float(fit.sigma[CLOCK])
            numbers = {"ppm": fit.clock * 1e6, "sigma_ppm": sigma_clock * 1e6}
            texts = [
                f"its clock runs {value_text(sign * fit.clock, sigma_clock, ' ppm', 1e6)} faster "
                f"than that of {{other}}: {1e3 * over:.3g} ms over the log"
                for sign in (1, -1)
            ]
            if not pair.is_far:
                yield self._both("clock", texts[0], texts[1], **numbers)
        # A drift explains an offset if the clocks agree at some time.
        drifted = over / 2 if is_drifting and not pair.is_stepping else 0.0
        tolerated = drifted + max(limits.offset, HALF * max(self._a.interval, self._b.interval))
        limit = max(tolerated, SIGNIFICANT * sigma)
        if pair.is_far or pair.repeats or abs(fit.offset) < limit or sigma > 0.3:  # noqa: PLR2004
            return
        fit = self._measured(OFFSET)
        sigma = float(fit.sigma[OFFSET])
        if abs(fit.offset) < tolerated + BEYOND * sigma:
            return
        where = " in the middle of the log" if drifted else ""
        sides = []
        for other, added in ((self._names[1], -fit.offset), (self._names[0], fit.offset)):
            word = "early" if added > 0 else "late"
            by = value_text(abs(added), sigma, " ms", 1e3)
            text = f"is {word} by {by}{where} against {other}"
            sides.append(repairable(text, {"time_offset": f"{added * 1e3:.4g}ms"}))
        numbers = {"ms": fit.offset * 1e3, "sigma_ms": sigma * 1e3}
        yield Statement(code="offset", a=sides[0], b=sides[1], numbers=numbers)

    # Constant differences.

    def _constant(self) -> Iterator[Statement]:
        pair, fit, limits = self._pair, self._fit, self._tolerances
        own = self._a.is_rates and not self._b.is_rates
        if pair.steady in {"bias", "bias or drift", "both"}:
            is_blind = float(_certain(fit.covariance)[0][-1]) > BLIND
            if own and is_blind and not (fit.is_plain and self._same):
                return
            turned = fit.matrix.T if own and not is_blind else np.eye(3)
            # A unit is corrected before the bias is, and a scale after it.
            scale = fit.scale if own else 1.0
            scale /= math.radians(1.0) if self._is_in_degrees(own=own) else 1.0
            bias = (-turned if own else turned) @ fit.bias / scale
            sigma = np.sqrt(turned**2 @ self._measured(BIAS).sigma[BIAS] ** 2) / scale
            at = int(np.argmax(np.abs(fit.bias) / np.maximum(fit.sigma[BIAS], 1e-9)))
            in_b = limits.bias * (max(1.0, fit.scale) if self._b.is_rates else 1.0)
            certainty = float(fit.sigma[BIAS][at])
            limit = max(in_b, SIGNIFICANT * certainty, 0.02 * fit.score)
            if abs(fit.bias[at]) > limit and certainty < 0.1:  # noqa: PLR2004  # rad/s: unknown
                yield self._bias(bias, sigma, own=own)
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

    def _is_in_degrees(self, *, own: bool) -> bool:
        """Return whether the rates next to an orientation are in deg/s."""
        factor = self._fit.scale if own else 1 / self._fit.scale
        return self._a.is_rates != self._b.is_rates and abs(math.log(factor / DEG)) < UNIT

    def _bias(self, bias: Float64, sigma: Float64, *, own: bool) -> Statement:
        fit, names = self._fit, self._names
        shown = np.ones(3, np.bool_) if own else fit.shown
        if self._a.is_rates != self._b.is_rates:
            source, other = (self._a, names[1]) if own else (self._b, names[0])
            bias, sigma = as_recorded(source, np.where(shown, bias, 0.0), sigma)
            shown = shown | bool({"mount", "axes"} & {*source.corrected})

        def texts(values: Float64) -> str:
            parts = [
                f"{'xyz'[k]} {value_text(values[k], sigma[k], '', 1 / DEG)}"
                for k in np.flatnonzero(shown)
            ]
            return f"bias {', '.join(parts)} deg/s"

        alternative = ""
        if self._pair.steady == "bias or drift":
            alternative = f", or {names[1]} drifts: the motion does not show which"
        numbers = {
            "bias_deg_s": [float(x) / DEG for x in bias],
            "sigma_deg_s": [float(x) / DEG for x in sigma],
        }
        if self._a.is_rates != self._b.is_rates:
            subtracted = ",".join(f"{x / DEG:.4g}" for x in bias) + "deg/s"
            text = f"{texts(bias)} against {other}{alternative if own else ''}"
            side = repairable(text, {"bias": subtracted})
            return Statement.one_sided("bias", side, of_a=own, numbers=numbers)
        return Statement(
            code="bias",
            a=Side(text=f"{texts(-bias)} in the axes of {names[1]}, against it"),
            b=Side(text=f"{texts(bias)} against {names[0]}{alternative}"),
            numbers=numbers,
        )


def not_shown(pair: Pair) -> Iterator[tuple[str, str, str]]:
    """Yield each relation that the motion of a pair does not determine, with both sources."""
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
    sigma, directions = _certain(fit.covariance)
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


def _about(direction: Float64) -> str:
    """Return a direction: an axis if it is one, else its components."""
    at = int(np.argmax(np.abs(direction)))
    if abs(direction[at]) > 0.99:  # noqa: PLR2004  # 8 deg
        return "xyz"[at]
    return f"({', '.join(f'{x:.2f}' for x in direction)})"


def _certain(covariance: Float64) -> tuple[Float64, Float64]:
    """Return standard deviations of a rotation, the largest last, and their directions."""
    variance, directions = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(variance, 0.0)), directions
