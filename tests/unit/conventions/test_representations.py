"""Rotation vectors, angles and matrices as tables of attitudes, and back into quaternions."""

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from make.places import SAMPLE_LOGS
from scipy.spatial.transform import Rotation

from quatprop import RemarkWarning, convert, read_attitudes, write
from quatprop.cli.commands import cli
from quatprop.conventions.representations import REPRESENTATIONS, from_euler, from_matrices
from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.logs.interpolation import stamps_in
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.settings import EULER_SEQUENCES
from quatprop.settings.selection import AttitudeSelection
from quatprop.tables.model import Stamp
from quatprop.writers import open_table
from quatprop.writers.formats import WRITERS

HALF = np.sqrt(0.5)
TABLES = [kind for kind, known in WRITERS.items() if known.columns]
OPTIONS = {
    "rotvec": ["--as", "rotvec"],
    "euler-zyx": ["--as", "euler-zyx"],
    "euler-zyx-deg": ["--as", "euler-zyx", "--euler-unit", "deg"],
    "euler-zxz": ["--as", "euler-zxz"],
    "matrix": ["--as", "matrix"],
}

BY_HAND = {
    "yaw,pitch,roll": [
        ((90, 0, 0), (HALF, 0, 0, HALF)),
        ((0, 90, 0), (HALF, 0, HALF, 0)),
        ((0, 0, 90), (HALF, HALF, 0, 0)),
        # First about z, then about the new y: k and j multiply to kj = -i.
        ((90, 90, 0), (0.5, -0.5, 0.5, 0.5)),
        ((90, 0, 90), (0.5, 0.5, 0.5, 0.5)),
        ((450, 0, 0), (-HALF, 0, 0, -HALF)),
    ],
    "rotvec_x,rotvec_y,rotvec_z": [
        ((0, 0, 90), (HALF, 0, 0, HALF)),
        ((180, 0, 0), (0, 1, 0, 0)),
        ((0, -90, 0), (HALF, 0, -HALF, 0)),
        ((0, 0, 0), (1, 0, 0, 0)),
    ],
}
"""Angles in deg -> wxyz, worked out from cos and sin of half the angle."""

MATRICES = [
    ((1, 0, 0, 0, 1, 0, 0, 0, 1), (1, 0, 0, 0)),
    ((0, -1, 0, 1, 0, 0, 0, 0, 1), (HALF, 0, 0, HALF)),
    ((0, 0, 1, 1, 0, 0, 0, 1, 0), (0.5, 0.5, 0.5, 0.5)),
    ((1, 0, 0, 0, -1, 0, 0, 0, -1), (0, 1, 0, 0)),
    ((-1, 0, 0, 0, 1, 0, 0, 0, -1), (0, 0, 1, 0)),
    ((-1, 0, 0, 0, -1, 0, 0, 0, 1), (0, 0, 0, 1)),
]
"""R row by row, v_ref = R v_body -> wxyz: no turn, a quarter about z, x to y to z, half turns."""


