"""`quatprop check`: what is judged and pinned, and the messages when something changed."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS
from make.suites import check

from quatprop import __version__
from quatprop.check.case import CaseResult, exit_code
from quatprop.check.reference import decimation
from quatprop.cli.commands import cli

SUITE = """\
[defaults]
method = "mean"

[case.spin]
log = "logs/spin.csv"
reference = "refs/spin.parquet"

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
NAMES = ["spin", "rest", "tumbling"]


def outcomes(suite, *options):
    """Return exit code and name -> report of each case."""
    result = check(suite, "--json", *options)
    assert result.stdout.startswith("{"), result.output
    told = json.loads(result.stdout)
    return result.exit_code, {case["name"]: case for case in told["cases"]}


def verdicts(suite):
    """Return exit code and name -> verdict."""
    code, cases = outcomes(suite)
    return code, {name: case["verdict"] for name, case in cases.items()}


def only(name, verdict):
    """Return the verdicts where one case alone does not pass."""
    return {known: verdict if known == name else "pass" for known in NAMES}


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Make a suite over sample logs, with its references and its lock."""
    folder = tmp_path_factory.mktemp("made")
    shutil.copytree(SAMPLE_LOGS, folder / "logs")
    suite = folder / "suite.toml"
    suite.write_text(SUITE)
    result = check(suite, "--update")
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture
def suite(made, tmp_path):
    """Give a copy of that suite that may be broken."""
    return shutil.copytree(made, tmp_path / "ci") / "suite.toml"


def edit(path, old, new):
    """Replace a part of a text that is there once."""
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def metadata(path):
    """Return what a Parquet file keeps beside its columns."""
    return pq.ParquetFile(path).metadata.metadata


def rewrite(path, columns):
    """Write other columns in a stored reference; its provenance stays."""
    table = pa.table(columns, names=["t_ns", "qw", "qx", "qy", "qz"])
    pq.write_table(table.replace_schema_metadata(metadata(path)), path)


def turn(path, angle, rows=slice(None)):
    """Turn attitudes of a stored reference about the body's x axis."""
    t_ns, *wxyz = pq.read_table(path).columns
    wxyz = np.column_stack([column.to_numpy() for column in wxyz])
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    w, x, y, z = wxyz[rows].T
    # q (c + s i), by the table of products.
    wxyz[rows] = np.column_stack([w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s])
    rewrite(path, [t_ns, *map(pa.array, wxyz.T)])


def accept(suite, name):
    """Pin a stored reference as it is now, as if an update had written it."""
    from quatprop.check.lock import sha256_of

    lock = suite.with_suffix(".lock.json")
    told = json.loads(lock.read_text())
    told["cases"][name]["reference"] = sha256_of(str(suite.parent / "refs" / f"{name}.parquet"))
    lock.write_text(json.dumps(told))


# What passes.


def test_a_suite_passes_against_its_own_references(suite):
    """Every case has a line: verdict, name, worst error against the tolerance, where."""
    result = check(suite)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert [line[:16].split() for line in lines[:3]] == [["pass", name] for name in NAMES]
    assert " rad of 1e-09 rad at +" in lines[0]
    assert " rad of 1e-08 rad at +" in lines[1]
    assert " deg of 0.1 deg at +" in lines[2]
    assert lines[3] == "3 cases: 3 passed"
    # Aligned: the figures begin in one column.
    assert {len(line) - len(line[17:].lstrip()) for line in lines[:3]} == {17}


def test_references_are_small_and_say_how_they_came_about(suite):
    """Of 3000 samples 580 are kept, and the options, the source and the version with them."""
    table = pq.read_table(suite.parent / "refs" / "rest.parquet")
    told = json.loads(metadata(suite.parent / "refs" / "rest.parquet")[b"quatprop"])
    assert len(table) == 580  # 2900 after the first second, every fifth
    assert told["check"]["options"] == {"bias": "static", "method": "mean", "start": "+1s"}
    assert told["check"]["every"] == 5
    assert told["convention"]["method"] == "mean"
    assert told["quatprop"] == __version__
    assert told["source"]["path"] == "rest.parquet"
    assert len(told["source"]["sha256"]) == 64


def test_references_do_not_depend_on_where_they_are_made(made, tmp_path):
    """The same suite in another folder gives the same bytes, references and lock."""
    folder = tmp_path / "elsewhere"
    shutil.copytree(SAMPLE_LOGS, folder / "logs")
    (folder / "suite.toml").write_text(SUITE)
    assert check(folder / "suite.toml", "--update").exit_code == 0
    for name in ("refs/spin.parquet", "refs/rest.parquet", "suite.lock.json"):
        assert (folder / name).read_bytes() == (made / name).read_bytes()


