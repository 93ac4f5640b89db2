"""`quatprop info`: rates and attitudes of logs, and what is missing to read them."""

import io
import json
import sys

import numpy as np
import pyarrow as pa
import pytest
from make.commands import refused, run
from make.formats import NOT_READ
from make.joined_logs import join_mcap
from make.places import SAMPLE_LOGS
from make.ros import TF, imu_messages, write_messages
from make.small_files import EUROC
from make.tables import write_rates
from make.writing import write_series
from pyarrow import parquet as pq

import quatprop
from quatprop.base.text import Setting, in_python
from quatprop.kinematics.series import AttitudeSeries
from quatprop.propagation import plausibility, survey
from quatprop.readers.containers import topic_table
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.messages import protobuf
from quatprop.settings import in_options
from quatprop.writers.formats import WRITERS

CONING = SAMPLE_LOGS / "coning.mcap"


def info(*arguments, **options):
    """Return what `quatprop info --json` says of one log."""
    (log,) = json.loads(run("info", "--json", *arguments, code=0, **options).stdout)
    return log


def text(*arguments):
    """Return the lines of `quatprop info`."""
    return run("info", *arguments, code=0).stdout.splitlines()


def table(tmp_path, head, name="log.csv"):
    """Write five rows, 10 ms apart."""
    rows = [[10_000_000 * k, *["0.5"] * head.count(",")] for k in range(5)]
    return write_rates(tmp_path / name, rows, head)


def test_a_log_is_a_table_with_a_line_for_each_source(tmp_path):
    """It names the source, its type, samples, rate, span, gaps, duplicates and largest rate."""
    log = write_rates(tmp_path / "log.csv", [(k * 10**8, 0, 0, 1) for k in range(11)], EUROC)
    name, head, source = text(log)
    assert name == f"{log} (csv)"
    assert " ".join(head.split()) == "source type samples Hz span s gaps dup back max rad/s"
    assert source.split()[-8:] == ["EuRoC", "11", "10", "1", "0", "0", "0", "1"]
    assert info(log)["kind"] == "csv"


RATE_UNIT, TIME_UNIT = Setting("rate_unit", "rad/s|deg/s"), Setting("time_unit", "s|ms|us|ns")
UNITS = {
    "t_ns,gyro_x,gyro_y,gyro_z": "the unit of the rates 'gyro_x', 'gyro_y', 'gyro_z' is not "
    f"declared; specify it with {RATE_UNIT}",
    "t,wx_rad_s,wy_rad_s,wz_rad_s": "the unit of the time 't' is not declared; specify it with "
    f"{TIME_UNIT}",
    "t,wx,wy,wz": "the unit of the rates 'wx', 'wy', 'wz' and the unit of the time 't' are not "
    f"declared; specify them with {RATE_UNIT} and {TIME_UNIT}",
}


@pytest.mark.parametrize(("head", "sentence"), UNITS.items())
def test_a_table_whose_units_are_unknown_is_shown(tmp_path, head, sentence):
    """Known counts are shown, unknown ones left open, and the missing option is named."""
    path = table(tmp_path, head)
    (source,) = info(path)["sources"]
    assert (source["missing"], source["samples"]) == (in_python(sentence), 5)
    timed, rated = "t_ns" in head, "rad_s" in head
    assert (source["rate_hz"], source["span_s"]) == ((100.0, 0.04) if timed else (None, None))
    assert (source["max_rate_rad_s"] is not None, source["rate_unit"] is not None) == (rated, rated)
    _, _, row, *_, last = text(path)
    assert row.split().count("-") == 5 * (not timed) + (not rated)
    assert last == f"  {source['source']}: {in_options(sentence)}"


