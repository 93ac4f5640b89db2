"""Mistakes that would let a change of the attitudes through the gate unseen."""

import json
import re
from xml.etree import ElementTree as ET

import pytest
from make.suites import check, lock_of, pinned, repinned, shortened, stored, write_suite

TURNED = 'mount = "x,-y,-z"'
GONE = (
    "the largest change of the attitudes cannot be measured: not comparable: the old reference is"
)


@pytest.fixture
def folder(folder):
    """Give the folder with a short log: of many runs, all are quick."""
    return shortened(folder)


def largest(result):
    """Return the largest change that an update has listed, deg."""
    return max(map(float, re.findall(r"attitudes: max ([\d.]+) deg", result.stdout)))


def test_a_reference_of_another_name_is_compared_with_the_old_one(folder):
    """A change of 180 deg was accepted with a SHA-256 where the key `reference` had changed."""
    suite = pinned(folder, stored())
    write_suite(folder, stored("spin", "spin.csv", TURNED).replace("refs/", "other/new/"))
    result = check(suite, "--update", "-k", "spin")
    assert result.exit_code == 0
    assert largest(result) > 100


@pytest.mark.parametrize("remove", [True, False])
def test_a_change_from_a_reference_that_is_gone_is_refused(folder, remove):
    """Deleted, or replaced by hand with the new one, the old one was compared no more."""
    suite = pinned(folder, stored())
    reference, lock = folder / "refs" / "spin.parquet", suite.with_suffix(".lock.json")
    turned = stored("spin", "spin.csv", TURNED)
    if remove:
        reference.unlink()
    else:
        before = lock.read_bytes()
        pinned(folder, turned)
        lock.write_bytes(before)
    write_suite(folder, turned)
    before = lock_of(suite)
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert result.stdout.startswith("ERROR  spin  ")
    assert (
        f"{reference}: {GONE} gone; restore the old one, or accept it unseen with --update --f"
        in (result.stdout)
    )
    was = "missing" if remove else f"SHA-256 {before['spin']['reference'][:12]}"
    assert f"       reference: {was} -> SHA-256 " in result.stdout
    assert lock_of(suite) == before
    assert reference.exists() != remove
    result = check(suite, "--update", "--force")
    assert result.exit_code == 0
    assert "attitudes: not comparable: the old reference is gone" in result.stdout
    assert check(suite).exit_code == 0


@pytest.mark.parametrize(
    ("rows", "refused"),
    [
        ("every = 1000", "1 of 301 attitudes, over 0 s"),
        ("every = 34", "9 of 301 attitudes, over 2.72 s"),
        ("every = 33", ""),
        ('at = "logs/150.csv"', "150 of 301 attitudes, over 1.49 s"),
        ('at = "logs/151.csv"', ""),
    ],
)
def test_a_reference_of_a_few_attitudes_is_refused(folder, rows, refused):
    """One of 1 attitude, q0, passed whatever came after it."""
    lines = (folder / "logs" / "spin.truth.csv").read_text().splitlines(keepends=True)
    for count in (150, 151):
        (folder / "logs" / f"{count}.csv").write_text("".join(lines[: count + 1]))
    suite = write_suite(folder, stored("spin", "spin.csv", rows))
    result = check(suite, "--update")
    assert result.exit_code == (2 if refused else 0)
    assert f"a reference of {refused} of 3 s, would pass" in result.stdout or not refused
    assert (folder / "refs" / "spin.parquet").exists() != bool(refused)


@pytest.mark.parametrize(("rows", "share", "code"), [(151, "50", 0), (150, "49.67", 2)])
def test_a_change_is_measured_over_half_of_the_old_reference_at_least(folder, rows, share, code):
    """Attitudes that were not compared are accepted with --force alone."""
    suite = pinned(folder, stored())
    shortened(folder, rows)
    result = check(suite, "--update")
    assert (result.exit_code, largest(result)) == (code, 0)
    assert f" deg from the {share} % of the old reference covered" in result.stdout


@pytest.mark.parametrize("rows", ["every = 30", "rate = 3.7"])
@pytest.mark.parametrize("turned", [False, True])
def test_fewer_attitudes_do_not_hide_how_far_they_have_changed(folder, rows, turned):
    """The change was measured on the stamps that `every` had left."""
    suite = pinned(folder, stored())
    change = [TURNED] if turned else []
    write_suite(folder, stored("spin", "spin.csv", *change))
    all_rows = check(suite, "--update", "--dry-run")
    write_suite(folder, stored("spin", "spin.csv", rows, *change))
    result = check(suite, "--update")
    assert result.exit_code == 0
    assert largest(result) == (largest(all_rows) if turned else 0)


