"""`quatprop check`: what is judged and pinned, and the messages when something changed."""

import json
import os
import re
import shutil
import subprocess

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from make.commands import INSTALLED, run
from make.places import ROOT, SAMPLE_LOGS
from make.suites import check, repinned
from make.tables import write_rates
from ruamel.yaml import YAML

from quatprop import __version__
from quatprop.tools.check.changes import decimation
from quatprop.tools.check.lock import sha256_of

pytestmark = pytest.mark.usefixtures("no_causes")

SUITE = """\
[defaults]
method = "mean"

[case.spin]
log = "logs/spin.csv"
reference = "refs/spin.parquet"

[case.dos]
log = "logs/dos.csv"
reference = "refs/dos.parquet"

[case.made]
log = "logs/made.csv"
pin-log = false
reference = "refs/made.parquet"

[case.rest]
log = "logs/rest.parquet"
bias = "static"
start = "+1s"
reference = "refs/rest.parquet"
tol = "1e-8rad"

[case.tumbling]
log = "logs/tumbling_ros2"
method = "coning"
reference-log = "logs/tumbling.truth.csv"
tol = "0.1deg"
"""
NAMES = ["spin", "dos", "made", "rest", "tumbling"]


@pytest.fixture(scope="session")
def pinned(tmp_path_factory):
    """Make a suite over sample logs, with its references and its lock."""
    folder = tmp_path_factory.mktemp("pinned")
    unused = shutil.ignore_patterns("coning*", "*.bag", "spin.truth.csv", "rest.truth.parquet")
    shutil.copytree(SAMPLE_LOGS, folder / "logs", ignore=unused)
    run("simulate", folder / "logs/made.csv", "--motion", "tumbling", "--truth", "none", code=0)
    rows = "".join(f"{k},0,0,1\r\n" for k in range(9))
    (folder / "logs/dos.csv").write_bytes(f"t_ns,wx,wy,wz\r\n{rows}".encode())
    (folder / "suite.toml").write_text(SUITE)
    result = check(folder / "suite.toml", "--update")
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture
def ci(pinned, tmp_path):
    """Give a copy of that folder, in which things may be broken."""
    return shutil.copytree(pinned, tmp_path / "ci")


def judged(ci, name, *options):
    """Return the exit code and the report of a case."""
    result = check(ci / "suite.toml", "--json", "-k", name, *options)
    (case,) = json.loads(result.stdout)["cases"]
    case["said"] = "; ".join(filter(None, (case.get("summary"), case.get("reason"))))
    case["said"] = case["said"].replace(f"{ci}/", "")
    return result.exit_code, case


def edit(path, old, new):
    """Replace a part of a text that is there once."""
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def pin(ci, name, **facts):
    """Let the lock say something else of a case."""
    repinned(ci / "suite.toml", name, **facts)


def rewrite(ci, name, change, **facts):
    """Change the stamps and attitudes of a stored reference, or what came out; pin it so."""
    path = ci / "refs" / f"{name}.parquet"
    table = pq.read_table(path)
    t_ns, *wxyz = (column.to_numpy().copy() for column in table.columns)
    wxyz = np.column_stack(wxyz)
    if change is not None:
        change(t_ns, wxyz)
    metadata = pq.read_metadata(path).metadata
    report = json.loads(metadata[b"quatprop"])
    report["result"].update(facts)
    metadata = {**metadata, b"quatprop": json.dumps(report)}
    changed = pa.table([t_ns, *map(pa.array, wxyz.T)], names=table.column_names)
    pq.write_table(changed.replace_schema_metadata(metadata), path)
    pin(ci, name, reference=sha256_of(str(path)))


def turn(angle, rows=slice(None)):
    """Return a change that turns attitudes about the body's x axis."""

    def change(_, wxyz):
        c, s = np.cos(angle / 2), np.sin(angle / 2)
        w, x, y, z = wxyz[rows].T
        # q (c + s i), by the table of products.
        wxyz[rows] = np.column_stack([w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s])

    return change


