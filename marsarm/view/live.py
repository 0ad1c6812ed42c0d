"""View of a run while it runs, and of the whole run after it."""

import time
from collections.abc import Sequence
from typing import Final, Self

from fsw.config import CYCLE_HZ
from marsarm.view.frames import Event, Frames, Trail
from marsarm.view.looks import TRAIL_STEP_M
from marsarm.view.request import DEFAULT_PORT
from marsarm.view.samples import SAMPLE_CYCLES, Samples
from marsarm.view.server import Viewer
from marsarm.view.watched_run import WatchedRun, build_surroundings
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.record import CycleRecord
from sim.world import World
from simgap.common.errors import BadRequest

DRAW_PERIOD_S: Final = 0.1
"""Least wall time between two drawings of a run that runs: drawing must not slow it."""


class LiveView:
    """Viewer that is fed with the cycles of a run; a context manager that stops it."""

    def __init__(self, title: str, world: World, arm: BuiltArm, effects: Sequence[Effect]) -> None:
        """Open the viewer.

        Args:
            title: Title of the run.
            world: World of the run.
            arm: Arm with its flight parameters.
            effects: Effects of the run.

        Raises:
            BadRequest: the viewer cannot be opened.
        """
        self._title = title
        self._surroundings = build_surroundings(world, arm.params, (*arm.effects, *effects), arm.model)
        self._viewer = Viewer(self._surroundings.scene, DEFAULT_PORT, title, "leave out --view")
        self._records: list[CycleRecord] = []
        self._times_s: list[float] = []
        self._tools: list[int] = []
        self._trail: Trail | None = None
        self._tool = self._drawn_tool = self._last_tick = 0
        self._begun_s = 0.0
        self._events: list[Event] = []
        self._drawn_s = -DRAW_PERIOD_S

    @property
    def has_begun(self) -> bool:
        """Return whether a run has begun."""
        return bool(self._records)

    def watch(self, record: CycleRecord) -> None:
        """Keep a sample of a cycle with its events, and draw it if a drawing is due."""
        if record.tick < self._last_tick:  # another run, which follows the last one
            self._begun_s += (self._last_tick + 1) / CYCLE_HZ
            self._trail, self._tool = None, 0
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
        if time.monotonic() - self._drawn_s >= DRAW_PERIOD_S:
            self._drawn_s = time.monotonic()
            self._draw()

    def _draw(self) -> None:
        """Draw the last sample."""
        try:
            frames = self._frames(slice(-1, None))
        except BadRequest:  # no finite angles: the last drawing stays
            return
        self._viewer.draw(frames, self._times_s[-1], self._events, self._extend_trail(frames))

    def _extend_trail(self, frames: Frames) -> Trail:
        """Return the trail of the present tool to the last sample, and keep it if the tool has moved on."""
        point = frames.trail(self._times_s[-1])
        if self._trail is None or self._drawn_tool != self._tool:
            self._trail, self._drawn_tool = point, self._tool
            return point
        whole = self._trail.extended_by(point)
        if whole.last_step_m > TRAIL_STEP_M:
            self._trail = whole
        return whole

    def _frames(self, part: slice) -> Frames:
        samples = Samples.of_records(self._times_s[part], self._tools[part], self._records[part])
        return self._surroundings.frames(samples)

    def play(self) -> None:
        """Play the whole run until the user presses Ctrl-C.

        Raises:
            BadRequest: no sample of the run can be drawn.
        """
        with self:
            scene, frames = self._surroundings.scene, self._frames(slice(None))
            self._viewer.play(WatchedRun(self._title, (), (), scene, frames, tuple(self._events)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._viewer.stop()
