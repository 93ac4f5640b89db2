"""Run the commands and listings of the documents; as a program, write what they print into them."""

import io
import math
import os
import re
import shlex
import subprocess
import sys
import warnings
from contextlib import chdir, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.flips import TABLE, unnoticed_table
from make import schema
from make.commands import run
from make.measured import METHOD_TABLE, method_table
from make.pictures import PICTURES, draw
from make.places import ROOT, SHARED_LOGS
from make.reference import python_reference, reference
from make.tables import write_rates
from make.terminal import terminal

from quatprop import QuatpropWarning

GUIDES = ROOT / "quatprop" / "docs"

SIMULATED = {
    "drive.mcap": ("--motion", "rest", "--duration", "40s", "--noise", "1e-4"),
    "flight.bag": ("--motion", "tumbling", "--duration", "10s"),
    "walk.bag": ("--motion", "coning", "--duration", "30s"),
    "builds/1.0/bench.csv": ("--motion", "tumbling", "--duration", "10s"),
    "recordings/a.csv": (),
    "runs/1/imu.bag": (),
}
"""Name of a log in the documents -> how it is simulated."""

BROAD = "broad/05_undisturbed_slow_rotation_with_breaks_B.hdf5"
RECORDED = {
    "flight.ulg": "ulog/sample.ulg",
    "robot.bag": "auk/auk.bag",
    "rover.bag": "two_imus/test1_2014_xsens.bag",
    "euroc/imu0/data.csv": "csv/euroc_v102/imu0_data.csv",
    BROAD: BROAD,
    "euroc/truth.csv": "csv/euroc_v102/state_groundtruth_data.csv",
}
"""Name of a log in the documents -> the real recording that it is."""


GIT = {
    "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1",
    **dict.fromkeys(("GIT_AUTHOR_NAME", "GIT_COMMITTER_NAME"), "A"),
    **dict.fromkeys(("GIT_AUTHOR_EMAIL", "GIT_COMMITTER_EMAIL"), "a@example.org"),
}  # fmt: skip
"""Whose commits those of the documents are."""


