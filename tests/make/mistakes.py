"""Mistakes put into recordings that have a reference: which cause is named for each.

``python -m make.mistakes LOGS`` (in ``tests/``) prints the table over all recordings.
"""

import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.quaternion import conjugate, multiply

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
}
"""Recordings with a reference; without another one, it is the orientation beside the rates."""

FRAMES_AND_BIAS = {"reference frame", "rate bias", "drift", "rate bias and reference frame"}
"""What recordings have without a mistake: references are relative to other frames, gyroscopes
have biases."""

AXES = {
    "x and y swapped": [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    "turned by 90 deg": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x reversed": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z reversed": [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
}
"""Body axes as they are taken by mistake, as a matrix for the rates."""

METHODS = [
    ("start", "end"),
    ("mean", "start"),
    ("end", "mean"),
    ("start", "coning"),
    ("coning", "end"),
    ("mean", "coning"),
    ("cubic", "start"),
    ("coning", "cubic"),
]
"""Methods of A and B."""


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


def mistakes(recording):
    """Yield the mistake, the name its cause should get (None: no mistake), A and B."""
    a, b = recording.propagated(), recording.reference
    yield "none", None, a, b
    # JPL numbers body to reference are those of the Hamilton conjugate: one cause for both.
    yield "direction or JPL of B", "conjugate", a, changed(b, conjugate)
    yield "direction or JPL of A", "conjugate", changed(a, conjugate), b
    yield "scalar-last read as first", "layout", a, changed(b, lambda q: q[:, [1, 2, 3, 0]])
    yield "scalar-first read as last", "layout-first", a, changed(b, lambda q: q[:, [3, 0, 1, 2]])
    yield "inertial rates", "side", recording.propagated(rates="inertial"), b
    for factor in (np.pi / 180, 2.0, 1.1):
        yield f"scaled by {factor:.3g}", "scale", recording.propagated(np.eye(3) * factor), b
    for name, matrix in AXES.items():
        yield name, "axes", recording.propagated(matrix), b
    yield "all axes reversed", "rate sign", recording.propagated(-np.eye(3)), b
    for offset_ms in (20, -20, 200, -200):
        yield f"late by {offset_ms} ms", "time offset", a, delayed(b, offset_ms)
    for of_a, of_b in METHODS:
        a_by, b_by = recording.propagated(method=of_a), recording.propagated(method=of_b)
        yield f"{of_a} against {of_b}", "method", a_by, b_by


def named_causes(a, b):
    """Return the causes that a comparison names."""
    cause = quatprop.compare(a, b, align="mean").likely_cause
    return [each for each in (cause, cause.also) if each] if cause else []


def ppm_named(cause):
    """Return the drift of B's clock and its standard deviation as a sentence has them, ppm."""
    found = re.match(r"B's clock is (slow|fast) by ([\d.]+) \+- ([\d.]+) ppm", cause.sentence)
    return (-1 if found[1] == "slow" else 1) * float(found[2]), float(found[3])


def verdict(wanted, names):
    """Return whether the right cause was named, a wrong one, or none."""
    if wanted in names or (wanted is None and names <= FRAMES_AND_BIAS):
        return "right"
    return "wrong" if names - FRAMES_AND_BIAS else "none"


def main(folder: Path) -> None:
    """Print the verdict on every mistake in every recording."""
    columns, total = list(RECORDINGS), Counter()
    table = {}
    for column in columns:
        for mistake, wanted, a, b in mistakes(Recording(folder, column)):
            names = {cause.name for cause in named_causes(a, b)}
            found = verdict(wanted, names)
            table.setdefault(mistake, []).append("ok" if found == "right" else found)
            total[wanted is not None, found] += 1
    print(" " * 28 + "".join(f"{column:>10}" for column in columns))
    for mistake, verdicts in table.items():
        print(f"{mistake:28}" + "".join(f"{one:>10}" for one in verdicts))
    for (with_mistake, found), count in sorted(total.items()):
        print(f"{'with' if with_mistake else 'without'} a mistake: {found} {count}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if sys.argv[1:] else "../shared/logs"))
