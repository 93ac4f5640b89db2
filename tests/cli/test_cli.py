"""The command line as users meet it: exit codes, one-line errors, summaries, whole files."""

import io
import json
import re
import subprocess
import sys
import tarfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from click.testing import CliRunner

from quatprop.cli.commands import COMMANDS, cli
from quatprop.kinematics.quaternion import geodesic_angle

EUROC = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]\n"
INSTALLED = Path(sys.executable).with_name("quatprop")


def run(*arguments, **options):
    """Run the command line in this process."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments], **options)


@pytest.fixture
def log(tmp_path):
    """Return a CSV that turns by 0.1 rad about z every 100 ms, 11 samples."""
    path = tmp_path / "log.csv"
    rows = [f"{100_000_000 * k},0,0,1\n" for k in range(11)]
    path.write_text(EUROC + "".join(rows))
    return path


def refused(result, sentence):
    """Check that a run ended with code 2 and exactly one line, which is the sentence."""
    assert result.exit_code == 2, result.output
    assert result.stderr == f"Error: {sentence}\n"


def test_a_log_becomes_an_attitude_series(log, tmp_path):
    """Eleven samples give eleven attitudes, the first is the identity; one radian in all."""
    out = tmp_path / "out.csv"
    result = run("propagate", log, "-o", out)
    assert result.exit_code == 0
    lines = out.read_text().splitlines()
    assert lines[0] == "t_ns,qw,qx,qy,qz"
    assert lines[1] == "0,1,0,0,0"
    t_ns, *wxyz = lines[-1].split(",")
    assert (len(lines), t_ns) == (12, "1000000000")
    assert geodesic_angle([float(q) for q in wxyz], [np.cos(0.5), 0, 0, np.sin(0.5)]) < 1e-15


def test_the_summary_goes_to_stderr_and_can_be_silenced(log, tmp_path):
    """The summary says samples, span, method, final attitude and rotation; -q says nothing."""
    out = tmp_path / "out.csv"
    result = run("propagate", log, "-o", out)
    assert result.stdout == ""
    assert result.stderr.splitlines() == [
        f"source      {log} (csv): {EUROC.strip().split(',', 1)[1]} EuRoC",
        f"rate        {EUROC.strip().split(',', 1)[1]} in rad/s, #timestamp [ns] clock",
        "samples     11 over 1 s, 10 Hz",
        "method      start, body rates: rates resolved in the body frame; q[k+1] = q[k] * dq[k]",
        "sensitivity the final attitude differs by 0 deg from method mean, by 0 deg from every "  # noqa: ISC004
        "second sample",
        "final       w +0.877582562  x +0.000000000  y +0.000000000  z +0.479425539",
        "rotation    57.2958 deg from q0 to the final attitude, 57.2958 deg traversed, "  # noqa: ISC004
        "at most 57.2958 deg/s",
    ]
    assert run("propagate", log, "-o", out, "-q").output == ""


def test_data_on_stdout_and_words_on_stderr(log):
    """`-o -` writes CSV on stdout and nothing else."""
    result = subprocess.run(
        [INSTALLED, "propagate", log, "-o", "-"], capture_output=True, text=True, check=True
    )
    assert result.stdout.splitlines()[:2] == ["t_ns,qw,qx,qy,qz", "0,1,0,0,0"]
    assert "samples     11" in result.stderr


def test_csv_on_stdin(log):
    """`-` reads CSV from stdin."""
    result = subprocess.run(
        [INSTALLED, "propagate", "-", "-o", "-", "-q"],
        input=log.read_bytes(),
        capture_output=True,
        check=True,
    )
    assert len(result.stdout.splitlines()) == 12


@pytest.mark.parametrize(("layout", "columns"), [
    ("scalar-first", ["qw", "qx", "qy", "qz"]), ("wxyz", ["qw", "qx", "qy", "qz"]),
    ("scalar-last", ["qx", "qy", "qz", "qw"]), ("xyzw", ["qx", "qy", "qz", "qw"]),
])  # fmt: skip
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_the_layout_moves_columns_and_nothing_else(log, tmp_path, layout, columns, suffix):
    """Both layouts hold the same attitude, under names that say which is which."""
    out = tmp_path / f"out.{suffix}"
    assert run("propagate", log, "-o", out, "--layout", layout).exit_code == 0
    read = pyarrow.parquet.read_table if suffix == "parquet" else pa.csv.read_csv
    table = read(out)
    assert table.column_names == ["t_ns", *columns]
    assert table["qw"][-1].as_py() == pytest.approx(np.cos(0.5), abs=1e-15)
    assert table["qz"][-1].as_py() == pytest.approx(np.sin(0.5), abs=1e-15)


def test_the_output_carries_its_conventions(log, tmp_path):
    """Parquet metadata says convention, layout, method, q0, source, counts and version."""
    out = tmp_path / "out.parquet"
    run("propagate", log, "-o", out, "--method", "mean", "--layout", "xyzw", "--q0", "0,0,0,1")
    told = json.loads(pyarrow.parquet.read_metadata(out).metadata[b"quatprop"])
    convention = told["convention"]
    assert convention["attitude"] == "body to reference: v_ref = q v_body q*"
    assert convention["product"] == "Hamilton, ij = k"
    assert convention["side"].endswith("q[k+1] = q[k] * dq[k]")
    assert (convention["method"], convention["rates"]) == ("mean", "body")
    assert convention["layout"] == "scalar-last"
    assert convention["q0_wxyz"] == [0.0, 0.0, 0.0, 1.0]
    assert (told["source"]["path"], told["source"]["bytes"]) == (str(log), log.stat().st_size)
    assert (told["counts"]["read"], told["counts"]["used"]) == (11, 11)
    assert told["quatprop"]


def test_the_report_is_json(log, tmp_path):
    """--report writes counts, policies, conventions, source, version and timings."""
    report = tmp_path / "report.json"
    result = run("propagate", log, "-o", tmp_path / "out.csv", "--report", report)
    assert result.exit_code == 0
    told = json.loads(report.read_text())
    assert told["result"]["samples"] == 11
    assert told["result"]["net_rotation_rad"] == pytest.approx(1.0, abs=1e-15)
    assert told["policy"]["on_backwards"] == "error"
    assert told["timings"]["seconds"] > 0
    assert run("propagate", log, "-o", tmp_path / "o.csv", "-q", "--report", "-").stdout.startswith(
        "{"
    )


@pytest.mark.parametrize(
    ("on_gap", "degrees"), [("hold", [0, 10, 20, 120, 130]), ("zero", [0, 10, 20, 20, 30]),
                            ("split", [0, 10, 20, 0, 10])],
)  # fmt: skip
def test_what_happens_across_a_gap(tmp_path, on_gap, degrees):
    """The rate before holds across, or nothing turns, or the attitude begins again at q0."""
    path, out = tmp_path / "log.csv", tmp_path / "out.csv"
    rows = [f"{t * 1_000_000_000},0,0,{np.radians(10)!s}\n" for t in (0, 1, 2, 12, 13)]
    path.write_text(EUROC + "".join(rows))
    result = run("propagate", path, "-o", out, "--max-gap", "5s", "--on-gap", on_gap)
    assert result.exit_code == 0, result.output
    assert "1 interval longer than 5 s" in result.stderr
    for row, angle in zip(out.read_text().splitlines()[1:], degrees, strict=True):
        half = np.radians(angle) / 2
        expected = [np.cos(half), 0, 0, np.sin(half)]
        assert geodesic_angle([float(q) for q in row.split(",")[1:]], expected) < 1e-15


def test_inertial_rates_multiply_on_the_left(tmp_path):
    """About another axis than q0's, the side shows: dq q0 for inertial rates, q0 dq for body."""
    path = tmp_path / "log.csv"
    path.write_text(EUROC + "0,0,0,1\n1000000000,0,0,1\n")
    half = np.sqrt(0.5)
    about_z = [np.cos(0.5), 0, 0, np.sin(0.5)]
    sides = {
        "body": [half * about_z[0], half * about_z[0], -half * about_z[3], half * about_z[3]],
        "inertial": [half * about_z[0], half * about_z[0], half * about_z[3], half * about_z[3]],
    }
    for rates, expected in sides.items():
        result = run("propagate", path, "-o", tmp_path / "o.csv", "--rates", rates,
                     "--q0", f"{half},{half},0,0")  # fmt: skip
        assert result.exit_code == 0, result.output
        row = (tmp_path / "o.csv").read_text().splitlines()[-1].split(",")[1:]
        assert geodesic_angle([float(q) for q in row], expected) < 1e-15


