"""Texts that end without a line end, and texts of absurd shapes."""

import bz2
import gzip
import io
import json
import math
import time
import zlib

import pytest
from click.testing import CliRunner
from make.table_rates import rate_batches

from quatprop.cli.commands import cli
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.tables.csv.log import CsvLog
from quatprop.tables.log import Loss
from quatprop.text import quoted

HEADER = "t_ns,wx,wy,wz\n"
CUT = "it has no line end, and its last cell was cut off"


def read(text, header=HEADER, **options):
    """Return the numbers of the last row that is read, the rows, the losses and the remarks."""
    data = text if isinstance(text, bytes) else (header + text).encode()
    log = CsvLog(io.BytesIO(data))
    chosen = {"rate_unit": "rad/s", "time_unit": "ns", **options}
    rows = [row for batch in rate_batches(log, **chosen) for row in batch.rate]
    return rows[-1].tolist() if rows else None, len(rows), log.losses, log.remarks


def rows_of(*cells):
    """Return rows whose last cells are these, the last without its line end."""
    return "\n".join(f"{1000 * k},0.125,-0.25,{cell}" for k, cell in enumerate(cells))


def test_a_number_shorter_than_all_before_it_was_cut_off():
    """Where every number has six decimals, one of three is the beginning of another."""
    text = rows_of(*["0.123456", "-1.000000", "2.500000"] * 3, "0.123")
    assert read(text) == ([0.125, -0.25, 2.5], 9, [Loss("line 11", CUT, 1)], [])


def test_a_last_line_without_its_end_is_whole_where_it_looks_like_the_others():
    """Texts that people join by line ends have none behind the last line."""
    text = rows_of(*["0.123456", "-1.000000", "2.500000"] * 3, "0.000000")
    assert read(text) == ([0.125, -0.25, 0.0], 10, [], [])


REMARK = (
    "the last line has no line end: if the log was cut off there, its end {} may have lost digits"
)


@pytest.mark.parametrize("cells", [("0.5", "0.25", "0.125", "0.75"), ("1", "22", "-333", "12")])
def test_where_nobody_can_tell_it_is_said(cells):
    """Numbers of any length may be whole or cut: the last is kept, and the doubt is said."""
    text = rows_of(*cells)
    last, count, losses, remarks = read(text)
    assert (last[2], count, losses) == (float(cells[-1]), 4, [])
    assert remarks == [REMARK.format(f"'{text[-12:]}'")]


def test_a_number_shorter_than_hundreds_before_it_was_cut_off():
    """Numbers printed in full have nearly always many digits; one of three has lost some."""
    text = rows_of(*(repr(math.sin(k + 1)) for k in range(300)), "0.85")
    assert read(text)[1:] == (300, [Loss("line 302", CUT, 1)], [])


@pytest.mark.parametrize("cell", ["", "-", "1.25e", "1.25e-", "1.2500e-0"])
def test_what_is_no_number_any_more_was_cut_off(cell):
    """The begin of a number that is none, or another one, is no sample."""
    text = rows_of(*["1.2500e-03", "2.2500e+02"] * 3, cell)
    last, count, losses, _ = read(text)
    assert (last, count) == ([0.125, -0.25, 225.0], 6)
    assert [loss.place for loss in losses] == ["line 8"]


def test_a_column_that_is_not_read_may_be_cut():
    """Nothing is said where no number that is used can have lost a digit."""
    text = "0,1,2,3,some words\n1,1,2,3,some wo"
    assert read(text, "t_ns,wx,wy,wz,note\n") == ([1.0, 2.0, 3.0], 2, [], [])


@pytest.mark.parametrize("count", [3, 200_000])
@pytest.mark.parametrize("zeros", [1, 4096, 5_000_000])
@pytest.mark.parametrize("end", ["\n", "\n9,1,2", "\n9,1,2,0.12"])
def test_zeros_at_the_end_are_damage(count, zeros, end):
    """A power failure leaves them; the rows before are read, and the row they cut is not."""
    rows = "\n".join(f"{k},1,2,0.125" for k in range(count))
    _, kept, losses, remarks = read(rows + end + zeros * "\0")
    assert (kept, remarks) == (count, [])
    assert losses[0] == Loss("end of the file", "it is filled with zero bytes")
    assert [loss.place for loss in losses[1:]] == [f"line {count + 2}"] * (end != "\n")


@pytest.mark.parametrize("end", ["", "\n"])
@pytest.mark.parametrize("before", [3, 100_000])
def test_zeros_between_rows_cost_a_row_at_most(before, end):
    """A recorder that went on after a power failure leaves them, near the beginning or far on."""
    rows = [f"{k},1,2,0.125\n" for k in range(before + 9)]
    text = "".join(rows[:before]) + 512 * "\0" + end + "".join(rows[before:])
    _, kept, losses, _ = read(text)
    assert kept == before + 9 - (not end)
    assert [loss.place for loss in losses] == [f"line {before + 2}"]


