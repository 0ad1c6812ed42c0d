"""Fast reader of a log's container: its records, each checked, and the messages of its chunks as arrays."""

import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from struct import error as StructError
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Metadata
from mcap.writer import MCAP0_MAGIC
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from marsarm.telemetry.log_writer import RECORD_HEAD

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
CHUNK_MARK: Final = b"\4\0\0\0zstd"
"""Name of the compression in the head of every chunk; the content of a chunk may hold it by chance."""
MARK_PLACE: Final = RECORD_HEAD.size + 28
"""Bytes of a chunk record before its mark."""
MAX_CHUNK_BYTES: Final = 1 << 26
"""Limit of the decompressed size that a chunk may claim; the recorder writes a million bytes at most."""
BATCH_BYTES: Final = 1 << 20
"""Bytes that are taken apart together; they fit the cache of a processor."""
PARSE_ERRORS: Final = (
    McapError,
    zstandard.ZstdError,
    StructError,
    ValueError,
    OverflowError,
    KeyError,
    TypeError,
    AttributeError,
)
"""Errors that damaged bytes raise in a parser; ValueError includes CRC, Unicode and JSON."""


class CorruptData(Exception):
    """Error of bytes at `offset` that changed after they were written."""

    def __init__(self, why: str, offset: int) -> None:
        super().__init__(why)
        self.why = why
        self.offset = offset


