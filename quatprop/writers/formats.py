"""The table of output formats, and what each can store."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base.errors import OutputError, UsageError
from quatprop.base.places import is_address, is_stdout, is_stream, without_secret
from quatprop.base.text import Remark, Setting, listed, quoted
from quatprop.stores.kinds import READERS, TEXT_KINDS
from quatprop.stores.objects import split_address

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from quatprop.kinematics.conventions import Layout


class Format(NamedTuple):
    """One row of :data:`WRITERS`.

    `suffixes`: file name suffixes of this format; ``""`` is a name without one
    `opener`: ``module:class`` of the writer, imported when it is needed. It is called with the
        target and, for columns, their names; for messages, a topic and a compression
    `columns`: whether it is a table of any columns
    `encodings`: encodings of its messages; empty for a format without messages
    `lists`: whether its columns can hold lists of numbers
    `layout`: the layout that the format prescribes; None if both are possible
    `is_text`: whether it may be written to stdout
    `comments`: whether it has comments, in which the provenance can be stored
    `has_fields`: whether columns have metadata of their own
    `keeps_provenance`: whether it can store the provenance other than in comments
    `compressions`: compressions of its content; the first is the default
    """

    suffixes: tuple[str, ...]
    opener: str
    columns: bool = False
    lists: bool = False
    encodings: tuple[str, ...] = ()
    layout: str | None = None
    has_stamps: bool = True
    is_text: bool = False
    comments: bool = False
    has_fields: bool = False
    keeps_provenance: bool = False
    compressions: tuple[str, ...] = ("none",)

    def load(self) -> Any:
        """Import and return the writer."""
        module, _, name = self.opener.partition(":")
        return getattr(import_module(f"quatprop.writers.{module}"), name)


def _text(suffixes: tuple[str, ...], opener: str, **options: Any) -> Format:
    """Return a text format."""
    return Format(suffixes, opener, is_text=True, **options)


def _messages(
    suffixes: tuple[str, ...], opener: str, encodings: tuple[str, ...], *compressions: str
) -> Format:
    """Return a format of messages, which have quaternions x, y, z, w."""
    return Format(
        suffixes,
        opener,
        encodings=encodings,
        layout="scalar-last",
        keeps_provenance=True,
        compressions=compressions,
    )


WRITERS: Mapping[str, Format] = {
    "csv": _text((".csv",), "text_tables:CsvTable", columns=True, comments=True),
    "tsv": _text((".tsv",), "text_tables:TsvTable", columns=True, comments=True),
    "jsonl": _text((".jsonl", ".ndjson"), "jsonl:JsonLinesTable", columns=True),
    "parquet": Format(
        (".parquet", ".pq"),
        "parquet:ParquetTable",
        columns=True,
        lists=True,
        has_fields=True,
        keeps_provenance=True,
        compressions=("zstd",),
    ),
    "feather": Format(
        (".feather", ".arrow"),
        "arrow:FeatherTable",
        columns=True,
        lists=True,
        has_fields=True,
        keeps_provenance=True,
    ),
    "npy": Format((".npy",), "npy:NpyTable", columns=True),
    "npz": Format((".npz",), "npy:NpzTable", columns=True, keeps_provenance=True),
    "tum": _text((".tum",), "trajectories:TumTable", layout="scalar-last", comments=True),
    "euroc": _text((), "trajectories:EurocTable", layout="scalar-first", comments=True),
    "kitti": _text((".kitti",), "trajectories:KittiTable", layout="scalar-first", has_stamps=False),
    "sto": _text((".sto",), "trajectories:StoTable", layout="scalar-first"),
    "mcap": _messages((".mcap",), "mcap:McapWriter", ("cdr", "protobuf"), "zstd", "lz4", "none"),
    "bag": _messages((".bag",), "rosbag1:BagWriter", ("ros1",), "none", "lz4", "bz2"),
    "rosbag2": _messages(("",), "rosbag2:SqliteBagWriter", ("cdr",), "none"),
    "rosbag2-mcap": _messages((), "rosbag2:McapBagWriter", ("cdr",), "zstd", "none"),
}
"""All output formats by kind; the kinds are the choices of the setting ``to``."""

GENERAL_KINDS = tuple(kind for kind, form in WRITERS.items() if form.columns or form.encodings)
"""The kinds that can store other series than attitudes."""

DEFAULT_LAYOUT = "scalar-first"


def layout_of(kind: str, layout: str | None = None) -> Layout:
    """Return the layout in which a kind of file is written.

    `layout`: the requested layout; None if none was requested
    """
    from quatprop.kinematics.conventions import layout_named

    prescribed = WRITERS[kind].layout
    if layout is None:
        return layout_named(prescribed or DEFAULT_LAYOUT)
    order = layout_named(layout)
    if prescribed is not None and order.name != prescribed:
        raise UsageError(
            f"{kind} is {prescribed} by its own definition, not {order.name}; omit "
            f"{Setting('layout')}",
        )
    return order


def kind_of(target: Path | str, kind: str | None = None, choices: Collection[str] = WRITERS) -> str:
    """Return the output kind: the given one, or that of the target's suffix if it is None."""
    if kind is not None:
        if kind not in WRITERS:
            raise OutputError(target, f"no output kind {quoted(kind)}; choose {'|'.join(choices)}")
        _refuse_suffix(target, kind)
        return kind
    if is_stdout(target) or is_stream(target):
        return "csv"
    suffix = _suffix(target)
    for name, form in WRITERS.items():
        if suffix in form.suffixes:
            return name
    suffixes = ", ".join(s for name in choices for s in WRITERS[name].suffixes if s)
    raise OutputError(
        without_secret(target),
        f"the suffix does not determine the output format; use one of {suffixes}, none for a "
        "ROS 2 bag "
        f"folder, or specify {Setting('to', '|'.join(choices))}",
    )


