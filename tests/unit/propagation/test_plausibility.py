"""Rates against the log's own orientation, and how little of the log is read for that."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quatprop.base.text import in_python
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, multiply, rotate, rotation_matrix
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.orientation_check import against_orientation
from quatprop.propagation.plausibility import orientation_remarks

MS, SECOND = 1_000_000, 1_000_000_000
TOO_SMALL = (
    "the log's own orientation rotates 57.3 times as far as its rates: "
    "were they scaled by pi/180 once too often?"
)
TOO_LARGE = "own orientation: if they are in deg/s, use rate_unit='deg/s'"


def turning(samples, resting=0, rate=0.04):
    """Return rates of a body that rests, then turns, and its attitudes."""
    t_ns = np.arange(samples) * 10 * MS
    rate = (np.arange(samples) >= resting)[:, None] * [rate * 0.6, rate * 0.8, 0]
    return GyroSeries(t_ns, rate), AttitudeSeries(t_ns, attitudes(t_ns, rate))


@pytest.mark.parametrize(
    ("scale", "unit", "sentence"),
    [
        (1.0, "rad/s", None),
        (1.2, "rad/s", None),
        (math.pi / 180, "rad/s", TOO_SMALL),
        (180 / math.pi, "rad/s", TOO_LARGE),
        # A unit that is declared already is not advised again.
        (math.pi / 180, "deg/s", ": if they are in rad/s, use rate_unit='rad/s'"),
        (180 / math.pi, "deg/s", ": were they scaled by 180/pi once too often?"),
        # A factor that is not near 180/pi is not the unit's; of slow turns a bias may be one.
        (1 / 19.5, "rad/s", None),
        (1 / 20.5, "rad/s", "rotates 20.5 times as far as its rates: are both of the same sensor?"),
        (19.5, "rad/s", None),
        (1 / 80, "rad/s", "rotates 80 times as far as its rates: are both of the same sensor?"),
        (1e-4, "deg/s", ": are both of the same sensor?"),
    ],
)
def test_rates_against_the_log_s_own_orientation(scale, unit, sentence):
    """A factor of pi/180 shows, also after a rest; a scale error of a fifth does not."""
    for gyro, own in (turning(1000), turning(6000, resting=4000)):
        parts = [own[:3000], own[3000:]] if len(own) > 3000 else [own]
        said = against_orientation([gyro.with_rate(gyro.rate * scale)], parts, unit=unit)
        assert said is None if sentence is None else sentence in in_python(said)


@pytest.mark.parametrize(
    ("deg_s", "scale", "is_said"),
    [(0.99, 0.02, False), (1.01, 0.02, True), (0.0495, 50, False), (0.0505, 50, True)],
)
def test_an_orientation_that_hardly_moves_is_not_compared(deg_s, scale, is_said):
    """Noise and drift do not matter where it turns by 1 deg in a second, or should."""
    gyro, own = turning(1000, rate=math.radians(deg_s))
    said = against_orientation([gyro.with_rate(gyro.rate * scale)], [own])
    assert (said is not None) == is_said


def test_an_orientation_that_does_not_move_tells_nothing():
    """At rest there is nothing to compare, nor without common stamps or an estimate."""
    t_ns = np.arange(1000) * 10 * MS
    still = AttitudeSeries(t_ns, np.tile([1.0, 0, 0, 0], (1000, 1)))
    slow, fast = (GyroSeries(t_ns, np.full((1000, 3), rate)) for rate in (1e-6, 0.5))
    for gyro in (slow, fast, GyroSeries(t_ns + 1, slow.rate)):
        assert against_orientation([gyro], [still]) is None
    assert against_orientation([], []) is None


def swinging(count, peak):
    """Return rates and attitudes of a body that swings about all axes."""
    t_ns = np.arange(count) * 10 * MS
    phase = 2 * np.pi * 0.4 * t_ns[:, None] / SECOND * [1.0, 1.3, 0.7]
    rate = peak * np.sin(phase + np.arange(3))
    return GyroSeries(t_ns, rate), AttitudeSeries(t_ns, attitudes(t_ns, rate, method="mean"))


def swung(series, wxyz):
    """Return attitudes at the same times."""
    return AttitudeSeries(series.t_ns, wxyz)


SPOILT = {
    "none": lambda gyro, own: (gyro, own),
    "heading": lambda gyro, own: (gyro, swung(own, multiply(exp([0, 0, 2.0]), own.wxyz))),
    "other frame": lambda gyro, own: (gyro, swung(own, multiply(exp([np.pi, 0, 0]), own.wxyz))),
    "tilted": lambda gyro, own: (gyro, swung(own, multiply(own.wxyz, exp([0.3, -0.2, 0.2])))),
    "late": lambda gyro, own: (gyro, swung(own, np.roll(own.wxyz, 6, axis=0))),
    "biased": lambda gyro, own: (gyro.with_rate(gyro.rate + np.array([2, -1, 3]) / 100), own),
}
"""Mistakes and unknowns of rates and orientations, other than their axes."""

AXES = [
    *("x,y,z", "x,-y,-z", "-x,y,-z", "-x,-y,z", "y,x,-z", "y,-x,z", "-y,x,z", "-y,-x,-z"),
    *("y,z,x", "z,x,y", "-z,y,x", "z,y,-x", "x,z,-y", "-x,z,y", "-z,-x,y", "-y,z,-x"),
]


@pytest.mark.thorough
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize(("count", "peak"), [(1000, 0.5), (6000, 1.5), (3000, 8.0)])
def test_rates_about_other_axes_than_the_orientation_are_remarked_on(axes, count, peak):
    """Orientation in the axes of one convention and rates in those of another: 104 deg, unsaid."""
    gyro, own = swinging(count, peak)
    said = against_orientation([gyro.with_rate(gyro.rate @ mounting(axes))], [own])
    if axes == "x,y,z":
        assert said is None
    else:
        assert in_python(said).endswith(f"the rates are turned into its axes, with mount='{axes}'")


@pytest.mark.parametrize("peak", [0.3, 1.5, 8.0])
@pytest.mark.parametrize("spoilt", SPOILT)
def test_what_is_no_other_choice_of_axes_is_not_taken_for_one(spoilt, peak):
    """A convention that is unknown, errors of a good sensor, and motion that shows too little."""
    gyro, own = SPOILT[spoilt](*swinging(4000, peak))
    assert against_orientation([gyro], [own]) is None


MIRRORED = {
    "mirrored": [1, 1, -1],
    "two exchanged": [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    "all reversed": [-1, -1, -1],
}


@pytest.mark.thorough
@pytest.mark.parametrize("peak", [1.5, 3.0, 8.0])
@pytest.mark.parametrize("how", MIRRORED)
def test_rates_that_no_rotation_explains_are_remarked_on_without_advice(how, peak):
    """Left-handed axes have no remedy but the sensor's own; they were not mentioned."""
    gyro, own = swinging(4000, peak)
    spoilt = np.array(MIRRORED[how])
    rate = gyro.rate @ spoilt if spoilt.ndim > 1 else gyro.rate * spoilt
    said = in_python(against_orientation([gyro.with_rate(rate)], [own]))
    assert said.startswith("the rates contradict the log's own orientation, by up to ")
    assert said.endswith(
        "deg, whatever the axes, the frame and the unit: are both of the same sensor?"
    )


