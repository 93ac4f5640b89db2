"""What the user says about which samples of a log to use."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Selection:
    """The options that choose samples; None means "not said".

    Parameters
    ----------
    topic
        Which topic of a container.
    rate_field, time_field
        Dotted paths of message fields, such as ``"imu.angular_velocity"``.
    rate_cols
        The x, y and z rate columns of a table, by name or number from 0.
    time_col
        The time column of a table, by name or number from 0.
    rate_unit
        ``"rad/s"`` or ``"deg/s"``.
    time_unit
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``.
    sample_rate
        Rows a second, Hz, of a table without a time column.
    clock
        ``"header"``, ``"log"`` or ``"publish"``.
    """

    topic: str | None = None
    rate_field: str | None = None
    time_field: str | None = None
    rate_cols: tuple[str, str, str] | None = None
    time_col: str | None = None
    rate_unit: str | None = None
    time_unit: str | None = None
    sample_rate: float | None = None
    clock: str | None = None
