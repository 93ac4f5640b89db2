"""A gap is the first hypothesis for an error, and nothing is fitted across it."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import quatprop
from quatprop import AttitudeSeries, GyroSeries, compare
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")

HZ, COUNT = 50, 1500
FIRST_NS = 1_700_000_000_000_000_000
T_NS = FIRST_NS + np.arange(COUNT) * 10**9 // HZ
SECONDS = np.arange(COUNT)[:, None] / HZ
FRAME_DEG = re.compile(r"reference frames differ by ([\d.]+) deg")
STEP = re.compile(
    r"changes by ([\d.]+) deg across a gap of .*s in ([AB and]+), which .* at (\d+) ns:"
)


def motion(seed):
    """Return rates of a body that turns about all axes and does not repeat itself, rad/s."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.3, 5, (6, 3)), rng.uniform(0, 6.3, (6, 3)), rng.normal(size=(6, 3))
    return (
        sum(size * np.cos(SECONDS * fast + phase) for fast, phase, size in zip(*waves, strict=True))
        / 3
    )


def propagated(rate, keep=slice(None), q0=None):
    """Return the attitudes of some of the rates."""
    found = quatprop.propagate(GyroSeries(T_NS[keep], rate[keep]), method="cubic", q0=q0)
    return AttitudeSeries(found.t_ns, found.wxyz)


def turned(series, rotvec):
    """Return a series in another reference frame."""
    return AttitudeSeries(series.t_ns, multiply(exp(rotvec), series.wxyz))


@given(
    seed=st.integers(0, 2**32),
    begin=st.integers(60, 900),
    count=st.integers(12, 500),
    gap_of=st.sampled_from(["A", "B", "A and B"]),
    planted=st.tuples(st.sampled_from([0.0, 40.0, 120.0]), st.sampled_from([0.0, 0.2])),
    align=st.sampled_from(["none", "first", "mean"]),
)
@settings(max_examples=25, deadline=None)
def test_a_step_at_a_gap_is_reported_and_nothing_is_fitted_across_it(  # noqa: PLR0913, PLR0917
    seed, begin, count, gap_of, planted, align
):
    """It was a steady drift, or frames that differ; those that do are named by their true angle."""
    frame_deg, bias_deg_s = planted
    rate = motion(seed)
    keep = np.r_[:begin, begin + count : COUNT]
    truth = propagated(rate)
    frame = np.radians(frame_deg) * np.array([0.48, -0.6, 0.64])
    measured = rate + np.radians([bias_deg_s, 0, 0])
    estimate = propagated(measured, keep, truth.wxyz[0])
    reference = turned(truth[keep] if gap_of == "A and B" else truth, frame)
    a, b = (reference, estimate) if gap_of == "B" else (estimate, reference)
    found = compare(a, b, align=align)
    causes = found.likely_cause.chain if found.likely_cause else []
    for cause in causes:
        # Method: attitudes over the edges of a gap are of a lower order.
        assert cause.name in {"reference frame", "rate bias", "drift", "method"}
        if cause.name == "reference frame" and (angle := FRAME_DEG.search(cause.sentence)):
            assert frame_deg or float(angle[1]) < 2
            if align == "none":
                assert float(angle[1]) == pytest.approx(frame_deg, abs=3)
        assert bias_deg_s or cause.name not in {"rate bias", "drift"}
    after = np.searchsorted(estimate.t_ns, T_NS[begin])
    steps = [
        multiply(one.wxyz[[k]] * [1, -1, -1, -1], one.wxyz[[k + n]])
        for one, k, n in ((estimate, after - 1, 1), (truth, begin - 1, count + 1))
    ]
    step_deg = float(np.degrees(geodesic_angle(*steps))[0])
    said = [remark for remark in found.remarks if remark.code == "step-at-gap"]
    if step_deg > 20 and not bias_deg_s:
        assert len(said) == 1
    for remark in said:
        degrees, of, at = STEP.search(remark).groups()
        apart_deg = 0.05 + (count + 1) / HZ * bias_deg_s
        assert float(degrees) == pytest.approx(step_deg, rel=2e-3, abs=apart_deg)
        assert (of, int(at)) == (gap_of, T_NS[begin - 1])


