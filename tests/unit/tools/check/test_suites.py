"""Suites: what may stand in them, and what is refused."""

import math

import pytest
from make.commands import run
from make.places import SAMPLE_LOGS
from make.suites import TRUTH, check, lock_of, pinned, stored, with_logs, write_suite
from make.tables import write_rates

from quatprop import read_attitudes
from quatprop.cli import compare, propagate
from quatprop.tools.check import cases

OUTPUT_ONLY = {
    "output", "to", "layout", "header-comment", "with", "euler-unit", "message", "out-topic",
    "frames", "report", "quiet", "verbose", "plot", "json", "config",
}  # fmt: skip
"""Options of propagate and compare that are about what they write: no keys of a case."""


def long_names(command):
    """Return the names of a command's options."""
    options = [option for option in command.params if option.param_type_name == "option"]
    names = {name for option in options for name in option.opts if name.startswith("--")}
    return {name.removeprefix("--") for name in names}


def test_every_option_is_a_key_of_a_case_or_about_the_output():
    """A new option of propagate or compare is a key by itself, unless it is about the output."""
    assert long_names(propagate.command) - OUTPUT_ONLY == set(cases.PROPAGATION_KEYS)
    own = {name for name in long_names(compare.command) if not name.endswith(("-a", "-b"))}
    of_b = {name for name in long_names(compare.command) if name.endswith("-b")}
    once = {"normalize", "on-invalid"}
    assert own - OUTPUT_ONLY - once - cases.PROPAGATION_KEYS.keys() == set(cases.COMPARISON_KEYS)
    reference = {f"reference-{name.removesuffix('-b')}" for name in of_b}
    assert reference | once == set(cases.REFERENCE_KEYS)
    assert OUTPUT_ONLY.isdisjoint(cases.PARSERS)


# Suites that are refused

BAD_KEYS = [
    ('methd = "end"', ", 'methd'", "no such key; did you mean 'method'?"),
    ("xyzzy = 1", ", 'xyzzy'", "no such key; a case has the options of propagate that"),
    ('output = "a.csv"', ", 'output'", "no such key; a case has the options of propagate"),
    ('method = "middle"', ", 'method'", "'middle' is not one of 'start', 'end', 'mean', "),
    ("every = 0", ", 'every'", "'0' is not a whole number above 0"),
    ("every = true", ", 'every'", "'True' is not a whole number above 0"),
    ('pin-log = "no"', ", 'pin-log'", "this is true or false"),
    ("normalize = 1", ", 'normalize'", "'1' is not true or false"),
    ("bias = [0.1, 0.2]", ", 'bias'", "'0.1,0.2' is not X,Y,Z, 3 finite numbers, nor"),
    ("bias = {x = 1}", ", 'bias'", 'if its name has a dot, quote it: [case."case9.bias"]'),
    ("bias = [{x = 1}]", ", 'bias'", "this takes text, a number or a list of them"),
    ('start = "soon"', ", 'start'", "'soon' is not a time; write RFC 3339"),
    ('tol = "0.1"', ", 'tol'", "'0.1' is not an angle; write a number with its unit"),
    ("tol = 0.1", ", 'tol'", "'0.1' is not an angle; write a number with its unit"),
    ('align = "best"', ", 'align'", "'best' is not one of 'none', 'first', 'yaw', "),
    ('q0 = "none.csv"', ", 'q0'", "none.csv' is not four numbers W,X,Y,Z, level, log or an exis"),
    ("heading = 90", "", 'heading requires q0 = "level"'),
    ('reference-topic = "/a"', ", 'reference'", "combined with 'reference-topic'"),
    ("skip = true", ", 'skip'", "write the reason as text"),
    ("xfail = true", ", 'xfail'", "write the reason as text"),
]
"""A line of a case, the place of the error, and its sentence."""

LACKING = [
    ('reference = "a.parquet"\n', "", 'there is no log; name it with log = "PATH"'),
    ('log = "-"\nreference = "a.parquet"\n', ", 'log'", "this is not a path"),
    ('log = ["a.csv", 1]\nreference = "a.parquet"\n', ", 'log'", "this is not a path"),
    ('log = []\nreference = "a.parquet"\n', ", 'log'", "this is not a path"),
    (
        'log = ["a.csv", "b.csv"]\nreference-topic = "/b"\ntol = "1deg"\n',
        ", 'reference-topic'",
        "name that of the attitudes with reference-log",
    ),
    (
        'log = "a.csv"\nreference-log = ["b.csv", "c.csv"]\ntol = "1deg"\n',
        ", 'reference-log'",
        "attitudes are read from one file; name one",
    ),
    ('log = "a.csv"\n', "", "there is no reference; name the file that an"),
    ('log = "a.csv"\nreference-topic = "/b"\n', ", 'tol'", "there is no toler"),
    ('log = "a.csv"\nreference = "a.csv"\n', ", 'reference'", "a stored reference is "),
    (
        'log = "a.csv"\nreference = "refs/../refs/spin.parquet"\n',
        ", 'reference'",
        "case 'spin' has it already",
    ),
]


