"""Values of settings: parse them together, and write them for a configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quatprop.errors import UsageError
from quatprop.settings import PROPAGATE
from quatprop.settings.reading import OPTION_NAMES
from quatprop.text import Setting, did_you_mean, listed, quoted

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from quatprop.settings.parsers import Parser


def parse_all(
    options: Mapping[str, object], parsers: Mapping[str, Parser] = PROPAGATE
) -> dict[str, Any]:
    """Return settings by name with their parsed values; None counts as not given."""
    values = {}
    refuse_unknown(options, parsers)
    for name, value in options.items():
        if value is None:
            continue
        try:
            values[name] = parsers[name](value)
        except UsageError as error:
            raise UsageError(f"{Setting(name)}: {error.text}") from error
    return values


def refuse_unknown(options: Iterable[str], names: Collection[str]) -> None:
    """Refuse unknown keywords of a function, and suggest the likely one."""
    keywords = {option: keyword for keyword, option in OPTION_NAMES.items()}
    for name in options:
        if name in names:
            continue
        keyword = keywords.get(name.rstrip("_"))
        if name == "euler_unit" and "extra_columns" in names:
            way_out = "; it is part of a representation's name, such as 'euler-zyx-deg'"
        elif keyword in names:
            way_out = f"; did you mean {quoted(keyword)}?"
        else:
            way_out = did_you_mean(name, names, f"there are {listed(names)}")
        raise UsageError(f"there is no setting {quoted(name)}{way_out}")


def as_text(name: str, value: object, parsed: object) -> str | bool:
    """Return the value of a setting in the form for a configuration."""
    if isinstance(value, str | bool):
        return value
    if type(parsed) is tuple:
        return ",".join(f"{part}{SI_UNITS.get(name, '')}" for part in parsed)
    if name == "scale_sigma" and isinstance(parsed, float):
        return f"{parsed * 1e6}ppm"
    return f"{parsed}{SI_UNITS.get(name, '')}"


SI_UNITS = {
    "max_gap": "ns",
    "noise_density": "rad/s/sqrt(Hz)",
    "bias_sigma": "rad/s",
    "random_walk": "rad/s^2/sqrt(Hz)",
    "misalignment_sigma": "rad",
    "q0_sigma": "rad",
}
"""Units of settings whose values are written with a unit."""
