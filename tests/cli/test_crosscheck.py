"""``quatprop crosscheck`` prints findings with options that work, and exits by what it found."""

import json
import shlex

import numpy as np
import pytest
from make.commands import refused, run
from make.rigs import DEG, FAULTS, GYRO, MOCAP, ORIENTATION, rig
from make.ros import TF, imu_messages, write_messages
from make.tables import write_attitudes, write_rates

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.quaternion import conjugate, exp, multiply

POSE = "geometry_msgs/msg/PoseStamped"


def bag(path, sources):
    """Write a rig as a log of messages; return the path."""
    gyro, orientation, mocap = (sources[name] for name in (GYRO, ORIENTATION, MOCAP))
    messages = [*imu_messages(gyro.t_ns, gyro.values, orientation.values)]
    for t_ns, (w, *xyz) in zip(mocap.t_ns.tolist(), mocap.values.tolist(), strict=True):
        pose = {"header": {"stamp": t_ns}, "pose": {"orientation": [*xyz, w]}}
        messages.append(("/mocap", POSE, t_ns, pose))
    return write_messages(path, sorted(messages, key=lambda one: one[2]))


def test_a_healthy_log_is_one_line(tmp_path):
    """Nothing but the number of sources and that they agree."""
    said = run("crosscheck", bag(tmp_path / "rig.mcap", rig()), code=0)
    assert said.stdout == "3 sources of rotation, consistent\n"


def test_a_corrected_log_is_consistent(tmp_path):
    """The command line that is printed applies every remedy."""
    faulty = FAULTS["late"][0](FAULTS["deg/s read as rad/s"][0](rig(8)))
    log = bag(tmp_path / "rig.mcap", faulty)
    lines = run("crosscheck", log, code=1).stdout.splitlines()
    assert lines[0] == "3 sources of rotation, inconsistent"
    assert lines[1].startswith("fault    /imu rates  deg/s read as rad/s")
    assert lines[1].endswith("   --rate-unit deg/s")
    assert lines[2].startswith("differs  /mocap      is late by ")
    head, *again = shlex.split(lines[-1].removeprefix("corrected: "))
    assert head == "quatprop"
    assert run(*again, code=0).stdout == "3 sources of rotation, consistent\n"


def test_remedies_are_options_of_the_commands_that_read_the_source(tmp_path):
    """What is read with the option of a finding agrees with the other sources."""
    faulty = FAULTS["conjugate"][0](FAULTS["deg/s read as rad/s"][0](rig(9)))
    log = bag(tmp_path / "rig.mcap", faulty)
    remedies = [one.remedy for one in quatprop.crosscheck(log).findings]
    assert remedies == ["--from-direction ref-to-body", "--rate-unit deg/s"]
    with pytest.warns(quatprop.RemarkWarning, match="read in deg/s, as requested"):
        rates = quatprop.read_rates(f"{log}:/imu", rate_unit="deg/s")
    attitudes = quatprop.read_attitudes(f"{log}:/imu", from_direction="ref-to-body")
    assert quatprop.crosscheck(rates, attitudes, f"{log}:/mocap").passed


def test_a_configuration_repairs_the_gyroscope_for_propagate(tmp_path):
    """With it, propagate gives the attitudes of the motion capture; other sources are no part."""
    faulty = FAULTS["late"][0](FAULTS["mount"][0](FAULTS["deg/s read as rad/s"][0](rig(8))))
    log, made = bag(tmp_path / "rig.mcap", faulty), tmp_path / "made.toml"
    said = run("crosscheck", log, "--write-config", made, code=1)
    assert "inconsistent" in said.stdout
    assert made.read_text().splitlines() == [
        "# quatprop propagate LOG -o OUT --config THIS_FILE",
        "# by quatprop crosscheck, for '/imu rates'",
        'topic = "/imu"',
        'rate-unit = "deg/s"',
    ]
    assert run("crosscheck", log, "--write-config", "-", code=1).stdout == made.read_text()
    run("propagate", log, "-o", tmp_path / "out.csv", "--config", made, code=0)
    limits = ("--align", "mount", "--time-offset", "auto", "--tol", "4deg")
    run("compare", tmp_path / "out.csv", f"{log}:/mocap", *limits, code=0)