def test_unusable_settings_are_named(folder):
    """One sentence names the suite, the case and the key; the other cases still run."""
    lines = [stored(f"case{k}", "spin.csv", line) for k, (line, *_) in enumerate(BAD_KEYS)]
    lines += [f"[case.less{k}]\n{text}" for k, (text, *_) in enumerate(LACKING)]
    pinned(folder, TRUTH + stored())
    suite = write_suite(folder, TRUTH + stored() + "".join(lines))
    result = check(suite)
    assert result.exit_code == 2
    *errors, last = result.stdout.splitlines()
    assert last == f"{len(lines) + 2} cases: 2 passed, {len(lines)} errors"
    for k, (line, where, words) in enumerate([*BAD_KEYS, *LACKING]):
        name = f"case{k}" if k < len(BAD_KEYS) else f"less{k - len(BAD_KEYS)}"
        (sentence,) = (error for error in errors if error.split()[:2] == ["ERROR", name])
        assert f"{suite}, case '{name}'{where}: " in sentence, line
        assert words in sentence, line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[case.a\n", ": it is not TOML: Expected ']'"),
        ("", ": it has no cases; a suite has a table [defaults] and one table [case.NAME]"),
        ("[cases.a]\n", ": unknown 'cases'; a suite has"),
        ("case = 1\n", ": 'case' is not a table; a suite has"),
        ('[case]\nlog = "a"\n', ": 'case.log' is not a table; a suite has"),
        ("[defaults]\nmethd = 1\n[case.a]\n", ", 'defaults.methd': no such key; did you mean "),
        ("[case.\udcff]", ": it is not UTF-8 text: byte 6"),
        (None, ": no such file or folder; check the path"),
        # It was a sentence about TOML.
        ("<<<<<<< HEAD\n[case.a]\n", ": line 1 is a conflict marker of a merge; keep one"),
        # One line made every case green, also with --strict.
        *(
            (f'[defaults]\n{key} = "later"\n[case.a]\n', f", 'defaults.{key}': the reason belongs")
            for key in ("skip", "xfail")
        ),
    ],
)
def test_a_broken_suite_is_refused_at_once(folder, text, words):
    """Nothing is run of a suite that is not one."""
    suite = folder / "suite.toml"
    if text is not None:
        suite.write_bytes(text.encode(errors="surrogateescape"))
    result = check(suite)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"Error: {suite}{words}")


def test_errors_about_the_reference_name_its_keys(folder):
    """Where compare has options of its B, a suite has keys that begin with reference."""
    (folder / "logs" / "plain.csv").write_text("1,1,0,0,0\n2,1,0,0,0\n")
    text = '[case.c]\nlog = "logs/spin.csv"\nreference-log = "logs/plain.csv"\ntol = "1deg"\n'
    result = check(write_suite(folder, text), "--update")
    assert result.exit_code == 2
    words = "name the columns with reference-quat-cols, reference-from-layout and "
    assert f"{words}reference-time-col\n" in result.stdout


# The meaning of keys


def test_a_case_overrides_the_defaults(folder):
    """Its own value takes precedence, also false over true."""
    defaults = '[defaults]\nmethod = "end"\nnormalize = true\nrates = "inertial"\n'
    suite = write_suite(folder, defaults + TRUTH + "normalize = false\n")
    assert check(suite, "--update").exit_code == 1  # inertial rates are not those of the log
    assert lock_of(suite)["coning"]["options"] == {"method": "coning", "rates": "inertial"}


def test_paths_are_relative_to_the_suite(folder, monkeypatch):
    """Wherever it is run from: the log, the reference, and the files that options name."""
    suite = write_suite(folder, stored("spin", "spin.csv", 'at = "logs/spin.truth.csv"'))
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    assert check("../suite.toml", "--update").exit_code == 0
    assert (folder / "refs" / "spin.parquet").exists()
    monkeypatch.chdir(folder)
    assert check("suite.toml").exit_code == check(suite).exit_code == 0
    truth = folder / "logs" / "spin.truth.csv"
    truth.write_text(truth.read_text().replace(",1,", ",1.0,", 1))
    assert "logs/spin.truth.csv: its content changed" in check("suite.toml").stdout


@pytest.mark.parametrize("key", ["imu", "msg-path", "calibration", "at"])
def test_a_file_that_a_key_names_is_next_to_the_suite_and_pinned(tmp_path, key):
    """Wherever the command is started."""
    (tmp_path / "near.txt").touch()
    suite = write_suite(tmp_path, stored("a", "a.csv", f'{key} = "near.txt"'))
    _, (case,) = cases.load_cases(suite)
    assert case.inputs[key] == str(tmp_path / "near.txt")


