"""Where a propagation begins: given, from gravity, from the log itself, from another series.

Combinations of all choices are tested in ``contract/test_options_oracle.py``.
"""

import math
import re

import numpy as np
import pandas as pd
import pytest
from make import ulog
from make.commands import refused, run
from make.joined_logs import join_mcap
from make.places import SAMPLE_LOGS
from make.ros import imu_messages, write_messages
from make.tables import write_attitudes, write_rates
from scipy.special import chdtri

from quatprop import GyroSeries, QuatpropError, RemarkWarning, propagate
from quatprop.base.errors import UsageError
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, multiply, rotate
from quatprop.kinematics.quaternion import log as rotation_vector
from quatprop.propagation.initial_attitude import FirstAttitude, InitialAttitude, level

G = 9.80665
COLUMNS = "t_ns,wx,wy,wz,accel_x,accel_y,accel_z"
T0 = 1_700_000_000_000_000_000
UNIT = [1, 0, 0, 0]


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("heading", [0.0, 0.7, -3.0])
@pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (0.3, -0.2), (2.9, 1.2), (-1.0, -1.0)])
def test_level_is_roll_and_pitch_from_gravity(roll, pitch, heading, down):
    """The force that a body feels at a known zyx attitude gives that attitude back."""
    turns = exp(np.array([[0, 0, heading], [0, pitch, 0], [roll, 0, 0]], dtype=np.float64))
    truth = multiply(turns[0], multiply(turns[1], turns[2]))
    up = np.array([0.0, 0.0, -G if down else G])
    felt = rotate(truth * [1, -1, -1, -1], up)
    assert geodesic_angle(level(felt, heading, down=down), truth) < 1e-15


def turned(roll, pitch, yaw):
    """Return attitudes Rz Ry Rx of some angles, wxyz."""
    about = map(np.multiply.outer, map(np.array, (roll, pitch, yaw)), np.eye(3))
    x, y, z = map(exp, about)
    return multiply(z, multiply(y, x))


def all_within(errors, covariance, comparisons):
    """Tell whether the sum of e' P^-1 e of ``(N, 3)`` is in the 99.9 % band of all comparisons."""
    squares = np.einsum("ni,ij,nj->", errors, np.linalg.pinv(covariance, 1e-9), errors)
    freedom = np.linalg.matrix_rank(covariance, 1e-9 * covariance.max()) * len(errors)
    low, high = chdtri(freedom, [1 - 0.0005 / comparisons, 0.0005 / comparisons])
    return bool(low < squares < high)


ANGLES = [(0, 0, 0), (0.3, -0.2, 1.0), (2.9, 1.2, -2.0), (-1.0, -1.4, 0.0)]


@pytest.mark.parametrize("sigma", [(2e-3,), (1e-3, 2e-3, 1e-2)])
@pytest.mark.parametrize("angles", ANGLES)
def test_the_error_of_a_first_attitude_is_about_every_axis_or_in_roll_pitch_and_yaw(sigma, angles):
    """Of 4,000 attitudes each; one that is off by 5 % is found."""
    errors = np.random.default_rng(6).normal(size=(4000, 3)) * sigma
    truth = turned(*np.array(angles)[:, None])
    wrong = turned(*(angles + errors).T) if len(sigma) == 3 else multiply(truth, exp(errors))
    apart = rotation_vector(multiply(conjugate(truth), wrong))
    for fault in (1.0, 0.95, 1.05):
        covariance = FirstAttitude(truth[0]).covariance(tuple(fault * each for each in sigma))
        assert all_within(apart, covariance, 16) == (fault == 1)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("angles", ANGLES)
