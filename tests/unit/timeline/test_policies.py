"""The timeline counts, refuses, drops, sorts and holds samples."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from make.options_reference import outliers
from make.tables import write_frame

from quatprop import propagate
from quatprop.base.errors import TimelineError
from quatprop.base.text import in_python
from quatprop.base.times import duration_text
from quatprop.kinematics.series import GyroSeries
from quatprop.timeline.counts import OBSERVE, Counts, Policy, remarks
from quatprop.timeline.policies import Timeline
from quatprop.timeline.stamps import LONGEST_NS, LOOK_AHEAD, StampChecks, marked
from quatprop.timeline.time_range import EndsFinder

MS = 1_000_000
NAN = np.nan


def gyro(t_ms, x=None):
    """Return a series with stamps in ms and a rate of (1, 2, 2) rad/s, or of (x, 0, 0)."""
    rate = np.tile([1.0, 2.0, 2.0], (len(t_ms), 1))
    if x is not None:
        rate = np.zeros((len(t_ms), 3))
        rate[:, 0] = x
    return GyroSeries(np.array(t_ms, dtype=np.int64) * MS, rate)


def samples(text):
    """Return batches of samples: ``"0 10=nan | 20"`` are stamps in ms, with rates about x."""
    for batch in text.split("|"):
        pairs = [sample.partition("=")[::2] for sample in batch.split()]
        yield gyro([int(t) for t, _ in pairs], [float(x or 1) for _, x in pairs])


def applied(policy, *batches):
    """Return stamps in ms, rates and counts after a policy."""
    timeline = Timeline(policy, "log.csv")
    out = list(timeline.apply(batches))
    stamps = np.concatenate([batch.t_ns for batch in out]) // MS if out else np.zeros(0, np.int64)
    rates = np.concatenate([batch.rate for batch in out]) if out else np.zeros((0, 3))
    return stamps.tolist(), rates, timeline.counts


def said(counts, policy=None):
    """Return the remarks on counts."""
    return list(map(in_python, remarks(counts, policy or Policy())))


def test_a_clean_timeline_passes_unchanged():
    """Samples in order go through, measured: span, intervals, largest rate, angle turned."""
    stamps, rates, counts = applied(Policy(), gyro([0, 10, 20]), gyro([30, 45]))
    assert stamps == [0, 10, 20, 30, 45]
    assert (rates == [1.0, 2.0, 2.0]).all()
    assert (counts.samples_read, counts.samples_used, counts.span_ns) == (5, 5, 45 * MS)
    assert (counts.min_dt_ns, counts.median_dt_ns, counts.max_dt_ns) == (10 * MS, 10 * MS, 15 * MS)
    assert counts.max_rate == 3.0
    assert counts.path_angle_rad == pytest.approx(3.0 * 0.045, rel=1e-15)
    assert said(counts) == []


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("policy", [{}, {"on_nonfinite": "hold"}])
@pytest.mark.parametrize("turns", [[[0], [1], [2]], [[2], [0], [1]], [[0, 1], [2]], [[1], [0, 2]]])
@pytest.mark.parametrize("suffix", ["csv", "parquet", "npy"])
@pytest.mark.parametrize("start", [None, 0.2])
def test_axes_in_rows_of_their_own_are_not_to_be_dropped(tmp_path, policy, turns, suffix, start):
    """As an outer join makes them; dropping left no samples."""
    axes = [f"gyro_{axis}_rad_s" for axis in "xyz"]
    rate = np.full((300, 3), NAN)
    for k in range(300):
        rate[k, turns[k % len(turns)]] = np.sin(k / 9)
    frame = pd.DataFrame(rate, columns=axes).assign(t_ns=10 * MS * np.arange(300))
    path = write_frame(tmp_path / f"log.{suffix}", frame, 100)
    options = policy if start is None else {**policy, "start": f"+{start}s"}
    with pytest.raises(TimelineError, match=r"none of the samples \d+ to \d+ has rates") as caught:
        propagate(path, **options)
    assert "drop'" not in str(caught.value)
    assert str(caught.value).endswith("as with ffill() and dropna() of pandas")
    filled = write_frame(path, frame.ffill().dropna(), 100)
    assert len(propagate(filled, **options).t_ns) >= 297 - (start is not None) * 20


def test_an_empty_log_counts_nothing():
    """No batches, and batches without samples, give nothing and no error."""
    assert applied(Policy())[2].samples_used == 0
    assert applied(Policy(), gyro([]), gyro([]))[2].first_ns is None
    assert Counts().span_ns == 0


GAP = "longer than 20 ms; choose on_gap='hold' or 'zero' or 'split' or a longer max_gap"
NONFINITE = "the rate of sample 5 (t = 20000000 ns) is absent or not finite; choose on_nonfinite="
WAYS = "choose on_backwards='drop' or 'sort', or another clock"
STEP = f"time steps back by 5 ms at sample 2 (t = 5000000 ns); {WAYS}"
LONG = f"time steps back by 1e+06 s at sample 3 (t = -5000000 ns); {WAYS}"
ANEW = (
    "time steps back by 4294.87 s at sample 2 (t = 93000000 ns); the clock begins anew there: if a "
    "simulation was reset, cut the log there and propagate each of its two runs by itself, the "
    "first also by on_backwards='drop' end='4294960000000'; if only the clock was, choose another "
    "clock, or read the parts in order with in_sequence"
)
NONE_BEFORE = (
    "the rate of sample 0 (t = 0 ns) is not finite and there is none before it to hold; "
    "choose on_nonfinite='drop', or begin later with start"
)


DROP, SORT, HOLD = {"on_backwards": "drop"}, {"on_backwards": "sort"}, {"on_nonfinite": "hold"}
LOOK = {"on_backwards": "keep", "on_nonfinite": "keep"}
REFUSE = {"on_gap": "error", "max_gap_ns": 20 * MS}


@pytest.mark.parametrize(
    ("policy", "text", "message"),
    [
        ({}, "0 10 5 20", STEP),
        ({}, "0 10 | 5 20", STEP),
        # Of a step after a long interval, no counter is the cause.
        ({}, "0 10 1000000000 -5", LONG),
        ({}, "4294950 4294960 93 103", ANEW),
        ({}, "-20 -10 0 | 0 10 20=nan", f"{NONFINITE}'drop' or 'hold'"),
        ({}, "-20 -10 0 | 0 10 20=inf", f"{NONFINITE}'drop' or 'hold'"),
        ({}, "-20 -10 0 | 0 10 20=-inf", f"{NONFINITE}'drop' or 'hold'"),
        (HOLD, "0=nan 10 20", NONE_BEFORE),
        (REFUSE, "0 20 60 70", f"a gap ends at sample 2 (t = 60000000 ns), {GAP}"),
    ],
)
def test_what_is_irregular_is_refused(policy, text, message):
    """With where it is, and which options settle it; also at a batch's start."""
    with pytest.raises(TimelineError) as refused:
        applied(Policy(**policy), *samples(text))
    assert in_python(str(refused.value)) == f"log.csv: {message}"


