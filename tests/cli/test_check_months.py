"""A repository with real logs that is checked for months: what happens to it, and what is said."""

import json
import math
import os
import shutil
import subprocess
import sys
import time

import pytest
from make.places import ROOT
from make.suites import check
from ruamel.yaml import YAML

from quatprop import __version__

SUITE = """[defaults]
method = "mean"

[case.xio]
log = "logs/xio.csv"
rate-unit = "deg/s"
reference = "refs/xio.parquet"

[case.px4]
log = "logs/px4.csv"
pin-log = false
reference = "refs/px4.parquet"

[case.bag]
log = "logs/bag"
reference = "refs/bag.parquet"
"""


@pytest.fixture(scope="module")
def made(shared_logs, tmp_path_factory):
    """Return a repository with a suite of three real logs and its references."""
    repository = tmp_path_factory.mktemp("repository")
    logs = repository / "ci" / "logs"
    (logs / "bag").mkdir(parents=True)
    shutil.copyfile(shared_logs / "csv" / "xio3" / "Inertial.csv", logs / "xio.csv")
    px4 = shared_logs / "csv" / "px4" / "sample_sensor_combined_0.csv"
    shutil.copyfile(px4, logs / "px4.csv")
    for part in (shared_logs / "auk" / "auk_sqlite3").iterdir():
        shutil.copyfile(part, logs / "bag" / part.name)
    suite = repository / "ci" / "suite.toml"
    suite.write_text(SUITE)
    done = check(suite, "--update")
    assert done.exit_code == 0, done.stdout
    return repository


@pytest.fixture
def ci(made, tmp_path):
    """Return a copy of the folder of the suite."""
    return shutil.copytree(made / "ci", tmp_path / "ci")


def verdict(ci, case, *options):
    """Return the exit code, and the verdict and all that is said of a case."""
    done = check(ci / "suite.toml", "--json", *options)
    cases = {one["name"]: one for one in json.loads(done.stdout)["cases"]}
    others = {name: one["verdict"] for name, one in cases.items() if name != case}
    assert set(others.values()) == {"pass"}, done.stdout
    one = cases[case]
    said = "; ".join([one.get("summary") or "", one.get("reason") or "", *one["notes"]])
    return done.exit_code, one["verdict"], said.replace(f"{ci}/", "")


def rows(ci):
    """Return the lines of the log that a firmware makes anew."""
    return (ci / "logs" / "px4.csv").read_text().splitlines()


def rewrite(ci, lines):
    """Write the lines of that log."""
    (ci / "logs" / "px4.csv").write_text("\n".join(lines) + "\n")


def test_a_log_that_is_recorded_again_and_longer(ci):
    """It passes: all of the reference is covered."""
    header, *lines = rows(ci)
    last = lines[-1].split(",")
    step = int(last[0]) - int(lines[-2].split(",")[0])
    more = [",".join([str(int(last[0]) + k * step), *last[1:]]) for k in range(1, 200)]
    rewrite(ci, [header, *lines, *more])
    done = check(ci / "suite.toml")
    assert done.exit_code == 0
    assert done.stdout.splitlines()[1] == (
        "pass   px4  0 rad of 1e-09 rad at +0 ns, 100 % of the reference covered"
    )


