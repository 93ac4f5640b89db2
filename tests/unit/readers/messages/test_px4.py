"""Messages of PX4: averages, increments, bursts, and estimates that may be missing."""

import numpy as np
import pytest
from make.px4_messages import write_mcap
from make.reading import rates
from make.streams import propagated

from quatprop import DataLossWarning, RemarkWarning, propagate
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle
from quatprop.propagation.job import Job, run
from quatprop.propagation.settings import OutputSettings
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import rate_candidates
from quatprop.settings.reading import RateSelection

COUNT = 50


def convention(folder, kind):
    """Return the method with which such a log is propagated, whence it is, and the samples."""
    job = Job(str(folder / f"{kind}.mcap"), OutputSettings(str(folder / "out.csv")))
    report = run(job)
    assert not any("method" in remark for remark in report.remarks)
    return report.convention.method, report.convention.method_from, report.convention.samples


def read(folder, kind, messages):
    """Return the one source of a log of messages of a kind, and its samples."""
    source, series, losses = rates(write_mcap(folder / f"{kind}.mcap", kind, messages))
    assert not losses
    return source, series


def test_an_average_over_the_interval_before_its_stamp_wants_the_method_end(tmp_path):
    """The series is that of rates and stamps; what the rates are is declared."""
    messages = [
        {"timestamp": 5000 * k, "gyro_rad": [0, 0, k], "gyro_integral_dt": 5000}
        for k in range(COUNT)
    ]
    source, series = read(tmp_path, "SensorCombined", messages)
    assert series.t_ns.tolist() == [5_000_000 * k for k in range(COUNT)]
    assert series.rate[:, 2].tolist() == list(range(COUNT))
    assert series.integration_time_ns is None
    assert series.is_interval_average
    assert source.method_used("start") == ("start", "given")
    assert source.method_remarks("end") == []
    (remark,) = source.method_remarks("start")
    assert remark.startswith("each rate is the average over the interval before its timestamp, ")
    assert remark.endswith("which is what method end assumes; method start was used")
    assert convention(tmp_path, "SensorCombined") == ("end", "log", "averages")
    final = attitudes(series.t_ns, series.rate, method="end")[-1]
    assert geodesic_angle(final, exp([0, 0, 0.005 * sum(range(1, COUNT))])) < 1e-14


def test_increments_are_not_integrated_again(tmp_path):
    """A constant spin, sampled over intervals of many lengths: the angles add up as they are."""
    random = np.random.default_rng(2)
    spans = random.integers(2000, 8000, COUNT)
    angle = np.float32(0.3) * (spans / 5000).astype(np.float32)
    messages = [
        {"timestamp": stamp + 300, "timestamp_sample": stamp + random.integers(-900, 900),
         "delta_angle": [0, turned, 0], "delta_angle_dt": span}
        for stamp, span, turned in zip(np.cumsum(spans), spans, angle, strict=True)
    ]  # fmt: skip
    source, series = read(tmp_path, "VehicleImu", messages)
    assert source.increments
    assert source.method_remarks(None) == []
    assert series.integration_time_ns.tolist() == (spans * 1000).tolist()
    *_, last = propagated([series])
    whole = np.cumsum(angle[1:].astype(np.float64))
    truth = exp(np.stack([0 * whole, whole, 0 * whole], axis=1))
    assert geodesic_angle(last.wxyz[1:], truth).max() < 1e-13
    assert convention(tmp_path, "VehicleImu") == ("end", "log", "increments")


def fifo(first_us, samples, dt=125.5, scale=0.001):
    """Return a message whose samples are k, -k and 2 k for k from 1 on."""
    values = np.arange(1, samples + 1)
    return {
        "timestamp": first_us + 50, "timestamp_sample": first_us, "dt": dt, "scale": scale,
        "samples": samples, "x": values, "y": -values, "z": 2 * values,
    }  # fmt: skip


def test_a_burst_is_as_many_samples_as_it_counts(tmp_path):
    """The last sample has the stamp, those before it lie a spacing apart, to the nanosecond."""
    source, series = read(
        tmp_path, "SensorGyroFifo", [fifo(1000, 3), fifo(2000, 0), fifo(9000, 32)]
    )
    assert source.remarks == (
        "several samples per message: the time of each is counted back from the timestamp",
    )
    assert series.t_ns[:3].tolist() == [749_000, 874_500, 1_000_000]
    assert series.t_ns[3:].tolist() == [9_000_000 - 125_500 * k for k in range(31, -1, -1)]
    expected = np.concatenate([np.arange(1, 4), np.arange(1, 33)]) * np.float64(np.float32(0.001))
    assert (series.rate == np.stack([expected, -expected, 2 * expected], axis=1)).all()


@pytest.mark.parametrize("damage", [{"samples": 33}, {"dt": float("nan")}, {"dt": -1}])
def test_a_burst_that_cannot_be_is_lost_and_told(tmp_path, damage):
    """The other messages are good."""
    messages = [fifo(1000, 3), {**fifo(2000, 3), **damage}, fifo(3000, 2)]
    path = write_mcap(tmp_path / "log.mcap", "SensorGyroFifo", messages)
    _, series, (loss,) = rates(path)
    assert len(series) == 5
    # Its own clock is compared with that of the recorder, by the first messages.
    with pytest.warns(DataLossWarning), pytest.warns(RemarkWarning):
        assert len(propagate(path, clock="header")) == 5
    assert loss.messages == 1
    assert "and has room for 32; the log is damaged" in loss.reason


def test_an_estimate_that_is_invalid_is_not_finite(tmp_path):
    """The policy for rates that are not finite decides; estimates are no gyroscopes."""
    messages = [
        {"timestamp": k, "timestamp_sample": k, "angular_velocity": rate}
        for k, rate in enumerate([[0.5, 1, 2], [np.nan] * 3], 1)
    ]
    _, series = read(tmp_path, "VehicleOdometry", messages)
    with open_log(tmp_path / "VehicleOdometry.mcap") as log:
        assert [one.preferred for one in rate_candidates(log, RateSelection())] == [False]
    np.testing.assert_array_equal(series.rate, [[0.5, 1, 2], [np.nan] * 3])
