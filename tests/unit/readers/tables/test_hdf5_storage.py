"""HDF5 data stored elsewhere, packed, in part or not at all; attributes of every form."""

import zlib
from functools import partial
from itertools import product

import numpy as np
import pytest
from make.table_rates import refusal, table_rates

from quatprop import read_rates
from quatprop.base.errors import DamagedLogError
from quatprop.readers.tables.hdf5 import Hdf5Log

h5py = pytest.importorskip("h5py")

COUNT = 60
RATES = np.random.default_rng(4).normal(size=(COUNT, 3))
STAMPS = np.arange(COUNT) * 1_000_000
read = partial(table_rates, rate_unit="rad/s", time_unit="ns")
refused = partial(refusal, rate_unit="rad/s", time_unit="ns")


@pytest.fixture
def path(tmp_path):
    """Where a test writes its file."""
    return tmp_path / "log.h5"


def written(path, **options):
    """Open a file for writing, with times in it."""
    file = h5py.File(path, "w", **options)
    file["t"] = STAMPS
    return file


CHUNKS = [((10, 3), False), ((7, 2), False), ((1, 1), False), ((2, 9), True), ((3, 60), True)]


@pytest.mark.thorough
@pytest.mark.parametrize(("chunks", "is_of_matlab"), CHUNKS, ids=str)
@pytest.mark.parametrize("share", [0, 0.3, 0.95, 1])
def test_chunks_that_were_never_written_are_refused(path, chunks, is_of_matlab, share):
    """They were read as rates of 0: 144.1 deg instead of 107.9, exit code 0."""
    random = np.random.default_rng(round(100 * share))
    values = RATES.T if is_of_matlab else RATES
    whole = np.ones(values.shape, np.bool_)
    with written(path) as file:
        gyr = file.create_dataset("gyr", values.shape, "f8", chunks=chunks)
        if is_of_matlab:
            gyr.attrs["MATLAB_class"] = np.bytes_("double")
            file["t"].attrs["MATLAB_class"] = np.bytes_("double")
        begins = product(*(range(0, n, k) for n, k in zip(values.shape, chunks, strict=True)))
        for place in begins:
            part = tuple(slice(b, b + k) for b, k in zip(place, chunks, strict=True))
            if random.random() < share:
                gyr[part] = values[part]
            else:
                whole[part] = False
    rows = whole.all(axis=0 if is_of_matlab else 1)
    if rows.all():
        assert read(path).rate.tolist() == RATES.tolist()
        return
    unit = chunks[is_of_matlab] if share else COUNT
    first = int(np.flatnonzero(~rows)[0]) // unit * unit
    assert refused(path, DamagedLogError) == (
        f"its dataset 'gyr': rows {first + 1} to {min(first + unit, COUNT)} cannot be read (they "
        "were never written); copy the others to a new file, with h5py"
    )


@pytest.mark.thorough
@pytest.mark.parametrize("fill", [None, 5.0, np.nan])
@pytest.mark.parametrize("time", ["ALLOC", "IFSET", "NEVER"])
@pytest.mark.parametrize("kind", ["f8", ">f4", "3f8"])
def test_what_unwritten_rows_are_filled_with_does_not_matter(path, fill, time, kind):
    """Numbers of a fill value, or zeros where the file says that none is to be used."""
    kind = np.dtype(kind)
    how = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    how.set_fill_time(getattr(h5py.h5d, f"FILL_TIME_{time}"))
    shape = (COUNT,) if kind.subdtype else (COUNT, 3)
    how.set_chunk((10, 3)[: len(shape)])
    if fill is not None and not kind.subdtype:
        how.set_fill_value(np.array(fill, kind))
    with written(path) as file:
        space = h5py.h5s.create_simple(shape)
        h5py.h5d.create(file.id, b"gyr", h5py.h5t.py_create(kind, logical=True), space, how)
        file["gyr"][:20], file["gyr"][30:] = RATES[:20], RATES[30:]
    assert "rows 21 to 30 cannot be read (they were never written)" in refused(
        path, DamagedLogError
    )
    with h5py.File(path, "a") as file:
        file["gyr"][20:30] = RATES[20:30]
    assert read(path).rate.tolist() == RATES.astype(kind.base).tolist()


