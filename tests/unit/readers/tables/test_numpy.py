"""NumPy arrays and archives: columns, types, orders, damage, what is never believed."""

import struct
import warnings
import zipfile

import h5py
import numpy as np
import pytest
from make.commands import refused
from make.table_rates import refusal, table_rates
from scipy.io import savemat

from quatprop.base.errors import DamagedLogError, NoRatesError, UndeclaredError
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection

T_NS = np.array([1_700_000_000_123_456_789, 1_700_000_000_123_456_790, -5], np.int64)
RATES = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [0.1, -0.0, 5e-324]])
RECORDS = [("t_ns", "<i8"), ("wx", "<f8"), ("wy", "<f8"), ("wz", "<f8")]
RAD = {"rate_unit": "rad/s"}


@pytest.fixture
def path(tmp_path):
    """Where a test writes its file; the name is no hint."""
    return tmp_path / "log"


def records(t_ns=T_NS, rates=RATES, dtype=RECORDS):
    """Return rates as an array of records."""
    rows = np.zeros(len(t_ns), dtype)
    for name, column in zip(rows.dtype.names, (t_ns, *np.transpose(rates)), strict=True):
        rows[name] = column
    return rows


def saved(path, save, *arrays, **named):
    """Save arrays under exactly this path, and return it."""
    with path.open("wb") as file:
        save(file, *arrays, **named)
    return path


def npy(header, data=b"", version=(1, 0)):
    """Return an array file with any header."""
    text = header if isinstance(header, bytes) else repr(header).encode()
    form = "<H" if version == (1, 0) else "<I"
    return b"\x93NUMPY" + bytes(version) + struct.pack(form, len(text)) + text + data


@pytest.mark.parametrize("save", [np.save, np.savez, np.savez_compressed])
@pytest.mark.parametrize("order", ["<", ">"])
def test_records_are_read_to_the_bit(path, save, order):
    """In either byte order; records of an archive of one array need no prefix."""
    dtype = [(name, order + kind[1:]) for name, kind in RECORDS]
    found = table_rates(saved(path, save, records(dtype=dtype)))
    assert (found.t_ns, found.losses) == (T_NS.tolist(), [])
    assert found.rate.tobytes() == RATES.tobytes()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("order", "CF")
def test_an_archive_of_columns_and_matrices_is_read(path, save, order):
    """An array of two dimensions is as many columns, in either order of storage."""
    others = {"sample_rate": 100.0, "note": np.array(["a", "b"]), "k": np.zeros((2, 2, 2))}
    saved(path, save, t_ns=T_NS, gyro=RATES.copy(order), **others)
    found = table_rates(path, time_col="t_ns", **RAD)
    assert (found.t_ns, found.losses) == (T_NS.tolist(), [])
    assert found.rate.tobytes() == RATES.tobytes()


@pytest.mark.parametrize("order", "CF")
def test_columns_without_names_are_numbered(path, order):
    """A plain array needs the options that a headerless text needs."""
    saved(path, np.save, np.column_stack([[0.5, 1.0, 2.0], RATES]).copy(order))
    assert "its columns are '0: 0.5', '1: 1.0', " in refusal(path, NoRatesError)
    cols = {"rate_cols": ("1", "2", "3")}
    sentence = refusal(path, UndeclaredError, time_col="0", **cols)
    assert "the unit of the rates '1', '2', '3' and the unit" in sentence
    found = table_rates(path, time_col="0", time_unit="s", **cols, **RAD)
    assert found.t_ns == [500_000_000, 1_000_000_000, 2_000_000_000]
    assert found.rate.tobytes() == RATES.tobytes()
    counted = table_rates(path, sample_rate=4.0, **cols, **RAD)
    assert counted.t_ns == [0, 250_000_000, 500_000_000]


def test_nested_records_and_fields_that_are_arrays_are_opened(path):
    """Fields of fields are named with dots, elements with brackets."""
    rows = np.zeros(2, [("header", [("t_ns", "<i8")]), ("gyro", "<f4", (3,)), ("mode", "S3")])
    rows["header"]["t_ns"], rows["gyro"] = [7, 9], [[1, 2, 3], [4, 5, 6]]
    with open_log(saved(path, np.save, rows)) as log:
        assert log.names == ["header.t_ns", *(f"gyro[{k}]" for k in range(3)), "mode"]
    found = table_rates(path, time_col="header.t_ns", **RAD)
    assert (found.t_ns, found.rate.tolist()) == ([7, 9], [[1, 2, 3], [4, 5, 6]])
    sentence = refusal(path, time_col="mode", time_unit="ns", **RAD)
    assert sentence.startswith("column 'mode' holds text, not numbers")


def test_dates_know_their_unit(path):
    """datetime64 is a time whatever it is called; NaT is a row without a time, and told."""
    when = np.array(["2026-01-01T00:00:00.000001", "NaT"], "datetime64[us]")
    found = table_rates(saved(path, np.savez, recorded=when, gyro=RATES[:2]), **RAD)
    assert (found.t_ns, found.rate.tolist()) == ([1767225600_000001000], [[1, 2, 3]])
    assert [(loss.place, loss.messages) for loss in found.losses] == [("rows 1 to 2", 1)]


