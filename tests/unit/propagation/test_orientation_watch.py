"""Rates that agree with the log's own orientation at first, and later do not."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from make.ros import imu_messages, write_messages

import quatprop
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, multiply, rotate
from quatprop.propagation.direction_watch import CHUNK, OrientationWatch
from quatprop.propagation.orientation_check import COMPARED_SAMPLES

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")

CODES = {"contradicts-later", "rates-contradict", "rates-off-scale", "other-axes", "other-frame"}
TURNED = np.diag([1.0, -1.0, -1.0])
FLIP = [1.0, -1.0, -1.0, -1.0]


def moving(seed, hz, seconds, *, rest_s=0.0):
    """Return stamps, rates and attitudes of a body that is moved by hand."""
    rng = np.random.default_rng(seed)
    t_ns = 10**18 + np.arange(round(hz * seconds)) * round(1e9 / hz)
    t_s = (t_ns - t_ns[0])[:, None] / 1e9
    waves = zip(rng.uniform(0.05, 1.2, (6, 3)), rng.uniform(0, 6, (6, 3)), strict=True)
    rate = sum(0.5 * np.sin(2 * np.pi * hertz * t_s + phase) for hertz, phase in waves)
    rate *= np.clip(t_s - rest_s, 0, 1)
    return SimpleNamespace(t_ns=t_ns, rate=rate, wxyz=attitudes(t_ns, rate, method="mean"), rng=rng)


def said_of(log, start=None, end=None):
    """Return what is said of rates and orientation in a range."""
    watch = OrientationWatch("body", "rad/s", start, end)
    for begin in range(0, len(log.t_ns), 3333):
        part = slice(begin, begin + 3333)
        watch.add(log.t_ns[part], log.rate[part], log.wxyz[part])
    return {one.code: str(one) for one in watch.remarks()}


@pytest.mark.parametrize("at", [0.4, 0.55, 0.8])
@pytest.mark.parametrize(
    ("seed", "hz", "seconds"), [(1, 100, 90), (2, 200, 60), (3, 50, 150), (4, 400, 200)]
)
def test_a_later_change_is_found_with_its_place(seed, hz, seconds, at):
    """Axes are toggled, or the unit; of the parts only the later one has a remark: its own."""
    log = moving(seed, hz, seconds)
    change = int(at * len(log.t_ns))
    true = log.rate[change:].copy()
    log.rate[change:] = true @ TURNED if seed % 2 else np.degrees(true)
    ((code, text),) = said_of(log).items()
    assert code == "contradicts-later"
    found = int(re.search(r"until about (\d+) ns only", text)[1])
    assert abs(found - log.t_ns[change]) < 2e9
    assert text.count(str(found)) == 3  # also as --end and as --start
    assert not said_of(log, end=found - 10**9)
    assert [*said_of(log, start=found + 10**9)] == ["other-axes" if seed % 2 else "rates-off-scale"]


def test_the_messages_of_a_log_are_compared_to_their_end(tmp_path):
    """Also by info; the earlier part, by itself, is well."""
    log = moving(9, 100, 60)
    log.rate[4000:] = log.rate[4000:] @ TURNED
    path = write_messages(tmp_path / "log.mcap", imu_messages(log.t_ns, log.rate, log.wxyz))

    def codes(remarks):
        return {one.code for one in remarks} & CODES

    assert codes(quatprop.propagate(path).report.remarks) == {"contradicts-later"}
    assert codes(quatprop.propagate(path, end=int(log.t_ns[3900])).report.remarks) == set()
    (survey,) = quatprop.info(path).sources
    assert codes(survey.remarks) == {"contradicts-later"}


def test_several_files_and_parts_are_compared_too(tmp_path):
    """The axes change after 450 s of 600 s."""
    log = moving(3, 50, 600)
    log.rate[22_500:] = log.rate[22_500:] @ TURNED
    names = []
    for number, part in enumerate((slice(None), slice(15_000), slice(15_000, None))):
        messages = imu_messages(log.t_ns[part], log.rate[part], log.wxyz[part])
        names.append(write_messages(tmp_path / f"{number}.mcap", messages))
    whole, *parts = names

    def codes(log, **options):
        return {one.code for one in quatprop.propagate(log, **options).report.remarks} & CODES

    assert codes(parts) == {"contradicts-later"}
    assert codes(parts, in_sequence=True) == {"contradicts-later"}
    assert codes(whole, start="+430s", end="+480s") == {"contradicts-later"}
    assert codes(whole, start="+500s", end="+550s") == {"other-axes"}
    assert not codes(whole, start="+300s", end="+350s")


def healthy(kind, log):
    """Change a log in a way that is no contradiction."""
    count = len(log.t_ns)
    half = slice(count // 2, None)
    if kind == "bias":
        log.rate += np.radians([1.5, -2.0, 1.0])
    elif kind == "late":
        log.wxyz = np.roll(log.wxyz, count // 400, axis=0)
        log.wxyz[: count // 400] = log.wxyz[count // 400]
    elif kind == "noisy":
        log.rate += log.rng.normal(0, 0.02, log.rate.shape)
        log.wxyz = multiply(log.wxyz, exp(log.rng.normal(0, 0.003, log.rate.shape)))
    elif kind == "reset":
        log.wxyz[half] = multiply(exp(np.array([0.0, 0.0, 0.7])), log.wxyz[half])
    elif kind == "settling":
        turn = np.exp(-np.arange(count - count // 2) / (count / 40))
        log.wxyz[half] = multiply(exp(turn[:, None] * [0.3, 0.0, 0.6]), log.wxyz[half])
    elif kind == "scale":
        log.rate *= 1.03
    elif kind == "gap":
        keep = np.abs(np.arange(count) - count // 2) > count // 20
        log.t_ns, log.rate, log.wxyz = log.t_ns[keep], log.rate[keep], log.wxyz[keep]
    elif kind == "invalid":
        log.wxyz[half][::7] = 0
    elif kind == "absent":
        log.rate[half][::50] = np.nan
    return log


KINDS = ["bias", "late", "noisy", "reset", "settling", "scale", "gap", "invalid", "absent", "well"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("seed", "hz", "rest_s"), [(4, 100, 0), (5, 200, 40), (6, 400, 3), (7, 50, 10), (8, 1000, 0)]
)
def test_a_filter_that_is_well_has_no_remark(kind, seed, hz, rest_s):
    """Bias, delay, noise, a reset, a filter that settles, a gap: none is another sensor."""
    assert not said_of(healthy(kind, moving(seed, hz, 75, rest_s=rest_s)))


@pytest.mark.parametrize("size", [1, 37, 5000])
def test_batches_of_any_size_give_the_same(size):
    """And not more than what is compared at once is kept."""
    log = moving(8, 100, 200)
    log.rate[12_000:] = log.rate[12_000:] @ TURNED
    found, most = [], 0
    watch = OrientationWatch("body", "rad/s", None, None)
    for begin in range(0, len(log.t_ns), size):
        part = slice(begin, begin + size)
        watch.add(log.t_ns[part], log.rate[part], log.wxyz[part])
        held = (*watch._held, *watch._waiting)  # noqa: SLF001  # all that it keeps in memory
        most = max(most, sum(len(one[0]) for one in held))
    found = watch.remarks()
    whole = OrientationWatch("body", "rad/s", None, None)
    whole.add(log.t_ns, log.rate, log.wxyz)
    assert [*map(str, found)] == [*map(str, whole.remarks())] != []
    assert most <= COMPARED_SAMPLES + CHUNK + size


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_messages_that_were_joined_are_told_by_their_orientation(tmp_path, rates):
    """The body was laid on its side between two recordings; each part by itself is well."""
    log = moving(2, 100, 60)
    turn = multiply(log.wxyz[3000], multiply(exp(np.array([1.2, 0, 0])), log.wxyz[3000] * FLIP))
    log.wxyz[3000:] = multiply(turn, log.wxyz[3000:])
    if rates == "inertial":
        log.rate = rotate(log.wxyz, log.rate)
    path = write_messages(tmp_path / "log.mcap", imu_messages(log.t_ns, log.rate, log.wxyz))

    def said(**options):
        remarks = quatprop.propagate(path, rates=rates, **options).report.remarks
        return {one.code: str(one) for one in remarks if one.code in CODES | {"recordings-joined"}}

    ((code, text),) = said().items()
    assert code == "recordings-joined"
    at = int(log.t_ns[3000])
    assert f"at about t = {at} ns" in text
    assert not said(end=at - 1)
    assert not said(start=at)
