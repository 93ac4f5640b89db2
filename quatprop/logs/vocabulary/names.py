"""Names of columns that mean a quantity in any table; those of single sources are in the rows.

Their units have to be declared. Numbered components of a quaternion do not tell which one is the
scalar, so they are only matched in rows for sources where this is known.
"""

from __future__ import annotations

from quatprop.settings.choices import EULER_SEQUENCES
from quatprop.tables.column_names import (
    EULER,
    EULER_NUMBERED,
    NOT_ATTITUDE,
    NOT_RATE,
    NOT_ROTATION,
    ROTATION_VECTOR,
)

COMPONENT = r"(?P<part>[wxyz])"
"""A component; by itself, it means a quaternion only if the user says so."""

SENSOR = (
    r"(?:.*[._])?(?:sensor|device|imu|frame|instance|node|module|source|location|placement|side"
    r"|hand|segment|body_part|serial|mac|address|port|unit)(?:_?(?:id|name|type|no|num|number|index))?"
    r"|id|kind|topic|type|name|msg|message|tag|channel|(?:.*\.)?i"
)
"""Names of columns that may identify the sensor of a row, such as ``I`` in ArduPilot logs."""
WITH_RATE_UNIT = tuple(
    rf"{NOT_RATE}(?:.*[^a-z])?[a-z]?(?P<part>[{axes}])(?:[^a-z].*)?" for axes in ("xyz", "pqr")
)
"""Names of an axis, or a body rate in flight mechanics, that are rates if their unit is one."""
BARE_RATES = ("g_?(?P<part>[xyz])", r"(?P<part>[pqr])")
"""Names that are body rates if the user declares the unit of rates."""
BESIDE_BARE_RATES = r"(?:a|acc\w*|m|mag\w*)_?[xyz]"
"""Axes of other sensors of the same device."""
QUATERNION = (
    rf"{NOT_ATTITUDE}(?:(?:.*[._])?(?:quaternion|quat|orientation|attitude|rotation|rot|ori|q)"
    rf"[._]?|q_[a-z]+_[a-z]+_|q_[a-z]+_){COMPONENT}"
)
_MATRIX = (
    NOT_ROTATION + r"(?:.*[._])?(?:r|m|mat|rot|rotation|matrix|dcm)_?"
    r"\[?(?P<part>[{0}](?:_|\]\[)?[{0}])\]?"
)

BIAS = (
    r"(?:.*[._])?(?:gyro(?:scope)?_?bias|bias_?gyro(?:scope)?|b_?g)[._]?"
    r"(?P<part>[xyz]|\[[012]\])"
)
FORCE = (
    r"(?:.*\.)?(?:a_rs_s_|acc(?:el(?:eration|erometer)?)?[ _]?|linear_acceleration\.|"
    r"accelerometer_m_s2\[?|a)(?P<part>[xyz012])\]?"
)
POSITION = r"(?:t|(?:.*\.)?(?:position|translation)\.|p_[a-z]+_[a-z]+_)(?P<part>[xyz])"
ROTATIONS = (
    ("rotvec", ROTATION_VECTOR, ("x", "y", "z")),
    ("euler-zyx", EULER, ("yaw", "pitch", "roll")),
    *(
        (f"euler-{sequence}", EULER_NUMBERED.format(sequence), ("1", "2", "3"))
        for sequence in EULER_SEQUENCES
    ),
    *(
        (
            "matrix",
            _MATRIX.format(i),
            tuple(f"{row}{column}|{row}_{column}|{row}][{column}" for row in i for column in i),
        )
        for i in ("123", "012")
    ),
)
"""Representation, pattern and spellings of the components of attitudes except quaternions."""
