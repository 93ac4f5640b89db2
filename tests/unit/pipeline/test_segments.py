"""Stretch after segment: the attitude reached, and memory that stays flat."""

import tracemalloc
from fractions import Fraction

import numpy as np
import pytest

from quatprop import propagate
from quatprop.errors import RemarkWarning, TimelineError, UsageError
from quatprop.kinematics.propagate import Propagation, attitudes
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.segments import Segments
from quatprop.pipeline.settings import OutputSettings, PropagationSettings
from quatprop.series import GyroSeries
from quatprop.series.blocks import BLOCK
from quatprop.settings import LOOK_AHEAD, METHODS
from quatprop.timeline import Timeline
from quatprop.timeline.counts import Policy

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def peak_bytes(blocks):
    """Return the most memory that a log of so many blocks takes on its way."""

    def batches():
        for k in range(blocks):
            t_ns = np.arange(k * BLOCK, (k + 1) * BLOCK)
            yield GyroSeries(t_ns, np.zeros((BLOCK, 3)))

    timeline = Timeline(Policy(), "log")
    segments = Segments(timeline, IDENTITY, method="start", rates="body")
    tracemalloc.start()
    for _ in segments.attitudes(timeline.apply(batches())):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def test_memory_does_not_grow_with_the_log():
    """Five times the samples take no more memory."""
    assert peak_bytes(15) < 1.1 * peak_bytes(3)


@pytest.mark.parametrize("count", [1, 2, 3, 500, BLOCK + 1, BLOCK + 2, 2 * BLOCK])
@pytest.mark.parametrize(
    ("method", "other"),
    [
        ("start", "mean"),
        ("end", "mean"),
        ("mean", "coning"),
        ("coning", "cubic"),
        ("cubic", "coning"),
    ],
)
def test_the_sensitivity_is_the_difference_of_ends(method, other, count):
    """It is the angle to the end of the next better method, and to that of every second sample."""
    if count > BLOCK and method in {"start", "end"}:
        return
    random = np.random.default_rng(1)
    t_ns, rate = np.arange(count) * 10_000_000, random.normal(0, 2, (count, 3))
    timeline = Timeline(Policy(), "log")
    segments = Segments(timeline, IDENTITY, method=method, rates="body")
    for _ in segments.attitudes(timeline.apply([GyroSeries(t_ns, rate)])):
        pass
    own, next_better = (final_attitude(t_ns, rate, each) for each in (method, other))
    kept = np.unique([*range(0, count, 2), count - 1])
    sparse = final_attitude(t_ns[kept], rate[kept], method)
    assert geodesic_angle(segments.final, own) < 1e-15
    assert segments.sensitivity.next_method == other
    expected = [float(geodesic_angle(own, end)) for end in (next_better, sparse)]
    assert segments.sensitivity.angles(segments.final) == pytest.approx(expected, abs=1e-13)


def final_attitude(t_ns, rate, method):
    """Return the last attitude, in one go."""
    ((*_, (_, last)),) = [list(Propagation(IDENTITY, method, "body").run([GyroSeries(t_ns, rate)]))]
    return last.wxyz[-1]


@pytest.mark.parametrize("kind", ["averages", "increments"])
def test_the_sensitivity_of_averages_and_increments(kind):
    """The method end leads on to coning; two intervals become one, with the same integral."""
    random = np.random.default_rng(4)
    steps = random.integers(8_000_000, 12_000_000, 500)
    t_ns, rate = np.cumsum(steps), random.normal(0, 2, (500, 3))
    spans = steps if kind == "increments" else None
    series = GyroSeries(t_ns, rate, spans, kind == "averages")
    timeline = Timeline(Policy(), "log")
    segments = Segments(timeline, IDENTITY, method="end", rates="body")
    list(segments.attitudes(timeline.apply([series[:177], series[177:]])))
    assert segments.sensitivity.next_method == "coning"
    theta = rate * (steps / 1e9)[:, None]
    pairs = np.concatenate([theta[1:-1:2] + theta[2::2], theta[-1:]])
    ends = [attitudes(np.arange(len(t) + 1) * 1_000_000_000, np.concatenate([t, t[-1:]]))[-1]
            for t in (theta[1:], pairs)]  # fmt: skip
    sampling_rad = segments.sensitivity.angles(segments.final)[1]
    assert sampling_rad == pytest.approx(float(geodesic_angle(*ends)), abs=1e-13)


