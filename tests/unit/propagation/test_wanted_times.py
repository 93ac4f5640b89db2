"""`--at`: stamps of files that hold nothing else, and of other topics of the log."""

import json
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from make.ros import imu_messages, write_messages

import quatprop

BAG = SAMPLE_LOGS / "tumbling.bag"
AT = [1_700_000_001_500_000_000, 1_700_000_002_500_000_001]


@pytest.mark.parametrize(
    "text",
    [
        "t_ns\n{0}\n{1}\n",
        "{0}\n{1}\n",
        "{1}\n\n{0}",
        "#timestamp [ns],filename\n{0},a.png\n{1},b.png\n",
        "time (s)\n1700000001.5\n1700000002.500000001\n",
        "time\n2023-11-14T22:13:21.5Z\n2023-11-14T22:13:22.500000001Z\n",
        "frame,timestamp_ns\n0,{0}\n1,{1}\n",
        "frame,timestamp_ms\n0,1700000001500\n1,1700000002500.000001\n",
        "frame,time\n0,{0}\n1,{1}\n",
        "frame_index,t_s\n7,1700000001.5\n8,1700000002.500000001\n",
        "camera,t_ns,exposure\nfront,{0},7\nfront,{1},8\n",
    ],
)
def test_a_file_of_stamps_alone(tmp_path, text):
    """By unit, or as whole ns or dates; a CSV of them was no attitudes and refused."""
    frames = tmp_path / "frames.csv"
    frames.write_text(text.format(*AT))
    assert quatprop.propagate(BAG, at=frames).t_ns.tolist() == AT


STATE_IT = (
    "is not declared, and options for the rates do not apply to it; state it in the names of its "
    "columns, such as time_s or gyro_bias_x (rad/s)"
)
FRAMES = np.arange(60)
BESIDE = {
    "frame": FRAMES,
    "exposure_ns": 8_000_000 + FRAMES % 7,
    "gain": FRAMES % 2,
    "line": FRAMES // 2,
    "file": [f"{frame}.png" for frame in FRAMES],
}


@pytest.mark.parametrize("kind", ["csv", "jsonl", "parquet"])
@pytest.mark.parametrize("names", [*combinations(BESIDE, 2)], ids="+".join)
def test_a_table_whose_only_columns_are_times(tmp_path, kind, names):
    """Numbers that alternate beside times tell no sensors apart: a table without rates failed."""
    at = AT[0] + FRAMES * 10_000_000
    table = pd.DataFrame({**{name: BESIDE[name] for name in names}, "timestamp_ns": at})
    path = tmp_path / f"frames.{kind}"
    if kind == "csv":
        table.to_csv(path, index=False)
    elif kind == "jsonl":
        table.to_json(path, orient="records", lines=True)
    else:
        table.to_parquet(path)
    assert quatprop.propagate(BAG, at=path).t_ns.tolist() == at.tolist()


UNITS = {"s": 10**9, "ms": 10**6, "us": 1_000, "ns": 1}


