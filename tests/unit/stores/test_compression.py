"""Unpacking chunks, messages and whole files, with declared sizes that are not believed."""

import bz2
import gzip
import io
import os
import struct
import tempfile
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from quatprop.stores.compressed_files import DecompressedCopy, file_compression
from quatprop.stores.compression import (
    MAX_SIZE,
    UnreadableDataError,
    decompress,
    decompressed_pieces,
)
from quatprop.tables.text_stream import open_text

PACK = {
    "": bytes,
    "none": bytes,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.compress,
    "bz2": bz2.compress,
}
PACK_FILE = {
    ".lz4": lz4.frame.compress,
    ".zstd": zstandard.compress,
    ".bz2": bz2.compress,
    ".gz": gzip.compress,
}
TEXT = bytes(range(256)) * 5000


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Let temporary files go to a folder whose content can be checked."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("size", [0, 1, 1000, len(TEXT)])
@pytest.mark.parametrize("declared", [True, False])
def test_decompress_returns_what_was_packed(compression, size, declared):
    """Every compression gives the original back, with and without a declared size."""
    packed = PACK[compression](TEXT[:size])
    assert decompress(memoryview(packed), compression, size if declared else None) == TEXT[:size]


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("off", [-1, 1, -999, 10**6])
def test_a_declared_size_is_checked(compression, off):
    """Data that unpacks to another size than declared is refused, whichever way it lies."""
    packed = PACK[compression](TEXT[:1000])
    with pytest.raises(
        UnreadableDataError, match=rf"declares {1000 + off} bytes decompressed and "
    ):
        decompress(packed, compression, 1000 + off)


def test_a_zstd_frame_without_content_size_is_unpacked_to_the_declared_size():
    """Streaming writers leave the size out of the frame."""
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(TEXT)
    assert decompress(packed, "zstd", len(TEXT)) == TEXT
    assert decompress(packed, "zstd") == TEXT


@pytest.mark.parametrize("compression", PACK)
def test_a_size_over_the_limit_is_refused_before_anything_is_allocated(compression):
    """A chunk that declares a terabyte is refused."""
    packed = PACK[compression](b"x")
    with pytest.raises(
        UnreadableDataError, match=r"declares 1099511627776 bytes decompressed, over"
    ):
        decompress(packed, compression, 1 << 40)


def test_a_zstd_frame_that_claims_a_terabyte_is_refused():
    """The size in the frame header is compared before it is allocated."""
    frame = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 40) + b"\x01\x00\x00"
    with pytest.raises(UnreadableDataError, match="and holds 1099511627776"):
        decompress(frame, "zstd", 100)


def test_a_bomb_of_undeclared_size_is_refused_at_the_limit(monkeypatch):
    """Data without declared size stops growing at the limit."""
    monkeypatch.setattr("quatprop.stores.compression.MAX_SIZE", 1 << 20)
    for compression in ("lz4", "zstd", "bz2"):
        with pytest.raises(UnreadableDataError, match="it decompresses to more than 1048576 bytes"):
            decompress(PACK[compression](bytes(1 << 22)), compression)
    assert MAX_SIZE == 1 << 30


def test_an_unknown_compression_is_named():
    """What this version cannot unpack is said in one sentence."""
    with pytest.raises(
        UnreadableDataError, match="its compression 'brotli' is not one of none, lz4"
    ):
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


