"""Rotation vectors, angles and matrices as tables of attitudes, and back into quaternions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from make.reading import attitudes
from make.tables import write_rates
from scipy.spatial.transform import Rotation

from quatprop import RemarkWarning, convert, read_attitudes, write
from quatprop.base.errors import UsageError
from quatprop.kinematics.conventions import REPRESENTATIONS, from_euler, from_matrices, mounting
from quatprop.kinematics.quaternion import from_matrix, geodesic_angle
from quatprop.propagation.other_logs import stamps_in
from quatprop.propagation.recording import Recording
from quatprop.readers.open_log import open_log
from quatprop.readers.tables.model import Stamp
from quatprop.settings.quantities import EULER_SEQUENCES
from quatprop.writers import open_table
from quatprop.writers.formats import WRITERS

HALF = np.sqrt(0.5)
TABLES = [kind for kind, known in WRITERS.items() if known.columns]
QUATERNIONS = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda q: np.linalg.norm(q) > 0.1
)

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


def written(tmp_path, head, rows):
    """Write a table with stamps from 0."""
    return write_rates(
        tmp_path / "in.csv", [(k, *row) for k, row in enumerate(rows)], f"t_ns,{head}"
    )


def read(path, **options):
    """Return wxyz of a table."""
    return attitudes(path, **options)[2]


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("names", BY_HAND)
def test_angles_are_those_worked_out_by_hand(tmp_path, names, unit):
    """Suffixes, brackets or the option say the unit; all give the same quaternions."""
    rows, expected = zip(*BY_HAND[names], strict=True)
    rows = np.array(rows) * (1.0 if unit == "deg" else np.pi / 180)
    for form, option in ((f"{{}}_{unit}", None), (f"{{}} [{unit}]", None), ("imu.{}", unit)):
        head = ",".join(form.format(name) for name in names.split(","))
        found = read(written(tmp_path, head, rows.tolist()), from_angle_unit=option)
        np.testing.assert_allclose(found, expected, atol=1e-15)


@pytest.mark.parametrize("names", ["r{}{}", "m_{}{}", "rotation_{}_{}"])
@pytest.mark.parametrize("first", [0, 1])
def test_matrices_are_those_worked_out_by_hand(tmp_path, names, first):
    """Numbered from 1 or from 0, in any order of columns; transposed in the other direction."""
    rows, expected = zip(*MATRICES, strict=True)
    head = [names.format(i + first, j + first) for i in range(3) for j in range(3)]
    backwards = written(tmp_path, ",".join(head[::-1]), [row[::-1] for row in rows])
    np.testing.assert_allclose(read(backwards), expected, atol=1e-15)
    path = written(tmp_path, ",".join(head), rows)
    np.testing.assert_allclose(read(path), expected, atol=1e-15)
    other = read(path, from_direction="ref-to-body")
    np.testing.assert_allclose(other * [1, -1, -1, -1], expected, atol=1e-15)


@given(st.sampled_from(list(REPRESENTATIONS.values())), st.lists(QUATERNIONS, min_size=1))
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
    rows = np.array([(10.0, 20.0, 30.0), (-170.0, 5.0, 80.0)])
    with pytest.warns(RemarkWarning):
        found = read_attitudes(written(tmp_path, head, rows), **options).wxyz
    expected = Rotation.from_euler(sequence, rows[:, order], degrees=True)
    assert geodesic_angle(found, expected.as_quat(scalar_first=True)).max() < 1e-15 * 4


@pytest.mark.parametrize("columns", [9, 12])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_matrix_without_names_is_read_by_its_columns(tmp_path, columns, order):
    """As ARKit's 3x4 matrix of a pose; stored column by column, its columns are named in rows."""
    truth = Rotation.random(9, random_state=1)
    shape = 3, columns // 3
    pose = np.dstack([truth.as_matrix(), np.ones((9, 3, 1))])[:, :, : shape[1]]
    rows = [[10**7 * k, *each.ravel(order)] for k, each in enumerate(pose)]
    (tmp_path / "a.csv").write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    places = 1 + np.arange(columns).reshape(shape, order=order).ravel()
    with pytest.warns(RemarkWarning):
        found = read_attitudes(
            tmp_path / "a.csv", quat_cols=places.tolist(), time_col=0, time_unit="ns"
        )
    assert geodesic_angle(found.wxyz, truth.as_quat(scalar_first=True)).max() < 1e-15 * 4


