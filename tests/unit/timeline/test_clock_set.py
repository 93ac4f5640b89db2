"""A clock that was set while it was recorded: back by a while, or from 1970 to today."""

import re

import numpy as np
import pandas as pd
import pytest
from make.commands import refused, run
from make.ros import imu_messages, write_messages

MS, S = 10**6, 10**9
T0 = 1_700_000_000 * S
COUNT = 900
STEADY = np.arange(COUNT) * 10 * MS
RATE = np.sin(np.arange(COUNT)[:, None] / 30 + np.arange(3))
HEADER = "time_ns,gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)\n"


def rows_of(t_ns):
    """Return the rows of a table."""
    texts = (",".join(map(repr, rate)) for rate in RATE[: len(t_ns)].tolist())
    return [f"{t},{text}\n" for t, text in zip(t_ns.tolist(), texts, strict=True)]


def table(path, rows):
    """Write rows; return the path."""
    path.write_text("".join([HEADER, *rows]))
    return path


def final(*words, code=0):
    """Return the attitudes that are propagated."""
    out = words[1].parent / "o.csv"
    out.unlink(missing_ok=True)
    run("propagate", *words[1:], "-o", out, code=code)
    return pd.read_csv(out)


def set_back(by_ns, at=400):
    """Return the times of a clock that is set back once."""
    return T0 + STEADY - by_ns * (np.arange(COUNT) >= at)


@pytest.mark.parametrize("by_ms", [50, 1_300, 3_900, 60_000])
def test_a_clock_that_was_set_back_is_cut_there(tmp_path, by_ms):
    """Sorting mixed what follows with what was before; in sequence, nothing of it is lost."""
    t_ns = set_back(by_ms * MS)
    if by_ms > 4_000:  # the log began earlier
        t_ns = np.concatenate([[T0 - 100 * S], t_ns[1:]])
    rows = rows_of(t_ns)
    path = table(tmp_path / "log.csv", rows)
    said = refused("propagate", path, "-o", "-")
    assert re.search(
        r"at sample 400 \(t = \d+ ns\) as if the clock had been set back; choose another "
        r"--time-col, --series C=VALUE if rows of several sensors follow one another, or cut the "
        r"log there and read its parts in order with --in-sequence$",
        said,
    )
    parts = table(tmp_path / "1.csv", rows[:400]), table(tmp_path / "2.csv", rows[400:])
    found = final("propagate", *parts, "--in-sequence")
    assert (np.diff(found["t_ns"])[1:] == 10 * MS).all()
    info = run("info", path, code=0).stdout
    assert "(refused), first at sample 400" in info
    assert "as if the clock had been set back" in info


@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_of_a_clock_that_was_set_back_steady_log_times_are_named_first(tmp_path, suffix):
    """They were not named at all, only another clock."""
    messages = imu_messages(set_back(1_300 * MS), RATE, recorded=T0 + STEADY)
    path = write_messages(tmp_path / f"log.{suffix}", messages)
    said = refused("propagate", path, "-o", "-")
    assert said.endswith(
        "as if the clock had been set back; choose --clock log, whose times are steady, or cut the "
        "log there and read its parts in order with --in-sequence"
    )
    assert final("propagate", path, "--clock", "log")["t_ns"].tolist() == (T0 + STEADY).tolist()
    parts = [
        write_messages(
            tmp_path / f"{name}.{suffix}",
            imu_messages(set_back(1_300 * MS)[part], RATE[part], recorded=(T0 + STEADY)[part]),
        )
        for name, part in (("1", slice(400)), ("2", slice(400, None)))
    ]
    found = final("propagate", *parts, "--in-sequence")
    assert np.diff(found["t_ns"]).tolist() == [10 * MS] * (COUNT - 1)


def test_steady_log_times_are_named_before_header_times_in_disorder_are_sorted(tmp_path):
    """Late stamps may be right, so that sorting stays a way out."""
    late = STEADY + np.random.default_rng(3).integers(-30 * MS, 30 * MS, COUNT)
    path = write_messages(
        tmp_path / "log.mcap", imu_messages(T0 + late, RATE, recorded=T0 + STEADY)
    )
    said = refused("propagate", path, "-o", "-")
    ways = "; choose --clock log, whose times are steady, or --on-backwards drop|sort"
    assert said.endswith(ways)
    found = final("propagate", path, "--clock", "log")
    assert found["t_ns"].tolist() == (T0 + STEADY).tolist()
    unsteady = np.sort(STEADY + np.random.default_rng(4).integers(0, 300 * MS, COUNT))
    messages = imu_messages(T0 + late, RATE, recorded=T0 + unsteady)
    other = write_messages(tmp_path / "other.mcap", messages)
    said = refused("propagate", other, "-o", "-")
    assert said.endswith("; choose --on-backwards drop|sort, or another --clock")


