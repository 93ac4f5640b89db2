"""Suites: what is refused, what an update does, and the reports for CI."""

import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
from xml.etree import ElementTree as ET

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS
from make.suites import check

from quatprop import __version__
from quatprop.check import cases
from quatprop.check.case_run import propagate_case
from quatprop.cli import compare, propagate
from quatprop.cli.commands import cli
from quatprop.errors import ComparisonError
from quatprop.errors.third_party import TRACEBACK


@pytest.fixture
def folder(tmp_path):
    """Give a folder with sample logs."""
    (tmp_path / "logs").mkdir()
    for name in ("spin.csv", "spin.truth.csv", "coning.mcap", "coning.truth.csv", "rest.parquet"):
        shutil.copy(SAMPLE_LOGS / name, tmp_path / "logs")
    return tmp_path


def write(folder, text):
    """Write a suite."""
    suite = folder / "suite.toml"
    suite.write_text(text)
    return suite


def stored(name="spin", log="spin.csv", *more):
    """Return a case with a stored reference."""
    lines = [f"[case.{name}]", f'log = "logs/{log}"', f'reference = "refs/{name}.parquet"', *more]
    return "\n".join(lines) + "\n"


TRUTH = """\
[case.coning]
log = "logs/coning.mcap"
method = "coning"
reference-log = "logs/coning.truth.csv"
tol = "0.1deg"
"""

# Keys and values.


OUTPUT_ONLY = {
    "output", "to", "layout", "header-comment", "with", "euler-unit", "message", "out-topic",
    "frames", "into", "report", "quiet", "verbose", "plot", "json", "config",
}  # fmt: skip
"""Options of propagate and compare that are about what they write: no keys of a case."""


def long_names(command):
    """Return the names of a command's options."""
    options = [option for option in command.params if option.param_type_name == "option"]
    return {
        name.removeprefix("--")
        for option in options
        for name in option.opts
        if name.startswith("--")
    }


def test_every_option_is_a_key_of_a_case_or_about_the_output():
    """A new option of propagate or compare is a key by itself, unless it is about the output."""
    assert long_names(propagate.command) - OUTPUT_ONLY == set(cases.PROPAGATION_KEYS)
    own = {name for name in long_names(compare.command) if not name.endswith(("-a", "-b"))}
    of_b = {name for name in long_names(compare.command) if name.endswith("-b")}
    once = {"normalize", "on-invalid"}
    assert own - OUTPUT_ONLY - once == set(cases.COMPARISON_KEYS)
    reference = {f"reference-{name.removesuffix('-b')}" for name in of_b}
    assert reference | once == set(cases.REFERENCE_KEYS)
    assert OUTPUT_ONLY.isdisjoint(cases.PARSERS)


def test_the_plugin_and_the_suites_need_no_command_line():
    """Cases are made of settings: click is not imported."""
    code = (
        "import sys, quatprop.pytest_plugin, quatprop.check.runner, quatprop.check.cases\n"
        "print({name for name in sys.modules if name == 'click' or 'quatprop.cli' in name})"
    )
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout == "set()\n"


@pytest.mark.parametrize(
    ("more", "where", "words"),
    [
        ('methd = "end"', ", 'methd'", "no such key; did you mean 'method'?"),
        ("xyzzy = 1", ", 'xyzzy'", "no such key; a case has the options of propagate that"),
        ('output = "a.csv"', ", 'output'", "no such key; a case has the options of propagate"),
        ('method = "middle"', ", 'method'", "'middle' is not one of 'start', 'end', 'mean', "),
        ("every = 0", ", 'every'", "'0' is not a whole number above 0"),
        ("every = true", ", 'every'", "'True' is not a whole number above 0"),
        ('pin-log = "no"', ", 'pin-log'", "this is true or false"),
        ("normalize = 1", ", 'normalize'", "'1' is not true or false"),
        ("bias = [0.1, 0.2]", ", 'bias'", "'0.1,0.2' is not X,Y,Z, 3 finite numbers, nor"),
        ("bias = {x = 1}", ", 'bias'", "this takes text, a number or a list of them"),
        ('start = "soon"', ", 'start'", "'soon' is not a time; write RFC 3339"),
        ('tol = "0.1"', ", 'tol'", "'0.1' is not an angle; write a number with its unit"),
        ("tol = 0.1", ", 'tol'", "'0.1' is not an angle; write a number with its unit"),
        ('align = "best"', ", 'align'", "'best' is not one of 'none', 'first', 'yaw', "),
        ('q0 = "none.csv"', ", 'q0'", "none.csv' is neither four numbers W,X,Y,Z nor level or log"),
        ("heading = 90", "", 'heading goes with q0 = "level"'),
        ('reference-topic = "/a"', ", 'reference'", "goes without 'reference-topic'"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named(folder, more, where, words):
    """One sentence names the suite, the case and the key; other cases are judged all the same."""
    suite = write(folder, TRUTH + stored())
    assert check(suite, "--update").exit_code == 0
    write(folder, TRUTH + stored("spin", "spin.csv", more))
    result = check(suite)
    assert result.exit_code == 2
    first, second, last = result.stdout.splitlines()
    assert first.startswith("pass   coning  ")
    assert second.startswith(f"ERROR  spin    {suite}, case 'spin'{where}: ")
    assert words in second
    assert last == "2 cases: 1 passed, 1 error"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[case.a\n", ": it is not TOML: Expected ']'"),
        ("", ": it has no cases; a suite has a table [defaults] and one table [case.NAME]"),
        ("[cases.a]\n", ": unknown 'cases'; a suite has"),
        ("case = 1\n", ": 'case' is not a table; a suite has"),
        ('[case]\nlog = "a"\n', ": 'case.log' is not a table; a suite has"),
        (
            "[defaults]\nmethd = 1\n[case.a]\n",
            ", 'defaults.methd': no such key; did you mean 'method'?",
        ),
    ],
)
def test_a_broken_suite_is_refused_at_once(folder, text, words):
    """Nothing is run of a suite that is not one."""
    suite = write(folder, text)
    result = check(suite)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"Error: {suite}{words}")


def test_a_missing_suite_is_named(folder):
    """It is named."""
    result = check(folder / "none.toml")
    assert (result.exit_code, result.stderr) == (
        2, f"Error: {folder / 'none.toml'}: no such file or folder; check the path\n",
    )  # fmt: skip


def test_a_suite_that_is_no_text_is_refused(folder):
    """Bytes that are not UTF-8 are no TOML."""
    suite = folder / "suite.toml"
    suite.write_bytes(b"[case.\xff]")
    assert check(suite).stderr == f"Error: {suite}: it is not UTF-8 text: byte 6\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[case.a]\nreference = "a.parquet"\n', 'there is no log; name it with log = "PATH"'),
        ('[case.a]\nlog = "-"\nreference = "a.parquet"\n', "'log': this is not a path"),
        ('[case.a]\nlog = "a.csv"\n', "there is no reference; name the file that an"),
        ('[case.a]\nlog = "a.csv"\nreference-topic = "/b"\n', "'tol': there is no toler"),
        ('[case.a]\nlog = "a.csv"\nreference = "a.csv"\n', "'reference': a stored reference is "),
    ],
)  # fmt: skip
def test_what_a_case_lacks_is_named(folder, text, words):
    """So is what to say."""
    result = check(write(folder, text))
    assert result.exit_code == 2
    assert words in result.stdout


