"""The lines of a summary: given values in their own units, and estimated ones next to them."""

import re

import numpy as np
import pytest

from quatprop import GyroSeries, propagate
from quatprop.propagation.report import conventions, facts

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
T_NS = np.arange(1001) * 10_000_000
TURN = (np.arange(1001) >= 500)[:, None] * [0, 0, np.pi / 10]
"""Rest, and a quarter of a turn in 5 s."""
NOISE = 1e-3 * (-1.0) ** np.arange(1001)[:, None] * [1, 0, 0]
RATES = GyroSeries(T_NS, TURN + NOISE + [0.01, 0.02, 0.03])
METHOD = "rates resolved in the {} frame; q[k+1] = {}"
REST = "scatter 0.001 rad/s; steady by rate; the whole log was searched"


@pytest.mark.parametrize(
    ("options", "rows"),
    [
        (
            {"bias": (0.01, 0.02, 0.03), "mount": "y,-x,z", "every": 7, "start": "+1s"},
            {
                "samples": "901 over 9 s, 100 Hz; 129 attitudes written",
                "bias": "x +0.01  y +0.02  z +0.03 rad/s (2.14 deg/s)",
                "mount": "0 1 0; -1 0 0; 0 0 1 (matrix, sensor axes to body axes)",
                "method": f"start, body rates: {METHOD.format('body', 'q[k] * dq[k]')}",
                "start": "1000000000 ns",
                "max gap": "10 median intervals",
            },
        ),
        (
            {"mount": [0.5**0.5, 0, 0, 0.5**0.5]},  # its matrix is rounded in the last digit
            {"mount": "0 -1 0; 1 0 0; 0 0 1 (matrix, sensor axes to body axes)"},
        ),
        (
            {"bias": "static:1s", "end": "-1s", "max_gap": "20ms", "rates": "inertial"},
            {
                "bias": "x +0.01  y +0.02  z +0.03 rad/s (2.14 deg/s), from 500 samples at rest "
                f"over 4.99 s from t = 0 ns, {REST}",
                "method": f"start, inertial rates: {METHOD.format('reference', 'dq[k] * q[k]')}",
                "max gap": "20 ms",
                "end": "9000000000 ns",
            },
        ),
        (
            {"bias": "static@+1s..+3s", "q0": (0, 0, 0, 1), "on_gap": "zero"},
            {
                "samples": "1001 over 10 s, 100 Hz",
                "bias": "x +0.010005  y +0.02  z +0.03 rad/s (2.14 deg/s), from 201 samples over "
                "2 s from t = 1000000000 ns, scatter 0.001 rad/s; as given",
                "on gap": "zero",
                "q0": "w +0.000000000  x +0.000000000  y +0.000000000  z +1.000000000",
            },
        ),
        (
            {
                "noise_density": "2deg/sqrt(h)",
                "bias_sigma": "3deg/h",
                "random_walk": "4deg/h/sqrt(h)",
                "scale_sigma": "50ppm",
                "misalignment_sigma": "6mrad",
                "q0_sigma": "1deg",
            },
            {
                "": "from noise 2 deg/sqrt(h) (given), bias 3 deg/h (given), random walk of the "
                "bias 4 deg/h/sqrt(h) (given), scale factors 50 ppm (given), misalignments 6 mrad "
                "(given), q0 1 deg (given)",
            },
        ),
        (
            {"regular_time": True},
            {"clock": "the timestamps already follow a steady clock: used unchanged"},
        ),
    ],
)
def test_settings_are_said_as_they_were_given(options, rows):
    """With the samples that they leave, and the bias that is found."""
    report = propagate(RATES, **options).report
    said = {**dict(conventions(report)), **dict(facts(report))}
    said |= {"q0": dict(conventions(report))["q0"]}
    assert {label: said[label] for label in rows} == rows


def test_timestamps_of_a_clock_that_repeat_are_not_called_steady():
    """Late samples repeat the timestamp before, and the next make up for it: all are kept."""
    numbers = np.arange(2000)
    numbers[[300, 900]] -= 1
    turn = np.sin(numbers[:, None] * [0.01, 0.013, 0.007])
    report = propagate(GyroSeries(numbers * 5_000_000, turn), regular_time=True).report
    assert dict(facts(report))["clock"] == (
        "the timestamps already follow a steady clock, except 2 repeated: used unchanged"
    )


def test_a_clock_that_replaces_timestamps_is_described():
    """With the scatter of uniform jitter of 0.5 ms, and the samples that are missing."""
    random, kept = np.random.default_rng(1), np.delete(np.arange(4000), [100, 2000, 2001])
    late = kept * 5_000_000 + random.integers(-500_000, 500_000, len(kept))
    turn = np.sin(kept[:, None] * [0.01, 0.013, 0.007])
    row = dict(facts(propagate(GyroSeries(late, turn), regular_time=True).report))["clock"]
    numbers = re.fullmatch(
        r"steady at (\S+) Hz from t = (\S+) ns, instead of timestamps that scatter about it by "
        r"(\S+) us RMS and are at most (\S+) us away; 3 samples missing",
        row,
    )
    rate_hz, begin_ns, scatter_us, most_us = map(float, numbers.groups())
    assert abs(begin_ns) < 20_000
    found = rate_hz, scatter_us, most_us
    assert found == pytest.approx((200, 500 / 3**0.5, 500), rel=0.01)


def test_corrections_have_their_earlier_name_too():
    """A script that reads the rests of a report goes on working."""
    report = propagate(RATES, bias="static").report
    assert report.conditioning.rest == report.correction.rest is not None
