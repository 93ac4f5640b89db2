"""Reports on cases: in the terminal, for CI, as artifacts; and first steps."""

import json
import os
import re
import shlex
import shutil
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import pytest
from make.commands import run
from make.places import SAMPLE_LOGS
from make.suites import STRICT, TRUTH, check, lock_of, pinned, repinned, stored, write_suite

import quatprop
from quatprop import __version__
from quatprop.base.errors import ComparisonError
from quatprop.tools.check.case import CaseResult
from quatprop.tools.check.runner import append_github_summary, github_annotations, write_overview


def test_passing_cases_are_only_counted_if_there_are_many(folder):
    """Failures come last, and -v lists all."""
    many = "".join(stored(f"case{number}") for number in range(9))
    suite = write_suite(folder, many + stored("bad", "none.csv") + stored("z"))
    check(suite, "--update")
    first, second = check(suite).stdout.splitlines()
    assert first.startswith("ERROR  bad    ")
    assert second == "11 cases: 10 passed, 1 error"
    *lines, note, _ = check(suite, "-v").stdout.splitlines()
    assert [line.split()[0] for line in lines] == [*["pass"] * 10, "ERROR"]
    # The remarks of propagate on the log are shown, pinned or not.
    assert note.startswith("note on 10 cases: every rate is the same, ")


def test_a_suite_can_be_written_for_logs(folder):
    """A name with an emoji made invalid TOML; an existing suite is not replaced."""
    suite, log = folder / "ci" / "suite.toml", folder / "logs" / "spin.csv"
    suite.parent.mkdir()
    (folder / "more").mkdir()
    logs = [log, shutil.copy(log, folder / "more"), shutil.copy(log, folder / "a \U0001f680.csv")]
    result = check(suite, "--init", *logs)
    assert result.exit_code == 0, result.output
    cases = [line for line in result.stdout.splitlines() if line.startswith("pass ")]
    assert [line.split()[1] for line in cases] == ["spin", "spin-2", "a"]
    lock = suite.with_name("suite.lock.json")
    assert result.stderr.splitlines()[-1] == f"wrote {suite}, {lock} and the references"
    case = '[case."a b"]\nlog = "../a b.csv"\nreference = "refs/a b.parquet"\n'
    assert case.replace(" b", " \U0001f680") in suite.read_text()
    assert check(suite).stdout.splitlines()[-1] == "3 cases: 3 passed"
    again = check(suite, "--init", *logs)
    assert (again.exit_code, again.stderr) == (
        2, f"Error: {suite}: there is a suite already; add cases to it, or name another file\n",
    )  # fmt: skip
    assert "--init needs a LOG for each case" in check(suite, log).stderr


def test_a_log_on_another_drive_is_named_by_its_whole_path(folder, monkeypatch):
    """Windows has no relative path from one drive to another."""

    def relpath(*_):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(os.path, "relpath", relpath)
    suite, log = folder / "suite.toml", folder / "logs" / "spin.csv"
    assert check(suite, "--init", log).exit_code == 0
    assert f'log = "{log.as_posix()}"' in suite.read_text()
    assert check(suite).exit_code == 0


def test_a_suite_without_usable_logs_is_not_left_behind(folder):
    """The corrected command can be repeated; with several logs, the usable ones are counted."""
    bad, good, suite = folder / "bad.csv", folder / "logs" / "spin.csv", folder / "ci.toml"
    bad.write_text("a,b\n1,2\n")
    before = sorted(folder.rglob("*"))
    result = check(suite, "--init", bad)
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1] == "wrote nothing, as no log could be propagated"
    assert check(suite, "--init", good, "-k", "none").exit_code == 2
    assert sorted(folder.rglob("*")) == before
    result = check(suite, "--init", bad, good)
    assert result.exit_code == 2
    lock = suite.with_name("ci.lock.json")
    words = f"wrote {suite}, {lock} and the references of 1 of 2 cases"
    assert result.stderr.splitlines()[-1] == words
    assert suite.exists()
    assert list(lock_of(suite)) == ["spin"]


@pytest.mark.parametrize(("limit", "code"), [("1deg", 0), ("1e-9deg", 1)])
def test_any_limit_on_the_error_is_a_tolerance(folder, limit, code):
    """Without `tol`, a case was refused for having none; --explain left the others out."""
    pinned(folder, TRUTH)
    case = TRUTH.replace('tol = "0.1deg"', f'align = "yaw"\ntol-inclination = "{limit}"')
    suite = write_suite(folder, case)
    result = check(suite)
    assert result.exit_code == code, result.output
    shown = limit.replace("-9", "-09").replace("deg", " deg")
    assert f"; error in inclination 0.0154633 deg (limit {shown}" in result.stdout
    assert (
        "; with the reference frame of the reference attitudes rotated by 0.0357711"
        in result.stdout
    )
    explained = check(suite, "--explain").stdout
    assert re.search("judged by +alignment yaw\n", explained)
    assert f"tol-inclination {limit}\n" in explained


