"""Attitudes in the columns of a table: quaternions, or rotations in another representation."""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conventions import HAMILTON, Meaning
from quatprop.conventions.representations import REPRESENTATIONS
from quatprop.errors import LogError, NoAttitudesError, UsageError
from quatprop.kinematics.quaternion import conjugate
from quatprop.kinematics.uncertainty import reference_covariance
from quatprop.provenance import JsonObject, entry_of
from quatprop.series import SIGMA_COLUMNS
from quatprop.signals.attitude_convention import BY_NAME, meaning_of, recorded_convention
from quatprop.signals.message_values import without_absent
from quatprop.signals.signal import AttitudeSignal
from quatprop.tables.matching.choose import ColumnMatch, match_quaternion
from quatprop.tables.matching.column_names import parse_name
from quatprop.tables.matching.rotations import match_rotation
from quatprop.text import Setting, Text, plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.selection import AttitudeSelection
    from quatprop.signals.signal import Rows
    from quatprop.tables.base import TableLog

AXES = 3
"""Numbers in a position."""

_POSITION = re.compile(
    r"(?P<set>t|(?:.*\.)?(?:position|translation)\.|p_[a-z]+_[a-z]+_)(?P<axis>[xyz])"
)
"""Columns of a position, by their name without a unit."""


def of_table(log: TableLog, selection: AttitudeSelection) -> AttitudeSignal:
    """Return the attitudes of a table.

    Raises
    ------
    NoAttitudesError
        No columns look like attitudes and the user names none.
    UndeclaredError
        The layout, a unit, a column or the time is not declared.
    UsageError
        The user contradicts the table.
    """
    provenance = log.provenance()
    recorded = recorded_convention(provenance)
    columns = _match(log, selection, recorded)
    representation = columns.representation
    if columns.unit == "deg" and f"{representation}-deg" in REPRESENTATIONS:
        representation += "-deg"
    declared = recorded.get("representation", representation)
    if declared != representation:
        raise UsageError(
            f"{plain(log.path)}: its columns are {representation}, and the metadata of the file "
            f"say {plain(declared)}; write the file again"
        )
    meaning = meaning_of(log.path, selection, recorded)
    is_quaternion = representation == "quaternion"
    sigma_axes = _sigma_axes(log, provenance)
    return AttitudeSignal(
        name=columns.name,
        type_name=columns.dialect,
        field=columns.name,
        layout=(columns.layout or BY_NAME) if is_quaternion else "",
        meaning=meaning,
        clock=columns.clock,
        remarks=tuple(_remarks(columns)),
        provenance=provenance,
        read=partial(_read, log, columns, meaning, sigma_axes),
        representation=representation,
        has_positions=bool(_positions(log)),
        may_have_covariances=meaning == HAMILTON and sigma_axes is not None,
        sigma_axes=sigma_axes,
        rotation_columns=_rotation_columns(log, representation),
    )


def _match(log: TableLog, selection: AttitudeSelection, recorded: dict[str, str]) -> ColumnMatch:
    """Return the columns of the attitude, a quaternion before any other rotation."""
    try:
        columns = match_quaternion(log, selection, recorded.get("layout"))
    except NoAttitudesError:
        rotation = match_rotation(log, selection)
        if rotation is None:
            raise
        for name in ("from_layout", "from_convention"):
            if getattr(selection, name) is not None:
                raise UsageError(
                    f"{plain(log.path)}: {Setting(name)} is about quaternions, and this table has "
                    f"{rotation.representation}; leave it out"
                ) from None
        return rotation
    if selection.from_angle_unit is not None:
        raise UsageError(
            f"{plain(log.path)}: {Setting('from_angle_unit')} is about angles, and this table has "
            "a quaternion; leave it out"
        )
    return columns


def _remarks(columns: ColumnMatch) -> Iterator[str | Text]:
    yield from columns.remarks
    if columns.representation != "quaternion":
        yield "which of q and -q is meant is not stored: signs are those of each row by itself"
    if columns.representation.startswith("euler-"):
        first, second, third = tuple(columns.representation.removeprefix("euler-"))
        yield f"the angles turn about {first}, the new {second}, and the newest {third}"


