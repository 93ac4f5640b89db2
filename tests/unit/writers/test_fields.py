"""Metadata of the columns of Parquet and Arrow files, and the programs that keep it."""

from itertools import product

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS

import quatprop
from quatprop.settings import LAYOUTS

LOG = SAMPLE_LOGS / "tumbling.truth.csv"
FRAMES = {"body-to-ref": ("body", "reference"), "ref-to-body": ("reference", "body")}
CONVENTIONS = ("hamilton", "jpl")
QUATERNION = {"qw", "qx", "qy", "qz"}


def facts_of(path):
    """Return the metadata of each field."""
    read = (
        pq.read_schema if path.suffix == ".parquet" else lambda path: pa.ipc.open_file(path).schema
    )
    return {
        field.name: {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
        for field in read(path)
    }


def attitudes(path):
    """Return the attitudes of a file, Hamilton, body to reference."""
    return quatprop.read_attitudes(path).wxyz


@pytest.mark.parametrize(
    ("layout", "convention", "direction"),
    [*product(["scalar-first", "scalar-last"], CONVENTIONS, FRAMES)],
)
@pytest.mark.parametrize("suffix", ["parquet", "feather"])
def test_columns_say_what_they_are(tmp_path, suffix, layout, convention, direction):
    """Where those of the file got lost, as in pyarrow, JPL attitudes were taken for Hamilton."""
    out, again = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    words = ["--layout", layout, "--convention", convention, "--direction", direction, "-q"]
    run("convert", LOG, out, *words, code=0)
    source, target = FRAMES[direction]
    facts = facts_of(out)
    assert facts.pop("t_ns") == {"unit": "ns"}
    assert list(facts)[0 if layout == "scalar-first" else -1] == "qw"
    assert facts.keys() == QUATERNION
    for said in facts.values():
        assert said == {
            "layout": layout, "convention": convention, "direction": direction,
            "from_frame": source, "to_frame": target, "unit": "1",
        }  # fmt: skip
    if suffix == "parquet":
        pq.write_table(pq.read_table(out).replace_schema_metadata(), again)
    else:
        table = pa.feather.read_table(out).replace_schema_metadata()
        pa.feather.write_feather(table, again, compression="uncompressed")
    assert facts_of(again) == facts_of(out)
    np.testing.assert_array_equal(attitudes(again), attitudes(out))
    np.testing.assert_allclose(attitudes(again), attitudes(LOG), atol=1e-15)


@pytest.mark.parametrize(
    ("form", "unit", "frame"),
    [
        ("rotvec", "rad", None), ("euler-zyx-deg", "deg", None), ("matrix", "1", None),
        ("body-rates", "rad/s", "body"), ("inertial-rates", "rad/s", "reference"),
    ],
)  # fmt: skip
def test_other_representations_say_their_unit_and_frame(tmp_path, form, unit, frame):
    """Their names say it, too."""
    name = form.removesuffix("-deg")
    angles = ["--euler-unit", "deg"] if form.endswith("-deg") else []
    run("convert", LOG, tmp_path / "a.parquet", "--as", name, *angles, "-q", code=0)
    facts = facts_of(tmp_path / "a.parquet")
    del facts["t_ns"]
    assert {column["unit"] for column in facts.values()} == {unit}
    assert {column.get("frame") for column in facts.values()} == {frame}


@pytest.mark.parametrize("axes", ["body", "reference"])
def test_standard_deviations_say_their_axes(tmp_path, axes):
    """They are read about the same ones without the metadata of the file."""
    out, again = tmp_path / "a.parquet", tmp_path / "b.parquet"
    options = ["--noise-density", "0.2deg/sqrt(h)", "--sigma", "--sigma-axes", axes, "-q"]
    run("propagate", SAMPLE_LOGS / "tumbling.bag", "-o", out, *options, code=0)
    assert facts_of(out)["sigma_y"] == {"frame": axes, "unit": "rad"}
    pq.write_table(pq.read_table(out), again)
    read = [quatprop.read_attitudes(path).covariance for path in (out, again)]
    np.testing.assert_array_equal(*read)


def test_series_in_memory_say_it_too():
    """As a table of Arrow."""
    series = quatprop.read_attitudes(LOG)
    for name, column in (("qw", series.to_arrow()), ("qw", series.to_arrow(scalar_first=False))):
        said = column.schema.field(name).metadata
        is_first = column.column_names[1] == "qw"
        assert said[b"layout"] == (b"scalar-first" if is_first else b"scalar-last")
    rates = quatprop.read_rates(SAMPLE_LOGS / "spin.csv").to_arrow()
    assert rates.schema.field("wx").metadata == {b"frame": b"body", b"unit": b"rad/s"}


@pytest.mark.parametrize("keeper", ["pandas", "polars"])
def test_pandas_and_polars_keep_neither(tmp_path, keeper):
    """As library.md says; when that changes, so does the page."""
    out, again = tmp_path / "a.parquet", tmp_path / "b.parquet"
    run("convert", LOG, out, "-q", code=0)
    if keeper == "pandas":
        pd.read_parquet(out).to_parquet(again)
    else:
        pl.read_parquet(out).write_parquet(again)
    assert facts_of(again)["qw"] == {}
    assert b"quatprop" not in (pq.read_schema(again).metadata or {})


def test_columns_that_contradict_each_other_are_refused(tmp_path):
    """Of two attitudes, neither is chosen silently."""
    table = quatprop.read_attitudes(LOG).to_arrow()
    field = table.schema.field("qx")
    odd = field.with_metadata({**field.metadata, b"convention": b"jpl"})
    schema = table.schema.set(table.schema.get_field_index("qx"), odd)
    pq.write_table(table.cast(schema), tmp_path / "a.parquet")
    told = refused("convert", tmp_path / "a.parquet", tmp_path / "b.csv")
    assert "its columns differ in convention: 'hamilton', 'jpl'" in told


def test_metadata_of_other_meanings_say_nothing(tmp_path):
    """The direction of a column may be that of a wind."""
    table = quatprop.read_attitudes(LOG).to_arrow()
    fields = [one.with_metadata({"direction": "north", "layout": one.name}) for one in table.schema]
    pq.write_table(table.cast(pa.schema(fields)), tmp_path / "a.parquet")
    np.testing.assert_array_equal(attitudes(tmp_path / "a.parquet"), attitudes(LOG))


def test_layouts_are_named_as_everywhere():
    """The two names of the layout are those of the settings."""
    assert {"scalar-first", "scalar-last"} <= {*LAYOUTS}
