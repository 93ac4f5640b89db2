"""References change only where somebody sees by how much: on the screen, and in the lock."""

import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor

import pytest
from make.commands import run
from make.suites import TRUTH, check, delay, lock_of, pinned, shortened, stored, write_suite
from make.systems import on_posix
from make.tables import write_rates
from scipy.spatial.transform import Rotation

from quatprop.cli.check import CI_VARIABLES
from quatprop.tools.check.cases import load_cases
from quatprop.tools.check.lock import merge_into_lock, read_lock
from quatprop.tools.check.runner import CheckOptions, run_cases

MOUNTED = 'mount = "x,-y,-z"'


@pytest.fixture
def folder(folder):
    """Give the folder with a short log: of many runs, all are quick."""
    return shortened(folder)


def damage(folder, _suite):
    """Set a rate to zero, for a second."""
    log = folder / "logs" / "spin.csv"
    lines = log.read_text().splitlines()
    lines[100:200] = [f"{line.split(',')[0]},0,0,0" for line in lines[100:200]]
    log.write_text("\n".join(lines) + "\n")


def mount(folder, suite):
    """Mount the sensor otherwise."""
    write_suite(folder, suite.read_text().replace("\nreference =", f"\n{MOUNTED}\nreference ="))


def forget(folder, suite):
    """Remove the lock, and damage the log."""
    suite.with_suffix(".lock.json").unlink()
    damage(folder, suite)


def forget_entry(folder, suite):
    """Remove the case from the lock, and damage its log."""
    lock = suite.with_suffix(".lock.json")
    lock.write_text(json.dumps({**json.loads(lock.read_text()), "cases": {}}))
    damage(folder, suite)


def older(folder, suite):
    """Let the lock be of another format, and damage the log."""
    lock = suite.with_suffix(".lock.json")
    cases = {name: {"final_wxyz": [1, 0, 0, 0]} for name in lock_of(suite)}
    lock.write_text(json.dumps({"cases": cases}))
    damage(folder, suite)


def exchange(folder, suite):
    """Let the reference be another one, of a sensor that is mounted otherwise."""
    log, reference = folder / "logs" / "spin.csv", folder / "refs" / "spin.parquet"
    run("propagate", log, "-o", reference, "--mount", "x,-y,-z", "-q", code=0)
    assert suite.exists()


def rename(folder, suite):
    """Give the case another name, and mount the sensor otherwise."""
    write_suite(folder, suite.read_text().replace("[case.spin]", "[case.turn]"))
    mount(folder, suite)


def rename_all(folder, suite):
    """Give the case and its reference other names, and mount the sensor otherwise."""
    write_suite(folder, stored("turn"))
    mount(folder, suite)


def align(folder, suite):
    """Let an alignment take out how the sensor is mounted."""
    mount(folder, suite)
    write_suite(folder, suite.read_text() + 'align = "mean"\n')


def shift(folder, suite):
    """Let all stamps be those of another clock, and damage the log."""
    damage(folder, suite)
    delay(folder / "logs" / "spin.csv", 10**15)


def free(folder, suite):
    """Damage a log whose bytes are not pinned."""
    write_suite(folder, suite.read_text() + "pin-log = false\n")
    damage(folder, suite)


WAYS = [
    damage, mount, forget, forget_entry, older, exchange, rename, rename_all, align, shift, free,
]  # fmt: skip

FORCED = [shift, rename, rename_all]
"""Of the first nobody knows the largest change; the others remove a case from the lock."""