def test_a_configuration_is_written_for_one_gyroscope(tmp_path):
    """Not if none is wrong or several are, nor over a log."""
    sources = rig(3)
    gyro = sources[GYRO]
    table(tmp_path / "a.csv", gyro.t_ns, gyro.values)
    truth = write_attitudes(tmp_path / "truth.csv", sources[MOCAP].t_ns, sources[MOCAP].values)
    made = tmp_path / "made.toml"
    said = refused("crosscheck", truth, truth, "--write-config", made)
    assert said == "Error: there is no gyroscope to write a configuration for"
    assert not made.exists()
    table(tmp_path / "b.csv", gyro.t_ns, gyro.values)
    both = (tmp_path / "a.csv", tmp_path / "b.csv", "--write-config")
    assert refused("crosscheck", *both, made).startswith("Error: no finding is about a gyroscope")
    assert refused("crosscheck", *both, tmp_path / "b.csv").startswith(
        f"Error: {tmp_path / 'b.csv'}"
    )


def test_a_mounting_is_repaired_by_the_option_that_is_printed(tmp_path):
    """--mount of propagate takes the exchange of axes as it is printed."""
    log = bag(tmp_path / "rig.mcap", FAULTS["axes"][0](rig(9)))
    (finding,) = quatprop.crosscheck(log).findings
    mount = finding.remedy.removeprefix("--mount=")
    turned = quatprop.propagate(f"{log}:/imu", mount=mount, method="coning", q0="log")
    assert quatprop.crosscheck(turned, f"{log}:/mocap", tol_mount="5deg").passed


def test_json_has_everything(tmp_path):
    """Sources, findings and pairs, with values and their standard deviations."""
    log = bag(tmp_path / "rig.mcap", FAULTS["late"][0](rig(3)))
    report = json.loads(run("crosscheck", log, "--json", code=1).stdout)
    assert report["schema"] == "quatprop-crosscheck-1"
    assert (report["state"], report["exit"]) == ("inconsistent", 1)
    assert [one["name"] for one in report["sources"]] == [GYRO, ORIENTATION, MOCAP]
    (finding,) = report["findings"]
    assert (finding["level"], finding["code"], finding["source"]) == ("differs", "offset", MOCAP)
    assert finding["settings"]["time_offset"].endswith("ms")
    assert {one["status"] for one in report["pairs"]} == {"related"}
    assert all(one["offset_sigma_s"] > 0 for one in report["pairs"])


def test_limits_and_allowed_differences(tmp_path):
    """A difference within its limit is not stated, and an allowed one is a remark."""
    log = bag(tmp_path / "rig.mcap", FAULTS["late"][0](rig(3)))
    assert run("crosscheck", log, "--tol-offset", "200ms", code=0).stdout.count("\n") == 1
    lines = run("crosscheck", log, "--allow", "offset,mount", code=0).stdout.splitlines()
    assert lines[1].startswith("remark   /mocap")


def test_files_are_compared_too(tmp_path):
    """Two tables on one clock."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rows = np.column_stack((gyro.t_ns, gyro.values)).tolist()
    rates = write_rates(tmp_path / "rates.csv", [[int(t), *w] for t, *w in rows],
                        "t_ns,wx_rad_s,wy_rad_s,wz_rad_s")  # fmt: skip
    poses = write_attitudes(tmp_path / "poses.csv", mocap.t_ns, mocap.values)
    said = run("crosscheck", rates, poses, code=0).stdout
    assert said == "2 sources of rotation, consistent\n"


def test_an_undeclared_unit_and_layout_are_decided(tmp_path):
    """A unit and an order that nobody stated are hypotheses that the other source decides."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rows = [[t, *w] for t, w in zip(gyro.t_ns.tolist(), (gyro.values / DEG).tolist(), strict=True)]
    rates = write_rates(tmp_path / "rates.csv", rows, "t_ns,wx,wy,wz")
    xyzw = np.roll(mocap.values, -1, axis=1)
    poses = write_attitudes(tmp_path / "poses.csv", mocap.t_ns, xyzw, "t_ns,a,b,c,d")
    result = quatprop.crosscheck(rates, poses, quat_cols="a,b,c,d")
    assert [(one.code, one.source) for one in result.findings] == [
        ("reading", "poses.csv"), ("unit", "rates.csv")
    ]  # fmt: skip
    assert result.findings[0].settings == {"from_layout": "scalar-last"}
    assert result.findings[1].settings == {"rate_unit": "deg/s"}


