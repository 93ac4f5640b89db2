"""Suites in processes that are killed or interrupted, and under pytest."""

import io
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from unittest import mock
from xml.etree import ElementTree as ET

import pytest
from make.commands import installed
from make.suites import STRICT, TRUTH, check, lock_of, pinned, stored, with_logs, write_suite
from make.systems import on_posix

pytestmark = pytest.mark.usefixtures("no_causes")

HOOK = """
import multiprocessing, os, sys, time
def hook(event, arguments):
    if event == "open" and str(arguments[0]).endswith("rest.parquet"):
        if multiprocessing.parent_process() is not None:
            os.kill(os.getpid(), 9)
    if event == "os.rename" and str(arguments[1]).endswith("long.parquet"):
        while True:
            time.sleep(0.01)  # one sleep does not end by a signal that comes just before it
sys.addaudithook(hook)
"""
"""As sitecustomize.py: what reads one log is killed, and what writes the reference of another is
never done."""


@pytest.fixture
def folder(tmp_path):
    """Give a folder with sample logs."""
    return with_logs(tmp_path)


def hooked(folder):
    """Return an environment whose processes have the hook."""
    (folder / "sitecustomize.py").write_text(HOOK)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}


@on_posix
def test_a_killed_process_is_an_error_of_its_case(folder):
    """Where memory runs out, the system kills a process; this is an error of its case."""
    suite = write_suite(folder, stored("rest", "rest.parquet") + TRUTH)
    result = installed("check", suite, "--update", "-j", "2", env=hooked(folder))
    first, second, last = result.stdout.splitlines()
    assert first.startswith("pass   coning  new  ")
    assert second.startswith("ERROR  rest    the process that ran it was killed; is there enough")
    assert (last, result.returncode) == ("2 cases: 1 passed, 1 error", 2)


def test_the_output_is_the_same_for_any_number_of_processes(folder):
    """With two processes the text is that of one, whatever finishes first."""
    suite = write_suite(folder, stored("rest", "rest.parquet") + TRUTH)
    one, two = (check(suite, "-j", processes) for processes in "12")
    assert (two.exit_code, two.output) == (one.exit_code, one.output)
    assert one.stdout.endswith("\n2 cases: 0 passed, 2 errors\n")


