"""Attitude series to compare, each read as a whole."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.containers.remote import without_secret
from quatprop.errors import NoSamplesError, QuatpropError
from quatprop.formats import open_log
from quatprop.selection import AttitudeSelection
from quatprop.series import AttitudeSeries
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.rotation_check import RotationCheck

if TYPE_CHECKING:
    from quatprop.containers.base import Loss
    from quatprop.signals.attitudes import AttitudeSource
    from quatprop.signals.rotation_check import RowCounts


@dataclass(frozen=True, slots=True)
class Reading:
    """What to read, and how.

    Parameters
    ----------
    path
        Any log or table with attitudes, or ``"-"``.
    kind
        A key of :data:`quatprop.formats.READERS`; None: told by content and suffix.
    selection
        Which attitudes.
    normalize
        Scale rows of any length but zero to unit length.
    drop
        Leave out rows that are no rotation, instead of refusing the series.
    side
        Which side of a comparison it is, ``"a"`` or ``"b"``, for errors.
    """

    path: str
    kind: str | None = None
    selection: AttitudeSelection = field(default_factory=AttitudeSelection)
    normalize: bool = False
    drop: bool = False
    side: str = ""


@dataclass(frozen=True, slots=True)
class Operand:
    """One side of a comparison.

    Parameters
    ----------
    reading
        What was asked for.
    kind
        The kind of the log.
    source
        Which attitudes were found.
    series
        The attitudes.
    counts
        What was found in its rows.
    losses
        What could not be read.
    """

    reading: Reading
    kind: str
    source: AttitudeSource
    series: AttitudeSeries
    counts: RowCounts
    losses: tuple[Loss, ...]

    @property
    def data_lost(self) -> bool:
        """Whether something was left out."""
        return bool(self.losses or self.counts.bad)

    def report(self) -> dict[str, Any]:
        """Return where it is from and what it spans, JSON-ready."""
        t_ns = self.series.t_ns
        return {
            "path": self.reading.path,
            "kind": self.kind,
            "name": self.source.name,
            "type": self.source.type_name,
            "quaternion": self.source.quaternion,
            "layout": self.source.layout,
            "meaning": asdict(self.source.meaning),
            "clock": self.source.clock,
            "samples": len(t_ns),
            "first_ns": int(t_ns.min()),
            "last_ns": int(t_ns.max()),
            "rows": asdict(self.counts),
            "losses": [asdict(loss) for loss in self.losses],
            "remarks": list(self.source.remarks),
        }


def read_operand(reading: Reading) -> Operand:
    """Read an attitude series into memory.

    Raises
    ------
    LogError
        It cannot be read, or not as asked.
    NotRotationsError
        Rows are no rotations, and are not to be dropped.
    """
    try:
        return _read(reading)
    except QuatpropError as error:
        error.side = reading.side
        raise


def _read(reading: Reading) -> Operand:
    with open_log(reading.path, reading.kind) as log:
        source = choose_attitudes(log, reading.selection)
        check = RotationCheck(reading.path, normalize=reading.normalize, drop=reading.drop)
        parts = list(check.apply(source.rows()))
        if not parts:
            raise NoSamplesError(reading.path, source.name)
        series = AttitudeSeries(
            np.concatenate([part.t_ns for part in parts]),
            np.concatenate([part.wxyz for part in parts]),
        )
        known = replace(reading, path=without_secret(reading.path))
        return Operand(known, log.kind, source, series, check.counts, tuple(log.losses))
