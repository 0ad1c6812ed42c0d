"""Speed of reading a log of ten minutes into numpy arrays, compared with the stock reader of MCAP."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from mcap.reader import make_reader

from marsarm.telemetry.read import read_log
from validation.sample_logs import record_log

CYCLES: Final = 38_400
"""Ten minutes at 64 Hz."""
REPEATS: Final = 5
PART_NS: Final = (300 * 10**9, 310 * 10**9)
"""Log times of a part that is read alone."""


def stock(path: Path) -> int:
    """Iterate over all messages with every CRC checked, without decoding them, and return their number."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())


def stock_to_numpy(path: Path) -> dict[str, Any]:
    """Read all messages with every CRC checked, and return those of each topic as an array of bytes."""
    bodies: dict[str, list[bytes]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            bodies.setdefault(channel.topic, []).append(message.data)
    return {topic: np.frombuffer(b"".join(found), np.uint8) for topic, found in bodies.items()}


def seconds(job: Callable[[], Any]) -> float:
    """Measure the processor time of a job, which other processes do not affect much."""
    began = time.process_time()
    job()
    return time.process_time() - began


def log_reading(cycles: int = CYCLES) -> dict[str, Any]:
    """Measure processor times for all channels; each ratio is the median of alternating pairs."""
    with TemporaryDirectory() as folder:
        path = record_log(Path(folder) / "run.mcap", cycles)
        jobs: tuple[Callable[[], Any], ...] = (
            lambda: read_log(path),
            lambda: stock(path),
            lambda: stock_to_numpy(path),
            lambda: read_log(path, start_ns=PART_NS[0], end_ns=PART_NS[1]),
        )
        times_s = np.array([[seconds(job) for job in jobs] for _ in range(REPEATS)])
        log = read_log(path)
        ours, iterated, to_numpy, part = np.median(times_s, axis=0).tolist()
        return {
            "cycles": cycles,
            "bytes": path.stat().st_size,
            "messages": stock(path),
            "topics": len(log.time_ns),
            "all_channels_s": ours,
            "ten_seconds_s": part,
            "stock_iterating_s": iterated,
            "stock_to_numpy_s": to_numpy,
            "ratio_to_stock_iterating": median((times_s[:, 1] / times_s[:, 0]).tolist()),
            "ratio_to_stock_to_numpy": median((times_s[:, 2] / times_s[:, 0]).tolist()),
        }


if __name__ == "__main__":
    print(json.dumps(log_reading(), indent=2))
