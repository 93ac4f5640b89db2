"""Results in Rerun and Foxglove: what they are given, at which times, and what is said."""

import subprocess
import sys
import tempfile
from itertools import groupby
from pathlib import Path
from unittest import mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from make.commands import refused, run
from make.mcap_doctor import examine
from make.tables import write_attitudes, write_rates
from mcap.reader import make_reader

import quatprop
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.kinematics.series import BLOCK
from quatprop.tools.plot import figure, viewers

T0 = 1_700_000_000_123_456_789
"""Ends in digits that a float of seconds loses."""

STEP = 5_000_001
SAMPLES = 300


@pytest.fixture(params=[T0, 0], ids=["since 1970", "since the start"])
def log(tmp_path, request):
    """Write rates about a turning axis, and return file, times and rates."""
    t_ns = request.param + STEP * np.arange(SAMPLES)
    rates = np.column_stack([np.sin(np.arange(SAMPLES) / 40), np.full(SAMPLES, 0.5), t_ns % 7])
    rows = [(t, *rate) for t, rate in zip(t_ns.tolist(), rates.tolist(), strict=True)]
    head = "t_ns,wx [rad/s],wy [rad/s],wz [rad/s]"
    return write_rates(tmp_path / "log.csv", rows, head), t_ns, rates


@pytest.fixture
def pair(tmp_path):
    """Write attitudes that are 5 degrees off about y, one second early, and the reference."""
    t_ns = T0 + STEP * np.arange(SAMPLES)
    true = exp(np.outer(np.arange(SAMPLES) / 100, [0, 0, 1]))
    off = multiply(true, exp(np.radians([[0, 5, 0]])))
    early = write_attitudes(tmp_path / "off.csv", t_ns - 1_000_000_000, off)
    return early, write_attitudes(tmp_path / "true.csv", t_ns, true), t_ns - 1_000_000_000


@pytest.fixture
def foxglove(tmp_path, monkeypatch):
    """Stand in for Foxglove's app; return what it was asked to open."""
    opened = []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(viewers, "which", {"foxglove-studio": "/apps/foxglove-studio"}.get)

    def open_app(command, *, start_new_session, **_streams):
        assert start_new_session, "it would end with the terminal"
        opened.append(command)

    monkeypatch.setattr(subprocess, "Popen", open_app)
    return opened


def messages_of(path):
    """Return topic -> log times and messages of a file, decoded by the library of protobuf."""
    examine(path)
    with path.open("rb") as stream:
        read = sorted(
            make_reader(stream).iter_messages(), key=lambda one: (one[1].topic, one[2].sequence)
        )
    topics = {}
    for topic, messages in groupby(read, key=lambda one: one[1].topic):
        rows = list(messages)
        schema, pool = rows[0][0], descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
        times = [message.log_time for _, _, message in rows]
        topics[topic] = times, [kind.FromString(message.data) for _, _, message in rows]
    return topics


def test_foxglove_is_given_axes_and_rates_at_the_times_of_the_log(log, foxglove, tmp_path):
    """Every sample is in the file that is opened, with the numbers of the log and of the result."""
    path, t_ns, rates = log
    said = run("propagate", path, "-o", tmp_path / "a.csv", "--view", "foxglove", code=0).stderr
    ((app, name),) = foxglove
    assert app == "/apps/foxglove-studio"
    assert said.endswith(f"view: {name}\n")
    shown = messages_of(Path(name))
    assert set(shown) == {"/rates", "/tf/body"}
    times, messages = shown["/rates"]
    assert times == t_ns.tolist()
    assert [(m.x_rad_s, m.y_rad_s, m.z_rad_s) for m in messages] == list(map(tuple, rates))
    times, messages = shown["/tf/body"]
    assert times == t_ns.tolist()
    wxyz = [(m.rotation.w, m.rotation.x, m.rotation.y, m.rotation.z) for m in messages]
    assert (np.array(wxyz) == quatprop.propagate(path).wxyz).all()
    assert {(m.parent_frame_id, m.child_frame_id) for m in messages} == {("reference", "body")}


