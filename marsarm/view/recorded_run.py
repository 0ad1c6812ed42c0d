"""Recording of a run for a view while the run is carried out."""

from collections.abc import Mapping, Sequence
from typing import Self

from fsw.config import CYCLE_HZ
from marsarm.view.frames import MOST_SAMPLES, SAMPLE_CYCLES, Event, Samples, ViewFrames
from marsarm.view.watched_run import WatchedRun, build_surroundings, list_facts
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.record import CycleRecord
from sim.setting import World


class RecordedRun:
    """Samples and events of a run, or of several that follow each other."""

    def __init__(self, title: str, world: World, arm: BuiltArm, effects: Sequence[Effect]) -> None:
        """Begin without any sample.

        Args:
            title: Title of the run.
            world: World of the run.
            arm: Arm with its flight parameters.
            effects: Effects beyond those of the arm.
        """
        self._title = title
        self._surroundings = build_surroundings(world, arm.params, (*arm.effects, *effects), arm.model)
        self._records: list[CycleRecord] = []
        self._times_s: list[float] = []
        self._tools: list[int] = []
        self._events: list[Event] = []
        self._tool = self._last_tick = 0
        self._begun_s = 0.0

    @property
    def has_begun(self) -> bool:
        """Return whether a run has begun."""
        return bool(self._records)

    def watch(self, record: CycleRecord) -> None:
        """Keep the events of a cycle, and its state if a sample is due."""
        if record.tick < self._last_tick:  # another run, which follows the last one
            self._begun_s += (self._last_tick + 1) / CYCLE_HZ
            self._tool = 0
        self._last_tick = record.tick
        time_s = self._begun_s + record.tick / CYCLE_HZ
        if record.outputs.tool is not None:
            self._tool = int(record.outputs.tool.tool)
        self._events += [Event(time_s, evr.severity, evr.message) for evr in record.outputs.evrs]
        if record.tick % SAMPLE_CYCLES:
            return
        self._records.append(record)
        self._times_s.append(time_s)
        self._tools.append(self._tool)

    def play(self) -> None:
        """Play nothing: no viewer shows this run."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Keep what was recorded."""

    def _frames(self, part: slice) -> ViewFrames:
        """Compute the frames of some samples; BadRequest if none has finite angles."""
        samples = Samples.of_records(self._times_s[part], self._tools[part], self._records[part])
        return self._surroundings.frames(samples)

    def collect(self, header: Mapping[str, str]) -> WatchedRun:
        """Return the run for a page, with at most MOST_SAMPLES at regular times.

        Args:
            header: What identifies the run, as in the header of its log.

        Raises:
            BadRequest: no sample of the run can be drawn.
        """
        frames = self._frames(slice(None, None, -(-len(self._times_s) // MOST_SAMPLES)))
        scene = self._surroundings.scene
        return WatchedRun(self._title, list_facts(header), (), scene, frames, tuple(self._events))
