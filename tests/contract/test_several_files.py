"""Several files of one recording are one log, whatever their format."""

import json
from itertools import pairwise

import numpy as np
import pytest
from make.commands import refused, run
from make.formats import FORMATS, SAMPLES, samples

import quatprop

CUTS = (0, 70, 130, SAMPLES)


def parts_of(folder, name):
    """Write the samples in three files, the last of which comes first by name."""
    parts = []
    for number, (first, end) in enumerate(pairwise(CUTS)):
        part = folder / f"{9 - number}" / name
        part.parent.mkdir()
        FORMATS[name].write(part, samples(end - first, first))
        parts.append(part)
    return parts[::-1]


@pytest.mark.parametrize("name", FORMATS)
def test_they_give_the_attitudes_of_the_whole(tmp_path, name):
    """In whatever order they are named."""
    FORMATS[name].write(tmp_path / name, samples())
    parts = parts_of(tmp_path, name)
    options = {"topic": FORMATS[name].topics[0]} if FORMATS[name].topics else {}
    with pytest.warns(quatprop.RemarkWarning, match="3 files are read as one log"):
        found = quatprop.propagate(parts, **options)
    whole = quatprop.propagate(tmp_path / name, **options)
    np.testing.assert_array_equal(found.t_ns, whole.t_ns)
    np.testing.assert_array_equal(found.wxyz, whole.wxyz)
    with pytest.warns(quatprop.RemarkWarning, match="3 files"):
        rates = quatprop.read_rates(tuple(parts), **options)
    assert rates == quatprop.read_rates(tmp_path / name, **options)


@pytest.fixture
def parts(tmp_path):
    """Return three files of a table."""
    return parts_of(tmp_path, "commas.csv")


def test_the_command_line_takes_them_and_records_each(tmp_path, parts):
    """With the SHA-256 of each; a gap between them is a gap."""
    out = tmp_path / "out.csv"
    done = run("propagate", *parts, "-o", out, "--report", tmp_path / "report.json", code=0)
    assert "warning: 3 files are read as one log, in the order of their times" in done.stderr
    told = json.loads((tmp_path / "report.json").read_text())
    assert [*told["files"]] == sorted(map(str, parts))
    assert told["source"]["path"] == " + ".join(map(str, parts))
    assert told["source"]["sha256"] is None
    assert "609.983 ms after" in run("propagate", parts[0], parts[2], "-o", out, code=0).stderr
    said = refused("propagate", parts[0], parts[2], "-o", out, "--on-gap", "error")
    assert "gap" in said


def test_what_one_of_them_lost_is_told_with_its_name(tmp_path):
    """The others are whole."""
    parts = parts_of(tmp_path, "none.bag")
    data = parts[1].read_bytes()
    parts[1].write_bytes(data[: len(data) * 2 // 3])
    done = run("propagate", *parts, "-o", tmp_path / "out.csv", "-t", "/imu", code=3)
    assert f"lost: {parts[1]}, " in done.stderr


def test_overlapping_files_are_merged(tmp_path):
    """By the times of their rows; the samples of both are counted."""
    write = FORMATS["commas.csv"].write
    write(tmp_path / "a.csv", samples(120))
    write(tmp_path / "b.csv", samples(SAMPLES - 120, 120)[:60])
    write(tmp_path / "c.csv", samples(40, 160))
    files = [tmp_path / f"{name}.csv" for name in "abc"]
    done = run("propagate", *files, "-o", tmp_path / "out.csv", code=0)
    assert "(kept: a zero-length step leaves the attitude unchanged)" in done.stderr


def test_what_cannot_be_one_log_is_refused(tmp_path, parts):
    """In a sentence."""
    out = tmp_path / "out.csv"
    assert "a file is named twice" in refused("propagate", parts[0], parts[0], "-o", out)
    assert "not from stdin" in refused("propagate", parts[0], "-", "-o", out)
    FORMATS["none.bag"].write(tmp_path / "a.bag", samples(10))
    said = refused("propagate", tmp_path / "a.bag", parts[0], "-o", out)
    assert "several" in said
