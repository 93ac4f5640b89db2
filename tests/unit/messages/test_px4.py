"""Messages of PX4: averages, increments, bursts, and estimates that may be missing."""

import numpy as np
import pytest
from make.px4_messages import write_mcap, zeros
from make.streams import propagated

from quatprop.errors import SchemaError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates, rate_candidates
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings
from quatprop.series import GyroSeries
from quatprop.settings.selection import RateSelection

COUNT = 50


def read(path, **options):
    """Return the one source of a log and its samples."""
    with open_log(path) as log:
        source = choose_rates(log, RateSelection(**options))
        return source, GyroSeries.joined(list(source.batches()))


def test_an_average_over_the_interval_before_its_stamp_wants_the_method_end(tmp_path):
    """The series is that of rates and stamps; what the rates are is declared."""
    path = write_mcap(
        tmp_path / "log.mcap",
        "SensorCombined",
        [{"timestamp": 5000 * k, "gyro_rad": [0, 0, k], "gyro_integral_dt": 5000}
         for k in range(COUNT)],
    )  # fmt: skip
    source, series = read(path)
    assert series.t_ns.tolist() == [5_000_000 * k for k in range(COUNT)]
    assert series.rate[:, 2].tolist() == list(range(COUNT))
    assert series.integration_time_ns is None
    assert source.method_remarks("end") == []
    assert source.method_remarks("start") == [
        (
            "each rate is the average over the interval before its stamp, which is what "
            "method end assumes; method start was used"
        )
    ]
    assert series.is_interval_average
    assert source.method_used("start") == ("start", "given")
    assert source.method_used(None) == ("end", "log")
    whole = 0.005 * sum(range(1, COUNT))
    final = attitudes(series.t_ns, series.rate, method="end")[-1]
    assert geodesic_angle(final, exp([0, 0, whole])) < 1e-14


def test_increments_are_not_integrated_again(tmp_path):
    """A constant spin, sampled over intervals of many lengths: the angles add up as they are."""
    random = np.random.default_rng(2)
    spans = random.integers(2000, 8000, COUNT)
    angle = np.float32(0.3) * (spans / 5000).astype(np.float32)
    stamps = np.cumsum(spans)
    path = write_mcap(
        tmp_path / "log.mcap",
        "VehicleImu",
        [
            {"timestamp": stamp + 300, "timestamp_sample": stamp + random.integers(-900, 900),
             "delta_angle": [0, turned, 0], "delta_angle_dt": span}
            for stamp, span, turned in zip(stamps, spans, angle, strict=True)
        ],
    )  # fmt: skip
    source, series = read(path)
    assert source.increments
    assert source.samples == "increments"
    assert source.method_used(None) == ("end", "log")
    assert source.method_remarks(None) == []
    assert series.integration_time_ns.tolist() == (spans * 1000).tolist()
    *_, last = propagated([series])
    whole = np.cumsum(angle[1:].astype(np.float64))
    truth = exp(np.stack([0 * whole, whole, 0 * whole], axis=1))
    assert geodesic_angle(last.wxyz[1:], truth).max() < 1e-13


def fifo(first_us, samples, dt=125.5, scale=0.001):
    """Return a message whose samples are k, -k and 2 k for k from 1 on."""
    values = np.arange(1, samples + 1)
    return {
        "timestamp": first_us + 50, "timestamp_sample": first_us, "dt": dt, "scale": scale,
        "samples": samples, "x": values, "y": -values, "z": 2 * values,
    }  # fmt: skip


def test_a_burst_is_as_many_samples_as_it_counts(tmp_path):
    """The last sample has the stamp, those before it lie a spacing apart, to the nanosecond."""
    path = write_mcap(
        tmp_path / "log.mcap", "SensorGyroFifo", [fifo(1000, 3), fifo(2000, 0), fifo(9000, 32)]
    )
    source, series = read(path)
    assert source.remarks == (
        "several samples a message: the time of each is counted back from the stamp",
    )
    assert len(series) == 35
    assert series.t_ns[:3].tolist() == [749_000, 874_500, 1_000_000]
    assert series.t_ns[-32:].tolist() == [9_000_000 - 125_500 * k for k in range(31, -1, -1)]
    expected = np.concatenate([np.arange(1, 4), np.arange(1, 33)]) * np.float64(np.float32(0.001))
    assert (series.rate == np.stack([expected, -expected, 2 * expected], axis=1)).all()