@pytest.mark.parametrize("suffix", PACK_FILE)
def test_a_packed_file_is_unpacked_beside_and_removed(tmp_path, temporary, suffix):
    """The copy has the content and the inner suffix, and is gone after the block."""
    path = tmp_path / ("log.mcap" + suffix)
    path.write_bytes(PACK_FILE[suffix](TEXT))
    assert file_compression(path.read_bytes()[:4]) == {".gz": "gz"}.get(suffix, suffix[1:])
    with closing(DecompressedCopy(path)) as copy:
        assert copy.path.suffix == ".mcap"
        assert copy.path.read_bytes() == TEXT
        assert copy.damage == ""
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("suffix", PACK_FILE)
def test_a_file_of_several_frames_is_one_file(tmp_path, temporary, suffix):
    """Parallel compressors write one frame after another."""
    path = tmp_path / ("log.db3" + suffix)
    path.write_bytes(PACK_FILE[suffix](TEXT) + PACK_FILE[suffix](TEXT[:100]))
    with closing(DecompressedCopy(path)) as copy:
        assert copy.path.read_bytes() == TEXT + TEXT[:100]
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("suffix", [".lz4", ".zstd"])
@pytest.mark.parametrize("skipped", [0, 4, 20])
@pytest.mark.usefixtures("temporary")
def test_frames_to_be_skipped_are_skipped(tmp_path, suffix, skipped):
    """Pzstd begins with one, and its files were taken for other ones (RFC 8878, 3.1.2)."""
    skip = struct.pack("<II", 0x184D2A50 + skipped % 16, skipped) + b"\x28" * skipped
    pack = PACK_FILE[suffix]
    path = tmp_path / ("log.csv" + suffix)
    path.write_bytes(skip + skip + pack(TEXT) + skip + pack(TEXT[:99]) + skip)
    with closing(DecompressedCopy(path)) as copy:
        assert copy.path.read_bytes() == TEXT + TEXT[:99]
    assert file_compression(path.read_bytes()) == suffix[1:]
    with closing(open_text(path)) as text:
        assert text.read(2 * len(TEXT)) == TEXT + TEXT[:99]
    path.write_bytes(path.read_bytes()[: -len(skip) // 2])
    with closing(DecompressedCopy(path)) as copy:
        assert copy.damage.endswith("data is damaged or cut off")


def test_a_long_frame_to_be_skipped_is_of_zstd():
    """What comes behind it is not looked for; what ends within its head is nothing."""
    assert file_compression(struct.pack("<II", 0x184D2A5F, 1000) + bytes(50)) == "zstd"
    assert file_compression(struct.pack("<II", 0x184D2A5F, 8)[:7]) == ""
    assert file_compression(struct.pack("<II", 0x184D2A5F, 0) + b"no frame") == ""


@pytest.mark.parametrize("suffix", PACK_FILE)
@pytest.mark.parametrize("is_cut", [False, True])
@pytest.mark.usefixtures("temporary")
def test_a_second_frame_that_is_damaged_is_reported(tmp_path, suffix, is_cut):
    """The libraries' readers of bz2 and lz4 take it for the end of the file."""
    path = tmp_path / f"log.csv{suffix}"
    first = os.urandom(9000)
    second = bytearray(PACK_FILE[suffix](os.urandom(9000)))
    if is_cut:
        del second[-3000:]
    else:
        second[5:60] = bytes(55)
    path.write_bytes(PACK_FILE[suffix](first) + second)
    with closing(DecompressedCopy(path)) as copy:
        assert copy.damage.endswith("data is damaged or cut off")
        assert copy.path.read_bytes()[:9000] == first


@pytest.mark.parametrize("suffix", PACK_FILE)
def test_a_packed_file_cut_off_keeps_what_comes_before(tmp_path, temporary, suffix):
    """The good part is copied and the damage is told."""
    content = os.urandom(3 << 20)
    path = tmp_path / ("log.mcap" + suffix)
    path.write_bytes(PACK_FILE[suffix](content)[: 2 << 20])
    with closing(DecompressedCopy(path)) as copy:
        good = copy.path.read_bytes()
        assert copy.damage.endswith("data is damaged or cut off")
    assert content.startswith(good)
    assert len(good) > 1 << 20
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("suffix", PACK_FILE)
def test_a_packed_file_without_anything_good_leaves_no_copy(tmp_path, temporary, suffix):
    """A file whose first block is damaged is refused and nothing stays behind."""
    path = tmp_path / ("log.mcap" + suffix)
    path.write_bytes(PACK_FILE[suffix](TEXT)[:6])
    with pytest.raises(UnreadableDataError, match="data is damaged"):
        DecompressedCopy(path)
    assert list(temporary.iterdir()) == []


def test_a_file_that_is_not_packed_is_refused(tmp_path, temporary):
    """Plain bytes are no packed file."""
    path = tmp_path / "log.mcap"
    path.write_bytes(TEXT)
    with pytest.raises(
        UnreadableDataError, match="it is not compressed with zstd, lz4, bz2 or gzip"
    ):
        DecompressedCopy(path)
    assert list(temporary.iterdir()) == []


def test_a_copy_that_does_not_fit_says_where(tmp_path, temporary, monkeypatch):
    """A full disk is told with the folder and the way out, and the copy is removed."""

    class Full(io.BytesIO):
        def write(self, _data):
            raise OSError(28, "No space left on device")

    path = tmp_path / "log.mcap.gz"
    path.write_bytes(gzip.compress(TEXT))
    way = Path.open
    monkeypatch.setattr(Path, "open", lambda p, mode: Full() if mode == "wb" else way(p, mode))
    with pytest.raises(
        UnreadableDataError, match=r"does not fit into .* \(No space.*; set TMPDIR to"
    ):
        DecompressedCopy(path)
    assert list(temporary.iterdir()) == []


def test_a_forgotten_copy_is_removed(tmp_path, temporary):
    """The temporary file goes with its object."""
    path = tmp_path / "log.mcap.gz"
    path.write_bytes(gzip.compress(TEXT))
    copy = DecompressedCopy(path)
    assert len(list(temporary.iterdir())) == 1
    del copy
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("zeros", [1, 100_000])
def test_only_gzip_is_padded_with_zeros(zeros):
    """Behind other frames zeros are what a file system left of a lost end."""
    padding = b"\0" * zeros
    whole = io.BytesIO(gzip.compress(b"0.1 rad/s") + padding)
    assert b"".join(decompressed_pieces(whole, "gzip")) == b"0.1 rad/s"
    for name, packed in (("zstd", zstandard.compress(b"0.1")), ("bz2", bz2.compress(b"0.1"))):
        with pytest.raises(UnreadableDataError, match="is damaged or cut off"):
            list(decompressed_pieces(io.BytesIO(packed + padding), name))
