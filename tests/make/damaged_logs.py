"""Logs of every format, and ways to damage them; all told by seeds."""

import random
import shutil
from pathlib import Path
from typing import NamedTuple

from make.formats import PACK, write_all
from make.places import SAMPLE_LOGS

from quatprop import propagate, write

EXTREMES = [
    value.to_bytes(size, order)
    for size, values in {
        2: (0, 1, 0x7FFF, 0x8000, 0xFFFF),
        4: (0, 1, 2**31 - 1, 2**31, 2**32 - 4, 2**32 - 1),
        8: (0, 1, 2**31, 2**32 - 1, 2**60, 2**63 - 1, 2**63, 2**64 - 9, 2**64 - 1),
    }.items()
    for value in values
    for order in ("little", "big")
]
"""Lengths, counts and offsets that nobody should believe."""

TOKENS = [
    b"nan", b"-inf", b"1e999", b"1e-400", b"9" * 40, b"-0", b'"', b",,,,", b"\r", b"\nnull\n",
    b"\n[1, 2]\n3\n", b"CREATE TABLE x(y)", b"\n", b"\0", b"\x1b[2J\x1b]0;x\x07", b"\xff\xfe",
    b"\xef\xbb\xbf", b"[4294967295]", b"[18446744073709551616]", b"[]", b"<=4294967295",
    b"float64[1000000000] x\n", b"wstring s\n", b"string s\n", b"geometry_msgs/Vector3",
    b"sensor_msgs/Imu x\n", b"MSG: std_msgs/Header\n", b"../../../etc/passwd", b"/dev/zero",
    b"!!python/object:os.system x", b"&a [*a, *a]", b"- ", b": ", b"2262-04-12T00:00:00Z",
    b"-9223372036854775808", b"18446744073709551615",
]  # fmt: skip
"""Texts that mean something to one format or another."""


def write_logs(folder):
    """Write an intact log of every kind, ROS 2 bags too; return their names, sorted."""
    write_all(folder)
    for name in ("spin.csv", "coning.mcap", "tumbling.bag", "rest.parquet"):
        shutil.copy(SAMPLE_LOGS / name, folder)
    shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", folder / "tumbling_ros2")
    for name in ("a.csv", "a.tum", "a.jsonl", "a.npz", "a.parquet", "a.feather", "a.mcap", "a.bag"):
        write(propagate(folder / "commas.csv"), folder / f"attitudes-{name}")
    return sorted(path.name for path in folder.iterdir())