AMBIGUOUS = {
    "a,b,wx,wy,wz": "the time column (one of 'a', 'b') is not declared; specify it with "
    "time_col='C', "
    "or sample_rate='HZ' for rows at a steady rate",
    "t_ns,a_qw,a_qx,a_qy,a_qz,b_qw,b_qx,b_qy,b_qz": "which quaternion to use (their scalar columns "
    "are 'a_qw', 'b_qw') is not declared; specify it with series='a' or 'b'",
    "time,qw,qx,qy,qz": "the unit of the time 'time' is not declared; specify it with "
    "time_unit='s' or "
    "'ms' or 'us' or 'ns'",
}


@pytest.mark.parametrize(("head", "missing"), AMBIGUOUS.items())
def test_an_ambiguous_column_is_asked_for(tmp_path, head, missing):
    """Where even the time or the quaternion is ambiguous, the sentence stands alone."""
    (source,) = info(table(tmp_path, head))["sources" if "wx" in head else "attitudes"]
    samples = 5 if head.startswith("time") else None
    assert (source["samples"], source["rate_hz"], source["missing"]) == (samples, None, missing)


def test_attitudes_of_a_table_are_listed(tmp_path):
    """Type, layout, count and rate; rows that are no rotation are counted and located."""
    rows = ["0,0,0,0,1", "10000000,0,0,0,0", "20000000,nan,0,0,0"]
    path = write_rates(tmp_path / "log.csv", rows, "t_ns,qx,qy,qz,qw")
    log = info(path)
    assert log["sources"] == []
    (source,) = log["attitudes"]
    assert source.items() >= {
        ("source", "qx,qy,qz,qw"), ("type", "quatprop"), ("layout", "scalar-last"),
        ("convention", "hamilton"), ("direction", "body-to-ref"), ("samples", 3),
        ("rate_hz", 100.0), ("invalid", 2), ("missing", None),
    }  # fmt: skip
    (remark,) = source["remarks"]
    assert remark == (
        "2 of 3 rows are invalid quaternions (1 all zero, 1 absent or not finite), the first is "
        "row 1 at 10000000 ns"
    )
    head = " ".join(text(path)[1].split())
    assert head == "attitudes type samples Hz span s gaps dup back invalid layout"


@pytest.mark.parametrize("name", ["out.parquet", "out.mcap", "out.npz"])
def test_how_attitudes_were_made_is_shown(tmp_path, name):
    """Log, method and first attitude, as their file says, and in what terms they are stored."""
    path = tmp_path / name
    run("propagate", CONING, "-o", path, "--method", "mean", "--q0", "0.6,0,0,0.8", code=0)
    (source,) = info(path)["attitudes"]
    assert (source["method"], source["made_from"]) == ("mean", str(CONING))
    assert source["q0_wxyz"] == pytest.approx([0.6, 0.0, 0.0, 0.8], abs=1e-15)
    said = f"from {CONING}, method mean, q0 0.6,0,0,0.8 (wxyz), stored as hamilton body-to-ref"
    assert text(path)[-1] == f"  {source['source']}: {said}"


@pytest.mark.parametrize(
    "metadata",
    ["[]", '{"convention": 3, "source": {"path": [1]}}', '{"convention": {"q0_wxyz": ["a", 1]}}'],
)
def test_metadata_of_other_programs_does_no_harm(tmp_path, metadata):
    """It is left out, or refused in a sentence."""
    path = tmp_path / "a.parquet"
    rows = pa.table(
        {"t_ns": [0, 10], "qw": [1.0, 1.0], **dict.fromkeys(["qx", "qy", "qz"], [0.0] * 2)}
    )
    pq.write_table(rows.replace_schema_metadata({"quatprop": metadata}), path)
    result = run("info", path)
    assert result.exit_code in {0, 2}
    assert "stored as" not in result.output


