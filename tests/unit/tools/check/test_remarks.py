"""Remarks on the log of a case are pinned with it: a new one is shown, and may be a failure."""

import json

from make.suites import check, lock_of, pinned, stored, write_suite
from make.tables import write_rates


def frozen(folder):
    """Write a log with repeated stamps and a gap, in which every rate is zero."""
    rows = [(k * 10_000_000, 0, 0, 0) for k in range(300) if not 100 < k < 150]
    rows[20:20] = [rows[20]] * 79
    return write_rates(folder / "logs" / "frozen.csv", rows)


def test_a_new_suite_shows_the_remarks_on_its_logs(folder):
    """Repeated stamps, gaps and rates that are all zero were accepted silently."""
    suite = folder / "ci.toml"
    result = check(suite, "--init", frozen(folder))
    assert result.exit_code == 0
    for words in (
        "remark: 79 repeated timestamps",
        "remark: 1 interval longer",
        "remark: every ra",
    ):
        assert words in result.stdout
    # Codes, of which there is one for each kind: sentences change.
    assert {"zero-rates"} < {*lock_of(suite)["frozen"]["remarks"]}


def test_a_remark_that_is_not_pinned_is_shown_and_strictly_a_failure(folder, monkeypatch):
    """A pinned remark is known; another number in its sentence is no other remark."""
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    rows = [(k * 10_000_000, k % 7, 1, k % 3) for k in range(300)]
    write_rates(folder / "logs" / "made.csv", [*rows[:5], rows[5], *rows[5:]])
    case = stored("made", "made.csv", "pin-log = false", 'align = "first"', 'tol = "400deg"')
    suite = pinned(folder, case)
    known = lock_of(suite)["made"]["remarks"]
    write_rates(folder / "logs" / "made.csv", [*rows[:5], *[rows[5]] * 3, *rows[5:]])
    assert "note" not in check(suite, "--strict").stdout
    holes = [row for k, row in enumerate(rows) if not 100 < k < 150]
    write_rates(folder / "logs" / "made.csv", [*holes[:5], holes[5], *holes[5:]])
    write_suite(folder, case + "min-coverage = 10\n")
    result = check(suite)
    assert result.exit_code == 0
    assert "note on made: 1 interval longer than 100 ms" in result.stdout
    assert "::warning file=" in result.stderr
    (found,) = json.loads(check(suite, "--json").stdout)["cases"]
    assert len(found["unpinned"]) == 1
    assert len(found["remarks"]) == len(known) + 1
    result = check(suite, "--strict", "--artifacts", folder / "evidence")
    assert result.exit_code == 1
    assert "not pinned: 1 interval longer than 100 ms" in result.stdout
    assert "with --strict this is a failure" in result.stdout
    # Accepted, it is listed, on the screen and in the lock.
    result = check(suite, "--update")
    assert "pass   made  kept     " in result.stdout
    assert "remark: 1 interval longer than 100 ms" in result.stdout
    assert set(lock_of(suite)["made"]["remarks"]) == {*known, *found["unpinned"]}
    assert check(suite, "--strict").exit_code == 0
