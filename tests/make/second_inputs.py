"""Logs with a second input, such as the series of q0, that contradicts the rates."""

import struct

import numpy as np
from make import ulog
from make.ros import TF, imu_messages, write_messages

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, multiply

STAMPS = 10**18 + np.arange(4000) * 10_000_000
VECTOR = "geometry_msgs/msg/Vector3Stamped"
BIAS = np.array([0.02, -0.015, 0.01])


class Remarks(list):
    """The remarks on a run, and its attitudes."""

    def __init__(self, result):
        super().__init__(result.report.remarks)
        self.attitudes = result


def swinging_after_rest(noise=0.0):
    """Return rates of a body that rests for 5 s and then swings, rad/s."""
    t_s = np.arange(len(STAMPS)) / 100
    phase = t_s[:, None] * [2.0, 2.6, 1.4] + np.arange(3)
    rate = np.clip(t_s - 5, 0, 1)[:, None] * np.sin(phase)
    return rate + noise * np.random.default_rng(5).normal(size=rate.shape)


def of_q0(spoil):
    """Propagate rates from the attitudes of a series; `spoil` changes its quaternions."""

    def made(_folder, **more):
        gyro = GyroSeries(STAMPS, swinging_after_rest())
        true = attitudes(gyro.t_ns, gyro.rate, method="mean")
        series = AttitudeSeries(STAMPS, spoil(true.copy()))
        return Remarks(
            quatprop.propagate(gyro, q0=series, **{"start": "+8s", "method": "mean", **more})
        )

    return made


def frozen(until):
    """Return a function that repeats the attitude of 7 s up to a row."""

    def spoil(wxyz):
        wxyz[700:until] = wxyz[700]
        return wxyz

    return spoil


def with_another_body(wxyz):
    """Replace every second attitude by that of a body that does not move."""
    wxyz[1::2] = multiply(exp([0, 0, 1.5]), exp([0.1, 0, 0]))
    return wxyz


def of_vectors(vector, ahead_ns=0, *, frame="", transforms=(), **options):
    """Propagate Imu messages with a topic of vectors, of the same clock or one that is ahead."""

    def made(folder, **more):
        rate, force = BIAS + swinging_after_rest(1e-3), [[0.0, 0.0, 9.8]] * len(STAMPS)
        messages = [*imu_messages(STAMPS, rate, frame="imu_link", linear_acceleration=force)]
        for t in STAMPS[10:3000:50].tolist():
            values = {"header": {"stamp": t + ahead_ns, "frame_id": frame}, "vector": [*vector]}
            messages.append(("/vector", VECTOR, t, values))
        messages = [*transforms, *sorted(messages, key=lambda one: one[2])]
        path = write_messages(folder / "log.mcap", messages)
        return Remarks(quatprop.propagate(path, topic="/imu", **(options | more)))

    return made


BASE_TURNED = [
    (
        "/tf_static",
        TF,
        int(STAMPS[0]) - 10,
        [[[[0, "base"], "imu_link", ([1, 2, 3], [0.0, 0.0, 0.6, 0.8])]]],
    )
]
"""The sensor is turned about z in the frame of the base."""


ESTIMATED = (
    "estimator_sensor_bias:uint64_t timestamp;uint64_t timestamp_sample;uint32_t gyro_device_id;"
    "float[3] gyro_bias;bool gyro_bias_valid;"
)


def flight(folder, devices, devices_of_biases, samples=200):
    """Write the rates of gyroscopes, and biases of an estimator for each of some of them."""
    stamps_us = 1_000_000 + np.arange(samples) * 5_000
    biases = [*enumerate(devices_of_biases, len(devices))]
    return ulog.write(
        folder / "log.ulg",
        ulog.record(b"F", ESTIMATED.encode()),
        *[ulog.added("sensor_gyro", k, k) for k in range(len(devices))],
        *[ulog.added("estimator_sensor_bias", k, id_) for k, (id_, _) in enumerate(biases)],
        *[
            ulog.data("sensor_gyro", id_, timestamp=t, timestamp_sample=t, device_id=device, x=0.1)
            for t in stamps_us.tolist()
            for id_, device in enumerate(devices)
        ],
        *[
            ulog.record(b"D", struct.pack("<HQQI3f?", id_, t, t, device, 0.1, 0.0, 0.0, True))
            for t in stamps_us[::50].tolist()
            for id_, device in biases
        ],
    )


def of_gyroscope(device, **options):
    """Propagate rates of a gyroscope with the biases of one of two, by its number."""

    def made(folder, **more):
        log = flight(folder, [11, 12], [device])
        given = {"topic": "sensor_gyro/1", "bias": "estimator_sensor_bias"}
        return Remarks(quatprop.propagate(log, **(given | options | more)))

    return made