@pytest.mark.thorough
@pytest.mark.parametrize("first_ms", [0, 1_000])
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_a_simulation_that_was_reset_is_two_runs(tmp_path, suffix, first_ms):
    """The robot is put back: by --clock log the second run went on from the end of the first."""
    runs = slice(500), slice(500, None)
    t_ns = first_ms * MS + np.where(np.arange(COUNT) < 500, STEADY, STEADY - 500 * 10 * MS)
    path = write_messages(
        tmp_path / f"log.{suffix}", imu_messages(t_ns, RATE, recorded=T0 + STEADY)
    )
    said = refused("propagate", path, "-o", "-")
    end = t_ns[499]
    assert said.endswith(
        "; the clock begins anew there: if a simulation was reset, cut the log there and propagate "
        "each of its two runs by itself, the first also by --on-backwards drop "
        f"--end {end}; if only the clock was, choose --clock log, whose times are steady, or read "
        "the parts in order with --in-sequence"
    )
    parts = [
        write_messages(
            tmp_path / f"{number}.{suffix}",
            imu_messages(t_ns[one], RATE[one], recorded=(T0 + STEADY)[one]),
        )
        for number, one in enumerate(runs)
    ]
    each = [final("propagate", part) for part in parts]
    assert [one["t_ns"].tolist() for one in each] == [t_ns[one].tolist() for one in runs]
    assert (each[1].iloc[0, 1:] == each[0].iloc[0, 1:]).all()
    first = final("propagate", path, "--on-backwards", "drop", "--end", end, code=3)
    pd.testing.assert_frame_equal(first, each[0])
    whole = final("propagate", path, "--clock", "log")
    assert whole["t_ns"].tolist() == (T0 + STEADY).tolist()
    in_order = final("propagate", *parts, "--in-sequence")
    np.testing.assert_allclose(in_order.iloc[:, 1:], whole.iloc[:, 1:], atol=1e-12)


def order(name):
    """Return indices of rows that came late, in packets or one by one, or of several sensors."""
    rows = np.arange(COUNT)
    if name.startswith("late"):
        size = int(name[4:])
        rows = np.concatenate(
            [rows[:300], rows[300 + size : 300 + 2 * size], rows[300 : 300 + size],
             rows[300 + 2 * size :]]
        )  # fmt: skip
    return rows


@pytest.mark.parametrize("name", ["late1", "late2", "late3", "late10", "late200"])
def test_rows_that_came_late_are_sorted(tmp_path, name):
    """Behind them time jumps ahead; nothing was set."""
    path = table(tmp_path / "log.csv", rows_of(T0 + STEADY[order(name)]))
    said = refused("propagate", path, "-o", "-")
    assert "set back" not in said
    assert "choose --on-backwards drop|sort" in said
    found = final("propagate", path, "--on-backwards", "sort")
    assert found["t_ns"].tolist() == (T0 + STEADY).tolist()


def test_rows_of_another_sensor_behind_the_first_are_no_clock_that_was_set(tmp_path):
    """They begin when the first do, or take turns in packets."""
    twice = np.concatenate([STEADY[:300], STEADY[:300] + MS])
    packets = np.concatenate([STEADY[:300].reshape(-1, 10), STEADY[:300].reshape(-1, 10) + MS], 1)
    for k, t_ns in enumerate((twice, packets.ravel())):
        path = table(tmp_path / f"{k}.csv", rows_of(T0 + t_ns))
        said = refused("propagate", path, "-o", "-")
        assert "set back" not in said
        assert "--series" in said


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_a_clock_that_was_set_from_1970_names_the_two_parts(tmp_path, suffix):
    """The rates were propagated across decades."""
    t_ns = STEADY + T0 * (np.arange(COUNT) >= 300)
    if suffix == "csv":
        path = table(tmp_path / "log.csv", rows_of(t_ns))
    else:
        path = write_messages(tmp_path / "log.mcap", imu_messages(t_ns, RATE, recorded=t_ns))
    said = run("propagate", path, "-o", "-", code=0).stderr
    (ways,) = re.findall(r"if the clock was set there, use one part, by (.*) or (.*)", said)
    assert ways == (f"--start {t_ns[300]}", f"--end {t_ns[299]}")
    for way, part in zip(ways, (t_ns[300:], t_ns[:300]), strict=True):
        assert final("propagate", path, *way.split())["t_ns"].tolist() == part.tolist()


def test_a_pause_of_days_is_no_clock_that_was_set(tmp_path):
    """A log may have been continued."""
    t_ns = T0 + STEADY + 30 * 86_400 * S * (np.arange(COUNT) >= 300)
    path = table(tmp_path / "log.csv", rows_of(t_ns))
    assert "the clock was set" not in run("propagate", path, "-o", "-", code=0).stderr
