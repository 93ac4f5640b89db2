"""Time ranges of indexed logs: the same attitudes as of the whole log, and little of it read."""

import shutil
import sqlite3
import warnings
from contextlib import closing

import numpy as np
import pyarrow.parquet
import pytest
from make.mcap import Topic, write_topics
from make.tables import write_rates
from mcap.reader import make_reader
from mcap.writer import CompressionType

from quatprop import propagate, read_rates
from quatprop.base.errors import NoSamplesError, TimelineError, UsageError
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation import plausibility
from quatprop.readers import range_readers
from quatprop.readers.containers import mcap, rosbag1
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection
from quatprop.tools.simulation import Gyroscope, Shape, simulate
from quatprop.writers import rosbag1 as rosbag1_file

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
SECONDS = 2000
RATE = 10
T0_NS = 1000 * NS_PER_S
MARGIN_S = 10


@pytest.fixture(autouse=True)
def _narrow(monkeypatch):
    """Use a margin that suits short logs, and compare fewer samples with the orientation."""
    monkeypatch.setattr(plausibility, "COMPARED_SAMPLES", 100)
    monkeypatch.setattr(range_readers, "MARGIN_NS", MARGIN_S * NS_PER_S)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return a folder with a log in many chunks, as MCAP, ROS 1 bag and SQLite."""
    folder = tmp_path_factory.mktemp("logs")
    gyroscope = Gyroscope(RATE, SECONDS * RATE, noise=1e-3, start_ns=T0_NS)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(rosbag1_file, "CHUNK_BYTES", 25_000)
        for name, kind in {"one.mcap": "mcap", "log.bag": "bag"}.items():
            simulate(folder / name, "coning", Shape(), gyroscope, kind=kind, truth=None)
    rewrite(folder / "one.mcap", folder / "log.mcap")
    simulate(folder / "db3", "coning", Shape(), gyroscope, kind="rosbag2", truth=None)
    return folder


def rewrite(source, target, logged=lambda log_ns: log_ns):
    """Write messages of an MCAP file in small chunks, at other log times."""
    with source.open("rb") as stream:
        read = list(make_reader(stream).iter_messages())
    schema, channel, _ = read[0]
    messages = [(logged(message.log_time), message.data) for _, _, message in read]
    kind = schema.encoding, channel.message_encoding
    topics = {channel.topic: Topic(schema.name, messages, schema.data, *kind)}
    options = {"chunk_size": 25_000, "compression": CompressionType.ZSTD}
    write_topics(target, topics, profile="ros2", **options)


def whole(log, start, end):
    """Return the attitudes of a range, with the whole log read."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(range_readers, "SHARE", 10**6)
        series = propagate(log, start=start, end=end)
    assert series.report.correction.part is None
    return series


@pytest.mark.parametrize(
    ("name", "reading"),
    [("log.mcap", (mcap, "load_chunk")), ("log.bag", (rosbag1, "read_chunk"))],
)
def test_little_of_the_log_is_read(logs, monkeypatch, name, reading):
    """Only chunks around the range and at the ends of the log."""
    places = set()
    original = getattr(*reading)

    def noting(file, chunk, *others, **options):
        places.add(chunk.start)
        return original(file, chunk, *others, **options)

    monkeypatch.setattr(*reading, noting)
    propagate(logs / name, start="+900s", end="+905s")
    few = len(places)
    whole(logs / name, "+900s", "+905s")
    assert few < len(places) / 4


BEGIN, END = T0_NS + 700 * NS_PER_S, T0_NS + 720 * NS_PER_S


