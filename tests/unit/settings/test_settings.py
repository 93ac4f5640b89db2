"""Settings by name: the same values from text, from TOML and from Python."""

import datetime as dt
import json
import math
import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Annotated, TypedDict

import click
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, in_python
from quatprop.base.times import NS_PER_S, Instant, Nanoseconds
from quatprop.cli.commands import cli
from quatprop.cli.options import options_of, with_options
from quatprop.cli.propagate import command
from quatprop.propagation.gyro_errors import ErrorSettings
from quatprop.propagation.settings import PropagationSettings, propagation_settings
from quatprop.settings import PROPAGATE, in_keys, in_options, parse_all
from quatprop.settings.bias import GivenBias, StaticBias
from quatprop.settings.command_options import CALIBRATE, COMPARE, CONVERT
from quatprop.settings.parsers import Choice, Keyword, keywords_of, parameters, resolve_path
from quatprop.settings.quantities import (
    NOISE_DENSITIES,
    RAD_PER_UNIT,
    RATE_WALKS,
    RATES,
    SCALED_RATE_UNITS,
    picture_size,
)
from quatprop.settings.reading import (
    CHECKS,
    NOISE,
    ONE_SERIES,
    READ_RATES,
    AttitudeSelection,
    GyroCorrection,
    RateSelection,
)
from quatprop.timeline.counts import Policy
from quatprop.tools.check.cases import PARSERS
from quatprop.tools.simulation_options import SIMULATE


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("rate_cols", ["a, b,c", ("a", "b", "c"), np.array(["a", "b", "c"])], ("a", "b", "c")),
        ("q0", ["1,0,0,0", (1, 0, 0, 0), np.array([1.0, 0, 0, 0])], (1.0, 0.0, 0.0, 0.0)),
        ("q0", [__file__, Path(__file__)], __file__),
        ("q0", ["level"], "level"),
        ("bias", ["0.1,-2,3e-3", [0.1, -2, 0.003]], GivenBias((0.1, -2.0, 0.003))),
        (
            "bias",
            [
                *("0.1,-2,3e-3deg/s", "0.1, -2, 3e-3 deg/s", "0.1deg/s,-2deg/s,.003 deg/s"),
                *(["0.1", -2, "0.003dps"], "+0.1,-2.,3.0E-3 DPS"),
            ],
            GivenBias((0.1, -2.0, 0.003), "deg/s"),
        ),
        ("bias", ["static", "static:1s", StaticBias()], StaticBias(1_000_000_000)),
        ("bias", ["static:250ms"], StaticBias(250_000_000)),
        ("bias", ["static:nearest"], StaticBias(between="nearest")),
        ("bias", ["static:interpolate:2s"], StaticBias(2_000_000_000, between="interpolate")),
        (
            "bias",
            ["static@+10s..-20s", "static @ +10s .. -20s "],
            StaticBias(start=Instant(10**10, "first"), end=Instant(-2 * 10**10, "last")),
        ),
        ("mount", ["x,-y,-z", ("x", "-y", "-z")], "x,-y,-z"),
        ("end", ["0", 0], Instant(0, "clock")),
        ("end", ["1000000", 1_000_000], Instant(1_000_000, "clock")),
        ("start", ["+10s", Instant(10_000_000_000, "first")], Instant(10_000_000_000, "first")),
        (
            "end",
            ["1970-01-01T00:00:01Z", dt.datetime(1970, 1, 1, 0, 0, 1, tzinfo=dt.UTC)],
            Instant(1_000_000_000, "clock"),
        ),
        (
            "max_gap",
            [
                "20ms",
                "0.02",
                ".02",
                0.02,
                np.float64(0.02),
                2e-2,
                "2e-2",
                "20000000ns",
                Decimal("0.02"),
                dt.timedelta(milliseconds=20),
                np.timedelta64(20, "ms"),
                Nanoseconds(20_000_000),
            ],
            Nanoseconds(20_000_000),
        ),
        (
            "max_gap",
            ["1s", "1", 1, 1.0, np.int64(1), np.float32(1), "1.", "1000ms"],
            Nanoseconds(NS_PER_S),
        ),
        ("rate", ["29.97", "29.97Hz", "29.97 Hz", 29.97, Fraction(2997, 100)], Fraction(2997, 100)),
        ("rate", ["30000/1001", Fraction(30000, 1001)], Fraction(30000, 1001)),
        ("rate", ["50", 50, np.int64(50), 50.0], Fraction(50)),
        ("every", ["3", 3], 3),
        ("heading", ["-90", -90, -90.0], -90.0),
        ("rate_unit", ["deg/s", "dps", "Deg/s", "DPS"], "deg/s"),
        ("rate", ["1e9", 10**9], Fraction(10**9)),
        ("rate", ["1e-9", Fraction(1, 10**9)], Fraction(1, 10**9)),
        ("bias_sigma", ["3600deg/h", "1 deg/s", "1000mdeg/s", math.radians(1)], math.radians(1)),
        ("scale_sigma", ["1000ppm", "0.1 %", ".1%", 1e-3], 1e-3),
        ("scale_sigma", ["0%", 0.0], 0.0),
        ("q0_sigma", ["0.5deg", math.radians(0.5)], (math.radians(0.5),)),
        ("q0_sigma", ["1mrad, 2mrad,0.1rad", np.array([1e-3, 2e-3, 0.1])], (1e-3, 2e-3, 0.1)),
    ],
)
def test_a_setting_reads_the_same_from_text_and_from_python(name, values, expected):
    """One parser takes what the command line, a suite and Python have."""
    for value in values:
        parsed = PROPAGATE[name](value)
        assert parsed == expected
        assert type(parsed) is type(expected)
    if isinstance(expected, GivenBias | StaticBias | Instant):
        assert PROPAGATE[name](str(expected)) == expected