@pytest.mark.parametrize("kind", [kind for kind in WRITERS if kind not in NOT_READ])
def test_every_kind_that_is_written_is_described(tmp_path, kind):
    """The layout is that of the file, the rate that of its stamps."""
    series = AttitudeSeries(np.arange(11) * 5_000_000, np.tile([1.0, 0, 0, 0], (11, 1)))
    path = write_series(tmp_path / "attitude", series, kind=kind)
    (source,) = info(path)["attitudes"]
    layout = "scalar-last" if WRITERS[kind].layout == "scalar-last" else "scalar-first"
    assert (source["layout"], source["samples"], source["rate_hz"]) == (layout, 11, 200.0)


def test_one_log_that_cannot_be_read_hides_no_other(tmp_path):
    """Neither what is damaged nor what holds nothing of use; each has its sentence."""
    good, other = table(tmp_path, "t_ns,wx,wy,wz"), table(tmp_path, "t_ns,qw,qx,qy,qz", "q.csv")
    bad, empty = tmp_path / "bad.mcap", table(tmp_path, "t_ns,a,b", "nothing.csv")
    bad.write_bytes(b"\x89MCAP0\r\n" + bytes(20))
    missing = tmp_path / "none.bag"
    result = run("info", "--json", good, bad, empty, other, missing, code=2)
    assert [log["path"] for log in json.loads(result.stdout)] == [str(good), str(other)]
    blamed = [line.split(":")[1].strip() for line in result.stderr.splitlines()]
    assert blamed == [str(bad), str(empty), str(missing)]


def test_options_about_rates_hide_attitudes(tmp_path):
    """Somebody who names columns of rates wants to see rates."""
    path = table(tmp_path, "t_ns,wx,wy,wz,qw,qx,qy,qz")
    for options, count in (([], 1), (["--rate-cols", "wx,wy,wz", "--rate-unit", "deg/s"], 0)):
        log = info(path, *options)
        assert (len(log["sources"]), len(log["attitudes"])) == (1, count)


@pytest.mark.parametrize(
    ("head", "key"), [("t_ns,wx,wy,wz", "sources"), ("t_ns,qw,qx,qy,qz", "attitudes")]
)
def test_stdin_is_read_once(head, key):
    """Rates are looked at; attitudes where there are no rates."""
    rows = "".join(f"{k}{',0.5' * head.count(',')}\n" for k in range(3))
    assert info("-", input=f"{head}\n{rows}")[key][0]["samples"] == 3


def test_a_binary_log_on_stdin_is_listed_whole():
    """It was copied, so attitudes are looked for, too; text is read once, which is reported."""
    found = []
    for name in ("tumbling.bag", "spin.csv"):
        stdin = io.BufferedReader(io.BytesIO((SAMPLE_LOGS / name).read_bytes()))
        found.append(info("-", input=stdin))
    log = info(SAMPLE_LOGS / "tumbling.bag")
    assert {**found[0], "path": log["path"]} == log
    remark = "text on stdin is read only once: attitudes were not looked for"
    assert remark in found[1]["sources"][0]["remarks"]


def test_an_orientation_that_no_message_has_is_not_listed():
    """A gyroscope without an estimate marks every orientation as absent: there are none."""
    log = info(SAMPLE_LOGS / "tumbling.bag")
    assert ([one["source"] for one in log["sources"]], log["attitudes"]) == (["/imu"], [])


def test_a_topic_that_needs_an_extra_does_not_hide_the_others(tmp_path, monkeypatch):
    """Unreadable sources are listed with a remedy, next to the readable ones."""
    alone = tmp_path / "alone.mcap"
    run("propagate", CONING, "-o", alone, "-q", "--message", "FrameTransform", code=0)
    copy = join_mcap(tmp_path / "copy.mcap", CONING, alone)
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    protobuf._message_class.cache_clear()  # noqa: SLF001  # others may have filled it
    log = info(copy)
    assert [one["source"] for one in log["sources"]] == ["/imu"]
    (attitude,) = log["attitudes"]
    assert "is encoded as protobuf, which needs the package protobuf" in attitude["missing"]
    said = text(alone)[3]
    assert said.startswith(f"  /tf: from {CONING}, method start, q0 1,0,0,0 ")
    assert said.endswith(", stored as hamilton body-to-ref")
    alone.write_bytes(alone.read_bytes().replace(b'{"', b'x"'))  # its metadata are no JSON now
    assert info(alone)["attitudes"][0]["source"] == "/tf"