QUATERNION = "qw,qx,qy,qz"
DEGREES = "yaw_deg,pitch_deg,roll_deg"
RADIANS = "yaw_rad,pitch_rad,roll_rad"
MATRIX = "r11,r12,r13,r21,r22,r23,r31,r32,r33"
REFUSED = {
    "a,b,c --quat-cols a,b,c": "which sequence of angles 'a', 'b', 'c' are, if they are angles (a "
    "quaternion has four ",
    "a,b,c --quat-cols a,b": "'a,b' does not name 3 or 4 columns A,B,C[,D], or 9 or 12 of a matrix",
    f"{QUATERNION} --quat-cols {QUATERNION} --from-euler xyz": "--from-euler is about three angles,"
    " and --quat-cols names 4 columns",
    f"{DEGREES} --from-euler zxz": "--from-euler zxz contradicts the columns 'yaw_deg', 'pitch_deg'"
    ", 'roll_deg', which by their names are angles about z, y, x; if it is right, name the columns "
    "too, with --quat-cols A,B,C",
    "euler_xyz_1_rad,euler_xyz_2_rad,euler_xyz_3_rad --from-euler zyx": "--from-euler zyx contradi"
    "cts the columns 'euler_xyz_1_rad', 'euler_xyz_2_rad', 'euler_xyz_3_rad', which by their names "
    "are angles about x, y, z",
    "a,b,c --from-euler xyz --quat-cols a,b,c": "the unit of the angles 'a', 'b', 'c' is not "
    "declared; specify it with --from-angle-unit",
    f"{QUATERNION} --from-euler xyx": "about angles, and this table has a quaternion; omit it",
    "yaw,pitch,roll": "the unit of the angles 'yaw', 'pitch', 'roll' is not declared; specify "
    "it with "
    "--from-angle-unit rad|deg",
    f"{DEGREES} --from-angle-unit rad": "--from-angle-unit says rad, but by their names 'yaw_deg', "
    "'pitch_deg', 'roll_deg' are in deg; omit the option",
    "yaw[turn],pitch[turn],roll[turn]": "are declared in 'turn'; convert the numbers to rad or deg",
    "yaw_deg[rad],pitch_deg[rad],roll_deg[rad]": "are declared in deg, but also rad; correct the "
    "wrong unit, or name that of the numbers with --from-angle-unit deg|rad",
    f"{MATRIX} --from-angle-unit rad": "about angles, and",
    f"{MATRIX} --from-euler zyx": "no attitudes found; its columns",
    f"{RADIANS} --from-layout wxyz": "--from-layout does not apply to euler-zyx; omit it",
    f"{RADIANS} --from-convention jpl": "--from-convention does not apply to euler-zyx; omit it",
    f"{QUATERNION} --from-angle-unit rad": "this table has a quaternion; omit it",
    "a.yaw_rad,a.pitch_rad,a.roll_rad,b.yaw_rad,b.pitch_rad,b.roll_rad": "which rotation",
    "yaw_rate,pitch_rate,roll_rate": "no attitudes found; its columns are 't_ns', 'yaw_r",
    "omega_yaw,omega_pitch,omega_roll": "no attitudes found",
    "yaw_rad,pitch_rad": "no attitudes found",
}


@pytest.mark.parametrize(("words", "sentence"), REFUSED.items())
def test_options_that_do_not_fit_the_columns_are_refused(tmp_path, words, sentence):
    """Sequences, units, options that are about something else, two rotations, half of one."""
    head, *options = words.split()
    path = written(tmp_path, head, [range(1, head.count(",") + 2)])
    assert sentence in refused("convert", path, "-", *options)


def test_metadata_that_say_another_representation_are_refused(tmp_path):
    """Columns renamed behind the metadata's back are no guess to make."""
    path = tmp_path / "in.parquet"
    with open_table(path, ("yaw_deg", "pitch_deg", "roll_deg")) as table:
        table.write_rows(np.array([1]), [np.array([1.0])] * 3)
        table.commit({"convention": {"representation": "euler-zyx"}})
    sentence = "its columns are euler-zyx-deg, and the metadata of the file say euler-zyx; write"
    assert sentence in refused("convert", path, "-")


GOOD = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
ODD_MATRICES = [GOOD.round(4), GOOD * 1.1, GOOD @ np.diag([1, 1, -1]), GOOD * 0, GOOD * np.nan]
ODD_ANGLES = [(0.1, 0.2, 0.3), (np.inf, 0, 0), (0, np.nan, 0), (1e308, 1e308, 1e308)]


OF_MATRICES = (
    "4 of 5 rows are invalid quaternions (1 off unit length by up to 0.21, 3 absent or not finite),"
    " the first is row 1 at 1 ns"
)