def test_ninety_percent_missing(ci):
    """What is left is right, and too little of the reference."""
    header, *lines = rows(ci)
    rewrite(ci, [header, *lines[: len(lines) // 10]])
    code, is_, said = verdict(ci, "px4")
    assert (code, is_) == (1, "fail")
    assert "coverage 9." in said
    assert "% of the time and" in said
    assert "% of the samples of the reference, at least 99 %" in said


def test_another_sample_rate(ci):
    """Every third sample: the attitudes are others, and two thirds of the reference have none."""
    header, *lines = rows(ci)
    rewrite(ci, [header, *lines[::3]])
    code, is_, said = verdict(ci, "px4")
    assert (code, is_) == (1, "fail")
    assert "above the tolerance, first at" in said or "have the same time" in said, said


def test_another_method(ci):
    """An option has changed since the case was pinned."""
    suite = ci / "suite.toml"
    suite.write_text(SUITE.replace('rate-unit = "deg/s"', 'rate-unit = "deg/s"\nmethod = "start"'))
    code, is_, said = verdict(ci, "xio")
    assert (code, is_) == (2, "error")
    assert "the case has changed since it was pinned: method was 'mean' and is now 'start'" in said


def test_a_bias(ci):
    """0.01 rad/s on x fail, and the cause is named."""
    header, *lines = rows(ci)
    column = header.split(",").index("gyro_rad[0]")
    parts = [line.split(",") for line in lines]
    for part in parts:
        part[column] = repr(float(part[column]) + 0.01)
    rewrite(ci, [header, *map(",".join, parts)])
    code, is_, said = verdict(ci, "px4")
    assert (code, is_) == (1, "fail")
    assert "above the tolerance, first at" in said
    assert "likely cause: " in said
    assert "bias" in said


def test_a_case_that_is_deleted(ci):
    """It does not disappear: said, an error with --strict, and an update names its reference."""
    suite = ci / "suite.toml"
    suite.write_text(SUITE[: SUITE.index("[case.bag]")])
    said = "pinned, but not in the suite: 'bag'; restore them, or remove them from the lock with"
    done = check(suite)
    assert (done.exit_code, done.stderr) == (0, f"{said} --update\n")
    assert check(suite, "--strict").exit_code == 1
    done = check(suite, "--update")
    assert done.stderr.splitlines() == [
        "removed from the lock: 'bag'",
        f"no longer used, to be removed: {ci / 'refs' / 'bag.parquet'}",
    ]
    assert check(suite, "--strict").exit_code == 0


def test_a_reference_that_is_edited(ci):
    """It is not the one that was pinned."""
    shutil.copyfile(ci / "refs" / "bag.parquet", ci / "refs" / "xio.parquet")
    code, is_, said = verdict(ci, "xio")
    assert (code, is_) == (2, "error")
    assert "refs/xio.parquet: this is not the reference that was pinned (SHA-256 " in said
    assert "; its metadata have case 'bag' instead of 'xio'" in said


@pytest.mark.parametrize("file", ["logs/xio.csv", "refs/xio.parquet", "logs/bag/metadata.yaml"])
def test_pointers_of_git_lfs(ci, file):
    """Named as such; an update does not replace them."""
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
    (ci / file).write_bytes(pointer)
    for options in ((), ("--update",)):
        code, is_, said = verdict(ci, "bag" if "bag" in file else "xio", *options)
        assert (code, is_) == (2, "error")
        assert said.strip("; ") == (
            f"{file}: it is a Git LFS pointer, not the file itself; download the file with git lfs "
            "pull"
        )
        assert (ci / file).read_bytes() == pointer


def test_an_unfinished_merge(ci):
    """The line of the marker and the way out."""
    lock = ci / "suite.lock.json"
    lines = lock.read_text().splitlines()
    lock.write_text("\n".join([*lines[:3], "<<<<<<< HEAD", *lines[3:]]))
    done = check(ci / "suite.toml")
    assert done.exit_code == 2
    assert done.stderr.replace(f"{ci}/", "") == (
        "Error: suite.lock.json: line 4 is a conflict marker of a merge; remove the markers, "
        "keeping one side of each case, and check with --update\n"
    )


def test_line_ends_that_git_converted(ci):
    """The cause is named, and the attribute that prevents it."""
    log = ci / "logs" / "xio.csv"
    content = log.read_bytes()
    unix = b"\r\n" not in content
    log.write_bytes(content.replace(b"\n", b"\r\n") if unix else content.replace(b"\r\n", b"\n"))
    code, is_, said = verdict(ci, "xio")
    assert (code, is_) == (2, "error")
    ends = "from LF to CRLF" if unix else "from CRLF to LF"
    assert said.strip("; ") == (
        f"logs/xio.csv: only its line ends changed since the reference was made, {ends}: Git "
        "converts them; keep them with a line 'xio.csv -text' in .gitattributes, and check the "
        "file out again; restore it, or accept it with --update"
    )


def test_files_in_the_folder_of_a_bag(ci):
    """What no reader reads does not count; of what is read, the file that differs is named."""
    bag = ci / "logs" / "bag"
    (bag / ".DS_Store").write_bytes(b"desktop")
    (bag / "notes.txt").write_text("windy")
    assert check(ci / "suite.toml").exit_code == 0
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text() + "# edited\n")
    code, is_, said = verdict(ci, "bag")
    assert (code, is_) == (2, "error")
    assert "logs/bag/metadata.yaml: its content changed since the reference was made" in said
    metadata.unlink()
    _, is_, said = verdict(ci, "bag")
    assert is_ == "error"
    assert "metadata.yaml: it was there when the reference was made, and is missing" in said


def test_a_new_version(ci):
    """Said once for all cases, and settled by an update that leaves the references as they are."""
    lock = ci / "suite.lock.json"
    lock.write_text(lock.read_text().replace(f'"quatprop": "{__version__}"', '"quatprop": "0.0.9"'))
    before = {path: path.read_bytes() for path in (ci / "refs").iterdir()}
    note = f"the reference was made by quatprop 0.0.9, this is {__version__}"
    assert check(ci / "suite.toml").stdout.splitlines()[-2] == f"note on 3 cases: {note}"
    assert "note" not in check(ci / "suite.toml", "--update").stdout
    assert "note" not in check(ci / "suite.toml").stdout
    assert {path: path.read_bytes() for path in (ci / "refs").iterdir()} == before


def test_a_folder_that_moved(ci, tmp_path):
    """Paths are relative to the suite: nothing changes."""
    moved = tmp_path / "elsewhere" / "tests"
    moved.parent.mkdir()
    shutil.move(ci, moved)
    assert check(moved / "suite.toml").stdout.splitlines()[-1] == "3 cases: 3 passed"


TRUTHS = {
    "auk": (
        "auk/auk.bag",
        'reference-topic = "/vicon/auk/auk"\nalign = "mount"\ntime-offset = "auto"',
        (25.65, 10.87, 12.11, 4.921),
    ),
    "euroc": (
        "csv/euroc_v102/imu0_data.csv",
        'reference-log = "{logs}/csv/euroc_v102/state_groundtruth_data.csv"\nalign = "mean"',
        (0.3334, 0.2023, 0.5925, 0.2776),
    ),
    "xio3": (
        "csv/xio3/Inertial.csv",
        'reference-log = "{logs}/csv/xio3/Quaternion.csv"\nalign = "mean"\ntime-offset = "auto"',
        (5.009, 2.517, 6.992, 4.460),
    ),
    "px4": (
        "csv/px4/sample_sensor_combined_0.csv",
        (
            'reference-log = "{logs}/csv/px4/sample_vehicle_attitude_0.csv"\n'
            'align = "mean"\ntime-offset = "auto"'
        ),
        (7.895, 4.325, 1.551, 1.103),
    ),
    "husky": (
        "husky/test1_husky.bag",
        'topic = "/imu/data"\nreference-topic = "/imu/data"\nalign = "first"',
        (45.24, 22.47, 9.613, 3.061),
    ),
}
"""Recording -> log, how it is compared, and worst and RMS error, overall and over 5 s, deg."""

LIMITS = ("tol", "rms-tol", "window-tol", "window-rms-tol")
BIASES = {"euroc": (-0.002, 0.0208, 0.0758)}
DEG_S = {"xio3"}
"""Recordings whose rates, and so whose biases, are in deg/s."""


def test_criteria_tell_regressions_from_the_errors_of_a_recording(shared_logs, tmp_path):
    """At 1.2 times the errors of today, all pass; a bias of 0.02 rad/s, a wrong side, a conjugate
    and a scale error of 5 % fail.
    """
    (tmp_path / "scale.yaml").write_text("matrix: [[1.05, 0, 0], [0, 1.05, 0], [0, 0, 1.05]]\n")
    suite = '[defaults]\nmethod = "mean"\nwindow = "5s"\n'
    for name, (log, compared, errors) in TRUTHS.items():
        bias = BIASES.get(name, (0.0, 0.0, 0.0))
        more = math.degrees(0.02) if name in DEG_S else 0.02
        usual = f"bias = {list(bias)}\n" if any(bias) else ""
        for regression, keys in {
            "": usual,
            # About z, xio3 has such a bias of the other sign itself.
            " bias": f"bias = {[bias[0] + more, *bias[1:]]}\n",
            " side": f'{usual}rates = "inertial"\n',
            " conjugate": f'{usual}reference-from-direction = "ref-to-body"\n',
            " scale": f'{usual}calibration = "scale.yaml"\n',
        }.items():
            suite += f'\n[case."{name}{regression}"]\nlog = "{shared_logs / log}"\n{keys}'
            suite += compared.format(logs=shared_logs) + "\n"
            limits = zip(LIMITS, errors, strict=True)
            suite += "".join(f'{key} = "{1.2 * error:.6f}deg"\n' for key, error in limits)
    (tmp_path / "suite.toml").write_text(suite)
    done = check(tmp_path / "suite.toml", "--update", "--json")
    cases = json.loads(done.stdout)["cases"]
    assert len(cases) == 5 * len(TRUTHS)
    for case in cases:
        expected = "fail" if " " in case["name"] else "pass"
        assert case["verdict"] == expected, (case["name"], case["reason"])


def test_a_hundred_cases(tmp_path):
    """What passes is counted, not listed."""
    rows = "".join(f"{10_000_000 * k},0.1,0.2,0.3\n" for k in range(10))
    suite = ""
    for number in range(100):
        name = f"log{number}"
        (tmp_path / f"{name}.csv").write_text(f"t_ns,wx,wy,wz\n{rows}")
        suite += f'[case.{name}]\nlog = "{name}.csv"\nreference = "refs/{name}.parquet"\n'
    (tmp_path / "suite.toml").write_text(suite)
    assert check(tmp_path / "suite.toml", "--update", "-q").exit_code == 0
    began = time.process_time()
    done = check(tmp_path / "suite.toml")
    seconds = time.process_time() - began
    assert done.exit_code == 0
    assert len(done.stdout.splitlines()) <= 10
    # Of the processor alone: other processes may be running.
    assert seconds / 100 <= 0.025


def steps_of(place):
    """Return the shell commands of the action, or of the snippet for GitLab."""
    yaml = YAML(typ="safe")
    if place == "github":
        action = yaml.load((ROOT / ".github/actions/quatprop-check/action.yml").read_text())
        (step,) = [step for step in action["runs"]["steps"] if "Check" in step.get("name", "")]
        return step["run"]
    text = (ROOT / "quatprop" / "docs" / "ci.md").read_text().split("## GitLab")[1]
    return "\n".join(yaml.load(text.split("```yaml\n")[1].split("```")[0])["attitude"]["script"])


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
@pytest.mark.parametrize("place", ["github", "gitlab"])
def test_the_steps_for_ci_services_run(place, tmp_path):
    """They check the suite, keep JUnit and evidence, and fail as the check does."""
    logs = tmp_path / "ci" / "logs"
    logs.mkdir(parents=True)
    shutil.copyfile(ROOT / "sample_logs" / "spin.csv", logs / "spin.csv")
    suite = tmp_path / "ci" / "suite.toml"
    suite.write_text('[case.spin]\nlog = "logs/spin.csv"\nreference = "refs/spin.parquet"\n')
    assert check(suite, "--update").exit_code == 0
    (tmp_path / "bin").mkdir()
    shim = tmp_path / "bin" / "quatprop"
    shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m quatprop "$@"\n')
    shim.chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{shim.parent}{os.pathsep}{os.environ['PATH']}",
        "SUITES": "ci/suite.toml",
        "OPTIONS": "--strict",
    }
    for expected in (0, 2):
        done = subprocess.run(
            ["/bin/bash", "-e", "-c", steps_of(place)],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == expected, done.stderr
        (junit,) = tmp_path.rglob("*.xml")
        assert f'errors="{min(expected, 1)}"' in junit.read_text()
        (logs / "spin.csv").write_text("changed\n")
