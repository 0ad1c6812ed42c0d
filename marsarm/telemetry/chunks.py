"""Messages in the chunks of a log: decompressed, checked by CRC, and located through the message index."""

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

from marsarm.telemetry.mcap_reader import (
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
"""Head of a message record; the message follows. `length` counts the bytes after the field itself."""
MESSAGE_OVERHEAD: Final = MESSAGE_DTYPE.itemsize - RECORD_HEAD.size
"""Bytes of the head that `length` includes."""

BATCH_BYTES: Final = 1 << 20
"""Bytes that are decompressed together; they fit the cache of a processor."""

Offsets = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class MessageBatch:
    """Messages of some chunks, in the order of the file."""

    data: NDArray[np.uint8]
    """Decompressed chunks, one after the other, shape (bytes,)."""
    heads: NDArray[np.void]
    """Heads of the messages, type MESSAGE_DTYPE, shape (n,)."""
    starts: Offsets
    """Byte in `data` where each head begins, shape (n,)."""
    channels: dict[int, Channel]
    """Channels that these chunks declare, by number."""


def decompress_chunk(data: bytes, chunk: ChunkLocation, decompressor: zstandard.ZstdDecompressor) -> bytes:
    """Decompress the records of a chunk and check their CRC.

    Raises:
        ZstdError, ValueError: the data is damaged.
    """
    packed = memoryview(data)[chunk.begin : chunk.end]
    # Checked first: a damaged size could reserve any amount of memory.
    if zstandard.frame_content_size(packed) != chunk.size:
        raise ValueError(f"a chunk claims {chunk.size} bytes; its data does not")
    plain = decompressor.decompress(packed, allow_extra_data=False)
    if zlib.crc32(plain) != chunk.crc32:
        raise ValueError("a chunk does not match its CRC")
    return plain


def read_batches(
    data: bytes, chunks: Sequence[ChunkLocation], indexes: Sequence[Sequence[Span]]
) -> list[MessageBatch]:
    """Decompress chunks in batches of about BATCH_BYTES.

    Args:
        data: Content of the file.
        chunks: Chunks to read, in the order of the file.
        indexes: Message indexes of each chunk; an index that proves wrong is not used.

    Raises:
        CorruptData: a chunk does not match its CRC, or does not consist of records.
    """
    decompressor, found, begin, size = zstandard.ZstdDecompressor(), [], 0, 0
    for k, chunk in enumerate(chunks):
        size += chunk.size
        if size >= BATCH_BYTES or k == len(chunks) - 1:
            found.append(read_batch(data, chunks[begin : k + 1], indexes[begin : k + 1], decompressor))
            begin, size = k + 1, 0
    return found


def read_batch(
    data: bytes,
    chunks: Sequence[ChunkLocation],
    indexes: Sequence[Sequence[Span]],
    decompressor: zstandard.ZstdDecompressor,
) -> MessageBatch:
    """Read the messages of some chunks as one batch; arguments and errors as in `read_batches`."""
    plain, channels, at = [], dict[int, Channel](), 0
    try:
        for chunk in chunks:
            at = chunk.at
            plain.append(decompress_chunk(data, chunk, decompressor))
        begins = np.cumsum([0, *map(len, plain)])
        buffer = np.frombuffer(b"".join(plain), np.uint8)
        starts, heads, is_tiled = locate_by_index(data, indexes, buffer, begins)
        walked = []
        for k in np.flatnonzero(~is_tiled).tolist():
            at = chunks[k].at
            walked += [int(begins[k]) + start for start in walk_records(plain[k], channels)]
    except PARSE_ERRORS as error:
        raise CorruptData(str(error) or type(error).__name__, at) from error
    if walked:
        starts = np.sort(np.concatenate([starts, np.array(walked, np.int64)]))
        heads = heads_at(buffer, starts)
    return MessageBatch(buffer, heads, starts, channels)


def heads_at(buffer: NDArray[np.uint8], starts: Offsets) -> NDArray[np.void]:
    """Read the heads of messages.

    Args:
        buffer: Decompressed chunks, shape (bytes,).
        starts: Byte where each head begins, shape (n,).

    Returns:
        Heads of type MESSAGE_DTYPE, shape (n,).
    """
    if not len(starts):
        return np.zeros(0, MESSAGE_DTYPE)
    return sliding_window_view(buffer, MESSAGE_DTYPE.itemsize)[starts].view(MESSAGE_DTYPE)[:, 0]


def walk_records(plain: bytes, channels: dict[int, Channel]) -> list[int]:
    """Find the messages of a chunk by reading record after record.

    Args:
        plain: Decompressed chunk.
        channels: Dictionary that receives the channels of the chunk.

    Returns:
        Byte where each message begins.

    Raises:
        ValueError: the records do not fill the chunk.
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
    """Find the messages of chunks through their message indexes, and check each index against the records.

    A chunk is tiled if every record is a message and begins where the one before it ends. Its index is then
    right, even if the file is damaged elsewhere.

    Args:
        data: Content of the file.
        indexes: Spans of index entries in `data`, for each of the k chunks.
        buffer: Decompressed chunks, shape (bytes,).
        begins: Byte where each chunk begins in `buffer`, then the end of the last, shape (k + 1,).

    Returns:
        Byte where each message of a tiled chunk begins, rising, shape (n,); their heads, shape (n,); whether
        each chunk is tiled, shape (k,).
    """
    sizes = [[end - begin for begin, end in of_chunk] for of_chunk in indexes]
    usable = [k for k, of_chunk in enumerate(sizes) if not any(size % 16 for size in of_chunk)]
    view = memoryview(data)
    pairs = b"".join(view[begin:end] for k in usable for begin, end in indexes[k])
    chunk = np.repeat(usable, [sum(sizes[k]) // 16 for k in usable]).astype(np.int64)
    offset = np.frombuffer(pairs, "<u8")[1::2]
    is_tiled = np.diff(begins) > MESSAGE_DTYPE.itemsize
    room = np.diff(begins) - MESSAGE_DTYPE.itemsize
    is_tiled[chunk[offset > room.clip(0)[chunk].astype(np.uint64)]] = False
    is_kept = is_tiled[chunk]
    chunk = chunk[is_kept]
    starts = np.sort(begins[chunk] + offset[is_kept].astype(np.int64))
    heads = heads_at(buffer, starts)
    # A damaged length may be any number. Unsigned sums wrap around, so only the true length matches.
    ends = starts.astype(np.uint64) + heads["length"] + np.uint64(RECORD_HEAD.size)
    is_first, is_last = np.diff(chunk, prepend=-1) != 0, np.diff(chunk, append=-1) != 0
    expected = np.where(is_last, begins[chunk + 1], np.roll(starts, -1)).astype(np.uint64)
    is_consistent = (
        (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] >= MESSAGE_OVERHEAD) & (ends == expected)
    )
    is_consistent &= ~is_first | (starts == begins[chunk])
    is_tiled[chunk[~is_consistent]] = False
    is_tiled[np.bincount(chunk, minlength=len(indexes)) == 0] = False
    is_sure = is_tiled[chunk]
    return (starts, heads, is_tiled) if is_sure.all() else (starts[is_sure], heads[is_sure], is_tiled)
