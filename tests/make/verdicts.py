"""The reports of `quatprop check` in every form, and contradictions between two forms."""

import html
import json
import math
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree as ET

import pyarrow.parquet as pq
from click.testing import CliRunner
from make.commands import run

from quatprop.cli.commands import cli

WORDS = {
    "pass": "pass", "fail": "FAIL", "error": "ERROR", "skip": "skip", "xfail": "xfail",
    "xpass": "XPASS", "deleted": "gone",
}  # fmt: skip
ELEMENTS = {"fail": "failure", "error": "error", "pass": None, "xpass": None}
KINDS = {"fail": "error", "error": "error", "xpass": "warning", "deleted": "warning"}
JENKINS = {
    "testsuites": {"name", "time", "tests", "failures", "errors"},
    "testsuite": {
        "name", "tests", "failures", "errors", "group", "time", "skipped", "timestamp", "hostname",
        "id", "package", "file", "log", "url", "version",
    },
    "testcase": {"name", "time", "classname", "group"},
    **{name: {"message", "type"} for name in ("failure", "error", "skipped")},
    "system-out": set(),
}  # fmt: skip
"""Elements of junit-10.xsd, of Jenkins' plugin and of pytest's tests, and their attributes."""


def code_of(verdicts):
    """Return the exit code that verdicts stand for."""
    return 2 if "error" in verdicts else int("fail" in verdicts)


def contradictions(suite, *options, evidence=True):
    """Run a suite, in each form; return its cases by name, and what contradicts their verdicts.

    `evidence`: look at what is kept of failures, and run its commands, too
    """
    folder = Path(suite).parent / "evidence"
    junit, summary = folder.with_suffix(".xml"), folder.with_suffix(".md")
    arguments = ["check", str(suite), "-v", *options]
    github = {"GITHUB_ACTIONS": "true", "GITHUB_STEP_SUMMARY": str(summary)}
    shown = CliRunner().invoke(cli, [*arguments, f"--junit={junit}"], env=github)
    place = [f"--artifacts={folder}"] if evidence else []
    kept = CliRunner().invoke(cli, [*arguments, "--json", *place])
    report = json.loads(kept.stdout)
    cases = {case["name"]: case for case in report["cases"]}
    verdicts = {name: case["verdict"] for name, case in cases.items()}
    wrong = [
        f"{what}: {got}, and the verdicts are {verdicts}"
        for what, got, expected in _totals(shown, report, junit, verdicts)
        if got != expected
    ]
    for name, case in cases.items():
        said = _said(name, case, shown, junit, summary)
        said += _evidence(case) if evidence else []
        wrong += [f"{name} is {case['verdict']}: {text}" for text, agrees in said if not agrees]
    return cases, wrong


def _totals(shown, report, junit, verdicts):
    """Yield the statements on all cases: where, what, and what it should be."""
    code, all_verdicts = code_of(verdicts.values()), list(verdicts.values())
    yield "exit code", shown.exit_code, code
    yield "passed in JSON", report["passed"], code == 0
    counts = {verdict: all_verdicts.count(verdict) for verdict in WORDS}
    yield "counts in JSON", report["counts"], counts
    root = ET.parse(junit).getroot()  # noqa: S314  # our own file
    skipped = sum(ELEMENTS.get(verdict, "skipped") == "skipped" for verdict in all_verdicts)
    expected = [len(verdicts), counts["fail"], counts["error"]]
    yield "JUnit", [int(root.get(key)) for key in ("tests", "failures", "errors")], expected
    yield "skipped in JUnit", int(root[0].get("skipped")), skipped
    odd = [(e.tag, *e.attrib) for e in root.iter() if not e.attrib.keys() <= JENKINS[e.tag]]
    yield "schema of JUnit", odd, []
    passed = f"{counts['pass']} passed"
    yield "last line", passed in shown.stdout.splitlines()[-1], True


def _said(name, case, shown, junit, summary):
    """Return the statements on a case: where, and whether each agrees with its verdict."""
    verdict = case["verdict"]
    lines = [line.split(maxsplit=2) for line in shown.stdout.splitlines() if line[0] != " "]
    (word,) = [line[0] for line in lines if line[1:2] == [name]]
    said = [(f"text {word}", word == WORDS[verdict])]
    (element,) = [e for e in ET.parse(junit).iter("testcase") if e.get("name") == name]  # noqa: S314
    inside = [child.tag for child in element if child.tag != "system-out"]
    expected = [ELEMENTS.get(verdict, "skipped")] if ELEMENTS.get(verdict, "skipped") else []
    said.append((f"JUnit {inside}", inside == expected))
    mark = re.findall(rf"^::(\w+) .*title={re.escape(name)}%3A (\w+)::", shown.stderr, re.MULTILINE)
    wanted = [(KINDS[verdict], verdict)] if verdict in KINDS else []
    if verdict == "pass" and case["unpinned"]:
        wanted = [("warning", "pass")]
    said.append((f"annotation {mark}", mark == wanted))
    said.append(("no row in the summary", f"\n| {name} | " in summary.read_text()))
    told = case["comparison"] and case["comparison"]["passed"]
    said.append(("the comparison fails", not (verdict in {"pass", "xpass"} and told is False)))
    return said


def _evidence(case):
    """Return what the evidence of a case says, and whether it agrees with its verdict."""
    place = case["evidence"] and Path(case["evidence"])
    comparison = case["comparison"]
    if not place:
        return [("no evidence", case["verdict"] not in {"fail", "xfail"} or not comparison)]
    page = html.unescape((place / "error.html").read_text())
    (lead,) = re.findall(r"<p>((?:fail|error|xfail): .*?)</p>", page)
    said = [(f"page {lead}", lead.startswith(f"{case['verdict']}: "))]
    said.append(("page has another reason", case["reason"].startswith(lead.partition(": ")[2])))
    if comparison:
        most = f"max {math.degrees(case['error_rad']):.4g} deg"
        said.append((f"page has not {most}", most in page))
    commands = [shlex.split(line) for line in (place / "commands.txt").read_text().splitlines()]
    before = pq.read_table(place / "attitude.parquet")
    codes = [run(*arguments) for _, *arguments in commands]
    expected = {"fail": 1, "error": 2, "xfail": 0}[case["verdict"]]
    said.append((f"commands.txt checks with {codes[0].exit_code}", codes[0].exit_code == expected))
    after = pq.read_table(place / "attitude.parquet")
    said.append(("commands.txt propagates otherwise", before.equals(after)))
    if comparison:
        name, *rest = commands[2][1:]
        told = json.loads(run(name, *rest, "--json").stdout)
        said.append(("commands.txt compares otherwise", told["worst"] == comparison["worst"]))
        code = codes[2].exit_code
        said.append((f"compare ends with {code}", (code == 1) == (comparison["passed"] is False)))
    return said
