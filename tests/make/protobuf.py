"""Protobuf messages and the descriptors that define them."""

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

FIELD = descriptor_pb2.FieldDescriptorProto


DOUBLE, FLOAT, STRING, MESSAGE, UINT64 = (
    FIELD.TYPE_DOUBLE, FIELD.TYPE_FLOAT, FIELD.TYPE_STRING, FIELD.TYPE_MESSAGE, FIELD.TYPE_UINT64,
)  # fmt: skip


STAMP = ".google.protobuf.Timestamp"


def file_of(name, messages, imports=()):
    """Return a file descriptor; fields are names with a number, or with a type."""
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package=name, syntax="proto3")
    file.dependency.extend(imports)
    for message, fields in messages.items():
        made = file.message_type.add(name=message)
        for number, (field, kind) in enumerate(fields.items(), 1):
            repeated = field.endswith("*")
            made.field.add(
                name=field.rstrip("*"),
                number=number,
                label=FIELD.LABEL_REPEATED if repeated else FIELD.LABEL_OPTIONAL,
                **(
                    {"type": MESSAGE, "type_name": kind}
                    if isinstance(kind, str)
                    else {"type": kind}
                ),
            )
    return file


def stamp_file():
    """Return the file that defines a time stamp."""
    file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(file)
    return file


FOXGLOVE = file_of(
    "foxglove",
    {
        "Vector3": dict.fromkeys("xyz", DOUBLE),
        "Quaternion": dict.fromkeys("xyzw", DOUBLE),
        "Pose": {"position": ".foxglove.Vector3", "orientation": ".foxglove.Quaternion"},
        "Odometry": {
            "timestamp": STAMP, "frame_id": STRING, "body_frame_id": STRING,
            "pose": ".foxglove.Pose", "linear_velocity": ".foxglove.Vector3",
            "angular_velocity": ".foxglove.Vector3",
        },
    },
    ["google/protobuf/timestamp.proto"],
)  # fmt: skip


def described(*files):
    """Return a set of descriptors; what is imported comes last, as some writers have it."""
    return descriptor_pb2.FileDescriptorSet(file=files).SerializeToString()


def made(type_name, *files):
    """Return the class of a message."""
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(files):
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(type_name))
