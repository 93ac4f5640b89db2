"""Suites of the sample logs."""

import pytest
from make.suites import with_logs


@pytest.fixture
def folder(tmp_path):
    """Give a folder with sample logs."""
    return with_logs(tmp_path)
