"""The recipes of the guide to many logs, as scripts: what they write is what a batch writes."""

import os
import re
import subprocess
import sys

import pyarrow.dataset
import pyarrow.parquet
import pytest
from make.batches import batch, spin
from make.documents import GUIDES
from make.places import ROOT

RECIPES = (GUIDES / "fleets.md").read_text().split("## Recipes")[1]
SCRIPTS = {
    name: text for text, name in re.findall(r"(?s)```python\n(# (\w+\.py)\n.*?)```", RECIPES)
}


@pytest.fixture
def alone(tmp_path):
    """Run a batch on logs of two vehicles; return the tables by log."""
    for number, name in enumerate(("car1/a.csv", "car1/day/b.csv", "car2/a.csv")):
        spin(tmp_path / "recordings" / name, rate=number + 1.0, samples=50)
    batch(tmp_path / "recordings", "-o", tmp_path / "attitudes", "--method", "coning", code=0)
    tables = {}
    for path in (tmp_path / "attitudes").rglob("*.parquet"):
        name = path.relative_to(tmp_path / "attitudes").as_posix().removesuffix(".parquet")
        tables[name] = pyarrow.parquet.read_table(path, partitioning=None).to_pydict()
    return tables


def made_by(folder, name):
    """Run a script in a folder; return the tables that it wrote, by log."""
    (folder / name).write_text(SCRIPTS[name])
    path = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    environment = {**os.environ, "PYTHONPATH": path, "PYSPARK_PYTHON": sys.executable}
    subprocess.run([sys.executable, name], cwd=folder, env=environment, check=True, timeout=240)
    rows = pyarrow.dataset.dataset(folder / name.removesuffix(".py"), partitioning="hive")
    table = rows.to_table().sort_by("t_ns")
    columns = ["t_ns", "qw", "qx", "qy", "qz"]
    return {
        log: table.filter(pyarrow.dataset.field("log") == log).select(columns).to_pydict()
        for log in table["log"].unique().to_pylist()
    }


def test_one_partitioned_dataset_has_every_attitude(alone, tmp_path):
    """With the name of each log, in a folder for each vehicle; also when it is made again."""
    for _ in range(2):
        assert made_by(tmp_path, "dataset.py") == alone
        parts = {path.name for path in (tmp_path / "dataset").iterdir()}
        assert parts == {"vehicle=car1", "vehicle=car2"}
    (tmp_path / "recordings" / "car1" / "a.csv").write_text("nothing")
    batch(tmp_path / "recordings", "-o", tmp_path / "attitudes", "--method", "coning", code=2)
    assert made_by(tmp_path, "dataset.py").keys() == alone.keys() - {"car1/a.csv"}


@pytest.mark.parametrize(
    ("script", "library"), [("with_ray.py", "ray"), ("with_spark.py", "pyspark")]
)
def test_other_systems_give_what_a_batch_gives(alone, tmp_path, script, library):
    """To the last bit, under the same names."""
    pytest.importorskip(library)
    assert made_by(tmp_path, script) == alone
