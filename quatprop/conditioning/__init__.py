"""What is done to the rates before they are multiplied up: bias, mounting, the part of the log.

Each step is a map over batches, so memory stays flat. The order is fixed: the bias is subtracted in
sensor axes, then sensor axes are turned into body axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.conditioning.static_detection import AT_REST, REST_WINDOW_NS, quietest, windows_of
from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import normalize, rotation_matrix
from quatprop.text import quoted
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.series import GyroSeries
    from quatprop.times import Instant

AXES = {"x": 0, "y": 1, "z": 2}


def mounting(text: str) -> NDArray[np.float64]:
    """Return the matrix that takes sensor axes to body axes.

    Parameters
    ----------
    text
        Three signed sensor axes that become the body's x, y and z, such as ``"x,-y,-z"``, or a
        unit quaternion ``"W,X,Y,Z"`` with v_body = m v_sensor m*.

    Returns
    -------
    ndarray
        Rotation matrix, shape ``(3, 3)``: rate_body = M rate_sensor.

    Raises
    ------
    UsageError
        The text is neither, or the axes are left-handed.

    Examples
    --------
    >>> mounting("y,-x,z").tolist()
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    parts = [part.strip().lower() for part in text.split(",")]
    if len(parts) == len(AXES) and {part.lstrip("+-") for part in parts} == set(AXES):
        axes = np.zeros((3, 3))
        for row, part in enumerate(parts):
            axes[row, AXES[part[-1]]] = -1.0 if part.startswith("-") else 1.0
        if np.linalg.det(axes) < 0:
            raise UsageError(
                f"the mounting {quoted(text)} mirrors the axes, which no rotation does; "
                "change one sign or swap two axes"
            )
        return axes
    try:
        wxyz = np.array([float(part) for part in parts])
    except ValueError:
        wxyz = np.zeros(0)
    if wxyz.shape != (4,) or not np.isfinite(wxyz).all() or not wxyz.any():
        raise UsageError(
            f"{quoted(text)} is no mounting; write three signed axes such as x,-y,-z, "
            "or a quaternion W,X,Y,Z that takes sensor axes to body axes"
        )
    matrix: NDArray[np.float64] = rotation_matrix(normalize(wxyz))
    return matrix


@dataclass(frozen=True, slots=True)
class Conditioning:
    """What the user wants done; None is nothing.

    Parameters
    ----------
    bias
        Subtracted from every rate, x, y, z, in the unit of the source.
    static_ns
        Take the mean over the log's rest as the bias; rest is looked for in windows so long, ns.
    mount
        Sensor axes to body axes, as :func:`mounting` reads it.
    start, end
        The part of the log to use, ends included.
    """

    bias: tuple[float, ...] | None = None
    static_ns: int | None = None
    mount: str | None = None
    start: Instant | None = None
    end: Instant | None = None

    @property
    def looks_ahead(self) -> bool:
        """Whether the log has to be read once before it can be read for good."""
        ends = {moment.origin for moment in (self.start, self.end) if moment is not None}
        return self.static_ns is not None or bool(ends - {"clock"})


