"""HDF5 files: datasets of columns, groups, names, units, damage, what is never believed."""

import sys

import numpy as np
import pytest
from make.table_rates import refusal, table_rates

from quatprop import propagate, read_attitudes, read_rates
from quatprop.base.errors import DamagedLogError, QuatpropError, UndeclaredError, UsageError
from quatprop.readers.tables.hdf5 import Hdf5Log

h5py = pytest.importorskip("h5py")

RATE_HZ, COUNT = 2000 / 7, 1000
SECONDS = np.arange(COUNT) / RATE_HZ
RATES = np.random.default_rng(4).normal(size=(COUNT, 3))
RAD = {"rate_unit": "rad/s"}


@pytest.fixture
def path(tmp_path):
    """Where a test writes its file."""
    return tmp_path / "log.h5"


def broad(path, **options):
    """Write a file as BROAD publishes them."""
    with h5py.File(path, "w") as file:
        file.attrs["sampling_rate"] = RATE_HZ
        file.create_dataset("imu_gyr", data=RATES, **options)
        file["imu_acc"] = np.tile([0.0, 0.0, 9.81], (COUNT, 1))
        file["movement"] = np.ones(COUNT, np.bool_)
    return path


@pytest.mark.parametrize(
    "options",
    [{}, {"chunks": (7, 2)}, {"compression": "gzip", "shuffle": True}, {"dtype": ">f8"}],
    ids=str,
)
def test_a_file_of_broad_is_read_to_the_bit(path, options):
    """Rates are those stored, however they are stored, and the file says at what rate."""
    rates = read_rates(broad(path, **options), **RAD)
    assert rates.rate.tobytes() == RATES.tobytes()
    assert np.abs(rates.t_ns * 1e-9 - SECONDS).max() < 1e-9
    np.save(path.with_suffix(".npy"), RATES)
    columns = {"rate_cols": ["0", "1", "2"], "sample_rate": RATE_HZ}
    again = propagate(path.with_suffix(".npy"), **columns, **RAD)
    assert propagate(path, **RAD).wxyz.tobytes() == again.wxyz.tobytes()


@pytest.mark.parametrize("layout", ["CONTIGUOUS", "CHUNKED", "COMPACT"])
def test_columns_after_others_are_read_to_the_bit(path, layout):
    """However a matrix is stored, of its columns only those from the first wanted on are read."""
    matrix = np.ascontiguousarray(np.hstack([np.cumsum(RATES, axis=0), RATES]))
    how = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    how.set_layout(getattr(h5py.h5d, layout))
    if layout == "CHUNKED":
        how.set_chunk((7, 2))
    with h5py.File(path, "w") as file:
        space = h5py.h5s.create_simple(matrix.shape)
        h5py.h5d.create(file.id, b"imu", h5py.h5t.IEEE_F64LE, space, how)
        file["imu"][:] = matrix
    columns = [f"imu[{k}]" for k in (3, 4, 5)]
    rates = read_rates(path, rate_cols=columns, sample_rate=RATE_HZ, **RAD)
    assert rates.rate.tobytes() == RATES.tobytes()


