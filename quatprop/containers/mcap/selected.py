"""Selected messages of a chunk that also holds others, such as the pictures of a camera.

The index says where every message begins. Of a large uncompressed chunk only the selected messages
are read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.byte_ranges import GAP, ranges_of, ranges_worth_reading
from quatprop.containers.mcap.messages import index_of, indexed_offsets
from quatprop.containers.mcap.regions import RECORD, Loaded, Region, head_of
from quatprop.containers.mcap.walk import MESSAGE_HEAD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.redefinitions import DefinitionCheck


def selected_messages(
    source: FileSource,
    region: Region,
    ids: Sequence[int],
    definitions: DefinitionCheck,
    whole: Loaded | None = None,
) -> Loaded | None:
    """Return copies of the messages of selected channels, without what lies between them.

    The heads of all records show that nothing is hidden between them, also where none is selected.

    Parameters
    ----------
    source
        The file.
    region
        A chunk.
    ids
        The channels.
    definitions
        Compares the definitions at the beginning of the chunk.
    whole
        All records; None to read only those that are selected, one byte range after another. The
        checksum is that of the whole chunk, so they are not checked against it.

    Returns
    -------
    Loaded or None
        None where the chunk is better read whole, since most of it is selected, or where its index
        and its records do not agree.

    Raises
    ------
    UnreadableDataError
        It redefines a selected channel.
    """
    index = index_of(source, region)
    selected = indexed_offsets(index, region, ids)
    others = indexed_offsets(index, region, [id_ for id_ in region.holds or () if id_ not in ids])
    if selected is None or others is None or not len(selected) + len(others):
        return None
    bounds = np.concatenate([selected, others, [len(whole.data) if whole else region.size]])
    order = np.argsort(bounds, kind="stable")
    begins, nexts = bounds[order[:-1]], bounds[order[1:]]
    is_wanted, lengths = order[:-1] < len(selected), nexts - begins
    read = (whole.data, begins) if whole else _read(source, region, begins, nexts, is_wanted)
    if read is None:
        return None
    records, begins = read
    leading = definitions.check_leading(records, region, ids)
    # Without a checksum there is nothing gained by reading all of a chunk that begins otherwise.
    is_right = not whole or begins[0] == leading
    if not is_right or not _are_as_listed(records, begins, lengths, ids, is_wanted):
        return None
    begins, lengths = begins[is_wanted], lengths[is_wanted]
    if not len(begins):
        return Loaded(offsets=begins, is_partial=whole is None)
    length = int(lengths[0])
    if np.count_nonzero(lengths != length):
        ranges = ranges_of(begins, begins + lengths, GAP)
        data = ranges.of(np.frombuffer(records, np.uint8))
        return Loaded(data.data, offsets=begins - ranges.moved, is_partial=whole is None)
    # Records of one length are copied in a single call.
    every = np.ndarray((len(records) - length + 1,), f"V{length}", records, 0, (1,))
    data = every[begins].view(np.uint8)
    return Loaded(data.data, offsets=np.arange(0, len(data), length), is_partial=whole is None)


def _are_as_listed(
    records: Buffer,
    begins: NDArray[np.int64],
    lengths: NDArray[np.int64],
    ids: Sequence[int],
    is_wanted: NDArray[np.bool_],
) -> bool:
    """Tell whether a record of each length, and of a listed channel, begins at each place."""
    places = len(records) - MESSAGE_HEAD.itemsize + 1
    if begins[-1] >= places:
        return False
    # A stride of 1 byte lets records begin anywhere.
    heads = np.ndarray((places,), MESSAGE_HEAD, records, strides=(1,))[begins]
    are_right = heads["length"] == lengths - RECORD.size
    are_right &= np.isin(heads["channel"], ids) == is_wanted
    return bool(are_right.all())


def _read(
    source: FileSource,
    region: Region,
    begins: NDArray[np.int64],
    nexts: NDArray[np.int64],
    is_wanted: NDArray[np.bool_],
) -> tuple[Buffer, NDArray[np.int64]] | None:
    """Read what precedes the first record, the wanted records, and the heads of the others.

    Returns
    -------
    tuple or None
        The bytes, and where in them the records begin; None where the whole chunk is as quick to
        read.
    """
    chunk = head_of(source, region)
    if chunk is None or not chunk.is_uncompressed or chunk.size != region.size:
        return None
    starts = np.concatenate([[0], begins])
    ends = np.where(is_wanted, nexts, np.minimum(begins + MESSAGE_HEAD.itemsize, nexts))
    ranges = ranges_worth_reading(starts, np.concatenate([begins[:1], ends]), chunk.size)
    if ranges is None:
        return None
    at = region.start + chunk.begin
    data = source.read_ranges((at + ranges.begins).tolist(), (at + ranges.ends).tolist())
    return (data, begins - ranges.moved[1:]) if len(data) == ranges.size else None
