"""What an MCAP file holds and where: channels, schemas, and the regions with messages.

The summary at the end of the file is used if it is whole and agrees with the file. What it does
not cover, or the whole file if it has none, is scanned record by record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.mcap.definitions import read_definitions
from quatprop.containers.mcap.regions import Region, head_of
from quatprop.containers.mcap.scan import Scan
from quatprop.containers.mcap.summary import McapIndex, Summary, read_footer, read_summary

if TYPE_CHECKING:
    from quatprop.containers.file_source import FileSource

UNDEFINED = "no record defines it"
"""Why the messages of a channel are lost."""


def build_index(source: FileSource) -> McapIndex:
    """Build the index of a file that begins with :data:`MAGIC`.

    Parameters
    ----------
    source
        The file.

    Returns
    -------
    McapIndex
        What can be read of the file; `losses` says what cannot.
    """
    footer = read_footer(source)
    summary = Summary() if footer is None else read_summary(source, footer)
    end = source.size
    if footer is not None:
        end = footer.data_end if summary else footer.footer_start
    scan = _scanned(source, end, summary, is_closed=footer is not None)
    if footer is not None and not summary and scan.summary_start not in {0, footer.data_end}:
        # Bytes are missing, or too many, before the summary: it is not where the footer says.
        summary = read_summary(source, footer._replace(summary_start=scan.summary_start))
    index = summary.index
    index.regions, index.losses = scan.regions, scan.losses
    for opcode, content, place, first_id in scan.definitions.records:
        index.define(opcode, content, place, first_id)
    read_definitions(source, index, is_complete=summary.is_complete, is_closed=footer is not None)
    for region in index.regions:
        for id_ in region.own([id_ for id_ in region.ids if id_ not in index.channels]):
            index.losses.note(f"channel {id_}", UNDEFINED, region.count(id_), region.start)
    return index


def _scanned(source: FileSource, end: int, summary: Summary, *, is_closed: bool) -> Scan:
    """Scan the data section; what the summary says of its chunks is used where it fits the file."""
    usable = _usable_chunks(source, summary)
    scan = Scan(source, end, dict(usable), summary.attachments)
    scan.run(is_closed=is_closed)
    # Chunks that the scan did not come by, or records that do not begin where a chunk ends.
    if usable and (scan.indexed or scan.losses):
        scan = Scan(source, end, {}, summary.attachments)
        scan.run(is_closed=is_closed)
    if scan.losses:
        scan.add_lost(summary.chunks.values())
    return scan


def _usable_chunks(source: FileSource, summary: Summary) -> dict[int, Region]:
    """Return the chunks of the summary; none if bytes are missing or inserted before the last one.

    The definitions of the summary are used all the same.
    """
    if not summary.chunks:
        return {}
    last = summary.chunks[max(summary.chunks)]
    return summary.chunks if head_of(source, last) else {}