def test_errors_about_the_reference_name_its_keys(folder):
    """Where compare has options of its B, a suite has keys that begin with reference."""
    (folder / "logs" / "plain.csv").write_text("1,1,0,0,0\n2,1,0,0,0\n")
    text = '[case.c]\nlog = "logs/spin.csv"\nreference-log = "logs/plain.csv"\ntol = "1deg"\n'
    result = check(write(folder, text), "--update")
    assert result.exit_code == 2
    words = "name the columns with reference-quat-cols, reference-from-layout and "
    assert f"{words}reference-time-col\n" in result.stdout


def test_two_cases_do_not_share_a_reference(folder):
    """An update of one would be that of the other."""
    second = stored("other").replace("refs/other", "refs/../refs/spin")
    result = check(write(folder, stored() + second), "--update")
    assert result.exit_code == 2
    assert "case 'other', 'reference': case 'spin' has it already" in result.stdout


def test_a_case_says_what_the_defaults_do_not(folder):
    """A case's own value is taken before that of the defaults, also false before true."""
    defaults = '[defaults]\nmethod = "end"\nnormalize = true\nrates = "inertial"\n'
    suite = write(folder, defaults + TRUTH + "normalize = false\n")
    assert check(suite, "--update").exit_code == 1  # inertial rates are not those of the log
    lock = json.loads((folder / "suite.lock.json").read_text())
    assert lock["cases"]["coning"]["options"] == {"method": "coning", "rates": "inertial"}


def test_paths_are_relative_to_the_suite(folder, monkeypatch):
    """Wherever it is run from: the log, the reference, and the files that options name."""
    suite = write(folder, stored("spin", "spin.csv", 'at = "logs/spin.truth.csv"'))
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    assert check("../suite.toml", "--update").exit_code == 0
    assert (folder / "refs" / "spin.parquet").exists()
    monkeypatch.chdir(folder)
    assert check("suite.toml").exit_code == 0
    assert check(suite).exit_code == 0
    truth = folder / "logs" / "spin.truth.csv"
    truth.write_text(truth.read_text().replace(",1,", ",1.0,", 1))
    assert "logs/spin.truth.csv: its content changed" in check("suite.toml").stdout


def test_a_topic_of_the_log_itself_is_a_reference(tmp_path):
    """A log with both rates and attitudes is compared with itself, and pinned once."""
    log = tmp_path / "log.mcap"
    made = CliRunner().invoke(cli, ["propagate", str(SAMPLE_LOGS / "coning.mcap"), "-o", str(log)])
    assert made.exit_code == 0, made.output
    text = '[case.a]\nlog = "coning.mcap"\nreference-log = "log.mcap"\n'
    shutil.copy(SAMPLE_LOGS / "coning.mcap", tmp_path)
    suite = write(tmp_path, text + 'reference-topic = "/attitude"\ntol = "1e-9rad"\n')
    assert check(suite, "--update").exit_code == 0
    pins = json.loads((tmp_path / "suite.lock.json").read_text())["cases"]["a"]
    assert set(pins["inputs"]) == {"log", "reference-log"}
    assert pins["reference"] is None
    assert pins["error_rad"] < 1e-9


def test_a_log_that_is_made_anew_need_not_be_pinned(folder):
    """Other bytes of the same rates pass then, and other rates fail as a regression."""
    suite = write(folder, stored("spin", "spin.csv", "pin-log = false"))
    assert check(suite, "--update").exit_code == 0
    log = folder / "logs" / "spin.csv"
    log.write_text(log.read_text() + "\n")
    assert check(suite).exit_code == 0
    lines = log.read_text().splitlines()
    t_ns, *_ = lines[501].split(",")
    log.write_text("\n".join([*lines[:501], f"{t_ns},0,0,0", *lines[502:]]))
    result = check(suite)
    assert result.exit_code == 1
    # A hundredth of a second at a quarter turn a second.
    assert result.stdout.startswith("FAIL   spin  0.0157 rad of 1e-09 rad at +")
    assert "above the tolerance, first at +5.01 s" in result.stdout
    log.unlink()
    assert check(suite).exit_code == 2


