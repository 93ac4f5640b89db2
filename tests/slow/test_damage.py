"""Damaged logs of every format give sentences, not tracebacks; `make fuzz` reads many more."""

import re
import struct
import time

import pytest
from fuzz.damage import fuzz
from fuzz.flips import FORMATS, TABLE, Format, problems, sample, unnoticed_table
from make.documents import GUIDES
from make.mcap import numbered, unclosed
from make.systems import on_posix

from quatprop.readers.open_log import open_log

KINDS = 54
LOGS = range(0, KINDS, 3)
"""A third of the kinds, in turn; `make fuzz` reads every one."""


@on_posix
def test_damaged_logs_are_read_or_refused_within_bounds():
    """No damage leads to a traceback, a hang, boundless memory, leavings or an odd exit code."""
    problems = {}
    fuzz(LOGS, 1, problems.__setitem__)
    assert sorted(problems) == list(LOGS)
    assert {seed: found.problem for seed, found in problems.items() if found.problem} == {}


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_ten_thousand_damaged_chunks_cost_little_time(tmp_path, kind):
    """Each is noted once, without a look through all that were noted before."""
    count = 10_000
    if kind == "mcap":
        chunk = struct.pack("<QQQII", 0, 1, 40, 7, 0) + struct.pack("<Q", 40) + bytes(40)
        content = unclosed(numbered()) + (struct.pack("<BQ", 6, len(chunk)) + chunk) * count
    else:
        fields = (b"op=\x05", b"compression=bz2", b"size=" + struct.pack("<I", 40))
        header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
        chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", 40) + bytes(40)
        begin = struct.pack("<I", 8) + struct.pack("<I", 4) + b"op=\x03" + struct.pack("<I", 0)
        content = b"#ROSBAG V2.0\n" + begin + chunk * count
    log = tmp_path / f"log.{kind}"
    log.write_bytes(content)
    began = time.process_time()
    with open_log(log) as opened:
        for channel in opened.channels():
            for _ in opened.blocks(channel):
                pass
        assert len(opened.losses) >= count - 1
    assert time.process_time() - began < 5


# Flipped bits of the structure of logs: noticed or harmless; `make fuzz` flips every one.

SAMPLE, THINGS = 40, 150
"""Flips of each format, and things that a byte can be of which one each is flipped as well."""


@pytest.mark.parametrize("name", FORMATS)
def test_a_flipped_bit_of_the_structure_is_noticed_or_harmless(tmp_path, name):
    """No flip gives wrong samples, or loses one without a word or with a wrong count."""
    form = Format.named(name)
    judged = list(form.judged(sample(name, SAMPLE, THINGS), tmp_path))
    assert problems(judged, form.unnoticed()) == []


def test_what_formats_cannot_notice_is_what_formats_md_shows():
    """`make documents` writes the table."""
    assert re.search(TABLE, (GUIDES / "formats.md").read_text())[0] == unnoticed_table()