def test_q0_may_be_given_scalar_last(log, tmp_path):
    """--q0-layout says how the four numbers are laid out."""
    for numbers, layout in (("0,1,0,0", "wxyz"), ("1,0,0,0", "xyzw")):
        run("propagate", log, "-o", tmp_path / "o.csv", "--q0", numbers, "--q0-layout", layout)
        assert (tmp_path / "o.csv").read_text().splitlines()[1] == "0,0,1,0,0"


def test_damage_ends_with_code_3(tmp_path):
    """A torn last line is lost, counted and said; the rest is saved."""
    path = tmp_path / "log.csv"
    path.write_text(EUROC + "0,0,0,1\n1000000000,0,0,1\n2000000000,0")
    result = run("propagate", path, "-o", tmp_path / "out.csv")
    assert result.exit_code == 3, result.output
    assert "lost: line 4" in result.stderr
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 3


def test_dropped_samples_end_with_code_3(tmp_path):
    """What a policy drops is data lost."""
    path = tmp_path / "log.csv"
    path.write_text(EUROC + "0,0,0,1\n1000000000,nan,0,1\n2000000000,0,0,1\n")
    result = run("propagate", path, "-o", tmp_path / "out.csv", "--on-nonfinite", "drop")
    assert result.exit_code == 3, result.output
    assert "samples     2 of 3 over 2 s, 0.5 Hz" in result.stderr
    assert "warning: 1 non-finite rate (dropped), first at sample 1" in result.stderr


