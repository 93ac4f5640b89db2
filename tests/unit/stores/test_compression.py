"""Unpacking chunks, messages and whole files, with declared sizes that are not believed."""

import bz2
import gzip
import io
import struct
from contextlib import closing
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from quatprop.readers.tables.text_rows import open_text
from quatprop.stores.compression import (
    MAX_SIZE,
    DecompressedCopy,
    UnreadableDataError,
    decompress,
    decompressed_pieces,
    file_compression,
)

PACK = {
    "": bytes,
    "none": bytes,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.compress,
    "bz2": bz2.compress,
}
PACK_FILE = {f".{name}": PACK[name] for name in ("lz4", "zstd", "bz2")} | {".gz": gzip.compress}
TEXT = " ".join(map(str, range(180_000))).encode()
NOISE = np.random.default_rng(1).bytes(1_200_000)
"""Both are more than what is unpacked at a time."""

each_suffix = pytest.mark.parametrize("suffix", PACK_FILE)


@pytest.fixture
def unpacked(tmp_path, temporary):  # noqa: ARG001
    """Return a function that gives content and damage of the copy of a compressed file."""

    def copied(data, suffix):
        path = tmp_path / f"log.mcap{suffix}"
        path.write_bytes(data)
        with closing(DecompressedCopy(path)) as copy:
            assert copy.path.suffix == ".mcap"
            return copy.path.read_bytes(), copy.damage

    return copied


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("size", [0, 1, 1000, len(TEXT)])
@pytest.mark.parametrize("declared", [True, False])
def test_decompress_returns_what_was_packed(compression, size, declared):
    """Every compression gives the original back, with and without a declared size."""
    packed = PACK[compression](TEXT[:size])
    assert decompress(memoryview(packed), compression, size if declared else None) == TEXT[:size]


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize(
    ("size", "reason"),
    [(999, "and "), (1001, "and "), (1, "and "), (10**6, "and "), (1 << 40, "over")],
)
def test_a_declared_size_is_checked(compression, size, reason):
    """Whichever way it lies; a terabyte is refused before it is allocated."""
    packed = PACK[compression](TEXT[:1000])
    with pytest.raises(UnreadableDataError, match=f"declares {size} bytes decompressed,? {reason}"):
        decompress(packed, compression, size)


def test_the_size_in_a_frame_of_zstd_may_be_absent_or_a_lie():
    """Streaming writers leave it out; it is compared before it is allocated."""
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(TEXT)
    assert decompress(packed, "zstd", len(TEXT)) == decompress(packed, "zstd") == TEXT
    frame = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 40) + b"\x01\x00\x00"
    with pytest.raises(UnreadableDataError, match="and holds 1099511627776"):
        decompress(frame, "zstd", 100)


@pytest.mark.parametrize("damage", [slice(-9), slice(100), slice(1, None)])
def test_a_damaged_frame_of_lz4_does_no_harm_to_the_next(damage):
    """The size that it declared was held against the next one, if that declared none."""
    packed, good = lz4.frame.compress(TEXT), lz4.frame.compress(TEXT[:99], store_size=False)
    with pytest.raises(UnreadableDataError):
        decompress(packed[damage], "lz4", len(TEXT))
    assert decompress(good, "lz4", 99) == TEXT[:99]


@pytest.mark.parametrize("compression", ["lz4", "zstd", "bz2"])
def test_a_bomb_of_undeclared_size_is_refused_at_the_limit(monkeypatch, compression):
    """Data without declared size stops growing at the limit."""
    assert MAX_SIZE == 1 << 30
    monkeypatch.setattr("quatprop.stores.compression.MAX_SIZE", 1 << 20)
    with pytest.raises(UnreadableDataError, match=r"^it decompresses to more than 1048576 bytes"):
        decompress(PACK[compression](bytes(1 << 21)), compression)


def test_an_unknown_compression_is_named():
    """A compression that this version cannot unpack is refused in one sentence."""
    reason = "its compression 'brotli' is not one of none, lz4"
    with pytest.raises(UnreadableDataError, match=reason):
        decompress(b"", "brotli", 0)


