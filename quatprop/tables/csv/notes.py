"""What the lines before the header of a text table declare."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

from quatprop.errors import UnsupportedLogError
from quatprop.tables.base import TableNotes

if TYPE_CHECKING:
    from pathlib import Path

_SAMPLE_RATE = re.compile(r"(?i)(?:sample|sampling|update) (?:rate|frequency)\W*([\d.]+) *(k?)Hz")
_POWERS = {0: "s", -3: "ms", -6: "us", -9: "ns"}


def declared_notes(before: list[str], names: list[str], path: Path) -> TableNotes:
    """Return what comments and ``key,value`` lines declare."""
    title = before[0].strip("\ufeff \r\n") if before else ""
    rate = next(filter(None, map(_SAMPLE_RATE.search, before)), None)
    sample_rate = float(rate[1]) * (1000 if rate[2] else 1) if rate else None
    if title.upper() != "GYROFLOW IMU LOG":
        return TableNotes(sample_rate=sample_rate, title=title)
    keys = dict(text.strip().split(",", 1) for text in before if "," in text)
    try:
        tick = Decimal(keys.get("tscale", "1").strip())
        scale = float(keys.get("gscale", "1"))
    except (InvalidOperation, ValueError) as error:
        raise UnsupportedLogError(path, "its tscale or gscale is not a number") from error
    if tick.adjusted() not in _POWERS or tick != Decimal(1).scaleb(tick.adjusted()):
        raise UnsupportedLogError(
            path, f"its tscale {tick} is not 1, 0.001, 0.000001 or 0.000000001 s; convert its times"
        )
    units = {names.index("t"): _POWERS[tick.adjusted()]} if "t" in names else {}
    mount = _gcsv_mount(keys.get("orientation", "XYZ").strip())
    return TableNotes(units=units, rate_scale=scale, title=title, mount=mount)


def _gcsv_mount(letters: str) -> str:
    """Return an orientation of gcsv as signed axes: a small letter is an axis turned around."""
    if letters == "XYZ" or not re.fullmatch(r"(?i)(?!.*(.).*\1)[xyz]{3}", letters):
        return ""
    return ",".join(("" if letter.isupper() else "-") + letter.lower() for letter in letters)
