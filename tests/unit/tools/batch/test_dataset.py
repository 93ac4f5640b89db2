"""One Parquet dataset instead of a file a log: the same bytes wherever and whenever it is made."""

import hashlib
import re
import shutil
from pathlib import Path

import pyarrow.dataset
import pyarrow.parquet
import pytest
from make.batches import batch, entries, said, spin
from make.commands import refused, run

import quatprop
from quatprop.stores.objects import _s3, list_objects
from quatprop.stores.remote import get, upload
from quatprop.tools.batch import dataset
from quatprop.tools.batch.dataset import with_parts
from quatprop.tools.batch.log_search import BatchTask
from quatprop.tools.batch.planning import shard

FLEETS = Path(quatprop.__file__).parent / "docs" / "fleets.md"

DATASET = ("--dataset", "--buckets", "3")

NAMES = ("a.csv", "a-b.csv", "deep/b.csv", "deep/er/c.csv", "d.csv", "e.csv", "f.csv")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Write some logs, in folders."""
    folder = tmp_path_factory.mktemp("logs") / "in"
    for number, name in enumerate(NAMES):
        spin(folder / name, rate=(number + 1) / 10, samples=5 + number)
    return folder


@pytest.fixture(scope="module")
def made(logs, tmp_path_factory):
    """Make the dataset of these logs at once."""
    out = tmp_path_factory.mktemp("made") / "out"
    batch(logs, "-o", out, *DATASET, code=0)
    return out


def files_in(folder):
    """Return the files of a dataset, by name."""
    return {path.name: path.read_bytes() for path in folder.glob("*.parquet")}


def rows_of(folder):
    """Return the number of rows of each log."""
    counts = (
        pyarrow.dataset.dataset(folder).to_table().group_by("log").aggregate([([], "count_all")])
    )
    return dict(zip(counts["log"].to_pylist(), counts["count_all"].to_pylist(), strict=True))


ROWS = {name: 5 + number for number, name in enumerate(NAMES)}


def test_a_dataset_has_all_rows_in_order(made, logs, tmp_path):
    """Those of the files that are made otherwise, sorted by log and time, each with its origin."""
    batch(logs, "-o", tmp_path / "out", code=0)
    assert rows_of(made) == ROWS
    assert sorted(files_in(made)) == ["0-of-3.parquet", "1-of-3.parquet", "2-of-3.parquet"]
    for name in files_in(made):
        table, field = pyarrow.parquet.read_table(made / name), pyarrow.dataset.field("log")
        keys = list(zip(table["log"].to_pylist(), table["t_ns"].to_pylist(), strict=True))
        assert keys == sorted(keys)
        metadata = pyarrow.parquet.read_metadata(made / name).metadata
        for log in set(table["log"].to_pylist()):
            digest = hashlib.sha256(log.removesuffix(".csv").encode()).digest()
            assert name == f"{int.from_bytes(digest[:8], 'little') % 3}-of-3.parquet"
            alone = tmp_path / "out" / log.replace(".csv", ".parquet")
            rows = table.filter(field == log).drop_columns("log")
            assert rows.equals(pyarrow.parquet.read_table(alone))
            own = pyarrow.parquet.read_metadata(alone).metadata[b"quatprop"]
            assert metadata[f"quatprop {log}".encode()] == own
    assert not [path for path in (made / "_parts").rglob("*") if path.is_file()]


@pytest.mark.parametrize("way", ["shards", "one at a time", "dask", "store", "larger"])
def test_a_dataset_is_the_same_bytes_however_it_is_made(made, logs, tmp_path, bucket, way):
    """In parts, log by log, a second time, from and into a store, and after other logs."""
    out = tmp_path / "out"
    if way == "shards":
        for part in (2, 1):
            batch(logs, "-o", out, *DATASET, "--shard", f"{part}/2", code=0)
    elif way == "one at a time":
        for name in reversed(NAMES):
            batch(logs / name, "-o", out, *DATASET, "--root", logs, code=0)
    elif way == "dask":
        distributed = pytest.importorskip("distributed")
        options = {"processes": False, "dashboard_address": ":0"}
        with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
            run("batch", logs, "-o", out, *DATASET, "--dask", cluster.scheduler_address, code=0)
    elif way == "larger":
        shutil.copytree(logs, tmp_path / "in")
        batch(tmp_path / "in", "-o", out, *DATASET, code=0)
        for name in NAMES:
            spin(tmp_path / "in" / name, samples=9)
        batch(tmp_path / "in", "-o", out, *DATASET, code=0)
        shutil.copytree(logs, tmp_path / "in", dirs_exist_ok=True)
        batch(tmp_path / "in", "-o", out, *DATASET, code=0)
    else:
        upload(logs, f"{bucket}/in")
        for _ in range(2):
            batch(f"{bucket}/in", "-o", f"{bucket}/out", *DATASET, code=0)
        found = {name: get(f"{bucket}/out/{name}") for name in list_objects(f"{bucket}/out")}
        assert {name: data for name, data in found.items() if name[0] != "_"} == files_in(made)
        assert not [name for name in found if name.startswith("_parts/")]
        words = "nothing to do: all 7 outputs are up to date\n"
        again = (f"{bucket}/in", "-o", f"{bucket}/out", *DATASET, "--skip-existing", "--verify")
        assert batch(*again).stderr == words
        return
    assert files_in(out) == files_in(made)


def test_rows_of_a_log_that_fails_do_not_stay(logs, tmp_path):
    """And those of a log that is gone do, as its output does; a log that comes again is new."""
    shutil.copytree(logs, tmp_path / "in")
    arguments = (tmp_path / "in", "-o", tmp_path / "out", *DATASET)
    batch(*arguments, code=0)
    (tmp_path / "in" / "a.csv").write_text("nothing")
    (tmp_path / "in" / "d.csv").unlink()
    batch(*arguments, "--skip-existing", code=2)
    assert rows_of(tmp_path / "out") == {name: n for name, n in ROWS.items() if name != "a.csv"}
    states = {entry["log"]: entry["state"] for entry in entries(tmp_path / "out").values()}
    assert states == {**dict.fromkeys(NAMES, "done"), "a.csv": "failed", "d.csv": "deleted"}
    spin(tmp_path / "in" / "a.csv", samples=3)
    spin(tmp_path / "in" / "d.csv", samples=4)
    assert said(batch(*arguments, "--skip-existing", code=0)).startswith("2 of 2 logs done")
    assert rows_of(tmp_path / "out") == {**ROWS, "a.csv": 3, "d.csv": 4}


@pytest.mark.parametrize("at", ["folder", "store"])
def test_a_file_without_logs_is_removed(tmp_path, bucket, at):
    """All rows of it were those of a log that fails now."""
    log, out = spin(tmp_path / "a.csv"), f"{bucket}/out" if at == "store" else str(tmp_path / "out")

    def files():
        found = list_objects(out) if at == "store" else files_in(tmp_path / "out")
        return [name for name in found if name[0] != "_"]

    batch(log, "-o", out, "--dataset", code=0)
    assert files() == [f"{with_parts([BatchTask('', 'a.csv')], 256)[0].folder[7:-1]}.parquet"]
    log.write_text("nothing")
    batch(log, "-o", out, "--dataset", code=2)
    assert files() == []


@pytest.mark.parametrize("when", ["before a file", "before the parts go"])
def test_a_batch_that_was_killed_goes_on(made, logs, tmp_path, monkeypatch, when):
    """Nothing is propagated again, and no row is lost or there twice."""
    arguments = (logs, "-o", tmp_path / "out", *DATASET)
    with monkeypatch.context() as patched:
        step = "_write" if when == "before a file" else "_remove_parts"

        def killed(*_):
            raise KeyboardInterrupt

        patched.setattr(dataset, step, killed)
        batch(*arguments)
    assert (files_in(tmp_path / "out") == {}) == (when == "before a file")
    words = "nothing to do: all 7 outputs are up to date\n"
    assert batch(*arguments, "--skip-existing").stderr == words
    assert files_in(tmp_path / "out") == files_in(made)
    assert batch(*arguments, "--skip-existing").stderr == words


@pytest.mark.parametrize("damage", ["gone", "empty", "cut", "other", "rows"])
def test_a_file_that_was_damaged_is_made_again(made, logs, tmp_path, damage):
    """By what it says of its rows; damage within them is found where it is asked for."""
    shutil.copytree(made, tmp_path / "out")
    place = tmp_path / "out" / "1-of-3.parquet"
    before = place.read_bytes()
    again = (logs, "-o", tmp_path / "out", *DATASET, "--skip-existing")
    if damage == "gone":
        place.unlink()
    elif damage == "rows":
        place.write_bytes(before[:100] + bytes([before[100] ^ 1]) + before[101:])
        assert batch(*again).stderr.startswith("nothing to do")
        again = (*again, "--verify")
    else:
        place.write_bytes({"empty": b"", "cut": before[:-9], "other": bytes(len(before))}[damage])
    batch(*again, code=0)
    assert place.read_bytes() == before


def test_a_file_that_cannot_be_opened_is_not_one_without_rows(made, logs, tmp_path):
    """Rows of logs that are not propagated again would be lost."""
    shutil.copytree(made, tmp_path / "out")
    place = tmp_path / "out" / "1-of-3.parquet"
    place.unlink()
    place.symlink_to(place)
    words = refused("batch", logs, "-o", tmp_path / "out", *DATASET, "--skip-existing")
    assert words == f"Error: {place}: cannot be read: Too many levels of symbolic links"


def test_a_part_of_others_is_named(made, logs, tmp_path):
    """A table that somebody put among the parts was called a bug of this program."""
    shutil.copytree(made, tmp_path / "out")
    part = tmp_path / "out" / "_parts" / "0-of-3" / "x.parquet"
    part.parent.mkdir(parents=True, exist_ok=True)
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), part)
    words = refused("batch", logs, "-o", tmp_path / "out", *DATASET, "-j", "1", "-q")
    assert words == f"Error: {part}: no batch has written this; remove it"
    part.write_bytes(b"PAR1")
    words = refused("batch", logs, "-o", tmp_path / "out", *DATASET, "-j", "1", "-q")
    assert words.startswith(f"Error: {part}: its rows cannot be read (")


def test_rows_that_cannot_be_read_are_not_lost_unsaid(made, logs, tmp_path):
    """Where one log of a damaged file comes again, the rows of the others cannot be kept."""
    shutil.copytree(made, tmp_path / "out")
    place = tmp_path / "out" / "1-of-3.parquet"
    before = place.read_bytes()
    place.write_bytes(before[:100] + bytes([before[100] ^ 1]) + before[101:])
    log = pyarrow.parquet.read_table(made / "1-of-3.parquet")["log"].to_pylist()[-1]
    again = (logs / log, "--root", logs, "-o", tmp_path / "out", *DATASET)
    words = refused("batch", *again, "-j", "1", "-q")
    assert words.startswith(f"Error: {place}: its rows cannot be read (")
    assert words.endswith("); remove it, and continue with --skip-existing")
    place.unlink()
    batch(logs, "-o", tmp_path / "out", *DATASET, "--skip-existing", code=0)
    assert files_in(tmp_path / "out") == files_in(made)


def test_a_folder_is_one_dataset_or_files(made, logs, tmp_path):
    """Rows would be there twice, and of other columns."""
    shutil.copytree(made, tmp_path / "out")
    out = tmp_path / "out"
    for options in ((), ("--dataset", "--buckets", "4")):
        assert refused("batch", logs, "-o", out, *options) == (
            f"Error: '{out}' has a dataset of 3 files; choose --dataset --buckets 3, or another "
            "folder"
        )
    batch(logs / "a.csv", "-o", tmp_path / "files", code=0)
    words = refused("batch", logs, "-o", tmp_path / "files", "--dataset")
    assert words.endswith("has one file per log; omit --dataset, or choose another folder")
    log = pyarrow.parquet.read_table(made / "1-of-3.parquet")["log"].to_pylist()[0]
    again = (logs / log, "--root", logs, "-o", out, *DATASET, "--with", "rotvec", "-q")
    assert " has other columns than other logs in it; propagate all" in refused("batch", *again)
    batch(logs, "-o", out, *DATASET, "--with", "rotvec", code=0)
    assert "rotvec_x_rad" in pyarrow.dataset.dataset(out).schema.names


def test_a_shard_has_whole_files():
    """Two machines would write the same file."""
    tasks = [BatchTask("in", f"{number}.csv") for number in range(200)]
    assert {len(log.folder) for log in with_parts(tasks, 10)} == {len("_parts/9-of-10/")}
    assert {len(log.folder) for log in with_parts(tasks, 11)} == {len("_parts/09-of-11/")}
    every = with_parts(tasks, 7)
    for count in (2, 3, 7):
        files = [{log.folder for log in every if shard(f"{k + 1}/{count}", 7).has(log)}
                 for k in range(count)]  # fmt: skip
        assert sum(map(len, files)) == len(set().union(*files)) == 7


def test_a_log_that_was_compressed_takes_the_place_of_its_rows(logs, tmp_path):
    """Its name is another one; its rows would be there twice."""
    import gzip

    shutil.copytree(logs, tmp_path / "in")
    arguments = (tmp_path / "in", "-o", tmp_path / "out", *DATASET)
    batch(*arguments, code=0)
    log = tmp_path / "in" / "a.csv"
    (tmp_path / "in" / "a.csv.gz").write_bytes(gzip.compress(log.read_bytes()))
    log.unlink()
    batch(*arguments, "--skip-existing", code=0)
    expected = {**ROWS, "a.csv.gz": ROWS["a.csv"]}
    del expected["a.csv"]
    assert rows_of(tmp_path / "out") == expected


QUERY = re.findall(r"```sql\n(.*?)```", FLEETS.read_text(), re.DOTALL)[-1]


def test_the_query_of_the_document_joins_dataset_and_manifest(tmp_path, monkeypatch):
    """The column is the name of the log, as in the manifest."""
    duckdb = pytest.importorskip("duckdb")
    monkeypatch.chdir(tmp_path)
    for name in ("whole", "torn"):
        log = spin(tmp_path / "in" / f"{name}.csv", rate=0)
    log.write_text(log.read_text() + "500000000,0\n")
    batch("in", "-o", "attitudes", *DATASET, code=3)
    assert duckdb.sql(QUERY).fetchall() == [("torn.csv", [1, 0, 0, 0])]


def test_a_dataset_opens_everywhere(made):
    """As one, in pandas, polars and DuckDB, and of one log only its row groups are read."""
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    assert pandas.read_parquet(made).groupby("log").size().to_dict() == ROWS
    table = polars.scan_parquet(made / "*.parquet").group_by("log").len().collect()
    assert dict(table.rows()) == ROWS
    chosen = pyarrow.dataset.field("log") == "d.csv"
    read = [group for fragment in pyarrow.dataset.dataset(made).get_fragments(chosen)
            for group in fragment.split_by_row_group(chosen)]  # fmt: skip
    assert len(read) == 1
    duckdb = pytest.importorskip("duckdb")
    table = duckdb.read_parquet(f"{made}/*.parquet").aggregate("log, count(*)")
    assert dict(table.fetchall()) == ROWS


def test_a_store_that_does_not_answer_loses_no_rows(tmp_path, bucket, store_server, monkeypatch):
    """A file that cannot be fetched is not one that is damaged: its rows would be left out."""
    for name in "ab":
        spin(tmp_path / "in" / f"{name}.csv")
    arguments = ("--root", tmp_path / "in", "-o", f"{bucket}/out", "--dataset", "--buckets", "1")
    batch(tmp_path / "in", *arguments, code=0)
    before = get(f"{bucket}/out/0-of-1.parquet")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    _s3.cache_clear()
    for refused_method in ("HEAD", "GET"):
        store_server.before = lambda method, path, which=refused_method: (
            "503 Slow Down" if method == which and path.endswith("0-of-1.parquet") else None
        )
        done = batch(tmp_path / "in" / "a.csv", *arguments, code=2)
        assert f"Error: {bucket}/out/0-of-1.parquet: the store is overloaded (" in done.stderr
    store_server.before = lambda *_: None
    _s3.cache_clear()
    assert get(f"{bucket}/out/0-of-1.parquet") == before
    batch(tmp_path / "in" / "a.csv", *arguments, "--skip-existing", code=0)
    assert get(f"{bucket}/out/0-of-1.parquet") == before
