"""Many logs at a time: what goes wrong with some of them, outputs, options, clusters."""

import json
import math
import os
import random

import pytest
from make.batches import batch, entries, outputs_in, said, spin
from make.commands import refused, run
from make.ros import imu_messages, write_messages

from quatprop.base.errors import TRACEBACK, LogError, UsageError
from quatprop.base.processes import ThisProcess
from quatprop.cli.batch import command
from quatprop.cli.propagate import command as propagate
from quatprop.propagation.job import Job
from quatprop.propagation.settings import OutputSettings
from quatprop.tools.batch import execution, worker
from quatprop.tools.batch.log_search import LogSearch
from quatprop.tools.batch.planning import BatchSettings, refuse_shared_names

SETTINGS = BatchSettings.for_job(Job("LOG", OutputSettings("OUT")), "OUT")


# Logs with which something is wrong


def test_one_log_that_fails_does_not_stop_the_others(tmp_path):
    """Its error is shown, and in the report; the others are done, and the exit code is 2."""
    good, bad, out = spin(tmp_path / "good.csv"), tmp_path / "bad.csv", tmp_path / "out"
    bad.write_text("0,20\n1,21\n2,22\n")
    done = batch(bad, good, "-o", out, "-q", "--json", code=2)
    sentence = (
        f"{bad}: no body rates found; its columns are '0', '1'; "
        "name the columns with --rate-cols and --time-col"
    )
    assert done.stderr == f"Error: {sentence}\n"
    assert outputs_in(out) == ["good.csv.parquet"]
    assert entries(out)["bad.csv.parquet"]["error"] == sentence
    first, second = json.loads(done.stdout)
    assert [first["log"], second["log"]] == [str(bad), str(good)]
    assert first["error"] == sentence
    assert second["report"]["result"]["samples"] == 5


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (ZeroDivisionError("by zero"), "{log}: This is a bug in quatprop (ZeroDivisionError: "),
        (OSError(28, "No space", "far/a"), "{log}: far/a: system error (No space"),
    ],
)
def test_an_unexpected_exception_does_not_stop_the_others(tmp_path, monkeypatch, error, sentence):
    """A bug that one log triggers fails that log alone."""
    run_job = worker.run

    def fails(job, **options):
        if job.log.endswith("bad.csv"):
            raise error
        return run_job(job, **options)

    monkeypatch.delenv(TRACEBACK, raising=False)
    monkeypatch.setattr(worker, "run", fails)
    bad, good = (spin(tmp_path / name) for name in ("bad.csv", "good.csv"))
    done = batch(bad, good, "-o", tmp_path / "out", code=2)
    assert f"Error: {sentence.format(log=bad)}" in done.stderr
    assert said(done) == "1 of 2 logs done, 5 samples"
    monkeypatch.setenv(TRACEBACK, "1")
    if isinstance(error, ZeroDivisionError):
        with pytest.raises(ZeroDivisionError):
            batch(bad, "-o", tmp_path / "out")


def test_an_output_below_a_file_is_an_error_of_its_log(tmp_path):
    """If the folder of an output cannot be created, only its log fails."""
    first, _ = (spin(tmp_path / "runs" / name / "imu.csv") for name in "12")
    out = tmp_path / "out"
    out.mkdir()
    (out / "1").write_text("in the way")
    done = batch(tmp_path / "runs", "-o", out, code=2)
    assert f"Error: {first}: {out / '1'}: system error (" in done.stderr
    assert f"1 failed:\n  {first}: " in done.stderr
    assert (out / "2" / "imu.csv.parquet").exists()


@pytest.mark.parametrize(
    "options",
    ["--bias static", "--bias static@+0s..+9s", "--mount tf:base", "--q0 level", "--bias /b"],
)
def test_errors_of_a_batch_name_the_log(tmp_path, options):
    """Each error, also one that an option causes, is shown at once and in the list at the end."""
    logs = [spin(tmp_path / name, rate=9) for name in ("a.csv", "b.csv")]
    done = batch(*logs, "-o", tmp_path / "out", *options.split(), code=2)
    lines = [line for line in done.stderr.splitlines() if str(tmp_path) in line]
    leads = [f"{lead}{log}: " for lead in ("Error: ", "  ") for log in logs]
    assert [line[: len(lead)] for line, lead in zip(lines, leads, strict=True)] == leads
    assert f"{logs[0]}: {logs[0]}" not in done.stderr