def test_rows_that_hold_the_fill_value_are_read(path):
    """A gyroscope at rest gives zeros, which were written."""
    with written(path) as file:
        file.create_dataset("gyr", data=np.zeros((COUNT, 3)), chunks=(7, 2))
    assert read(path).rate.tolist() == np.zeros((COUNT, 3)).tolist()


def test_a_dataset_that_was_never_written_is_refused(path):
    """Its place in the file is only made when the first number is."""
    with written(path) as file:
        file.create_dataset("gyr", (COUNT, 3), "f8")
    assert refused(path) == "its dataset 'gyr': it was never written; was the recording closed?"


@pytest.mark.parametrize("version", ["earliest", "latest"])
@pytest.mark.parametrize("is_checked", [True, False])
def test_rows_of_a_damaged_chunk_are_named_and_the_others_can_be_copied(path, version, is_checked):
    """Columns next to it have chunks of other lengths."""
    how = {"fletcher32": True} if is_checked else {"compression": "gzip"}
    with written(path, libver=version) as file:
        del file["t"]
        file.create_dataset("t", data=STAMPS, chunks=(7,))
        chunks = file.create_dataset("gyr", data=RATES, chunks=(10, 3), **how).id
        places = [chunks.get_chunk_info(k).byte_offset for k in (1, 2, 5)]
    data = bytearray(path.read_bytes())
    for place in places:
        data[place + 30] ^= 1
    path.write_bytes(data)
    sentence = refused(path, DamagedLogError)
    assert sentence.startswith("its dataset 'gyr': rows 11 to 20 cannot be read (")
    assert sentence.endswith("); copy the others to a new file, with h5py")
    other = path.with_name("other.h5")
    with h5py.File(path) as file, h5py.File(other, "w") as copy:
        for name in ("t", "gyr"):
            copy[name] = np.concatenate([file[name][:10], file[name][30:50]])
    kept = [*range(10), *range(30, 50)]
    t_ns, rate, losses, _ = read(other)
    assert (t_ns, rate.tolist(), losses) == (STAMPS[kept].tolist(), RATES[kept].tolist(), [])


@pytest.mark.parametrize("number", range(6))
def test_a_chunk_whose_place_is_damaged_is_not_read_as_zeros(path, number):
    """Where the index of chunks says another row for it, zeros were read."""
    with written(path) as file:
        file.create_dataset("gyr", data=RATES, chunks=(10, 3))
    good = path.read_bytes()
    tree = next(k for k in range(0, len(good), 8) if good[k : k + 6] == b"TREE\1\0")
    row = tree + 24 + 40 * number + 8
    for place in range(0, 120, 10):
        path.write_bytes(good[:row] + place.to_bytes(8, "little") + good[row + 8 :])
        if place != 10 * number:
            assert "cannot be read (they were never written)" in refused(path, DamagedLogError)


@pytest.mark.parametrize("size", [0, 239, 241, 1 << 20, (1 << 32) - 1])
def test_a_chunk_that_states_another_size_is_refused(path, size):
    """HDF5 writes it beyond its memory, and the process crashed."""
    with written(path) as file:
        file.create_dataset("gyr", data=np.zeros((COUNT, 3)), chunks=(10, 3))
    good = path.read_bytes()
    tree = next(k for k in range(0, len(good), 8) if good[k : k + 6] == b"TREE\1\0")
    path.write_bytes(good[: tree + 24] + size.to_bytes(4, "little") + good[tree + 28 :])
    assert refused(path, DamagedLogError) == (
        "its dataset 'gyr': rows 1 to 10 cannot be read (their chunk has other than 240 bytes); "
        "copy the others to a new file, with h5py"
    )


