"""Odd but valid tables of rates, and what other readers find in them."""

import csv
import json
from decimal import Decimal

import numpy as np
import pyarrow as pa
from pyarrow import feather, parquet

DEGREE = np.pi / 180
T0 = 1_700_000_000_000_000_000
AXES = ("wx", "wy", "wz")
NAMES = [f"gyro_{axis}_rad_s" for axis in "xyz"]
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def samples(rng):
    """Return stamps and rates."""
    count = rng.choice((1, 2, 30, 100))
    first = rng.choice((0, T0, -(10**9), 12_345_678_901_000))
    jitter = rng.choice((0, 1000))
    stamps = [first + 10_000_000 * k + jitter * rng.randrange(1000) for k in range(count)]
    return stamps, [[rng.gauss(0, 1) for _ in AXES] for _ in stamps]


def csv_log(rng, folder):
    """Write a CSV table in some dialect; read it with the csv module and decimal numbers."""
    path = folder / f"log.{rng.choice(('csv', 'txt', 'dat'))}"
    stamps, rates = samples(rng)
    delimiter = rng.choice(",,;;\t| ")
    comma = delimiter in ";\t|" and rng.random() < 0.5
    unit = rng.choice(list(PER_SECOND))
    rate_unit, factor = rng.choice((("rad_s", 1.0), ("deg_s", DEGREE)))
    time = f"t_{unit}" if delimiter == " " else rng.choice((f"t_{unit}", f"time [{unit}]"))
    used = [time, *(f"gyro_{axis}_{rate_unit}" for axis in "xyz")]
    note = rng.choice((None, "plain", f"a{delimiter}b", 'say ""x""', "é", "two\nlines"))
    quoting = rng.choice((csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONNUMERIC))
    spaces = delimiter in ",;|" and quoting == csv.QUOTE_MINIMAL and rng.random() < 0.5
    number = rng.choice(("{!r}", "{:.6f}", "{:+.17e}", "{:.3g}", "{:E}"))
    columns = [*used, *(["note"] if note is not None and delimiter != " " else [])]
    columns += [f"channel{k}" for k in range(rng.choice((0, 0, 0, 0, 0, 3000)))]
    rng.shuffle(columns)
    # The csv module does not quote a line break that is none of its own.
    end = rng.choice(("\n", "\n", "\r\n", "\n" if note == "two\nlines" else "\r"))
    with path.open("w", newline="", encoding=rng.choice(("utf-8", "utf-8-sig"))) as file:
        if rng.random() < 0.4:
            file.write(f"# made by a recorder{end}")
        writer = csv.writer(file, delimiter=delimiter, lineterminator=end, quoting=quoting)
        writer.writerow(columns)
        for ns, rate in zip(stamps, rates, strict=True):
            texts = [format(Decimal(ns) * PER_SECOND[unit] / 10**9, "f")]
            texts += [number.format(x) for x in rate]
            texts = [text.replace(".", ",") if comma else text for text in texts]
            texts = [f" {text} " if spaces else text for text in texts]
            cells = {"note": note, **dict(zip(used, texts, strict=True))}
            writer.writerow([cells.get(name, "7") for name in columns])
            if rng.random() < 0.05:
                file.write(end)
    if rng.random() < 0.3:
        path.write_bytes(path.read_bytes().rstrip(b"\r\n"))
    with path.open(encoding="utf-8-sig", newline="") as lines:
        rows = csv.reader((line for line in lines if line[0] != "#"), delimiter=delimiter)
        header = next(rows)
        places = [header.index(name) for name in used]
        read = [[row[k].strip() for k in places] for row in rows if row]
    expected = []
    for texts in read:
        t, *rate = [text.replace(",", ".") if comma else text for text in texts]
        t_ns = int((Decimal(t) * 10**9 / PER_SECOND[unit]).to_integral_value())
        expected.append((t_ns, tuple(float(x) * factor for x in rate)))
    return path, {}, expected, True