def _suffix(target: Path | str) -> str:
    """Return the suffix of a file or an address, in small letters."""
    name = split_address(str(target))[0] if is_address(target) else target
    return Path(name).suffix.lower()


@lru_cache(maxsize=8)
def _refuse_suffix(target: Path | str, kind: str) -> None:
    """Refuse the suffix of another format, which programs would take the file for.

    Text may have the suffix of any text, and a folder any name.
    """
    form, suffix = WRITERS[kind], _suffix(target)
    if suffix in form.suffixes or "" in form.suffixes or kind == "rosbag2-mcap":
        return
    suffixes = {name: row.suffixes for name, row in READERS.items()}
    suffixes |= {name: row.suffixes for name, row in WRITERS.items()}
    others = [name for name, known in suffixes.items() if suffix and suffix in known]
    if others and not (form.is_text and {*others} & {*TEXT_KINDS, "tsv", "jsonl"}):
        own = form.suffixes[0] if form.suffixes else ".txt"
        omit = f", or omit {Setting('to')}" if others[0] in WRITERS else ""
        raise OutputError(
            without_secret(target),
            f"the suffix {suffix} is that of {others[0]}, and {Setting('to', kind)} writes {kind}; "
            f"name the file *{own}{omit}",
        )


def format_remarks(
    target: Path | str,
    kind: str | None = None,
    *,
    positions_lost: bool = False,
    sigma_lost: bool = False,
) -> Iterator[Remark]:
    """Yield remarks on the data that a format cannot store.

    `positions_lost`: whether the source has positions and the output none
    `sigma_lost`: whether the source has standard deviations or covariances and the output none
    """
    kind = kind_of(target, kind)
    if not WRITERS[kind].has_stamps:
        yield Remark("stamps-lost", f"the timestamps are not kept: {kind} has no place for them")
    if positions_lost:
        yield Remark(
            "positions-lost",
            "the positions of the attitudes are not kept: the output has no place for them",
        )
    if sigma_lost:
        yield Remark(
            "sigma-lost",
            "the standard deviations or covariances of the attitudes are not kept: only tables and "
            "messages with a covariance hold them, for Hamilton body-to-reference attitudes and "
            "axes that are at most permuted",
        )


