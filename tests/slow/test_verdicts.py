"""Exit code, text, JSON, JUnit, annotations, page and commands say the same of every outcome."""

import pytest
from fuzz.regressions import Study
from make.suites import TRUTH, check, delay, pinned, repinned, stored, with_logs, write_suite
from make.verdicts import contradictions

COPY = TRUTH.replace("coning]", "{}]")


def case_of(name, *lines, tol="0.1deg"):
    """Return a case that is judged by the truth of its log."""
    return "\n".join([COPY.format(name).replace("0.1deg", tol).rstrip(), *lines]) + "\n"


FREE = "pin-log = false"

BEFORE = (
    case_of("good") + case_of("above") + case_of("known") + case_of("unknown")
    + stored("kept") + stored("changed") + stored("gone") + stored("lost", "lost.csv")
    + stored("cut", "cut.csv", FREE) + stored("moved", "moved.csv", FREE)
    + '[case.apart]\nlog = "logs/early.csv"\nreference-log = "logs/spin.truth.csv"\n'
    + f'tol = "1deg"\n{FREE}\n' + stored("stamps") + stored("samples")
)  # fmt: skip

AFTER = (
    BEFORE.replace(stored("gone"), "")
    .replace(case_of("above"), case_of("above", tol="1e-9deg"))
    .replace(case_of("known"), case_of("known", 'xfail = "drifts"', tol="1e-9deg"))
    .replace(case_of("unknown"), case_of("unknown", 'xfail = "drifts"'))
    .replace(stored("changed"), stored("changed", "spin.csv", 'mount = "x,-y,-z"'))
    + '[case.left]\nlog = "logs/none.csv"\nskip = "later"\n'
)

VERDICTS = {
    "good": "pass", "above": "fail", "known": "xfail", "unknown": "xpass", "kept": "pass",
    "changed": "error", "gone": "deleted", "lost": "error", "cut": "fail", "moved": "error",
    "apart": "error", "stamps": "error", "samples": "fail", "left": "skip",
}  # fmt: skip
STRICT = VERDICTS | {"unknown": "fail", "gone": "fail"}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Give a suite with a case of every outcome."""
    folder = with_logs(tmp_path_factory.mktemp("outcomes"))
    for name in ("lost", "cut", "moved", "early"):
        (folder / "logs" / f"{name}.csv").write_bytes((folder / "logs/spin.csv").read_bytes())
    pinned(folder, BEFORE)
    (folder / "logs" / "lost.csv").unlink()
    lines = (folder / "logs" / "cut.csv").read_text().splitlines(keepends=True)
    (folder / "logs" / "cut.csv").write_text("".join([*lines[:500], *lines[523:]]))
    delay(folder / "logs" / "moved.csv", 10**15)
    delay(folder / "logs" / "early.csv", -(10**15))
    (folder / "refs" / "stamps.parquet").write_bytes(b"PAR1 no more")
    repinned(folder / "suite.toml", "samples", samples=1001)
    return write_suite(folder, AFTER)


@pytest.mark.parametrize(("options", "verdicts"), [([], VERDICTS), (["--strict"], STRICT)])
def test_every_form_of_a_result_says_the_same(outcomes, options, verdicts):
    """A log with 23 rows cut out failed by 1 deg, and its page and commands said 0 deg.

    With --strict, JUnit and the annotations knew of no failure where the exit code was 1.
    """
    # The evidence is the same with --strict and without.
    cases, wrong = contradictions(outcomes, *options, evidence="--strict" in options)
    assert {name: case["verdict"] for name, case in cases.items()} == verdicts
    assert wrong == []
    assert check(outcomes, "-k", "good", "-k", "gone", *options).exit_code == 2


def test_no_overlap_is_the_same_for_both_kinds_of_reference(outcomes):
    """One was a failure, the other an error, and both advised an offset for this run alone."""
    said = [check(outcomes, "-k", name).stdout for name in ("moved", "apart")]
    for text in said:
        assert "have no time in common: their timestamps are from different clocks or" in text
        assert 'time-offset = "-' not in text
        assert "; see clock, start" in text
    assert 'time-offset = "auto"' in said[1]


def test_a_sample_of_regressions_is_caught(tmp_path):
    """As of all logs of `fuzz/regressions.py`, by each kind of case."""
    study = Study(tmp_path / "coning", "coning")
    caught = {"pinned": "error", "stored": "fail", "truth": "fail"}
    for regression in ("delay 20 ms", "cut 23 rows"):
        assert study.spoiled(regression, compared=False) == (caught, [])
    unseen = caught | dict.fromkeys(("stored", "truth"), "pass")
    assert study.spoiled("spike 0.01", compared=False) == (unseen, [])
    assert study.rewritten("columns in another order").startswith("pass ")
