"""Viewer in the browser: scene, controls and plots of a run, served by viser on this machine only."""

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.evrs import Severity
from marsarm.common.options import DEFAULT_PORT
from marsarm.render.rays import Triangles, join_triangles
from marsarm.view.frames import Event, Trail, ViewFrames
from marsarm.view.scene import (
    ARROW_HEAD_M,
    ARROW_M_PER_N,
    ARROW_RADIUS_M,
    CURVE_COLOURS,
    FIRST_SPEED,
    FORCE_RGB,
    GHOST_RGB,
    LEAST_FORCE_N,
    LONGEST_ARROW_M,
    MOST_MAGNIFICATION,
    SHORTEST_ARROW_M,
    SPEEDS,
    STATIC,
    TRAIL_RGB,
    TRAIL_STEP_M,
    Scene,
)
from marsarm.view.watched_run import Plot, RecordedRun, WatchedRun, make_plots
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.record import CycleRecord
from sim.setting import World
from simgap.common.errors import BadRequest

HOST: Final = "127.0.0.1"
PERIOD_S: Final = 1 / 30
"""Wall time between two frames."""
GHOST_OPACITY: Final = 0.25
MOST_POINTS: Final = 600
"""Largest number of points of a curve: two for each of the 300 pixels of a panel."""
LATEST_EVENTS: Final = 6


class Stage:
    """Scene in the browser: world, shown arm, believed arm, trail of the tool and contact force."""

    def __init__(self, server: Any, scene: Scene) -> None:
        self._scene = server.scene
        self._arms = {
            arm: [
                self._scene.add_frame(f"/{arm}/{body}", show_axes=False, visible=False)
                for body in range(len(scene.carriers))
            ]
            for arm in ("shown", "believed")
        }
        for number, part in enumerate(scene.parts):
            place = "/world" if part.carrier == STATIC else f"/shown/{part.carrier}"
            self._add_mesh(
                f"{place}/part{number}", part.triangles, tuple(round(255 * value) for value in part.rgb)
            )
        for carrier in range(len(scene.carriers)):
            whole = join_triangles([part.triangles for part in scene.parts if part.carrier == carrier])
            self._add_mesh(f"/believed/{carrier}/whole", whole, GHOST_RGB, GHOST_OPACITY)
        nowhere = np.zeros((1, 2, 3), np.float32)
        self._trail = self._scene.add_line_segments(
            "/trail", nowhere, colors=TRAIL_RGB, thickness=3.0, thickness_units="screen"
        )
        self._force = self._scene.add_arrows(
            "/force", nowhere, colors=FORCE_RGB, shaft_radius=ARROW_RADIUS_M, head_radius=ARROW_HEAD_M
        )

    def _add_mesh(
        self, name: str, triangles: Triangles, rgb: tuple[int, ...], opacity: float | None = None
    ) -> None:
        self._scene.add_mesh_simple(
            name, triangles.vertices_m, triangles.faces, color=rgb, opacity=opacity, cast_shadow=False
        )

    def draw(self, frames: ViewFrames, time_s: float, factor: float, with_ghost: bool) -> None:
        """Draw arms and force at a time, with offsets of the arms times a factor."""
        p_m, q = frames.arm_at(frames.shown, time_s, factor)
        self._move("shown", p_m, q)
        has_ghost = with_ghost and frames.true is not None
        if has_ghost:
            self._move("believed", *frames.arm_at(frames.believed, time_s, factor))
        for node in self._arms["believed"]:
            node.visible = has_ghost
        self._draw_force(p_m[-1], frames.between(frames.force_N, time_s))

    def draw_trail(self, points_m: NDArray[Any], is_visible: bool) -> None:
        """Draw the trail of the tool through points, shape (k, 3)."""
        self._trail.visible = is_visible and len(points_m) > 1
        if self._trail.visible:
            self._trail.points = np.stack([points_m[:-1], points_m[1:]], axis=1)

    def _move(self, arm: str, p_m: NDArray[Any], q: NDArray[Any]) -> None:
        for node, position, (x, y, z, w) in zip(self._arms[arm], p_m, q, strict=False):
            node.position, node.wxyz, node.visible = position, (w, x, y, z), True

    def _draw_force(self, tool_m: NDArray[Any], force_N: NDArray[Any]) -> None:
        size_N = float(np.linalg.norm(force_N))
        self._force.visible = size_N > LEAST_FORCE_N
        if self._force.visible:
            length_m = min(SHORTEST_ARROW_M + ARROW_M_PER_N * size_N, LONGEST_ARROW_M)
            self._force.points = np.array([[tool_m, tool_m + length_m * force_N / size_N]], np.float32)