def test_a_levelled_attitude_is_off_by_the_noise_of_the_accelerometer(tmp_path, angles, down):
    """The error of q0 was left out, whatever the noise; and its sigma comes with its origin."""
    random = np.random.default_rng(7)
    truth = turned(*angles)
    force = rotate(conjugate(truth), [0, 0, -G if down else G])
    noisy = force + random.normal(0, 0.3, (101, 3))
    rows = [(k * 10**7, 1e-9 * k, 0, 0, *row) for k, row in enumerate(noisy.tolist())]
    log = write_rates(tmp_path / "log.csv", rows, COLUMNS)
    settings = {"q0": "level", "heading": math.degrees(angles[2]), "noise_density": 1e-9}
    settings |= {"reference_z": "down" if down else "up", "rate_unit": "rad/s", "sigma": True}
    result = propagate(log, **settings)
    x, y, z = (force + random.normal(0, 0.3 / math.sqrt(101), (4000, 3))).T * (-1 if down else 1)
    levelled = turned(np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z)), angles[2])
    apart = rotation_vector(multiply(conjugate(truth), levelled))
    # That of a log is by its own noise, which 303 numbers show to some 4 %.
    scatter = math.sqrt(((noisy - noisy.mean(axis=0)) ** 2).mean())
    covariance = result.covariance[0] * (0.3 / scatter) ** 2
    np.testing.assert_allclose(np.linalg.eigvalsh(covariance)[0], 0, atol=1e-15)
    errors = FirstAttitude(turned(*angles)).covariance
    exact = 0.3 / math.sqrt(101) / np.array([math.hypot(*force[1:]), G, math.inf])
    np.testing.assert_allclose(covariance, errors(tuple(exact)), rtol=0.1, atol=1e-7)
    for fault in (1.0, 0.95, 1.05):
        assert all_within(apart, errors(tuple(fault * exact)), 24) == (fault == 1)
    report = result.report.uncertainty
    said = "accelerometer noise, without its bias and without that of the heading"
    assert report.origins["q0_sigma"] == said
    np.testing.assert_allclose(report.q0_sigma_rad, result.sigma[0], rtol=1e-3)
    given = propagate(log, q0_sigma="1deg", **settings)
    np.testing.assert_allclose(given.sigma[0], math.radians(1), rtol=1e-9)
    assert given.report.uncertainty.origins["q0_sigma"] == "given"


@pytest.mark.filterwarnings("ignore:.*every rate is zero")
def test_accelerations_that_do_not_change_tell_no_sigma(log):
    """The attitude was stated to be exact, "q0 0 deg"."""
    result = propagate(log, q0="level", noise_density=1e-9, rate_unit="rad/s")
    assert "q0_sigma" not in result.report.uncertainty.origins


@pytest.fixture
def log(tmp_path):
    """Return a table of 2 s at rest, rolled by 30 degrees."""
    force = (0.0, G * math.sin(math.radians(30)), G * math.cos(math.radians(30)))
    return write_rates(
        tmp_path / "log.csv", [(k * 10_000_000, 0, 0, 0, *force) for k in range(200)], COLUMNS
    )


def first_attitude(log, q0, *options):
    """Return the first attitude of a propagation from `q0`, wxyz."""
    out = log.with_name("out.csv")
    code = run("propagate", log, "-o", out, "--q0", q0, *options).exit_code
    assert code in {0, 3}
    return [float(q) for q in out.read_text().splitlines()[1].split(",")[1:]]


def sentence(log, q0, *options):
    """Return why `q0` is refused; nothing is written."""
    out = log.with_name("out.csv")
    said = refused("propagate", log, "-o", out, "--q0", q0, *options)
    assert not out.exists()
    return said


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_length_that_rounding_to_three_decimals_explains_is_taken(sign):
    """A thousandth more or less than 1; beyond that it is no attitude."""
    assert InitialAttitude(wxyz=(0.0, 1 + sign * 0.00099, 0.0, 0.0)).wxyz[1] != 1
    with pytest.raises(UsageError, match=r" has the length (0\.99899|1\.00101), so it is not an "):
        InitialAttitude(wxyz=(0.0, 0.0, 0.0, 1 + sign * 0.00101))


@pytest.mark.parametrize(
    ("wanted", "origin"),
    [
        (InitialAttitude(), "identity"),
        (InitialAttitude(wxyz=(0.0, 1.0, 0.0, 0.0)), "given"),
        (InitialAttitude("log"), "log"),
        (
            InitialAttitude("level", heading=math.pi / 2, down=True),
            "level, reference z down, heading 90 deg",
        ),
    ],
)
def test_the_report_names_where_q0_is_from(wanted, origin):
    """Nothing is called given that was not."""
    assert wanted.origin == origin


# --- level


@pytest.mark.parametrize(
    ("head", "row", "said"),
    [
        (COLUMNS, "{t},{swing},0,0,0,0,9.8", "its rates scatter by 0.7 rad/s in the first second"),
        (COLUMNS, "{t},0,0,0,0,0,{swing}", "the accelerations of the first second do not show"),
        ("t_ns,wx,wy,wz", "{t},0,0,0", "it has no accelerations to take roll and pitch from"),
    ],
)
def test_level_needs_gravity_alone(tmp_path, head, row, said):
    """A log that begins in motion, or without an accelerometer, tells no level."""
    rows = [row.format(t=k * 10_000_000, swing=0.7 * (-1) ** k) for k in range(200)]
    assert said in sentence(write_rates(tmp_path / "log.csv", rows, head), "level")


