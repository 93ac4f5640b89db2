"""Text tables that are damaged: torn rows, lost line ends, stray quotes, zeros, absurd shapes."""

import bz2
import errno
import gzip
import io
import math
import re
import zlib

import pytest
from make.commands import run
from make.table_rates import refusal, table_rates

from quatprop.base.errors import DamagedLogError, Loss, UnsupportedLogError, UsageError
from quatprop.base.text import quoted
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.tables.csv import CsvLog
from quatprop.settings.reading import RateSelection

UNITS = {"rate_unit": "rad/s", "time_unit": "s"}
HEADER = "t_ns,wx,wy,wz\n"
CUT = "it has no line end, and its last cell was cut off"


def read(text, header=HEADER):
    """Return the numbers of the last row that is read, the rows, the losses and the remarks."""
    text = text if isinstance(text, bytes) else header + text
    _, rate, losses, remarks = table_rates(text, rate_unit="rad/s", time_unit="ns")
    return rate[-1].tolist() if len(rate) else None, len(rate), losses, remarks


def rows_of(*cells):
    """Return rows whose last cells are these, the last without its line end."""
    return "\n".join(f"{1000 * k},0.125,-0.25,{cell}" for k, cell in enumerate(cells))


# Rows that do not fit


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("1,2,3", "it has 3 columns instead of 4"),
        ("1,2,3,4,5", "it has 5 columns instead of 4"),
        ("1,x3,2,4", "'x3' in column 'wx' is not a number"),
        ("1e999999999,2,3,4", "1e999999999 s in column 't' does not fit"),
        ("inf,2,3,4", "'inf' in column 't' is not a time"),
        ("1e,2,3,4", "'1e' in column 't' is not a time"),
        (",2,3,4", "'' in column 't' is not a time"),
        ("99999999999999999999,2,3,4", "99999999999999999999 s in column 't' does not fit"),
        ('0.5,2,3,0.12"3456', "'0.12\"3456' in column 'wz' is not a number"),
        # Only Python takes the next ones for numbers.
        ("1,2,3,1_000", "'1_000' in column 'wz' is not a number"),
        ("1,2,3,\u0661.5", f"{quoted(chr(0x661) + '.5')} in column 'wz' is not a number"),
        ("1,2,3,1\u00a0000", f"{quoted('1' + chr(0xA0) + '000')} in column 'wz' is not a number"),
        ("1_0,2,3,4", "'1_0' in column 't' is not a time"),
    ],
)
def test_a_row_that_does_not_fit_is_left_out_and_told(row, reason):
    """A damaged row is lost alone, with its line and the reason."""
    rows = f"0,1,2,3\n\n{row}\n2,1,2,3\n3,1,2,3\n"
    t_ns, _, losses, _ = table_rates(f"t,wx,wy,wz\n{rows}", **UNITS)
    assert t_ns == [0, 2000000000, 3000000000]
    (loss,) = losses
    assert (loss.place, loss.messages) == ("line 4", 1)
    assert loss.reason.startswith(reason)


def test_many_losses_are_told_together():
    """Losses are counted by place, so that a bad log does not fill the memory with sentences."""
    rows, reason = ["1,1,2,3"] * 99, "it has 1 columns instead of 4"
    rows[2:74:9] = ["1"] * 8
    few = [Loss(f"line {line}", reason, 1) for line in range(4, 76, 9)]
    assert read("\n".join(rows) + "\n")[2] == few
    rows[74] = "1"
    many = Loss("lines 4 to 76", f"9 of these rows do not fit; the first: {reason}", 9)
    assert read("\n".join(rows) + "\n")[2] == [many]


def test_a_log_is_read_again_from_the_start_and_stdin_once(tmp_path):
    """Losses are reported once, and so is a stream that cannot be read again."""
    text = "t,wx,wy,wz\n0,1,2,3\n1\n2,1,2,3\n"
    path = tmp_path / "log.csv"
    path.write_text(text)
    with CsvLog(path) as log, CsvLog(io.BytesIO(text.encode())) as stdin:
        for _ in range(2):
            batches = choose_rates(log, RateSelection(**UNITS)).batches()
            assert sum(map(len, batches)) == 2
        assert len(log.losses) == 1
        assert len(list(choose_rates(stdin, RateSelection(**UNITS)).batches())) == 1
        with pytest.raises(UsageError, match="stdin can be read only once"):
            list(choose_rates(stdin, RateSelection(**UNITS)).batches())


