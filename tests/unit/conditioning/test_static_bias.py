"""``--bias static``: rest is found by rate, accelerometer and orientation; motion is no rest."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from quatprop import propagate
from quatprop.cli.commands import cli
from quatprop.conditioning import window_sums

G = 9.80665
BIAS = np.array([0.01, -0.02, 0.005])
RATE = "t_ns,wx,wy,wz"
FORCE = ",accel_x,accel_y,accel_z"
ORIENTATION = ",qw,qx,qy,qz"
HZ = 100


def static(path, *options, window="static"):
    """Run with --bias static; return the result and what the report says of the conditioning."""
    out = path.parent / "out.csv"
    options = ("-o", out, "--bias", window, "--report", "-", *options)
    result = CliRunner().invoke(cli, ["propagate", *map(str, (path, *options))])
    told = json.loads(result.stdout)["conditioning"] if result.exit_code == 0 else None
    return result, told


class Motion:
    """A body that turns at given rates, one after the other, with the sensors it carries.

    Parameters
    ----------
    periods
        Seconds, and the true body rate, rad/s.
    """

    def __init__(self, *periods):
        self.rate = np.concatenate([np.tile(rate, (s * HZ, 1)) for s, rate in periods])
        attitude, attitudes = Rotation.from_euler("x", 0.3), []
        for s, rate in periods:
            time = np.arange(s * HZ + 1)[:, None] / HZ
            turned = attitude * Rotation.from_rotvec(time * rate)
            attitudes.append(turned[:-1])
            attitude = turned[-1]
        self.attitude = Rotation.concatenate(attitudes)
        self.random = np.random.default_rng(1)

    def noise(self, scale, width=3):
        """Return white noise for every sample."""
        return self.random.normal(0, scale, (len(self.rate), width))

    def write(self, folder, *, force=None, orientation=None):
        """Write a table with rates, and what else is given; return its path."""
        columns = [self.rate + BIAS + self.noise(1e-3)]
        header = RATE
        if force is not None:
            header, columns = header + FORCE, [*columns, force]
        if orientation is not None:
            header, columns = header + ORIENTATION, [*columns, orientation]
        path = folder / "log.csv"
        stamps = np.arange(len(self.rate)) * (1_000_000_000 // HZ)
        rows = np.concatenate(columns, axis=1).tolist()
        lines = [f"{t},{','.join(map(repr, row))}" for t, row in zip(stamps, rows, strict=True)]
        path.write_text("\n".join([header, *lines, ""]))
        return path

    @property
    def gravity(self):
        """What an accelerometer feels of gravity, with noise."""
        return self.attitude.inv().apply([0, 0, G]) + self.noise(0.02)

    @property
    def wxyz(self):
        """The true attitude with a little noise, as an estimator in the log would have it."""
        noisy = self.attitude * Rotation.from_rotvec(self.noise(1e-3))
        return noisy.as_quat(scalar_first=True)


def test_the_static_bias_is_that_of_the_rest(tmp_path):
    """The rest is found, its mean subtracted, and both are reported, with what was searched."""
    noise = np.random.default_rng(1).normal(0, 1e-4, (2000, 3))
    rate = np.array([0.01, -0.02, 0.03]) + noise
    rate[:500, 2] += 1.0 + np.sin(np.arange(500))
    path = tmp_path / "log.csv"
    rows = [f"{k * 10_000_000},{x},{y},{z}\n" for k, (x, y, z) in enumerate(rate.tolist())]
    path.write_text(RATE + "\n" + "".join(rows))
    result, told = static(path, "--end", "+4s")
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
    ) in result.stderr


@pytest.mark.parametrize("sensors", ["rate", "accelerometer", "orientation"])
def test_rest_that_only_the_rates_show_is_remarked_on(sensors, tmp_path):
    """A body that turns steadily all along has the same rates."""
    motion, known = Motion((20, [0.0, 0.0, 0.0])), {}
    if sensors == "accelerometer":
        known = {"force": motion.gravity}
    if sensors == "orientation":
        known = {"orientation": motion.wxyz}
    log = motion.write(tmp_path, **known)
    result, told = static(log)
    remark = (
        "no accelerometer and no orientation confirms the rest from which the bias is taken: a "
        f"steady rotation at {np.degrees(np.linalg.norm(BIAS)):.2f} deg/s would look the same"
    )
    is_alone = sensors == "rate"
    assert told["rest"]["steady"] == ["rate"] if is_alone else ["rate", sensors]
    assert (f"warning: {remark}\n" in result.stderr) == is_alone
    assert (remark in told["remarks"]) == is_alone


def test_motion_is_not_taken_for_rest(tmp_path):
    """A log that moves throughout has no bias to give, and says how far it is from rest."""
    path = tmp_path / "log.csv"
    rows = [f"{k * 10_000_000},{np.sin(k)},0,0\n" for k in range(500)]
    path.write_text(RATE + "\n" + "".join(rows))
    result, _ = static(path)
    assert result.exit_code == 2
    assert "the log has no period of rest to take the bias from (the quietest scatters by 0.7" in (
        result.stderr
    )


@pytest.mark.parametrize(
    "sensors", ["rate", "rate,accelerometer", "rate,accelerometer,orientation"]
)
@pytest.mark.parametrize("turn", [2.0, 5.0, 30.0])
@pytest.mark.parametrize("rest_first", [True, False])
def test_a_steady_turn_is_not_rest(turn, rest_first, sensors, tmp_path):
    """Three seconds of rest beside ten of a steady turn: the bias is that of the rest."""
    periods = [(3, np.zeros(3)), (10, np.array([0, 0, np.radians(turn)]))]
    motion = Motion(*(periods if rest_first else periods[::-1]))
    path = motion.write(
        tmp_path,
        force=motion.gravity if "accelerometer" in sensors else None,
        orientation=motion.wxyz if "orientation" in sensors else None,
    )
    result, told = static(path)
    assert result.exit_code == 0, result.output
    assert told["bias_rad_s"] == pytest.approx(BIAS.tolist(), abs=3e-4)
    assert told["rest"]["samples"] == 300
    assert told["rest"]["steady"] == sensors.split(",")


def test_a_log_that_turns_fast_all_along_has_no_rest(tmp_path):
    """A car that circles at 14 deg/s is steady, but no gyroscope has such a bias."""
    result, _ = static(Motion((20, np.array([0.0, 0.0, 0.246]) - BIAS)).write(tmp_path))
    assert result.exit_code == 2
    assert (
        "the steadiest period of the log has a mean rate of 0.246 rad/s, more than the bias of a "
        "gyroscope: the body turns; give --bias X,Y,Z"
    ) in result.stderr


def test_the_accelerometer_shows_a_steady_tumble(tmp_path):
    """A slow turn about a level axis could be a bias, but gravity changes its direction."""
    motion = Motion((20, np.array([0.08, 0, 0])))
    result, _ = static(motion.write(tmp_path, force=motion.gravity))
    assert result.exit_code == 2
    assert (
        "no period of rest to take the bias from that lasts 1 s (by rate and accelerometer); give "
        "--bias X,Y,Z, or look for a shorter rest with --bias static:DUR"
    ) in result.stderr
    assert static(motion.write(tmp_path))[0].exit_code == 0


def test_the_accelerometer_shows_a_drive(tmp_path):
    """Straight driving does not turn, but shakes: rest is where the specific force is quiet."""
    motion = Motion((30, np.zeros(3)))
    driving = (np.arange(3000) < 2000)[:, None]
    force = motion.gravity + driving * motion.noise(0.4)
    force[:2000, 0] += np.linspace(0, 1, 2000)
    _, told = static(motion.write(tmp_path, force=force))
    assert (told["rest"]["first_ns"], told["rest"]["samples"]) == (20_000_000_000, 1000)


def test_shaking_is_not_rest(tmp_path):
    """A specific force that scatters by a third of gravity is that of a body in motion."""
    motion = Motion((20, np.zeros(3)))
    result, _ = static(motion.write(tmp_path, force=motion.gravity + motion.noise(2.0)))
    assert result.exit_code == 2
    assert "(where the rates are quiet, the specific force scatters by at least 3" in result.stderr
    assert "%: the body moves)" in result.stderr


def test_the_orientation_shows_a_turn_about_the_vertical(tmp_path):
    """What neither rates nor gravity show, the log's own orientation does."""
    up = Rotation.from_euler("x", 0.3).inv().apply([0, 0, 1])
    motion = Motion((20, 0.08 * up))
    path = motion.write(tmp_path, force=motion.gravity, orientation=motion.wxyz)
    result, _ = static(path)
    assert result.exit_code == 2
    assert (
        "(where the rates are steady, the log's own orientation turns by 4.58 deg/s)"
    ) in result.stderr
    # Without it nothing shows the turn, and the bias is taken, which the summary says.
    result, told = static(motion.write(tmp_path, force=motion.gravity))
    assert told["bias_rad_s"] == pytest.approx((0.08 * up + BIAS).tolist(), abs=3e-4)
    assert "steady by rate, accelerometer; the whole log was searched" in result.stderr


