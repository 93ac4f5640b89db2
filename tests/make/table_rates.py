"""Rates of a table in one call, and why they are not read."""

import io
import warnings
from typing import NamedTuple

import numpy as np
import pytest

from quatprop import read_rates
from quatprop.base.errors import UnsupportedLogError
from quatprop.base.text import in_python
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.tables.csv import CsvLog
from quatprop.settings.reading import RateSelection


class Rates(NamedTuple):
    """The rates that are read from a table, and the remarks on it."""

    t_ns: list
    rate: np.ndarray
    losses: list
    remarks: list


def table_rates(source, **options):
    """Return the rates of a file, or of the bytes or text of a table from stdin."""
    if isinstance(source, str):
        source = source.encode()
    with CsvLog(io.BytesIO(source)) if isinstance(source, bytes) else open_log(source) as log:
        chosen = choose_rates(log, RateSelection(**options))
        batches = list(chosen.batches())
        t_ns = [stamp for batch in batches for stamp in batch.t_ns.tolist()]
        rate = np.concatenate([np.empty((0, 3)), *(batch.rate for batch in batches)])
        remarks = [*chosen.remarks, *log.remarks]
        return Rates(t_ns, rate, [*log.losses], [in_python(remark) for remark in remarks])


def refusal(source, error=UnsupportedLogError, **options):
    """Return the sentence with which a table is refused, without its name."""
    with pytest.raises(error) as caught:
        table_rates(source, **options)
    name = "-" if isinstance(source, str | bytes) else source
    return str(caught.value).removeprefix(f"{name}: ")


def told(path, **options):
    """Return the stamps of a table as users get them, and what they are warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        t_ns = read_rates(path, **options).t_ns
    return t_ns.tolist(), [str(warning.message).removeprefix(f"{path}: ") for warning in caught]
