"""CSV: exact bytes, exact numbers."""

import numpy as np
import pyarrow.csv
import pytest

from quatprop.errors import UsageError
from quatprop.series import AttitudeSeries
from quatprop.writers import open_writer

HALF = AttitudeSeries(
    np.array([1_700_000_000_000_000_000, 1_700_000_000_005_000_001]),
    np.array([[1.0, -0.0, 0.0, 0.0], [0.5, -0.5, 0.1 + 0.2, 1e-320]]),
)


def write(target, series, layout="scalar-first"):
    """Write one series and return the bytes."""
    with open_writer(target, layout=layout) as writer:
        writer.write(series)
        writer.commit({})
    return target.read_bytes()


@pytest.mark.parametrize("layout", ["scalar-first", "wxyz"])
def test_scalar_first_is_written_to_the_byte(tmp_path, layout):
    """The header is bare, the columns are t_ns,qw,qx,qy,qz and lines end in a newline."""
    assert write(tmp_path / "a.csv", HALF, layout) == (
        b"t_ns,qw,qx,qy,qz\n"
        b"1700000000000000000,1,-0,0,0\n"
        b"1700000000005000001,0.5,-0.5,0.30000000000000004,1e-320\n"
    )


@pytest.mark.parametrize("layout", ["scalar-last", "xyzw"])
def test_scalar_last_moves_the_scalar_and_nothing_else(tmp_path, layout):
    """The columns are t_ns,qx,qy,qz,qw with the same numbers."""
    assert write(tmp_path / "a.csv", HALF, layout) == (
        b"t_ns,qx,qy,qz,qw\n"
        b"1700000000000000000,-0,0,0,1\n"
        b"1700000000005000001,-0.5,0.30000000000000004,1e-320,0.5\n"
    )


def test_an_unknown_layout_is_refused_with_the_known_ones(tmp_path):
    """A layout that does not exist is an error that lists those that do."""
    with pytest.raises(
        UsageError,
        match=r"^no layout 'jpl'; choose one of 'scalar-first', 'scalar-last', 'wxyz', 'xyzw'$",
    ):
        open_writer(tmp_path / "a.csv", layout="jpl")
    assert list(tmp_path.iterdir()) == []


def test_every_float_reads_back_as_itself(tmp_path):
    """Any finite float64, also a denormal, comes back from the decimals with the same bits."""
    bits = np.random.default_rng(5).integers(0, 2**63, 40_000, dtype=np.int64)
    values = bits.view(np.float64)
    values = values[np.isfinite(values)][:20_000].reshape(-1, 4)
    write(tmp_path / "a.csv", AttitudeSeries(np.arange(len(values)), values))
    table = pyarrow.csv.read_csv(
        tmp_path / "a.csv",
        convert_options=pyarrow.csv.ConvertOptions(
            column_types=dict.fromkeys(["qw", "qx", "qy", "qz"], "float64")
        ),
    )
    back = np.column_stack([table[name].to_numpy() for name in ("qw", "qx", "qy", "qz")])
    np.testing.assert_array_equal(back.view(np.int64), values.view(np.int64))


def test_batches_of_any_size_give_the_same_bytes(tmp_path):
    """How a series is cut into batches cannot be seen in the file."""
    rng = np.random.default_rng(6)
    t_ns, wxyz = np.arange(5000), rng.standard_normal((5000, 4))
    whole = write(tmp_path / "whole.csv", AttitudeSeries(t_ns, wxyz))
    with open_writer(tmp_path / "cut.csv") as writer:
        for rows in np.split(np.arange(5000), [1, 1, 700, 4096]):
            writer.write(AttitudeSeries(t_ns[rows], wxyz[rows]))
        writer.commit({})
    assert (tmp_path / "cut.csv").read_bytes() == whole


def test_a_series_without_samples_is_a_header(tmp_path):
    """Committing without a write leaves the header line alone."""
    with open_writer(tmp_path / "a.csv") as writer:
        writer.commit({})
    assert (tmp_path / "a.csv").read_bytes() == b"t_ns,qw,qx,qy,qz\n"


def test_a_dash_is_stdout_and_leaves_it_open(capfdbinary):
    """``-`` writes CSV to standard output, which can still be written to afterwards."""
    with open_writer("-") as writer:
        writer.write(AttitudeSeries(np.array([7]), np.array([[1.0, 0.0, 0.0, 0.0]])))
        writer.commit({})
    print("still open", flush=True)
    assert capfdbinary.readouterr().out == b"t_ns,qw,qx,qy,qz\n7,1,0,0,0\nstill open\n"
