"""What a comparison found, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from quatprop.cli.summary import loss_lines
from quatprop.comparison.statistics import FIGURES
from quatprop.containers.base import Loss
from quatprop.text import plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator


def comparison(report: dict[str, Any]) -> str:
    """Return what ``quatprop compare`` found, in lines that begin with a name each.

    Parameters
    ----------
    report
        The reports of both sides under ``"a"`` and ``"b"``, and that of
        :meth:`quatprop.comparison.Comparison.report`.
    """
    facts = [*_facts(report), *_figures(report), *_judgement(report)]
    return "\n".join(f"{name:<9} {value}".rstrip() for name, value in facts)


def _facts(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for side in ("a", "b"):
        said = report[side]
        span = duration_text(said["last_ns"] - said["first_ns"])
        named = " ".join(plain(said[key]) for key in ("name", "type") if said[key])
        name = f"{plain(said['path'])} ({said['kind']}): {named}"
        yield side.upper(), f"{name}, {said['samples']} samples over {span}"
    yield "matched", _matched(report["association"])
    offset = report["time_offset"]
    if offset["added_to_b_ns"] or offset["found"]:
        yield "offset", _offset(offset)
    alignment = report["alignment"]
    if alignment["name"] != "none":
        yield "alignment", _alignment(alignment)
    if alignment["mounting"]:
        yield "", _mounting(alignment["mounting"])


def _matched(association: dict[str, Any]) -> str:
    how = {
        "exact": "equal stamps",
        "nearest": f"nearest to {association['at']} within "
        f"{duration_text(association['max_dt_ns'])}",
        "interpolate": f"{'A' if association['at'] == 'B' else 'B'} interpolated at the stamps of "
        f"{association['at']}, over at most {duration_text(association['max_dt_ns'])}",
    }
    span = duration_text(association["last_ns"] - association["first_ns"])
    counts = f"{association['matched']} of {association['candidates']} samples over {span}"
    return f"{counts}: {how[association['match']]}"


def _offset(offset: dict[str, Any]) -> str:
    said = f"{duration_text(offset['added_to_b_ns'])} added to B's stamps"
    if found := offset["found"]:
        said += (
            f" +- {duration_text(round(found['std_ns']))}, found from angular speeds: correlation "
            f"{found['correlation']:.4f}, next best elsewhere {found['runner_up']:.4f}"
        )
    return said


def _alignment(alignment: dict[str, Any]) -> str:
    said = f"{alignment['name']}: reference frame turned by {_both(alignment['reference_rad'])}"
    if alignment["mounting"]:
        said += f", body frame by {_both(alignment['mount_rad'])}"
    return said


def _mounting(mounting: dict[str, Any]) -> str:
    first, second, third = mounting["singular_values"]
    return (
        f"from {mounting['motions']} rotations, {math.degrees(mounting['turn_rad']):.3g} deg RMS; "
        f"axes excited as 1 : {second / first:.2g} : {third / first:.2g}; "
        f"+- {math.degrees(mounting['std_rad']):.2g} deg"
    )


def _figures(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "error", f"{'rad':>14} {'deg':>14}"
    for key, name in FIGURES.items():
        error = report["error_rad"][key]
        yield f"  {name}", f"{error:14.6e} {math.degrees(error):14.6g}"
    if report["drift_deg_h"] is not None:
        yield "drift", f"{report['drift_deg_h']:+.6g} deg/h, slope of the error"
    yield "worst", _place(report["worst"], report)
    if report["window"]:
        yield "window", _window(report["window"], report["association"]["first_ns"])


def _window(window: dict[str, Any], first_ns: int) -> str:
    return (
        f"{window['count']} of {duration_text(window['window_ns'])}: max "
        f"{_both(window['max_rad'])}, RMS {_both(window['rms_rad'])}; the worst begins at "
        f"{window['worst_ns']} ns, {duration_text(window['worst_ns'] - first_ns)} after the first"
    )


def _judgement(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    if report["tolerance_rad"] is not None:
        tolerance = f"tolerance {_both(report['tolerance_rad'])}"
        if report["passed"]:
            yield "passed", f"no error above the {tolerance}"
        else:
            first = _place(report["first_exceeding"], report)
            yield "failed", f"above the {tolerance}, first at {first}"
    if cause := report["likely_cause"]:
        yield "cause", f"likely ({cause['name']}): {cause['sentence']}"
        rms = f"{cause['rms_before']:.3g} rad to {cause['rms_after']:.3g} rad"
        yield "", f"without it the RMS error goes from {rms}"
    for side in ("a", "b"):
        for remark in report[side]["remarks"]:
            yield "remark", f"{side.upper()}: {plain(remark)}"
        rows = report[side]["rows"]
        if left_out := rows["read"] - rows["used"]:
            yield "lost", f"{left_out} rows of {side.upper()} are no rotation"
        for loss in loss_lines([Loss(**loss) for loss in report[side]["losses"]]):
            yield "", loss
    for remark in report["remarks"]:
        yield "remark", plain(remark)


def _place(place: dict[str, Any], report: dict[str, Any]) -> str:
    since = duration_text(place["t_ns"] - report["association"]["first_ns"])
    return (
        f"sample {place['index']} of {place['at']}, {place['t_ns']} ns, {since} after the first: "
        f"{_both(place['error_rad'])}"
    )


def _both(angle: float) -> str:
    return f"{angle:.6g} rad ({math.degrees(angle):.6g} deg)"