def test_of_a_damaged_log_what_can_be_saved_is_compared(folder):
    """A log that is cut off passes as it did, with a note that data are lost."""
    log = folder / "logs" / "coning.mcap"
    log.write_bytes(log.read_bytes()[:-3000])
    suite = write(folder, stored("cut", "coning.mcap"))
    assert check(suite, "--update").exit_code == 0
    result = check(suite)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[1].strip() == (
        f"note on cut: data of {log} were lost or left out, see propagate"
    )


def test_rows_that_are_left_out_of_an_independent_series_are_noted(folder):
    """What is not compared cannot fail, so an update says it, too."""
    truth = folder / "truth.csv"
    lines = (folder / "logs" / "spin.truth.csv").read_text().splitlines()
    truth.write_text("\n".join([*lines[:500], "1,2", *lines[600:]]) + "\n")
    case = '[case.spin]\nlog = "logs/spin.csv"\nreference-log = "truth.csv"\ntol = "0.1deg"\n'
    suite = write(folder, case)
    note = f"note on spin: data of {truth} were lost or left out, see compare"
    for options in (("--update",), ()):
        result = check(suite, *options)
        assert result.exit_code == 0
        assert note in map(str.strip, result.stdout.splitlines())


# Updates.


def test_an_update_says_what_changed(folder):
    """Options, SHA-256, samples, and how far the new reference is from the old one."""
    suite = write(folder, stored())
    new = check(suite, "--update")
    assert new.stdout.splitlines()[0] == (
        f"pass   spin  new      1000 of 1000 attitudes in {folder / 'refs' / 'spin.parquet'}"
    )
    log = folder / "logs" / "spin.csv"
    lines = log.read_text().splitlines()
    log.write_text("\n".join(lines[:-1]) + "\n")
    write(folder, stored("spin", "spin.csv", 'mount = "x,-y,-z"'))
    changed = check(suite, "--update")
    assert changed.exit_code == 0
    first, sha, mount, samples, attitudes, _ = changed.stdout.splitlines()
    assert first.startswith("pass   spin  updated  999 of 999 attitudes in ")
    assert sha.split()[:2] == ["log:", "SHA-256"]
    assert mount == "       mount: the default -> 'x,-y,-z'"
    assert samples == "       samples: 1000 -> 999"
    assert attitudes.startswith("       attitudes: up to ")
    assert "rad from the old reference, at +" in attitudes
    assert check(suite).exit_code == 0


def test_the_cause_of_an_update_names_the_log_and_the_reference(folder):
    """A suite has no A and no B."""
    suite = write(folder, stored("coning", "coning.mcap"))
    check(suite, "--update")
    write(folder, stored("coning", "coning.mcap", 'method = "coning"'))
    assert (
        "likely cause: the same rates lead to the log's attitudes with method coning, and to the "
        "reference with method start (method)"
    ) in check(suite, "--update").stdout


def test_what_passes_is_left_as_it_is(folder):
    """A second update touches nothing."""
    suite = write(folder, stored() + TRUTH)
    assert check(suite, "--update").exit_code == 0
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
    again = check(suite, "--update")
    assert again.exit_code == 0
    assert again.stdout.splitlines()[0].startswith("pass   spin    kept     ")
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()} == before


def test_an_update_of_some_cases_leaves_the_others_pinned(folder):
    """With -k the lock keeps what it knows; a case that is gone is forgotten."""
    suite = write(folder, stored() + TRUTH)
    assert check(suite, "--update").exit_code == 0
    assert check(suite, "--update", "-k", "spin").exit_code == 0
    assert check(suite).exit_code == 0
    write(folder, TRUTH)
    assert check(suite, "--update").exit_code == 0
    assert list(json.loads((folder / "suite.lock.json").read_text())["cases"]) == ["coning"]


def test_an_update_does_not_hide_a_failure_against_an_independent_series(folder):
    """The truth stays the truth: the case fails in an update, too, which pins what it saw."""
    suite = write(folder, TRUTH)
    assert check(suite, "--update").exit_code == 0
    write(folder, TRUTH.replace('"coning"\nref', '"end"\nref').replace("0.1deg", "0.01deg"))
    result = check(suite, "--update")
    assert result.exit_code == 1
    assert result.stdout.startswith("FAIL   coning  updated  ")
    assert "       method: 'coning' -> 'end'\n       worst error: " in result.stdout


def test_an_update_replaces_only_what_an_update_wrote(folder):
    """A truth that somebody named as the reference is not lost."""
    suite = write(folder, stored())
    (folder / "refs").mkdir()
    reference = folder / "refs" / "spin.parquet"
    shutil.copy(SAMPLE_LOGS / "rest.truth.parquet", reference)
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert f"{reference}: this was not written by check --update, which would" in result.stdout
    assert reference.read_bytes() == (SAMPLE_LOGS / "rest.truth.parquet").read_bytes()


def test_an_update_never_replaces_a_log(folder):
    """A reference at the place of a log is refused, also of another case."""
    shutil.copy(SAMPLE_LOGS / "rest.parquet", folder / "logs" / "rest.parquet")
    rest = stored("rest", "rest.parquet")
    suite = write(folder, rest + stored("spin").replace("refs/spin", "logs/rest"))
    before = (folder / "logs" / "rest.parquet").read_bytes()
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert "this is an input of the run; choose another output" in result.output
    assert (folder / "logs" / "rest.parquet").read_bytes() == before


def test_a_case_chooses_its_rows(folder):
    """`every` and `rate` of a case are those of its reference."""
    suite = write(
        folder, stored("a", "spin.csv", "every = 100") + stored("b", "spin.csv", "rate = 7")
    )
    assert check(suite, "--update").exit_code == 0
    assert len(pq.read_table(folder / "refs" / "a.parquet")) == 10
    assert len(pq.read_table(folder / "refs" / "b.parquet")) == 70
    assert check(suite).exit_code == 0


