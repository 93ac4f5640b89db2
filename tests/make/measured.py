"""The errors of the integration rules on what sensors give, as the documents show them."""

import warnings

import numpy as np

import quatprop
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, log, multiply
from quatprop.tools.simulation import Shape, motion_named

METHODS = ("start", "mean", "coning", "cubic", "quintic")
RATES_HZ = (25, 50, 100, 200, 400)
SECONDS = 10
NS = 1_000_000_000

NEWTON_COTES = np.array(
    [16067, 106300, -48525, 272400, -260550, 427368, -260550, 272400, -48525, 106300, 16067]
)
"""Weights of 11 equidistant values, closed; 598752 / 5 times those of the integral over 10 steps.
Abramowitz and Stegun, Handbook of Mathematical Functions, 1964, 25.4.20."""

SAMPLES = ("points", "averages", "corrected averages")
"""The samples of a sensor: the rate at each stamp, its mean since the stamp before, or the rotation
vector since then divided by the time, which is an average with its coning correction."""


def sampled(motion, hertz, kind):
    """Return what a sensor gives of a motion, and the true attitudes."""
    t_ns = np.arange(SECONDS * hertz + 1) * (NS // hertz)
    true_rate, wxyz = motion_named(motion, Shape())(t_ns)
    if kind == "points":
        return quatprop.GyroSeries(t_ns, true_rate), wxyz
    if kind == "averages":
        fine, _ = motion_named(motion, Shape())(
            np.arange((len(t_ns) - 1) * 10 + 1) * (NS // hertz // 10)
        )
        parts = np.stack([fine[k : len(fine) - 10 + k : 10] for k in range(11)])
        mean = np.tensordot(NEWTON_COTES / NEWTON_COTES.sum(), parts, 1)
    else:
        mean = log(multiply(conjugate(wxyz[:-1]), wxyz[1:])) * hertz
    rate = np.concatenate([mean[:1], mean])
    return quatprop.GyroSeries(t_ns, rate, is_interval_average=True), wxyz


def largest_error_deg(motion, hertz, kind, method):
    """Return the largest geodesic error over the whole time, deg."""
    series, wxyz = sampled(motion, hertz, kind)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", quatprop.RemarkWarning)
        found = quatprop.propagate(series, method=method, q0=wxyz[0])
    return float(np.degrees(geodesic_angle(found.wxyz, wxyz).max()))


def convergence():
    """Return the largest error, deg, by motion, method and sample rate, of rates at points."""
    return {
        motion: {
            method: [largest_error_deg(motion, hertz, "points", method) for hertz in RATES_HZ]
            for method in METHODS
        }
        for motion in ("tumbling", "coning")
    }


TABLE_METHODS = ("start", "end", "mean", "coning", "cubic", "quintic")

METHOD_TABLE = r"(?m)^\| the sensor gives \| method \|.*\n(?:\|.*\n)+"
"""Where conventions.md has the errors of methods."""


FLOOR = 1e-10
"""deg: smaller errors are not far above those of rounding."""


def method_table():
    """Return the errors of each method on what a sensor gives, and the order they show."""
    shown = (50, 100, 200)
    head = ["the sensor gives", "method", *(f"{hertz} Hz" for hertz in shown), "order"]
    rows = [head, ["---"] * len(head)]
    for kind in SAMPLES:
        for method in TABLE_METHODS:
            if kind != "points" and method in {"start", "mean"}:
                continue
            errors = [largest_error_deg("coning", hertz, kind, method) for hertz in shown]
            order = np.log2(errors[0] / errors[1])
            cells = [f"{error:.2g}" if error > FLOOR else "< 1e-10" for error in errors]
            rows.append([kind, f"`{method}`", *cells, f"{order:.1f}" if errors[1] > FLOOR else ""])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
