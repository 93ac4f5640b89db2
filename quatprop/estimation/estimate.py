"""From rates and a reference to what differs between them: search, fit, jumps, and validation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError, UsageError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.estimation.cells import Cells, cells_of_attitudes, cells_of_rates
from quatprop.estimation.fit import REJECTED, Data, Estimate, Priors, fit, informations, rule_errors
from quatprop.estimation.followed import Followed, follow
from quatprop.estimation.jumps import with_jumps
from quatprop.estimation.model import (
    OF_GROUP,
    FollowedMotion,
    Model,
    RotationWindows,
    errors_of,
    joined,
    windows_of,
)
from quatprop.estimation.search import CELL_NS, OffsetSearch, agreement, candidate_at, search_series
from quatprop.kinematics.quaternion import from_matrix, geodesic_angle, rotation_matrix
from quatprop.kinematics.time_series import rms

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64
    from quatprop.estimation.covariances import Candidate
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries

LENGTHS_NS: Final = tuple(int(1e8 * length) for length in (1, 2, 5, 10, 20, 50))
"""Candidate lengths of windows. Noise of the reference dominates short ones, noise of the rates
long ones: the length with the smallest determinant of the covariance is used."""

FIRST_NS: Final = 1_000_000_000
"""Length of the windows of the first estimate, with which the lengths are compared."""

MIN_WINDOWS: Final = 60
"""Minimum number of windows."""

MIN_INTERVALS: Final = 2
"""Minimum length of windows, in intervals of the reference."""

PARTS: Final = 30
"""Parts of the recording, of which every third is held out for validation."""

DETERMINED: Final = 0.5
"""A parameter is determined if its standard deviation is below this share of its prior."""

NEAR: Final = 3
"""Intervals on either side of a given offset in which the motion is looked for."""

FAR: Final = 2.0
"""Standard deviations beyond which a mounting is another one than the given one."""

AS_GOOD: Final = 1.2
"""Offsets with up to this multiple of the least residual are equally good: the nearest is taken."""

ROUNDING: Final = 1e-9
"""Residual of exact series, as a share of the motion."""

FINER: Final = 4
"""Places in each of these intervals."""

OF_RATES: Final = ~np.isin(OF_GROUP, ("offset", "drift"))
"""The parameters that a file can state."""

VALLEY: Final = 0.95
"""Correlation of two parameters that are hardly distinguished."""


class Question(NamedTuple):
    """The parameters to estimate, and from what.

    `names`: groups of parameters; the others are taken to be right
    `priors`: standard deviation of each group; of the offset None: one interval
    `offset_ns`: to be added to the timestamps of the reference beforehand; None: unknown
    `mount`: sensor to body, wxyz, as far as it is known
    `window_ns`: length of windows; None: the best one
    """

    names: tuple[str, ...]
    priors: dict[str, float | None]
    offset_ns: int | None
    mount: Float64
    window_ns: int | None


class Validation(NamedTuple):
    """Errors of rotations over windows that were not used.

    `windows`: number of windows
    `given_rad`, `clock_rad`, `all_rad`: RMS as given, with the clock corrected, with everything
    `clock_sigma_rad`, `file_sigma_rad`: standard deviations of the differences of the first and the
        last two
    """

    windows: int
    given_rad: float
    clock_rad: float
    all_rad: float
    clock_sigma_rad: float
    file_sigma_rad: float


class CalibrationEstimate(NamedTuple):
    """An estimate, and the facts about it.

    `estimate`: of all parameters together
    `covariance`: of their errors, and of the variation of the bias, SI units, shape ``(14, 14)``
    `determined`: whether the motion shows a parameter, shape ``(14,)``
    `mirror`: the factors of the axes of the rates, applied first, shape ``(3, 3)``
    `windows`: from which it was estimated
    `followed`: the motion that the reference follows
    `validation`: what it improves
    """

    estimate: Estimate
    covariance: Float64
    determined: Bool
    mirror: Float64
    windows: RotationWindows
    followed: Followed
    validation: Validation

    def valleys(self) -> list[tuple[int, int, float]]:
        """Return pairs of indistinguishable parameters, and how much of one equals the other."""
        estimate = self.estimate
        index = np.flatnonzero(estimate.free[: len(OF_GROUP)])
        sigma = np.sqrt(estimate.covariance.diagonal()[index])
        correlation = estimate.covariance[np.ix_(index, index)] / np.outer(sigma, sigma)
        pairs = []
        for i, j in zip(*np.triu_indices(len(index), 1), strict=True):
            if abs(correlation[i, j]) > VALLEY:
                slope = np.sign(correlation[i, j]) * sigma[i] / sigma[j]
                pairs.append((int(index[i]), int(index[j]), float(slope)))
        return pairs


def estimate(
    rates: GyroSeries, reference: AttitudeSeries, question: Question
) -> CalibrationEstimate:
    """Estimate what differs between rates and a reference, both in order of time and finite."""
    candidate, centre_ns, interval_ns = _beginning(rates, reference, question)
    mirror = _mirror(candidate.turn)
    if "mount" not in question.names:
        candidate = candidate._replace(turn=rotation_matrix(question.mount))
        mirror = np.eye(3)
    turn = candidate.turn @ mirror
    rates = rates.with_rate(rates.rate @ mirror)
    followed = follow(rates, reference, candidate.offset_ns, turn)
    _refuse_unit(followed)
    if not len(followed.seen.errors):
        raise ComparisonError(
            "the reference does not follow the rotation of the log about any axis; choose another "
            f"one, or give the difference of the clocks with {Setting('time_offset')}"
        )
    given = Model(
        mount=question.mount,
        added_ns=question.offset_ns or 0,
        middle_ns=(int(reference.t_ns[0]) + int(reference.t_ns[-1])) // 2,
    )
    centre = given._replace(added_ns=centre_ns)
    if "mount" in question.names:
        centre = centre._replace(mount=_mount_between(question, from_matrix(turn)))
    priors = _priors(question, centre, interval_ns)
    windows = _lengths(rates, reference, centre, question.window_ns)
    begin = centre._replace(offset=(candidate.offset_ns - centre_ns) / NS_PER_S)
    if "mount" in question.names:
        begin = begin._replace(mount=from_matrix(turn))
    best, every = _best(rates, windows, priors, begin, followed.seen)
    every = with_jumps(best, priors, every)
    every = _with_tilt(every, followed)
    covariance = _with_variation(every)
    sigma = np.sqrt(covariance.diagonal())
    determined = (priors.sigma > 0) & (sigma < DETERMINED * priors.sigma)
    if not determined.any():
        raise ComparisonError(
            "none of the requested parameters can be estimated: the motion is too small for the "
            "noise, or the clocks differ; record for longer, or estimate less"
        )
    count = len(best.windows)
    part = np.arange(count) * PARTS // count % 3 == 1
    partial = fit(best.where(~part), priors, every.model)
    validation = _validated(best.where(part), given, partial)
    if not determined[OF_RATES].any():
        every = every._replace(model=_with_clock(given, every.model))
        validation = validation._replace(all_rad=validation.clock_rad, file_sigma_rad=0.0)
    return CalibrationEstimate(
        every, covariance, determined, mirror, best.windows, followed, validation
    )


def _beginning(
    rates: GyroSeries, reference: AttitudeSeries, question: Question
) -> tuple[Candidate, int, float]:
    """Return where the fit begins, the most likely offset, ns, and its standard deviation, ns."""
    interval_ns = max(float(np.median(np.diff(series.t_ns))) for series in (rates, reference))
    mount = rotation_matrix(question.mount)
    offset_ns = question.offset_ns
    if offset_ns is None and "offset" in question.names:
        found = search_series(rates, reference, mount)
        if found is not None and found.is_found:
            best = found.candidates[0]
            sigma_ns = max(interval_ns, found.cell_ns / 2, 3 * best.spread_ns)
            return best, best.offset_ns, sigma_ns
        if found is not None and found.is_repeating:
            raise ComparisonError(_repeats(found))
    offset_ns = offset_ns or 0
    b = cells_of_attitudes(reference, max(CELL_NS, int(1.5 * interval_ns)))
    best_ns = offset_ns
    if "offset" in question.names:
        # Rates at a wrong time are turned, and look as if they were not followed.
        steps = sorted(range(-NEAR * FINER, NEAR * FINER + 1), key=abs)
        near = [offset_ns + round(step * interval_ns / FINER) for step in steps]
        left = np.array([1 - agreement(_cells_for(rates, b, at_ns), b) ** 2 for at_ns in near])
        best_ns = near[int(np.argmax(left <= AS_GOOD * left.min() + ROUNDING))]
    a = cells_of_rates(rates, b.length_ns, b.start_ns + best_ns)
    both = [candidate_at(a, b, best_ns, mount, mirrored=hand) for hand in (False, True)]
    if both[0] is None or both[1] is None:
        raise ComparisonError(
            f"the log, {rates.t_ns[0]} to {rates.t_ns[-1]} ns, and the reference, "
            f"{reference.t_ns[0]} to {reference.t_ns[-1]} ns, have no time in common, or too "
            f"little; add their difference with {Setting('time_offset')}"
        )
    search = OffsetSearch((both[0],), (both[1],), 0.0, len(b), b.length_ns)
    return search.candidates[0], offset_ns, interval_ns


def _mount_between(question: Question, found: Float64) -> Float64:
    """Return the most likely mounting before the fit: the given one, unless it is far away."""
    sigma = question.priors["mount"] or 0.0
    is_near = geodesic_angle(found, question.mount) < FAR * sigma
    return question.mount if is_near else found


def _cells_for(rates: GyroSeries, b: Cells, offset_ns: int) -> Cells:
    """Return cells of rates that begin with those of a reference."""
    a = cells_of_rates(rates, b.length_ns, b.start_ns + offset_ns)
    return Cells(a.start_ns - offset_ns, a.length_ns, a.rate, a.known)


def _repeats(found: OffsetSearch) -> str:
    offsets = ", ".join(f"{one.offset_ns / NS_PER_S:+.3f} s" for one in found.candidates[:3])
    fits = f"offsets of {offsets} fit" if len(found.candidates) > 1 else "many offsets fit"
    return (
        f"the motion repeats itself, so that {fits} equally well; give the right one with "
        f"{Setting('time_offset')}, or {Setting('time_offset', '0')} for one clock"
    )


def _mirror(turn: Float64) -> Float64:
    """Return the mirror of one axis that makes a matrix the smallest proper rotation."""
    if np.linalg.det(turn) > 0:
        return np.eye(3)
    mirrors = [np.eye(3) - 2 * np.diag(row) for row in np.eye(3)]
    return max(mirrors, key=lambda mirror: float(np.trace(turn @ mirror)))


def _refuse_unit(followed: Followed) -> None:
    factor = followed.factor
    if factor == 1.0:
        return
    known = {np.pi / 180: "deg/s", 180 / np.pi: "rad/s"}
    unit = next((name for size, name in known.items() if abs(factor / size - 1) < 0.2), None)  # noqa: PLR2004
    text = (
        f"the rates of the log are {1 / factor:.3g} times as large as the rotation of the reference"
    )
    remedy = f"they are in {unit}: {Setting('rate_unit', unit)}" if unit else "check their unit"
    raise ComparisonError(f"{text}; {remedy}")


def _priors(question: Question, centre: Model, interval_ns: float) -> Priors:
    each = {name: question.priors[name] for name in question.priors}
    if each["offset"] is None:
        each["offset"] = interval_ns / NS_PER_S
    sigma = [each[name] if name in question.names else 0.0 for name in OF_GROUP]
    return Priors(centre, np.array(sigma, float), float(each["bias"] or 0.0))


def _lengths(
    rates: GyroSeries, reference: AttitudeSeries, centre: Model, window_ns: int | None
) -> list[RotationWindows]:
    """Return the windows of every length that gives enough of them."""
    shortest = MIN_INTERVALS * float(np.median(np.diff(reference.t_ns)))
    if window_ns is not None and window_ns < shortest:
        raise UsageError(
            f"windows of {duration_text(window_ns)} are shorter than {MIN_INTERVALS} intervals of "
            f"the reference; choose {Setting('window')} of {duration_text(int(shortest))} or more"
        )
    lengths = LENGTHS_NS if window_ns is None else (window_ns,)
    usable = [each for each in lengths if each >= shortest] or [int(np.ceil(shortest))]
    windows = [windows_of(rates, reference, centre, each) for each in usable]
    enough = [each for each in windows if len(each) >= MIN_WINDOWS]
    if not enough:
        raise ComparisonError(
            f"the log and the reference have {max(map(len, windows))} windows in common, and a "
            f"calibration needs {MIN_WINDOWS}; record for longer, or choose a shorter "
            f"{Setting('window')}"
        )
    return enough


def _best(
    rates: GyroSeries,
    lengths: list[RotationWindows],
    priors: Priors,
    begin: Model,
    seen: FollowedMotion,
) -> tuple[Data, Estimate]:
    """Return the windows with the smallest uncertainty, and the estimate from them."""
    each = [Data(rates, windows, seen, np.empty((0, 3))) for windows in lengths]
    errors = rule_errors(rates, joined(lengths), priors.centre)
    cuts = np.cumsum([len(windows) for windows in lengths])[:-1]
    each = [
        data._replace(by_rule=part) for data, part in zip(each, np.split(errors, cuts), strict=True)
    ]
    short = [data for data in each if data.windows.length_ns <= FIRST_NS]
    first = short[-1] if short else each[0]
    found = fit(first, priors, begin)
    if len(each) == 1:
        return first, found
    shown = [
        np.linalg.slogdet(one + np.eye(len(one)))[1]
        for one in informations(each, priors, found.model)
    ]
    best = each[int(np.argmax(shown))]
    return best, found if best is first else fit(best, priors, found.model)


def _with_tilt(found: Estimate, followed: Followed) -> Estimate:
    """Add what the axes that the reference does not follow do to the others, to second order."""
    sigma = np.zeros(len(found.free))
    sigma[: len(OF_GROUP)][np.isin(OF_GROUP, ("scale", "misalignment", "mount"))] = (
        followed.tilt / 2
    )
    sigma[~found.free] = 0.0
    return found._replace(covariance=found.covariance + np.diag(sigma**2))


def _with_variation(found: Estimate) -> Float64:
    """Return the covariance of the parameters; that of the bias contains by how much it varies."""
    covariance = found.covariance[: len(OF_GROUP), : len(OF_GROUP)].copy()
    covariance[:3, :3] += found.model.variation
    return covariance


def _with_clock(model: Model, other: Model) -> Model:
    """Return a model with the clock of another one."""
    return model._replace(added_ns=other.added_ns, offset=other.offset, drift=other.drift)


def _validated(data: Data, given: Model, found: Estimate) -> Validation:
    """Return the errors over windows without outliers: as given, and of the estimate.

    The file states one bias; a window that fits with its jumps is not an outlier.
    """
    model = found.model.without_jumps()
    clock = _with_clock(given, model)
    models = [given, clock, model, *([found.model] if found.model.jumps_ns else [])]
    vectors = [errors_of(data.rates, data.windows, each, data.seen)[0] for each in models]
    squares = np.stack(vectors) ** 2
    fits = (squares / found.linear.noise).sum(axis=2) < REJECTED**2
    usual = fits[[0, 2, *range(3, len(models))]].any(axis=0)
    if not usual.any():
        usual[:] = True
    each = squares.sum(axis=2)[:3, usual]
    before, middle, after = (rms(np.sqrt(row)) for row in each)
    tiny = float(np.finfo(float).tiny)

    def sigma(first: int, total: float) -> float:
        # sigma(a - b) = sigma(a^2 - b^2) / (a + b)
        difference = each[first] - each[first + 1]
        parts = [part.mean() for part in np.array_split(difference, PARTS // 3) if len(part)]
        return float(np.std(parts, ddof=1) / np.sqrt(len(parts)) / max(total, tiny))

    return Validation(
        int(usual.sum()), before, middle, after, sigma(0, before + middle), sigma(1, middle + after)
    )