def test_a_case_can_be_explained(folder):
    """Its inputs, the changes in them, and how it is judged; nothing is run."""
    suite = write_suite(folder, stored("spin", "spin.csv", 'method = "mean"') + TRUTH)
    new = check(suite, "--explain")
    # Its reference is missing, which is an error of `check`, too.
    assert (new.exit_code, "lock       no entry" in new.stdout) == (2, True)
    assert check(suite, "--update").exit_code == 0
    bag = shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", folder / "logs" / "bag")
    others = stored("bag", "bag") + stored("free", "spin.csv", "pin-log = false", 'xfail = "no"')
    write_suite(folder, stored("spin", "spin.csv", 'method = "end"') + TRUTH + others)
    assert check(suite, "--update", "-k", "bag", "-k", "free").exit_code == 0
    (bag / "metadata.yaml").write_text((bag / "metadata.yaml").read_text() + "# edited\n")
    (folder / "refs" / "spin.parquet").unlink()
    repinned(suite, "spin", every=2)
    result = check(suite, "--explain")
    assert result.exit_code == 2
    spin, coning, of_bag, free = result.stdout.split("\n\n")
    title, log, method, reference, judged, tol, stamps, samples, last, remark = spin.splitlines()
    assert title == "spin (line 1 of the suite)"
    assert log.startswith(f"  log        {folder / 'logs' / 'spin.csv'}: SHA-256 ")
    assert log.endswith(", as pinned")
    assert method == "  method     end, pinned as mean"
    assert reference.endswith("spin.parquet: no such file or folder; check the path")
    assert (judged, tol.strip()) == ("  judged by  alignment none", "tol 1e-9rad")
    assert (stamps.strip(), samples.strip()) == ("equal timestamps", "1000 samples")
    assert last == f"  lock       by quatprop {__version__}, one of every 2 attitudes"
    assert "coning.truth.csv, an independent series" in coning
    assert remark == "  remark     frozen"
    assert f"  log        {bag}: changed: 'metadata.yaml'\n" in of_bag
    assert f"  log        {folder / 'logs' / 'spin.csv'}: not pinned\n" in free
    assert "timestamps may differ\n  xfail      no\n  lock       by" in free
    assert "tol 0.1deg: 0.0718199 deg when it was pinned, margin 28 %" in coning


# Evidence


@pytest.fixture
def failing(folder):
    """Give a suite of which one case fails, with a name that is no name of a folder."""
    keys = "normalize = true\nregular-time = false\nreference-time-unit = 'ns'\n"
    pinned(folder, TRUTH.replace("case.coning", 'case."a/b"') + keys + stored())
    return write_suite(folder, STRICT.replace("case.coning", 'case."a/b"') + keys + stored())


def test_the_evidence_of_a_failure_is_kept(failing, folder):
    """The attitudes, a page, and commands that repeat the case."""
    result = check(failing, "--artifacts", folder / "failed")
    place = folder / "failed" / "a%2Fb"
    assert result.exit_code == 1
    assert f"; see {place}\n" in result.stdout
    assert sorted(path.name for path in place.iterdir()) == [
        "attitude.parquet", "commands.txt", "error.html",
    ]  # fmt: skip
    assert "<svg" in (place / "error.html").read_text()
    commands = [shlex.split(line) for line in (place / "commands.txt").read_text().splitlines()]
    assert [name for name, *_ in commands] == ["quatprop"] * 3
    assert [run(*arguments).exit_code for _, *arguments in commands] == [1, 0, 1]
    assert sorted(path.name for path in (folder / "failed").iterdir()) == ["a%2Fb", "index.html"]


def test_the_commands_of_a_case_keep_the_attitudes_that_were_judged(folder):
    """Those at the times of its reference, which has every second one."""
    repinned(pinned(folder, stored()), "spin", every=2)
    suite = write_suite(folder, stored("spin", "spin.csv", 'bias = "1,0,0"'))
    check(suite, "--artifacts", folder / "failed")
    place = folder / "failed" / "spin"
    kept = len(quatprop.read_attitudes(place / "attitude.parquet").t_ns)
    _, propagate, _ = (place / "commands.txt").read_text().splitlines()
    run(*shlex.split(propagate)[1:], code=0)
    assert len(quatprop.read_attitudes(place / "attitude.parquet").t_ns) == kept == 500


