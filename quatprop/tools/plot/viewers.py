"""Show a result in Rerun or Foxglove: attitudes as axes, rates or errors as plots.

Times are those of the log. Rerun is open during a run; Foxglove opens an MCAP file at the end.
Batches are passed on as arrays, and none is kept.
"""

from __future__ import annotations

import os
import subprocess
import sys
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from shutil import rmtree, which
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.rendering import GPS_EPOCH_NS
from quatprop.base.text import Setting
from quatprop.kinematics.series import blocks
from quatprop.readers.attitude_input import LoadedAttitudes
from quatprop.tools.plot.figure import AXES
from quatprop.writers.formats import Message
from quatprop.writers.mcap import McapFile
from quatprop.writers.message_encoders import (
    CURVES,
    FoxgloveEncoder,
    Topic,
    curve_messages,
    schema_of,
)
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64, Records
    from quatprop.comparison.result import Comparison
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.readers.attitude_input import ReadAttitudes

RATES, ERROR = CURVES

CONNECT_S = 10.0
"""Longest time for Rerun to open, s."""

EYE = (2.2, 1.6, 1.2)
"""Position of the camera, for axes of length 1."""

SHORTER = 0.6
"""Length of the axes of B relative to those of A, so that both are visible."""


class Viewer(ABC):
    """Sends data to a viewer; it can observe a propagation.

    `said`: message to the user once the data are shown
    """

    said = ""

    @abstractmethod
    def axes(self, name: str, series: AttitudeSeries) -> None:
        """Show the axes of a body."""

    @abstractmethod
    def plot(self, type_name: str, t_ns: Int64, values: Float64) -> None:
        """Plot numbers, shape ``(N, fields)``, named as :data:`.CURVES` says."""

    @abstractmethod
    def show(self) -> None:
        """Show all data that were sent."""

    def rates(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Plot the rates, and yield them unchanged."""
        for batch in batches:
            self.plot(RATES, batch.t_ns, batch.rate)
            yield batch

    def attitudes(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Show the attitudes, and yield them unchanged."""
        for batch in batches:
            self.axes("body", batch)
            yield batch

    def draw(self, _report: object) -> None:
        """Show all data of the run."""
        self.show()

    def compared(self, a: ReadAttitudes, b: ReadAttitudes, comparison: Comparison) -> None:
        """Show the attitudes of A and B, on the clock of A, and the errors between them."""
        for name, side, later_ns in (("A", a, 0), ("B", b, comparison.time_offset.added_to_b_ns)):
            if isinstance(side, LoadedAttitudes):
                for rows in blocks(len(side.series)):
                    part = side.series[rows]
                    self.axes(name, replace(part, t_ns=part.t_ns + later_ns))
        for rows in blocks(len(comparison.t_ns)):
            errors = [comparison.errors[rows], *comparison.error_vectors[rows].T]
            self.plot(ERROR, comparison.t_ns[rows], np.degrees(np.column_stack(errors)))
        self.show()

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, *_error: object) -> None:
        """Release the viewer, and remove files that are not shown."""


def open_viewer(name: str) -> Viewer:
    """Return a viewer: ``"rerun"`` or ``"foxglove"``."""
    return RerunViewer() if name == "rerun" else FoxgloveViewer()


