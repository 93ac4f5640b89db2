"""Updates: pins, cases that are left alone, and outputs."""

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from make.places import SAMPLE_LOGS
from make.suites import STRICT, TRUTH, check, lock_of, pinned, repinned, stored, write_suite
from scipy.spatial.transform import Rotation

from quatprop.base.errors import TRACEBACK
from quatprop.tools.check.case import propagate_case


def test_an_update_says_what_changed(folder):
    """Options, SHA-256, samples, and how far the new reference is from the old one."""
    suite = write_suite(folder, stored())
    new = check(suite, "--update")
    assert new.stdout.splitlines()[0] == (
        f"pass   spin  new      1000 of 1000 attitudes in {folder / 'refs' / 'spin.parquet'}"
    )
    log = folder / "logs" / "spin.csv"
    log.write_text("\n".join(log.read_text().splitlines()[:-1]) + "\n")
    write_suite(folder, stored("spin", "spin.csv", 'mount = "x,-y,-z"'))
    changed = check(suite, "--update")
    assert changed.exit_code == 0
    first, sha, mount, samples, final, reference, attitudes, _ = changed.stdout.splitlines()
    assert first.startswith("pass   spin  updated  999 of 999 attitudes in ")
    assert sha.split()[:2] == ["log:", "SHA-256"]
    assert mount == "       mount: the default -> 'x,-y,-z'"
    assert samples == "       samples: 1000 -> 999"
    # A quarter turn a second, for 9.99 s, and for 9.98 s about an axis with y and z reversed.
    rate = np.pi / 6 * np.array([1, 2, 2])
    ends = [Rotation.from_rotvec(9.99 * rate), Rotation.from_rotvec(9.98 * rate * [1, -1, -1])]
    apart = np.degrees((ends[0].inv() * ends[1]).magnitude())
    assert final.split()[2:4] == [f"{apart:.6g}", "deg"]
    assert final.endswith("from the one pinned; total angle: 899.1 deg -> 898.2 deg")
    assert reference.split()[:2] == ["reference:", "SHA-256"]
    assert attitudes.startswith("       attitudes: max ")
    assert " deg from the 99.9 % of the old reference covered" in attitudes
    assert check(suite).exit_code == 0


@pytest.mark.usefixtures("causes")
def test_the_cause_of_an_update_names_the_log_and_the_reference(folder):
    """A suite has no A and no B."""
    suite = pinned(folder, stored("coning", "coning.mcap"))
    write_suite(folder, stored("coning", "coning.mcap", 'method = "coning"'))
    said = check(suite, "--update").stdout
    assert "is within what the integration method of the log's attitudes (coning) and " in said
    assert "the reference series (start) costs, " in said


def test_only_what_changed_is_pinned_anew(folder):
    """A passing case is left as it is, -k leaves the others, and a removed case is forgotten."""
    suite = pinned(folder, stored() + TRUTH)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
    for options in ((), ("--dry-run",)):
        again = check(suite, "--update", *options)
        assert again.stdout.splitlines()[0].startswith("pass   spin    kept     ")
    assert check(suite, "--update", "-k", "spin").exit_code == 0
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()} == before
    assert list(lock_of(suite)) == ["coning", "spin"]
    assert check(write_suite(folder, TRUTH), "--update", "--force").exit_code == 0
    assert list(lock_of(suite)) == ["coning"]


def test_an_update_does_not_hide_a_failure_against_an_independent_series(folder):
    """The truth stays the truth: the case fails in an update, too, which pins what it saw."""
    suite = pinned(folder, TRUTH)
    write_suite(folder, STRICT)
    result = check(suite, "--update")
    assert result.exit_code == 1
    assert result.stdout.startswith("FAIL   coning  kept     ")
    assert " -> " not in result.stdout
    write_suite(folder, TRUTH.replace('"coning"\nref', '"end"\nref').replace("0.1deg", "0.01deg"))
    result = check(suite, "--update")
    assert result.exit_code == 1
    assert result.stdout.startswith("FAIL   coning  updated  ")
    assert "       method: 'coning' -> 'end'\n       final attitude: " in result.stdout
    assert "       max error: 0.0718199 deg -> 0.62864 deg\n" in result.stdout


def test_an_update_replaces_only_what_an_update_wrote(folder):
    """Neither a truth that somebody named as the reference, nor a log, also of another case."""
    suite = write_suite(folder, stored())
    (folder / "refs").mkdir()
    reference = shutil.copy(SAMPLE_LOGS / "rest.truth.parquet", folder / "refs" / "spin.parquet")
    log = folder / "logs" / "rest.parquet"
    before = [reference.read_bytes(), log.read_bytes()]
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert f"{reference}: this was not written by check --update, which would" in result.stdout
    write_suite(folder, stored("rest", log.name) + stored().replace("refs/spin", "logs/rest"))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert "this is an input of the run; choose another output" in result.output
    assert [reference.read_bytes(), log.read_bytes()] == before