def test_each_transform_is_a_source(tmp_path):
    """Links of a robot are different bodies: they are not compared with each other."""
    sources = rig(2)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    seconds = (mocap.t_ns - mocap.t_ns[0])[:, None] * 1e-9
    arm = exp(np.sin(seconds * [0.7, 1.1, 0.3]))
    messages = [*imu_messages(gyro.t_ns, gyro.values)]
    for t_ns, body, link in zip(mocap.t_ns.tolist(), mocap.values, arm, strict=True):
        transforms = [
            {"header": {"stamp": t_ns, "frame_id": parent}, "child_frame_id": child,
             "transform": {"rotation": [*q[1:].tolist(), float(q[0])]}}
            for parent, child, q in (("map", "base", body), ("base", "arm", link))
        ]  # fmt: skip
        messages.append(("/tf", TF, t_ns, {"transforms": transforms}))
    path = write_messages(tmp_path / "rig.mcap", sorted(messages, key=lambda one: one[2]))
    result = quatprop.crosscheck(path)
    assert {one.name for one in result.sources} >= {"/tf map:base", "/tf base:arm"}
    assert {pair.b.name for pair in result.pairs if pair.status == "related"} == {"/tf map:base"}
    assert result.passed


def test_series_in_memory_are_sources():
    """A notebook compares what it has."""
    sources = rig(5)
    rates = GyroSeries(sources[GYRO].t_ns, sources[GYRO].values)
    truth = AttitudeSeries(sources[MOCAP].t_ns, sources[MOCAP].values)
    assert quatprop.crosscheck(rates, truth).passed
    turned = AttitudeSeries(truth.t_ns, multiply(truth.wxyz, exp(np.array([0.0, 0.2, 0.0]))))
    wrong = AttitudeSeries(truth.t_ns, conjugate(truth.wxyz))
    assert [one.code for one in quatprop.crosscheck(rates, turned).findings] == ["mount"]
    assert [one.code for one in quatprop.crosscheck(rates, wrong).findings] == ["reading"]


def test_one_source_is_nothing_to_compare(tmp_path):
    """Exit code 2, with the reason."""
    gyro = rig()[GYRO]
    log = write_messages(tmp_path / "gyro.mcap", imu_messages(gyro.t_ns, gyro.values))
    assert run("crosscheck", log, code=2).stdout == "2 sources of rotation, nothing to compare\n"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--correct", "rate-unit=deg/s"], "'rate-unit=deg/s' is not a setting of a source"),
        (["--correct", "/imu:unit=deg/s"], "'unit' is not one of 'from_layout'"),
        (["--correct", "/nowhere:rate-unit=deg/s"], "no source '/nowhere'"),
        (["--correct", "/imu rates:mount=x,y,z,w"], "'x,y,z,w' is not a mounting"),
        (["--allow", "everything"], "'everything' is not one of"),
        (["--tol-mount", "2parsec"], "'2parsec' is not an angle"),
    ],
)
def test_refusals(tmp_path, options, sentence):
    """What is wrong is said in one sentence."""
    log = bag(tmp_path / "rig.mcap", rig())
    assert sentence in refused("crosscheck", log, *options)


