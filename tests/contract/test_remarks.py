"""Every remark: what provokes it, and what is near to that and must not."""

import math
import re
from contextlib import suppress
from itertools import product

import numpy as np
import pytest
from fuzz.remarks import false_remarks
from make.places import ROOT, SAMPLE_LOGS
from make.remarked import REMEDIES, TABLE, TRUTHS

import quatprop
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.propagation.survey import survey
from quatprop.settings.reading import RateSelection

NAMED = re.compile(r"(\w+)=('[^']*'(?: or '[^']*')*)")
"""A setting and the values that a remark names."""


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("code", TABLE)
def test_a_remark_is_made_where_it_is_true_and_not_next_to_that(tmp_path, code):
    """The log that provokes it, and one that is near to that."""
    for number, made in enumerate(TABLE[code]):
        folder = tmp_path / str(number)
        folder.mkdir()
        said = {remark.code: str(remark) for remark in made(folder)}
        assert (code in said) == (not number), said
        # The other rest, which is taken by its remedy, differs as well: that is tested with rests.
        # The sample rate is the one that is given. Of two ranges, each is tried by itself.
        tried = {"rests-differ", "stamps-unused", "other-rate", "contradicts-later"}
        tried |= {"recordings-joined", "unit-changes"}
        is_tried = code in {*REMEDIES} | tried
        assert is_tried or not NAMED.search(said.get(code, "")), "try its remedy"


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("code", REMEDIES)
def test_the_remedy_that_a_remark_names_removes_it(tmp_path, code):
    """One of the values, if there are several; some were refused, or were given already.

    The attitudes are then those of the body, if these are known, and were not before.
    """
    (tmp_path / "0").mkdir()
    before = REMEDIES[code](tmp_path / "0")
    said = {remark.code: str(remark) for remark in before}[code]
    values = {name: re.findall("'([^']*)'", text) for name, text in NAMED.findall(said)}
    tries = [dict(zip(values, each, strict=True)) for each in product(*values.values())]
    found = []
    for number, options in enumerate(tries, 1):
        (tmp_path / str(number)).mkdir()
        # Of several units only some may be possible.
        with suppress(*[quatprop.QuatpropError] * bool(tries[1:])):
            found.append(REMEDIES[code](tmp_path / str(number), **options))
    mended = [each for each in found if code not in {one.code for one in each}]
    assert mended, (said, found)
    if (truth := TRUTHS.get(code)) is not None:
        assert error_of(before.attitudes, truth) > math.radians(1)
        assert min(error_of(each.attitudes, truth) for each in mended) < math.radians(0.1)


def error_of(series, truth):
    """Return the largest error of attitudes, rad; infinite at times when there is no truth."""
    places = truth.t_ns.searchsorted(series.t_ns).clip(max=len(truth) - 1)
    is_known = truth.t_ns[places] == series.t_ns
    angles = geodesic_angle(series.wxyz, truth.wxyz[places])
    return np.where(is_known, angles, np.inf).max()


def test_every_remark_has_a_row():
    """Who adds a remark says what provokes it, and what must not."""
    source = "".join(path.read_text() for path in (ROOT / "quatprop").rglob("*.py"))
    made = (
        r'(?:Remark|\.remark)\(\s*"([a-z0-9-]+)"',
        r'\("(\w+-\w+|gaps)", counts\.',
        r'"(rest[a-z-]+)": self',
    )
    assert {code for pattern in made for code in re.findall(pattern, source)} == TABLE.keys()


# --- logs that are well, and recordings

RECORDINGS = {
    "auk/auk.bag": set(),
    # The cameras did not see the body all the time.
    "broad/18_undisturbed_fast_translation_with_breaks_B.hdf5": {"invalid-quaternions"},
    "csv/data_xsens.txt": set(),
    "csv/euroc_v102/imu0_data.csv": set(),
    "csv/euroc_v102/state_groundtruth_data.csv": set(),
    # A dropout of 65 ms.
    "csv/px4/sample_sensor_combined_0.csv": {"gaps"},
    "csv/px4/sample_vehicle_attitude_0.csv": set(),
    "csv/rostopic_echo.csv": set(),
    "csv/xio3/Inertial.csv": set(),
    "csv/xio3/Quaternion.csv": set(),
    "csv/xio_fusion_degs.csv": set(),
    "csv/xio_gait_duplicates_degs.csv": {"repeated-stamps"},
    "irregular/tilt_laser.bag": {"jitter", "repeated-stamps"},
    "json_imu/demo.mcap": {"placeholder"},
    # Its driver scaled the rates twice, and stamps messages when they arrive.
    "nested_imu/kiran_11sec_motion/11sec_motion_0.mcap": {"jitter", "rates-off-scale"},
    # One message, of zeros.
    "rosbag2/klintan_sample.db3": {"zero-rates"},
    # A program that publishes 131, 132, 133 and a quaternion of length 196.
    "rosbag2/plotjuggler_rosbag2_test/rosbag2_test_0.db3": {
        "beyond-range",
        "frozen",
        "invalid-quaternions",
        "jitter",
        "orientation-invalid",
    },
    "rosbag2/rerun_rosbag2_2025_09_10-13_03_56_0.mcap": set(),
    "ulog/sample.ulg": {"frames-by-type", "gaps"},
}
"""Recordings, and what is true of them: each remark was checked against the log by hand."""


def codes_of(path, **options):
    """Return the codes of all remarks on the signals of a log."""
    found = survey(str(path), None, RateSelection(**options))
    return {one.code for signal in (*found.sources, *found.attitudes) for one in signal.remarks}


@pytest.mark.parametrize("name", RECORDINGS)
def test_what_is_said_of_a_recording_is_true(shared_logs, name):
    """And there is nothing else."""
    no_unit = name.endswith((".hdf5", ".txt"))
    options = {"rate_unit": "rad/s"} if no_unit else {}
    assert codes_of(shared_logs / name, **options) == RECORDINGS[name]


@pytest.mark.parametrize(
    "name", ["spin.csv", "coning.mcap", "tumbling.bag", "tumbling_ros2", "rest.parquet"]
)
def test_of_the_sample_logs_one_is_said_to_be_simulated(name):
    """As it is: a spin without noise has one rate."""
    assert codes_of(SAMPLE_LOGS / name) == ({"frozen"} if name == "spin.csv" else set())


def test_nothing_false_is_said_of_logs_that_are_well():
    """Rounded peaks were saturated, rounded rates were held, of 25 of 120 such logs."""
    for seed in range(60):
        said, how = false_remarks(seed)
        assert not said, (seed, how, said)
