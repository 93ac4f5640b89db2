"""Draw the pictures of the documents; each keeps in it the numbers that it shows."""

import io
import json
import warnings
from fractions import Fraction

import matplotlib as mpl
import numpy as np
from make.measured import METHODS, RATES_HZ, convergence
from make.places import SAMPLE_LOGS
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import quatprop
from quatprop.kinematics.quaternion import conjugate, multiply, shorter
from quatprop.kinematics.quaternion import log as rotation_vector
from quatprop.tools.simulation import Gyroscope, Shape, motion_named, record

STYLE = {"font.size": 8, "lines.linewidth": 1.0, "axes.grid": True, "grid.alpha": 0.3}
KEY = "Description"
"""Where a PNG keeps its numbers."""

RUNS, HERTZ, SECONDS = 40, 50, 30
NOISE = np.radians(0.2) / 60
"""rad/s/sqrt(Hz): 0.2 deg/sqrt(h)."""
BIAS = np.radians(20) / 3600
"""rad/s: 20 deg/h."""


def methods():
    """Return a picture of the error by sample rate and method, and its numbers."""
    errors = convergence()
    figure = Figure((7.2, 3.1), layout="constrained")
    for axes, (motion, rows) in zip(
        figure.subplots(1, 2, sharey=True), errors.items(), strict=True
    ):
        for method in METHODS:
            axes.loglog(RATES_HZ, rows[method], "o-", ms=3, label=method)
        axes.axhline(
            np.degrees(NOISE * np.sqrt(10)),
            color="0.4",
            ls="--",
            label="noise of 0.2 deg/√h, 1 sigma",
        )
        axes.set(title=f"{motion}, 10 s", xlabel="sample rate, Hz", ylim=(1e-14, 10))
        axes.set_xticks(RATES_HZ, [str(hertz) for hertz in RATES_HZ])
        axes.minorticks_off()
    axes.figure.axes[0].set_ylabel("largest error, deg")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right center")
    return figure, errors


def made_mistakes():
    """Return what each mistake makes of the attitudes of the tumbling body, and the truth."""
    rates = quatprop.read_rates(SAMPLE_LOGS / "tumbling.bag")
    truth = quatprop.read_attitudes(SAMPLE_LOGS / "tumbling.truth.csv")
    degrees = quatprop.GyroSeries(rates.t_ns, np.degrees(rates.rate))
    t_ns, wxyz = truth.t_ns, truth.wxyz

    def propagated(series=rates, **options):
        return quatprop.propagate(series, **{"method": "cubic", **options})

    return {
        "wrong side of the product": propagated(rates="inertial"),
        "reference to body for body to reference": quatprop.AttitudeSeries(
            t_ns, wxyz * [1, -1, -1, -1]
        ),
        "w, x, y, z read as x, y, z, w": quatprop.AttitudeSeries(t_ns, wxyz, layout="scalar-last"),
        "deg/s read as rad/s": propagated(degrees),
        "y and z of the sensor inverted": propagated(mount="x,-y,-z"),
        "bias of 0.01 rad/s about x": propagated(bias=(-0.01, 0, 0)),
        "method start": propagated(method="start"),
        "clock 30 ms late": quatprop.AttitudeSeries(t_ns + 30_000_000, wxyz),
    }, truth


def mistakes():
    """Return a picture of the error of each mistake in time, and the causes that are named."""
    figure = Figure((7.2, 6.4), layout="constrained")
    causes = {}
    made, truth = made_mistakes()
    for axes, (name, wrong) in zip(
        figure.subplots(4, 2, sharex=True).flat, made.items(), strict=True
    ):
        found = quatprop.compare(wrong, truth)
        causes[name] = [found.likely_cause.name, float(np.degrees(found.error_rad.max))]
        axes.plot((found.t_ns - truth.t_ns[0]) / 1e9, np.degrees(found.errors), lw=0.8)
        axes.set_title(f"{name}: cause ({causes[name][0]})", fontsize=8)
        axes.set(ylim=(0, 1.1 * causes[name][1]), xlim=(0, 10))
    figure.supxlabel("time, s", fontsize=8)
    figure.supylabel("geodesic error, deg", fontsize=8)
    return figure, causes


def uncertainty(runs=RUNS):
    """Return a picture of the errors of many runs within their standard deviations.

    The document gives the ratio for 4,000 runs, too.
    """
    random = np.random.default_rng(7)
    figure = Figure((7.2, 2.8), layout="constrained")
    axes, ratios = figure.subplots(), []
    for seed in range(runs):
        bias = tuple(random.normal(0, BIAS, 3))
        gyroscope = Gyroscope(
            Fraction(HERTZ), HERTZ * SECONDS, noise=NOISE, bias=bias, seed=seed, start_ns=0
        )
        (log,) = record(motion_named("coning", Shape()), gyroscope)
        found = quatprop.propagate(
            quatprop.GyroSeries(log.t_ns, log.rate), method="cubic", sigma=True,
            noise_density=NOISE, bias_sigma=BIAS,
        )  # fmt: skip
        vectors = rotation_vector(shorter(multiply(conjugate(log.wxyz), found.wxyz)))
        ratios.append(vectors[-1] / found.sigma[-1])
        axes.plot(log.t_ns / 1e9, np.degrees(vectors[:, 0]), color="0.5", lw=0.4)
    sigma = np.degrees(found.sigma[:, 0])
    for count, alpha in ((2, 0.15), (1, 0.3)):
        axes.fill_between(
            log.t_ns / 1e9, -count * sigma, count * sigma, color="C0", alpha=alpha, lw=0,
            label=f"± {count} sigma",
        )  # fmt: skip
    axes.set(xlabel="time, s", ylabel="error about body x, deg", xlim=(0, SECONDS))
    axes.legend(loc="upper left")
    return figure, {"rms_of_final_error_in_sigma": float(np.sqrt(np.mean(np.square(ratios))))}


PICTURES = {"methods.png": methods, "mistakes.png": mistakes, "sigma.png": uncertainty}


def numbers_of(name):
    """Return the picture of this name, and its numbers to three digits."""
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore", quatprop.QuatpropWarning)
        figure, numbers = PICTURES[name]()
    return figure, _rounded(numbers)


def numbers_in(path):
    """Return the numbers that a picture keeps."""
    with Image.open(path) as picture:
        return json.loads(picture.text[KEY])


def draw(path):
    """Draw a picture where it is not there, or other numbers are in it."""
    figure, numbers = numbers_of(path.name)
    if path.exists() and numbers_in(path) == numbers:
        return
    stream, about = io.BytesIO(), PngInfo()
    with mpl.rc_context(STYLE):
        figure.savefig(stream, format="png", dpi=130)
    about.add_text(KEY, json.dumps(numbers))
    # A palette is a third of the size.
    Image.open(stream).convert("RGB").quantize(48).save(path, "png", optimize=True, pnginfo=about)


def _rounded(value):
    """Return numbers to three digits; those that are rounding errors are all the same."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return value if isinstance(value, str) else float(f"{max(value, 1e-9):.3g}")
