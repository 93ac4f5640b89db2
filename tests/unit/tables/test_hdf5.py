"""HDF5 files: datasets of columns, groups, names, damage, what is never believed."""

import sys

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from quatprop import DataLossWarning, propagate, read_attitudes, read_rates
from quatprop.cli.commands import cli
from quatprop.tables.hdf5 import Hdf5Log

h5py = pytest.importorskip("h5py")

RATE_HZ, COUNT = 2000 / 7, 1000
SECONDS = np.arange(COUNT) / RATE_HZ
RATES = np.random.default_rng(4).normal(size=(COUNT, 3))


def broad(path, **options):
    """Write a file as BROAD publishes them, with a turn of 0.5 rad/s about z as its truth."""
    with h5py.File(path, "w") as file:
        file.attrs["sampling_rate"] = RATE_HZ
        file.create_dataset("imu_gyr", data=RATES, **options)
        file["imu_acc"] = np.tile([0.0, 0.0, 9.81], (COUNT, 1))
        xyzw = Rotation.from_rotvec(np.outer(SECONDS, [0, 0, 0.5])).as_quat()
        file["opt_quat"] = xyzw[:, [3, 0, 1, 2]]
        file["movement"] = np.ones(COUNT, np.bool_)
    return path


def refusal(path, *options):
    """Return the error of a run that is refused."""
    result = CliRunner().invoke(cli, ["propagate", str(path), "-o", "-", *options])
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 2
    return result.stderr


@pytest.mark.parametrize(
    "options",
    [{}, {"chunks": (7, 2)}, {"compression": "gzip", "shuffle": True}, {"dtype": ">f8"}],
    ids=str,
)
def test_a_file_of_broad_is_read_to_the_bit(tmp_path, options):
    """Rates are those stored, however they are stored, and the file says at what rate."""
    rates = read_rates(broad(tmp_path / "a.hdf5", **options), rate_unit="rad/s")
    assert rates.rate.tobytes() == RATES.tobytes()
    assert np.abs(rates.t_ns * 1e-9 - SECONDS).max() < 1e-9


def test_the_truth_of_broad_is_read(tmp_path):
    """Its columns have numbers, so which is the scalar must be said."""
    truth = read_attitudes(
        broad(tmp_path / "a.h5"),
        quat_cols=[f"opt_quat[{k}]" for k in range(4)],
        from_layout="scalar-first",
    )
    expected = np.column_stack([np.cos(SECONDS / 4), np.sin(SECONDS / 4)])
    assert np.abs(truth.wxyz[:, [0, 3]] - expected).max() < 1e-15


def test_columns_are_named_by_groups_fields_and_attributes(tmp_path):
    """Datasets of one dimension, records, and an attribute with names are one table each."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["a/t_ns"] = np.arange(3) * 10**9
        file["a/deep/gyr"] = RATES[:3]
        file["a/deep/gyr"].attrs["columns"] = np.array([b"x", b"y", b"z"])
        file["b"] = np.array([(5, 1.0), (6, 2.0)], [("t", "<i8"), ("u", "<f4")])
        file["note"] = "text"
        file["image"] = np.zeros((2, 2, 2))
    options = {"rate_unit": "rad/s", "time_col": "a.t_ns", "time_unit": "ns"}
    rates = read_rates(path, **options)
    assert rates.rate.tobytes() == RATES[:3].tobytes()
    assert rates.t_ns.tolist() == [0, 10**9, 2 * 10**9]
    assert refusal(path, "--rate-cols", "x,y,z").endswith(
        "the columns are 'a.deep.gyr.x', 'a.deep.gyr.y', 'a.deep.gyr.z', 'a.t_ns', 'b.t', 'b.u'\n"
    )
    error = refusal(path, "--rate-cols", "b.u,a.deep.gyr.y,a.deep.gyr.z", "--rate-unit", "rad/s",
                    "--time-col", "a.t_ns", "--time-unit", "ns")  # fmt: skip
    assert "have '2', '3' rows, so they are not one table; choose others" in error


def test_a_cut_file_is_refused_in_a_sentence(tmp_path):
    """HDF5 says itself how long it should be."""
    path = broad(tmp_path / "a.h5")
    path.write_bytes(path.read_bytes()[:-1000])
    error = refusal(path)
    assert error.startswith(f"Error: {path}: its groups and datasets are damaged (")
    assert "truncated file" in error
    assert error.endswith("; was it closed and copied whole?\n")


def test_a_file_of_matlab_is_read_column_by_column(tmp_path):
    """Its text comes first, and it stores vectors and matrices in columns."""
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"t": SECONDS[None], "gyr": RATES.T}.items():
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Nov 22 08:00:00 2026")
    rates = read_rates(path, rate_unit="rad/s", time_unit="s")
    assert rates.rate.tobytes() == RATES.tobytes()
    assert np.abs(rates.t_ns * 1e-9 - SECONDS).max() < 1e-9


def test_a_unit_that_a_dataset_declares_is_its_unit(tmp_path):
    """As recorders of motion have it; one for columns of several quantities is that of none."""
    path = tmp_path / "a.h5"
    micros = np.round(SECONDS * 1e6).astype("u8")
    with h5py.File(path, "w") as file:
        for name, values, unit in (
            ("Sensors/XI-1/Gyroscope", RATES, b"rad/s"),
            ("Sensors/XI-1/Accelerometer", RATES, b"m/s^2"),
            ("Sensors/XI-1/Time", micros, "\u03bcs".encode()),
        ):
            file[name] = values
            file[name].attrs["Units"] = np.bytes_(unit)
    rates = read_rates(path)
    assert rates.rate.tobytes() == RATES.tobytes()
    assert rates.t_ns.tolist() == (micros * 1000).tolist()
    records = np.zeros(COUNT, [("t_us", "u8"), *((f"g{axis}_dps", "f8") for axis in "xyz")])
    records["t_us"] = micros
    with h5py.File(path, "w") as file:
        file["log"] = records
        file["log"].attrs["units"] = np.bytes_(b"rad/s")
    assert read_rates(path).t_ns.tolist() == (micros * 1000).tolist()


def test_the_time_beside_the_rates_is_theirs(tmp_path):
    """Another group's time is not."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["imu/time_ns"], file["imu/gyr"] = np.arange(COUNT)[:, None], RATES
        file["camera/time_ns"] = np.zeros(9)
    rates = read_rates(path, rate_unit="rad/s")
    assert rates.t_ns.tolist() == list(range(COUNT))


