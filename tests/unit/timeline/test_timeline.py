"""What the timeline counts, refuses, drops, sorts and holds."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from make.options_reference import outliers

from quatprop.conditioning.time_range import EndsFinder
from quatprop.errors import TimelineError
from quatprop.series import GyroSeries
from quatprop.text import in_python
from quatprop.timeline import Timeline
from quatprop.timeline.counts import OBSERVE, Counts, Policy, remarks
from quatprop.timeline.outliers import LOOK_AHEAD, marked
from quatprop.timeline.stamps import LONGEST_NS, StampChecks

MS = 1_000_000


def gyro(t_ms, rate=None):
    """Return a series with stamps in ms and, unless given, a rate of (1, 2, 2) rad/s."""
    t_ns = np.array(t_ms, dtype=np.int64) * MS
    if rate is None:
        rate = np.tile([1.0, 2.0, 2.0], (len(t_ns), 1))
    return GyroSeries(t_ns, np.asarray(rate, dtype=np.float64))


def applied(policy, *batches):
    """Return stamps in ms, rates and counts after a policy."""
    timeline = Timeline(policy, "log.csv")
    out = list(timeline.apply(batches))
    stamps = np.concatenate([batch.t_ns for batch in out]) // MS if out else np.zeros(0, np.int64)
    rates = np.concatenate([batch.rate for batch in out]) if out else np.zeros((0, 3))
    return stamps.tolist(), rates, timeline.counts


def test_a_clean_timeline_passes_unchanged():
    """Samples in order go through, measured: span, intervals, largest rate, angle turned."""
    stamps, rates, counts = applied(Policy(), gyro([0, 10, 20]), gyro([30, 45]))
    assert stamps == [0, 10, 20, 30, 45]
    assert (rates == [1.0, 2.0, 2.0]).all()
    assert (counts.read, counts.used, counts.span_ns) == (5, 5, 45 * MS)
    assert (counts.min_dt_ns, counts.median_dt_ns, counts.max_dt_ns) == (10 * MS, 10 * MS, 15 * MS)
    assert counts.max_rate == 3.0
    assert counts.path_angle_rad == pytest.approx(3.0 * 0.045, rel=1e-15)
    assert list(remarks(counts, Policy())) == []


def test_an_empty_log_counts_nothing():
    """No batches, and batches without samples, give nothing and no error."""
    assert applied(Policy())[2].used == 0
    assert applied(Policy(), gyro([]), gyro([]))[2].first_ns is None
    assert Counts().span_ns == 0


def test_duplicates_are_kept_and_counted_across_batches():
    """Repeated stamps stay, also where a batch ends between them."""
    stamps, _, counts = applied(Policy(), gyro([0, 10, 10]), gyro([10, 20]))
    assert stamps == [0, 10, 10, 10, 20]
    assert (counts.duplicates.count, counts.duplicates.first_index) == (2, 2)
    assert counts.duplicates.first_ns == 10 * MS
    (remark,) = remarks(counts, Policy())
    assert in_python(remark) == (
        "2 repeated timestamps (kept: a zero-length step leaves the attitude unchanged), "
        "first at sample 2, t = 10000000 ns"
    )


@pytest.mark.parametrize("batches", [([0, 10, 5, 20],), ([0, 10], [5, 20])])
def test_a_backward_step_is_an_error_by_default(batches):
    """The error says how far, where, and which options settle it; also at a batch's start."""
    with pytest.raises(
        TimelineError,
        match=r"^log\.csv: time steps back by 5 ms at sample 2 \(t = 5000000 ns\); "
        r"choose on_backwards='drop' or 'sort', or another clock$",
    ):
        applied(Policy(), *map(gyro, batches))


CAUSES = [
    ([4_294_950, 4_294_960, 3, 13], "as if a counter of 32 bits in us had wrapped around"),
    ([-20 + 2**31, -10 + 2**31, -(2**31), 10 - 2**31], "as if a counter of 32 bits in ms had "),
]


