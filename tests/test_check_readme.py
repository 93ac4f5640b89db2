"""What the README says of regression in CI is what happens: its suite, its output, its workflow."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from quatprop.cli import cli

ROOT = Path(__file__).parents[1]
SECTION = (ROOT / "README.md").read_text().split("## Regression in CI\n")[1].split("\n## ")[0]


def block(kind):
    """Return the one block of a kind in the section."""
    (text,) = re.findall(rf"```{kind}\n(.*?)```", SECTION, re.DOTALL)
    return text


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Give a repository with the README's suite, and sample logs where it expects logs."""
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    shutil.copytree(ROOT / "sample_logs", tmp_path / "ci" / "logs")
    (tmp_path / "ci" / "suite.toml").write_text(block("toml"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words):
    """Run a quatprop command as it is written."""
    name, *arguments = shlex.split(words, comments=True)
    assert name == "quatprop"
    return CliRunner().invoke(cli, arguments)


def test_the_suite_gives_the_output_that_is_shown(repository):
    """Both commands of the example print what stands beneath them."""
    made, judged = (part.split("\n", 1) for part in block("console").split("$ ")[1:])
    assert run(made[0]).stdout == made[1].rstrip("\n") + "\n"
    suite = repository / "ci" / "suite.toml"
    suite.write_text(suite.read_text().replace('method = "coning"', 'method = "end"'))
    assert run(judged[0]).stdout == judged[1]


def test_the_steps_of_the_workflow_run(repository):
    """The workflow is YAML of GitHub's shape; its check passes and leaves the file it uploads."""
    assert run("quatprop check ci/suite.toml --update").exit_code == 0
    workflow = YAML(typ="safe", pure=True).load(block("yaml"))
    assert workflow["on"] == ["push", "pull_request"]
    (job,) = workflow["jobs"].values()
    steps = job["steps"]
    assert all(("uses" in step) != ("run" in step) for step in steps)
    install, check = [step["run"] for step in steps if "run" in step]
    assert install == "python -m pip install ./tools/quatprop"
    result = run(check)
    assert result.exit_code == 0, result.output
    (upload,) = [step for step in steps if "upload-artifact" in step.get("uses", "")]
    assert (repository / upload["with"]["path"]).is_file()