def time_array(rng, stamps):
    """Return a time column of some Arrow type and its name."""
    kind = rng.choice(("int64", "timestamp", "utc", "decimal", "us", "dictionary", "uint64"))
    if kind == "uint64" and stamps[0] >= 0:
        return "t_ns", pa.array(stamps, pa.uint64())
    if kind in ("timestamp", "utc"):
        unit = rng.choice(("ns", "us"))
        kind = pa.timestamp(unit, "Europe/Berlin" if kind == "utc" else None)
        return "time", pa.array([ns * PER_SECOND[unit] // 10**9 for ns in stamps], kind)
    if kind == "decimal":
        return "t_s", pa.array([Decimal(ns).scaleb(-9) for ns in stamps], pa.decimal128(30, 9))
    if kind == "us":
        return "t_us", pa.array([ns // 1000 for ns in stamps])
    array = pa.array(stamps, pa.int64())
    return "t_ns", array.dictionary_encode() if kind == "dictionary" else array


def rate_array(rng, values):
    """Return a column of rates of some Arrow type."""
    kind = rng.choice(
        ("float64", "float64", "float32", "float16", "int32", "int8", "decimal", "dictionary")
    )
    if kind == "decimal":
        return pa.array([Decimal(repr(round(x, 9))) for x in values], pa.decimal128(20, 9))
    if kind == "dictionary":
        return pa.array(values).dictionary_encode()
    if kind.startswith("int"):
        return pa.array([round(9 * x) for x in values], kind)
    return pa.array(np.asarray(values, kind))


def arrow_log(rng, folder):
    """Write a Parquet or Feather file of some types and layout; read it with pyarrow."""
    stamps, rates = samples(rng)
    time, array = time_array(rng, stamps)
    columns = {time: array}
    columns |= {name: rate_array(rng, [rate[k] for rate in rates]) for k, name in enumerate(NAMES)}
    if rng.random() < 0.3:
        columns["imu"] = pa.StructArray.from_arrays([columns.pop(name) for name in NAMES], NAMES)
    for name, value in {"note": "n", "list": [1, 2], "nested": {"a": 1}}.items():
        columns[name] = pa.array([value] * len(stamps))
    table = pa.table({name: columns[name] for name in rng.sample(list(columns), len(columns))})
    if rng.random() < 0.5:
        middle = rng.randrange(len(stamps) + 1)
        empty = table.slice(0, 0)
        table = pa.concat_tables([empty, table.slice(0, middle), empty, table.slice(middle)])
    if rng.random() < 0.5:
        path = folder / "log.parquet"
        parquet.write_table(
            table,
            path,
            compression=rng.choice(("none", "snappy", "gzip", "brotli", "lz4", "zstd")),
            row_group_size=rng.choice((1, 7, 1000)),
            use_dictionary=rng.choice((True, False, ["note"])),
            data_page_version=rng.choice(("1.0", "2.0")),
            data_page_size=rng.choice((64, 1 << 20)),
            store_schema=rng.random() < 0.7,
            write_statistics=rng.random() < 0.7,
            write_page_checksum=rng.random() < 0.5,
            version=rng.choice(("2.4", "2.6")),
        )
        return path, {}, arrow_samples(parquet.read_table(path), time), True
    path = folder / "log.feather"
    how = {"compression": rng.choice(("uncompressed", "lz4", "zstd"))}
    feather.write_feather(table, path, chunksize=rng.choice((1, 7, 1000)), **how)
    return path, {}, arrow_samples(feather.read_table(path), time), True


def arrow_samples(table, time):
    """Return the samples of a table, computed with exact numbers."""
    column, unit = table[time], time.removeprefix("t_")
    if pa.types.is_timestamp(column.type):
        column, unit = column.cast(pa.int64()), column.type.unit
    stamps = [int(value * (10**9 // PER_SECOND[unit])) for value in column.to_pylist()]
    if "imu" in table.column_names:
        rates = [[row[name] for name in NAMES] for row in table["imu"].to_pylist()]
    else:
        rates = zip(*(table[name].to_pylist() for name in NAMES), strict=True)
    return [(ns, tuple(map(float, rate))) for ns, rate in zip(stamps, rates, strict=True)]


def numpy_log(rng, folder):
    """Write records or columns of some types and orders; read them with NumPy."""
    stamps, rates = samples(rng)
    columns = {"t_ns": np.array(stamps, rng.choice("<>") + "i8")}
    for name, values in zip(AXES, 9 * np.array(rates).T, strict=True):
        kind = rng.choice("<>") + rng.choice(("f4", "f8", "f2", "i4", "i2"))
        columns[name] = values.astype(kind)
    columns["extra"] = np.zeros(len(stamps), rng.choice(("<u1", "S3", "<U2", "?", ">c16")))
    order = rng.sample(list(columns), len(columns))
    form = rng.choice(("records", "records", "matrix", "npz", "packed", "npz of records"))
    path = folder / ("log.npy" if form in ("records", "matrix") else "log.npz")
    if form == "matrix":
        matrix = np.stack([columns[name] for name in ("t_ns", *AXES)], axis=1)
        matrix[:, 0] = np.arange(len(stamps)) * 1e7
        matrix = matrix.astype(rng.choice(("<f8", ">f8")))
        np.save(path, matrix.copy(order=rng.choice("CF")))
        settings = {"time_col": "0", "rate_cols": ("1", "2", "3"), "rate_unit": "rad/s"}
        expected = [(int(t), tuple(rate)) for t, *rate in np.load(path).tolist()]
        return path, settings | {"time_unit": "ns"}, expected, True
    kinds = np.dtype([(n, columns[n].dtype) for n in order], align=rng.random() < 0.5)
    records = np.zeros(len(stamps), kinds)
    for name in order:
        records[name] = columns[name]
    if form == "records":
        np.save(path, records)
    elif form == "npz of records":
        np.savez(path, anything=records)
    else:
        save = np.savez_compressed if form == "packed" else np.savez
        save(path, **{name: columns[name] for name in order})
    read = np.load(path)
    read = read["anything"] if form == "npz of records" else read
    axes = [read[name].astype(float).tolist() for name in AXES]
    return path, {}, list(zip(read["t_ns"].tolist(), zip(*axes, strict=True), strict=True)), True


def jsonl_log(rng, folder):
    """Write JSON Lines of some spacing and nesting; read them with json."""
    path = folder / f"log.{rng.choice(('jsonl', 'ndjson', 'json'))}"
    stamps, rates = samples(rng)
    nested = rng.random() < 0.5
    separators = rng.choice(((",", ":"), (", ", ": "), (" ,\t", "  : ")))
    end = rng.choice(("\n", "\r\n", "\n\n", " \n"))
    sort = rng.random() < 0.3
    lines = []
    rates = [[round(x) if rng.random() < 0.1 else x for x in rate] for rate in rates]
    for ns, rate in zip(stamps, rates, strict=True):
        if nested:
            stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
            row = {
                "header": {"seq": 1, "stamp": stamp, "frame_id": 'é "[{\\'},
                "list": [1, [2, {"z": None}]],
                "angular_velocity": dict(zip("xyz", rate, strict=True)),
            }
        else:
            row = dict(zip(("t_ns", *AXES), (ns, *rate), strict=True))
            row |= rng.choice(({}, {"note": None}, {"note": "t_ns"}, {"more": {"wx": 3}}))
        if rng.random() < 0.3:
            row = dict(reversed(row.items()))
        ascii_ = rng.random() < 0.5
        lines.append(json.dumps(row, separators=separators, sort_keys=sort, ensure_ascii=ascii_))
    content = end.join(lines) + rng.choice(("", end))
    path.write_bytes(rng.choice((b"", b"", b"\xef\xbb\xbf")) + content.encode())
    expected = []
    for line in filter(str.strip, path.read_text("utf-8-sig").splitlines()):
        row = json.loads(line)
        if nested:
            stamp, rate = row["header"]["stamp"], row["angular_velocity"]
            t_ns, rate = stamp["sec"] * 10**9 + stamp["nanosec"], [rate[a] for a in "xyz"]
        else:
            t_ns, rate = row["t_ns"], [row[name] for name in AXES]
        expected.append((t_ns, tuple(map(float, rate))))
    return path, {}, expected, True


TABLE_LOGS = {"csv": csv_log, "arrow": arrow_log, "numpy": numpy_log, "jsonl": jsonl_log}
