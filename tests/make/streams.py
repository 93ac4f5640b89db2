"""Streams of samples propagated as a run does it, for tests."""

from quatprop.kinematics.propagate import Propagation


def propagated(batches, q0=(1.0, 0.0, 0.0, 0.0), method="start", rates="body"):
    """Return an iterator over the attitudes of a stream, in blocks."""
    return (series for _, series in Propagation(q0, method, rates).run(batches))
