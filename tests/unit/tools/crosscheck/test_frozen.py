"""A source is frozen only if another one of the same body turns meanwhile."""

from dataclasses import replace

import numpy as np
import pytest
from make.rigs import FAULTS, GYRO, MOCAP, ORIENTATION, crosscheck, rig

from quatprop.kinematics.quaternion import exp


def transform(sources, frames, wxyz):
    """Return the motion capture of a rig as a transform with other attitudes."""
    name = f"/tf {':'.join(frames)}"
    return replace(sources[MOCAP], name=name, device=name, frames=frames, values=wxyz)


def held(sources, seconds):
    """Return attitudes that are corrected once in a while, as those of map to odom."""
    t_s = (sources[MOCAP].t_ns - sources[MOCAP].t_ns[0]) * 1e-9
    return exp(np.floor(t_s / seconds)[:, None] * np.array([[0.0, 0.0, 0.01]]))


@pytest.mark.parametrize(("kind", "seconds"), [("rests", 1.5)])
def test_corrections_of_a_navigation_stack_are_not_frozen(kind, seconds):
    """A transform of another body stays as it is while the gyroscope turns."""
    sources = rig(2, kind)
    corrected = transform(sources, ("map", "odom"), held(sources, seconds))
    result = crosscheck([*sources.values(), corrected])
    assert [one for one in result.findings if one.level != "remark"] == []
    assert result.exit_code == 0


def test_a_wheel_that_turns_evenly_does_not_make_others_frozen():
    """Nor is what is left a share of its motion, of which there is none but rounding."""
    sources = rig(2, "rests")
    t_s = (sources[MOCAP].t_ns - sources[MOCAP].t_ns[0]) * 1e-9
    wheel = transform(sources, ("base", "wheel"), exp(t_s[:, None] * np.array([[0.0, 10.0, 0.0]])))
    result = crosscheck([*sources.values(), wheel])
    assert result.findings == ()
    assert [one.status for one in result.pairs if wheel in (one.a, one.b)] == ["at rest"] * 3


@pytest.mark.parametrize("late", [-1.2, 0.4])
def test_a_late_source_at_rest_is_not_frozen(late):
    """Where it rests, the others rest too, once the offset is known."""
    sources = rig(4)
    rests = {}
    for name, one in sources.items():
        values = one.values.copy()
        t_s = one.t_ns * 1e-9
        at_rest = (t_s > 10) & (t_s < 16)
        if not one.is_rates:
            values = values[np.where(at_rest, np.argmax(t_s > 10), np.arange(len(t_s)))]
        values[at_rest] = 0.0 if one.is_rates else values[at_rest][0]
        rests[name] = replace(one, values=values[t_s < 16], t_ns=one.t_ns[t_s < 16])
    moved = rests[MOCAP].t_ns + round(late * 1e9)
    result = crosscheck([*(rests | {MOCAP: replace(rests[MOCAP], t_ns=moved)}).values()])
    assert {one.code for one in result.findings if one.level != "remark"} == {"offset"}


def test_frozen_rates_are_found_against_another_device_alone():
    """A motion capture of the same body shows it as well as the orientation next to them."""
    faulty = FAULTS["frozen"][0](rig(11))
    del faulty[ORIENTATION]
    codes = [(one.code, one.source) for one in crosscheck([*faulty.values()]).findings]
    assert ("frozen", GYRO) in codes
