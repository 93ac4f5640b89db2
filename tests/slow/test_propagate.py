"""Half a million samples against the 80-bit oracle."""

import numpy as np
import pytest
from make import oracle

from quatprop.kinematics.propagate import attitudes


@pytest.mark.skipif(not oracle.EXTENDED, reason="longdouble has no 80 bits here")
def test_half_a_million_samples_against_the_oracle():
    """Final and worst error stay below 1e-14 rad, rows at unit length."""
    rng = np.random.default_rng(2)
    steps = rng.integers(4_500_000, 5_500_000, 500_000)
    t_ns = 1_700_000_000_000_000_000 + np.cumsum(steps)
    rate = rng.normal(size=(len(t_ns), 3))
    q = attitudes(t_ns, rate)
    assert oracle.angle(oracle.blocked(t_ns, rate), q).max() < 1e-14
    length = np.sqrt((q.astype(oracle.L) ** 2).sum(axis=1))
    assert np.abs(length - 1).max() <= 2 * np.finfo(float).eps