# Cases that pass.


def test_a_suite_passes_against_its_own_references(ci):
    """Every case has a line: verdict, name, worst error against the tolerance, where."""
    # A file that no reader reads does not count.
    (ci / "logs/tumbling_ros2/notes.txt").write_text("windy")
    moved = shutil.move(ci, ci.with_name("elsewhere"))
    result = check(moved / "suite.toml")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert [line.split()[:2] for line in lines[:5]] == [["pass", name] for name in NAMES]
    assert " (limit 1e-09 rad" in lines[0]
    assert " (limit 1e-08 rad" in lines[3]
    assert " (limit 0.1 deg, margin " in lines[4]
    assert lines[5:] == ["5 cases: 5 passed"]
    # Aligned: the figures begin in one column.
    assert {len(line) - len(line[17:].lstrip()) for line in lines[:5]} == {17}
    assert check(moved / "suite.toml", "-q").output == "5 cases: 5 passed\n"


def test_references_are_small_and_say_how_they_came_about(ci):
    """Of 3000 samples 580 are kept, and the options, the source and the version with them."""
    path = ci / "refs" / "rest.parquet"
    told = json.loads(pq.read_metadata(path).metadata[b"quatprop"])
    assert pq.read_metadata(path).num_rows == 580  # 2900 after the first second, every fifth
    assert told["check"]["options"] == {"bias": "static", "method": "mean", "start": "+1s"}
    assert told["check"]["every"] == 5
    assert told["convention"]["method"] == "mean"
    assert told["quatprop"] == __version__
    assert told["source"]["path"] == "rest.parquet"
    assert len(told["source"]["sha256"]) == 64


def test_references_do_not_depend_on_folders(pinned, tmp_path, monkeypatch):
    """Neither on where the suite lies nor on where the command is given: same bytes, same lock."""
    shutil.copytree(pinned / "logs", tmp_path / "logs")
    (tmp_path / "imu.yaml").write_text("gyroscope_noise_density: 1e-4\n")
    (tmp_path / "suite.toml").write_text(
        SUITE.replace("[case.dos]", 'imu = "imu.yaml"\n[case.dos]')
    )
    contents = []
    for folder in (tmp_path, "/"):
        monkeypatch.chdir(folder)
        assert check(tmp_path / "suite.toml", "--update").exit_code == 0
        contents.append((tmp_path / "refs/spin.parquet").read_bytes())
        (tmp_path / "refs/spin.parquet").unlink()
        (tmp_path / "suite.lock.json").rename(tmp_path / "old.lock")
    assert contents[0] == contents[1]
    (tmp_path / "imu.yaml").write_text("gyroscope_noise_density: 2e-4\n")
    assert check(tmp_path / "suite.toml", "--update").exit_code == 0
    (tmp_path / "refs/spin.parquet").write_bytes(contents[0])
    said = check(tmp_path / "suite.toml").stdout
    assert "its metadata have imu of SHA-256 '3dc44c013510' instead of '" in said
    (tmp_path / "suite.toml").write_text(SUITE)
    assert check(tmp_path / "suite.toml", "--update", "--force").exit_code == 0
    for name in ("refs/spin.parquet", "refs/rest.parquet", "suite.lock.json"):
        assert (tmp_path / name).read_bytes() == (pinned / name).read_bytes()


@pytest.mark.parametrize(
    ("patterns", "names"),
    [
        (["spin"], ["spin"]),
        (["*in*"], ["spin", "tumbling"]),
        (["d?s", "spi"], ["spin", "dos"]),
        (["spinn"], []),
    ],
)
def test_cases_can_be_chosen(ci, patterns, names):
    """-k takes parts of names or patterns, and can be repeated; choosing none is an error."""
    options = [part for pattern in patterns for part in ("-k", pattern)]
    result = check(ci / "suite.toml", "-v", *options)
    lines = [line for line in result.stdout.splitlines()[:-1] if not line.startswith("note on ")]
    assert [line.split()[1] for line in lines] == names
    if not names:
        assert result.exit_code == 2
        assert f"no case of {ci / 'suite.toml'} matches -k spinn" in result.stderr


