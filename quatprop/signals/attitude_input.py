"""Attitude series read into memory as a whole, to be compared or kept as a reference."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.stores import without_secret
from quatprop.errors import LogError, NoSamplesError, QuatpropError
from quatprop.formats import open_log
from quatprop.selection import AttitudeSelection
from quatprop.series import AttitudeSeries
from quatprop.settings import READ_ATTITUDES, SELECT_ATTITUDES, parse_all
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.quaternion_check import QuaternionCheck
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.containers.base import Loss
    from quatprop.provenance import JsonObject
    from quatprop.signals.quaternion_check import QuaternionCounts
    from quatprop.signals.signal import AttitudeSignal


@dataclass(frozen=True, slots=True)
class AttitudeInput:
    """Which attitude series to read.

    Parameters
    ----------
    path
        Any log or table with attitudes, or ``"-"``.
    kind
        A key of :data:`quatprop.log_kinds.READERS`; None for the kind that content and suffix show.
    selection
        Which attitudes.
    normalize
        Scale quaternions of any length but zero to unit length.
    drop
        Leave out invalid quaternions instead of refusing the series.
    side
        Which side of a comparison it is, ``"a"`` or ``"b"``, for errors.
    positions
        Read positions beside the attitudes too, where there are any.
    """

    path: str
    kind: str | None = None
    selection: AttitudeSelection = field(default_factory=AttitudeSelection)
    normalize: bool = False
    drop: bool = False
    side: str = ""
    positions: bool = False


@dataclass(frozen=True, slots=True)
class LoadedAttitudes:
    """An attitude series in memory, and where it is from.

    Parameters
    ----------
    input
        What was asked for.
    kind
        The kind of the log.
    signal
        The attitudes that were chosen.
    series
        Their values.
    counts
        Valid and invalid rows.
    losses
        What could not be read.
    """

    input: AttitudeInput
    kind: str
    signal: AttitudeSignal
    series: AttitudeSeries
    counts: QuaternionCounts
    losses: tuple[Loss, ...]

    @property
    def data_lost(self) -> bool:
        """Whether something was left out."""
        return bool(self.losses or self.counts.invalid)

    def report(self) -> JsonObject:
        """Return where it is from and what it spans, JSON-ready."""
        t_ns = self.series.t_ns
        return {
            "path": self.input.path,
            "kind": self.kind,
            "name": self.signal.name,
            "type": self.signal.type_name,
            "quaternion": self.signal.field,
            "layout": self.signal.layout,
            "meaning": asdict(self.signal.meaning),
            "clock": self.signal.clock,
            "samples": len(t_ns),
            "first_ns": int(t_ns.min()),
            "last_ns": int(t_ns.max()),
            "rows": asdict(self.counts),
            "losses": [asdict(loss) for loss in self.losses],
            "remarks": list(self.signal.remarks),
        }


def attitude_input(path: str, options: Mapping[str, object], side: str = "") -> AttitudeInput:
    """Return which attitude series to read, from settings by name.

    Parameters
    ----------
    path
        As for :class:`AttitudeInput`.
    options
        Keys of :data:`quatprop.settings.READ_ATTITUDES` and their values.
    side
        As for :class:`AttitudeInput`.

    Raises
    ------
    UsageError
        There is no such setting, or a value cannot be used.
    """
    values = parse_all(options, READ_ATTITUDES)
    return AttitudeInput(
        path,
        values.get("kind"),
        AttitudeSelection(**{name: values.get(name) for name in SELECT_ATTITUDES}),
        normalize=values.get("normalize", False),
        drop=values.get("on_invalid") == "drop",
        side=side,
    )


def load_attitudes(wanted: AttitudeInput) -> LoadedAttitudes:
    """Read an attitude series into memory.

    Raises
    ------
    LogError
        It cannot be read, or not as asked.
    NotRotationsError
        Quaternions are invalid, and are not to be dropped.
    """
    try:
        return _load(wanted)
    except QuatpropError as error:
        error.side = wanted.side
        raise


def _load(wanted: AttitudeInput) -> LoadedAttitudes:
    with open_log(wanted.path, wanted.kind, msg_path=wanted.selection.msg_path) as log:
        signal = choose_attitudes(log, wanted.selection)
        if signal.placeholder:
            raise LogError(
                wanted.path,
                f"the orientation of {quoted(signal.name)} is the identity in every message: a "
                "placeholder, not an attitude; choose another ",
                Setting("topic"),
            )
        check = QuaternionCheck(wanted.path, normalize=wanted.normalize, drop=wanted.drop)
        poses = signal.poses if wanted.positions else None
        read = signal.covariances or poses or signal.rows
        parts = list(check.apply(read()))
        if not parts:
            raise NoSamplesError(wanted.path, signal.name)
        series = AttitudeSeries.joined(parts)
        signal = replace(signal, remarks=(*signal.remarks, *log.remarks))
        zeros = int(np.count_nonzero(series.t_ns == 0))
        # A series may begin at 0.
        if signal.clock == "header" and zeros > 1:
            remark = f"{zeros} of {len(series)} header stamps are zero"
            signal = replace(signal, remarks=(*signal.remarks, remark))
        wanted = replace(wanted, path=without_secret(wanted.path))
        return LoadedAttitudes(wanted, log.kind, signal, series, check.counts, tuple(log.losses))
