"""The command line as users meet it: outputs, summaries, exit codes of what is not refused."""

import json
import tarfile

import numpy as np
import pyarrow.parquet
import pytest
from make.commands import refused, run
from make.small_files import EPOCH_NS, EUROC
from make.tables import write_rates

from quatprop.cli.commands import cli


@pytest.fixture
def log(tmp_path):
    """Return a CSV that turns by 0.1 rad about z every 100 ms, 11 samples."""
    return write_rates(tmp_path / "log.csv", [(k * 100_000_000, 0, 0, 1) for k in range(11)], EUROC)


def stamps(path):
    """Return the first column of a CSV."""
    return [int(row.split(",")[0]) for row in path.read_text().splitlines()[1:]]


def test_a_log_becomes_attitudes_and_a_summary_on_stderr(log, tmp_path):
    """Eleven samples give eleven attitudes, from the identity on; one radian in all."""
    out = tmp_path / "out.csv"
    result = run("propagate", log, "-o", out, code=0)
    header, first, *_, last = out.read_text().splitlines()
    assert (header, first, len(stamps(out))) == ("t_ns,qw,qx,qy,qz", "0,1,0,0,0", 11)
    expected = [1e9, np.cos(0.5), 0, 0, np.sin(0.5)]
    np.testing.assert_allclose(np.array(last.split(","), float), expected, atol=1e-15)
    assert result.stdout == ""
    columns = EUROC.split(",", 1)[1]
    assert result.stderr.splitlines() == [
        f"source      {log} (csv): {columns} EuRoC",
        f"rate        {columns} in rad/s, #timestamp [ns] clock",
        "samples     11 over 1 s, 10 Hz",
        "method      start, body rates: rates resolved in the body frame; q[k+1] = q[k] * dq[k]",
        "sensitivity the attitudes change by at most 0 deg with method mean, by at most 0 deg "  # noqa: ISC004
        "if every second sample is left out",
        "final       w +0.877582562  x +0.000000000  y +0.000000000  z +0.479425539",
        "rotation    57.2958 deg from q0 to the final attitude, 57.2958 deg traversed, "  # noqa: ISC004
        "at most 57.2958 deg/s",
    ]
    assert run("propagate", log, "-o", out, "-q", code=0).output == ""


def test_stdin_and_stdout_are_data_and_stderr_is_words(log):
    """`-` is CSV on both sides, and nothing else."""
    result = run("propagate", "-", "-o", "-", input=log.read_text(), code=0)
    assert result.stdout.splitlines()[:2] == ["t_ns,qw,qx,qy,qz", "0,1,0,0,0"]
    assert len(result.stdout.splitlines()) == 12
    assert "samples     11" in result.stderr


@pytest.mark.parametrize("words", ["propagate - -o out.csv", "convert - -", "calibrate - log.csv"])
def test_a_standard_input_that_is_closed_is_one_sentence(log, monkeypatch, capsys, words):
    """As in a service or after ``<&-``: it was called a bug."""
    monkeypatch.chdir(log.parent)
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(SystemExit, match="2"):
        cli.main(words.split())
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "Error: -: standard input is closed; name a file\n")


def test_output_and_report_carry_conventions_source_and_counts(log, tmp_path):
    """Parquet metadata have what the report has, but for the timings."""
    out, report = tmp_path / "out.parquet", tmp_path / "report.json"
    options = ["--method", "mean", "--layout", "xyzw", "--q0", "0,0,0,1"]
    run("propagate", log, "-o", out, "--report", report, *options, code=0)
    kept = json.loads(pyarrow.parquet.read_metadata(out).metadata[b"quatprop"])
    told = json.loads(report.read_text())
    for one in (kept, told):
        convention = one["convention"]
        assert convention["attitude"] == "body to reference: v_ref = q v_body q*"
        assert convention["product"] == "Hamilton, ij = k"
        assert convention["side"].endswith("q[k+1] = q[k] * dq[k]")
        assert (convention["method"], convention["rates"]) == ("mean", "body")
        assert (convention["layout"], convention["q0_wxyz"]) == ("scalar-last", [0, 0, 0, 1])
        assert (one["source"]["path"], one["source"]["bytes"]) == (str(log), log.stat().st_size)
        assert (one["counts"]["samples_read"], one["counts"]["samples_used"]) == (11, 11)
        assert one["quatprop"]
    assert told["result"]["samples"] == 11
    assert told["result"]["net_rotation_rad"] == pytest.approx(1.0, abs=1e-15)
    assert told["policy"]["on_backwards"] == "error"
    assert told["timings"]["seconds"] > 0
    shown = run("propagate", log, "-o", tmp_path / "o.csv", "-q", "--report", "-", code=0).stdout
    assert json.loads(shown)["counts"] == told["counts"]


