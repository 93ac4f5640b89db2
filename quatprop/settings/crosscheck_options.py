"""The settings of a cross-check: signals, tolerances, allowed differences, corrections."""

from collections.abc import Collection, Mapping
from datetime import timedelta
from typing import Annotated, Final

from quatprop.base.errors import UsageError
from quatprop.base.text import quoted
from quatprop.settings.command_options import angle_rad
from quatprop.settings.parsers import Choice, Keyword, keywords_of, length, parts_of
from quatprop.settings.quantities import RATES, RATIOS, quantity_of
from quatprop.settings.reading import PLOT, RateOptions, SeriesOptions

FACTS: Final = (
    *("axes", "mount", "offset", "clock", "scale", "bias", "drift", "changes", "unrelated", "weak"),
)
"""Differences that two devices may have without a fault, so that they can be allowed."""

CORRECTIONS: Final = (
    *("from_layout", "from_convention", "from_direction", "rate_unit", "bias", "scale", "axes"),
    *("mount", "rates", "time_offset"),
)
"""Settings of single sources, in the order in which they are applied."""

_rate = quantity_of(RATES, "a rate", "0.3deg/s")
_ratio = quantity_of({**RATIOS, "": 1.0}, "a ratio", "2%")


def allowed(value: object) -> tuple[str, ...]:
    """Return which differences are allowed: text such as ``"mount,offset"``, or names."""
    return tuple(Choice(*FACTS)(str(name).strip()) for name in parts_of(value))


def corrections(value: object) -> dict[str, dict[str, str]]:
    """Return settings of sources: source -> setting -> value.

    `value`: texts such as ``"/imu:rate-unit=deg/s"``, or the same as mappings
    """
    settings: dict[str, dict[str, str]] = {}
    if isinstance(value, Mapping):
        for source, own in value.items():
            for name, one in own.items():
                settings.setdefault(str(source), {})[_setting(str(name))] = str(one)
        return settings
    for text in [value] if isinstance(value, str) else parts_of(value):
        source, name, one = _parts(str(text))
        settings.setdefault(source, {})[_setting(name)] = one
    return settings


def _parts(text: str) -> tuple[str, str, str]:
    """Return source, setting and value; the source may contain colons, as may the value."""
    head, equals, value = text.partition("=")
    source, colon, name = head.rpartition(":")
    if not (equals and colon and source and value):
        raise UsageError(
            f"{quoted(text)} is not a setting of a source; write SOURCE:SETTING=VALUE, such as "
            "/imu:rate-unit=deg/s"
        )
    return source, name, value


def _setting(name: str) -> str:
    return Choice(*CORRECTIONS)(name.replace("-", "_"))


class CrossCheckOptions(RateOptions, SeriesOptions, total=False):
    """Keywords of :func:`quatprop.crosscheck`, besides those of both base classes."""

    # fmt: off
    tol_offset: Annotated[float | str | timedelta | None, Keyword(
        length, "Tolerated clock offset; 0.6 intervals of the slower source in any case.",
        "5ms", "DUR", "Limits", common=True)]
    tol_mount: Annotated[float | str | None, Keyword(
        angle_rad, "Rotation between the axes of two devices that is tolerated.", "2deg", "ANGLE",
        "Limits", common=True)]
    tol_scale: Annotated[float | str | None, Keyword(
        _ratio, "Difference in scale that is tolerated.", "2%", "RATIO", "Limits", common=True)]
    tol_bias: Annotated[float | str | None, Keyword(
        _rate, "Bias of a gyroscope that is tolerated.", "0.3deg/s", "RATE", "Limits",
        common=True)]
    allow: Annotated[str | Collection[str] | None, Keyword(
        allowed, f"Differences that are no reason to fail: {', '.join(FACTS)}.", "none",
        "NAMES", "Limits", common=True)]
    correct: Annotated[Mapping[str, Mapping[str, str]] | Collection[str] | str | None, Keyword(
        corrections, "Read one source otherwise, such as /imu:rate-unit=deg/s: "
        f"{', '.join(name.replace('_', '-') for name in CORRECTIONS)}. Findings say which.",
        "as the log says", "SOURCE:SETTING=VALUE", common=True)]
    # fmt: on


CROSSCHECK = {
    name: row
    for name, row in keywords_of(CrossCheckOptions).items()
    if name not in {"start", "end"}
}
"""Settings of a cross-check: name -> its row."""

READ: Final = tuple(name for name in CROSSCHECK if name in PLOT)
"""Those for reading."""