def test_errors_of_a_batch_name_the_topic(tmp_path):
    """Only one of two topics moves; topics of one log are counted as series."""
    swing = [math.sin(k / 9) for k in range(400)]
    still, moving = ([(x, 0, 0) for x in rate] for rate in ([0] * 400, swing))
    stamps = [k * 10**7 for k in range(400)]
    topics = {"/a/imu": still, "/b/imu": moving}
    messages = [
        (topic, *row[1:]) for topic, rate in topics.items() for row in imu_messages(stamps, rate)
    ]
    log = write_messages(tmp_path / "log.mcap", sorted(messages, key=lambda row: row[2]))
    words = ("-o", tmp_path / "out", "-t", "*", "--bias", "static")
    done = batch(log, *words, code=2).stderr.splitlines()
    error = f"{log}:/b/imu: no stationary period (the rates scatter by at least 0.651 rad/s); give "
    assert [line for line in done if line.startswith((f"Error: {error}", f"  {error}"))] == [
        f"Error: {error}--bias X,Y,Z, or look for a shorter one with --bias static:DUR",
        f"  {error}--bias X,Y,Z, or look for a shorter one with --bias static:DUR",
    ]
    assert any(line.startswith(f"{log}:/a/imu  ") for line in done)
    assert done[-1] == "1 of 2 series of 1 log done, 400 samples"


def test_lost_data_of_any_log_is_code_3(tmp_path):
    """As for one log: the rest of a damaged log is written, and the exit code is 3."""
    torn, whole = spin(tmp_path / "torn.csv"), spin(tmp_path / "whole.csv")
    torn.write_text(torn.read_text() + "500000000,0\n")
    done = batch(torn, whole, "-o", tmp_path / "out", code=3)
    assert "lost: line 7: it has 2 columns instead of 4" in done.stderr
    done = batch(torn, whole, "-o", tmp_path / "out", "--skip-existing", code=3)
    assert done.stderr == (
        "nothing to do: all 2 outputs are up to date; data was lost in 1 of them\n"
    )


EXPECTED = 'rate = "10Hz"\ngaps = 0\nunit = "rad/s"\n'


def test_the_manifest_says_which_logs_are_not_as_expected(tmp_path):
    """They are done; the exit code is 1, also where they are skipped the next time."""
    good, gap, out = spin(tmp_path / "good.csv"), spin(tmp_path / "gap.csv", samples=40), "out"
    rows = gap.read_text().splitlines(keepends=True)
    gap.write_text("".join(rows[:5] + rows[25:]))
    expected = tmp_path / "expected.toml"
    expected.write_text(EXPECTED)
    options = (good, gap, "-o", tmp_path / out, "--expect", expected)
    shown = batch(*options, code=1).stderr
    reason = "1 gap, expected at most 0, the first before "
    assert f"  not as expected: {reason}" in shown
    assert "\n1 log not as expected\n" in shown
    found = {name: entry["unmet"] for name, entry in entries(tmp_path / out).items()}
    assert found["good.csv.parquet"] == []
    assert [one.startswith(reason) for one in found["gap.csv.parquet"]] == [True]
    assert "1 log not as expected" in batch(*options, "--skip-existing", code=1).stderr
    # Other expectations are looked at, and none are none.
    expected.write_text(EXPECTED.replace("gaps = 0", "gaps = 1"))
    batch(*options, "--skip-existing", code=0)
    batch(*options[:-2], code=0)
    assert {entry["unmet"] for entry in entries(tmp_path / out).values()} == {None}


def test_topics_that_are_not_as_expected_are_counted_as_series(tmp_path):
    """Next to "2 of 2 series of 1 log done" stood "2 logs not as expected"."""
    messages = [
        (topic, *row[1:])
        for topic in ("/a/imu", "/b/imu")
        for row in imu_messages([k * 10**7 for k in range(40)], [(1, 2, 3)] * 40)
    ]
    log = write_messages(tmp_path / "log.mcap", sorted(messages, key=lambda row: row[2]))
    expected = tmp_path / "expected.toml"
    expected.write_text('rate = "10Hz"\n')
    options = (log, "-o", tmp_path / "out", "-t", "*", "--expect", expected)
    *_, unmet, done = batch(*options, code=1).stderr.splitlines()
    assert (unmet, done) == (
        "2 series not as expected", "2 of 2 series of 1 log done, 80 samples"
    )  # fmt: skip
    assert batch(*options, "--skip-existing", code=1).stderr.startswith("2 series not as expected")


