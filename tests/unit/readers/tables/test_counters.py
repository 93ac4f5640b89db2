"""Counters of samples: what is one, where it wrapped around, and what is not exact."""

import numpy as np
import pytest

from quatprop.readers.tables.table_log import counted, counting


def stepping(*steps):
    """Return the numbers of a counter with these steps."""
    return np.cumsum([5.0, *steps])


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (stepping(), None),
        (stepping(1), (1, True, False)),
        (stepping(0.5), None),
        (np.array([2.0**60 - 256, 2.0**60 - 128]), (128, False, False)),
        (np.array([2.0**60 - 128, 2.0**60]), None),
        # One step in twenty may not rise, and one in any case.
        (stepping(1, 0), (1, True, False)),
        (stepping(1, 0, 0), None),
        (stepping(*[1] * 38, 0, -1), (1, True, False)),
        (stepping(*[1] * 37, 0, -1), None),
        (stepping(*[1] * 37, 0, 0, 0), None),
        # Where more steps are no multiples of the usual one, many samples were lost.
        (stepping(*[4] * 38, 3, 5), (4, False, True)),
        (stepping(*[4] * 37, 3, 5, 7), (4, True, True)),
        (stepping(*[4] * 37, 8, 12, 16), (4, False, True)),
        (stepping(*[5] * 37, 3, 4, 7), (5, False, True)),
    ],
)
def test_a_counter_is_known_by_its_steps(numbers, expected):
    """Its usual step, whether it counts one by one, and whether there are other steps."""
    assert counting(numbers) == expected


@pytest.mark.parametrize(
    ("last", "following", "count"),
    [
        # After a loss of less than a quarter of the range.
        (255, 62, 63),
        (255, 63, -192),
        (256, 0, -256),
        (2**16 - 1, 2**14 - 2, 2**14 - 1),
        (2**32 - 1, 2**30 - 2, 2**30 - 1),
        (2**32 - 1, 2**30 - 1, 2**30 - 2**32),
        (2**32, 0, -(2**32)),
    ],
)
def test_a_counter_wraps_around_at_the_end_of_its_range(last, following, count):
    """Ranges are of 8, 16 or 32 bits; the rows before may have been read before."""
    assert counted(np.array([last, following])).tolist() == [0, count]
    assert counted(np.array([following]), (last, 7)).tolist() == [7 + count]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_count_whose_differences_may_overflow_is_refused(sign):
    """Before they are taken."""
    assert counted(np.array([0, sign * (2**61 - 1)])).tolist() == [0, sign * (2**61 - 1)]
    with pytest.raises(OverflowError):
        counted(np.array([0, sign * 2**61]))
