"""Rates are compared with the turning of gravity in the accelerometer next to them."""

import re
from itertools import pairwise

import numpy as np
import pytest
from make.motion import waves

import quatprop
from quatprop import GyroSeries
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotate
from quatprop.propagation.direction_watch import ForceWatch
from quatprop.propagation.gravity_check import against_gravity

DEG, G = np.pi / 180, 9.81
SEEDS = range(4)


def sensor(seed, motion="by hand"):
    """Return times, ns, measured rates, rad/s, and specific forces, m/s^2, of a body."""
    random = np.random.default_rng(seed)
    hz, size = random.choice([50, 100, 200, 400]), random.uniform(10, 60) * DEG
    t_s = np.arange(40 * hz) / hz
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    rate = waves(random, t_s, 0.05, 1.5, size)
    moved = waves(random, t_s, 0.1, 2.0, random.uniform(0.0, 0.5))
    if motion == "vehicle":
        rate *= [0.05, 0.05, 1.0]
        # In a bend, the acceleration is across the way.
        moved = np.stack([0 * t_s, 10.0 * rate[:, 2], 0 * t_s], axis=1)
    if motion == "shaken":
        moved = waves(random, t_s, 0.1, 2.0, 5.0)
    true = attitudes(t_ns, rate, method="mean")
    down = rotate(conjugate(true), np.tile([0.0, 0.0, G], (len(t_s), 1)))
    if motion == "pendulum":
        rate *= [1.0, 0.0, 0.0]
        down = np.tile([0.0, 0.0, 1.0], (len(t_s), 1)) * (G + rate[:, :1] ** 2)
    if motion == "flight":
        # Of a rotorcraft, the specific force is that of its thrust, wherever it tilts.
        down = np.tile([0.0, 0.0, G], (len(t_s), 1))
    if motion == "rest":
        rate, down = 0 * rate, np.tile(down[0], (len(t_s), 1))
    rate = rate + random.normal(0, 0.003, rate.shape) + random.normal(0, 0.01, 3)
    return t_ns, rate, down + moved + random.normal(0, 0.05, rate.shape)


FAULTS = {
    "deg/s as rad/s": (lambda w: w / DEG, "57.3 times too large"),
    "rad/s as deg/s": (lambda w: w * DEG, "57.3 times too small"),
    "two axes": (lambda w: w[:, [1, 0, 2]], "as the rates do about y, x, z,"),
    "half a turn": (lambda w: w * [-1, -1, 1], "as the rates do about -x, -y, z,"),
    "cycled": (lambda w: w[:, [1, 2, 0]], "as the rates do about z, x, y,"),
    "mirrored": (lambda w: w * [1, -1, 1], "as the rates do about x, -y, z,"),
    "opposite": (lambda w: -w, "as the rates do about -x, -y, -z,"),
    "axes and unit": (lambda w: w[:, [2, 1, 0]] / DEG, "about z, y, x,"),
}


@pytest.mark.thorough
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", FAULTS)
def test_another_unit_or_other_axes_are_named(seed, fault):
    """Whichever sign and unit the accelerations have."""
    change, expected = FAULTS[fault]
    t_ns, rate, force = sensor(seed)
    for scale in (1.0, -1 / G):
        found = against_gravity(GyroSeries(t_ns, change(rate)), t_ns, scale * force, "rad/s")
        assert found is not None
        assert expected in str(found)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("motion", ["by hand", "vehicle", "shaken", "pendulum", "flight", "rest"])
def test_nothing_is_said_of_a_sound_sensor(seed, motion):
    """Also where the accelerations show something else than gravity."""
    t_ns, rate, force = sensor(seed, motion)
    assert against_gravity(GyroSeries(t_ns, rate), t_ns, force, "rad/s") is None


@pytest.mark.thorough
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("motion", ["vehicle", "shaken", "pendulum", "flight", "rest"])
@pytest.mark.parametrize("fault", FAULTS)
def test_no_wrong_cause_is_named_where_gravity_is_hidden(seed, motion, fault):
    """It may be missed, but not called another one."""
    change, expected = FAULTS[fault]
    t_ns, rate, force = sensor(seed, motion)
    found = against_gravity(GyroSeries(t_ns, change(rate)), t_ns, force, "rad/s")
    assert found is None or expected in str(found)


@pytest.mark.parametrize("angle", [20, 45, 70])
def test_an_accelerometer_that_is_turned_by_another_angle_is_no_choice_of_axes(angle):
    """No signed axes make the two agree, so none are named."""
    t_ns, rate, force = sensor(3)
    turned = rotate(exp(np.array([angle * DEG, 0.0, 0.0]))[None], force)
    assert against_gravity(GyroSeries(t_ns, rate), t_ns, turned, "rad/s") is None