@pytest.mark.parametrize(
    ("policy", "text", "expected", "counted"),
    [
        (DROP, "0 10 20 5 15 | 18 20 30", "0 10 20 20 30", {"backwards": (3, 3), "dropped": 3}),
        (DROP, "0 10 5 20 | 15 30", "0 10 20 30", {"backwards": (2, 2)}),
        (SORT, "10=1 0=2 | 0=3", "0=2 0=3 10=1", {"backwards": (2, 1), "dropped": 0}),
        (LOOK, "0 10=nan 5 20", "0 10=nan 5 20", {"backwards": (1, 2), "nonfinite": (1, 1)}),
        # In inspection a step back is one event; dropped are all until the clock has caught up.
        (LOOK, "0 10 5 7 20", "0 10 5 7 20", {"backwards": (1, 2), "max_rate": 1.0}),
        (DROP, "0 10 5 7 20", "0 10 20", {"backwards": (2, 2)}),
        ({"on_nonfinite": "drop"}, "0 10=nan 20", "0 20", {"nonfinite": (1, 1), "dropped": 1}),
        (HOLD, "0 1=4 | 2=nan 3=inf 4=8", "0 1=4 2=4 3=4 4=8", {"nonfinite": (2, 2), "dropped": 0}),
        (HOLD, "0 1=4 2=nan | 3=nan 4=8", "0 1=4 2=4 3=4 4=8", {"nonfinite": (2, 2)}),
        (HOLD, "0=2 1=nan 2=nan | 3=nan 4=8", "0=2 1=2 2=2 3=2 4=8", {"nonfinite": (3, 1)}),
        ({}, "0 10 10 | 10 20", "0 10 10 10 20", {"duplicates": (2, 2), "dropped": 0}),
    ],
)
def test_samples_are_dropped_sorted_and_held(policy, text, expected, counted):
    """Across batches; sorting keeps the order of equal timestamps, and looking changes nothing."""
    stamps, rates, counts = applied(Policy(**policy), *samples(text))
    (wanted,) = samples(expected)
    assert stamps == (wanted.t_ns // MS).tolist()
    assert np.array_equal(rates, wanted.rate, equal_nan=True)
    for name, value in counted.items():
        event = getattr(counts, name)
        assert value == ((event.count, event.first_index) if isinstance(value, tuple) else event)


# --- the causes of steps back: counters that wrap around, and outliers


CAUSES = [
    ([4_294_950, 4_294_960, 3, 13], "as if a counter of 32 bits in us had wrapped around"),
    ([-20 + 2**31, -10 + 2**31, -(2**31), 10 - 2**31], "as if a counter of 32 bits in ms had "),
    ([4_290, 4_293, 1, 4], "as if a counter of 32 bits in ns had wrapped around"),
    # Ten intervals later at most.
    ([4_294_950, 4_294_960, 92, 102], "as if a counter of 32 bits in us had wrapped around"),
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
        " wrapped around; log a wider counter, or choose another clock"
    )
    for choice in ("drop", "sort", "keep"):
        policy = Policy(on_backwards=choice)
        _, _, counts = applied(policy, *batches)
        remark = next(text for text in said(counts, policy) if "non-mono" in text)
        assert f" ns {cause}" in remark
        assert "on_backwards" not in remark


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
    "the first three": (regular(s0=10**5, s1=10**6, s2=10**7), [0, 1, 2]),
    "last but one": (regular(s98=10**6), [98]),
    "in a row": (regular(s50=10**5, s51=10**7, s52=10**6), [50, 51, 52]),
    "apart": (regular(s20=10**6, s22=10**6, s70=10**7), [20, 22, 70]),
    "of a burst": (
        [*regular(), *range(90_000, 90_032), *range(11_000, 12_000, 10)],
        range(100, 132),
    ),
    "a burst at first": ([*range(90_000, 90_032), *regular()], range(32)),
    "before a late one": (regular(s50=10**6, s51=10_420), [50]),
    "of a clock that stands": ([10_000] * 50 + [10**6] + [10_000] * 49, [50]),
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
    "two clocks in turn": [t for stamp in regular() for t in (stamp, stamp + 50_000)],
    "neighbours that changed places": regular(s50=10_510, s51=10_500),
}


