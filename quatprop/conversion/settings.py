"""The keywords of a conversion."""

from collections.abc import Collection
from fractions import Fraction
from os import PathLike
from typing import Annotated

from quatprop.settings.choices import CONVENTIONS, DIRECTIONS, SIGNS, Convention, Direction, Sign
from quatprop.settings.keyword import Keyword, keywords_of
from quatprop.settings.parsers import Choice, frequency, path
from quatprop.settings.reading import AttitudeOptions
from quatprop.settings.rotations import Rotated, mounting

ROTATION = "W,X,Y,Z|x,-y,-z|rpy:R,P,Y|ned-to-enu|frd-to-flu"


class ConvertOptions(AttitudeOptions, total=False):
    """Keywords of :func:`quatprop.convert` besides those of :class:`AttitudeOptions`."""

    # fmt: off
    convention: Annotated[Convention | None, Keyword(
        Choice(*CONVENTIONS), "Convention of OUT.", "hamilton", group="Output", common=True)]
    direction: Annotated[Direction | None, Keyword(
        Choice(*DIRECTIONS), "Which coordinates OUT transforms into which.", "body-to-ref",
        group="Output", common=True)]
    sign: Annotated[Sign | None, Keyword(
        Choice(*SIGNS), "Sign of q, as q and -q are the same attitude: keep leaves it; continuous "
        "takes the one nearer to the previous row; positive takes w >= 0 (for half turns, w = 0, "
        "the first component that is not zero is positive).", "keep", group="Output", common=True)]
    left: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting,
        "From the reference axes of {log} to the reference axes of OUT: a quaternion with "
        "v_new = r v_old r*, the old axes that become x, y and z, fixed-axis angles (deg), or a "
        "name. Positions are rotated as well.", "the same", ROTATION, group="Output")]
    right: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting,
        "From the body axes of {log} to the body axes of OUT, in the same way: q_out = LEFT q_in "
        "RIGHT*. Covariances are rotated as well.", "the same", ROTATION, group="Output")]
    relative_to: Annotated[str | PathLike[str] | None, Keyword(
        path, "Write the attitude of the body of {log} in the axes of another, q_FILE* q, such as "
        "the angle of a joint: FILE (FILE:TOPIC) holds the attitudes of the other body against the "
        "same reference, and is interpolated in time.", "the reference", "FILE", "Output",
        common=True)]
    rate: Annotated[float | Fraction | str | None, Keyword(
        frequency, "Output rate: the attitudes of {log} are interpolated by polynomials "
        "through six of them, not across gaps; holds them in memory.", "as they are", "HZ",
        "Output", common=True)]
    # fmt: on


CONVERT = keywords_of(ConvertOptions)
"""All keywords of a conversion, with those of reading: name -> row."""

TERMS = {name: row for name, row in CONVERT.items() if name not in keywords_of(AttitudeOptions)}
"""The keywords of the conversion only."""