def test_names_beyond_latin_are_read(path):
    """A header of version 3 is text in UTF-8."""
    names = tuple(f"\u03c9{axis}" for axis in "xyz")
    with pytest.warns(UserWarning, match=r"format 3\.0"):
        saved(path, np.save, records(dtype=[("t_ns", "<i8"), *((name, "<f8") for name in names)]))
    assert table_rates(path, rate_cols=names, **RAD).t_ns == T_NS.tolist()


def test_pickles_are_never_loaded(path):
    """An array of objects is refused unread."""

    class Bomb:
        def __reduce__(self):
            return pytest.fail, ("it was unpickled",)

    sentence = "it holds pickled Python objects, which could run code and are not read; save plain"
    bomb = np.array([Bomb()], object)
    assert refusal(saved(path, np.save, bomb), DamagedLogError).startswith(sentence)
    assert refusal(saved(path, np.savez, rows=bomb)).startswith(f"its array 'rows': {sentence}")


DESCR = np.lib.format.dtype_to_descr(np.dtype(RECORDS))


def header(descr, shape, *, fortran=False):
    """Return the header of an array file."""
    return {"descr": descr, "fortran_order": fortran, "shape": shape}


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"\x93NUMPY", "its header is damaged; was it copied whole?"),
        (b"\x93NUMPY\x01\x00", "its header is damaged"),
        (npy(header("<f8", (0,)), version=(9, 0)), "its header is damaged"),
        (npy(header(DESCR, (2,)))[:-9], "its header is damaged"),
        (npy(b"", version=(2, 0))[:8] + b"\xff\xff\xff\xff", "its header claims 4294967295 bytes"),
        (npy("not a dict"), "its header is damaged"),
        (npy(b"(" * 5000), "its header is damaged"),
        (npy(b"__import__('os')"), "its header is damaged"),
        (npy(header("nonsense", (2,))), "header is damaged"),
        (npy(header(DESCR, (-2,))), "its header gives no shape"),
        (npy(header(DESCR, 3)), "its header is damaged"),
        (
            npy(header(DESCR, (2**60,)), b"abc"),
            "it has 3 of the 36893488147419103232 bytes that its",
        ),
        (npy(header("|V0", (3,))), "its elements have 0 bytes"),
        (npy(header("|S9999999", (3,))), "have 9999999 bytes"),
        (npy(header("<f8", ())), "its array of shape () is"),
        (npy(header("<f8", (2, 3, 4))), "of shape (2, 3, 4"),
        (npy(header(DESCR, (2, 2))), "of shape (2, 2) is"),
        (npy(header("<f8", (200, 10**15))), "its rows have 8000"),
        (npy(header("<f8", (200, 4097))), "its rows have 32776 bytes"),
        (npy(header("<f8", (2, 0), fortran=True)), "its rows have 8 bytes"),
    ],
)
def test_headers_are_not_believed(path, content, sentence):
    """A file that is no table is refused in one sentence, quickly, whatever its header claims."""
    path.write_bytes(content)
    assert sentence in refusal(path, DamagedLogError)
    refused("info", path)


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
@pytest.mark.parametrize("shape", [b"(3,)", b"(3L,)"])
def test_headers_of_every_version_are_read(path, version, shape):
    """Python 2 wrote sizes as 3L, of which NumPy warns."""
    head = repr(header(DESCR, "shape")).encode().replace(b"'shape'}", shape + b"}")
    path.write_bytes(npy(head, records().tobytes(), version))
    with warnings.catch_warnings(action="error"):
        assert table_rates(path).t_ns == T_NS.tolist()


@pytest.mark.parametrize("save", [np.save, np.savez, np.savez_compressed])
def test_an_array_without_rows_is_read(path, save):
    """As a recorder leaves it that was stopped at once."""
    assert table_rates(saved(path, save, records()[:0])).t_ns == []


def test_an_array_that_is_cut_is_refused(path):
    """Its header says how long it is."""
    path.write_bytes(npy(header(DESCR, (3,)), records().tobytes()[:-1]))
    reason = "it has 95 of the 96 bytes that its array claims; was it copied whole?"
    assert refusal(path, DamagedLogError) == reason


