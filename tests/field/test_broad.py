"""The columns that BROAD publishes, from its data: phases of movement, heading and inclination."""

import math

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quatprop import AttitudeSeries, compare

PUBLISHED = {
    "05_undisturbed_slow_rotation_with_breaks_B": (
        1.7858627911654175, 1.632848954589384, 0.7232921656490349,
    ),
    "18_undisturbed_fast_translation_with_breaks_B": (
        4.461444080112256, 2.868569328563213, 3.4174490945804177,
    ),
}  # fmt: skip
"""RMS errors in total, heading and inclination, deg, of Madgwick's filter with the gain 0.12:
`example_code/out/results_madgwick_average_rmse.json` of https://github.com/dlaidig/broad."""

GAIN = 0.12


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_published_columns(shared_logs, name):
    """Judged in the phases of movement; the filter is computed in 64 bits instead of 32."""
    with h5py.File(shared_logs / "broad" / f"{name}.hdf5") as file:
        rate, acc, mag, truth, moves = (
            file[name][:] for name in ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "movement")
        )
        hz = file.attrs["sampling_rate"]
    t_ns = np.rint(np.arange(len(rate)) / hz * 1e9).astype(np.int64)
    known = np.isfinite(truth).all(axis=1)
    phases = t_ns[np.flatnonzero(np.diff(np.pad(moves, 1))).reshape(-1, 2) - [0, 1]]
    estimate = AttitudeSeries(t_ns, madgwick(rate / hz, acc, mag, GAIN / hz))
    reference = AttitudeSeries(t_ns[known], truth[known])
    found = compare(estimate, reference, judge=phases, tol_heading="180deg")
    rms = found.error_rad.rms, found.parts.heading.rms, found.parts.inclination.rms
    assert np.degrees(rms) == pytest.approx(PUBLISHED[name], rel=1e-4)


def madgwick(turn, acc, mag, step):
    """Return the attitudes of Madgwick's filter, east-north-up, scalar first.

    As in the code that BROAD uses, the field that the magnetometer should see has half its length.

    `turn`: rates times the interval; `step`: the gain times the interval
    """
    acc, mag = (rows / np.linalg.norm(rows, axis=1)[:, None] for rows in (acc, mag))
    east = np.cross(mag[0], acc[0])
    north, east = (axis / np.linalg.norm(axis) for axis in (np.cross(acc[0], east), east))
    start = Rotation.from_matrix([north, -east, acc[0]])
    q, out = start.as_quat(scalar_first=True).tolist(), []
    for rate, a, m in zip(turn.tolist(), acc.tolist(), mag.tolist(), strict=True):
        q = updated(q, rate, a, m, step)
        out.append(q)
    to_east = Rotation.from_euler("z", 90, degrees=True)
    attitudes = to_east * Rotation.from_quat(out, scalar_first=True)
    return attitudes.as_quat(scalar_first=True)


def updated(q, turn, acc, mag, step):
    """Return the attitude after one sample: a step of gradient descent on what it leaves."""
    w, x, y, z = q
    (gx, gy, gz), (mx, my, mz) = turn, mag
    hx = 2 * ((0.5 - y * y - z * z) * mx + (x * y - w * z) * my + (x * z + w * y) * mz)
    hy = 2 * ((x * y + w * z) * mx + (0.5 - x * x - z * z) * my + (y * z - w * x) * mz)
    v = 2 * ((x * z - w * y) * mx + (y * z + w * x) * my + (0.5 - x * x - y * y) * mz)
    h = math.hypot(hx, hy)
    slope = [0.0] * 4
    # Of half the field and of gravity: horizontal and vertical part in reference axes, and sensor.
    for n, d, (sx, sy, sz) in ((h, v, mag), (0.0, 2.0, acc)):
        fx = n * (0.5 - y * y - z * z) + d * (x * z - w * y) - sx
        fy = n * (x * y - w * z) + d * (w * x + y * z) - sy
        fz = n * (w * y + x * z) + d * (0.5 - x * x - y * y) - sz
        slope[0] += -d * y * fx + (d * x - n * z) * fy + n * y * fz
        slope[1] += d * z * fx + (n * y + d * w) * fy + (n * z - 2 * d * x) * fz
        slope[2] += -(2 * n * y + d * w) * fx + (n * x + d * z) * fy + (n * w - 2 * d * y) * fz
        slope[3] += (d * x - 2 * n * z) * fx + (d * y - n * w) * fy + n * x * fz
    part = step / math.hypot(*slope)
    w, x, y, z = (
        w + (-x * gx - y * gy - z * gz) / 2 - part * slope[0],
        x + (w * gx + y * gz - z * gy) / 2 - part * slope[1],
        y + (w * gy - x * gz + z * gx) / 2 - part * slope[2],
        z + (w * gz + x * gy - y * gx) / 2 - part * slope[3],
    )
    length = math.hypot(w, x, y, z)
    return w / length, x / length, y / length, z / length