def run(*arguments, code=0):
    """Run `quatprop convert` and return the result."""
    result = CliRunner().invoke(cli, ["convert", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result


def written(tmp_path, head, rows, name="in.csv"):
    """Write a table with stamps from 0."""
    path = tmp_path / name
    lines = [",".join(map(repr, (k, *row))) for k, row in enumerate(rows)]
    path.write_text("\n".join([f"t_ns,{head}", *lines]) + "\n")
    return path


def read(path, **options):
    """Return wxyz of a table."""
    with open_log(path) as log:
        source = choose_attitudes(log, AttitudeSelection(**options))
        return np.concatenate([wxyz for _, wxyz in source.rows()])


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("names", BY_HAND)
def test_angles_are_those_worked_out_by_hand(tmp_path, names, unit):
    """Suffixes, brackets or the option say the unit; all give the same quaternions."""
    rows, expected = zip(*BY_HAND[names], strict=True)
    rows = np.array(rows) * (1.0 if unit == "deg" else np.pi / 180)
    for head, option in (
        (",".join(f"{name}_{unit}" for name in names.split(",")), None),
        (",".join(f"{name} [{unit}]" for name in names.split(",")), None),
        (",".join(f"imu.{name}" for name in names.split(",")), unit),
    ):
        found = read(written(tmp_path, head, rows.tolist()), from_angle_unit=option)
        np.testing.assert_allclose(found, expected, atol=1e-15)


@pytest.mark.parametrize("names", ["r{}{}", "m_{}{}", "rotation_{}_{}"])
@pytest.mark.parametrize("first", [0, 1])
def test_matrices_are_those_worked_out_by_hand(tmp_path, names, first):
    """Numbered from 1 or from 0, in any order of columns; transposed in the other direction."""
    rows, expected = zip(*MATRICES, strict=True)
    head = [names.format(i + first, j + first) for i in range(3) for j in range(3)]
    path = written(tmp_path, ",".join(head), rows)
    np.testing.assert_allclose(read(path), expected, atol=1e-15)
    backwards = written(tmp_path, ",".join(head[::-1]), [row[::-1] for row in rows])
    np.testing.assert_allclose(read(backwards), expected, atol=1e-15)
    other = read(path, from_direction="ref-to-body")
    np.testing.assert_allclose(other * [1, -1, -1, -1], expected, atol=1e-15)


quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


@given(st.sampled_from(list(REPRESENTATIONS.values())), st.lists(quaternions, min_size=1))
def test_each_representation_leads_back_to_its_attitude(form, rows):
    """Within rounding, wherever the attitude looks: straight up and half turns too."""
    wxyz = np.array(rows)
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    back = form.attitudes(form.values(wxyz))
    assert geodesic_angle(back, wxyz).max() < 3e-15
    np.testing.assert_allclose(np.linalg.norm(back, axis=1), 1, rtol=1e-15)


@given(
    st.sampled_from(EULER_SEQUENCES),
    st.lists(st.tuples(*[st.floats(-20, 20)] * 3), min_size=1, max_size=20),
)
def test_angles_of_any_size_are_those_of_scipy(sequence, rows):
    """Beyond half a turn, and pitch beyond 90 degrees."""
    expected = Rotation.from_euler(sequence.upper(), rows).as_quat(scalar_first=True)
    assert geodesic_angle(from_euler(sequence, np.array(rows)), expected).max() < 1e-14


@pytest.mark.parametrize(
    ("head", "options", "sequence", "order"),
    [
        ("roll_deg,pitch_deg,yaw_deg", {"from_euler": "XYZ"}, "XYZ", [0, 1, 2]),
        ("yaw_deg,pitch_deg,roll_deg", {"from_euler": "yxz"}, "YXZ", [1, 2, 0]),
        ("yaw_deg,pitch_deg,roll_deg", {"from_euler": "zyx"}, "ZYX", [0, 1, 2]),
        ("euler_zxz_1_deg,euler_zxz_2_deg,euler_zxz_3_deg", {}, "ZXZ", [0, 1, 2]),
        ("a [deg],b [deg],c [deg]", {"from_euler": "zyz", "quat_cols": "c,b,a"}, "ZYZ", [2, 1, 0]),
    ],
)
def test_angles_of_other_tools_are_read_in_their_sequence(tmp_path, head, options, sequence, order):
    """By their names, or by the option: yaw, pitch and roll are the angles about z, y and x."""
    rows = [(10.0, 20.0, 30.0), (-170.0, 5.0, 80.0)]
    path = written(tmp_path, head, rows)
    with pytest.warns(RemarkWarning):
        found = read_attitudes(path, **options).wxyz
    angles = np.array(rows)[:, order]
    expected = Rotation.from_euler(sequence, angles, degrees=True).as_quat(scalar_first=True)
    assert geodesic_angle(found, expected).max() < 1e-15 * 4


@pytest.mark.parametrize(
    ("head", "options", "sentence"),
    [
        ("a,b,c", ["--quat-cols", "a,b,c"],
         "which sequence of angles 'a', 'b', 'c' are, if they are angles (a quaternion has four "),
        ("a,b,c", ["--quat-cols", "a,b"], "'a,b' does not name 3 or 4 columns A,B,C[,D]"),
        ("qw,qx,qy,qz", ["--quat-cols", "qw,qx,qy,qz", "--from-euler", "xyz"],
         "--from-euler is about three angles, and --quat-cols names 4 columns"),
        ("yaw_deg,pitch_deg,roll_deg", ["--from-euler", "zxz"],
         ("--from-euler zxz contradicts the columns 'yaw_deg', 'pitch_deg', 'roll_deg', which by "
         "their names are angles about z, y, x; if it is right, name the columns too, with "
         "--quat-cols A,B,C")),
        ("euler_xyz_1_rad,euler_xyz_2_rad,euler_xyz_3_rad", ["--from-euler", "zyx"],
         ("--from-euler zyx contradicts the columns 'euler_xyz_1_rad', 'euler_xyz_2_rad', "
         "'euler_xyz_3_rad', which by their names are angles about x, y, z")),
        ("a,b,c", ["--from-euler", "xyz", "--quat-cols", "a,b,c"],
         "the unit of the angles 'a', 'b', 'c' is not declared; say it with --from-angle-unit"),
        ("qw,qx,qy,qz", ["--from-euler", "xyx"], "no attitudes found; its columns"),
    ],
)  # fmt: skip
def test_a_sequence_that_does_not_fit_the_columns_is_refused(tmp_path, head, options, sentence):
    """The sentence names what would."""
    path = written(tmp_path, head, [range(head.count(",") + 1)])
    assert sentence in " ".join(run(path, "-", *options, code=2).stderr.split())


def test_gimbal_lock_of_another_sequence_is_told(tmp_path):
    """Proper angles are in it where the second is 0 or 180 deg."""
    path = written(tmp_path, "euler_zxz_1_deg,euler_zxz_2_deg,euler_zxz_3_deg",
                   [(10, 0, 5), (10, 0.02, 5), (10, 179.995, 5)])  # fmt: skip
    out = tmp_path / "out.csv"
    assert (
        "note: 2 rows are within 0.01 deg of euler_zxz_2 0 or 180 deg (gimbal lock), where "
        "euler_zxz_1 and euler_zxz_3 cannot be distinguished: they share the rotation equally"
    ) in run(path, out, "--as", "euler-ZXZ", "--euler-unit", "deg").stderr
    assert out.read_text().startswith("t_ns,euler_zxz_1_deg,euler_zxz_2_deg,euler_zxz_3_deg\n0,7.5")


@given(st.lists(quaternions, min_size=1, max_size=20))
def test_matrices_are_read_as_scipy_reads_them(rows):
    """From scipy's own matrices, with w never below zero."""
    rotation = Rotation.from_quat(rows, scalar_first=True)
    found = from_matrices(rotation.as_matrix().reshape(-1, 9))
    assert geodesic_angle(found, rotation.as_quat(scalar_first=True)).max() < 1e-14
    assert (found[:, 0] >= 0).all()


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("form", OPTIONS)
@pytest.mark.parametrize("direction", ["body-to-ref", "ref-to-body"])
def test_what_is_written_is_read_and_turned_into_any_other(tmp_path, kind, form, direction):
    """Names say the rest; the direction is in the metadata where there is room, else an option."""
    random = np.random.default_rng(4)
    wxyz = random.normal(size=(50, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    source = written(tmp_path, "qw,qx,qy,qz", wxyz.tolist())
    first = tmp_path / f"first.{kind}"
    run(source, first, *OPTIONS[form], "--direction", direction)
    said = [] if WRITERS[kind].keeps_provenance else ["--from-direction", direction]
    for other, options in OPTIONS.items():
        second, back = tmp_path / f"{other}.parquet", tmp_path / "back.npz"
        run(first, second, *options, *said)
        run(second, back)
        assert geodesic_angle(read(back), wxyz).max() < 1e-14
    if WRITERS[kind].keeps_provenance:
        said = ["--from-direction", {"body-to-ref": "ref-to-body"}.get(direction, "body-to-ref")]
        assert "but the metadata of the file says" in run(first, back, *said, code=2).stderr


def test_angles_without_a_unit_are_refused(tmp_path):
    """The sentence names the option; what the names say is not overruled by it."""
    path = written(tmp_path, "yaw,pitch,roll", [(1, 2, 3)])
    assert (
        "the unit of the angles 'yaw', 'pitch', 'roll' is not declared; say it with "
        "--from-angle-unit rad|deg"
    ) in run(path, "-", code=2).stderr
    run(path, "-", "--from-angle-unit", "deg")
    named = written(tmp_path, "yaw_deg,pitch_deg,roll_deg", [(1, 2, 3)])
    assert (
        "--from-angle-unit says rad, but by their names 'yaw_deg', 'pitch_deg', 'roll_deg' are in "
        "deg; leave the option out"
    ) in run(named, "-", "--from-angle-unit", "rad", code=2).stderr
    turns = written(tmp_path, "yaw [turn],pitch [turn],roll [turn]", [(1, 2, 3)])
    assert "are declared in 'turn'; convert them to rad or deg" in run(turns, "-", code=2).stderr


@pytest.mark.parametrize(
    ("head", "options", "sentence"),
    [
        ("r11,r12,r13,r21,r22,r23,r31,r32,r33", ["--from-angle-unit", "rad"], "about angles, and"),
        ("yaw_rad,pitch_rad,roll_rad", ["--from-layout", "wxyz"], "--from-layout is about quatern"),
        ("yaw_rad,pitch_rad,roll_rad", ["--from-convention", "jpl"], "--from-convention is about"),
        ("qw,qx,qy,qz", ["--from-angle-unit", "rad"], "this table has a quaternion; leave it out"),
        ("a.yaw_rad,a.pitch_rad,a.roll_rad,b.yaw_rad,b.pitch_rad,b.roll_rad", [], "which rotation"),
        ("yaw_rate,pitch_rate,roll_rate", [], "no attitudes found; its columns are 't_ns', 'yaw_r"),
        ("omega_yaw,omega_pitch,omega_roll", [], "no attitudes found"),
        ("yaw_rad,pitch_rad", [], "no attitudes found"),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path, head, options, sentence):
    """Options that are about something else, two rotations, half of one."""
    path = written(tmp_path, head, [range(head.count(",") + 1)])
    assert sentence in run(path, "-", *options, code=2).stderr


def test_metadata_that_say_another_representation_are_refused(tmp_path):
    """Columns renamed behind the metadata's back are no guess to make."""
    path = tmp_path / "in.parquet"
    with open_table(path, ("yaw_deg", "pitch_deg", "roll_deg")) as table:
        table.write(np.array([1]), [np.array([1.0])] * 3)
        table.commit({"convention": {"representation": "euler-zyx"}})
    assert (
        "its columns are euler-zyx-deg, and the metadata of the file say euler-zyx; write the file"
    ) in run(path, "-", code=2).stderr


def test_matrices_that_are_no_rotations_are_found(tmp_path):
    """Skewed, mirrored, zero and NaN rows are located and counted; rounding of 3 digits is not."""
    good = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    rows = [good.round(4), good * 1.1, good @ np.diag([1, 1, -1]), good * 0, good * np.nan]
    head = "r11,r12,r13,r21,r22,r23,r31,r32,r33"
    path = written(tmp_path, head, [row.ravel().tolist() for row in rows])
    assert (
        "4 of 5 rows are invalid quaternions (1 off unit length by up to 0.21, 3 absent or not "
        "finite), the first is row 1 at 1 ns"
    ) in run(path, "-", code=2).stderr


def test_angles_and_vectors_that_are_not_finite_are_found(tmp_path):
    """Infinite angles have no sine, and no warning comes of it."""
    rows = [(0.1, 0.2, 0.3), (np.inf, 0, 0), (0, np.nan, 0), (1e308, 1e308, 1e308)]
    for head in ("yaw_rad,pitch_rad,roll_rad", "rotvec_x_rad,rotvec_y_rad,rotvec_z_rad"):
        path = tmp_path / "in.csv"
        lines = [f"{k},{','.join(map(str, row))}" for k, row in enumerate(rows)]
        path.write_text("\n".join([f"t_ns,{head}", *lines]) + "\n")
        assert "rows are invalid quaternions (" in run(path, "-", code=2).stderr


def test_stamps_are_those_of_the_rates_where_angles_have_no_unit(tmp_path):
    """Angles beside rates do not stand in the way of who wants the stamps alone."""
    path = written(tmp_path, "wx,wy,wz,yaw,pitch,roll", [range(6), range(6)])
    assert stamps_in(path).tolist() == [0, 1]


def test_gimbal_lock_is_told(tmp_path):
    """Rows at pitch +-90 deg are counted; the attitude survives there all the same."""
    angles = [(10, 89.98, 0), (10, 89.995, 20), (10, 90, 20), (-50, -90, 3)]
    path = written(tmp_path, "yaw_deg,pitch_deg,roll_deg", angles)
    out = tmp_path / "out.csv"
    result = run(path, out, "--as", "euler-zyx", "--euler-unit", "deg")
    assert (
        "note: 3 rows are within 0.01 deg of pitch -90 or 90 deg (gimbal lock), where yaw and roll "
        "cannot be distinguished: they share the rotation equally and jump from row to row; "
        "together they are still the attitude"
    ) in result.stderr
    assert geodesic_angle(read(out), read(path)).max() < 1e-15 * 4
    assert "cannot be distinguished" not in run(path, out, "--as", "matrix").stderr


@pytest.mark.parametrize("kind", TABLES)
def test_angles_stand_beside_the_quaternion(tmp_path, kind):
    """In propagate, convert and the library; what is read back is the quaternion."""
    log, out = SAMPLE_LOGS / "tumbling.bag", tmp_path / f"a.{kind}"
    options = ["--with", "euler-xyz", "--euler-unit", "deg"]
    names = ["euler_xyz_1_deg", "euler_xyz_2_deg", "euler_xyz_3_deg"]
    for command, target in (("propagate", ["-o", out]), ("convert", [tmp_path / f"b.{kind}"])):
        source = log if command == "propagate" else out
        arguments = [command, source, *target, *options]
        result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
        assert result.exit_code == 0, result.output
        with open_log(target[-1]) as table:
            assert table.names == ["t_ns", "qw", "qx", "qy", "qz", *names]
        wxyz = read(target[-1])
        angles = columns_in(target[-1], names)
        expected = Rotation.from_euler("XYZ", angles, degrees=True).as_quat(scalar_first=True)
        assert geodesic_angle(wxyz, expected).max() < 1e-14
    write(read_attitudes(out), tmp_path / f"c.{kind}", extra_columns="euler-xyz-deg")
    np.testing.assert_array_equal(columns_in(tmp_path / f"c.{kind}", names), angles)


def columns_in(path, names):
    """Return columns of a table, shape (N, k)."""
    with open_log(path) as log:
        places = tuple(log.names.index(name) for name in names)
        rows = log.read(Stamp((0,), ("ns",)), [places], lambda batch: batch)
        return np.concatenate([batch.values[1] for batch in rows])


def test_angles_and_standard_deviations_are_written_together(tmp_path):
    """Angles first; the standard deviations are read back."""
    out = tmp_path / "a.csv"
    arguments = ["propagate", SAMPLE_LOGS / "tumbling.bag", "-o", out, "--with", "euler-zyx",
                 "--sigma", "--noise-density", "0.2deg/sqrt(h)"]  # fmt: skip
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    header = out.read_text().splitlines()[0]
    assert header == "t_ns,qw,qx,qy,qz,yaw_rad,pitch_rad,roll_rad,sigma_x,sigma_y,sigma_z"
    assert read_attitudes(out).covariance is not None


@pytest.mark.parametrize(
    ("output", "options", "sentence"),
    [
        ("a.tum", [], f"--with: tum has its own columns; choose {', '.join(map(repr, TABLES))}"),
        ("a.mcap", [], "--with: mcap has its own columns; choose 'csv'"),
        ("a.csv", ["--as", "rotvec"], "--with is about quaternions and rotvec has none"),
        ("a.csv", ["--direction", "ref-to-body"], "--with goes with Hamilton quaternions body to"),
    ],
)
def test_angles_that_have_no_place_are_refused(tmp_path, output, options, sentence):
    """One sentence, and nothing is written."""
    source = written(tmp_path, "qw,qx,qy,qz", [(1.0, 0.0, 0.0, 0.0)])
    out = tmp_path / output
    assert sentence in run(source, out, "--with", "euler-zyx", *options, code=2).stderr
    assert not out.exists()
    with pytest.raises(
        UsageError, match="extra_columns: there is no 'euler'; did you mean 'euler-zyx'"
    ):
        write(read_attitudes(source), out, to="csv", extra_columns="euler")
    assert (
        "--euler-unit goes with euler-zyx and other sequences"
        in run(source, out, "--with", "rotvec", "--euler-unit", "deg", code=2).stderr
    )


def test_the_library_takes_a_sequence_in_capitals_too(tmp_path):
    """As scipy writes intrinsic rotations, and as the command line takes it."""
    path = written(tmp_path, "qw,qx,qy,qz", [(0.5, 0.5, 0.5, 0.5)])
    convert(path, tmp_path / "out.csv", representation="euler-XYZ")
    assert (tmp_path / "out.csv").read_text().splitlines()[0] == (
        "t_ns,euler_xyz_1_rad,euler_xyz_2_rad,euler_xyz_3_rad"
    )
