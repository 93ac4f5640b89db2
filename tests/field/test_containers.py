"""Real recordings, message for message against other people's readers."""

import tarfile

import pytest
from make.bag_doctor import unclosed
from make.container_messages import messages_of, rosbags_messages
from make.mcap import read, saved, truth

from quatprop.base.errors import QuatpropError
from quatprop.readers.containers.db3 import Db3Log
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.containers.rosbag1 import Rosbag1Log
from quatprop.readers.containers.rosbag2 import Rosbag2Log

AUK = [
    "auk/auk_mcap_zstd", "auk/auk_mcap_zstdfile", "auk/auk_sqlite3",
    "auk/auk_sqlite3_zstdfile", "auk/auk_sqlite3_zstdmsg",
]  # fmt: skip
RECORDINGS = {
    "auk/auk.bag": Rosbag1Log,
    "auk/auk_bz2.bag": Rosbag1Log,
    "auk/auk_lz4.bag": Rosbag1Log,
    "husky/test1_husky.bag": Rosbag1Log,
    "irregular/tilt_laser.bag": Rosbag1Log,
    "two_imus/test1_2014_xsens.bag": Rosbag1Log,
    "broken/cruise_example-unsorted-chunks.bag": Rosbag1Log,
    "broken/foxglove_example.bag": Rosbag1Log,
    "broken/foxglove_example-bz2.bag": Rosbag1Log,
    "broken/foxglove_example-lz4.bag": Rosbag1Log,
    "broken/foxglove_no-messages.bag": Rosbag1Log,
    "rosbag2/klintan_sample.db3": Db3Log,
    "rosbag2/plotjuggler_rosbag2_test/rosbag2_test_0.db3": Db3Log,
    **dict.fromkeys(AUK, Rosbag2Log),
    "nested_imu/kiran_11sec_motion": Rosbag2Log,
    "rosbag2/geocam_all_types": Rosbag2Log,
    # Whose metadata name the folder with the part, and whose database has no definitions.
    "rosbag2/plotjuggler_rosbag2_test": Rosbag2Log,
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_every_message_is_as_rosbags_reads_it(shared_logs, name):
    """Bytes and times of every topic, and no loss."""
    path = shared_logs / name
    assert messages_of(RECORDINGS[name](path)) == (rosbags_messages(path), [])


@pytest.mark.parametrize("name", ["auk/auk_lz4.bag", "irregular/tilt_laser.bag",
                                  "broken/cruise_example-unsorted-chunks.bag"])  # fmt: skip
def test_a_bag_whose_index_was_never_written_has_every_message(shared_logs, tmp_path, name):
    """It is rebuilt from the chunks."""
    path = saved(tmp_path, unclosed((shared_logs / name).read_bytes()), "log.bag.active")
    expected = {name: rows for name, rows in rosbags_messages(shared_logs / name).items() if rows}
    assert messages_of(Rosbag1Log(path)) == (expected, [])


def test_all_forms_of_one_recording_are_the_same(shared_logs):
    """A recording has the same channels however it is stored and packed."""
    every = []
    for name in AUK:
        with Rosbag2Log(shared_logs / name) as log:
            every.append(log.channels())
    assert all(channels == every[0] for channels in every)


@pytest.fixture(scope="session")
def conformance(shared_logs, tmp_path_factory):
    """Return the files of the MCAP conformance suite."""
    folder = tmp_path_factory.mktemp("conformance")
    with tarfile.open(shared_logs / "mcap_conformance.tar.gz") as archive:
        archive.extractall(folder, filter="data")
    return sorted(folder.rglob("*.mcap"))


@pytest.mark.parametrize("cut", [0, 30, 150])
def test_the_conformance_suite_is_read_as_the_library_does(conformance, tmp_path, cut):
    """Every combination of features; without its end, a file gives what it holds or a sentence."""
    assert len(conformance) == 502
    for path in conformance:
        content = path.read_bytes()
        expected = sorted(truth(content))
        cut_off = saved(tmp_path, content[: len(content) - cut])
        try:
            log = McapLog(cut_off)
        except QuatpropError:
            assert cut
            continue
        found = sorted(read(log))
        assert set(found) <= set(expected)
        assert cut > 30 or found == expected, path.name
        assert bool(log.losses) == bool(cut) or (cut and found == expected), path.name