def test_a_log_that_is_made_anew_may_be_longer(ci):
    """It passes where all of the reference is covered."""
    log = ci / "logs/made.csv"
    t_ns, rates = log.read_text().splitlines()[-1].split(",", 1)
    log.write_text(f"{log.read_text()}{int(t_ns) + 10_000_000},{rates}\n")
    assert judged(ci, "made")[0] == 0
    shown = check(ci / "suite.toml").stdout.splitlines()[2]
    errors = "max error 0 rad at +0 ns (limit 1e-09 rad)"
    assert shown == f"pass   made      {errors}; coverage 100 % (minimum 99 %)"


# Cases that cannot be judged, and why.

SHA = "its content changed since the reference file was made (SHA-256 "
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
NOT_THERE = "it is a Git LFS pointer, not the file itself; download the file with git lfs pull"
LINE_ENDS = (
    "only its line ends changed since the reference file was made, from {}: Git converts them"
)
BROKEN_FILES = {
    ("spin", "logs/spin.csv"): {
        "flip": SHA,
        "lf to crlf": LINE_ENDS.format("LF to CRLF"),
        "missing": "no such file or folder; check the path",
        "pointer": NOT_THERE,
    },
    ("dos", "logs/dos.csv"): {"crlf to lf": LINE_ENDS.format("CRLF to LF")},
    ("rest", "logs/rest.parquet"): {"flip": SHA},
    ("tumbling", "logs/tumbling_ros2/tumbling_ros2.db3"): {"flip": SHA},
    ("tumbling", "logs/tumbling_ros2/metadata.yaml"): {
        "comment": SHA,
        "missing": "it existed when the reference file was made, and is missing",
        "pointer": NOT_THERE,
    },
    ("tumbling", "logs/tumbling_ros2/Odd.msg"): {
        "pointer": NOT_THERE,
        "new": "it did not exist when the reference file was made",
    },
    ("tumbling", "logs/tumbling.truth.csv"): {"flip": SHA},
    ("spin", "refs/spin.parquet"): {
        "cut": ", and cannot be read; restore it",
        "missing": "the reference file is missing; restore it, or write it with --update",
        "pointer": NOT_THERE,
    },
}
BREAK = {
    "flip": lambda data: data[:-2] + bytes([data[-2] ^ 1]) + data[-1:],
    "lf to crlf": lambda data: data.replace(b"\n", b"\r\n"),
    "crlf to lf": lambda data: data.replace(b"\r\n", b"\n"),
    "comment": lambda data: data + b"# edited\n",
    "cut": lambda data: data[:5000],
    "pointer": lambda _: POINTER,
    "new": lambda _: b"float64 x\n",
}


@pytest.mark.parametrize(
    ("case", "file", "how", "reason"),
    [(*place, *row) for place, rows in BROKEN_FILES.items() for row in rows.items()],
)
def test_a_file_that_has_changed_is_an_error(ci, case, file, how, reason):
    """The error names it, what happened to it, and the remedy."""
    path = ci / file
    content = path.read_bytes() if path.exists() else b""
    path.unlink(missing_ok=True)
    if how != "missing":
        path.write_bytes(BREAK[how](content))
    # An update accepts what changed, but never takes a pointer for the file itself.
    for options in ([], ["--update"]) if how == "pointer" else ([],):
        code, found = judged(ci, case, *options)
        assert (code, found["verdict"]) == (2, "error")
        assert found["reason"].startswith(f"{path}: ")
        assert reason in found["reason"]
    assert how != "pointer" or path.read_bytes() == POINTER


def test_line_ends_of_a_large_file_are_not_looked_for(ci, monkeypatch):
    """Several copies of it would be held in memory."""
    path = ci / "logs/spin.csv"
    monkeypatch.setattr("quatprop.tools.check.lock.MAX_TEXT", path.stat().st_size)
    path.write_bytes(BREAK["lf to crlf"](path.read_bytes()))
    assert SHA in judged(ci, "spin")[1]["reason"]


