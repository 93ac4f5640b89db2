"""What HDF5 stores elsewhere, packed, in part or not at all; its attributes of every form."""

import zlib
from functools import partial
from itertools import product

import numpy as np
import pytest
from make.table_rates import refusal, table_rates

from quatprop import read_rates
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


@pytest.mark.parametrize(("chunks", "is_of_matlab"), CHUNKS, ids=str)
@pytest.mark.parametrize("share", [0, 0.3, 0.95, 1])
def test_chunks_that_were_never_written_are_lost(path, chunks, is_of_matlab, share):
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
    t_ns, rate, losses, _ = read(path)
    assert t_ns == STAMPS[rows].tolist()
    assert rate.tolist() == RATES[rows].tolist()
    told = np.ones(COUNT, np.bool_)
    for place, reason, count in losses:
        first, last = map(int, place.removeprefix("rows ").split(" to "))
        assert (reason, count) == ("they were never written", last - first + 1)
        told[first - 1 : last] = False
    assert told.tolist() == rows.tolist()


def test_a_dataset_that_was_never_written_is_lost(path):
    """Its place in the file is only made when the first number is."""
    with written(path) as file:
        file.create_dataset("gyr", (COUNT, 3), "f8")
    assert read(path).losses == [("rows 1 to 60", "they were never written", COUNT)]


@pytest.mark.parametrize("version", ["earliest", "latest"])
@pytest.mark.parametrize("is_checked", [True, False])
def test_a_damaged_chunk_is_lost_alone(path, version, is_checked):
    """All that followed it was lost, too; other columns beside have chunks of other lengths."""
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
    t_ns, rate, losses, _ = read(path)
    kept = [*range(10), *range(30, 50)]
    assert t_ns == STAMPS[kept].tolist()
    assert rate.tolist() == RATES[kept].tolist()
    assert [(loss.place, loss.messages) for loss in losses] == [
        ("rows 11 to 30", 20),
        ("rows 51 to 60", 10),
    ]


@pytest.mark.parametrize("number", range(6))
def test_a_chunk_whose_place_is_lost_is_lost_alone(path, number):
    """Where the index of chunks says another row for it, zeros were read."""
    with written(path) as file:
        file.create_dataset("gyr", data=RATES, chunks=(10, 3))
    good = path.read_bytes()
    tree = next(k for k in range(0, len(good), 8) if good[k : k + 6] == b"TREE\1\0")
    row = tree + 24 + 40 * number + 8
    kept = [k for k in range(COUNT) if k // 10 != number]
    for place in range(0, 120, 10):
        path.write_bytes(good[:row] + place.to_bytes(8, "little") + good[row + 8 :])
        if place == 10 * number:
            continue
        t_ns, rate, losses, _ = read(path)
        assert set(t_ns) <= set(STAMPS[kept])
        assert not (rate == 0).any()
        assert COUNT - len(t_ns) == sum(loss.messages for loss in losses)


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
    """What it leads to may be what the user looks for."""
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
        "its dataset 'gyr': the chunks of a row have 1610612736 bytes, over the limit 1073741824"
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


@pytest.mark.parametrize(("version", "options"), FORMS, ids=str)
@pytest.mark.parametrize("form", TEXTS)
def test_texts_of_every_form_are_read(path, version, options, form):
    """Units that h5py writes by itself are of variable length, and were not seen."""
    with written(path, libver=version, **options) as file:
        file["gyr"] = RATES * 180 / np.pi
        # What follows does not fit into the header of the dataset, which goes on behind this one.
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
    """HDF5 does, so it is not asked for it."""
    with written(path) as file:
        file["gyr"] = RATES
        file["gyr"].attrs["unit"] = "deg/s"
    good = path.read_bytes()
    begin = good.find(b"GCOL")
    count = 0
    for byte, fill in product(range(begin, begin + 32), (0, 255)):
        data = bytearray(good)
        data[byte] = fill
        path.write_bytes(data)
        with Hdf5Log(path) as log:
            name = log.names[0]
        assert name in {"gyr[0]", "gyr[0] [deg/s]"}
        if name == "gyr[0]":
            assert "its attribute 'unit' cannot be read" in refused(path)
            count += 1
    assert count > 5
    with h5py.File(path, "w", libver="latest") as file:
        file["gyr"] = RATES
        for k in range(30):
            file["gyr"].attrs[f"note {k}"] = k
        file["gyr"].attrs["units"] = "deg/s"
    assert refused(path) == (
        "its dataset 'gyr': its attribute 'units' cannot be read; save it as numpy.bytes_"
    )


def test_an_attribute_of_no_known_type_is_damage(path):
    """What it says of the rows, such as which are none, would be unknown."""
    with written(path) as file:
        gyr = file.create_dataset("gyr", data=RATES).id
        one = h5py.h5s.create(h5py.h5s.SCALAR)
        h5py.h5a.create(gyr, b"_FillValue", h5py.h5t.UNIX_D32LE, one)
    ((place, reason, count),) = read(path).losses
    assert (place, count) == ("the end of its array", COUNT)
    assert reason.startswith("it is damaged: ")


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
def test_a_chunk_that_decompresses_to_more_than_it_may_is_lost_alone(path, is_checked, is_sound):
    """HDF5 takes memory for whatever a deflate stream holds: 5 MB of it held 1.1 GB."""
    # Large enough to be looked into.
    data = zlib.compress(bytes(1 << 21), 0) if is_sound else bytes(1 << 21)
    how = {"chunks": (10, 3), "compression": "gzip", "fletcher32": is_checked}
    with written(path) as file:
        gyr = file.create_dataset("gyr", data=RATES, **how)
        gyr.id.write_direct_chunk((10, 0), data)
    t_ns, rate, losses, _ = read(path)
    kept = [*range(10), *range(20, COUNT)]
    assert t_ns == STAMPS[kept].tolist()
    assert rate.tolist() == RATES[kept].tolist()
    ((place, reason, count),) = losses
    assert (place, count) == ("rows 11 to 20", 10)
    assert reason.startswith("a chunk of them decompresses to more than 240 bytes" if is_sound
                             else "they are damaged: ")  # fmt: skip