@pytest.mark.parametrize("frame", ["body", "inertial"])
@pytest.mark.parametrize("tilt", [0.0, 1.0, 2.0, 3.0])
def test_the_orientation_shows_a_turn_in_the_axes_of_the_rates(tmp_path, frame, tilt):
    """On a tilted body a turn has other numbers in the axes of the reference.

    Of rates in those axes it was taken for rest, and the rotation for the bias.
    """
    motion = Motion((4, [0, 0, 0.08]))
    attitude = Rotation.from_euler("x", tilt) * motion.attitude
    if frame == "inertial":
        motion.rate = attitude.apply(motion.rate)
    path = motion.write(tmp_path, orientation=attitude.as_quat(scalar_first=True))
    result, _ = static(path, "--rates", frame)
    assert result.exit_code == 2
    assert "(where the rates are steady, the log's own orientation turns by 4.58" in result.stderr


def test_an_orientation_that_settles_does_not_hide_rest(tmp_path):
    """Estimators drift and converge at rest; only a turn that the rates have too is a turn."""
    motion = Motion((20, np.zeros(3)))
    drift = Rotation.from_rotvec(np.arange(2000)[:, None] / HZ * np.array([0, 0, 0.05]))
    result, told = static(
        motion.write(
            tmp_path,
            force=motion.gravity,
            orientation=(drift * motion.attitude).as_quat(scalar_first=True),
        )
    )
    assert result.exit_code == 0, result.output
    assert told["bias_rad_s"] == pytest.approx(BIAS.tolist(), abs=3e-4)


