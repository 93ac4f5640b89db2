"""What the tests of stores share: a place for temporary files."""

import tempfile

import pytest


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Let temporary files go to a folder of the test, where none may stay."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []
