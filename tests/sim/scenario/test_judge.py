"""Checks of a scenario on made-up true states: each bound from either side."""

from dataclasses import replace
from math import isnan

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints, Preload
from fsw.dictionary.enums import Mode
from fsw.dictionary.faults import NoContact
from fsw.kinematics.transforms import rotation_x, rotation_y
from sim.frames import P_NR_M
from sim.scenario import data
from sim.scenario.judge import CheckResult, Ending, Snapshot, Trace, evaluate_checks, note_snapshot
from sim.sequence import Outcome
from sim.setting import Surface, World
from tests.tools import TOOL_SWITCHES, TOOLS

STOWED_RAD = np.array([1.5, -0.3, -2.8, 3.1, 0.6])
POINT_N = np.array([2.0, 0.1, -0.2])
UP_N = (0.0, 0.0, -1.0)
"""Upward normal of the level surface."""
INLET = data.TaughtPoint("inlet", "portion", (0.6, 0.1, -1.2), (0.0, 0.0, 1.0))
BOX = data.TaughtPoint("box", "drill", (0.94, 0.28, -0.86), (-1.0, 0.0, 0.0))
ENDING = Ending(Outcome.DONE, Mode.DEPLOYED, STOWED_RAD + 1.0, True, False, ())
REST = Snapshot(
    command=1,
    p_RoTo_R_m={tool: np.zeros(3) for tool in TOOLS},
    R_RT={tool: np.eye(3) for tool in TOOLS},
    force_R_N={tool: np.zeros(3) for tool in TOOLS},
    closed={tool: np.zeros(len(TOOL_SWITCHES[tool]), bool) for tool in TOOLS},
    pads_R_m={tool: np.zeros((len(TOOL_SWITCHES[tool]), 3)) for tool in TOOLS},
    vibrates=False,
)


def axes_along(direction: np.ndarray) -> np.ndarray:
    """Return axes as columns, the x axis along a direction."""
    x = direction / np.linalg.norm(direction)
    y = np.cross([0.3, 0.9, 0.1], x)
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def snapshot_at(
    tool: str,
    p_N_m: np.ndarray = POINT_N,
    command: int = 1,
    force_N: tuple[float, float, float] = (0.0, 0.0, 0.0),
    R: np.ndarray | None = None,
    touching: bool = True,
    vibrates: bool = False,
) -> Snapshot:
    """Make a snapshot with one tool at a pose."""
    p, force, axes = dict(REST.p_RoTo_R_m), dict(REST.force_R_N), dict(REST.R_RT)
    p[tool], force[tool] = np.asarray(p_N_m) - P_NR_M, np.array(force_N)
    if R is not None:
        axes[tool] = R
    closed = {name: np.zeros(len(switches), bool) for name, switches in TOOL_SWITCHES.items()}
    closed[tool][:1] = touching
    pads = {name: np.tile(p[tool], (len(switches), 1)) for name, switches in TOOL_SWITCHES.items()}
    return Snapshot(command, p, axes, force, closed, pads, vibrates)


def results(
    check: data.Check, *moments: Snapshot, ending: Ending = ENDING, world: World | None = None
) -> dict[str, CheckResult]:
    """Return the results of a check, by name."""
    surface = Surface((float(POINT_N[0]), float(POINT_N[1]), float(POINT_N[2])), UP_N)
    scenario = data.Scenario(
        name="made up",
        title="",
        summary="",
        world=world or World(surface=surface),
        commands=(MoveJoints((0.0,) * 5), Preload("drill", 300.0)),
        checks=(check,),
        taught=(INLET, BOX),
    )
    trace = Trace()
    for moment in moments:
        note_snapshot(scenario, trace, moment)
    found = evaluate_checks(scenario, STOWED_RAD, trace, ending)
    return {measured.name: measured for measured in found}


@pytest.mark.parametrize("outcome", Outcome)
def test_done_is_done_and_nothing_else_is(outcome):
    (found,) = results(data.Done(), ending=replace(ENDING, outcome=outcome)).values()
    assert (found.check, found.passed) == ("done", outcome is Outcome.DONE)


def off(*values: float) -> np.ndarray:
    """Return a place beside the point."""
    return POINT_N + np.array(values)


