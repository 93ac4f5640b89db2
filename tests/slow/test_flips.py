"""Flipped bits of the structure of logs: noticed or harmless; `make fuzz` flips every one."""

import re

import pytest
from fuzz.flips import FORMATS, TABLE, Format, problems, sample, unnoticed_table
from make.documents import GUIDES

SAMPLE = 40
"""Flips of each format, beside one of each thing that a byte can be."""


@pytest.mark.parametrize("name", FORMATS)
def test_a_flipped_bit_of_the_structure_is_noticed_or_harmless(tmp_path, name):
    """No flip gives wrong samples, or loses one without a word or with a wrong count."""
    form = Format.named(name)
    judged = list(form.judged(sample(name, SAMPLE), tmp_path))
    assert {flip.name for flip in judged} == {flip.name for flip in form.flips()}
    assert problems(judged, form.unnoticed()) == []


def test_what_formats_cannot_notice_is_what_formats_md_shows():
    """`make documents` writes the table."""
    assert re.search(TABLE, (GUIDES / "formats.md").read_text())[0] == unnoticed_table()
