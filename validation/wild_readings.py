"""Campaign of wild readings: one of a run is wrong, from one count to 1e300, and nothing may come of it.

Each draw begins in a stored state of a run: at rest, in a free move, before and after a touch, in a press, in
homing. It goes on for two seconds with one wrong reading, or three of ten, or one that stays wrong, and is
compared with the same run without them. As long as both give the same actuator commands they have the same
sensors, so the plant is stepped only for a draw that commands something else.

Where load and friction leave the side of a joint undecided, the estimate says so, by an uncertainty of more
than half the backlash. The least change of a load may then move the estimate to the other side a load period
sooner or later. The difference of two estimates at that time is counted apart, and has no bound.
"""

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from math import hypot, inf, nan
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, CYCLE_S, Config
from fsw.cycle import step
from fsw.dictionary.commands import Command, MoveJoints, Preload
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr, ReadingNotUsed
from fsw.dictionary.faults import Fault, ReadingImplausible
from fsw.dictionary.types import joints5
from fsw.messages import ActuatorCommand, Outputs, Sensors
from fsw.state import State
from sim.arms import arm_named
from sim.initialisation import initialise_joints, prepare_homing, true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.scenario.file import load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup, teach
from sim.sequence import run_sequence
from sim.setting import World
from validation.campaigns import Context, Document
from validation.scenarios import choose

RUN_CYCLES: Final = 2 * CYCLE_HZ
GOOD_READINGS: Final = 3
"""Good readings after a wrong one from which on the estimate is compared."""
OUTPUT_RAD, TOOL_M = 5e-5, 1e-4
"""Largest difference of the estimates after a reading beyond its bound."""
LEVER_M: Final = 2.5
"""Distance from a joint to a tool: an angle moves a tool by at most that much more."""
DRAWS_OF_A_START: Final = 50
UNIT: Final = {
    "encoder_count": 1.0,
    "resolver_rad": 2 * np.pi / 2**16,
    "current_A": 1e-3,
    "winding_C": 0.01,
    "gravity_R_m_s2": 1e-3,
    "structure_C": 0.01,
}
"""Least wrong size of each sensor."""
SIZES: Final = {
    "encoder_count": 5,
    "resolver_rad": 5,
    "current_A": 5,
    "winding_C": 5,
    "gravity_R_m_s2": 3,
    "structure_C": 1,
}
STATES: Final = ("rest", "free", "touch", "press", "homing")
KINDS: Final = ("once", "once", "once", "once", "three of ten", "stays")


@dataclass(frozen=True, slots=True)
class Draw:
    """Wrong reading: sensor, number, size, and the cycles in which it is wrong."""

    sensor: str
    index: int
    how: str
    """`add`, `set` or `negate`."""
    size: float
    cycles: tuple[int, ...]

    def corrupt(self, sensors: Sensors) -> Sensors:
        """Return readings of which this one is wrong."""
        values = np.atleast_1d(np.array(getattr(sensors, self.sensor)))
        true = values[self.index].item()
        wrong = {"add": true + self.size, "set": self.size, "negate": -true}[self.how]
        if self.sensor == "encoder_count":
            most = np.iinfo(np.int64)
            wrong = max(min(int(wrong) if abs(wrong) < inf else most.max, most.max), most.min)
        values[self.index] = wrong
        value = float(values[0]) if self.sensor == "structure_C" else values
        return replace(sensors, **{self.sensor: value})  # type: ignore[arg-type]