# Run in the background, the tests would have it ignore what interrupts it.
LISTENING = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from quatprop.cli import main
main()
"""


@on_posix
@pytest.mark.parametrize("processes", ["1", "2"])
def test_ctrl_c_ends_tidily(folder, processes):
    """Interrupted, it says so and no more: what is pinned was written, and nothing half-written.

    One process of two works on a case meanwhile, and is interrupted as well.
    """
    shutil.copy(folder / "logs" / "spin.csv", folder / "logs" / "long.csv")
    suite = write_suite(folder, stored("short") + stored("long", "long.csv"))
    process = subprocess.Popen(
        [sys.executable, "-c", LISTENING, "check", suite, "--update", "-j", processes,
         "--junit", folder / "junit.xml"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, **hooked(folder)},
    )  # fmt: skip
    assert process.stdout.readline().startswith("pass   short  new  ")
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert (process.returncode, errors) == (130, "Interrupted.\n")
    assert lock_of(suite).keys() == {"short"}
    assert [path.name for path in (folder / "refs").iterdir()] == ["short.parquet"]
    # A case that was not run has not passed.
    (tests,) = ET.parse(folder / "junit.xml").getroot()  # noqa: S314  # our own file
    assert [tests.get(key) for key in ("tests", "errors")] == ["2", "1"]
    assert tests.find("./testcase[@name='long']/error") is not None
    assert check(suite, "--update").exit_code == 0
    assert lock_of(suite).keys() == {"short", "long"}


# pytest


@pytest.fixture
def mixed(folder):
    """Give a folder with a suite of which one case passes, and two fail, and another test."""
    others = stored() + stored("rest", "rest.parquet")
    pinned(folder, TRUTH + others)
    (folder / "logs" / "rest.parquet").unlink()
    (folder / "test_other.py").write_text("def test_spinning(): pass\n")
    write_suite(folder, STRICT + others)
    return folder


def run_pytest(folder, *options, code=0):
    """Run pytest with the plugin, and no other, in this process; return what it says.

    What an object that is freed cannot raise is noticed by the pytest around it: of its own, it
    would collect the garbage of all tests twice. Nor does it remove the folders of earlier runs.
    """
    arguments = ["-p", "quatprop.pytest_plugin", "-p", "no:cacheprovider", "-p", "no:tmpdir",
                 "-p", "no:unraisableexception", "-W", "error", "-rA",
                 "--import-mode=importlib", "--assert=plain", *options]  # fmt: skip
    environment = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "COLUMNS": "200", "PYTEST_ADDOPTS": ""}
    with (
        chdir(folder),
        mock.patch.dict(os.environ, environment),
        redirect_stdout(io.StringIO()) as stream,
        redirect_stderr(stream),
    ):
        result = pytest.main(arguments)
    # Each folder has one of its own, which pytest would take for that of the folder before.
    sys.modules.pop("test_other", None)
    told = stream.getvalue()
    assert result == code, told
    assert "Traceback" not in told
    return told


def test_pytest_collects_cases_next_to_other_tests(mixed):
    """Each case is a test; a failure is its reason, without a traceback; -k chooses among all."""
    told = run_pytest(mixed, "--quatprop-suite", "suite.toml", code=1)
    assert "2 failed, 2 passed" in told
    assert "PASSED suite.toml::spin" in told
    assert "FAILED suite.toml::coning" in told
    assert "above the tolerance, first at +" in told
    assert "no such file or folder; check the path" in told
    told = run_pytest(mixed, "--quatprop-suite=suite.toml", "-k", "spin")
    assert "2 passed, 2 deselected" in told
    told = run_pytest(mixed, "--quatprop-suite=suite.toml", "-m", "quatprop", code=1)
    assert "2 failed, 1 passed, 1 deselected" in told


@pytest.mark.parametrize("workers", [0, 1])
def test_pytest_fails_where_no_case_of_a_suite_is_collected(mixed, workers):
    """Cases of an ignored suite were missing from JUnit; with xdist, pytest ended with an error."""
    ignored = ["--quatprop-suite=suite.toml", "--ignore=suite.toml", "-k", "spinning"]
    xdist = ["-p", "xdist", f"-n{workers}", "--junit-xml=junit.xml"]
    told = run_pytest(mixed, *ignored, *xdist, code=pytest.ExitCode.TESTS_FAILED)
    assert "1 failed, 1 passed" in told
    assert "suite.toml: none of its cases was collected; is it ignored by an option" in told
    (failure,) = ET.parse(mixed / "junit.xml").iter("failure")  # noqa: S314  # our own file
    assert "none of its cases was collected" in failure.get("message")
    assert "deselected" not in told.replace("1 deselected", "")


@pytest.mark.parametrize("arguments", [[], ["."], [".ci/suite.toml"]])
def test_pytest_collects_a_suite_in_a_folder_that_it_skips(tmp_path, arguments):
    """Its version 9 collected no case of it; nothing else of the folder is a test."""
    folder = tmp_path / ".ci"
    folder.mkdir()
    pinned(with_logs(folder), stored())
    for place in (tmp_path, folder):
        (place / "test_other.py").write_text("def test_other():\n    pass\n")
    told = run_pytest(tmp_path, "--quatprop-suite=.ci/suite.toml", *arguments)
    assert ("2 passed" in told) == (arguments != [".ci/suite.toml"])
    assert ".ci/test_other.py" not in told
    assert "PASSED .ci/suite.toml::spin" in told


def test_pytest_refuses_a_suite_without_cases(mixed):
    """With a misspelt name, here or in the configuration, or without cases, it passed."""
    (mixed / "pytest.ini").write_text("[pytest]\naddopts = --quatprop-suite=ci/siute.toml\n")
    told = run_pytest(mixed, "test_other.py", code=pytest.ExitCode.USAGE_ERROR)
    assert "siute.toml: no such file; check the path" in told
    (mixed / "pytest.ini").write_text("[pytest]\naddopts = --quatprop-suit=suite.toml\n")
    assert "unrecognized arguments" in run_pytest(mixed, code=pytest.ExitCode.USAGE_ERROR)
    (mixed / "pytest.ini").unlink()
    (mixed / "suite.toml").write_text("[defaults]\n")
    told = run_pytest(mixed, "--quatprop-suite=suite.toml", code=pytest.ExitCode.INTERRUPTED)
    assert "it has no cases" in told


@pytest.mark.parametrize("workers", [0, 1])
def test_pytest_says_if_every_case_is_deselected(mixed, workers):
    """Under xdist, only workers know it, so it was not reported."""
    xdist = ["-p", "xdist", f"-n{workers}"]
    told = run_pytest(mixed, "--quatprop-suite=suite.toml", "-k", "spinning", *xdist)
    assert f"quatprop: every case of {mixed.resolve() / 'suite.toml'} was deselected" in told


def test_pytest_says_how_a_lock_of_a_merge_is_mended(mixed):
    """The option was `update`, without its dashes."""
    lock = mixed / "suite.lock.json"
    lock.write_text("<<<<<<< HEAD\n" + lock.read_text())
    told = run_pytest(mixed, "--quatprop-suite=suite.toml", code=pytest.ExitCode.INTERRUPTED)
    assert "keeping one side of each case, and check with --update" in told


def test_pytest_knows_cases_that_fail_as_expected(folder):
    """XPASS was a pass, whatever `xfail_strict` says; deleted cases were seen nowhere."""
    known = 'xfail = "the filter drifts"\n'
    pinned(folder, TRUTH + stored() + stored("gone"))
    write_suite(folder, TRUTH + known + STRICT.replace("coning]", "bad]") + known + stored())
    pinned_too = ["--quatprop-suite=suite.toml"]
    told = run_pytest(folder, *pinned_too, code=1)
    assert "XPASS suite.toml::coning - the filter drifts" in told
    assert "it is pinned, but not in the suite; restore it" in told
    # A case that is not pinned has no result, which no reason explains.
    assert "FAILED suite.toml::bad" in told
    assert check(folder / "suite.toml", "--update", "-k", "bad", "-k", "gone").exit_code == 0
    told = run_pytest(folder, *pinned_too)
    assert "1 passed, 1 xfailed, 1 xpassed" in told
    (folder / "pytest.ini").write_text("[pytest]\nxfail_strict = true\n")
    assert "[XPASS(strict)] the filter drifts" in run_pytest(folder, *pinned_too, code=1)
    (folder / "pytest.ini").unlink()
    write_suite(folder, TRUTH + known + stored().replace("spin]", "spun]"))
    strictly = (*pinned_too, "--quatprop-strict", "--quatprop-artifacts=evidence")
    told = run_pytest(folder, *strictly, code=1)
    assert "it is known to fail: the filter drifts; with --strict this is a failure" in told
    assert "with --strict this is a failure" in told


def test_pytest_shows_what_was_obtained_and_expected(folder):
    """As a table, above the reason, and with the evidence."""
    pinned(folder, TRUTH)
    write_suite(folder, STRICT + 'rms-tol = "1deg"\n')
    told = run_pytest(folder, "--quatprop-suite=suite.toml", "--quatprop-artifacts=kept", code=1)
    lines = [line.split() for line in told.splitlines()]
    assert ["obtained", "expected"] in lines
    table = lines[lines.index(["obtained", "expected"]) + 1 :]
    assert table[0] == ["largest", "error", "0.0718199", "deg", "limit", "1e-09", "deg"]
    assert "FAILED suite.toml::coning - above the tolerance, first at " in told
    assert table[1][:2] == ["RMS", "error"]
    assert (folder / "kept" / "coning" / "error.html").is_file()


def test_pytest_runs_one_case_by_its_name(mixed):
    """A case that is named is run alone, also where the configuration names the suite."""
    (mixed / "pytest.ini").write_text("[pytest]\naddopts = --quatprop-suite=suite.toml\n")
    (mixed / "elsewhere").mkdir()
    for place, name in ((mixed, "suite.toml"), (mixed / "elsewhere", "../suite.toml")):
        told = run_pytest(place, f"{name}::spin")
        assert "1 passed" in told
        assert "deselected" not in told
    told = run_pytest(mixed / "elsewhere", "--collect-only", "--rootdir=..")
    assert "3 tests collected" in told


def overview(page):
    """Return the verdict of each case in an overview, and what its heading counts."""
    text = page.read_text()
    rows = re.findall(r'<tr><td data-key="([^"]*)">.*?<span class="(\w+)">', text)
    return dict(rows), re.search(r"</h1><p>(.*?)</p>", text)[1]


def test_pytest_writes_the_overview_of_all_cases(folder):
    """Pages of failures stood alone; workers know a part of the cases only."""
    pinned(folder, TRUTH + stored() + stored("gone") + stored("b"))
    known = TRUTH.replace("coning]", "known]") + 'xfail = "drifts"\n'
    left = stored("left") + 'skip = "no log"\n'
    changed = stored("b") + 'mount = "x,-y,-z"\n'
    write_suite(folder, STRICT + stored() + known + left + changed)
    shown = check(folder / "suite.toml", "--artifacts", folder / "by-command").stdout
    rows, heads = overview(folder / "by-command" / "index.html")
    assert rows == {
        "b": "error", "coning": "fail", "gone": "deleted", "known": "error", "left": "skip",
        "spin": "pass",
    }  # fmt: skip
    assert heads == shown.splitlines()[-1]
    options = ["--quatprop-suite=suite.toml", "-p", "xdist"]
    for workers in "01":
        kept = folder / workers
        told = run_pytest(folder, *options, f"-n{workers}", f"--quatprop-artifacts={kept}", code=1)
        assert overview(kept / "index.html") == (rows, heads)
        assert 'href="coning/error.html"' in (kept / "index.html").read_text()
        # It is the suite that says why a case is skipped, not a line of the plugin.
        assert "SKIPPED [1] suite.toml: no log" in told


def test_pytest_leaves_no_older_overview(folder):
    """One that was green would stand for a run without results."""
    pinned(folder, stored())
    options = ["--quatprop-suite=suite.toml", "--quatprop-artifacts=kept"]
    run_pytest(folder, *options)
    page = folder / "kept" / "index.html"
    assert overview(page)[0] == {"spin": "pass"}
    write_suite(folder, "[case.a\n")
    told = run_pytest(folder, *options, code=pytest.ExitCode.INTERRUPTED)
    assert "it is not TOML: Expected ']'" in told
    assert overview(page)[0] == {"suite.toml": "error"}
    (folder / "suite.toml").unlink()
    run_pytest(folder, *options, code=pytest.ExitCode.USAGE_ERROR)
    assert not page.exists()
    write_suite(folder, stored())
    (folder / "elsewhere").mkdir()
    run_pytest(folder, *options, "--rootdir=elsewhere")
    assert overview(page)[0] == {"spin": "pass"}


def test_pytest_keeps_the_evidence_of_suites_apart(folder):
    """Cases of one name in two suites replaced each other's evidence."""
    pinned(folder, TRUTH)
    suite = write_suite(folder, STRICT)
    shutil.copy(suite, folder / "b.toml")
    shutil.copy(suite.with_suffix(".lock.json"), folder / "b.lock.json")
    options = ["--quatprop-suite=suite.toml", "--quatprop-suite=b.toml"]
    run_pytest(folder, *options, "--quatprop-artifacts=kept", code=1)
    pages = sorted(page.parent.name for page in folder.glob("kept/*/index.html"))
    assert pages == ["b", "suite"]
    for name in pages:
        assert (folder / "kept" / name / "coning" / "error.html").is_file()
        assert overview(folder / "kept" / name / "index.html")[0] == {"coning": "fail"}