@dataclass(slots=True)
class McapContent:
    """Records of a log: metadata by name, and chunks with the byte where each begins."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    chunks: list[tuple[int, Chunk]] = field(default_factory=list)
    closed: bool = False
    """True if the log has the end of an MCAP file, and its data matches its CRC."""
    end: int = len(MCAP0_MAGIC)
    """Byte where its last complete record ends, or its data section, if it is closed."""
    crc_holds: bool = True
    """False if the data does not match its CRC; a chunk that does not match its own is a more exact place."""
    trailing_bytes: int = 0
    """Bytes after the end of a closed log; they are not part of it."""


def read_records(data: bytes) -> McapContent:
    """Split a log into records, to the end of its data or where it was cut; CorruptData if one is damaged."""
    found = McapContent()
    while found.end + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, found.end)
        begin = found.end + RECORD_HEAD.size
        if begin + length > len(data):
            break
        try:
            is_end = _add_record(found, opcode, data, begin, begin + length)
        except PARSE_ERRORS as error:
            raise CorruptData(str(error) or type(error).__name__, found.end) from error
        if is_end:
            _check_chunks(found, data, found.end)
            end = data.find(MCAP0_MAGIC, found.end) + len(MCAP0_MAGIC)
            found.closed = found.crc_holds and end >= len(MCAP0_MAGIC)
            found.trailing_bytes = len(data) - end if found.closed else 0
            return found
        found.end = begin + length
    _check_chunks(found, data, len(data))
    if data.endswith(MCAP0_MAGIC) and len(data) > len(MCAP0_MAGIC):
        raise CorruptData("it was closed, but a record runs past its end", found.end)
    return found


def _add_record(found: McapContent, opcode: int, data: bytes, begin: int, end: int) -> bool:
    """Parse a record, and return whether it ends the data; ValueError if it has no place in a log."""
    if opcode == Opcode.MESSAGE_INDEX and end - begin == 6 + int.from_bytes(
        data[begin + 2 : begin + 6], "little"
    ):
        return False
    stream = ReadDataStream(BytesIO(data[begin:end]))
    match opcode:
        case Opcode.CHUNK:
            found.chunks.append((found.end, Chunk.read(stream)))
        case Opcode.METADATA:
            record = Metadata.read(stream)
            found.metadata[record.name] = record.metadata
        case Opcode.HEADER if found.end == len(MCAP0_MAGIC):
            pass
        case Opcode.DATA_END:
            # In MCAP a CRC of 0 means none, but a log always has one.
            crc = zlib.crc32(memoryview(data)[: found.end])
            found.crc_holds = DataEnd.read(stream).data_section_crc == crc
            return True
        case _:
            raise ValueError(f"a record with opcode {opcode} and {end - begin} bytes has no place here")
    return False


def _check_chunks(found: McapContent, data: bytes, end: int) -> None:
    """Check that no chunk before `end` was passed over; only the start of one may follow the last record."""
    is_cut = data.startswith(CHUNK_MARK, found.end + MARK_PLACE) and end > found.end
    inside = sum(chunk.data.count(CHUNK_MARK) for _, chunk in found.chunks)  # the same bytes by chance
    if data.count(CHUNK_MARK, 0, end) != len(found.chunks) + inside + is_cut:
        raise CorruptData("a record is broken", found.end)
    if is_cut:
        with suppress(*PARSE_ERRORS):
            unpack_chunk(Chunk.read(ReadDataStream(BytesIO(data[found.end + RECORD_HEAD.size :]))))
            raise CorruptData("a record is broken", found.end)


def unpack_chunk(chunk: Chunk) -> bytes:
    """Decompress the records of a chunk and check their CRC; ZstdError or ValueError if they are damaged."""
    # Checked first: a damaged size could reserve any amount of memory.
    size = chunk.uncompressed_size
    if (
        chunk.compression != "zstd"
        or zstandard.frame_content_size(chunk.data) != size
        or size > MAX_CHUNK_BYTES
    ):
        raise ValueError(f"a chunk claims {size} bytes of {chunk.compression}; its data does not")
    plain = zstandard.ZstdDecompressor().decompress(chunk.data, allow_extra_data=False)
    if zlib.crc32(plain) != chunk.uncompressed_crc:
        raise ValueError("a chunk does not match its CRC")
    return plain


def message_starts(plain: bytes) -> list[int]:
    """Return where each message of a decompressed chunk begins; ValueError if records do not fill it."""
    starts, at = [], 0
    try:
        while at < len(plain):
            opcode, length = RECORD_HEAD.unpack_from(plain, at)
            if opcode == Opcode.MESSAGE:
                starts.append(at)
                if length < MESSAGE_OVERHEAD:
                    raise ValueError(f"a message record of {length} bytes in a chunk")
            elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                raise ValueError(f"a record with opcode {opcode} in a chunk")
            at += RECORD_HEAD.size + length
    except StructError as error:
        raise ValueError("a chunk ends within a record") from error
    if at != len(plain):
        raise ValueError("a chunk's last record runs past its end")
    return starts


@dataclass(frozen=True, slots=True, eq=False)
class MessageBatch:
    """Messages of some chunks, in the order of the file."""

    data: NDArray[np.uint8]
    """Decompressed chunks, one after the other, shape (bytes,)."""
    heads: NDArray[np.void]
    """Heads of the messages, type MESSAGE_DTYPE, shape (n,)."""
    starts: NDArray[np.int64]
    """Byte in `data` where each message begins, after its head, shape (n,)."""

    def bodies(self, rows: NDArray[np.int64]) -> list[bytes]:
        """Return the messages of some rows, shape (m,)."""
        begins = self.starts[rows]
        ends = begins + (self.heads["length"][rows].astype(np.int64) - MESSAGE_OVERHEAD)
        return [self.data[begin:end].tobytes() for begin, end in zip(begins, ends, strict=True)]

    def same_size(self, rows: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
        """Return the messages of rows, (m,), as bytes, (m, size); ValueError if one has another size."""
        # Checked first: a damaged layout could reserve any amount of memory.
        if (self.heads["length"][rows] != MESSAGE_OVERHEAD + size).any():
            raise ValueError(f"a message is not {size} bytes long")
        if not len(rows):
            return np.zeros((0, size), np.uint8)
        return sliding_window_view(self.data, size)[self.starts[rows]]


def read_batches(chunks: Sequence[tuple[int, Chunk]]) -> Iterator[MessageBatch]:
    """Yield messages of chunks in batches of about BATCH_BYTES; CorruptData if a chunk is damaged."""
    parts: list[bytes] = []
    starts: list[int] = []
    size = 0
    for at, chunk in chunks:
        try:
            plain = unpack_chunk(chunk)
            starts += [size + start for start in message_starts(plain)]
        except PARSE_ERRORS as error:
            raise CorruptData(str(error) or type(error).__name__, at) from error
        parts.append(plain)
        size += len(plain)
        if size >= BATCH_BYTES:
            yield _make_batch(b"".join(parts), starts)
            parts, starts, size = [], [], 0
    yield _make_batch(b"".join(parts), starts)


def _make_batch(plain: bytes, starts: Sequence[int]) -> MessageBatch:
    data, begins = np.frombuffer(plain, np.uint8), np.array(starts, np.int64)
    if not starts:  # there may be no bytes to slide over
        return MessageBatch(data, np.zeros(0, MESSAGE_DTYPE), begins)
    heads = sliding_window_view(data, MESSAGE_DTYPE.itemsize)[begins].view(MESSAGE_DTYPE)[:, 0]
    return MessageBatch(data, heads, begins + MESSAGE_DTYPE.itemsize)
