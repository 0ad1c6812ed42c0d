"""Seeded changes to a file's bytes, and to what is inside the chunks and the header of a log."""

import struct
import zlib
from collections.abc import Callable
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

from ground.telemetry.format import FORMAT, FORMAT_RECORD, HEADER_RECORD, header_crc32
from ground.telemetry.mcap_reader import CHUNK_HEAD, RECORD_HEAD, ChunkLocation, iter_records, parse_chunk

Random = np.random.Generator
NUMBERS: Final = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0xFFFF,
    0x7FFFFFFF,
    0xFFFFFFFF,
    1 << 40,
    (1 << 63) - 1,
    (1 << 64) - 1,
)
"""What lengths and offsets break on."""
LONGEST: Final = 1 << 20


def place(random: Random, data: bytes) -> int:
    """Somewhere in the data, most often near its beginning or its end."""
    near = int(random.integers(64))
    return int(random.choice((int(random.integers(len(data) + 1)), near, len(data) - near)))


def flip(random: Random, data: bytearray) -> None:
    """Change some bits."""
    for _ in range(int(random.integers(1, 5))):
        if data:
            data[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))


def number(random: Random, data: bytearray) -> None:
    """Put a number where one may have been."""
    size = int(random.choice((1, 2, 4, 8)))
    value = int(NUMBERS[int(random.integers(len(NUMBERS)))]) & ((1 << 8 * size) - 1)
    at = max(0, place(random, data))
    data[at : at + size] = value.to_bytes(size, "little")


def cut(random: Random, data: bytearray) -> None:
    """Take a piece out, or all from some place on."""
    at = max(0, place(random, data))
    del data[at : at + int(random.integers(1, 256)) if random.random() < 0.7 else None]


def repeat(random: Random, data: bytearray) -> None:
    """Put a piece in again somewhere else."""
    if len(data) < LONGEST:
        at, to = max(0, place(random, data)), max(0, place(random, data))
        data[to:to] = data[at : at + int(random.integers(1, 4096))]


def noise(random: Random, data: bytearray) -> None:
    """Write noise over a piece."""
    at = max(0, place(random, data))
    data[at : at + 16] = random.bytes(int(random.integers(1, 32)))


PLAIN: Final[tuple[Callable[[Random, bytearray], None], ...]] = (flip, number, cut, repeat, noise)


def changed(random: Random, data: bytes) -> bytes:
    """The bytes with some changes of any kind."""
    out = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        PLAIN[int(random.integers(len(PLAIN)))](random, out)
    return bytes(out)


def changed_inside(random: Random, data: bytes) -> bytes:
    """A log with changes in the records of a chunk, or in its header, and with CRCs that fit them."""
    chunks, metadata = parts(data)
    if not chunks or random.random() < 0.2:
        return with_header(random, data, metadata)
    chunk = chunks[int(random.integers(len(chunks)))]
    try:
        plain = zstandard.ZstdDecompressor().decompress(data[chunk.begin : chunk.end])
    except zstandard.ZstdError:
        return changed(random, data)
    return data[: chunk.at] + packed(changed(random, plain), chunk) + data[chunk.end :]


def parts(data: bytes) -> tuple[list[ChunkLocation], dict[str, tuple[int, int]]]:
    """Chunks, and where the format and header records begin and end, as far as they can be told."""
    chunks, metadata = [], {}
    for at, opcode, body in iter_records(data, len(MCAP0_MAGIC)):
        try:
            if opcode == 6:
                chunks.append(parse_chunk(data, at, len(body)))
        except (ValueError, struct.error):
            continue
        for name in (FORMAT_RECORD, HEADER_RECORD):
            if opcode == 12 and bytes(body[4 : 4 + len(name)]) == name.encode():
                metadata[name] = (at, at + RECORD_HEAD.size + len(body))
    return chunks, metadata


def packed(plain: bytes, like: ChunkLocation) -> bytes:
    """A chunk record of these records, at the times of another."""
    inner = zstandard.ZstdCompressor().compress(plain)
    head = CHUNK_HEAD.pack(like.first_ns, like.last_ns, len(plain), zlib.crc32(plain), 4, b"zstd", len(inner))
    return RECORD_HEAD.pack(6, len(head) + len(inner)) + head + inner


def with_header(random: Random, data: bytes, metadata: dict[str, tuple[int, int]]) -> bytes:
    """The log with changed texts in its header, whose CRC fits."""
    if len(metadata) < 2:
        return changed(random, data)
    begin, (header_at, end) = metadata[FORMAT_RECORD][0], metadata[HEADER_RECORD]
    text = bytes(data[header_at:end]).decode("latin-1")
    names = [name for name in ("channels", "seed", "request", "params") if name in text] or ["channels"]
    name = names[int(random.integers(len(names)))]
    old = text.partition(name)[2][4:]
    header = {name: changed(random, old.encode()).decode("latin-1")}
    builder = RecordBuilder()
    Metadata(name=FORMAT_RECORD, metadata={"version": FORMAT, "header_crc32": header_crc32(header)}).write(
        builder
    )
    Metadata(name=HEADER_RECORD, metadata=header).write(builder)
    return data[:begin] + builder.end() + data[end:]
