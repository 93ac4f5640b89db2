"""What shows rest stands beside the rates, at the times that the stages give these."""

import numpy as np
import pytest
from make.ros import imu_messages, write_messages

from quatprop import propagate
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, rotate

pytestmark = [
    pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning"),
    pytest.mark.filterwarnings("ignore::quatprop.DataLossWarning"),
]

START, HZ = 1_760_000_000_000_000_000, 100
STEP = 10**9 // HZ
BIAS = np.array([0.02, -0.01, 0.015])


def motion(seconds=20, rest=4):
    """Return times, rates with a bias, and specific forces of a body at rest at both ends."""
    rng = np.random.default_rng(5)
    t_ns = START + np.arange(seconds * HZ) * STEP
    t_s = (t_ns - START)[:, None] * 1e-9
    moves = ((t_s > rest) & (t_s < seconds - rest)).astype(float)
    rate = moves * np.sin(t_s * [1.1, 1.7, 0.9] + [0, 1, 2])
    wxyz = attitudes(t_ns, rate)
    force = rotate(conjugate(wxyz), np.tile([0, 0, 9.81], (len(t_ns), 1)))
    force += rng.normal(0, 0.02, force.shape)
    return t_ns, rate + BIAS + rng.normal(0, 1e-3, rate.shape), force, wxyz


def write_imu(path, stamps, rate, force, wxyz=(), **recorded):
    """Write messages with accelerations."""
    vectors = np.asarray(force).tolist()
    messages = imu_messages(stamps, rate, wxyz, linear_acceleration=vectors, **recorded)
    return write_messages(path, messages)


def rest_of(path, **options):
    """Return the rest from which a run takes the bias, which must be that of the sensor."""
    rest = propagate(path, bias="static", **options).report.correction.rest
    np.testing.assert_allclose(rest.mean_rad_s, BIAS, atol=3e-4)
    assert "accelerometer" in rest.steady
    return rest


@pytest.mark.thorough
@pytest.mark.parametrize("oriented", [False, True])
@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_files_in_sequence_show_their_rests(tmp_path, oriented, suffix):
    """Accelerations kept their overlapping times, and "the body moves" where it rests."""
    t_ns, rate, force, wxyz = motion()
    # The second one is at rest when the first one moves.
    order = np.roll(np.arange(len(t_ns)), len(t_ns) // 2)
    parts = []
    for number, rows in enumerate([slice(None), order]):
        own = wxyz[rows] if oriented else ()
        path = tmp_path / f"{number}{suffix}"
        parts.append(write_imu(path, t_ns, rate[rows], force[rows], own))
    rest = rest_of(parts, in_sequence=True)
    assert ("orientation" in rest.steady) == oriented
    assert rest.span_s == pytest.approx(4, abs=0.6)


@pytest.mark.parametrize("oriented", [False, True])
def test_samples_that_are_dropped_do_not_disturb_the_rests(tmp_path, oriented):
    """Their accelerations stayed in the windows of others."""
    t_ns, rate, force, wxyz = motion()
    again = slice(600, 1400)
    stamps = np.concatenate([t_ns, t_ns[: again.stop - again.start]])
    rate, force, wxyz = (np.concatenate([each, each[again]]) for each in (rate, force, wxyz))
    recorded = START + np.arange(len(stamps)) * STEP
    path = write_imu(
        tmp_path / "log.mcap", stamps, rate, force, wxyz if oriented else (), recorded=recorded
    )
    rest = rest_of(path, on_backwards="drop")
    assert rest.span_s == pytest.approx(4, abs=0.6)
    assert ("orientation" in rest.steady) == oriented


@pytest.mark.parametrize("second", [10**9, 2 * 10**8])
def test_samples_in_packets_show_their_rests(tmp_path, second):
    """Of stamps in whole seconds every other window was empty: no rest of 1 s."""
    t_ns, rate, force, wxyz = motion(40, 6)
    path = write_imu(
        tmp_path / "log.mcap", t_ns // second * second, rate, force, wxyz, recorded=t_ns
    )
    rest = rest_of(path, regular_time=True)
    assert rest.span_s > 5
    assert "orientation" in rest.steady
