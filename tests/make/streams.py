"""Streams of samples propagated as a run does it, for tests."""

import numpy as np

from quatprop.kinematics.propagate import Propagation
from quatprop.propagation.attitude_stream import Segments
from quatprop.timeline.counts import Policy
from quatprop.timeline.policies import Timeline

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def propagated(batches, q0=IDENTITY, method="start", rates="body"):
    """Return an iterator over the attitudes of a stream, in blocks."""
    return (series for _, series in Propagation(q0, method, rates).run(batches))


def segmented(batches, times=None, policy=None, q0=IDENTITY, **how):
    """Return the segments of a run that has come to its end, all stamps and all attitudes."""
    sensitivity = how.pop("sensitivity", True)
    timeline = Timeline(policy or Policy(), "log")
    how = {"method": "start", "rates": "body", **how}
    segments = Segments(timeline, np.array(q0), times=times, **how)
    parts = list(segments.attitudes(timeline.apply(batches), sensitivity=sensitivity))
    t_ns, wxyz = ([getattr(part, name) for part in parts] for name in ("t_ns", "wxyz"))
    return segments, np.concatenate(t_ns), np.concatenate(wxyz)
