"""Rates of an open table."""

from quatprop.settings.selection import RateSelection
from quatprop.signals.rates import choose_rates


def rate_batches(log, **options):
    """Yield the rates of a table in batches, as the options choose them."""
    source = choose_rates(log, RateSelection(**options))
    return source.batches()