# A last line without its end

SIX = ["0.123456", "-1.000000", "2.500000"]
LONG = [repr(math.sin(k + 1)) for k in range(100)]
REMARK = (
    "the last line has no line end: if the log was cut off there, its end {} may have lost digits"
)


@pytest.mark.parametrize(
    "cells",
    [
        # Where every number has six decimals, one of three is the beginning of another.
        [*SIX, "0.123"],
        # Numbers printed in full have nearly always many digits.
        [*LONG, "0.85"],
        *([*["1.2500e-03", "2.2500e+02"] * 3, end] for end in ("", "-", "1.25e", "1.25e-")),
        [*["1.2500e-03", "2.2500e+02"] * 3, "1.2500e-0"],
        ['"3.5"', '"3.5"', '"3.'],
    ],
    ids=lambda cells: cells[-1],
)
def test_a_last_cell_that_is_shorter_than_those_before_was_cut_off(cells):
    """The beginning of a number is no sample, whether it is a number or none any more."""
    _, count, losses, remarks = read(rows_of(*cells))
    assert (count, remarks) == (len(cells) - 1, [])
    assert losses == [Loss(f"line {len(cells) + 1}", CUT, 1)]


@pytest.mark.parametrize(
    "cells",
    [
        ("0.5", "0.25", "0.125", "0.75"),
        ("1", "22", "-333", "12"),
        # Too few to tell that all have as many decimals, or many.
        (*SIX[:2], "0.123"),
        (*SIX[:2], "0.654321"),
        (*LONG[1:], "0.85"),
    ],
    ids=lambda cells: cells[-1],
)
def test_where_nobody_can_tell_it_is_said(cells):
    """Numbers of any length may be whole or cut: the last is kept, with a remark."""
    text = rows_of(*cells)
    last, count, losses, remarks = read(text)
    assert (last[2], count, losses) == (float(cells[-1]), len(cells), [])
    assert remarks == [REMARK.format(f"'{text[-12:]}'")]


def test_a_last_line_without_its_end_is_whole_where_it_looks_like_the_others():
    """Texts that people join by line ends have none behind the last line."""
    assert read(rows_of(*SIX, "0.000000")) == ([0.125, -0.25, 0.0], 4, [], [])
    # No number that is used can have lost a digit.
    text = "0,1,2,3,some words\n1,1,2,3,some wo"
    assert read(text, "t_ns,wx,wy,wz,note\n") == ([1.0, 2.0, 3.0], 2, [], [])


def test_a_last_date_that_is_shorter_than_those_before_was_cut_off():
    """Without its zone it was still a date."""
    text = "".join(f"1,2,3,2026-01-01T00:00:0{k}Z\n" for k in range(4))
    assert read(text[:-2], "wx,wy,wz,time\n")[1:3] == (3, [Loss("line 5", CUT, 1)])
    assert read(text[:-1], "wx,wy,wz,time\n")[1:3] == (4, [])


def test_a_time_of_two_parts_may_overflow_as_a_sum():
    """The row is lost alone, with its time."""
    rows = "".join(f"9223372036,{ns},1,2,3\n" for ns in (1, 854775807, 854775808))
    t_ns, _, losses, _ = table_rates(f"s,ns,wx,wy,wz\n{rows}", time_col="s,ns", rate_unit="rad/s")
    assert t_ns == [2**63 - 854775807, 2**63 - 1]
    reason = "its time of 9223372036854775808 ns does not fit in int64 ns"
    assert losses == [Loss("line 4", reason, 1)]