def test_a_topic_of_several_transforms_is_one_sentence(shared_logs):
    """The sentence stands under the log's name and does not repeat it."""
    log = shared_logs / "irregular" / "tilt_laser.bag"
    assert text(log)[-1].endswith("; choose one with --frame PARENT:CHILD of quatprop convert")
    (said,) = [one["missing"] for one in info(log)["attitudes"] if one["source"] == "/tf"]
    assert str(said).startswith("topic '/tf' has several transforms: '/tilt_axis:/camera', ")


def test_a_topic_without_transforms_is_reported(tmp_path):
    """An error about an empty /tf_static in `info` advised to run `info`."""
    log = write_messages(tmp_path / "log.mcap", [("/tf_static", TF, 0, ())])
    said = "the messages of topic '/tf_static' hold no transforms; choose another "
    assert text(log)[-1] == f"  /tf_static: {said}--topic"
    assert info(log)["attitudes"][0]["missing"] == f"{said}topic"
    assert refused("convert", log, tmp_path / "out.csv") == f"Error: {log}: {said}--topic"


@pytest.mark.parametrize(
    ("room", "apart_whole"), [(1 << 21, [8000] * 2), (1 << 23, [8000])], ids=["long", "short"]
)
def test_rates_and_attitudes_of_a_topic_are_read_together(tmp_path, monkeypatch, room, apart_whole):
    """A log is read once, with the same remarks as if each source were read by itself."""
    monkeypatch.setattr(plausibility, "COMPARED_SAMPLES", 10)
    monkeypatch.setattr(topic_table, "ROOM", room)
    monkeypatch.setattr(topic_table, "ENOUGH_MESSAGES", 2000)
    log = tmp_path / "log.mcap"
    run("simulate", log, "--samples", "8000", "--truth", "none", code=0)
    read, original = [], McapLog.blocks

    def blocks(self, channel, *within):
        count = 0
        for block in original(self, channel, *within):
            count += len(block)
            yield block
        read.append(count)

    monkeypatch.setattr(McapLog, "blocks", blocks)
    surveyed = info(log)
    assert read == [8000]
    (rates,) = surveyed["sources"]
    assert (rates["samples"], rates["gaps"], rates["backwards"]) == (8000, 0, 0)
    monkeypatch.setattr(survey, "_attitude_reading", lambda *_: None)
    apart = info(log)
    assert read == [8000, *apart_whole]
    assert apart == surveyed


def test_info_suggests_crosscheck_if_there_are_several_sources(tmp_path):
    """One line where a log has several sources of rotation, and none where it has one."""
    t_ns, rate = np.arange(100) * 10**7, np.ones((100, 3))
    one = [*imu_messages(t_ns, rate)]
    other = [("/rear", *each[1:]) for each in one]
    both = write_messages(tmp_path / "both.mcap", sorted([*one, *other], key=lambda each: each[2]))
    count = len(quatprop.crosscheck(both, clock="log").sources)
    assert f"  {count} sources of rotation: crosscheck compares each with every other" in text(both)
    rows = [(k * 10**7, 0.1, 0.2, 0.3, 0, 0, 0, 0) for k in range(100)]
    head = "t_ns,wx_rad_s,wy_rad_s,wz_rad_s,qw,qx,qy,qz"
    assert "sources of rotation" not in text(write_rates(tmp_path / "zeros.csv", rows, head))
    assert count == 4, "each topic has rates and an orientation"
    assert "crosscheck" not in "".join(text(write_messages(tmp_path / "one.mcap", one)))
