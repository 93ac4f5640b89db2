"""Help: groups of options, one screen of common ones, defaults."""

import re

import pytest
from click.testing import CliRunner
from make.commands import run

from quatprop.cli.commands import COMMANDS, GROUPS, cli
from quatprop.settings import PROPAGATE
from quatprop.settings.command_options import COMPARE
from quatprop.settings.reading import READ_ATTITUDES

SCREEN = 60
"""Lines of a terminal window."""


def shown(*arguments, width=80, **environment):
    """Return what quatprop shows on a terminal of this width."""
    runner = CliRunner(env=environment)
    options = {"prog_name": "quatprop", "color": True, "terminal_width": width}
    result = runner.invoke(cli, arguments, **options)
    assert result.exit_code == 0
    return result.output


def test_every_setting_has_a_group_in_help():
    """Its row says which, and that is one of those that help has."""
    keywords = {**PROPAGATE, **COMPARE, **READ_ATTITUDES}.values()
    assert {keyword.group for keyword in keywords} <= {*GROUPS}


def test_help_lists_the_commands_there_are():
    """Each with its words."""
    listed = shown("--help")
    assert all(name in listed and words[:30] in listed for name, words in COMMANDS.items())


@pytest.mark.parametrize("name", sorted({*COMMANDS} - {"simulate"}))
def test_a_command_alone_shows_its_help(name):
    """All need a log, or a word, but one."""
    assert run(name, code=2).stderr == run(name, "--help", code=0).stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_help_with_its_default(name):
    """Each says what it does, and its default where it takes a value."""
    for option in cli.get_command(None, name).params:
        if option.param_type_name == "option":
            assert option.help, option.name
            has_default = option.show_default or "[default:" in option.help
            assert option.is_flag or option.required or has_default, option.name


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("width", [80, 120])
def test_help_fits_the_terminal(name, width):
    """Every line fits, examples and long lists of choices too; common options are one screen."""
    common = shown(name, "--help", width=width, NO_COLOR="1").splitlines()
    assert name == "check" or len(common) <= SCREEN
    whole = shown(name, "--help-all", width=width, NO_COLOR="1").splitlines()
    assert max(map(len, [*common, *whole])) <= width
    assert width == 80 or max(map(len, whole)) > 80


@pytest.mark.parametrize("name", COMMANDS)
def test_help_lists_the_options_of_its_examples(name):
    """Those of convert used three that only --help-all had."""
    listed = shown(name, "--help", NO_COLOR="1").partition("Examples:")[2]
    for example in cli.get_command(None, name).examples:
        if example.startswith(f"quatprop {name} "):
            for option in re.findall(r" (--?[a-z][a-z-]*)", example):
                assert re.search(rf"(?m)^  .*{option}[ ,]", listed.partition("\n\n")[2]), option


@pytest.mark.parametrize("name", COMMANDS)
def test_both_helps_give_the_same_defaults(name):
    """The short one cut "start; end where the samples are averages" down to "start"."""

    def defaults(which):
        text = " ".join(shown(name, which, width=400, NO_COLOR="1").split())
        return set(re.findall(r"\[default: .*?\]", text))

    assert defaults("--help") <= defaults("--help-all")


def test_help_names_what_it_refers_to_and_the_terms_of_the_field():
    """It mentioned "the next three options", and called a bias "bias instability"."""
    text = shown("propagate", "--help", NO_COLOR="1")
    assert re.search(r"--start TIME +Use LOG from here  \[default: all\]\n", text)
    text = " ".join(shown("plot", "--help-all", width=400, NO_COLOR="1").split())
    assert "next three" not in text
    assert "--rms-tol, --final-tol and --p95-tol take the same" in text
    assert "Angle random walk" in shown("simulate", "--help", NO_COLOR="1")
    text = " ".join(shown("propagate", "--help-all", NO_COLOR="1").split())
    assert "the turn-on repeatability, not the bias instability" in text


def test_long_examples_go_on_in_a_second_line():
    """They can be copied as they are."""
    text = shown("check", "--help", width=48, NO_COLOR="1")
    first = "  quatprop check suite.toml --init demo.bag"
    assert f"\n{first} \\\n    spin.csv\n" in text


RATES = "--topic --rate-cols --rate-unit --start --end"
PROPAGATE_OPTIONS = (
    f"{RATES} --bias --mount --q0 --method --on-backwards --on-gap --output --to --layout --with "
    "--rate --sigma"
)
ERRORS = "--tol --align --time-offset --window"
COMMON = {
    "info": "--topic --rate-cols --rate-unit --json --as-config",
    "propagate": f"{PROPAGATE_OPTIONS} --plot --quiet",
    "batch": f"{PROPAGATE_OPTIONS} -j --skip-existing --json --quiet",
    "convert": "--topic --start --end --to --layout --with --euler-unit --convention "
    "--direction --sign --left --right --relative-to --rate --as --quiet",
    "compare": f"--start --end {ERRORS} --plot --json --quiet",
    "calibrate": f"--estimate --window --time-offset --prior --mount {RATES} --on-backwards "
    "--output --json --quiet",
    "plot": "--show --components --unwrap --size --no-title --reference "
    f"{RATES} {ERRORS} --output --quiet",
    "noise": f"{RATES} --on-backwards --output --plot --json --quiet",
    "check": "-k -j --update --dry-run --interactive --force --init --reference-log --topic-b "
    "--on-invalid --explain "
    "--artifacts --strict --junit --json --quiet --verbose",
    "simulate": "--to --compression --truth --motion --rate --duration --samples --start --seed "
    "--noise --bias --q0 --frequency --axis --angle --spin-frequency --walk --quiet",
    "completion": "",
}
"""The options that the help of a command shows, in this order."""


@pytest.mark.parametrize("name", COMMON)
def test_help_shows_common_options_and_help_all_every_one(name):
    """With their defaults, unless there are none."""
    command = cli.get_command(None, name)
    common, whole = (shown(name, flag, NO_COLOR="1") for flag in ("--help", "--help-all"))
    names = re.findall(r"^  (?:-\w, )?(--?[a-z][\w-]*)(?= |$)", common, re.MULTILINE)
    assert names == [*COMMON[name].split(), "--help", "--help-all"]
    options = {option for p in command.params for option in p.opts if option.startswith("--")}
    assert {option for option in options if f"{option} " in whole} == options
    assert "[default: none" not in common or name in {"check", "simulate"}


def test_help_is_coloured_unless_no_color_is_set():
    """On a terminal; NO_COLOR with any value turns colours off, an empty one does not."""
    assert "\x1b[1mInput\x1b[0m:" in shown("propagate", "--help")
    assert "\x1b[1mCommands\x1b[0m:" in shown("--help")
    assert "\x1b" in shown("--help", NO_COLOR="")
    assert "\x1b" not in shown("propagate", "--help", NO_COLOR="1")
    assert "\x1b" not in shown("--help", NO_COLOR="1")