def test_missing_file(tmp_path):
    """A path that leads nowhere is said."""
    path = tmp_path / "none.mcap"
    refused(
        run("propagate", path, "-o", tmp_path / "out.csv"),
        f"{path}: no such file or folder; check the path",
    )


def test_empty_file(tmp_path):
    """A file without a byte is said to be empty."""
    path = tmp_path / "log.mcap"
    path.touch()
    sentence = f"{path}: the file is empty; was the recording closed?"
    refused(run("propagate", path, "-o", tmp_path / "out.csv"), sentence)
    refused(run("info", path), sentence)


def test_unknown_format(tmp_path):
    """Bytes of no known kind list the kinds that --from takes."""
    path = tmp_path / "log.xyz"
    path.write_bytes(b"\x00\x01\x02 nonsense")
    refused(
        run("propagate", path, "-o", tmp_path / "out.csv"),
        f"{path}: neither its content nor its suffix is that of a log this version reads; "
        "if you know its kind, use --from mcap|bag|db3|rosbag2|ulog|parquet|feather|"
        "npy|npz|hdf5|matlab|jsonl|tum|kitti|csv",
    )


def test_a_log_without_rates(tmp_path):
    """Columns that are no rates are listed, with the way out."""
    path = tmp_path / "log.csv"
    path.write_text("time,temperature,pressure\n0,20,1\n1,21,1\n")
    result = run("propagate", path, "-o", tmp_path / "out.csv")
    refused(
        result,
        f"{path}: no body rates found; its columns are 'time', 'temperature', 'pressure'; "
        "name the columns with --rate-cols and --time-col",
    )


def test_unknown_suffix(log, tmp_path):
    """An output suffix that tells no format lists those that do."""
    out = tmp_path / "out.xls"
    result = run("propagate", log, "-o", out)
    assert result.exit_code == 2
    assert re.fullmatch(
        rf"Error: {re.escape(str(out))}: the suffix does not tell the output format; use one of "
        r".*\.csv.*\.parquet.* or say --to \S+\n",
        result.stderr,
    )
    assert not out.exists()


def test_target_is_a_folder(log, tmp_path):
    """A folder is not replaced by a file."""
    folder = tmp_path / "out.csv"
    folder.mkdir()
    refused(run("propagate", log, "-o", folder), f"{folder}: is a folder; name a file in it")


def test_the_log_itself_is_not_replaced(log):
    """The output may not be the log."""
    before = log.read_bytes()
    refused(
        run("propagate", log, "-o", log),
        f"{log}: this is an input of the run; choose another output",
    )
    assert log.read_bytes() == before


