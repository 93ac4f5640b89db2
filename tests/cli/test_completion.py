"""Completion in real shells, and what it offers."""

import os
import re
import select
import shutil
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete
from make.commands import INSTALLED, run
from make.joined_logs import join_mcap
from make.places import ROOT, SAMPLE_LOGS
from make.systems import on_posix

from quatprop.cli.commands import COMMANDS, cli
from quatprop.cli.completion import Bash

pexpect = pytest.importorskip("pexpect")
pytestmark = on_posix

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


def spawned(shell, folder, programs, **options):
    """Start a shell in a folder that finds programs in another."""
    environment = {
        "PATH": f"{programs}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "HOME": str(folder),
        "TERM": "xterm",
        "LANG": "C.UTF-8",
    }
    return pexpect.spawn(shell, START[shell], cwd=folder, env=environment, timeout=60, **options)


@pytest.mark.parametrize("shell", START)
def test_a_line_is_completed_word_by_word(shell, tmp_path):
    """To the topic or columns of the file; then the line runs, and no name in it is executed."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    command = "$(touch PWNED)"
    shutil.copy(SAMPLE_LOGS / "tumbling.bag", tmp_path / "walk.bag")
    rows = "".join(f"{k},0,0,1\n" for k in range(5))
    (tmp_path / f"log{command}.csv").write_text(f"{command},wx,wy,wz\n{rows}")
    terminal = spawned(shell, tmp_path, INSTALLED.parent, dimensions=(40, 200))
    terminal.sendline(f"{ENABLE[shell]} && echo rea''dy")
    terminal.expect("ready")
    columns = "-q -o b.csv --rate-unit rad/s --time-unit ns --rate-cols wx,wy,wz --time-col '$(t"
    for words, end in (
        (("quatprop propa", "wal", "--metho", "coni", "--mount frd", "-t "), "-o a.csv -q"),
        (("quatprop propagate lo", columns), ""),
    ):
        for typed in words:
            terminal.send(typed + "\t")
            terminal.expect(".+")
        terminal.sendline(f"{end}; echo do''ne")
        terminal.expect("done")
    terminal.close()
    names = sorted(path.name for path in tmp_path.iterdir() if path.name[0] != ".")
    assert names == ["a.csv", "b.csv", f"log{command}.csv", "walk.bag"]
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1001


def offered(*words):
    """Return what is offered for the last word: values, or the kind of a path."""
    *before, incomplete = words
    found = ShellComplete(cli, {}, "quatprop", "_").get_completions(before, incomplete)
    return [item.value if item.type == "plain" else item.type for item in found]


OFFERED = {
    "co": ["convert", "compare", "completion"],
    "--v": ["--version"],
    # An unknown command was a traceback in the terminal.
    "propagat co": ["convert", "compare", "completion"],
    "propagate x": ["file"],
    "propagate x.bag -o y": ["file"],
    "propagate x.bag --on-g": ["--on-gap"],
    "propagate x.bag --q0 w": ["file"],
    "propagate x.bag --start ": [],
    "propagate coning.mcap --topic=": ["/imu"],
    "compare spin.csv coning.mcap --topic-b=": ["/imu"],
    "propagate none.bag -t ": [],
    "propagate - -t ": [],
    "propagate s3://b/log.bag -t ": [],
    "propagate coning.mcap -t ": ["/imu"],
    "propagate -t ": [],
    "info coning.mcap rest.parquet --rate-field ang": ["angular_velocity"],
    "plot coning.mcap -t /": ["/imu"],
    "info coning.mcap:/imu --rate-field ang": ["angular_velocity"],
    "propagate x.bag --q0 le": ["level", "file"],
    "propagate x.bag --bias st": ["static", "static:nearest", "static:interpolate", "file"],
    "propagate x.bag --bias static:": ["static:nearest", "static:interpolate", "file"],
    "propagate x.bag --mount frd": ["frd-to-flu"],
    "convert a.csv b.csv --left n": ["ned-to-enu"],
    "compare a.csv b.csv --time-offset a": ["auto"],
    "plot a.csv --reference b.csv --time-offset a": ["auto"],
    "propagate x.bag --series a": ["all"],
    "propagate x.csv --time-col n": ["none"],
    "propagate x.bag --rate-unit d": ["deg/s"],
    "propagate spin.csv -t ": [],
    "propagate spin.csv --time-col ": ["none", "t_ns", "wx", "wy", "wz"],
    "simulate --bias s": [],
    "propagate spin.csv --rate-cols wx,w": ["wx,wy", "wx,wz"],
    "compare spin.csv spin.truth.csv --quat-cols-b qw,qx,": ["qw,qx,t_ns", "qw,qx,qy", "qw,qx,qz"],
    "compare spin.csv spin.truth.csv --time-col-a w": ["wx", "wy", "wz"],
    "plot coning.mcap --reference spin.truth.csv --time-col-ref t": ["t_ns"],
}


@pytest.mark.parametrize(("line", "values"), OFFERED.items())
def test_completion_offers_names_from_the_log(monkeypatch, line, values):
    """They come from the log on the line; without one there are none."""
    monkeypatch.chdir(SAMPLE_LOGS)
    assert offered(*line.split(" ")) == values


@pytest.mark.parametrize(
    ("line", "topics"),
    [
        ("propagate LOG -t", ["/imu"]),
        ("convert LOG out.csv -t", ["/attitude", "/imu"]),
        ("compare spin.csv LOG --topic-b", ["/attitude", "/imu"]),
        ("plot LOG --reference spin.csv -t", ["/imu", "/attitude"]),
        ("plot spin.csv --reference LOG --topic-ref", ["/imu", "/attitude"]),
    ],
)
def test_topics_are_those_that_the_command_reads(tmp_path, line, topics):
    """Of a log with rates, and with attitudes, which an Imu may have as well."""
    coning, alone = SAMPLE_LOGS / "coning.mcap", tmp_path / "alone.mcap"
    run("propagate", coning, "-o", alone, "-q", code=0)
    log = join_mcap(tmp_path / "both.mcap", coning, alone)
    assert offered(*line.replace("LOG", str(log)).split(), "") == topics


def test_commands_are_offered_without_importing_them():
    """Completion is quick."""
    code = (
        "import sys; from quatprop.cli import run; sys.argv = ['quatprop']\n"
        "try: run()\n"
        "finally: print(sorted({'numpy', 'quatprop.cli.plot'} & set(sys.modules)))"
    )
    words = {"COMP_LINE": "quatprop ", "_QUATPROP_COMPLETE": "bash_complete"}
    out = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **words},
        capture_output=True,
        text=True,
        check=False,
    ).stdout.splitlines()
    assert out == [*(f"plain,{name}" for name in COMMANDS), "[]"]


HOSTILE = [
    "$(touch PWNED)", "$(touch${IFS}PWNED)", "`touch PWNED`", "a;touch PWNED", "a&touch PWNED",
    "a|touch PWNED", 'a"$(touch PWNED)', "a';touch PWNED;'", "a' && touch PWNED #", "<(touch x)",
    ">PWNED", "a>PWNED", "#comment", "~", "~root", "a:~", "*", "?", "[ab]*", "{a,b}", "!!", "!q",
    "a!b", "it's", "'", '"', 'a"b', "'!'", "\\", "a\\", "a\\ b", "\\\\", "\\'", '\\"', "$HOME",
    "${x", "$'x'", " ", "a b", " a", "a ", "-x", "--", "=", "a=b", "a:b:c", "a,b", "^a^b", "%1",
    "@host", "/imu/äß", "日本", "😀 x", "e\u0301",
]  # fmt: skip
"""Names that mean something to a shell."""

QUOTES = pytest.mark.parametrize("quote", ["", "'", '"'], ids=["bare", "single", "double"])
BASH = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
FAKE = """#!/bin/sh
if [ -n "$_QUATPROP_COMPLETE" ]; then
  printf "%s\\0" "$COMP_LINE" "$COMP_REPLACED" > asked; cat answer