def test_expectations_that_cannot_be_read_are_refused(tmp_path):
    """In one sentence with the file, before anything is done."""
    log, expected = spin(tmp_path / "log.csv"), tmp_path / "expected.toml"
    for text, sentence in (
        ("rat = 1", f"Error: {expected}: 'expect' has no key 'rat'"),
        ("rate = ", f"Error: {expected}: "),
    ):
        expected.write_text(text)
        said = refused("batch", log, "-o", tmp_path / "out", "--expect", expected)
        assert said.startswith(sentence)
    missing = tmp_path / "missing.toml"
    said = refused("batch", log, "-o", tmp_path / "out", "--expect", missing)
    assert said == f"Error: {missing}: no such file or folder; check the path"
    assert not (tmp_path / "out").exists()


def test_keys_in_addresses_are_not_shown(tmp_path):
    """Neither with the name of the log, nor in its error, nor in the report."""
    done = batch("nowhere://key:secret@logs/a.mcap", "-o", tmp_path, "--json", code=2)
    assert "secret" not in done.stdout + done.stderr
    assert "nowhere://logs/a.mcap: unknown kind of store (" in done.stderr
    assert json.loads(done.stdout)[0]["log"] == "nowhere://logs/a.mcap"


# Outputs


FOLDERS = (
    "keep their folders in the names with --root DIR, a folder above both, or write to another "
    "folder"
)


def test_two_logs_never_share_an_output(tmp_path):
    """The second of two logs of one name failed, after the first was done."""
    one, out = spin(tmp_path / "a.csv"), tmp_path / "out"
    other = spin(tmp_path / "b" / "a.csv", samples=7)
    words = f"'{one}' and '{other}' would have one output, '{out / 'a.csv.parquet'}'; {FOLDERS}"
    assert refused("batch", one, other, "-o", out) == f"Error: {words}"
    assert not out.exists()
    batch(one, other, "-o", out, "--root", tmp_path, code=0)
    assert set(entries(out)) == {"a.csv.parquet", "b/a.csv.parquet"}
    another = spin(tmp_path / "c.csv")
    batch(one, tmp_path / "." / "a.csv", another, another, "-o", out, "-q", code=0)
    assert len(entries(out)) == 3


def test_two_names_of_one_topic_are_refused(tmp_path):
    """Both would be the one output of that topic."""
    log = tmp_path / "a.mcap"
    run("simulate", log, "--samples", "9", "--truth", "none", code=0)
    words = refused("batch", f"{log}:/imu", f"{log}:imu", "-o", tmp_path / "out")
    assert f"would have one output, '{tmp_path / 'out' / 'a.mcap' / 'imu.parquet'}'; " in words


@pytest.mark.parametrize("number", range(40))
def test_logs_of_one_name_have_outputs_of_their_own(tmp_path, number):
    """Whatever they differ in: suffix, compression, topic, or a folder."""
    draw = random.Random(number)
    stems, suffixes = ("run1", "run1.csv", "run1.mcap", "b"), (".csv", ".csv.gz", ".mcap", "")
    names = {
        f"{draw.choice(('', 'd/', 'd/e/'))}{draw.choice(stems)}{draw.choice(suffixes)}"
        f"{draw.choice(('', '', ':/imu', ':/imu/b'))}"
        for _ in range(30)
    }
    search = LogSearch(str(tmp_path), suffix=".parquet")
    for name in sorted(names):
        search.add(str(tmp_path / name))
    logs = search.logs
    assert len({log.name for log in logs}) == len(logs) == len(names)
    refuse_shared_names(logs, str(tmp_path / "out"))
    twice = draw.choice(logs)
    with pytest.raises(UsageError, match="would have one output"):
        refuse_shared_names([*logs, twice._replace(root="/elsewhere")], str(tmp_path / "out"))


def test_a_table_next_to_a_recording_has_an_output_of_its_own(tmp_path):
    """run1.csv together with run1.mcap refused the whole batch."""
    (tmp_path / "in").mkdir()
    run("simulate", tmp_path / "in" / "run1.mcap", "--samples", "9", "--truth", "none", code=0)
    spin(tmp_path / "in" / "run1.csv")
    out = tmp_path / "out"
    for _ in range(2):
        batch(tmp_path / "in", "-o", out, code=0)
        assert outputs_in(out) == ["run1.csv.parquet", "run1.mcap.parquet"]
        assert {name: entry["samples"] for name, entry in entries(out).items()} == {
            "run1.csv.parquet": 5, "run1.mcap.parquet": 9,
        }  # fmt: skip