def test_no_output_replaces_an_input_or_another_output(log, tmp_path):
    """Neither the result nor the report goes over the log, the q0 file, or the other of the two."""
    start = tmp_path / "q0.csv"
    start.write_text("t_ns,qw,qx,qy,qz\n-1,1,0,0,0\n1000000000000,1,0,0,0\n")
    out = tmp_path / "out.csv"
    before = log.read_bytes(), start.read_bytes()
    overlap = "this is an input of the run; choose another output"
    twice = "two outputs of the run would go here; choose another"
    for arguments, sentence in (
        (["-o", out, "--report", log], f"{log}: {overlap}"),
        (["-o", start, "--q0", start], f"{start}: {overlap}"),
        (["-o", out, "--report", out], f"{out}: {twice}"),
    ):
        refused(run("propagate", log, *arguments), sentence)
    refused(run("convert", start, out, "--report", start), f"{start}: {overlap}")
    refused(
        run("simulate", tmp_path / "s.csv", "--truth", tmp_path / "s.csv"),
        f"{tmp_path / 's.csv'}: {twice}",
    )
    assert before == (log.read_bytes(), start.read_bytes())
    assert not out.exists()


def test_no_output_goes_into_the_folder_that_is_read(tmp_path):
    """A ROS 2 bag is a folder: a result inside it could be taken for a part of it."""
    bag = tmp_path / "bag"
    assert run("simulate", bag, "--samples", "10").exit_code == 0
    refused(
        run("propagate", bag, "-o", bag / "out.csv"),
        f"{bag / 'out.csv'}: this lies in {bag}, which is an input; choose another output",
    )


def test_a_report_that_cannot_be_written_leaves_the_old_result(log, tmp_path):
    """Where the report goes is checked before the result takes its place."""
    out = tmp_path / "out.csv"
    out.write_text("old")
    result = run("propagate", log, "-o", out, "--report", tmp_path / "none" / "report.json")
    assert result.exit_code == 2
    assert "there is no folder" in result.stderr
    assert out.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "out.csv"]


def test_what_is_marked_read_only_stays(log, tmp_path):
    """A read-only file or folder is not written to, not even by root, who may."""
    out = tmp_path / "out.csv"
    out.write_text("old")
    out.chmod(0o444)
    refused(run("propagate", log, "-o", out), f"{out}: this file is read-only; choose another")
    assert out.read_text() == "old"
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o555)
    refused(
        run("propagate", log, "-o", folder / "out.csv"),
        f"{folder / 'out.csv'}: writing in the folder {folder} is not permitted; choose another",
    )
    folder.chmod(0o755)


@pytest.mark.parametrize(
    "arguments", [["--heading", "30"], ["--reference-z", "down"], ["--q0-layout", "xyzw"]]
)
def test_options_without_what_they_belong_to(log, tmp_path, arguments):
    """An option that would be ignored is refused."""
    result = run("propagate", log, "-o", tmp_path / "o.csv", *arguments)
    assert result.exit_code == 2
    assert f"{arguments[0]} goes with --q0" in result.stderr


def test_a_kind_that_the_log_cannot_be(log, tmp_path):
    """--from is refused where a folder is no file of that kind, or a file no folder."""
    result = run("info", tmp_path, "--from", "bag")
    refused(result, f"{tmp_path}: a folder is no log of kind bag; leave --from out, or name the "
                    "log itself")  # fmt: skip
    result = run("info", log, "--from", "rosbag2")
    refused(result, f"{log}: a file is no log of kind rosbag2; leave --from out, or name the "
                    "log itself")  # fmt: skip