DURATIONS = {
    f"{rows['of']} {name}": row
    for rows in (
        {"of": "propagate", **PROPAGATE}, {"of": "compare", **COMPARE}, {"of": "noise", **NOISE},
        {"of": "calibrate", **CALIBRATE}, {"of": "simulate", **SIMULATE},
    )
    for name, row in rows.items()
    if isinstance(row, Keyword) and row.takes.startswith("DUR")
}  # fmt: skip
"""Every setting that is a length of time."""


@pytest.mark.parametrize("name", DURATIONS)
@given(ns=st.integers(1, 999_999 * NS_PER_S))
def test_a_length_of_time_without_a_unit_is_in_seconds(name, ns):
    """Whole numbers were ns in Python, fractions and bare text were refused."""
    row, seconds = DURATIONS[name], Decimal(ns) / NS_PER_S
    assert row(f"{ns}ns") == row(seconds) == row(f"{seconds:f}") == row(f"{seconds:f}s") == ns
    assert row(row(seconds)) == ns
    whole = max(ns // NS_PER_S, 1)
    for value in (whole, float(whole), np.int64(whole), np.float64(whole), str(whole)):
        assert row(value) == row(f"{whole}s") == whole * NS_PER_S
    assert PROPAGATE["bias"](f"static:{whole}") == PROPAGATE["bias"](f"static:{whole}s")


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("topic", 3, "topic: '3' is not a name"),
        ("topic", {"a": 20 * "long"}, "topic: a value of type dict is not a name"),
        ("rate_cols", "a,b", "rate_cols: 'a,b' does not name 3 columns X,Y,Z"),
        (
            "rate_cols",
            "a,b,a",
            ("rate_cols: 'a,b,a' names a column twice; if several have that name, give their "
             "numbers, from 0"),
        ),
        ("rate_cols", "0,0,1", "rate_cols: '0,0,1' names a column twice"),
        ("method", "magic", "method: 'magic' is not one of 'start', 'end', 'mean', 'coning'"),
        ("q0", (1, 0, 0), "q0: '1,0,0' is not W,X,Y,Z, 4 finite numbers"),
        ("q0", "nowhere.csv", "q0: 'nowhere.csv' is not four numbers W,X,Y,Z, level, log or"),
        ("q0", object, "q0: "),
        ("bias", "1,2,z", "bias: '1,2,z' is not X,Y,Z, 3 finite numbers, nor static[:DUR]"),
        ("bias", "1,2,3mph", "bias: '1,2,3mph' is not in one of 'rad/s', 'mrad/s', 'deg/s'"),
        ("bias", "1,2,3deg", "bias: '1,2,3deg' is not in one of 'rad/s', 'mrad/s', 'deg/s'"),
        ("bias", "1deg/s,2,3", "bias: '1deg/s,2,3' has several units; write 0.1,0.2,0.3deg/s"),
        ("bias", "1deg/s,2rad/s,3deg/s", "bias: '1deg/s,2rad/s,3deg/s' has several units;"),
        ("bias", "1,2,infdeg/s", "bias: '1,2,infdeg/s' is not X,Y,Z, 3 finite numbers, nor"),
        ("bias", "1,2deg/s", "bias: '1,2deg/s' is not X,Y,Z, 3 finite numbers, nor"),
        ("bias", "static:soon", "bias: 'soon' is not a duration"),
        ("bias", "static:best:1s", "bias: 'best' is not one of 'nearest', 'interpolate'"),
        ("start", 1.5, "start: '1.5' is not a time; write text, whole ns, or a datetime"),
        ("start", True, "start: 'True' is not a time"),
        ("max_gap", True, "max_gap: 'True' is not a duration; write a number with a unit"),
        ("max_gap", math.nan, "max_gap: 'nan' is not a duration; write a number with a unit"),
        ("max_gap", (1,), "max_gap: '1' is not a duration; write seconds, or text such as '20ms'"),
        ("max_gap", np.timedelta64(1), "max_gap: '1 generic time units' is not a duration; write"),
        ("max_gap", -1, "max_gap: '-1' is not a duration above 0"),
        ("max_gap", 1e-10, "max_gap: '1e-10' is in seconds, and finer than a nanosecond; round it"),
        ("max_gap", 20_000_000, "max_gap: '20000000' without a unit is in seconds; write 20000000"),
        ("max_gap", 1e16, "max_gap: '1e+16' without a unit is in seconds; write 10000"),
        ("max_gap", "1e999999", "max_gap: '1e999999' is not a duration; write a number with"),
        ("rate", 0, "rate: '0' is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"),
        ("rate", "1/0", "rate: '1/0' is not a rate from 1e-9 to 1e9 Hz"),
        ("rate", "1000000001", "rate: '1000000001' is not a rate from 1e-9 to 1e9 Hz"),
        ("rate", "9e-10", "rate: '9e-10' is not a rate from 1e-9 to 1e9 Hz"),
        ("rate", "nan", "rate: 'nan' is not a rate from 1e-9 to 1e9 Hz"),
        ("every", 0, "every: '0' is not a whole number above 0"),
        ("every", "ten", "every: 'ten' is not a whole number above 0"),
        ("every", 1.5, "every: '1.5' is not a whole number above 0"),
        ("every", True, "every: 'True' is not a whole number above 0"),
        ("heading", True, "heading: 'True' is not a finite number"),
        ("heading", "north", "heading: 'north' is not a finite number"),
        ("heading", float("inf"), "heading: 'inf' is not a finite number"),
        ("at", 7, "at: '7' is not a path"),
        *(
            (name, value, f"{name}: '{value}' {said}; write a number with its unit, such as {such}")
            for name, value, said, such in (
                ("noise_density", "0.2", "is not a noise density", "0.2deg/sqrt(h)"),
                ("noise_density", "0.2deg/h", "is not a noise density", "0.2deg/sqrt(h)"),
                ("bias_sigma", "20deg", "is not a rate", "20deg/h"),
                ("bias_sigma", "-1deg/h", "is not a rate", "20deg/h"),
                ("random_walk", "1rad/s", "is not a rate random walk", "1e-5rad/s^2/sqrt(Hz)"),
                ("scale_sigma", "5", "is not a ratio", "1000ppm or 0.1%"),
                ("misalignment_sigma", "5", "is not an angle", "5mrad"),
                ("q0_sigma", "5", "is not an angle", "0.5deg or 5mrad"),
            )
        ),
        ("scale_sigma", -1, "scale_sigma: '-1' is below 0"),
        # Their squares were infinite, and an internal error.
        *(
            (name, value, f"{name}: '{value}' is larger than {noun} can be")
            for name, value, noun in (
                ("noise_density", "1e308rad/s/sqrt(Hz)", "a noise density"),
                ("noise_density", "9" * 400 + "deg/sqrt(h)", "a noise density"),
                ("bias_sigma", 2e30, "a rate"),
                ("random_walk", "1e40 deg/h/sqrt(h)", "a rate random walk"),
                ("misalignment_sigma", "1e33deg", "an angle"),
            )
        ),
        ("q0_sigma", "1deg,5deg", "q0_sigma: '1deg,5deg' is neither one angle nor ROLL,PITCH,YAW"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_used_is_one_sentence(name, value, sentence):
    """The sentence names the setting and the value, and says what could be used."""
    with pytest.raises(UsageError) as caught:
        parse_all({name: value})
    assert str(caught.value).startswith(sentence)


DEG = math.pi / 180
SI = {
    "rad": 1.0, "mrad": 1e-3, "deg": DEG, "mdeg": DEG / 1000, "arcmin": DEG / 60,
    "arcsec": DEG / 3600, "rpm": 6 * DEG, "s": 1.0, "h": 3600.0, "Hz": 1.0, "sqrt": math.sqrt,
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "units"),
    [
        ("noise_density", NOISE_DENSITIES),
        ("bias_sigma", RATES),
        ("random_walk", RATE_WALKS),
        ("misalignment_sigma", RAD_PER_UNIT),
    ],
)
def test_every_unit_is_worth_what_it_is_called(name, units):
    """Those of data sheets become rad/s/sqrt(Hz), rad/s, rad/s^2/sqrt(Hz) and rad."""
    for unit in units:
        expected = 3 * eval(unit.replace("^", "**"), SI.copy())  # noqa: S307  # our own text
        assert PROPAGATE[name](f"3 {unit}") == pytest.approx(expected, rel=1e-15), unit
    for unit, (other, factor) in SCALED_RATE_UNITS.items():
        known = unit.replace("dps", "deg/s").replace("\u00b0", "deg").replace("hr", "h")
        expected = eval(known, SI.copy())  # noqa: S307
        assert factor * RATES[other] == pytest.approx(expected, rel=1e-15), unit


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("25.4mm", (1, None)),
        ("2.54x254cm", (1, 100)),
        ("100x1in", (100, 1)),
        *((text, None) for text in ("25.3mm", "100.1in", "5x100.1in", "5x0.9in", "5")),
    ],
)
def test_a_picture_is_at_least_an_inch_and_at_most_a_hundred(text, size):
    """Both its width and its height are limited."""
    if size is not None:
        assert picture_size(text) == pytest.approx(size)
        return
    with pytest.raises(UsageError, match=f"'{text}' is not a size from 1in to 100in"):
        picture_size(text)


