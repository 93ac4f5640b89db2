"""`quatprop check` over real recordings, which have errors of their own."""

import json
import math

import pytest
from make.suites import check

pytestmark = pytest.mark.usefixtures("no_causes")

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
    """At 1.2 times the errors of today it passes; with a mistake, another for each, it fails."""
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
    wrong = {
        # About z, xio3 has such a bias of the other sign itself.
        "bias": f"bias = {[x + more, y, z]}\n",
        "side": f'{usual}rates = "inertial"\n',
        "conjugate": f'{usual}reference-from-direction = "ref-to-body"\n',
        "scale": f'{usual}calibration = "scale.yaml"\n',
    }
    chosen = list(wrong)[list(TRUTHS).index(name)]
    cases = {"pass": usual, chosen: wrong[chosen]}
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


def test_recordings_pass_against_their_own_references(shared_logs, tmp_path):
    """Whatever is wrong with their stamps; references stay small."""
    suite = tmp_path / "suite.toml"
    text = ""
    for number, (name, options) in enumerate(LOGS.items()):
        text += f'[case."{name}"]\nlog = "{shared_logs / name}"\n{options}\n'
        text += f'reference = "{number}.parquet"\n'
    suite.write_text(text)
    for options in (["--update"], []):
        result = check(suite, *options)
        assert result.stdout.splitlines()[-1] == f"{len(LOGS)} cases: {len(LOGS)} passed"
    sizes = [path.stat().st_size for path in tmp_path.rglob("*.parquet")]
    assert sum(sizes) < 25_000 * len(LOGS)