def test_evidence_without_a_comparison_says_why(failing, folder, monkeypatch):
    """The sentence is text of the page, never markup."""

    def fails(*_arguments):
        raise ComparisonError("A turns <b>faster</b> & B does not")

    monkeypatch.setattr("quatprop.tools.check.case.compare", fails)
    assert check(failing, "--artifacts", folder / "failed").exit_code == 2
    sentence = (
        "the log's attitudes turns &lt;b&gt;faster&lt;/b&gt; &amp; the reference series does not"
    )
    page = (folder / "failed" / "a%2Fb" / "error.html").read_text()
    assert page.split("</h1>")[1].split("</body>")[0] == (
        f"\n<p>error: {sentence}</p>\n<p>there is nothing to draw, as nothing was compared</p>\n"
    )


def test_a_failure_is_reported_even_if_its_evidence_cannot_be_written(failing, folder):
    """The case has failed, and why, whatever the folder of artifacts is."""
    (folder / "failed").write_text("a file")
    result = check(failing, "--artifacts", folder / "failed")
    assert result.exit_code == 1
    assert "FAIL" in result.stdout
    _, why = next(line for line in result.stdout.splitlines() if "above" in line).split("above ")
    assert why.startswith("the tolerance, first at +")
    sentence = f"; its artifacts cannot be kept: {folder / 'failed'}: cannot be written: "
    assert why.partition(sentence)[2] == "Not a directory"
    (line,) = result.stderr.splitlines()
    assert line.startswith("the overview cannot be written: ")


# Reports for CI


@pytest.fixture
def mixed(folder):
    """Give a suite of which one case passes, one fails, and one cannot be judged."""
    others = stored() + stored("rest", "rest.parquet")
    pinned(folder, TRUTH + others)
    (folder / "logs" / "rest.parquet").unlink()
    return write_suite(folder, STRICT + others)


def test_junit_has_each_case(mixed, folder):
    """Counts, failures with their reasons, and the line in the suite."""
    target = folder / "junit.xml"
    assert check(mixed, "--junit", target).exit_code == 2
    first, second, *_, last = target.read_text().splitlines(keepends=True)
    assert (first[:5], second[:11], last) == ("<?xml", "<testsuites", "</testsuites>\n")
    root = ET.parse(target).getroot()  # noqa: S314  # our own file
    assert [root.get(key) for key in ("tests", "failures", "errors")] == list("311")
    (tests,) = root
    assert tests.get("skipped") == "0"
    assert [case.get("name") for case in tests] == ["coning", "spin", "rest"]
    failure, error = tests.find("./testcase/failure"), tests.find("./testcase/error")
    assert failure.get("message").startswith("above the tolerance, first at +")
    assert error.get("message").endswith("rest.parquet: no such file or folder; check the path")
    assert error.text.startswith(f"{mixed}:9\n")


def test_a_place_where_junit_cannot_go_is_reported_before_anything_runs(mixed, folder):
    """Not after an hour of cases; and a mistyped --junit does not cost a log."""
    log = folder / "logs" / "spin.csv"
    before = log.read_bytes()
    for target, words in (
        (folder / "none" / "junit.xml", f"there is no folder {folder / 'none'}; create it first"),
        (log, "this is an input of the run; choose another output"),
    ):
        result = check(mixed, "--junit", target)
        assert (result.exit_code, result.stdout) == (2, "")
        assert words in result.stderr
    assert log.read_bytes() == before


@pytest.fixture
def summary(folder, monkeypatch):
    """Give the summary of GitHub's runner, on which the command runs."""
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(folder / "summary.md"))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.chdir(folder)
    return folder / "summary.md"


@pytest.mark.usefixtures("mixed")
def test_github_gets_a_summary_and_annotations(summary):
    """The summary is appended to; annotations go to stderr; stdout stays JSON."""
    summary.write_text("before\n")
    result = check("suite.toml", "--json")
    counts = {"pass": 1, "fail": 1, "error": 1, "skip": 0, "xfail": 0, "xpass": 0, "deleted": 0}
    report = json.loads(result.stdout)
    assert (report["passed"], report["counts"]) == (False, counts)
    assert [case["updated"] for case in report["cases"]] == [None] * 3
    second, first = result.stderr.splitlines()
    assert first.startswith("::error file=suite.toml,line=1,title=coning%3A fail::")
    assert second == (
        "::error file=suite.toml,line=9,title=rest%3A error::logs/rest.parquet: no such file or "
        "folder; check the path"
    )
    lines = summary.read_text().splitlines()
    assert lines[:2] == ["before", "### suite.toml: 3 cases: 1 passed, 1 failed, 1 error"]
    assert lines[3:5] == ["| case | verdict | worst error | why |", "|---|---|---|---|"]
    assert [line.split(" | ")[:2] for line in lines[5:8]] == [
        ["| rest", ":warning: error"], ["| coning", ":x: failed"], ["| spin", "passed"],
    ]  # fmt: skip


MANY = 2000


