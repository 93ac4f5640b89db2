"""Words in the names of columns that are rates of the body; any other word has to be explained.

Names of a program are in the rows of the vocabulary. Of other names, every word has to be known:
one that is not may name another frame, another part of a machine, a command or a statistic.
"""

from __future__ import annotations

import re
from itertools import takewhile
from typing import TYPE_CHECKING

from quatprop.base.text import quoted

if TYPE_CHECKING:
    from collections.abc import Sequence

_QUANTITY = """
    gyro gyros gyroscope gyroscopes gyr gyroskop giroscopio girosc\u00f3pio giroskop giroscope
    gyroscoop jiroskop \u017cyroskop \u0433\u0438\u0440\u043e\u0441\u043a\u043e\u043f
    \u30b8\u30e3\u30a4\u30ed\u30b9\u30b3\u30fc\u30d7 \u30b8\u30e3\u30a4\u30ed
    \u9640\u87ba\u4eea \u9640\u87ba\u5100 \uc790\uc774\ub85c\uc2a4\ucf54\ud504
    omega \u03c9 w g ang angular velocity velocities vel rate rates speed rotation rotational rot
    turn turning spin drehrate winkelgeschwindigkeit
"""
_MEASUREMENT = """
    raw calibrated calib cal uncalibrated uncal corrected compensated comp unbiased debiased
    filtered filt unfiltered lowpass lpf lp smoothed smooth scaled processed proc
    measured measurement measurements meas reading readings data value values val output out
    sample samples signal adc est estimated estimate hz dps rad deg si unit units s per sec
    motion core mems vector vec vec3 vector3 component axis axes field
"""
_SENSOR = """
    imu imus sensor sensors sens device dev ahrs ins marg inertialsensor module node tag board card
    chip instance id nr no num number index msg message messages log topic state
    main primary secondary aux auxiliary master slave internal external int ext onboard backup
    fcu fc fmu mavros mavlink autopilot pixhawk px4 ardupilot flight
    xsens mti mtw mvn movella awinda noraxon opal apdm delsys shimmer bosch bno bmi bmx
    invensense icm mpu lsm lsmds lis adis analog vectornav vn novatel microstrain sbg ellipse kvh
    fog honeywell hg phidgets phidget razor myahrs stim sensonor livox ouster velodyne zed realsense
    oak kinect azure basler gopro insta360 android iphone ios arduino nano esp m5stack teensy
    polar empatica muse garmin fitbit apple wear
"""
_BODY = """
    body frd flu fsd rfu bf base link chassis vehicle car truck bike bicycle boat ship aircraft
    plane airplane rocket satellite spacecraft uav drone quad quadrotor quadcopter copter robot
    rover platform user phone smartphone mobile watch smartwatch tablet headset hmd glasses camera
    cam tracker rigidbody
    left right front rear back top bottom center centre side lh rh lhs rhs lf rf lr rr fl fr rl
    head neck chest trunk torso waist pelvis hip thigh shank calf leg foot feet ankle knee heel
    toe shoe insole arm forearm upperarm elbow wrist hand finger thumb shoulder sternum lumbar
    sacrum tibia femur spine belt pocket ear helmet person subject
"""
_FRAME = """
    world ned enu nwu nav navigation inertial eci ecef earth map odom global lvlh spatial geo
    geographic horizontal orbital icrf gcrf teme n
"""
_ROLE = """
    cmd cmds command commanded sp setpoint setpoints ref reference des desired target goal demand
    demanded req requested err errs error errors innov innovs innovation innovations resid residual
    residuals pred predicted prediction planned trajectory teleop joy joystick
"""
_OTHER = """
    unc uncertainty sigma sd rms mean avg average median min minimum max maximum abs absolute norm
    limit lim thresh threshold bg joint joints wheel wheels motor motors rotor rotors gimbal
"""
_INCREMENT = (
    r"(?:^|[._])(?:d|delta)_?(?:theta|angles?|ang|phi|psi|gyro|rot[a-z]*|v)(?![a-z])"
    r"|(?:^|[._])(?:delta|incr?|increments?)(?![a-z])"
)
"""A key of angles that were integrated over an interval."""
_NORTH_EAST = {"den": "ned", "enu": "enu"}
"""Sorted letters of components, and the frame that they tell."""
_EULER = r"(?:^|[._])(?:euler[a-z]*|(?:phi|theta|psi)|(?:roll|pitch|yaw)_?dot)(?![a-z])"
"""A key of the rate of an Euler angle."""
_WORDS = frozenset(f"{_QUANTITY} {_MEASUREMENT} {_SENSOR} {_BODY}".split())
_RATES = frozenset(_QUANTITY.split()) - {"w", "g"}
_FRAMES = frozenset(_FRAME.split())
_ROLES = frozenset(_ROLE.split())
_OTHERS = frozenset(_OTHER.split()) | _ROLES
"""Words for commands, deviations, statistics, and the rates of other things."""
_SHORTEST = 3
"""Length of the shortest words in compounds such as bodyrate."""
_MODEL = r"[a-z]{1,5}\d{3,}[a-z]*\d*"
"""The number of a model, such as icm20948."""