@pytest.mark.parametrize("rate", [5, 20])
def test_clipping_and_gaps_are_no_contradiction(rate):
    """Forces of a clipped sensor, in packets with pauses, with values that are missing."""
    t_ns, rates, force = sensor(rate)
    force = np.clip(force, -G, G)
    force[::7] = np.nan
    kept = (np.arange(len(t_ns)) // 300) % 3 != 0
    series = GyroSeries(t_ns[kept], rates[kept])
    assert against_gravity(series, t_ns, force, "rad/s") is None


@pytest.mark.parametrize(
    "name",
    ["a{} [m/s^2]", "acc_{}_g", "a{}_m_s2", "accel_{}_mps2", "accelerometerAcceleration{}(G)"],
)
def test_a_table_is_read_in_the_unit_that_the_remark_names(tmp_path, name):
    """The header states the wrong unit, and the remark the option that overrides it."""
    t_ns, rate, force = sensor(1)
    forces = [name.format(axis.upper() if "(G)" in name else axis) for axis in "xyz"]
    head = ",".join(["t [s],gx [rad/s],gy [rad/s],gz [rad/s]", *forces])
    path, rows = tmp_path / "log.csv", np.column_stack([t_ns * 1e-9, rate / DEG, force])
    np.savetxt(path, rows, "%.9f", ",", header=head, comments="")
    with pytest.warns(
        quatprop.QuatpropWarning, match="if they are in deg/s, use rate_unit='deg/s'"
    ):
        quatprop.propagate(path)
    with pytest.warns(quatprop.QuatpropWarning, match="read in deg/s, as requested"):
        read = quatprop.propagate(path, rate_unit="deg/s")
    assert "gravity-off-scale" not in {one.code for one in read.report.remarks}
    true = attitudes(t_ns, rate)
    np.testing.assert_allclose(read.wxyz, true, atol=1e-4)


CODES = {
    *("gravity-off-scale", "gravity-other-axes"),
    *("rates-off-scale", "other-axes"),
}
LATER = {
    "unit": lambda w: w / DEG,
    "axes": lambda w: w[:, [1, 0, 2]],
    "signs": lambda w: w * [1, -1, -1],
}
BESIDE = {
    "forces": "ax [m/s^2],ay [m/s^2],az [m/s^2]",
    "orientation": "qw,qx,qy,qz",
}


def moved_by_hand(seed, seconds=60, hz=100, q0=(1.0, 0.0, 0.0, 0.0), shaken=0.05):
    """Return times, ns, measured rates, rad/s, forces, m/s^2, and attitudes of a body."""
    random = np.random.default_rng(seed)
    t_s = np.arange(seconds * hz) / hz
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    rate = waves(random, t_s, 0.05, 1.0, random.uniform(15, 40) * DEG)
    own = attitudes(t_ns, rate, method="mean", q0=q0)
    force = rotate(conjugate(own), np.tile([0.0, 0.0, G], (len(t_s), 1)))
    force += waves(random, t_s, 0.1, 2.0, shaken) + random.normal(0, 0.05, rate.shape)
    rate = rate + random.normal(0, 0.003, rate.shape) + random.normal(0, 0.01, 3)
    return t_ns, rate, force, own


def table_of(path, beside, *columns):
    """Write rates, and forces or an orientation beside them; return the path."""
    t_ns, rate, force, own = columns
    rows = [t_ns * 1e-9, *rate.T, *(force if beside == "forces" else own).T]
    head = f"t [s],gx [rad/s],gy [rad/s],gz [rad/s],{BESIDE[beside]}"
    np.savetxt(path, np.transpose(rows), "%.9f", ",", header=head, comments="")
    return path


def said_of(paths, **options):
    """Return the remarks on a recording by code."""
    return {one.code: str(one) for one in quatprop.propagate(paths, **options).report.remarks}


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("beside", BESIDE)
@pytest.mark.parametrize("change", LATER)
@pytest.mark.parametrize("files", [1, 2])
def test_a_change_later_in_tables_is_found_with_its_place(tmp_path, files, change, beside):
    """Of one table, or between two that are read as one; the later part is never silent."""
    for seed in range(2):
        t_ns, rate, force, own = moved_by_hand(seed)
        at = len(t_ns) * (2 + seed) // 5
        rate[at:] = LATER[change](rate[at:])
        ends = [0, len(t_ns)] if files == 1 else [0, at, len(t_ns)]
        paths = [
            table_of(tmp_path / f"{k}.csv", beside, t_ns[a:b], rate[a:b], force[a:b], own[a:b])
            for k, (a, b) in enumerate(pairwise(ends))
        ]
        text = said_of(paths)["contradicts-later"]
        found = int(re.search(r"until about (\d+) ns only", text)[1])
        assert abs(found - t_ns[at]) < 3e9
        assert not {"contradicts-later", *CODES} & said_of(paths, end=found - 10**9).keys()
        still = said_of(paths, start=found + 10**9).keys()
        assert {"contradicts-later", "rates-contradict", *CODES} & still


def joined(seed, angle, hz=100, shaken=0.05):
    """Return two recordings as one, with steady times, between which the body was turned."""
    axis = np.random.default_rng(seed).normal(size=3) * [1, 1, 0.3]
    turn = exp(angle * axis / np.linalg.norm(axis))
    first = moved_by_hand(seed, 30, hz, shaken=shaken)
    begin = multiply(first[3][-1], turn)
    second = moved_by_hand(seed + 100, 30, hz, q0=begin, shaken=shaken)
    t_ns = np.concatenate([first[0], second[0] + first[0][-1] + 10**9 // hz])
    return t_ns, *map(np.concatenate, zip(first[1:], second[1:], strict=True))


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("hz", [50, 400])
@pytest.mark.parametrize("angle", [60, 100, 150])
@pytest.mark.parametrize("beside", BESIDE)
def test_recordings_that_were_joined_are_told_by_what_is_beside(tmp_path, beside, angle, hz):
    """The rates go on as if nothing had happened; of each part by itself nothing is said."""
    for seed in range(2):
        t_ns, *rows = joined(seed, angle * DEG, hz)
        path = table_of(tmp_path / f"{seed}.csv", beside, t_ns, *rows)
        (text,) = (text for code, text in said_of(path).items() if code == "recordings-joined")
        found = int(re.search(r"at about t = (\d+) ns", text)[1])
        assert abs(found - t_ns[len(t_ns) // 2]) < 1e8
        for options in ({"end": found - 1}, {"start": found}):
            assert "recordings-joined" not in said_of(path, **options)


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("beside", BESIDE)
def test_nothing_is_said_of_a_whole_recording(tmp_path, beside):
    """Nor of one that pauses while the body is turned, or that a slow turn is missing of."""
    for seed in range(3):
        t_ns, *rows = moved_by_hand(seed, shaken=0.5)
        assert not said_of(table_of(tmp_path / "whole.csv", beside, t_ns, *rows))
        t_ns, *rows = joined(seed, 2.0)
        t_ns[len(t_ns) // 2 :] += 3 * 10**9
        said = said_of(table_of(tmp_path / "pause.csv", beside, t_ns, *rows))
        assert said.keys() == {"gaps"}


@pytest.mark.parametrize("motion", ["by hand", "vehicle", "shaken", "pendulum", "flight", "rest"])
def test_a_force_that_moves_is_no_joint(motion):
    """Whatever moves it, and however hard."""
    for seed in range(12):
        watch = ForceWatch("rad/s", None, None)
        watch.add(*sensor(seed, motion))
        assert not watch.remarks(), seed


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_a_number_beside_the_rates_that_does_not_fit_costs_no_row(tmp_path):
    """The rates of its row are read, wherever it is, and also if it is the last cell, cut off."""
    t_ns, rate, force, own = moved_by_hand(1)
    path = table_of(tmp_path / "log.csv", "forces", t_ns, rate, force, own)
    whole = quatprop.propagate(path)
    lines = path.read_text().splitlines()
    for k in (2500, 4000):
        lines[k] = lines[k].rpartition(",")[0] + ",?"
    path.write_text("\n".join(lines)[:-4])
    read = quatprop.propagate(path)
    np.testing.assert_array_equal(read.wxyz, whole.wxyz)
    assert not read.report.losses


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_a_mounting_explains_an_orientation_of_the_body(tmp_path):
    """Rates in sensor axes beside it contradict nothing once the mounting is given."""
    t_ns, rate, force, own = moved_by_hand(5)
    rate = rate[:, [1, 0, 2]] * [1, 1, -1]
    path = table_of(tmp_path / "log.csv", "orientation", t_ns, rate, force, own)
    assert said_of(path).keys() == {"other-axes"}
    assert not said_of(path, mount="y,x,-z")