def test_no_settings_are_the_defaults():
    """None counts as not given."""
    assert propagation_settings({}) == PropagationSettings()
    assert propagation_settings(dict.fromkeys(PROPAGATE)) == PropagationSettings()


def test_every_setting_of_propagate_is_used(monkeypatch):
    """One that is accepted and changes nothing would go unnoticed."""
    used = set()

    class Values(dict):
        def __contains__(self, name):
            used.add(name)
            return super().__contains__(name)

        def get(self, name, default=None):
            used.add(name)
            return super().get(name, default)

    monkeypatch.setattr("quatprop.propagation.settings.parse_all", lambda _options: Values())
    propagation_settings({})
    assert set(PROPAGATE) - used == set()


def test_every_interface_has_the_same_names():
    """The options of the command, the parsers and the keywords of the library are one list."""
    output = {"logs", "output", "to", "layout", "comment", "message", "out_topic", "frames",
              "extra_columns", "euler_unit",
              "report", "plot", "config", "quiet", "verbose"}  # fmt: skip
    assert {option.name for option in command.params} - output == set(PROPAGATE)


@pytest.mark.parametrize("name", ["bias", "q0"])
def test_a_series_may_be_a_folder(tmp_path, name):
    """A ROS 2 bag is one: it is an input of the run, and found next to the file that names it."""
    (tmp_path / "a,b").mkdir()
    settings = propagation_settings({name: str(tmp_path / "a,b")})
    assert settings.inputs == {name: str(tmp_path / "a,b")}
    assert resolve_path(name, "a,b", tmp_path) == tmp_path / "a,b"