@pytest.mark.parametrize("kind", ["csv", "jsonl"])
def test_a_place_of_a_text_that_cannot_be_read_ends_it(tmp_path, monkeypatch, kind):
    """As on a worn memory card: the rows before it are read."""
    path, count = tmp_path / f"log.{kind}", 60_000
    row = "{},1,2,3\n" if kind == "csv" else '{{"t_ns":{},"wx":1,"wy":2,"wz":3}}\n'
    path.write_text(HEADER * (kind == "csv") + "".join(map(row.format, range(count))))
    read_file = io.FileIO.readinto

    def fail(file, buffer):
        if file.tell() >= 1 << 19:
            raise OSError(errno.EIO, "Input/output error")
        return read_file(file, buffer)

    monkeypatch.setattr("quatprop.readers.tables.text_rows._FileNow.readinto", fail)
    t_ns, _, losses, _ = table_rates(path, rate_unit="rad/s")
    assert t_ns == [*range(len(t_ns))]
    assert 10_000 < len(t_ns) < count
    assert losses[-1].place == "end of the file"
    assert losses[-1].reason.startswith("it cannot be read further: ")


@pytest.mark.parametrize("rows", [1, 2, 40])
def test_a_last_row_whose_first_cell_has_line_breaks_is_one_row(rows):
    """Its line end is missing, and a line break in its first cell does not begin a row."""
    text = "".join(f'"a\nb {k}",{k},0.125,-0.25,0.500\n' for k in range(rows))
    last, count, losses, remarks = read(text[:-1], header="note,t_ns,wx,wy,wz\n")
    assert (last, count, losses) == ([0.125, -0.25, 0.5], rows, [])
    assert len(remarks) == (rows < 40)


@pytest.mark.parametrize(
    "command", ["info {}", "convert {} {}.out.csv", "compare {} {}", "plot {} -o {}.svg"]
)
def test_every_command_says_that_an_attitude_may_be_cut(tmp_path, command):
    """A component that lost its last digits is another attitude."""
    log = tmp_path / "log.txt"
    rows = [f"{k} 0 0 0 0.6 0 0 {cell}" for k, cell in enumerate(["0.8", "0.80", "0.8", "0.8"])]
    log.write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows))
    result = run(*command.replace("{}", str(log)).split(), code=0)
    assert REMARK.format("' 0.6 0 0 0.8'") in result.output


# Zeros


@pytest.mark.parametrize(
    ("count", "zeros"), [(3, 1), (3, 4096), (3, 5_000_000), (200_000, 5_000_000)]
)
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


# Quotes

QUOTED = "t_ns,note,wx,wy,wz,end\n"
NOT_CLOSED = "its quote is not closed"


@pytest.mark.parametrize("end", ["\n", ""])
@pytest.mark.parametrize(
    ("rows", "bad"),
    [
        ('0,a,1,2,3,z 1,"b,1,2,3,z 2,c,1,2,3,z 3,d,1,2,3,z', [3]),
        ('0,a,1,2,3,z 1,b,1,"2,3,z 2,c,1,2,3,z 3,d,1,2,3,z', [3]),
        ('0,a,1,2,3,z 1,b,1,2,3,"z 2,c,1,2,3,z 3,d,1,2,3,z', [3]),
        ('0,a,1,2,3,z 1,b,1,2,3,"z 2,c,1,2,3,z 3,d,1,2,3,z" 4,e,1,2,3,z', [3]),
        ('0,a,1,2,3,z 1,"b,1,2,3,z 2,c,1,2,3,z 3,"d,1,2,3,z 4,e,1,2,3,z', [3, 5]),
        ('0,a,1,2,3,z 1,b,1,2,3,z 2,c,1,2,3,z 3,d,1,2,3,"z', [5]),
    ],
)
def test_a_quote_that_is_not_closed_costs_its_own_row(rows, bad, end):
    """The rows that it would swallow are read, and its line is noted."""
    rows = rows.split()
    _, count, losses, _ = read("\n".join(rows) + end, QUOTED)
    assert count == len(rows) - len(bad)
    assert losses == [Loss(f"line {line}", NOT_CLOSED, 1) for line in bad]


