"""The examples of the commands and of the documents do what they show."""

import shlex

from make.commands import run
from make.places import ROOT

from quatprop.cli.commands import COMMANDS, cli


def test_the_examples_of_every_command_run(tmp_path, monkeypatch):
    """One after the other, in a folder that has the sample logs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    for name in COMMANDS:
        examples = cli.get_command(None, name).examples
        assert examples, name
        for line in examples:
            program, *arguments = shlex.split(line)
            assert program == "quatprop"
            run(*arguments, code=0)
