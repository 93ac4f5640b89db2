"""Every defect put into a recording is remarked on once, and nothing else is."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from make.mistakes import Recording
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

import quatprop
from quatprop.cli.commands import cli
from quatprop.pipeline.rate_checks import RateChecks
from quatprop.series import GyroSeries
from quatprop.timeline.counts import Counts

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
IMU = "sensor_msgs/msg/Imu"
START_NS = 1_700_000_000_000_000_000
UNKNOWN = np.array([-1.0] + [0.0] * 8)
"""The covariance of an orientation that is not estimated, by the definition of the message."""


def write_imu(path, t_ns, rate, wxyz, *, stamps=None, covariance=None):  # noqa: PLR0913
    """Write Imu messages as an MCAP file, recorded at their times."""
    vector, zeros = TYPES["geometry_msgs/msg/Vector3"], np.zeros(9)
    stamps = t_ns if stamps is None else stamps
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channel = writer.register_channel(
            "/imu", "cdr", writer.register_schema(IMU, "ros2msg", b"")
        )
        for at, stamp, (x, y, z), (qw, qx, qy, qz) in zip(
            t_ns.tolist(), stamps.tolist(), rate.tolist(), wxyz.tolist(), strict=True
        ):
            time = TYPES["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            message = TYPES[IMU](
                TYPES["std_msgs/msg/Header"](time, "imu"),
                TYPES["geometry_msgs/msg/Quaternion"](qx, qy, qz, qw),
                zeros if covariance is None else covariance,
                vector(x, y, z),
                zeros,
                vector(0.0, 0.0, 9.8),
                zeros,
            )
            writer.add_message(channel, at, bytes(STORE.serialize_cdr(message, IMU)), at)
        writer.finish()
    return path


def remarks_of(path):
    """Return what info says of the rates and the attitudes of a log."""
    result = CliRunner().invoke(cli, ["info", str(path), "--json"])
    assert result.exit_code == 0, result.output
    (log,) = json.loads(result.stdout)
    signals = [*log["sources"], *log["attitudes"]]
    said = [[*signal["remarks"], signal["missing"]] for signal in signals]
    return [remark for one in said for remark in one if remark]


def saturated(rate):
    """Return rates of a body twice as fast, clipped at 0.6 of the largest, and then calibrated."""
    largest = 1.2 * np.abs(rate).max()
    clipped = np.clip(2 * rate, -largest, largest)
    calibration = [[1.01, 0.012, -0.008], [0.009, 0.99, 0.011], [-0.01, 0.007, 1.02]]
    noise = np.random.default_rng(1).normal(0, 2e-3, rate.shape)
    return clipped @ np.transpose(calibration) + [0.01, -0.02, 0.015] + noise


@pytest.fixture(scope="module", params=["xio3", "xsens-txt"])
def recording(request, shared_logs):
    """Return times, rates and attitudes of a recording."""
    found = Recording(shared_logs, request.param)
    t_ns = found.t_ns - found.t_ns[0] + START_NS
    return t_ns, found.rate, found.reference.wxyz


def slow(t_ns, rate, wxyz):
    """Return every 16th sample."""
    return t_ns[::16], rate[::16], wxyz[::16]


@pytest.mark.parametrize(
    ("defect", "remark"),
    [
        ("none", ""),
        ("saturated", "of its extreme of"),
        ("held", "67 % of the rows repeat the row before while the body turns: the log re"),
        ("slow", "the sample rate is too low for this motion"),
        ("whole seconds", "the timestamps are whole seconds"),
        ("zero stamps", "all header stamps of topic '/imu' are zero"),
        ("identity", "it is the identity in every message: a placeholder, not an attitude"),
        ("covariance", ""),
    ],
)
def test_each_defect_of_a_recording_is_remarked_on_once(recording, tmp_path, defect, remark):
    """One defect gives one remark on each axis side, and none of the other remarks."""
    t_ns, rate, wxyz = recording
    options = {}
    match defect:
        case "saturated":
            rate = saturated(rate)
            # The orientation is that of the slower body.
            options["covariance"] = UNKNOWN
        case "held":
            rate = rate[np.arange(len(rate)) // 3 * 3]
        case "slow":
            t_ns, rate, wxyz = slow(t_ns, rate, wxyz)
        case "whole seconds":
            options["stamps"] = t_ns // 10**9 * 10**9
        case "zero stamps":
            options["stamps"] = np.zeros_like(t_ns)
        case "identity":
            wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (len(t_ns), 1))
        case "covariance":
            options["covariance"] = UNKNOWN
    said = remarks_of(write_imu(tmp_path / "log.mcap", t_ns, rate, wxyz, **options))
    if defect == "whole seconds":
        said = [one for one in said if "repeated timestamps" not in one]
    if not remark:
        assert said == []
        return
    assert all(remark in one for one in said), said
    # Each side of an axis may be saturated; without stamps neither signal can be read.
    assert len(said) == {"zero stamps": 2, "saturated": len(set(said)) or 1}.get(defect, 1)


def remarks(rate, step_ns=5_000_000):
    """Return the remarks on rates at regular times."""
    checks, t_ns = RateChecks(), np.arange(len(rate)) * step_ns
    list(checks.observe([GyroSeries(t_ns, np.asarray(rate, dtype=np.float64))]))
    counts = Counts(used=len(rate), first_ns=0, last_ns=int(t_ns[-1]), median_dt_ns=step_ns)
    return list(map(str, checks.remarks(counts)))


def swinging(samples=20_000, peak=5.0):
    """Return rates of a body that swings, with noise."""
    t_s = np.arange(samples)[:, None] * 0.005
    noise = np.random.default_rng(3).normal(0, 5e-3, (samples, 3))
    return peak * np.sin(t_s * [3.1, 4.7, 2.3] + [0, 1, 2]) + noise


def test_peaks_of_a_swinging_body_are_no_saturation():
    """All peaks of a sine are equal, and it dwells there, but smoothly."""
    assert remarks(swinging()) == []


def test_a_steady_rotation_between_others_is_no_saturation():
    """A turntable that is switched on and off stays at one rate for long."""
    on = (np.arange(20_000) // 2000 % 2)[:, None] * [0, 0, 3.0]
    assert remarks(on + np.random.default_rng(4).normal(0, 2e-3, on.shape)) == []


def test_held_samples_at_an_extreme_are_no_saturation():
    """Three rows of one held sample are one sample."""
    rate = swinging()[np.arange(20_000) // 4 * 4]
    (said,) = remarks(rate)
    assert said == (
        "75 % of the rows repeat the row before while the body turns: the log repeats samples, "
        "with a new rate only every 4 rows"
    )


def test_held_samples_do_not_hide_saturation():
    """A sensor may be read too often and be saturated as well."""
    held, *others = remarks(np.clip(swinging()[np.arange(20_000) // 4 * 4], -4, np.inf))
    assert held.startswith("75 % of the rows repeat the row before")
    assert [one.split(" rad/s")[0] for one in others] == [
        f"axis -{axis} stays at its extreme of -4" for axis in "xyz"
    ]


def test_a_resting_sensor_that_repeats_its_steps_is_not_held():
    """At rest, a coarse sensor shows the same step again and again."""
    steps = np.random.default_rng(5).integers(-1, 2, (5000, 3)) * 1e-3
    assert remarks(np.where(np.random.default_rng(6).random((5000, 1)) < 0.3, 0.0, steps)) == []


def test_a_car_sampled_once_a_second_is_too_slow():
    """Steps of few degrees, each of another rate: what lies between them is unknown."""
    rng = np.random.default_rng(7)
    rate = np.cumsum(rng.normal(0, 0.1, (20_000, 3)), axis=0) * [0, 0, 1]
    rate = 0.2 * np.sin(rate)
    (said,) = remarks(rate[::50], step_ns=1_000_000_000)
    assert said.endswith("deg in the time between them: the sample rate is too low for this motion")
    assert remarks(rate, step_ns=20_000_000) == []


def test_whole_seconds_are_not_fast_motion(tmp_path):
    """Of 100 samples to a second, none is taken to last a second."""
    path = tmp_path / "log.csv"
    rows = [f"{1_700_000_000 + k // 100},{3 + 0.1 * (k % 7)},0,0.1" for k in range(1000)]
    path.write_text("t_s,wx_rad_s,wy_rad_s,wz_rad_s\n" + "\n".join(rows) + "\n")
    said = remarks_of(path)
    assert [one.split(" (")[0].split(":")[0] for one in said] == [
        "990 repeated timestamps",
        "the timestamps are whole seconds, each of several samples",
    ]


@pytest.mark.filterwarnings("ignore:.*the times in '%time' differ:quatprop.RemarkWarning")
def test_recordings_are_plausible(shared_logs):
    """Nothing is said against what real sensors measured."""
    for name in ("xio3", "xsens-txt", "rostopic", "euroc"):
        found = Recording(shared_logs, name)
        checks = RateChecks()
        list(checks.observe([GyroSeries(found.t_ns, found.rate)]))
        counts = Counts(
            used=len(found.t_ns),
            first_ns=int(found.t_ns[0]),
            last_ns=int(found.t_ns[-1]),
            median_dt_ns=int(np.median(np.diff(found.t_ns))),
        )
        assert checks.remarks(counts) == [], name


def test_a_log_that_clips_is_remarked_on_in_the_library():
    """A notebook gets the warning, too."""
    rate = np.clip(swinging(2000), -4, 4)
    with pytest.warns(quatprop.RemarkWarning, match="saturated") as seen:
        quatprop.propagate(GyroSeries(np.arange(2000) * 5_000_000, rate))
    assert len(seen) == 6
