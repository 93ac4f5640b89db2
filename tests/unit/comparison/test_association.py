"""Which attitudes belong together in time, and attitudes between samples."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quatprop.base.errors import ComparisonError
from quatprop.comparison import association
from quatprop.comparison.association import shifted
from quatprop.estimation.cells import over_gap
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.resample import interpolate
from quatprop.kinematics.series import AttitudeSeries
from quatprop.settings.command_options import ComparisonSettings

EPOCH_NS = 1_700_000_000_000_000_000


def random_series(t_ns, seed=0):
    """Return attitudes of arbitrary signs at given times."""
    rotations = Rotation.random(len(t_ns), rng=np.random.default_rng(seed))
    return AttitudeSeries(np.asarray(t_ns, np.int64), rotations.as_quat(scalar_first=True))


def associate(a, b, **settings):
    """Match two series with some settings."""
    return association.associate(a, b, ComparisonSettings(**settings))


def spin(t_ns):
    """Return a spin about z at 1 rad/s."""
    t_ns = np.asarray(t_ns, np.int64)
    vectors = ((t_ns - EPOCH_NS) * 1e-9)[:, None] * [[0, 0, 1.0]]
    return AttitudeSeries(t_ns, Rotation.from_rotvec(vectors).as_quat(scalar_first=True))


@pytest.mark.parametrize("ratio", [10**3, 10**6, 10**9])
@pytest.mark.parametrize("first_ns", [0, EPOCH_NS])
def test_times_in_another_unit_are_recognised(ratio, first_ns):
    """In either series, also if one is a part of the other; times in the right unit match."""
    t_ns = first_ns + np.arange(100) * 10**9
    part = slice(20, 60) if first_ns else slice(0, 60)
    a, b = random_series(t_ns), random_series(t_ns[part] // ratio)
    for pair, smaller in (((a, b), "B"), ((b, a), "A")):
        sentence = rf"the times of {smaller} are {ratio:,} times smaller .* by {ratio:,}$"
        with pytest.raises(ComparisonError, match=sentence):
            associate(*pair)
    assert len(associate(a, AttitudeSeries(b.t_ns * ratio, b.wxyz))) == len(b)


@pytest.mark.parametrize("later_ns", [10**11, 10**12, 10**13, EPOCH_NS, EPOCH_NS // 1000])
def test_an_offset_is_not_taken_for_another_unit(later_ns):
    """The times of the series do not overlap, but have the same scale."""
    t_ns = np.arange(100) * 10**8
    with pytest.raises(ComparisonError, match="if they begin at the same moment, give time_off"):
        associate(random_series(t_ns), random_series(t_ns + later_ns))


def test_slerp_keeps_nanoseconds():
    """At an epoch of 1.7e18 ns one nanosecond of a spin is one nanoradian."""
    series = spin([EPOCH_NS, EPOCH_NS + 1000])
    between = interpolate(series, np.array([EPOCH_NS + 1])).wxyz
    assert float(2 * between[0, 3]) == pytest.approx(1e-9, rel=1e-6)


def test_equal_stamps_are_matched_exactly():
    """Samples that only one of the series has are left out."""
    a = random_series([0, 10, 20, 30, 40])
    b = random_series([10, 20, 25, 40])
    pairs = associate(a, b)
    assert (pairs.match, pairs.at, pairs.candidates) == ("exact", "A", 4)
    assert pairs.t_ns.tolist() == [10, 20, 40]
    assert pairs.index.tolist() == [1, 2, 4]
    assert np.array_equal(pairs.a, a.wxyz[[1, 2, 4]])
    assert np.array_equal(pairs.b, b.wxyz[[0, 1, 3]])


def test_series_of_the_same_stamps_are_not_copied():
    """Two long ones fit where they fit by themselves."""
    t_ns = EPOCH_NS + np.arange(5)
    a, b = random_series(t_ns), random_series(t_ns, 1)
    pairs = associate(a, b)
    assert np.shares_memory(pairs.a, a.wxyz)
    assert np.shares_memory(pairs.b, b.wxyz)
    assert pairs.index.tolist() == [0, 1, 2, 3, 4]
    assert (pairs.match, pairs.at, pairs.candidates) == ("exact", "A", 5)


def test_other_stamps_are_interpolated_where_there_are_fewer():
    """The series with the shorter intervals is interpolated at the timestamps of the other one."""
    a = spin(EPOCH_NS + 10_000_000 * np.arange(100))
    b = spin(EPOCH_NS + 3_141_592 + 50_000_000 * np.arange(20))
    pairs = associate(a, b)
    assert (pairs.match, pairs.at, len(pairs)) == ("interpolate", "B", 20)
    assert np.array_equal(pairs.t_ns, b.t_ns)
    assert geodesic_angle(pairs.a, pairs.b).max() < 1e-15
    swapped = associate(b, a)
    assert (swapped.match, swapped.at, len(swapped)) == ("interpolate", "A", 20)


def test_nothing_is_interpolated_across_a_gap():
    """Neighbours farther apart than ten median intervals are too far, unless --max-dt is given."""
    t_ns = EPOCH_NS + 10_000_000 * np.r_[np.arange(100), np.arange(130, 200)]
    b = spin(EPOCH_NS + 5_000_000 + 20_000_000 * np.arange(99))
    pairs = associate(spin(t_ns), b)
    seconds = (pairs.t_ns - EPOCH_NS) * 1e-9
    assert not ((seconds > 0.99) & (seconds < 1.3)).any()
    assert len(associate(spin(t_ns), b, match="interpolate", max_dt=400_000_000)) == 99


def test_a_gap_is_longer_than_ten_intervals():
    """Spans of time that end where it begins, or begin where it ends, contain none of it."""
    t_ns = np.array([0, 1, 2, 12, 13, 24, 25, 26])
    begin = np.array([2, 11, 12, 13, 23, 24])
    assert over_gap(t_ns, begin, begin + 1).tolist() == [False, False, False, True, True, False]
    assert not over_gap(t_ns, np.array([0]), np.array([13])).any()


def test_the_nearest_sample_is_near_enough_or_none():
    """Each sample of the sparser series finds the nearest one within --max-dt."""
    a = random_series([0, 100, 200, 300, 400])
    b = random_series([4, 31, 49, 51, 97, 160, 203, 291, 308], seed=1)
    pairs = associate(a, b, max_dt=9)
    assert (pairs.match, pairs.at) == ("nearest", "A")
    assert pairs.t_ns.tolist() == [0, 100, 200, 300]
    assert np.array_equal(pairs.b, b.wxyz[[0, 4, 6, 8]])
    assert pairs.interpolation_error_rad == 0, "nothing was interpolated"
    assert associate(a, b, max_dt=4, min_matched=10).t_ns.tolist() == [0, 100, 200]
    # The first of A is matched, too, though B begins a little later; and no more than there are.
    pairs = associate(
        random_series(range(0, 1000, 100)), random_series(range(2, 1002, 100)), max_dt=9
    )
    assert (pairs.match, pairs.at, len(pairs), pairs.candidates) == ("nearest", "A", 10, 10)


def test_without_a_limit_half_an_interval_of_the_denser_series_is_near():
    """Its median interval; one of two samples is enough."""
    a, b = random_series([0, 35, 66, 100]), random_series([0, 10, 20, 30, 60, 100, 110])
    assert associate(a, b, match="nearest").t_ns.tolist() == [0, 35, 100]
    a, b = random_series([0, 10]), random_series([1, 11])
    assert associate(a, b, match="nearest").t_ns.tolist() == [0, 10]
    assert associate(a, a, match="interpolate").t_ns.tolist() == [0, 10]


def test_too_few_pairs_are_refused_with_both_spans():
    """The error states how many there are, the minimum, and the spans of both series."""
    a, b = random_series(range(0, 1000, 10)), random_series(range(5, 1005, 10))
    with pytest.raises(
        ComparisonError,
        match=r"^only 0 of 99 samples in the common time have a partner \(exact\) and at least 50 "
        r"must \(A: 0 to 990 ns, B: 5 to 995 ns\); see time_offset, match, max_dt "
        r"and min_matched$",
    ):
        associate(a, b, match="exact")


def test_other_clocks_are_refused():
    """Without a common time, the error is another than for too few pairs."""
    a, b = random_series(range(0, 100, 10)), random_series(range(1000, 1100, 10))
    with pytest.raises(
        ComparisonError,
        match=r"^A and B have no time in common \(A: 0 to 90 ns, B: 1000 to 1090 ns\); "
        r"if they begin at the same moment, give time_offset='-1000ns'$",
    ):
        associate(a, b)
    with pytest.raises(ComparisonError, match=r", give time_offset='-1000ns'$"):
        associate(a, shifted(b, 500), time_offset=500)
    assert associate(a, shifted(b, -1000)).match == "exact"


def test_one_pair_is_too_few():
    """Two are the least, but for two series that are one attitude each."""
    one, more = random_series([5]), random_series([5, 15])
    with pytest.raises(ComparisonError, match=r"^only 1 of 1 samples in the common time have a"):
        associate(one, more, match="exact", min_matched=0)
    assert associate(one, one).t_ns.tolist() == [5]
    with pytest.raises(ComparisonError, match=r"^only 1 of 1 samples"):
        associate(one, one, align="first")
    for match, other_ns in (("nearest", 6), ("interpolate", 5)):
        with pytest.raises(ComparisonError, match=r"^(A and B have no time|only 0 of 1 samples)"):
            associate(one, random_series([other_ns]), match=match)


def test_series_that_overlap_without_samples_are_not_called_disjoint():
    """B has a sample before A and one after it, and none between."""
    sentence = r"^one of them has no sample in the time that both cover \(A: 10 to 19 ns, B: "
    with pytest.raises(ComparisonError, match=sentence):
        associate(random_series(range(10, 20)), random_series([0, 100]), match="exact")