def test_a_case_that_is_replaced_by_another_is_not_forgotten_without_being_asked(folder):
    """A case renamed with its log and reference changed was `new`, without any angle."""
    suite = pinned(folder, stored())
    shortened(folder, 300)
    write_suite(folder, stored("turn", "spin.csv", TURNED))
    preview = check(suite, "--update", "--dry-run")
    assert "would be removed from the lock: 'spin', pinned with 301 samples, " in (preview.stderr)
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert "the lock pins 'spin', which the suite no longer has; restore" in result.stderr
    assert list(lock_of(suite)) == ["spin"]
    assert check(suite, "--update", "-k", "turn").exit_code == 0
    assert list(lock_of(suite)) == ["spin", "turn"]
    assert check(suite, "--update", "--force").exit_code == 0
    assert list(lock_of(suite)) == ["turn"]


def test_an_update_of_some_cases_removes_no_others(folder):
    """With -k, too, all cases that the suite had no more were removed from the lock."""
    suite = pinned(folder, stored("a") + stored("b") + stored("bb"))
    write_suite(folder, stored("a"))
    assert check(suite, "--update", "-k", "a").exit_code == 0
    assert list(lock_of(suite)) == ["a", "b", "bb"]
    assert check(suite, "--update", "-k", "b").exit_code == 0
    assert list(lock_of(suite)) == ["a", "bb"]
    assert check(suite, "--update", "-k", "b*").exit_code == 2
    assert list(lock_of(suite)) == ["a", "bb"]


@pytest.mark.parametrize("chosen", [["spin", "nothere"], ["gone"], ["spin", "go"]])
def test_every_choice_has_a_case(folder, chosen):
    """-k spin -k nothere ran spin alone, and passed; so did a case that was deleted."""
    suite = pinned(folder, stored() + stored("gone"))
    write_suite(folder, stored())
    result = check(suite, *(part for one in chosen for part in ("-k", one)))
    assert result.exit_code == 2
    assert f"no case of {suite} matches -k {chosen[-1]}" in result.stderr


@pytest.mark.parametrize("options", [["-k", "nothere"], []])
def test_a_run_that_ends_at_once_leaves_no_older_results(folder, options):
    """JUnit and the overview of the last run stayed, and were green."""
    suite, junit, page = pinned(folder, stored()), folder / "x.xml", folder / "ev" / "index.html"
    kept = ["--junit", junit, "--artifacts", page.parent]
    assert check(suite, *kept).exit_code == 0
    assert "1 passed" in page.read_text()
    if not options:
        write_suite(folder, "<<<<<<< HEAD\n" + stored())
    result = check(suite, *kept, *options)
    assert result.exit_code == 2
    (tests,) = ET.parse(junit).getroot()  # noqa: S314  # our own file
    assert [tests.get(key) for key in ("tests", "errors")] == ["1", "1"]
    reason = tests.find("./testcase/error").get("message")
    assert result.stderr.strip().endswith(reason)
    assert "1 error" in page.read_text()


def test_a_run_that_ends_at_once_replaces_no_input(folder):
    """Results of an error must not go where there is something else; a new file is none."""
    suite = write_suite(folder, "<<<<<<< HEAD\n" + stored())
    before = suite.read_bytes()
    assert check(suite, "--junit", suite).exit_code == 2
    assert suite.read_bytes() == before
    assert check(suite, "--junit", folder / "new.xml").exit_code == 2
    assert 'errors="1"' in (folder / "new.xml").read_text()


def test_advice_can_be_followed(folder):
    """--init has no --dry-run, and --update leaves a case with xfail as it is."""
    result = check(folder / "new.toml", "--init", folder / "logs/spin.csv", env={"CI": "true"})
    assert "run it on your machine, or write them anyway with --force" in result.stderr
    suite = pinned(folder, stored())
    write_suite(folder, stored("spin", "spin.csv", TURNED, 'xfail = "drifts"'))
    words = "leaves it as it is, because of xfail"
    assert words not in check(suite).stdout
    result = check(suite, "--update")
    assert (result.exit_code, words in result.stdout) == (2, True)


def test_an_error_does_not_read_as_a_pass(folder):
    """Its first line was `0 rad of 1e-09 rad at +0 ns`."""
    suite = pinned(folder, stored())
    write_suite(folder, stored("spin", "spin.csv", 'method = "cubic"'))
    first, second, *_ = check(suite).stdout.splitlines()
    assert first.startswith(
        f"ERROR  spin  {folder / 'refs' / 'spin.parquet'}: the case has changed"
    )
    assert second.strip().startswith("max error 0 rad at +0 ns (limit ")
    assert "pass   spin  would be updated  301 of" in check(suite, "--update", "--dry-run").stdout


