"""Which logs a batch has, and the names of their outputs."""

import glob
import os
from pathlib import Path

import pytest
from make.batches import batch, entries, said, spin
from make.commands import refused, run

from quatprop.base.errors import UsageError
from quatprop.tools.batch.log_search import LogSearch
from quatprop.tools.batch.planning import refuse_shared_names, shard
from quatprop.tools.batch.tasks import BatchTask


def names(*given, root=None, output=""):
    """Return the names of the outputs of what was found."""
    search = LogSearch(root, output)
    for name in given:
        search.add(str(name))
    return [log.name for log in search.logs]


def test_a_folder_is_searched_for_logs(tmp_path, monkeypatch):
    """Bag folders are one log; what is no log is counted; the outputs are no logs."""
    for name in (
        "b/imu.csv", "b/c/imu.csv", "a.MCAP", "x.bag.zst", "rec.bag.active", "b/.imu.csv",
        "ride/metadata.yaml", "ride/ride_0.db3", ".git/x.csv", "out/a.parquet", "README",
    ):  # fmt: skip
        spin(tmp_path / name)
    (tmp_path / "ride" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    (tmp_path / "unnamed").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "broken").symlink_to("nowhere")
    (tmp_path / "b" / "loop.csv").symlink_to("loop.csv")
    search = LogSearch(output=str(tmp_path / "out"))
    search.add(str(tmp_path))
    assert [found.name for found in search.logs] == [
        "a.MCAP", "rec.bag.active", "unnamed", "x.bag.zst", "b/imu.csv", "b/loop.csv",
        "b/c/imu.csv", "ride",
    ]  # fmt: skip
    assert search.other_files == 3  # one of them hidden, and a broken link
    assert names(tmp_path / "ride") == ["ride"]
    assert names(tmp_path / "b", tmp_path / "b" / "imu.csv") == [
        "imu.csv", "loop.csv", "c/imu.csv",
    ]  # fmt: skip
    monkeypatch.chdir(tmp_path / "ride")
    assert names(".") == names("../b/../ride/.") == ["ride"]


def test_patterns_are_expanded(tmp_path):
    """** is expanded as in a shell; names are paths below the fixed part."""
    for name in ("mon/1/imu.csv", "mon/2/imu.csv", "tue/imu.csv", "tue/gps.csv", "a[1].csv"):
        spin(tmp_path / name)
    assert names(tmp_path / "*" / "*" / "imu.csv") == ["mon/1/imu.csv", "mon/2/imu.csv"]
    assert names(tmp_path / "**" / "imu.csv") == [
        "mon/1/imu.csv", "mon/2/imu.csv", "tue/imu.csv",
    ]  # fmt: skip
    assert names(tmp_path / "mon" / "**") == ["1/imu.csv", "2/imu.csv"]
    assert names(tmp_path / "t*") == ["tue/gps.csv", "tue/imu.csv"]
    assert names(tmp_path / "a[1].csv") == ["a[1].csv"]
    with pytest.raises(UsageError, match=r"^nothing matches '.*nothing\*'; check the pattern"):
        names(tmp_path / "nothing*")


TREE = ("a.csv", ".b.csv", "p/other/a.csv", "p/run1/a.csv", "p/run1/deep/b.csv", "p/run2/c.csv",
        "p/.run3/d.csv", "p/run1/.e/f.csv", "p/run[1].csv", "run/run/run.csv")  # fmt: skip

PATTERNS = (
    "*", "**", "p/*", "p/**", "p/run*/**", "p/run*", "**/*.csv", "**/run*/**", "p/**/*.csv",
    "*/*/*", "**/deep", "**/run/*", "p/run[[]1].csv", "p/[!r]*/*", "p/run?/?.csv", "p/.*/*", ".b*",
    "**/**/c.csv", "*/**/run*", "p/run1/**/**", "**/run/**/run*",
)  # fmt: skip