CONFLICT = (
    "line 3 is a conflict marker of a merge; remove the markers, keeping one side of each case, "
    "and check with --update"
)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\xff", "it is not the lock that --update writes; restore it, or remove it and update"),
        (
            b'{\n "cases": {\n<<<<<<< ours\n',
            CONFLICT,
        ),
    ],
)
def test_a_damaged_lock_is_refused(folder, content, reason):
    """A merge that went wrong does not pass for an empty lock."""
    suite = write(folder, stored())
    lock = folder / "suite.lock.json"
    lock.write_bytes(content)
    result = check(suite)
    assert (result.exit_code, result.stderr) == (2, f"Error: {lock}: {reason}\n")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("final_wxyz", [1.0]),
        ("final_wxyz", None),
        ("final_wxyz", ["1", 0, 0, 0]),
        ("samples", "1001"),
        ("every", 1.5),
        ("every", 0),
        ("reference", 7),
        ("quatprop", None),
        ("error_rad", "small"),
        ("inputs", {"log": 1}),
        ("options", {"method": None}),
    ],
)
def test_a_lock_with_a_value_of_another_kind_is_refused(folder, key, value):
    """An entry that was edited by hand and is invalid is reported before anything is judged."""
    suite = write(folder, stored())
    assert check(suite, "--update").exit_code == 0
    lock = folder / "suite.lock.json"
    told = json.loads(lock.read_bytes())
    told["cases"]["spin"][key] = value
    lock.write_text(json.dumps(told))
    result = check(suite)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"Error: {lock}: it is not the lock that --update writes;")


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (ZeroDivisionError("by zero"), "This is a bug in quatprop (ZeroDivisionError: "),
        (MemoryError(), "There is not enough memory; choose fewer columns or topics"),
    ],
)
def test_what_nobody_expected_does_not_stop_the_other_cases(folder, monkeypatch, error, sentence):
    """Errors that are none of a log, too, are those of one case of many."""

    def fails(case, every):
        if case.name == "bad":
            raise error
        return propagate_case(case, every)

    monkeypatch.delenv(TRACEBACK, raising=False)
    monkeypatch.setattr("quatprop.check.update.propagate_case", fails)
    suite = write(folder, stored("bad") + stored("good"))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert f"ERROR  bad   {sentence}" in result.stdout
    assert "pass   good  new  " in result.stdout


def test_a_reference_below_a_file_is_an_error_of_its_case(folder):
    """Where its folder cannot be made, the others are updated all the same."""
    (folder / "way").write_text("in it")
    suite = write(folder, stored("bad").replace("refs/", "way/") + stored("good"))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert f"ERROR  bad   {folder / 'way'}: system error (" in result.stdout
    assert (folder / "refs" / "good.parquet").exists()


# Cases that are not judged, or known to fail, or gone.


def test_a_case_can_be_skipped_with_a_reason(folder):
    """It is not run; the reason is shown."""
    suite = write(folder, TRUTH + stored("spin", "none.csv", 'skip = "no log yet"'))
    result = check(suite, "--update", "--junit", folder / "junit.xml")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[1:] == [
        "skip   spin    no log yet", "2 cases: 1 passed, 1 skipped",
    ]  # fmt: skip
    root = ET.parse(folder / "junit.xml").getroot()  # noqa: S314  # our own file
    assert root.get("skipped") == "1"
    assert root.find(".//skipped").get("message") == "no log yet"


@pytest.mark.parametrize("key", ["skip", "xfail"])
def test_a_reason_is_a_text(folder, key):
    """True says nothing to the next reader."""
    result = check(write(folder, stored("spin", "spin.csv", f"{key} = true")))
    assert result.exit_code == 2
    assert f"case 'spin', '{key}': write the reason as text" in result.stdout


def test_a_case_can_be_known_to_fail(folder):
    """Its failure is no failure; an update does not hide it; a pass is reported."""
    known = TRUTH + 'xfail = "the filter drifts"\n'
    suite = write(folder, known.replace("0.1deg", "1e-9deg") + stored())
    assert check(suite, "--update").exit_code == 0
    for options in ((), ("--strict",), ("--update",)):
        result = check(suite, *options)
        assert result.exit_code == 0
        first, reason, *_, last = result.stdout.splitlines()
        assert first.startswith("xfail  coning  ")
        assert reason.strip().startswith("the filter drifts: above the tolerance, first at +")
        assert last == "2 cases: 1 passed, 1 failed as expected"
    write(folder, known + stored())
    result = check(suite)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[1].startswith("XPASS  coning  0.0")
    assert result.stdout.splitlines()[2].strip() == "it is known to fail: the filter drifts"
    assert result.stdout.splitlines()[3] == "2 cases: 1 passed, 1 passed unexpectedly"
    assert check(suite, "--strict").exit_code == 1


def test_a_deleted_case_is_named(folder):
    """--strict fails on it; an update removes it from the lock, and names its reference."""
    suite = write(folder, stored() + stored("rest", "rest.parquet") + TRUTH)
    assert check(suite, "--update").exit_code == 0
    assert check(suite, "-k", "spin", "--strict").exit_code == 0
    write(folder, stored() + TRUTH)
    result = check(suite)
    way_out = "restore them, or remove them from the lock"
    assert (result.exit_code, result.stderr) == (
        0,
        f"pinned, but not in the suite: 'rest'; {way_out} with --update\n",
    )
    assert json.loads(check(suite, "--json").stdout)["deleted"] == ["rest"]
    assert check(suite, "--strict").exit_code == 1
    result = check(suite, "--update", "--strict")
    assert (result.exit_code, result.stderr.splitlines()) == (
        0,
        [
            "removed from the lock: 'rest'",
            f"no longer used, to be removed: {folder / 'refs' / 'rest.parquet'}",
        ],
    )
    assert check(suite, "--strict").exit_code == 0


