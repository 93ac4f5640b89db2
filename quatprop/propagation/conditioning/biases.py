"""Recorded gyroscope biases over time: a table, or a topic of a log."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, UsageError
from quatprop.base.guarded_text import read_yaml_file, unusable
from quatprop.base.rendering import count_text
from quatprop.base.text import Remark, Setting, did_you_mean, listed, plain, quoted
from quatprop.base.times import duration_text
from quatprop.kinematics.quaternion import rotate
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.conditioning.frames import frame_of
from quatprop.readers.column_readings import read_vectors
from quatprop.readers.matching import find, scalar_column
from quatprop.readers.rate_signals import match_bias
from quatprop.readers.vocabulary import TYPES
from quatprop.settings.parsers import InMemory
from quatprop.timeline.stamps import GAP_FACTOR, gap_limit_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from quatprop.base.arrays import Float64, Int64
    from quatprop.propagation.recording import Recording
    from quatprop.readers.matching import Match


# Calibration of a gyroscope from a file: scale factors, misalignment and bias.
#
# Also a bias over time, from an estimator or a reference.


_unusable = partial(unusable, "calibration")

LARGEST_CONDITION = 1e3
"""Maximum condition number of a calibration matrix; above it, the matrix is nearly singular."""

OWN_KEYS = ("matrix", "bias")
"""Keys of a file in quatprop's own format."""


class Calibration(NamedTuple):
    """A calibration of rates: w = M (w_raw - b).

    `matrix`: M: scale factors, misalignment and rotation to the sensor axes, ``(3, 3)``; None:
        identity
    `bias_rad_s`: b, in the axes of the raw rates, shape ``(3,)``, rad/s; None: no bias in the file
    """

    matrix: Float64 | None = None
    bias_rad_s: Float64 | None = None
    remarks: tuple[Remark, ...] = ()


def read_calibration(path: Path | str, topic: str = "") -> Calibration:
    """Read a calibration.

    `path`: YAML or JSON with ``matrix``, three rows of three numbers, and optionally ``bias``, in
        rad/s; or the output of kalibr for an IMU with the model ``scale-misalignment``

    References
    ----------
    kalibr, ``IccSensors.py``, IccScaledMisalignedImu: the measured rate is
    M C_gyro_i w + A C_gyro_i a + b.
    """
    content = _imu(path, read_yaml_file("calibration", path), topic)
    if "matrix" in content:
        for key in map(str, content):
            if key not in OWN_KEYS:
                raise _unusable(path, f"no key {quoted(key)}{did_you_mean(key, OWN_KEYS)}")
        bias = content.get("bias")
        matrix = _checked(path, "matrix", _numbers(path, "matrix", content["matrix"], (3, 3)))
        return Calibration(matrix, None if bias is None else _numbers(path, "bias", bias, (3,)))
    gyroscopes = content.get("gyroscopes")
    if not (isinstance(gyroscopes, dict) and "M" in gyroscopes):
        raise _unusable(
            path,
            "it holds no calibration; write matrix: [[...], [...], [...]] and bias: [x, y, z], "
            "or take kalibr's file with gyroscopes: M",
        )
    turn = _numbers(path, "C_gyro_i", gyroscopes.get("C_gyro_i", np.eye(3)), (3, 3))
    measured = _checked(path, "M", _numbers(path, "M", gyroscopes["M"], (3, 3))) @ turn
    by_force = _numbers(path, "A", gyroscopes.get("A", np.zeros((3, 3))), (3, 3))
    uncorrected = Remark(
        "calibration-part",
        f"{plain(path)}: the effect of acceleration on the rates (A of kalibr) is not corrected",
    )
    inverse = np.linalg.inv(_checked(path, "M C_gyro_i", measured)).astype(np.float64)
    return Calibration(inverse, None, (uncorrected,) if by_force.any() else ())