def test_a_failed_run_leaves_the_old_file(log, tmp_path):
    """An error midway leaves the old result and nothing beside it."""
    out = tmp_path / "out.csv"
    run("propagate", log, "-o", out)
    before = out.read_bytes()
    with log.open("a") as file:
        file.write("5,0,0,1\n")
    assert run("propagate", log, "-o", out).exit_code == 2
    assert out.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "out.csv"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--q0", "1,0,0"],
            "Invalid value for '--q0': '1,0,0' is not W,X,Y,Z, 4 finite numbers",
        ),
        (["--max-gap", "5"], "Invalid value for '--max-gap': '5' is not a duration"),
        (["--bias", "1,2"], "'1,2' is not X,Y,Z, 3 finite numbers, nor static[:DUR]"),
        (["--start", "noon"], "Invalid value for '--start': 'noon' is not a time"),
        (["--rate", "0"], "'0' is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"),
        (["--at", ""], "Invalid value for '--at': "),
        (["--report", ""], "Invalid value for '--report': the name is empty; is a variable of the"),
        (["--method", "middle"], "Invalid value for '--method': 'middle' is not one of"),
        (["--with", "euler-zyx,rotvec"], "'euler-zyx,rotvec' names several, and only one is poss"),
        (["--rate-cols", "x,y"], "'x,y' does not name 3 columns X,Y,Z"),
        (["--mount", "x,y,-z"], "the mounting 'x,y,-z' is left-handed, so it is not a rotation"),
        (
            ["--q0", "0,0,0,0"],
            "0,0.0 has the length 0, so it is not an attitude; the identity is 1,0,0,0",
        ),
        (
            ["--q0", "1,0,0,0.1"],
            "--q0 1.0,0.0,0.0,0.1 has the length 1.00499, so it is not an attitude; scale it to 1",
        ),
        (
            ["--mount", "2,0,0,0"],
            "the mounting '2,0,0,0' has the length 2, so it is not a rotation; scale it to 1",
        ),
    ],
)
def test_wrong_usage_ends_with_code_2(log, tmp_path, arguments, sentence):
    """A value that means nothing is refused with what would."""
    result = run("propagate", log, "-o", tmp_path / "out.csv", *arguments)
    assert result.exit_code == 2
    assert sentence in result.stderr
    assert not (tmp_path / "out.csv").exists()


def test_a_bias_is_subtracted_in_the_unit_of_the_rates(tmp_path):
    """With --rate-unit deg/s the bias is in deg/s too: what is left turns 90 deg."""
    path = tmp_path / "log.csv"
    path.write_text("t_ns,wx,wy,wz\n0,0,0,91\n1000000000,0,0,91\n")
    out = tmp_path / "out.csv"
    result = run("propagate", path, "-o", out, "--bias", "0,0,1", "--rate-cols", "wx,wy,wz",
                 "--time-col", "t_ns", "--time-unit", "ns", "--rate-unit", "deg/s")  # fmt: skip
    assert result.exit_code == 0, result.output
    row = [float(q) for q in out.read_text().splitlines()[-1].split(",")[1:]]
    assert geodesic_angle(row, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]) < 1e-15