def test_a_trial_of_broad_needs_no_options(path):
    """Its rates and its optical attitudes were refused until options named and declared them."""
    wxyz = np.random.default_rng(5).normal(size=(COUNT, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    with h5py.File(broad(path), "a") as file:
        file["opt_quat"], file["opt_pos"] = wxyz, RATES
    assert read_rates(path).rate.tobytes() == RATES.tobytes()
    found = read_attitudes(path)
    assert found.wxyz.tobytes() == wxyz.tobytes()


def test_an_accelerometer_can_be_named(path):
    """A table whose columns have other names could not be levelled."""
    still = np.random.default_rng(6).normal(0, 1e-3, (COUNT, 3))
    with h5py.File(path, "w") as file:
        file.attrs["sampling_rate"] = RATE_HZ
        file["w"], file["f"] = still, np.tile([0.0, 9.81, 0.0], (COUNT, 1))
    named = {"rate_cols": ["w[0]", "w[1]", "w[2]"], **RAD, "q0": "level"}
    with pytest.raises(QuatpropError, match="it has no accelerations"):
        propagate(path, **named)
    found = propagate(path, **named, accel_cols="f[0],f[1],f[2]")
    np.testing.assert_allclose(found.as_matrix()[0] @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    with pytest.raises(UsageError, match=r"accel_cols asks for column 'f\[9\]'"):
        propagate(path, **named, accel_cols="f[0],f[1],f[9]")


def test_columns_are_named_by_groups_fields_and_attributes(path):
    """Datasets of one dimension, records, and an attribute with names are one table each."""
    with h5py.File(path, "w") as file:
        file["a1/t_ns"] = np.arange(3) * 10**9
        file["a1/raw/gyr"] = RATES[:3]
        file["a1/raw/gyr"].attrs["columns"] = np.array([b"x", b"y", b"z"])
        file["b"] = np.array([(5, 1.0), (6, 2.0)], [("t", "<i8"), ("u", "<f4")])
        file["note"] = "text"
        file["image"] = np.zeros((2, 2, 2))
    time = {"time_col": "a1.t_ns", "time_unit": "ns"}
    found = table_rates(path, **time, **RAD)
    assert found.rate.tobytes() == RATES[:3].tobytes()
    assert found.t_ns == [0, 10**9, 2 * 10**9]
    assert refusal(path, UsageError, rate_cols=["x", "y", "z"]).endswith(
        "the columns are 'a1.raw.gyr.x', 'a1.raw.gyr.y', 'a1.raw.gyr.z', 'a1.t_ns', 'b.t', 'b.u'"
    )
    mixed = ["b.u", "a1.raw.gyr.y", "a1.raw.gyr.z"]
    sentence = refusal(path, rate_cols=mixed, **time, **RAD)
    assert "have '2', '3' rows, so they are not one table; choose others" in sentence


@pytest.mark.parametrize(
    ("value", "rate_hz"),
    [(np.int32(100), 100), (np.uint8(100), 100), (0.5, 0.5)]
    + [(value, None) for value in (0.0, -1.0, np.inf, np.nan, [100.0, 100.0], np.bytes_("100"))],
    ids=str,
)
def test_a_sample_rate_is_one_number_above_zero(path, value, rate_hz):
    """Of any type."""
    with h5py.File(path, "w") as file:
        file["gyr"], file.attrs["sampling_rate"] = RATES, value
    with Hdf5Log(path) as log:
        assert log.notes.sample_rate == rate_hz


def test_names_that_do_not_fit_the_columns_are_not_theirs(path):
    """Each column of several has a name of its own, or none has one."""
    names = {"pair": "xy", "twice": "xx", "few": "x", "one": "x"}
    with h5py.File(path, "w") as file:
        for name, letters in names.items():
            file[name] = np.zeros((5, 1 if name == "one" else 2))
            file[name].attrs["columns"] = np.array(list(letters), np.bytes_)
        file["empty"] = np.zeros((5, 2))
        file["empty"].attrs["columns"] = np.array([b"x", b""])
    with Hdf5Log(path) as log:
        assert log.names == [
            *("empty[0]", "empty[1]", "few[0]", "few[1]", "one", "pair.x", "pair.y"),
            *("twice[0]", "twice[1]"),
        ]


def test_a_cut_file_is_refused_in_a_sentence(path):
    """HDF5 says itself how long it should be."""
    path.write_bytes(broad(path).read_bytes()[:-1000])
    sentence = refusal(path, DamagedLogError)
    assert sentence.startswith("its groups and datasets are damaged (")
    assert "truncated file" in sentence
    assert sentence.endswith("; was it closed and copied whole?")


def test_a_file_of_matlab_is_read_column_by_column(path):
    """Its text comes first, and it stores vectors and matrices in columns."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"t": SECONDS[None], "gyr": RATES.T}.items():
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Nov 22 08:00:00 2026")
    found = table_rates(path.rename(path.with_suffix(".mat")), time_unit="s", **RAD)
    assert found.rate.tobytes() == RATES.tobytes()
    assert np.abs(np.array(found.t_ns) * 1e-9 - SECONDS).max() < 1e-9


def test_a_unit_that_a_dataset_declares_is_its_unit(path):
    """As recorders of motion have it; one for columns of several quantities is that of none."""
    micros = np.round(SECONDS * 1e6).astype("u8")
    with h5py.File(path, "w") as file:
        for name, values, unit in (
            ("Sensors/XI-1/Gyroscope", RATES, b"rad/s"),
            ("Sensors/XI-1/Accelerometer", RATES, b"m/s^2"),
            ("Sensors/XI-1/Time", micros, "\u03bcs".encode()),
        ):
            file[name] = values
            file[name].attrs["Units"] = np.bytes_(unit)
    found = table_rates(path)
    assert found.rate.tobytes() == RATES.tobytes()
    assert found.t_ns == (micros * 1000).tolist()
    records = np.zeros(COUNT, [("t_us", "u8"), *((f"g{axis}_dps", "f8") for axis in "xyz")])
    records["t_us"] = micros
    with h5py.File(path, "w") as file:
        file["log"] = records
        file["log"].attrs["units"] = np.bytes_(b"rad/s")
    assert table_rates(path).t_ns == (micros * 1000).tolist()


@pytest.mark.parametrize(("rate", "time"), [("rad/s", "s"), ("deg/s", "ms"), ("rad/s", "ms")])
def test_a_unit_in_a_name_and_an_attribute_must_agree(path, rate, time):
    """The attribute won over the name; the user decides."""
    with h5py.File(path, "w") as file:
        file["gyro_dps"], file["time_s"] = RATES, SECONDS
        file["gyro_dps"].attrs["units"], file["time_s"].attrs["units"] = rate, time
    units = {}
    if rate != "deg/s":
        assert f"declared in deg/s, but also {rate}; correct the wrong" in refusal(path)
        units["rate_unit"] = "deg/s"
    if time != "s":
        assert f"'time_s [{time}]' is declared in s, but also {time};" in refusal(path, **units)
        units["time_unit"] = "s"
    assert table_rates(path, **units).t_ns == np.round(SECONDS * 1e9).astype(int).tolist()


def test_the_time_next_to_the_rates_is_theirs(path):
    """Another group's time is not."""
    with h5py.File(path, "w") as file:
        file["imu/time_ns"], file["imu/gyr"] = np.arange(COUNT)[:, None], RATES
        file["camera/time_ns"] = np.zeros(9)
    assert table_rates(path, **RAD).t_ns == [*range(COUNT)]


def test_of_two_sensors_one_is_chosen_by_its_group(path):
    """With its own time; the refusal names both groups and asks for the unit at once."""
    with h5py.File(path, "w") as file:
        for k, name in enumerate(("left", "right")):
            file[f"{name}/imu/time_ns"] = np.arange(COUNT) + 1000 * k
            file[f"{name}/imu/gyro"] = RATES + k
    remedies = "specify them with series='left' or 'right' and rate_unit='rad/s' or 'deg/s'"
    assert refusal(path, UndeclaredError).endswith(remedies)
    for k, name in enumerate(("left", "right")):
        found = table_rates(path, series=name, **RAD)
        assert found.t_ns == [*range(1000 * k, 1000 * k + COUNT)]
        assert np.array_equal(found.rate, RATES + k)


@pytest.mark.parametrize("version", ["earliest", "latest"])
@pytest.mark.parametrize("before", [0, 512])
def test_what_follows_the_end_of_the_file_is_lost(path, version, before):
    """HDF5 stops at the end that the file states, and half the samples would be missing."""
    with h5py.File(path, "w", libver=version, userblock_size=before) as file:
        file["gyr"] = RATES
        file.attrs["sampling_rate"] = RATE_HZ
    content = path.read_bytes()
    for rest in (b"", content, b"\0", b"\xff" * 99):
        path.write_bytes(content + rest)
        found = table_rates(path, **RAD)
        assert found.rate.tobytes() == RATES.tobytes()
        assert [loss.place for loss in found.losses] == [f"byte {len(content)}"] * bool(rest)
        assert all(loss.reason.startswith(f"{len(rest)} bytes fol") for loss in found.losses)


def test_a_size_that_the_file_cannot_hold_is_not_believed(path):
    """Chunks that were never written would be read as zeros for days."""
    with h5py.File(path, "w") as file:
        file.create_dataset("gyr", shape=(10**12, 3), chunks=(1000, 3), dtype="f8")
    assert refusal(path) == (
        "its dataset 'gyr': it decompresses to more than 2147483648 bytes; if that "
        "is right, set QUATPROP_MAX_UNPACKED to more"
    )


def test_without_h5py_the_way_out_is_named(path, monkeypatch):
    """A sentence, not an ImportError."""
    broad(path)
    monkeypatch.setitem(sys.modules, "h5py", None)
    sentence = "HDF5 needs h5py, which is not installed; pip install h5py"
    assert refusal(path, UsageError) == sentence