def is_of_another(keys: Sequence[str]) -> bool:
    """Return whether a rate is commanded, a deviation, a statistic, or not the body's, by name.

    `keys`: keys of its three columns
    """
    return bool(_other_word(keys)) and not _is_ours(keys)


def other_meaning_of(keys: Sequence[str]) -> str:
    """Return what names say that is no measured rate about axes of the body; empty if nothing.

    `keys`: keys of its three columns
    """
    if all(re.search(_INCREMENT, key) for key in keys):
        return "increments of angles, to be divided by their intervals"
    if all(re.search(_EULER, key) for key in keys):
        return "rates of Euler angles, which are not about axes of the body"
    word = "" if _is_ours(keys) else _other_word(keys)
    return f"not measured by a gyroscope of the body ({quoted(word)})" if word else ""


def _other_word(keys: Sequence[str]) -> str:
    """Return the word for a command, a deviation, a statistic or another thing; empty if none."""
    words = _words("_".join(_shared(keys)))
    return next((word for word in words if _stem(word) in _OTHERS), "")


def frame_in(keys: Sequence[str]) -> str:
    """Return the word for another frame than the body's in names of a rate; empty if none.

    `keys`: keys of its three columns
    """
    if _is_ours(keys):
        return "ref"
    words = _words("_".join(_shared(keys)))
    if parts := _NORTH_EAST.get("".join(sorted(key[-1:] for key in _parts(keys)))):
        return parts
    if _ends_in_world(keys):
        return "w"
    # n2 is a number.
    return next((word for word in words if word in _FRAMES or _stem(word) in _FRAMES - {"n"}), "")


def _ends_in_world(keys: Sequence[str]) -> bool:
    """Return whether a word for a rate is followed by a w of its own, as in ang_vel_w.x."""
    begin, end = _shared(keys)
    *words, last = ["", *_words(begin.rstrip(".[").rpartition(".")[2])]
    is_apart = begin[-1:] in {"_", ".", "["}
    if is_apart and last == "w" and not _RATES.isdisjoint(words):
        return True
    return "w" in _words(end) and not _RATES.isdisjoint((*words, last))


def role_in(keys: Sequence[str]) -> str:
    """Return the word in names for what is commanded, a deviation or a reference; else empty.

    `keys`: keys of the columns of a rate or an attitude
    """
    words = _words("_".join(_shared(keys)))
    return next((word for word in words if _stem(word) in _ROLES), "")


def _is_ours(keys: Sequence[str]) -> bool:
    """Return whether rates are in the reference frame as ``convert`` writes them."""
    return _shared(keys) == ("w", "_ref")


def unknown_word_in(keys: Sequence[str]) -> str:
    """Return the first word in names of a rate that is not known; empty if none.

    Levels with a number above the name itself are identifiers, as of a sensor or a trial.
    """
    begin, end = _shared(keys)
    *above, own = begin.rstrip(".[").split(".")
    levels = [level for level in above if not re.search(r"\d", level)]
    words = _words(" ".join((*levels, own, end)))
    return next((word for word in words if not _is_known(word)), "")


def _shared(keys: Sequence[str]) -> tuple[str, str]:
    """Return what precedes and what follows the component in all names."""
    begin = _beginning(keys)
    return begin, _beginning([key[len(begin) :][::-1] for key in keys])[::-1]


def _parts(keys: Sequence[str]) -> list[str]:
    """Return what differs in names, which is the component."""
    begin, end = map(len, _shared(keys))
    return [key[begin : len(key) - end] for key in keys]


def _beginning(texts: Sequence[str]) -> str:
    same = takewhile(lambda letters: len({*letters}) == 1, zip(*texts, strict=False))
    return "".join(letters[0] for letters in same)


def _words(text: str) -> list[str]:
    return re.findall(r"[^\W_]+", text)


def _stem(word: str) -> str:
    return re.sub(r"\d+", "", word)


def _is_known(word: str) -> bool:
    stem = _stem(word)
    return (
        not (stem and _WORDS.isdisjoint((word, stem)))
        or _is_compound(stem)
        or bool(re.fullmatch(_MODEL, word))
    )


def _is_compound(stem: str) -> bool:
    ends = range(_SHORTEST, len(stem) + 1)
    return any(
        stem[:end] in _WORDS and (not stem[end:] or _is_compound(stem[end:])) for end in ends
    )