def test_a_lost_lock_beside_its_references_says_so(folder):
    """Not that the case is new."""
    suite = write(folder, stored())
    assert check(suite, "--update").exit_code == 0
    (folder / "suite.lock.json").unlink()
    reason = "the reference is there, but not in the lock; restore the lock, or check with --update"
    assert reason in check(suite).stdout


def test_pointers_of_git_lfs_are_not_updated(folder):
    """Neither a log nor a reference that was not downloaded is taken for the file itself."""
    suite = write(folder, stored())
    assert check(suite, "--update").exit_code == 0
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
    for path in (folder / "refs" / "spin.parquet", folder / "logs" / "spin.csv"):
        before = path.read_bytes()
        path.write_text(pointer)
        for options in ((), ("--update",)):
            result = check(suite, *options)
            assert result.exit_code == 2
            assert f"{path}: it is a Git LFS pointer, not the file itself" in result.stdout
        assert path.read_text() == pointer
        path.write_bytes(before)


def test_pinned_options_are_compared_by_value(folder):
    """Another way of writing a number is no change."""
    suite = write(folder, stored("spin", "spin.csv", "rate = 50", 'max-gap = "1s"', "bias=[0,0,1]"))
    assert check(suite, "--update").exit_code == 0
    write(folder, stored("spin", "spin.csv", "rate = 50.0", 'max-gap = "1000ms"', "bias=[0,0,1.0]"))
    assert check(suite).exit_code == 0
    write(folder, stored("spin", "spin.csv", "rate = 51", 'max-gap = "1s"', "bias=[0,0,1]"))
    assert "rate was '50' and is now '51'; restore it" in check(suite).stdout


def test_of_many_cases_those_that_pass_are_counted(folder):
    """Failures come last, and -v lists all."""
    many = "".join(stored(f"case{number}") for number in range(9))
    suite = write(folder, many + stored("bad", "none.csv") + stored("z"))
    result = check(suite, "--update")
    first, second = result.stdout.splitlines()
    assert first.startswith("ERROR  bad    ")
    assert second == "11 cases: 10 passed, 1 error"
    lines = check(suite, "-v").stdout.splitlines()
    assert [line.split()[0] for line in lines] == [*["pass"] * 10, "ERROR", "11"]


# First steps, and evidence.


def test_a_suite_can_be_written_for_logs(folder):
    """With a case for each log, and their references; a suite that is there is not replaced."""
    suite = folder / "ci" / "suite.toml"
    suite.parent.mkdir()
    shutil.copy(folder / "logs" / "spin.csv", folder / "a b.csv")
    (folder / "more").mkdir()
    shutil.copy(folder / "logs" / "spin.csv", folder / "more" / "spin.csv")
    logs = [folder / "logs" / "spin.csv", folder / "more" / "spin.csv", folder / "a b.csv"]
    result = check(suite, "--init", *logs)
    assert result.exit_code == 0, result.output
    assert [line.split()[1] for line in result.stdout.splitlines()[:2]] == ["spin", "spin-2"]
    lock = suite.with_name("suite.lock.json")
    assert result.stderr.splitlines()[-1] == f"wrote {suite}, {lock} and the references"
    assert '[case."a b"]\nlog = "../a b.csv"\nreference = "refs/a b.parquet"\n' in suite.read_text()
    assert check(suite).stdout.splitlines()[-1] == "3 cases: 3 passed"
    again = check(suite, "--init", *logs)
    assert (again.exit_code, again.stderr) == (
        2, f"Error: {suite}: there is a suite already; add cases to it, or name another file\n",
    )  # fmt: skip
    assert "--init needs a LOG for each case" in check(suite, logs[0]).stderr


def test_a_suite_of_which_no_log_can_be_used_is_not_left_behind(folder):
    """The command can be corrected and given again; of several logs it says how many were used."""
    bad, suite = folder / "bad.csv", folder / "ci.toml"
    bad.write_text("a,b\n1,2\n")
    before = sorted(folder.rglob("*"))
    result = check(suite, "--init", bad)
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1] == "wrote nothing, as no log could be propagated"
    assert check(suite, "--init", folder / "logs" / "spin.csv", "-k", "none").exit_code == 2
    assert sorted(folder.rglob("*")) == before
    result = check(suite, "--init", bad, folder / "logs" / "spin.csv")
    assert result.exit_code == 2
    lock = suite.with_name("ci.lock.json")
    assert result.stderr.splitlines()[-1] == (
        f"wrote {suite}, {lock} and the references of 1 of 2 cases"
    )
    assert suite.exists()
    assert list(json.loads(lock.read_text())["cases"]) == ["spin"]


def test_a_case_can_be_explained(folder):
    """What it depends on, what of it has changed, and how it is judged; nothing is run."""
    suite = write(folder, stored("spin", "spin.csv", 'method = "mean"') + TRUTH)
    assert "lock       no entry" in check(suite, "--explain").stdout
    assert check(suite, "--update").exit_code == 0
    write(folder, stored("spin", "spin.csv", 'method = "end"') + TRUTH)
    (folder / "refs" / "spin.parquet").unlink()
    pins = json.loads(suite.with_suffix(".lock.json").read_text())
    pins["cases"]["spin"]["every"] = 2
    suite.with_suffix(".lock.json").write_text(json.dumps(pins))
    result = check(suite, "--explain")
    assert result.exit_code == 0
    spin, coning = result.stdout.split("\n\n")
    title, log, method, reference, judged, stamps, samples, lock = spin.splitlines()
    assert title == "spin (line 1 of the suite)"
    assert log.startswith(f"  log        {folder / 'logs' / 'spin.csv'}: SHA-256 ")
    assert log.endswith(", as pinned")
    assert method == "  method     end, pinned as mean"
    assert reference.endswith("spin.parquet: no such file or folder; check the path")
    assert judged == "  judged by  worst error of at most 1e-09 rad, alignment none"
    assert (stamps.strip(), samples.strip()) == ("equal timestamps", "1000 samples")
    assert lock == f"  lock       by quatprop {__version__}, one of every 2 attitudes"
    assert "coning.truth.csv, an independent series" in coning
    assert "worst error of at most 0.1 deg" in coning