@pytest.mark.parametrize("key", ["pin-log = true", "pin-log = false"])
def test_a_case_that_is_renamed_with_its_log_is_compared_with_the_old_one(folder, key):
    """-k with the new name accepted another log, mount, name and reference without any angle."""
    suite = pinned(folder, stored("spin", "spin.csv", key) + stored("other", "rest.parquet"))
    shortened(folder, 300)
    write_suite(folder, stored("turn", "spin.csv", key, TURNED))
    result = check(suite, "--update", "-k", "turn")
    assert result.exit_code == 0
    words = "       compared with 'spin', which is pinned, but not in the suite\n"
    assert words in result.stdout
    assert largest(result) > 100


def test_a_new_case_that_cannot_be_compared_with_one_that_is_gone_is_refused(folder):
    """A case renamed when its old reference was gone was not reported."""
    suite = pinned(folder, stored())
    (folder / "refs" / "spin.parquet").unlink()
    shortened(folder, 300)
    write_suite(folder, stored("turn", "spin.csv", TURNED))
    result = check(suite, "--update", "-k", "turn")
    assert result.exit_code == 2
    assert f"{GONE} gone; restore the old one, or accept it unseen" in result.stdout
    words = "if this is another case, remove that from the lock first, with --update -k spin"
    assert words in result.stdout
    assert check(suite, "--update", "-k", "spin").exit_code == 0
    assert "pass   turn  new  " in check(suite, "--update", "-k", "turn").stdout


def test_a_new_case_is_compared_with_the_one_that_it_most_likely_was(folder):
    """By its log, then by its name; where none is like it, with all that were pinned."""
    pinned(folder, stored("stray", "rest.parquet")).with_suffix(".lock.json").unlink()
    suite = pinned(folder, stored("left") + stored("right") + stored("rest", "rest.parquet"))
    names = ["left-hand", "right-hand", "coning"]
    logs = ["spin.csv", "spin.csv", "coning.mcap"]
    write_suite(folder, "".join(map(stored, names, logs)))
    chosen = [part for name in names for part in ("-k", name)]
    result = check(suite, "--update", "--force", *chosen)
    _, *told = re.split("^pass ", result.stdout, flags=re.MULTILINE)
    compared = {one.split()[0]: re.findall("compared with '(.*?)'", one) for one in told}
    assert [compared[name] for name in names] == [["left"], ["right"], ["left", "rest", "right"]]
    assert "which no case has" not in result.stdout


@pytest.mark.parametrize("name", ["spin", "turn"])
@pytest.mark.parametrize("place", ["refs", "elsewhere"])
def test_without_a_lock_changes_are_shown_against_existing_references(folder, name, place):
    """A deleted lock made all cases new; a reference with another name was ignored."""
    suite = pinned(folder, stored())
    suite.with_suffix(".lock.json").unlink()
    # Files that cannot be read do not end the search.
    (folder / "logs" / "link.parquet").symlink_to("nowhere")
    (folder / "logs" / "other.parquet").write_bytes(b'PAR1 "check"')
    write_suite(folder, stored(name, "spin.csv", TURNED).replace("refs/", f"{place}/"))
    result = check(suite, "--update")
    assert result.exit_code == 0
    assert " updated  301 of 301 " in result.stdout
    assert "       mount: the default -> 'x,-y,-z'\n       final attitude: " in result.stdout
    assert largest(result) > 100


def test_without_a_lock_the_same_references_are_not_new(folder):
    """They were listed as new, like one that nobody has seen before."""
    suite = pinned(folder, stored())
    lock, reference = suite.with_suffix(".lock.json"), folder / "refs" / "spin.parquet"
    before = [lock.read_bytes(), reference.read_bytes()]
    lock.unlink()
    result = check(suite, "--update")
    assert (result.exit_code, largest(result)) == (0, 0)
    assert [lock.read_bytes(), reference.read_bytes()] == before


def test_a_thin_reference_of_an_earlier_version_is_an_error_of_every_run(folder, monkeypatch):
    """It passed whatever came after its few attitudes, until the next update refused it."""
    monkeypatch.setattr("quatprop.tools.check.judge.too_sparse", lambda *_: "")
    suite = pinned(folder, stored("spin", "spin.csv", "every = 150"))
    monkeypatch.undo()
    words = (
        "a reference of 3 of 301 attitudes, over 3 s of 3 s, would pass nearly any change; choose "
        "at least 10 over half of the log with every, and write it with --update"
    )
    for options in ([], ["--update"]):
        result = check(suite, *options)
        assert (result.exit_code, words in result.stdout) == (2, True)
    write_suite(folder, stored("spin", "spin.csv", "every = 15"))
    result = check(suite, "--update")
    assert (result.exit_code, largest(result)) == (0, 0)
    assert check(suite).exit_code == 0


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ('align = "mount"', "the body turns about one axis only"),
        ('time-offset = "auto"', "the speed of the log's attitudes is constant, which shows"),
    ],
)
def test_a_case_that_can_never_be_judged_is_not_pinned(folder, key, words):
    """An update passed with a mounting that one axis does not show; every check was an error."""
    suite = pinned(folder, stored())
    write_suite(folder, stored("spin", "spin.csv", key))
    result = check(suite, "--update")
    assert result.exit_code == 2
    assert words in result.stdout


