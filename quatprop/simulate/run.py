"""One simulated recording: the log and, beside it, the truth."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.progress import metered
from quatprop.provenance import as_json
from quatprop.simulate.gyroscope import record
from quatprop.simulate.logs import open_log_writer
from quatprop.simulate.motion import motion_named
from quatprop.writers import WRITERS, kind_of, open_writer
from quatprop.writers.targets import is_stdout, refuse_overlap

if TYPE_CHECKING:
    from quatprop.simulate.gyroscope import Gyroscope
    from quatprop.simulate.motion import Shape

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def truth_beside(target: Path | str, kind: str | None = None) -> str | None:
    """Return where the truth of a log goes by default: the log's name with ``.truth.csv``.

    Beside a Parquet log it is Parquet as well; beside stdout there is none.

    Examples
    --------
    >>> truth_beside("logs/spin.mcap")
    'logs/spin.truth.csv'
    """
    if is_stdout(target):
        return None
    kind = kind_of(target, kind)
    suffix = ".truth.parquet" if kind == "parquet" else ".truth.csv"
    path = Path(target)
    return str(path.with_name((path.name if kind.startswith("rosbag2") else path.stem) + suffix))


def simulate(  # noqa: PLR0913  # a recording in full
    target: Path | str,
    motion: str,
    shape: Shape,
    gyroscope: Gyroscope,
    *,
    q0: tuple[float, ...] = IDENTITY,
    kind: str | None = None,
    compression: str | None = None,
    truth: Path | str | None = None,
) -> None:
    """Write a log of a motion, and its true attitude.

    Parameters
    ----------
    target
        Where the log goes.
    motion, shape
        What the body does: a key of :data:`quatprop.simulate.motion.MOTIONS` and its parameters.
    gyroscope
        How it is sampled.
    q0
        True attitude at the first sample, body -> reference, wxyz.
    kind, compression
        As for :func:`quatprop.simulate.logs.open_log_writer`.
    truth
        Where the true attitudes go, scalar-first; None writes none.

    Raises
    ------
    UsageError
        The motion is unknown, or a parameter is out of range.
    OutputError
        A file cannot be written; then neither is.
    """
    refuse_overlap([], [str(target), None if truth is None else str(truth)])
    provenance = _provenance(motion, shape, gyroscope, q0)
    with ExitStack() as stack:
        log = stack.enter_context(
            open_log_writer(target, kind, deviation=gyroscope.deviation, compression=compression)
        )
        attitudes = stack.enter_context(open_writer(truth)) if truth is not None else None
        recorded = record(motion_named(motion, shape), gyroscope, q0)
        for series in metered(recorded, gyroscope.samples, len):
            log.write(series)
            if attitudes is not None:
                attitudes.write(series)
        if attitudes is not None:
            attitudes.finish(provenance)
        # Recorders put no provenance into their messages.
        log.finish({} if WRITERS[kind_of(target, kind)].encodings else provenance)
        if attitudes is not None:
            attitudes.publish()
        log.publish()


def _provenance(
    motion: str, shape: Shape, gyroscope: Gyroscope, q0: tuple[float, ...]
) -> dict[str, object]:
    """Return what was simulated, JSON-ready. Without a version: the bytes depend on it alone."""
    return {
        "simulated": motion,
        "motion": as_json(shape),
        "gyroscope": as_json(gyroscope),
        "convention": {
            "attitude": "body to reference: v_ref = q v_body q*",
            "product": "Hamilton, ij = k",
            "rates": "body, rad/s",
            "layout": "scalar-first",
            "q0_wxyz": list(q0),
        },
    }