@pytest.mark.parametrize("change", WAYS)
def test_nothing_is_accepted_without_its_change_in_degrees(folder, change):
    """A wrong output was accepted with a line of totals, or with nothing but a SHA-256.

    `check` says it, too, where there is an old reference, and fails; the lock shows it in angles.
    """
    suite = pinned(folder, stored())
    before = next(iter(lock_of(suite).values()))
    change(folder, suite)
    shown = check(suite)
    assert shown.exit_code in {1, 2}
    force = []
    if change in FORCED:
        refused = check(suite, "--update")
        assert (refused.exit_code, " --update --force" in refused.output) == (2, True)
        force = ["--force"]
    preview = check(suite, "--update", "--dry-run", *force)
    updated = check(suite, "--update", *force)
    assert preview.stdout == updated.stdout.replace("  updated  ", "  would be updated  ")
    assert preview.stderr.endswith("nothing was written, because of --dry-run\n")
    assert updated.exit_code == 0
    assert " updated " in updated.stdout
    angles = re.findall(r"(?:max|final attitude:) ([\d.]+) deg", updated.stdout)
    assert max(map(float, angles)) > 10, updated.stdout
    after = next(iter(lock_of(suite).values()))
    if change is not exchange:  # which restored the right one
        assert before["final_deg"] != after["final_deg"]
    # No history: the second update finds nothing to do.
    lock, reference = suite.with_suffix(".lock.json"), next((folder / "refs").iterdir())
    content = [lock.read_bytes(), reference.read_bytes()]
    again = check(suite, "--update")
    assert again.stdout.splitlines()[0].split()[2] == "kept"
    assert content == [lock.read_bytes(), reference.read_bytes()]


def test_a_reference_that_is_missing_is_written_again(folder):
    """Nothing else has changed: it is the one that was pinned."""
    suite = pinned(folder, stored())
    reference = folder / "refs" / "spin.parquet"
    content = reference.read_bytes()
    reference.unlink()
    result = check(suite, "--update")
    assert result.exit_code == 0
    assert "reference: missing -> SHA-256 " in result.stdout
    assert reference.read_bytes() == content
    assert check(suite).exit_code == 0


def test_every_reference_that_is_replaced_is_listed_however_many(folder):
    """Three of 34 references were replaced, and one line was printed: 33 passed."""
    names = [f"case{number}" for number in range(9)]
    cases = "".join(stored(name) for name in names)
    suite = pinned(folder, cases)
    damage(folder, suite)
    result = check(suite, "--update", "-q")
    listed = [line.split()[1:3] for line in result.stdout.splitlines() if "pass " in line]
    assert listed == [[name, "updated"] for name in names]
    assert result.stdout.count("log: SHA-256 ") == len(names)
    assert result.stdout.count("reference: SHA-256 ") == len(names)
    assert len(re.findall(r"attitudes: max [\d.]+ deg, RMS [\d.]+ deg, final ", result.stdout)) == 9


def test_a_change_is_shown_before_it_is_accepted(folder):
    """`check` compares what changed with the old reference, keeps the evidence, writes nothing."""
    suite = pinned(folder, stored())
    mount(folder, suite)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    result = check(suite, "--artifacts", folder / "evidence")
    assert result.exit_code == 2
    assert result.stdout.startswith("ERROR  spin  ")
    assert (
        "mount was the default and is now 'x,-y,-z'; restore it, or accept it with --update; "
        in (result.stdout)
    )
    assert "above the tolerance, first at +10 ms" in result.stdout
    page = (folder / "evidence" / "spin" / "error.html").read_text()
    assert "<p>error: " in page
    assert "<svg" in page
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize("answers", ["y\nn\n", "n\n", ""])
def test_changes_can_be_accepted_one_by_one(folder, answers):
    """A case that is not accepted stays as it was, and fails; the end of the input is a no."""
    suite = pinned(folder, stored("a") + stored("b"))
    damage(folder, suite)
    before = lock_of(suite)
    result = check(suite, "--update", "--interactive", "-k", "a", "-k", "b", input=answers)
    accepted = ["a"] if answers.startswith("y") else []
    assert result.exit_code == 2
    after = lock_of(suite)
    assert [name for name in after if after[name] != before[name]] == accepted
    assert result.stderr.count("accept?") == 2
    assert result.stderr.count(" deg from the old reference") == 2


def test_an_update_can_be_limited_to_cases(folder):
    """A name that matches exactly selects that case alone."""
    suite = pinned(folder, stored("spin") + stored("spin-2"))
    damage(folder, suite)
    before = lock_of(suite)
    check(suite, "--update", "-k", "spin")
    after = lock_of(suite)
    assert [name for name in after if after[name] != before[name]] == ["spin"]