@pytest.mark.parametrize(
    ("head", "rows", "counts"),
    [
        (MATRIX, [row.ravel() for row in ODD_MATRICES], OF_MATRICES),
        # Infinite angles have no sine, and no warning comes of it.
        (RADIANS, ODD_ANGLES, "2 of 4 rows are invalid quaternions (2 absent or not finite)"),
        ("rotvec_x_rad,rotvec_y_rad,rotvec_z_rad", ODD_ANGLES, "rows are invalid quaternions ("),
    ],
)
def test_rows_that_are_no_rotations_are_found(tmp_path, head, rows, counts):
    """Skewed, mirrored, zero and NaN rows are located and counted; rounding of 4 digits is not."""
    assert counts in refused("convert", written(tmp_path, head, rows), "-")


def nearest(matrices):
    """Return the nearest rotations by singular values."""
    left, _, right = np.linalg.svd(matrices)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return left @ right


@given(
    seed=st.integers(0, 10**6),
    size=st.sampled_from([1e-10, 1e-6, 1e-4, 3e-4, 1e-3, 0.01, 0.05]),
    rounded=st.booleans(),
)
def test_a_matrix_with_noise_is_its_nearest_rotation(seed, size, rounded):
    """The longest row of the products of the quaternion was 1.4 times as far from the truth."""
    random = np.random.default_rng(seed)
    true = Rotation.random(60, random).as_matrix()
    true[:3] = np.diag([1, -1, -1]), np.diag([-1, 1, -1]), np.eye(3)
    if rounded:
        noisy = true.round(round(-np.log10(size)))
    else:
        noisy = true + random.uniform(-size, size, true.shape)
    found = from_matrices(noisy.reshape(-1, 9))
    expected = Rotation.from_matrix(nearest(noisy)).as_quat(scalar_first=True)
    assert geodesic_angle(found, expected).max() < 1e-13 + 1e-7 * size
    off = np.abs(noisy.swapaxes(1, 2) @ noisy - np.eye(3)).max(axis=(1, 2))
    length = np.linalg.norm(found, axis=1)
    np.testing.assert_allclose(length, np.where(off > 1e-3, 1 + off, 1), rtol=1e-12)
    for row in (0, 3, 59):
        assert from_matrices(noisy[row].reshape(1, 9))[0].tolist() == found[row].tolist()
    assert np.isnan(from_matrices((noisy @ np.diag([1, 1, -1])).reshape(-1, 9))).all()


@pytest.mark.parametrize("digits", [2, 3, 4])
def test_rounded_matrices_are_nearest_rotations_wherever_they_are_read(tmp_path, digits):
    """Of a table, and of a mounting; they are rotations of unit length."""
    matrices = Rotation.random(50, np.random.default_rng(digits)).as_matrix().round(digits)
    expected = Rotation.from_matrix(nearest(matrices)).as_quat(scalar_first=True)
    path = written(tmp_path, MATRIX, matrices.reshape(-1, 9))
    run("convert", path, tmp_path / "out.csv", "--normalize")
    found = read_attitudes(tmp_path / "out.csv").wxyz
    assert geodesic_angle(found, expected).max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-15)
    if digits > 2:
        for matrix, q in zip(matrices, expected, strict=True):
            text = ",".join(map(str, matrix.ravel()))
            assert geodesic_angle(from_matrix(mounting(text)), q) < 1e-9


def test_stamps_are_those_of_the_rates_where_angles_have_no_unit(tmp_path):
    """Angles next to rates do not stand in the way of who wants the stamps alone."""
    path = written(tmp_path, "wx,wy,wz,yaw,pitch,roll", [range(6), range(6)])
    assert stamps_in(str(path), Recording((), None)).tolist() == [0, 1]


FORMS = ["rotvec", "euler-zyx", "euler-zyx --euler-unit deg", "euler-zxz", "matrix"]


