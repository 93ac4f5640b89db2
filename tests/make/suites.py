"""Suites, and `quatprop check` on them."""

import json
import shutil

from click.testing import CliRunner
from make.places import SAMPLE_LOGS

from quatprop.cli.commands import cli

TRUTH = """\
[case.coning]
log = "logs/coning.mcap"
method = "coning"
reference-log = "logs/coning.truth.csv"
tol = "0.1deg"
"""
"""A case with an independent reference, which it passes."""

STRICT = TRUTH.replace("0.1deg", "1e-9deg")
"""The same case, which fails."""


def check(suite, *options, **kwargs):
    """Run the command; errors come back as exit code and text."""
    return CliRunner().invoke(cli, ["check", str(suite), *map(str, options)], **kwargs)


def stored(name="spin", log="spin.csv", *more):
    """Return a case with a stored reference."""
    lines = [f"[case.{name}]", f'log = "logs/{log}"', f'reference = "refs/{name}.parquet"', *more]
    return "\n".join(lines) + "\n"


def with_logs(folder):
    """Copy sample logs into a folder, and return it."""
    (folder / "logs").mkdir()
    for name in ("spin.csv", "spin.truth.csv", "coning.mcap", "coning.truth.csv", "rest.parquet"):
        shutil.copy(SAMPLE_LOGS / name, folder / "logs")
    return folder


def write_suite(folder, text):
    """Write a suite."""
    suite = folder / "suite.toml"
    suite.write_text(text)
    return suite


def pinned(folder, text):
    """Write a suite, all of whose cases are pinned."""
    suite = write_suite(folder, text)
    result = check(suite, "--update")
    assert result.exit_code == 0, result.output
    return suite


def repinned(suite, name, **facts):
    """Let the lock say something else of a case."""
    lock = suite.with_suffix(".lock.json")
    told = json.loads(lock.read_text())
    told["cases"][name].update(facts)
    lock.write_text(json.dumps(told))


def shortened(folder, rows=301):
    """Leave only the first rows of the log of a spin; return the folder."""
    log = folder / "logs" / "spin.csv"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[: rows + 1]))
    return folder


def delay(path, ns):
    """Let the stamps of a text log be later."""
    head, *rows = path.read_text().splitlines()
    late = [f"{int(row.split(',')[0]) + ns},{row.split(',', 1)[1]}" for row in rows]
    path.write_text("\n".join([head, *late]) + "\n")


def lock_of(suite):
    """Return what the lock of a suite says of its cases."""
    return json.loads(suite.with_suffix(".lock.json").read_text())["cases"]