def test_a_pinned_reference_that_cannot_be_read_is_an_error(ci):
    """Where there is nothing to compare with, nothing passes."""
    (ci / "refs/spin.parquet").write_bytes(b"PAR1 and no more")
    pin(ci, "spin", reference=sha256_of(str(ci / "refs/spin.parquet")))
    code, case = judged(ci, "spin")
    assert (code, case["verdict"]) == (2, "error")
    assert "refs/spin.parquet: " in case["said"]


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("tumbling", 'method = "coning"', 'method = "end"', "method was 'coning' and is now 'end'"),
        ("rest", 'start = "+1s"\n', "", "start was '+1s' and is now the default"),
        (
            "rest",
            '"+1s"',
            "2023-11-14T22:13:21Z",
            "start was '+1s' and is now '2023-11-14T22:13:21+00:00'",
        ),
        ("rest", '"static"', '"0,0,0.001"', "bias was 'static' and is now '0,0,0.001'"),
        (
            "spin",
            'spin.csv"',
            # Other ways of writing what was pinned change nothing.
            'spin.csv"\nmethod = "mean"\nrates = "body"\nq0-layout = "wxyz"\nq0 = [1, 0, 0, 0]',
            "pinned: q0 was the default and is now '1,0,0,0'; restore it, or accept it with --",
        ),
    ],
)
def test_a_changed_option_is_an_error(ci, name, old, new, words):
    """An option that is not the pinned one is named, with both values."""
    edit(ci / "suite.toml", old, new)
    code, case = judged(ci, name)
    assert (code, case["verdict"]) == (2, "error")
    assert words in case["reason"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "case 'rest' instead of 'spin', every '5' instead of '1'"),
        ([], "bias 'static' instead of 'the default'"),
        (["--convention", "jpl"], "product 'JPL, ij = -k' instead of 'Hamilton, ij = k'"),
    ],
)
def test_a_reference_that_is_not_the_pinned_one_is_an_error(ci, options, words):
    """It is named, with what it says of itself and should not."""
    reference, other = ci / "refs/spin.parquet", ci / "refs/rest.parquet"
    if options:
        run("convert", reference, ci / "other.parquet", *options, code=0)
        other = ci / "other.parquet"
    shutil.copy(other, reference)
    code, case = judged(ci, "spin")
    assert (code, case["verdict"]) == (2, "error")
    assert (
        "refs/spin.parquet: this is not the reference file that was pinned (SHA-256 "
        in case["said"]
    )
    assert words in case["said"]


# Cases that fail, and why.


@pytest.mark.parametrize("row", [0, 250, 999])
def test_a_moved_reference_fails_where_it_moved(ci, row):
    """A thousandth of a radian in one row is found there, and only its case fails."""
    rewrite(ci, "spin", turn(1e-3, slice(row, row + 1)))
    code, spin = judged(ci, "spin")
    assert (code, spin["verdict"]) == (1, "fail")
    assert spin["error_rad"] == pytest.approx(1e-3, abs=1e-12)
    assert spin["comparison"]["worst"]["index"] == row
    assert "above the tolerance, first at +" in spin["reason"]
    cause = "1 of 1000 samples carry the error, and the others are right (isolated samples)"
    assert spin["reason"].endswith(f"likely cause: {cause}")
    # Failures come last, and alone stand with -q.
    line, *_, total = check(ci / "suite.toml", "-q").output.splitlines()
    assert line.startswith("FAIL   spin      max error 0.001 rad at +")
    assert total == "5 cases: 4 passed, 1 failed"


