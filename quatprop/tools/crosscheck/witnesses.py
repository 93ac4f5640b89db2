"""The rates and the orientation of one device, as other devices see them.

Some faults look the same within a device: mirrored rates next to a conjugate look like rates of the
reference frame, and a bias like a drift. A third source decides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from quatprop.estimation.relation import BIAS
from quatprop.tools.crosscheck.facts import (
    DEG,
    SIGNIFICANT,
    Side,
    Statement,
    Tolerances,
    value_text,
)
from quatprop.tools.crosscheck.pair import Pair

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.tools.crosscheck.sources import Source

Statements: TypeAlias = tuple[Pair, list[Statement]]
"""A pair, and the statements on it."""

REMARKS: Final = frozenset({"bias", "drift"})
"""Facts that every sensor shows: no reason to fail."""

CLEAR: Final = 0.3
"""Share of the motion that is left, below which a pair is a witness."""

_CONJUGATE: Final = {"from_direction": "ref-to-body"}


def as_others_see(
    pair: Pair, own: list[Statement], between: Sequence[Statements], tolerances: Tolerances
) -> list[Statement]:
    """Return the statements on the rates and the orientation of a device, corrected by others."""
    if pair.status != "related" or pair.a.is_rates == pair.b.is_rates:
        return own
    rates, orientation = (pair.a, pair.b) if pair.a.is_rates else (pair.b, pair.a)
    plain = [*_plain(rates, between)]
    mirrored = [
        one
        for other, statements in between
        if other.a is rates and not other.is_flat
        for one in statements
        if one.code == "mirrored"
    ]
    codes = {one.code for one in own}
    if mirrored and plain and "inertial" in codes:
        side = Side(
            text="is conjugate (reference to body), as the rates next to it are mirrored",
            settings=_CONJUGATE,
            remedy="--from-direction ref-to-body",
        )
        return [mirrored[0], _about("reading", orientation, pair, side)]
    fits = any(not other.is_flat for other in _plain(orientation, between))
    if fits and not plain and "reading" in codes:
        side = Side(
            text="rates are about the axes of the reference frame, as other devices confirm",
            settings={"rates": "inertial"},
            remedy="--rates inertial",
        )
        inertial = _about("inertial", rates, pair, side)
        return [inertial if one.code == "reading" else one for one in own]
    if mirrored and pair.is_flat:
        return [one for one in own if one.code not in {"axes", "mount"}] + mirrored[:1]
    drift = _drift(pair, between, tolerances) if pair.a is rates else None
    if drift is not None:
        return [one for one in own if one.code not in REMARKS] + [drift]
    return own


def _about(code: str, source: Source, pair: Pair, side: Side) -> Statement:
    """Return a statement about one source of a pair."""
    is_a = source is pair.a
    return Statement(code=code, a=side if is_a else None, b=None if is_a else side)


def _plain(source: Source, between: Sequence[Statements]) -> Iterator[Pair]:
    """Yield the pairs of a source with other devices in which no reading is needed."""
    for other, _ in between:
        is_plain = other.fit is not None and other.fit.is_plain
        if source in (other.a, other.b) and other.status == "related" and is_plain:
            yield other


def _drift(pair: Pair, between: Sequence[Statements], tolerances: Tolerances) -> Statement | None:
    """Return that an orientation turns away, if others confirm the rates next to it."""
    if pair.steady in {"drift", "both"}:
        return None  # the motion shows it without others
    own = gyro_bias(pair)
    biases = [
        gyro_bias(other)
        for other in _plain(pair.a, between)
        if other.a is pair.a and other.fit is not None and other.fit.score < CLEAR
    ]
    others = [one for one in biases if one is not None]
    if own is None or not others:
        return None
    weights = [1 / np.maximum(sigma, 1e-5) ** 2 for _, sigma in others]
    total = np.sum(weights, axis=0)
    mean = np.sum([bias * w for (bias, _), w in zip(others, weights, strict=True)], axis=0)
    difference = own[0] - mean / total
    sigma = np.sqrt(own[1] ** 2 + 1 / total)
    at = int(np.argmax(np.abs(difference) / sigma))
    if abs(difference[at]) < max(tolerances.bias, SIGNIFICANT * sigma[at]):
        return None
    size, certainty = float(np.linalg.norm(difference)), float(np.linalg.norm(sigma))
    about = ", ".join(f"{x / size:.2f}" for x in difference)
    count = f"{len(others)} other comparison{'s' * (len(others) > 1)}"
    text = (
        f"turns {value_text(size, certainty, ' deg/s', 1 / DEG)} about body ({about}) away from "
        f"the rates next to it, which {count} confirm{'s' * (len(others) == 1)}"
    )
    numbers = {"deg_s": size / DEG, "sigma_deg_s": certainty / DEG}
    return Statement(code="drift", a=None, b=Side(text=text), numbers=numbers)


def gyro_bias(pair: Pair) -> tuple[Float64, Float64] | None:
    """Return the bias of A's rates in their axes and B's unit, and its deviations, rad/s."""
    fit = pair.fit
    if fit is None or not pair.a.is_rates or not fit.is_plain:
        return None
    back = fit.matrix.T
    sigma = np.where(fit.shown, fit.sigma[BIAS], 10.0)
    bias = -back @ np.where(fit.shown, fit.bias, 0.0)
    return bias, np.sqrt(back**2 @ sigma**2)