def test_the_evidence_of_a_failure_is_kept(folder):
    """The attitudes, a page, and commands that repeat the case."""
    suite = write(folder, TRUTH.replace("case.coning", 'case."a/b"') + stored())
    assert check(suite, "--update").exit_code == 0
    text = TRUTH.replace("case.coning", 'case."a/b"').replace("0.1deg", "1e-9deg")
    write(folder, text + stored())
    result = check(suite, "--artifacts", folder / "failed")
    place = folder / "failed" / "a%2Fb"
    assert result.exit_code == 1
    assert f"; see {place}\n" in result.stdout
    assert sorted(path.name for path in place.iterdir()) == [
        "attitude.parquet", "commands.txt", "error.html",
    ]  # fmt: skip
    assert "<svg" in (place / "error.html").read_text()
    codes = []
    for line in (place / "commands.txt").read_text().splitlines():
        name, *arguments = shlex.split(line)
        assert name == "quatprop"
        codes.append(CliRunner().invoke(cli, arguments).exit_code)
    assert codes == [0, 1]
    assert [path.name for path in (folder / "failed").iterdir()] == ["a%2Fb"]


def test_evidence_without_a_comparison_says_why(folder, monkeypatch):
    """The sentence is text of the page, never markup."""

    def fails(*_arguments):
        raise ComparisonError("A turns <b>faster</b> & B does not")

    suite = write(folder, TRUTH)
    assert check(suite, "--update").exit_code == 0
    write(folder, TRUTH.replace("0.1deg", "1e-9deg"))
    monkeypatch.setattr("quatprop.check.artifacts.compare", fails)
    assert check(suite, "--artifacts", folder / "failed").exit_code == 1
    page = folder / "failed" / "coning" / "error.html"
    assert page.read_text() == (
        "<!doctype html>\n<p>A turns &lt;b&gt;faster&lt;/b&gt; &amp; B does not</p>\n"
    )


def test_a_failure_is_told_where_its_evidence_cannot_be_kept(folder):
    """The case has failed, and why, whatever the folder of artifacts is."""
    suite = write(folder, TRUTH)
    assert check(suite, "--update").exit_code == 0
    write(folder, TRUTH.replace("0.1deg", "1e-9deg"))
    (folder / "failed").write_text("a file")
    result = check(suite, "--artifacts", folder / "failed")
    assert result.exit_code == 1
    assert "FAIL" in result.stdout
    _, why = next(line for line in result.stdout.splitlines() if "above" in line).split("above ")
    assert why.startswith("the tolerance, first at +")
    sentence = f"; its artifacts cannot be kept: {folder / 'failed'}: cannot be written: "
    assert why.partition(sentence)[2] == "Not a directory"


# Reports for CI.


@pytest.fixture
def mixed(folder):
    """Give a suite of which one case passes, one fails, and one cannot be judged."""
    suite = write(folder, TRUTH + stored() + stored("rest", "rest.parquet"))
    assert check(suite, "--update").exit_code == 0
    write(folder, TRUTH.replace("0.1deg", "1e-9deg") + stored() + stored("rest", "rest.parquet"))
    (folder / "logs" / "rest.parquet").unlink()
    return suite


def test_junit_has_each_case(mixed, folder):
    """Counts, failures with their reasons, and the line in the suite."""
    target = folder / "junit.xml"
    assert check(mixed, "--junit", target).exit_code == 2
    root = ET.parse(target).getroot()  # noqa: S314  # our own file
    assert root.tag == "testsuites"
    assert [root.get(key) for key in ("tests", "failures", "errors", "skipped")] == list("3110")
    (tests,) = root
    assert [case.get("name") for case in tests] == ["coning", "spin", "rest"]
    assert [case.get("line") for case in tests] == ["1", "6", "9"]
    failure, error = tests.find("./testcase/failure"), tests.find("./testcase/error")
    assert failure.get("message").startswith("above the tolerance, first at +")
    assert error.get("message").endswith("rest.parquet: no such file or folder; check the path")


def test_a_missing_folder_for_junit_is_reported_before_anything_runs(mixed, folder):
    """Not after an hour of cases."""
    result = check(mixed, "--junit", folder / "none" / "junit.xml")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert f"there is no folder {folder / 'none'}; create it first" in result.stderr


def test_junit_never_replaces_what_is_read(mixed, folder):
    """A mistyped --junit does not cost a log."""
    log = folder / "logs" / "spin.csv"
    before = log.read_bytes()
    result = check(mixed, "--junit", log)
    assert result.exit_code == 2
    assert "this is an input of the run; choose another output" in result.stderr
    assert log.read_bytes() == before


@pytest.mark.usefixtures("mixed")
def test_github_gets_a_summary_and_annotations(folder, monkeypatch):
    """The summary is appended to; annotations go to stderr; stdout stays JSON."""
    summary = folder / "summary.md"
    summary.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.chdir(folder)
    result = check("suite.toml", "--json")
    counts = {"pass": 1, "fail": 1, "error": 1, "skip": 0, "xfail": 0, "xpass": 0}
    report = json.loads(result.stdout)
    assert (report["passed"], report["counts"]) == (False, counts)
    first, second = result.stderr.splitlines()
    assert first.startswith("::error file=suite.toml,line=1,title=coning%3A fail::")
    assert second == (
        "::error file=suite.toml,line=9,title=rest%3A error::logs/rest.parquet: no such file or "
        "folder; check the path"
    )
    lines = summary.read_text().splitlines()
    assert lines[:2] == [
        "before", "### suite.toml: 3 cases: 1 passed, 1 failed, 1 error",
    ]  # fmt: skip
    assert lines[3:5] == ["| case | verdict | worst error | why |", "|---|---|---|---|"]
    assert [line.split(" | ")[:2] for line in lines[5:8]] == [
        ["| rest", ":warning: error"], ["| coning", ":x: failed"], ["| spin", "passed"],
    ]  # fmt: skip