@pytest.mark.parametrize(("stamps", "cause"), CAUSES)
@pytest.mark.parametrize("cut", [1, 2, 3, 4])
def test_what_the_stamps_show_is_named_where_time_steps_back(stamps, cause, cut):
    """Not the sample that the clock steps back to is wrong, but the stamp before it, or neither."""
    batches = gyro(stamps[:cut]), gyro(stamps[cut:])
    with pytest.raises(TimelineError, match=rf" ns\) {cause}.*") as refused:
        applied(Policy(), *batches)
    # To drop or sort what follows was advised, which spoils it.
    assert str(refused.value).endswith(
        " wrapped around; log a wider counter, or add 2^32 to the column after each such step, or "
        "choose another clock"
    )
    for choice in ("drop", "sort", "keep"):
        policy = Policy(on_backwards=choice)
        _, _, counts = applied(policy, *batches)
        said = next(text for text in map(in_python, remarks(counts, policy)) if "non-mono" in text)
        assert f" ns {cause}" in said
        assert "on_backwards" not in said


def regular(**wrong):
    """Return 100 stamps 10 ms apart, in ms, some of them wrong."""
    stamps = list(range(10_000, 11_000, 10))
    for name, stamp in wrong.items():
        stamps[int(name[1:])] = stamp
    return stamps


OUTLIERS = {
    "far ahead": (regular(s50=10**6), [50]),
    "ahead within the log": (regular(s50=10_700), [50]),
    "first": (regular(s0=10**6), [0]),
    "second": (regular(s1=10**6), [1]),
    "last but one": (regular(s98=10**6), [98]),
    "in a row": (regular(s50=10**5, s51=10**7, s52=10**6), [50, 51, 52]),
    "apart": (regular(s20=10**6, s22=10**6, s70=10**7), [20, 22, 70]),
    "of a burst": (
        [*regular(), *range(90_000, 90_032), *range(11_000, 12_000, 10)],
        range(100, 132),
    ),
    "before a late one": (regular(s50=10**6, s51=10_420), [50]),
}
"""Stamps in ms, and which of them the next ones contradict."""

NO_OUTLIERS = {
    "last": regular(s99=10**6),
    "first before the clock was set": regular(s0=0, s1=10),
    "a pause": [*regular(), *(stamp + 10**6 for stamp in regular())],
    "a clock set back": [*regular(), *(stamp - 5_000 for stamp in regular())],
    "a clock that was ahead for longer": [
        *regular(),
        *range(90_000, 90_066, 2),
        *range(11_000, 12_000, 10),
    ],
    "late": regular(s50=10_420),
    "a straggler after a pause": [*regular(), 90_000, 11_000, *range(90_010, 91_000, 10)],
    "two clocks in turn": [stamp for pair in zip(regular(), regular(), strict=True) for stamp in
                           (pair[0], pair[1] + 50_000)],
    "neighbours that changed places": regular(s50=10_510, s51=10_500),
}  # fmt: skip


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize("case", [*OUTLIERS, *NO_OUTLIERS])
def test_a_jump_ahead_that_the_next_stamps_contradict_is_an_outlier(case, size):
    """It was dropped with all samples up to where the clock caught up, or took the last place."""
    stamps, outliers = OUTLIERS.get(case) or (NO_OUTLIERS[case], [])
    batches = [gyro(stamps[k : k + size]) for k in range(0, len(stamps), size)]
    kept, _, counts = applied(Policy("drop"), *batches)
    assert counts.outliers.count == len(outliers)
    assert counts.outliers.first_index == (outliers[0] if outliers else None)
    if outliers:
        late = [k for k, stamp in enumerate(stamps) if stamp == 10_420 and k == 51]
        assert kept == [stamps[k] for k in range(len(stamps)) if k not in {*outliers, *late}]
        with pytest.raises(
            TimelineError,
            match=rf"^log\.csv: the timestamp of sample {outliers[0]} \(t = "
            rf"{stamps[outliers[0]] * MS} ns\) is an outlier, [\d.e+]+ m?s ahead of those around "
            "it; choose on_backwards='drop' or 'sort', or another clock$",
        ):
            applied(Policy(), *batches)
    in_order, _, counts = applied(Policy("sort"), *batches)
    assert in_order == sorted(stamps[k] for k in range(len(stamps)) if k not in outliers)
    assert (counts.outliers.count, counts.dropped) == (len(outliers), len(outliers))