@pytest.mark.parametrize("count", [5, 200_000])
@pytest.mark.parametrize("order", "CF")
def test_an_archive_with_a_wrong_checksum_is_refused(path, count, order):
    """Numbers that are not what was written are not used, wherever in an array they are."""
    values = np.asarray(np.random.default_rng(1).normal(size=(count, 6)), order=order)
    saved(path, np.savez, t_ns=np.arange(count), w=values)
    data = path.read_bytes()
    begin = data.index(values.tobytes(order))
    sentence = "its array 'w' is damaged (Bad CRC-32 for file 'w.npy'); save it again"
    for place in (begin + 3, begin + values.nbytes // 2 + 3, begin + values.nbytes - 5):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        columns = {"rate_cols": ["w[0]", "w[1]", "w[2]"], "time_col": "t_ns"}
        assert refusal(path, DamagedLogError, **columns, **RAD) == sentence


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_array_that_is_shorter_than_its_header_says_is_refused(path, save):
    """The archive is whole, and so is its checksum."""
    saved(path, save, rows=records())
    with zipfile.ZipFile(path) as archive:
        content = archive.read("rows.npy")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("rows.npy", content[:-1])
    reason = "its array 'rows' is damaged (it ends before its last row); save it again"
    assert refusal(path, DamagedLogError) == reason


def test_columns_of_different_lengths_are_no_table(path):
    """They are refused before anything is read."""
    ones = np.ones(4)
    saved(path, np.savez, t_ns=np.arange(5), wx=ones, wy=ones, wz=ones)
    assert "have '4', '5' rows, so they are not one table" in refusal(path)


def test_bytes_behind_an_archive_are_told(path):
    """Of two archives in one file, zipfile opens the last one that has its end record."""
    saved(path, np.savez, records())
    size = path.stat().st_size
    path.write_bytes((2 * path.read_bytes())[:-22] + bytes(22))
    (loss,) = table_rates(path).losses
    reason = f"{size} bytes follow the archive and are not read; was another joined to it?"
    assert loss[:2] == (f"byte {size}", reason)


def test_an_archive_of_something_else_is_refused(path):
    """Any zip file begins like an archive of arrays; one without files was one "of ;"."""
    zipfile.ZipFile(path, "w").close()
    assert refusal(path) == "it is a ZIP archive of nothing; was it written to the end?"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "nothing")
    assert "it is a ZIP archive of 'readme.txt'; unpack" in refusal(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("xl/workbook.xml", "")
    assert "a workbook of a spreadsheet; save its table as" in refusal(path)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(DamagedLogError, match=r"its directory is damaged .* was it written to"):
        table_rates(path)


def test_an_archive_of_thousands_of_arrays_is_refused(path):
    """Each may have thousands of columns, whatever the size of the file is."""
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(4097):
            archive.writestr(f"{number}.npy", b"")
    assert refusal(path) == "it has 4097 arrays; save the arrays of one recording"


def test_memory_does_not_grow_with_the_file(path):
    """Blocks are small however wide the rows are."""
    wide = np.zeros(40, [*RECORDS, ("frame", "S1000000")])
    with open_log(saved(path, np.save, wide)) as log:
        sizes = [len(batch) for batch in choose_rates(log, RateSelection()).batches()]
    assert sum(sizes) == 40
    assert max(sizes) * wide.itemsize <= 1 << 24


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_archive_without_its_directory_is_refused(path, save):
    """It stands at the end; the arrays before it may not be all."""
    saved(path, save, records())
    data = path.read_bytes()
    sentence = "its directory is damaged (File is not a zip file); was it written to the end?"
    for size in (len(data) - 1, data.rindex(b"PK\1\2"), 99):
        path.write_bytes(data[:size])
        assert refusal(path, DamagedLogError) == sentence


@pytest.mark.parametrize("form", ["npy", "npz", "npz f", "v5", "v7.3", "h5", "h5 chunks"])
def test_a_matrix_whose_rows_are_signals_is_read_along_them(tmp_path, form):
    """Of 3 by 2,000 numbers three samples were read, without a remark."""
    rate, seconds = np.random.default_rng(5).normal(size=(2000, 3)), np.arange(2000) / 100
    kind = {"v5": "mat", "v7.3": "mat"}.get(form, form.split()[0])
    path = tmp_path / f"log.{kind}"
    variables = {"gyr": rate.T, "t": seconds[None]}
    if form == "npy":
        np.save(path, np.vstack([variables["t"], variables["gyr"]]))
    elif kind == "npz":
        order = np.asfortranarray if form.endswith("f") else np.ascontiguousarray
        np.savez(path, **{name: order(values) for name, values in variables.items()})
    elif form == "v5":
        savemat(path, variables)
    else:
        of_matlab = form == "v7.3"
        with h5py.File(path, "w", userblock_size=512 if of_matlab else 0) as file:
            for name, values in variables.items():
                chunks = (1, 300) if form.endswith("chunks") else None
                file.create_dataset(name, data=values.T if of_matlab else values, chunks=chunks)
                if of_matlab:
                    file[name].attrs["MATLAB_class"] = np.bytes_("double")
        if of_matlab:
            with path.open("r+b") as bare:
                bare.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    columns = {"rate_cols": ("1", "2", "3"), "time_col": "0"} if form == "npy" else {}
    found = table_rates(path, rate_unit="rad/s", time_unit="s", **columns)
    assert found.rate.tolist() == rate.tolist()
    assert found.t_ns == np.round(seconds * 1e9).tolist()
    assert not found.losses