def test_a_case_chooses_its_rows(folder):
    """`every` and `rate` of a case are those of its reference."""
    rows = {"a": ("every = 100", 10), "b": ("rate = 7", 70)}
    suite = pinned(
        folder, "".join(stored(name, "spin.csv", key) for name, (key, _) in rows.items())
    )
    for name, (_, count) in rows.items():
        assert len(pq.read_table(folder / "refs" / f"{name}.parquet")) == count
    assert check(suite).exit_code == 0


def test_pinned_options_are_compared_by_value(folder):
    """Another way of writing a number is no change."""
    suite = pinned(
        folder, stored("spin", "spin.csv", "rate = 50", 'max-gap = "1s"', "bias=[0,0,1]")
    )
    same = stored("spin", "spin.csv", "rate = 50.0", 'max-gap = "1000ms"', "bias=[0,0,1.0]")
    write_suite(folder, same)
    assert check(suite).exit_code == 0
    write_suite(folder, same.replace("50.0", "51"))
    assert "rate was '50' and is now '51'; restore it" in check(suite).stdout
    # A value that only an earlier version could read.
    repinned(suite, "spin", options={"rate": "fast"})
    assert "rate was 'fast' and is now '51'" in check(suite).stdout


# The lock


def test_a_lock_that_is_not_valid_is_refused(folder):
    """An entry edited by hand, or text that is not JSON, is reported before anything runs."""
    suite = pinned(folder, stored())
    lock = folder / "suite.lock.json"
    intact = lock.read_text()
    contents = [b"\xff"]
    for key, value in (
        ("final_deg", {"roll": 1.0}),
        ("final_deg", None),
        ("final_deg", {"roll": 1.0, "pitch": 0.0, "yaw": "north"}),
        ("remarks", "frozen"),
        ("span_s", None),
        ("samples", "1001"),
        ("every", 1.5),
        ("every", 0),
        ("reference", 7),
        ("quatprop", None),
        ("measured", {"max": "small"}),
        ("inputs", {"log": 1}),
        ("options", {"method": None}),
    ):
        told = json.loads(intact)
        told["cases"]["spin"][key] = value
        contents.append(json.dumps(told).encode())
    for content in contents:
        lock.write_bytes(content)
        result = check(suite)
        assert result.exit_code == 2
        why = " (it is not JSON: line 1: Expecting value)" if content == b"\xff" else ""
        words = f"it is not the lock that --update writes{why}; restore it, or remove it and update"
        assert result.stderr == f"Error: {lock}: {words}\n", content
    lock.unlink()
    lock.mkdir()
    assert check(suite).stderr.startswith(f"Error: {lock}: ")
    lock.rmdir()
    words = (
        "the reference file exists, but is not in the lock; restore the lock, or check "
        "with --update"
    )
    assert words in check(suite).stdout


OLDER = '{"cases": {"spin": {"final_wxyz": [1, 0, 0, 0]}}}'
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
MARKER = "is a conflict marker of a merge; remove the markers, keeping one side of each case, and "


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (OLDER, "the lock was written by an older format; run check with --update, which lists"),
        # The advice was to remove it, and with it all that was pinned.
        (POINTER, "it is a Git LFS pointer, not the file itself"),
        ("{{\n  <<<<<<< HEAD\n{entry}\n", f"line 2 {MARKER}check with --update\n"),
        # The last one was taken.
        (
            '{{"format": 1, "cases": {{"a": {entry}, "a": {entry}}}}}',
            "it is not the lock that --update writes ('a' is there twice); ",
        ),
    ],
)
def test_the_error_says_why_a_lock_is_not_valid(folder, content, words):
    """It may have another format, an unresolved merge, or be a pointer of Git LFS."""
    suite = pinned(folder, stored())
    lock = suite.with_suffix(".lock.json")
    entry = json.dumps(lock_of(suite)["spin"])
    lock.write_text(content if content == OLDER else content.format(entry=entry))
    for options in ((), *[("--update",)] * (content == POINTER)):
        result = check(suite, *options)
        assert result.exit_code == 2
        assert f"{lock}: {words}" in result.stderr
        assert content != POINTER or "remove" not in result.stderr


