"""ROS 2 bag folders, message for message against rosbags' own reader."""

import itertools
import re
import shutil
import sqlite3
import time
from collections import defaultdict
from contextlib import closing

import numpy as np
import pytest
import zstandard
from make.camera_log import write_mcap
from make.container_messages import messages_of, rosbags_messages
from make.mcap import HEADERS, build, saved
from make.ros import ROS2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from ruamel.yaml import YAML

from quatprop.base.errors import DamagedLogError, Loss, UnreadableLogError, UnsupportedLogError
from quatprop.readers.containers.rosbag2 import Rosbag2Log
from quatprop.readers.containers.rosbag2_parts import folder
from quatprop.readers.tables.model import TimeRange
from quatprop.stores.file_source import FileSource

T0 = 1_700_000_000_000_000_000
HEADER = b"\x00\x01\x00\x00"
IMU, TEXT = ("/imu", "sensor_msgs/msg/Imu"), ("/text", "std_msgs/msg/String")
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP


FORMS = [
    (SQLITE, CompressionMode.NONE),
    (SQLITE, CompressionMode.FILE),
    (SQLITE, CompressionMode.MESSAGE),
    (MCAP, CompressionMode.NONE),
    (MCAP, CompressionMode.FILE),
    (MCAP, CompressionMode.MESSAGE),
    (MCAP, CompressionMode.STORAGE),
]


def messages(path, *options):
    """Return the messages of each topic, sorted, and what was lost."""
    return messages_of(Rosbag2Log(path, *options))


def write_bag(path, form=FORMS[0], first=0, count=300, late=0):
    """Write a folder with one part; `late` ns of disorder."""
    storage, mode = form
    rng = np.random.default_rng(first)
    writer = Writer(path, version=9, storage_plugin=storage)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        imu = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=ROS2)
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=ROS2)
        for k in range(first, first + count):
            log_ns = T0 + 1_000_000 * k - (int(rng.integers(late)) if late else 0)
            writer.write(imu, log_ns, HEADER + rng.bytes(316))
            if k % 5 == 0:
                writer.write(text, log_ns, HEADER + rng.bytes(8 * int(rng.integers(1, 40))))
    return path


def metadata_of(path):
    """Return what a folder's metadata say."""
    return YAML(typ="safe").load((path / "metadata.yaml").read_text())


def write_metadata(path, metadata):
    """Replace a folder's metadata."""
    with (path / "metadata.yaml").open("w") as file:
        YAML(typ="safe").dump(metadata, file)


def split_bag(path, form=FORMS[0], late=0, overlap=0, order=(0, 1, 2)):
    """Write a bag in three parts; return it, and its messages as rosbags reads its parts."""
    path.mkdir()
    expected = defaultdict(list)
    metadata = None
    names = []
    for number in order:
        part = write_bag(path / f"part{number}", form, first=(300 - overlap) * number, late=late)
        for name, rows in rosbags_messages(part).items():
            expected[name] += rows
        metadata = metadata or metadata_of(part)
        (file,) = (one for one in part.iterdir() if one.name != "metadata.yaml")
        names.append("bag_{}{}".format(len(names), "".join(file.suffixes)))
        file.rename(path / names[-1])
        shutil.rmtree(part)
    information = metadata["rosbag2_bagfile_information"]
    information["relative_file_paths"] = names
    information["files"] = [
        # Stale, as a recorder that died leaves them.
        {"path": name, "starting_time": {"nanoseconds_since_epoch": T0}, "message_count": 360}
        for name in names
    ]
    for topic in information["topics_with_message_count"]:
        topic["message_count"] *= 3
    write_metadata(path, metadata)
    return path, {name: sorted(rows) for name, rows in expected.items()}


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_every_form_gives_the_messages_of_rosbags(tmp_path, form):
    """Each storage and each compression gives the bytes and times that rosbags gives."""
    path = write_bag(tmp_path / "bag", form, count=100)
    assert messages(path) == (rosbags_messages(path), [])