def test_outliers_are_those_of_the_rule_that_is_documented():
    """Read from the documents, stamp by stamp, wherever batches end and however far stamps jump."""
    random, found = np.random.default_rng(2), 0
    jumps = [-300, -30, 30, 100, 300, 10**4, 10**6, 2**62]
    for _ in range(500):
        stamps = np.cumsum(random.integers(0, 20, random.integers(1, 150)))
        for _ in range(random.integers(0, 6)):
            first, length = (
                random.integers(len(stamps)),
                random.integers(1, random.choice([2, 6, 40])),
            )
            stamps[first : first + length] += random.choice(jumps)
        expected, size = outliers(stamps.tolist()), int(random.integers(1, 151))
        batches = [stamps[k : k + size] for k in range(0, len(stamps), size)]
        mask = np.concatenate([mask for _, mask, _ in marked(batches, lambda t_ns: t_ns)])
        assert np.flatnonzero(mask).tolist() == sorted(expected)
        found += len(expected) > 0
    assert found > 100


def test_what_comes_after_the_next_64_samples_makes_no_outlier():
    """The first samples are the same, however the log goes on."""
    random = np.random.default_rng(3)
    for _ in range(200):
        stamps = np.cumsum(random.integers(0, 20, 200))
        for _ in range(8):
            first, length = random.integers(len(stamps)), random.integers(1, 40)
            stamps[first : first + length] += random.choice([-300, 300, 10**4, 10**6])
        whole = outliers(stamps.tolist())
        part = outliers(stamps[: 100 + LOOK_AHEAD].tolist())
        assert {k for k in whole if k < 100} == {k for k in part if k < 100}


def test_packets_that_came_early_are_sorted():
    """They fit in the gap that they left; a stamp that is wrong does not, and is dropped."""
    early = [*range(100), *range(400, 410), *range(100, 400), *range(410, 500)]
    stamps, _, counts = applied(Policy("sort"), gyro(early))
    assert stamps == sorted(early)
    assert (counts.outliers.count, counts.backwards.count) == (0, 300)
    early[20] = 5_000
    stamps, _, counts = applied(Policy("sort"), gyro(early))
    assert stamps == sorted(set(early) - {5_000})
    assert (counts.outliers.count, counts.outliers.first_index, counts.dropped) == (1, 20, 1)


def newest_first(stamps, _random):
    """Write the last sample first."""
    return stamps[::-1]


def halves(stamps, random):
    """Write the beginning after the rest."""
    return np.roll(stamps, random.integers(1, len(stamps)))


def packets(stamps, random):
    """Write packets that overtook each other."""
    parts = np.array_split(stamps, random.integers(2, 20))
    return np.concatenate([parts[k] for k in random.permutation(len(parts))])


def shuffled(stamps, random):
    """Write samples in any order."""
    return random.permutation(stamps)


@pytest.mark.parametrize("order", [newest_first, halves, packets, shuffled])
def test_what_sorts_into_a_steady_clock_has_no_outliers(order):
    """The 32 newest samples of a log that was written newest first were dropped as outliers."""
    random = np.random.default_rng(5)
    for samples in random.integers(40, 400, 25):
        stamps = 10 * np.arange(samples) + random.integers(-1, 2, samples)
        policy, written = Policy("sort"), order(stamps, random).tolist()
        kept, _, counts = applied(policy, gyro(written[:30]), gyro(written[30:]))
        assert kept == stamps.tolist()
        assert (counts.outliers.count, counts.dropped) == (0, 0)
        finder = EndsFinder(earliest=True)
        list(Timeline(policy, "log.csv").looked_ahead([gyro(written)], finder.add))
        ends = finder.ends()
        assert [ends.first_ns, ends.last_ns] == [stamps[0] * MS, stamps[-1] * MS]


@pytest.mark.parametrize("wrong", [3, 50, 96])
def test_an_outlier_is_dropped_from_a_log_that_was_written_newest_first(wrong):
    """Also where samples are lost: a gap among the newest is no jump."""
    written = regular(**{f"s{wrong}": 10**6})[::-1]
    del written[12:20]
    kept, _, counts = applied(Policy("sort"), gyro(written))
    assert kept == sorted(written)[:-1]
    assert (counts.outliers.count, counts.outliers.first_index) == (1, written.index(10**6))