def _imu(path: Path | str, content: Mapping[str, object], topic: str) -> Mapping[str, object]:
    """Return the part of a file for one IMU: one of imu0, imu1... of kalibr, or all."""
    imus = {
        name: part
        for name, part in content.items()
        if isinstance(part, dict) and str(name).startswith("imu")
    }
    if len(imus) > 1:
        ours = {name: part for name, part in imus.items() if part.get("rostopic") == topic}
        if len(ours) != 1:
            raise _unusable(
                path,
                f"it has several IMUs ({listed(imus)}), and none with rostopic {quoted(topic)}",
            )
        imus = ours
    return next(iter(imus.values()), content)


def _checked(path: Path | str, name: str, matrix: Float64) -> Float64:
    """Return a matrix, or refuse one that is singular or mirrors the axes."""
    condition = float(np.linalg.cond(matrix)) if matrix.any() else np.inf
    if not condition <= LARGEST_CONDITION:
        raise _unusable(
            path,
            f"{name} is singular (condition number {condition:.3g}), so it is not a calibration",
        )
    if np.linalg.det(matrix) < 0:
        raise _unusable(path, f"{name} mirrors the axes (its determinant is negative)")
    return matrix


def _numbers(path: Path | str, name: str, value: object, shape: tuple[int, ...]) -> Float64:
    """Return finite numbers of a shape, or refuse others."""
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        what = "three rows of three numbers" if len(shape) > 1 else "three numbers"
        raise _unusable(path, f"{name} is not {what}")
    return numbers


_NEAR = 2
"""A series may begin and end within so many of its median intervals of the samples."""


