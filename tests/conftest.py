"""What the tests share: where the real recordings are."""

import os
from pathlib import Path

import pytest

SHARED_LOGS = Path(
    os.environ.get("QUATPROP_SHARED_LOGS", Path(__file__).parents[2] / "shared" / "logs")
)


@pytest.fixture(scope="session")
def shared_logs() -> Path:
    """Return the folder of real recordings, or skip the test where it is absent."""
    if not SHARED_LOGS.is_dir():
        pytest.skip(f"no real recordings at {SHARED_LOGS}; set QUATPROP_SHARED_LOGS")
    return SHARED_LOGS