class Viewer:
    """Viewer of one run, live or recorded; a context manager that stops its server."""

    def __init__(self, scene: Scene, port: int, title: str, otherwise: str) -> None:
        """Start the server from a port on, and print its address; BadRequest without viser or a free port.

        `otherwise` is advice for an error: how the command works without a viewer.
        """
        self._server = open_server(port, title, otherwise)
        self._stage = Stage(self._server, scene)
        gui = self._server.gui
        self._readout = gui.add_markdown("The run has not begun.")
        self._factor = gui.add_slider(
            "Deflection and backlash ×", min=1.0, max=MOST_MAGNIFICATION, step=0.5, initial_value=1.0
        )
        self._ghost = gui.add_checkbox("Believed by flight software", initial_value=True)
        self._trail = gui.add_checkbox("Trail of the tool", initial_value=True)

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.get_port()}"

    def draw(self, frames: ViewFrames, time_s: float, events: Sequence[Event], trail: Trail) -> None:
        """Draw a run at a time."""
        factor, _, _ = self._settings()
        with self._server.atomic():
            self._stage.draw(frames, time_s, factor, self._ghost.value)
            self._stage.draw_trail(trail.points_m(factor), self._trail.value)
            self._readout.content = describe(frames, time_s, events)

    def _settings(self) -> tuple[float, bool, bool]:
        """Return what the user has set: magnification, and whether ghost and trail are drawn."""
        return float(self._factor.value), self._ghost.value, self._trail.value

    def play(self, run: WatchedRun) -> None:
        """Play a run until the user presses Ctrl-C."""
        gui, times_s = self._server.gui, run.frames.samples.time_s
        start_s, end_s = float(times_s[0]), float(times_s[-1])
        playing = gui.add_checkbox("Play", initial_value=True)
        speed = gui.add_dropdown(
            "Speed", [f"{factor}x" for factor in SPEEDS], initial_value=f"{FIRST_SPEED}x"
        )
        marks = tuple(
            sorted({round(event.time_s, 1) for event in run.events if start_s <= event.time_s <= end_s})
        )
        clock = gui.add_slider(
            "Time, s",
            min=start_s,
            max=max(end_s, start_s + 0.1),
            step=0.1,
            initial_value=start_s,
            marks=marks,
        )
        self._add_event_menu(run.events, clock)
        for plot in make_plots(run.frames):
            add_plot(gui, plot, times_s)
        for note in run.notes:
            gui.add_markdown(note)
        drawn: tuple[object, ...] = ()
        last_s = time.monotonic()
        with end_by_ctrl_c():
            while True:
                now_s = time.monotonic()
                if playing.value and clock.value < end_s:
                    clock.value = min(clock.value + (now_s - last_s) * int(speed.value[:-1]), end_s)
                last_s = now_s
                if (wanted := (clock.value, *self._settings())) != drawn:
                    self.draw(run.frames, clock.value, run.events, run.frames.trail(clock.value))
                    drawn = wanted
                time.sleep(max(PERIOD_S - (time.monotonic() - now_s), 0.0))

    def _add_event_menu(self, events: Sequence[Event], clock: Any) -> None:
        """Add a menu of the events; choosing one moves the clock to it."""
        names = {f"{event.time_s:.1f} s  {event.text}": event.time_s for event in events}
        if not names:
            return
        menu = self._server.gui.add_dropdown("Event reports", list(names))

        def move_clock(_: Any) -> None:
            clock.value = names[menu.value]

        menu.on_update(move_clock)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Stop the server."""
        with redirect_stdout(StringIO()):  # viser prints that it stops
            self._server.stop()


@contextmanager
def end_by_ctrl_c() -> Iterator[None]:
    """Let Ctrl-C end a block as a normal end, not as an interruption: this is how a user closes a viewer.

    A signal that is ignored stays ignored.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        print("viewer    closed", file=sys.stderr)
    finally:
        signal.signal(signal.SIGINT, before)


