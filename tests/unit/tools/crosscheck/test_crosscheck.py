"""Every planted fault is found and named, nothing else is, and its remedy repairs it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from make.rigs import (
    CHANGES,
    DEG,
    FAULTS,
    GYRO,
    MOCAP,
    ORIENTATION,
    crosscheck,
    later,
    rig,
    with_values,
)

import quatprop
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.tools.crosscheck.repairs import applied


def found(sources, **options):
    """Return the findings on sources: code and source."""
    return [(one.code, one.source) for one in crosscheck([*sources.values()], **options).findings]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["full", "planar", "rests"])
@pytest.mark.parametrize("seed", range(2))
def test_a_healthy_rig_has_no_findings(seed, kind):
    """Sound sources have different noise, reference frames, sample rates and motions."""
    result = crosscheck([*rig(seed, kind).values()])
    assert result.findings == ()
    assert result.exit_code == 0
    assert [*result.lines()] == ["3 sources of rotation, consistent"]


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_named_and_repaired(name):
    """The finding names the source, and with its remedy applied the rig is sound."""
    fault, code, source = FAULTS[name]
    faulty = fault(rig(11))
    result = crosscheck([*faulty.values()])
    assert [(one.code, one.source) for one in result.findings] == [(code, source)]
    assert result.exit_code == (0 if code in {"bias", "drift"} else 1)
    settings = {one.source: one.settings for one in result.findings if one.settings}
    beyond_repair = {"clock", "reversed", "drift"}
    beyond_repair |= {"dead", "dead-axis", "frozen", "spikes"}
    assert bool(settings) == (code not in beyond_repair)
    if settings:
        assert crosscheck(applied([*faulty.values()], settings)).findings == ()


def test_two_faults_are_two_findings():
    """Each is attributed to its own source."""
    faulty = FAULTS["late"][0](FAULTS["deg/s read as rad/s"][0](rig(5)))
    assert found(faulty) == [("unit", GYRO), ("offset", MOCAP)]


def test_values_are_within_their_standard_deviations():
    """The offset, the mounting and the bias are those that were planted."""
    turn = np.array([0.2, -0.1, 0.15])
    mount = with_values(MOCAP, lambda q: multiply(q, exp(turn)))
    biased = with_values(GYRO, lambda w: w + np.array([1.0, 0.0, -0.5]) * DEG)
    faulty = biased(FAULTS["late"][0](mount(rig(3))))
    numbers = {one.code: one.numbers for one in crosscheck([*faulty.values()]).findings}
    assert abs(abs(numbers["offset"]["ms"]) - 80) < 4 * numbers["offset"]["sigma_ms"] < 4
    angle = np.linalg.norm(turn) / DEG
    assert abs(numbers["mount"]["deg"] - angle) < 4 * numbers["mount"]["sigma_deg"] < 2
    # The rig itself has a bias of about 0.05 deg/s.
    assert np.allclose(numbers["bias"]["bias_deg_s"], [1.0, 0.0, -0.5], atol=0.3)


def test_a_third_source_distinguishes_mirrored_rates_from_a_conjugate():
    """Within the device they look like rates of the reference frame."""
    faulty = FAULTS["conjugate"][0](FAULTS["mirrored"][0](rig(4)))
    assert found(faulty) == [("mirrored", GYRO), ("reading", ORIENTATION)]


def test_a_misread_orientation_alone_is_a_tie():
    """With two orientations, either may be the conjugate one."""
    faulty = FAULTS["conjugate"][0](rig(6))
    del faulty[GYRO]
    (finding,) = crosscheck([*faulty.values()]).findings
    assert finding.code == "reading"
    assert finding.text.endswith("(or that one is wrong)")


def test_an_allowed_difference_is_a_remark():
    """A mounting that the suite allows is no reason to fail."""
    faulty = [*FAULTS["mount"][0](rig(2)).values()]
    assert crosscheck(faulty).exit_code == 1
    allowed = crosscheck(faulty, allowed=["mount"])
    assert allowed.exit_code == 0
    assert [one.level for one in allowed.findings] == ["remark"]


def test_a_copy_does_not_confirm_anything():
    """The same numbers on another topic are not a second measurement."""
    sources = rig(1)
    copy = replace(sources[GYRO], name="/copy", device="/copy")
    result = crosscheck([*sources.values(), copy])
    assert [(one.level, one.code, one.source) for one in result.findings] == [
        ("remark", "copy", "/copy")
    ]


def test_one_source_cannot_be_compared():
    """Nothing is wrong, and nothing is confirmed."""
    assert crosscheck([rig(1)[GYRO]]).exit_code == 2


def test_a_constant_rate_is_no_dead_axis_if_the_others_agree():
    """A body that spins evenly, as simulated ones do, has constant rates."""
    sources = rig(0)
    rate = np.tile([0.0, 0.0, 0.3], (3000, 1))
    t_ns = np.arange(3000) * 10**7
    wxyz = exp(t_ns[:, None] * 1e-9 * np.array([[0.0, 0.0, 0.3]]))
    spin = [
        replace(sources[GYRO], t_ns=t_ns, values=rate),
        replace(sources[MOCAP], t_ns=t_ns, values=wxyz),
    ]
    assert [one for one in crosscheck(spin).findings if one.level != "remark"] == []


def test_many_sources_are_compared_with_one():
    """Above eight sources, not all pairs are compared, and a fault is still found."""
    sources = FAULTS["late"][0](rig(1))
    more = {
        f"/gyro{k}": replace(sources[GYRO], name=f"/gyro{k}", device=f"/gyro{k}",
                             values=sources[GYRO].values + 1e-4 * (k + 1))
        for k in range(8)
    }  # fmt: skip
    result = crosscheck([*(sources | more).values()])
    assert len(result.pairs) < 20
    assert [(one.code, one.source) for one in result.findings if one.level != "remark"] == [
        ("offset", MOCAP)
    ]


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("also", ["deg/s read as rad/s", "conjugate", "layout", "axes"])
def test_a_bias_is_right_next_to_another_fault(also):
    """The value is that of the gyroscope in its own axes, once the other fault is corrected."""
    bias = np.array([2.0, -0.5, 1.0])
    biased = with_values(GYRO, lambda w: w + bias * DEG)(rig(12))
    result = crosscheck([*FAULTS[also][0](biased).values()])
    (numbers,) = (one.numbers for one in result.findings if one.code == "bias")
    own = bias[[1, 0, 2]] * [1, -1, 1] if also == "axes" else bias
    # The rig itself has a bias of about 0.05 deg/s.
    assert np.allclose(numbers["bias_deg_s"], own, atol=0.35)
    settings = {}
    for one in result.findings:
        if one.settings:
            settings.setdefault(one.source, {}).update(one.settings)
    assert crosscheck(applied([*FAULTS[also][0](biased).values()], settings)).findings == ()


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_along_a_log_is_a_finding(name):
    """A log whose later half differs was only loosely related, and so consistent."""
    fault, source, text = CHANGES[name]
    result = crosscheck([*fault(rig(3)).values()])
    assert result.exit_code == 1
    (finding,) = (one for one in result.findings if one.level != "remark")
    assert (finding.code, finding.source) == ("changes", source)
    assert re.search(text, finding.text)
    assert abs(finding.numbers["seconds"] - 19.0) < 0.6  # s: one window


def test_a_change_may_be_allowed():
    """It is allowed like a difference between devices."""
    assert crosscheck([*CHANGES["mount"][0](rig(3)).values()], allowed=["changes"]).passed


def test_a_jump_within_the_limits_is_not_a_drift():
    """A line was fitted to a step of 15 ms, and reported as a drift of 22 ms."""
    assert crosscheck([*later(rig(3), 0.015).values()]).findings == ()


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("seconds", [-3.0123, 5e8])
def test_an_unrelated_source_changes_no_statement_on_others(seconds):
    """One on another clock, that begins at zero, changed the offset of all others."""
    alone = FAULTS["late"][0](rig(3))
    del alone[ORIENTATION]
    gyro = rig(4)[GYRO]
    t_ns = alone[GYRO].t_ns + round(seconds * 1e9)
    also = replace(gyro, name="/also", device="/also", t_ns=t_ns)
    before, after = (
        [(one.code, one.source, one.text) for one in crosscheck(some).findings]
        for some in ([*alone.values()], [*alone.values(), also])
    )
    assert [code for code, *_ in before] == ["offset"]
    assert set(before) <= set(after)


def other(rig, begin=0.0):
    """Return the sources of a rig under other names, begun later, s."""
    return {
        f"/other{name}": replace(
            one, name=f"/other{name}", device=f"/other{one.device}",
            t_ns=one.t_ns + round(begin * 1e9))
        for name, one in rig.items()
    }  # fmt: skip


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("kind", "begin"),
    [("full", 0.0), ("full", 1e8), ("planar", 0.0), ("planar", 3600.0), ("rests", 1e8)],
)
def test_two_gyroscopes_of_different_bodies_are_not_consistent(kind, begin):
    """In short recordings, only a remark mentioned it."""
    short = replace(rig(1, kind)[GYRO], t_ns=rig(1)[GYRO].t_ns[:2000],
                    values=rig(1, kind)[GYRO].values[:2000])  # fmt: skip
    for gyro in (rig(1, kind)[GYRO], short):
        result = crosscheck([rig(0, kind)[GYRO], *other({GYRO: gyro}, begin).values()])
        assert result.exit_code == 1
        assert not result.passed


def briefly(source):
    """Return the first 20 s of a source."""
    is_kept = source.t_ns < 20 * 10**9
    return replace(source, t_ns=source.t_ns[is_kept], values=source.values[is_kept])


def test_two_groups_of_sources_are_not_consistent():
    """Each agrees with another one, but the two bodies are different; what is wrong is said too."""
    late = other(FAULTS["late"][0](rig(2)))
    sources = [briefly(one) for one in (rig(1)[GYRO], rig(1)[MOCAP], *late.values())]
    result = crosscheck(sources)
    found = {(one.code, one.source) for one in result.findings}
    assert found == {
        ("unrelated", "/other/imu"), ("unrelated", f"/other{MOCAP}"), ("offset", f"/other{MOCAP}")
    }  # fmt: skip


@pytest.mark.parametrize(("duration", "code"), [("20s", 1), ("30s", 2)])
def test_slow_wandering_is_not_consistent(duration, code):
    """Two random walks have peaks by chance, which were taken for one repeated motion."""
    walks = [
        quatprop.simulate(motion="random-walk", seed=seed, duration=duration)[0] for seed in (0, 5)
    ]
    assert quatprop.crosscheck(*walks).exit_code == code


def test_sources_that_are_not_confirmed_are_in_the_headline():
    """A motion that repeats itself every 4 s, and a source that is 1 s late."""
    sources = rig(0)
    seconds = np.arange(0, 40, 0.01)
    t_ns, angle = np.rint(seconds * 1e9).astype(np.int64), 2 * np.pi * seconds / 4
    rate = np.stack((np.sin(angle), np.sin(2 * angle), np.cos(3 * angle)), axis=1)
    gyro = replace(sources[GYRO], t_ns=t_ns, values=rate)
    first, late = (
        replace(gyro, name=name, device=name, t_ns=t_ns + added,
                values=rate + 1e-3 * np.random.default_rng(added).normal(size=rate.shape))
        for name, added in (("/first", 0), ("/late", 10**9))
    )  # fmt: skip
    result = crosscheck([gyro, first, late])
    assert (result.state, result.exit_code) == ("consistent in part", 2)
    assert result.headline == "3 sources of rotation, 2 consistent, nothing shown of /late"
    assert crosscheck([gyro, first]).exit_code == 0
    assert crosscheck([gyro, late]).headline == "2 sources of rotation, nothing to compare"
