"""What users of the library write, for type checkers: ``make lint`` checks it; nothing runs it."""

import numpy as np
from scipy.spatial.transform import Rotation

import quatprop


def attitudes_of(log: str, topic: str | None = None) -> quatprop.AttitudeSeries:
    """Pass on what may be None, and give numbers as a list, a tuple and an array."""
    rates = quatprop.read_rates(log, topic=topic)
    return quatprop.propagate(rates, q0=np.eye(4)[0], bias=[0, 0, 0.001], mount=(1, 0, 0, 0))


def own_series() -> quatprop.Comparison:
    """Make series of lists and of arrays of any numbers."""
    rates = quatprop.GyroSeries([0, 10_000_000], [[0, 0, 1], [0, 0, 1]])
    times = np.arange(2) * 0.01
    same = quatprop.GyroSeries.from_seconds(times, np.tile([0, 0, 1], (2, 1)))
    reference = quatprop.AttitudeSeries(np.arange(2), np.eye(4)[:2].tolist())
    phases = np.array([[0, 1]])
    attitudes = quatprop.propagate(rates)
    return quatprop.compare(attitudes, reference, tol=None if same else "1deg", judge=phases)


def in_memory(times: list[int], rotation: Rotation) -> quatprop.AttitudeSeries:
    """Give values where the command line takes files; use a series as a sequence and a rotation."""
    rates = quatprop.read_rates("log.mcap")
    at_frames = quatprop.propagate(rates, at=times, q0=rotation, bias=rates, mount=np.eye(3))
    angles = at_frames.between("+1s").as_euler("ZYX", degrees=True)
    quatprop.convert("a.csv", "b.csv", left="ned-to-enu", right=rotation, sign="positive")
    relative = [row.relative_to(at_frames) for row in at_frames[angles[:, 0] > 0]]
    return relative[0] * at_frames.inv()


def mistakes() -> None:
    """Each is found: a comment that nothing needs is an error."""
    quatprop.propagate("log.mcap", method="rk4")  # type: ignore[arg-type]
    quatprop.propagate("log.mcap", on_gap="stop")  # type: ignore[arg-type]
    quatprop.compare("a.csv", "b.csv", align="best")  # type: ignore[arg-type]
    quatprop.read_rates("log.mcap", rate_units="deg/s")  # type: ignore[call-arg]