def test_a_step_after_a_long_interval_is_that_of_no_counter():
    """Whatever has no cause in the stamps around it is said as it is."""
    with pytest.raises(TimelineError, match=r"1e\+06 s at sample 3 \(t = -5000000 ns\); choose"):
        applied(Policy(), gyro([0, 10, 10**9, -5]))


def test_no_sample_rate_is_remarked_on_where_time_goes_back():
    """Inspection keeps stamps as they are, and a log may end before it begins."""
    _, _, counts = applied(OBSERVE, gyro([*range(10_000, 10_400, 10), *range(0, 400, 10)]))
    assert [text for text in map(in_python, remarks(counts, OBSERVE)) if "gyroscope" in text] == []


def test_drop_waits_until_the_clock_has_caught_up():
    """Every sample earlier than the latest stamp reached is dropped, and counted."""
    stamps, _, counts = applied(
        Policy(on_backwards="drop"), gyro([0, 10, 20, 5, 15]), gyro([18, 20, 30])
    )
    assert stamps == [0, 10, 20, 20, 30]
    assert (counts.backwards.count, counts.backwards.first_index, counts.dropped) == (3, 3, 3)
    # The last stamp of a batch may be the latest.
    stamps, _, _ = applied(Policy(on_backwards="drop"), gyro([0, 10, 5, 20]), gyro([15, 30]))
    assert stamps == [0, 10, 20, 30]


def test_sort_orders_all_samples_and_is_stable():
    """Sorting keeps the order of equal stamps and loses nothing."""
    first, second = gyro([10, 0], np.array([[1.0, 0, 0], [2.0, 0, 0]])), gyro([0], [[3.0, 0, 0]])
    stamps, rates, counts = applied(Policy(on_backwards="sort"), first, second)
    assert stamps == [0, 0, 10]
    assert rates[:, 0].tolist() == [2.0, 3.0, 1.0]
    assert counts.dropped == 0
    assert counts.backwards.count == 2


def test_looking_changes_nothing():
    """The observing policy lets everything pass and counts it all."""
    rate = np.ones((4, 3))
    rate[1, 2] = np.nan
    stamps, rates, counts = applied(OBSERVE, gyro([0, 10, 5, 20], rate))
    assert stamps == [0, 10, 5, 20]
    assert np.isnan(rates[1, 2])
    assert (counts.backwards.count, counts.nonfinite.count) == (1, 1)
    assert counts.max_rate == pytest.approx(np.sqrt(3.0))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_rate_that_is_not_finite_is_an_error_by_default(bad):
    """The error names the sample, its stamp and the options."""
    rate = np.ones((3, 3))
    rate[2, 0] = bad
    with pytest.raises(
        TimelineError,
        match=r"^log\.csv: the rate of sample 5 \(t = 20000000 ns\) is absent or not finite; "
        r"choose on_nonfinite='drop' or 'hold'$",
    ):
        applied(Policy(), gyro([-20, -10, 0]), gyro([0, 10, 20], rate))


def test_dropped_rates_are_lost_and_counted():
    """Dropping removes the sample with its stamp."""
    rate = np.ones((3, 3))
    rate[1] = np.nan
    stamps, _, counts = applied(Policy(on_nonfinite="drop"), gyro([0, 10, 20], rate))
    assert stamps == [0, 20]
    assert (counts.nonfinite.count, counts.dropped) == (1, 1)


def test_held_rates_repeat_the_last_finite_one_across_batches():
    """Holding fills with the rate before, also from the batch before; the stamps stay."""
    first = gyro([0, 10], [[1, 2, 3], [4, 5, 6]])
    second = gyro([20, 30, 40], [[np.nan] * 3, [7, np.inf, 7], [8, 8, 8]])
    stamps, rates, counts = applied(Policy(on_nonfinite="hold"), first, second)
    assert stamps == [0, 10, 20, 30, 40]
    assert rates.tolist() == [[1, 2, 3], [4, 5, 6], [4, 5, 6], [4, 5, 6], [8, 8, 8]]
    assert (counts.nonfinite.count, counts.dropped) == (2, 0)


