"""Mistakes put into recordings are named, and the recordings as they are have none."""

import warnings

import numpy as np
import pytest
from make.mistakes import Recording, mistakes, named_causes, ppm_named, verdict

import quatprop
from quatprop import AttitudeSeries


@pytest.fixture(scope="module", params=["xio3", "xsens-txt", "euroc"])
def recording(request, shared_logs):
    """Return a recording with a reference."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", quatprop.RemarkWarning)
        return Recording(shared_logs, request.param)


def test_mistakes_put_into_recordings_are_named(recording):
    """Every mistake gets its name, and the recording as it is gets none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", quatprop.RemarkWarning)
        found = {
            name: (wanted, {cause.name for cause in named_causes(a, b)})
            for name, wanted, a, b in mistakes(recording)
        }
    missed = {name: case for name, case in found.items() if verdict(*case) != "right"}
    assert (len(found), missed) == (26, {})


def test_a_clock_that_drifts_is_named_in_a_recording(shared_logs):
    """What the clocks of EuRoC differ by already, some 65 ppm, is below one interval: not named."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", quatprop.RemarkWarning)
        recording = Recording(shared_logs, "euroc")
        a, b = recording.propagated(), recording.reference
        named = {}
        for ppm in (-800, 800):
            t_ns = b.t_ns + (b.t_ns - b.t_ns[0]) * ppm // 1_000_000
            causes = named_causes(a, AttitudeSeries(t_ns, b.wxyz))
            named[ppm] = ppm_named(next(one for one in causes if one.name == "clock drift"))
    (low, low_std), (high, high_std) = named[-800], named[800]
    assert high - low == pytest.approx(1600, abs=3 * np.hypot(low_std, high_std))
    assert abs(low + high) / 2 < 100
