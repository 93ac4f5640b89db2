"""Rates beside four numbered columns, which may be a quaternion in either layout."""

import numpy as np
import pytest
from make.motion import waves

import quatprop
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import rotate

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")

STORED = {"scalar-first": [0, 1, 2, 3], "scalar-last": [1, 2, 3, 0]}
FAULTS = {
    "world axes": (lambda w, q: rotate(q, w), "other-frame", "rates='inertial'"),
    "other axes": (lambda w, _: w[:, [1, 0, 2]] * [1, 1, -1], "other-axes", "mount='y,x,-z'"),
    "unit": (lambda w, _: w / 20 * 180 / np.pi, "rates-off-scale", "as far as"),
}


def said_of(folder, seed, change, stored, names="q0,q1,q2,q3"):
    """Return the remarks on rates beside an orientation, by code."""
    random = np.random.default_rng(seed)
    t_ns = np.arange(4000) * 10_000_000
    rate = waves(random, t_ns * 1e-9, 0.05, 1.5, random.uniform(0.2, 0.8))
    own = attitudes(t_ns, rate, method="mean")
    rows = [t_ns * 1e-9, *np.transpose(change(rate, own)), *own[:, stored].T]
    path = folder / f"{seed}.csv"
    head = f"t (s),wx,wy,wz,{names}"
    np.savetxt(path, np.transpose(rows), "%.9f", ",", header=head, comments="")
    report = quatprop.propagate(path, rate_unit="rad/s").report
    return {one.code: str(one) for one in report.remarks}


@pytest.mark.parametrize("seed", range(2, 5))
@pytest.mark.parametrize("layout", STORED)
@pytest.mark.parametrize("fault", FAULTS)
def test_rates_that_agree_in_no_layout_are_named(tmp_path, fault, layout, seed):
    """As they are beside an orientation whose names tell its layout."""
    change, code, way = FAULTS[fault]
    said = said_of(tmp_path, seed, change, STORED[layout])
    assert way in said[code]
    assert layout in said[code]


@pytest.mark.parametrize("names", ["q0,q1,q2,q3", "q1,q2,q3,q4", "quat[0],quat[1],quat[2],quat[3]"])
@pytest.mark.parametrize("layout", STORED)
def test_rates_that_agree_in_one_layout_are_well(tmp_path, layout, names):
    """Whatever they are in the other."""
    for seed in range(3):
        assert not said_of(tmp_path, seed, lambda w, _: w, STORED[layout], names)


def test_numbers_without_unit_length_are_no_orientation(tmp_path):
    """Such as those of the joints of an arm; so with a fifth one, whatever their length."""

    def change(rate, own):
        own *= 1.7
        return -rate

    assert not said_of(tmp_path, 1, change, STORED["scalar-first"])
    five = "q0,q1,q2,q3,q4"
    random = np.random.default_rng(5)
    rate, q = random.normal(0, 0.3, (4000, 3)), random.normal(size=(4000, 5))
    q /= np.linalg.norm(q[:, :4], axis=1)[:, None]
    path, rows = tmp_path / "five.csv", np.column_stack([np.arange(4000) * 0.01, rate, q])
    np.savetxt(path, rows, "%.9f", ",", header=f"t (s),wx,wy,wz,{five}", comments="")
    assert not quatprop.propagate(path, rate_unit="rad/s").report.remarks