class RerunViewer(Viewer):
    """Sends data to Rerun, which is open from the beginning."""

    def __init__(self) -> None:
        try:
            import rerun
        except ImportError as error:
            raise UsageError(
                f"{Setting('view', 'rerun')} needs Rerun, which is not installed; "
                "pip install rerun-sdk"
            ) from error
        self._rerun: Any = rerun
        self._stream = rerun.RecordingStream("quatprop")
        self._declared: list[str] = []
        self._unit = ""
        # Beside Python, where an environment that is not activated keeps it.
        places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
        try:
            rerun.spawn(
                executable_path=which("rerun", path=places),
                hide_welcome_screen=True,
                recording=self._stream,
            )
            self._stream.flush(timeout_sec=CONNECT_S)
        except RuntimeError as error:
            raise UsageError(
                "Rerun did not open a window; run `rerun` to see why, or forward port 9876 to a "
                "machine where it runs"
            ) from error

    def axes(self, name: str, series: AttitudeSeries) -> None:
        """Show the axes of a body."""
        if name not in self._declared:
            self._declared.append(name)
            length = SHORTER if name == "B" else 1.0
            self._stream.log(name, self._rerun.TransformAxes3D(length), static=True)
        quaternions = self._rerun.Transform3D.columns(quaternion=series.wxyz[:, [1, 2, 3, 0]])
        self._stream.send_columns(name, [self._times(series.t_ns)], quaternions)

    def plot(self, type_name: str, t_ns: Int64, values: Float64) -> None:
        """Plot numbers."""
        if type_name not in self._declared:
            self._declared.append(type_name)
            fields = CURVES[type_name]
            colours = [int(AXES.get(field[0], AXES["w"])[1:] + "ff", 16) for field in fields]
            lines = self._rerun.SeriesLines(names=fields, colors=np.array(colours, np.uint32))
            self._stream.log(_place(type_name), lines, static=True)
            self._stream.send_blueprint(self._layout(_place(type_name)))
        scalars = self._rerun.Scalars.columns(scalars=values)
        self._stream.send_columns(_place(type_name), [self._times(t_ns)], scalars)

    def _layout(self, plotted: str) -> Any:
        import rerun.blueprint as layout

        eye = layout.EyeControls3D(position=EYE, look_target=(0, 0, 0), eye_up=(0, 0, 1))
        return layout.Blueprint(
            layout.Horizontal(
                layout.Spatial3DView(origin="/", name="attitude", eye_controls=eye),
                layout.TimeSeriesView(origin=plotted, name=plotted),
            ),
            collapse_panels=True,
        )

    def _times(self, t_ns: Int64) -> Any:
        """Return times as instants, or as durations if the clock does not count from 1970."""
        self._unit = self._unit or ("timestamp" if t_ns[0] >= GPS_EPOCH_NS else "duration")
        form = "datetime64[ns]" if self._unit == "timestamp" else "timedelta64[ns]"
        return self._rerun.TimeColumn("log_time", **{self._unit: t_ns.astype(form)})

    def show(self) -> None:
        """Wait until Rerun has received everything, unless it was closed."""
        with suppress(RuntimeError):
            self._stream.flush()

    def __exit__(self, *_error: object) -> None:
        self._stream.disconnect()


class FoxgloveViewer(Viewer):
    """Writes an MCAP file in the temporary folder, and opens it in Foxglove's desktop app."""

    def __init__(self) -> None:
        self._command = _foxglove()
        self._path = Path(mkdtemp(prefix="quatprop-")) / "view.mcap"
        self._stream = self._path.open("wb")
        self._file = McapFile(self._stream, "", "zstd")
        self._topics: list[str] = []

    def axes(self, name: str, series: AttitudeSeries) -> None:
        """Show the axes of a body."""
        encoder = FoxgloveEncoder(Message("FrameTransform", f"/tf/{name}", child=name))
        self._write(encoder.topic, series.t_ns, encoder.encode(series, self._path))

    def plot(self, type_name: str, t_ns: Int64, values: Float64) -> None:
        """Plot numbers."""
        schema = schema_of(type_name)
        topic = Topic(f"/{_place(type_name)}", type_name, "protobuf", "protobuf", schema)
        self._write(topic, t_ns, curve_messages(values))

    def _write(self, topic: Topic, t_ns: Int64, messages: Records) -> None:
        with output_errors(self._path):
            if topic.name not in self._topics:
                self._file.add_channel(topic)
                self._topics.append(topic.name)
            self._file.write(t_ns, messages, self._topics.index(topic.name))

    def show(self) -> None:
        """Finish the file and open it, without waiting until it is closed."""
        with output_errors(self._path):
            self._file.finish()
            self._stream.close()
        self.said = f"view: {self._path}"
        subprocess.Popen(  # noqa: S603  # a program that was found under its name
            [*self._command, str(self._path)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def __exit__(self, *_error: object) -> None:
        """Remove the file, unless it is shown."""
        if not self.said:
            self._file.abort()
            self._stream.close()
            rmtree(self._path.parent)


def _foxglove() -> list[str]:
    """Return the command that opens a file in Foxglove."""
    if found := which("foxglove-studio"):
        return [found]
    if Path("/Applications/Foxglove.app").exists():
        return ["open", "-a", "Foxglove"]
    raise UsageError(
        f"{Setting('view', 'foxglove')} needs Foxglove's desktop app, and there is no "
        "foxglove-studio on the PATH; install it from https://foxglove.dev/download, or write "
        "MCAP and open that in the web app"
    )


def _place(type_name: str) -> str:
    """Return the path of numbers in a viewer: ``"rates"`` or ``"error"``."""
    return type_name.rpartition(".")[2].lower()