def test_a_burst_propagates_as_the_samples_it_is_made_of(tmp_path):
    """A constant rate over many messages turns by rate times time."""
    message = {"dt": 250, "scale": 0.01, "samples": 8, "x": [0] * 8, "y": [100] * 8, "z": [0] * 8}
    path = write_mcap(
        tmp_path / "log.mcap",
        "SensorGyroFifo",
        [{"timestamp": 2000 * k, "timestamp_sample": 2000 * k, **message} for k in range(1, COUNT)],
    )
    _, series = read(path)
    assert (np.diff(series.t_ns) == 250_000).all()
    final = attitudes(series.t_ns, series.rate)[-1]
    whole = float(np.float32(0.01)) * 100 * 250e-6 * (len(series) - 1)
    assert geodesic_angle(final, exp([0, whole, 0])) < 1e-14


@pytest.mark.parametrize("damage", [{"samples": 33}, {"dt": float("nan")}, {"dt": -1}])
def test_a_burst_that_cannot_be_is_lost_and_told(tmp_path, damage):
    """The other messages are good."""
    messages = [fifo(1000, 3), {**fifo(2000, 3), **damage}, fifo(3000, 2)]
    path = write_mcap(tmp_path / "log.mcap", "SensorGyroFifo", messages)
    with open_log(path) as log:
        series = GyroSeries.joined(list(choose_rates(log, RateSelection()).batches()))
        (loss,) = log.losses
    assert len(series) == 5
    assert loss.messages == 1
    assert "and has room for 32; the log is damaged" in loss.reason


def test_an_estimate_that_is_invalid_is_not_finite(tmp_path):
    """The policy for rates that are not finite decides; estimates are no gyroscopes."""
    path = write_mcap(
        tmp_path / "log.mcap",
        "VehicleOdometry",
        [{"timestamp": 1, "timestamp_sample": 1, "angular_velocity": [0.5, 1, 2]},
         {"timestamp": 2, "timestamp_sample": 2, "angular_velocity": [np.nan] * 3}],
    )  # fmt: skip
    with open_log(path) as log:
        (candidate,) = rate_candidates(log, RateSelection())
    assert not candidate.preferred
    _, series = read(path)
    assert series.rate[0].tolist() == [0.5, 1, 2]
    assert np.isnan(series.rate[1]).all()


def test_other_messages_have_plain_rates(tmp_path):
    """Each with the time at which it was sampled, not that at which it was sent."""
    for kind, fields in (("SensorGyro", {"x": 1, "y": 2, "z": 3}),
                         ("VehicleAngularVelocity", {"xyz": [1, 2, 3]})):  # fmt: skip
        message = {"timestamp": 900, "timestamp_sample": 700, **fields}
        _, series = read(write_mcap(tmp_path / f"{kind}.mcap", kind, [message]))
        assert series.t_ns.tolist() == [700_000]
        assert series.rate.tolist() == [[1, 2, 3]]


def test_a_log_without_the_definition_is_refused(tmp_path):
    """It is no standard type, so there is nothing to read it by."""
    path = write_mcap(tmp_path / "log.mcap", "VehicleImu", [{}], definition=False)
    with (
        open_log(path) as log,
        pytest.raises(
            SchemaError,
            match=r"the log carries no definition of 'px4_msgs/msg/VehicleImu' and it is not a "
            r"standard type; put its .msg files beside the log, or name them with msg_path$",
        ),
    ):
        choose_rates(log, RateSelection())


def test_the_report_says_what_ruled_the_intervals(tmp_path):
    """The default is what the messages say their samples are, and no remark is made on it."""
    samples = [
        {"timestamp": 5000 * k, "timestamp_sample": 5000 * k, "delta_angle_dt": 5000,
         "delta_angle": [0.01 * k, 0, 0], "gyro_rad": [k, 0, 0]}
        for k in range(1, 5)
    ]  # fmt: skip
    reports = {}
    for kind in ("VehicleImu", "SensorCombined"):
        known = [{name: row[name] for name in row if name in zeros(kind)} for row in samples]
        path = write_mcap(tmp_path / f"{kind}.mcap", kind, known)
        reports[kind] = run(Job(str(path), OutputSettings(str(tmp_path / f"{kind}.csv"))))
    for kind, samples in (("VehicleImu", "increments"), ("SensorCombined", "averages")):
        convention = reports[kind].convention
        assert (convention.method, convention.method_from) == ("end", "log")
        assert convention.samples == samples
        assert not any("method" in remark for remark in reports[kind].remarks)
    assert reports["VehicleImu"].result.net_rotation_rad == pytest.approx(0.09, abs=1e-8)
    assert reports["SensorCombined"].result.net_rotation_rad == pytest.approx(0.045, abs=1e-8)