def test_a_file_that_is_not_there_is_named_next_to_the_configuration(tmp_path):
    """An address is no file; what may be a topic or numbers is none unless it is there."""
    assert resolve_path("calibration", "none.yaml", tmp_path) == tmp_path / "none.yaml"
    assert resolve_path("calibration", "s3://bucket/none.yaml", tmp_path) is None
    for name, text in (("q0", "/none"), ("bias", "1,2,3"), ("at", "/none"), ("topic", "/none")):
        assert resolve_path(name, text, tmp_path) is None


@pytest.mark.parametrize(
    ("name", "text"), [("bias", "static"), ("bias", "static:2s"), ("q0", "level"), ("q0", "log")]
)
def test_words_of_settings_are_no_files(tmp_path, monkeypatch, name, text):
    """Whatever lies there; they mean what they mean without it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / text).touch()
    assert resolve_path(name, text, tmp_path) is None
    assert propagation_settings({name: text}).inputs == {}


@pytest.mark.parametrize(
    ("command", "side", "rows"),
    [
        ("propagate", "", PROPAGATE),
        ("batch", "", {name: row for name, row in PROPAGATE.items() if name != "in_sequence"}),
        ("convert", "", CONVERT),
        ("info", "", READ_RATES),
        ("plot", "", {**READ_RATES, **ONE_SERIES}),
        ("plot", "ref", ONE_SERIES),
        ("compare", "", {**COMPARE, **CHECKS}),
        ("compare", "a", {**COMPARE, **CHECKS, **ONE_SERIES}),
        ("compare", "b", {**COMPARE, **CHECKS, **ONE_SERIES}),
    ],
)
def test_options_in_sentences_exist(command, side, rows):
    """A setting in a sentence is an option of the command, and accepts the value given there."""
    options = {name: one for one in cli.get_command(None, command).params for name in one.opts}
    for name, row in rows.items():
        said = in_options(f"use {Setting(name, '|'.join(row.choices), side)}").split()
        assert said[1] in options, (command, side, name)
        if row.choices:
            assert set(options[said[1]].type.choices) == set(said[2].split("|")), name


@pytest.mark.parametrize(
    ("side", "rows"),
    [("", {**PROPAGATE, **COMPARE, **CHECKS}), ("b", {**COMPARE, **CHECKS, **ONE_SERIES})],
)
def test_keys_in_sentences_exist(side, rows):
    """A setting in a sentence is a key of a case, and accepts the values given there."""
    for name, row in rows.items():
        said = in_keys(f"use {Setting(name, '|'.join(row.choices), side)}")
        key, _, values = said.removeprefix("use ").partition(" = ")
        assert key in PARSERS, (side, name)
        if row.choices:
            for value in values.split(" or "):
                assert PARSERS[key](json.loads(value)) == json.loads(value)
        elif values:
            assert PARSERS[key](json.loads(values)) is True


@pytest.mark.parametrize("side", ["at", "q0", "info"])
def test_options_of_a_lookup_are_those_of_convert(side):
    """About attitudes that are only looked up, a command has few options of its own."""
    for name in {**ONE_SERIES, **CHECKS}:
        said = in_options(f"use {Setting(name)} or so", side)
        own = "info" if name in READ_RATES and side == "info" else "convert"
        options = [option for one in cli.get_command(None, own).params for option in one.opts]
        assert said.split()[1] in options
        assert (" of quatprop convert or so" in said) == (own == "convert")


@pytest.mark.parametrize("spell", [in_options, in_keys, in_python])
def test_whose_settings_of_a_lookup_are_is_said_once(spell):
    """After the last; what the run has itself, such as its start, is its own."""
    said = spell(f"give {Setting('quat_cols')} and {Setting('from_layout')} or so", "at")
    assert re.fullmatch(r"give \S+ and \S+ of (quatprop )?convert or so", said)
    said = spell(f"begin with {Setting('start', '5')}", "q0")
    assert said in {"begin with --start 5", 'begin with start = "5"', "begin with start='5'"}


def test_keywords_in_sentences_exist():
    """The library's are the names of the rows."""
    for name, row in PROPAGATE.items():
        values = " or ".join(map(repr, row.choices))
        expected = f"{name}={values}" if values else name
        assert in_python(f"use {Setting(name, '|'.join(row.choices), 'b')}") == f"use {expected}"


