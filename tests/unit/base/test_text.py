"""Names, values, times and counts as sentences show them."""

from pathlib import Path

import pytest

from quatprop.base.errors import Loss
from quatprop.base.rendering import file_names, instant_text, loss_lines, rate_text, samples_text
from quatprop.base.text import did_you_mean, listed, shown


def test_long_lists_are_cut():
    """A dozen names, and 20 losses, of which the JSON report has all."""
    assert listed("abcdefghijkl").endswith(", 'k', 'l'")
    assert listed("abcdefghijklm").endswith(", 'k', 'l' and 1 more")
    losses = [Loss(f"byte {k}", "gone") for k in range(21)]
    assert len(loss_lines(losses[:20])) == 20
    assert loss_lines(losses)[19:] == [
        "lost: byte 19: gone",
        "lost: 1 more, which the JSON report lists",
    ]


@pytest.mark.parametrize(
    ("loss", "text"),
    [
        (Loss("chunk at byte 9", "torn", 1722), "lost: chunk at byte 9: torn (1,722 lost)"),
        (Loss("line 7", "it has 2 columns", 1), "lost: line 7: it has 2 columns"),
        (Loss("a", "1,722 rows are torn", 1722), "lost: a: 1,722 rows are torn"),
        (Loss("a", "1722 rows are torn", 1722), "lost: a: 1722 rows are torn"),
        (Loss("a", "torn at 17225", 1722), "lost: a: torn at 17225 (1,722 lost)"),
    ],
)
def test_a_loss_is_counted(loss, text):
    """Unless the reason has the number, or the place is that of one row."""
    assert loss_lines([loss]) == [text]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (["a", 2], "'a,2'"),
        (tuple(range(12)), "'0,1,2,3,4,5,6,7,8,9,10,11'"),
        (tuple(range(13)), "'(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12)'"),
        ("x" * 99, "'" + "x" * 99 + "'"),
        (Path("x" * 59), "'" + "x" * 59 + "'"),
        (Path("x" * 60), f"a value of type {type(Path()).__name__}"),
        (Path("a\nb"), f"a value of type {type(Path()).__name__}"),
        (object(), "a value of type object"),
    ],
)
def test_a_value_is_shown_if_it_is_short(value, text):
    """Of tables and objects the type is; text is shown as it was given."""
    assert shown(value) == text


@pytest.mark.parametrize(
    ("name", "names", "meant"),
    [
        ("METHOD", ["rate", "method"], "method"),
        ("bias", ["--mount", "--bias"], "--bias"),
        ("imu", ["/a/imu", "imu_raw", "omu"], "imu_raw"),
        ("ab", ["xxxxxxabxx", "xxxxabxx"], "xxxxabxx"),
        ("abcdefg", ["abcdexy"], "abcdexy"),
        ("abc", ["abx"], None),
        ("a", ["xax"], None),
    ],
)
def test_a_name_is_suggested_if_it_is_similar(name, names, meant):
    """One that begins with it, then one that is spelled nearly so, then the shortest with it."""
    expected = "; else" if meant is None else f"; did you mean '{meant}'?"
    assert did_you_mean(name, names, "else") == expected


@pytest.mark.parametrize(
    ("t_ns", "text"),
    [
        (0, "0 s of its clock"),
        (-1_500_000_000, "-1.5 s of its clock"),
        (315_964_799_999_999_999, "315964799.999999999 s of its clock"),
        (315_964_800_000_000_000, "1980-01-06 00:00:00 UTC"),
        (1_700_000_000_250_000_000, "2023-11-14 22:13:20.25 UTC"),
    ],
)
def test_an_instant_is_utc_since_gps_began(t_ns, text):
    """Earlier ones are of a clock that starts with the device."""
    assert instant_text(t_ns) == text


def test_the_usual_rate_is_shown_where_pauses_hide_it():
    """From a quarter more than the average on."""
    assert rate_text(11, 10**9, 80_000_000) == rate_text(11, 10**9) == "10 Hz"
    assert rate_text(11, 10**9, 79_000_000) == "10 Hz on average, mostly 12.6582 Hz"
    assert samples_text(1, 0) == "1 sample"
    assert samples_text(3, 2_000_000_000) == "3 samples over 2 s, 1 Hz"


def test_files_have_short_names_that_differ():
    """Their folder is shown, or their topic, only if they are equal otherwise."""
    files = [("a/x.csv", "/i"), ("b/x.csv", "/i"), ("y.bag", "/i"), ("y.bag", "/j"), ("-", "")]
    assert file_names(files) == ["a/x.csv", "b/x.csv", "y.bag /i", "y.bag /j", "stdin"]