def test_slow_sampling_is_not_reassured():
    """Coning at 1.1 samples a turn: all methods agree to 1 deg, and all are far off."""
    hz, seconds = 8, 60
    t_ns = np.arange(hz * seconds + 1) * (1_000_000_000 // hz)
    angle = 2 * np.pi * 7.3 * t_ns / 1e9
    rate = np.stack([np.cos(angle), np.sin(angle), np.full(len(angle), 0.05)], axis=1)
    dense_ns = np.arange(hz * seconds * 128 + 1) * (1_000_000_000 // hz // 128)
    angle = 2 * np.pi * 7.3 * dense_ns / 1e9
    dense = np.stack([np.cos(angle), np.sin(angle), np.full(len(angle), 0.05)], axis=1)
    truth = attitudes(dense_ns, dense, method="cubic")[-1]
    for method in ("start", "mean", "coning", "cubic"):
        timeline = Timeline(Policy(), "log")
        segments = Segments(timeline, IDENTITY, method=method, rates="body")
        list(segments.attitudes(timeline.apply([GyroSeries(t_ns, rate)])))
        _, sampling_rad = segments.sensitivity.angles(segments.final)
        error_rad = geodesic_angle(segments.final, truth)
        assert error_rad > np.radians(20)
        assert sampling_rad > error_rad / 4


def test_the_sensitivity_is_computed_where_it_is_read():
    """Nobody pays for a second propagation whose result is not wanted."""
    timeline = Timeline(Policy(), "log")
    segments = Segments(timeline, IDENTITY, method="start", rates="body")
    batch = GyroSeries(np.arange(9) * 10_000_000, np.ones((9, 3)))
    for _ in segments.attitudes(timeline.apply([batch]), sensitivity=False):
        pass
    assert segments.sensitivity is None


@pytest.mark.parametrize("on_gap", ["hold", "zero", "split"])
def test_the_sensitivity_spans_gaps_as_the_attitudes_do(on_gap):
    """It is the difference since the last restart, and no rotation is assumed inside gaps."""
    random = np.random.default_rng(2)
    t_ns, rate = np.arange(200) * 10_000_000, random.normal(0, 2, (200, 3))
    t_ns[120:] += 10_000_000_000
    policy = Policy(on_gap=on_gap)
    timeline = Timeline(policy, "log")
    segments = Segments(timeline, IDENTITY, method="start", rates="body")
    list(segments.attitudes(timeline.apply([GyroSeries(t_ns, rate)])))
    ends = []
    for method in ("start", "mean"):
        if on_gap == "hold":
            ends.append(attitudes(t_ns, rate, method=method)[-1])
            continue
        before = attitudes(t_ns[:120], rate[:120], method=method)[-1]
        q0 = IDENTITY if on_gap == "split" else before
        ends.append(attitudes(t_ns[120:], rate[120:], q0=q0, method=method)[-1])
    assert geodesic_angle(segments.final, ends[0]) < 1e-15
    expected = float(geodesic_angle(*ends))
    assert segments.sensitivity.angles(segments.final)[0] == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rate", [None, Fraction(2997, 100)])
def test_the_output_of_a_cut_log_is_a_prefix(method, rate, tmp_path):
    """A CSV of the first samples gives, byte for byte, the first rows of the whole log's output.

    Methods that look ahead, cubic one sample and quintic two, agree up to the last but so many.
    """
    random = np.random.default_rng(3)
    t_ns = np.cumsum(random.integers(4_000_000, 6_000_000, 20_000))
    rates = random.normal(0, 2, (len(t_ns), 3))
    rates[19_000] = 500.0
    rows = [f"{t},{x},{y},{z}\n" for t, (x, y, z) in zip(t_ns, rates, strict=True)]
    settings = PropagationSettings(method=method, rate=rate)
    outputs = []
    for count in (len(rows), 16_500, 3001, 2):
        log, out = tmp_path / f"{count}.csv", tmp_path / f"{count}.out.csv"
        log.write_text("t_ns,wx,wy,wz\n" + "".join(rows[:count]))
        run(Job(str(log), OutputSettings(str(out)), settings))
        outputs.append(out.read_bytes())
        if method in LOOK_AHEAD:
            lines = out.read_text().splitlines(keepends=True)
            ahead = 1 if method == "cubic" else 2
            known = t_ns[max(count - 1 - ahead, 0)]
            kept = lines[:1] + [row for row in lines[1:] if int(row.split(",")[0]) <= known]
            outputs[-1] = "".join(kept).encode()
    whole = outputs[0]
    assert all(whole.startswith(part) and len(part) < len(whole) for part in outputs[1:])


GAPPED = "t_ns,wx,wy,wz\n" + "".join(
    f"{t}000000000,0,0,{w}\n" for t, w in [(0, 0.1), (1, 0.2), (11, 0.3), (12, 0.1), (13, 0.0)]
)
"""Rates about z, rad/s, with a gap from 1 s to 11 s."""


def angles(tmp_path, policy, **options):
    """Return stamps, s, and angles about z, rad, of the log with a gap."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text(GAPPED)
    settings = PropagationSettings(policy=policy, **options)
    run(Job(str(log), OutputSettings(str(out)), settings))
    rows = np.loadtxt(out, delimiter=",", skiprows=1, ndmin=2)
    return rows[:, 0] / 1e9, 2 * np.arctan2(rows[:, 4], rows[:, 1])


@pytest.mark.parametrize(
    ("on_gap", "expected"),
    [
        ("hold", [0, 0.1, 0.5, 0.9, 1.3, 1.7, 2.25, 2.5]),
        ("zero", [0, 0.1, 0.1, 0.1, 0.1, 0.1, 0.25, 0.5]),
    ],
)
def test_attitudes_inside_a_gap_are_those_that_its_policy_assumes(on_gap, expected, tmp_path):
    """Where no rotation is assumed the attitude stays; no wanted time is left out."""
    times = tmp_path / "times.csv"
    wanted = [0, 1, 3, 5, 7, 9, 11.5, 13]
    times.write_text("t_ns,qw,qx,qy,qz\n" + "".join(f"{int(t * 1e9)},1,0,0,0\n" for t in wanted))
    policy = Policy(on_gap=on_gap, max_gap_ns=5_000_000_000)
    stamps, angle = angles(tmp_path, policy, at=str(times))
    assert stamps.tolist() == wanted
    np.testing.assert_allclose(angle, expected, atol=1e-14)


def test_a_split_log_has_no_attitudes_inside_gaps(tmp_path):
    """There nothing is assumed; the next segment begins with q0."""
    policy = Policy(on_gap="split", max_gap_ns=5_000_000_000)
    stamps, angle = angles(tmp_path, policy, rate=Fraction(2))
    assert stamps.tolist() == [0, 0.5, 1, 11, 11.5, 12, 12.5, 13]
    np.testing.assert_allclose(angle, [0, 0.05, 0.1, 0, 0.15, 0.3, 0.35, 0.4], atol=1e-14)


def test_times_inside_the_gaps_of_a_split_log_are_counted(tmp_path):
    """They have no attitude, which nobody sees in the output."""
    times = tmp_path / "times.csv"
    times.write_text("t_ns,qw,qx,qy,qz\n0,1,0,0,0\n3000000000,1,0,0,0\n99000000000,1,0,0,0\n")
    policy = Policy(on_gap="split", max_gap_ns=5_000_000_000)
    assert angles(tmp_path, policy, at=str(times))[0].tolist() == [0]
    with pytest.warns(RemarkWarning) as caught:
        propagate(tmp_path / "log.csv", at=times, on_gap="split", max_gap="5s")
    assert any(
        "2 of the 3 times asked for with at have no attitude: 1 outside the samples used and 1 in "
        "gaps" in str(one.message)
        for one in caught
    )


def test_times_in_gaps_alone_are_not_said_to_be_outside_the_log(tmp_path):
    """All of them are between the first and the last sample, and were said not to be."""
    times = tmp_path / "times.csv"
    times.write_text("t_ns,qw,qx,qy,qz\n3000000000,1,0,0,0\n4000000000,1,0,0,0\n")
    with pytest.raises(
        TimelineError,
        match=r"none of the times asked for with at has an attitude: 2 in gaps; its samples are "
        r"from 0 to 13000000000 ns: are both on the same clock\?$",
    ):
        angles(tmp_path, Policy("error", "error", "split", 5_000_000_000), at=str(times))


def test_times_outside_the_log_are_refused(tmp_path):
    """An empty output with exit code 0 would look like success."""
    times = tmp_path / "times.csv"
    times.write_text("t_ns,qw,qx,qy,qz\n14000000000,1,0,0,0\n")
    with pytest.raises(
        TimelineError,
        match=r"none of the times asked for with at has an attitude: 1 outside the samples used; "
        r"its samples are from 0 to 13000000000 ns: are both on the same clock\?$",
    ):
        angles(tmp_path, Policy(), at=str(times))
    assert not (tmp_path / "out.csv").exists()


def test_a_wrong_timestamp_does_not_fill_the_disk(tmp_path):
    """One stamp of another clock would ask for 1.7e11 rows: the two samples are named."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    stamps = [0, 10_000_000, 20_000_000, 1_700_000_000_000_000_000]
    log.write_text("t_ns,wx,wy,wz\n" + "".join(f"{t},0,0,1\n" for t in stamps))
    settings = PropagationSettings(rate=Fraction(100))
    with pytest.raises(
        UsageError,
        match=r"^between the samples at 20000000 and 1700000000000000000 ns there would be "
        r"169,999,999,998 attitudes at 100 Hz; is a timestamp wrong\? Choose on_gap='split', a "
        r"lower rate, or leave a part out with start or end$",
    ):
        run(Job(str(log), OutputSettings(str(out)), settings))
    assert not out.exists()
    split = PropagationSettings(rate=Fraction(100), policy=Policy(on_gap="split"))
    run(Job(str(log), OutputSettings(str(out)), split))
    assert len(out.read_text().splitlines()) == 1 + 4