def test_level_does_not_advise_another_start_where_accelerations_are_absent(tmp_path):
    """Whatever start was chosen, they were marked as absent."""
    stamps = T0 + np.arange(300) * 10_000_000
    absent = {"linear_acceleration_covariance": np.full(9, -1.0)}
    path = write_messages(
        tmp_path / "log.bag", imu_messages(stamps, np.full((300, 3), 0.1), **absent)
    )
    said = refused("propagate", path, "-o", tmp_path / "out.csv", "--q0", "level")
    assert "the accelerations next to its rates are absent" in said
    assert said.endswith("; give --q0")


@pytest.mark.parametrize(("scatter", "is_taken"), [(0.0499, True), (0.0501, False)])
def test_gravity_may_scatter_by_a_twentieth(tmp_path, scatter, is_taken):
    """Of a vehicle whose engine runs; more than that is motion."""
    rows = [(k * 10_000_000, 0, 0, 0, 0, 0, G + G * scatter * (-1) ** k) for k in range(100)]
    log = write_rates(tmp_path / "log.csv", rows, COLUMNS)
    if is_taken:
        assert first_attitude(log, "level") == UNIT
    else:
        assert "do not show gravity alone" in sentence(log, "level")


def test_level_is_by_the_first_second_alone(tmp_path):
    """Its end included; then the body may tip over and turn."""
    rows = [(k * 10_000_000, 0, 0, 0, 0, 0, G) for k in range(100)]
    rows += [(1_000_000_000, 0, 0, 0, 0, 0.5, G)]
    rows += [(k * 10_000_000, 3 * (-1) ** k, 0, 0, G, 0, 0) for k in range(101, 200)]
    q0 = first_attitude(write_rates(tmp_path / "log.csv", rows, COLUMNS), "level")
    assert geodesic_angle(q0, exp([math.atan2(0.5 / 101, G), 0, 0])) < 1e-15


def test_level_of_a_sorted_log_is_that_of_its_earliest_second(log):
    """Gravity is averaged from the earliest sample on, wherever in the log it is."""
    tipped = [f"{(k - 300) * 10_000_000},0,0,0,0,{G},0\n" for k in range(150)]
    log.write_text(log.read_text() + "".join(tipped))
    q0 = first_attitude(log, "level", "--on-backwards", "sort")
    assert geodesic_angle(q0, [math.sqrt(0.5), math.sqrt(0.5), 0, 0]) < 1e-15


# --- the log's own orientation


def test_the_log_s_own_orientation(shared_logs, tmp_path):
    """--q0 log begins from the orientation in the same messages; --start moves it along."""
    log, own = tmp_path / "husky.bag", tmp_path / "own.csv"
    log.symlink_to(shared_logs / "husky" / "test1_husky.bag")
    run("convert", log, own, "-t", "/imu/data", "--layout", "scalar-first", code=0)
    rows = {line.split(",")[0]: line.split(",")[1:] for line in own.read_text().splitlines()[1:]}
    for options in ((), ("--start", "+100s")):
        q0 = first_attitude(log, "log", *options)
        stamp = log.with_name("out.csv").read_text().splitlines()[1].split(",")[0]
        assert geodesic_angle(q0, [float(q) for q in rows[stamp]]) < 1e-9


def test_a_placeholder_is_no_orientation(tmp_path):
    """Drivers without an estimate leave the identity: it is flagged, and used for nothing."""
    t_ns, flat = T0 + np.arange(50) * 10_000_000, np.tile([1.0, 0, 0, 0], (50, 1))
    log = write_messages(tmp_path / "log.bag", imu_messages(t_ns, [[0.1, 0.2, 0.3]] * 50, flat))
    out = tmp_path / "out.csv"
    flagged = "is the identity in every message: a placeholder, not an attitude"
    for q0 in ("log", "/imu", log, f"{log}:/imu"):
        said = sentence(log, q0)
        assert said.endswith(f"the orientation of '/imu' {flagged}; give another --q0")
        with pytest.raises(QuatpropError, match=f"{flagged}; give another q0$"):
            propagate(log, q0=q0)
    run("propagate", log, "-o", out, code=0)
    for sides in ((out, log), (log, out)):
        assert flagged in refused("compare", *sides)
    assert f"it {flagged}" in run("info", log).stdout
    # One that is not level for a while is an estimate.
    flat[-1] = 0.8, 0, 0, 0.6
    log = write_messages(tmp_path / "tilted.bag", imu_messages(t_ns, (), flat))
    assert first_attitude(log, "log") == UNIT