def test_references_do_not_depend_on_where_the_command_is_given(tmp_path, monkeypatch):
    """Nor where cases name other files: their paths in the metadata are those of the suite."""
    shutil.copyfile(SAMPLE_LOGS / "spin.csv", tmp_path / "spin.csv")
    (tmp_path / "imu").mkdir()
    (tmp_path / "imu" / "imu.yaml").write_text("gyroscope_noise_density: 1e-4\n")
    (tmp_path / "suite.toml").write_text(
        '[case.spin]\nlog = "spin.csv"\nreference = "spin.parquet"\nimu = "imu/imu.yaml"\n'
    )
    contents = []
    for folder, suite in ((tmp_path, "suite.toml"), ("/", tmp_path / "suite.toml")):
        monkeypatch.chdir(folder)
        assert check(suite, "--update").exit_code == 0
        contents.append((tmp_path / "spin.parquet").read_bytes())
        (tmp_path / "spin.parquet").unlink()
        (tmp_path / "suite.lock.json").unlink()
    assert contents[0] == contents[1]
    (tmp_path / "imu" / "imu.yaml").write_text("gyroscope_noise_density: 2e-4\n")
    assert check(suite, "--update").exit_code == 0
    (tmp_path / "spin.parquet").write_bytes(contents[0])
    assert "its metadata have imu of SHA-256 '3dc44c013510' instead of '" in check(suite).stdout


def test_the_output_is_the_same_for_any_number_of_processes(suite):
    """With two processes the text is that of one, whatever finishes first."""
    edit(suite, 'method = "coning"', 'method = "end"')
    one, two = check(suite), check(suite, "-j", "2")
    assert (two.exit_code, two.output) == (one.exit_code, one.output)
    assert one.exit_code == 2


@pytest.mark.parametrize(
    ("patterns", "names"),
    [(["spin"], ["spin"]), (["*in*"], ["spin", "tumbling"]), (["res", "spi"], ["spin", "rest"])],
)
def test_cases_can_be_chosen(suite, patterns, names):
    """-k takes parts of names or patterns, and can be repeated."""
    options = [part for pattern in patterns for part in ("-k", pattern)]
    assert list(outcomes(suite, *options)[1]) == names


def test_choosing_no_case_is_an_error(suite):
    """A pattern that matches nothing does not pass in silence."""
    result = check(suite, "-k", "spinn")
    assert result.exit_code == 2
    assert f"no case of {suite} matches -k spinn" in result.stderr


def test_quiet_leaves_the_exit_code(suite):
    """Only the totals and what failed are shown with -q."""
    assert check(suite, "-q").output == "3 cases: 3 passed\n"
    edit(suite, 'tol = "0.1deg"', 'tol = "0.001deg"')
    first, _, last = check(suite, "-q").output.splitlines()
    assert first.startswith("FAIL   tumbling  ")
    assert last == "3 cases: 2 passed, 1 failed"


# What fails, and why: exactly that case.


@pytest.mark.parametrize(
    ("name", "log"),
    [
        ("spin", "spin.csv"),
        ("rest", "rest.parquet"),
        ("tumbling", "tumbling_ros2/tumbling_ros2.db3"),
    ],
)
def test_a_changed_log_is_an_error(suite, name, log):
    """One byte more or other in a log is an error of its case, which names the log."""
    log = suite.parent / "logs" / log
    content = bytearray(log.read_bytes())
    content[-2] ^= 1
    log.write_bytes(content)
    assert verdicts(suite) == (2, only(name, "error"))
    reason = outcomes(suite)[1][name]["reason"]
    assert "its content changed since the reference was made (SHA-256 " in reason
    assert reason.startswith(str(suite.parent / "logs"))


def test_a_changed_independent_series_is_an_error(suite):
    """What a case is compared with is pinned, too."""
    truth = suite.parent / "logs" / "tumbling.truth.csv"
    truth.write_text(truth.read_text() + "\n")
    assert verdicts(suite) == (2, only("tumbling", "error"))
    assert outcomes(suite)[1]["tumbling"]["reason"].startswith(f"{truth}: its content changed")


def test_a_missing_log_is_an_error(suite):
    """A log that is not there is no skip."""
    log = suite.parent / "logs" / "spin.csv"
    log.unlink()
    assert verdicts(suite) == (2, only("spin", "error"))
    reason = outcomes(suite)[1]["spin"]["reason"]
    assert reason == f"{log}: no such file or folder; check the path"