else printf "%s\\0" "$@" > asked; fi
"""


class Terminal:
    """An interactive bash whose ``quatprop`` is answered by this process, which is quick."""

    def __init__(self, folder):
        self.folder = folder
        fake = folder / "bin" / "quatprop"
        fake.parent.mkdir()
        fake.write_text(FAKE)
        fake.chmod(0o700)
        for name in ("asked", "answer"):
            os.mkfifo(folder / name)
        self.asked = os.open(folder / "asked", os.O_RDWR | os.O_NONBLOCK)
        variable = "_QUATPROP_COMPLETE"
        names = {"complete_func": "_c", "complete_var": variable, "prog_name": "quatprop"}
        (folder / "script").write_text(Bash(cli, {}, "quatprop", variable).source_template % names)
        self.bash = spawned("bash", folder, fake.parent, dimensions=(40, 500))
        self.bash.delaybeforesend = None
        self.bash.sendline("source ./script; bind 'set bell-style none'; echo rea''dy")
        self.bash.expect("ready")

    def received(self):
        """Return what the next run of ``quatprop`` tells."""
        shown = ""
        while self.asked not in (ready := select.select([self.asked, self.bash], [], [], 60)[0]):
            assert ready, f"bash has not run quatprop: {shown[-200:]}"
            shown += self.bash.read_nonblocking(99999).decode(errors="replace")
        return os.read(self.asked, 4096).decode().split("\0")[:-1]

    def tab(self, typed, monkeypatch):
        """Type something and a tab, and answer."""
        self.bash.send(typed + "\t")
        line, replaced = self.received()
        answer = completed(monkeypatch, line, replaced)
        (self.folder / "answer").write_text(answer)
        return answer

    def enter(self):
        """Run the line; return the arguments."""
        self.bash.send("\r")
        return self.received()


def completed(monkeypatch, line, replaced):
    """Return what bash is answered."""
    monkeypatch.setenv("COMP_LINE", line)
    monkeypatch.setenv("COMP_REPLACED", replaced)
    return Bash(cli, {}, "quatprop", "_").complete()


@pytest.fixture(scope="module")
def terminal(tmp_path_factory):
    """Return a terminal that several tests use."""
    terminal = Terminal(tmp_path_factory.mktemp("terminal"))
    yield terminal
    terminal.bash.close(force=True)
    os.close(terminal.asked)


def begun(name, count, quote):
    """Return how the first characters of a name are typed, in a quote or not."""
    stop = {"'": "'", '"': "!"}.get(quote, "")
    count = min([count, *(name.index(mark) for mark in stop if mark in name)])
    count = 0 if name.startswith("-") else count
    special = {"": r"(\W)", '"': r"([$`\"\\])", "'": "()$"}[quote]
    return quote + re.sub(special, r"\\\1" if quote != "'" else "", name[:count])


@BASH
@QUOTES
def test_bash_takes_a_completed_name_as_it_is(terminal, monkeypatch, quote):
    """Names from logs were inserted without quotes: completing ``$(command)`` ran the command."""
    for number, name in enumerate(HOSTILE):
        monkeypatch.setattr("quatprop.cli.completion._names_in", lambda *_, name=name: [name])
        typed = begun(name, number % 3, quote)
        if number % 4 == 0:
            typed += f"{quote}\2" * bool(quote)  # the cursor goes back before the quote
        option = "--topic=" if number % 5 == 0 else "-t "
        answer = terminal.tab(f"quatprop propagate x.csv {option}{typed}", monkeypatch)
        assert answer, (name, typed)
        ran = terminal.enter()
        given = [f"--topic={name}"] if number % 5 == 0 else ["-t", name]
        assert ran == ["propagate", "x.csv", *given], (name, typed, answer)
    assert not (terminal.folder / "PWNED").exists()


@BASH
@QUOTES
def test_bash_goes_on_where_names_differ(terminal, monkeypatch, quote):
    """The common beginning of several names is inserted, in the open quote."""
    names = ["$(touch PWNED) a", "$(touch PWNED) b'\"\\"]
    monkeypatch.setattr("quatprop.cli.completion._names_in", lambda *_: names)
    terminal.tab(f"quatprop propagate x.csv -t {quote}", monkeypatch)
    terminal.tab("b", monkeypatch)
    assert terminal.enter()[-1] == names[1]
    assert not (terminal.folder / "PWNED").exists()


@pytest.mark.parametrize("typed", ["$'x", "$(x", "`x", '"$x', '"`x', "<(x", "a;x", 'a"b$('])
def test_words_that_bash_would_expand_are_not_completed(monkeypatch, typed):
    """Which quotes are open in it is not known."""
    monkeypatch.setattr("quatprop.cli.completion._names_in", lambda *_: [typed + "y", "$x", "x"])
    for replaced in ("", typed[-1:], typed):
        assert completed(monkeypatch, f"quatprop propagate x.csv -t {typed}", replaced) == ""


def test_names_that_would_command_the_terminal_are_not_offered(monkeypatch):
    """A line break would end a name, and a list of names would be obeyed by the terminal."""
    names = ["", *(f"a{chr(code)}b" for code in range(256)), "a\u202eb", "a\u2028b", "a\udc80b"]
    monkeypatch.setattr("quatprop.cli.completion._names_in", lambda *_: names)
    found = offered("propagate", "x.csv", "-t", "")
    ascii_letters = "".join(name[1:-1] for name in found if name.isascii())
    assert ascii_letters == "".join(map(chr, range(32, 127)))
    assert all(name.isprintable() for name in found)


def test_a_script_of_click_for_bash_gets_nothing(monkeypatch):
    """It would split and expand what it gets."""
    monkeypatch.setenv("COMP_WORDS", "quatprop prop")
    monkeypatch.setenv("COMP_CWORD", "1")
    monkeypatch.delenv("COMP_LINE", raising=False)
    assert Bash(cli, {}, "quatprop", "_").complete() == ""


def test_bash_completes_file_names_itself(monkeypatch):
    """It knows their names itself."""
    assert completed(monkeypatch, "quatprop propagate x", "x") == "file,"


@pytest.mark.parametrize(
    ("shell", "word"), [("bash", "COMP_LINE"), ("zsh", "#compdef"), ("fish", "commandline -t")]
)
def test_each_shell_has_its_script(shell, word):
    """With the variable that asks quatprop for values."""
    script = run("completion", shell, code=0).stdout
    assert word in script
    assert "_QUATPROP_COMPLETE" in script