def open_server(port: int, title: str, otherwise: str) -> Any:
    """Start viser on loopback, and print its address on standard error; BadRequest if that is impossible."""
    try:
        import viser
    except ImportError as error:
        raise BadRequest(
            f"view: viser is missing ({error}); pip install 'marsarm[view]', or {otherwise}"
        ) from error
    try:
        with redirect_stdout(StringIO()):  # viser prints its address, also where a program reads
            server = viser.ViserServer(host=HOST, port=port, label=title, verbose=False)
    except OSError as error:
        raise BadRequest(f"view: no port from {port} on can be opened ({error}); {otherwise}") from error
    server.scene.set_up_direction("+z")
    server.scene.configure_environment_map(None)  # the others are fetched from the network
    server.scene.add_light_ambient("/light", intensity=0.7)
    server.initial_camera.position, server.initial_camera.look_at = (4.0, -3.0, 2.2), (1.4, -0.2, 0.6)
    server.gui.configure_theme(show_share_button=False)
    print(f"viewer    http://{HOST}:{server.get_port()}", file=sys.stderr, flush=True)
    return server


def describe(frames: ViewFrames, time_s: float, events: Sequence[Event]) -> str:
    """Return mode, force, tool error and the latest events at a time, as Markdown."""
    frame = frames.frame_at(time_s)
    line = f"**{time_s:.1f} s** {frames.samples.mode_names[frame]}"
    if frames.tool_error_m is not None:
        force_N = float(np.linalg.norm(frames.force_N[frame]))
        line += f", contact {force_N:.1f} N, tool error {1e3 * frames.tool_error_m[frame]:.1f} mm"
    latest = [event for event in events if event.time_s <= time_s][-LATEST_EVENTS:]
    marks = ["**" if event.severity >= Severity.WARNING_LO else "" for event in latest]
    lines = [
        f"- {event.time_s:.1f} s {mark}{event.text}{mark}" for event, mark in zip(latest, marks, strict=True)
    ]
    return "\n".join([line, "", *lines])


def add_plot(gui: Any, plot: Plot, time_s: NDArray[np.float64]) -> None:
    """Add curves over time to the panel."""
    from viser import uplot

    rows = np.linspace(0, len(time_s) - 1, min(len(time_s), MOST_POINTS)).astype(int)
    colours = (CURVE_COLOURS * len(plot.values))[: len(plot.values)]
    series = [
        uplot.Series(label=label or plot.title, stroke=c, width=1)
        for label, c in zip(plot.values, colours, strict=True)
    ]
    gui.add_uplot(
        (time_s[rows], *(np.ascontiguousarray(values[rows], float) for values in plot.values.values())),
        (uplot.Series(label="s"), *series),
        title=f"{plot.title}, {plot.unit}",
        scales={"x": uplot.Scale(time=False, auto=True)},
        aspect=1.6,
    )


DRAW_PERIOD_S: Final = 0.1
"""Least wall time between two drawings of a run that runs: drawing must not slow it."""


class LiveView(RecordedRun):
    """Viewer that is fed with the cycles of a run; a context manager that stops it."""

    def __init__(self, title: str, world: World, arm: BuiltArm, effects: Sequence[Effect]) -> None:
        """Open the viewer of a run, described as for a recorded one; BadRequest if that is impossible."""
        super().__init__(title, world, arm, effects)
        self._viewer = Viewer(self._surroundings.scene, DEFAULT_PORT, title, "leave out --view")
        self._trail: Trail | None = None
        self._drawn_tool = 0
        self._drawn_s = -DRAW_PERIOD_S

    def watch(self, record: CycleRecord) -> None:
        """Keep a sample of a cycle with its events, and draw it if a drawing is due."""
        if record.tick < self._last_tick:
            self._trail = None
        super().watch(record)
        if self.is_due(record.tick) and time.monotonic() - self._drawn_s >= DRAW_PERIOD_S:
            self._drawn_s = time.monotonic()
            self._draw()

    def _draw(self) -> None:
        """Draw the last sample."""
        try:
            frames = self._frames(slice(-1, None))
        except BadRequest:  # no finite angles: the last drawing stays
            return
        self._viewer.draw(frames, self._times_s[-1], self._events, self._extend_trail(frames))

    def _extend_trail(self, frames: ViewFrames) -> Trail:
        """Return the trail of the present tool to the last sample, and keep it if the tool has moved on."""
        point = frames.trail(self._times_s[-1])
        if self._trail is None or self._drawn_tool != self._tool:
            self._trail, self._drawn_tool = point, self._tool
            return point
        whole = self._trail.extended_by(point)
        if whole.last_step_m > TRAIL_STEP_M:
            self._trail = whole
        return whole

    def play(self) -> None:
        """Play the whole run until the user presses Ctrl-C; BadRequest if no sample can be drawn."""
        with self:
            scene, frames = self._surroundings.scene, self._frames(slice(None))
            self._viewer.play(WatchedRun(self._title, (), (), scene, frames, tuple(self._events)))

    def __exit__(self, *_: object) -> None:
        self._viewer.stop()
