"""`quatprop check` over the real recordings: all pass; of what is broken, nothing does."""

import json
import shutil

import pytest
from click.testing import CliRunner

from quatprop.cli.commands import cli

LOGS = {
    "auk/auk.bag": "",
    "auk/auk_mcap_zstd": "",
    "auk/auk_sqlite3_zstdfile": "",
    "csv/data_xsens.txt": 'rate-unit = "rad/s"',
    "csv/euroc_v102/imu0_data.csv": "",
    "csv/px4/sample_sensor_combined_0.csv": "",
    "csv/rostopic_echo.csv": "",
    "csv/xio3/Inertial.csv": "",
    "csv/xio_fusion_degs.csv": "",
    "csv/xio_gait_duplicates_degs.csv": "",
    "husky/test1_husky.bag": "",
    "irregular/test3_2014_ardrone.bag": "",
    "irregular/tilt_laser.bag": "",
    "json_imu/demo.mcap": "",
    "nested_imu/kiran_11sec_motion": "",
    "nested_imu/kiran_car_circle_data_0_imu.csv": 'rate-unit = "rad/s"\ntime-unit = "s"',
    "rosbag2/geocam_all_types": "",
    "rosbag2/klintan_sample.db3": "",
    "rosbag2/plotjuggler_rosbag2_test": "",
    "rosbag2/rerun_rosbag2_2025_09_10-13_03_56_0.mcap": "",
    "rosbag2/test_bag_mcap.mcap": "",
    "two_imus/test1_2014_xsens.bag": 'topic = "/xsens/imu_data"',
}
"""Recordings that hold rates, and what they cannot be read without; of auk's forms three."""

TRUTHS = """
[case.vicon]
log = "logs/auk/auk.bag"
method = "mean"
reference-topic = "/vicon/auk/auk"
align = "mount"
time-offset = "auto"
tol = "30deg"

[case.truth]
log = "logs/csv/euroc_v102/imu0_data.csv"
method = "mean"
bias = [-0.002, 0.0208, 0.0758]
reference-log = "logs/csv/euroc_v102/state_groundtruth_data.csv"
align = "mean"
tol = "1deg"
"""


def judged(suite, *options):
    """Return the exit code, and name -> outcome of those that do not pass."""
    result = CliRunner().invoke(cli, ["check", str(suite), "--json", *options])
    cases = json.loads(result.stdout)["cases"]
    assert len(cases) == len(LOGS) + 2
    return result.exit_code, {case["name"]: case for case in cases if case["verdict"] != "pass"}


@pytest.fixture(scope="module")
def suite(shared_logs, tmp_path_factory):
    """Make a suite over copies of all recordings that hold rates."""
    folder = tmp_path_factory.mktemp("recordings")
    text = TRUTHS
    for name, options in LOGS.items():
        source, target = shared_logs / name, folder / "logs" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        # Contents alone: the recordings are read-only, and their copies are to be broken.
        if source.is_dir():
            target.mkdir()
            for part in source.iterdir():
                shutil.copyfile(part, target / part.name)
        else:
            shutil.copyfile(source, target)
        text += (
            f'[case."{name}"]\nlog = "logs/{name}"\nreference = "refs/{name}.parquet"\n{options}\n'
        )
    truth = "csv/euroc_v102/state_groundtruth_data.csv"
    shutil.copyfile(shared_logs / truth, folder / "logs" / truth)
    path = folder / "suite.toml"
    path.write_text(text)
    return path


def test_all_recordings_pass_and_what_is_broken_is_found(suite):
    """Of bytes, options, tolerances, references exactly the broken ones fail, each with why."""
    folder = suite.parent
    assert judged(suite, "--update") == (0, {})
    kept = sum(path.stat().st_size for path in (folder / "refs").rglob("*.parquet"))
    assert kept < 25_000 * len(LOGS)

    bag = folder / "logs" / "husky" / "test1_husky.bag"
    content = bytearray(bag.read_bytes())
    content[len(content) // 2] ^= 1
    bag.write_bytes(content)
    reference = folder / "refs" / "csv" / "rostopic_echo.csv.parquet"
    shutil.copyfile(folder / "refs" / "auk" / "auk.bag.parquet", reference)
    text = suite.read_text()
    text = text.replace('topic = "/xsens/imu_data"', 'topic = "/xsens/imu_data"\nmethod = "end"')
    suite.write_text(text.replace('tol = "1deg"', 'tol = "0.01deg"'))
    code, found = judged(suite, "-j", "2")
    assert code == 2
    words = {
        "husky/test1_husky.bag": "test1_husky.bag: its content changed since the reference was",
        "csv/rostopic_echo.csv": "case 'auk/auk.bag' instead of 'csv/rostopic_echo.csv'",
        "two_imus/test1_2014_xsens.bag": "method was the default and is now 'end'",
        "truth": "above the tolerance, first at +",
    }
    assert found.keys() == words.keys()
    for name, reason in words.items():
        assert reason in found[name]["reason"]
    assert found["truth"]["verdict"] == "fail"
