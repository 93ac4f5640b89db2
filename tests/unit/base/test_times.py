"""Durations and instants as users write them."""

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quatprop.base.errors import UsageError
from quatprop.base.times import (
    Instant,
    duration_ns,
    duration_text,
    instant,
    numbered_stamps,
    regular_count,
    regular_stamps,
)


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("20ms", 20_000_000),
        ("0.5s", 500_000_000),
        ("1m30s", 90_000_000_000),
        ("1.5us", 1_500),
        ("7ns", 7),
        ("2h", 7_200_000_000_000),
        (".25s", 250_000_000),
        ("1700000000.123456789s", 1_700_000_000_123_456_789),
    ],
)
def test_durations_are_exact(text, ns):
    """A duration is exact to the nanosecond, however many digits it has."""
    assert duration_ns(text) == ns


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        *((0, "0 ns"), (999, "999 ns"), (1000, "1 us"), (1_500, "1.5 us"), (10**6, "1 ms")),
        *((20_000_000, "20 ms"), (10**9, "1 s"), (-3 * 10**9, "-3 s")),
    ],
)
def test_durations_read_well(ns, text):
    """A duration is shown in the largest unit it fills."""
    assert duration_text(ns) == text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("+10s", Instant(10_000_000_000, "first")),
        ("1m30s", Instant(90_000_000_000, "first")),
        # Ten years.
        ("+87840h", Instant(316_224_000_000_000_000, "first")),
        ("-30s", Instant(-30_000_000_000, "last")),
        ("1403715523912140000", Instant(1_403_715_523_912_140_000, "clock")),
        ("1970-01-01T00:00:01Z", Instant(1_000_000_000, "clock")),
        ("2001-09-09T01:46:40.000000001Z", Instant(1_000_000_000_000_000_001, "clock")),
        ("2001-09-09T03:46:40+02:00", Instant(1_000_000_000_000_000_000, "clock")),
        ("1969-12-31T23:59:59.5Z", Instant(-500_000_000, "clock")),
    ],
)
def test_instants(text, expected):
    """An instant is RFC 3339, integer ns, or counted from the first or the last sample."""
    assert instant(text) == expected
    assert expected.origin == "clock" or instant(str(expected)) == expected


NO_DURATION = "is not a duration; write a number with a unit, such as 20ms, 0.5s or 1m30s"
NOT_EXACT = [
    *(
        (duration_ns, text, NO_DURATION)
        for text in ["", "5", "s", "5 s", "5x", "-5s", "1e3s", "s5"]
    ),
    (duration_ns, "1m 30s", NO_DURATION),
    (duration_ns, "1.5ns", "is finer than a nanosecond; round it"),
    # It is not taken as UTC, nor as the time of this machine.
    (instant, "2001-09-09T03:46:40", "has no time zone; add one, such as Z for UTC"),
    *((instant, text, "is not a time") for text in ["yesterday", "2001-09-09", "1.5"]),
    (instant, "2001-13-09T03:46:40Z", "is not a time"),
    (instant, "+87840h1ns", "counts from the first sample, and no log is so long"),
]


@pytest.mark.parametrize(("read", "text", "sentence"), NOT_EXACT)
def test_text_that_is_not_a_time_is_refused(read, text, sentence):
    """A number without a unit, a time without a zone, and what would have to be rounded."""
    with pytest.raises(UsageError, match=f"^{re.escape(f'{text!r} {sentence}')}"):
        read(text)


@given(st.integers(0, 10**12), st.fractions(Fraction(1, 10**4), 10**9, max_denominator=10**6))
def test_regular_stamps_are_rounded_once(first, rate):
    """Sample k is at k / rate to the nearest ns, and those up to a stamp are as many as counted."""
    numbers = np.array([first, first + 1, first + 2, first + 10**10])
    expected = [round(int(k) * 10**9 / rate) for k in numbers]
    if expected[-1] < 2**62:
        assert numbered_stamps(numbers, rate).tolist() == expected
        assert regular_stamps(first, first + 3, rate).tolist() == expected[:3]
        assert regular_count(expected[1], rate) >= first + 2
        if expected[1] < expected[2]:
            assert regular_count(expected[1], rate) == first + 2
            assert regular_count(expected[2] - 1, rate) == first + 2


@pytest.mark.parametrize(
    ("elapsed_ns", "rate", "count"),
    [(-1, 1, 0), (0, 2 * 10**9, 2), (1, Fraction(2 * 10**9, 3), 1), (2, Fraction(2 * 10**9, 3), 2)],
)
def test_a_sample_at_half_a_nanosecond_is_at_the_even_one(elapsed_ns, rate, count):
    """Before the first there is none."""
    assert regular_count(elapsed_ns, Fraction(rate)) == count
    # Every 1.5 ns.
    stamps = regular_stamps(0, 6, Fraction(2 * 10**9, 3))
    assert stamps.tolist() == [0, 2, 3, 4, 6, 8]


def test_times_beyond_int64_are_refused():
    """The last one that fits is in 2262."""
    last = 2**63 // 10**9 - 1
    assert regular_stamps(last, last + 1, Fraction(1)).tolist() == [last * 10**9]
    assert not len(regular_stamps(5, 5, Fraction(1)))
    with pytest.raises(UsageError, match=f"at 1 Hz the times of {last + 2} samples do not fit in"):
        regular_stamps(last, last + 2, Fraction(1))
