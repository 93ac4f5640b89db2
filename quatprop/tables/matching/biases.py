"""The columns of the biases of a gyroscope."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.selection import RateSelection
from quatprop.tables.matching.choose import ColumnMatch
from quatprop.tables.matching.column_names import RATE_UNITS
from quatprop.tables.matching.dialects import RATE_PARTS
from quatprop.tables.matching.matcher import ColumnMatcher
from quatprop.text import Setting, listed, plain

if TYPE_CHECKING:
    from quatprop.tables.base import TableLog


def match_bias(log: TableLog) -> ColumnMatch:
    """Return which columns hold time and the biases of a gyroscope, and their units.

    Raises
    ------
    UndeclaredError
        The time, or one of several sets, is not declared.
    UsageError
        No columns look like biases, or their unit is not declared.
    """
    matcher = ColumnMatcher(log, RateSelection(), "rate_cols", RATE_PARTS)
    matcher.may_choose_series = False
    dialect = matcher.dialect("bias")
    sets = matcher.sets(dialect.bias)
    if not sets:
        raise UsageError(
            f"{Setting('bias')} {plain(log.path)}: no columns are named as biases of a gyroscope, "
            f"such as b_w_RS_S_x or gyro_bias_x; there are {listed(log.columns())}"
        )
    bias = matcher.only_set(sets, "set of biases", "x")
    unit = matcher.unit("rate", bias, RATE_UNITS, dialect.rate_unit)
    if not unit:
        raise UsageError(
            f"{Setting('bias')} {plain(log.path)}: the unit of {matcher.names(bias)} is not "
            "declared; name it in the header, such as gyro_bias_x [rad/s]"
        )
    return ColumnMatch(*matcher.timed_and_named(bias, dialect), unit, dialect.name)
