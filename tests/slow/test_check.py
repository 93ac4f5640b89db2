"""`quatprop check` over real recordings, which have errors of their own."""

import json
import math
import shutil

import pytest
from make.suites import check

TRUTHS = {
    "auk": ["auk/auk.bag", "/vicon/auk/auk", "mount", (25.65, 10.87, 12.11, 4.921)],
    "euroc": [
        "csv/euroc_v102/imu0_data.csv",
        "csv/euroc_v102/state_groundtruth_data.csv",
        "mean",
        (0.3334, 0.2023, 0.5925, 0.2776),
    ],
    "xio3": [
        "csv/xio3/Inertial.csv",
        "csv/xio3/Quaternion.csv",
        "mean",
        (5.009, 2.517, 6.992, 4.460),
    ],
    "px4": [
        "csv/px4/sample_sensor_combined_0.csv",
        "csv/px4/sample_vehicle_attitude_0.csv",
        "mean",
        (7.895, 4.325, 1.551, 1.103),
    ],
}
"""Recording -> log, reference, alignment, and worst and RMS error, overall and over 5 s, deg."""

LIMITS = ("tol", "rms-tol", "window-tol", "window-rms-tol")
OFFSETS = {"auk", "xio3", "px4"}
"""Recordings whose two clocks differ."""
BIASES = {"euroc": [-0.002, 0.0208, 0.0758]}
DEG_S = {"xio3"}
"""Recordings whose rates, and so whose biases, are in deg/s."""


@pytest.mark.parametrize("name", TRUTHS)
def test_criteria_tell_regressions_from_the_errors_of_a_recording(shared_logs, tmp_path, name):
    """At 1.2 times the errors of today, it passes; a bias of 0.02 rad/s, a wrong side, a conjugate
    and a scale error of 5 % fail.
    """
    (tmp_path / "scale.yaml").write_text("matrix: [[1.05, 0, 0], [0, 1.05, 0], [0, 0, 1.05]]\n")
    log, reference, align, errors = TRUTHS[name]
    key, folder = ("topic", "") if reference.startswith("/") else ("log", f"{shared_logs}/")
    always = (
        f'log = "{shared_logs / log}"\nalign = "{align}"\nreference-{key} = "{folder}{reference}"\n'
    )
    always += 'time-offset = "auto"\n' if name in OFFSETS else ""
    for limit, error in zip(LIMITS, errors, strict=True):
        always += f'{limit} = "{1.2 * error:.6f}deg"\n'
    x, y, z = BIASES.get(name, [0.0, 0.0, 0.0])
    more = math.degrees(0.02) if name in DEG_S else 0.02
    usual = f"bias = {[x, y, z]}\n" if name in BIASES else ""
    cases = {
        "pass": usual,
        # About z, xio3 has such a bias of the other sign itself.
        "bias": f"bias = {[x + more, y, z]}\n",
        "side": f'{usual}rates = "inertial"\n',
        "conjugate": f'{usual}reference-from-direction = "ref-to-body"\n',
        "scale": f'{usual}calibration = "scale.yaml"\n',
    }
    suite = tmp_path / "suite.toml"
    suite.write_text(
        '[defaults]\nmethod = "mean"\nwindow = "5s"\n'
        + "".join(f"[case.{case}]\n{always}{lines}" for case, lines in cases.items())
    )
    judged = json.loads(check(suite, "--update", "--json").stdout)["cases"]
    verdicts = {case["name"]: case["verdict"] for case in judged}
    assert verdicts == dict.fromkeys(cases, "fail") | {"pass": "pass"}


LOGS = {
    "auk/auk.bag": "",
    "auk/auk_mcap_zstd": "",
    "csv/data_xsens.txt": 'rate-unit = "rad/s"',
    "csv/px4/sample_sensor_combined_0.csv": "",
    "csv/rostopic_echo.csv": "",
    "csv/xio_gait_duplicates_degs.csv": "",
    "husky/test1_husky.bag": "",
    "json_imu/demo.mcap": "",
    "nested_imu/kiran_11sec_motion": "",
    "nested_imu/kiran_car_circle_data_0_imu.csv": 'rate-unit = "rad/s"\ntime-unit = "s"',
    "rosbag2/klintan_sample.db3": "",
    "two_imus/test1_2014_xsens.bag": 'topic = "/xsens/imu_data"',
}
"""Recordings that hold rates, and what they cannot be read without."""

TRUTH = """
[case.truth]
log = "{0}/csv/euroc_v102/imu0_data.csv"
method = "mean"
bias = [-0.002, 0.0208, 0.0758]
reference-log = "{0}/csv/euroc_v102/state_groundtruth_data.csv"
align = "mean"
tol = "1deg"
"""


def judged(suite, *options):
    """Return the exit code, and name -> outcome of those that do not pass."""
    result = check(suite, "--json", *options)
    cases = json.loads(result.stdout)["cases"]
    assert len(cases) == len(LOGS) + 1
    return result.exit_code, {case["name"]: case for case in cases if case["verdict"] != "pass"}


def test_all_recordings_pass_and_what_is_broken_is_found(shared_logs, tmp_path):
    """Of bytes, options, tolerances, references exactly the broken ones fail, each with why."""
    bag = shutil.copyfile(shared_logs / "husky/test1_husky.bag", tmp_path / "husky.bag")
    text = TRUTH.format(shared_logs)
    for name, options in LOGS.items():
        log = bag if name.startswith("husky") else shared_logs / name
        text += f'[case."{name}"]\nlog = "{log}"\nreference = "refs/{name}.parquet"\n{options}\n'
    suite = tmp_path / "suite.toml"
    suite.write_text(text)
    assert judged(suite, "--update") == (0, {})
    refs = tmp_path / "refs"
    assert sum(path.stat().st_size for path in refs.rglob("*.parquet")) < 25_000 * len(LOGS)

    content = bytearray(bag.read_bytes())
    content[len(content) // 2] ^= 1
    bag.write_bytes(content)
    shutil.copyfile(refs / "auk/auk.bag.parquet", refs / "csv/rostopic_echo.csv.parquet")
    text = text.replace('topic = "/xsens/imu_data"', 'topic = "/xsens/imu_data"\nmethod = "end"')
    suite.write_text(text.replace('tol = "1deg"', 'tol = "0.01deg"'))
    code, found = judged(suite, "-j", "2")
    reasons = {
        "husky/test1_husky.bag": "husky.bag: its content changed since the reference was",
        "csv/rostopic_echo.csv": "case 'auk/auk.bag' instead of 'csv/rostopic_echo.csv'",
        "two_imus/test1_2014_xsens.bag": "method was the default and is now 'end'",
        "truth": "above the tolerance, first at +",
    }
    assert (code, found.keys()) == (2, reasons.keys())
    assert all(reason in found[name]["reason"] for name, reason in reasons.items())
    assert found["truth"]["verdict"] == "fail"