def test_zeros_alone_are_no_table():
    """There is nothing to read."""
    with pytest.raises(UnsupportedLogError, match="it holds NUL bytes, as no text does"):
        read(bytes(10_000))


def test_a_line_between_open_quotes_was_cut_off():
    """A cell whose quote is not closed is not whole."""
    text = '0,1,2,"3.5"\n1,1,2,"3.5"\n2,1,2,"3.'
    assert read(text)[1:] == (2, [Loss("line 4", CUT, 1)], [])


QUOTED = "t_ns,note,wx,wy,wz,end\n"


@pytest.mark.parametrize("end", ["\n", ""])
@pytest.mark.parametrize(
    ("rows", "bad"),
    [
        (["0,a,1,2,3,z", '1,"b,1,2,3,z', "2,c,1,2,3,z", "3,d,1,2,3,z"], [3]),
        (["0,a,1,2,3,z", '1,b,1,"2,3,z', "2,c,1,2,3,z", "3,d,1,2,3,z"], [3]),
        (["0,a,1,2,3,z", '1,b,1,2,3,"z', "2,c,1,2,3,z", "3,d,1,2,3,z"], [3]),
        (["0,a,1,2,3,z", '1,b,1,2,3,"z', "2,c,1,2,3,z", '3,d,1,2,3,z"', "4,e,1,2,3,z"], [3]),
        (["0,a,1,2,3,z", '1,"b,1,2,3,z', "2,c,1,2,3,z", '3,"d,1,2,3,z', "4,e,1,2,3,z"], [3, 5]),
        (["0,a,1,2,3,z", "1,b,1,2,3,z", "2,c,1,2,3,z", '3,d,1,2,3,"z'], [5]),
    ],
)  # fmt: skip
def test_a_quote_that_is_not_closed_costs_its_own_row(rows, bad, end):
    """The rows that it would swallow are read, and its line is noted."""
    _, count, losses, _ = read("\n".join(rows) + end, QUOTED)
    assert count == len(rows) - len(bad)
    assert losses == [Loss(f"line {line}", "its quote is not closed", 1) for line in bad]


@pytest.mark.parametrize("cell", ['"a ""quote"""', "plain", '5" disk'])
def test_stray_quotes_anywhere_cost_their_own_rows_only(cell):
    """In a table of many blocks, whether or not other cells have quotes."""
    rows = [f"{k},1,2,3,{cell},z" for k in range(200_000)]
    strays = (10, 80_000, 80_001, 199_998)
    for k in strays:
        rows[k] = f'{k},1,2,3,"a,z'
    _, count, losses, _ = read("\n".join(rows) + "\n", "t_ns,wx,wy,wz,size,raw\n")
    assert count == 199_996
    assert losses == [Loss(f"line {2 + k}", "its quote is not closed", 1) for k in strays]


def test_stray_quotes_between_cells_with_line_breaks_are_counted():
    """Where a record ends may be in doubt then; every row is read or counted as lost."""
    rows = [f'{k},1,2,3,"a\n""{k}"""' for k in range(20_000)]
    rows[5_000] = '5000,1,2,3,"a'
    _, count, losses, _ = read("\n".join(rows) + "\n", "t_ns,wx,wy,wz,raw\n")
    assert 19_980 < count < 20_000
    assert count + sum(loss.messages for loss in losses) >= 20_000


@pytest.mark.parametrize("cell", ["1_000", "\u0661.5", "1\u00a0000"])
def test_what_only_python_takes_for_a_number_is_none(cell):
    """Underscores and digits of other scripts are damage, or what a user has to settle."""
    _, count, losses, _ = read("0,0.5,1,1\n1,0.5,1,1\n2,0.5,1,1\n" + f"3,0.5,1,{cell}\n")
    assert count == 3
    reason = f"{quoted(cell)} in column 'wz' is not a number"
    assert losses == [Loss("line 5", reason, 1)]
    assert read("0,0.5,1,1\n1,0.5,1,1\n2,0.5,1,1\n1_0,0.5,1,1\n")[1] == 3


def test_a_text_of_the_old_macintosh_is_whole():
    """Its lines end with a carriage return, the last one, too."""
    text = "t_ns,wx,wy,wz\r0,0.5,1,1\r10,0.5,1,2\r"
    assert read(text.encode()) == ([0.5, 1.0, 2.0], 2, [], [])


@pytest.mark.parametrize("rows", [1, 2, 40])
def test_a_last_row_whose_first_cell_has_line_breaks_is_one_row(rows):
    """Its line end is missing, and a line break in its first cell does not begin a row."""
    text = "".join(f'"a\nb {k}",{k},0.125,-0.25,0.500\n' for k in range(rows))
    last, count, losses, remarks = read(text[:-1], header="note,t_ns,wx,wy,wz\n")
    assert (last, count, losses) == ([0.125, -0.25, 0.5], rows, [])
    assert len(remarks) == (rows < 40)


