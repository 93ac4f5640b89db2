"""``--bias static``: rest is found by rate, accelerometer and orientation; motion is no rest."""

import json
import re

import numpy as np
import pytest
from make.commands import refused, run
from make.ros import imu_messages, write_messages
from make.tables import write_rates
from scipy.spatial.transform import Rotation

from quatprop import RemarkWarning, propagate
from quatprop.base.errors import LogError, UsageError
from quatprop.propagation.conditioning import static_period

G = 9.80665
BIAS = np.array([0.01, -0.02, 0.005])
HZ = 100
COLUMNS = {
    "rate": "t_ns,wx,wy,wz",
    "accelerometer": "accel_x,accel_y,accel_z",
    "orientation": "qw,qx,qy,qz",
}


def options(log, *more, window="static"):
    """Return a command line with --bias static."""
    return ("propagate", log, "-o", log.with_name("out.csv"), "--bias", window, *more)


def static(log, *more):
    """Run with --bias static; return the messages, and the conditioning in the report."""
    result = run(*options(log, "--report", "-", *more), code=0)
    return result.stderr, json.loads(result.stdout)["correction"]


class Motion:
    """A body that turns at given rates for some seconds each, with the sensors it carries."""

    def __init__(self, *periods):
        self.rate = np.concatenate([np.tile(rate, (s * HZ, 1)) for s, rate in periods])
        steps = Rotation.from_rotvec(self.rate / HZ).as_matrix()
        attitudes = [Rotation.from_euler("x", 0.3).as_matrix()]
        for step in steps[:-1]:
            attitudes.append(attitudes[-1] @ step)
        self.attitude = Rotation.from_matrix(np.array(attitudes))
        self.random = np.random.default_rng(1)

    def noise(self, scale):
        """Return white noise for every sample."""
        return self.random.normal(0, scale, self.rate.shape)

    def known(self, sensors):
        """Return what the sensors measure, by their names."""
        both = {"accelerometer": self.gravity, "orientation": self.wxyz}
        return {name: values for name, values in both.items() if name in sensors}

    def write(self, folder, **sensors):
        """Write a table with rates, and what else is given; return its path."""
        header = ",".join([COLUMNS["rate"], *(COLUMNS[name] for name in sensors)])
        columns = [self.rate + BIAS + self.noise(1e-3), *sensors.values()]
        rows = enumerate(np.concatenate(columns, axis=1).tolist())
        return write_rates(
            folder / "log.csv", [[k * (10**9 // HZ), *row] for k, row in rows], header
        )

    @property
    def gravity(self):
        """The gravity that an accelerometer measures, with noise."""
        return self.attitude.inv().apply([0, 0, G]) + self.noise(0.02)

    @property
    def wxyz(self):
        """The true attitude with a little noise, as an estimator in the log would have it."""
        noisy = self.attitude * Rotation.from_rotvec(self.noise(1e-3))
        return noisy.as_quat(scalar_first=True)


REST = np.zeros(3)
UP = Rotation.from_euler("x", 0.3).inv().apply([0, 0, 1])


def test_the_static_bias_is_that_of_the_rest(tmp_path):
    """The rest is found, its mean subtracted, and both are reported, with what was searched."""
    rate = np.array([0.01, -0.02, 0.03]) + np.random.default_rng(1).normal(0, 1e-4, (2000, 3))
    rate[:500, 2] += 1.0 + np.sin(np.arange(500))
    rows = [[k * 10_000_000, *row] for k, row in enumerate(rate.tolist())]
    said, told = static(write_rates(tmp_path / "log.csv", rows), "--end", "+4s")
    assert told["bias_rad_s"] == pytest.approx(rate[500:].mean(axis=0).tolist(), abs=1e-12)
    rest = told["rest"]
    assert (rest["first_ns"], rest["samples"]) == (5_000_000_000, 1500)
    assert rest["scatter_rad_s"] == pytest.approx(np.sqrt(3) * 1e-4, rel=0.05)
    assert rest["steady"] == ["rate"]
    # The whole log, although a part is propagated in which there is no rest.
    assert (rest["searched_first_ns"], rest["searched_last_ns"]) == (0, 19_990_000_000)
    assert (
        "from 1500 samples at rest over 14.99 s from t = 5000000000 ns, scatter 0.000173 rad/s; "
        "steady by rate; the whole log was searched"
    ) in said


@pytest.mark.parametrize("sensors", [[], ["accelerometer"], ["orientation"]])
def test_rest_that_only_the_rates_show_is_remarked_on(sensors, tmp_path):
    """A body that turns steadily all along has the same rates."""
    motion = Motion((10, REST))
    said, told = static(motion.write(tmp_path, **motion.known(sensors)))
    remark = (
        "no accelerometer and no orientation confirms the stationary period that the bias is "
        f"estimated from: a steady rotation at {np.degrees(np.linalg.norm(BIAS)):.2f} deg/s "
        "would look the same"
    )
    assert told["rest"]["steady"] == ["rate", *sensors]
    assert (f"warning: {remark}\n" in said) == (not sensors)
    assert (remark in told["remarks"]) == (not sensors)


@pytest.mark.parametrize("sensors", [[], ["accelerometer"], ["accelerometer", "orientation"]])
@pytest.mark.parametrize(("turn", "rest_first"), [(2.0, True), (5.0, False), (30.0, True)])
def test_a_steady_turn_is_not_rest(turn, rest_first, sensors, tmp_path):
    """Three seconds of rest and ten of a steady turn: the bias is that of the rest."""
    periods = [(3, REST), (10, np.array([0, 0, np.radians(turn)]))]
    motion = Motion(*(periods if rest_first else periods[::-1]))
    _, told = static(motion.write(tmp_path, **motion.known(sensors)))
    assert told["bias_rad_s"] == pytest.approx(BIAS.tolist(), abs=3e-4)
    assert told["rest"]["samples"] == 300
    assert told["rest"]["steady"] == ["rate", *sensors]


TURNS = (
    "has a mean rate of 0.246 rad/s, more than the bias of a gyroscope: the body rotates; give -"
)
TUMBLES = (
    "no stationary period (where the rates are steady, gravity in the sensor turns by 4.58 deg/s, "
    "as they do); give --bias X,Y,Z"
)
SHAKES = "(where the rates are quiet, the specific force scatters by at least 3"
HEADS = "(where the rates are steady, the log's own orientation turns by 4.58 deg/s, as they do)"


@pytest.mark.parametrize(
    ("rate", "shaking", "sensors", "said"),
    [
        ([0.0, 0.0, 0.246] - BIAS, 0, [], TURNS),
        # A slow turn about a level axis could be a bias, but gravity changes its direction.
        ([0.08, 0, 0], 0, ["accelerometer"], TUMBLES),
        (REST, 2.0, ["accelerometer"], SHAKES),
        # Only the log's own orientation shows a turn about the vertical.
        (0.08 * UP, 0, ["accelerometer", "orientation"], HEADS),
    ],
)
def test_a_steady_motion_all_along_is_no_rest(rate, shaking, sensors, said, tmp_path):
    """One of the sensors shows it; without it the bias is taken, which the summary says."""
    motion = Motion((10, rate))
    known = motion.known(sensors)
    if shaking:
        known["accelerometer"] += motion.noise(shaking)
    assert said in refused(*options(motion.write(tmp_path, **known)))
    if sensors:
        _, told = static(motion.write(tmp_path, **motion.known(sensors[:-1])))
        assert told["bias_rad_s"] == pytest.approx((rate + BIAS).tolist(), abs=3e-4)
        assert told["rest"]["steady"] == ["rate", *sensors[:-1]]


CURVE = re.compile(
    r"warning: ([\d.]+) deg/s of the bias are about the vertical, where the accelerometer does "
    r"not tell a bias from a steady rotation, as of a vehicle in a curve: is the body at rest "
    r"there\?\n"
)


@pytest.mark.parametrize("sensors", [["accelerometer"], ["accelerometer", "orientation"]])
@pytest.mark.parametrize(("turn", "is_said"), [(1.7, False), (3.0, True), (4.0, True), (9.0, True)])
def test_a_steady_turn_about_the_vertical_all_along_is_remarked_on(
    turn, is_said, sensors, tmp_path
):
    """It was the bias, "steady by rate, accelerometer", without a word."""
    motion = Motion((10, np.radians(turn) * UP))
    log = motion.write(tmp_path, **motion.known(sensors))
    if not sensors[1:]:
        found = [float(each) for each in CURVE.findall(static(log)[0])]
        assert found == pytest.approx(is_said * [turn + np.degrees(BIAS @ UP)], abs=0.02)
    elif is_said:
        assert "the log's own orientation turns by" in refused(*options(log))


@pytest.mark.parametrize("tilt", [0, 5, 20, 90])
@pytest.mark.parametrize("turn", [3.0, 8.0])
@pytest.mark.parametrize("rest_s", [0, 4])
def test_gravity_shows_a_steady_turn_about_a_tilted_axis(rest_s, turn, tilt, tmp_path):
    """It was cut where gravity had turned by 0.01 rad, and each part was a rest."""
    axis = Rotation.from_rotvec([0, np.radians(tilt), 0]).apply(UP)
    motion = Motion((rest_s, REST), (40, np.radians(turn) * axis))
    log = motion.write(tmp_path, accelerometer=motion.gravity)
    if rest_s:
        # However long, the turn does not make the rest too short.
        _, told = static(log)
        assert told["bias_rad_s"] == pytest.approx(BIAS.tolist(), abs=3e-4)
        assert told["rest"]["samples"] == 400
        return
    result = run(*options(log))
    # A bias that is larger than the level part of the turn hides it.
    is_shown = turn * np.sin(np.radians(tilt)) > np.degrees(np.linalg.norm(BIAS))
    assert is_shown == (result.exit_code == 2)
    assert is_shown or len(CURVE.findall(result.stderr)) == 1


@pytest.mark.parametrize("way", ["static:nearest", "static:interpolate"])
def test_a_turn_about_the_vertical_is_none_of_several_rests(way, tmp_path):
    """Its rate was subtracted while it lasted, so that the attitude did not turn."""
    shake = np.radians([20, 10, 15])
    periods = [(6, REST), (1, shake), (10, np.radians(5) * UP), (1, shake), (6, REST)]
    motion = Motion(*periods)
    log = motion.write(tmp_path, accelerometer=motion.gravity)
    found = propagate(log, bias=way, rate_unit="rad/s").report.correction
    assert [rest.samples for rest in found.rests] == pytest.approx([600, 600], abs=100)


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize("has_force", [False, True])
@pytest.mark.parametrize("end", [0.0, 1.0])
@pytest.mark.parametrize("filtered", [(0.3, 0.01, 0.01, 1), (3, 0.05, 3e-3, 3), (10, 0.3, 0.01, 8)])
def test_a_filter_that_settles_does_not_hide_a_long_rest(filtered, end, has_force, tmp_path):
    """Its beginning has no noise; by that, the rest was not quiet, and the log was refused."""
    tau, peak, noise, lasts = filtered
    random, t_s = np.random.default_rng(4), np.arange(3000)[:, None] / HZ
    settles = t_s < lasts
    decay = np.exp(-t_s / tau)
    rate = np.where(settles, end * BIAS + peak * decay, BIAS + random.normal(0, noise, (3000, 3)))
    force = np.add([0, 0, G], random.normal(0, 0.15, (3000, 3)))
    force = np.where(settles, [0, 0, G] * (1 - decay / 2), force)
    messages = imu_messages(
        10**18 + np.arange(3000) * 10**7, rate, linear_acceleration=(force * has_force).tolist()
    )
    path = write_messages(tmp_path / "log.mcap", messages)
    correction = propagate(path, bias="static").report.correction
    error = noise / np.sqrt(correction.rest.samples)
    np.testing.assert_allclose(correction.bias_rad_s, BIAS, atol=5 * error)
    assert correction.rest.span_s > 0.9 * (30 - lasts) - 1


def test_motion_is_not_taken_for_rest(tmp_path):
    """A log that moves throughout has no bias to give, and says how far it is from rest."""
    log = write_rates(tmp_path / "log.csv", [(k * 10**7, np.sin(k), 0, 0) for k in range(500)])
    said = refused(*options(log))
    assert f"Error: {log}: no stationary period (the rates scatter by at least 0.7" in said


def test_the_accelerometer_shows_a_drive(tmp_path):
    """Straight driving does not turn, but shakes: rest is where the specific force is quiet."""
    motion = Motion((30, REST))
    driving = (np.arange(3000) < 2000)[:, None]
    force = motion.gravity + driving * motion.noise(0.4)
    force[:2000, 0] += np.linspace(0, 1, 2000)
    _, told = static(motion.write(tmp_path, accelerometer=force))
    assert (told["rest"]["first_ns"], told["rest"]["samples"]) == (20_000_000_000, 1000)


@pytest.mark.parametrize(("share", "is_rest"), [(0.7, False), (0.4, True)])
def test_an_orientation_that_turns_about_as_the_rates_shows_a_turn(tmp_path, share, is_rest):
    """An estimator may lag behind; where it turns by less than half, it drifts."""
    motion = Motion((3, [0, 0, 0.08]))
    motion.attitude = Rotation.from_rotvec(np.arange(300)[:, None] / HZ * [0, 0, 0.08 * share])
    log = motion.write(tmp_path, orientation=motion.wxyz)
    assert ("orientation turns by 3.2" in run(*options(log)).stderr) == (not is_rest)


@pytest.mark.parametrize("count", [0, 20])
def test_an_orientation_that_is_hardly_there_shows_no_turn(tmp_path, count):
    """It was recorded for less than two windows of a rest."""
    motion = Motion((3, REST))
    wxyz = np.where(np.arange(300)[:, None] < count, motion.wxyz, np.nan)
    _, told = static(motion.write(tmp_path, orientation=wxyz))
    assert told["rest"]["samples"] == 300


@pytest.mark.parametrize("frame", ["body", "inertial"])
@pytest.mark.parametrize("tilt", [0.0, 2.0])
def test_the_orientation_shows_a_turn_in_the_axes_of_the_rates(tmp_path, frame, tilt):
    """Of rates in the axes of the reference a turn was taken for rest, and for the bias."""
    motion = Motion((1, [0, 0, 0.08]))  # two windows
    attitude = Rotation.from_euler("x", tilt) * motion.attitude
    if frame == "inertial":
        motion.rate = attitude.apply(motion.rate)
    log = motion.write(tmp_path, orientation=attitude.as_quat(scalar_first=True))
    assert ("(where the rates are steady, the log's own orientation turns by 4.5") in refused(
        *options(log, "--rates", frame)
    )


def test_an_orientation_that_settles_or_changes_its_sign_does_not_hide_rest(tmp_path):
    """Estimators drift and converge at rest, and some loggers flip q to -q from row to row."""
    motion = Motion((10, REST))
    drift = Rotation.from_rotvec(np.arange(1000)[:, None] / HZ * np.array([0, 0, 0.05]))
    settling = (drift * motion.attitude).as_quat(scalar_first=True)
    flipped = motion.wxyz * np.where(np.arange(1000) % 2, 1, -1)[:, None]
    for wxyz in (settling, flipped):
        log = motion.write(tmp_path, accelerometer=motion.gravity, orientation=wxyz)
        _, told = static(log)
        assert told["bias_rad_s"] == pytest.approx(BIAS.tolist(), abs=3e-4)
    assert told["rest"]["samples"] == 1000


def test_a_damaged_rate_hides_no_rest(tmp_path):
    """Its square is infinite, of which NumPy warned; without a rest, the least scatter was nan."""
    body = Motion((3, [0, 0, 0]), (3, [0, 0.5, 0]))
    body.rate[450] = 1e200
    _, conditioning = static(body.write(tmp_path), "--end", "+4s")
    np.testing.assert_allclose(conditioning["bias_rad_s"], BIAS, atol=3e-4)
    body.rate += body.noise(5)
    words = refused(*options(body.write(tmp_path), "--end", "+4s"))
    assert re.search(r"\(the rates scatter by at least [78]\.\d+ rad/s\)", words)


def test_an_accelerometer_that_is_named_has_to_be_there(tmp_path):
    """Without its name, whatever is wrong with it, rest is found by the rates."""
    log = Motion((5, REST)).write(tmp_path)
    with pytest.raises(UsageError, match="accel_cols asks for column 'a'"):
        propagate(log, bias="static", accel_cols="a,b,c")


def test_accelerations_that_are_no_numbers_are_done_without(tmp_path):
    """Rest is that of the rates then; where they are named, they are missed."""
    rows = [(10_000_000 * k, 0.001 * (k % 2), 0, 0, "no", "no", "no") for k in range(300)]
    log = write_rates(tmp_path / "log.csv", rows, "t_ns,wx,wy,wz,ax,ay,az")
    with pytest.warns(RemarkWarning, match="no accelerometer and no orientation confirms"):
        assert len(propagate(log, bias="static:1s")) == 300
    with pytest.raises(LogError, match="'no' in column 'ax' is not a number"):
        propagate(log, bias="static:1s", accel_cols="ax,ay,az")


@pytest.mark.parametrize("force", [",,", "nan,nan,nan", "0,0,0", "none,none,none"])
def test_an_accelerometer_that_measures_nothing_shows_nothing(force, tmp_path):
    """Its columns may be empty, NaN, zero or text: rest is then found by the rates alone."""
    log = Motion((5, REST)).write(tmp_path)
    head, *rows = log.read_text().splitlines()
    write_rates(log, [f"{row},{force}" for row in rows], f"{head},{COLUMNS['accelerometer']}")
    _, told = static(log)
    assert (told["rest"]["samples"], told["rest"]["steady"]) == (500, ["rate"])


@pytest.mark.parametrize("window", ["static:200ms", "static", "static:5s"])
def test_a_car_that_circles_is_not_at_rest(window, shared_logs, tmp_path):
    """The recording of a car on a roundabout: 0.25 rad/s is no bias, however long a rest is."""
    log = tmp_path / "car.csv"
    log.symlink_to(shared_logs / "nested_imu" / "kiran_car_circle_data_0_imu.csv")
    more = ("--rate-unit", "rad/s", "--time-unit", "s")
    said = refused(*options(log, *more, window=window))
    assert "the body rotates; give --bias X,Y,Z" in said


RESTS = {
    "auk/auk.bag": (0.0, 10.0, [-0.0002, -0.0006, -0.0003]),
    "husky/test1_husky.bag": (237.5, 246.5, [-0.0001, -0.0003, -0.0001]),
    "irregular/tilt_laser.bag": (0.0, 17.75, [-0.0084, -0.0072, -0.0056]),
    "ulog/sample.ulg": (7.0, 68.9, [-0.0013, -0.0021, -0.0028]),
    "csv/euroc_v102/imu0_data.csv": (2.0, 4.0, [-0.0019, 0.0188, 0.0775]),
    "csv/xio_fusion_degs.csv": (117.5, 135.4, [0.0001, -0.0001, 0.0]),
}
"""Where recordings rest, s from the beginning, found by eye in rates and accelerometers; bias."""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", RESTS)
def test_the_rest_of_recordings(name, shared_logs):
    """The rest of a drone whose motors run, of a parked robot, of one before its flight."""
    begin_s, end_s, bias = RESTS[name]
    report = propagate(shared_logs / name, bias="static").report
    rest, first_ns = report.correction.rest, report.result.first_ns
    assert (rest.first_ns - first_ns) / 1e9 == pytest.approx(begin_s, abs=0.6)
    assert (rest.last_ns - first_ns) / 1e9 == pytest.approx(end_s, abs=0.6)
    assert rest.mean_rad_s == pytest.approx(bias, abs=2e-4)


@pytest.mark.parametrize("block", [100, 1000, 4096])
def test_sums_of_windows_do_not_depend_on_how_rows_arrive(monkeypatch, block):
    """A window that goes on in the next batch has the same sums to the bit."""
    monkeypatch.setattr(static_period, "BLOCK", block)
    rng = np.random.default_rng(block)
    t_ns = np.cumsum(rng.integers(1, 2_000_000, 3000))
    values = rng.normal(size=(3000, 3))
    values[rng.random(3000) < 0.01] = np.nan
    whole = static_period.window_sums([(t_ns, values)], 50_000_000)
    finite = values[np.isfinite(values).all(axis=1)]
    assert whole["count"].sum() == len(finite)
    np.testing.assert_allclose(whole["total"].sum(axis=0), finite.sum(axis=0), atol=1e-12)
    np.testing.assert_allclose(whole["squares"].sum(axis=0), (finite**2).sum(axis=0), rtol=1e-12)
    for cuts in ([], [1], [999, 1000, 1001], sorted(rng.integers(0, 3000, 40))):
        rows = zip(np.split(t_ns, cuts), np.split(values, cuts), strict=True)
        parts = static_period.window_sums(rows, 50_000_000)
        assert parts.tobytes() == whole.tobytes()
