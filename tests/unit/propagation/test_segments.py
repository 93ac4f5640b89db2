"""Stretch after segment: how far the end depends on the method, and what is written of it.

Attitudes inside and next to gaps are tested in ``contract/test_options_oracle.py``.
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.commands import refused, run
from make.streams import IDENTITY, segmented
from make.tables import write_attitudes, write_rates

from quatprop import propagate
from quatprop.base.errors import RemarkWarning
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, multiply
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.time_series import BLOCK
from quatprop.propagation.report import facts
from quatprop.timeline.counts import Policy

# --- how far the final attitude depends on the method and on the sampling


def random_rates(count):
    """Return samples at even intervals."""
    rate = np.random.default_rng(1).normal(0, 2, (count, 3))
    return GyroSeries(np.arange(count) * 10_000_000, rate)


def final_attitude(series, method, q0=IDENTITY):
    """Return the last attitude, in one go."""
    return attitudes(series.t_ns, series.rate, q0=q0, method=method)[-1]


NEXT = {"start": "mean", "end": "mean", "mean": "cubic", "coning": "cubic", "cubic": "coning"}


def marked(count):
    """Return where attitudes are compared.

    At all of 2048 samples, each 32nd of 32768, each 256th, the last.
    """
    k = np.arange(1, count + 1)
    every = np.where(k <= 2048, 1, np.where(k <= 32768, 32, 256))
    return (k % every == 0) | (k == count) | (k % BLOCK == 0)


def largest_angles(series, method, rates="body"):
    """Return the largest angles to the next better method, and to every second sample."""
    count = len(series)
    kept = np.unique([*range(0, count, 2), count - 1])
    how = {"q0": IDENTITY, "rates": rates}
    own, other = (
        attitudes(series.t_ns, series.rate, method=each, **how) for each in (method, NEXT[method])
    )
    sparse = attitudes(series.t_ns[kept], series.rate[kept], method=method, **how)
    every = marked(-(-count // 2))
    angles = geodesic_angle(own[kept], sparse)[: len(every)][every].max()
    last = geodesic_angle(own[-1], sparse[-1])
    return geodesic_angle(own, other)[marked(count)].max(), max(angles, last)


@pytest.mark.thorough
@pytest.mark.parametrize("count", [1, 2, 3, 40, 500, BLOCK + 1, BLOCK + 2])
@pytest.mark.parametrize(("method", "rates"), [*((m, "body") for m in NEXT), ("mean", "inertial")])
def test_the_sensitivity_is_the_largest_difference(method, rates, count):
    """From the next better method, and from that of every second sample; the ends alone counted."""
    series = random_rates(count)
    segments, _, _ = segmented([series], method=method, rates=rates)
    assert segments.sensitivity.next_method == NEXT[method]
    expected = [float(angle) for angle in largest_angles(series, method, rates)]
    assert segments.sensitivity.angles == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("hertz", [0.3, 0.5, 1.1])
def test_a_body_that_turns_to_and_fro_is_sensitive_in_between(hertz):
    """At the end of a swing, methods agree that differ by half a sample within: it was 0."""
    t_ns = np.arange(1001) * 10_000_000
    angle = 2 * np.pi * hertz * t_ns / 1e9
    series = GyroSeries(t_ns, np.cos(angle)[:, None] * [[0.0, 0.0, 2.0]])
    start, mean = (attitudes(series.t_ns, series.rate, method=m) for m in ("start", "mean"))
    largest = geodesic_angle(start, mean).max()
    assert segmented([series])[0].sensitivity.angles[0] == pytest.approx(largest, rel=0.02)
    said = dict(facts(propagate(series).report))["sensitivity"]
    degrees = float(said.removeprefix("the attitudes change by at most ").partition(" deg with")[0])
    assert degrees == pytest.approx(np.degrees(largest), rel=0.02)
    assert said.endswith("; start lags by half a sample, which mean and coning correct")
    assert "lags" not in dict(facts(propagate(series, method="mean").report))["sensitivity"]


@given(st.integers(2, 80), st.integers(0, 10**6), st.sampled_from(["body", "inertial"]))
def test_the_sensitivity_of_short_logs_is_the_largest_anywhere(count, seed, rates):
    """Of fewer than 32 samples only the last were compared: less than half was said."""
    random = np.random.default_rng(seed)
    t_ns = np.cumsum(random.integers(1_000_000, 20_000_000, count))
    series = GyroSeries(t_ns, random.normal(0, 3, (count, 3)))
    own, other = (attitudes(t_ns, series.rate, method=m, rates=rates) for m in ("start", "mean"))
    angles = segmented([series], rates=rates)[0].sensitivity.angles
    assert angles[0] == pytest.approx(geodesic_angle(own, other).max(), abs=1e-12)
    kept = np.unique([*range(0, count, 2), count - 1])
    sparse = attitudes(t_ns[kept], series.rate[kept], rates=rates)
    assert angles[1] == pytest.approx(geodesic_angle(own[kept], sparse).max(), abs=1e-12)


@pytest.mark.parametrize(("count", "compared"), [(5, "coning"), (6, "cubic"), (500, "cubic")])
@pytest.mark.parametrize("rates", ["body", "inertial"])
@pytest.mark.parametrize("kind", ["rates", "averages", "increments"])
def test_where_quintic_is_cubic_it_is_compared_with_coning(kind, rates, count, compared):
    """It was compared with itself there: the sensitivity of a short or uneven log was 0."""
    series = random_rates(count)
    spans = np.full(count, 10_000_000) if kind == "increments" else None
    t_ns = series.t_ns + np.arange(count) // 7 * 50_000_000
    series = GyroSeries(t_ns, series.rate, spans, kind == "averages")
    segments, _, own = segmented([series], method="quintic", rates=rates)
    vectors = {
        method: rotation_vectors(
            t_ns,
            -series.rate if rates == "inertial" else series.rate,
            method,
            spans,
            is_interval_average=kind == "averages",
        )
        for method in ("coning", "cubic", "quintic")
    }
    is_cubic = (vectors["quintic"] == vectors["cubic"]).all(axis=1)
    assert is_cubic.all() == (compared == "coning")
    others = [np.array(IDENTITY)]
    for step in exp(np.where(is_cubic[:, None], vectors["coning"], vectors["cubic"])):
        others.append(multiply(others[-1], step))
    others = conjugate(others) if rates == "inertial" else np.array(others)
    assert segments.sensitivity.next_method == compared
    expected = float(geodesic_angle(own, others)[marked(count)].max())
    assert segments.sensitivity.angles[0] == pytest.approx(expected, abs=1e-13)
    assert expected > 1e-6


@pytest.mark.parametrize("kind", ["averages", "increments"])
def test_the_sensitivity_of_averages_and_increments(kind):
    """The method end leads on to coning; two intervals become one, with the same integral.

    The rates of repeated stamps count in neither, however long they say that they are.
    """
    random = np.random.default_rng(4)
    steps, rate = random.integers(8_000_000, 12_000_000, 500), random.normal(0, 2, (500, 3))
    steps[[50, 301, 302]] = 0
    spans = np.where(steps, steps, 10_000_000) if kind == "increments" else None
    series = GyroSeries(np.cumsum(steps), rate, spans, kind == "averages")
    segments, _, _ = segmented([series[:177], series[177:]], method="end")
    assert segments.sensitivity.next_method == "coning"
    theta = rate * (steps / 1e9)[:, None]
    pairs = np.concatenate([theta[1:-1:2] + theta[2::2], theta[-1:]])
    own, sparse = (
        attitudes(np.arange(len(turns) + 1) * 10**9, np.concatenate([turns, turns[-1:]]))
        for turns in (theta[1:], pairs)
    )
    angles = geodesic_angle(own[[*range(0, 500, 2), 499]], sparse)
    expected = max(angles[:250][marked(250)].max(), angles[-1])
    assert segments.sensitivity.angles[1] == pytest.approx(float(expected), abs=1e-13)


@pytest.mark.parametrize("method", ["start", "mean", "coning", "cubic"])
def test_slow_sampling_is_not_reassured(method):
    """Coning at 1.1 samples a turn: all methods agree to 1 deg, and all are far off."""

    def coning(hz, seconds=60):
        t_ns = np.arange(hz * seconds + 1) * (1_000_000_000 // hz)
        angle = 2 * np.pi * 7.3 * t_ns / 1e9
        rate = np.stack([np.cos(angle), np.sin(angle), np.full(len(angle), 0.05)], axis=1)
        return GyroSeries(t_ns, rate)

    segments, _, _ = segmented([coning(8)], method=method)
    error_rad = geodesic_angle(segments.final, final_attitude(coning(1000), "cubic"))
    assert error_rad > np.radians(20)
    assert segments.sensitivity.angles[1] > error_rad / 4


def test_the_sensitivity_is_computed_where_it_is_read():
    """Nobody pays for a second propagation whose result is not wanted."""
    assert segmented([random_rates(9)], sensitivity=False)[0].sensitivity is None


@pytest.mark.parametrize("on_gap", ["hold", "zero", "split"])
def test_the_sensitivity_spans_gaps_as_the_attitudes_do(on_gap):
    """It is the largest of all segments, and no rotation is assumed inside gaps."""
    even = random_rates(200)
    gap_ns = np.where(np.arange(200) < 120, 0, 10_000_000_000)
    series = GyroSeries(even.t_ns + gap_ns, even.rate)
    segments, _, _ = segmented([series], policy=Policy(on_gap=on_gap))
    found = []
    for method in ("start", "mean"):
        whole = attitudes(series.t_ns, series.rate, method=method)
        before = attitudes(series.t_ns[:120], series.rate[:120], method=method)
        q0 = IDENTITY if on_gap == "split" else before[-1]
        after = attitudes(series.t_ns[120:], series.rate[120:], q0=q0, method=method)
        found.append(whole if on_gap == "hold" else np.concatenate([before, after]))
    own, other = found
    assert geodesic_angle(segments.final, own[-1]) < 1e-15
    every = marked(200) if on_gap == "hold" else np.concatenate([marked(120), marked(80)])
    expected = float(geodesic_angle(own, other)[every].max())
    assert segments.sensitivity.angles[0] == pytest.approx(expected, abs=1e-15)


# --- outputs


@pytest.fixture(scope="module")
def rows():
    """Return rates, one of them beyond any, as rows."""
    random = np.random.default_rng(3)
    t_ns = np.cumsum(random.integers(4_000_000, 6_000_000, 5000)).tolist()
    rates = random.normal(0, 2, (len(t_ns), 3))
    rates[-100] = 500.0
    return [f"{t},{x},{y},{z}" for t, (x, y, z) in zip(t_ns, rates.tolist(), strict=True)]


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["start", "cubic", "quintic"])
@pytest.mark.parametrize("rate", [(), ("--rate", "29.97")])
def test_the_output_of_a_cut_log_is_a_prefix(method, rate, rows, tmp_path):
    """A CSV of the first samples gives, byte for byte, the first rows of the whole log's output.

    Methods that look ahead, cubic one sample and quintic two, agree up to the last but so many.
    """
    outputs = []
    for count in (5000, 4097, 301, 2):
        log, out = write_rates(tmp_path / "log.csv", rows[:count]), tmp_path / "out.csv"
        options = ("--rate-unit", "rad/s", "--method", method, *rate)
        run("propagate", log, "-o", out, *options, code=0)
        head, *lines = out.read_text().splitlines(keepends=True)
        ahead = {"cubic": 1, "quintic": 2}.get(method, 0)
        known = int(rows[max(count - 1 - ahead, 0)].split(",")[0])
        kept = [line for line in lines if int(line.split(",")[0]) <= known]
        outputs.append("".join([head, *kept]))
    assert all(outputs[0].startswith(part) and len(part) < len(outputs[0]) for part in outputs[1:])


@pytest.fixture
def gapped(tmp_path):
    """Return a log with a gap from 1 s to 11 s."""
    rows = [f"{t}000000000,0,0,0.1" for t in (0, 1, 11, 12, 13)]
    return write_rates(tmp_path / "log.csv", rows)


@pytest.mark.parametrize(
    ("wanted_s", "said"),
    [
        ([14], "none of the times asked for with --at has an attitude: 1 outside the samples used"),
        # All of them are between the first and the last sample, and were said not to be.
        ([3, 4], "none of the times asked for with --at has an attitude: 2 in gaps"),
    ],
)
def test_times_of_which_none_has_an_attitude_are_refused(gapped, wanted_s, said):
    """An empty output with exit code 0 would look like success."""
    stamps = [t * 10**9 for t in wanted_s]
    times = write_attitudes(gapped.with_name("times.csv"), stamps, [IDENTITY] * len(stamps))
    out = gapped.with_name("out.csv")
    gaps = ("--on-gap", "split", "--max-gap", "5s", "--rate-unit", "rad/s")
    assert refused("propagate", gapped, "-o", out, "--at", times, *gaps).endswith(
        f"{said}; its samples are from 0 to 13000000000 ns: are both on the same clock?"
    )
    assert not out.exists()


def test_times_without_an_attitude_are_counted(gapped):
    """Nobody sees in the output that they are not there."""
    stamps = [0, 3 * 10**9, 99 * 10**9]
    times = write_attitudes(gapped.with_name("times.csv"), stamps, [IDENTITY] * 3)
    with pytest.warns(RemarkWarning) as caught:
        series = propagate(gapped, at=times, on_gap="split", max_gap="5s", rate_unit="rad/s")
    assert series.t_ns.tolist() == [0]
    assert any(
        "2 of the 3 times asked for with at have no attitude: 1 outside the samples used and 1 in "
        "gaps" in str(one.message)
        for one in caught
    )


def test_a_wrong_timestamp_does_not_fill_the_disk(tmp_path):
    """One stamp of another clock would ask for 1.7e11 rows: the two samples are named."""
    out = tmp_path / "out.csv"
    stamps = [0, 10_000_000, 20_000_000, 1_700_000_000_000_000_000]
    log = write_rates(tmp_path / "log.csv", [(t, 0, 0, 1) for t in stamps])
    arguments = ("propagate", log, "-o", out, "--rate", Fraction(100), "--rate-unit", "rad/s")
    assert refused(*arguments).startswith(
        "Error: between the samples at 20000000 and 1700000000000000000 ns there would be "
        "169,999,999,998 attitudes at 100 Hz; is a timestamp wrong? Choose --on-gap split, a "
    )
    assert not out.exists()
    run(*arguments, "--on-gap", "split", code=0)
    assert len(out.read_text().splitlines()) == 1 + 4


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize(("method", "is_said"), [("end", True), ("coning", False)])
def test_coning_is_no_error_of_averages_that_are_corrected(method, is_said):
    """The summary announced 0.0106 deg by method coning that PX4's corrected averages do not have.

    Nothing in such a log tells whether the sensor corrects, so that the summary says both.
    """
    t_us, rate = np.arange(100) * 10_000, np.random.default_rng(1).normal(0, 0.1, (100, 3))
    log = GyroSeries(t_us * 1000, rate, is_interval_average=True)
    rows = dict(facts(propagate(log, method=method).report))
    assert ("(no error if the sensor corrects for coning itself)" in rows["sensitivity"]) is is_said


def test_one_sample_has_no_sensitivity(tmp_path):
    """No method makes anything of it."""
    log = tmp_path / "log.csv"
    log.write_text("t_ns,wx,wy,wz\n1000,0.1,0.2,0.3\n")
    said = run("propagate", log, "-o", tmp_path / "a.csv", "--rate-unit", "rad/s").stderr
    assert "sensitivity" not in said
    assert "final" in said