def files_of(pattern):
    """Return what glob finds, and all that it finds below folders."""
    for match in glob.glob(pattern, recursive=True):  # noqa: PTH207  # it is what is compared with
        below = glob.glob(f"{glob.escape(match)}/**/*.csv", recursive=True)  # noqa: PTH207
        yield from below if Path(match).is_dir() else [match]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_pattern_matches_what_glob_matches(tmp_path, monkeypatch, pattern):
    """'p/run*/**' matched p/other: only the last part of the pattern counted."""
    for name in TREE:
        spin(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    search = LogSearch()
    search.add(pattern)
    found = [os.path.normpath(log.path) for log in search.logs]
    assert sorted(found) == sorted({os.path.normpath(path) for path in files_of(pattern)})


def test_a_root_keeps_folders_in_names(tmp_path):
    """A log that is not below the root is refused."""
    first, second = spin(tmp_path / "mon" / "imu.csv"), spin(tmp_path / "tue" / "imu.csv")
    assert names(first, second) == ["imu.csv", "imu.csv"]
    assert names(first, second, root=tmp_path) == ["mon/imu.csv", "tue/imu.csv"]
    assert names(tmp_path / "mon", root=tmp_path) == ["mon/imu.csv"]
    words = (
        r"does not lie in '.*mon'; choose another root \(names are relative to the current folder\)"
    )
    with pytest.raises(UsageError, match=words):
        names(first, second, root=tmp_path / "mon")


def test_a_name_depends_on_its_own_log_alone(tmp_path):
    """The same log has the same name in a folder, a pattern, and in any part of them."""
    for day in "abcdef":
        spin(tmp_path / day / "imu.csv")
    every = names(tmp_path)
    assert every == names(tmp_path / "*" / "imu.csv") == [f"{day}/imu.csv" for day in "abcdef"]
    search = LogSearch()
    search.add(str(tmp_path))
    parts = [filter(shard(f"{part}/4").has, search.logs) for part in (1, 2, 3, 4)]
    assert sorted(found.name for part in parts for found in part) == every


def test_a_part_of_a_folder_that_grows_keeps_its_logs():
    """Parts were counted off: a new log between two tasks moved others, that were done by none."""
    few = [BatchTask("in", f"{number}.csv") for number in range(0, 60, 2)]
    many = [BatchTask("in", f"{number}.csv") for number in range(60)]
    for part in map(shard, ("1/3", "2/3", "3/3")):
        before, after = set(filter(part.has, few)), set(filter(part.has, many))
        assert after & set(few) == before
        assert 5 < len(after) < 40


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "-1/2", "a/b", "1/0"])
def test_a_part_is_one_of_n(text):
    """Anything else is refused."""
    with pytest.raises(UsageError, match=r"is not I/N, from 1/N to N/N, for shard"):
        shard(text)


