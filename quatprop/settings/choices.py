"""Names that settings accept, for the type checkers of users and for parsers."""

from typing import Literal, TypeAlias, get_args

Layout: TypeAlias = Literal["scalar-first", "scalar-last", "wxyz", "xyzw"]
LAYOUTS: tuple[str, ...] = get_args(Layout)
RateUnit: TypeAlias = Literal["rad/s", "deg/s"]
RATE_UNITS: tuple[str, ...] = get_args(RateUnit)
TimeUnit: TypeAlias = Literal["s", "ms", "us", "ns"]
TIME_UNITS: tuple[str, ...] = get_args(TimeUnit)
ClockName: TypeAlias = Literal["header", "log", "publish"]
CLOCKS: tuple[str, ...] = get_args(ClockName)
Method: TypeAlias = Literal["start", "end", "mean", "coning", "cubic", "quintic"]
METHODS: tuple[str, ...] = get_args(Method)
LOOK_AHEAD = {"cubic", "quintic"}
"""Methods that use samples after an interval."""
CORRECT_CONING = {"coning", *LOOK_AHEAD}
"""Methods that correct averages and increments for coning."""
Frame: TypeAlias = Literal["body", "inertial"]
FRAMES: tuple[str, ...] = get_args(Frame)
"""Frames of rates: steps of body rates multiply on the right, of inertial rates on the left."""
EulerSequence: TypeAlias = Literal[
    "zyx", "xyz", "xzy", "yxz", "yzx", "zxy", "zxz", "zyz", "xyx", "xzx", "yxy", "yzy"
]
EULER_SEQUENCES: tuple[str, ...] = get_args(EulerSequence)
"""Axes of intrinsic rotations in their order: Tait-Bryan angles, then proper Euler angles."""
Convention: TypeAlias = Literal["hamilton", "jpl"]
CONVENTIONS: tuple[str, ...] = get_args(Convention)
Direction: TypeAlias = Literal["body-to-ref", "ref-to-body"]
DIRECTIONS: tuple[str, ...] = get_args(Direction)
Sign: TypeAlias = Literal["keep", "continuous", "positive"]
SIGNS: tuple[str, ...] = get_args(Sign)