def test_a_deleted_case_is_named(folder):
    """--strict fails on it; an update removes it from the lock, and names its reference."""
    suite = pinned(folder, stored() + stored("rest", "rest.parquet") + TRUTH)
    assert check(suite, "-k", "spin", "--strict").exit_code == 0
    lock = lock_of(suite)["rest"]
    write_suite(folder, stored() + TRUTH)
    result = check(suite)
    assert result.exit_code == 0
    words = "it is pinned, but not in the suite; restore it, or remove it from the lock with "
    *_, gone, last = result.stdout.splitlines()
    assert gone == f"gone   rest    {words}--update -k rest"
    assert last == "3 cases: 2 passed, 1 deleted"
    assert json.loads(check(suite, "--json").stdout)["counts"]["deleted"] == 1
    assert check(suite, "--strict").exit_code == 1
    result = check(suite, "--update", "--strict", "--force")
    final = ", ".join(f"{angle} {size:g}" for angle, size in lock["final_deg"].items())
    turned = f"total angle {lock['total_angle_deg']:g} deg, final {final} deg"
    pinned_rest = f"{lock['samples']:,} samples, {turned}"
    assert (result.exit_code, result.stderr.splitlines()) == (
        0,
        [
            f"removed from the lock: 'rest', pinned with {pinned_rest}",
            f"no longer used, to be removed: {folder / 'refs' / 'rest.parquet'}",
        ],
    )
    assert check(suite, "--strict").exit_code == 0


# Errors of one case of many


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (ZeroDivisionError("by zero"), "This is a bug in quatprop (ZeroDivisionError: "),
        (MemoryError(), "There is not enough memory; choose fewer columns or topics"),
    ],
)
def test_an_unexpected_exception_does_not_stop_the_other_cases(
    folder, monkeypatch, error, sentence
):
    """A bug that one case triggers fails that case alone."""

    def fails(case, every, folder):
        if case.name == "bad":
            raise error
        return propagate_case(case, every, folder)

    monkeypatch.delenv(TRACEBACK, raising=False)
    monkeypatch.setattr("quatprop.tools.check.judge.propagate_case", fails)
    result = check(write_suite(folder, stored("bad") + stored("good")), "--update")
    assert result.exit_code == 2
    assert f"ERROR  bad   {sentence}" in result.stdout
    assert "pass   good  new  " in result.stdout
    monkeypatch.setenv(TRACEBACK, "1")
    if isinstance(error, ZeroDivisionError):
        assert check(folder / "suite.toml").exception is error


def test_a_reference_below_a_file_is_an_error_of_its_case(folder):
    """Where its folder cannot be made, the others are updated all the same."""
    (folder / "way").write_text("in it")
    suite = write_suite(folder, stored("bad").replace("refs/", "way/") + stored("good"))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert f"ERROR  bad   {folder / 'way'}: system error (" in result.stdout
    assert (folder / "refs" / "good.parquet").exists()


# Links


@pytest.mark.parametrize("way", ["../{}", "{}/outside/r.parquet", "refs/r.parquet", "r.parquet"])
def test_an_update_writes_only_in_the_folder_of_the_suite(folder, way):
    """A reference with ../ or an absolute path, or behind a link, replaced any Parquet file."""
    outside, inside = folder / "outside", folder / "suite"
    outside.mkdir()
    inside.mkdir()
    shutil.move(folder / "logs", inside / "logs")
    target = outside / "r.parquet"
    reference = way.format("outside/r.parquet" if way.startswith("..") else folder)
    if reference == "refs/r.parquet":
        (inside / "refs").symlink_to(outside)
    elif reference == "r.parquet":
        (inside / "r.parquet").symlink_to(target)
    suite = write_suite(inside, stored().replace("refs/spin.parquet", reference))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert (
        f"{inside / reference}: it leads to {target}, which is outside {inside}; remove the link "
        "or the path that leads there\n"
    ) in result.output
    assert list(outside.iterdir()) == []


def test_a_lock_that_is_a_link_out_of_the_folder_is_refused(folder):
    """An update would replace what it leads to."""
    inside = folder / "suite"
    inside.mkdir()
    shutil.move(folder / "logs", inside / "logs")
    (inside / "suite.lock.json").symlink_to(folder / "precious")
    result = check(write_suite(inside, stored()), "--update")
    assert result.exit_code == 2
    leads = f"it leads to {folder / 'precious'}, which is outside {inside}; "
    assert result.output.startswith(f"Error: {inside / 'suite.lock.json'}: {leads}")
    assert not (folder / "precious").exists()


@pytest.mark.parametrize("name", ["", "attitude.parquet", "error.html", "commands.txt"])
def test_artifacts_are_not_written_through_links(folder, name):
    """Links in their folder led anywhere."""
    suite = pinned(folder, TRUTH)
    write_suite(folder, STRICT)
    place, outside = folder / "failed" / "coning", folder / "outside"
    outside.mkdir()
    (place if name else place.parent).mkdir(parents=True)
    (place / name).symlink_to(outside / name)
    result = check(suite, "--artifacts", folder / "failed")
    assert result.exit_code == 1
    words = f"its artifacts cannot be kept: {place / (name or 'attitude.parquet')}: "
    assert words in result.output
    assert list(outside.iterdir()) == []