@pytest.mark.parametrize("number", range(5 * len(TABLES)))
def test_what_is_written_is_read_and_turned_into_any_other(tmp_path, number):
    """Names say the rest; the direction is in the metadata where there is room, else an option."""
    row, column = divmod(number, len(FORMS))
    kind, form, other = TABLES[row], FORMS[column], FORMS[(row + column) % len(FORMS)]
    direction, opposite = ("body-to-ref", "ref-to-body")[:: -1 if (row + column) % 2 else 1]
    wxyz = np.random.default_rng(4).normal(size=(50, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    first, second, back = (tmp_path / name for name in (f"a.{kind}", "b.parquet", "c.npz"))
    source = written(tmp_path, QUATERNION, wxyz)
    run("convert", source, first, "--as", *form.split(), "--direction", direction, code=0)
    said = [] if WRITERS[kind].keeps_provenance else ["--from-direction", direction]
    run("convert", first, second, "--as", *other.split(), *said, code=0)
    run("convert", second, back, code=0)
    assert geodesic_angle(read(back), wxyz).max() < 1e-14
    if WRITERS[kind].keeps_provenance:
        said = refused("convert", first, back, "--from-direction", opposite)
        assert "but the metadata of the file says" in said


LOCKED = {
    "yaw pitch roll": "3 rows are within 0.01 deg of pitch -90 or 90 deg (gimbal lock), where only "
    "the sum or the difference of yaw and roll is determined; the attitude itself is correct",
    # Proper angles are in it where the second is 0 or 180 deg.
    "euler_zxz_1 euler_zxz_2 euler_zxz_3": "2 rows are within 0.01 deg of euler_zxz_2 0 or 180 deg "
    "(gimbal lock), where only the sum or the difference of euler_zxz_1 and euler_zxz_3 is",
}
LOCKED_ROWS = {
    "euler-zyx": [(10, 89.98, 0), (10, 89.995, 20), (10, 90, 20), (-50, -90, 3)],
    "euler-ZXZ": [(10, 0.02, 5), (10, 0, 5), (10, 179.995, 5)],
}


@pytest.mark.parametrize(("names", "form"), list(zip(LOCKED, LOCKED_ROWS, strict=True)))
def test_gimbal_lock_is_reported(tmp_path, names, form):
    """The remark claimed that both share the rotation equally, which is false for most rows."""
    head = ",".join(f"{name}_deg" for name in names.split())
    path, out = written(tmp_path, head, LOCKED_ROWS[form]), tmp_path / "out.csv"
    said = run("convert", path, out, "--as", form, "--euler-unit", "deg", code=0).stderr
    assert f"note: {LOCKED[names]}" in said
    assert out.read_text().startswith(f"t_ns,{head}\n")
    assert geodesic_angle(read(out), read(path)).max() < 1e-15 * 4
    said = run("convert", path, out, "--as", "matrix", code=0).stderr
    assert "cannot be distinguished" not in said


def columns_in(path, names):
    """Return columns of a table, shape (N, k)."""
    with open_log(path) as log:
        assert log.names == ["t_ns", *QUATERNION.split(","), *names]
        places = tuple(log.names.index(name) for name in names)
        rows = log.read(Stamp((0,), ("ns",)), [places], lambda batch: batch)
        return np.concatenate([batch.values[1] for batch in rows])


@pytest.mark.parametrize("kind", TABLES)
def test_angles_stand_next_to_the_quaternion(tmp_path, kind):
    """In propagate, convert and the library; what is read back is the quaternion."""
    first, second, third = (tmp_path / f"{name}.{kind}" for name in "abc")
    options = ["--with", "euler-xyz", "--euler-unit", "deg"]
    names = ["euler_xyz_1_deg", "euler_xyz_2_deg", "euler_xyz_3_deg"]
    run("propagate", SAMPLE_LOGS / "tumbling.bag", "-o", first, *options, code=0)
    run("convert", first, second, *options, code=0)
    write(read_attitudes(first), third, extra_columns="euler-xyz-deg")
    for path in (first, second, third):
        angles = columns_in(path, names)
        expected = Rotation.from_euler("XYZ", angles, degrees=True).as_quat(scalar_first=True)
        assert geodesic_angle(read(path), expected).max() < 1e-14


def test_angles_and_standard_deviations_are_written_together(tmp_path):
    """Angles first; the standard deviations are read back."""
    out = tmp_path / "a.csv"
    options = ["--with", "euler-zyx", "--sigma", "--noise-density", "0.2deg/sqrt(h)"]
    run("propagate", SAMPLE_LOGS / "tumbling.bag", "-o", out, *options, code=0)
    header = out.read_text().splitlines()[0]
    assert header == f"t_ns,{QUATERNION},{RADIANS},sigma_x,sigma_y,sigma_z"
    assert read_attitudes(out).covariance is not None


def test_the_library_takes_a_sequence_in_capitals_too(tmp_path):
    """As scipy writes intrinsic rotations, and as the command line takes it."""
    path, out = written(tmp_path, QUATERNION, [(0.5, 0.5, 0.5, 0.5)]), tmp_path / "out.csv"
    convert(path, out, representation="euler-XYZ")
    names = "euler_xyz_1_rad,euler_xyz_2_rad,euler_xyz_3_rad"
    assert out.read_text().splitlines()[0] == f"t_ns,{names}"
    unknown = "extra_columns: there is no 'euler'; did you mean 'euler-zyx'"
    with pytest.raises(UsageError, match=unknown):
        write(read_attitudes(path), out, to="csv", extra_columns="euler")
