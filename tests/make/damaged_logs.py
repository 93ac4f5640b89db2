"""Logs of every format, and ways to damage them; all told by seeds."""

import random
import re
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


DAMAGES = (
    "flip", "randomise", "truncate", "number", "number", "length", "length", "token", "token",
    "remove", "repeat", "move", "zero",
)  # fmt: skip


def damaged(data, rng):
    """Return bytes with one to four damages."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        if data:
            _damage(data, rng, rng.choice(DAMAGES))
    return bytes(data)


def _place(data, rng):
    """Return an offset: anywhere, or near the beginning or the end, where the structure is."""
    reach = rng.choice((len(data), min(len(data), 600)))
    offset = rng.randrange(reach)
    return offset if rng.random() < 0.6 else len(data) - 1 - offset


def _damage(data, rng, kind):  # noqa: PLR0912  # one damage after another
    begin = _place(data, rng)
    end = begin + rng.choice((1, 8, 100, 4096, 20_000))
    match kind:
        case "flip":
            for _ in range(rng.choice((1, 1, 8))):
                data[_place(data, rng)] ^= 1 << rng.randrange(8)
        case "randomise":
            size = min(rng.choice((1, 4, 64, 600)), len(data) - begin)
            data[begin : begin + size] = rng.randbytes(size)
        case "truncate":  # also where blocks of a file system, pages and batches end
            step = rng.choice((1, 1, 8, 64, 512, 4096))
            del data[begin // step * step :]
        case "number":
            value = rng.choice(EXTREMES)
            data[begin : begin + len(value)] = value
        case "length":  # most likely: a number that fits into the rest of the file
            size = rng.choice((4, 8))
            for at in range(begin, min(begin + 200, len(data) - size)):
                number = int.from_bytes(data[at : at + size], "little")
                if 0 < number <= len(data) - at:
                    values = [value for value in EXTREMES if len(value) == size]
                    near = (number + rng.choice((-1, 1))).to_bytes(size, "little")
                    data[at : at + size] = rng.choice([*values, near])
                    break
        case "token":
            token = rng.choice(TOKENS)
            data[begin : begin + (len(token) if rng.random() < 0.6 else 0)] = token
        case "remove":
            del data[begin:end]
        case "repeat":
            at = rng.choice((end, _place(data, rng)))
            data[at:at] = data[begin:end] * rng.choice((1, 1, 20))
        case "move":
            block = data[begin:end]
            del data[begin:end]
            at = rng.randrange(len(data) + 1)
            data[at:at] = block
        case "zero":
            data[begin:end] = bytes(len(data[begin:end]))


PAGE = 4096
"""Bytes of a page of the small databases."""


def damaged_pages(data, rng):
    """Return a database, or its write-ahead log, with one to four damages of its structure."""
    data = bytearray(data)
    head, step = (0, PAGE) if data.startswith(b"SQLite") else (32, 24 + PAGE)
    for _ in range(rng.choice((1, 1, 2, 4))):
        begin = head + step * rng.randrange(max(1, (len(data) - head) // step))
        _damage_page(data, rng, begin, step)
    return bytes(data)


WORDS = (b"messages", b"timestamp", b"topic_id", b"topics", b"INTEGER", b"TABLE", b"INDEX",
         b"PRIMARY KEY", b"BLOB", b"NOT NULL", b"id", b"data")  # fmt: skip


def _damage_page(data, rng, begin, step):
    match rng.choice(("page", "page", "frame", "remove", "exchange", "truncate", "schema")):
        case "page":  # its kind, its number of cells, or where they are
            head = begin + step - PAGE + (100 if begin == 0 else 0)
            sizes = ((0, 1), (1, 2), (3, 2), (5, 2), (7, 1), (8, 4), (8, 2), (10, 2))
            place, size = rng.choice(sizes)
            part = slice(head + place, head + place + size)
            before = int.from_bytes(data[part], "big")
            value = rng.choice((0, 1, before + 1, max(0, before - 1), rng.randrange(1 << 8 * size)))
            data[part] = (value % (1 << 8 * size)).to_bytes(size, "big")
        case "frame":  # its head, or that of the file
            at = rng.choice((0, begin)) + 4 * rng.randrange(25)
            data[at : at + 4] = rng.choice([value for value in EXTREMES if len(value) == 4])
        case "remove":
            del data[begin : begin + step]
        case "exchange":
            other = rng.randrange(max(1, len(data) // step)) * step + begin % step
            first, second = data[begin : begin + step], data[other : other + step]
            if len(first) == len(second):
                data[begin : begin + step], data[other : other + step] = second, first
        case "truncate":
            del data[begin:]
        case "schema":  # a word of it, whose length stays
            word = rng.choice(WORDS)
            places = [found.start() for found in re.finditer(word, data)]
            if places:
                at = rng.choice(places)
                data[at : at + len(word)] = rng.choice(WORDS)[: len(word)].ljust(len(word))


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