def test_names_are_those_of_the_logs(tmp_path):
    """With all suffixes; of an address without what opens its store."""
    (tmp_path / "bag.v2").mkdir()
    (tmp_path / "bag.v2" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    paths = [tmp_path / name for name in ("a.mcap.zst", "bag.v2", "b.bag")]
    assert names(*paths) == ["a.mcap.zst", "bag.v2", "b.bag"]
    logs = ["s3://key:secret@logs/a.mcap?region=eu.west/1", "s3://logs/d/b.bag.zst?region=b.c"]
    assert names(*logs) == ["a.mcap", "b.bag.zst"]
    assert names(*logs, root="s3://logs") == ["a.mcap", "d/b.bag.zst"]


@pytest.mark.parametrize("ignores_case", [True, False])
def test_names_that_differ_in_case_only_are_refused_where_they_are_one(tmp_path, ignores_case):
    """They failed everywhere, though on most disks they are two."""
    (tmp_path / "out").mkdir()
    (tmp_path / "OUT").symlink_to("out" if ignores_case else tmp_path)
    search = LogSearch(suffix=".npy")
    for name in ("1/IMU.bag", "2/imu.bag", "3/gps.bag"):
        search.add(str(tmp_path / name))
    first, second, _ = search.logs
    if ignores_case:
        with pytest.raises(UsageError) as error:
            refuse_shared_names(search.logs, str(tmp_path / "out"))
        assert str(error.value).startswith(
            f"'{first.path}' and '{second.path}' would have one output, "
            f"'{tmp_path / 'out' / 'imu.bag.npy'}'; "
        )
    else:
        refuse_shared_names(search.logs, str(tmp_path / "out"))


def test_logs_can_be_listed(tmp_path):
    """In a file or on stdin, one a line, in addition to others."""
    logs = [spin(tmp_path / f"{name}.csv") for name in "abc"]
    (tmp_path / "list").write_text(f"{logs[0]}\n\n{logs[1]}\n")
    done = batch(logs[2], "--list", tmp_path / "list", "-o", tmp_path / "out")
    assert said(done) == "3 of 3 logs done, 15 samples"
    done = batch("--list", "-", "-o", tmp_path / "two", input=f"{logs[0]}\n{logs[1]}")
    assert said(done) == "2 of 2 logs done, 10 samples"
    assert refused("batch", "--list", tmp_path / "nope", "-o", tmp_path / "out") == (
        f"Error: {tmp_path / 'nope'}: no such file or folder; check the path"
    )


def test_tables_without_rates_in_a_folder_are_ignored(tmp_path):
    """They are counted; naming one is an error."""
    spin(tmp_path / "in" / "imu.csv")
    gps = tmp_path / "in" / "gps.csv"
    gps.write_text("t,lat,lon\n0,1,2\n")
    # Of two columns it failed: rates have three.
    battery = "Time (s),Voltage (V)\n" + "0.5,4.1\n" * 300
    (tmp_path / "in" / "battery.csv").write_text(battery)
    (tmp_path / "in" / "note.md").write_text("words")
    done = batch(tmp_path / "in", "-o", tmp_path / "out", code=0)
    words = "1 of 1 logs done, 5 samples; ignored 2 tables without body rates and 1 other file"
    assert said(done) == words
    for name in ("gps", "battery"):
        assert entries(tmp_path / "out")[f"{name}.csv.parquet"]["state"] == "no rates"
    batch(gps, "-o", tmp_path / "out", code=2)


def test_a_topic_does_not_apply_to_tables(tmp_path):
    """Tables in a folder are ignored; a named one is refused before anything is done."""
    table, recorded = spin(tmp_path / "logs" / "a.csv"), tmp_path / "logs" / "b.mcap"
    run("simulate", recorded, "--samples", "5", "--truth", "none", code=0)
    done = batch(tmp_path / "logs", "-o", tmp_path / "out", "--topic", "/imu", code=0)
    assert said(done) == "1 of 1 logs done, 5 samples; ignored 1 other file"
    words = refused("batch", recorded, table, "-o", tmp_path / "none", "--topic", "/imu")
    assert words == (
        f"Error: '{table}' is a table, and --topic is for logs of messages; propagate tables by "
        "themselves"
    )
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("command", ["propagate", "info"])
def test_one_log_of_a_folder_is_not_taken_for_all(tmp_path, command):
    """The other commands refuse a folder with several logs, and name them."""
    for name in ("a.csv", "b.mcap", "b.truth.csv", "c/metadata.yaml"):
        spin(tmp_path / "in" / name)
    output = ["-o", tmp_path / "out.csv"] if command == "propagate" else []
    assert refused(command, tmp_path / "in", *output) == (
        f"Error: {tmp_path / 'in'}: the folder holds several logs: 'a.csv', 'b.mcap', 'c'; "
        "name one, or use quatprop batch"
    )
    for name in ("a.csv", "b.mcap"):
        spin(tmp_path / "bag" / name)
    assert "b.mcap: the whole part: " in refused(
        command, tmp_path / "bag", "--from", "rosbag2", *output
    )
    for name in ("part-0.parquet", "part-1.parquet"):
        (tmp_path / "set").mkdir(exist_ok=True)
        (tmp_path / "set" / name).write_bytes(b"PAR1")
    assert refused(command, tmp_path / "set", *output) == (
        f"Error: {tmp_path / 'set'}: the folder holds several logs: 'part-0.parquet', "
        f"'part-1.parquet'; name one, all of one recording as {tmp_path / 'set'}/*.parquet, "
        "or use quatprop batch"
    )
