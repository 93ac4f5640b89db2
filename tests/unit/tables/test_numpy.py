"""NumPy arrays and archives: columns, types, orders, damage, what is never believed."""

import io
import struct
import zipfile

import numpy as np
import pytest
from click.testing import CliRunner
from make.table_rates import rate_batches

from quatprop.cli.commands import cli
from quatprop.errors import DamagedLogError, NoRatesError, UndeclaredError, UnsupportedLogError
from quatprop.logs.open_log import open_log
from quatprop.tables.npy_format import HeaderError, read_header

T_NS = np.array([1_700_000_000_123_456_789, 1_700_000_000_123_456_790, -5], np.int64)
RATES = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [0.1, -0.0, 5e-324]])
RECORDS = [("t_ns", "<i8"), ("wx", "<f8"), ("wy", "<f8"), ("wz", "<f8")]


def records(t_ns=T_NS, rates=RATES, dtype=RECORDS):
    """Return rates as an array of records."""
    rows = np.zeros(len(t_ns), dtype)
    for name, column in zip(rows.dtype.names, (t_ns, *np.transpose(rates)), strict=True):
        rows[name] = column
    return rows


def read(path, **options):
    """Return stamps, rates and losses of a file."""
    with open_log(path) as log:
        batches = list(rate_batches(log, **options))
        t_ns = np.concatenate([np.zeros(0, np.int64), *(batch.t_ns for batch in batches)])
        return t_ns, np.concatenate([np.zeros((0, 3)), *(b.rate for b in batches)]), log.losses