def test_a_pointer_of_git_lfs_in_place_of_a_log_is_named(suite):
    """The pointer in its place is recognised, with the way out."""
    log = suite.parent / "logs" / "spin.csv"
    log.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    assert verdicts(suite) == (2, only("spin", "error"))
    assert outcomes(suite)[1]["spin"]["reason"] == (
        f"{log}: it is a Git LFS pointer, not the file itself; download the file with git lfs pull"
    )


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("tumbling", 'method = "coning"', 'method = "end"', "method was 'coning' and is now 'end'"),
        ("rest", 'start = "+1s"\n', "", "start was '+1s' and is now the default"),
        ("rest", '"static"', '"0,0,0.001"', "bias was 'static' and is now '0,0,0.001'"),
        (
            "spin",
            'spin.csv"',
            'spin.csv"\nmount = "x,-y,-z"',
            "mount was the default and is now 'x,-y,-z'",
        ),
    ],
)
def test_a_changed_option_is_an_error(suite, name, old, new, words):
    """An option that is not the pinned one is named, with both values."""
    edit(suite, old, new)
    assert verdicts(suite) == (2, only(name, "error"))
    assert words in outcomes(suite)[1][name]["reason"]


def test_an_option_written_in_another_way_is_the_same(suite):
    """The default may be written, and numbers may be a list."""
    edit(suite, 'log = "logs/spin.csv"', 'log = "logs/spin.csv"\nrates = "body"\nmax-gap = "1s"')
    edit(suite, 'max-gap = "1s"', 'q0-layout = "scalar-first"\nq0 = [1, 0, 0, 0]')
    code, cases = outcomes(suite, "-k", "spin")
    assert (code, cases["spin"]["reason"].split(": ")[-1]) == (
        2,
        "q0 was the default and is now '1,0,0,0'; restore it, or accept it with --update",
    )


@pytest.mark.parametrize("row", [0, 250, 999])
def test_a_moved_reference_fails_where_it_moved(suite, row):
    """A thousandth of a radian in one row is found there, and only its case fails."""
    reference = suite.parent / "refs" / "spin.parquet"
    turn(reference, 1e-3, slice(row, row + 1))
    accept(suite, "spin")
    assert verdicts(suite) == (1, only("spin", "fail"))
    spin = outcomes(suite)[1]["spin"]
    assert spin["error_rad"] == pytest.approx(1e-3, abs=1e-12)
    assert spin["comparison"]["worst"]["index"] == row
    assert "above the tolerance, first at +" in spin["reason"]
    assert spin["reason"].endswith(
        "likely cause: 1 of 1000 samples carry the error, and the others are right "
        "(isolated samples)"
    )
    line = check(suite).stdout.splitlines()[2]  # failures come last
    assert line.startswith("FAIL   spin      0.001 rad of 1e-09 rad at +")


def test_a_tolerance_decides(suite):
    """An error of a millionth of a radian passes at two millionths, and fails at a half."""
    turn(suite.parent / "refs" / "rest.parquet", 1e-6)
    accept(suite, "rest")
    edit(suite, 'tol = "1e-8rad"', 'tol = "2e-6rad"')
    assert verdicts(suite) == (0, only("rest", "pass"))
    edit(suite, 'tol = "2e-6rad"', 'tol = "5e-7rad"')
    assert verdicts(suite) == (1, only("rest", "fail"))
    reason = outcomes(suite)[1]["rest"]["reason"]
    assert "the reference frames differ by" in reason or "the body frames differ" in reason
    assert "takes" not in reason, "what would hide a regression is not advised"


def test_an_independent_series_fails_above_its_tolerance(suite):
    """The truth is 0.01 deg from what coning gives: 0.001 deg is not kept."""
    edit(suite, 'tol = "0.1deg"', 'tol = "0.001deg"')
    assert verdicts(suite) == (1, only("tumbling", "fail"))


def test_a_reference_that_is_not_the_pinned_one_is_an_error(suite):
    """It is named, with what it says of itself and should not."""
    reference = suite.parent / "refs" / "spin.parquet"
    shutil.copy(suite.parent / "refs" / "rest.parquet", reference)
    assert verdicts(suite) == (2, only("spin", "error"))
    reason = outcomes(suite)[1]["spin"]["reason"]
    assert reason.startswith(f"{reference}: this is not the reference that was pinned (SHA-256 ")
    assert "case 'rest' instead of 'spin', every '5' instead of '1'" in reason
    assert "bias 'static' instead of 'the default'" in reason


def test_a_reference_of_another_convention_says_so(suite, tmp_path):
    """A reference that was converted is not that of the case, and tells its convention."""
    reference = suite.parent / "refs" / "spin.parquet"
    converted = tmp_path / "jpl.parquet"
    told = CliRunner().invoke(
        cli, ["convert", str(reference), str(converted), "--convention", "jpl"]
    )
    assert told.exit_code == 0, told.output
    shutil.copy(converted, reference)
    assert verdicts(suite) == (2, only("spin", "error"))
    assert (
        "product 'JPL, ij = -k' instead of 'Hamilton, ij = k'"
        in (outcomes(suite)[1]["spin"]["reason"])
    )


