"""PX4 ULog files, record by record, by the documented format."""

import struct

from make.px4_messages import DEFINITIONS

NUMBERS = {
    "uint64": ("uint64_t", "Q"), "uint32": ("uint32_t", "I"), "int32": ("int32_t", "i"),
    "uint8": ("uint8_t", "B"), "int8": ("int8_t", "b"), "int16": ("int16_t", "h"),
    "float32": ("float", "f"),
}  # fmt: skip


TOPICS = {
    "sensor_combined": "SensorCombined",
    "sensor_gyro": "SensorGyro",
    "sensor_gyro_fifo": "SensorGyroFifo",
    "vehicle_angular_velocity": "VehicleAngularVelocity",
    "vehicle_imu": "VehicleImu",
}


def record(kind, content):
    """Return one record."""
    return struct.pack("<Hc", len(content), kind) + content


def fields_of(topic):
    """Return names, ULog types, codes and lengths of the fields of a message."""
    for line in DEFINITIONS[TOPICS[topic]].splitlines():
        if "=" not in line:
            type_name, name = line.split()
            number, _, length = type_name.rstrip("]").partition("[")
            yield name, *NUMBERS[number], int(length or 0)


def header():
    """Return the beginning of a file with all definitions."""
    begin = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 123)
    begin += record(b"B", bytes(40))
    begin += record(b"I", b"\x0bchar[3] sysPX4")
    for topic in TOPICS:
        text = "".join(
            f"{kind}[{length}] {name};" if length else f"{kind} {name};"
            for name, kind, _, length in fields_of(topic)
        )
        # Padding at the end is part of the definition, not of the messages.
        begin += record(b"F", f"{topic}:{text}uint8_t[4] _padding0;".encode())
    return begin


def added(topic, instance, id_):
    """Return the record that begins a topic."""
    return record(b"A", struct.pack("<BH", instance, id_) + topic.encode())


def data(topic, id_, **values):
    """Return a message."""
    content = struct.pack("<H", id_)
    for name, _, code, length in fields_of(topic):
        value = values.get(name, [0] * length if length else 0)
        numbers = list(value) + [0] * (length - len(value)) if length else [value]
        content += struct.pack(f"<{len(numbers)}{code}", *numbers)
    return record(b"D", content)


def walk(content):
    """Yield kind, begin and end of what is in each record of a file."""
    at = 16
    while at < len(content):
        size, kind = struct.unpack_from("<Hc", content, at)
        at += 3 + size
        yield kind, at - size, at


def write(path, *records):
    """Write a file."""
    path.write_bytes(header() + b"".join(records))
    return path


def gyro(id_, stamps_us, scale=1.0):
    """Return messages of a gyroscope."""
    return [
        data("sensor_gyro", id_, timestamp=t + 9, timestamp_sample=t, x=scale * k, y=-k, z=0.5)
        for k, t in enumerate(stamps_us)
    ]
