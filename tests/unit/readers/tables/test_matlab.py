"""Files of MATLAB before version 7.3: variables, structs, damage, sizes."""

import io
import struct
import sys
import zlib
from functools import reduce

import numpy as np
import pytest
from make.commands import refused
from make.table_rates import refusal, table_rates
from scipy.io import savemat
from scipy.sparse import csc_matrix

from quatprop.base.errors import DamagedLogError, LogError, UsageError
from quatprop.readers.tables.matlab import MatlabLog

COUNT = 200
RATES = np.random.default_rng(6).normal(size=(COUNT, 3))
SECONDS = np.arange(COUNT) / 100
UNITS = {"rate_unit": "rad/s", "time_unit": "s"}
FORMS = [{"format": "5"}, {"format": "5", "do_compression": True}, {"format": "4"}]


@pytest.fixture
def path(tmp_path):
    """Where a test writes its file."""
    return tmp_path / "log.mat"


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("oned_as", ["row", "column"])
def test_variables_are_columns(path, form, oned_as):
    """Four of 98 published recordings are such files."""
    note = {} if form["format"] == "4" else {"note": np.array(["a", 1], object)}
    variables = {"gyr": RATES, "t": SECONDS, "acc": np.ones((COUNT, 3)), "fs": 100.0, **note}
    savemat(path, variables, oned_as=oned_as, **form)
    found = table_rates(path, **UNITS)
    assert found.rate.tolist() == RATES.tolist()
    assert found.t_ns == np.round(SECONDS * 1e9).tolist()
    with MatlabLog(path) as log:
        names = [f"{name}[{k}]" for name in ("acc", "gyr") for k in range(3)]
        assert sorted(log.names) == [*names, "t"]


def test_fields_of_structs_are_columns(path):
    """With the path that MATLAB itself has for them."""
    stamps = np.arange(COUNT, dtype=np.int64) * 10_000_000
    sensor = {"gyr": RATES.astype("f4"), "t_ns": stamps[:, None], "name": "imu"}
    deep = reduce(lambda inner, _: {"a": inner}, range(8), SECONDS)
    log = {"imu": sensor, "list": [{"a": 1}, {"a": 2}]}
    savemat(path, {"log": log, "x": deep, "too_deep": {"a": deep}})
    found = table_rates(path, rate_unit="rad/s")
    assert (found.rate.tolist(), found.t_ns) == (RATES.astype("f4").tolist(), stamps.tolist())
    with MatlabLog(path) as log:
        names = [*(f"log.imu.gyr[{k}]" for k in range(3)), "log.imu.t_ns", "x" + 8 * ".a"]
        assert sorted(log.names) == names


@pytest.mark.parametrize("form", FORMS[:2], ids=str)
def test_a_damaged_variable_is_lost_alone(path, form):
    """The variables before and behind it are read, wherever the damage is."""
    savemat(path, {"gyr": RATES, "t": SECONDS}, **form)
    begin = path.stat().st_size
    savemat(path, {"gyr": RATES, "t": SECONDS, "extra": RATES}, **form)
    good = path.read_bytes()
    for byte in range(begin + 8, begin + 400, 30):
        data = bytearray(good)
        data[byte] ^= 0x55
        path.write_bytes(data)
        with MatlabLog(path) as log:
            assert {"gyr[0]", "t"} <= set(log.names)
            told = [(loss.place, loss.reason.split(": ")[0]) for loss in log.losses]
        assert told in ([], [(f"byte {begin}", "a variable is damaged")])
        if "do_compression" in form:
            assert told
    for size in (begin, begin + 3, begin + 8, len(good) - 1):
        path.write_bytes(good[:size])
        found = table_rates(path, **UNITS)
        assert found.rate.tolist() == RATES.tolist()
        reasons = [loss.reason for loss in found.losses]
        assert reasons == ["the file ends within a variable"] * (size > begin)


def test_matrices_in_matrices_without_end_are_a_damaged_variable(path):
    """They ended the run with an error of the package itself."""
    savemat(path, {"t": SECONDS})
    nested = b"".join(struct.pack("<II", 14, 8 * k) for k in reversed(range(5000)))
    path.write_bytes(path.read_bytes()[:128] + nested)
    assert refusal(path, DamagedLogError).startswith("a variable is damaged: ")


def test_hostile_sizes_are_refused(path, monkeypatch):
    """Claimed sizes are not allocated, and decompression is limited as in other logs."""
    monkeypatch.setenv("QUATPROP_MAX_UNPACKED", "1M")
    file = io.BytesIO()
    savemat(file, {"gyr": RATES})
    good = file.getvalue()
    bomb = zlib.compress(bytes(1 << 22))
    path.write_bytes(good[:128] + struct.pack("<II", 15, len(bomb)) + bomb)
    assert refusal(path) == (
        "it decompresses to more than 1048576 bytes; if that is right, set QUATPROP_MAX_UNPACKED "
        "to more"
    )
    refused = 0
    for place in range(128, 200, 4):
        path.write_bytes(good[:place] + b"\xf0\xff\xff\x7f" + good[place + 4 :])
        try:
            MatlabLog(path).close()
        except LogError:
            refused += 1
    assert refused > 5
    path.write_bytes(good[:128])
    assert refusal(path, DamagedLogError) == "it has no variables; was it written to the end?"


