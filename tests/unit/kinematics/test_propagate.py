"""Rates to attitudes: closed forms, an 80-bit oracle, and independence of batches to the bit."""

import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make import oracle
from make.streams import propagated

from quatprop.base.errors import SeriesError
from quatprop.kinematics.propagate import TILE, Propagation, attitudes
from quatprop.kinematics.quaternion import PADDING
from quatprop.kinematics.sensitivity import FinalAttitude, marks
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.time_series import BLOCK, reblock
from quatprop.settings.quantities import METHODS

needs_80_bits = pytest.mark.skipif(not oracle.EXTENDED, reason="longdouble has no 80 bits here")


def steady(rate, count, dt_ns):
    """Return samples of one rate at even intervals."""
    return np.arange(count) * dt_ns, np.tile(np.asarray(rate, float), (count, 1))


def noisy(seed, count, scale=1.0, dt_ns=5_000_000):
    """Return samples of random rates at uneven intervals, with stamps of today."""
    rng = np.random.default_rng(seed)
    steps = rng.integers(dt_ns * 9 // 10, dt_ns * 11 // 10, count)
    return 1_700_000_000_000_000_000 + np.cumsum(steps), scale * rng.normal(size=(count, 3))


def joined(stream):
    """Return all stamps and attitudes of a stream."""
    series = list(stream)
    return np.concatenate([s.t_ns for s in series]), np.concatenate([s.wxyz for s in series])


# --- the 80-bit oracle


@needs_80_bits
def test_blocked_oracle_is_the_serial_one():
    """The fast oracle gives what the plain one gives."""
    t_ns, rate = noisy(3, 3 * oracle.RUN + 17)
    assert oracle.angle(oracle.blocked(t_ns, rate), oracle.serial(t_ns, rate)).max() < 1e-16


@pytest.mark.thorough
@needs_80_bits
@pytest.mark.parametrize("rates", ["body", "inertial"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_every_method_and_frame_against_the_oracle(method, rates, scale):
    """Methods, frames and q0 agree with the serial oracle, from tiny steps to steps of a turn."""
    t_ns, rate = noisy(4, 1000, scale, 20_000_000)
    q0 = [0.1, -0.7, 0.3, 0.5]
    q = attitudes(t_ns, rate, q0=q0, method=method, rates=rates)
    truth = oracle.serial(t_ns, rate, q0, method, rates)
    assert oracle.angle(truth, q).max() < 2e-14 * max(scale / 10, 1)


# --- batches


@st.composite
def cuts(draw, count):
    """Draw where to cut a series into batches, empty ones and single samples among them."""
    edges = draw(st.lists(st.integers(0, count), max_size=8))
    near = draw(st.sampled_from([0, TILE, BLOCK, count]))
    singles = [min(max(near + k, 0), count) for k in (-1, 0, 1, 2)]
    return sorted([0, count, *edges, *singles])


def batches(t_ns, rate, edges):
    """Cut a series at sample indices."""
    for begin, end in pairwise(edges):
        yield GyroSeries(t_ns[begin:end], rate[begin:end])


@settings(max_examples=25)
@given(st.data())
def test_batches_do_not_matter(data):
    """However the stream is cut, every attitude is the same to the bit."""
    count = data.draw(
        st.sampled_from(
            [1, 2, 9, 100, TILE - 1, TILE, TILE + 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 77]
        )
    )
    method = data.draw(st.sampled_from(sorted(METHODS)))
    rates = data.draw(st.sampled_from(["body", "inertial"]))
    scale = data.draw(st.sampled_from([1e-4, 1.0, 1e3]))
    t_ns, rate = noisy(count, count, scale)
    whole = attitudes(t_ns, rate, method=method, rates=rates)
    stream = batches(t_ns, rate, data.draw(cuts(count)))
    stamps, q = joined(propagated(stream, method=method, rates=rates))
    assert np.array_equal(stamps, t_ns)
    assert q.tobytes() == whole.tobytes()


@settings(max_examples=30)
@given(st.data())
def test_later_samples_do_not_matter(data):
    """The first attitudes of a series are those of any longer one, to the bit.

    The method cubic looks one sample ahead: there it is all but the last attitude. Quintic looks
    two ahead, and four where it has fewer samples before.
    """
    method = data.draw(st.sampled_from(sorted(METHODS)))
    rates = data.draw(st.sampled_from(["body", "inertial"]))
    total = 2 * TILE + 100
    t_ns, rate = noisy(11, total, data.draw(st.sampled_from([1e-4, 1.0, 30.0])))
    # A few long steps must not change how the others are computed.
    rate[data.draw(st.lists(st.integers(0, total - 1), max_size=3))] *= 1000
    edges = [1, 2, 9, PADDING, PADDING + 1, TILE - 1, TILE, TILE + 1, total]
    count = data.draw(st.one_of(st.sampled_from(edges), st.integers(1, total)))
    whole = attitudes(t_ns, rate, method=method, rates=rates)
    cut = batches(t_ns[:count], rate[:count], data.draw(cuts(count)))
    _, q = joined(propagated(cut, method=method, rates=rates))
    ahead = {"cubic": 1, "quintic": 2 if count > 5 else 4}.get(method, 0)
    same = max(count - ahead, 0)
    assert q[:same].tobytes() == whole[:same].tobytes()


def test_memory_order_does_not_matter():
    """Rates that lie apart or backwards in memory give the same bits."""
    t_ns, rate = noisy(6, TILE + 100)
    wide = np.zeros((len(rate), 7))
    wide[:, 2:5] = rate
    same = attitudes(t_ns, rate)
    assert attitudes(t_ns, wide[:, 2:5]).tobytes() == same.tobytes()
    assert attitudes(t_ns, np.asfortranarray(rate)).tobytes() == same.tobytes()
    assert attitudes(t_ns[::-1].copy()[::-1], rate[::-1].copy()[::-1]).tobytes() == same.tobytes()


@settings(max_examples=25)
@given(st.data())
def test_the_final_attitude_alone_is_that_of_the_series(data):
    """So are those at the marks. The reduction ends to the bit where a tile does."""
    count = data.draw(
        st.sampled_from([1, 2, 9, 17, 100, TILE - 1, TILE, TILE + 1, 2 * TILE, BLOCK + 77])
    )
    method = data.draw(st.sampled_from(sorted(METHODS)))
    rates = data.draw(st.sampled_from(["body", "inertial"]))
    t_ns, rate = noisy(count, count, data.draw(st.sampled_from([1e-4, 1.0, 30.0])))
    q0 = [0.1, -0.7, 0.3, 0.5]
    final = FinalAttitude(q0, method, rates)
    found, at = [], []
    for block in reblock(batches(t_ns, rate, data.draw(cuts(count)))):
        at.append(len(at) * BLOCK + marks(len(block), is_first=not at))
        found.append(final.add(block))
    found, at = np.concatenate([*found, final.end()]), np.concatenate(at)
    whole = attitudes(t_ns, rate, q0=q0, method=method, rates=rates)
    assert at[-1] == count - 1
    assert np.abs(found - whole[at]).max() <= 1e-15
    assert np.abs(found[-1] - whole[-1]).max() <= (0 if count % TILE == 0 else 1e-15)


def test_inputs_are_never_changed():
    """A series handed out, and the rates handed in, stay as they were."""
    t_ns, rate = noisy(7, 2 * BLOCK)
    before = rate.copy()
    series = []
    copies = []
    for block in propagated([GyroSeries(t_ns, rate)], rates="inertial"):
        series.append(block)
        copies.append(block.wxyz.copy())
    assert np.array_equal(rate, before)
    assert all(np.array_equal(s.wxyz, c) for s, c in zip(series, copies, strict=True))


def test_stream_is_lazy():
    """Attitudes come as soon as a block of samples is there, not at the end of the log."""
    given_out = []

    def source():
        for part in range(6):
            given_out.append(part)
            yield GyroSeries(*noisy(part, BLOCK // 2))

    stream = propagated(source())
    assert not given_out
    assert len(next(stream)) == BLOCK
    assert given_out == [0, 1]


# --- edges


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_few_samples(rates):
    """No batches, or only empty ones, give no series; the first attitude is q0, at any rate."""
    empty = GyroSeries(np.empty(0, np.int64), np.empty((0, 3)))
    assert not list(propagated([]))
    assert not list(propagated([empty, empty]))
    assert attitudes(empty.t_ns, empty.rate).shape == (0, 4)
    q = attitudes(np.array([5]), np.array([[9.0, 9.0, 9.0]]), q0=[0.6, 0.0, 0.8, 0.0], rates=rates)
    assert np.allclose(q, [[0.6, 0.0, 0.8, 0.0]], rtol=0, atol=np.finfo(float).eps)


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_zero_rate_is_the_identity_to_the_bit(rates):
    """Without rotation every row is exactly (1, 0, 0, 0), with no negative zeros."""
    t_ns, rate = steady([0, 0, 0], 2 * TILE + 3, 5_000_000)
    q = attitudes(t_ns, rate, rates=rates)
    assert q.tobytes() == np.tile([1.0, 0.0, 0.0, 0.0], (len(t_ns), 1)).tobytes()


@pytest.mark.parametrize(
    ("q0", "message"),
    [
        ([1, 0, 0], r"^Expected `q0` to have shape \(4,\), got \(3,\)$"),
        (np.eye(4), r"^Expected `q0` to have shape \(4,\), got \(4, 4\)$"),
        ([0, 0, 0, 0], "^Expected `q0` to be a nonzero quaternion, got all zeros$"),
        ([np.nan, 0, 0, 1], r"^Expected `q0` to be finite, got \[nan, 0.0, 0.0, 1.0\]$"),
        ("level", "^Expected `q0` to be four numbers w, x, y, z, got 'level'$"),
    ],
)
def test_bad_q0_is_refused_at_once(q0, message):
    """An invalid quaternion is refused before any sample is read."""
    with pytest.raises(SeriesError, match=message):
        Propagation(q0, "start", "body")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_rates_that_are_no_numbers_are_refused(bad):
    """The first attitude that cannot be computed is named, counted over blocks."""
    t_ns, rate = noisy(9, BLOCK + 50)
    rate[BLOCK + 20, 1] = bad
    message = f"^the attitude of sample {BLOCK + 21} is not finite; "
    with pytest.raises(SeriesError, match=message):
        list(propagated([GyroSeries(t_ns, rate)]))


WIDE = "X86_V4 AVX512_ICL AVX512_SPR AVX512F AVX512CD AVX512_SKX"
PROGRAMS = {
    WIDE: """
import hashlib
import numpy as np
from quatprop.settings.quantities import METHODS
from quatprop.kinematics.propagate import attitudes
rate = np.random.default_rng(1).normal(0, 3, (20_000, 3))
rate[::7] *= 1000
for method in METHODS:
    q = attitudes(np.arange(20_000) * 5_000_000, rate, method=method)
    print(method, hashlib.sha256(q.tobytes()).hexdigest())
""",
    f"{WIDE} X86_V3 AVX2 FMA3": """
import numpy as np
from quatprop.kinematics.quaternion import half_angle
angles = np.random.default_rng(6).uniform(0, 1, (5, 999)) * [[0.1], [0.8], [3.0], [50.0], [1e9]]
print(np.array(half_angle(angles**2)).tobytes().hex())
""",
}


@pytest.mark.parametrize("features", PROGRAMS)
def test_the_same_bytes_on_every_processor(features):
    """Attitudes do not depend on AVX-512, nor cosines and sines on any instructions."""
    plain = {"NPY_DISABLE_CPU_FEATURES": features}
    if "FMA3" in features:
        plain["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-FMA,-AVX2"
    # numpy warns of features that this processor lacks, or that it knows by other names.
    command = [sys.executable, "-W", "ignore", "-c", PROGRAMS[features]]
    fast, slow = (
        subprocess.check_output(command, env={**os.environ, **env}) for env in ({}, plain)
    )
    assert len(fast) > 300
    assert fast == slow