@pytest.mark.parametrize(
    ("logged", "is_part"),
    [
        (lambda log_ns: log_ns - NS_PER_S * 3 // 10, True),
        (lambda log_ns: log_ns + NS_PER_S * 1_700_000_000, True),
        (lambda log_ns: END if BEGIN <= log_ns <= END else log_ns, False),
        (lambda log_ns: log_ns if log_ns > T0_NS + NS_PER_S else 0, False),
    ],
)
def test_stamps_are_found_by_log_times_that_are_always_as_far(logs, tmp_path, logged, is_part):
    """As in a log that was recorded again, but not where the recorder hung or its clock was off."""
    log = tmp_path / "again.mcap"
    rewrite(logs / "log.mcap", log, logged)
    series = propagate(log, start="+700s", end="+705s")
    assert (series.report.correction.part is not None) == is_part
    assert len(series) == 5 * RATE + 1
    assert series == whole(log, "+700s", "+705s")


def test_a_range_without_samples_is_refused_as_ever(logs):
    """The error counts the samples on both sides, of the whole log."""
    middle = T0_NS + 700 * NS_PER_S + 1
    with pytest.raises(NoSamplesError, match="7001 are before, 12999 after"):
        propagate(logs / "log.mcap", start=middle, end=middle + 1)


def test_the_report_says_what_was_not_read(logs):
    """Which part was read, and that nothing is known of the rest."""
    report = propagate(logs / "log.mcap", start="-30s").report
    part = report.correction.part
    last_ns = T0_NS + (SECONDS * RATE - 1) * NS_PER_S // RATE
    # The recorder is late by some milliseconds.
    late = part.last_ns - last_ns
    assert 0 < late < NS_PER_S // 100
    assert abs(part.first_ns - (last_ns - (30 + MARGIN_S) * NS_PER_S)) < NS_PER_S // 100
    assert part.leaves_out == (True, False)
    assert report.source.digest.sha256 is None
    assert any("only the part of the log around" in str(remark) for remark in report.remarks)
    assert report.as_json()["correction"]["part"]["first_ns"] == part.first_ns


def test_damage_elsewhere_is_not_looked_for_and_damage_there_is(logs, tmp_path):
    """Losses outside the range cannot be known; those in it are reported."""
    content = bytearray((logs / "log.mcap").read_bytes())
    with (logs / "log.mcap").open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    damaged = next(chunk for chunk in chunks if chunk.message_start_time > T0_NS + 1000 * NS_PER_S)
    place = damaged.chunk_start_offset + damaged.chunk_length - 10
    content[place : place + 4] = bytes(4)
    log = tmp_path / "damaged.mcap"
    log.write_bytes(content)
    report = propagate(log, start="+300s", end="+310s").report
    assert report.correction.part is not None
    assert not report.losses
    second = (damaged.message_start_time - T0_NS) // NS_PER_S
    report = propagate(log, start=f"+{second - 20}s", end=f"+{second + 20}s").report
    assert report.correction.part is not None
    (loss,) = report.losses
    assert loss.place == f"chunk at byte {damaged.chunk_start_offset}"


def test_what_is_sorted_is_read_whole(logs):
    """Samples far out of order may belong to the range."""
    series = propagate(logs / "log.mcap", start="-30s", on_backwards="sort")
    assert series.report.correction.part is None


def test_a_start_before_the_log_is_remarked_on(logs):
    """It may be a slip of the unit, however little is read."""
    series = propagate(logs / "log.mcap", start=T0_NS // 2, end=T0_NS + 5 * NS_PER_S)
    assert np.array_equal(series.t_ns, T0_NS + np.arange(5 * RATE + 1) * NS_PER_S // RATE)
    assert series.report.correction.part is not None
    assert any("excludes nothing" in str(remark) for remark in series.report.remarks)


def table(tmp_path, t, **options):
    """Write random rates at some times, in row groups of ten; return what reads them."""
    random = np.random.default_rng(1)
    rates = {name: random.normal(size=len(t)) for name in ("wx", "wy", "wz")}
    path = tmp_path / "table.parquet"
    pyarrow.parquet.write_table(
        pyarrow.table({"t": t, **rates}), path, row_group_size=10, **options
    )
    return path


STAMPS = {
    "ns": (pyarrow.int64(), 1, "ns"),
    "ms as 32 bits": (pyarrow.int32(), 10**6, "ms"),
    "us without a sign": (pyarrow.uint64(), 10**3, "us"),
    **{
        f"times in {unit}": (pyarrow.timestamp(unit), scale, None)
        for unit, scale in {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}.items()
    },
}
"""Possible time columns: type, unit in ns, and the unit to declare."""


@pytest.mark.thorough
@pytest.mark.parametrize("kind", STAMPS)
@pytest.mark.parametrize("ordered", [True, False])
def test_row_groups_are_chosen_by_their_statistics(kind, ordered, tmp_path):
    """Any range of any stamps, in order or not, has the samples that the whole table has there."""
    arrow, scale, unit = STAMPS[kind]
    random = np.random.default_rng(len(kind))
    t = random.integers(0, 300, 200)
    # Groups of ten rows overlap.
    t = np.sort(t) if ordered else t // 9 + np.arange(200)
    path, parts = table(tmp_path, pyarrow.array(t).cast(arrow)), 0
    with open_log(path) as log:
        signal = choose_rates(log, RateSelection(time_unit=unit, rate_unit="rad/s"))
        reader = signal.part_reader()
        if ordered:
            assert reader.ends()[:2] == (t.min() * scale, t.max() * scale)
        everything = GyroSeries.joined(list(signal.batches()))
        for _ in range(30):
            first = int(random.integers(-5, 300))
            last = first + int(random.integers(0, 40))
            first_ns = None if first < 0 else first * scale
            last_ns = None if last > 300 else last * scale
            found = reader.read(first_ns, last_ns)
            if found is None:
                continue
            part, batches = found
            parts += 1
            low, high = first_ns or 0, 10**18 if last_ns is None else last_ns
            inside = everything[(everything.t_ns >= low) & (everything.t_ns <= high)]
            joined = GyroSeries.joined([everything[:0], *batches])
            joined = joined[(joined.t_ns >= low) & (joined.t_ns <= high)]
            assert joined.t_ns.tolist() == inside.t_ns.tolist()
            assert joined.rate.tolist() == inside.rate.tolist()
            assert part.leaves_out == (
                low > everything.t_ns.min(),
                high < everything.t_ns.max(),
            )
    assert parts > 3


@pytest.mark.parametrize(
    ("t", "options"),
    [
        (np.arange(100), {"write_statistics": False}),
        (np.arange(100) * 1.0, {}),
        ([None] * 10 + list(range(90)), {}),
        (np.full(100, 2**62), {}),
    ],
)
def test_a_table_that_does_not_say_where_its_stamps_are_is_read_whole(t, options, tmp_path):
    """Statistics may be missing, leave out floats, or not fit."""
    with open_log(table(tmp_path, t, **options)) as log:
        selection = RateSelection(time_unit="ms", rate_unit="rad/s")
        assert choose_rates(log, selection).part_reader() is None


def test_rows_outside_of_a_range_keep_their_numbers(tmp_path):
    """A loss in a part is located by its rows in the whole table."""
    t = list(range(100))
    t[53] = None
    with open_log(table(tmp_path, t)) as log:
        signal = choose_rates(log, RateSelection(time_unit="ns", rate_unit="rad/s"))
        _, batches = signal.part_reader().read(52, 55)
        assert sum(map(len, batches)) == 9
        assert [loss.place for loss in log.losses] == ["rows 51 to 60"]


@pytest.mark.parametrize(
    "change",
    [
        "DROP INDEX timestamp_idx",
        "DROP INDEX timestamp_idx; CREATE INDEX other ON messages (topic_id, timestamp)",
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 'late', x'00')",
    ],
)
def test_a_database_without_a_sound_index_of_times_is_read_whole(logs, tmp_path, change):
    """Where no index begins with the time, or a time is no number, ranges are not looked up."""
    bag = tmp_path / "bag"
    shutil.copytree(logs / "db3", bag)
    (part,) = bag.glob("*.db3")
    with closing(sqlite3.connect(part)) as database:
        database.executescript(change)
    with open_log(logs / "db3") as log:
        (channel,) = log.channels()
        assert log.recorded_span(channel).length_ns > (SECONDS - 2) * NS_PER_S
    with open_log(bag) as log:
        assert log.recorded_span(*log.channels()) is None


def relative(tmp_path, stamps_ms, kind="csv", **options):
    """Return the stamps, in ms, that are used of a table of samples, and what was remarked."""
    path = tmp_path / f"log.{kind}"
    if kind == "csv":
        write_rates(path, [(f"{stamp}000000", 0.1, 0.1, 0.1) for stamp in stamps_ms])
    else:
        t_ns = np.array(stamps_ms, np.int64) * 10**6
        series = GyroSeries(t_ns, np.full((len(t_ns), 3), 0.1))
        pyarrow.parquet.write_table(series.to_arrow(), path, row_group_size=20)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        series = propagate(path, rate_unit="rad/s", **options)
    return (series.t_ns // 10**6).tolist(), [str(one.message) for one in caught]


TEN_S = range(10_000, 20_000, 100)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "place"), [("csv", 0), ("csv", 50), ("parquet", 1), ("parquet", 98)]
)
@pytest.mark.parametrize("option", ["end=-3s", "start=-2s", "start=+1s"])
def test_relative_times_do_not_count_from_an_outlier(kind, place, option, tmp_path):
    """A stamp of 1000 s in a log of 10 to 20 s was the last: `--end -3s` cut nothing."""
    stamps = list(TEN_S)
    stamps[place] = 1_000_000
    name, _, value = option.partition("=")
    later = slice(10 + (place == 0), None)
    rows = {"end=-3s": slice(70), "start=-2s": slice(79, None), "start=+1s": later}
    expected = TEN_S[rows[option]]
    for on_backwards in ("drop", "sort"):
        used, _ = relative(tmp_path, stamps, kind, on_backwards=on_backwards, **{name: value})
        assert used == [stamp for stamp in expected if stamp != TEN_S[place]]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("option", [{}, {"start": "+1s"}, {"end": "-3s"}, {"start": "-2s"}])
def test_an_outlier_is_refused_with_a_relative_range_as_without(kind, option, tmp_path):
    """It was hidden by the range that it had displaced."""
    stamps = list(TEN_S)
    stamps[50] = 1_000_000
    with pytest.raises(
        TimelineError,
        match=r"log\.(csv|parquet): the timestamp of sample 50 \(t = 1000000000000 ns\) is an "
        r"outlier, 985\.1 s ahead of those around it; choose on_backwards='drop' or 'sort', or "
        r"another time_col$",
    ):
        relative(tmp_path, stamps, kind, **option)


PAUSES = {
    "start=+1s": ([0, *TEN_S], TEN_S, "start counts from the first sample, at 0 ns", "0 to 10"),
    "start=-2s": ([*TEN_S, 10**6], [10**6], "start counts from the last", "19.9 to 1000"),
    "end=-3s": ([*TEN_S, 10**6], TEN_S, "end counts from the last", "19.9 to 1000"),
}


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("option", PAUSES)
def test_a_pause_next_to_the_anchor_is_remarked_on_with_both_timestamps(option, kind, tmp_path):
    """`--start +1s` silently removed only the row from before the clock was set."""
    stamps, expected, said, pause = PAUSES[option]
    name, _, value = option.partition("=")
    used, remarks = relative(tmp_path, stamps, kind, **{name: value})
    assert used == list(expected)
    before, after = (round(float(stamp) * NS_PER_S) for stamp in pause.split(" to "))
    (found,) = (remark for remark in remarks if said in remark)
    assert f" from {before} to {after} ns; if a clock was wrong there, give an absol" in found


def test_a_pause_is_never_refused_and_one_amid_the_log_is_no_anchor(tmp_path):
    """Without a relative range the remark has both timestamps; inside the log no clock is wrong."""
    used, remarks = relative(tmp_path, [*TEN_S, 10**6])
    assert used == [*TEN_S, 10**6]
    assert any("t = 1000000000000 ns, 980.1 s after 19900000000 ns" in one for one in remarks)
    stamps = [*TEN_S, *(stamp + 10**6 for stamp in TEN_S)]
    used, remarks = relative(tmp_path, stamps, start="+1s")
    assert used == stamps[10:]
    assert not any("counts from" in remark for remark in remarks)


def test_stamps_that_go_backwards_are_dropped_before_the_range_is_cut(tmp_path):
    """A late sample is late, wherever the range begins; one outside of it is not lost."""
    stamps = [*range(0, 1000, 10), 500, *range(1000, 2000, 10)]
    used, remarks = relative(
        tmp_path, stamps, start=400_000_000, end=600_000_000, on_backwards="drop"
    )
    assert used == [*range(400, 610, 10)]
    assert any("1 non-monotonic timestamp (dropped), first at sample 100" in one for one in remarks)


@pytest.mark.parametrize("option", ["start", "end"])
def test_a_small_time_in_nanoseconds_is_taken_where_the_log_reaches_it(option, tmp_path):
    """A log may begin at 0 and last a millisecond: its times could not be written."""
    stamps = range(0, 10**6, 25_000)
    path = write_rates(tmp_path / "log.csv", [(stamp, 0, 0, 1) for stamp in stamps])
    used = propagate(path, **{option: 714_036}).t_ns.tolist()
    assert used == [t for t in stamps if (t >= 714_036 if option == "start" else t <= 714_036)]
    for seconds in (5, "5"):
        with pytest.raises(
            UsageError,
            match=f"^{option}='5' is a time of the log's clock in ns, not in seconds; write 5s for "
            "seconds after the first sample$",
        ):
            propagate(path, **{option: seconds})


def test_an_outlier_in_the_last_minute_is_no_anchor(logs, tmp_path):
    """The end that the index leads to is held against its neighbours."""
    log, series = tmp_path / "log.parquet", read_rates(logs / "one.mcap")
    stamps = series.t_ns.copy()
    stamps[-5] += 1000 * NS_PER_S
    moved = GyroSeries(stamps, series.rate).to_arrow()
    pyarrow.parquet.write_table(moved, log, row_group_size=500)
    with pytest.raises(TimelineError, match=r"is an outlier, 1000.1 s ahead"):
        propagate(log, start="-30s")
    found = propagate(log, start="-30s", on_backwards="drop")
    assert found.report.correction.start_ns == series.t_ns[-1] - 30 * NS_PER_S
    assert len(found) == 30 * RATE
