"""Numbers and pictures in the documents are those that the package gives."""

import re

import pytest
from make.documents import GUIDES
from make.measured import METHOD_TABLE, method_table
from make.pictures import PICTURES, numbers_in, numbers_of


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_show_what_is_measured(name):
    """Each keeps its numbers; `make documents` draws it again where they are others."""
    assert numbers_in(GUIDES / name) == _about(numbers_of(name)[1])


def _about(value):
    """Return numbers that may differ in the last of three digits."""
    if isinstance(value, dict):
        return {key: _about(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_about(item) for item in value]
    return value if isinstance(value, str) else pytest.approx(value, rel=0.02)


def test_pictures_of_documents_are_small():
    """They are in the wheel."""
    assert max((GUIDES / name).stat().st_size for name in PICTURES) < 100_000


def test_the_table_of_methods_shows_their_errors():
    """`make documents` writes it."""
    assert re.search(METHOD_TABLE, (GUIDES / "conventions.md").read_text())[0] == method_table()