def test_an_output_of_another_log_is_not_replaced(tmp_path):
    """One log at a time, too: the manifest knows whose output it is."""
    one, other = spin(tmp_path / "1" / "imu.csv"), spin(tmp_path / "2" / "imu.csv")
    batch(one, "-o", tmp_path / "out", code=0)
    words = refused("batch", other, "-o", tmp_path / "out", "-q")
    place = tmp_path / "out" / "imu.csv.parquet"
    assert words == f"Error: '{one}' and '{other}' would have one output, '{place}'; {FOLDERS}"
    assert entries(tmp_path / "out")["imu.csv.parquet"]["root"] == str(tmp_path / "1")
    batch(other, "-o", tmp_path / "out", "--root", tmp_path, code=0)
    batch(one, "-o", tmp_path / "out", code=0)


def test_a_log_that_was_moved_keeps_its_output(tmp_path):
    """It was refused, with the whole batch, as the output was that of the log as it had been."""
    spin(tmp_path / "in" / "a.csv")
    batch(tmp_path / "in", "-o", tmp_path / "out", code=0)
    folder = (tmp_path / "in").rename(tmp_path / "moved")
    done = batch(folder, "-o", tmp_path / "out", code=0)
    assert said(done).startswith("1 of 1 logs done, 5 samples")
    assert entries(tmp_path / "out")["a.csv.parquet"]["state"] == "done"


def test_a_file_behind_a_link_is_not_moved_to_stale(tmp_path):
    """A file outside of the folder of outputs was moved into it, as an earlier output."""
    log = spin(tmp_path / "in" / "sub" / "a.csv")
    (tmp_path / "outside").mkdir()
    precious = tmp_path / "outside" / "a.csv.parquet"
    precious.write_text("precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "sub").symlink_to(tmp_path / "outside")
    log.write_text("nothing")
    batch(tmp_path / "in", "-o", tmp_path / "out", code=2)
    assert precious.read_text() == "precious"


def test_outputs_do_not_replace_other_logs(tmp_path):
    """The output of one log may not have the name of another log."""
    first, other = spin(tmp_path / "x" / "a.csv"), spin(tmp_path / "out" / "x" / "a.csv.csv", 2)
    before = other.read_bytes()
    options = ("-o", tmp_path / "out", "--to", "csv", "--root", tmp_path)
    words = refused("batch", first, other, *options)
    assert words.endswith(f"{other}: this is an input of the run; choose another output")
    assert other.read_bytes() == before


@pytest.mark.parametrize("name", ["a.csv.parquet", "sub", "_manifest"])
def test_links_in_the_folder_of_outputs_are_not_followed_out_of_it(tmp_path, name):
    """Files outside were replaced through links, which anyone who writes there may put there."""
    for log in ("a.csv", "sub/b.csv"):
        spin(tmp_path / "in" / log)
    out, outside = tmp_path / "out", tmp_path / "outside"
    (tmp_path / "real").mkdir()
    out.symlink_to("real")  # the folder itself may be a link
    outside.mkdir()
    place, shown = outside / "file", out / name
    if name == "a.csv.parquet":
        place.write_text("precious")
        shown.symlink_to(place)
    else:
        shown.symlink_to(outside)
        place = outside / "b.csv.parquet" if name == "sub" else outside
        shown = out / "sub" / "b.csv.parquet" if name == "sub" else shown
    done = batch(tmp_path / "in", "-o", out, code=2)
    assert (
        f": {shown}: it leads to {place}, which is outside {tmp_path / 'real'}; remove the "
        "link or the path that leads there\n"
    ) in done.stderr
    assert [path.read_text() for path in outside.iterdir()] == ["precious"] * (
        name == "a.csv.parquet"
    )
    written = {path.name for path in out.rglob("[ab].csv.parquet") if not path.is_symlink()}
    assert written == {"a.csv.parquet": {"b.csv.parquet"}, "sub": {"a.csv.parquet"}}.get(
        name, set()
    )


# Options


def test_a_batch_uses_the_cores_that_it_may_use(tmp_path, monkeypatch):
    """A scheduler may allow a job fewer cores than the machine has."""
    counts = []

    def noted(processes, _items, **_isolated):
        counts.append(processes)
        return ThisProcess(), 1

    monkeypatch.setattr(execution, "own_executor", noted)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {1, 4, 6}, raising=False)
    for options in ((), ("-j", 5)):
        run("batch", spin(tmp_path / "a.csv"), "-o", tmp_path / "out", "-q", *options)
    assert counts == [3, 5]
    assert SETTINGS.with_threads(4).job.settings.threads == 4
    assert SETTINGS.with_threads(2).with_threads(4).job.settings.threads == 2


