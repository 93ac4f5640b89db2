"""What users of the library write, for type checkers: ``make lint`` checks it; nothing runs it."""

import numpy as np

import quatprop


def attitudes_of(log: str, topic: str | None = None) -> quatprop.AttitudeSeries:
    """Pass on what may be None, and give numbers as a list, a tuple and an array."""
    rates = quatprop.read_rates(log, topic=topic)
    return quatprop.propagate(rates, q0=np.eye(4)[0], bias=[0, 0, 0.001], mount=(1, 0, 0, 0))


def own_series() -> quatprop.Comparison:
    """Make series of lists and of arrays of any numbers."""
    rates = quatprop.GyroSeries([0, 10_000_000], [[0, 0, 1], [0, 0, 1]])
    times = np.arange(2) * 0.01
    same = quatprop.GyroSeries.from_seconds(times, np.tile([0, 0, 1], (2, 1)))
    reference = quatprop.AttitudeSeries(np.arange(2), np.eye(4)[:2].tolist())
    return quatprop.compare(quatprop.propagate(rates), reference, tol=None if same else "1deg")
