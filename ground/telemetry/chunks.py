"""The messages in a log's chunks: unpacked, checked against their CRC, and found without walking each one."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ground.telemetry.mcap_reader import (
    PARSE_ERRORS,
    RECORD_HEAD,
    ChunkLocation,
    CorruptData,
    Span,
    iter_records,
    parse_channel,
)

MESSAGE_DTYPE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("time_ns", "<u8"),
        ("publish_ns", "<u8"),
    ]
)
"""How a message record begins; the message itself follows. `length` counts from behind itself."""
MESSAGE_OVERHEAD: Final = MESSAGE_DTYPE.itemsize - RECORD_HEAD.size
"""Bytes that `length` counts beside the message."""

BATCH_BYTES: Final = 1 << 20
"""Bytes that are taken apart at a time: what the processor keeps at hand."""

Offsets = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class MessageBatch:
    """All messages of some chunks in the order of the file.

    `heads` are of type HEAD, shape (n,), `starts` says where in `data` each of them begins.
    """

    data: NDArray[np.uint8]
    heads: NDArray[np.void]
    starts: Offsets
    channels: dict[int, Channel]
    """Those that these chunks declare."""


def decompress_chunk(data: bytes, place: ChunkLocation, decompressor: zstandard.ZstdDecompressor) -> bytes:
    """The records of a chunk, as its CRC has them; ZstdError or ValueError when they are not."""
    packed = memoryview(data)[place.begin : place.end]
    # Checked before memory is reserved for it.
    if zstandard.frame_content_size(packed) != place.size:
        raise ValueError(f"a chunk claims {place.size} bytes; its data does not")
    plain = decompressor.decompress(packed, allow_extra_data=False)
    if zlib.crc32(plain) != place.crc32:
        raise ValueError("a chunk does not match its CRC")
    return plain


def read_batches(
    data: bytes, places: Sequence[ChunkLocation], indexes: Sequence[Sequence[Span]]
) -> list[MessageBatch]:
    """Unpack chunks, some at a time; the `indexes` of their messages are tried and not trusted.

    Raises:
        NotAsWritten: a chunk does not match its CRC, or does not consist of records.
    """
    decompressor, found, begin, size = zstandard.ZstdDecompressor(), [], 0, 0
    for k, place in enumerate(places):
        size += place.size
        if size >= BATCH_BYTES or k == len(places) - 1:
            found.append(read_batch(data, places[begin : k + 1], indexes[begin : k + 1], decompressor))
            begin, size = k + 1, 0
    return found


def read_batch(
    data: bytes,
    places: Sequence[ChunkLocation],
    indexes: Sequence[Sequence[Span]],
    decompressor: zstandard.ZstdDecompressor,
) -> MessageBatch:
    """The messages of some chunks; errors as of `read_batches`."""
    plain, channels, at = [], dict[int, Channel](), 0
    try:
        for place in places:
            at = place.at
            plain.append(decompress_chunk(data, place, decompressor))
        begins = np.cumsum([0, *map(len, plain)])
        buffer = np.frombuffer(b"".join(plain), np.uint8)
        starts, heads, is_tiled = locate_by_index(data, indexes, buffer, begins)
        walked = []
        for k in np.flatnonzero(~is_tiled).tolist():
            at = places[k].at
            walked += [int(begins[k]) + start for start in walk_records(plain[k], channels)]
    except PARSE_ERRORS as error:
        raise CorruptData(str(error) or type(error).__name__, at) from error
    if walked:
        starts = np.sort(np.concatenate([starts, np.array(walked, np.int64)]))
        heads = heads_at(buffer, starts)
    return MessageBatch(buffer, heads, starts, channels)


def heads_at(buffer: NDArray[np.uint8], starts: Offsets) -> NDArray[np.void]:
    """The heads of the messages at these places, type HEAD, shape (n,)."""
    if not len(starts):
        return np.zeros(0, MESSAGE_DTYPE)
    return sliding_window_view(buffer, MESSAGE_DTYPE.itemsize)[starts].view(MESSAGE_DTYPE)[:, 0]


def walk_records(plain: bytes, channels: dict[int, Channel]) -> list[int]:
    """Where in a chunk its messages begin, one record after the other; its channels are added.

    ValueError when records do not fill the chunk.
    """
    starts, end = [], 0
    for at, opcode, body in iter_records(plain, 0):
        if opcode == Opcode.MESSAGE:
            if len(body) < MESSAGE_OVERHEAD:
                raise ValueError(f"a message record of {len(body)} bytes in a chunk")
            starts.append(at)
        elif opcode == Opcode.CHANNEL:
            channel = parse_channel(body)
            channels[channel.id] = channel
        elif opcode != Opcode.SCHEMA:
            raise ValueError(f"a record with opcode {opcode} in a chunk")
        end = at + RECORD_HEAD.size + len(body)
    if end != len(plain):
        raise ValueError("a chunk's last record runs past its end")
    return starts


def locate_by_index(
    data: bytes, indexes: Sequence[Sequence[Span]], buffer: NDArray[np.uint8], begins: Offsets
) -> tuple[Offsets, NDArray[np.void], NDArray[np.bool_]]:
    """Where messages begin by the indexes, in order, their heads, and which chunks they tile without a gap.

    `begins` has where each chunk begins, and the end of the last. In a chunk that is tiled every record is a
    message and begins where the one before it ends: then its index is right, whatever happened to the file.
    Of the other chunks nothing is said.
    """
    sizes = [[end - begin for begin, end in of_chunk] for of_chunk in indexes]
    whole = [k for k, of_chunk in enumerate(sizes) if not any(size % 16 for size in of_chunk)]
    view = memoryview(data)
    pairs = b"".join(view[begin:end] for k in whole for begin, end in indexes[k])
    chunk = np.repeat(whole, [sum(sizes[k]) // 16 for k in whole]).astype(np.int64)
    offset = np.frombuffer(pairs, "<u8")[1::2]
    is_tiled = np.diff(begins) > MESSAGE_DTYPE.itemsize
    room = np.diff(begins) - MESSAGE_DTYPE.itemsize
    is_tiled[chunk[offset > room.clip(0)[chunk].astype(np.uint64)]] = False
    kept = is_tiled[chunk]
    chunk = chunk[kept]
    starts = np.sort(begins[chunk] + offset[kept].astype(np.int64))
    heads = heads_at(buffer, starts)
    # The length in broken bytes may be anything; as unsigned numbers wrap around, none but the due one fits.
    ends = starts.astype(np.uint64) + heads["length"] + np.uint64(RECORD_HEAD.size)
    is_first, is_last = np.diff(chunk, prepend=-1) != 0, np.diff(chunk, append=-1) != 0
    due = np.where(is_last, begins[chunk + 1], np.roll(starts, -1)).astype(np.uint64)
    fits = (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] >= MESSAGE_OVERHEAD) & (ends == due)
    fits &= ~is_first | (starts == begins[chunk])
    is_tiled[chunk[~fits]] = False
    is_tiled[np.bincount(chunk, minlength=len(indexes)) == 0] = False
    sure = is_tiled[chunk]
    return (starts, heads, is_tiled) if sure.all() else (starts[sure], heads[sure], is_tiled)