def test_names_cannot_command_what_shows_them(folder, monkeypatch):
    """Line breaks, bars and escapes in a name stay text in the terminal, the summary, and XML."""
    summary, junit = folder / "summary.md", folder / "junit.xml"
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    suite = write(folder, '[case."a\\n::error::|<b>\\u001b[31m"]\nlog = "logs/none.csv"\n')
    result = check(suite, "--junit", junit)
    assert result.exit_code == 2
    assert "\x1b" not in result.output
    assert not any(line.startswith("::error::") for line in result.output.splitlines())
    assert "| a\\\\n::error::\\|\\<b\\>\\\\x1b\\[31m |" in summary.read_text()
    (case,) = ET.parse(junit).getroot().iter("testcase")  # noqa: S314  # our own file
    assert case.get("name") == "a\\n::error::|<b>\\x1b[31m"


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_killed_process_is_an_error_of_its_case(folder):
    """Where memory runs out, the system kills a process; this is an error of its case."""
    hook = """
import multiprocessing, os, sys
def kill(event, arguments):
    if event == "open" and str(arguments[0]).endswith("rest.parquet"):
        if multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), 9)
sys.addaudithook(kill)
"""
    (folder / "sitecustomize.py").write_text(hook)
    suite = write(folder, stored("rest", "rest.parquet") + TRUTH)
    command = [sys.executable, "-m", "quatprop", "check", suite, "--update", "-j", "2"]
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    result = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    first, second, last = result.stdout.splitlines()
    assert first.startswith("pass   coning  new  ")
    assert second.startswith("ERROR  rest    the process that ran it was killed; is there enough")
    assert (last, result.returncode) == ("2 cases: 1 passed, 1 error", 2)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no process groups to interrupt")
@pytest.mark.parametrize("processes", ["1", "2"])
def test_ctrl_c_ends_tidily(folder, processes):
    """Interrupted, it says so and no more: what is pinned was written, and nothing half-written.

    One process of two works on a case meanwhile, and is interrupted as well. It may just have
    written a reference that it cannot report any more: the next update pins that.
    """
    log = folder / "logs" / "long.csv"
    rows = "".join(f"{t}0000000,0.1,0.2,0.3\n" for t in range(1_000_000))
    log.write_text("t_ns,wx,wy,wz\n" + rows)
    suite = write(folder, stored("short") + stored("long", "long.csv"))
    # Run in the background, the tests would have it ignore what interrupts it.
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from quatprop.cli import main; main()"
    )
    command = [sys.executable, "-c", code, "check", str(suite), "--update", "-j", processes]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout.readline().startswith("pass   short  new  ")
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (130, "Interrupted.\n")
    pinned = json.loads((folder / "suite.lock.json").read_text())["cases"]
    assert "short" in pinned
    written = {path.name for path in (folder / "refs").iterdir()}
    assert {f"{name}.parquet" for name in pinned} <= written <= {"short.parquet", "long.parquet"}
    assert check(suite, "--update").exit_code == 0
    pinned = json.loads((folder / "suite.lock.json").read_text())["cases"]
    assert pinned.keys() == {"short", "long"}


# pytest.


def pytest_run(folder, *options):
    """Run pytest with the plugin, and no other."""
    command = [sys.executable, "-m", "pytest", "-p", "quatprop.pytest_plugin", "-p",
               "no:cacheprovider", "-W", "error", "-rA", *options]  # fmt: skip
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "COLUMNS": "200"}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_pytest_collects_cases(mixed):
    """Each case is a test; a failure is its reason, without a traceback."""
    result = pytest_run(mixed.parent, "--quatprop-suite", "suite.toml")
    assert result.returncode == 1, result.stdout
    assert "1 passed, 2 failed" in result.stdout or "2 failed, 1 passed" in result.stdout
    assert "PASSED suite.toml::spin" in result.stdout
    assert "FAILED suite.toml::coning" in result.stdout
    assert "above the tolerance, first at +" in result.stdout
    assert "no such file or folder; check the path" in result.stdout
    assert "Traceback" not in result.stdout


def test_pytest_chooses_cases_beside_other_tests(mixed):
    """The suite comes beside the tests that pytest finds, and -k chooses among all of them."""
    (mixed.parent / "test_other.py").write_text("def test_spinning(): pass\n")
    result = pytest_run(mixed.parent, "--quatprop-suite=suite.toml", "-k", "spin")
    assert result.returncode == 0, result.stdout
    assert "2 passed, 2 deselected" in result.stdout


def test_pytest_refuses_a_suite_that_is_not_there(mixed):
    """It passed without its cases where other tests were collected."""
    (mixed.parent / "test_other.py").write_text("def test_other(): pass\n")
    result = pytest_run(mixed.parent, "--quatprop-suite=siute.toml")
    assert result.returncode == pytest.ExitCode.USAGE_ERROR
    name = mixed.parent.resolve() / "siute.toml"
    assert f"--quatprop-suite: {name}: no such file; check the path" in result.stderr


