"""Ends of a time range: numbers that cannot be meant in ns, and pauses near an anchor."""

import numpy as np
import pytest
from make.tables import write_rates

from quatprop import GyroSeries, propagate
from quatprop.base.errors import QuatpropError, UsageError

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
MS = 1_000_000


def used(t_ns, **options):
    """Return the stamps that are propagated, and the codes of the remarks."""
    series = GyroSeries(np.asarray(t_ns), np.full((len(t_ns), 3), 1e-3))
    attitudes = propagate(series, **options)
    return attitudes.t_ns.tolist(), [remark.code for remark in attitudes.report.remarks]


@pytest.mark.parametrize(
    ("t_ns", "start", "said"),
    [
        ([0, 2 * MS], MS - 1, "not in seconds; write 999999s for seconds after the first sample"),
        ([0, 2 * MS], MS, None),
        ([0, 500], 499, "not in seconds; write 499s"),
        ([0, 500], 500, None),
        ([0, 500], 0, None),
        ([0, 500], -1, None),
        ([10**12, 10**12 + MS], 10**7, "is at 10000000 ns, and the first sample at 1000000000000"),
        ([10**12, 10**12 + MS], 10**7 + 1, None),
    ],
)
def test_numbers_that_cannot_be_ns_are_refused(t_ns, start, said):
    """Seconds next to a clock of ns would leave out nothing, or everything."""
    if said is None:
        assert used(t_ns, start=start)[0] == [t for t in t_ns if t >= start]
        return
    with pytest.raises(UsageError, match=said):
        used(t_ns, start=start)


@pytest.mark.parametrize(
    ("samples", "pause_ms", "is_said"),
    [(1, 110, True), (1, 100, False), (32, 110, True), (33, 110, False)],
)
@pytest.mark.parametrize("end", ["start", "end"])
def test_a_pause_of_more_than_ten_intervals_within_32_samples_is_said(
    samples, pause_ms, is_said, end
):
    """A clock may have been wrong there, from which the range counts."""
    t_ns = np.arange(200) * 10 * MS + (np.arange(200) >= samples) * (pause_ms - 10) * MS
    if end == "end":
        t_ns = -t_ns[::-1]
    _, codes = used(t_ns, **{end: "+20ms" if end == "start" else "-20ms"})
    assert ("pause-at-end" in codes) == is_said


def test_a_range_may_be_of_one_sample_and_no_less():
    """Both ends are included."""
    t_ns = range(0, 100, 10)
    assert used(t_ns, start="+20ns", end="+20ns")[0] == [20]
    with pytest.raises(UsageError, match="start is 1 ns after end; swap them, or check units"):
        used(t_ns, start="+21ns", end="+20ns")


@pytest.mark.parametrize("options", [{"start": "+1s"}, {"end": "-1s"}, {"bias": "static"}])
def test_an_empty_log_has_no_ends_and_no_rest(tmp_path, options):
    """The refusal reports that it is empty."""
    path = write_rates(tmp_path / "log.csv", [])
    with pytest.raises(QuatpropError, match=r"no samples in|no stationary period: too few samples"):
        propagate(path, rate_unit="rad/s", **options)