def failed(found: dict[str, CheckResult]) -> list[str]:
    """Return the names of what did not pass."""
    return [name for name, measured in found.items() if not measured.passed]


@pytest.mark.parametrize(("lateral_m", "passed"), [(0.0149, True), (0.0151, False)])
def test_placed_is_beside_the_point_along_the_surface_however_deep(lateral_m, passed):
    where = off(0.6 * lateral_m, -0.8 * lateral_m, 0.2)
    found = results(data.Placed(1, "apxs"), snapshot_at("apxs", where))
    assert found["lateral"].value == pytest.approx(lateral_m)
    assert failed(found) == ([] if passed else ["lateral"])


def test_placed_needs_a_switch_of_that_tool():
    other = replace(snapshot_at("apxs"), closed=snapshot_at("drill").closed)
    for moment in (snapshot_at("apxs", touching=False), other):
        assert failed(results(data.Placed(1, "apxs"), moment)) == ["apxs in contact"]


def test_what_counts_is_the_last_cycle_of_the_command():
    far = off(0.5, 0.0, 0.0)
    later = snapshot_at("apxs", far, command=2, touching=False)
    assert not failed(results(data.Placed(1, "apxs"), snapshot_at("apxs", far), snapshot_at("apxs"), later))


def test_what_was_not_reached_is_not_a_number_and_has_not_passed():
    for check in (
        data.Placed(2, "apxs"),
        data.SameSpot(2, "mahli", 1, "apxs"),
        data.Preloaded(2, "drill", 300.0),
        data.Loaded(2, "box", 100.0),
        data.GravityHeld(2, "drill", (1.0, 0.0, 0.0)),
        data.OverInlet(2, "inlet"),
        data.Docked(2, "box"),
    ):
        found = results(check, snapshot_at("apxs")).values()
        assert any(isnan(measured.value) for measured in found)
        assert not any(measured.passed for measured in found if isnan(measured.value))


def test_same_spot_counts_from_where_the_first_tool_truly_was():
    first = snapshot_at("apxs", off(0.004, 0.0, 0.0))
    second = snapshot_at("mahli", off(0.004, 0.003, 0.05), command=2)
    found = results(data.SameSpot(2, "mahli", 1, "apxs"), first, second)
    assert found["lateral"].value == pytest.approx(0.003)
    assert found["lateral"].check == "same_spot"
    assert not failed(found)


def press(normal_N: float, lateral_N: float = 0.0, slip_m: float = 0.0, command: int = 2) -> Snapshot:
    """Make snapshots of the drill pressed on the surface: the contact force points up."""
    return snapshot_at("drill", off(slip_m, 0.0, 0.0), command, (lateral_N, 0.0, -normal_N))


@pytest.mark.parametrize(
    ("force_N", "passed"), [(269.0, False), (271.0, True), (329.0, True), (331.0, False)]
)
def test_preloaded_is_within_its_share_at_the_end(force_N, passed):
    found = results(data.Preloaded(2, "drill", 300.0), press(5.0), press(force_N))
    assert found["force"].value == pytest.approx(force_N)
    assert found["force"].passed == passed


def test_preloaded_watches_peaks_on_the_way_and_while_it_is_let_go_but_not_where_the_tool_hardly_presses():
    check = data.Preloaded(2, "drill", 300.0)
    pressed = [press(3.0), press(150.0, 45.0, 1e-4), press(300.0, 60.0, 2e-4)]
    run = [*pressed, press(250.0, 75.0, 8e-4, command=3)]
    found = results(check, *run)
    assert found["lateral over normal force"].value == pytest.approx(0.30)
    assert found["slip"].value == pytest.approx(8e-4)
    assert found["most force"].value == pytest.approx(300.0)
    for later, wrong in (
        (press(300.0, command=3), []),
        (press(401.0, command=3), ["most force"]),
        (press(100.0, 36.0, command=3), ["lateral over normal force"]),
        (press(100.0, 0.0, 1.1e-3, command=3), ["slip"]),
        (press(19.0, 15.0, 0.1, command=3), []),
    ):
        assert failed(results(check, *run, later)) == wrong