def test_a_torn_reference_is_an_error(suite):
    """Half a file cannot be read, and the error names it."""
    reference = suite.parent / "refs" / "spin.parquet"
    reference.write_bytes(reference.read_bytes()[:5000])
    assert verdicts(suite) == (2, only("spin", "error"))
    assert ", and cannot be read; restore it" in outcomes(suite)[1]["spin"]["reason"]


def test_a_missing_reference_is_an_error(suite):
    """It is named, with the way out."""
    reference = suite.parent / "refs" / "rest.parquet"
    reference.unlink()
    assert verdicts(suite) == (2, only("rest", "error"))
    assert outcomes(suite)[1]["rest"]["reason"] == (
        f"{reference}: the reference is missing; restore it, or write it with --update"
    )


def test_a_case_that_was_never_updated_is_an_error(suite):
    """A new case does not pass before something was pinned."""
    suite.with_suffix(".lock.json").unlink()
    shutil.rmtree(suite.parent / "refs")
    code, found = verdicts(suite)
    assert (code, set(found.values())) == (2, {"error"})
    assert "the lock has no entry for this case yet" in outcomes(suite)[1]["spin"]["reason"]


def _pretend(suite, name, **facts):
    """Let the lock say something else of a case."""
    lock = suite.with_suffix(".lock.json")
    told = json.loads(lock.read_text())
    told["cases"][name].update(facts)
    lock.write_text(json.dumps(told))


def test_another_version_is_named_and_judged_all_the_same(suite):
    """A reference of another version passes with a note; if it fails, the note says why, maybe."""
    _pretend(suite, "spin", quatprop="0.0.9")
    note = f"the reference was made by quatprop 0.0.9, this is {__version__}"
    assert outcomes(suite)[1]["spin"]["notes"] == [note]
    assert check(suite).stdout.splitlines()[-2] == f"note on spin: {note}"
    _pretend(suite, "spin", final_wxyz=[0.0, 1.0, 0.0, 0.0])
    assert outcomes(suite)[1]["spin"]["reason"].endswith(note)


def test_another_count_of_samples_fails(suite):
    """Attitudes that were thinned do not hide that samples are gone."""
    _pretend(suite, "rest", samples=2901)
    assert verdicts(suite) == (1, only("rest", "fail"))
    assert outcomes(suite)[1]["rest"]["reason"].startswith(
        "2900 samples were propagated, and 2901 when pinned"
    )


def test_another_end_fails(suite):
    """The last attitude is compared, though the reference lacks it."""
    _pretend(suite, "rest", final_wxyz=[0.0, 1.0, 0.0, 0.0])
    assert verdicts(suite) == (1, only("rest", "fail"))
    assert (
        "the attitude at the last sample is 3.14 rad from the one that was pinned"
        in (outcomes(suite)[1]["rest"]["reason"])
    )


def test_other_stamps_fail(suite):
    """A stamp that moved by a nanosecond is not within any tolerance."""
    reference = suite.parent / "refs" / "rest.parquet"
    table = pq.read_table(reference)
    t_ns = table["t_ns"].to_numpy().copy()
    t_ns[7] += 1
    rewrite(reference, [pa.array(t_ns), *table.columns[1:]])
    accept(suite, "rest")
    assert verdicts(suite) == (1, only("rest", "fail"))
    assert outcomes(suite)[1]["rest"]["reason"].startswith(
        "1 of 580 timestamps differ from the reference, the first at attitude 7: "
        f"{t_ns[7] - 1} ns, not {t_ns[7]} ns"
    )


def test_trouble_comes_before_failure():
    """0 if all pass, 1 if one fails, 2 as soon as one could not be judged."""
    passed, failed, error = (CaseResult("a", verdict) for verdict in ("pass", "fail", "error"))
    assert exit_code([passed, passed]) == 0
    assert exit_code([passed, failed]) == 1
    assert exit_code([failed, error, passed]) == exit_code([error]) == 2


@pytest.mark.parametrize(
    ("samples", "every"),
    [(1, 1), (1000, 1), (1001, 2), (2001, 5), (5001, 10), (10_000_001, 20_000)],
)
def test_references_are_thinned_in_round_steps(samples, every):
    """At most 1000 attitudes are kept, and at least 400 of a long log."""
    assert decimation(samples) == every
    assert samples <= 1000 or 400 <= samples / every <= 1000
