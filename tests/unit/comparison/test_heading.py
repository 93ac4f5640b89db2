"""Errors in heading and in inclination, each with its own limit, and the alignment in heading."""

import json

import numpy as np
import pytest
from make.commands import run
from make.motion import rotor, stamps
from make.tables import write_attitudes
from scipy.spatial.transform import Rotation

from quatprop import AttitudeSeries, compare
from quatprop.comparison.alignment import align
from quatprop.kinematics.quaternion import exp, multiply

T_NS = stamps(50, 4)
TRUTH = AttitudeSeries(T_NS, rotor(T_NS / 1e9)[0])


def turned(*degrees):
    """Return the truth in other reference axes, turned about x, y, z one after the other."""
    steps = [exp(np.radians(angle) * axis) for angle, axis in zip(degrees, np.eye(3), strict=True)]
    turn = multiply(steps[2], multiply(steps[1], steps[0]))
    return AttitudeSeries(T_NS, multiply(turn, TRUTH.wxyz))


@pytest.mark.parametrize("setting", ["mean", "first", "mount"])
def test_a_tilt_passed_with_every_other_alignment(setting):
    """The reason for yaw: of a levelled attitude, roll and pitch are not free."""
    assert compare(turned(1, 0, 40), TRUTH, align=setting, tol="0.1deg").passed


def test_a_tilt_fails_by_its_inclination():
    """Heading is taken out to rounding; what is left is the tilt."""
    found = compare(
        turned(1, 0, 40), TRUTH, align="yaw", tol_heading="0.1deg", tol_inclination="0.1deg"
    )
    heading, inclination = found.criteria
    assert (heading.setting, heading.passed) == ("tol_heading", True)
    assert (inclination.setting, inclination.passed) == ("tol_inclination", False)
    assert heading.value < 1e-14
    assert np.degrees(inclination.value) == pytest.approx(1, abs=1e-12)
    assert not found.passed
    assert found.likely_cause.sentence.startswith("the reference frames differ by 1 deg;")
    assert found.likely_cause.remedy == "align='mean' removes it"
    assert np.degrees(found.alignment.reference_rad) == pytest.approx(40, abs=1e-9)


def test_a_difference_in_heading_alone_is_advised_to_be_taken_out_alone():
    """The advice was --align mean, which takes out a tilt as well. The remedy, applied, passes."""
    found = compare(turned(0, 0, 35), TRUTH, tol="0.1deg")
    assert found.likely_cause.remedy == "align='yaw' removes it"
    assert compare(turned(0, 0, 35), TRUTH, tol="0.1deg", align="yaw").passed
    tilted = compare(turned(1, 0, 35), TRUTH, tol="0.1deg")
    assert tilted.likely_cause.remedy == "align='mean' removes it"


def test_heading_alone_passes():
    """It is free, and all of the error."""
    found = compare(turned(0, 0, -170), TRUTH, align="yaw", tol="1e-12rad")
    assert found.passed
    assert np.degrees(found.alignment.reference_rad) == pytest.approx(170, abs=1e-9)


def test_parts_are_those_of_scipy():
    """Without an alignment: the angle between the z axes, and the components of the vector."""
    noise = np.random.default_rng(1).normal(0, 0.3, (len(T_NS), 3))
    a = AttitudeSeries(T_NS, multiply(exp(noise), TRUTH.wxyz))
    parts = compare(a, TRUTH, tol_heading=3, tol_inclination=3).parts
    errors = Rotation.from_rotvec(noise)
    vertical = errors.apply([0, 0, 1.0])
    inclination = np.arccos(vertical[:, 2])
    # Without the rotation that tilts the vertical, the rotation about it is left.
    axis = np.cross([0, 0, 1.0], vertical)
    axis *= (inclination / np.linalg.norm(axis, axis=1))[:, None]
    heading = (Rotation.from_rotvec(axis).inv() * errors).magnitude()
    for name, sizes in {
        "heading": heading, "inclination": inclination, "about_x": np.abs(noise[:, 0]),
        "about_y": np.abs(noise[:, 1]), "about_z": np.abs(noise[:, 2]),
    }.items():  # fmt: skip
        extent = getattr(parts, name)
        assert extent.max == pytest.approx(sizes.max(), rel=1e-9)
        assert extent.rms == pytest.approx(np.sqrt((sizes**2).mean()), rel=1e-9)


def test_the_heading_is_the_best_there_is():
    """No other rotation about z leaves a smaller sum of squared chords, with noise on all axes."""
    noise = np.random.default_rng(2).normal(0, 0.2, (len(T_NS), 3))
    a = multiply(exp([0, 0, 2.5]), multiply(exp(noise), TRUTH.wxyz))
    found = align("yaw", a, TRUTH.wxyz)
    assert not found.reference_wxyz[1:3].any()

    def chords(angle):
        other = multiply(exp([0, 0, angle]), TRUTH.wxyz)
        return (1 - np.einsum("ij,ij->i", a, other) ** 2).sum()

    best = 2 * np.arctan2(found.reference_wxyz[3], found.reference_wxyz[0])
    assert chords(best) < min(chords(best - 1e-3), chords(best + 1e-3))


def test_opposite_verticals_have_no_heading():
    """The stated error was 180 deg of noise, without a remark."""
    noise = np.random.default_rng(3).normal(0, 1e-4, (len(T_NS), 3))
    a = AttitudeSeries(T_NS, multiply(exp(noise), turned(180, 0, 90).wxyz))
    (said,) = compare(a, TRUTH, align="yaw").remarks
    assert said.startswith("the z axes of A and B point in opposite directions")
    assert not compare(turned(170, 0, 90), TRUTH, align="yaw").remarks


def test_the_command_line_shows_the_parts(tmp_path):
    """Rows, criteria, JSON and the exit code."""
    a = write_attitudes(tmp_path / "a.csv", T_NS, turned(1, 0, 40).wxyz)
    b = write_attitudes(tmp_path / "b.csv", T_NS, TRUTH.wxyz)
    limits = ["--align", "yaw", "--tol-inclination", "0.1deg", "--tol-heading", "0.1deg"]
    result = run("compare", a, b, *limits, code=1)
    assert "parts     heading: max " in result.stdout
    assert "failed    error in inclination 0.0174533 rad (1 deg), at most" in result.stdout
    parts = json.loads(run("compare", a, b, *limits, "--json", code=1).stdout)["parts"]
    assert parts["inclination"]["max"] == pytest.approx(np.radians(1), abs=1e-12)