def _attitudes(numbers: Float64, columns: ColumnMatch) -> Float64:
    """Return the quaternions that columns hold, in whatever representation."""
    if columns.representation == "quaternion":
        return without_absent(numbers[:, :4], numbers[:, 4:].T)
    values = np.radians(numbers) if columns.unit == "deg" else numbers
    # What is not finite is reported later, row by row.
    with np.errstate(invalid="ignore", over="ignore"):
        return REPRESENTATIONS[columns.representation].attitudes(values)


def _positions(log: TableLog) -> list[int]:
    """Return the columns of the only position; none where there is no single one."""
    sets: dict[str, dict[str, int]] = {}
    for number, name in enumerate(map(parse_name, log.columns())):
        match = _POSITION.fullmatch(name.key)
        if match and name.unit in {"", "m"}:
            sets.setdefault(match["set"], {})[match["axis"]] = number
    positions = [[found[axis] for axis in "xyz"] for found in sets.values() if len(found) == AXES]
    return positions[0] if len(positions) == 1 else []


def _rotation_columns(log: TableLog, representation: str) -> tuple[str, ...]:
    """Return the columns of rotations in other representations than the one that is read."""
    names = log.columns()
    beside = {
        column
        for other, form in REPRESENTATIONS.items()
        if other != representation and set(form.columns) <= set(names)
        for column in form.columns
    }
    return tuple(name for name in names if name in beside)


def _sigma_axes(log: TableLog, provenance: JsonObject) -> str | None:
    """Return the axes of standard deviations, body axes unless the metadata say otherwise."""
    if not set(SIGMA_COLUMNS) <= {parse_name(name).key for name in log.columns()}:
        return None
    axes = entry_of(provenance, "uncertainty", dict).get("columns_axes")
    return "reference" if axes == "reference" else "body"


def _read(  # noqa: PLR0913  # what to read, and how
    log: TableLog,
    columns: ColumnMatch,
    meaning: Meaning,
    sigma_axes: str | None,
    *,
    positions: bool = False,
    covariances: bool = False,
    logged: bool = False,  # noqa: ARG001  # rows of tables have no log times
) -> Rows:
    """Yield attitudes, and positions and covariances if they are wanted.

    Raises
    ------
    LogError
        A standard deviation is negative or not finite.
    """
    beside = _positions(log) if positions else []
    if covariances:
        names = [parse_name(name).key for name in log.columns()]
        beside += [names.index(name) for name in SIGMA_COLUMNS]
    timed = columns.timed._replace(numbers=(*columns.timed.numbers, *beside))
    read = 0
    for t_ns, numbers in log.metered_rows(timed):
        split = numbers.shape[1] - len(beside)
        wxyz = meaning.converted(_attitudes(numbers[:, :split], columns))
        position = numbers[:, split : split + AXES] if positions else None
        covariance = None
        if covariances:
            sigmas = _checked(log, numbers[:, -AXES:], wxyz, t_ns, read)
            covariance = sigmas[:, :, None] ** 2 * np.eye(AXES)
            if sigma_axes == "reference":
                covariance = reference_covariance(conjugate(wxyz), covariance)
        yield t_ns, wxyz, position, covariance
        read += len(t_ns)


def _checked(log: TableLog, sigmas: Float64, wxyz: Float64, t_ns: Int64, first: int) -> Float64:
    """Return standard deviations that can be used; `first` is the number of the first row."""
    # A row without an attitude needs no standard deviations.
    has_attitude = np.isfinite(wxyz).all(axis=1, keepdims=True)
    sigmas = np.where(has_attitude, sigmas, 0.0)
    # Unknown ones are written as three NaN.
    is_unknown = np.isnan(sigmas).all(axis=1, keepdims=True)
    is_usable = is_unknown | (np.isfinite(sigmas) & (sigmas >= 0))
    if not is_usable.all():
        row, axis = np.argwhere(~is_usable)[0]
        raise LogError(
            log.path,
            f"{SIGMA_COLUMNS[axis]} is {sigmas[row, axis]:g} in row {first + row} at "
            f"{t_ns[row]} ns, which is not a standard deviation; correct it, or leave out "
            f"the columns {', '.join(SIGMA_COLUMNS)}",
        )
    return sigmas