@pytest.mark.parametrize("row", [20, 1500])
def test_one_timestamp_far_ahead_does_not_hide_what_follows(tmp_path, row):
    """All samples after it were left out as earlier."""
    rates, truth = quatprop.simulate(motion="tumbling", duration="30s")
    t_ns, rate = rates.t_ns.copy(), rates.rate
    t_ns[row] += 3_600_000_000_000
    path = write_rates(
        tmp_path / "rates.csv",
        [(t, *w) for t, w in zip(t_ns.tolist(), rate.tolist(), strict=True)],
        "t_ns,wx_rad_s,wy_rad_s,wz_rad_s",
    )
    reference = write_attitudes(tmp_path / "truth.csv", truth.t_ns, truth.wxyz)
    said = json.loads(run("crosscheck", path, reference, "--json", code=3).stdout)
    (used,) = (one for one in said["sources"] if one["kind"] == "rates")
    assert used["samples"] == len(rates) - 1


def table(path, t_ns, rate):
    """Write rates as a table; return the path."""
    path.parent.mkdir(exist_ok=True)
    rows = [(t, *w) for t, w in zip(t_ns.tolist(), rate.tolist(), strict=True)]
    return write_rates(path, rows, "t_ns,wx_rad_s,wy_rad_s,wz_rad_s")


def test_files_of_one_name_are_two_devices(tmp_path):
    """Two loggers write files of the same name: they were taken for one device."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    poses = write_attitudes(tmp_path / "poses.csv", mocap.t_ns, mocap.values)
    scaled = [table(tmp_path / name / "imu.csv", gyro.t_ns, gyro.values * factor)
              for name, factor in (("a", 1.0), ("b", 1.2))]  # fmt: skip
    result = quatprop.crosscheck(*scaled, poses)
    assert [one.name for one in result.sources] == [*map(str, scaled), "poses.csv"]
    assert len({one.device for one in result.sources}) == 3
    assert [(one.level, one.code, one.source) for one in result.findings] == [
        ("differs", "scale", str(scaled[1]))
    ]


def test_what_is_left_out_is_lost(tmp_path):
    """Samples that cannot be used are told with their file, and exit and JSON agree on code 3."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rate, t_ns, wxyz = gyro.values.copy(), gyro.t_ns.copy(), mocap.values.copy()
    rate[100:103] = np.nan
    t_ns[[500, 501]] = t_ns[[501, 500]]
    wxyz[7] = 0.0
    logs = [table(tmp_path / "imu.csv", t_ns, rate)]
    logs.append(write_attitudes(tmp_path / "poses.csv", mocap.t_ns, wxyz))
    said = run("crosscheck", *logs, code=3)
    assert said.stdout == "2 sources of rotation, consistent\n"
    count = len(gyro.t_ns)
    left_out = "samples are left out"
    assert said.stderr.splitlines()[-2:] == [
        f"lost: imu.csv rates: 4 of {count} {left_out}: 3 are not finite, 1 timestamp out of order",
        f"lost: poses.csv orientation: 1 of {len(mocap.t_ns)} {left_out}: 1 all zero",
    ]
    assert said.stderr.startswith("warning: imu.csv: 1 non-monotonic timestamp (dropped), first at")
    report = json.loads(run("crosscheck", *logs, "--json", code=3).stdout)
    assert (report["state"], report["exit"]) == ("consistent", 3)
    assert {one["code"] for one in report["remarks"]} == {"stamps-back", "nonfinite-rates"}
    assert [one["messages"] for one in report["losses"]] == [4, 1]


def test_losses_name_their_file(tmp_path):
    """Of several files, a part that cannot be read is told with the name of its file."""
    log = bag(tmp_path / "rig.mcap", rig())
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    said = run("crosscheck", log, cut, code=3)
    assert "\nlost: cut.mcap, " in f"\n{said.stderr}"
    report = json.loads(run("crosscheck", log, cut, "--json", code=3).stdout)
    assert report["exit"] == 3
    assert report["losses"][0]["place"].startswith("cut.mcap, ")