@pytest.mark.parametrize("size", [1, 1000])
@pytest.mark.parametrize("case", [*OUTLIERS, *NO_OUTLIERS])
def test_a_jump_ahead_that_the_next_stamps_contradict_is_an_outlier(case, size):
    """It was dropped with all samples up to where the clock caught up, or took the last place."""
    stamps, wrong = OUTLIERS.get(case) or (NO_OUTLIERS[case], [])
    batches = [gyro(stamps[k : k + size]) for k in range(0, len(stamps), size)]
    kept, _, counts = applied(Policy("drop"), *batches)
    assert counts.outliers.count == len(wrong)
    assert counts.outliers.first_index == (wrong[0] if wrong else None)
    ahead = Timeline(Policy("drop"), "log.csv").preview(batches, lambda _: None)
    assert [t_ns // MS for batch in ahead for t_ns in batch.t_ns.tolist()] == kept
    if wrong:
        late = [k for k, stamp in enumerate(stamps) if stamp == 10_420 and k == 51]
        assert kept == [stamps[k] for k in range(len(stamps)) if k not in {*wrong, *late}]
        # Before the first there is none: it is compared with the middle of the next eight.
        around = stamps[wrong[0] - 1] if wrong[0] else stamps[len(wrong) + 3]
        ahead = duration_text((stamps[wrong[0]] - around) * MS)
        with pytest.raises(TimelineError) as refused:
            applied(Policy(), *batches)
        assert in_python(str(refused.value)) == (
            f"log.csv: the timestamp of sample {wrong[0]} (t = {stamps[wrong[0]] * MS} ns) is an "
            f"outlier, {ahead} ahead of those around it; {WAYS}"
        )
    in_order, _, counts = applied(Policy("sort"), *batches)
    assert in_order == sorted(stamps[k] for k in range(len(stamps)) if k not in wrong)
    assert (counts.outliers.count, counts.dropped) == (len(wrong), len(wrong))


def test_outliers_are_those_of_the_rule_that_is_documented():
    """Read from the documents, stamp by stamp, wherever batches end and however far stamps jump."""
    random, found = np.random.default_rng(2), 0
    jumps = [-300, -30, 30, 100, 300, 10**4, 10**6, 2**62]
    for _ in range(500):
        stamps = np.cumsum(random.integers(0, 20, random.integers(1, 150)))
        for _ in range(random.integers(0, 6)):
            first = random.integers(len(stamps))
            length = random.integers(1, random.choice([2, 6, 40]))
            stamps[first : first + length] += random.choice(jumps)
        expected, size = outliers(stamps.tolist()), int(random.integers(1, 151))
        batches = [stamps[k : k + size] for k in range(0, len(stamps), size)]
        mask = np.concatenate([mask for _, mask, _ in marked(batches, lambda t_ns: t_ns)])
        assert np.flatnonzero(mask).tolist() == sorted(expected)
        found += len(expected) > 0
    assert found > 100


def packets(stamps, random):
    """Write packets that overtook each other."""
    parts = np.array_split(stamps, random.integers(2, 20))
    return np.concatenate([parts[k] for k in random.permutation(len(parts))])


ORDERS = {
    "newest first": lambda stamps, _random: stamps[::-1],
    "the beginning last": lambda stamps, random: np.roll(stamps, random.integers(1, len(stamps))),
    "packets": packets,
    "shuffled": lambda stamps, random: random.permutation(stamps),
}


@pytest.mark.parametrize("order", ORDERS)
def test_what_sorts_into_a_steady_clock_has_no_outliers(order):
    """The 32 newest samples of a log that was written newest first were dropped as outliers."""
    random = np.random.default_rng(5)
    for samples in random.integers(40, 400, 25):
        stamps = 10 * np.arange(samples) + random.integers(-1, 2, samples)
        policy, written = Policy("sort"), ORDERS[order](stamps, random).tolist()
        kept, _, counts = applied(policy, gyro(written[:30]), gyro(written[30:]))
        assert kept == stamps.tolist()
        assert (counts.outliers.count, counts.dropped) == (0, 0)
        back = np.flatnonzero(written < np.maximum.accumulate(written))
        assert (counts.backwards.count, counts.backwards.first_index) == (
            len(back),
            next(iter(back), None),
        )
        finder = EndsFinder(earliest=True)
        list(Timeline(policy, "log.csv").preview([gyro(written)], finder.add))
        ends = finder.ends()
        assert [ends.first_ns, ends.last_ns] == [stamps[0] * MS, stamps[-1] * MS]


def test_an_outlier_is_dropped_from_packets_that_came_early():
    """They fit in the gap that they left; a stamp that is wrong does not."""
    early = [*range(100), *range(400, 410), *range(100, 400), *range(410, 500)]
    early[20] = 5_000
    stamps, _, counts = applied(Policy("sort"), gyro(early))
    assert stamps == sorted(set(early) - {5_000})
    assert (counts.outliers.count, counts.outliers.first_index, counts.dropped) == (1, 20, 1)


@pytest.mark.parametrize("wrong", [3, 50, 96])
def test_an_outlier_is_dropped_from_a_log_that_was_written_newest_first(wrong):
    """Also where samples are lost: a gap among the newest is no jump."""
    written = regular(**{f"s{wrong}": 10**6})[::-1]
    del written[12:20]
    kept, _, counts = applied(Policy("sort"), gyro(written))
    assert kept == sorted(written)[:-1]
    assert (counts.outliers.count, counts.outliers.first_index) == (1, written.index(10**6))


# --- gaps


def test_gaps_are_intervals_over_ten_medians():
    """Ten medians are no gap; more is one, located by the sample after it."""
    _, _, counts = applied(Policy(), gyro([0, 10, 20, 30, 130, 231, 241, 251, 261]))
    assert (counts.gap_limit_ns, counts.gaps.count, counts.gaps.first_index) == (100 * MS, 1, 5)
    assert said(counts) == [
        (
            "1 interval longer than 100 ms (propagated across), first at sample 5, t = 231000000 ns"
            ", 101 ms after 130000000 ns"
        )
    ]


@pytest.mark.parametrize("size", [1, 3, 100])
def test_gaps_are_listed_by_the_stamps_around_them(size):
    """Wherever batches end, each gap is told by where it begins and where it ends."""
    whole = gyro([0, 10, 20, 30, 231, 241, 251, 500, 510])
    batches = [whole[k : k + size] for k in range(0, len(whole), size)]
    _, _, counts = applied(Policy(max_gap_ns=50 * MS), *batches)
    assert counts.gap_list == [(30 * MS, 231 * MS), (251 * MS, 500 * MS)]


@pytest.mark.parametrize("first", [600, 3000])
def test_not_every_gap_of_very_many_is_listed(first):
    """The list is bounded, also over batches; the count is of all."""
    stamps = np.arange(0, 30_000, 10) * MS
    checks = StampChecks("log.csv", Policy(max_gap_ns=5 * MS))
    list(checks.observe([stamps[:first], stamps[first:]]))
    assert (checks.counts.gaps.count, len(checks.counts.gap_list)) == (2999, 1000)
    assert checks.counts.gap_list[-1] == (9990 * MS, 10_000 * MS)


T_MS = [0, 10, 20, 90, 140, 241, 342, 352]
PARTS = [[0, 10, 20], [90, 140], [241], [342, 352]]


@pytest.mark.parametrize(
    ("on_gap", "stamps", "segments", "angle"),
    [
        # Only an interval that is longer than the limit ends a segment.
        ("zero", T_MS, PARTS, 3 * 0.080),
        ("split", T_MS, PARTS, 3 * 0.080),
        ("hold", T_MS, [T_MS], 3 * 0.352),
        # Without a median interval there is no gap.
        ("split", [7, 7, 7], [[7, 7, 7]], 0.0),
    ],
)
def test_segments_end_where_gaps_begin(on_gap, stamps, segments, angle, monkeypatch):
    """A gap ends a segment, also between blocks; gaps in a row make segments of one sample."""
    monkeypatch.setattr("quatprop.timeline.policies.reblock", lambda batches: batches)
    limit_ns = None if stamps[0] else 50 * MS
    for size in (1, 2, 3, 100):
        batches = [gyro(stamps[at : at + size]) for at in range(0, len(stamps), size)]
        timeline = Timeline(Policy(on_gap=on_gap, max_gap_ns=limit_ns), "log.csv")
        found = [
            [int(t_ns) // MS for series in segment for t_ns in series.t_ns]
            for segment in timeline.segments(timeline.apply(batches))
        ]
        assert found == segments
        assert timeline.counts.gaps.count == (0 if stamps[0] else 3)
        assert timeline.counts.path_angle_rad == pytest.approx(angle, rel=1e-12)


# --- remarks


REFUSED = "refused without on_backwards='drop' or 'sort'"
UNREAD = "refused without on_nonfinite='drop' or 'hold'"


@pytest.mark.parametrize(
    ("policy", "backwards", "nonfinite"),
    [
        (Policy(on_backwards="drop", on_nonfinite="drop"), "dropped", "dropped"),
        (Policy("sort", "hold"), "sorted", "replaced by the last finite rate"),
        (OBSERVE, REFUSED, UNREAD),
    ],
)
def test_remarks_say_how_events_were_handled(policy, backwards, nonfinite):
    """One sentence for each kind of event: how many, what was done, where the first was."""
    _, _, counts = applied(policy, *samples("0 0 10 5 20 30=nan"))
    repeated, *others = said(counts, policy)
    assert repeated == (
        "1 repeated timestamp (kept: a zero-length step leaves the attitude unchanged), first at "
        "sample 1, t = 0 ns"
    )
    assert others == [
        f"1 non-monotonic timestamp ({backwards}), first at sample 3, t = 5000000 ns",
        f"1 non-finite rate ({nonfinite}), first at sample 5, t = 30000000 ns",
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
    assert said(counts, policy) == [
        (
            f"2 intervals longer than 50 ms ({handled}), first at sample 2, t = 70000000 ns; the "
            "longest, of 120 ms after 80000000 ns"
        )
    ]


FEW = "0.1 samples per second are few for a"
EQUAL = "all timestamps are 0 ns, so the rates cannot be propagated; choose other timestamps with"
WHOLE = "whole seconds"


@pytest.mark.parametrize(
    ("stamps", "remark"),
    [
        # Seconds read as milliseconds, or the other way round; 0.5 Hz to 50 kHz are no reason.
        (10_000 * np.arange(50), "100,000 samples per second are beyond any gyroscope"),
        (19_990 * np.arange(20), "50,025 samples per second are beyond any gyroscope"),
        (20_000 * np.arange(50), None),
        (10_000 * np.arange(19), None),
        (2 * 10**9 * np.arange(50), None),
        (2_000_000_001 * np.arange(50), "0.5 samples per second are few for a gyroscope"),
        (10**10 * np.arange(50), f"{FEW} gyroscope; if the timestamps are in another unit, use "),
        # Microseconds of 2001 to 2033 as nanoseconds are those of days 12 to 23.
        (10**15 + 199_980 * np.arange(50), "5,001 samples per second that begin on 1970-01-12"),
        (10**15 + 200_000 * np.arange(50), None),
        (10**15 - 1 + 199_980 * np.arange(50), None),
        (10**10 * np.arange(19), None),
        # Equal stamps turn nothing; a stamp alone is no such thing.
        (np.zeros(1, int), None),
        (np.zeros(2, int), EQUAL),
        (np.zeros(3, int), EQUAL),
        # More than half of the stamps repeat the one before, and all are whole seconds.
        (1000 * MS * (3 + np.arange(30) // 3), WHOLE),
        (1000 * MS * (3 + np.arange(30) // 3 * 2), WHOLE),
        (1000 * MS * (3 + np.arange(30) // 3) + 500 * MS, None),
        (1500 * MS * (2 + np.arange(30) // 3), None),
        (1000 * MS * (3 + np.arange(30) // 2), None),
    ],
)
def test_stamps_that_may_be_in_another_unit_are_remarked(stamps, remark):
    """Where their steps show it."""
    _, _, counts = applied(Policy(), GyroSeries(stamps, np.ones((len(stamps), 3))))
    found = [text for text in said(counts) if not re.search("repeated|share a timestamp", text)]
    assert [remark in text for text in found] == [True] * (remark is not None)


def test_no_sample_rate_is_remarked_on_where_time_goes_back():
    """Inspection keeps stamps as they are, and a log may end before it begins."""
    _, _, counts = applied(OBSERVE, gyro([*range(10_000, 10_400, 10), *range(0, 400, 10)]))
    assert not any("gyroscope" in text for text in said(counts, OBSERVE))


BETWEEN = "between the first timestamp and the last"
NO_ROTATION = f"{BETWEEN}: no rotation is assumed for the rest"


@pytest.mark.parametrize(
    ("span_ns", "integrated_ns", "expected"),
    [
        (MS, 999_000, None),
        (MS, 998_999, f"998.999 us of the 1 ms {NO_ROTATION}"),
        (MS, 1_001_000, None),
        (MS, 1_001_001, f"1.001 ms of the 1 ms {BETWEEN}"),
        # However short the log is.
        (100, 99, f"99 ns of the 100 ns {NO_ROTATION}"),
    ],
)
def test_increments_that_miss_a_thousandth_of_the_time_are_remarked(
    span_ns, integrated_ns, expected
):
    """Up to a thousandth too little or too much is what clocks differ by."""
    ends = {"first_ns": 5, "last_ns": 5 + span_ns}
    found = said(Counts(samples_read=9, samples_used=9, **ends, integrated_ns=integrated_ns))
    assert found == ([] if expected is None else [f"the increments cover {expected}"])


# --- stamps alone, and batches


def test_the_median_is_that_of_65536_intervals():
    """As documented: the next interval would make it 30 ns."""
    intervals = [10] * 32_768 + [30] * 32_770
    checks = StampChecks("log.csv")
    list(checks.observe([np.cumsum([0, *intervals])]))
    assert checks.counts.median_dt_ns == 20


def test_the_median_is_that_of_the_first_intervals(monkeypatch):
    """Later samples do not wait for it, and are not part of it; all of them come out."""
    monkeypatch.setattr("quatprop.timeline.stamps.MEDIAN_WINDOW", 4)
    t_ns = np.cumsum([0, 10, 10, 30, 30, *[1] * 105])
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


def test_the_longest_span_is_that_of_64_bits():
    """One nanosecond more is refused."""
    checks = StampChecks("log.csv")
    assert len(list(checks.observe([np.array([-5, LONGEST_NS - 5])]))) == 1
    assert checks.counts.max_dt_ns == LONGEST_NS
    last = f"^log\\.csv: its timestamps span more than 292 years, up to {LONGEST_NS - 5} ns; check"
    with pytest.raises(TimelineError, match=last):
        list(StampChecks("log.csv").observe([np.array([-6, 0, LONGEST_NS - 5])]))


STAMPS = st.lists(st.integers(-50, 50), max_size=60)
CUTS = st.lists(st.integers(0, 60), max_size=6)


def edges(cuts, count):
    """Return where batches begin and end."""
    return pairwise([0, *sorted(min(cut, count) for cut in cuts), count])


# A busy machine makes lists slowly.
@settings(suppress_health_check=[HealthCheck.too_slow])
@given(STAMPS, CUTS, st.sampled_from(["drop", "sort", "keep"]))
def test_what_comes_out_does_not_depend_on_batches(stamps, cuts, on_backwards):
    """Stamps, rates and counts are the same however the log was cut into batches."""
    # The first sample that is left may have no finite rate, and none before it to hold.
    policy = Policy(on_backwards, "hold" if on_backwards == "keep" else "drop")
    x = np.arange(1.0, len(stamps) + 1)
    x[1::7] = NAN
    whole = gyro(stamps, x)
    parts = [whole[start:stop] for start, stop in edges(cuts, len(stamps))]
    together, apart = applied(policy, whole), applied(policy, *parts)
    assert together[0] == apart[0]
    assert np.array_equal(together[1], apart[1], equal_nan=True)
    assert together[2] == apart[2]


@given(STAMPS, CUTS)
@example([0, 0, 1], [])
def test_stamps_alone_are_counted_as_with_rates(stamps, cuts):
    """Stamps without rates give the same counts as a timeline that lets everything pass."""
    whole = np.array(stamps, np.int64) * MS
    checks = StampChecks("log.csv")
    out = list(checks.observe(whole[start:stop] for start, stop in edges(cuts, len(whole))))
    assert [t for part in out for t in part.tolist()] == whole.tolist()
    together = applied(OBSERVE, gyro(stamps))[2]
    of_rates = {"max_rate": 0.0, "path_angle_rad": 0.0, "packet_error_rad": 0.0}
    assert checks.counts == replace(together, **of_rates)


@pytest.mark.parametrize("samples", [3, 50, 2000])
@pytest.mark.parametrize("step_ns", [1_000_000, 10_000_000, 1_000_000_000])
def test_samples_in_reverse_order_of_time_are_to_be_sorted(samples, step_ns):
    """They were said to begin with an outlier, and dropping was offered, which leaves one."""
    t_ns = 1_700_000_000_000_000_000 + np.arange(samples)[::-1] * step_ns
    series = GyroSeries(t_ns, np.arange(3.0 * samples).reshape(-1, 3))
    with pytest.raises(TimelineError, match="are in reverse order of time; choose ") as caught:
        list(Timeline(Policy(), "log.csv").apply([series]))
    assert "drop" not in str(caught.value)
    in_order = Timeline(Policy(on_backwards="sort"), "log.csv").apply([series])
    assert GyroSeries.joined(list(in_order)) == series[::-1]