@pytest.mark.parametrize("value", ["true", "1", "woodpecker"])
def test_no_update_where_nobody_reviews_it(folder, value):
    """Under CI it replaced references, and exited 0."""
    suite = pinned(folder, stored())
    mount(folder, suite)
    lock = suite.with_suffix(".lock.json")
    before = lock.read_bytes()
    for options in (["--update"], ["--update", "--dry-run"]):
        result = check(suite, *options, env={"CI": value})
        assert result.exit_code == (2 if len(options) == 1 else 0)
        assert lock.read_bytes() == before
    assert check(
        folder / "new.toml", "--init", folder / "logs/spin.csv", env={"CI": value}
    ).exit_code
    assert not (folder / "new.toml").exists()
    assert check(suite, "--update", "--force", env={"CI": value}).exit_code == 0
    assert lock.read_bytes() != before
    assert check(suite, "--update", env={"CI": "false"}).exit_code == 0


@pytest.mark.parametrize("variable", CI_VARIABLES)
def test_services_that_do_not_set_ci_are_known(folder, variable):
    """There an update accepted what had changed."""
    suite = pinned(folder, stored())
    mount(folder, suite)
    for value, code in (("2024.1", 2), ("False", 0)):
        result = check(suite, "--update", env={variable: value})
        refusal = f"{variable} is set, so nobody"
        assert (result.exit_code, refusal in result.stderr) == (code, code == 2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--dry-run"], "--dry-run requires --update"),
        (["--interactive"], "--interactive requires --update"),
        (["--force"], "--force requires --update"),
        (["--update", "--interactive", "-j", "2"], "omit -j"),
        (["--reference-log", "a.csv"], "--reference-log requires --init"),
    ],
)
def test_options_of_an_update_go_with_it(folder, options, words):
    """Alone they would promise what does not happen; a series for limits is a key of a suite."""
    result = check(pinned(folder, stored()), *options)
    assert result.exit_code == 2
    assert words in result.stderr


# The lock


def test_the_lock_is_readable_in_a_review(folder):
    """Quaternions and digests alone did not show what had changed."""
    write_rates(folder / "logs" / "still.csv", [(k, 0, 0, -1e-9) for k in range(3)])
    suite = pinned(folder, stored() + TRUTH + stored("still", "still.csv"))
    pins = lock_of(suite)
    assert not re.search(r"-0\.0\b", suite.with_suffix(".lock.json").read_text())
    # Pi / 2 rad/s for 3 s about (1, 2, 2) / 3.
    assert pins["spin"]["total_angle_deg"] == 270
    assert pins["spin"]["span_s"] == 3.0
    assert pins["spin"]["samples"] == 301
    end = Rotation.from_rotvec([90, 180, 180], degrees=True).as_euler("ZYX", degrees=True)
    assert pins["spin"]["final_deg"] == dict(
        zip(("roll", "pitch", "yaw"), end[::-1].round(6).tolist(), strict=True)
    )
    assert pins["spin"]["remarks"] == ["frozen"]
    assert pins["coning"]["measured"]["tol"] == pins["coning"]["measured"]["max"]


@on_posix
def test_two_updates_at_once_lose_nothing(folder):
    """The one that ended last wrote the lock as it was when it began."""
    suite = write_suite(folder, stored("a") + stored("b"))
    loaded, (a, _) = load_cases(suite)
    running = run_cases([a], {}, CheckOptions(suite=loaded), 1)
    next(running)
    assert check(suite, "--update", "-k", "b").exit_code == 0
    list(running)
    assert list(lock_of(suite)) == ["a", "b"]
    pin = read_lock(loaded.lock)["a"]

    def add(number):
        merge_into_lock(suite, loaded.lock, {f"c{number}": pin}, ())

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(add, range(40)))
    assert len(lock_of(suite)) == 42


def test_a_log_that_was_renamed_is_found(folder):
    """It has the SHA-256 that is pinned."""
    suite = pinned(folder, stored())
    shutil.move(folder / "logs" / "spin.csv", folder / "logs" / "flight.csv")
    result = check(suite)
    assert result.exit_code == 2
    words = f"{folder / 'logs' / 'flight.csv'} has the same content: name that as log"
    assert words in result.stdout