def test_pytest_runs_one_case_by_its_name(mixed):
    """A case that is named is run alone, also where the configuration names the suite."""
    (mixed.parent / "pytest.ini").write_text("[pytest]\naddopts = --quatprop-suite=suite.toml\n")
    (mixed.parent / "elsewhere").mkdir()
    for place, name in (
        (mixed.parent, "suite.toml"),
        (mixed.parent / "elsewhere", "../suite.toml"),
    ):
        result = pytest_run(place, f"{name}::spin")
        assert result.returncode == 0, result.stdout
        assert "1 passed" in result.stdout
        assert "deselected" not in result.stdout
    assert "3 tests collected" in pytest_run(place, "--collect-only", "--rootdir=..").stdout


def test_pytest_reports_a_broken_suite(folder):
    """It is an error of the collection, in one sentence."""
    write(folder, "[case.a\n")
    result = pytest_run(folder, "--quatprop-suite=suite.toml")
    assert result.returncode == 2
    assert "it is not TOML: Expected ']'" in result.stdout
    assert "Traceback" not in result.stdout


@pytest.mark.parametrize("key", ["imu", "msg-path", "calibration", "at"])
def test_a_file_that_a_key_names_is_beside_the_suite_and_pinned(tmp_path, key):
    """Wherever the command is started."""
    suite = tmp_path / "suite.toml"
    suite.write_text(f'[case.a]\nlog = "a.csv"\nreference = "a.parquet"\n{key} = "beside.txt"\n')
    (tmp_path / "beside.txt").touch()
    _, (case,) = cases.load_cases(suite)
    assert case.inputs[key] == str(tmp_path / "beside.txt")


@pytest.mark.parametrize(
    ("limit", "code", "sentence"),
    [
        ('tol = "3sigma"', 1, "largest error 5 sigma, at most 3 sigma"),
        ("max-sigma = 4", 1, "largest error 5 sigma, at most 4 sigma"),
        ('tol = "1deg"\nrms-tol = "1e-4rad"', 1, "RMS error"),
        ('tol = "0.1mrad"', 1, "above the tolerance"),
        ('tol = "6sigma"', 0, "largest error 5 of 6 sigma"),
        ('tol = "1deg"', 0, "0.286479 deg of 1 deg at +0 ns"),
        (
            'tol = "1deg"\nalign = "first"',
            2,
            "(exact) and at least 2 must",
        ),
        ('tol = "1deg"\ndrift-tol = "1deg/h"', 2, "one pair of attitudes shows no drift"),
        (
            'tol = "1deg"\ndrift-tol = "1deg/h"\nalign = "mean"',
            2,
            'drift-tol needs align = "none" or',
        ),
        ('tol = "1deg"\nwindow = "1s"', 2, "no two pairs are 1 s apart: they span 0 ns"),
    ],
)
def test_a_log_of_one_sample_is_judged_by_every_limit(tmp_path, limit, code, sentence):
    """Its attitude is 5 standard deviations of 1 mrad about x from that of the reference."""
    (tmp_path / "log.csv").write_text("t_ns,wx,wy,wz\n5,0,0,0\n")
    half = 0.0025
    (tmp_path / "truth.csv").write_text(
        "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z\n"
        f"5,{math.cos(half)!r},{math.sin(half)!r},0,0,0.001,0.001,0.001\n"
    )
    (tmp_path / "suite.toml").write_text(
        f'[case.one]\nlog = "log.csv"\nreference-log = "truth.csv"\n{limit}\n'
    )
    result = check(tmp_path / "suite.toml", "--update")
    if code < 2:
        result = check(tmp_path / "suite.toml")
    assert result.exit_code == code, result.output
    assert sentence in result.output


@pytest.mark.parametrize("way", ["../{}", "{}/outside/r.parquet", "refs/r.parquet", "r.parquet"])
def test_an_update_writes_only_in_the_folder_of_the_suite(folder, way):
    """A reference with ../ or an absolute path, or behind a link, replaced any Parquet file."""
    outside, inside = folder / "outside", folder / "suite"
    outside.mkdir()
    inside.mkdir()
    shutil.move(folder / "logs", inside / "logs")
    target = outside / "r.parquet"
    reference = way.format("outside/r.parquet" if way.startswith("..") else folder)
    if reference == "refs/r.parquet":
        (inside / "refs").symlink_to(outside)
    elif reference == "r.parquet":
        (inside / "r.parquet").symlink_to(target)
    suite = write(inside, stored().replace("refs/spin.parquet", reference))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert (
        f"{inside / reference}: {target} is written to, which is not in {inside}; remove the link "
        "or the path that leads there\n"
    ) in result.output
    assert list(outside.iterdir()) == []


def test_a_lock_that_is_a_link_out_of_the_folder_is_refused(folder):
    """An update would replace what it leads to."""
    inside = folder / "suite"
    inside.mkdir()
    shutil.move(folder / "logs", inside / "logs")
    (inside / "suite.lock.json").symlink_to(folder / "precious")
    result = check(write(inside, stored()), "--update")
    assert result.exit_code == 2
    assert result.output.startswith(f"Error: {inside / 'suite.lock.json'}: {folder / 'precious'} ")
    assert not (folder / "precious").exists()


@pytest.mark.parametrize("name", ["", "attitude.parquet", "error.html", "commands.txt"])
def test_artifacts_are_not_written_through_links(folder, name):
    """Links in their folder led anywhere."""
    suite = write(folder, TRUTH)
    assert check(suite, "--update").exit_code == 0
    write(folder, TRUTH.replace("0.1deg", "1e-9deg"))
    place, outside = folder / "failed" / "coning", folder / "outside"
    outside.mkdir()
    (place if name else place.parent).mkdir(parents=True)
    (place / name).symlink_to(outside / name)
    result = check(suite, "--artifacts", folder / "failed")
    assert result.exit_code == 1
    assert (
        f"its artifacts cannot be kept: {place / (name or 'attitude.parquet')}: " in result.output
    )
    assert list(outside.iterdir()) == []
