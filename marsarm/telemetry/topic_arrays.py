"""Conversion of messages to numpy arrays by topic, with checks of length, order and completeness."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.records import Channel
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from marsarm.telemetry.chunks import MESSAGE_DTYPE, MESSAGE_OVERHEAD, MessageBatch
from marsarm.telemetry.format import (
    CHANNELS_KEY,
    COMMAND_TOPIC,
    DERIVED_KEY,
    EVR_TOPIC,
    LAYOUT_KEY,
    TRUTH_KEY,
)
from marsarm.telemetry.schema import Layout


@dataclass(frozen=True, slots=True)
class KnownTopic:
    """Flight channel; the layout is None for EVRs and commands."""

    topic: str
    layout: Layout | None
    is_truth: bool


def decode_topics(header: Mapping[str, str]) -> dict[int, dict[str, Any]]:
    """Return the description of each channel in a header, by number; empty if the header has none.

    Raises:
        KeyError, TypeError, AttributeError, ValueError: the header is damaged.
    """
    topics = json.loads(header.get(CHANNELS_KEY, "{}"))
    return {int(about["id"]): {**about, "topic": topic} for topic, about in topics.items()}


def known_topics(header: Mapping[str, str], records: Mapping[int, Channel]) -> dict[int, KnownTopic]:
    """Return the flight channels, from the header, or else from the channel records.

    Channels of other programs, and channels that are derived for other tools, are left out.
    """
    topics = decode_topics(header) or {number: _topic_document(one) for number, one in records.items()}
    return {
        number: KnownTopic(one["topic"], _parse_layout(one["layout"]), bool(one["truth"]))
        for number, one in topics.items()
        if one["topic"] in (EVR_TOPIC, COMMAND_TOPIC) or (one["layout"] is not None and not one["derived"])
    }


def _topic_document(channel: Channel) -> dict[str, Any]:
    """Describe a channel from its record, as a header does."""
    layout = channel.metadata.get(LAYOUT_KEY)
    return {
        "topic": channel.topic,
        "layout": None if layout is None else json.loads(layout),
        "truth": TRUTH_KEY in channel.metadata,
        "derived": DERIVED_KEY in channel.metadata,
    }


def _parse_layout(rows: Any) -> Layout | None:
    return None if rows is None else Layout.from_json(json.dumps(rows))


BatchRows = Sequence[NDArray[np.int64]]
"""Rows of the messages of a channel in each batch, shape (n,)."""


def rows_of(batches: Sequence[MessageBatch], channel_id: int) -> BatchRows:
    """Find the messages of a channel in each batch."""
    return [np.flatnonzero(batch.heads["channel"] == channel_id) for batch in batches]


def heads_of(batches: Sequence[MessageBatch], rows: BatchRows) -> NDArray[np.void]:
    """Return the heads of messages, type MESSAGE_DTYPE, shape (n,)."""
    found = [batch.heads[of_batch] for batch, of_batch in zip(batches, rows, strict=True)]
    return np.concatenate([np.zeros(0, MESSAGE_DTYPE), *found])


def select_rows(rows: BatchRows, is_chosen: NDArray[np.bool_]) -> BatchRows:
    """Select messages; `is_chosen` has shape (n,) over all batches."""
    of_batch = np.split(is_chosen, np.cumsum([len(one) for one in rows])[:-1])
    return [one[chosen] for one, chosen in zip(rows, of_batch, strict=True)]


def check_complete(topic: str, heads: NDArray[np.void], from_start: bool) -> None:
    """Check that sequence numbers are consecutive, from 0 if `from_start`.

    Raises:
        ValueError: a message is missing or out of order.
    """
    sequence = heads["sequence"].astype(np.int64)
    first = 0 if from_start or not len(sequence) else int(sequence[0])
    if not np.array_equal(sequence, np.arange(first, first + len(sequence))):
        raise ValueError(f"messages of {topic} are missing or out of order")


def check_order(topic: str, time_ns: NDArray[np.uint64], one_a_cycle: bool) -> None:
    """Check the order of log times, shape (n,); with `one_a_cycle` they must rise strictly.

    Raises:
        ValueError: a time is before the previous one, or equal to it.
    """
    for k in np.flatnonzero(time_ns[1:] <= time_ns[:-1]) + 1:
        if time_ns[k] < time_ns[k - 1]:
            raise ValueError(
                f"message {k} of {topic}, at {time_ns[k] / 1e9:.6f} s, comes after one of "
                f"{time_ns[k - 1] / 1e9:.6f} s; times must not go back"
            )
        if one_a_cycle:
            raise ValueError(
                f"messages {k - 1} and {k} of {topic} are both of {time_ns[k] / 1e9:.6f} s; "
                "a cycle has one of each"
            )


def packets_of(
    batches: Sequence[MessageBatch], rows: BatchRows, topic: str, layout: Layout
) -> NDArray[np.void]:
    """Copy messages to one read-only array of the type of the layout, shape (n,).

    Raises:
        ValueError: a message has another length than the layout.
    """
    dtype = layout.dtype
    # Checked first: a damaged layout could reserve any amount of memory.
    lengths = np.concatenate([batch.heads["length"][one] for batch, one in zip(batches, rows, strict=True)])
    if (lengths != MESSAGE_OVERHEAD + dtype.itemsize).any():
        raise ValueError(f"a message of {topic} is not {dtype.itemsize} bytes long")
    packets = np.empty(len(lengths), dtype)
    raw, done = packets.view(np.uint8).reshape(len(packets), dtype.itemsize), 0
    for batch, one in zip(batches, rows, strict=True):
        if len(one):
            windows = sliding_window_view(batch.data, dtype.itemsize)
            raw[done : done + len(one)] = windows[batch.starts[one] + MESSAGE_DTYPE.itemsize]
            done += len(one)
    packets.flags.writeable = False
    return packets


def bodies_of(batches: Sequence[MessageBatch], rows: BatchRows) -> list[bytes]:
    """Return the bodies of messages."""
    bodies = []
    for batch, of_batch in zip(batches, rows, strict=True):
        begins = batch.starts[of_batch] + MESSAGE_DTYPE.itemsize
        ends = begins + (batch.heads["length"][of_batch].astype(np.int64) - MESSAGE_OVERHEAD)
        bodies += [batch.data[b:e].tobytes() for b, e in zip(begins, ends, strict=True)]
    return bodies
