"""Progress on a terminal: how much of what, how fast, and how long it will take."""

import os
import re
import sys

import pytest
from make.commands import run
from make.places import ROOT, SAMPLE_LOGS
from make.systems import on_posix

from quatprop.base.progress import with_progress
from quatprop.cli import summary as shown

pexpect = pytest.importorskip("pexpect")
pytestmark = on_posix

PROGRAM = """
import sys
from quatprop.cli import summary as progress
from quatprop.cli.commands import cli
progress.DELAY_S = float(sys.argv[1])
if __name__ == "__main__":
    for line in sys.argv[2:]:
        cli(line.split(), standalone_mode=False)
        print("\\n=====", flush=True)
"""
"""Several command lines, one after the other, which show progress after a delay."""


def on_terminal(folder, delay, *lines, **environment):
    """Return what a terminal gets of each of some command lines, in a folder of sample logs."""
    (folder / "program.py").write_text(PROGRAM)
    for path in SAMPLE_LOGS.iterdir():
        (folder / path.name).symlink_to(path)
    output, code = pexpect.run(
        " ".join([sys.executable, "program.py", str(delay), *(f"'{line}'" for line in lines)]),
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", **environment},
        withexitstatus=True,
        timeout=60,
    )
    assert code == 0, output
    return output.decode().split("\r\n=====\r\n")[:-1]


COUNTED = {
    "propagate spin.csv -o a.csv": "1.00k/1.00k",
    "info tumbling.bag": "1.00k/1.00k",
    "compare tumbling.truth.csv tumbling.truth.csv": "samples/s",
    "convert rest.truth.parquet b.csv": "3.00k/3.00k",
    "plot coning.mcap -o c.png": "/1.00k",
    "simulate d.csv --samples 100000": "/100k",
    "batch spin.csv coning.mcap -o e -j 1": "1/2 ",
    "propagate spin.csv -o f.csv -q": None,
}
BAR = r"( samples|log)/s|s/log"


def test_commands_show_how_much_is_done_and_how_fast(tmp_path):
    """With the total and the time that is left, and nothing of it stays; -q shows nothing."""
    outputs = on_terminal(tmp_path, -1, *COUNTED, TQDM_MININTERVAL="0")
    for output, counted in zip(outputs, COUNTED.values(), strict=True):
        if counted is None:
            assert output == ""
            continue
        bars = [line for line in re.split("[\r\n]+", output) if re.search(BAR, line)]
        assert any(counted in line for line in bars), output
        assert any(re.search(r"\d%\|.*\[\d\d:\d\d<[\d?]", line) for line in bars), output
        # A terminal shows the text after the last carriage return of a line.
        left = [line.rstrip("\r").rpartition("\r")[2] for line in output.split("\n")]
        assert not any(re.search(BAR, line) for line in left)


INDENTS = {
    "propagate tumbling.bag -o a.csv": 12,
    "compare tumbling.truth.csv tumbling.truth.csv": 10,
    "convert tumbling.truth.csv a.tum": 5,
}


def test_a_narrow_terminal_gets_long_lines_below_their_text(tmp_path, monkeypatch):
    """Words are not broken, and what is no terminal gets lines whole; nothing quick has bars."""
    outputs = on_terminal(tmp_path, 60, *INDENTS, COLUMNS="60")
    monkeypatch.chdir(tmp_path)
    for output, (line, indent) in zip(outputs, INDENTS.items(), strict=True):
        assert "samples/s" not in output
        lines = output.splitlines()
        assert any(one.startswith(" " * indent) and one[indent] != " " for one in lines)
        assert all(len(one) <= 60 or " " not in one.strip() for one in lines)
        assert max(map(len, run(*line.split(), code=0).output.splitlines())) > 60


def test_nothing_is_shown_where_stderr_is_no_terminal(monkeypatch, capsys):
    """Batches pass as they are."""
    monkeypatch.setattr(shown, "DELAY_S", -1.0)
    batches = iter(["ab", "c"])
    with shown.progress():
        assert with_progress(batches, 3) is batches
    assert capsys.readouterr().err == ""