@pytest.mark.parametrize("compression", ["lz4", "zstd", "bz2"])
@given(noise=st.binary(max_size=200), cut=st.integers(0, 100), declared=st.booleans())
def test_damaged_data_raises_nothing_but_compression_error(compression, noise, cut, declared):
    """Cut off and garbled data is refused or happens to be right; it never does anything else."""
    packed = PACK[compression](TEXT[:4000])
    size = 4000 if declared else None
    for bad in (noise, packed[: len(packed) * cut // 101], packed[:cut] + noise):
        with pytest.raises(UnreadableDataError):
            raise UnreadableDataError(str(len(decompress(bad, compression, size))))


@each_suffix
def test_a_compressed_file_may_be_of_several_frames(unpacked, suffix):
    """Parallel compressors write one after another; the copy is gone after the block."""
    packed = PACK_FILE[suffix](TEXT)
    assert file_compression(packed[:4]) == suffix[1:]
    assert unpacked(packed, suffix) == (TEXT, "")
    assert unpacked(packed + PACK_FILE[suffix](TEXT[:100]), suffix) == (TEXT + TEXT[:100], "")


@each_suffix
def test_a_copy_may_be_as_large_as_the_limit(unpacked, monkeypatch, suffix):
    """It is refused if it decompresses to more than that."""
    monkeypatch.setenv("QUATPROP_MAX_UNPACKED", str(len(TEXT)))
    assert unpacked(PACK_FILE[suffix](TEXT), suffix) == (TEXT, "")
    with pytest.raises(UnreadableDataError, match=f"decompresses to more than {len(TEXT)} bytes"):
        unpacked(PACK_FILE[suffix](TEXT + b"."), suffix)


@pytest.mark.parametrize("suffix", [".lz4", ".zstd"])
@pytest.mark.parametrize("skipped", [0, 4, 20])
def test_frames_to_be_skipped_are_skipped(tmp_path, unpacked, suffix, skipped):
    """Pzstd begins with one, and its files were taken for other ones (RFC 8878, 3.1.2)."""
    skip = struct.pack("<II", 0x184D2A50 + skipped % 16, skipped) + b"\x28" * skipped
    pack = PACK_FILE[suffix]
    packed = skip + skip + pack(TEXT) + skip + pack(TEXT[:99]) + skip
    assert file_compression(packed) == suffix[1:]
    assert unpacked(packed, suffix) == (TEXT + TEXT[:99], "")
    path = tmp_path / f"log.csv{suffix}"
    path.write_bytes(packed)
    with closing(open_text(path)) as text:
        assert text.read(2 * len(TEXT)) == TEXT + TEXT[:99]
    _, damage = unpacked(packed[: -len(skip) // 2], suffix)
    assert damage.endswith("data is damaged or cut off")


def test_a_long_frame_to_be_skipped_is_of_zstd():
    """Nothing is searched for after it; a file that ends within its head holds nothing."""
    assert file_compression(struct.pack("<II", 0x184D2A5F, 1000) + bytes(50)) == "zstd"
    assert file_compression(struct.pack("<II", 0x184D2A5F, 8)[:7]) == ""
    assert file_compression(struct.pack("<II", 0x184D2A5F, 0) + b"no frame") == ""


@each_suffix
@pytest.mark.parametrize("is_cut", [False, True])
def test_a_second_frame_that_is_damaged_is_reported(unpacked, suffix, is_cut):
    """The libraries' readers of bz2 and lz4 take it for the end of the file."""
    first, second = PACK_FILE[suffix](NOISE[:9000]), bytearray(PACK_FILE[suffix](NOISE[9000:18000]))
    if is_cut:
        del second[-3000:]
    else:
        second[5:60] = bytes(55)
    content, damage = unpacked(first + second, suffix)
    assert damage.endswith("data is damaged or cut off")
    assert content[:9000] == NOISE[:9000]


@each_suffix
def test_a_compressed_file_cut_off_keeps_what_comes_before(unpacked, suffix):
    """The good part is copied and the damage is told."""
    packed = PACK_FILE[suffix](NOISE)
    good, damage = unpacked(packed[:1_000_000], suffix)
    assert damage.endswith("data is damaged or cut off")
    assert NOISE.startswith(good)
    assert len(good) > 800_000  # bz2 packs 900 kB at a time


@each_suffix
def test_a_file_without_anything_good_leaves_no_copy(unpacked, suffix):
    """It is refused, and so is one that is not compressed."""
    with pytest.raises(UnreadableDataError, match="data is damaged"):
        unpacked(PACK_FILE[suffix](TEXT)[:6], suffix)
    with pytest.raises(UnreadableDataError, match="it is not compressed with zstd, lz4, bz2 or gz"):
        unpacked(TEXT, suffix)


@pytest.mark.usefixtures("temporary")
def test_a_copy_that_does_not_fit_says_where(tmp_path, monkeypatch):
    """A full disk is told with the folder and the way out, and the copy is removed."""

    class Full(io.BytesIO):
        def write(self, _data):
            raise OSError(28, "No space left on device")

    path = tmp_path / "log.mcap.gz"
    path.write_bytes(gzip.compress(TEXT))
    way = Path.open
    monkeypatch.setattr(Path, "open", lambda p, mode: Full() if mode == "wb" else way(p, mode))
    reason = r"does not fit into .* \(No space.*; set TMPDIR to"
    with pytest.raises(UnreadableDataError, match=reason):
        DecompressedCopy(path)


def test_a_forgotten_copy_is_removed(tmp_path, temporary):
    """The temporary file goes with its object."""
    path = tmp_path / "log.mcap.gz"
    path.write_bytes(gzip.compress(TEXT))
    copy = DecompressedCopy(path)
    assert len(list(temporary.iterdir())) == 1
    del copy


@pytest.mark.parametrize("zeros", [1, 100_000])
def test_only_gzip_is_padded_with_zeros(zeros):
    """Behind other frames zeros are what a file system left of a lost end."""
    padding = b"\0" * zeros
    whole = io.BytesIO(gzip.compress(b"0.1 rad/s") + padding)
    assert b"".join(decompressed_pieces(whole, "gzip")) == b"0.1 rad/s"
    for name in ("zstd", "bz2"):
        with pytest.raises(UnreadableDataError, match="is damaged or cut off"):
            list(decompressed_pieces(io.BytesIO(PACK[name](b"0.1") + padding), name))