@given(
    seed=st.integers(0, 2**32),
    begin=st.integers(60, 900),
    count=st.integers(12, 500),
    gap_of=st.sampled_from(["A", "B", "A and B"]),
    planted=st.sampled_from(["bias", "frame", "ramp"]),
)
@settings(max_examples=15, deadline=None)
def test_an_error_that_does_not_step_at_a_gap_is_not_blamed_on_it(
    seed, begin, count, gap_of, planted
):
    """The motion is known on both sides, and the error has its cause elsewhere."""
    rate = motion(seed)
    keep = np.r_[:begin, begin + count : COUNT]
    truth = propagated(rate)
    other = {
        "bias": lambda: propagated(rate + np.radians([0.5, 0.3, -0.4])),
        "frame": lambda: turned(truth, [0.3, 0.5, -0.2]),
        "ramp": lambda: turned(truth, SECONDS * [0.004, 0.003, -0.005]),
    }[planted]()
    a, b = (one[keep] if name in gap_of else one for name, one in (("A", truth), ("B", other)))
    found = compare(a, b)
    assert "step-at-gap" not in {remark.code for remark in found.remarks}
    names = {"bias": {"rate bias", "drift"}, "frame": {"reference frame"}, "ramp": {"drift"}}
    causes = found.likely_cause.chain if found.likely_cause else []
    assert {cause.name for cause in causes[:1]} <= names[planted]


def test_frames_do_not_differ_where_a_begins_as_b_does():
    """A drift from B's attitude on was reported as frames that differ by its mean."""
    rate = motion(5)
    bend = np.minimum(SECONDS, 5)
    truth = propagated(rate)
    bent = turned(truth, bend * [0.2, -0.1, 0.15])
    found = compare(truth, bent)
    causes = found.likely_cause.chain if found.likely_cause else []
    assert not [cause for cause in causes if "frame" in cause.name]


def test_a_step_and_other_causes_are_both_reported():
    """Frames explain most, and the rest steps at a gap: the step was not reported."""
    rate = motion(4)
    keep = np.r_[:700, 750:COUNT]
    truth = propagated(rate)
    found = compare(propagated(rate, keep, truth.wxyz[0]), turned(truth, [0.0, 0.0, 2.5]))
    assert [cause.name for cause in found.likely_cause.chain] == ["reference frame"]
    assert "differ by 143.239 deg" in found.likely_cause.sentence
    (remark,) = [one for one in found.remarks if one.code == "step-at-gap"]
    assert remark.startswith("without that cause, the error changes by ")


def test_a_gap_that_is_not_judged_is_no_step_but_in_the_part_that_is():
    """The step lies before the range, and B is aligned there, or in it."""
    rate = motion(4)
    keep = np.r_[:300, 360:COUNT]
    truth = propagated(rate)
    a = propagated(rate, keep, truth.wxyz[0])
    inside = compare(a, truth, judge="+2s..+20s", align="first")
    (remark,) = inside.remarks
    assert (remark.code, inside.likely_cause) == ("step-at-gap", None)
    own = compare(a, truth, judge="+8s..+20s", align="first", align_range="judged")
    assert "step-at-gap" not in {one.code for one in own.remarks}


def test_a_mounting_is_not_fitted_across_a_gap():
    """The rotations over it, which one series lost, moved the mounting by some degrees."""
    rate = motion(9)
    keep = np.r_[:700, 740:COUNT]
    truth = propagated(rate)
    mount = exp([0.4, -0.3, 0.9])
    reference = AttitudeSeries(T_NS, multiply(truth.wxyz, mount))
    found = compare(propagated(rate, keep, truth.wxyz[0]), reference, align="mount")
    inverse = found.alignment.mount_wxyz * [1, -1, -1, -1]
    assert np.degrees(geodesic_angle(inverse, mount)) < 0.01