@pytest.mark.parametrize("cell", ['"a ""quote"""', "plain", '5" disk'])
def test_stray_quotes_anywhere_cost_their_own_rows_only(cell):
    """In a table of several blocks, whether or not other cells have quotes, as torn rows do."""
    count, pad = 16_000, 300 * "x"
    rows = [f"{k},1,2,3,{cell},{pad}" for k in range(count)]
    strays = (10, 7_000, 7_001, count - 2)
    for k in strays:
        rows[k] = f'{k},1,2,3,"a,{pad}'
    rows[9_000] = "torn"
    _, kept, losses, _ = read("\n".join(rows) + "\n", "t_ns,wx,wy,wz,size,raw\n")
    assert kept == count - 5
    told = {loss.place: loss.reason for loss in losses}
    assert told.pop("line 9002") == "it has 1 columns instead of 6"
    assert told == {f"line {2 + k}": NOT_CLOSED for k in strays}


def test_stray_quotes_between_cells_with_line_breaks_are_counted():
    """Where a record ends may be in doubt then; every row is read or counted as lost."""
    rows = [f'{k},1,2,3,"a\n""{k}"""' for k in range(6_000)]
    rows[3_000] = '3000,1,2,3,"a'
    _, count, losses, _ = read("\n".join(rows) + "\n", "t_ns,wx,wy,wz,raw\n")
    assert 5_980 < count < 6_000
    assert count + sum(loss.messages for loss in losses) >= 6_000


def test_lines_of_as_many_words_as_columns_are_text():
    """A text with line breaks and commas holds no row, as its words are no numbers."""
    rows = [f'{k},"on\nleft, right, up, down, {k}",1,2,3' for k in range(9)]
    assert read("\n".join(rows) + "\n", "t_ns,raw,wx,wy,wz\n")[1:] == (9, [], [])


def test_quotes_in_comments_and_within_cells_are_no_damage():
    """A quote has a meaning only at the beginning of a cell, and none in a comment."""
    text = '# "paused\n0,a,1,2,3,5"\n#,"stop\n1,3" disk,1,2,3,z\n'
    assert read(text, f"#{QUOTED}")[1:] == (2, [], [])


# Compressed texts


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
    reason = "its bz2 data is damaged or cut off, and nothing of it can be read"
    assert refusal(path, DamagedLogError) == reason


# Absurd shapes

ROWS = "".join(f"{1000 * k},0.5,0.25,0.125\n" for k in range(1000))


def test_a_row_with_a_cell_of_megabytes_is_read():
    """Text next to the numbers may be of any length; one that should be a number is one loss."""
    text = "".join(f"{1000 * k},1,2,3,{'x' * 3_000_000}\n" for k in range(3))
    for whole in (text, text[:-1]):
        assert read(whole, "t_ns,wx,wy,wz,note\n") == ([1.0, 2.0, 3.0], 3, [], [])
    last, count, losses, _ = read(f"{ROWS}1000000,{'x' * 10_000_000},1,2\n1001000,1,2,3\n")
    assert (last, count) == ([1.0, 2.0, 3.0], 1001)
    assert [(loss.place, loss.messages) for loss in losses] == [("line 1002", 1)]


def test_a_header_without_end_is_refused():
    """Fifty megabytes of commas are no table."""
    assert refusal("," * 50_000_000).startswith("its header is longer than 262144 bytes")


@pytest.mark.parametrize("junk", ['"\n' + 200 * "x" + "\n", "a,b\n"], ids=["open quotes", "words"])
def test_megabytes_of_rows_that_do_not_fit_are_refused_soon(junk):
    """A table is refused when most of its rows do not fit, without looking at all of them."""
    stream = io.BytesIO((HEADER + ROWS + junk * (20_000_000 // len(junk))).encode())
    with CsvLog(stream) as log:
        batches = choose_rates(log, RateSelection()).batches()
        with pytest.raises(UnsupportedLogError, match=r"of its first (\d+) rows do not") as caught:
            list(batches)
        assert stream.tell() < 10_000_000
    assert int(re.search(r"first (\d+) rows", str(caught.value))[1]) < 200_000