def test_quotes_in_comments_and_within_cells_are_no_damage():
    """A quote has a meaning only at the beginning of a cell, and none in a comment."""
    text = '# "paused\n0,a,1,2,3,5"\n#,"stop\n1,3" disk,1,2,3,z\n'
    assert read(text, QUOTED)[1:] == (2, [], [])


def test_a_stray_quote_costs_its_row_alone():
    """Only a cell whose next lines are no rows can have line breaks."""
    text = rows_of(*["0.123456"] * 3, '0.12"3456', *["0.123456"] * 120)
    _, count, losses, _ = read(text)
    reason = "'0.12\"3456' in column 'wz' is not a number"
    assert (count, losses) == (123, [Loss("line 5", reason, 1)])


@pytest.mark.parametrize("rows", [200, 20_000])
def test_a_compressed_text_that_is_cut_off_ends_with_its_last_whole_line(rows):
    """All that zlib decompresses of it is read; there is no doubt that more follows."""
    text = (HEADER + rows_of(*(f"{k}.5" for k in range(rows)))).encode()
    packed = gzip.compress(text)[: -300 if rows < 1000 else -500]
    whole_lines = zlib.decompressobj(wbits=31).decompress(packed).count(b"\n")
    last, count, losses, remarks = read(packed)
    assert (last, count) == ([0.125, -0.25, count - 0.5], whole_lines - 1)
    assert (losses[0], remarks) == (Loss(f"line {count + 2}", CUT, 1), [])
    assert losses[1] == Loss("end of the file", "its gz data is damaged or cut off")


def test_a_compressed_text_of_which_nothing_can_be_read_is_damaged(tmp_path):
    """A block of bz2 is read whole or not at all, and the file is not empty."""
    path = tmp_path / "log.csv.bz2"
    path.write_bytes(bz2.compress((HEADER + rows_of(*"12345")).encode())[:-20])
    with pytest.raises(DamagedLogError) as caught:
        CsvLog(path)
    assert str(caught.value) == (
        f"{path}: its bz2 data is damaged or cut off, and nothing of it can be read"
    )


def test_the_doubt_is_said_by_the_commands(tmp_path):
    """The remark is shown, stands in the report, and is no loss: exit code 0."""
    log, report = tmp_path / "log.csv", tmp_path / "report.json"
    log.write_text(HEADER + rows_of("0.5", "0.25", "0.75"))
    command = ["propagate", str(log), "-o", str(tmp_path / "out.csv"), "--report", str(report)]
    result = CliRunner().invoke(cli, command)
    assert result.exit_code == 0
    shown = "warning: " + REMARK.format("'5,-0.25,0.75'")
    assert shown in result.output
    assert any("no line end" in remark for remark in json.loads(report.read_text())["remarks"])
    assert "no line end" in CliRunner().invoke(cli, ["info", str(log)]).output


@pytest.mark.parametrize(
    "command", ["info {}", "convert {} {}.out.csv", "compare {} {}", "plot {} -o {}.svg"]
)
def test_every_command_says_that_an_attitude_may_be_cut(tmp_path, command):
    """A component that lost its last digits is another attitude."""
    log = tmp_path / "log.txt"
    rows = [f"{k} 0 0 0 0.6 0 0 {cell}" for k, cell in enumerate(["0.8", "0.80", "0.8", "0.8"])]
    log.write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows))
    result = CliRunner().invoke(cli, command.replace("{}", str(log)).split())
    assert result.exit_code == 0, result.output
    assert REMARK.format("' 0.6 0 0 0.8'") in result.output


ROWS = "".join(f"{1000 * k},0.5,0.25,0.125\n" for k in range(1000))


def test_a_row_with_a_cell_of_megabytes_is_read():
    """Text beside the numbers may be of any length."""
    text = "".join(f"{1000 * k},1,2,3,{'x' * 3_000_000}\n" for k in range(6))
    assert read(text, "t_ns,wx,wy,wz,note\n") == ([1.0, 2.0, 3.0], 6, [], [])


def test_a_cell_of_megabytes_that_is_no_number_is_one_row_that_does_not_fit():
    """One row is lost with it, and its line is told."""
    text = f"{ROWS}1000000,{'x' * 10_000_000},1,2\n1001000,1,2,3\n"
    last, count, losses, _ = read(text)
    assert (last, count) == ([1.0, 2.0, 3.0], 1001)
    assert [(loss.place, loss.messages) for loss in losses] == [("line 1002", 1)]


def test_a_header_without_end_is_refused():
    """Fifty megabytes of commas are no table."""
    with pytest.raises(UnsupportedLogError, match="its header is longer than 262144 bytes"):
        read("," * 50_000_000, "")


@pytest.mark.parametrize("junk", ["1\n", '"\n"x\n', "a,b\n"])
def test_megabytes_of_rows_that_do_not_fit_are_refused_soon(junk):
    """A table is refused when most of its rows do not fit, without looking at all of them."""
    began = time.process_time()
    with pytest.raises(UnsupportedLogError, match=r"rows do not fit \(line"):
        read(ROWS + junk * (20_000_000 // len(junk)))
    assert time.process_time() - began < 5
