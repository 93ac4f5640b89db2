"""Mistakes put into recordings are named, and the recordings as they are have none."""

import numpy as np
import pytest
from make.mistakes import Recording, mistakes, named_causes, ppm_named, verdict

from quatprop import AttitudeSeries

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")


@pytest.mark.parametrize(("name", "step"), [("xio3", 1), ("xsens-txt", 3), ("euroc", 3)])
def test_mistakes_put_into_recordings_are_named(shared_logs, name, step):
    """Every mistake gets its name, or one of each kind, and the recording as it is gets none."""
    found = {
        name: (wanted, {cause.name for cause in named_causes(a, b)})
        for name, wanted, a, b in list(mistakes(Recording(shared_logs, name)))[::step]
    }
    missed = {name: case for name, case in found.items() if verdict(*case) != "right"}
    assert (len(found), missed) == (-(-26 // step), {})


def test_a_clock_that_drifts_is_named_in_a_recording(shared_logs):
    """What the clocks of EuRoC differ by already, some 65 ppm, is below one interval: not named."""
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
