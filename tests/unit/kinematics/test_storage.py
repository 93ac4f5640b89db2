"""Layout, convention and direction of stored quaternions, worked out on paper.

The attitude is (10 + i + 2j + 4k) / 11. With the Hamilton product and v_ref = q v_body q*, its
matrix follows from R = (w^2 - |v|^2) I + 2 w [v x] + 2 v v^T, all over 121:

    w^2 - |v|^2 = 100 - 21 = 79,    2 w [v x] = 20 [[0, -4, 2], [4, 0, -1], [-2, 1, 0]],
    2 v v^T = 2 [[1, 2, 4], [2, 4, 8], [4, 8, 16]].
"""

from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.commands import run
from make.tables import write_rates
from scipy.spatial.transform import Rotation

from quatprop.base.errors import UsageError
from quatprop.kinematics.conventions import AttitudeConvention, Signs, euler_angles
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.settings.quantities import EULER_SEQUENCES

BODY_TO_REF = np.array([[81, -76, 48], [84, 87, -4], [-32, 36, 111]]) / 121

STORED = {
    ("scalar-first", "hamilton", "body-to-ref"): (10, 1, 2, 4),
    ("scalar-first", "hamilton", "ref-to-body"): (10, -1, -2, -4),
    ("scalar-first", "jpl", "ref-to-body"): (10, 1, 2, 4),
    ("scalar-first", "jpl", "body-to-ref"): (10, -1, -2, -4),
    ("scalar-last", "hamilton", "body-to-ref"): (1, 2, 4, 10),
    ("scalar-last", "hamilton", "ref-to-body"): (-1, -2, -4, 10),
    ("scalar-last", "jpl", "ref-to-body"): (1, 2, 4, 10),
    ("scalar-last", "jpl", "body-to-ref"): (-1, -2, -4, 10),
}
"""The same attitude in all eight combinations, times 11."""

COLUMNS = {"scalar-first": "t_ns,qw,qx,qy,qz", "scalar-last": "t_ns,qx,qy,qz,qw"}
CANONICAL = ("scalar-first", "hamilton", "body-to-ref")
VECTORS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3.0, -5.0, 7.0]])


def cross_matrix(v):
    """Return [v x]."""
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def textbook_matrix(convention, w, v):
    """Return the matrix of a quaternion as the textbook of its convention writes it."""
    v = np.asarray(v)
    if convention == "jpl":  # Trawny and Roumeliotis 2005, eq. 62
        return (2 * w**2 - 1) * np.eye(3) - 2 * w * cross_matrix(v) + 2 * np.outer(v, v)
    return (w**2 - v @ v) * np.eye(3) + 2 * w * cross_matrix(v) + 2 * np.outer(v, v)


def converted(tmp_path, combination, *options):
    """Convert the attitude from a combination; return the header and the numbers of its row."""
    numbers = [repr(number / 11) for number in STORED[combination]]
    path = write_rates(tmp_path / "in.csv", [["5", *numbers]], COLUMNS[combination[0]])
    header, row = run("convert", path, "-", *options, code=0).stdout.splitlines()
    stamp, *numbers = map(float, row.split(","))
    assert stamp == 5
    return header, numbers


def split(combination, numbers):
    """Return w and the vector of stored numbers."""
    if combination[0] == "scalar-first":
        return numbers[0], np.array(numbers[1:])
    return numbers[3], np.array(numbers[:3])


@pytest.mark.parametrize("first", STORED)
def test_every_combination_becomes_every_other(tmp_path, first):
    """All 64 pairs, to the bit, and each result turns vectors as its textbook says."""
    said = ["--from-convention", first[1], "--from-direction", first[2]]
    for second, expected in STORED.items():
        names = ("--layout", "--convention", "--direction")
        options = [word for pair in zip(names, second, strict=True) for word in pair]
        header, numbers = converted(tmp_path, first, *said, *options)
        assert header == COLUMNS[second[0]]
        assert numbers == [number / 11 for number in expected]
        turned = VECTORS @ textbook_matrix(second[1], *split(second, numbers)).T
        matrix = BODY_TO_REF if second[2] == "body-to-ref" else BODY_TO_REF.T
        np.testing.assert_allclose(turned, VECTORS @ matrix.T, atol=1e-14)


def from_matrix(numbers):
    """Return the rotation of a matrix row by row."""
    return Rotation.from_matrix(np.reshape(numbers, (3, 3)))


SCIPY = {
    "--layout wxyz": ("qw,qx,qy,qz", partial(Rotation.from_quat, scalar_first=True)),
    "--layout xyzw": ("qx,qy,qz,qw", Rotation.from_quat),
    "--as rotvec": ("rotvec_x_rad,rotvec_y_rad,rotvec_z_rad", Rotation.from_rotvec),
    "--as euler-zyx": ("yaw_rad,pitch_rad,roll_rad", partial(Rotation.from_euler, "ZYX")),
    "--as euler-zyx --euler-unit deg": (
        "yaw_deg,pitch_deg,roll_deg",
        partial(Rotation.from_euler, "ZYX", degrees=True),
    ),
    "--as matrix": ("r11,r12,r13,r21,r22,r23,r31,r32,r33", from_matrix),
}
"""Options -> the columns, and what scipy makes of their numbers."""


