"""Data next to attitudes: kept where source and output have room for it, reported where not."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from make.commands import run
from make.ros import imu_messages, write_messages
from make.small_files import QUATERNION
from make.tables import write_rates
from rosbags.highlevel import AnyReader

import quatprop
from quatprop.base.errors import SeriesError
from quatprop.kinematics.quaternion import reference_covariance

POSITIONS = "the positions of the attitudes are not kept: the output has no place for them"
COVARIANCES = "the standard deviations or covariances of the attitudes are not kept"
SIGMAS = ["sigma_x", "sigma_y", "sigma_z"]
SIGMA_TABLE = f"{QUATERNION},{','.join(SIGMAS)}"


def convert(*arguments, code=0):
    """Return what a conversion says."""
    return run("convert", *arguments, code=code).stderr


def trajectory(path):
    """Return the rows of a TUM trajectory as text."""
    return [line.split() for line in path.read_text().splitlines()[1:]]


@pytest.fixture(scope="module")
def vicon(shared_logs, tmp_path_factory):
    """Return the Vicon poses of a recording: as rosbags reads them, and as a trajectory."""
    log = shared_logs / "auk" / "auk.bag"
    with AnyReader([log]) as reader:
        chosen = [one for one in reader.connections if one.topic == "/vicon/auk/auk"]
        messages = [reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages(chosen)]
    points = [one.transform.translation for one in messages]
    path = tmp_path_factory.mktemp("vicon") / "vicon.tum"
    assert POSITIONS not in convert(log, path, "-t", "/vicon/auk/auk")
    return np.array([[p.x, p.y, p.z] for p in points]), path


def test_a_vicon_topic_becomes_a_trajectory_with_its_positions(vicon, tmp_path):
    """To the bit, in the library too: each number is the shortest decimal of it."""
    expected, path = vicon
    assert np.abs(expected).max() > 0.1
    assert (np.array(trajectory(path))[:, 1:4].astype(float) == expected).all()
    series = quatprop.read_attitudes(path)
    assert (series.position == expected).all()
    quatprop.write(series, tmp_path / "again.tum")
    assert (tmp_path / "again.tum").read_bytes() == path.read_bytes()
    assert quatprop.AttitudeSeries([0], [[1, 0, 0, 0]]).position is None
    with pytest.raises(SeriesError, match="position"):
        quatprop.AttitudeSeries([0], [[1, 0, 0, 0]], [[1, 2]])


@pytest.fixture
def poses(tmp_path):
    """Return a trajectory of three poses."""
    path = tmp_path / "poses.tum"
    rows = [f"{k}.000000001 {0.1 * k!r} -{k}.5 1e-09 0.6 0 0 0.8" for k in range(1, 4)]
    path.write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *rows, ""]))
    return path


@pytest.mark.parametrize(
    "words",
    [
        "euroc.csv --to euroc",
        "pose.mcap --message PoseStamped",
        "pose.bag --message PoseStamped",
        "tf.mcap --message TFMessage",
    ],
)
def test_formats_with_positions_give_them_back(poses, tmp_path, words):
    """There and back again is the same trajectory."""
    name, *options = words.split()
    there, back = tmp_path / name, tmp_path / "back.tum"
    assert POSITIONS not in convert(poses, there, *options)
    assert POSITIONS not in convert(there, back)
    found, expected = (np.array(trajectory(path), float) for path in (back, poses))
    np.testing.assert_array_equal(found, expected)


ABSENT = {
    POSITIONS: (
        "out.csv --layout wxyz",
        "out.parquet",
        "out.mcap --message QuaternionStamped",
        "out.mcap --message PoseInFrame",
        "out.csv --as rotvec",
        # They would be those of another frame: they are zero then.
        "out.tum --from-direction ref-to-body",
    ),
    COVARIANCES: (
        "out.tum",
        "out.mcap",
        "out.csv --as rotvec",
        "out.csv --direction ref-to-body",
        "out.csv --from-direction ref-to-body",
    ),
}


def test_an_output_without_positions_or_standard_deviations_says_so(poses, sigmas, tmp_path):
    """A sentence names what is lost."""
    for source, (sentence, outputs) in zip((poses, sigmas), ABSENT.items(), strict=True):
        for words in outputs:
            name, *options = words.split()
            assert sentence in convert(source, tmp_path / name, *options)
            if source == poses and name == "out.tum":
                assert {tuple(row[1:4]) for row in trajectory(tmp_path / name)} == {("0",) * 3}


def test_attitudes_without_positions_are_at_the_origin(tmp_path):
    """Nothing is lost, so there is no remark."""
    path, out = write_rates(tmp_path / "in.csv", ["0,1,0,0,0"], QUATERNION), tmp_path / "out.tum"
    assert POSITIONS not in convert(path, out)
    assert trajectory(out)[0][1:4] == ["0"] * 3


def test_a_ground_truth_keeps_its_positions(tmp_path):
    """Columns with a unit in their names; attitudes that are dropped take theirs along."""
    names = [f"p_RS_R_{axis} [m]" for axis in "xyz"] + [f"q_RS_{part} []" for part in "wxyz"]
    head = ", ".join(["#timestamp", *names])
    rows = ["1000000000,1.5,2.5,-3.25,1,0,0,0", "2000000000,9,9,9,0,0,0,0"]
    path, out = write_rates(tmp_path / "truth.csv", rows, head), tmp_path / "out.tum"
    convert(path, out, "--on-invalid", "drop", code=3)
    assert [row[:4] for row in trajectory(out)] == [["1.000000000", "1.5", "2.5", "-3.25"]]


@pytest.fixture
def sigmas(tmp_path):
    """Return a table with standard deviations about body axes."""
    rows = ["0,1,0,0,0,0,0,0", "1000000000,0.6,0,0.8,0,0.1,0.2,0.3"]
    return write_rates(tmp_path / "in.csv", rows, SIGMA_TABLE)


@pytest.mark.parametrize("name", ["out.csv", "out.parquet", "out.npz", "out.jsonl"])
def test_tables_keep_standard_deviations_to_the_bit(sigmas, tmp_path, name):
    """There and back again they are the same numbers."""
    there, back = tmp_path / name, tmp_path / "back.csv"
    for source, out in ((sigmas, there), (there, back)):
        said = convert(source, out)
        assert COVARIANCES not in said
        assert ",".join(("qw,qx,qy,qz", *SIGMAS)) in said
    assert back.read_text() == sigmas.read_text()


@pytest.mark.parametrize("message", ["PoseWithCovarianceStamped", "Imu"])
def test_messages_keep_covariances(sigmas, tmp_path, message):
    """About the axes of the reference there, about those of the body in a table."""
    there, back = tmp_path / "out.mcap", tmp_path / "back.csv"
    assert COVARIANCES not in convert(sigmas, there, "--message", message)
    assert COVARIANCES not in convert(there, back)
    covariance = np.array([np.zeros((3, 3)), np.diag([0.01, 0.04, 0.09])])
    series = quatprop.read_attitudes(there)
    np.testing.assert_allclose(series.covariance, covariance, atol=1e-16)
    last = [float(number) for number in back.read_text().splitlines()[-1].split(",")[5:]]
    np.testing.assert_allclose(last, [0.1, 0.2, 0.3], rtol=1e-14)
    assert COVARIANCES in convert(there, tmp_path / "out.tum")


def test_axes_of_the_reference_remain_theirs(tmp_path):
    """The metadata say about which axes they are, and still do."""
    rates = quatprop.GyroSeries([0, 10**9, 2 * 10**9], [[0.3, 0, 0], [0, 0.3, 0], [0, 0, 0]])
    errors = {"noise_density": 1e-3, "scale_sigma": 1e-2, "sigma_axes": "reference"}
    made = quatprop.propagate(rates, sigma=True, **errors)
    first, second = tmp_path / "a.parquet", tmp_path / "b.parquet"
    quatprop.write(made, first)
    convert(first, second)
    columns = [pq.read_table(path).select(SIGMAS).to_pandas() for path in (first, second)]
    np.testing.assert_allclose(*columns, rtol=1e-12)
    in_reference = reference_covariance(made.wxyz, made.covariance)
    variances = np.diagonal(in_reference, axis1=1, axis2=2)
    np.testing.assert_allclose(columns[0], np.sqrt(variances), rtol=1e-12)


@pytest.mark.parametrize("changes", [True, False])
@pytest.mark.parametrize("ours", [True, False])
def test_covariances_that_are_constant_at_first_are_kept(tmp_path, changes, ours):
    """Only a driver says the same to the end; messages of this package are none of a driver."""
    t_ns = np.arange(19_000, dtype=np.int64) * 10_000_000
    covariance = np.tile(np.diag([0.01, 0.04, 0.09]), (len(t_ns), 1, 1))
    if changes:
        covariance[-1] *= 4
    wxyz = np.tile([1.0, 0, 0, 0], (len(t_ns), 1))
    series = quatprop.AttitudeSeries(t_ns, wxyz, covariance=covariance)
    log, back = tmp_path / "log.mcap", tmp_path / "back.parquet"
    quatprop.write(series, back)
    convert(back, log, "--message", "PoseWithCovarianceStamped")
    if not ours:
        log.write_bytes(log.read_bytes().replace(b"quatprop", b"another."))
    is_constant = not (changes or ours)
    sentence = "the covariance of the orientation does not change in 19000 messages, so it is"
    assert (sentence in convert(log, back)) == is_constant
    names = [name for name in pq.read_schema(back).names if name in SIGMAS]
    assert names == ([] if is_constant else SIGMAS)
    if is_constant:
        with pytest.warns(quatprop.RemarkWarning, match=sentence):
            assert quatprop.read_attitudes(log).covariance is None
    else:
        np.testing.assert_allclose(quatprop.read_attitudes(log).covariance, covariance, rtol=1e-14)


def test_covariances_that_are_known_in_part_are_said_to_be_unknown(tmp_path):
    """A row has three standard deviations or none; two of three would be lost unseen."""
    log = tmp_path / "log.mcap"
    diagonals = [[1.0, 4, 9], [1, 4, -1], [1, np.nan, 9], [-1, -1, -1], [np.nan] * 3]
    wxyz, covariances = [(0.8, 0.0, 0.6, 0.0)] * 5, [np.diag(one).ravel() for one in diagonals]
    t_ns = np.arange(1, 6) * 10**9
    write_messages(log, imu_messages(t_ns, wxyz=wxyz, orientation_covariance=covariances))
    sentence = "2 messages have incomplete covariances, which are treated as unknown"
    with pytest.warns((quatprop.RemarkWarning, quatprop.DataLossWarning)) as caught:
        series = quatprop.read_attitudes(log, on_invalid="drop")
    assert sum(sentence in str(one.message) for one in caught) == 1
    assert np.isfinite(series.covariance).all(axis=(1, 2)).tolist() == [True, False, False, False]
    assert convert(log, tmp_path / "back.csv", "--on-invalid", "drop", code=3).count(sentence) == 1


def test_messages_without_covariances_have_none_when_they_are_read_again(tmp_path):
    """An Imu has zeros then, which are not exact attitudes: nothing is lost, nothing is sigma."""
    rows = [f"{t},0.6,0.8,0,0" for t in range(1, 4)]
    table, log = write_rates(tmp_path / "in.csv", rows, QUATERNION), tmp_path / "log.mcap"
    convert(table, log, "--message", "Imu")
    assert COVARIANCES not in convert(log, tmp_path / "back.tum")
    assert quatprop.read_attitudes(log).covariance is None
