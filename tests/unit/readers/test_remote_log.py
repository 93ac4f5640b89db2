"""Logs in stores that are replaced while they are read, and bags that are copied as a whole."""

import shutil

import pytest
from make.commands import run
from make.places import SAMPLE_LOGS

from quatprop.base.errors import ReplacedError, UsageError
from quatprop.readers.open_log import open_log, open_logs


@pytest.mark.parametrize(("is_replaced", "error"), [(True, ReplacedError), (False, UsageError)])
def test_an_error_of_a_log_that_was_replaced_says_so(tmp_path, is_replaced, error):
    """Other errors may be its consequence; otherwise they are reported."""
    path = shutil.copy(SAMPLE_LOGS / "tumbling.bag", tmp_path / "log.bag")

    def read():
        with open_log(path.as_uri()):
            if is_replaced:
                path.write_bytes(path.read_bytes() + b"more")
            raise UsageError("something else")

    with pytest.raises(error):
        read()


def test_the_parts_of_a_bag_are_read_where_they_are(tmp_path):
    """Of MCAP parts, only the names are in the copy of the folder."""
    bag = tmp_path / "bag"
    run("simulate", bag, "--to", "rosbag2-mcap", "--duration", "2s", code=0)
    with open_logs([bag.as_uri()]) as log:
        (part,) = log.path.glob("*.mcap")
        assert part.stat().st_size == 0
        assert len(log.channels()) == 1
