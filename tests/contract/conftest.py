"""Fixtures of the tests of all formats: a log of each of them."""

import pytest
from make.formats import write_all


@pytest.fixture(scope="session")
def logs(tmp_path_factory):
    """Return a folder with a log of every format, each with the same samples."""
    folder = tmp_path_factory.mktemp("formats")
    write_all(folder)
    return folder