@pytest.mark.usefixtures("causes")
def test_a_tolerance_decides(ci):
    """An error of a millionth of a radian passes at two millionths, and fails at a half."""
    rewrite(ci, "rest", turn(1e-6))
    edit(ci / "suite.toml", 'tol = "1e-8rad"', 'tol = "2e-6rad"')
    assert judged(ci, "rest")[0] == 0
    edit(ci / "suite.toml", 'tol = "2e-6rad"', 'tol = "5e-7rad"')
    code, case = judged(ci, "rest")
    assert (code, case["verdict"]) == (1, "fail")
    assert "frames differ" in case["reason"]
    assert "takes it out" not in case["reason"], "what would hide a regression is not advised"
    edit(ci / "suite.toml", 'tol = "5e-7rad"', "")
    edit(ci / "suite.toml", 'tol = "0.1deg"', 'tol = "0.001deg"')  # coning is 0.01 deg off
    assert "above the tolerance" in check(ci / "suite.toml", "-k", "tumbling").stdout


def late(t_ns, _):
    """Move a stamp by a nanosecond, which is not within any tolerance."""
    t_ns[7] += 1


def biased(row):
    """Return a row of a log whose rate about x is off by 0.01 rad/s, which are 2063 deg/h."""
    t_ns, x, *others = row.split(",")
    return ",".join([t_ns, repr(float(x) + 0.01), *others])


def remade(ci, change):
    """Make the log anew that is not pinned: what it leads to is judged."""
    header, *rows = (ci / "logs/made.csv").read_text().splitlines()
    write_rates(ci / "logs/made.csv", change(rows), header)