def damaged(data, rng):
    """Return bytes with one to four damages."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        if data:
            rng.choice(DAMAGES)(data, rng)
    return bytes(data)


def _place(data, rng):
    """Return an offset: anywhere, or near the beginning or the end, where the structure is."""
    reach = rng.choice((len(data), min(len(data), 600)))
    offset = rng.randrange(reach)
    return offset if rng.random() < 0.6 else len(data) - 1 - offset


def _flip(data, rng):
    for _ in range(rng.choice((1, 1, 8))):
        data[_place(data, rng)] ^= 1 << rng.randrange(8)


def _randomise(data, rng):
    at = _place(data, rng)
    size = min(rng.choice((1, 4, 64, 600)), len(data) - at)
    data[at : at + size] = rng.randbytes(size)


def _truncate(data, rng):
    # Also where blocks of a file system, pages and batches end.
    step = rng.choice((1, 1, 8, 64, 512, 4096))
    del data[_place(data, rng) // step * step :]


def _overwrite(data, rng):
    at, value = _place(data, rng), rng.choice(EXTREMES)
    data[at : at + len(value)] = value


def _overwrite_length(data, rng):
    """Overwrite what is most likely a length: a number that fits into the rest of the file."""
    size = rng.choice((4, 8))
    first = _place(data, rng)
    for at in range(first, min(first + 200, len(data) - size)):
        if 0 < int.from_bytes(data[at : at + size], "little") <= len(data) - at:
            values = [value for value in EXTREMES if len(value) == size]
            near = int.from_bytes(data[at : at + size], "little") + rng.choice((-1, 1))
            data[at : at + size] = rng.choice([*values, near.to_bytes(size, "little")])
            return


def _write_token(data, rng):
    at, token = _place(data, rng), rng.choice(TOKENS)
    data[at : at + (len(token) if rng.random() < 0.6 else 0)] = token


def _block(data, rng):
    at = _place(data, rng)
    return at, at + rng.choice((1, 8, 100, 4096, 20_000))


def _remove(data, rng):
    begin, end = _block(data, rng)
    del data[begin:end]


def _repeat(data, rng):
    begin, end = _block(data, rng)
    at = rng.choice((end, _place(data, rng)))
    data[at:at] = data[begin:end] * rng.choice((1, 1, 20))


def _exchange(data, rng):
    begin, end = _block(data, rng)
    block = data[begin:end]
    del data[begin:end]
    at = rng.randrange(len(data) + 1)
    data[at:at] = block


def _zero(data, rng):
    begin, end = _block(data, rng)
    end = min(end, len(data))
    data[begin:end] = bytes(end - begin)


DAMAGES = (
    _flip, _randomise, _truncate, _overwrite, _overwrite, _overwrite_length, _overwrite_length,
    _write_token, _write_token, _remove, _repeat, _exchange, _zero,
)  # fmt: skip


PAGE = 4096
"""Bytes of a page of the small databases."""


def damaged_pages(data, rng):
    """Return a database, or its write-ahead log, with one to four damages of its structure."""
    data = bytearray(data)
    head, step = (0, PAGE) if data.startswith(b"SQLite") else (32, 24 + PAGE)
    for _ in range(rng.choice((1, 1, 2, 4))):
        begin = head + step * rng.randrange(max(1, (len(data) - head) // step))
        rng.choice(PAGE_DAMAGES)(data, rng, begin, step)
    return bytes(data)


def _edit_page_head(data, rng, begin, step):
    """Change the kind of a page, its number of cells, or where they are."""
    at = begin + step - PAGE + (100 if begin == 0 else 0)
    place, size = rng.choice(((0, 1), (1, 2), (3, 2), (5, 2), (7, 1), (8, 4), (8, 2), (10, 2)))
    before = int.from_bytes(data[at + place : at + place + size], "big")
    value = rng.choice((0, 1, before + 1, max(0, before - 1), rng.randrange(1 << 8 * size)))
    data[at + place : at + place + size] = (value % (1 << 8 * size)).to_bytes(size, "big")


def _edit_frame(data, rng, begin, _step):
    """Change the head of the file or of a frame."""
    begin = rng.choice((0, begin))
    at = begin + 4 * rng.randrange(25)
    data[at : at + 4] = rng.choice([value for value in EXTREMES if len(value) == 4])


def _remove_page(data, _rng, begin, step):
    del data[begin : begin + step]


def _exchange_pages(data, rng, begin, step):
    other = rng.randrange(max(1, len(data) // step)) * step + begin % step
    first, second = data[begin : begin + step], data[other : other + step]
    if len(first) == len(second):
        data[begin : begin + step], data[other : other + step] = second, first


def _truncate_pages(data, _rng, begin, _step):
    del data[begin:]


def _edit_schema(data, rng, _begin, _step):
    """Change a word of the schema, whose length stays."""
    words = (b"messages", b"timestamp", b"topic_id", b"topics", b"INTEGER", b"TABLE", b"INDEX",
             b"PRIMARY KEY", b"BLOB", b"NOT NULL", b"id", b"data")  # fmt: skip
    word = rng.choice(words)
    places = [at for at in range(len(data)) if data[at : at + len(word)] == word]
    if places:
        at = rng.choice(places)
        data[at : at + len(word)] = rng.choice(words)[: len(word)].ljust(len(word))


PAGE_DAMAGES = (
    _edit_page_head, _edit_page_head, _edit_frame, _remove_page, _exchange_pages,
    _truncate_pages, _edit_schema,
)  # fmt: skip


def _damaged_file(file, rng):
    is_database = file.suffix == ".db3" or file.name.endswith("-wal")
    damage = damaged_pages if is_database and rng.random() < 0.5 else damaged
    return damage(file.read_bytes(), rng)


class DamagedLog(NamedTuple):
    """Where a damaged log is, and the names of the intact logs whose samples were in it."""

    path: Path
    origins: tuple[str, ...]


def write_damaged(seed, intact, folder):
    """Write the damaged log of a seed into a folder."""
    rng = random.Random(seed)
    names = sorted(path.name for path in intact.iterdir())
    name = names[seed % len(names)]
    target, origins = folder / name, (name,)
    if (intact / name).is_dir():
        shutil.copytree(intact / name, target)
        files = sorted(target.iterdir())
        file = rng.choice(files)
        if rng.random() < 0.05:
            file.unlink()
        else:
            file.write_bytes(_damaged_file(file, rng))
        return DamagedLog(target, origins)
    suffix = name.rpartition(".")[2]
    if suffix in PACK and rng.random() < 0.5:
        inside = (intact / name.removesuffix(f".{suffix}")).read_bytes()
        target.write_bytes(PACK[suffix](damaged(inside, rng)))
    elif rng.random() < 0.05:
        files = [other for other in names if (intact / other).is_file()]
        other = rng.choice((name, rng.choice(files)))
        first, second = (intact / name).read_bytes(), (intact / other).read_bytes()
        second = rng.choice((second, damaged(second, rng)))
        target.write_bytes(first + second)
        # Of what is cut off near its beginning, there is nothing that could be missed.
        if other == name and len(second) > PAGE:
            origins = (name, other)
    else:
        target.write_bytes(_damaged_file(intact / name, rng))
    return DamagedLog(target, origins)