@pytest.mark.parametrize(
    ("rows", "options", "said"),
    [
        (["0,0,0,1", "1000000000,0,0,1", "2000000000,0"], [], ["lost: line 4"]),
        (
            ["0,0,0,1", "1000000000,nan,0,1", "2000000000,0,0,1"],
            ["--on-nonfinite", "drop"],
            [
                "samples     2 of 3 over 2 s, 0.5 Hz",
                "warning: 1 non-finite rate (dropped), first at sample 1",
            ],
        ),
    ],
)
def test_lost_samples_end_with_code_3(tmp_path, rows, options, said):
    """Damaged and dropped samples are counted and reported; the rest is saved."""
    path, out = tmp_path / "log.csv", tmp_path / "out.csv"
    path.write_text("\n".join([EUROC, *rows]))
    result = run("propagate", path, "-o", out, *options, code=3)
    assert all(sentence in result.stderr for sentence in said)
    assert len(stamps(out)) == 2


@pytest.mark.parametrize(
    ("options", "said", "milliseconds"),
    [
        ("--every 4", "samples     11 over 1 s, 10 Hz; 3 attitudes written", [0, 400, 800]),
        ("--start +200ms --end -500ms", "samples     4 over 300 ms", [200, 300, 400, 500]),
        ("--start 1970-01-01T00:00:00.9Z", "samples     2 over 100 ms", [900, 1000]),
        ("--start 800000000 --end +900ms", "samples     2 over 100 ms", [800, 900]),
        (
            "--start 0 --end 1700000000 --every 9",
            "warning: --end is after the last sample and excludes nothing; a number",
            [0, 900],
        ),
        # A relative end cannot be a slip of the unit.
        ("--start +0s --end -1s", "samples     1\n", [0]),
        (
            "--at AT",
            "2 of the 4 times asked for with --at have no attitude: 2 outside",
            [0, 123],
        ),
    ],
)
def test_the_summary_describes_a_part_of_a_log(log, tmp_path, options, said, milliseconds):
    """With a time range or --at, the right rows are written, with the right remarks."""
    at = write_rates(tmp_path / "at.csv", [(t, 0, 0, 0) for t in (-5, 0, 123_000_000, 2 * 10**9)])
    out = tmp_path / "out.csv"
    result = run("propagate", log, "-o", out, *options.replace("AT", str(at)).split(), code=0)
    assert said in result.stderr
    assert ("excludes nothing" in result.stderr) == ("nothing" in said)
    assert stamps(out) == [t * 1_000_000 for t in milliseconds]


def test_an_offset_before_the_log_is_no_unix_time(tmp_path):
    """A start counted from the end may lie before the first sample."""
    log = write_rates(tmp_path / "log.csv", [(EPOCH_NS + k * 10**8, 0, 0, 1) for k in range(11)])
    result = run("propagate", log, "-o", "-", "--start", "-2s", code=0)
    assert len(result.stdout.splitlines()) == 12


@pytest.mark.parametrize("cut", [0, 30])
def test_files_without_rates_end_in_a_sentence(shared_logs, tmp_path, cut):
    """Whatever the container holds, whole or cut off: each is one clear line and code 2."""
    paths = sorted((shared_logs / "broken").iterdir())
    with tarfile.open(shared_logs / "mcap_conformance.tar.gz") as archive:
        names = sorted(name for name in archive.getnames() if name.endswith(".mcap"))
        assert len(names) == 502
        for name in names[:: len(names) // 30]:
            paths.append(tmp_path / name.rpartition("/")[2])
            paths[-1].write_bytes(archive.extractfile(name).read()[: -cut or None])
    before = set(tmp_path.iterdir())
    for path in paths:
        said = refused("propagate", path, "-o", tmp_path / "out.csv")
        assert said.startswith(f"Error: {path}: ")
    assert set(tmp_path.iterdir()) == before