def test_a_topic_of_the_log_itself_is_a_reference(tmp_path):
    """A log with both rates and attitudes is compared with itself, and pinned once."""
    coning = SAMPLE_LOGS / "coning.mcap"
    run("propagate", coning, "-o", tmp_path / "log.mcap", "-q", code=0)
    text = f'[case.a]\nlog = "{coning}"\nreference-log = "log.mcap"\n'
    suite = pinned(tmp_path, text + 'reference-topic = "/attitude"\ntol = "1e-9rad"\n')
    pins = lock_of(suite)["a"]
    assert set(pins["inputs"]) == {"log", "reference-log"}
    assert pins["reference"] is None
    assert pins["measured"]["max"] < 1e-7
    write_suite(tmp_path, suite.read_text().replace('reference-log = "log.mcap"\n', ""))
    assert "the case was pinned with another kind of reference" in check(suite).stdout


def test_a_log_that_is_made_anew_need_not_be_pinned(folder):
    """Other bytes of the same rates pass then, and other rates fail as a regression."""
    suite = pinned(folder, stored("spin", "spin.csv", "pin-log = false"))
    log = folder / "logs" / "spin.csv"
    log.write_text(log.read_text() + "\n")
    assert check(suite).exit_code == 0
    lines = log.read_text().splitlines()
    t_ns, *_ = lines[501].split(",")
    log.write_text("\n".join([*lines[:501], f"{t_ns},0,0,0", *lines[502:]]))
    result = check(suite)
    assert result.exit_code == 1
    # A hundredth of a second at a quarter turn a second.
    assert result.stdout.startswith("FAIL   spin  max error 0.0157 rad at +")
    assert "above the tolerance, first at +5.01 s" in result.stdout
    log.unlink()
    assert check(suite).exit_code == 2


def test_data_that_are_not_compared_are_noted(folder):
    """They cannot fail, so an update notes lost data of the log and of the reference, too."""
    log, truth = folder / "logs" / "coning.mcap", folder / "truth.csv"
    log.write_bytes(log.read_bytes()[:-3000])
    lines = (folder / "logs" / "spin.truth.csv").read_text().splitlines()
    truth.write_text("\n".join([*lines[:500], "1,2", *lines[600:]]) + "\n")
    case = '[case.spin]\nlog = "logs/spin.csv"\nreference-log = "truth.csv"\ntol = "0.1deg"\n'
    suite = write_suite(folder, stored("cut", "coning.mcap") + case)
    for options in (("--update",), ()):
        result = check(suite, *options)
        assert result.exit_code == 0
        assert [line.strip() for line in result.stdout.splitlines() if "note on" in line] == [
            f"note on cut: data of {log} were lost or omitted, see propagate",
            f"note on spin: data of {truth} were lost or omitted, see compare",
        ]
        assert "remark: data" not in result.stdout


@pytest.mark.parametrize("is_log_cut", [False, True])
def test_a_file_next_to_the_log_is_noted_by_its_name(folder, is_log_cut):
    """Losses of the file of q0 were attributed to the log."""
    log, start = folder / "logs" / "spin.csv", folder / "start.csv"
    if is_log_cut:
        log.write_text(f"{log.read_text()}1,2\n")
    lines = (folder / "logs" / "spin.truth.csv").read_text().splitlines()
    start.write_text("\n".join([*lines[:500], "1,2", *lines[600:]]) + "\n")
    suite = write_suite(folder, stored("spin", "spin.csv", 'q0 = "start.csv"'))
    expected = [start, log] if is_log_cut else [start]
    for options in (("--update",), ()):
        result = check(suite, *options)
        assert result.exit_code == 0
        assert [line.strip() for line in result.stdout.splitlines() if "note on" in line] == [
            f"note on spin: data of {file} were lost or omitted, see propagate" for file in expected
        ]


def test_a_case_can_be_skipped_with_a_reason(folder):
    """It is not run; the reason is shown."""
    suite = write_suite(folder, TRUTH + stored("spin", "none.csv", 'skip = "no log yet"'))
    result = check(suite, "--update", "--junit", folder / "junit.xml")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[1:] == [
        "skip   spin    no log yet", "2 cases: 1 passed, 1 skipped",
    ]  # fmt: skip
    junit = (folder / "junit.xml").read_text()
    assert 'skipped="1"' in junit
    assert '<skipped message="no log yet"' in junit
    assert check(suite, "--explain").exit_code == 0


