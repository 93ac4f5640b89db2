"""Recordings that have a reference, for mistakes to be put into."""

import re
from pathlib import Path

import numpy as np

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.quaternion import multiply

AUK = {"log": "auk/auk.bag", "rates": {"topic": "/auk/fcu/imu"}}
PX4 = {"log": "ulog/sample.ulg", "rates": {"topic": "sensor_combined/0"}}

RECORDINGS = {
    # Reference, and what is taken out beforehand: the rule by which the reference integrates, the
    # offset of its clock in ms, and a mounting.
    "auk-vicon": {
        **AUK,
        "attitudes": {"topic": "/vicon/auk/auk"},
        "method": "mean",
        "offset_ms": -14.7,
        "mounted": True,
    },
    "auk": {**AUK, "method": "mean"},
    "husky": {"log": "husky/test1_husky.bag", "rates": {"topic": "/imu/data"}},
    "ardrone": {"log": "irregular/test3_2014_ardrone.bag", "rates": {"topic": "/ardrone/imu"}},
    "tilt": {"log": "irregular/tilt_laser.bag", "rates": {"topic": "/imu_data"}},
    "xsens": {
        "log": "two_imus/test1_2014_xsens.bag",
        "rates": {"topic": "/xsens/imu_data"},
        "method": "mean",
    },
    "kiran": {
        "log": "nested_imu/kiran_11sec_motion",
        "rates": {"topic": "/imu"},
        "factor": 180 / np.pi,
        "method": "mean",
        "mounted": True,
    },
    "px4": {**PX4, "attitudes": {"topic": "vehicle_attitude/0"}, "offset_ms": -7.25},
    "euroc": {
        "log": "csv/euroc_v102/imu0_data.csv",
        "reference": "csv/euroc_v102/state_groundtruth_data.csv",
        "method": "mean",
    },
    "xio3": {"log": "csv/xio3/Inertial.csv", "reference": "csv/xio3/Quaternion.csv"},
    "xsens-txt": {"log": "csv/data_xsens.txt", "rates": {"rate_unit": "rad/s"}},
    "rostopic": {"log": "csv/rostopic_echo.csv"},
    **{
        name: {
            "log": f"broad/{trial}_with_breaks_B.hdf5",
            "attitudes": {"on_invalid": "drop"},
            "method": "mean",
        }
        for name, trial in (
            ("broad05", "05_undisturbed_slow_rotation"),
            ("broad18", "18_undisturbed_fast_translation"),
        )
    },
}
"""Recordings with a reference; without another one, it is the orientation next to the rates."""

AXES = {
    "x and y swapped": [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    "turned by 90 deg": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x reversed": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z reversed": [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
}
"""Body axes as they are taken by mistake, as a matrix for the rates."""


class Recording:
    """Rates and a reference, which agree but for biases and reference frames."""

    def __init__(self, folder: Path, name: str) -> None:
        known = RECORDINGS[name]
        log, options = folder / known["log"], known.get("rates", {})
        rates = quatprop.read_rates(log, **options)
        order = np.argsort(rates.t_ns, kind="stable")
        self.t_ns = rates.t_ns[order]
        self.rate = rates.rate[order] * known.get("factor", 1.0)
        self.method = known.get("method", "end")
        topic = {key: value for key, value in options.items() if key == "topic"}
        read = known.get("attitudes", topic)
        reference = quatprop.read_attitudes(folder / known.get("reference", known["log"]), **read)
        offset_ns = round(known.get("offset_ms", 0) * 1e6)
        self.reference = AttitudeSeries(reference.t_ns + offset_ns, reference.wxyz)
        if known.get("mounted"):
            mount = quatprop.compare(self.propagated(), self.reference, align="mount").alignment
            wxyz = multiply(self.reference.wxyz, mount.mount_wxyz)
            self.reference = AttitudeSeries(self.reference.t_ns, wxyz)

    def propagated(self, matrix=None, method=None, rates="body"):
        """Return the attitudes that the rates lead to; by mistake with axes exchanged or scaled."""
        rate = self.rate if matrix is None else self.rate @ np.asarray(matrix).T
        series = GyroSeries(self.t_ns, rate)
        found = quatprop.propagate(series, method=method or self.method, rates=rates)
        return AttitudeSeries(found.t_ns, found.wxyz)


def changed(series, change):
    """Return a series with other quaternions."""
    return AttitudeSeries(series.t_ns, np.ascontiguousarray(change(series.wxyz)))


def delayed(series, offset_ms):
    """Return a series that is late."""
    return AttitudeSeries(series.t_ns + offset_ms * 1_000_000, series.wxyz)


def ppm_named(cause):
    """Return the drift of B's clock and its standard deviation as a sentence has them, ppm."""
    found = re.match(r"B's clock is (slow|fast) by ([\d.]+) \+- ([\d.]+) ppm", cause.sentence)
    return (-1 if found[1] == "slow" else 1) * float(found[2]), float(found[3])
