"""The examples of the commands and of the documents do what they show."""

import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from make.commands import run
from make.documents import GUIDES, Document
from make.places import ROOT, SAMPLE_LOGS, SHARED_LOGS
from make.systems import on_posix

from quatprop.cli.commands import COMMANDS, cli


def test_the_examples_of_every_command_run(tmp_path, monkeypatch):
    """One after the other, in an empty folder: a log that they need is simulated before."""
    for name in COMMANDS:
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        examples = cli.get_command(None, name).examples
        assert examples, name
        for line in examples:
            program, *arguments = shlex.split(line)
            assert program == "quatprop"
            run(*arguments, code=0)


def test_a_first_week_of_python(tmp_path):
    """Sixty calls as users write them, in threads and in processes, where warnings are errors."""
    script = ROOT / "tests" / "examples" / "first_week.py"
    command = [sys.executable, "-W", "error", script, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("error: missing.csv: no such file")


ELSEWHERE = {"development", "fleets", "library", "recipes"}
"""Guides of which examples/test_documents.py runs what is in them."""


LONG = ("rover.bag",)
"""Recordings of several sensors, of which the commands take half a minute."""


@pytest.mark.parametrize(
    ("name", "left_out"),
    [
        *((path.stem, LONG) for path in sorted(GUIDES.glob("*.md")) if path.stem not in ELSEWHERE),
        pytest.param("crosscheck", (), marks=pytest.mark.thorough(keep=0)),
    ],
)
def test_commands_of_guides_print_what_is_shown(name, left_out, tmp_path, monkeypatch):
    """To the letter; where nothing is shown, they end well, or as it says."""
    if name == "ci" and not shutil.which("git"):
        pytest.skip("its last sections merge with git")
    monkeypatch.setenv("COLUMNS", "200")
    recordings = SHARED_LOGS if SHARED_LOGS.is_dir() else None
    document = Document(GUIDES / f"{name}.md", tmp_path, recordings, left_out)
    assert document.run() == document.text


@on_posix
@pytest.mark.skipif(not shutil.which("awk"), reason="the demo needs a shell with awk")
def test_the_demo_shows_the_error_of_every_log(tmp_path, monkeypatch):
    """Each line of its table has a log, a method, and the same angle in rad and in deg."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SAMPLE_LOGS, "sample_logs")
    # Its commands are run by this process, which has imported everything.
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    Path("quatprop").write_text('#!/bin/sh\nprintf "%s\\n" "$@" > asked\nexec cat answer\n')
    Path("quatprop").chmod(0o700)
    for name in ("asked", "answer"):
        os.mkfifo(name)
    script = "sample_logs/demo.sh > shown; echo $? > code; : > asked"
    with subprocess.Popen(["/bin/sh", "-c", script], start_new_session=True) as demo:
        try:
            while words := Path("asked").read_text():
                Path("answer").write_text(run(*words.splitlines(), code=0).stdout)
        except BaseException:
            os.killpg(demo.pid, signal.SIGKILL)
            raise
    assert Path("code").read_text() == "0\n"
    rows = [line.split() for line in Path("shown").read_text().splitlines()]
    rows = [row for row in rows if row[-1:] == ["deg"]]
    table = [row for row in rows if len(row) == 6 and row[1] != "%"]
    assert len(table) == 9
    for _log, _method, radians, _rad, degrees, _deg in table:
        assert math.degrees(float(radians)) == pytest.approx(float(degrees), rel=1e-5, abs=1e-12)