@pytest.mark.parametrize("direction", ["body-to-ref", "ref-to-body"])
@pytest.mark.parametrize("options", SCIPY)
def test_every_form_means_to_scipy_what_its_columns_are_called(tmp_path, options, direction):
    """It turns vectors as the written-out matrix, or as its transpose in the other direction."""
    names, rotation = SCIPY[options]
    words = (*options.split(), "--direction", direction)
    header, numbers = converted(tmp_path, CANONICAL, *words)
    assert header == f"t_ns,{names}"
    matrix = BODY_TO_REF if direction == "body-to-ref" else BODY_TO_REF.T
    turned = rotation(numbers).apply(VECTORS)
    np.testing.assert_allclose(turned, VECTORS @ matrix.T, atol=1e-14)


quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


def unit(rows):
    """Return rows at unit length."""
    rows = np.array(rows)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@pytest.mark.parametrize("sequence", EULER_SEQUENCES)
def test_angles_keep_the_attitude_in_gimbal_lock(sequence):
    """The first and the third are not unique there; with any of them the rotation is the same."""
    locks = (0, np.pi) if sequence[0] == sequence[2] else (-np.pi / 2, np.pi / 2)
    wanted = np.array([
        (first, lock + np.sign(sum(locks) / 2 - lock) * off, 0.3)
        for first, off, lock in product([-3.0, 0.0, 0.4], [0.0, 1e-12, 1e-9, 1e-6], locks)
    ])  # fmt: skip
    q = Rotation.from_euler(sequence.upper(), wanted)
    angles = euler_angles(sequence, q.as_quat(scalar_first=True))
    assert np.abs(angles[:, [0, 2]]).max() <= np.pi
    assert np.abs(angles[:, 1] - sum(locks) / 2).max() <= np.pi / 2
    back = Rotation.from_euler(sequence.upper(), angles).as_quat(scalar_first=True)
    assert geodesic_angle(back, q.as_quat(scalar_first=True)).max() < 1e-15 * 4


@pytest.mark.parametrize("sequence", [s for s in EULER_SEQUENCES if s[0] == s[2]])
def test_a_rotation_about_the_first_axis_is_shared_equally(sequence):
    """Proper angles of it are in gimbal lock; the sign of a zero makes no difference."""
    axis = "xyz".index(sequence[0])
    for sign in (0.0, -0.0):
        wxyz = np.full((1, 4), sign)
        wxyz[0, [0, 1 + axis]] = np.cos(0.2), np.sin(0.2)
        np.testing.assert_allclose(euler_angles(sequence, wxyz), [[0.2, 0, 0.2]], atol=1e-15)


def test_a_sign_that_either_choice_would_continue_does_not_depend_on_batches():
    """Two attitudes half a turn apart have a dot product of zero: the choice before them counts."""
    wxyz = np.array([[0.0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 1, 0]])
    for cut in range(4):
        signs = Signs("continuous")
        parts = np.concatenate([signs.applied(wxyz[:cut]), signs.applied(wxyz[cut:])])
        np.testing.assert_array_equal(parts, [[0, 0, 0, 1], [0, 0, 0, 1], [0, 0, -1, 0]])


@given(st.lists(quaternions, min_size=2, max_size=30), st.data())
def test_a_continuous_sign_does_not_depend_on_batches(rows, data):
    """Neighbours never have a negative dot product, however the series is cut."""
    wxyz = unit(rows)
    whole = Signs("continuous").applied(wxyz)
    assert (np.einsum("ij,ij->i", whole[1:], whole[:-1]) >= 0).all()
    assert (np.abs(whole) == np.abs(wxyz)).all()
    cut = data.draw(st.integers(0, len(rows)))
    signs = Signs("continuous")
    parts = [signs.applied(wxyz[:cut]), signs.applied(wxyz[cut:])]
    assert (np.concatenate(parts) == whole).all()


@given(st.lists(quaternions, min_size=1, max_size=30))
def test_a_positive_sign_has_no_negative_scalar(rows):
    """No row has w below zero, and each is the q or the -q it was."""
    wxyz = unit(rows)
    positive = Signs("positive").applied(wxyz)
    assert (positive[:, 0] >= 0).all()
    kept = (positive == wxyz).all(axis=1)
    assert (kept | (positive == -wxyz).all(axis=1)).all()


def test_a_positive_sign_decides_half_turns_too():
    """With w = 0, the first component that is not zero is positive: q and -q give the same."""
    rows = np.array([[0, 0, -0.6, 0.8], [-0.0, -1, 0, 0], [0, 0, 0, -1], [-0.5, 0.5, 0.5, 0.5]])
    expected = [[0, 0, 0.6, -0.8], [0, 1, 0, 0], [0, 0, 0, 1], [0.5, -0.5, -0.5, -0.5]]
    for signed in (Signs("positive").applied(rows), Signs("positive").applied(-rows)):
        assert signed.tolist() == expected
        assert not np.signbit(signed[:, 0]).any()


@pytest.mark.parametrize(
    ("make", "word", "sentence"),
    [
        (AttitudeConvention, "shuster", "no convention 'shuster'; choose one of 'hamilton', 'jp"),
        (
            lambda word: AttitudeConvention(direction=word),
            "up",
            "no direction 'up'; choose one of 'body-to-ref', 'ref-t",
        ),
    ],
)
def test_unknown_words_are_refused(make, word, sentence):
    """The error lists what there is."""
    with pytest.raises(UsageError, match=sentence):
        make(word)