def test_a_row_is_all_that_help_and_documents_need():
    """A made-up setting gets its option, on either side, and its paragraph of numpydoc."""

    class Options(TypedDict, total=False):
        upside: Annotated[float | str | None, Keyword(
            Choice("down", "up"), f"Way of {{log}}, as {Setting('clock', 'log')} has it.",
            "up")]  # fmt: skip

    assert parameters(Options) == (
        "upside : float or str\n"
        "    Way of the log, as clock='log' has it. One of 'down', 'up'. By default: up."
    )
    command = click.Command("do", params=[])
    with_options(options_of(keywords_of(Options), log="B", side="b"))(command)
    (option,) = command.params
    assert (option.opts, option.name, option.group) == (["--upside-b"], "upside_b", "Input B")
    assert option.help == "Way of B, as --clock-b log has it.  [default: up]"


def names_of(record):
    """Return the names of the fields of a record."""
    return {*getattr(record, "_fields", ()), *getattr(record, "__dataclass_fields__", ())}


def test_no_setting_of_propagate_is_forgotten():
    """A row whose value reaches no record was accepted, documented, and without effect."""
    records = (PropagationSettings, RateSelection, Policy, GyroCorrection, ErrorSettings)
    computed = {"max_gap", "heading", "reference_z", "q0_layout"}
    assert PROPAGATE.keys() - set().union(*map(names_of, records)) == computed
    shortened = propagation_settings({"max_gap": "1s", "q0": "level", "heading": 90})
    assert shortened.policy.max_gap_ns == NS_PER_S
    assert shortened.q0.heading == math.pi / 2


def test_what_is_read_is_selected_by_the_settings_of_these_names():
    """The records have a field for each setting, and few that are those of other commands."""
    others = {"accel_cols", "rates", "in_sequence"}
    assert names_of(RateSelection) == (READ_RATES.keys() - {"kind"}) | others
    assert names_of(AttitudeSelection) == ONE_SERIES.keys() - {"kind"}