def test_a_lock_that_was_edited_does_not_hide_another_reference(folder):
    """With its option and SHA-256 edited, and not its angles, a turn of 167 deg passed."""
    suite = pinned(folder, stored())
    angles = lock_of(suite)["spin"]["final_deg"]
    repinned(suite, "spin", final_deg={**angles, "yaw": angles["yaw"] + 0.01})
    assert check(suite).exit_code == 1
    pinned(folder, stored("spin", "spin.csv", TURNED))
    repinned(suite, "spin", final_deg=angles)
    result = check(suite)
    assert result.exit_code == 1
    assert (
        "the last attitudes in the lock and in the reference file are 167.241 deg " in result.stdout
    )
    assert "final attitude: 167.241 deg from the one pinned" in check(suite, "--update").stdout
    assert check(suite).exit_code == 0


def test_a_new_reference_for_a_series_is_not_called_unreadable(folder):
    """There was none: nobody knows by how much the attitudes have changed."""
    truth = stored().replace(
        'reference = "refs/spin.parquet"', 'reference-log = "logs/spin.truth.csv"'
    )
    pinned(folder, truth + 'tol = "1deg"\n')
    result = check(write_suite(folder, stored("spin", "spin.csv", TURNED)), "--update")
    assert result.exit_code == 2
    assert "not comparable: no reference was stored before; restore" in result.stdout


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ('judge = "+0s..+20ms"', "judged at +0s..+20ms alone"),
        ('match = "exact"', "equal timestamps"),
        ('max-dt = "4ms"', "equal timestamps"),
        (
            'match = "nearest"\nmax-dt = "4ms"',
            "the reference series nearest to the log's attitudes within 4 ms, not interpolated",
        ),
        (
            'match = "interpolate"\nmax-dt = "30ms"',
            (
                "the reference series interpolated at the timestamps of the log's attitudes, "
                "over at most 30 ms"
            ),
        ),
    ],
)
def test_matching_and_judged_ranges_are_reported(folder, key, words):
    """A pass of three samples, or of samples near those of the reference, read as any other."""
    suite = pinned(folder, stored("spin", "spin.csv", key))
    assert f"; {words}\n" in check(suite).stdout


@pytest.mark.parametrize("keys", [("pin-log = false",), ()])
def test_a_log_that_is_no_longer_pinned_is_named(folder, keys):
    """It was reported as pinned with another kind of reference."""
    suite = pinned(folder, stored("spin", "spin.csv", *keys))
    write_suite(folder, stored() if keys else stored("spin", "spin.csv", "pin-log = false"))
    result = check(suite)
    assert result.exit_code == 2
    was, now = ("false", "true") if keys else ("true", "false")
    words = f"since it was pinned: pin-log was {was} and is now {now}; restore it, or accept it"
    assert words in result.stdout
    assert "kind of reference" not in result.stdout
    assert "exist" not in result.stdout


def test_up_to_eight_cases_that_pass_are_listed(folder):
    """Among more, those that need attention would be lost."""
    for count in (8, 9):
        suite = pinned(folder, "".join(stored(f"case{number}") for number in range(count)))
        assert ("pass   case0 " in check(suite).stdout) == (count == 8)


def test_a_case_without_lock_entry_and_reference_does_not_pass(folder):
    """With its lock entry and its reference deleted, among many or with -q, no line was shown."""
    others = "".join(stored(f"case{number}") for number in range(8))
    suite = pinned(folder, others + stored())
    lock, before = suite.with_suffix(".lock.json"), lock_of(suite)
    (folder / "refs" / "spin.parquet").unlink()
    told = json.loads(lock.read_text())
    del told["cases"]["spin"]
    lock.write_text(json.dumps(told))
    write_suite(folder, others + stored("spin", "spin.csv", TURNED))
    for options in ([], ["--strict"]):
        result = check(suite, *options, env={"CI": "true"})
        assert result.exit_code == 2
        assert "ERROR  spin   " in result.stdout
        assert "the lock has no entry for this case yet; look at what is" in result.stdout
    assert check(suite, "--update", env={"CI": "true"}).exit_code == 2
    result = check(suite, "--update", "-q")
    assert result.stdout.startswith("pass   spin   new      301 of 301 attitudes in ")
    # A review sees the entry as it was committed, and as it is.
    after = lock_of(suite)
    assert after["spin"]["final_deg"] != before["spin"]["final_deg"]
    assert {name for name in after if after[name] != before[name]} == {"spin"}