def test_foxglove_is_given_both_sides_of_a_comparison_and_the_error(pair, foxglove):
    """All of it is on the clock of A, which is a second behind that of B here."""
    a, b, t_ns = pair
    line = ("compare", a, b, "--time-offset=-1s", "--view", "foxglove")
    said = run(*line, code=0).stderr
    ((_, name),) = foxglove
    assert said == f"view: {name}\n"
    assert run(*line, "-q", code=0).output == ""
    shown = messages_of(Path(name))
    assert set(shown) == {"/error", "/tf/A", "/tf/B"}
    for times, _ in shown.values():
        assert times == t_ns.tolist()
    _, errors = shown["/error"]
    vectors = [(one.angle_deg, one.x_deg, one.y_deg, one.z_deg) for one in errors]
    np.testing.assert_allclose(vectors, [[5, 0, 5, 0]] * SAMPLES, atol=1e-9)
    body = shown["/tf/B"][1][100].rotation
    np.testing.assert_allclose([body.w, body.z], [np.cos(0.5), np.sin(0.5)], atol=1e-12)


def test_a_view_of_more_than_a_chunk_is_whole(foxglove, tmp_path):
    """Channels fill their chunks at different paces, and attitudes come in two parts."""
    rows = [(T0 + STEP * (k + k // 10_000 * 100), 1, 2, 3) for k in range(20_000)]
    path = write_rates(tmp_path / "log.csv", rows)
    options = ("-o", tmp_path / "a.npy", "-q", "--on-gap", "split")
    run("propagate", path, *options, "--view", "foxglove", code=0)
    found = examine(Path(foxglove[0][1]))
    assert len(found.chunks) > 2
    assert found.counts == {1: 20_000, 2: 20_000}


def test_on_a_mac_the_app_is_opened_by_its_name(foxglove, tmp_path, monkeypatch):
    """Foxglove's installer puts no command on the PATH there."""
    monkeypatch.setattr(viewers, "which", {}.get)
    app, exists = Path("/Applications/Foxglove.app"), Path.exists
    monkeypatch.setattr(Path, "exists", lambda path: path == app or exists(path))
    path = write_rates(tmp_path / "log.csv", [(T0, 1, 2, 3)])
    run("propagate", path, "-o", tmp_path / "a.csv", "-q", "--view", "foxglove", code=0)
    ((*command, _),) = foxglove
    assert command == ["open", "-a", "Foxglove"]


def test_nothing_is_left_of_a_view_of_a_run_that_fails(foxglove, tmp_path):
    """The file in the temporary folder is for Foxglove, which is not opened."""
    path = write_rates(tmp_path / "log.csv", [(T0, 1, 2, 3), (T0 - 1, 1, 2, 3)])
    refused("propagate", path, "-o", tmp_path / "a.csv", "--view", "foxglove")
    assert foxglove == []
    assert [one.name for one in tmp_path.iterdir()] == ["log.csv"]


def test_a_viewer_that_is_missing_is_named_before_the_log_is_read(tmp_path, monkeypatch):
    """The way out is in the sentence, and neither file is looked for."""
    monkeypatch.setattr(viewers, "which", {}.get)
    monkeypatch.setitem(sys.modules, "rerun", None)
    propagate = "propagate", "no.csv", "-o", tmp_path / "a.csv", "--view"
    assert "rerun" in (said := refused(*propagate, "rerun"))
    assert said.endswith("needs Rerun, which is not installed; pip install rerun-sdk")
    assert "install it from https://foxglove.dev/download" in refused(*propagate, "foxglove")
    assert "pip install rerun-sdk" in refused("compare", "a.csv", "b.csv", "--view", "rerun")


@pytest.fixture
def rerun(monkeypatch):
    """Stand in for the library of Rerun; return a function that tells what an entity was given."""
    sdk = mock.MagicMock()
    monkeypatch.setitem(sys.modules, "rerun", sdk)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", sdk.blueprint)
    sdk.TimeColumn = lambda name, **times: (name, *times.items())
    sdk.Scalars.columns = lambda scalars: scalars
    sdk.Transform3D.columns = lambda quaternion: quaternion
    stream = sdk.RecordingStream.return_value

    def given(entity):
        """Return the kind of its times, the times in nanoseconds, and the values."""
        columns = [call.args for call in stream.send_columns.call_args_list]
        times, values = zip(*(rest for name, *rest in columns if name == entity), strict=True)
        (kinds,) = {(name, kind) for ((name, (kind, _)),) in times}
        stamps = np.concatenate([t_ns for ((_, (_, t_ns)),) in times])
        assert kinds[0] == "log_time"
        assert stamps.dtype.name.endswith("64[ns]")
        return kinds[1], stamps.astype(int).tolist(), np.concatenate(values)

    given.sdk, given.stream = sdk, stream
    return given


def test_rerun_is_given_axes_and_rates_at_the_times_of_the_log(log, rerun, tmp_path):
    """Instants where the clock counts from 1970, durations where it does not, to the nanosecond."""
    path, t_ns, rates = log
    run("propagate", path, "-o", tmp_path / "a.csv", "-q", "--view", "rerun", code=0)
    kind = "timestamp" if t_ns[0] >= T0 else "duration"
    xyzw = quatprop.propagate(path).wxyz[:, [1, 2, 3, 0]]
    for entity, expected in (("rates", rates), ("body", xyzw)):
        given_kind, times, values = rerun(entity)
        assert (given_kind, times) == (kind, t_ns.tolist())
        assert (values == expected).all()


def test_rerun_is_told_once_how_the_blocks_of_a_long_log_are_drawn(rerun, tmp_path):
    """Each block goes to the same axes and curves."""
    t_ns = T0 + STEP * np.arange(BLOCK + 1)
    columns = dict.fromkeys(("wx [rad/s]", "wy [rad/s]", "wz [rad/s]"), np.ones(len(t_ns)))
    pq.write_table(pa.table({"t_ns": t_ns, **columns}), tmp_path / "log.parquet")
    line = ("propagate", tmp_path / "log.parquet", "-o", tmp_path / "a.npy", "-q")
    run(*line, "--view", "rerun", code=0)
    assert rerun("rates")[1] == rerun("body")[1] == t_ns.tolist()
    declared = [call.args[0] for call in rerun.stream.log.call_args_list]
    assert sorted(declared) == ["body", "rates"]


def test_rerun_is_given_both_sides_of_a_comparison_and_the_error(pair, rerun):
    """All of it is on the clock of A, which is a second behind that of B here."""
    a, b, t_ns = pair
    run("compare", a, b, "--time-offset=-1s", "--view", "rerun", "-q", code=0)
    for entity in ("error", "A", "B"):
        _, times, values = rerun(entity)
        assert times == t_ns.tolist()
        if entity == "error":
            np.testing.assert_allclose(values, [[5, 0, 5, 0]] * SAMPLES, atol=1e-9)
    np.testing.assert_allclose(values[100], [0, 0, np.sin(0.5), np.cos(0.5)], atol=1e-12)
    # Each is declared once; the axes of B are shorter, so that both are seen.
    declared = [(call.args[0], call.kwargs) for call in rerun.stream.log.call_args_list]
    assert declared == [(name, {"static": True}) for name in ("A", "B", "error")]
    of_a, of_b = (call.args[0] for call in rerun.sdk.TransformAxes3D.call_args_list)
    assert 0 < of_b < of_a
    (lines,) = rerun.sdk.SeriesLines.call_args_list
    colours = [f"{figure.AXES[axis].lower()}ff" for axis in "wxyz"]
    assert lines.kwargs["names"] == ("angle_deg", "x_deg", "y_deg", "z_deg")
    assert [f"#{colour:08x}" for colour in lines.kwargs["colors"]] == colours
    rerun.stream.flush.assert_called()
    rerun.stream.disconnect.assert_called_once_with()


def test_the_library_of_rerun_stores_what_it_is_given(log, tmp_path, monkeypatch):
    """Where it is installed, it writes what it would show to a file."""
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    monkeypatch.setenv("_RERUN_TEST_FORCE_SAVE", str(tmp_path / "shown.rrd"))
    path, t_ns, rates = log
    run("propagate", path, "-o", tmp_path / "a.csv", "-q", "--view", "rerun", code=0)
    kind = "timestamp[ns]" if t_ns[0] >= T0 else "duration[ns]"
    xyzw = quatprop.propagate(path).wxyz[:, [1, 2, 3, 0]].astype(np.float32)[:, None]
    for entity, column, expected in (
        ("/rates", "Scalars:scalars", rates),
        ("/body", "Transform3D:quaternion", xyzw),
    ):
        chunks = [
            chunk.to_record_batch()
            for chunk in RrdReader(tmp_path / "shown.rrd").stream()
            if chunk.entity_path == entity and not chunk.is_static
        ]
        times = [time for chunk in chunks for time in chunk["log_time"]]
        assert {str(time.type) for time in times} == {kind}
        assert [time.value for time in times] == t_ns.tolist()
        values = [value for chunk in chunks for value in chunk[column].to_pylist()]
        assert (np.array(values) == expected).all()


def test_rerun_that_does_not_open_is_said_before_the_log_is_read(rerun):
    """Without a display it ends at once; the run would have gone on and shown nothing."""
    rerun.sdk.spawn.side_effect = RuntimeError("no viewer")
    said = refused("propagate", "no.csv", "-o", "a.csv", "--view", "rerun")
    assert said.startswith("Error: Rerun did not open a window; run `rerun` to see why")