def test_pytest_fails_strictly_where_the_command_does(folder):
    """A case with xfail that passed with a remark that is not pinned failed as expected."""
    pinned(folder, stored())
    suite = write_suite(folder, stored("spin", "spin.csv", 'xfail = "drifts"'))
    lock = suite.with_suffix(".lock.json")
    lock.write_text(lock.read_text().replace('"frozen"', '"other"'))
    assert check(suite, "--strict").exit_code == 1
    run_pytest(folder, "--quatprop-suite=suite.toml", "--quatprop-strict", code=1)


CONFTEST = """\
import os
import pytest

def pytest_runtest_setup(item):
    if item.name == "rest":
        pytest.skip("no network")
    if item.name == "killed":
        os._exit(1)

def pytest_runtest_call(item):
    if item.name == "lost":
        raise RuntimeError("no device")

def pytest_collection_modifyitems(items):
    for item in items:
        if item.name == "coning":
            item.add_marker(pytest.mark.xfail(reason="drifts"))
        if item.name == "spin":
            item.add_marker(pytest.mark.xfail(reason="drifts", strict=True))
"""


def test_pytest_writes_what_others_make_of_cases(mixed):
    """An overview has the verdict of pytest; a case has its line, and another error its place."""
    (mixed / "conftest.py").write_text(CONFTEST)
    (mixed / "test_other.py").write_text("def test_that_is_in_no_suite():\n    1 / 0\n")
    (mixed / "suite.toml").write_text((mixed / "suite.toml").read_text() + stored("lost"))
    options = ["--quatprop-suite=suite.toml", "--quatprop-artifacts=kept", "--tb=short"]
    junit = ["--junit-xml=junit.xml", "-o", "junit_family=xunit1"]
    told = run_pytest(mixed, *options, *junit, code=1)
    verdicts = {"coning": "xfail", "lost": "error", "rest": "skip", "spin": "fail"}
    assert overview(mixed / "kept" / "index.html")[0] == verdicts
    assert "conftest.py:12: in pytest_runtest_call\n" in told
    assert "_ case spin _" in told
    cases = ET.parse(mixed / "junit.xml").iter("testcase")  # noqa: S314  # our own file
    lines = {case.get("name"): case.get("line") for case in cases}
    assert [lines[name] for name in verdicts] == ["0", "11", "8", "5"]  # from 0 on
    # Of a process that dies, there is no other report.
    (mixed / "suite.toml").write_text(stored("killed"))
    told = run_pytest(mixed, *options, "-pxdist", "-n1", "--max-worker-restart=0", code=1)
    assert overview(mixed / "kept" / "index.html")[0] == {"killed": "error"}


def test_pytest_says_where_an_overview_cannot_be_written(folder):
    """The cases have run, and pass or fail as they do."""
    pinned(folder, stored())
    (folder / "kept").write_text("a file")
    told = run_pytest(folder, "--quatprop-suite=suite.toml", "--quatprop-artifacts=kept")
    assert "quatprop: the overview in kept cannot be written: File exists\n" in told
