"""Suites of the sample logs."""

import shutil

import pytest
from make.places import SAMPLE_LOGS


@pytest.fixture
def folder(tmp_path):
    """Give a folder with sample logs."""
    (tmp_path / "logs").mkdir()
    for name in ("spin.csv", "spin.truth.csv", "coning.mcap", "coning.truth.csv", "rest.parquet"):
        shutil.copy(SAMPLE_LOGS / name, tmp_path / "logs")
    return tmp_path
