"""Recovery: writes all undamaged messages of a damaged log to a new, complete log."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.writer import IndexType, Writer

from marsarm.telemetry.errors import LogNotReadable
from marsarm.telemetry.format import (
    CHANNELS_KEY,
    FORMAT,
    FORMAT_RECORD,
    HEADER_RECORD,
    end_metadata,
    header_crc32,
    version_problem,
)
from marsarm.telemetry.lost_messages import RECOVERED_RECORD, LostMessages, loss_metadata
from marsarm.telemetry.mcap_reader import PARSE_ERRORS
from marsarm.telemetry.read import parse_log, read_log_bytes
from marsarm.telemetry.salvage import SalvagedLog, salvage
from marsarm.telemetry.topic_arrays import decode_topics, known_topics
from simgap.common.files import atomic_write, check_distinct_files, check_output
from simgap.common.progress import Progress


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """Result of a recovery."""

    saved: Mapping[str, int]
    """Number of saved messages by topic."""
    lost: tuple[LostMessages, ...]
    """Losses of this recovery and of earlier ones."""
    header_lost: bool
    """True if versions, parameters and commands of the run are lost."""
    notes: tuple[str, ...] = ()
    """Sentences about parts that were left out, because they belong to another log, or were reordered."""


def recover(bad: Path, good: Path, progress: Progress) -> RecoveryReport:
    """Write the undamaged messages of one log to another.

    Messages are renumbered, so the new log is complete in itself. Metadata in it lists the losses. The new
    file appears only after it was read back without an error.

    Args:
        bad: Damaged log.
        good: New file.
        progress: Called for each chunk.

    Raises:
        LogNotReadable: `bad` cannot be read, or has no part of a marsarm log.
        LogDamaged: the undamaged parts do not form a log.
        BadOutput: `good` cannot be written.
        BadRequest: `good` and `bad` are the same file.
    """
    data = read_log_bytes(bad)
    check_distinct_files({"BAD": bad, "GOOD": check_output(good, (".mcap",), "GOOD")})
    progress(0, 1, "searching")
    found = salvage(data)
    _check_ours(bad, found)
    if not any(len(chunk.heads) for chunk in found.chunks):
        raise LogNotReadable(bad, "holds no undamaged message, only a header at most; nothing can be saved")
    lost = (*found.lost_before, *found.lost)
    with atomic_write(good, "GOOD") as file:
        saved, duplicates = _write(file, found, lost, progress)
        file.flush()
        parse_log(bad, Path(file.name).read_bytes())
    notes = (*found.notes, f"{duplicates} duplicate messages left out") if duplicates else found.notes
    return RecoveryReport(saved, lost, HEADER_RECORD not in found.metadata, notes)


def _check_ours(bad: Path, found: SalvagedLog) -> None:
    if problem := version_problem(found.metadata):
        raise LogNotReadable(bad, problem)
    if not found.chunks and HEADER_RECORD not in found.metadata:
        raise LogNotReadable(bad, "holds no undamaged part of a marsarm log; nothing can be saved")
    try:
        known = known_topics(found.metadata.get(HEADER_RECORD, {}), found.channels)
    except PARSE_ERRORS:
        known = {}
    if found.chunks and not known:
        raise LogNotReadable(bad, "nothing in it says what its messages mean; nothing can be saved")


def _write(
    file: BinaryIO, found: SalvagedLog, lost: tuple[LostMessages, ...], progress: Progress
) -> tuple[dict[str, int], int]:
    """Write all messages once; return their number by topic, and the number of duplicates left out."""
    numbers = {old: new for new, old in enumerate(sorted(found.channels), 1)}
    header = _renumber_topics(found.metadata.get(HEADER_RECORD, {}), numbers)
    # There are no attachments, and an empty index of them would point to nothing.
    indexes = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
    writer = Writer(file, chunk_size=1 << 30, index_types=indexes, enable_data_crcs=True)
    writer.start(profile="", library="marsarm")
    writer.add_metadata(FORMAT_RECORD, {"version": FORMAT, "header_crc32": header_crc32(header)})
    writer.add_metadata(HEADER_RECORD, header)
    writer.add_metadata(RECOVERED_RECORD, loss_metadata(lost))
    _register_topics(writer, found)
    counts: dict[int, int] = {}
    seen: dict[int, int] = {}
    duplicates = 0
    for k, chunk in enumerate(found.chunks):
        for number, sequence, time_ns, publish_ns, message in chunk.messages():
            if number not in numbers:
                continue
            if sequence <= seen.get(number, -1):
                duplicates += 1
            else:
                writer.add_message(numbers[number], time_ns, message, publish_ns, counts.get(number, 0))
                counts[number], seen[number] = counts.get(number, 0) + 1, sequence
        writer.flush()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself
        progress(k, len(found.chunks), "writing")
    for record in end_metadata(found.interrupted_by):
        writer.add_metadata(record.name, record.metadata)
    writer.finish()  # type: ignore[no-untyped-call]
    return {found.channels[number].topic: count for number, count in counts.items()}, duplicates


def _renumber_topics(header: Mapping[str, str], numbers: Mapping[int, int]) -> dict[str, str]:
    """Replace the numbers of the channels in the header by those of the new file."""
    if CHANNELS_KEY not in header:
        return dict(header)
    topics = decode_topics(header)
    kept = {
        one["topic"]: {**{name: value for name, value in one.items() if name != "topic"}, "id": numbers[old]}
        for old, one in topics.items()
        if old in numbers
    }
    return {**header, CHANNELS_KEY: json.dumps(kept)}


def _register_topics(writer: Writer, found: SalvagedLog) -> None:
    """Write schemas and channels, numbered from 1; a lost schema becomes 0, which means none in MCAP."""
    schemas = {
        number: writer.register_schema(schema.name, schema.encoding, schema.data)
        for number, schema in found.schemas.items()
    }
    for _, channel in sorted(found.channels.items()):
        writer.register_channel(
            channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
        )