@pytest.mark.parametrize("version", ["earliest", "latest"])
@pytest.mark.parametrize("rest", [None, b"\0", b"\xff" * 99], ids=["joined", "zero", "noise"])
@pytest.mark.parametrize("before", [0, 512])
def test_what_follows_the_end_of_the_file_is_lost(tmp_path, version, rest, before):
    """HDF5 stops at the end that the file states, and half the samples would be missing."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver=version, userblock_size=before) as file:
        file["gyr"] = RATES
        file.attrs["sampling_rate"] = RATE_HZ
    content = path.read_bytes()
    with Hdf5Log(path) as log:
        assert not log.losses
    rest = content if rest is None else rest
    path.write_bytes(content + rest)
    with pytest.warns(DataLossWarning, match=f"byte {len(content)}: {len(rest)} bytes follow the"):
        assert read_rates(path, rate_unit="rad/s").rate.tobytes() == RATES.tobytes()


def test_a_damaged_chunk_loses_its_rows(tmp_path):
    """What is before and behind it is kept, and the loss is counted."""
    path = broad(tmp_path / "a.h5", compression="gzip", chunks=(100, 3))
    with h5py.File(path) as file:
        chunk = file["imu_gyr"].id.get_chunk_info(5)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset : chunk.byte_offset + chunk.size] = b"\xff" * chunk.size
    path.write_bytes(data)
    out = tmp_path / "out.csv"
    result = CliRunner().invoke(
        cli, ["propagate", str(path), "--rate-unit", "rad/s", "-o", str(out)]
    )
    assert result.exit_code == 3
    assert "\nlost: rows 501 to 600: they are damaged: " in result.stderr
    assert len(read_attitudes(out).t_ns) == 900


def test_a_size_that_the_file_cannot_hold_is_not_believed(tmp_path):
    """Chunks that were never written would be read as zeros for days."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("gyr", shape=(10**12, 3), chunks=(1000, 3), dtype="f8")
    assert refusal(path) == (
        f"Error: {path}: its dataset 'gyr': it decompresses to more than 2147483648 bytes; if that "
        "is right, set QUATPROP_MAX_UNPACKED to more\n"
    )


def test_without_h5py_the_way_out_is_named(tmp_path, monkeypatch):
    """A sentence, not an ImportError."""
    path = broad(tmp_path / "a.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert refusal(path) == (
        f"Error: {path}: HDF5 needs h5py, which is not installed; pip install h5py\n"
    )


def test_the_same_numbers_give_the_same_attitudes(tmp_path):
    """The format of the file does not matter."""
    stored = propagate(broad(tmp_path / "a.h5"), rate_unit="rad/s")
    np.save(tmp_path / "a.npy", RATES)
    again = propagate(
        tmp_path / "a.npy", rate_unit="rad/s", rate_cols=["0", "1", "2"], sample_rate=RATE_HZ
    )
    assert stored.wxyz.tobytes() == again.wxyz.tobytes()
