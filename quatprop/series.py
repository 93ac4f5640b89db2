"""The nouns: a series of body rates and a series of attitudes.

Both are frozen, validated once at birth, and hold read-only arrays. A whole log and a batch of
one are the same type: readers yield many short series in order, writers take them in order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.errors import SeriesError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

Scalar = TypeVar("Scalar", bound=np.generic)

BLOCK = 131_072
"""Samples in a block of :func:`reblock`: 4 MiB of rates, enough to make calls cheap."""


@dataclass(frozen=True, slots=True)
class GyroSeries:
    """Angular rates of the body relative to the reference, in time.

    Parameters
    ----------
    t_ns
        Time stamps, shape ``(N,)``, int64, nanoseconds of the chosen clock.
    rate
        Angular rate, shape ``(N, 3)``, float64, rad/s. Resolved in the body frame unless the
        propagation is told ``rates="inertial"``.

    Raises
    ------
    SeriesError
        The shapes or the types do not fit.

    Examples
    --------
    >>> GyroSeries(np.array([0, 10]), np.zeros((2, 3))).rate.shape
    (2, 3)
    """

    t_ns: Int64
    rate: Float64

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", _stamps(self.t_ns))
        object.__setattr__(self, "rate", _rows("rate", self.rate, self.t_ns, 3))

    def __len__(self) -> int:
        return len(self.t_ns)


def reblock(batches: Iterable[GyroSeries], size: int = BLOCK) -> Iterator[GyroSeries]:
    """Cut a stream of samples at fixed sample indices, wherever its batches ended.

    What is computed block by block is then the same to the bit however the samples arrived.

    Parameters
    ----------
    batches
        Samples in order; empty batches are passed over.
    size
        Samples in every block but the last.

    Yields
    ------
    GyroSeries
        Blocks of `size` samples; the last may be shorter, none is empty.
    """
    held: list[GyroSeries] = []
    count = 0
    for batch in batches:
        start = 0
        while count + len(batch) - start >= size:
            stop = start + size - count
            yield _joined([*held, _part(batch, start, stop)])
            held, count, start = [], 0, stop
        if start < len(batch):
            held.append(_part(batch, start, len(batch)))
            count += len(batch) - start
    if count:
        yield _joined(held)


def _part(series: GyroSeries, start: int, stop: int) -> GyroSeries:
    return GyroSeries(series.t_ns[start:stop], series.rate[start:stop])


def _joined(parts: list[GyroSeries]) -> GyroSeries:
    if len(parts) == 1:
        return parts[0]
    return GyroSeries(
        np.concatenate([part.t_ns for part in parts]), np.concatenate([part.rate for part in parts])
    )


@dataclass(frozen=True, slots=True)
class AttitudeSeries:
    """Attitudes of the body, in time.

    Parameters
    ----------
    t_ns
        Time stamps, shape ``(N,)``, int64, nanoseconds.
    wxyz
        Unit quaternions body -> reference (Hamilton, scalar first), shape ``(N, 4)``, float64.

    Raises
    ------
    SeriesError
        The shapes or the types do not fit.
    """

    t_ns: Int64
    wxyz: Float64

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", _stamps(self.t_ns))
        object.__setattr__(self, "wxyz", _rows("wxyz", self.wxyz, self.t_ns, 4))

    def __len__(self) -> int:
        return len(self.t_ns)


def _stamps(t_ns: Int64) -> Int64:
    if t_ns.ndim != 1 or t_ns.dtype != np.int64:
        raise SeriesError(
            f"Expected `t_ns` of shape (N,) and type int64, got {t_ns.shape} {t_ns.dtype}"
        )
    return _read_only(t_ns)


def _rows(name: str, values: Float64, t_ns: Int64, width: int) -> Float64:
    if values.shape != (len(t_ns), width) or values.dtype != np.float64:
        raise SeriesError(
            f"Expected `{name}` of shape ({len(t_ns)}, {width}) and type float64, "
            f"got {values.shape} {values.dtype}"
        )
    return _read_only(values)


def _read_only(values: NDArray[Scalar]) -> NDArray[Scalar]:
    view = values.view()
    view.setflags(write=False)
    return view
