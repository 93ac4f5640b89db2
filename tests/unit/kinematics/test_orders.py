"""How the error shrinks with the interval, on a rotor whose axis precesses, by every method."""

from fractions import Fraction

import numpy as np
import pytest
from make.motion import FRAMES, RATES_HZ, SECOND, orders, rotor, rotor_samples, stamps
from make.streams import segmented

from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.resample import Steady

AVERAGED = ("averages", "increments")
SLOW_HZ = (16, 32, 64, 125)
"""At higher rates the error of quintic is that of float64."""


def worst(kind, t_ns, method, times=None, *, inside=False):
    """Return the worst error of the attitudes, rad, or of those between the outer intervals.

    Within those, with a neighbour on one side alone, the rate is an order less.
    """
    how = {"q0": rotor(t_ns[:1] / 1e9)[0][0], "method": method}
    how["rates"] = kind if kind in FRAMES else "body"
    _, out_ns, wxyz = segmented([rotor_samples(kind, t_ns)], times, **how)
    error = geodesic_angle(wxyz, rotor(out_ns / 1e9)[0])
    return error[(out_ns > t_ns[1]) & (out_ns < t_ns[-2])].max() if inside else error.max()


@pytest.mark.thorough
@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize(
    ("method", "kind", "bounds", "order"),
    [
        *(("end", kind, [1.3e-2, 3.2e-3, 7.9e-4, 2.0e-4], 1.95) for kind in AVERAGED),
        *(("coning", kind, [1.4e-4, 1.7e-5, 2.2e-6, 2.7e-7], 2.95) for kind in AVERAGED),
        *(("cubic", kind, [2.0e-5, 1.3e-6, 8.0e-8, 5.0e-9], 3.8) for kind in AVERAGED),
        *(("cubic", kind, [2.0e-5, 1.3e-6, 8.0e-8, 5.0e-9], 3.8) for kind in FRAMES),
    ],
)
def test_at_samples(method, kind, bounds, order, jitter):
    """The worst over 20 s, at 50 to 400 Hz, at even stamps and at stamps that are off."""
    errors = [worst(kind, stamps(hz, 20, jitter), method) for hz in RATES_HZ]
    assert (np.array(errors) <= bounds).all()
    assert orders(errors).min() > order


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    ("method", "order"), [("start", 1), ("end", 1), ("mean", 2), ("coning", 2)]
)
def test_simple_rules(method, order, frame):
    """Rates at moments, in either frame; the sign of the coning term is in test_increments."""
    errors = [worst(frame, stamps(hz, 2), method) for hz in RATES_HZ]
    assert orders(errors)[-1] == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize("kind", AVERAGED)
@pytest.mark.parametrize(("method", "order"), [("end", 1.9), ("coning", 2.8), ("cubic", 3.7)])
def test_between_samples(method, kind, order):
    """At 997 Hz the order is the same: the rate within an interval follows from its neighbours."""
    errors = [
        worst(kind, stamps(hz, 5, 0.3), method, Steady(Fraction(997)), inside=True)
        for hz in RATES_HZ
    ]
    assert np.log2(errors[0] / errors[-1]) / 3 > order


@pytest.mark.parametrize("hz_out", [None, 997])
@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("kind", [*FRAMES, *AVERAGED])
def test_quintic_is_of_sixth_order(kind, jitter, hz_out):
    """At samples and between them; of averages, the polynomial is that of the integral."""
    errors = [
        worst(kind, stamps(hz, 4, jitter), "quintic", hz_out and Steady(Fraction(hz_out)))
        for hz in SLOW_HZ
    ]
    assert np.log2(errors[0] / errors[-1]) / 3 > 5.8
    assert errors[-1] < 1e-10


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("kind", AVERAGED)
def test_alternating_intervals_are_of_full_order(kind, first):
    """The first and the last interval lost their correction: third order, worse than coning."""
    cubic, coning = [], []
    for hz in RATES_HZ:
        steps = np.tile(np.array([6, 14]) * (SECOND // hz // 10), hz // 10 + 1)[first:]
        t_ns = np.concatenate([[0], np.cumsum(steps)])
        cubic.append(worst(kind, t_ns, "cubic"))
        coning.append(worst(kind, t_ns, "coning"))
    assert orders(cubic).min() > 3.8
    assert (np.array(cubic) < np.array(coning) / 4).all()
