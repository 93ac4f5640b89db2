"""Suites of the sample logs."""

import pytest
from make.suites import with_logs


@pytest.fixture(autouse=True)
def without_causes(no_causes):
    """Judge cases without a look for the causes of their errors, where no test is about them."""


@pytest.fixture
def folder(tmp_path):
    """Give a folder with sample logs."""
    return with_logs(tmp_path)