def draw_reading(random: np.random.Generator, kind: str) -> Draw:
    """Draw a wrong reading: mostly of a size near the bounds, else up to 1e300, no number, or negated."""
    sensor = str(random.choice(list(UNIT)))
    index, share = int(random.integers(SIZES[sensor])), random.random()
    cycles = {"once": (0,), "stays": tuple(range(RUN_CYCLES))}.get(kind)
    if cycles is None:
        cycles = tuple(sorted(int(k) for k in random.choice(10, 3, replace=False)))
    most = 5.0 if share < 0.7 else 300.0
    size = float(random.choice([-1.0, 1.0])) * UNIT[sensor] * 10.0 ** random.uniform(0.0, most)
    if share > 0.95 and sensor != "encoder_count":
        return Draw(sensor, index, "set", float(random.choice([nan, inf, -inf])), cycles)
    how = "negate" if share > 0.85 else "add"
    return Draw(sensor, index, how, float(np.clip(size, -1e300, 1e300)), cycles)


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Stored run, and how it goes on without a wrong reading."""

    loop: ClosedLoop
    sensors: tuple[Sensors, ...]
    states: tuple[State, ...]
    outputs: tuple[Outputs, ...]


def go_on(loop: ClosedLoop) -> Start:
    """Run a fork for two seconds and store it."""
    fork, rows = loop.fork(), []
    for _ in range(RUN_CYCLES):
        record = fork.cycle()
        rows.append((record.sensors, fork.state, record.outputs))
    sensors, states, outputs = zip(*rows, strict=True)
    return Start(loop, sensors, states, outputs)


def prepare(state: str, seed: int) -> ClosedLoop:
    """Prepare a run in one of the states, at a random time of it."""
    random = np.random.default_rng([seed, 91])
    arm = arm_named("nominal" if seed % 2 else f"calibrated:{seed}")
    if state == "homing":
        joint = Joint(int(random.integers(len(Joint))))
        run = prepare_homing(arm, joint, World(), seed)
        return _stop_after(run.loop, iter(run), int(random.integers(60, 1500)))
    if state in ("rest", "free"):
        ready = np.array(arm.params.poses.ready_rad)
        loop = ClosedLoop(Setup(arm, World(), joints5(ready), seed, true_reference(arm)))
        if state == "rest":
            return _stop_after(loop, (loop.cycle() for _ in range(1000)), int(random.integers(5, 200)))
        command = MoveJoints(joints5(ready + random.uniform(-0.15, 0.15, 5)))
        return _stop_after(loop, run_sequence(loop, (command,)), int(random.integers(3, 700)))
    tool = ("apxs", "drill")[int(random.integers(2))]
    world, preview = random_placement(seed, arm, tool, 0.2)
    place = place_command(preview.placement)
    loop = ClosedLoop(Setup(arm, world, joints5(preview.standoff_rad), seed, true_reference(arm)))
    if state == "touch":
        return _stop_after(loop, run_sequence(loop, (place,)), int(random.integers(900, 1700)))
    for _ in run_sequence(loop, (place,)):
        pass
    press: tuple[Command, ...] = (Preload(tool, 300.0),)
    return _stop_after(loop, run_sequence(loop, press), int(random.integers(5, 900)))


def _stop_after(loop: ClosedLoop, run: Iterable[object], cycles: int) -> ClosedLoop:
    """Stop a run after so many cycles, or at its end."""
    for done, _ in enumerate(run):
        if done == cycles:
            break
    return loop


def allowed_change(config: Config, start: Start, draw: Draw, cycle: int) -> float:
    """Compute the bound of a change from the reading before, as docs/faults.md derives it."""
    params, state = config.params, start.states[cycle - 1] if cycle else start.loop.state
    monitors, k = params.monitors, draw.index
    joint = params.joints.in_order()[min(k, 4)]
    move = state.move
    turns = move is not None and (bool(move.plan.active[k % 5]) or move.phase.name == "BRAKE")
    turn_rad = turns * monitors.setpoint_step_factor * CYCLE_S * joint.speed_rad_s
    match draw.sensor:
        case "resolver_rad":
            return 6.0 * 2**0.5 * monitors.resolver_noise_rad + joint.backlash_rad + turn_rad
        case "current_A":
            return inf
        case "winding_C":
            return monitors.winding_step_K
        case "structure_C":
            return monitors.structure_step_K
        case "gravity_R_m_s2":
            return monitors.gravity_step_m_s2
    if not turns:
        return params.motion.settle_error_rad / float(config.rad_per_count[k])
    before = start.sensors[cycle - 1].encoder_count[k] if cycle else state.readings.used[19 + k]
    return turn_rad / float(config.rad_per_count[k]) + 2.0 * abs(
        int(state.drive.setpoint_count[k]) - int(before)
    )


@dataclass(frozen=True, slots=True)
class Result:
    """Outcome of a draw."""

    state: str
    kind: str
    draw: Draw
    told: int
    output_rad: float
    """Largest difference of the angles of joints whose side both estimates know."""
    undecided_rad: float
    """Largest difference of the angles of the other joints."""
    tool_m: float
    """Largest difference of the tool while no joint of which a side is not known differs."""
    problem: str


def try_draw(name: str, kind: str, start: Start, draw: Draw) -> Result:
    """Run a draw beside the run without it."""
    problem = ""
    told, output_rad, undecided_rad, tool_m, faults, events = 0, 0.0, 0.0, 0.0, [], []
    last, were_apart = 0 if kind == "stays" else max(draw.cycles), False
    faulted, held = None, None
    for cycle, (state, outputs) in enumerate(_run(start, draw)):
        reference, there = start.outputs[cycle], start.states[cycle]
        told += sum(isinstance(evr, ReadingNotUsed) for evr in outputs.evrs)
        faults += [evr for evr in outputs.evrs if isinstance(evr, Fault)]
        events += [evr.name for evr in outputs.evrs if not isinstance(evr, ReadingNotUsed)]
        if faults and faulted is None:
            faulted, held = cycle, outputs.drive.setpoint_count
        if held is not None and not np.array_equal(held, outputs.drive.setpoint_count):
            problem = "a set-point moves after the fault"
        if cycle >= last + GOOD_READINGS and kind != "stays":
            decided_rad, apart_rad = compare_outputs(state, there)
            output_rad, undecided_rad = max(output_rad, decided_rad), max(undecided_rad, apart_rad)
            # the pose of the tool is of the outputs before the load of this cycle may move them
            are_apart, were_apart = were_apart or apart_rad > OUTPUT_RAD, apart_rad > OUTPUT_RAD
            if outputs.tool is not None and reference.tool is not None and not are_apart:
                away = outputs.tool.p_RoTo_R_m - reference.tool.p_RoTo_R_m
                tool_m = max(tool_m, float(np.linalg.norm(away)))
    wild = [cycle for cycle in draw.cycles if _is_wild(start, draw, cycle)]
    if kind == "stays":
        persistence = start.loop.config.params.monitors.reading_persistence
        if wild and 0 in wild and faulted is not None and faulted < persistence - 1:
            problem = problem or f"a fault after {faulted + 1} cycles: {faults[0].message}"
        if _never_plausible(start, draw) and (faulted is None or faulted > persistence):
            problem = problem or f"no fault in {persistence} cycles: {faulted}"
        return Result(name, kind, draw, told, output_rad, undecided_rad, tool_m, problem)
    expected = [evr.name for out in start.outputs for evr in out.evrs]
    if faults:
        problem = f"fault: {faults[0].message}"
    elif events != expected:
        problem = (
            f"other events: {Counter(events) - Counter(expected)}, {Counter(expected) - Counter(events)}"
        )
    elif bool(wild) != bool(told) or (kind == "once" and told > 1) or told > len(draw.cycles):
        problem = f"told {told} times, {len(wild)} were wild"
    bound_rad = OUTPUT_RAD
    if len(wild) < len(draw.cycles):
        bound_rad = max(bound_rad, _bound_rad(start, draw))
    if output_rad > bound_rad:
        problem = problem or f"outputs differ by {1e3 * output_rad:.3f} mrad, bound {1e3 * bound_rad:.3f}"
    if tool_m > max(TOOL_M, LEVER_M * bound_rad * (bound_rad > OUTPUT_RAD)):
        problem = problem or f"tool differs by {1e3 * tool_m:.3f} mm"
    return Result(name, kind, draw, told, output_rad, undecided_rad, tool_m, problem)


def compare_outputs(one: State, other: State) -> tuple[float, float]:
    """Return the largest difference [rad] of joints whose side both states know, and that of the others."""
    difference_rad = np.abs(one.joints.output_rad - other.joints.output_rad)
    uncertainty_rad = np.maximum(one.joints.uncertainty_rad, other.joints.uncertainty_rad)
    undecided = uncertainty_rad > one.joints.reference.half_backlash_rad
    return (
        float(difference_rad[~undecided].max(initial=0.0)),
        float(difference_rad[undecided].max(initial=0.0)),
    )


def _bound_rad(start: Start, draw: Draw) -> float:
    """Compute the bound of a sensor of angles [rad]; 0 for others."""
    if draw.sensor not in ("encoder_count", "resolver_rad"):
        return 0.0
    scale = float(start.loop.config.rad_per_count[draw.index]) if draw.sensor == "encoder_count" else 1.0
    return scale * max(allowed_change(start.loop.config, start, draw, cycle) for cycle in draw.cycles)


def _read(start: Start, draw: Draw, cycle: int) -> float:
    source = start.sensors[cycle]
    return float(np.atleast_1d(getattr(source, draw.sensor))[draw.index])


def _is_wild(start: Start, draw: Draw, cycle: int) -> bool:
    """Return whether a wrong reading is surely beyond its bound, of range or of change."""
    config = start.loop.config
    wrong = float(np.atleast_1d(getattr(draw.corrupt(start.sensors[cycle]), draw.sensor))[draw.index])
    return not _is_plausible(config, start, draw, cycle, wrong)


def _is_plausible(config: Config, start: Start, draw: Draw, cycle: int, value: float) -> bool:
    monitors, k = config.params.monitors, draw.index
    joint = config.params.joints.in_order()[min(k, 4)]
    low, high = {
        "current_A": (-1.2 * joint.current_limit_A - 6 * monitors.current_noise_A,) * 2,
        "resolver_rad": (-6.5, 6.5),
        "winding_C": (-150.0, 250.0),
        "structure_C": (monitors.structure_min_C, monitors.structure_max_C),
        "gravity_R_m_s2": (-monitors.gravity_max_m_s2, monitors.gravity_max_m_s2),
        "encoder_count": (-(2.0**52), 2.0**52),
    }[draw.sensor]
    high = -low if draw.sensor == "current_A" else high
    if not low <= value <= high:
        return False
    if draw.sensor == "gravity_R_m_s2":
        others = [float(one) for axis, one in enumerate(start.sensors[cycle].gravity_R_m_s2) if axis != k]
        if not monitors.gravity_min_m_s2 <= hypot(value, *others) <= monitors.gravity_max_m_s2:
            return False
    before = _before(start, draw, cycle)
    bound = allowed_change(config, start, draw, cycle)
    if draw.sensor == "encoder_count" and bound > 0:
        return _turned(config, start, draw, cycle, value)
    earlier = _before(start, draw, cycle - 1)
    return abs(value - before) <= bound or abs(value - earlier) <= bound + _again(config, start, draw, cycle)


def _before(start: Start, draw: Draw, cycle: int) -> float:
    """Return the right reading before a cycle."""
    if cycle > 0:
        return _read(start, draw, cycle - 1)
    place = {"resolver_rad": 0, "current_A": 5, "gravity_R_m_s2": 10, "structure_C": 13, "winding_C": 14}
    readings = start.loop.state.readings
    numbers = readings.used if cycle == 0 else readings.earlier
    return float(numbers[place.get(draw.sensor, 19) + draw.index])


def _again(config: Config, start: Start, draw: Draw, cycle: int) -> float:
    """Return by how much a bound grows in a further cycle."""
    state = start.states[cycle - 1] if cycle else start.loop.state
    if draw.sensor != "resolver_rad" or state.move is None:
        return 0.0
    turns = bool(state.move.plan.active[draw.index]) or state.move.phase.name == "BRAKE"
    return turns * float(config.protection.setpoint_step_rad[draw.index])


def _turned(config: Config, start: Start, draw: Draw, cycle: int, value: float) -> bool:
    """Return whether a motor may have turned to a count."""
    state = start.states[cycle - 1] if cycle else start.loop.state
    k, move = draw.index, state.move
    per_count = float(config.rad_per_count[k])
    turns = move is not None and (bool(move.plan.active[k]) or move.phase.name == "BRAKE")
    if not turns:
        still = config.params.motion.settle_error_rad / per_count
        return any(abs(value - _before(start, draw, cycle - n)) <= still for n in (0, 1))
    step_count, goal = (
        config.protection.setpoint_step_rad[k] / per_count,
        float(state.drive.setpoint_count[k]),
    )
    for n in (1, 2):
        before = _before(start, draw, cycle - n + 1)
        away = abs(goal - before)
        if min(before, goal) - n * step_count - away <= value <= max(before, goal) + n * step_count + away:
            return True
    return False


def _never_plausible(start: Start, draw: Draw) -> bool:
    """Return whether a reading that stays wrong is so by far more than its bound ever allows."""
    if draw.how == "negate" or abs(draw.size) > 1e6 or not np.isfinite(draw.size):
        wrong = [draw.corrupt(start.sensors[k]) for k in range(10)]
        values = [float(np.atleast_1d(getattr(one, draw.sensor))[draw.index]) for one in wrong]
        far = 1e5 if draw.sensor == "encoder_count" else 10.0
        return all(not abs(value - _read(start, draw, k)) <= far for k, value in enumerate(values))
    return False


def _run(start: Start, draw: Draw) -> Iterator[tuple[State, Outputs]]:
    """Yield states and outputs of a run with wrong readings; the plant is stepped if their drive differs."""
    state, config, found = start.loop.state, start.loop.config, []
    for cycle, sensors in enumerate(start.sensors):
        read = draw.corrupt(sensors) if cycle in draw.cycles else sensors
        state, outputs = step(config, state, read, ())
        found.append((state, outputs))
        if not same_drive(outputs.drive, start.outputs[cycle].drive):
            yield from _run_with_plant(start, draw)
            return
    yield from found


def same_drive(one: ActuatorCommand, other: ActuatorCommand) -> bool:
    """Return whether two actuator commands are equal."""
    names = ("setpoint_count", "setpoint_rate_rad_s", "current_limit_A", "power_on", "brake_release")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def _run_with_plant(start: Start, draw: Draw) -> Iterator[tuple[State, Outputs]]:
    loop = start.loop.fork()
    sense = loop.avionics.sense
    for cycle in range(RUN_CYCLES):
        wrong = cycle in draw.cycles
        vars(loop.avionics)["sense"] = (lambda: draw.corrupt(sense())) if wrong else sense
        record = loop.cycle()
        if loop.failure is not None:
            raise loop.failure
        yield loop.state, record.outputs


@cache
def _start(state: str, seed: int) -> Start:
    return go_on(prepare(state, seed))


def try_start(seed: int, number: int, draws: int) -> list[Result]:
    """Try draws that begin in one stored state."""
    name = STATES[number % len(STATES)]
    random = np.random.default_rng([seed, number, 17])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        start = _start(name, seed + number)
        kinds = [KINDS[k % len(KINDS)] for k in range(draws)]
        return [try_draw(name, kind, start, draw_reading(random, kind)) for kind in kinds]


def count_told(name: str, scenarios: tuple[str, ...]) -> list[str]:
    """Return what is told of wild readings in the homing of all joints and in scenarios of an arm."""
    arm, evrs = arm_named(name), list[Evr]()
    for result in initialise_joints(arm):
        evrs += [evr for _, evr in result.evrs]
    for scenario in map(load_scenario, scenarios):
        taught = teach(arm, result.reference, scenario.taught, scenario.world)
        run = ScenarioRun(ClosedLoop(scenario_setup(scenario, taught, result.reference, 1), False), scenario)
        evrs += [evr for record in run for evr in record.outputs.evrs]
    return [f"{name}: {evr.message}" for evr in evrs if isinstance(evr, ReadingNotUsed | ReadingImplausible)]


def campaign(context: Context, draws: int = 10_000, arms: int = 4, only: str = "") -> Document:
    """Try so many wrong readings, and run arms without any; in bounds if nothing comes of any, or is told."""
    starts = -(-draws // DRAWS_OF_A_START)
    jobs = [(context.seed, k, min(DRAWS_OF_A_START, draws - k * DRAWS_OF_A_START)) for k in range(starts)]
    results = [one for found in context.each(try_start, jobs, "starts") for one in found]
    bad = [f"{one.state}, {one.kind}, {one.draw}: {one.problem}" for one in results if one.problem]
    names = [f"as-built:{context.seed + k}" for k in range(1, arms + 1)]
    told = context.each(count_told, ((name, choose(only)) for name in names), "arms")
    quiet = [text for found in told for text in found]
    once = [one for one in results if one.kind == "once"]
    return {
        "draws": len(results),
        "in_bounds": not bad and not quiet,
        "told": sum(bool(one.told) for one in once),
        "of": len(once),
        "max_output_urad": 1e6 * max((one.output_rad for one in once if one.told), default=0.0),
        "max_tool_mm": 1e3 * max((one.tool_m for one in once if one.told), default=0.0),
        "undecided": {
            "draws": sum(one.undecided_rad > OUTPUT_RAD for one in results),
            "max_output_urad": 1e6 * max((one.undecided_rad for one in results), default=0.0),
        },
        "told_without_a_wrong_reading": quiet,
        "bad": bad,
    }
