"""Batches whose logs or outputs are in an object store."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from make.batches import UP_TO_DATE, batch, entries, said, spin
from make.commands import refused, run
from make.documents import GUIDES
from make.places import SAMPLE_LOGS

from quatprop.base.errors import StoreError
from quatprop.stores.objects import _s3, list_objects
from quatprop.stores.remote import get, remove, upload
from quatprop.tools.batch.log_search import LogSearch
from quatprop.tools.batch.manifest import Manifest, ManifestEntry
from quatprop.tools.batch.planning import shard
from quatprop.tools.batch.tasks import BatchTask


def test_a_store_gives_the_same_results_as_a_folder(bucket, tmp_path):
    """Logs of all kinds below a prefix; the outputs, the names and the manifest are the same."""
    logs, near, far = f"{bucket}/logs", tmp_path / "near", f"{bucket}/runs/1"
    (tmp_path / "logs").mkdir()
    for name, other in (
        ("coning.mcap", "coning.mcap"),
        ("tumbling.bag", "bag.bag"),
        ("rest.parquet", "rest.parquet"),
        ("spin.csv", "spin.csv"),
        ("tumbling_ros2", "tumbling_ros2"),
        ("README.md", "README.md"),
    ):
        copy = shutil.copytree if (SAMPLE_LOGS / name).is_dir() else shutil.copyfile
        copy(SAMPLE_LOGS / name, tmp_path / "logs" / other)
        upload(SAMPLE_LOGS / name, f"{logs}/{other}")
    spin(f"{logs}/.hidden/a.csv")
    batch(tmp_path / "logs", "-o", near, "--to", "csv", "-q", code=0)
    done = batch(logs, "-o", far, "--to", "csv", code=0)
    assert said(done).endswith("; ignored 1 other file")
    outputs = [
        *(
            "bag.bag.csv",
            "coning.mcap.csv",
            "rest.parquet.csv",
            "spin.csv.csv",
            "tumbling_ros2.csv",
        ),
    ]
    found = {name for name in list_objects(far) if not name.startswith("_manifest/")}
    assert found == set(outputs)
    for name in outputs:
        assert get(f"{far}/{name}") == (near / name).read_bytes()
    known = entries(far)
    assert sorted(known) == outputs
    assert (known["spin.csv.csv"]["root"], known["spin.csv.csv"]["log"]) == (logs, "spin.csv")
    assert len(known["spin.csv.csv"]["log_etag"]) == 32
    assert known["spin.csv.csv"]["log_sha256"] is None
    assert {entry["state"] for entry in known.values()} == {"done"}
    assert not list(Path().glob("s3:*"))


PATTERNS = (
    "*", "**", "**/*.csv", "*/*.csv", "run[12]/**", "**/*_ros2", "r*", "**/run1/*.csv", "run1/**/*",
    "r*/**", "run*/*",
)  # fmt: skip


def test_a_pattern_finds_in_a_store_what_it_finds_in_a_folder(bucket, tmp_path):
    """With the same names of outputs: files, bags, and folders that are searched."""
    for place in (tmp_path, f"{bucket}/found"):
        for name in ("a.csv", "run1/a.csv", "run1/deep/b.csv", "run2/c.csv", ".hidden/d.csv"):
            spin(place / name if place is tmp_path else f"{place}/{name}")
    shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", tmp_path / "run2" / "tumbling_ros2")
    upload(SAMPLE_LOGS / "tumbling_ros2", f"{bucket}/found/run2/tumbling_ros2")
    for pattern in PATTERNS:
        near, far = LogSearch(), LogSearch()
        near.add(f"{tmp_path}/{pattern}")
        far.add(f"{bucket}/found/{pattern}")
        assert [log.name for log in far.logs] == [log.name for log in near.logs]
        assert far.logs
    words = refused("batch", f"{bucket}/found/*.mcap", "-o", f"{bucket}/out")
    assert "nothing matches 's3://" in words


def test_up_to_date_outputs_in_a_store_are_skipped(bucket):
    """By size, time and ETag of the log; also where the log has the same size as before."""
    logs, out = f"{bucket}/logs", f"{bucket}/out"
    for name in "ab":
        spin(f"{logs}/{name}.csv")
    again = (logs, "-o", out, "--skip-existing")
    batch(*again, "-q", code=0)
    assert batch(*again).stderr == "nothing to do: all 2 outputs are up to date\n"
    spin(f"{logs}/b.csv", rate=2.0)
    words = "1 of 1 logs done, 5 samples; 1 skipped, as their outputs are up to date"
    assert said(batch(*again)) == words
    assert said(batch(*again, "--method", "mean")) == "2 of 2 logs done, 10 samples"
    assert sorted(entries(out)) == ["a.csv.parquet", "b.csv.parquet"]


def test_folders_go_to_a_store_too(bucket, tmp_path):
    """An output that is a ROS 2 bag is all of its files, as is a log that is one."""
    upload(SAMPLE_LOGS / "tumbling_ros2", f"{bucket}/a")
    for out in (f"{bucket}/out", tmp_path / "out"):
        arguments = (f"{bucket}/a", "-o", out, "--to", "rosbag2", "--skip-existing")
        batch(*arguments, code=0)
        assert batch(*arguments).stderr == UP_TO_DATE
    made = {path.name for path in (tmp_path / "out" / "a").iterdir()}
    assert made == {"a.db3", "metadata.yaml"}
    assert {f"a/{name}" for name in made} <= set(list_objects(f"{bucket}/out"))


def test_an_output_of_another_log_in_a_store_is_not_replaced(
    bucket, tmp_path, store_server, monkeypatch
):
    """Unless that is gone, which a store that does not answer does not say."""
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    _s3.cache_clear()
    one, other = (spin(f"{bucket}/{name}/imu.csv") for name in "12")
    batch(one, "-o", tmp_path, code=0)
    words = f"'{one}' and '{other}' would have one output, '{tmp_path / 'imu.csv.parquet'}'; keep"
    assert words in refused("batch", other, "-o", tmp_path, "-q")
    store_server.before = lambda _, path: "503 Slow Down" if path.endswith("/1/imu.csv") else None
    assert words in refused("batch", other, "-o", tmp_path, "-q")
    # Nor does it end a batch of other logs.
    line = (f"{bucket}/1", spin(tmp_path / "b.csv"), "-o", tmp_path, "--skip-existing")
    assert said(batch(*line, code=2)) == "1 of 2 logs done, 5 samples"
    store_server.before = lambda *_: None
    _s3.cache_clear()
    remove(one)
    batch(other, "-o", tmp_path, code=0)


def test_a_manifest_in_a_store_that_does_not_answer_is_not_empty(bucket, store_server, monkeypatch):
    """Entries that another batch merges meanwhile are read from their new place."""
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    _s3.cache_clear()
    out = f"{bucket}/out"
    manifest = Manifest(out)
    manifest.record(ManifestEntry("done", "/in", "a.csv", "a.npy"))

    def is_lines(path):
        return path.endswith(".jsonl")

    store_server.before = lambda _, path: "503 Slow Down" if is_lines(path) else None
    with pytest.raises(StoreError, match=r"\.jsonl: the store is overloaded \("):
        entries(out)

    def merged(_, path):
        if is_lines(path):
            store_server.before = lambda *_: None
            manifest.collect()

    store_server.before = merged
    assert list(entries(out)) == ["a.npy"]
    assert not any(map(is_lines, list_objects(out)))
    _s3.cache_clear()


def test_outputs_among_the_logs_are_refused(bucket):
    """As in a folder; outputs below the searched prefix are ignored."""
    logs = f"{bucket}/logs"
    spin(f"{logs}/a.csv")
    assert refused("batch", logs, "-o", f"{logs}/") == (
        f"Error: outputs in '{logs}' would lie among the logs; choose --output another folder"
    )
    for _ in range(2):
        assert said(batch(logs, "-o", f"{logs}/out")) == "1 of 1 logs done, 5 samples"
    other = spin(f"{logs}/a.csv.csv")
    words = refused("batch", f"{logs}/a.csv", other, "-o", logs, "--to", "csv")
    assert words == f"Error: {other}: this is an input of the run; choose another output"


@pytest.mark.parametrize(
    ("log", "out", "sentence"),
    [
        ("{bucket}/none", "out", "{bucket}/none: no such object; check"),
        ("s3://nobody-has-this", "out", "s3://nobody-has-this: no such object"),
        ("a.csv", "s3://nobody-has-this/out", "no such bucket ("),
        ("a.csv", "s3://denied/out", "its store does not permit that ("),
        ("s3://denied/logs", "out", "its store does not permit that ("),
        ("s3://denied/a.csv", "out", "its store does not permit that ("),
    ],
)
def test_an_error_of_a_store_is_one_sentence(bucket, tmp_path, log, out, sentence):
    """No bucket, no object, no rights: exit code 2, before anything is done where it is known."""
    log = spin(tmp_path / log) if log == "a.csv" else log.format(bucket=bucket)
    out = tmp_path / out if out == "out" else out
    words = refused("batch", log, "-o", out, "-q")
    assert words.startswith("Error: s3://")
    assert sentence.format(bucket=bucket) in words


@pytest.mark.parametrize("way", ["here", "dask"])
def test_an_output_that_a_store_cannot_describe_is_not_stale(
    bucket, tmp_path, store_server, monkeypatch, way
):
    """It was moved to the stale outputs; on a cluster it is looked up again."""
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setattr("quatprop.tools.batch.execution.LOOK_S", 0.01)
    _s3.cache_clear()
    asked, log = [], spin(tmp_path / "a.csv")

    def overloaded(method, path):
        if method == "HEAD" and path.endswith("/a.csv.parquet"):
            asked.append(path)
            return "503 Slow Down" if len(asked) < 3 else None  # Arrow asks twice
        return None

    store_server.before = overloaded
    line = ("batch", log, "-o", f"{bucket}/out", "--skip-existing")
    if way == "here":
        words = f"Error: {bucket}/out/a.csv.parquet: the store is overloaded ("
        assert run(*line, "-j1", code=2).stderr.startswith(words)
    else:
        distributed = pytest.importorskip("distributed")
        options = {"processes": False, "dashboard_address": ":0"}
        with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
            run(*line, "--dask", cluster.scheduler_address, code=0)
    assert len(asked) == (2 if way == "here" else 3)
    assert "a.csv.parquet" in list_objects(f"{bucket}/out")
    run(*line, "-j1", code=0)
    assert entries(f"{bucket}/out")["a.csv.parquet"]["state"] == "done"
    _s3.cache_clear()


def test_an_output_that_is_gone_at_once_is_no_result(bucket, tmp_path, store_server):
    """An output that a store accepted and does not have is not done."""
    store_server.before = lambda method, path: (
        "404 Not Found" if method == "HEAD" and path.endswith("/a.csv.parquet") else None
    )
    log = spin(tmp_path / "a.csv")
    assert batch(log, "-o", f"{bucket}/out", "-q", code=2).stderr == (
        f"Error: {log}: its output was changed\n"
    )
    assert entries(f"{bucket}/out")["a.csv.parquet"]["state"] == "failed"


FLEETS = GUIDES / "fleets.md"


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
@pytest.mark.parametrize(
    ("scheduler", "variables"),
    [
        ("Slurm", {"SLURM_ARRAY_TASK_ID": 1, "SLURM_ARRAY_TASK_COUNT": 7}),
        ("Kubernetes", {"JOB_COMPLETION_INDEX": 0}),
        ("AWS Batch", {"AWS_BATCH_JOB_ARRAY_INDEX": 0, "AWS_BATCH_JOB_ARRAY_SIZE": 7}),
    ],
)
def test_the_examples_of_array_jobs_divide_the_logs(scheduler, variables, tmp_path):
    """With the variables of each scheduler, the jobs together are given every log once."""
    section = FLEETS.read_text().split(f"### {scheduler}\n")[1].split("\n## ")[0]
    command = re.search(r"quatprop batch [^\n]*", section)[0].split('"],')[0]
    shim = tmp_path / "quatprop"
    shim.write_text('#!/bin/sh\nfor each; do last=$each; done\necho "$last"\n')
    shim.chmod(0o755)
    every = [BatchTask("in", f"{number}.csv") for number in range(50)]
    parts, (first, begin) = [], next(iter(variables.items()))
    for job in range(20 if len(variables) == 1 else 7):
        values = {name: str(value) for name, value in {**variables, first: begin + job}.items()}
        environment = {**os.environ, **values, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
        text = subprocess.check_output(["/bin/sh", "-c", command], env=environment, text=True)
        parts += [log.name for log in every if shard(text.strip()).has(log)]
    assert sorted(parts) == sorted(log.name for log in every)


@pytest.mark.parametrize("key", ["s3://b/k.csv", "../../x.csv", "a/./b.csv", "/c.csv"])
def test_a_key_that_is_not_a_path_fails_alone(monkeypatch, tmp_path, key):
    """Such a key stopped the batch, or could name an output outside of the folder."""
    monkeypatch.setattr(
        "quatprop.tools.batch.log_search.list_objects", lambda _address: {key: None}
    )
    monkeypatch.setattr("quatprop.tools.batch.log_search._is_folder", lambda path: "://" in path)
    monkeypatch.setattr("quatprop.tools.batch.log_search.exists", lambda _path: False)
    monkeypatch.setattr("quatprop.tools.batch.planning.exists", lambda _path: True)
    good, out = spin(tmp_path / "good.csv"), tmp_path / "deep" / "out"
    done = batch("s3://bucket/logs", good, "-o", out, "--to", "csv", code=2)
    assert (
        f"Error: s3://bucket/logs/{key}: its key has an empty part, '.', '..' or parameters; "
        "no address can have these: rename it\n"
    ) in done.stderr
    assert said(done) == "1 of 2 logs done, 5 samples"
    files = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert [name for name in files if not name.endswith(".pq")] == ["good.csv", "good.csv.csv"]


@pytest.mark.parametrize(
    ("pattern", "is_meant"),
    [("r*", True), ("*/**", True), ("r*/*/*.csv", True), ("r*/*.csv", False)],
)
def test_a_matched_key_that_is_not_a_path_is_reported(monkeypatch, pattern, is_meant):
    """A log that the pattern does not match cannot fail."""
    keys = {"run/a.csv": None, "run//b.csv": None}
    monkeypatch.setattr("quatprop.tools.batch.log_search.list_objects", lambda _address: keys)
    monkeypatch.setattr("quatprop.tools.batch.log_search.origin_of_object", lambda _info: "")
    monkeypatch.setattr("quatprop.tools.batch.log_search.exists", lambda _path: False)
    search = LogSearch()
    search.add(f"s3://bucket/logs/{pattern}")
    assert ("run//b.csv" in [log.log for log in search.logs if log.refused]) == is_meant
