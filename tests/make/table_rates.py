"""Rates of an open table."""

from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import RateSelection


def rate_batches(log, **options):
    """Yield the rates of a table in batches, as the options choose them."""
    source = choose_rates(log, RateSelection(**options))
    return source.batches()