def test_loaded_is_a_force_against_the_way_that_the_taught_tool_looks():
    for force, passed in ((119.0, True), (121.0, False), (79.0, False), (-100.0, False)):
        pushed_back = snapshot_at("drill", command=2, force_N=(force, 30.0, -50.0))
        found = results(data.Loaded(2, "box", 100.0), pushed_back)["force"]
        assert (found.value, found.passed) == (pytest.approx(force), passed)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, -0.3)])
@pytest.mark.parametrize(("off_deg", "passed"), [(0.99, True), (1.01, False), (90.0, False)])
def test_gravity_is_held_against_true_gravity_tilt_included(roll, pitch, off_deg, passed):
    world = World(tilt_roll_rad=roll, tilt_pitch_rad=pitch)
    R = axes_along(world.gravity_N_m_s2)  # gravity lies along tool x
    turned = R @ rotation_y(np.radians(off_deg))
    check = data.GravityHeld(1, "portion", (2.0, 0.0, 0.0))
    held, shaken = snapshot_at("portion", R=R), snapshot_at("portion", R=turned, vibrates=True)
    on_the_way = snapshot_at("portion", R=R @ rotation_y(1.0))
    found = results(check, on_the_way, shaken, held, world=world)["gravity off"]
    assert np.degrees(found.value) == pytest.approx(off_deg)
    assert found.passed == passed


def test_over_the_inlet_is_near_its_upright_axis_at_any_height_with_the_tube_along_gravity():
    world = World(tilt_pitch_rad=0.3)
    where = np.add(INLET.p_N_m, (0.003, 0.004, -0.03))
    for down, lean_rad in ((world.gravity_N_m_s2, 0.0), (np.array([0.0, 0.0, 1.0]), 0.3)):
        moment = snapshot_at("portion", where, R=axes_along(down))
        found = results(data.OverInlet(1, "inlet"), moment, world=world)
        assert found["from the axis"].value == pytest.approx(0.005)
        assert found["from gravity"].value == pytest.approx(lean_rad, abs=1e-9)
        assert ("from gravity" in failed(found)) is bool(lean_rad)


def test_docked_is_at_the_point_along_its_axis_and_in_contact():
    R = axes_along(np.array([-1.0, 0.0, 0.0])) @ rotation_x(0.7)
    where = np.add(BOX.p_N_m, (0.002, 0.0, 0.002))
    for turned, touching, wrong in (
        (R, True, []),
        (R @ rotation_y(np.radians(1.6)), True, ["from the axis"]),
        (R, False, ["drill in contact"]),
    ):
        found = results(data.Docked(1, "box"), snapshot_at("drill", where, R=turned, touching=touching))
        assert found["from the point"].value == pytest.approx(np.hypot(0.002, 0.002))
        assert failed(found) == wrong


def test_released_is_no_force_from_any_side_at_the_end():
    assert results(data.Released("drill"), press(300.0), press(0.0))["force"].passed
    assert not results(data.Released("drill"), press(0.0), press(0.0, 2.0))["force"].passed


def test_stowed_is_the_true_pose_and_that_flight_software_knows_it():
    there = replace(ENDING, mode=Mode.STOWED, output_rad=np.add(STOWED_RAD, (0.0, 0.019, 0.0, -0.01, 0.0)))
    beside = replace(there, output_rad=np.add(STOWED_RAD, (0.0, 0.0, -0.021, 0.0, 0.0)))
    assert not failed(results(data.Stowed(), ending=there))
    assert "known" in failed(results(data.Stowed(), ending=replace(there, mode=Mode.DEPLOYED)))
    assert "farthest joint from it" in failed(results(data.Stowed(), ending=beside))


def test_faulted_is_this_event_brakes_and_refusal_together():
    ending = replace(ENDING, outcome=Outcome.FAULTED, refuses=True, evrs=((1.0, NoContact(0.1)),))
    assert not failed(results(data.Faulted("NoContact"), ending=ending))
    assert "OverCurrent" in failed(results(data.Faulted("OverCurrent"), ending=ending))
    for field in ("braked", "refuses"):
        wrong = replace(ending, **{field: False})
        assert field in failed(results(data.Faulted("NoContact"), ending=wrong))