@pytest.mark.parametrize("bad_in_first", [1, 2])
def test_a_rate_is_held_from_one_batch_to_the_next(bad_in_first):
    """Where a batch ends with rates that are not finite, the next one goes on with the same."""
    good = [[1, 2, 3], [4, 5, 6], [7, 8, 9]][: 3 - bad_in_first]
    first = gyro([0, 10, 20], good + [[np.nan] * 3] * bad_in_first)
    second = gyro([30, 40], [[np.nan] * 3, [8, 8, 8]])
    _, rates, counts = applied(Policy(on_nonfinite="hold"), first, second)
    assert rates.tolist() == [*good, *[good[-1]] * (bad_in_first + 1), [8, 8, 8]]
    assert counts.nonfinite.count == bad_in_first + 1


def test_there_must_be_a_rate_to_hold():
    """Before the first finite rate there is none, and zero would be a guess."""
    rate = np.ones((3, 3))
    rate[0, 1] = np.nan
    with pytest.raises(
        TimelineError,
        match=r"^log\.csv: the rate of sample 0 \(t = 0 ns\) is not finite and there is none "
        r"before it to hold; choose on_nonfinite='drop', or begin later with start$",
    ):
        applied(Policy(on_nonfinite="hold"), gyro([0, 10, 20], rate))


def test_gaps_are_intervals_over_ten_medians():
    """Ten medians are no gap; more is one, located by the sample after it."""
    _, _, counts = applied(Policy(), gyro([0, 10, 20, 30, 130, 231, 241, 251, 261]))
    assert (counts.gap_limit_ns, counts.gaps.count, counts.gaps.first_index) == (100 * MS, 1, 5)
    (remark,) = remarks(counts, Policy())
    assert in_python(remark) == (
        "1 interval longer than 100 ms (propagated across), first at sample 5, t = 231000000 ns"
        ", 101 ms after 130000000 ns"
    )


@pytest.mark.parametrize("size", [1, 3, 100])
def test_gaps_are_listed_by_the_stamps_around_them(size):
    """Wherever batches end, each gap is told by where it begins and where it ends."""
    stamps = [0, 10, 20, 30, 231, 241, 251, 500, 510]
    whole = gyro(stamps)
    batches = [whole[k : k + size] for k in range(0, len(whole), size)]
    _, _, counts = applied(Policy(max_gap_ns=50 * MS), *batches)
    assert counts.gap_list == [(30 * MS, 231 * MS), (251 * MS, 500 * MS)]


def test_not_every_gap_of_very_many_is_listed():
    """The list is bounded; the count is of all."""
    _, _, counts = applied(Policy(max_gap_ns=5 * MS), gyro(range(0, 30_000, 10)))
    assert (counts.gaps.count, len(counts.gap_list)) == (2999, 1000)
    assert counts.gap_list[-1] == (9990 * MS, 10_000 * MS)


def test_a_gap_can_be_an_error():
    """With on_gap="error" the first interval over max_gap is refused."""
    with pytest.raises(
        TimelineError,
        match=r"^log\.csv: a gap ends at sample 2 \(t = 40000000 ns\), longer than 20 ms; "
        r"choose on_gap='hold' or 'zero' or 'split' or a longer max_gap$",
    ):
        applied(Policy(on_gap="error", max_gap_ns=20 * MS), gyro([0, 10, 40, 50]))