def condition(
    read: Callable[[], Iterable[GyroSeries]], wanted: Conditioning, unit: float
) -> tuple[Iterator[GyroSeries], dict[str, Any]]:
    """Return the samples as wanted, and what was done to them.

    Parameters
    ----------
    read
        Reads the samples; called twice where the conditioning looks ahead.
    wanted
        What to do.
    unit
        rad/s in the unit of the bias.

    Returns
    -------
    batches : iterator of GyroSeries
        The samples, rad/s, body axes.
    facts : dict
        ``bias_rad_s``, ``rest``, ``mount``, ``start_ns``, ``end_ns`` and ``outside``, the samples
        left out so far as before or after them; JSON-ready.

    Raises
    ------
    UsageError
        The log has no rest to take a bias from, the mounting is not a rotation, or the part ends
        before it starts.
    """
    mount = None if wanted.mount is None else mounting(wanted.mount)
    bias = None if wanted.bias is None else np.array(wanted.bias) * unit
    first_ns = last_ns = 0
    rest = None
    if wanted.looks_ahead:
        windows = windows_of(read(), wanted.static_ns or REST_WINDOW_NS)
        if len(windows):
            first_ns, last_ns = int(windows["first_ns"][0]), int(windows["last_ns"][-1])
            rest = quietest(windows)
    if wanted.static_ns is not None:
        if rest is None or not rest.scatter <= AT_REST:
            found = "" if rest is None else f" (the quietest scatters by {rest.scatter:.3g} rad/s)"
            raise UsageError(
                f"the log has no stretch of rest to take the bias from{found}; give --bias X,Y,Z, "
                "or look for a shorter rest with --bias static:DUR"
            )
        bias = rest.mean
    start_ns = _absolute(wanted.start, first_ns, last_ns)
    end_ns = _absolute(wanted.end, first_ns, last_ns)
    if start_ns is not None and end_ns is not None and start_ns > end_ns:
        raise UsageError(
            f"--start is {duration_text(start_ns - end_ns)} after --end; swap them, or check units"
        )
    outside = [0, 0]
    facts = {
        "bias_rad_s": None if bias is None else bias.tolist(),
        "rest": None if rest is None or wanted.static_ns is None else rest.told(),
        "mount": None if mount is None else mount.tolist(),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "outside": outside,
    }
    batches = iter(read())
    if start_ns is not None or end_ns is not None:
        batches = clipped(batches, start_ns, end_ns, outside)
    if bias is not None or mount is not None:
        batches = conditioned(batches, bias=bias, mount=mount)
    return batches, facts


def clipping_remarks(wanted: Conditioning, facts: dict[str, Any]) -> list[str]:
    """Return a sentence for each absolute end of the part that leaves nothing out.

    Parameters
    ----------
    wanted, facts
        What was asked for, and what :func:`condition` tells once all samples have passed.
    """
    before, after = facts["outside"]
    ends = (
        ("--start", "before the first", wanted.start, before),
        ("--end", "after the last", wanted.end, after),
    )
    return [
        f"{option} is {side} sample and leaves nothing out; a number without a unit is in ns"
        for option, side, moment, left_out in ends
        if moment is not None and moment.origin == "clock" and not left_out
    ]


def conditioned(
    batches: Iterable[GyroSeries],
    *,
    bias: NDArray[np.float64] | None = None,
    mount: NDArray[np.float64] | None = None,
) -> Iterator[GyroSeries]:
    """Yield rates without their bias, in body axes.

    Parameters
    ----------
    batches
        Rates in sensor axes, rad/s.
    bias
        Subtracted from every rate, shape ``(3,)``, rad/s, sensor axes.
    mount
        Matrix from sensor to body axes, shape ``(3, 3)``.
    """
    for batch in batches:
        rate = batch.rate
        if bias is not None:
            rate = rate - bias
        if mount is not None:
            rate = _turned(rate, mount)
        yield batch.with_rate(rate)


def _turned(rate: NDArray[np.float64], mount: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``rate @ mount.T``, each row rounded alike wherever it stands in its batch.

    A product of matrices rounds by the block in which a row comes to lie, and by the thread.
    """
    x, y, z = rate.T
    return np.stack([x * row[0] + y * row[1] + z * row[2] for row in mount], axis=1)


def clipped(
    batches: Iterable[GyroSeries],
    start_ns: int | None,
    end_ns: int | None,
    outside: list[int] | None = None,
) -> Iterator[GyroSeries]:
    """Yield the samples with start <= t <= end; None leaves an end open.

    The samples before and after are counted in the two numbers of `outside`.
    """
    left_out = [0, 0] if outside is None else outside
    low = np.iinfo(np.int64).min if start_ns is None else start_ns
    high = np.iinfo(np.int64).max if end_ns is None else end_ns
    for batch in batches:
        inside = (batch.t_ns >= low) & (batch.t_ns <= high)
        left_out[0] += int(np.count_nonzero(batch.t_ns < low))
        left_out[1] += int(np.count_nonzero(batch.t_ns > high))
        if inside.all():
            yield batch
        elif inside.any():
            yield batch[inside]


def _absolute(moment: Instant | None, first_ns: int, last_ns: int) -> int | None:
    """Return an instant on the log's clock, ns, given the log's first and last stamps."""
    if moment is None:
        return None
    return moment.ns + {"clock": 0, "first": first_ns, "last": last_ns}[moment.origin]
