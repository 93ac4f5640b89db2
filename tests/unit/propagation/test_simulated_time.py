"""Rates of a simulation that are stamped in wall time, and its clock beside them."""

import numpy as np
import pytest
from make.commands import run
from make.ros import imu_messages, write_messages

CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
T0, COUNT, HZ = 1_760_000_000 * 10**9, 500, 100
SIM = 5 * 10**9 + np.arange(COUNT) * (10**9 // HZ)
RATE = np.sin(np.arange(COUNT)[:, None] / 30 + np.arange(3))
RNG = np.random.default_rng(3)


def wall(speed):
    """Return wall times of a simulation that goes at a speed, or at many."""
    return T0 + np.cumsum(1e9 / HZ / np.broadcast_to(speed, COUNT)).astype(np.int64)


def said_of(path, stamps, recorded, clock=SIM):
    """Return what propagate says of a log with these header stamps, and a clock."""
    late = recorded + RNG.integers(0, 3_000_000, COUNT)
    messages = [*imu_messages(stamps, RATE, recorded=late)]
    # /clock comes more often than the rates.
    often = np.linspace(0, COUNT - 1, 2 * COUNT)
    pairs = (np.interp(often, np.arange(COUNT), each - each[0]) for each in (clock, recorded))
    for at, log in zip(*pairs, strict=True):
        values = {"clock": int(at + clock[0])}
        messages.append((CLOCK, CLOCK_TYPE, int(log + recorded[0]), values))
    write_messages(path, sorted(messages, key=lambda one: one[2]))
    return run("propagate", path, "-o", "-", code=0).stderr


VARYING = 0.8 + 0.15 * np.sin(np.arange(COUNT) / 50)


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
@pytest.mark.parametrize("speed", [0.5, 0.9, 2.0, VARYING], ids=str)
def test_wall_time_in_a_simulation_is_remarked_on(tmp_path, suffix, speed):
    """The rates were integrated over twice the time, in silence."""
    said = said_of(tmp_path / f"log.{suffix}", wall(speed), wall(speed))
    assert "the time of the simulation, on topic '/clock', goes " in said
    assert "record them with use_sim_time" in said


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
@pytest.mark.parametrize("speed", [0.5, 0.9, 1.0, 2.0, VARYING], ids=str)
def test_simulated_time_is_not_remarked_on(tmp_path, suffix, speed):
    """Whatever its speed; nor is a log that is played again."""
    said = said_of(tmp_path / f"a.{suffix}", SIM, wall(speed))
    assert "simulation, on topic" not in said
    said = said_of(tmp_path / f"b.{suffix}", wall(1.0), wall(speed), clock=wall(1.0))
    assert "simulation, on topic" not in said


@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_wall_time_at_the_speed_of_the_simulation_is_not_remarked_on(tmp_path, suffix):
    """Only where it began differs."""
    said = said_of(tmp_path / f"log.{suffix}", wall(1.0), wall(1.0))
    assert "simulation, on topic" not in said


@pytest.mark.parametrize("speed", [0.5, 0.95, VARYING], ids=["half", "nearly", "varying"])
def test_times_of_recording_in_a_simulation_are_remarked_on(tmp_path, speed):
    """They were integrated over another time, in silence; header timestamps are right."""
    path = tmp_path / "log.mcap"
    of_header = said_of(path, SIM, wall(speed))
    assert "--clock log" not in of_header
    said = run("propagate", path, "--clock", "log", "-o", "-", code=0).stderr
    assert "times as fast as the times of recording of topic '/imu', which are used" in said
    assert "only stamps in its time give right ones: use --clock header" in said