def test_a_case_can_be_known_to_fail(folder):
    """Its failure is no failure; an update does not hide it; a pass is reported."""
    known = TRUTH + 'xfail = "the filter drifts"\n'
    suite = pinned(folder, known.replace("0.1deg", "1e-9deg") + stored())
    for options in ((), ("--strict",), ("--update",)):
        result = check(suite, *options)
        assert result.exit_code == 0
        first, reason, *_, last = result.stdout.splitlines()
        assert first.startswith("xfail  coning  ")
        assert reason.strip().startswith("the filter drifts: above the tolerance, first at +")
        assert last == "2 cases: 1 passed, 1 failed as expected"
    write_suite(folder, known + stored())
    result = check(suite)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[1].startswith("XPASS  coning  max error 0.0")
    assert result.stdout.splitlines()[2].strip() == "it is known to fail: the filter drifts"
    assert result.stdout.splitlines()[3] == "2 cases: 1 passed, 1 passed unexpectedly"
    assert check(suite, "--strict").exit_code == 1


EXACT = 'tol = "1deg"\n'
LIMITS = [
    ('tol = "3sigma"', 1, "largest error 5 sigma, at most 3 sigma"),
    ("max-sigma = 4", 1, "largest error 5 sigma, at most 4 sigma"),
    (f'{EXACT}rms-tol = "1e-4rad"', 1, "RMS error"),
    ('tol = "0.1mrad"', 1, "above the tolerance"),
    ('tol = "6sigma"', 0, "largest error 5 sigma (limit 6 sigma"),
    (EXACT, 0, "max error 0.286479 deg at +0 ns (limit 1 deg"),
    (f'{EXACT}align = "first"', 2, "(exact) and at least 2 must"),
    (f'{EXACT}drift-tol = "1deg/h"', 2, "one pair of attitudes shows no drift"),
    (f'{EXACT}drift-tol = "1deg/h"\nalign = "mean"', 2, 'drift-tol needs align = "none" or'),
    (f'{EXACT}window = "1s"', 2, "no two pairs are 1 s apart: they span 0 ns"),
]


@pytest.mark.parametrize(("limit", "code", "sentence"), LIMITS)
def test_a_log_of_one_sample_is_judged_by_every_limit(tmp_path, limit, code, sentence):
    """Its attitude is 5 standard deviations of 1 mrad about x from that of the reference."""
    write_rates(tmp_path / "log.csv", [(5, 0, 0, 0)])
    half = [math.cos(0.0025), math.sin(0.0025)]
    head = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z"
    write_rates(tmp_path / "truth.csv", [(5, *half, 0, 0, *[0.001] * 3)], head)
    text = f'[case.one]\nlog = "log.csv"\nreference-log = "truth.csv"\n{limit}\n'
    suite = write_suite(tmp_path, text)
    result = check(suite, "--update")
    if code < 2:
        result = check(suite)
    assert result.exit_code == code, result.output
    assert sentence in result.output
    if "sigma" in limit:
        assert ": 5 sigma when it was pinned, " in check(suite, "--explain").stdout


def in_two(folder):
    """Divide the log of a spin into two files; return the case of both."""
    whole = folder / "logs" / "spin.csv"
    head, *rows = whole.read_text().splitlines(keepends=True)
    for name, part in (("a.csv", rows[:700]), ("b.csv", rows[700:])):
        (folder / "logs" / name).write_text(head + "".join(part))
    return stored().replace('"logs/spin.csv"', '["logs/a.csv", "logs/b.csv"]')


def test_a_log_in_several_files_is_one_case(folder):
    """Only a suite took no second file of a recording; both are pinned, and one is named."""
    suite = pinned(folder, in_two(folder))
    assert lock_of(suite)["spin"]["samples"] == len(read_attitudes(folder / "logs/spin.truth.csv"))
    assert check(suite).exit_code == 0
    assert lock_of(suite)["spin"]["inputs"].keys() == {"log", "log-2"}
    stdout = check(suite, "--explain").stdout
    assert str(folder / "logs" / "b.csv") in stdout
    second = folder / "logs" / "b.csv"
    second.write_text(second.read_text()[:-200])
    result = check(suite)
    assert result.exit_code == 2
    assert f"{second}: " in result.stdout


def test_a_reference_of_several_files_does_not_name_their_folder(tmp_path):
    """Made elsewhere, it has the same bytes."""
    made = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        suite = pinned(with_logs(tmp_path / name), in_two(tmp_path / name))
        made.append((suite.parent / "refs" / "spin.parquet").read_bytes())
    assert made[0] == made[1]


def test_a_file_less_is_another_log(folder):
    """The sentence names that, not another kind of reference."""
    text = in_two(folder)
    pinned(folder, text)
    suite = write_suite(folder, text.replace(', "logs/b.csv"', ""))
    stdout = check(suite).stdout
    assert "the case has changed since it was pinned: its log was 2 files and is now 1 file" in (
        " ".join(stdout.split())
    )
    assert "another kind of reference" not in stdout