def run(*arguments):
    """Run the command and return the result."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def npy(header, data=b"", version=(1, 0)):
    """Return an array file with any header."""
    text = header if isinstance(header, bytes) else repr(header).encode()
    form = "<H" if version == (1, 0) else "<I"
    return b"\x93NUMPY" + bytes(version) + struct.pack(form, len(text)) + text + data


@pytest.mark.parametrize("suffix", ["npy", "npz"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_records_are_read_to_the_bit(tmp_path, suffix, order):
    """Stamps and numbers are what the array holds, in either byte order, and its name is no hint.

    Records of an archive of one array need no prefix.
    """
    path = tmp_path / "log"
    dtype = [(name, order + kind[1:]) for name, kind in RECORDS]
    with path.open("wb") as file:
        (np.save if suffix == "npy" else np.savez)(file, records(dtype=dtype))
    t_ns, rate, losses = read(path)
    assert t_ns.tolist() == T_NS.tolist()
    assert rate.tobytes() == RATES.tobytes()
    assert losses == []


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("fortran", [False, True])
def test_an_archive_of_columns_and_matrices_is_read(tmp_path, save, fortran):
    """An array of two dimensions is as many columns, in either order of storage."""
    path = tmp_path / "log.npz"
    gyro = np.asfortranarray(RATES) if fortran else RATES
    save(
        path,
        t_ns=T_NS,
        gyro=gyro,
        sample_rate=100.0,
        note=np.array(["a", "b"]),
        k=np.zeros((2, 2, 2)),
    )
    t_ns, rate, losses = read(path, rate_unit="rad/s", time_col="t_ns")
    assert t_ns.tolist() == T_NS.tolist()
    assert rate.tobytes() == RATES.tobytes()
    assert losses == []


@pytest.mark.parametrize("fortran", [False, True])
def test_columns_without_names_are_numbered(tmp_path, fortran):
    """A plain array needs the options that a headerless text needs."""
    path = tmp_path / "log.npy"
    rows = np.column_stack([[0.5, 1.0, 2.0], RATES])
    np.save(path, np.asfortranarray(rows) if fortran else rows)
    with pytest.raises(NoRatesError, match="its columns are '0', '1', '2', '3'; name the columns"):
        read(path)
    with pytest.raises(UndeclaredError, match="the unit of the rates '1', '2', '3' and the unit"):
        read(path, rate_cols=("1", "2", "3"), time_col="0")
    said = {"rate_cols": ("1", "2", "3"), "rate_unit": "rad/s"}
    t_ns, rate, _ = read(path, **said, time_col="0", time_unit="s")
    assert t_ns.tolist() == [500_000_000, 1_000_000_000, 2_000_000_000]
    assert rate.tobytes() == RATES.tobytes()
    assert read(path, **said, sample_rate=4.0)[0].tolist() == [0, 250_000_000, 500_000_000]


def test_a_plain_array_of_quaternions_needs_layout_and_time(tmp_path):
    """Neither which column is the scalar nor when the rows were is guessed."""
    path, out = tmp_path / "q.npy", tmp_path / "out.csv"
    np.save(path, np.array([[0.0, 0.0, 0.0, 1.0], [0.6, 0.0, 0.0, 0.8]]))
    command = ["convert", path, out, "--quat-cols", "0,1,2,3"]
    result = run(*command)
    assert result.exit_code == 2
    assert "which of the columns '0', '1', '2', '3' is the scalar is not declared" in result.stderr
    command += ["--from-layout", "xyzw"]
    assert "--sample-rate HZ for rows at a steady rate" in run(*command).stderr
    assert run(*command, "--sample-rate", "2").exit_code == 0
    assert out.read_text() == "t_ns,qw,qx,qy,qz\n0,1,0,0,0\n500000000,0.8,0.6,0,0\n"


def test_nested_records_and_fields_that_are_arrays_are_opened(tmp_path):
    """Fields of fields are named with dots, elements with brackets."""
    path = tmp_path / "log.npy"
    rows = np.zeros(2, [("header", [("t_ns", "<i8")]), ("gyro", "<f4", (3,)), ("mode", "S3")])
    rows["header"]["t_ns"], rows["gyro"] = [7, 9], [[1, 2, 3], [4, 5, 6]]
    np.save(path, rows)
    with open_log(path) as log:
        assert log.names == ["header.t_ns", *(f"gyro[{k}]" for k in range(3)), "mode"]
    t_ns, rate, _ = read(path, rate_unit="rad/s", time_col="header.t_ns")
    assert (t_ns.tolist(), rate.tolist()) == ([7, 9], [[1, 2, 3], [4, 5, 6]])
    with pytest.raises(UnsupportedLogError, match="column 'mode' holds string, not numbers"):
        read(path, rate_unit="rad/s", time_col="mode", time_unit="ns")


def test_dates_know_their_unit(tmp_path):
    """datetime64 is a time whatever it is called; NaT is a row without a time, and told."""
    path = tmp_path / "log.npz"
    when = np.array(["2026-01-01T00:00:00.000001", "NaT"], "datetime64[us]")
    np.savez(path, recorded=when, gyro=RATES[:2])
    t_ns, rate, losses = read(path, rate_unit="rad/s")
    assert t_ns.tolist() == [1767225600_000001000]
    assert len(rate) == 1
    assert [(loss.place, loss.messages) for loss in losses] == [("rows 1 to 2", 1)]


def test_names_beyond_latin_are_read(tmp_path):
    """A header of version 3 is text in UTF-8."""
    path = tmp_path / "log.npy"
    rows = records(dtype=[("t_ns", "<i8"), *((f"\u03c9{axis}", "<f8") for axis in "xyz")])
    with pytest.warns(UserWarning, match=r"format 3\.0"):
        np.save(path, rows)
    names = tuple(f"\u03c9{axis}" for axis in "xyz")
    assert read(path, rate_cols=names, rate_unit="rad/s")[0].tolist() == T_NS.tolist()


def test_pickles_are_never_loaded(tmp_path):
    """An array of objects is refused unread."""

    class Bomb:
        def __reduce__(self):
            return pytest.fail, ("it was unpickled",)

    path = tmp_path / "log.npy"
    np.save(path, np.array([Bomb()], object), allow_pickle=True)
    sentence = "it holds pickled Python objects, which could run code and are not read; save plain"
    with pytest.raises(DamagedLogError, match=sentence):
        read(path)
    archive = tmp_path / "log.npz"
    np.savez(archive, rows=np.array([Bomb()], object))
    with pytest.raises(UnsupportedLogError, match=f"its array 'rows': {sentence}"):
        read(archive)


DESCR = np.lib.format.dtype_to_descr(np.dtype(RECORDS))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"\x93NUMPY", "it does not begin as a NumPy array; check that it was copied whole"),
        (b"\x93NUMPY\x01", "it does not begin as a NumPy array"),
        (b"\x93NUMPY\x01\x00", "it ends within its header; check that it was copied whole"),
        (b"\x93NUMPY\x09\x00\x10\x00", "it is of version 9.0 and 1.0 to 3.0 are read; save it"),
        (npy({"descr": DESCR, "fortran_order": False, "shape": (2,)})[:-9], "it ends within its"),
        (npy(b"", version=(2, 0))[:8] + b"\xff\xff\xff\xff", "its header claims 4294967295 bytes"),
        (npy("not a dict"), "its header is damaged; save it again"),
        (npy(b"(" * 5000), "its header is damaged"),
        (npy(b"__import__('os')"), "its header is damaged"),
        (npy({"descr": "nonsense", "fortran_order": False, "shape": (2,)}), "header is damaged"),
        (npy({"descr": DESCR, "fortran_order": False, "shape": (-2,)}), "its header gives no shap"),
        (npy({"descr": DESCR, "fortran_order": False, "shape": (True,)}), "its header gives no s"),
        (npy({"descr": DESCR, "fortran_order": False, "shape": 3}), "its header gives no shape"),
        (npy({"descr": "|V0", "fortran_order": False, "shape": (3,)}), "its elements have 0 bytes"),
        (npy({"descr": "|S9999999", "fortran_order": False, "shape": (3,)}), "have 9999999 bytes"),
        (npy({"descr": "<f8", "fortran_order": False, "shape": ()}), r"its array of shape \(\) is"),
        (npy({"descr": "<f8", "fortran_order": False, "shape": (2, 3, 4)}), r"of shape \(2, 3, 4"),
        (npy({"descr": DESCR, "fortran_order": False, "shape": (2, 2)}), r"of shape \(2, 2\) is"),
        (npy({"descr": "<f8", "fortran_order": False, "shape": (2, 10**15)}), "its rows have 8000"),
        (npy({"descr": "<f8", "fortran_order": True, "shape": (2, 0)}), "its rows have 8 bytes"),
    ],
)  # fmt: skip
def test_headers_are_not_believed(tmp_path, content, sentence):
    """What is no table is told in one sentence, quickly, whatever sizes the header claims."""
    path = tmp_path / "log.npy"
    path.write_bytes(content)
    with pytest.raises(DamagedLogError, match=sentence):
        read(path)
    assert run("info", path).exit_code == 2


def test_a_header_that_claims_too_much_gives_what_is_there(tmp_path):
    """Rows are read as they come; those that are missing are told, and the exit code is 3."""
    path = tmp_path / "log.npy"
    rows = records()
    header = {"descr": DESCR, "fortran_order": False, "shape": (2**60,)}
    path.write_bytes(npy(header, rows.tobytes()[:-1]))
    t_ns, _, losses = read(path)
    assert t_ns.tolist() == T_NS[:2].tolist()
    assert [(loss.place, loss.messages) for loss in losses] == [("the end of its array", 2**60 - 2)]
    assert "it has 2 of the 1152921504606846976 rows it claims" in losses[0].reason
    assert run("propagate", path, "-o", tmp_path / "out.csv").exit_code == 3


def test_what_follows_the_array_is_told(tmp_path):
    """A header that claims too little, or a second array behind the first, is no silent loss."""
    path = tmp_path / "log.npy"
    with path.open("wb") as file:
        np.save(file, records())
        np.save(file, records())
    _, _, losses = read(path)
    assert [(loss.place, loss.reason) for loss in losses] == [
        (
            "end of the file",
            "288 bytes follow its array and are not read; was another joined to it?",
        )
    ]


@pytest.mark.parametrize("save", [np.save, np.savez, np.savez_compressed])
def test_a_file_cut_anywhere_is_a_sentence_or_a_prefix(tmp_path, save):
    """No cut leads to other rows than those that stood there."""
    path, whole = tmp_path / "log", io.BytesIO()
    save(whole, records(np.arange(500), np.arange(1500.0).reshape(500, 3)))
    data = whole.getvalue()
    kept = []
    for cut in np.linspace(1, len(data) - 1, 100).astype(int):
        path.write_bytes(data[:cut])
        result = run("propagate", path, "--from", "npy" if save is np.save else "npz", "-o",
                     tmp_path / "out.csv")  # fmt: skip
        assert result.exit_code in {2, 3}, result.output
        if result.exit_code == 3:
            t_ns, rate, _ = read(path)
            kept.append(len(t_ns))
            assert t_ns.tolist() == list(range(len(t_ns)))
            assert rate.ravel().tolist() == list(range(3 * len(t_ns)))
    assert max(kept) >= 490


@pytest.mark.parametrize("count", [5, 200_000])
def test_an_archive_with_a_wrong_checksum_is_told(tmp_path, count):
    """Numbers that are not what was written do not pass in silence; rows before them are saved."""
    path = tmp_path / "log.npz"
    np.savez(path, t_ns=np.arange(count), **{f"w{axis}": np.ones(count) for axis in "xyz"})
    data = path.read_bytes()
    place = data.index(np.ones(count).tobytes()) + 8 * count - 5
    path.write_bytes(data[:place] + b"\x01" + data[place + 1 :])
    if count == 5:
        with pytest.raises(
            DamagedLogError, match=r"'wx' is damaged \(Bad CRC-32 for file 'wx.npy'"
        ):
            read(path)
        return
    t_ns, _, losses = read(path)
    assert 150_000 < len(t_ns) < count
    assert [loss.messages for loss in losses] == [count - len(t_ns)]
    assert "rows it claims (Bad CRC-32 for file 'wx.npy')" in losses[0].reason


def test_columns_of_different_lengths_are_no_table(tmp_path):
    """They are refused before anything is read."""
    path = tmp_path / "log.npz"
    np.savez(path, t_ns=np.arange(5), **{f"w{axis}": np.ones(4) for axis in "xyz"})
    with pytest.raises(UnsupportedLogError, match=r"have '4', '5' rows, so they are not one table"):
        read(path)


def test_joined_archives_are_refused(tmp_path):
    """Of two archives in one file, zipfile opens the last and passes over the first."""
    path = tmp_path / "log.npz"
    np.savez(path, t_ns=T_NS, **dict(zip(("wx", "wy", "wz"), RATES.T, strict=True)))
    size = path.stat().st_size
    path.write_bytes(2 * path.read_bytes())
    message = f"another file begins in it at byte {size}; split it there into two"
    with pytest.raises(UnsupportedLogError, match=message):
        read(path)
    content = path.read_bytes()
    path.write_bytes(content[:-22] + bytes(22))  # without the end record of the second
    assert [(loss.place, loss.reason) for loss in read(path)[2]] == [
        (
            f"byte {size}",
            f"{size} bytes follow the archive and are not read; was another joined to it?",
        )
    ]


def test_an_archive_of_something_else_is_refused(tmp_path):
    """Any zip file begins like an archive of arrays."""
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "nothing")
    with pytest.raises(UnsupportedLogError, match=r"it is a ZIP archive of 'readme.txt'; unpack"):
        read(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("xl/workbook.xml", "")
    with pytest.raises(UnsupportedLogError, match="a workbook of a spreadsheet; save its table as"):
        read(path)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(DamagedLogError, match=r"its directory is damaged .* was it written to"):
        read(path)


def test_memory_does_not_grow_with_the_file(tmp_path):
    """Blocks are small however wide the rows are."""
    path = tmp_path / "log.npy"
    wide = np.zeros(100, [*RECORDS, ("frame", "S1000000")])
    np.save(path, wide)
    with open_log(path) as log:
        sizes = [len(batch) for batch in rate_batches(log)]
    assert sum(sizes) == 100
    assert max(sizes) * wide.itemsize <= 1 << 24


def test_a_header_error_is_a_sentence_by_itself():
    """The parser of headers can be used alone."""
    with pytest.raises(HeaderError, match="it does not begin as a NumPy array"):
        read_header(io.BytesIO(b"PK"))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_archive_without_its_directory_gives_its_whole_arrays(tmp_path, save):
    """The rows that all of the columns have are read, and the loss is noted."""
    path, count = tmp_path / "log.npz", 100_000
    names = ("t_ns", "wx", "wy", "wz", "temperature")
    save(path, **{name: np.arange(count) * 1.5 for name in names})
    data = path.read_bytes()
    for cut, rows in ((len(data) - 10, count), (data.index(b"temperature") - 5, count),
                      (data.index(b"temperature") - 100, range(count // 2, count))):  # fmt: skip
        path.write_bytes(data[:cut])
        t_ns, _, losses = read(path, time_unit="ns")
        assert len(t_ns) == rows if isinstance(rows, int) else len(t_ns) in rows
        assert losses[0].reason == "its directory is damaged: more arrays may be missing"


def test_an_array_that_was_being_written_is_read_as_far_as_it_goes(tmp_path):
    """A process that died has not yet written the size of its last array."""
    path = tmp_path / "log.npz"
    np.savez(path, rows=records(np.arange(500), np.arange(1500.0).reshape(500, 3)))
    data = bytearray(path.read_bytes()[:5000])
    begin = 30 + len("rows.npy") + 4
    data[14:18], data[begin : begin + 16] = bytes(4), bytes(16)  # checksum and sizes
    path.write_bytes(data)
    t_ns, _, losses = read(path)
    assert t_ns.tolist() == list(range(len(t_ns)))
    assert len(t_ns) > 100
    assert len(losses) == 2