@pytest.mark.parametrize("zero_s", [0, 3_600, 1_700_000_000], ids=["elapsed", "hours", "epoch"])
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize(
    "form", ["{}", "timestamp\n{}", "t\n{}", "frame,time\n7,{}", "ts,a,b\n{},1,2"]
)
def test_whole_numbers_without_a_unit(tmp_path, form, unit, zero_s):
    """They are ns only if of an epoch in ns; those of ms or us were all read near the start."""
    first_ns = zero_s * 10**9
    stamps = first_ns + np.arange(1_000) * 10_000_000
    log, at = tmp_path / "log.csv", tmp_path / "at.txt"
    rates = {f"gyro_{axis} (rad/s)": np.linspace(0, 1, len(stamps)) for axis in "xyz"}
    pd.DataFrame({"t_ns": stamps, **rates}).to_csv(log, index=False)
    wanted = first_ns + np.arange(1, 9) * 10**9
    head, _, row = form.rpartition("\n")
    lines = [row.format(t) for t in (wanted // UNITS[unit]).tolist()]
    is_narrow = "a,b" not in form
    at.write_text("\n".join(filter(None, [head, *lines])))
    words = "propagate", log, "--at", at, "-o", tmp_path / "out.csv"
    if is_narrow and unit == "ns" and zero_s > 10**9:
        run(*words, code=0)
    else:
        said = refused(*words)
        assert f"{at}: the unit of the time" in said
        assert said.endswith(STATE_IT)
        if not head:
            head = f"t_{unit}"
        else:
            *others, name = head.split(",")[: 2 if is_narrow else 1]
            head = ",".join([*others, f"{name}_{unit}", *head.split(",")[len(others) + 1 :]])
        at.write_text("\n".join([head, *lines]))
        run(*words, code=0)
    found = quatprop.read_attitudes(tmp_path / "out.csv").t_ns
    assert found.tolist() == wanted.tolist()


@pytest.mark.parametrize(
    "header", ["exposure_ns,time_ns", "received_ns,timestamp_ns", "exposure_time_ns,t_ns"]
)
def test_a_duration_is_no_time(tmp_path, header):
    """Of two columns with a unit, exposures were the times if they were the first."""
    frames = tmp_path / "frames.csv"
    frames.write_text(f"{header}\n" + "".join(f"8000000,{t}\n" for t in AT))
    assert quatprop.propagate(BAG, at=frames).t_ns.tolist() == AT


IMAGE, STRING = "sensor_msgs/msg/CompressedImage", "std_msgs/msg/String"


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
@pytest.mark.parametrize(("kind", "late"), [(IMAGE, 3_000_000), (STRING, 0)])
def test_a_topic_of_the_log_gives_the_times(tmp_path, suffix, kind, late):
    """Of any type: by its header timestamps, or the time of recording where it has none."""
    stamps, frames = range(0, 10**9, 10_000_000), [1_015_000_000, 1_337_000_001]
    imu = imu_messages([10**9 + t for t in stamps], rate=[(0.0, k / 100, 1.0) for k in range(100)])
    values = [{"header": {"stamp": t}} if kind == IMAGE else {} for t in frames]
    other = [("/other", kind, t + late, one) for t, one in zip(frames, values, strict=True)]
    log = write_messages(tmp_path / f"log{suffix}", sorted([*imu, *other], key=lambda one: one[2]))
    assert quatprop.propagate(log, at="/other").t_ns.tolist() == frames
    logged = quatprop.propagate(log, at="/other", clock="log").t_ns.tolist()
    assert logged == [t + late for t in frames]
    out, report = tmp_path / "a.csv", tmp_path / "report.json"
    run("propagate", log, "-o", out, "--at", "/other", "--report", report)
    assert quatprop.read_attitudes(out).t_ns.tolist() == frames
    assert json.loads(report.read_text())["settings"]["at"] == "/other"
    assert (
        "is not a file or a topic of the log"
        in run("propagate", log, "-o", out, "--at", "/nothing", code=2).stderr
    )


def test_a_topic_of_another_log(tmp_path):
    """For `--at`, `--q0` and `--bias`; LOG:TOPIC was taken for a topic of the log itself."""
    first_ns = 1_700_000_000_000_000_000
    turned = {"quaternion": {"w": 0.0, "x": 1.0, "y": 0.0, "z": 0.0}}
    still = {"quaternion": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}}
    bias = {"vector": {"x": 0.25, "y": 0.0, "z": 0.0}}
    rows = [
        (topic, f"geometry_msgs/msg/{kind}", t_ns, {"header": {"stamp": t_ns}, **values})
        for t_ns in (first_ns, first_ns + 9_990_000_000)
        for topic, kind, values in (
            ("/still", "QuaternionStamped", still),
            ("/turned", "QuaternionStamped", turned),
            ("/bias", "Vector3Stamped", bias),
            ("/other_bias", "Vector3Stamped", {"vector": {"x": 9.0, "y": 0.0, "z": 0.0}}),
        )
    ]
    log = write_messages(tmp_path / "other.mcap", rows)
    found = quatprop.propagate(
        BAG, q0=f"{log}:/turned", at=f"{log}:/still", bias=f"{log}:/bias", method="coning"
    )
    same = quatprop.propagate(BAG, q0=[0, 1, 0, 0], bias=[0.25, 0, 0], at=found.t_ns)
    assert found.t_ns.tolist() == [first_ns, first_ns + 9_990_000_000]
    assert found.wxyz[0].tolist() == same.wxyz[0].tolist() == [0, 1, 0, 0]
    assert found.report.as_json()["files"].keys() == {str(log)}
    for option, sentence in (
        ("--at", "no topic '/nothing' that carries attitudes; choose one of '/still', '/turned'"),
        ("--q0", "no topic '/nothing' that carries attitudes; choose one of '/still', '/turned'"),
        ("--bias", f"{log}:/nothing: it has no topic with biases"),
    ):
        done = run("propagate", BAG, "-o", "-", option, f"{log}:/nothing", code=2)
        assert sentence in done.stderr, done.stderr
    found = quatprop.propagate(BAG, at=f"{log}:/other_bias")
    assert found.t_ns.tolist() == same.t_ns.tolist()
    found = quatprop.propagate(BAG, at=BAG.as_uri())
    assert found.t_ns.tolist() == quatprop.read_rates(BAG).t_ns.tolist()