@pytest.mark.parametrize("axes", [[1, -1, -1], [1, 1, -1], [-1, -1, -1], [-1, 1, -1]])
@pytest.mark.parametrize("tilt", [0.0, 0.02])
def test_a_vehicle_whose_rates_have_another_sign_is_remarked_on(axes, tilt):
    """It turns about the vertical alone, so that the inverse of its orientation agrees as well."""
    gyro, _ = swinging(4000, 1.0)
    rate = gyro.rate * [tilt, tilt, 1.0]
    own = AttitudeSeries(gyro.t_ns, attitudes(gyro.t_ns, rate))
    said = str(against_orientation([gyro.with_rate(rate * axes)], [own]))
    assert said.startswith("the rates contradict the log's own orientation, by up to ")


INVERSE = (
    "deg: they agree with its inverse: it is from reference to body, and an initial attitude that "
    "is taken from it is wrong; convert it, with from_direction='ref-to-body' of quatprop convert"
)


@pytest.mark.thorough
@pytest.mark.parametrize(("peak", "is_known"), [(0.2, False), (1.5, True), (3.0, True)])
@pytest.mark.parametrize("spoilt", ["none", "heading", "biased"])
def test_an_orientation_from_reference_to_body_is_named_where_motion_shows_it(
    peak, is_known, spoilt
):
    """Small turns do not distinguish it from rates about mirrored axes: both are named."""
    gyro, own = SPOILT[spoilt](*swinging(4000, peak))
    inverse = swung(own, conjugate(own.wxyz))
    said = against_orientation([gyro], [inverse])
    if not is_known:
        assert said.code == "rates-contradict"
        assert "deg: they agree with its inverse, but this motion does not tell that from " in str(
            said
        )
        return
    assert said.code == "inverse-orientation"
    assert in_python(said).endswith(INVERSE)
    assert against_orientation([gyro], [swung(own, conjugate(inverse.wxyz))]) is None


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("seed", range(10))
def test_nothing_but_the_inverse_is_taken_for_it(seed):
    """Mirrored and other axes, a mounting, another frame, and a sensor that is well, at random."""
    rng = np.random.default_rng(seed)
    t_ns = np.arange(3000) * int(rng.choice([5, 10, 20])) * MS
    phase = 2 * np.pi * rng.uniform(0.05, 0.8) * t_ns[:, None] / SECOND * [1.0, 1.3, 0.7]
    axes = rng.permutation([1.0, *rng.choice([1.0, 0.3, 0.05, 0.0], 2)])
    rate = rng.uniform(0.1, 4.0) * np.sin(phase + rng.uniform(0, 6, 3)) * axes
    start = exp(rng.normal(size=3) * rng.choice([0.0, 0.2, 2.0]))
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate, q0=start, method="mean"))
    gyro = GyroSeries(t_ns, rate + rng.normal(0, 0.01, 3) + rng.normal(0, 0.01, rate.shape))
    mount = rotation_matrix(exp(rng.normal(size=3)))
    others = [
        *(gyro.with_rate(gyro.rate * signs) for signs in ([1, 1, 1], [1, 1, -1], [-1, -1, -1])),
        *(gyro.with_rate(gyro.rate @ turn) for turn in (mount, -mount, mounting("y,-x,z"))),
        in_frame(gyro, own, "inertial"),
    ]
    for other in others:
        said = against_orientation([other], [own])
        assert said is None or said.code != "inverse-orientation"


