"""Topics without a log: what is found in the columns of a definition."""

from types import SimpleNamespace

from quatprop.containers.topic_table import TopicTable
from quatprop.logs.clocks.stamps import stamps_of
from quatprop.logs.matching.find import find, marks_of

LOG = SimpleNamespace(path="log", kind="mcap", has_publish_time=False)


def found_in(channel, quantity="rate", field=None):
    """Return what the messages of a channel have of a quantity."""
    return find(TopicTable(LOG, channel), quantity, field)


def names(found, group):
    """Return the names of some columns."""
    return [found.table.columns[k].text for k in group]


def mark(found):
    """Return the name of the column that marks a quantity as absent, or None."""
    return next(iter(names(found, marks_of(found))), None)


def stamps(found):
    """Return names and units of every stamp, the best first."""
    return [(names(found, stamp.columns), stamp.units) for stamp in stamps_of(found)]