def keeps_provenance(target: Path | str, kind: str | None = None, *, comment: bool = False) -> bool:
    """Return whether a file stores its provenance, in a comment or otherwise."""
    return comment or WRITERS[kind_of(target, kind)].keeps_provenance


# Message types in which attitudes can be written: types, topics, frames.
#
# A position or translation is zero if the attitudes have none. The message's frame is the reference
# frame; the child frame of a transform is the body, so that it maps body to reference as the
# attitude does, and so is the frame of an Imu. Covariances are about reference axes, as ROS defines
# them; zeros mean an unknown covariance, -1 an unknown value. All of these types define the
# quaternion as x, y, z, w: there is no other layout.


class MessageType(NamedTuple):
    """One row of :data:`MESSAGES`.

    `name`: full name of the type in ROS 2 or Foxglove's schemas
    `parts`: its fields in order: ``stamp``, ``frame``, ``child``, the number of elements ``count``,
        ``position`` and ``xyzw``, or a ``pose`` of both; the ``covariance`` of the orientation, or
        ``pose_covariance`` with it; ``rate``, ``acceleration`` and the covariance of each
    `topic`: its usual topic
    """

    name: str
    parts: tuple[str, ...]
    topic: str = "/attitude"

    @property
    def has_covariance(self) -> bool:
        """Whether it has a covariance of the orientation."""
        return not {"covariance", "pose_covariance"}.isdisjoint(self.parts)

    @property
    def is_ros(self) -> bool:
        """Whether it is a ROS message; otherwise it is one of Foxglove's own, in protobuf."""
        return "/" in self.name


MESSAGES: Mapping[str, MessageType] = {
    "QuaternionStamped": MessageType(
        "geometry_msgs/msg/QuaternionStamped", ("stamp", "frame", "xyzw")
    ),
    "PoseStamped": MessageType(
        "geometry_msgs/msg/PoseStamped", ("stamp", "frame", "position", "xyzw")
    ),
    "TFMessage": MessageType(
        "tf2_msgs/msg/TFMessage", ("count", "stamp", "frame", "child", "position", "xyzw"), "/tf"
    ),
    "PoseWithCovarianceStamped": MessageType(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        ("stamp", "frame", "position", "xyzw", "pose_covariance"),
    ),
    "Imu": MessageType(
        "sensor_msgs/msg/Imu",
        (
            *("stamp", "child", "xyzw", "covariance", "rate", "rate_covariance"),
            *("acceleration", "acceleration_covariance"),
        ),
    ),
    "FrameTransform": MessageType(
        "foxglove.FrameTransform", ("stamp", "frame", "child", "position", "xyzw"), "/tf"
    ),
    "PoseInFrame": MessageType("foxglove.PoseInFrame", ("stamp", "frame", "pose")),
}
"""All message types in which attitudes can be written."""


class Message(NamedTuple):
    """The type, topic and frames of attitude messages.

    `type`: a key of :data:`MESSAGES`, or the full name of a type
    `topic`: None is the usual one: ``/attitude``, or ``/tf`` for transforms
    `frame`: name of the reference frame
    `child`: name of the body frame
    """

    type: str = "QuaternionStamped"
    topic: str | None = None
    frame: str = "reference"
    child: str = "body"

    @property
    def definition(self) -> MessageType:
        """The type's row of :data:`MESSAGES`."""
        short = self.type.replace(".", "/").rpartition("/")[2]
        if short not in MESSAGES or self.type not in _names(MESSAGES[short].name):
            raise UsageError(
                f"attitudes cannot be written as {quoted(self.type)}; choose {listed(MESSAGES)}"
            )
        return MESSAGES[short]

    @property
    def topic_name(self) -> str:
        """The given or the usual topic."""
        return self.topic or self.definition.topic


def _names(name: str) -> tuple[str, ...]:
    """Return the short name, the full name and the ROS 1 name of a type."""
    package, _, short = name.replace(".", "/msg/").split("/")
    return short, name, f"{package}/{short}"
