"""Adds to the cycles of a log the messages that other people's tools know."""

from collections.abc import Mapping, Sequence

from fsw.config import Config
from ground.telemetry.mcap_file import Row
from ground.telemetry.pack import numbered
from ground.telemetry.standard import Sample, Standard


class Expander:
    """Adds the records of the standard messages of one arm; without a configuration there are none."""

    def __init__(self, config: Config | None, ids: Mapping[str, int]) -> None:
        self._standard = None if config is None else Standard(config)
        self._ids = ids
        self._counts = dict.fromkeys(ids.values(), 0)
        self._begun = False

    def __call__(self, rows: Sequence[tuple[Row, Sample | None]]) -> list[Row]:
        """The same rows, those with a sample followed by what is made of it."""
        expanded = []
        for row, sample in rows:
            expanded.append(row)
            if self._standard is not None and sample is not None:
                expanded.append(self._derived(self._standard, row.time_ns, sample))
        return expanded

    def _derived(self, standard: Standard, time_ns: int, sample: Sample) -> Row:
        messages = [] if self._begun else list(standard.fixed(time_ns))
        self._begun = True
        messages += standard.sample(time_ns, sample)
        return Row(time_ns, numbered(self._counts, time_ns, [(self._ids[t], data) for t, data in messages]))
