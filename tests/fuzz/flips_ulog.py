"""Small ULog files, and the structure of their records."""

import struct
from functools import cache

from fuzz.flips import SAMPLES
from make.ulog import added, data, header, record, walk

from quatprop.readers.containers.ulog import SYNC

KINDS = {
    "B": "flags", "I": "information", "M": "information", "F": "format", "P": "parameter",
    "A": "subscription", "R": "end of a subscription", "D": "message", "L": "logged text",
    "S": "synchronisation", "O": "dropout",
}  # fmt: skip
TITLE = "ULog"
COUNTED = ()
OPTIONS = {"two instances": {"topic": "sensor_gyro/0"}}
"""Of reading, for layouts with several topics of rates."""


@cache
def layouts():
    """Return files of one topic, with others between, of two instances, appended to, and late."""
    messages = [_message(1, k) for k in range(SAMPLES)]
    begin = header() + added("sensor_gyro", 0, 1)
    baro = record(b"F", b"sensor_baro:uint64_t timestamp;float pressure;uint8_t[4] _padding0;")
    others = [
        record(b"S", SYNC),
        record(b"L", b"6" + struct.pack("<Q", 7) + b"takeoff"),
        record(b"P", b"\x0cfloat MC_PIT" + bytes(4)),
        record(b"D", struct.pack("<HQf", 2, 5, 1.0)),
    ]
    with_others = header() + baro + added("sensor_gyro", 0, 1) + added("sensor_baro", 0, 2)
    instances = begin + added("sensor_gyro", 1, 3)
    late = [added("sensor_baro", 0, 2), others[3], record(b"R", struct.pack("<H", 2)), others[0]]
    appended = with_others + b"".join(messages[:150])
    flags = struct.pack("<8s8s3Q", bytes(8), b"\x01" + bytes(7), len(appended), 0, 0)
    appended = appended.replace(bytes(40), flags, 1)
    return {
        "one topic": begin + b"".join(messages),
        "other records": with_others + _between(messages, others),
        "two instances": instances + _between(messages, [_message(3, 500)]),
        "appended": appended + b"".join(messages[150:]),
        "late subscription": header() + baro + added("sensor_gyro", 0, 1) + b"".join(
            [*messages[:100], *late, *messages[100:]]
        ),
    }  # fmt: skip


def _message(id_, k):
    stamp = 10_000 * (k + 1)
    return data("sensor_gyro", id_, timestamp=stamp + 9, timestamp_sample=stamp, x=float(k + 1))


def _between(messages, others):
    """Return messages with one of some others behind every tenth."""
    parts = []
    for k, message in enumerate(messages):
        parts += [message, others[k // 10 % len(others)]] if k % 10 == 9 else [message]
    return b"".join(parts)


UNNOTICED = {
    "format: definition": "a field of another name",
    "message: id of an instance": "a message of another instance of the topic",
    "subscription: instance": "the messages of another instance of the topic",
}


def heads(log):
    """Return what each byte is of the heads of records, and of what is not a value."""
    has_instances = b"A\x01\x03" in log
    names = {**dict.fromkeys(range(8), "magic"), **dict.fromkeys(range(8, 16), "start time")}
    for letter, begin, end in walk(log):
        kind = KINDS[letter.decode()]
        names.update(dict.fromkeys(range(begin - 3, begin - 1), f"{kind}: length"))
        names[begin - 1] = f"{kind}: kind"
        if kind not in {"information", "parameter", "logged text"}:
            number = "id of an instance" if has_instances else "id"
            what = {"format": "definition", "message": number}.get(kind, "content")
            last = begin + 2 if kind == "message" else end
            names.update(dict.fromkeys(range(begin, last), f"{kind}: {what}"))
        if kind == "subscription":
            names[begin] = "subscription: instance"
    return names