def many(verdict="fail", count=MANY):
    """Return results, each with a reason of usual length."""
    reason = "above the tolerance, first at +1 s; likely cause: " + "the rates are larger " * 30
    return [CaseResult(f"case{k}", verdict, reason, "1 deg", error_rad=k) for k in range(count)]


def test_a_summary_is_shown_of_any_number_of_failures(tmp_path):
    """GitHub shows nothing of more than 1 MiB; the part that fits says how many are missing."""
    summary = tmp_path / "summary.md"
    for _ in range(2):
        append_github_summary(str(summary), Path("suite.toml"), many())
    text = summary.read_text()
    assert len(text.encode()) < 1 << 20
    assert text.startswith("### suite.toml: 2,000 cases: 0 passed, 2000 failed")
    rows = text.split("### ")[1].count("\n| case") - 1
    assert f"\n{MANY - rows:,} more cases for which there is no room here; see JUnit" in text
    assert f"|\n| case{MANY - 1} |" in text, "the worst comes first"


@pytest.mark.parametrize("count", [10, 11, MANY])
def test_ten_annotations_of_a_kind_are_shown(count):
    """GitHub drops the others silently; the tenth says how many there are."""
    results = [*many("fail", count), *many("deleted", count)]
    lines = [*github_annotations(Path("suite.toml"), results)]
    kinds = [line.split(" ")[0] for line in lines]
    assert kinds == ["::error"] * 10 + ["::warning"] * 10
    if count > 10:
        assert lines[9] == f"::error file=suite.toml,line=1::{count - 9} more cases, {count} in all"


def test_all_cases_are_seen_at_a_glance(failing, folder):
    """Worst first, each with its plot and, where there is one, a link to its page."""
    check(failing, "--artifacts", folder / "failed")
    page = (folder / "failed" / "index.html").read_text()
    first, second = page.split("<tbody>")[1].split("<tr>")[1:]
    (link,) = re.findall(r'<a href="(.*?)">a/b</a>', first)
    assert (folder / "failed" / unquote(link)).is_file()
    assert link == "a%252Fb/error.html"
    assert "0.0718199 deg</td>" in first
    ranks = [re.findall('data-key="([0-9]+)"', row)[:2] for row in (first, second)]
    assert [rank for rank, _ in ranks] == ["0", "1"]
    assert int(ranks[0][1]) > int(ranks[1][1])
    assert "<a " not in second
    assert "2 cases: 1 passed, 1 failed" in page
    assert page.count("<th scope") == page.count("<button>") == 5
    assert 'name="viewport"' in page
    case = (folder / "failed" / unquote(link)).read_text()
    (back,) = re.findall('<a href="(.*?)">all cases</a>', case)
    assert ((folder / "failed" / unquote(link)).parent / back).resolve() == (
        folder / "failed" / "index.html"
    ).resolve()
    assert case.count("likely cause") <= 1
    assert "http" not in page.replace("http-equiv", "")


@pytest.mark.parametrize(
    ("trace", "points"),
    [
        ((0.0, 1.0, 2.0), "1.0,31.0 80.0,16.0 159.0,1.0"),
        ((3.0,), "1.0,1.0"),
        ((0.0, 0.0), None),
        ((), None),
    ],
)
def test_a_small_plot_fills_its_frame(tmp_path, trace, points):
    """It has 160 x 32 dots, less half the width of the line; without an error there is none."""
    write_overview(tmp_path, Path("s.toml"), [CaseResult("a", "pass", trace=trace)])
    page = (tmp_path / "index.html").read_text()
    assert re.findall('points="(.*?)"', page) == ([points] if points else [])


def test_names_cannot_inject_markup(folder, summary):
    """Line breaks, bars and escapes in a name stay text in the terminal, the summary, and XML."""
    junit = folder / "junit.xml"
    suite = write_suite(folder, '[case."a\\n::error::|<b>\\u001b[31m"]\nlog = "logs/none.csv"\n')
    result = check(suite, "--junit", junit)
    assert result.exit_code == 2
    assert "\x1b" not in result.output
    assert not any(line.startswith("::error::") for line in result.output.splitlines())
    assert f"::error file={suite},line=1,title=" in result.stderr, "no line has this header"
    assert "| a\\\\n::error::\\|\\<b\\>\\\\x1b\\[31m |" in summary.read_text()
    (case,) = ET.parse(junit).getroot().iter("testcase")  # noqa: S314  # our own file
    assert case.get("name") == "a\\n::error::|<b>\\x1b[31m"
    check(suite, "--artifacts", folder / "failed")
    page = (folder / "failed" / "index.html").read_text()
    assert '<td data-key="a\\n::error::|&lt;b&gt;\\x1b[31m">a\\n::error::|&lt;b&gt;' in page
