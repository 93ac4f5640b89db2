"""Timestamps that jitter about a steady clock: found, what they cost, and replaced by its times."""

import json

import numpy as np
import pytest
from make.commands import run
from make.motion import rotor
from make.places import SAMPLE_LOGS
from make.tables import write_rates

from quatprop import GyroSeries, RemarkWarning, propagate, read_rates
from quatprop.base.errors import TimelineError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.timeline.counts import OBSERVE, Policy, remarks
from quatprop.timeline.policies import Timeline
from quatprop.timeline.regular_time import RegularTime
from quatprop.timeline.steady_clock import (
    DRIFTS,
    FOLLOWED,
    MISSING,
    REPEATS,
    SHORTEST,
    UNCLEAR,
    clock_of,
)

MS = 1_000_000
COUNT = 4000
RANDOM = np.random.default_rng(1)
LATE = np.abs(RANDOM.normal(0, MS, COUNT)).astype(np.int64)
"""Delays of arrival, ns."""

TRUE = 1_700_000_000_000_000_000 + np.arange(COUNT) * 5 * MS
"""Stamps at 200 Hz, ns."""


def tumbling(t_ns, stamps=None):
    """Return the true rates of a tumbling body at some times, under other stamps, and its truth."""
    wxyz, rate = rotor((t_ns - TRUE[0]) * 1e-9)
    return GyroSeries(np.maximum.accumulate(t_ns if stamps is None else stamps), rate), wxyz


def observed(series):
    """Return the clock that is found, and the remarks."""
    timeline = Timeline(OBSERVE, "log.csv", method="cubic")
    list(timeline.apply([series]))
    said = [str(remark) for remark in remarks(timeline.counts, OBSERVE)]
    return timeline.counts.steady_clock, [text for text in said if "steady clock" in text]


def replaced(series):
    """Return the stamps by the clock, and what is counted."""
    timeline = Timeline(Policy(regular_time=True), "log.csv")
    return np.concatenate([b.t_ns for b in timeline.apply([series])]), timeline.counts


def rms_deg(series, method="cubic", **options):
    """Return the RMS error of the attitudes at their stamps."""
    attitudes = propagate(series, method=method, **options)
    truth = rotor((attitudes.t_ns - TRUE[0]) * 1e-9)[0]
    start = propagate(series, method=method, q0=truth[0], **options)
    return np.degrees(np.sqrt(np.mean(geodesic_angle(start.wxyz, truth) ** 2)))


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_late_arrivals_are_found_and_repaired():
    """Timestamps up to 4 ms late cost 0.09 deg, silently; now there is a remark and a remedy."""
    series, _ = tumbling(TRUE, TRUE + LATE)
    clock, said = observed(series)
    assert len(said) == 1
    assert "clock of 200 Hz, by" in said[0]
    # Half-normal delays of 1 ms scatter by sqrt(1 - 2 / pi) ms.
    assert clock.residual_rms_ns == pytest.approx(0.603 * MS, rel=0.05)
    assert clock.residual_max_ns == pytest.approx(LATE.max(), rel=0.001)
    by_clock, _ = replaced(series)
    assert np.abs(by_clock - TRUE).max() < 5000
    assert rms_deg(series) > 0.005
    assert rms_deg(series, regular_time=True) < 0.0005
    with pytest.warns(RemarkWarning, match="regular_time uses the times of that clock"):
        propagate(series)