ONE_LOG = {"output", "to", "report", "plot", "quiet", "verbose", "in-sequence"}
"""Options of propagate that are about one log: batch has its own of some of them, or none."""

EVERY_LOG = {
    "--layout": "xyzw", "--with": "rotvec", "--euler-unit": "deg", "--header-comment": None,
    "--message": "TFMessage", "--out-topic": "/q",
    "--frames": "map,base", "--method": "coning", "--rates": "inertial", "--q0": "0,1,0,0",
    "--heading": "90", "--reference-z": "down", "--q0-layout": "xyzw", "--bias": "1,2,3",
    "--calibration": __file__, "--imu": __file__, "--sigma": None, "--sigma-axes": "reference",
    "--noise-density": "0.2deg/sqrt(h)", "--bias-sigma": "20deg/h", "--scale-sigma": "1000ppm",
    "--random-walk": "1e-5rad/s/sqrt(s)", "--misalignment-sigma": "5mrad", "--q0-sigma": "1deg",
    "--mount": "x,-y,-z", "--start": "+1s", "--end": "-1s", "--on-backwards": "drop",
    "--on-nonfinite": "hold", "--max-gap": "2s", "--on-gap": "zero", "--regular-time": None,
    "--every": "3", "--rate": "50", "--at": __file__, "--from": "csv", "--topic": "/imu",
    "--msg-path": __file__, "--rate-field": "a.b", "--series": "gyro",
    "--time-field": "a.t", "--rate-cols": "1,2,3", "--time-col": "0", "--rate-unit": "deg/s",
    "--time-unit": "ms", "--sample-rate": "10", "--clock": "log", "--earth-rate": "45",
    "--accel-cols": "4,5,6",
}  # fmt: skip
"""Option of propagate that holds for every log -> a value that is not its default."""

WITH = {
    "--heading": ("--q0", "level"),
    "--reference-z": ("--q0", "level"),
    "--q0-layout": ("--q0", "1,0,0,0"),
    "--euler-unit": ("--with", "euler-zyx"),
    "--sigma": ("--noise-density", "0.2deg/sqrt(h)"),
    "--sigma-axes": ("--sigma", "--noise-density", "0.2deg/sqrt(h)"),
}
"""Other options that an option needs."""


def test_every_option_of_propagate_holds_for_every_log_or_is_about_one():
    """Whoever adds an option to propagate has to decide here which it is."""
    names = {name for option in propagate.params for name in option.opts if name.startswith("--")}
    elsewhere = {"--config", "--threads"} | {f"--{name}" for name in ONE_LOG}
    assert names == EVERY_LOG.keys() | elsewhere
    own = {name for option in command.params for name in option.opts if name.startswith("--")}
    assert own == EVERY_LOG.keys() | {"--config", "--output", "--to", "--quiet", "--json", "--dask",
                                      "--skip-existing", "--list", "--verify", "--root", "--shard",
                                      "--retries", "--threads", "--expect"}  # fmt: skip


@pytest.mark.parametrize("option", EVERY_LOG)
def test_an_option_means_the_same_as_in_propagate(option, tmp_path, monkeypatch):
    """It makes the same job, and a different one from that without the option."""
    jobs = []

    def record(job, *_, **__):
        jobs.append(job)
        raise LogError(job.log, "that is all")

    monkeypatch.setattr("quatprop.propagation.job.run", record)
    monkeypatch.setattr(worker, "run", record)
    value, needed = EVERY_LOG[option], WITH.get(option, ())
    given = [option] if value is None else [option, value]
    for words in (given, []):
        run("propagate", "a.mcap", "-o", tmp_path / "a.mcap.parquet", *needed, *words)
        run("batch", "a.mcap", "-o", tmp_path, *needed, *words)
    alone, among, plain, plain_among = [
        job._replace(display_names=None, output=job.output._replace(to=None)) for job in jobs
    ]
    assert alone == among
    assert plain == plain_among
    assert alone != plain
