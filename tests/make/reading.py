"""Reading logs through the package, whole and in one call."""

from types import SimpleNamespace

import numpy as np

from quatprop.kinematics.series import GyroSeries
from quatprop.readers.attitude_signals import choose_attitudes
from quatprop.readers.containers.topic_table import TopicTable
from quatprop.readers.matching import find, marks_of
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.row_stamps import stamps_of
from quatprop.settings.reading import AttitudeSelection, RateSelection

LOG = SimpleNamespace(path="log", kind="mcap", has_publish_time=False)


def rates(path, **options):
    """Return the source of the rates that the options choose, its samples, and what was lost."""
    with open_log(path) as log:
        source = choose_rates(log, RateSelection(**options))
        return source, GyroSeries.joined(list(source.batches())), log.losses


def attitudes(path, **options):
    """Return the source of the attitudes that the options choose, stamps, quaternions, losses."""
    with open_log(path) as log:
        source = choose_attitudes(log, AttitudeSelection(**options))
        t_ns, wxyz = zip(*source.rows(), strict=True)
        return source, np.concatenate(t_ns), np.concatenate(wxyz), log.losses


def found_in(channel, quantity="rate", field=None):
    """Return what the messages of a channel have of a quantity, without a log."""
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
