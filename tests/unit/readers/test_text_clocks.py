"""Times in text whose digits are no decimal number: counts behind the point, clock faces."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pandas as pd
import pytest
from make.commands import refused, run
from make.table_rates import told

RATES = "gx (deg/s),gy (deg/s),gz (deg/s)"
STEP_NS = 10_000_000
COUNT = 700
FIRST = datetime(2024, 5, 1, 9, 59, 57, tzinfo=UTC)
NOON = datetime(2024, 5, 1, 12, 10, 57, tzinfo=UTC)


def table(path, times, *, name="time", decimal=".", delimiter=",", above=""):  # noqa: PLR0913
    """Write texts of times, and rates that differ from row to row; return the path."""
    names = [name, *RATES.split(",")]
    rows = [
        [time, *(f"{rate + k / 100:.2f}".replace(".", decimal) for rate in (1, 2, 3))]
        for k, time in enumerate(times)
    ]
    lines = [delimiter.join(row) for row in (names, *rows)]
    path.write_text(above + "\n".join(lines) + "\n")
    return path


def at(first, step_ns=STEP_NS, count=COUNT):
    """Return the times of rows."""
    return [first + timedelta(microseconds=k * step_ns / 1000) for k in range(count)]


@pytest.mark.parametrize("word", ["sec", "seconds"])
@pytest.mark.parametrize("first_s", [0, 59, 980, 90_000])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("options", [{}, {"time_unit": "s"}, {"time_col": "time"}])
def test_durations_in_seconds_may_be_text(tmp_path, word, first_s, decimal, options):
    """As MATLAB writes those of a timetable; whole seconds have no decimals."""
    t_ns = first_s * 10**9 + np.arange(COUNT) * STEP_NS
    times = [f"{t / 1e9:.10g} {word}".replace(".", decimal) for t in t_ns.tolist()]
    delimiter = ";" if decimal == "," else ","
    path = table(tmp_path / "log.csv", times, delimiter=delimiter, decimal=decimal)
    assert told(path, **options) == (t_ns.tolist(), [])


@pytest.mark.thorough
@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
@pytest.mark.parametrize("first_s", [0, 12, 1_700_000_000])
@pytest.mark.parametrize("words", [(), ("--time-unit", "s")])
@pytest.mark.parametrize("decimal", [".", ","])
def test_a_count_behind_the_point_is_no_decimal(tmp_path, unit, first_s, words, decimal):
    """As from "%d.%d" in C: 12.5 is 12 s and 5 ns; read as decimals, time stepped back."""
    size = {"ns": 10**9, "us": 10**6, "ms": 10**3}[unit]
    counts = first_s * size + 5 + np.arange(COUNT) * STEP_NS * size // 10**9
    times = [f"{t // size}{decimal}{t % size}" for t in counts.tolist()]
    delimiter = ";" if decimal == "," else ","
    path = table(tmp_path / "log.csv", times, delimiter=delimiter, decimal=decimal)
    done = run("propagate", path, *words, "-o", tmp_path / "o.csv", code=0)
    assert f"the digits behind the point in 'time' count {unit}, without leading" in done.stderr
    t_ns = pd.read_csv(tmp_path / "o.csv")["t_ns"]
    assert t_ns.tolist() == (counts * (10**9 // size)).tolist()


@pytest.mark.thorough
@pytest.mark.parametrize("unit", ["us", "ms"])
@pytest.mark.parametrize("first", [FIRST, datetime(2024, 5, 1, 23, 59, 58, tzinfo=UTC)])
def test_a_count_behind_the_seconds_of_a_time_of_day_is_no_decimal(tmp_path, unit, first):
    """As from "%H:%M:%S" and "%d"; midnight may be among them."""
    size = {"us": 1, "ms": 1000}[unit]
    times = [f"{t:%H:%M:%S}.{t.microsecond // size}" for t in at(first)]
    t_ns, remarks = told(table(tmp_path / "log.csv", times))
    assert np.diff(t_ns).tolist() == [STEP_NS] * (COUNT - 1)
    (one,) = remarks
    assert one.endswith(f"the digits behind the point count {unit}, without leading zeros")
    decimals = [f"{t:%H:%M:%S}.{t.microsecond // 10_000:02}" for t in at(first)]
    t_ns, _ = told(table(tmp_path / "decimals.csv", decimals))
    assert np.diff(t_ns).tolist() == [STEP_NS] * (COUNT - 1)


@pytest.mark.parametrize("late", [(), (50, 300)])
def test_decimals_are_no_counts(tmp_path, late):
    """Whatever their length, and though rows came late."""
    t_s = np.round(np.arange(COUNT) * 0.0123 + 0.1, 4)
    for k in late:
        t_s[[k, k + 1]] = t_s[[k + 1, k]]
    path = table(tmp_path / "log.csv", [f"{t:g}" for t in t_s], name="time_s")
    t_ns, remarks = told(path)
    assert t_ns == np.round(t_s * 1e9).astype(int).tolist()
    assert not any("behind the point" in one for one in remarks)


@pytest.mark.parametrize("pattern", ["%M:%S.", "%M:%S,"])
def test_minutes_and_seconds_go_on_after_the_full_hour(tmp_path, pattern):
    """As Excel saves times of day: without hours, and with a tenth of a second."""
    first = datetime(2024, 5, 1, 9, 59, 31, tzinfo=UTC)
    times = [t.strftime(pattern) + str(t.microsecond // 10**5) for t in at(first, 10**8)]
    decimal = pattern[-1]
    delimiter = ";" if decimal == "," else ","
    path = table(tmp_path / "log.csv", times, delimiter=delimiter, decimal=decimal)
    t_ns, remarks = told(path)
    assert t_ns == [(59 * 60 + 31) * 10**9 + k * 10**8 for k in range(COUNT)]
    assert remarks == ["the times in 'time' are minutes and seconds, and count from the full hour"]


def test_what_a_packet_of_minutes_and_seconds_prints_is_right(tmp_path):
    """At 100 Hz, ten rows have the same tenth of a second."""
    times = [t.strftime("%M:%S.") + str(t.microsecond // 10**5) for t in at(FIRST)]
    path = table(tmp_path / "log.csv", times)
    said = run("propagate", path, "-o", "-", code=0).stderr
    assert "--regular-time gives each sample its time" in said
    run("propagate", path, "--regular-time", "-o", tmp_path / "o.csv", code=0)
    assert np.abs(np.diff(pd.read_csv(tmp_path / "o.csv")["t_ns"]) - STEP_NS).max() < 20_000


VBO = "[header]\nsatellites\n\n[column names]\n"


@pytest.mark.parametrize(
    ("first", "name", "above", "shown"),
    [
        (FIRST, "time", "", "'time'"),
        (NOON, "time", "", "'time'"),
        (datetime(2024, 5, 1, 23, 59, 58, tzinfo=UTC), "time", "", "'time'"),
        (NOON.replace(second=1), "time", VBO, "'time'"),
        (NOON.replace(second=1), "UTC (hhmmss.ss)", "", "'UTC (hhmmss.ss)'"),
    ],
)
def test_hours_minutes_and_seconds_without_colons_are_no_number(
    tmp_path, first, name, above, shown
):
    """They pass over 40 s at the end of each minute; a header or their order shows it."""
    times = [t.strftime("%H%M%S.") + f"{t.microsecond // 10**4:02}" for t in at(first)]
    path = table(tmp_path / "log.csv", times, name=name, above=above)
    t_ns, remarks = told(path)
    midnight = first.replace(hour=0, minute=0, second=0)
    assert t_ns[0] == (first - midnight).seconds * 10**9
    assert np.diff(t_ns).tolist() == [STEP_NS] * (COUNT - 1)
    assert remarks == [
        f"the numbers in {shown} are hours, minutes and seconds, and count from midnight"
    ]


def test_the_unit_of_six_digits_is_asked_for_where_they_do_not_show_it(tmp_path):
    """They may be seconds, too; within a minute both are the same."""
    times = [f"{100_001 + k / 100:.2f}" for k in range(COUNT)]
    path = table(tmp_path / "log.csv", times)
    assert "the unit of the time 'time' is not declared" in refused("propagate", path, "-o", "-")
    longer = table(tmp_path / "longer.csv", [f"{100_001 + k / 10:.1f}" for k in range(COUNT)])
    assert "the unit of the time 'time' is not declared" in refused("propagate", longer, "-o", "-")


def test_digits_of_the_day_in_a_unit_that_the_user_states_are_remarked_on(tmp_path):
    """What the remark names reads them right."""
    times = [t.strftime("%H%M%S.") + f"{t.microsecond // 10**4:02}" for t in at(FIRST)]
    path = table(tmp_path / "log.csv", times)
    said = run("propagate", path, "--time-unit", "s", "-o", "-", code=0).stderr
    assert "are read in s, as requested; without --time-unit they are read as times of day" in said


@pytest.mark.parametrize(
    ("pattern", "delimiter", "decimal"),
    [
        ('"%Y-%m-%d %H:%M:%S,{:03}"', ",", "."),
        ("%Y-%m-%dT%H:%M:%S,{:03}Z", ";", ","),
        ("%Y-%m-%d %H:%M:%S,{:03}+00:00", ";", "."),
        ("%Y-%m-%dT%H:%M:%S,{:03}", "\t", ","),
    ],
)
def test_a_date_with_a_decimal_comma_is_of_iso_8601(tmp_path, pattern, delimiter, decimal):
    """As the logging of Python writes it."""
    times = [t.strftime(pattern).format(t.microsecond // 1000) for t in at(FIRST)]
    path = table(tmp_path / "log.csv", times, delimiter=delimiter, decimal=decimal)
    t_ns, _ = told(path)
    since_1970 = (FIRST - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()
    assert t_ns == [int(since_1970) * 10**9 + k * STEP_NS for k in range(COUNT)]


def test_a_comma_after_a_date_is_no_decimal_mark_if_it_ends_the_cell(tmp_path):
    """The number in the next cell is a rate."""
    times = [t.strftime("%Y-%m-%d %H:%M:%S") for t in at(FIRST, 10**9)]
    t_ns, _ = told(table(tmp_path / "log.csv", times))
    assert np.diff(t_ns).tolist() == [10**9] * (COUNT - 1)
