"""The nouns: a series of body rates and a series of attitudes.

Both are frozen, validated once at birth, and hold read-only arrays. A whole log and a batch of
one are the same type: readers yield many short series in order, writers take them in order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.errors import SeriesError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import Self

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

Scalar = TypeVar("Scalar", bound=np.generic)

BLOCK = 131_072
"""Samples in a block of :func:`reblock`: 4 MiB of rates, enough to make calls cheap."""


def blocks(rows: int) -> Iterator[slice]:
    """Yield slices of so many rows: what is computed of each needs no memory for all of them."""
    for start in range(0, rows, BLOCK):
        yield slice(start, start + BLOCK)


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
    span_ns
        For samples that are increments, integrated by the sensor: the time over which each was,
        shape ``(N,)``, int64, ns, ending at its stamp. The increment is the rate times this, and
        is taken as it is, whatever lies between the stamps. None for rates.

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
    span_ns: Int64 | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", _stamps("t_ns", self.t_ns))
        object.__setattr__(self, "rate", _rows("rate", self.rate, self.t_ns, 3))
        if self.span_ns is not None:
            object.__setattr__(self, "span_ns", _stamps("span_ns", self.span_ns))
            if len(self.span_ns) != len(self.t_ns):
                raise SeriesError(
                    f"Expected `span_ns` of shape ({len(self.t_ns)},), got {self.span_ns.shape}"
                )

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, chosen: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        """Return some samples: views for a slice, copies for a mask or positions."""
        span_ns = None if self.span_ns is None else self.span_ns[chosen]
        return type(self)(self.t_ns[chosen], self.rate[chosen], span_ns)

    def with_rate(self, rate: Float64) -> Self:
        """Return the same samples with other rates, shape ``(N, 3)``, rad/s."""
        return replace(self, rate=rate)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return series, at least one and all of the same kind, as one."""
        if len(parts) == 1:
            return parts[0]
        spans = [part.span_ns for part in parts if part.span_ns is not None]
        return cls(
            np.concatenate([part.t_ns for part in parts]),
            np.concatenate([part.rate for part in parts]),
            np.concatenate(spans) if spans else None,
        )


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
            yield GyroSeries.joined([*held, batch[start:stop]])
            held, count, start = [], 0, stop
        if start < len(batch):
            held.append(batch[start:])
            count += len(batch) - start
    if count:
        yield GyroSeries.joined(held)


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
        object.__setattr__(self, "t_ns", _stamps("t_ns", self.t_ns))
        object.__setattr__(self, "wxyz", _rows("wxyz", self.wxyz, self.t_ns, 4))

    def __len__(self) -> int:
        return len(self.t_ns)


def _stamps(name: str, values: Int64) -> Int64:
    if values.ndim != 1 or values.dtype != np.int64:
        raise SeriesError(
            f"Expected `{name}` of shape (N,) and type int64, got {values.shape} {values.dtype}"
        )
    return _read_only(values)


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