@pytest.mark.parametrize("q0", ["log", "/imu"])
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_the_orientation_of_a_split_recording_is_that_of_all_its_parts(tmp_path, q0):
    """The attitude is also found if it stands in the second part."""
    t_ns = T0 + np.arange(60) * 10_000_000
    wxyz = propagate(GyroSeries(t_ns, np.tile([0.1, 0.2, 0.3], (60, 1)))).wxyz
    names = [tmp_path / "1.bag", tmp_path / "2.bag"]
    for name, rows in zip(names, (slice(30), slice(30, None)), strict=True):
        own = wxyz[rows].copy()
        rate = np.tile([0.1, 0.2, 0.3], (30, 1))
        write_messages(name, imu_messages(t_ns[rows], rate, own))
    for start in (15, 45):
        found = propagate(names, q0=q0, start=int(t_ns[start]))
        assert geodesic_angle(found.wxyz[0], wxyz[start]) < 1e-12


def camera(name, up, *, is_marked):
    """Return messages of a camera whose gyroscope and accelerometer have topics of their own."""
    gyro, accel = (T0 + 500 * k + np.arange(count) * 10**9 // rate for k, count, rate in CAMERA)
    noise = np.random.default_rng(1).normal(1e-3, 1e-4, (len(gyro), 3))
    absent = np.array([-1.0, *[0.0] * 8])
    marks = {"linear_acceleration_covariance": absent} if is_marked else {}
    yield from (
        (f"{name}/gyro/sample", *message) for _, *message in imu_messages(gyro, noise, **marks)
    )
    marks = {"angular_velocity_covariance": absent} if is_marked else {}
    forces = [(G * np.array(up)).tolist()] * len(accel)
    yield from (
        (f"{name}/accel/sample", *message)
        for _, *message in imu_messages(accel, linear_acceleration=forces, **marks)
    )


CAMERA = (0, 800, 200), (1, 250, 63)
"""Topic, number of messages, rate in Hz."""


@pytest.mark.thorough
@pytest.mark.parametrize("is_marked", [False, True])
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_level_is_read_from_the_accelerometer_of_another_topic(tmp_path, suffix, is_marked):
    """As cameras publish it; of several, from that of the same camera."""
    up = np.array([[0.6, 0.0, 0.8], [0.0, 0.8, 0.6]])
    both = [
        *camera("/d400", up[0], is_marked=is_marked),
        *camera("/t265", up[1], is_marked=is_marked),
    ]
    both = sorted(both, key=lambda message: message[2])
    log = write_messages(tmp_path / f"log.{suffix}", both)
    for name, felt in zip(("/d400", "/t265"), up, strict=True):
        gyro = f"{name}/gyro/sample"
        remark = (
            f"accelerations are those of '{name}/accel/sample', whose axes are assumed to be "
            f"those of '{gyro}'"
        )
        with pytest.warns(RemarkWarning, match=remark):
            found = propagate(log, topic=gyro, q0="level", bias="static")
        assert found.report.correction.rest.steady == ("rate", "accelerometer")
        np.testing.assert_allclose(rotate(conjugate(found.wxyz[0]), [0, 0, 1]), felt, atol=1e-12)
    # Of an accelerometer that is as near as another, neither is used.
    names = {"/d400/gyro/sample": "/gyro"}
    both = [(names.get(name, name), *message) for name, *message in both]
    log = write_messages(tmp_path / f"renamed.{suffix}", both)
    assert "accelerations" in sentence(log, "level", "-t", "/gyro")


def test_a_log_without_an_orientation_next_to_its_rates_says_what_to_give(shared_logs, tmp_path):
    """Topics of attitudes without rates are no way out, since the rates have their own topic."""
    log = tmp_path / "log.ulg"
    log.symlink_to(shared_logs / "ulog" / "sample.ulg")
    assert sentence(log, "log") == (
        f"Error: {log}: there is no orientation next to the rates of 'sensor_combined/0'; give "
        "another --q0, such as a file of attitudes"
    )


# --- another series


@pytest.mark.parametrize(("option", "first_ns"), [("nonfinite", 10), ("backwards", -50)])
def test_the_attitude_is_that_of_the_first_sample_used(option, first_ns, tmp_path):
    """Samples that timestamp handling drops or moves do not determine the start."""
    rows = {
        "nonfinite": ["0,nan,0,0", "10,0,0,0", "20,0,0,0"],
        "backwards": ["0,0,0,0", "10,0,0,0", "20,0,0,0", "-50,0,0,0"],
    }[option]
    log, other = write_rates(tmp_path / "log.csv", rows), tmp_path / "other.csv"
    t = np.arange(-60, 61, 10)
    write_attitudes(other, t, exp(np.radians(t)[:, None] * [0, 0, 1.0]))
    choice = "drop" if option == "nonfinite" else "sort"
    q0 = first_attitude(log, other, f"--on-{option}", choice)
    assert geodesic_angle(q0, exp([0, 0, np.radians(first_ns)])) < 1e-15


@pytest.mark.parametrize("order", [1, -1])
def test_the_attitudes_next_to_the_first_sample_count_wherever_they_stand(log, order):
    """Each row is read by itself here, and behind the two come others, in whatever order."""
    t = np.arange(-45, 50, 10)[::order]
    other, wxyz = log.with_name("other.parquet"), exp(np.radians(abs(t))[:, None] * [0, 0, 1.0])
    columns = {"t_ns": t, **dict(zip(("qw", "qx", "qy", "qz"), wxyz.T, strict=True))}
    pd.DataFrame(columns).to_parquet(other, row_group_size=1)
    assert geodesic_angle(first_attitude(log, other), exp([0, 0, np.radians(5)])) < 1e-15


CLOCK = "are both on the same clock?"


@pytest.mark.parametrize(
    ("from_s", "to_s", "said"),
    [
        (-5, 5, None),
        (-5, 7200, "gap of 7205 s between its attitudes; interpolation reaches over at most 10 s"),
        (-9, -8, f"8 s before the first sample that is used (-8000000000 and 0 ns); {CLOCK}"),
        (15, 16, f"{CLOCK} If so, begin there with --start 15000000000"),
        (10**9, 10**9 + 1, f"used (1000000000000000000 and 0 ns); {CLOCK}"),
    ],
)
def test_a_series_must_reach_the_first_sample(log, from_s, to_s, said):
    """Attitudes that are hours apart say nothing of the time between; 10 s are bridged."""
    t_ns = [from_s * 10**9, to_s * 10**9]
    other = write_attitudes(log.with_name("other.csv"), t_ns, [UNIT, UNIT])
    if said is None:
        assert first_attitude(log, other) == UNIT
    else:
        assert sentence(log, other).endswith(said)


@pytest.mark.parametrize("option", ["--q0", "--at"])
def test_what_is_not_declared_of_a_series_is_said_to_convert(log, option):
    """Propagate has no options about the attitudes of another file, and names none as its own."""
    other = log.with_name("other.npy")
    np.save(other, np.arange(10.0).reshape(2, 5))
    assert refused("propagate", log, "-o", log.with_name("out.csv"), option, other).endswith(
        "name the columns with --quat-cols, --from-layout and --time-col of quatprop convert"
    )


def test_q0_is_the_attitude_of_a_topic_of_the_log(tmp_path):
    """Interpolated at the first sample that is used, as from a file; the report names the topic."""
    coning, alone, out = SAMPLE_LOGS / "coning.mcap", tmp_path / "alone.mcap", tmp_path / "out.csv"
    run("propagate", coning, "-o", alone, "--method", "coning", code=0)
    both = join_mcap(tmp_path / "both.mcap", coning, alone)
    run("propagate", both, "-o", tmp_path / "whole.csv", "-t", "/imu", "--method", "coning")
    options = ("propagate", both, "-o", out, "-t", "/imu", "--start", "+5s")
    assert ", from /attitude" in run(*options, "--q0", "/attitude", code=0).stderr
    whole, found = ((tmp_path / name).read_text().splitlines() for name in ("whole.csv", "out.csv"))
    first, expected = (np.loadtxt([row], delimiter=",") for row in (found[1], whole[501]))
    np.testing.assert_allclose(first, expected, rtol=0, atol=1e-15)
    config = tmp_path / "a.toml"
    config.write_text('q0 = "/attitude"\n')
    run(*options, "--config", config, code=0)
    assert out.read_text().splitlines() == found


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::quatprop.base.errors.QuatpropWarning")
@pytest.mark.parametrize("spelled", ["{path}", "{folder}/./{name}"])
@pytest.mark.parametrize("suffix", ["mcap", "bag"])
def test_losses_of_the_log_are_told_once_if_q0_names_its_file(tmp_path, suffix, spelled):
    """They were listed twice: of the log, and of the file next to it, which it is."""
    stamps = 10**18 + np.arange(2000) * 10**7
    attitudes = np.tile([0.8, 0.0, 0.0, 0.6], (2000, 1))
    messages = [
        (topic, kind, t_ns, values)
        for _, kind, t_ns, values in imu_messages(stamps, wxyz=attitudes)
        for topic in ("/imu", "/pose")
    ]
    path = write_messages(tmp_path / f"log.{suffix}", messages)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    named = spelled.format(path=path, folder=tmp_path, name=path.name)
    alone = propagate(path, topic="/imu").report.losses
    assert alone
    assert propagate(path, topic="/imu", q0=f"{named}:/pose").report.losses == alone
    other = tmp_path / f"other.{suffix}"
    other.write_bytes(path.read_bytes())
    with_other = propagate(path, topic="/imu", q0=f"{other}:/pose").report.losses
    assert with_other[: len(alone)] == alone
    assert [loss.place for loss in with_other[len(alone) :]] == [
        f"{other}, {loss.place}" for loss in alone
    ]


# --- where z points


@pytest.mark.parametrize("tilt", [(0.2, -0.1), (-0.7, 0.4)])
@pytest.mark.parametrize("kind", ["ulg", "csv"])
@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_level_of_px4_is_relative_to_north_east_down(tmp_path, tilt, kind):
    """Its body and reference have z down by type; a roll of 180 deg was added, unsaid."""
    truth = turned(*tilt, 0.0)
    force = rotate(conjugate(truth), [0, 0, -G])
    stamps = 1_000_000 + np.arange(300) * 5_000
    if kind == "ulg":
        felt = [
            ulog.data("sensor_combined", 7, timestamp=t, accelerometer_m_s2=force)
            for t in stamps.tolist()
        ]
        path = ulog.write(tmp_path / "log.ulg", ulog.added("sensor_combined", 0, 7), *felt)
    else:
        names = [f"{name}[{k}]" for name in ("gyro_rad", "accelerometer_m_s2") for k in range(3)]
        rows = [(t, 1e-3 * (k % 2), 0, 0, *force) for k, t in enumerate(stamps.tolist())]
        path = write_rates(tmp_path / "log.csv", rows, ",".join(["timestamp", *names]))
    found = propagate(path, q0="level", earth_rate=47)
    assert geodesic_angle(found.wxyz[0], truth) < 1e-6
    assert found.report.convention.q0_from == "level, reference z down, heading 0 deg"
    assert found.report.convention.earth_rate_rad_s[2] < 0
    assert propagate(path, earth_rate=47).report.convention.q0_from == "identity"
    up = propagate(path, q0="level", reference_z="up")
    assert geodesic_angle(up.wxyz[0], multiply([0, 1, 0, 0], truth)) < 1e-6
    # Another body has other axes, such as forward, left, up.
    mounted = propagate(path, q0="level", mount="x,-y,-z")
    assert mounted.report.convention.q0_from == "level, reference z up, heading 0 deg"
    assert geodesic_angle(mounted.wxyz[0], turned(tilt[0], -tilt[1], 0.0)) < 1e-6


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize(("given", "is_said"), [({}, True), ({"reference_z": "up"}, False)])
def test_a_level_start_upside_down_is_remarked_on_unless_z_is_given(tmp_path, given, is_said):
    """Of FRD axes, and of an iPhone, whose accelerations at rest point down."""
    force = rotate(conjugate(turned(0.3, -0.2, 0)), [0, 0, -1])
    rows = [(k * 10**7, 1e-3 * (k % 2), 0, 0, *force) for k in range(200)]
    log = write_rates(tmp_path / "log.csv", rows, COLUMNS)
    found = propagate(log, q0="level", rate_unit="rad/s", **given)
    said = [str(one) for one in found.report.remarks if one.code == "level-upside-down"]
    assert len(said) == is_said
    mended = propagate(log, q0="level", rate_unit="rad/s", reference_z="down")
    assert geodesic_angle(mended.wxyz[0], turned(0.3, -0.2, 0)) < 1e-12
    out = log.with_name("out.csv")
    said = run("propagate", log, "-o", out, "--q0", "level", "--rate-unit", "rad/s").stderr
    assert re.search(r"heading 0 deg: yaw 0, pitch 11\.459, roll -162\.811 deg\n", said)