@pytest.mark.parametrize("on_gap", ["zero", "split"])
@pytest.mark.parametrize("size", [1, 2, 3, 100])
def test_segments_end_where_gaps_begin(on_gap, size, monkeypatch):
    """A gap ends a segment, also between blocks; gaps in a row make segments of one sample."""
    monkeypatch.setattr("quatprop.timeline.reblock", lambda batches: batches)
    t_ms = [0, 10, 20, 90, 100, 200, 300, 310]
    batches = [gyro(t_ms[at : at + size]) for at in range(0, len(t_ms), size)]
    timeline = Timeline(Policy(on_gap=on_gap, max_gap_ns=50 * MS), "log.csv")
    segments = [
        [int(t_ns) // MS for series in segment for t_ns in series.t_ns]
        for segment in timeline.segments(timeline.apply(batches))
    ]
    assert segments == [[0, 10, 20], [90, 100], [200], [300, 310]]
    assert timeline.counts.gaps.count == 3
    assert timeline.counts.path_angle_rad == pytest.approx(3.0 * 0.040, rel=1e-12)


def test_other_gap_policies_know_one_segment():
    """Held gaps are propagated across."""
    timeline = Timeline(Policy(max_gap_ns=50 * MS), "log.csv")
    (segment,) = timeline.segments(timeline.apply([gyro([0, 10, 100])]))
    assert sum(map(len, segment)) == 3


@pytest.mark.parametrize(
    ("policy", "backwards", "nonfinite"),
    [
        (Policy(on_backwards="drop", on_nonfinite="drop"), "dropped", "dropped"),
        (
            Policy(on_backwards="sort", on_nonfinite="hold"),
            "sorted",
            "replaced by the last finite rate",
        ),
        (
            OBSERVE,
            "refused without on_backwards='drop' or 'sort'",
            "refused without on_nonfinite='drop' or 'hold'",
        ),
    ],
)
def test_remarks_say_how_events_were_handled(policy, backwards, nonfinite):
    """One sentence for each kind of event: how many, what was done, where the first was."""
    rate = np.ones((5, 3))
    rate[4] = np.nan
    _, _, counts = applied(policy, gyro([0, 10, 5, 20, 30], rate))
    assert list(map(in_python, remarks(counts, policy))) == [
        f"1 non-monotonic timestamp ({backwards}), first at sample 2, t = 5000000 ns",
        f"1 non-finite rate ({nonfinite}), first at sample 4, t = 30000000 ns",
    ]


@pytest.mark.parametrize(
    ("on_gap", "handled"),
    [
        ("hold", "propagated across"),
        ("zero", "no rotation assumed"),
        ("split", "restarted from q0"),
    ],
)
def test_remarks_say_how_gaps_were_handled(on_gap, handled):
    """The limit is part of the sentence, and several gaps are counted."""
    policy = Policy(on_gap=on_gap, max_gap_ns=50 * MS)
    _, _, counts = applied(policy, gyro([0, 10, 70, 80, 200]))
    (remark,) = remarks(counts, policy)
    assert in_python(remark) == (
        f"2 intervals longer than 50 ms ({handled}), first at sample 2, t = 70000000 ns; the "
        "longest, of 120 ms after 80000000 ns"
    )


@pytest.mark.parametrize(
    ("first", "interval", "repeats", "is_said"),
    [
        (3000, 1000, 3, True),
        (3000, 2000, 3, True),
        (3500, 1000, 3, False),
        (3000, 1500, 3, False),
        (3000, 1000, 2, False),
    ],
)
def test_whole_seconds_of_several_samples_are_remarked(first, interval, repeats, is_said):
    """More than half of the stamps repeat the one before, and all are whole seconds."""
    stamps = [first + interval * (k // repeats) for k in range(30)]
    _, _, counts = applied(Policy(), gyro(stamps))
    found = [text for text in map(in_python, remarks(counts, Policy())) if "whole seconds" in text]
    assert len(found) == is_said


@pytest.mark.parametrize("stamps", [[0], [0, 0], [0, 0, 0]])
def test_time_that_does_not_pass_is_remarked(stamps):
    """Equal stamps turn nothing, and that is said; a stamp alone is no such thing."""
    _, _, counts = applied(Policy(), gyro(stamps))
    expected = (
        "all timestamps are 0 ns; is there another clock or time column, or are they in another "
        "time_unit?"
    )
    found = [text for text in map(in_python, remarks(counts, Policy())) if text.startswith("all")]
    assert found == ([expected] if len(stamps) > 1 else [])


@pytest.mark.parametrize(
    ("interval", "samples", "said"),
    [
        (10_000, 50, "100,000 samples per second are beyond any"),
        (10, 50, "100,000,000 samples per second are beyond any"),
        (20_000, 50, None),
        (10_000, 19, None),
        (2 * 10**9, 50, None),
        (10 * 10**9, 50, "0.1 samples per second are few for a"),
        (10 * 10**9, 19, None),
    ],
)
def test_a_sample_rate_of_no_gyroscope_is_remarked(interval, samples, said):
    """Seconds read as milliseconds, or the other way round; 0.5 Hz to 50 kHz are no reason."""
    series = GyroSeries(interval * np.arange(samples), np.ones((samples, 3)))
    _, _, counts = applied(Policy(), series)
    found = [text for text in map(in_python, remarks(counts, Policy())) if "gyroscope" in text]
    expected = (
        f"{said} gyroscope; if the timestamps are in another unit, use "
        "time_unit='s' or 'ms' or 'us' or 'ns'"
    )
    assert found == ([expected] if said else [])


@pytest.mark.parametrize(
    ("integrated_ns", "end"),
    [
        (999_000, None),
        (998_999, " between the first timestamp and the last: no rotation is assumed for the rest"),
        (1_001_000, None),
        (1_001_001, " between the first timestamp and the last"),
    ],
)
def test_increments_that_miss_a_thousandth_of_the_time_are_remarked(integrated_ns, end):
    """Up to a thousandth too little or too much is what clocks differ by."""
    counts = Counts(read=9, used=9, first_ns=5, last_ns=1_000_005, integrated_ns=integrated_ns)
    found = list(map(in_python, remarks(counts, Policy())))
    if end is None:
        assert found == []
    else:
        (text,) = found
        assert text == (
            f"the increments cover {integrated_ns / 1e6:.6g} ms of the 1 ms{end}"
        ).replace("0.998999 ms", "998.999 us")


def test_a_nanosecond_that_increments_miss_is_no_rotation():
    """However short the log is."""
    counts = Counts(read=9, used=9, first_ns=0, last_ns=100, integrated_ns=99)
    assert in_python(next(remarks(counts, Policy()))).endswith(
        ": no rotation is assumed for the rest"
    )


@pytest.mark.parametrize("on_gap", ["zero", "split"])
def test_without_an_interval_there_is_no_gap_to_cut_at(on_gap):
    """A log whose stamps are all equal has no median interval, and is one segment."""
    timeline = Timeline(Policy(on_gap=on_gap), "log.csv")
    segments = timeline.segments(timeline.apply([gyro([7, 7, 7])]))
    assert [sum(map(len, segment)) for segment in segments] == [3]


def test_an_interval_of_the_limit_is_not_refused():
    """A gap is longer than the limit, not as long."""
    policy = Policy(on_gap="error", max_gap_ns=10 * MS)
    _, _, counts = applied(policy, gyro([0, 10, 20]))
    assert counts.gaps.count == 0
    with pytest.raises(TimelineError, match=r"a gap ends at sample 2 \(t = 21000000 ns\)"):
        applied(policy, gyro([0, 10, 21]))


def test_the_median_is_that_of_65536_intervals():
    """As documented: the next interval would make it 30 ns."""
    intervals = [10] * 32_768 + [30] * 32_770
    checks = StampChecks("log.csv")
    list(checks.observe([np.cumsum([0, *intervals])]))
    assert checks.counts.median_dt_ns == 20


# A busy machine makes lists slowly.
@settings(suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(st.integers(-50, 50), max_size=60),
    st.lists(st.integers(0, 60), max_size=6),
    st.sampled_from(["drop", "sort", "keep"]),
)
def test_what_comes_out_does_not_depend_on_batches(stamps, cuts, on_backwards):
    """Stamps, rates and counts are the same however the log was cut into batches."""
    # The first sample that is left may have no finite rate, and none before it to hold.
    policy = Policy(on_backwards, "hold" if on_backwards == "keep" else "drop")
    rate = np.arange(3.0 * len(stamps)).reshape(-1, 3)
    rate[1::7] = np.nan
    whole = gyro(stamps, rate)
    edges = [0, *sorted(min(cut, len(stamps)) for cut in cuts), len(stamps)]
    parts = [
        GyroSeries(whole.t_ns[start:stop], whole.rate[start:stop])
        for start, stop in pairwise(edges)
    ]
    together, apart = applied(policy, whole), applied(policy, *parts)
    assert together[0] == apart[0]
    assert np.array_equal(together[1], apart[1], equal_nan=True)
    assert together[2] == apart[2]


@given(
    st.lists(st.integers(-50, 50), min_size=1, max_size=60),
    st.lists(st.integers(0, 60), max_size=6),
)
def test_stamps_alone_are_counted_as_with_rates(stamps, cuts):
    """Stamps without rates give the same counts as a timeline that lets everything pass."""
    whole = np.array(stamps, np.int64) * MS
    edges = [0, *sorted(min(cut, len(stamps)) for cut in cuts), len(stamps)]
    checks = StampChecks("log.csv")
    out = list(checks.observe(whole[start:stop] for start, stop in pairwise(edges)))
    assert np.concatenate(out).tolist() == whole.tolist()
    together = applied(OBSERVE, gyro(stamps))[2]
    assert checks.counts == replace(together, max_rate=0.0, path_angle_rad=0.0)


def test_stamps_too_far_apart_for_64_bits_are_refused():
    """Their interval would wrap around to a few nanoseconds."""
    ends = np.array([-(2**63) + 2, 2**63 - 1])
    with pytest.raises(
        TimelineError,
        match=r"^log\.csv: its timestamps span more than 292 years, up to 9223372036854775807 ns; "
        r"check time_unit, the time column or clock$",
    ):
        applied(Policy(), GyroSeries(ends, np.ones((2, 3))))


def test_defaults_refuse_what_is_irregular_and_hold_across_gaps():
    """A policy that nobody chose changes no sample."""
    assert Policy() == Policy("error", "error", "hold", None)
    assert Policy("keep", "keep", "hold", None) == OBSERVE


def test_the_median_is_that_of_the_first_intervals(monkeypatch):
    """Later samples do not wait for it, and are not part of it; all of them come out."""
    monkeypatch.setattr("quatprop.timeline.stamps.MEDIAN_WINDOW", 4)
    intervals = np.array([10, 10, 30, 30, 1, 1, 1, 1, 1])
    intervals = np.append(intervals, [1] * 100)
    t_ns = np.concatenate([[0], np.cumsum(intervals)])
    read = []

    def batches():
        for k in range(0, len(t_ns), 2):
            read.append(k)
            yield t_ns[k : k + 2]

    checks = StampChecks("log.csv")
    stream = checks.observe(batches())
    first = next(stream)
    # And those that could show that the third batch has an outlier.
    assert read == [*range(0, 6, 2), *range(6, 6 + LOOK_AHEAD, 2)]
    assert np.concatenate([first, *stream]).tolist() == t_ns.tolist()
    assert (checks.counts.median_dt_ns, checks.counts.gap_limit_ns) == (20, 200)


def test_the_list_of_gaps_is_bounded_over_batches():
    """A second batch fills what is left of it, and no more."""
    halves = gyro(range(0, 6000, 10)), gyro(range(6000, 30_000, 10))
    checks = StampChecks("log.csv", Policy(max_gap_ns=5 * MS))
    for _ in checks.observe(half.t_ns for half in halves):
        pass
    assert (checks.counts.gaps.count, len(checks.counts.gap_list)) == (2999, 1000)


@pytest.mark.parametrize(("on_backwards", "count"), [("keep", 1), ("drop", 2), ("sort", 2)])
def test_what_counts_as_backwards_depends_on_what_is_done(on_backwards, count):
    """In inspection a step back is one event; dropped are all until the clock has caught up."""
    _, _, counts = applied(Policy(on_backwards=on_backwards), gyro([0, 10, 5, 7, 20]))
    assert counts.backwards.count == count


@pytest.mark.parametrize(
    ("on_gap", "sizes", "angle"), [("zero", [2, 1], 0.150), ("hold", [3], 0.303)]
)
def test_an_interval_of_the_limit_is_no_gap(on_gap, sizes, angle):
    """Only a longer one ends a segment, and its rotation counts where it is propagated across."""
    timeline = Timeline(Policy(on_gap=on_gap, max_gap_ns=50 * MS), "log.csv")
    segments = timeline.segments(timeline.apply([gyro([0, 50, 101])]))
    assert [sum(map(len, segment)) for segment in segments] == sizes
    assert timeline.counts.path_angle_rad == pytest.approx(angle, rel=1e-12)


def test_the_longest_span_is_that_of_64_bits():
    """One nanosecond more is refused."""
    checks = StampChecks("log.csv")
    assert len(list(checks.observe([np.array([-5, LONGEST_NS - 5])]))) == 1
    assert checks.counts.max_dt_ns == LONGEST_NS
    last = f"^log\\.csv: its timestamps span more than 292 years, up to {LONGEST_NS - 5} ns; check"
    with pytest.raises(TimelineError, match=last):
        list(StampChecks("log.csv").observe([np.array([-6, 0, LONGEST_NS - 5])]))