def test_the_sign_of_the_orientation_does_not_matter(tmp_path):
    """Some loggers flip q to -q from row to row."""
    motion = Motion((5, np.zeros(3)))
    flipped = motion.wxyz * np.where(np.arange(500) % 2, 1, -1)[:, None]
    _, told = static(motion.write(tmp_path, orientation=flipped))
    assert told["rest"]["samples"] == 500


def test_a_sensor_that_has_not_begun_shows_no_bias(tmp_path):
    """Zeros at the beginning of a log are no measurement."""
    motion = Motion((10, np.zeros(3)))
    motion.rate[:300] = -BIAS
    motion.noise = lambda scale: np.where(
        np.arange(1000)[:, None] < 300, 0, np.random.default_rng(2).normal(0, scale, (1000, 3))
    )
    _, told = static(motion.write(tmp_path))
    assert told["bias_rad_s"] == pytest.approx(BIAS.tolist(), abs=3e-4)


@pytest.mark.parametrize("force", [",,", "nan,nan,nan", "0,0,0", "none,none,none"])
def test_an_accelerometer_that_measures_nothing_shows_nothing(force, tmp_path):
    """Its columns may be empty, NaN, zero or text: rest is then found by the rates alone."""
    path = Motion((5, np.zeros(3))).write(tmp_path)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header + FORCE, *(f"{row},{force}" for row in rows), ""]))
    result, told = static(path)
    assert result.exit_code == 0, result.output
    assert (told["rest"]["samples"], told["rest"]["steady"]) == (500, ["rate"])


@pytest.mark.parametrize("window", ["static:200ms", "static", "static:5s"])
def test_a_car_that_circles_is_not_at_rest(window, shared_logs, tmp_path):
    """The recording of a car on a roundabout: 0.25 rad/s is no bias, however long a rest is."""
    log = tmp_path / "car.csv"
    log.write_bytes((shared_logs / "nested_imu" / "kiran_car_circle_data_0_imu.csv").read_bytes())
    result, _ = static(log, "--rate-unit", "rad/s", "--time-unit", "s", window=window)
    assert result.exit_code == 2
    assert "the body turns; give --bias X,Y,Z" in result.stderr


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
    rest, first_ns = report.conditioning.rest, report.result.first_ns
    assert (rest.first_ns - first_ns) / 1e9 == pytest.approx(begin_s, abs=0.6)
    assert (rest.last_ns - first_ns) / 1e9 == pytest.approx(end_s, abs=0.6)
    assert rest.mean_rad_s == pytest.approx(bias, abs=2e-4)


@pytest.mark.parametrize("block", [100, 1000, 4096])
@pytest.mark.parametrize("seed", range(4))
def test_sums_of_windows_do_not_depend_on_how_rows_arrive(monkeypatch, block, seed):
    """A window that goes on in the next batch has the same sums to the bit."""
    monkeypatch.setattr(window_sums, "BLOCK", block)
    rng = np.random.default_rng(seed)
    t_ns = np.cumsum(rng.integers(1, 2_000_000, 3000))
    values = rng.normal(size=(3000, 3))
    values[rng.random(3000) < 0.01] = np.nan
    whole = window_sums.window_sums([(t_ns, values)], 50_000_000)
    for cuts in ([], [1], [999, 1000, 1001], sorted(rng.integers(0, 3000, 40))):
        rows = zip(np.split(t_ns, cuts), np.split(values, cuts), strict=True)
        parts = window_sums.window_sums(rows, 50_000_000)
        assert parts.tobytes() == whole.tobytes()
