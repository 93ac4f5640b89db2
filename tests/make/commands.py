"""Running quatprop as users do: in this process, unless the process is what is tested."""

import os
import re
import subprocess
import sys
from pathlib import Path

from click.testing import CliRunner

from quatprop.cli.commands import cli

INSTALLED = Path(sys.executable).with_name("quatprop")


def run(*arguments, code=None, **options):
    """Run a command line in this process; return the result, which has the code if one is given."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments], **options)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert code is None or result.exit_code == code, result.output
    return result


def refused(*arguments, **options):
    """Return the one sentence with which a command line is refused."""
    result = run(*arguments, code=2, **options)
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1, result.stderr
    return result.stderr.removesuffix("\n")


ABOUT = r"(Error: )?(Invalid value: |Invalid value for '--[\w-]+': |\S+: )?"
"""The beginning of a refusal: the option or the file that it is about."""


def begins(said, sentence):
    """Return whether a refusal begins with a sentence, of which `...` stands for a part."""
    pattern = ".*".join(map(re.escape, re.split(r" ?\.\.\. ?", sentence)))
    return re.match(ABOUT + pattern, said) is not None


def installed(*arguments, **options):
    """Run the installed command in a process of its own."""
    environment = {**os.environ, "QUATPROP_TRACEBACK": "", **options.pop("env", {})}
    return subprocess.run(
        [INSTALLED, *map(str, arguments)],
        check=False,
        **{"env": environment, "capture_output": True, "text": True} | options,
    )
