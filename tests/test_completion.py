"""Completion in real shells, and what it offers."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from quatprop.cli.commands import COMMANDS, cli

pexpect = pytest.importorskip("pexpect")

ROOT = Path(__file__).parent.parent
SAMPLES = ROOT / "sample_logs"

START = {
    "bash": ["--norc", "--noprofile", "-i"],
    "zsh": ["-f", "-i"],
    "fish": ["--no-config", "-i"],
}
ENABLE = {
    "bash": "source <(quatprop completion bash)",
    "zsh": "autoload -U compinit && compinit -u -D && source <(quatprop completion zsh)",
    "fish": "quatprop completion fish | source",
}


@pytest.mark.parametrize("shell", START)
def test_a_line_is_completed_word_by_word(shell, tmp_path):
    """Command, file, option, choice, and the topic from the file; then the line runs."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    shutil.copy(SAMPLES / "tumbling.bag", tmp_path / "walk.bag")
    environment = {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "HOME": str(tmp_path),
        "TERM": "xterm",
        "LANG": "C.UTF-8",
    }
    terminal = pexpect.spawn(
        shell, START[shell], cwd=tmp_path, env=environment, dimensions=(40, 200), timeout=60
    )
    terminal.sendline(f"{ENABLE[shell]} && echo rea''dy")
    terminal.expect("ready")
    for typed in ("quatprop propa", "wal", "--metho", "coni", "-t "):
        terminal.send(typed + "\t")
        terminal.expect(".+")
    terminal.sendline("-o out.csv -q && echo do''ne")
    terminal.expect("done")
    terminal.close()
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 1001


def offered(*words):
    """Return what is offered for the last word: values, or the kind of a path."""
    *before, incomplete = words
    found = ShellComplete(cli, {}, "quatprop", "_").get_completions(before, incomplete)
    return [item.value if item.type == "plain" else item.type for item in found]


@pytest.mark.parametrize(
    ("words", "values"),
    [
        (["co"], ["convert", "compare", "completion"]),
        (["propagate", "x"], ["file"]),
        (["propagate", "x.bag", "-o", "y"], ["file"]),
        (["propagate", "x.bag", "--on-g"], ["--on-gap"]),
        (["propagate", "x.bag", "--q0", "w"], ["file"]),
        (["propagate", "x.bag", "--start", ""], []),
        (["propagate", "none.bag", "-t", ""], []),
        (["propagate", "-", "-t", ""], []),
        (["propagate", "s3://b/log.bag", "-t", ""], []),
        (["propagate", "coning.mcap", "-t", ""], ["/imu"]),
        (["propagate", "-t", ""], []),
        (["info", "coning.mcap", "rest.parquet", "--rate-field", "ang"], ["angular_velocity"]),
        (["plot", "coning.mcap", "-t", "/"], ["/imu"]),
        (["propagate", "spin.csv", "-t", ""], []),
        (["propagate", "spin.csv", "--time-col", ""], ["t_ns", "wx", "wy", "wz"]),
        (["propagate", "spin.csv", "--rate-cols", "wx,w"], ["wx,wy", "wx,wz"]),
        (["compare", "spin.csv", "spin.truth.csv", "--quat-cols-b", "qw,qx,"],
         ["qw,qx,t_ns", "qw,qx,qy", "qw,qx,qz"]),
        (["compare", "spin.csv", "spin.truth.csv", "--time-col-a", "w"], ["wx", "wy", "wz"]),
        (["plot", "coning.mcap", "--reference", "spin.truth.csv", "--time-col-ref", "t"], ["t_ns"]),
    ],
)  # fmt: skip
def test_what_is_offered(monkeypatch, words, values):
    """Names come from the log on the line that the option is about; without one there are none."""
    monkeypatch.chdir(SAMPLES)
    assert offered(*words) == values


def test_commands_are_offered_without_importing_them():
    """Completion is quick."""
    code = (
        "import sys; from quatprop.cli import run; sys.argv = ['quatprop']\n"
        "try: run()\n"
        "finally: print(sorted({'numpy', 'quatprop.cli.plot'} & set(sys.modules)))"
    )
    words = {"COMP_WORDS": "quatprop ", "COMP_CWORD": "1", "_QUATPROP_COMPLETE": "bash_complete"}
    out = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **words},
        capture_output=True,
        text=True,
        check=False,
    ).stdout.splitlines()
    assert out == [*(f"plain,{name}" for name in COMMANDS), "[]"]
