"""Formats that hold ns and float64: there and back is the same to the bit."""

from itertools import chain

import numpy as np
import pytest
from make.formats import NOT_READ
from make.reading import attitudes
from make.writing import write_series

from quatprop.base.errors import NotRotationsError
from quatprop.kinematics.conventions import layout_named
from quatprop.kinematics.series import AttitudeSeries
from quatprop.propagation.attitude_input import AttitudeInput
from quatprop.propagation.settings import OutputSettings
from quatprop.stores.kinds import READERS
from quatprop.tools.conversion import Conversion, convert
from quatprop.writers.formats import WRITERS

SUFFIX = {"rosbag2": "", "rosbag2-mcap": "", "euroc": ".euroc.csv"}
"""Endings of the kinds whose name is not their suffix; a file of EuRoC is a CSV."""

TIMED = [kind for kind in WRITERS if kind not in NOT_READ]
"""The kinds that are read with stamps and the numbers themselves."""

ROS = {kind for kind, known in WRITERS.items() if known.encodings}
PLACES = [[(kind, WRITERS[kind].layout or layout) for layout in ("scalar-first", "scalar-last")]
          for kind in TIMED]  # fmt: skip
"""Every format in the layouts it allows."""


def unit(random, count):
    """Return random unit quaternions, among them signs and zeros that are easily lost."""
    wxyz = random.normal(size=(count, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    wxyz[:4] = [[1, -0.0, 0, -0.0], [-0.0, 0, -1, 0], [0.5, -0.5, 0.5, -0.5], [1, 5e-324, 0, 0]]
    return wxyz


def series(kind, rows=200):
    """Return attitudes at awkward stamps; negative ones where the format has them: ROS has not."""
    random = np.random.default_rng(5)
    t_ns = 1_700_000_000_123_456_789 + np.cumsum(random.integers(0, 3, rows))
    t_ns[:3] = [0, 1, 999_999_999]
    if kind not in ROS:
        t_ns[:5] = [-(2**63) + 1, -1_000_000_000, -999_999_999, -1, 0]
    return AttitudeSeries(t_ns, unit(random, rows))


def written(folder, kind, layout, attitudes):
    """Write attitudes and return the file."""
    path = folder / f"attitude{SUFFIX.get(kind, '.' + kind)}"
    return write_series(path, attitudes, kind=kind, layout=layout)


def read(path):
    """Return stamps and wxyz of a file, and in which layout it has them."""
    source, t_ns, wxyz, losses = attitudes(path)
    assert losses == []
    return t_ns, wxyz, source.layout


@pytest.mark.parametrize("kind", TIMED)
def test_every_kind_that_is_written_can_be_read(tmp_path, kind):
    """In several blocks: the content tells the kind, the names the layout."""
    given = series(kind, 70_000)
    t_ns, wxyz, _ = read(written(tmp_path, kind, None, given))
    assert t_ns.tolist() == given.t_ns.tolist()
    assert wxyz.tobytes() == given.wxyz.tobytes()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (one[further // 2], PLACES[(i + further) % len(PLACES)][further % 2])
        for i, one in enumerate(PLACES)
        for further in range(4)
    ],
)
def test_converted_to_another_format_it_is_the_same_to_the_bit(tmp_path, first, second):
    """Stamps and numbers survive from each format and to each, in the four pairs of layouts."""
    (kind, layout), (other, other_layout) = first, second
    given = series(other if other in ROS else kind)
    source = written(tmp_path, kind, layout, given)
    assert read(source)[2] == layout_named(layout).name
    target = tmp_path / f"converted{SUFFIX.get(other, '.' + other)}"
    output = OutputSettings(str(target), to=other, layout=other_layout)
    convert(Conversion(AttitudeInput(str(source)), output))
    t_ns, wxyz, found = read(target)
    assert t_ns.tobytes() == given.t_ns.tobytes()
    assert wxyz.tobytes() == given.wxyz.tobytes()
    assert found == layout_named(other_layout).name


class Unsound:
    """Invalid quaternions: zero, NaN, and a wrong length; writers treat them alike."""

    t_ns = np.arange(5) * 1_000_000_000
    wxyz = np.array([[1, 0, 0, 0], [0] * 4, [np.nan, 0, 0, 1], [0.6, 0.8, 0, 0], [0, 0, 1.01, 0]])
    position = covariance = rate = None

    def __len__(self):
        return len(self.t_ns)


@pytest.mark.parametrize(("kind", "layout"), sorted(set(chain(*PLACES))))
def test_what_is_no_rotation_is_located_in_every_format(tmp_path, kind, layout):
    """Zero, NaN and a length beyond the tolerance: counted by kind, the first with its stamp."""
    path = written(tmp_path, kind, layout, Unsound())
    target = tmp_path / "converted.parquet"
    output = OutputSettings(str(target))
    sentence = (
        r"3 of 5 rows are invalid quaternions \(1 all zero, 1 off unit length by up to 0.01, 1 "
        r"absent or not finite\), the first is row 1 at 1000000000 ns; normalize scales "
        r"quaternions of "
        r"another length, on_invalid='drop' omits them"
    )
    with pytest.raises(NotRotationsError, match=sentence):
        convert(Conversion(AttitudeInput(str(path)), output))
    assert not target.exists()
    counts = convert(Conversion(AttitudeInput(str(path), drop=True), output)).counts
    assert (counts.samples_read, counts.samples_used) == (5, 2)
    assert (counts.zero, counts.not_unit, counts.not_finite) == (1, 1, 1)
    assert (counts.first, counts.first_ns) == (1, 1_000_000_000)
    scaled = AttitudeInput(str(path), drop=True, normalize=True)
    report = convert(Conversion(scaled, output))
    assert report.counts.normalized == 1
    assert read(target)[0].tolist() == [0, 3_000_000_000, 4_000_000_000]


def test_every_kind_takes_part():
    """Each reader of attitudes reads what a writer wrote, but for logs nobody writes."""
    read_kinds = set(READERS) - {"ulog", "db3", "hdf5", "matlab"}
    assert read_kinds - set(WRITERS) == set()
    assert set(WRITERS) - read_kinds == {"tsv", "euroc", "sto", "rosbag2-mcap"}
