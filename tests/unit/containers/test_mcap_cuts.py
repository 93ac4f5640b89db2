"""MCAP files cut around the ends of their chunks: nothing is read that is not in the file."""

import warnings

import pytest
from fuzz import flips_mcap as log

import quatprop

CUTS = range(-64, 64)
"""Bytes that the end of a chunk is before or behind the cut; a prime step meets every kind."""
STEP = 11


def cut(data, after):
    """Yield the files that are cut around the end of the last chunk but `after`."""
    ends = [
        start + 9 + length for start, opcode, length in log.records(data) if opcode == log.CHUNK
    ]
    for by in CUTS[after::STEP]:
        yield by, data[: ends[-1 - after] + by]


def samples(path, **options):
    """Return how many samples are read, which must be the first, and whether a loss is told."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        series = quatprop.read_rates(path, **options)
    count = len(series.t_ns)
    assert series.t_ns.tolist() == log.T_NS[:count].tolist()
    assert series.rate.tolist() == log.RATES[:count].tolist()
    return count, any(one.category is quatprop.DataLossWarning for one in caught)


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize("layout", [{}, {"message_indexes": False}, {"checksums": False}])
def test_no_cut_gives_samples_that_are_not_in_the_file(tmp_path, compression, layout):
    """All of what was written is read, and nothing else; what is missing is told."""
    data = log.mcap(compression, **layout)
    path = tmp_path / "cut.mcap"
    for after in range(log.CHUNKS):
        end = (log.CHUNKS - after) * log.COUNT // log.CHUNKS
        for by, content in cut(data, after):
            path.write_bytes(content)
            count, is_told = samples(path)
            assert end - log.COUNT // log.CHUNKS <= count <= end, by
            # Of the last chunk, the record that ends the data may be there.
            assert is_told or count == log.COUNT, by
            # Without compression, the last messages are a sample and a note; lz4 ends in 4 bytes.
            if by >= -4 * (compression == "lz4"):
                assert count == end, by


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize("clock", ["log", "header"])
def test_memory_that_nothing_was_written_to_is_not_read(tmp_path, compression, clock):
    """Half of the samples of a torn chunk were those of chunks before it, or none at all."""
    data = log.mcap(compression, count=log.MOST)
    path = tmp_path / "cut.mcap"
    *_, end = (start + 9 + n for start, opcode, n in log.records(data) if opcode == log.CHUNK)
    path.write_bytes(data[: end - 4])
    count, is_told = samples(path, clock=clock)
    assert is_told
    assert count > 0.9 * log.MOST
    if compression == "lz4":  # which ends in 4 bytes that hold no data
        assert count == log.MOST
