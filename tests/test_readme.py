"""What the README shows is what happens."""

import re
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from quatprop import RemarkWarning

ROOT = Path(__file__).parent.parent
SECTION = (ROOT / "README.md").read_text().split("## One log in")[1].split("\n## ")[0]


def shown():
    """Return each command of the section, and what is shown of it."""
    (block,) = [part.split("```")[0] for part in SECTION.split("```console\n")[1:] if "$ " in part]
    for text in block.split("$ ")[1:]:
        command, _, output = text.partition("\n")
        yield command, output.rstrip("\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the sample logs, as a clone has them."""
    place = tmp_path_factory.mktemp("clone")
    (place / "sample_logs").symlink_to(ROOT / "sample_logs")
    return place


@pytest.mark.parametrize(("command", "output"), list(shown()))
def test_the_first_commands_say_what_is_shown(folder, command, output):
    """To the letter, on stdout or stderr."""
    name, *arguments = shlex.split(command)
    program = [sys.executable, "-m", "quatprop"] if name == "quatprop" else [name]
    done = subprocess.run(
        [*program, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )
    assert (done.stdout + done.stderr).rstrip("\n") == output


def test_the_library_section_runs(folder, monkeypatch, capsys):
    """Every line of Python, one block after the other."""
    readme = (ROOT / "README.md").read_text()
    section = readme.split("## From Python")[1].split("\n## ")[0]
    monkeypatch.chdir(folder)
    names, made = {}, []
    for block in re.findall(r"```python\n(.*?)```", section, re.DOTALL):
        with warnings.catch_warnings():
            # The rates of the sample log are frozen, as quatprop remarks.
            warnings.simplefilter("ignore", RemarkWarning)
            exec(block, names)  # noqa: S102  # the README is ours
        made += [names.pop("made")] if "made" in names else []
    samples, passed, recorded = capsys.readouterr().out.splitlines()
    assert samples.startswith("1000 [-9.99772140e-01 ")
    assert passed.startswith("True 0.0001")
    assert recorded == "coning [1.0, 0.0, 0.0, 0.0]"
    assert [facts["convention"]["method"] for facts in made] == ["coning"] * 3
    assert len(names["attitudes"]) == 1000
    assert (folder / "euler.csv").read_text().startswith("t_ns,yaw_deg,pitch_deg,roll_deg\n")


def test_the_contents_name_every_section():
    """Each heading once, in order, with the anchor that it has."""
    readme = (ROOT / "README.md").read_text()
    contents = readme.split("\nContents: ")[1].split("\n\n")[0]
    heads = re.findall(r"^## (.*)$", readme, re.MULTILINE)
    anchors = [re.sub(r"[^a-z0-9 -]", "", head.lower()).replace(" ", "-") for head in heads]
    assert re.findall(r"\[(.*?)\]\(#(.*?)\)", contents) == list(zip(heads, anchors, strict=True))