@pytest.mark.parametrize("form", [FORMS[0], FORMS[1], FORMS[5]], ids=str)
@pytest.mark.parametrize("overlap", [0, 200])
def test_parts_are_one_log_in_time(tmp_path, form, overlap):
    """A split bag is one log, whatever the order of its parts and whether they overlap."""
    path, expected = split_bag(tmp_path / "bag", form, 5_000_000, overlap, order=(2, 0, 1))
    assert messages(path) == (expected, [])


@pytest.mark.parametrize("overlap", [0, 280])
def test_no_block_is_far_ahead(tmp_path, monkeypatch, overlap):
    """Whatever the order of the parts, and if they overlap: time order needs little memory."""
    monkeypatch.setattr("quatprop.readers.containers.db3.FETCHES", 1)
    path, _ = split_bag(tmp_path / "bag", overlap=overlap, order=(2, 0, 1))
    with Rosbag2Log(path) as log:
        (imu, _) = log.channels()
        blocks = list(log.blocks(imu))
    assert max(int(block.log_ns.max()) - block.watermark_ns for block in blocks) < 256 * 1_000_000
    for before, block in itertools.pairwise(blocks):
        assert before.watermark_ns <= block.log_ns.min()


@pytest.mark.parametrize("overlap", [0, 280])
def test_few_parts_stay_open_and_more_are_opened_again(tmp_path, monkeypatch, overlap):
    """A part is opened once, and however many stay open the messages are the same."""
    path, expected = split_bag(tmp_path / "bag", overlap=overlap)
    parts = sorted(part.name for part in path.glob("*.db3"))
    for count in (len(parts), 1):
        opened = []
        monkeypatch.setattr("quatprop.readers.containers.rosbag2.MAX_OPEN", count)
        found = messages(
            path, lambda part, opened=opened: opened.append(part.name) or FileSource(part)
        )
        assert found == (expected, [])
        assert (sorted(opened) == parts) == (count == len(parts))


def test_parts_are_found_by_their_names(tmp_path):
    """Without metadata, the numbered files of one bag are its parts; with those of before, too."""
    path, expected = split_bag(tmp_path / "bag")
    for part in path.glob("*.db3"):
        part.rename(path / part.name.replace("bag", "drive"))
    reason = "the parts that it names are not in the folder; they are found by their names"
    assert messages(path) == (expected, [Loss("metadata.yaml", reason)])
    (path / "metadata.yaml").unlink()
    (path / "notes.txt").write_text("calibrated today")
    assert messages(path) == (expected, [])


def test_parts_are_counted_as_numbers(tmp_path):
    """Part 10 comes after part 2."""
    path = tmp_path / "bag"
    path.mkdir()
    for number in (10, 2):
        part = write_bag(tmp_path / f"p{number}", first=number, count=1)
        (part / f"p{number}.db3").rename(path / f"bag_{number}.db3")
    with Rosbag2Log(path) as log:
        assert [part.path.name for part in log._parts] == ["bag_2.db3", "bag_10.db3"]  # noqa: SLF001  # the order shows nowhere else
        assert log.losses == [Loss("parts between 2 and 10", "they are not in the folder")]