def in_frame(gyro, own, frame):
    """Return rates in a frame, of which the attitudes are known."""
    return gyro if frame == "body" else gyro.with_rate(rotate(own.wxyz, gyro.rate))


@pytest.mark.parametrize("seed", range(24))
def test_what_is_advised_makes_rates_agree_with_the_orientation(seed):
    """Another unit, frame or axes, alone or with another unit, at any rate and sample rate."""
    rng = np.random.default_rng(seed)
    step_ns, peak = int(rng.choice([2, 5, 10, 20])) * MS, float(rng.uniform(0.3, 3.0))
    t_ns = np.arange(3000) * step_ns
    phase = 2 * np.pi * rng.uniform(0.2, 0.6) * t_ns[:, None] / SECOND * [1.0, 1.3, 0.7]
    rate = peak * np.sin(phase + rng.uniform(0, 6, 3)) + rng.normal(0, 2e-3, (3000, 3))
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate, q0=exp(rng.normal(size=3)), method="mean"))
    frame, axes = [("body", "x,y,z"), ("inertial", "x,y,z"), ("body", "-y,x,z")][seed % 3]
    scale = [1.0, 180 / math.pi, math.pi / 180, 2.5][seed % 4]
    gyro = in_frame(GyroSeries(t_ns, rate @ mounting(axes)), own, frame)
    said = against_orientation([gyro.with_rate(gyro.rate * scale)], [own])
    settings = dict(re.findall(r"(\w+)='(.*?)'", in_python(said))) if said else {}
    if scale > 3:
        assert settings.pop("rate_unit") == "deg/s"
    elif scale < 1:
        assert "scaled by pi/180 once too often" in str(said)
    if scale == 2.5:
        assert not settings
        assert str(said).endswith("are both of the same sensor?")
        return
    rate = gyro.rate @ mounting(settings.get("mount", "x,y,z")).T
    frame = settings.get("rates", "body")
    assert against_orientation([gyro.with_rate(rate)], [own], frame) is None


def test_no_unit_is_advised_for_what_happened_in_a_gap():
    """A pause of 1068 s counted as a time of the same rate, and deg/s was advised."""
    gyro, own = swinging(2000, 0.02)
    t_ns = own.t_ns + (np.arange(2000) > 900) * 1068 * SECOND
    assert against_orientation([replace(gyro, t_ns=t_ns)], [replace(own, t_ns=t_ns)]) is None


def test_rates_are_compared_in_the_axes_in_which_they_are_resolved():
    """Turns by x, y and -x, and back, in every second: of body rates they undo one another.

    The orientation to which they lead in reference axes was reported to rotate ever faster.
    """
    x, y = 2 * np.eye(3)[:2]
    rate = np.tile(4 * np.array([x, y, -x, rotate(exp(x), -y)]), (40, 1))
    t_ns = np.arange(len(rate)) * 250 * MS
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate, rates="inertial"))
    gyro = GyroSeries(t_ns, rate)
    assert "with rates='inertial'" in in_python(against_orientation([gyro], [own], "body"))
    assert against_orientation([gyro], [own], "inertial") is None


def test_motion_that_agrees_is_enough():
    """Where the first samples agree with the orientation, no more of the log is read."""
    gyro, own = turning(20_000)
    read = []

    def batches(series):
        for start in range(0, 20_000, 1000):
            read.append(start)
            yield series[start : start + 1000]

    assert against_orientation(batches(gyro), batches(own)) is None
    assert len(read) == 4


def test_only_the_beginning_is_searched_for_an_orientation(monkeypatch):
    """Where no message has an orientation, the log is not read to its end to find that out."""
    read = []

    def rows():
        for start in range(0, 10**6, 1000):
            read.append(start)
            yield np.arange(start, start + 1000), np.full((1000, 4), np.nan)

    absent = SimpleNamespace(first=rows)
    monkeypatch.setattr("quatprop.propagation.plausibility.own_orientation", lambda *_: absent)
    rates = GyroSeries(np.arange(10), np.ones((10, 3)))
    source = SimpleNamespace(unit="rad/s", matches=(), batches=lambda **_: iter([rates]))
    assert orientation_remarks(SimpleNamespace(path="log.bag"), source, None, "body") == []
    assert len(read) == 2