class Document:
    """A document whose blocks are run in their order.

    Commands of ``console`` blocks run in a folder with the logs that documents speak of, ``python``
    blocks in one namespace; blocks that begin with ``# NAME`` are files of that name. Sections on
    recordings that are not there, or that are left out, are left as they are; `missing` names those
    recordings.
    """

    def __init__(self, path, folder, recordings, left_out=()):
        self.text = path.read_text()
        self.folder = folder
        self.names = {}
        self.printed = ""
        there = {} if recordings is None else {
            name: recordings / path
            for name, path in RECORDED.items()
            if name not in left_out and (recordings / path).exists()
        }  # fmt: skip
        self.missing = [name for name in RECORDED if name not in there and name in self.text]
        self._prepare(there)

    def _prepare(self, recordings):
        (self.folder / "sample_logs").symlink_to(ROOT / "sample_logs")
        for name in (*SIMULATED, *RECORDED):
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if name in SIMULATED and name.partition("/")[0] in self.text:
                run("simulate", path, "--truth", "none", "-q", *SIMULATED[name], code=0)
            elif name in recordings:
                path.symlink_to(recordings[name])
        if "builds/2.0" in self.text:
            self._write_second_build()
        rows = "".join(f"{number / 100},1,2,3\n" for number in range(100))
        (self.folder / "log.csv").write_text("t,gx,gy,gz\n" + rows)
        (self.folder / "names.txt").write_text("runs/1/imu.bag\n")
        shim = self.folder / ".bin" / "quatprop"
        shim.parent.mkdir()
        shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m quatprop "$@"\n')
        shim.chmod(0o755)

    def _write_second_build(self):
        """Write the log of a build whose rates are in deg/s, under the same names."""
        head, *rows = (self.folder / "builds/1.0/bench.csv").read_text().splitlines()
        parts = [row.split(",") for row in rows]
        values = [[t, *(repr(math.degrees(float(rate))) for rate in rates)] for t, *rates in parts]
        write_rates(self.folder / "builds/2.0/bench.csv", values, head)

    def run(self):
        """Run all blocks; return the text with what is printed now in place of what is shown."""
        with chdir(self.folder):
            return "\n## ".join(map(self._section, self.text.split("\n## ")))

    def terminal(self):
        """Return the picture of a terminal in which the first commands are run."""
        commands = re.findall(r"(?m)^\$ (.*)$", self.text.split("```console\n")[1].split("```")[0])
        with chdir(self.folder):
            return terminal([(command, self._command(command)[1]) for command in commands])

    def _section(self, text):
        if any(name in text for name in self.missing):
            return text
        return re.sub(r"(?ms)^```(\w+)\n(.*?)^```$", self._block, text)

    def _block(self, found):
        kind, text = found.groups()
        if kind == "console":
            lines = [self._shown(part) for part in re.split(r"(?m)^\$ ", text)[1:]]
            return "```console\n" + "".join(lines) + "```"
        if kind == "python":
            self._listing(text)
        elif name := re.match(r"# ([\w/]+\.\w+)\n", text):
            Path(name[1]).parent.mkdir(parents=True, exist_ok=True)
            Path(name[1]).write_text(text)
        return found[0]

    def _shown(self, part):
        """Return a command, and what it prints where something is shown below it."""
        command, _, before = part.partition("\n")
        code, output = self._command(command)
        told = re.search(r"  # exit code (\d)$", command)
        assert code in ({int(told[1])} if told else {0, 3}), f"{command}: {code}, {output}"
        return f"$ {command}\n" + (output.rstrip("\n") + "\n" if before else "")

    def _command(self, command):
        words, _, grep = re.sub(r" +# exit code \d$", "", command).partition(" | grep ")
        words, _, target = words.partition(" > ")
        if words.startswith("quatprop "):
            # No process of its own: it is faster.
            result = run(*shlex.split(words.removesuffix(" 2>&1"), comments=True)[1:])
            if target:
                Path(target).write_text(result.stdout)
                return result.exit_code, result.stderr
            lines = (result.stdout + result.stderr).splitlines()
            return result.exit_code, "\n".join(line for line in lines if grep in line)
        folders = (self.folder / ".bin", Path(sys.executable).parent, os.environ["PATH"])
        done = subprocess.run(
            ["/bin/bash", "-c", command],
            env={
                **os.environ,
                **GIT,
                "PATH": os.pathsep.join(map(str, folders)),
                "PYTHONPATH": str(ROOT),
            },
            capture_output=True,
            text=True,
            check=False,
        )
        return done.returncode, done.stdout + done.stderr

    def _listing(self, text):
        with redirect_stdout(io.StringIO()) as stream, warnings.catch_warnings():
            # The rates of a sample log are frozen, as quatprop remarks, and truth has holes.
            warnings.simplefilter("ignore", QuatpropWarning)
            exec(text, self.names)  # noqa: S102  # the documents are ours
        self.printed += stream.getvalue()


if __name__ == "__main__":
    (GUIDES / "reference.md").write_text(reference())
    (GUIDES / "api.md").write_text(python_reference())
    (GUIDES / schema.NAME).write_text(schema.schema_text())
    for name in PICTURES:
        draw(GUIDES / name)
    for document in (ROOT / "README.md", *sorted(GUIDES.glob("*.md"))):
        with TemporaryDirectory() as place:
            text = re.sub(TABLE, unnoticed_table(), document.read_text())
            text = re.sub(METHOD_TABLE, method_table(), text)
            document.write_text(text)
            if document.name != "fleets.md":
                made = Document(document, Path(place), SHARED_LOGS)
                document.write_text(made.run())
                if document.name == "README.md":
                    (GUIDES / "terminal.svg").write_text(made.terminal())
                if made.missing:
                    print(
                        f"{document.name}: sections on {', '.join(made.missing)} are left as they "
                        f"are, since {SHARED_LOGS} (QUATPROP_SHARED_LOGS) lacks the recordings"
                    )
