"""Progress on a terminal: how much of what, how fast, and how long it will take."""

import os
import re
import subprocess
import sys

import pytest
from make.places import ROOT

from quatprop.cli import progress as shown
from quatprop.progress import with_progress

pexpect = pytest.importorskip("pexpect")
SAMPLES = ROOT / "sample_logs"

BAR = r"( samples|log)/s|s/log"

PROGRAM = """
import sys
from quatprop.cli import progress, main
progress.DELAY_S = -1.0
if __name__ == "__main__":
    main()
"""
"""The command line, which shows progress from the beginning."""


def on_terminal(folder, *arguments):
    """Return what a terminal gets of a command."""
    output, code = pexpect.run(
        f"{sys.executable} {folder / 'program.py'} {' '.join(map(str, arguments))}",
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "TQDM_MININTERVAL": "0"},
        withexitstatus=True,
        timeout=60,
    )
    assert code == 0, output
    return output.decode()


@pytest.mark.parametrize(
    ("arguments", "counted"),
    [
        (("propagate", SAMPLES / "spin.csv", "-o", "a.csv"), "1.00k/1.00k"),
        (("info", SAMPLES / "tumbling.bag"), "1.00k/1.00k"),
        (("compare", SAMPLES / "tumbling.truth.csv", SAMPLES / "tumbling.truth.csv"), "samples/s"),
        (("convert", SAMPLES / "rest.truth.parquet", "b.csv"), "3.00k/3.00k"),
        (("plot", SAMPLES / "coning.mcap", "-o", "c.png"), "/1.00k"),
        (("simulate", "d.csv", "--samples", "100000"), "/100k"),
        (("batch", SAMPLES / "spin.csv", SAMPLES / "coning.mcap", "-o", "e"), "1/2 "),
    ],
)
def test_commands_show_how_much_is_done_and_how_fast(tmp_path, arguments, counted):
    """With the total and the time that is left, and nothing of it stays."""
    (tmp_path / "program.py").write_text(PROGRAM)
    output = on_terminal(tmp_path, *arguments)
    bars = [line for line in re.split("[\r\n]+", output) if re.search(BAR, line)]
    assert any(counted in line for line in bars), output
    assert any(re.search(r"\d%\|.*\[\d\d:\d\d<[\d?]", line) for line in bars), output
    # What a line shows in the end comes after its last return.
    left = [line.rstrip("\r").rpartition("\r")[2] for line in output.split("\n")]
    assert not any(re.search(BAR, line) for line in left)


def test_a_quick_run_shows_nothing(tmp_path):
    """Nothing is shown of what takes less than half a second, or asks for quiet."""
    (tmp_path / "program.py").write_text(PROGRAM.replace("-1.0", "60.0"))
    output = on_terminal(tmp_path, "propagate", SAMPLES / "spin.csv", "-o", "a.csv")
    assert "samples/s" not in output
    (tmp_path / "program.py").write_text(PROGRAM)
    assert on_terminal(tmp_path, "propagate", SAMPLES / "spin.csv", "-o", "b.csv", "-q") == ""


def test_nothing_is_shown_where_stderr_is_no_terminal(monkeypatch, capsys):
    """Batches pass as they are."""
    monkeypatch.setattr(shown, "DELAY_S", -1.0)
    batches = iter(["ab", "c"])
    with shown.progress():
        assert with_progress(batches, 3) is batches
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "indent"),
    [
        (("propagate", SAMPLES / "tumbling.bag", "-o", "a.csv"), 12),
        (("compare", SAMPLES / "tumbling.truth.csv", SAMPLES / "tumbling.truth.csv"), 10),
        (("convert", SAMPLES / "tumbling.truth.csv", "a.tum"), 5),
    ],
)
def test_long_lines_go_on_below_their_text_on_a_narrow_terminal(tmp_path, arguments, indent):
    """Words are not broken, and what is no terminal gets each line whole."""
    text = pexpect.run(
        f"{sys.executable} -m quatprop {' '.join(map(str, arguments))}",
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "60"},
        timeout=60,
    )
    lines = text.decode().splitlines()
    assert any(line.startswith(" " * indent) and line[indent] != " " for line in lines)
    assert all(len(line) <= 60 or " " not in line.strip() for line in lines)
    command = [sys.executable, "-m", "quatprop", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)
    assert max(map(len, (done.stdout + done.stderr).splitlines())) > 60