ABOVE = "above the tolerance, first at"
STAMP = (
    "1 of 580 timestamps differ from those of the reference file, the first at attitude 7: "
    "1700000001350000000 ns, not 1700000001350000001 ns"
)
END = "the attitude at the last sample is 3.14 rad from the one in the reference file"
FAILURES = {
    # Attitudes that were thinned do not hide that samples are gone, nor another end.
    "samples": (lambda ci: pin(ci, "rest", samples=2901), "2900 samples were propagated, and 2901"),
    "end": (lambda ci: rewrite(ci, "rest", None, final_wxyz=[0.0, 1.0, 0.0, 0.0]), END),
    "stamp": (lambda ci: rewrite(ci, "rest", late), STAMP),
    "tenth": (
        lambda ci: remade(ci, lambda rows: rows[: len(rows) // 10]),
        "% of the samples of the reference series, at least 99 %",
    ),
    "third": (lambda ci: remade(ci, lambda rows: rows[::3]), ABOVE),
    "bias": (
        lambda ci: remade(ci, lambda rows: map(biased, rows)),
        "are a constant -2063, ",
    ),
}


@pytest.mark.usefixtures("causes")
@pytest.mark.parametrize("name", FAILURES)
def test_a_difference_fails(ci, name):
    """The sentence states how large it is and where; a bias is named."""
    change, words = FAILURES[name]
    change(ci)
    code, case = judged(ci, "made" if name in {"tenth", "third", "bias"} else "rest")
    assert (code, case["verdict"]) == (1, "fail")
    assert words in case["said"]


def test_another_version_is_named_and_judged_all_the_same(ci):
    """Noted once for all cases, in a failure too, until an update, which keeps the references."""
    note = f"the reference file was made by quatprop 0.0.9, this is {__version__}"
    for name in NAMES:
        pin(ci, name, quatprop="0.0.9")
    assert judged(ci, "spin")[1]["notes"] == [note]
    assert check(ci / "suite.toml").stdout.splitlines()[-2] == f"note on 5 cases: {note}"
    before = {path: path.read_bytes() for path in (ci / "refs").iterdir()}
    for options in (["--update"], []):
        assert "note" not in check(ci / "suite.toml", *options).stdout
    assert {path: path.read_bytes() for path in (ci / "refs").iterdir()} == before
    pin(ci, "spin", quatprop="0.0.9", samples=999)
    assert judged(ci, "spin")[1]["reason"].endswith(note)
    updated = check(ci / "suite.toml", "--update", "-k", "spin").stdout
    assert f"       quatprop: 0.0.9 -> {__version__}\n       samples: 999 -> 1000\n" in updated


@pytest.mark.parametrize(
    ("samples", "every"),
    [(1, 1), (1000, 1), (1001, 2), (2001, 5), (5001, 10), (10_000_001, 20_000)],
)
def test_references_are_thinned_in_round_steps(samples, every):
    """At most 1000 attitudes are kept, and at least 400 of a long log."""
    assert decimation(samples) == every


def steps_of(place, name="Check"):
    """Return the shell commands of the action, or of the snippet for GitLab."""
    yaml = YAML(typ="safe")
    if place == "github":
        action = yaml.load((ROOT / ".github/actions/quatprop-check/action.yml").read_text())
        steps = [step for step in action["runs"]["steps"] if name in step.get("name", "")]
        return steps[0]["run"]
    text = (ROOT / "quatprop" / "docs" / "ci.md").read_text().split("## GitLab")[1]
    return "\n".join(yaml.load(text.split("```yaml\n")[1].split("```")[0])["attitude"]["script"])


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
@pytest.mark.parametrize("place", ["github", "gitlab"])
def test_the_steps_for_ci_services_run(place, tmp_path):
    """They check the suite, keep JUnit and evidence, and fail as the check does."""
    log = write_rates(tmp_path / "ci/spin.csv", [(k, 0, 0, 1) for k in range(9)])
    suite = tmp_path / "ci/suite.toml"
    suite.write_text('[case.spin]\nlog = "spin.csv"\nreference = "spin.parquet"\n')
    assert check(suite, "--update").exit_code == 0
    path = f"{INSTALLED.parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "SUITES": "ci/suite.toml", "OPTIONS": "--strict"}
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
        log.write_text("changed\n")


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
@pytest.mark.parametrize("suites", ["", " ", "ci/none.toml"])
def test_the_action_fails_where_nothing_is_checked(suites, tmp_path):
    """Without a suite, its loop did nothing and succeeded."""
    path = f"{INSTALLED.parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "SUITES": suites, "OPTIONS": ""}
    command = ["/bin/bash", "-e", "-c", steps_of("github")]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert done.returncode == 2


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
@pytest.mark.parametrize("given", ["", "  "])
def test_the_action_fails_if_it_is_not_told_what_to_install(given, tmp_path):
    """GitHub does not enforce `required`; pip with nothing to install printed its help."""
    command = ["/bin/bash", "-e", "-c", steps_of("github", "Install")]
    environment = os.environ | {"INSTALL": given}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, check=False, text=True
    )
    assert done.returncode == 2
    assert done.stdout == "::error::'install' does not say what pip installs\n"


def test_artifacts_of_a_matrix_have_names_of_their_own():
    """Uploads under one name fail all but the first of its jobs."""
    action = YAML(typ="safe").load((ROOT / ".github/actions/quatprop-check/action.yml").read_text())
    name = action["runs"]["steps"][-1]["with"]["name"]
    assert {"github.job", "strategy.job-index"} <= {*re.findall(r"[\w.-]+", name)}


def test_the_hook_of_pre_commit_runs_the_command():
    """With the suite in its `args`."""
    (hook,) = YAML(typ="safe").load((ROOT / ".pre-commit-hooks.yaml").read_text())
    assert (hook["entry"], hook["language"]) == ("quatprop check", "python")
    assert not hook["pass_filenames"]


def test_the_container_starts_what_a_scheduler_names():
    """AWS Batch gives `command` to the ENTRYPOINT: `quatprop sh -c ...` was what ran."""
    text = (ROOT / "quatprop" / "docs" / "ci.md").read_text().split("## Docker")[1]
    image = text.split("```dockerfile\n")[1].split("```")[0]
    assert "ENTRYPOINT" not in image
    started = re.search(r"docker run .* -w /work quatprop (.*)", text)[1]
    assert started == "quatprop check ci/suite.toml --strict"


def test_the_citation_names_this_version():
    """As `quatprop --version` does."""
    cited = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())
    assert (cited["version"], cited["license"]) == (__version__, "Apache-2.0")