def test_part_of_a_log(log, tmp_path):
    """--start and --end take stamps, offsets from the first and from the last sample."""
    for options, stamps in {
        ("--start", "+200ms"): (200, 1000),
        ("--end", "-200ms"): (0, 800),
        ("--start", "300000000", "--end", "+500ms"): (300, 500),
        ("--start", "1970-01-01T00:00:00.9Z"): (900, 1000),
    }.items():
        run("propagate", log, "-o", tmp_path / "o.csv", *options)
        rows = (tmp_path / "o.csv").read_text().splitlines()[1:]
        first, last = (int(rows[at].split(",")[0]) // 1_000_000 for at in (0, -1))
        assert (first, last) == stamps
        assert rows[0].endswith(",1,0,0,0")


def test_a_part_without_samples_is_an_error(log, tmp_path):
    """Nothing between --start and --end is said, and nothing is written."""
    result = run("propagate", log, "-o", tmp_path / "o.csv", "--start", "+1h")
    assert result.exit_code == 2
    assert "no samples in" in result.stderr
    assert not (tmp_path / "o.csv").exists()


def test_a_mounting_turns_the_axes(tmp_path):
    """Sensor x as body y: a turn about the sensor's x is one about the body's y."""
    path = tmp_path / "log.csv"
    path.write_text(EUROC + "0,1,0,0\n1000000000,1,0,0\n")
    for mount in ("-y,x,z", f"{np.sqrt(0.5)},0,0,{np.sqrt(0.5)}"):
        result = run("propagate", path, "-o", tmp_path / "o.csv", "--mount", mount)
        assert result.exit_code == 0, result.output
        row = [float(q) for q in (tmp_path / "o.csv").read_text().splitlines()[-1].split(",")[1:]]
        assert geodesic_angle(row, [np.cos(0.5), 0, np.sin(0.5), 0]) < 1e-15


@pytest.mark.parametrize("kind", ["csv", "tsv", "tum", "euroc"])
def test_a_file_that_begins_with_its_provenance_can_be_read(log, tmp_path, kind):
    """The report in a # comment is no row: convert reads the file, and knows how it came about."""
    text, table = tmp_path / f"out.{kind}", tmp_path / "out.parquet"
    result = run("propagate", log, "-o", text, "--to", kind, "--header-comment", "-q")
    assert result.exit_code == 0, result.output
    assert text.read_text().startswith("# quatprop {")
    result = run("convert", text, table, "--layout", "scalar-first")
    assert result.exit_code == 0, result.output
    rows = pyarrow.parquet.read_table(table)
    assert rows.num_rows == 11
    assert rows["qw"][-1].as_py() == pytest.approx(np.cos(0.5), abs=1e-15)


def test_fewer_rows_out(log, tmp_path):
    """--every keeps every n-th sample; --rate gives the attitude at other times, exactly."""
    out = tmp_path / "o.csv"
    result = run("propagate", log, "-o", out, "--every", "4")
    assert "samples     11 over 1 s, 10 Hz; 3 of them written" in result.stderr
    assert [row.split(",")[0] for row in out.read_text().splitlines()[1:]] == [
        "0", "400000000", "800000000"
    ]  # fmt: skip
    run("propagate", log, "-o", out, "--rate", "3")
    rows = [row.split(",") for row in out.read_text().splitlines()[1:]]
    assert [row[0] for row in rows] == ["0", "333333333", "666666667", "1000000000"]
    for t_ns, *wxyz in rows:
        half = int(t_ns) * 1e-9 / 2
        expected = [np.cos(half), 0, 0, np.sin(half)]
        assert geodesic_angle([float(q) for q in wxyz], expected) < 1e-15
    refused(
        run("propagate", log, "-o", out, "--rate", "3", "--every", "2"),
        "--every, --rate and --at each say which attitudes to write; choose one",
    )


def test_attitudes_at_the_stamps_of_another_series(log, tmp_path):
    """--at takes the stamps of attitudes or of rates; what lies outside the log is left out."""
    out, other = tmp_path / "o.csv", tmp_path / "other.csv"
    for header, numbers in (("t_ns,qw,qx,qy,qz", "1,0,0,0"), ("t_ns,wx,wy,wz", "0,0,0")):
        stamps = (-5, 0, 123_456_789, 1_000_000_000, 1_000_000_001)
        rows = [f"{t_ns},{numbers}" for t_ns in stamps]
        other.write_text("\n".join([header, *rows]) + "\n")
        result = run("propagate", log, "-o", out, "--at", other)
        assert result.exit_code == 0, result.output
        assert "2 of the 5 times asked for with --at have no attitude: 2 outside" in result.stderr
        rows = [row.split(",") for row in out.read_text().splitlines()[1:]]
        assert [row[0] for row in rows] == ["0", "123456789", "1000000000"]
        half = 0.123456789 / 2
        between = [float(q) for q in rows[1][1:]]
        assert geodesic_angle(between, [np.cos(half), 0, 0, np.sin(half)]) < 1e-15


def test_info_is_a_table_and_json(log):
    """Info names the source, its type, samples, rate, span, gaps, duplicates and largest rate."""
    table = run("info", log).stdout.splitlines()
    assert table[0] == f"{log} (csv)"
    assert table[1].split() == ["source", "type", "samples", "Hz", "span", "s", "gaps", "dup",
                                "back", "max", "rad/s"]  # fmt: skip
    assert table[2].split()[-8:] == ["EuRoC", "11", "10", "1", "0", "0", "0", "1"]
    (survey,) = json.loads(run("info", "--json", log).stdout)
    assert (survey["kind"], survey["sources"][0]["samples"]) == ("csv", 11)


def test_info_goes_on_after_a_log_it_cannot_read(log, tmp_path):
    """Of several logs the readable ones are shown; the exit code is 2."""
    result = run("info", tmp_path / "none.bag", log)
    assert result.exit_code == 2
    assert "no such file" in result.stderr
    assert "EuRoC" in result.stdout


def test_every_option_has_help_with_its_default():
    """Each option of each command says what it does, and its default where it takes a value."""
    for name in COMMANDS:
        command = cli.get_command(None, name)
        for parameter in command.params:
            if parameter.param_type_name != "option":
                continue
            assert parameter.help, f"{name} {parameter.name}"
            if not parameter.is_flag and not parameter.required:
                assert parameter.show_default or "[default:" in parameter.help, (
                    f"{name} {parameter.name}"
                )


def test_the_help_of_every_command_is_the_table_of_commands():
    """`--help` lists exactly the commands there are."""
    out = run("--help").output
    for name, words in COMMANDS.items():
        assert name in out
        assert words[:30] in out
        assert run(name, "--help").exit_code == 0
    assert run("nonsense").exit_code == 2


def test_a_closed_pipe_ends_quietly(tmp_path):
    """`| head` is no error: no traceback and nothing on stderr."""
    path = tmp_path / "log.csv"
    path.write_text(EUROC + "".join(f"{k},0,0,1\n" for k in range(200_000)))
    script = f"{INSTALLED} propagate -q {path} -o - | head -n 1"
    result = subprocess.run(["/bin/sh", "-c", script], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "t_ns,qw,qx,qy,qz\n", "")


def conformance_files(shared_logs):
    """Yield name and bytes of every file of the MCAP conformance suite."""
    with tarfile.open(shared_logs / "mcap_conformance.tar.gz") as archive:
        for member in archive:
            if member.isfile() and member.name.endswith(".mcap"):
                yield member.name, archive.extractfile(member).read()


@pytest.mark.parametrize("cut", [0, 30])
def test_conformance_files_end_in_a_sentence(shared_logs, tmp_path, cut):
    """None of 502 files carries a rate: each is one clear line and code 2, whole or cut off."""
    path = tmp_path / "log.mcap"
    count = 0
    for name, data in conformance_files(shared_logs):
        path.write_bytes(data[: len(data) - cut])
        result = run("propagate", path, "-o", tmp_path / "out.csv")
        count += 1
        assert result.exit_code == 2, (name, result.output)
        assert isinstance(result.exception, SystemExit), (name, result.exception)
        assert result.stderr.startswith(f"Error: {path}: "), name
        assert result.stderr.count("\n") == 1, name
    assert count == 502
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


def test_broken_bags_end_in_a_sentence(shared_logs, tmp_path):
    """None of these bags carries a rate; each is one clear line and code 2."""
    for path in sorted((shared_logs / "broken").iterdir()):
        result = run("propagate", path, "-o", tmp_path / "out.csv")
        assert result.exit_code == 2, (path.name, result.output)
        assert result.stderr.startswith(f"Error: {path}: "), path.name
        assert result.stderr.count("\n") == 1, path.name


def test_names_from_files_cannot_command_the_terminal(tmp_path):
    """Escape codes in a column's name are shown escaped."""
    path = tmp_path / "log.csv"
    path.write_text("\x1b[31mred,b\n1,2\n")
    result = run("info", path, color=True)
    assert "\x1b" not in result.output


def test_packed_tables_and_logs(log, tmp_path):
    """A table in gzip gives what the table gives; stdin takes it too."""
    import gzip

    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    for path, out in ((log, "a.csv"), (packed, "b.csv")):
        result = run("propagate", path, "-o", tmp_path / out)
        assert result.exit_code == 0, result.output
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_output_is_reproducible(log, tmp_path):
    """The same log gives the same bytes, in Parquet with its metadata too."""
    for suffix in ("csv", "parquet"):
        written = []
        for _ in range(2):
            run("propagate", log, "-o", tmp_path / f"o.{suffix}")
            written.append((tmp_path / f"o.{suffix}").read_bytes())
        assert written[0] == written[1]


def test_a_parquet_table_of_rates(tmp_path):
    """Rates in Parquet are read by the same names as in CSV."""
    t_ns = np.arange(3) * 500_000_000
    table = pa.table({"t_ns": t_ns, "wx": np.zeros(3), "wy": np.zeros(3), "wz": np.ones(3)})
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(table, buffer)
    path = tmp_path / "log.bin"
    path.write_bytes(buffer.getvalue())
    result = run("propagate", path, "-o", tmp_path / "o.csv")
    assert result.exit_code == 0, result.output
    assert "(parquet)" in result.stderr


def test_a_part_without_samples_says_where_they_are(log, tmp_path):
    """Seconds taken for nanoseconds leave nothing; the sentence says on which side."""
    out = tmp_path / "out.csv"
    refused(
        run("propagate", log, "-o", out, "--start", "2000000000"),
        f"{log}: no samples in 'w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]' "
        "between --start and --end: 11 are before, 0 after; a number without a unit is in ns",
    )
    # The units were doubted where they had been given.
    refused(
        run("propagate", log, "-o", out, "--start", "+500s"),
        f"{log}: no samples in 'w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]' "
        "between --start and --end: 11 are before, 0 after; the log is 1 s long",
    )


@pytest.mark.parametrize("time", ["1408542250s", "+1408542250.25s", "391262h"])
@pytest.mark.parametrize("option", ["--start", "--end"])
def test_a_unix_time_in_seconds_is_no_duration(log, tmp_path, option, time):
    """It counted from the first sample, 45 years, and left nothing out."""
    result = run("propagate", log, "-o", tmp_path / "out.csv", option, time)
    assert result.exit_code == 2
    assert result.stderr.endswith(
        f"'{time}' counts from the first sample, and no log is so long; write a Unix time as RFC "
        "3339 (2024-01-31T12:00:00Z) or in ns, without a unit\n"
    )


@pytest.mark.parametrize("unit_ns", [1_000_000_000, 1_000_000])
def test_a_start_in_other_units_than_ns_is_refused(log, tmp_path, unit_ns):
    """Unix time in seconds or milliseconds would leave nothing out, unnoticed in a script."""
    first_ns = 1_700_000_000_000_000_000
    rows = "".join(f"{first_ns + 100_000_000 * k},0,0,1\n" for k in range(11))
    log.write_text(EUROC + rows)
    start = first_ns // unit_ns + 1
    refused(
        run("propagate", log, "-o", tmp_path / "out.csv", "--start", str(start)),
        f"--start is at {start} ns, and the first sample at {first_ns} ns; a number without a unit "
        "is in ns: write all digits, a date, or a duration from the first sample such as +5s",
    )
    longer = run("propagate", log, "-o", "-", "--start", "-2s")
    assert longer.exit_code == 0
    assert longer.stdout.count("\n") == 1 + 11


def test_an_end_of_the_part_that_leaves_nothing_out_is_remarked_on(log, tmp_path):
    """An end outside the log may be a slip of the unit; a relative one cannot be."""
    out = tmp_path / "out.csv"
    said = run("propagate", log, "-o", out, "--start", "0", "--end", "1700000000").stderr
    assert "warning: --start is before the first sample and leaves nothing out; a number" in said
    assert "warning: --end is after the last sample and leaves nothing out; a number" in said
    relative = run("propagate", log, "-o", out, "--start", "+0s", "--end", "500000000").stderr
    assert "warning" not in relative


def test_a_part_that_ends_before_it_starts_is_refused(log, tmp_path):
    """The ends are swapped, or in different units."""
    refused(
        run("propagate", log, "-o", tmp_path / "o.csv", "--start", "+2s", "--end", "500000000"),
        "--start is 1.5 s after --end; swap them, or check units",
    )


def test_two_outputs_do_not_share_stdout(log):
    """CSV and JSON in one stream would be neither."""
    refused(
        run("propagate", log, "-o", "-", "--report", "-"),
        "-: two outputs of the run would go to stdout; name a file for one",
    )


def test_an_output_is_no_address(log):
    """Only logs are fetched; the key that an address may carry is not shown."""
    refused(
        run("propagate", log, "-o", "s3://key:secret@bucket/out.csv"),
        "s3://...: outputs are files of this machine; copy them there afterwards",
    )


@pytest.mark.parametrize("rate", ["285.7142857142857", "2000/7", "59.9401", "29.97002997002997"])
@pytest.mark.parametrize("option", ["--sample-rate", "--rate"])
def test_rates_are_decimals_or_fractions(tmp_path, option, rate):
    """Both options take any decimal and any fraction, exactly."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text("wx,wy,wz\n" + "1,2,3\n" * 4)
    rates = {"--sample-rate": "10", option: rate}
    arguments = [word for item in rates.items() for word in item]
    result = CliRunner().invoke(
        cli, ["propagate", str(log), "-o", str(out), "--rate-unit", "rad/s", *arguments]
    )
    assert result.exit_code == 0, result.output
    rows = out.read_text().splitlines()[1:]
    assert int(rows[3].split(",")[0]) == round(3 * 10**9 / Fraction(rate))
