"""Batches whose logs or outputs are in an object store."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS

import quatprop
from quatprop.batch.execution import shard
from quatprop.batch.logs import FoundLog, LogSearch
from quatprop.batch.store_manifest import manifest_in
from quatprop.cli.commands import cli
from quatprop.stores.objects import list_objects
from quatprop.stores.transfers import get, put, upload

HEADER = "t_ns,wx,wy,wz\n"


def run(*arguments):
    """Run `quatprop batch` in this process."""
    return CliRunner().invoke(cli, ["batch", "-j", "1", *map(str, arguments)])


def log(path, rate=1.0, samples=5):
    """Write a log that turns about z."""
    rows = [f"{100_000_000 * k},0,0,{rate}\n" for k in range(samples)]
    text = HEADER + "".join(rows)
    if "://" in str(path):
        put(path, text.encode())
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return path


def names_in(address):
    """Return the names of the objects below an address."""
    return list(list_objects(address))


@pytest.fixture
def logs(bucket):
    """Return a prefix with a log of each kind, and what is no log."""
    for name in ("coning.mcap", "tumbling.bag", "tumbling_ros2", "rest.parquet", "spin.csv"):
        upload(SAMPLE_LOGS / name, f"{bucket}/logs/{name}")
    upload(SAMPLE_LOGS / "README.md", f"{bucket}/logs/README.md")
    log(f"{bucket}/logs/.hidden/a.csv")
    return f"{bucket}/logs"


def test_a_store_gives_what_a_folder_gives(bucket, logs, tmp_path):
    """Logs of all kinds below a prefix; the outputs, the names and the manifest are the same."""
    near = tmp_path / "near"
    for name in ("coning.mcap", "tumbling.bag", "rest.parquet", "spin.csv", "tumbling_ros2"):
        copy = shutil.copytree if (SAMPLE_LOGS / name).is_dir() else shutil.copyfile
        (tmp_path / "logs").mkdir(exist_ok=True)
        copy(SAMPLE_LOGS / name, tmp_path / "logs" / name)
    shutil.move(tmp_path / "logs" / "tumbling.bag", tmp_path / "logs" / "bag.bag")
    upload(SAMPLE_LOGS / "tumbling.bag", f"{bucket}/logs/bag.bag")
    assert run(tmp_path / "logs", "-o", near, "--to", "csv", "-q").exit_code == 0
    far = f"{bucket}/runs/1"
    done = run(logs, "-o", far, "--to", "csv")
    assert done.exit_code == 0, done.output
    assert done.stderr.splitlines()[-1].endswith("; ignored 2 other files")
    outputs = ["bag.csv", "coning.csv", "rest.csv", "spin.csv", "tumbling.csv", "tumbling_ros2.csv"]
    manifest = ["manifest.jsonl", "manifest.parquet"]
    found = [name for name in names_in(far) if not name.startswith("manifest/")]
    assert sorted(found) == sorted([*outputs, *manifest])
    for name in outputs:
        local = "bag.csv" if name == "tumbling.csv" else name
        assert get(f"{far}/{name}") == (near / local).read_bytes()
    entries = manifest_in(far).entries()
    assert sorted(entries) == outputs
    assert entries["spin.csv"]["log"] == f"{logs}/spin.csv"
    assert len(entries["spin.csv"]["log_etag"]) == 32
    assert entries["spin.csv"]["log_sha256"] is None
    lines = get(f"{far}/manifest.jsonl").splitlines()
    assert [json.loads(line)["output"] for line in lines] == outputs
    (tmp_path / "manifest.parquet").write_bytes(get(f"{far}/manifest.parquet"))
    table = pyarrow.parquet.read_table(tmp_path / "manifest.parquet")
    assert table["state"].to_pylist() == ["done"] * 6
    assert not list(Path().glob("s3:*"))


PATTERNS = ("*", "**", "**/*.csv", "*/*.csv", "run[12]/**", "**/*_ros2", "r*", "**/run1/*.csv")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_pattern_finds_in_a_store_what_it_finds_in_a_folder(bucket, tmp_path, pattern):
    """With the same names of outputs: files, bags, and folders that are searched."""
    for place in (tmp_path, f"{bucket}/found"):
        for name in ("a.csv", "run1/a.csv", "run1/deep/b.csv", "run2/c.csv", ".hidden/d.csv"):
            log(place / name if place is tmp_path else f"{place}/{name}")
    shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", tmp_path / "run2" / "tumbling_ros2")
    upload(SAMPLE_LOGS / "tumbling_ros2", f"{bucket}/found/run2/tumbling_ros2")
    near, far = LogSearch(), LogSearch()
    near.add(f"{tmp_path}/{pattern}")
    far.add(f"{bucket}/found/{pattern}")
    assert [log.name for log in far.logs] == [log.name for log in near.logs]
    assert far.logs


def test_a_pattern_that_matches_nothing_in_a_store_is_said(bucket):
    """As for one of a folder."""
    log(f"{bucket}/nothing/a.csv")
    result = run(f"{bucket}/nothing/*.mcap", "-o", f"{bucket}/out")
    assert result.exit_code == 2
    assert "nothing matches 's3://" in result.stderr


def test_what_is_up_to_date_in_a_store_is_left_out(bucket):
    """By size, time and ETag of the log; also where the log has the same size as before."""
    logs, out = f"{bucket}/logs", f"{bucket}/out"
    for name in "ab":
        log(f"{logs}/{name}.csv")
    assert run(logs, "-o", out, "-q").exit_code == 0
    done = run(logs, "-o", out, "--skip-existing")
    assert done.stderr == "nothing to do: all 2 outputs are up to date\n"
    log(f"{logs}/b.csv", rate=2.0)
    done = run(logs, "-o", out, "--skip-existing")
    assert done.stderr.splitlines()[-1] == (
        "1 of 1 logs done, 5 samples; 1 skipped, as their outputs are up to date"
    )
    done = run(logs, "-o", out, "--skip-existing", "--method", "mean")
    assert done.stderr.splitlines()[-1] == "2 of 2 logs done, 10 samples"
    assert sorted(manifest_in(out).entries()) == ["a.parquet", "b.parquet"]


def test_folders_go_to_a_store_too(bucket):
    """An output that is a ROS 2 bag is all of its files."""
    log(f"{bucket}/logs/a.csv")
    done = run(f"{bucket}/logs", "-o", f"{bucket}/out", "--to", "rosbag2", "-q")
    assert done.exit_code == 0, done.output
    assert {"a/a.db3", "a/metadata.yaml"} <= set(names_in(f"{bucket}/out"))
    done = run(f"{bucket}/logs", "-o", f"{bucket}/out", "--to", "rosbag2", "--skip-existing")
    assert done.stderr == "nothing to do: its output is up to date\n"


def test_two_batches_at_once_into_one_prefix(bucket, tmp_path):
    """Parts of an array job: every log is done once, and the manifest has all of them."""
    for number in range(6):
        log(tmp_path / "in" / f"{number}.csv", rate=number)
    command = [sys.executable, "-m", "quatprop", "batch", tmp_path / "in", "-o", f"{bucket}/out"]
    parts = [
        subprocess.Popen([*command, "-q", "-j", "1", "--shard", f"{part}/2"]) for part in (1, 2)
    ]
    assert [part.wait(60) for part in parts] == [0, 0]
    lines = get(f"{bucket}/out/manifest.jsonl").splitlines()
    names = [f"{number}.parquet" for number in range(6)]
    assert [json.loads(line)["output"] for line in lines] == names
    assert set(names) <= set(names_in(f"{bucket}/out"))


def test_outputs_among_the_logs_are_refused(bucket):
    """As in a folder; below the prefix that is searched they are left out."""
    log(f"{bucket}/logs/a.csv")
    done = run(f"{bucket}/logs", "-o", f"{bucket}/logs/")
    assert done.exit_code == 2
    assert done.stderr == (
        f"Error: outputs in '{bucket}/logs' would lie among the logs; "
        "choose --output another folder\n"
    )
    for _ in range(2):
        done = run(f"{bucket}/logs", "-o", f"{bucket}/logs/out")
        assert done.stderr.splitlines()[-1] == "1 of 1 logs done, 5 samples"
    done = run(f"{bucket}/logs/a.csv", "-o", f"{bucket}/logs", "--to", "csv")
    assert done.stderr == (
        f"Error: {bucket}/logs/a.csv: this is an input of the run; choose another output\n"
    )


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (("{bucket}/none", "-o", "out"), "{bucket}/none: there is no such object; check"),
        (("s3://nobody-has-this", "-o", "out"), "s3://nobody-has-this: there is no such object"),
        (("a.csv", "-o", "s3://nobody-has-this/out"), "there is no such bucket ("),
        (("a.csv", "-o", "s3://denied/out"), "its store does not permit that ("),
        (("s3://denied/logs", "-o", "out"), "its store does not permit that ("),
        (("s3://denied/a.csv", "-o", "out"), "its store does not permit that ("),
    ],
)
def test_what_a_store_refuses_is_one_sentence(bucket, tmp_path, monkeypatch, names, sentence):
    """No bucket, no object, no rights: exit code 2, before anything is done where it is known."""
    monkeypatch.chdir(tmp_path)
    log(tmp_path / "a.csv")
    done = run(*(name.format(bucket=bucket) for name in names), "-q")
    assert done.exit_code == 2
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("Error: s3://")
    assert sentence.format(bucket=bucket) in lines[0]


@pytest.mark.parametrize("name", ["coning.mcap", "rest.parquet"])
def test_a_dropped_connection_is_one_sentence(bucket, tmp_path, store_server, name):
    """It is neither damage of the log nor a bug, and there is no output."""
    upload(SAMPLE_LOGS / name, f"{bucket}/{name}")
    store_server.drop_after = store_server.sent
    try:
        done = run(f"{bucket}/{name}", "-o", tmp_path / "out", "-q")
    finally:
        store_server.drop_after = None
    assert done.exit_code == 2
    assert done.stderr.startswith(f"Error: {bucket}/{name}: its store does not answer (")
    assert done.stderr.count("\n") == 1
    assert done.stderr.endswith("; check the network and the address of the store\n")
    assert not list((tmp_path / "out").glob("[!m]*"))


FLEETS = Path(quatprop.__file__).parent / "docs" / "fleets.md"


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
@pytest.mark.parametrize(
    ("scheduler", "variables"),
    [
        ("Slurm", {"SLURM_ARRAY_TASK_ID": 1, "SLURM_ARRAY_TASK_COUNT": 20}),
        ("Kubernetes", {"JOB_COMPLETION_INDEX": 0}),
        ("AWS Batch", {"AWS_BATCH_JOB_ARRAY_INDEX": 0, "AWS_BATCH_JOB_ARRAY_SIZE": 20}),
    ],
)
def test_the_examples_of_array_jobs_divide_the_logs(scheduler, variables, tmp_path):
    """With the variables of each scheduler, the 20 jobs together are given every log once."""
    section = FLEETS.read_text().split(f"### {scheduler}\n")[1].split("\n## ")[0]
    command = re.search(r"quatprop batch [^\n]*", section)[0].split('"],')[0]
    shim = tmp_path / "quatprop"
    shim.write_text('#!/bin/sh\nfor each; do last=$each; done\necho "$last"\n')
    shim.chmod(0o755)
    shards = []
    first = next(iter(variables))
    for job in range(20):
        values = {name: str(value) for name, value in variables.items()}
        values[first] = str(variables[first] + job)
        environment = {**os.environ, **values, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
        done = subprocess.run(
            ["/bin/sh", "-c", command], env=environment, capture_output=True, text=True, check=True
        )
        shards.append(done.stdout.strip())
    every = [FoundLog(f"{number}.csv", f"{number}") for number in range(50)]
    parts = [log.name for text in shards for log in shard(every, text)]
    assert sorted(parts) == sorted(log.name for log in every)


@pytest.mark.parametrize("key", ["s3://b/k.csv", "../../x.csv", "a/./b.csv", "/c.csv", "a?b.csv"])
def test_a_key_that_is_no_path_fails_alone(monkeypatch, tmp_path, key):
    """One of them stopped the batch, or could name an output outside of the folder."""
    monkeypatch.setattr("quatprop.batch.logs.list_objects", lambda _address: {key: None})
    monkeypatch.setattr("quatprop.batch.logs._is_folder", lambda path: "://" in path)
    monkeypatch.setattr("quatprop.batch.logs.exists", lambda _path: False)
    good, out = log(tmp_path / "good.csv"), tmp_path / "deep" / "out"
    names = ["s3://bucket/logs", "s3://bucket/logs/**/*.csv"][: 1 + ("?" in key)]
    for name in names:
        done = run(name, good, "-o", out, "--to", "csv")
        assert done.exit_code == 2
        assert (
            f"Error: s3://bucket/logs/{key}: its key has an empty part, '.', '..' or '?', which no "
            "address can have; rename it\n"
        ) in done.stderr
        assert done.stderr.endswith("1 of 2 logs done, 5 samples\n")
    files = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert files == ["good.csv", "good.csv", "manifest.jsonl", "manifest.parquet"]
