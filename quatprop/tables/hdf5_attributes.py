"""Attributes of HDF5 datasets: unit, column names, packing, missing values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from quatprop.tables.hdf5_text import variable_text
from quatprop.tables.npy_format import HeaderError
from quatprop.text import quoted

if TYPE_CHECKING:
    from quatprop.arrays import AnyArray

_SAMPLE_RATES = ("sampling_rate", "sample_rate")
_COLUMN_NAMES = ("columns", "column_names", "names")
_UNITS = ("Units", "units", "Unit", "unit")
_PLAIN = {"scale_factor": 1, "add_offset": 0}
_ABSENT = ("_FillValue", "missing_value")


def packing(dataset: Any) -> str:
    """Return the attribute that packs the stored numbers; ``""``: none.

    References
    ----------
    CF Metadata Conventions, 8.1 "Packed data".
    """
    for name, plain in _PLAIN.items():
        if name in dataset.attrs and _attribute(dataset, name).tolist() != [plain]:
            return name
    return ""


def absent_values(dataset: Any) -> list[Any]:
    """Return the stored numbers that mean a missing value, as in netCDF."""
    if dataset.dtype.kind not in "iuf":
        return []
    arrays = (_attribute(dataset, name) for name in _ABSENT)
    values = (x for array in arrays if array.dtype == dataset.dtype for x in array.tolist())
    return [x for x in values if np.isfinite(x)]


def sample_rate(file: Any) -> float | None:
    """Return the sample rate declared by a file, Hz."""
    for name in _SAMPLE_RATES:
        value = _attribute(file, name)
        if value.size == 1 and value.dtype.kind in "iuf" and 0 < value.flat[0] < np.inf:
            return float(value.flat[0])
    return None


def unit_of(dataset: Any, file: BinaryIO) -> str:
    """Return the unit declared by a dataset, as the suffix of a column name."""
    for name in _UNITS:
        texts = _texts(dataset, name, file)
        if len(texts) == 1 and texts[0]:
            return f" [{texts[0]}]"
    return ""


def column_names(dataset: Any, count: int, file: BinaryIO) -> list[str]:
    """Return the names of the columns of a dataset; empty: no names."""
    for name in _COLUMN_NAMES:
        names = _texts(dataset, name, file)
        if all(names) and len(set(names)) == len(names) == count > 1:
            return names
    return []


def _attribute(item: Any, name: str) -> AnyArray:
    """Return an attribute of fixed size as one dimension; empty for others."""
    if name in item.attrs and not item.attrs.get_id(name).dtype.hasobject:
        return np.asarray(item.attrs[name]).reshape(-1)
    return np.empty(0)


def _texts(dataset: Any, name: str, file: BinaryIO) -> list[str]:
    """Return the strings of an attribute; empty for other types."""
    import h5py

    value = _attribute(dataset, name)
    if value.dtype.kind == "S":
        return [text.decode(errors="replace").strip() for text in value.tolist()]
    if value.size or name not in dataset.attrs:
        return []
    if h5py.check_string_dtype(dataset.attrs.get_id(name).dtype) is None:
        return []
    address = h5py.h5o.get_info(dataset.id).addr
    texts = variable_text(file, dataset.file.userblock_size, address, name)
    if texts is None:
        raise HeaderError(f"its attribute {quoted(name)} cannot be read; save it as numpy.bytes_")
    return [text.strip() for text in texts]