def elsewhere(file, name):
    """Make rates in a file refer to another one, in some way."""
    if name == "external":
        file.create_dataset("gyr", (COUNT, 3), "f8", external="other.bin")
    elif name == "link":
        file["gyr"] = h5py.ExternalLink("other.h5", "gyr")
    else:
        longest = (None, 3) if name == "unlimited" else (COUNT, 3)
        source = h5py.VirtualSource("other.h5", "gyr", (COUNT, 3), "f8", maxshape=longest)
        layout = h5py.VirtualLayout((COUNT, 3), "f8", maxshape=longest)
        rows = slice(0, h5py.h5s.UNLIMITED if name == "unlimited" else COUNT // 2)
        layout[rows] = source[rows]
        file.create_virtual_dataset("gyr", layout)


@pytest.mark.parametrize("name", ["virtual", "unlimited", "external"])
@pytest.mark.parametrize("is_there", [True, False])
def test_nothing_outside_the_file_is_read(path, name, is_there):
    """A missing source became zeros, and a file with a password became rates."""
    with written(path, libver="latest") as file:
        elsewhere(file, name)
    other = path.with_name("other.bin" if name == "external" else "other.h5")
    if is_there and name == "external":
        other.write_bytes(RATES.tobytes())
    elif is_there:
        with h5py.File(other, "w") as file:
            file.create_dataset("gyr", data=RATES, maxshape=(None, 3))
    assert refused(path) == (
        f"its dataset 'gyr': it refers to data elsewhere, '{other.name}', which is not opened; "
        "save its values here"
    )
    with h5py.File(path, "a") as file:
        del file["t"]
    assert refused(path).startswith("its dataset 'gyr': it refers to data elsewhere, ")


def test_a_link_to_another_file_is_remarked_on(path):
    """Its target may be the data that the user wants."""
    with written(path) as file:
        elsewhere(file, "link")
        file["more"] = h5py.ExternalLink("more.h5", "/gyr")
        file["soft"] = h5py.SoftLink("/gyr")
        file["g"] = RATES
    with Hdf5Log(path) as log:
        assert log.names == ["g[0]", "g[1]", "g[2]", "t"]
        assert list(log.remarks) == [
            f"its link '{name}' leads to another file, '{other}.h5', which is not opened"
            for name, other in (("gyr", "other"), ("more", "more"))
        ]
    with h5py.File(path, "a") as file:
        del file["t"], file["g"]
    assert refused(path) == (
        "its link 'gyr' leads to another file, 'other.h5', which is not opened; name that file"
    )


def test_a_filter_that_is_not_there_is_named(path):
    """Where the library lacks it, every row seemed to be damaged."""
    with written(path) as file:
        file.create_dataset(
            "gyr", (COUNT, 3), "f8", chunks=(COUNT, 3), compression=32123, allow_unknown_filter=True
        )
    assert refused(path) == (
        "its dataset 'gyr': it is compressed with filter 32123 (), which HDF5 does not have here; "
        "set HDF5_PLUGIN_PATH to the folder of its plugin"
    )


def test_sizes_are_limited_as_those_of_other_logs(path, monkeypatch):
    """One chunk of 1.6 GB, of a file of 1.6 MB, took 1.7 GB."""
    with written(path) as file:
        file.create_dataset("gyr", (COUNT, 3), "f8", maxshape=(None, 3), chunks=(1 << 26, 3))
    assert refused(path) == (
        "its dataset 'gyr': its chunks have 1610612736 bytes, over the limit 1073741824; save it "
        "in smaller ones"
    )
    with written(path) as file:
        file.create_dataset("gyr", data=RATES, chunks=(10, 3), compression="gzip")
        gyr = file["gyr"].id.get_create_plist()
        gyr.set_deflate(9)
        space = h5py.h5s.create_simple((COUNT, 3))
        h5py.h5d.create(file.id, b"twice", h5py.h5t.NATIVE_DOUBLE, space, gyr)
    assert len(read(path, rate_cols=["gyr[0]", "gyr[1]", "gyr[2]"])[0]) == COUNT
    assert refused(path, rate_cols=["twice[0]", "twice[1]", "twice[2]"]) == (
        "its dataset 'twice': it is compressed several times; save it compressed once"
    )
    monkeypatch.setenv("QUATPROP_MAX_UNPACKED", "1K")
    assert refused(path, rate_cols=["gyr[0]", "gyr[1]", "gyr[2]"]) == (
        "its dataset 'gyr': it decompresses to more than 1024 bytes; if that is right, set "
        "QUATPROP_MAX_UNPACKED to more"
    )


FORMS = [("earliest", {}), ("latest", {}), ("earliest", {"userblock_size": 512})]
FORMS += [("earliest", {"track_order": True})]
TEXTS = {"fixed": np.bytes_, "variable": str, "list": lambda text: [text]}


@pytest.mark.thorough
@pytest.mark.parametrize(("version", "options"), FORMS, ids=str)
@pytest.mark.parametrize("form", TEXTS)
def test_texts_of_every_form_are_read(path, version, options, form):
    """Units that h5py writes by itself are of variable length, and were not seen."""
    with written(path, libver=version, **options) as file:
        file["gyr"] = RATES * 180 / np.pi
        # The next attribute does not fit into the header of the dataset, which continues elsewhere.
        named = file.create_dataset("named", data=RATES)
        file["gyr"].attrs["comment"] = np.bytes_("as it was measured, " * 20)
        file["gyr"].attrs["Units"], file["gyr"].attrs["units"] = "", file["t"].ref
        file["gyr"].attrs["unit"] = TEXTS[form]("deg/s")
        file["t"].attrs["units"] = TEXTS[form]("ns")
        named.attrs["columns"] = ["x", "y", "z"]
    assert np.allclose(read_rates(path, rate_cols=[f"gyr[{k}]" for k in range(3)]).rate, RATES)
    with Hdf5Log(path) as log:
        assert log.names[-4:-1] == ["named.x", "named.y", "named.z"]


def test_a_damaged_text_neither_hangs_nor_crashes(path):
    """HDF5 does, so it is not given a heap of texts that is damaged."""
    with written(path) as file:
        file["gyr"] = RATES
        file["gyr"].attrs["unit"] = "deg/s"
    good = path.read_bytes()
    begin = good.find(b"GCOL")
    told = set()
    for byte, fill in product(range(begin, begin + 32), (0, 1, 128, 255)):
        data = bytearray(good)
        data[byte] = fill
        path.write_bytes(data)
        with Hdf5Log(path) as log:
            name = log.names[0]
        assert name in {"gyr[0]", "gyr[0] [deg/s]"}
        if name == "gyr[0]":
            told.add(refused(path))
    sentence = "its dataset 'gyr': its attribute 'unit' cannot be read ("
    assert {one[: len(sentence)] for one in told} == {sentence}
    assert f"{sentence}its texts are damaged); save it again" in told


def test_a_text_among_many_attributes_is_read(path):
    """They are not in the header of the dataset."""
    with written(path, libver="latest") as file:
        file["gyr"] = RATES * 180 / np.pi
        for k in range(30):
            file["gyr"].attrs[f"note {k}"] = k
        file["gyr"].attrs["units"] = "deg/s"
    with Hdf5Log(path) as log:
        assert log.names[0] == "gyr[0] [deg/s]"


def test_an_attribute_of_no_known_type_is_refused(path):
    """Its statements on rows, such as which are invalid, would be unknown."""
    with written(path) as file:
        gyr = file.create_dataset("gyr", data=RATES).id
        one = h5py.h5s.create(h5py.h5s.SCALAR)
        h5py.h5a.create(gyr, b"_FillValue", h5py.h5t.UNIX_D32LE, one)
    assert refused(path).startswith("its dataset 'gyr': No NumPy equivalent for TypeTimeID")


def test_packed_numbers_are_refused(path):
    """Netcdf has them: the rate was 16384 rad/s instead of 1."""
    with written(path) as file:
        file["gyr"] = np.round(RATES * 1000).astype(np.int16)
        file["gyr"].attrs["scale_factor"], file["gyr"].attrs["add_offset"] = 1.0, np.float32(0)
    assert len(read(path)[0]) == COUNT
    with h5py.File(path, "a") as file:
        file["gyr"].attrs["add_offset"] = 2.0
    assert refused(path) == (
        "its dataset 'gyr': its numbers are packed, with 'add_offset'; save them unpacked"
    )
    with h5py.File(path, "a") as file:
        file["gyr"].attrs["scale_factor"] = "a quarter"
    assert refused(path, rate_cols=["0", "1", "2"]) == (
        "its dataset 'gyr': its numbers are packed, with 'scale_factor'; save them unpacked"
    )


FACTORS = ["scale", "gain", "conversion_factor", "conversion", "sensitivity", "lsb"]


@pytest.mark.parametrize("name", FACTORS)
def test_integers_with_a_factor_of_no_convention_are_refused(path, name):
    """They were taken for rates as they are; NWB has conversion, others divide by sensitivity."""
    counts = np.round(RATES * 1000)
    with written(path) as file:
        file["gyr"] = counts.astype(np.int16)
        file["gyr"].attrs[name] = 1
    assert len(read(path)[0]) == COUNT
    with h5py.File(path, "a") as file:
        file["gyr"].attrs[name] = 0.001
    assert refused(path) == (
        f"its dataset 'gyr': its numbers are integers with the attribute '{name}', and no "
        "convention says how it is applied; save them as floats in their unit, or without the "
        "attribute if they are in it already"
    )
    with h5py.File(path, "a") as file:
        del file["gyr"]
        file["gyr"] = counts * 0.001
        file["gyr"].attrs[name] = 0.001
    assert len(read(path)[0]) == COUNT


@pytest.mark.parametrize(
    ("name", "value"),
    [("resolution", -1.0), ("resolution", 0.5), ("resolution", 16), ("conversion", 1.0),
     ("gain", "high"), ("scale", b"linear"), ("scale_factor", [1, 1, 1]), ("gain", [1.0, 1.0, 1.0]),
     ("add_offset", [0.0, 0.0, 0.0])],
)  # fmt: skip
def test_integers_with_an_attribute_that_is_no_factor_are_read(path, name, value):
    """They were refused: NWB has its resolution, and -1 for an unknown one, in all files."""
    with written(path) as file:
        file["gyr"] = np.round(RATES * 1000).astype(np.int16)
        file["gyr"].attrs[name] = value
    np.testing.assert_array_equal(read(path).rate, np.round(RATES * 1000))


def test_numbers_that_stand_for_no_value_are_none(path):
    """Netcdf names them: they were rates, and times."""
    stored = np.round(RATES * 1000).astype(np.int16)
    with written(path) as file:
        file["gyr"] = stored
        file["gyr"].attrs["_FillValue"] = stored[7, 1]
    rate = read(path).rate
    expected = stored.astype(np.float64)
    expected[stored == stored[7, 1]] = np.nan
    np.testing.assert_array_equal(rate, expected)
    with h5py.File(path, "a") as file:
        file["t"].attrs["missing_value"] = STAMPS[5]
    t_ns, _, (loss,), _ = read(path)
    assert t_ns == [t for t in STAMPS if t != STAMPS[5]]
    assert loss == ("rows 1 to 60", "rows without a time", 1)


def test_a_fill_value_of_records_loses_no_rows(path):
    """Netcdf has one for each compound type: every row was lost, as damaged."""
    records = np.rec.fromarrays([STAMPS, *RATES.T], names="t,wx,wy,wz").view(np.ndarray)
    with h5py.File(path, "w") as file:
        file["imu"] = records
        file["imu"].attrs["_FillValue"] = records[0]
    rate_cols = [f"imu.{name}" for name in ("wx", "wy", "wz")]
    t_ns, rate, losses, _ = read(path, rate_cols=rate_cols, time_col="imu.t")
    assert (t_ns, rate.tolist(), list(losses)) == (STAMPS.tolist(), RATES.tolist(), [])


@pytest.mark.parametrize("is_checked", [False, True])
@pytest.mark.parametrize("is_sound", [False, True])
def test_a_chunk_that_decompresses_to_more_than_it_may_is_refused(path, is_checked, is_sound):
    """HDF5 takes memory for whatever a deflate stream holds: 5 MB of it held 1.1 GB."""
    # Large enough to be looked into.
    data = zlib.compress(bytes(1 << 21), 0) if is_sound else bytes(1 << 21)
    how = {"chunks": (10, 3), "compression": "gzip", "fletcher32": is_checked}
    with written(path) as file:
        gyr = file.create_dataset("gyr", data=RATES, **how)
        try:
            gyr.id.write_direct_chunk((10, 0), data)
        except OSError:
            pytest.skip("HDF5 before 2.0 writes no chunk that is so much larger than its rows")
    sentence = refused(path, DamagedLogError)
    reason = (
        "their chunk has other than 240 bytes)" if is_sound else "Can't synchronously read data ("
    )
    assert f"rows 11 to 20 cannot be read ({reason}" in sentence
