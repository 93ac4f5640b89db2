"""Where the command line takes a file, the library takes what a program has, too."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.writers.formats import WRITERS

MS = 1_000_000
LOG = quatprop.read_rates("sample_logs/tumbling.bag")
FRAMES = LOG.t_ns[0] + np.arange(1, 20) * 33 * MS
"""When a camera took pictures."""


def at_frames(folder, at):
    """Return attitudes at times that are in a file, and at times in memory."""
    file = AttitudeSeries(FRAMES, np.tile([1.0, 0, 0, 0], (len(FRAMES), 1)))
    quatprop.write(file, folder / "frames.csv")
    return [
        quatprop.propagate(LOG, at=where, method="coning") for where in (folder / "frames.csv", at)
    ]


@pytest.mark.parametrize(
    "at",
    [FRAMES, FRAMES[::-1].tolist(), pd.Series(FRAMES), pd.to_datetime(FRAMES),
     GyroSeries(FRAMES, np.zeros((len(FRAMES), 3)))],
)  # fmt: skip
def test_attitudes_at_the_frames_of_a_camera(tmp_path, at):
    """They needed a file of attitudes that nobody had."""
    by_file, found = at_frames(tmp_path, at)
    assert len(found) == len(FRAMES)
    assert AttitudeSeries(found.t_ns, found.wxyz) == AttitudeSeries(by_file.t_ns, by_file.wxyz)
    assert found.report.settings["at"] == "in memory"


def test_the_first_attitude_is_a_rotation_or_that_of_a_series(tmp_path):
    """As of a file of the same attitudes, between whose stamps it lies."""
    turns = Rotation.from_rotvec([[0.3, 0.1, 0], [0.5, -0.2, 1]])
    series = AttitudeSeries(LOG.t_ns[0] + np.array([-MS, 2 * MS]), turns.as_quat(scalar_first=True))
    quatprop.write(series, tmp_path / "q0.csv")
    by_file = quatprop.propagate(LOG, q0=tmp_path / "q0.csv")
    found = quatprop.propagate(LOG, q0=series)
    np.testing.assert_array_equal(found.wxyz, by_file.wxyz)
    assert found.report.convention.q0_from == "in memory"
    numbers = quatprop.propagate(LOG, q0=turns[1].as_quat(scalar_first=True))
    np.testing.assert_allclose(quatprop.propagate(LOG, q0=turns[1]).wxyz, numbers.wxyz, atol=1e-15)


def test_the_bias_is_a_series():
    """Interpolated in time, as of a file; a constant one is three numbers."""
    ends = LOG.t_ns[[0, -1]]
    constant = GyroSeries(ends, [[0.01, 0, -0.02]] * 2)
    by_numbers = quatprop.propagate(LOG, bias=(0.01, 0, -0.02))
    found = quatprop.propagate(LOG, bias=constant)
    np.testing.assert_allclose(found.wxyz, by_numbers.wxyz, atol=1e-13)
    growing = GyroSeries(ends, [[0, 0, 0], [0.01, 0, -0.02]])
    fraction = (LOG.t_ns - ends[0]) / (ends[1] - ends[0])
    less = GyroSeries(LOG.t_ns, LOG.rate - fraction[:, None] * growing.rate[1])
    expected = quatprop.propagate(less)
    np.testing.assert_allclose(
        quatprop.propagate(LOG, bias=growing).wxyz, expected.wxyz, atol=1e-13
    )


@pytest.mark.parametrize(
    ("unit", "given"),
    [
        ("float seconds", lambda t_ns: (t_ns - t_ns[0]) / 1e9),
        ("a column of seconds", lambda t_ns: pd.Series((t_ns - t_ns[0]) / 1e9, index=t_ns[::-1])),
        ("integer ns", lambda t_ns: t_ns.tolist()),
        ("dates", pd.to_datetime),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_bare_arrays_are_propagated_as_the_series_of_them(unit, given):
    """Rates needed a class to be wrapped in before they could be propagated."""
    del unit
    found = quatprop.propagate(given(LOG.t_ns), LOG.rate.tolist(), method="coning", every=7)
    expected = quatprop.propagate(LOG, method="coning", every=7)
    np.testing.assert_allclose(found.wxyz, expected.wxyz, atol=1e-12)


@pytest.mark.parametrize("kind", [kind for kind, form in WRITERS.items() if form.keeps_provenance])
def test_the_metadata_of_an_output_are_read_back(tmp_path, kind):
    """They needed a library of each format."""
    out = tmp_path / f"out{WRITERS[kind].suffixes[0] if WRITERS[kind].suffixes else ''}"
    series = quatprop.propagate(LOG, method="coning", q0=(0, 1, 0, 0))
    quatprop.write(series, out, to=kind)
    made = quatprop.read_metadata(out)
    assert made["convention"]["method"] == "coning"
    assert made["convention"]["q0_wxyz"] == [0, 1, 0, 0]
    assert made["counts"]["samples_used"] == len(LOG)


def test_a_file_without_metadata_says_where_they_are_kept(tmp_path):
    """Not an empty dictionary, nor one of another program."""
    quatprop.write(AttitudeSeries([0], [[1, 0, 0, 0]]), tmp_path / "out.csv")
    with pytest.raises(quatprop.QuatpropError, match=r"out\.csv: it does not say how it was made"):
        quatprop.read_metadata(tmp_path / "out.csv")