def test_variables_that_are_no_tables_are_named(path):
    """Where there is nothing else."""
    savemat(path, {"log": np.array([1, "a"], object)})
    assert refusal(path) == ("its variable 'log': it is a cell array; save its numbers as vectors")
    savemat(path, {"log": [{"w": 1.0}, {"w": 2.0}]})
    assert refusal(path).startswith("its variable 'log': it is a")
    savemat(path, {"image": np.zeros((2, 2, 2))})
    assert refusal(path).startswith("its variable 'image': its array of shape (2, 2, 2) is")
    # These were said to be no variables.
    savemat(path, {"fs": 100.0, "empty": np.zeros((0, 3))})
    assert refusal(path) == "none of its variables has more than one value"
    savemat(path, {"w": csc_matrix(np.eye(3))})
    assert refusal(path) == "its variable 'w': it is sparse; save it as a full matrix"
    path.write_bytes(b"no file of MATLAB, \x00 whatever its name says")
    assert refusal(path, DamagedLogError).endswith("; was it written to the end?")


def part(kind, data):
    """Return an element of a file."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def test_objects_of_matlab_are_passed_over_and_named(path):
    """A table or a string was a damaged variable: 'NoneType' object is not iterable."""
    savemat(path, {"gyr": RATES, "t": SECONDS})
    good = path.read_bytes()
    begin, size = 128, struct.unpack_from("<I", good, 132)[0]
    texts = b"".join(part(1, text) for text in (b"imu", b"MCOS", b"table"))
    head = part(6, struct.pack("<II", 17, 0)) + texts
    table = part(14, head + good[begin : begin + 8 + size])
    path.write_bytes(good + table)
    found = table_rates(path, **UNITS)
    assert (found.rate.tolist(), found.losses) == (RATES.tolist(), [])
    path.write_bytes(good[:begin] + table)
    assert refusal(path) == (
        "its variable 'imu': it is an object, which only MATLAB reads; save a table by "
        "table2struct(t,'ToScalar',true)"
    )


def test_what_is_no_array_in_a_struct_is_passed_over_and_named(path):
    """A table there was an internal error, and a sparse matrix was columns without numbers."""
    savemat(path, {"log": {"t": SECONDS, "w": csc_matrix(RATES)}})
    with MatlabLog(path) as log:
        assert log.names == ["log.t"]
    savemat(path, {"log": {"w": csc_matrix(RATES)}})
    assert refusal(path) == "its variable 'log.w': it is sparse; save it as a full matrix"
    savemat(path, {"log": {"w": 1.5}})
    good = path.read_bytes()
    begin = good.rindex(struct.pack("<I", 14))  # of w, the last element
    texts = b"".join(part(1, text) for text in (b"", b"MCOS", b"table"))
    savemat(path, {"t": SECONDS})
    table = part(6, struct.pack("<II", 17, 0)) + texts + path.read_bytes()[128:]
    path.write_bytes(good[:128] + part(14, good[136:begin] + part(14, table)))
    assert refusal(path) == (
        "its variable 'log.w': it is an object, which only MATLAB reads; save a table by "
        "table2struct(t,'ToScalar',true)"
    )


def test_what_matlab_keeps_for_functions_is_no_column(path):
    """It is a vector of bytes without a name, behind the variables."""
    savemat(path, {"t": SECONDS})
    shape = part(6, struct.pack("<II", 9, 0)) + part(5, struct.pack("<ii", 1, COUNT))
    unnamed = part(14, shape + part(1, b"") + part(2, bytes(COUNT)))
    path.write_bytes(path.read_bytes() + unnamed)
    with MatlabLog(path) as log:
        assert (log.names, list(log.losses)) == (["t"], [])


def test_a_variable_beyond_the_memory_is_no_damage(path, monkeypatch):
    """Rather than a loss, after which the other variables are read."""

    def no_memory(_):
        raise MemoryError

    savemat(path, {"gyr": RATES})
    monkeypatch.setattr("scipy.io.loadmat", no_memory)
    assert refused("info", path).startswith(f"Error: {path}: there is not enough memory")


def test_without_scipy_the_way_out_is_named(path, monkeypatch):
    """A sentence, not an ImportError."""
    savemat(path, {"gyr": RATES})
    monkeypatch.setitem(sys.modules, "scipy.io", None)
    assert refusal(path, UsageError) == (
        "files of MATLAB before version 7.3 need scipy, which is not installed; pip install scipy, "
        "or save it again with '-v7.3'"
    )


def test_two_files_of_version_4_in_one_are_refused(path):
    """Such a file has no beginning, so the variables of the second replaced those of the first."""
    savemat(path, {"gyr": RATES, "t": SECONDS}, format="4")
    path.write_bytes(2 * path.read_bytes())
    assert refusal(path) == "several of its variables have one name; was another file joined to it?"


@pytest.mark.parametrize("header", [b"MATLAB 5.0", b"MATXAB 5.0"])
@pytest.mark.parametrize("kind", [0, 8, 20, 76, 169, 0xFFFF])
def test_data_of_an_unknown_type_are_a_damaged_variable(path, header, kind):
    """The library looks such a type up beyond its table: the process would end."""
    savemat(path, {"t": np.arange(200)})
    data = bytearray(path.read_bytes())
    data[: len(header)] = header
    struct.pack_into("<I", data, 128 + 8 + 16 + 16 + 8, kind)
    path.write_bytes(data)
    assert "a variable is damaged: the type of its data is unknown" in refusal(
        path, DamagedLogError
    )
