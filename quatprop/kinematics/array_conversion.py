"""Conversion of timestamps and numbers to NumPy arrays, from any library.

Arrays, lists, and the columns and tables of pandas, polars and Arrow are accepted. Timestamps are
integers in ns or dates, never floats, whose unit would have to be guessed.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.base.errors import SeriesError
from quatprop.base.times import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

INT64 = np.iinfo(np.int64)


def stamps_of(name: str, values: object) -> NDArray[np.int64]:
    """Return timestamps in ns.

    `values`: integers in ns, or dates of any resolution, shape ``(N,)``; dates without a zone are
        UTC
    `Returns`: shape ``(N,)``, int64, ns; the input itself if it is such an array
    """
    array = _as_array(name, values)
    if array.ndim != 1:
        raise SeriesError(f"Expected `{name}` to have shape (N,), got {array.shape}")
    if array.dtype == np.int64:
        return array
    if array.dtype.kind == "M":
        return _dates_in_ns(name, array)
    # NumPy converts integers beyond 64 bits to floats or objects.
    exact = values if isinstance(values, list | tuple) else array
    if array.dtype.kind == "O" and len(array) and all(isinstance(v, datetime) for v in array):
        return np.array([_ns_of(value) for value in array], np.int64)
    if array.dtype.kind in "Of" and all(isinstance(value, int) for value in exact):
        if all(INT64.min <= value <= INT64.max for value in exact):
            return np.array(exact, np.int64)
        raise SeriesError(f"`{name}` has values that do not fit 64 bits")
    if array.dtype.kind == "f" and np.isnan(array).any():
        raise SeriesError(f"`{name}` has missing values")
    if array.dtype.kind not in "iu":
        hint = "; for seconds as floats use from_seconds()"
        raise SeriesError(
            f"Expected `{name}` to be int64 nanoseconds or dates, got {array.dtype}"
            + (hint if array.dtype.kind == "f" else "")
        )
    if array.dtype.kind == "u" and len(array) and array.max() > INT64.max:
        raise SeriesError(f"`{name}` has values that do not fit 64 bits")
    return np.asarray(array, np.int64)


def times_like(t_ns: NDArray[np.int64], name: str, values: object) -> NDArray[np.int64] | None:
    """Return times in ns, one per timestamp, as :func:`stamps_of`; None if there are none."""
    if values is None:
        return None
    times = stamps_of(name, values)
    if times.shape != t_ns.shape:
        raise SeriesError(f"Expected `{name}` of shape {t_ns.shape}, got {times.shape}")
    return times


def times_of(name: str, values: object) -> NDArray[np.int64]:
    """Return timestamps in ns: floats are seconds, integers are ns, and dates are dates.

    `values`: shape ``(N,)``
    """
    array = _as_array(name, values)
    return seconds_in_ns(array, name) if array.dtype.kind == "f" else stamps_of(name, values)


def seconds_in_ns(t_s: object, name: str = "t_s") -> NDArray[np.int64]:
    """Return timestamps in ns from seconds as floats, rounded to the nearest ns.

    `t_s`: seconds, shape ``(N,)``. At an epoch of 1.7e9 s, floats are 238 ns apart
    """
    array = _as_array(name, t_s)
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        raise SeriesError(
            f"Expected `{name}` to be seconds of shape (N,), got {array.dtype} {array.shape}"
        )
    whole = np.floor(array.astype(np.float64))
    if not (np.isfinite(whole).all() and (np.abs(whole) < INT64.max // NS_PER_S).all()):
        raise SeriesError(f"`{name}` has seconds that are not finite, or not within 292 years of 0")
    rest = np.rint((array - whole) * NS_PER_S).astype(np.int64)
    return np.asarray(whole.astype(np.int64) * NS_PER_S + rest)


def rows_of(name: str, values: object, *shape: int) -> NDArray[np.float64]:
    """Return rows of numbers.

    `shape`: the required shape, such as ``len(t_ns), 4``
    """
    array = _as_array(name, values)
    if array.dtype.kind == "O" and array.ndim == 1 and len(array):
        # A column of lists.
        try:
            array = np.stack([np.asarray(row) for row in array])
        except ValueError as error:
            raise SeriesError(f"`{name}` has rows of different lengths") from error
    if array.dtype.kind == "O":
        # Nullable and Arrow-backed columns of pandas.
        try:
            array = array.astype(np.float64)
        except (TypeError, ValueError) as error:
            raise SeriesError(f"`{name}` has values that are missing or not numbers") from error
    if array.shape != shape:
        hint = "; transpose it" if array.shape == shape[::-1] else ""
        raise SeriesError(f"Expected `{name}` to have shape {shape}, got {array.shape}{hint}")
    if array.dtype.kind not in "iuf":
        raise SeriesError(f"Expected `{name}` to be numbers, got {array.dtype}")
    return array.astype(np.float64, copy=False)


def _as_array(name: str, values: object) -> NDArray[Any]:
    if type(values) is np.ndarray:
        return values
    if isinstance(values, np.ndarray):
        # A masked array, tested without importing numpy.ma.
        if np.any(getattr(values, "mask", False)):
            raise SeriesError(f"`{name}` has missing values")
        return np.asarray(values)
    if hasattr(values, "column_names") and hasattr(values, "columns"):
        # An Arrow table; its columns are Arrow columns.
        columns = [_as_array(name, column) for column in values.columns]
        return np.stack(columns, axis=1) if columns else np.zeros((0, 0))
    if getattr(getattr(values, "dtype", None), "tz", None) is not None:
        # Dates of pandas with a time zone are converted to UTC.
        return np.asarray(values.to_numpy(dtype="datetime64[ns]"))  # type: ignore[attr-defined]
    if hasattr(values, "to_numpy"):
        # Arrow's columns, which have a type and no dtype, only copy if this is allowed.
        options = {"zero_copy_only": False} if hasattr(values, "type") else {}
        return np.asarray(values.to_numpy(**options))
    try:
        return np.asarray(values)
    except ValueError as error:
        raise SeriesError(f"`{name}` has rows of different lengths") from error


def _ns_of(date: datetime) -> int:
    """Return a date in ns; UTC if it has no time zone."""
    since = date.replace(tzinfo=date.tzinfo or UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return since // timedelta(microseconds=1) * 1000


def _dates_in_ns(name: str, dates: NDArray[Any]) -> NDArray[np.int64]:
    in_ns = dates.astype("datetime64[ns]")
    if np.isnat(in_ns).any():
        raise SeriesError(f"`{name}` has missing dates")
    if (in_ns.astype(dates.dtype) != dates).any():
        raise SeriesError(f"`{name}` has dates that do not fit 64 bits of nanoseconds")
    return in_ns.view(np.int64)