def test_folders_that_are_not_one_bag_are_refused(tmp_path):
    """The refusal lists several bags, and what a bag needs."""
    with pytest.raises(UnreadableLogError, match="no such folder; name a ROS 2 bag folder"):
        Rosbag2Log(tmp_path / "missing")
    reason = r"the folder holds no part of a ROS 2 bag \(\.mcap, \.db3\); name a log file"
    with pytest.raises(UnsupportedLogError, match=reason):
        Rosbag2Log(tmp_path)
    for name in ("drive.mcap", "other.db3"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(UnsupportedLogError) as caught:
        Rosbag2Log(tmp_path)
    assert str(caught.value) == (
        f"{tmp_path}: the folder has no usable metadata.yaml and holds several bags: "
        "'drive.mcap', 'other.db3'; name one file"
    )


def test_a_missing_part_is_a_loss(tmp_path):
    """It is named, with the messages that the metadata count in it; none at all is refused."""
    path, expected = split_bag(tmp_path / "bag")
    (path / "bag_1.db3").unlink()
    found, losses = messages(path)
    assert losses == [Loss("part 'bag_1.db3'", "it is not in the folder", 360)]
    assert found[IMU] == expected[IMU][:300] + expected[IMU][600:]
    for number in (0, 2):
        (path / f"bag_{number}.db3").unlink()
    reason = r"bag: none of its parts can be read; part 'bag_0\.db3': it is not in the folder"
    with pytest.raises(DamagedLogError, match=reason):
        Rosbag2Log(path)


@pytest.mark.parametrize(
    ("told", "instead"),
    [
        (r"message_count: \d+", "message_count: 0"),
        (r"message_count: \d+", "message_count: many"),
        ("topic_metadata", "metadata"),
    ],
)
def test_metadata_that_count_no_messages_are_not_believed(tmp_path, told, instead):
    """A recorder that died has not counted its messages; those of a database are there."""
    path = write_bag(tmp_path / "bag")
    expected, metadata = rosbags_messages(path), path / "metadata.yaml"
    metadata.write_text(re.sub(told, instead, metadata.read_text()))
    assert messages(path) == (expected, [])
    with Rosbag2Log(path) as log:
        assert {channel.count for channel in log.channels()} == {None}


def test_a_part_that_the_metadata_do_not_name_is_a_loss(tmp_path):
    """A further part is not read, with a remark."""
    path = write_bag(tmp_path / "bag")
    shutil.copy(path / "bag.db3", path / "other.db3")
    reason = "metadata.yaml does not name it and it is not read; name it by itself to read it"
    assert messages(path) == (rosbags_messages(path), [Loss("part 'other.db3'", reason)])


def test_a_part_packed_or_unpacked_by_hand_is_the_part(tmp_path):
    """A part next to its packed form is read once, and is no further part."""
    path = write_bag(tmp_path / "bag", (MCAP, CompressionMode.FILE))
    expected = rosbags_messages(path)
    packed, told = path / "bag.mcap.zstd", path / "metadata.yaml"
    as_written = told.read_text()
    told.write_text(as_written.replace(packed.name, "bag.mcap"))
    assert messages(path) == (expected, [])
    told.write_text(as_written)
    with packed.open("rb") as source, (path / "bag.mcap").open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(source, target)
    assert messages(path) == (expected, [])
    packed.unlink()
    assert messages(path) == (expected, [])
    (path / "metadata.yaml").unlink()
    assert messages(path) == (expected, [])


@pytest.mark.parametrize("relative", ["../secret.db3", "/etc/secret.db3", "sub/../../secret.db3"])
def test_nothing_outside_the_folder_is_read(tmp_path, relative):
    """A path that leaves the folder is looked for in the folder only."""
    path = write_bag(tmp_path / "bag", count=20)
    shutil.copy(path / "bag.db3", tmp_path / "secret.db3")
    expected = rosbags_messages(path)
    metadata = metadata_of(path)
    metadata["rosbag2_bagfile_information"]["relative_file_paths"].append(relative)
    write_metadata(path, metadata)
    assert messages(path) == (expected, [Loss(f"part '{relative}'", "it is not in the folder")])


@pytest.mark.parametrize(
    "content",
    [
        "",
        "just words",
        "rosbag2_bagfile_information: 3",
        "rosbag2_bagfile_information: {version: 9}",
        "rosbag2_bagfile_information: {relative_file_paths: []}",
        "rosbag2_bagfile_information: {relative_file_paths: 7}",
        "a: [1, 2\nb: {",
        "rosbag2_bagfile_information: !!python/object/apply:os.system ['touch owned']",
        "rosbag2_bagfile_information: !!python/name:os.system",
        "\x00\x01",
        "[" * 5000,
    ],
)
def test_damaged_metadata_are_a_loss_and_nothing_runs(tmp_path, monkeypatch, content):
    """Metadata that say nothing of use are done without; what they ask to run does not run."""
    path = write_bag(tmp_path / "bag", count=20)
    expected = rosbags_messages(path)
    (path / "metadata.yaml").write_text(content)
    monkeypatch.chdir(tmp_path)
    reason = "it is damaged; the parts are found by their names"
    assert messages(path) == (expected, [Loss("metadata.yaml", reason)])
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize("names", [["bag.db3"], ["bag.db3", "bag/bag.db3"]])
def test_metadata_may_lack_keys(tmp_path, names):
    """Only the names of the parts are needed; a part that is named twice is read once."""
    path = write_bag(tmp_path / "bag")
    expected = rosbags_messages(path)
    write_metadata(path, {"rosbag2_bagfile_information": {"relative_file_paths": names}})
    assert messages(path) == (expected, [])
    with Rosbag2Log(path) as log:
        assert [channel.count for channel in log.channels()] == [None, None]


def test_a_definition_may_be_in_one_part_only(tmp_path):
    """A part without the definition of a type takes that of another part."""
    path, expected = split_bag(tmp_path / "bag")
    for number in (0, 2):
        with closing(sqlite3.connect(path / f"bag_{number}.db3")) as database, database:
            database.execute("DELETE FROM message_definitions")
    with Rosbag2Log(path) as log:
        imu, _ = log.channels()
        assert (imu.topic, imu.count, imu.schema_encoding) == ("/imu", 900, "ros2msg")
    assert messages(path) == (expected, [])


def test_a_part_without_messages_of_a_topic_does_not_hide_its_times(tmp_path):
    """Of a range of time, only its messages are read if every part knows its times."""
    for number, events in enumerate([[(0, 5, b"a"), (0, 9, b"b")], [(1, 20, b"c")]]):
        saved(tmp_path, build([("/a", HEADERS), ("/b", HEADERS)], events), f"bag_{number}.mcap")
    with Rosbag2Log(tmp_path) as log:
        spans = [log.recorded_span(channel) for channel in log.channels()]
    assert spans == [TimeRange(5, 9), TimeRange(20, 20)]


def test_messages_of_two_definitions_are_not_missed_in_each(tmp_path):
    """The metadata count the messages of a topic, whatever their definitions."""
    path, _ = split_bag(tmp_path / "bag")
    with closing(sqlite3.connect(path / "bag_1.db3")) as database, database:
        database.execute("UPDATE message_definitions SET encoded_message_definition = '# another'")
    log = Rosbag2Log(path)
    assert [channel.topic for channel in log.channels()] == ["/imu", "/imu", "/text", "/text"]
    assert messages_of(log)[1] == []


def test_a_damaged_part_loses_only_itself(tmp_path):
    """A part that cannot be opened is named with the reason; the others are read."""
    path, expected = split_bag(tmp_path / "bag", FORMS[3])
    (path / "bag_1.mcap").write_bytes(b"")
    found, losses = messages(path)
    assert found[IMU] == expected[IMU][:300] + expected[IMU][600:]
    assert {(loss.place, loss.messages) for loss in losses} == {
        ("bag_1.mcap: the whole part", None),
        ("metadata.yaml", 300),
        ("metadata.yaml", len(expected[TEXT]) - len(found[TEXT])),
    }
    assert losses[1].reason == "it counts 300 messages of topic '/imu' more than there are"


def test_a_packed_part_that_is_cut_gives_what_comes_before(tmp_path):
    """A packed part that ends early is read up to the cut, and the cut is a loss."""
    path = write_bag(tmp_path / "bag", (MCAP, CompressionMode.FILE), count=3000)
    expected, part = rosbags_messages(path)[IMU], path / "bag.mcap.zstd"
    part.write_bytes(part.read_bytes()[: part.stat().st_size * 2 // 3])
    found, losses = messages(path)
    assert len(expected) // 4 < len(found[IMU]) < len(expected)
    assert found[IMU] == expected[: len(found[IMU])]
    reason = "its zstd data is damaged or cut off"
    assert losses[0] == Loss("bag.mcap.zstd: end of the file", reason)


def test_a_part_that_is_gone_when_it_is_opened_again_loses_only_itself(tmp_path, monkeypatch):
    """Few parts stay open."""
    monkeypatch.setattr("quatprop.readers.containers.rosbag2.MAX_OPEN", 2)
    path, expected = split_bag(tmp_path / "bag")
    with Rosbag2Log(path) as log:
        (path / "bag_2.db3").unlink()
        found, losses = messages_of(log)
    assert found[IMU] == expected[IMU][:600]
    assert losses[0].place == "bag_2.db3: the whole part"


def test_other_message_compressions_are_refused(tmp_path):
    """A compression of messages that is not zstd is refused by name."""
    path = write_bag(tmp_path / "bag", count=20)
    metadata = metadata_of(path)
    metadata["rosbag2_bagfile_information"] |= {
        "compression_mode": "MESSAGE",
        "compression_format": "lz4",
    }
    write_metadata(path, metadata)
    with pytest.raises(UnsupportedLogError, match=r"bag: its messages are compressed with 'lz4'"):
        Rosbag2Log(path)


def test_copies_are_removed(tmp_path, monkeypatch):
    """The unpacked copies of packed parts are gone when the log is closed."""
    path, _ = split_bag(tmp_path / "bag", FORMS[1])
    copies = tmp_path / "copies"
    copies.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(copies))
    with Rosbag2Log(path) as log:
        assert len(list(copies.iterdir())) == 3
        assert sum(len(block) for block in log.blocks(log.channels()[0])) == 900
    assert list(copies.iterdir()) == []
    opened = []

    def interrupted(part):
        opened.append(part)
        if len(opened) == 3:
            raise KeyboardInterrupt
        return FileSource(part)

    (path / "bag_0.db3.zstd").write_bytes(zstandard.compress(b"no bag"))
    with pytest.raises(KeyboardInterrupt):
        Rosbag2Log(path, interrupted)
    assert list(copies.iterdir()) == []
    with Rosbag2Log(path):
        assert len(list(copies.iterdir())) == 2


def test_large_metadata_that_are_written_otherwise_are_read(tmp_path):
    """As a list in brackets, which any writer of YAML may choose."""
    for number in range(2):
        write_mcap(tmp_path / f"bag_{number}.mcap")
    names = "relative_file_paths: [bag_1.mcap, bag_0.mcap]"
    comment = "#" * (1 << 18)
    text = f"{comment}\nrosbag2_bagfile_information:\n  {names}\n"
    (tmp_path / "metadata.yaml").write_text(text)
    assert [part.name for part in folder(tmp_path).parts] == ["bag_1.mcap", "bag_0.mcap"]


@pytest.mark.parametrize("quote", ["", '"'])
def test_large_metadata_take_no_time(tmp_path, quote):
    """Of a bag with thousands of parts and profiles, the parts that the metadata name are read."""
    write_mcap(tmp_path / "bag_1.mcap")
    write_mcap(tmp_path / "bag_0.mcap")
    write_mcap(tmp_path / "bag_2.mcap")
    profiles = "".join(f"        - depth: {k}\n          name: {'x' * 50}\n" for k in range(30_000))
    (tmp_path / "metadata.yaml").write_text(
        'rosbag2_bagfile_information:\n  version: 5\n  compression_format: ""\n'
        f'  compression_mode: ""\n  relative_file_paths:\n    - {quote}bag_1.mcap{quote}\n'
        f"    - {quote}bag_0.mcap{quote}\n  topics_with_message_count:\n"
        f"    - topic_metadata:\n        name: /imu\n        profiles:\n{profiles}"
    )  # fmt: skip
    begin = time.process_time()
    found = folder(tmp_path)
    assert time.process_time() - begin < 1
    assert [part.name for part in found.parts] == ["bag_1.mcap", "bag_0.mcap"]
    assert [loss.place for loss in found.losses] == ["part 'bag_2.mcap'"]