def together(size):
    """Return stamps of samples that arrive so many at a time, 0.1 ms apart."""
    last = np.minimum(np.arange(COUNT) // size * size + size, COUNT) - 1
    return TRUE[last] + LATE[last] // 5 + (np.arange(COUNT) % size - size + 1) * MS // 10


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize("size", [2, 3, 5, 9])
def test_samples_that_arrive_together_are_found_and_repaired(size):
    """Bursts cost up to a degree, without a remark on their clock, and the repair was refused."""
    series, _ = tumbling(TRUE, together(size))
    clock, said = observed(series)
    assert len(said) == 1
    assert clock.rate_hz == pytest.approx(200, rel=1e-5)
    assert (clock.missing_ticks, clock.unchanged_samples) == (0, 0)
    by_clock, _ = replaced(series)
    assert np.abs(by_clock - TRUE).max() < MS // 10
    assert rms_deg(series) > 0.02
    assert rms_deg(series, regular_time=True) < 0.003


def hung(share):
    """Return deviations, ns, of which each has a share of the one before."""
    deviations = np.random.default_rng(4).normal(0, MS / 2, COUNT)
    for k in range(1, COUNT):
        deviations[k] += share * deviations[k - 1]
    return deviations.astype(np.int64)


LOST = [np.delete(np.arange(COUNT), range(2000, 2000 + lost)) for lost in (1, 5, 8)]
DRIFT = (20 * MS * np.sin(np.arange(COUNT) / COUNT * 4 * np.pi)).astype(np.int64)
UNKNOWN = {
    "3, of which 1 is lost": (TRUE[LOST[0]], together(3)[LOST[0]]),
    "5, of which 5 are lost": (TRUE[LOST[1]], together(5)[LOST[1]]),
    "8, of which 8 are lost": (TRUE[LOST[2]], together(8)[LOST[2]]),
    "4 of a clock that drifts": (TRUE + DRIFT, together(4) + DRIFT),
    "none, each deviation like the one before": (TRUE, TRUE + hung(0.9)),
}


@pytest.mark.parametrize("bursts", UNKNOWN)
def test_bursts_of_an_unknown_clock_are_left_alone(bursts):
    """Where each ends is then unknown, and the times of all that follow could be wrong."""
    series, _ = tumbling(*UNKNOWN[bursts])
    assert observed(series) == (None, [])
    with pytest.raises(TimelineError, match="do not jitter about a steady clock"):
        replaced(series)


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
# Errors before and after a pause add up as if they were independent.
@pytest.mark.parametrize(("pause_ms", "share"), [(0, 0.1), (52, 0.15)])
def test_what_jitter_costs_is_what_the_attitudes_are_off(pause_ms, share):
    """The estimate is close to the true RMS error, with the first attitude known."""
    true = TRUE + (np.arange(COUNT) > COUNT // 2) * pause_ms * MS
    series, _ = tumbling(true, true + LATE)
    clock, _ = observed(series)
    truth, _ = rotor((series.t_ns - TRUE[0]) * 1e-9)
    begin, _ = rotor(np.array([0.0]))
    errors = geodesic_angle(propagate(series, method="cubic", q0=begin[0]).wxyz, truth)
    assert clock.error_rad == pytest.approx(np.sqrt(np.mean(errors**2)), rel=share)


@pytest.mark.parametrize(
    ("hz", "tick", "rounding"),
    [
        (128, MS, np.rint),
        (128, MS, np.floor),
        (150, MS, np.rint),
        (400, MS, np.floor),
        (60, 10 * MS, np.floor),
        (1600, 100_000, np.rint),
        # As of a program that polls the sensor.
        (150, 700_000, np.floor),
    ],
)
def test_rounded_stamps_are_jitter_however_they_repeat(hz, tick, rounding):
    """Whole milliseconds of a steady clock are a pattern that repeats, and still rounded."""
    since = np.rint(np.arange(COUNT) * 1e9 / hz).astype(np.int64)
    true = TRUE[0] + 7 + since
    stamps = TRUE[0] + 7 + (rounding(since / tick) * tick).astype(np.int64)
    by_clock, counts = replaced(tumbling(true, stamps)[0])
    assert counts.steady_clock.rate_hz == pytest.approx(hz, rel=1e-9)
    assert np.ptp(by_clock - true) <= 2
    # The clock is in the middle of the rounding errors.
    assert counts.steady_clock.residual_max_ns < 0.55 * tick


def test_missing_samples_stay_missing_and_late_ones_are_not_missing():
    """A gap is a whole number of intervals; samples that only arrived late leave no gap."""
    stamps = TRUE + LATE
    stamps[1000:1012] = np.maximum(stamps[1000:1012], stamps[1012] - 1000)
    kept = np.ones(COUNT, bool)
    lost = [6, 300, 301, 302, 700, 712, 2500, 3991]
    kept[lost] = False
    series, _ = tumbling(TRUE[kept], stamps[kept])
    by_clock, counts = replaced(series)
    assert counts.steady_clock.missing_ticks == len(lost)
    np.testing.assert_array_equal(
        np.rint(np.diff(by_clock) / (5 * MS)), np.diff(TRUE[kept]) / (5 * MS)
    )
    assert np.abs(by_clock - TRUE[kept]).max() < 5000


def test_a_pause_may_set_the_clock_anew():
    """After a pause the clock goes on at another phase; a few samples by themselves are kept."""
    # The second pause is of ten and a half intervals.
    begin = np.array([0, 12_345_678_901, 12_393_178_901])[np.repeat([0, 1, 2], [2000, 50, 1950])]
    stamps = TRUE + LATE + begin
    kept = np.delete(np.arange(COUNT), [500, 3000])
    by_clock, counts = replaced(tumbling((TRUE + begin)[kept], stamps[kept])[0])
    few = (kept >= 2000) & (kept < 2050)
    assert np.abs(by_clock - (TRUE + begin)[kept])[~few].max() < 5000
    np.testing.assert_array_equal(by_clock[few], stamps[2000:2050])
    clock = counts.steady_clock
    assert (clock.missing_ticks, clock.unchanged_samples) == (2, 50)
    assert clock.rate_hz == pytest.approx(200, rel=1e-6)
    assert clock.offset_ns == pytest.approx(TRUE[0], abs=5000)
    assert clock.residual_rms_ns == pytest.approx(0.603 * MS, rel=0.05)
    assert clock.residual_max_ns == pytest.approx(LATE[kept][~few].max(), rel=0.005)


MIDDLES = {
    "normal": (RANDOM.normal(0, MS, COUNT), 0),
    "delays of which few are short": (RANDOM.rayleigh(MS, COUNT), np.sqrt(np.pi / 2) * MS),
    "each like the one before": (hung(0.75), 0),
}
"""Deviations without a sharp lower edge, and their mean, ns."""


@pytest.mark.parametrize("name", MIDDLES)
def test_without_a_sharp_edge_the_clock_is_in_the_middle(name):
    """There is none where samples are as rarely on time as much too late."""
    deviations, mean = MIDDLES[name]
    by_clock, _ = replaced(tumbling(TRUE, TRUE + deviations.astype(np.int64))[0])
    assert np.abs(by_clock - TRUE - mean).max() < 0.25 * MS


@pytest.mark.parametrize(
    ("stamps", "is_taken"),
    [
        *((TRUE[:count], True) for count in (1, 2, SHORTEST - 1)),
        (TRUE[: SHORTEST - 1] + np.arange(SHORTEST - 1) % 2 * 4500, True),
        (TRUE[: SHORTEST - 1] + np.arange(SHORTEST - 1) % 2 * 5500, False),
        (TRUE[:SHORTEST] + LATE[:SHORTEST], True),
    ],
)
def test_a_short_log_has_to_be_regular(stamps, is_taken):
    """Few samples show no clock; intervals within 0.2 % of one another need none."""
    series, _ = tumbling(stamps)
    series = series.with_rate(np.zeros((len(series), 3)))
    if is_taken:
        by_clock, counts = replaced(series)
        assert (counts.steady_clock is not None) == (len(stamps) == SHORTEST)
        assert counts.steady_clock or by_clock.tolist() == stamps.tolist()
        return
    with pytest.raises(TimelineError, match="no 256 of them are without a pause"):
        replaced(series)


@pytest.mark.parametrize(("last", "joined"), [(649, [1300, 1949]), (650, [1300, 1300, 650])])
def test_blocks_are_fitted_by_themselves_and_a_short_end_with_the_one_before(last, joined):
    """Memory stays constant, and the last few samples are not without a clock."""
    series, _ = tumbling(TRUE, TRUE + LATE)
    blocks = [series[:1300], series[1300:2600], series[2600 : 2600 + last]]
    clocks = RegularTime("log.csv", "start", "body")
    by_clock = list(clocks.replaced(iter(blocks)))
    assert [len(block) for block in by_clock] == joined
    t_ns = np.concatenate([b.t_ns for b in by_clock])
    assert np.abs(t_ns - TRUE[: 2600 + last]).max() < 20_000
    assert clocks.first_ns == series.t_ns[0]


def _walk(intervals_ms):
    return TRUE[0] + np.cumsum(np.asarray(intervals_ms) * MS).astype(np.int64)


HALF = np.arange(COUNT) < COUNT // 2
IRREGULAR = {
    "events": (_walk(RANDOM.exponential(5, COUNT)), UNCLEAR),
    "random intervals": (_walk(RANDOM.uniform(4, 6, COUNT)), UNCLEAR),
    "slightly random intervals": (_walk(RANDOM.normal(5, 0.1, COUNT)), DRIFTS),
    "two intervals in turn": (_walk(np.tile([3.0, 7.0], COUNT // 2)), UNCLEAR),
    "two that are closer": (_walk(np.tile([4.3, 5.7], COUNT // 2)), REPEATS),
    "whole milliseconds in turn": (_walk(np.tile([4, 6], COUNT // 2)), REPEATS),
    "three in turn": (_walk(np.tile([3.1, 6.2, 5.7], COUNT)[:COUNT]), REPEATS),
    "a drift": (_walk(np.linspace(5, 5.05, COUNT)) + LATE, DRIFTS),
    "another rate": (_walk(np.where(HALF, 5, 5.01)) + LATE, DRIFTS),
    "half the rate": (_walk(np.where(HALF, 5, 10)) + LATE, UNCLEAR),
    "eight in turn": (TRUE + np.tile(RANDOM.integers(0, 3 * MS, 8), COUNT // 8), REPEATS),
    "two in turn and noise": (TRUE + LATE + np.arange(COUNT) % 2 * MS * 6 // 5, REPEATS),
    "a wave": (TRUE + (MS * np.sin(np.arange(COUNT) * 1.2)).astype(np.int64), REPEATS),
    "a slow wave": (TRUE + DRIFT // 20 + LATE * 9 // 10, DRIFTS),
    "many missing": (TRUE[RANDOM.random(COUNT) > 0.2], MISSING),
    "more than one of twenty missing": ((TRUE + LATE // 20)[RANDOM.random(COUNT) > 0.06], MISSING),
    "bursts": (TRUE // (20 * MS) * 20 * MS + TRUE % (20 * MS) // 50, REPEATS),
    "few": (TRUE[: SHORTEST - 1] + LATE[: SHORTEST - 1], "no 256 of them are without a pause"),
}
"""Stamps that are true, and why they have no steady clock."""


def test_a_table_without_rows_has_no_clock(tmp_path):
    """As one whose stamps are irregular."""
    with pytest.raises(TimelineError, match="do not jitter about a steady clock"):
        read_rates(write_rates(tmp_path / "log.csv", []), regular_time=True)


@pytest.mark.parametrize("name", IRREGULAR)
@pytest.mark.parametrize("moves", [True, False], ids=["moving", "at rest"])
def test_irregular_stamps_are_left_alone(name, moves):
    """They are not remarked on, also where no motion shows them to be true, and not replaced."""
    stamps, why = IRREGULAR[name]
    series, _ = tumbling(stamps)
    if not moves:
        series = series.with_rate(np.random.default_rng(2).normal(0, 0.01, (len(series), 3)))
    clock, said = observed(series)
    assert (clock, said) == (None, [])
    with pytest.raises(TimelineError, match="do not jitter about a steady clock") as error:
        propagate(series, regular_time=True)
    assert why in str(error.value)
    assert str(error.value).endswith("; omit regular_time")


STEADY = {
    "regular": TRUE,
    "dropped samples": TRUE[np.arange(COUNT) % 50 > 0],
    "deviations of a few us": (TRUE + LATE // 1000)[np.arange(COUNT) % 50 > 0],
    "a slow drift": _walk(np.linspace(5, 5.05, COUNT)),
    "another rate": _walk(np.where(HALF, 5, 10)),
    "whole milliseconds": TRUE // MS * MS,
}
"""Stamps that do not jitter."""


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize("name", STEADY)
def test_stamps_that_do_not_jitter_are_kept_to_the_bit(name):
    """Healthy timestamps are neither remarked on nor changed, as the report states."""
    series, _ = tumbling(STEADY[name])
    assert observed(series) == (None, [])
    attitudes = propagate(series, regular_time=True)
    np.testing.assert_array_equal(attitudes.t_ns, series.t_ns)
    np.testing.assert_array_equal(attitudes.wxyz, propagate(series).wxyz)
    assert attitudes.report.policy.regular_time
    assert attitudes.report.counts.steady_clock is None


def test_samples_that_were_taken_when_their_stamps_say_are_left_alone():
    """A sensor that is read at jittering times has true stamps: its rates follow them."""
    series, _ = tumbling(TRUE + LATE)
    assert clock_of(series.t_ns, series.rate).why_not == FOLLOWED
    assert observed(series) == (None, [])
    still = series.with_rate(np.random.default_rng(2).normal(0, 0.01, (COUNT, 3)))
    assert clock_of(still.t_ns, still.rate).why_not == ""


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_the_remedy_for_late_arrivals_says_what_it_costs_if_they_are_none():
    """Noise hides that a sensor was read at these times: the remedy makes the error it names."""
    series, truth = tumbling(TRUE + LATE)
    noise = np.random.default_rng(2).normal(0, 0.05, series.rate.shape)
    noisy = series.with_rate(series.rate + noise)
    clock, said = observed(noisy)
    assert said[0].endswith(
        "but if the samples were taken at the times stated, it is what makes this error"
    )
    by_clock, _ = replaced(noisy)
    found = propagate(GyroSeries(by_clock, series.rate), method="cubic", q0=truth[0])
    made = np.degrees(np.sqrt(np.mean(geodesic_angle(found.wxyz, truth) ** 2)))
    assert rms_deg(series) < made / 3
    assert made == pytest.approx(np.degrees(clock.error_rad), rel=0.5)


def test_jitter_that_costs_next_to_nothing_is_not_remarked_on():
    """A remark is worth its line: of a body at rest, and of increments, jitter costs nothing."""
    series, _ = tumbling(TRUE, TRUE + LATE)
    rest = series.with_rate(np.random.default_rng(2).normal(0, 1e-4, (COUNT, 3)))
    clock, said = observed(rest)
    assert clock.error_rad < 1e-4
    assert said == []
    for hundredths, count in ((0.99, 0), (1.2, 1)):
        share = np.radians(hundredths / 100) / clock.error_rad
        assert len(observed(rest.with_rate(share * rest.rate))[1]) == count
    lengths = np.full(COUNT, 5 * MS)
    assert observed(GyroSeries(series.t_ns, series.rate, lengths)) == (None, [])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_damaged_rates_and_stamps_hide_no_clock_and_raise_nothing(tmp_path, value):
    """Non-finite values have their own policy; non-monotonic timestamps show no clock."""
    series, _ = tumbling(TRUE, TRUE + LATE)
    rate = series.rate.copy()
    rate[100] = value
    assert observed(series.with_rate(rate))[0].rate_hz == pytest.approx(200, rel=1e-6)
    t_ns = series.t_ns.copy()
    t_ns[100] = 0
    assert observed(GyroSeries(t_ns, rate)) == (None, [])
    np.savez(tmp_path / "back.npz", t_ns=t_ns, wx=rate[:, 0], wy=rate[:, 1], wz=rate[:, 2])
    with pytest.raises(TimelineError, match="they step back; omit regular_time"):
        read_rates(tmp_path / "back.npz", regular_time=True)


def test_the_clock_is_in_the_summary_the_report_and_the_configuration(tmp_path):
    """Changes of the timestamps are reported, and can be repeated."""
    series, _ = tumbling(TRUE, TRUE + LATE)
    wx, wy, wz = series.rate.T
    np.savez(tmp_path / "log.npz", t_ns=series.t_ns, wx=wx, wy=wy, wz=wz)
    out = tmp_path / "out.parquet"
    words = "propagate", tmp_path / "log.npz", "-o", out, "--regular-time", "--report", "-"
    done = run(*words, code=0)
    assert "clock       steady at " in done.stderr
    report = json.loads(done.stdout)
    clock = report["counts"]["steady_clock"]
    assert clock["rate_hz"] == pytest.approx(200, rel=1e-6)
    assert clock["offset_ns"] == pytest.approx(TRUE[0], abs=5000)
    assert clock["residual_rms_ns"] == pytest.approx(0.603 * MS, rel=0.05)
    assert report["policy"]["regular_time"] is True
    assert "regular-time = true" in run("info", out, "--as-config", code=0).stdout
    assert "steady clock of 200 Hz" in run("info", tmp_path / "log.npz", code=0).stdout


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_the_first_attitude_is_that_next_to_the_first_sample(tmp_path):
    """Its time by the clock was before the first orientation of the log, and so refused."""
    series, truth = tumbling(TRUE, TRUE + LATE)
    columns = zip(
        ("wx", "wy", "wz", "qw", "qx", "qy", "qz"), (*series.rate.T, *truth.T), strict=True
    )
    np.savez(tmp_path / "log.npz", t_ns=series.t_ns, **dict(columns))
    attitudes = propagate(tmp_path / "log.npz", q0="log", method="cubic", regular_time=True)
    assert attitudes.t_ns[0] < series.t_ns[0]
    assert geodesic_angle(attitudes.wxyz, truth).max() < 1e-5


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_messages_are_repaired_as_tables_are():
    """Log times that arrive late become the header timestamps again, but for a constant."""
    stamped, arrived = (
        read_rates(SAMPLE_LOGS / "tumbling.bag", clock=clock) for clock in ("header", "log")
    )
    by_clock = read_rates(SAMPLE_LOGS / "tumbling.bag", clock="log", regular_time=True)
    assert np.ptp(arrived.t_ns - stamped.t_ns) > 95_000
    assert np.ptp(by_clock.t_ns - stamped.t_ns) < 2_000
    np.testing.assert_array_equal(by_clock.rate, stamped.rate)
