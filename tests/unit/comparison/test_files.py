"""Series of files, compared while they are read: the result is that of series in memory."""

from itertools import count

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from quatprop.base.errors import ComparisonError, NotRotationsError
from quatprop.comparison import file_comparison
from quatprop.comparison.comparison import compare
from quatprop.propagation.attitude_input import AttitudeInput, load_attitudes
from quatprop.settings.command_options import comparison_settings

BATCH = 16
"""Rows of a batch in these tests."""


@pytest.fixture(autouse=True)
def in_small_batches(monkeypatch):
    """Stream however short the series are, in many batches."""
    monkeypatch.setattr(file_comparison, "SHORT", 0)
    monkeypatch.setattr("quatprop.readers.tables.arrow.BATCH_ROWS", BATCH)


@pytest.fixture
def streams(monkeypatch):
    """Fail where the series are compared in memory."""

    def refuse(*_anything):
        raise AssertionError("compared in memory")

    monkeypatch.setattr(file_comparison, "compare", refuse)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return what writes a series to a file of its own."""
    folder, numbers = tmp_path_factory.mktemp("series"), count()

    def write(t_ns, seed=0, length=1.0, turn=Rotation.identity()):  # noqa: B008  # immutable
        steps = np.random.default_rng(seed).normal(scale=0.05, size=(len(t_ns), 3))
        rotations = turn * Rotation.from_rotvec(np.cumsum(steps, axis=0))
        wxyz = length * rotations.as_quat(scalar_first=True)
        path = folder / f"{next(numbers)}.parquet"
        names = ("t_ns", "qw", "qx", "qy", "qz")
        pq.write_table(pa.table(dict(zip(names, (np.int64(t_ns), *wxyz.T), strict=True))), path)
        return AttitudeInput(str(path))

    return write


def outcome(work):
    """Return the report of a comparison, or the sentence that refuses it."""
    try:
        return work().report()
    except ComparisonError as error:
        return str(error)


def both(a, b, **options):
    """Return what comes of files, and of the same series in memory."""
    wanted = comparison_settings(**options)
    return tuple(
        outcome(work)
        for work in (
            lambda: file_comparison.compare_files(a, b, wanted, keep=False)[2],
            lambda: compare(load_attitudes(a).series, load_attitudes(b).series, wanted),
        )
    )


STAMPS = np.arange(0, 2_500_000_000, 10_000_000)

CASES = {
    "equal timestamps": (STAMPS, STAMPS, {}),
    "another seed's motion, aligned": (STAMPS, STAMPS, {"align": "first"}),
    "every other stamp": (STAMPS, STAMPS[::2], {}),
    "a later beginning": (STAMPS, STAMPS[101:], {"min_coverage": 90}),
    "an earlier end, and gaps": (np.delete(STAMPS, slice(60, 90)), STAMPS[:166], {}),
    "another clock": (STAMPS, STAMPS - 7_000_000, {"time_offset": "7ms", "tol": "0.1rad"}),
    "a known rule": (STAMPS, STAMPS[::3], {"match": "exact"}),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.usefixtures("streams")
def test_streamed_results_equal_those_in_memory(case, written):
    """Every figure is the same to the bit: errors, drift, worst sample, coverage, cause."""
    t_a, t_b, options = CASES[case]
    streamed, in_memory = both(written(t_a), written(t_b, seed=1), **options)
    assert streamed["matching"]["match"] == "exact"
    assert streamed == in_memory


@pytest.mark.parametrize(
    ("t_a", "t_b", "options"),
    [
        (STAMPS, STAMPS + 3_000_000, {}),
        (STAMPS[::-1], STAMPS, {}),
        (STAMPS, np.insert(STAMPS, 40, STAMPS[40]), {}),
        (STAMPS, STAMPS, {"window": "1s"}),
        (STAMPS, STAMPS, {"align": "mean"}),
        (STAMPS, STAMPS, {"match": "nearest"}),
        (STAMPS, STAMPS + 10**12, {"match": "exact"}),
        (STAMPS, STAMPS[::25] + (np.arange(10) > 0), {"match": "exact"}),
        (STAMPS[:1], STAMPS, {}),
    ],
)
def test_comparisons_that_cannot_be_streamed_are_done_in_memory(t_a, t_b, options, written):
    """Interpolation, windows, unsorted timestamps and refusals give the same results there."""
    streamed, in_memory = both(written(t_a), written(t_b, seed=1), **options)
    assert streamed == in_memory


@pytest.mark.parametrize(("matched_from", "part_ns"), [(0, 790_000_000), (120, None)])
def test_causes_are_searched_for_in_the_beginning(matched_from, part_ns, written, monkeypatch):
    """A comparison was refused where only its beginning had too few equal timestamps."""
    monkeypatch.setattr(file_comparison, "MAX_SAMPLES", 50)
    stamps = STAMPS + 3 * (np.arange(len(STAMPS)) < matched_from)
    turned = Rotation.from_rotvec([0.1, 0.2, -0.05])
    pair = written(STAMPS), written(stamps, turn=turned)
    settings = comparison_settings(match="exact", min_matched=10)
    found = file_comparison.compare_files(*pair, settings, keep=False)[2]
    assert found.error_rad.rms == pytest.approx(turned.magnitude(), rel=1e-12)
    assert (found.likely_cause and found.likely_cause.part_ns) == part_ns
    # Errors are not kept.
    assert found.error_vectors.shape == (0, 3)


@pytest.mark.parametrize("seed", range(15))
def test_any_stamps_are_matched_alike(written, seed):
    """Batches end anywhere, and series begin, pause and end where they like."""
    random = np.random.default_rng(seed)
    a, b = (
        written(random.integers(20) + np.cumsum(random.integers(1, 4, random.integers(3, 70))), k)
        for k in range(2)
    )
    streamed, in_memory = both(a, b, match="exact", min_matched=0, tol="1e-3rad")
    assert streamed == in_memory


def test_losses_of_a_file_are_counted_once(written):
    """A file that is read twice, to interpolate, still has each row once."""
    a, b = written(STAMPS), written(STAMPS + 3_000_000)
    first, second, comparison = file_comparison.compare_files(
        a, b, comparison_settings(), keep=False
    )
    assert comparison.matching.match == "interpolate"
    assert first.counts.samples_read == second.counts.samples_read == first.samples == len(STAMPS)
    assert (first.first_ns, first.last_ns) == (STAMPS[0], STAMPS[-1])


def test_invalid_quaternions_stop_a_comparison_of_files(written):
    """They are refused with the side that has them."""
    with pytest.raises(NotRotationsError, match="250 of 250 rows are invalid"):
        file_comparison.compare_files(
            written(STAMPS), written(STAMPS, length=1.1), comparison_settings(), keep=False
        )