@dataclass(slots=True)
class BiasSeriesReport:
    """The source of a bias over time.

    `source`: file, or topic of the log
    `field`: message field, or columns
    `values`: number of biases
    `first_ns`: timestamp of the first bias, ns
    `last_ns`: timestamp of the last bias, ns
    `outside_range`: number of samples before the first and after the last bias, which take
        the nearest
    `reach_ns`: how long before the first and after the last bias there are samples, ns
    `in_gaps`: number of samples in gaps of the biases
    `gap_limit_ns`: longer intervals between biases count as gaps, ns
    `longest_gap_ns`: the timestamps around the longest interval, ns
    """

    source: str
    field: str
    values: int
    first_ns: int
    last_ns: int
    outside_range: list[int] = dataclass_field(default_factory=lambda: [0, 0])
    reach_ns: list[int] = dataclass_field(default_factory=lambda: [0, 0])
    in_gaps: int = 0
    gap_limit_ns: int = 0
    longest_gap_ns: tuple[int, int] = (0, 0)

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks if samples are outside the time range of the biases, or in gaps of it."""
        near_ns = _NEAR * self.gap_limit_ns // GAP_FACTOR
        if max(self.reach_ns) > near_ns:
            before, after = (count_text(count, "sample") for count in self.outside_range)
            sides = (
                f"{before} before the first bias at {self.first_ns} ns",
                f"{after} after the last bias at {self.last_ns} ns",
            )
            far = [
                side for side, reach in zip(sides, self.reach_ns, strict=True) if reach > near_ns
            ]
            yield Remark(
                "bias-ends",
                f"{' and '.join(far)} take the nearest ({plain(self.source)}); are both on "
                "the same clock?",
            )
        if self.in_gaps:
            before_ns, after_ns = self.longest_gap_ns
            yield Remark(
                "bias-gaps",
                f"{count_text(self.in_gaps, 'sample')} take biases that are interpolated across "
                f"gaps of {plain(self.source)} longer than {duration_text(self.gap_limit_ns)}; the "
                f"longest is {duration_text(after_ns - before_ns)}, from {before_ns} to {after_ns} "
                "ns",
            )


class BiasSeries:
    """Biases at given times, interpolated linearly in between.

    `source`, `name`: file or topic, and field or columns, for the report
    `t_ns`: timestamps in any order, shape ``(N,)``, N > 0, int64 ns
    `bias_rad_s`: biases in the axes of the raw rates, shape ``(N, 3)``, rad/s
    `match`: where they are in a log; None if they are not messages
    `frame`: name of the frame about whose axes they are; empty if it is not known
    """

    def __init__(
        self, source: str, name: str, t_ns: Int64, bias_rad_s: Float64, match: Match | None = None
    ) -> None:
        self.match = match
        self.frame = "" if match is None else frame_of(match)
        order = np.argsort(t_ns, kind="stable")
        self._t_ns, self._bias = t_ns[order], bias_rad_s[order]
        first_ns, last_ns = int(self._t_ns[0]), int(self._t_ns[-1])
        steps, limit_ns = np.diff(self._t_ns), gap_limit_ns(self._t_ns)
        gaps = np.flatnonzero(steps > limit_ns)
        self._gaps_ns = self._t_ns[gaps], self._t_ns[gaps + 1]
        longest = int(np.argmax(np.append(steps, 0)))
        self.report = BiasSeriesReport(
            source,
            name,
            len(t_ns),
            first_ns,
            last_ns,
            gap_limit_ns=limit_ns,
            longest_gap_ns=(int(self._t_ns[longest]), int(self._t_ns[longest:][:2][-1])),
        )

    def at(self, t_ns: Int64) -> Float64:
        """Return the biases at times, ``(M, 3)``, rad/s; outside the series, the nearest."""
        report = self.report
        for side, early_ns in enumerate((self._t_ns[0] - t_ns, t_ns - self._t_ns[-1])):
            report.outside_range[side] += int(np.count_nonzero(early_ns > 0))
            report.reach_ns[side] = max(report.reach_ns[side], int(early_ns.max(initial=0)))
        starts, ends = self._gaps_ns
        if len(starts):
            gap = np.searchsorted(starts, t_ns) - 1
            self.report.in_gaps += int(np.count_nonzero((gap >= 0) & (t_ns < ends[gap])))
        return self.interpolated(t_ns)

    def turn(self, wxyz: Float64) -> None:
        """Turn the biases into the axes of another frame."""
        self._bias = rotate(wxyz, self._bias)

    def interpolated(self, t_ns: Int64) -> Float64:
        """Return the biases at times; nothing is counted."""
        # Differences up to 104 days are exact as floats.
        wanted, known = (each - self._t_ns[0] for each in (t_ns, self._t_ns))
        return np.stack([np.interp(wanted, known, axis) for axis in self._bias.T], axis=1)


def read_biases(source: str | InMemory, recording: Recording) -> BiasSeries:
    """Read biases over time, of a file or of a topic of the recording."""
    if isinstance(source, InMemory):
        series = source.value
        if not isinstance(series, GyroSeries) or not len(series):
            raise UsageError(f"{Setting('bias')}: a series of biases is a GyroSeries with rows")
        return BiasSeries(str(source), "rate", series.t_ns, series.rate)
    otherwise = f"{Setting('bias')} {plain(source)} is not three numbers X,Y,Z, static[:DUR], "
    with recording.second_input(source, otherwise) as opened:
        tables = opened.tables.tables(opened.selection.topic)
        known = [one for table in tables for one in find(table, "bias")]
        if not known and len(tables) == 1 and tables[0].is_typed:
            types = listed(name for name, row in TYPES.items() if row.bias)
            raise LogError(
                opened.name,
                f"messages of topic {quoted(tables[0].name)} are of type "
                f"{quoted(tables[0].type)}, of which no bias is known; types with one are {types}",
            )
        if len(known) != 1:
            names = listed(one.table.name for one in known)
            there = f"several topics with biases: {names}" if known else "no topic with biases"
            raise UsageError(f"{Setting('bias')} {plain(source)}: it has {there}")
        return _of_match(source, match_bias(known[0], opened.selection))


def _of_match(source: str, match: Match) -> BiasSeries:
    valid = scalar_column(match.table, match.part, match.row.valid)
    rows = read_vectors([match._replace(marks=valid)])
    parts = [(np.empty(0, np.int64), np.empty((0, 3))), *rows]
    t_ns, bias = (np.concatenate(column) for column in zip(*parts, strict=True))
    good = np.isfinite(bias).all(axis=1)
    if not good.any():
        raise UsageError(f"{Setting('bias')} {plain(source)}: it has no valid biases")
    of_messages = match if match.table.is_typed else None
    return BiasSeries(source, match.field, t_ns[good], bias[good], of_messages)
