"""Campaign of random faults at random times of random scenarios: final states, largest forces and angles.

A run of each scenario is forked at random times, and a fault is injected into each fork. The fork continues
until it is braked, until its scenario ends, or for 45 s and until it rests. Then a move is commanded.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Command, MoveJoints, Stop
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandRefused, FaultResponse
from fsw.dictionary.faults import Fault as FaultEvr
from fsw.motion.move import Phase
from fsw.protect.responses import Response
from sim.arms import arm_named
from sim.clearance import hull_force_N, tool_forces
from sim.effects.environment import PowerLoss
from sim.effects.faults import (
    BrakeStuck,
    HotMotor,
    InjectedFault,
    JointSeized,
    MissedCycles,
    RockGone,
    SensorFault,
    TiltStep,
    WeakMotor,
)
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.file import load_scenario
from sim.scenario.run import scenario_setup
from sim.sequence import run_sequence
from validation.campaigns import Context, Document
from validation.scenarios import choose

CHUNK = 100
"""Faults that one process injects."""
FORK_S = 45.0
"""Longest time that a fork runs after its fault."""
WIND_UP_RAD = 0.005
"""Largest wind-up of a gear."""
EXPECTED_ENDS = ("refusing", "stopped", "tolerated", "a later command refused")
TILT_DEG = (6.0, -8.0)
STILL: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
SENSORS = {
    "encoder_count": 5,
    "resolver_rad": 5,
    "current_A": 5,
    "winding_C": 5,
    "structure_C": 1,
    "switch_closed": 10,
    "gravity_R_m_s2": 3,
}
SIZES = {
    "encoder_count": (200.0, 200.0),
    "resolver_rad": (0.02, 0.01),
    "current_A": (1.0, 0.5),
    "winding_C": (30.0, 10.0),
    "structure_C": (5.0, 1.0),
    "switch_closed": (1.0, 0.5),
    "gravity_R_m_s2": (0.2, 0.1),
}
"""Size of a bias, and of noise."""


@dataclass(frozen=True, slots=True)
class FaultOutcome:
    """Injected fault and its outcome."""

    scenario: str
    fault: str
    mode: str
    """Mode of the arm when the fault began."""
    found: str
    """First fault that flight software reported, or none."""
    end: str
    """Final state: one of EXPECTED_ENDS, or an error; stopped is braked and not refusing."""
    braked: bool
    guarded_N: float
    """Largest force on a tool in a guarded move, a retraction, or a stop of these."""
    free_N: float
    """Largest force on a tool in free space."""
    pressed_N: float
    """Largest force on a tool in a preload."""
    hull_N: float
    """Largest force of the rover's hull on the arm, without the bit boxes."""
    beyond_rad: float
    """Largest excess of an output over its soft limits and their margin; negative is inside."""


def random_fault(rng: np.random.Generator, at_s: float, has_rock: bool) -> InjectedFault:
    """Draw a fault of any kind, at any joint or sensor, of a significant size."""
    joint = Joint(int(rng.integers(len(Joint))))
    match int(rng.integers(12 if has_rock else 11)):
        case 0:
            return JointSeized(at_s, joint)
        case 1:
            return BrakeStuck(at_s, joint)
        case 2:
            return WeakMotor(at_s, joint)
        case 3:
            return PowerLoss(at_s)
        case 4:
            return MissedCycles(at_s, int(rng.integers(1, 33)))
        case 5:
            return TiltStep(at_s, *(float(v) for v in np.radians(rng.uniform(-20.0, 20.0, 2))))
        case 6:
            return HotMotor(at_s, joint, float(rng.uniform(60.0, 150.0)))
        case 11:
            return RockGone(at_s)
        case _:
            return _sensor_fault(rng, at_s)


def _sensor_fault(rng: np.random.Generator, at_s: float) -> SensorFault:
    sensor = str(rng.choice(list(SENSORS)))
    kinds = ["frozen", "biased", "noisy"] + (
        ["nan"] if sensor not in ("encoder_count", "switch_closed") else []
    )
    kind = str(rng.choice(kinds))
    bias, noise = SIZES[sensor]
    sizes = {"biased": float(rng.choice([-1.0, 1.0]) * bias), "noisy": noise}
    return SensorFault(at_s, sensor, kind, int(rng.integers(SENSORS[sensor])), sizes.get(kind, 0.0))  # type: ignore[arg-type]


def inject_some(name: str, seed: int, count: int) -> list[FaultOutcome]:
    """Inject this many faults, each into a fork of one run of a scenario."""
    scenario = load_scenario(name).tilted(*(float(v) for v in np.radians(TILT_DEG)))
    arm = arm_named("nominal")
    rng = np.random.default_rng([seed, *map(ord, name)])
    setup = scenario_setup(scenario, arm, initial_reference(arm), seed)
    length = sum(1 for _ in run_sequence(ClosedLoop(setup), scenario.commands))
    ticks = Counter(int(tick) for tick in rng.integers(1, length, count))
    loop, found, begun = ClosedLoop(setup), [], 0
    for tick, record in enumerate(run_sequence(loop, scenario.commands)):
        begun += len(record.commands)
        for _ in range(ticks[tick]):
            fault = random_fault(rng, loop.plant.data.time, scenario.world.surface is not None)
            found.append(_inject(name, loop.fork((fault,)), fault, scenario.commands[begun:]))
    return found


def _inject(name: str, loop: ClosedLoop, fault: InjectedFault, rest: tuple[Command, ...]) -> FaultOutcome:
    initial_mode, move, observed = loop.state.mode, loop.state.move, _Observer(loop)
    moving = move is not None and move.phase in (Phase.RELEASE, Phase.RUN)
    last = loop.state.tick + round(FORK_S * CYCLE_HZ)
    for record in _continue_run(loop, rest):
        observed.note(record)
        at_rest = not record.outputs.joint.busy
        if (observed.responses and at_rest) or record.tick >= last:
            break
    if not observed.responses and loop.state.move is not None:
        observed.note(loop.cycle((Stop(),)))
    while loop.state.move is not None:
        observed.note(loop.cycle())
    for _ in range(round(0.25 * CYCLE_HZ)):
        observed.note(loop.cycle())
    braked = loop.braked
    reaction = loop.cycle((MoveJoints(STILL, relative=True),)).outputs.evrs
    refusing = any(isinstance(evr, CommandRefused) for evr in reaction)
    return FaultOutcome(
        scenario=name,
        fault=f"{fault.sensor} {fault.kind}" if isinstance(fault, SensorFault) else type(fault).__name__,
        mode=initial_mode.name,
        found=observed.found[0] if observed.found else "none",
        end=_classify_end(loop, observed, braked, refusing, _must_be_found(loop, fault, moving)),
        braked=braked,
        guarded_N=observed.max_N["guarded"],
        free_N=observed.max_N["free"],
        pressed_N=observed.max_N["pressed"],
        hull_N=observed.max_N["hull"],
        beyond_rad=observed.beyond_rad,
    )


def _classify_end(
    loop: ClosedLoop, observed: "_Observer", braked: bool, refusing: bool, must_be_found: bool
) -> str:
    """Classify the final state; EXPECTED_ENDS lists the correct ones."""
    if loop.failure is not None:
        return "software error"
    if not braked:
        return "not braked"
    if loop.state.mode is Mode.FAULTED:
        return "refusing" if refusing else "faulted and not refusing"
    if observed.responses:
        return "stopped" if set(observed.responses) == {Response.STOP_AND_BRAKE} else "not refusing"
    if observed.refused:
        return "a later command refused"
    return "overlooked" if must_be_found or observed.has_tracking_error else "tolerated"


def _must_be_found(loop: ClosedLoop, fault: InjectedFault, moving: bool) -> bool:
    """Check whether docs/faults.md requires that this fault is detected."""
    bounds = loop.config.params.monitors
    match fault:
        case SensorFault(kind="nan"):
            return True
        case SensorFault(
            kind="frozen", sensor="resolver_rad" | "current_A" | "gravity_R_m_s2" | "structure_C"
        ):
            return True
        case SensorFault(kind="biased", sensor="resolver_rad", size=size):
            # The unknown position inside the backlash adds to the bound.
            return abs(size) > bounds.resolver_error_rad + 2 * float(loop.config.half_backlash_rad.max())
        case MissedCycles(count=count):
            return count > bounds.missed_cycles
        case HotMotor(temperature_C=temperature):
            return temperature > bounds.winding_max_C
        case PowerLoss() | TiltStep():
            return moving
        case _:
            return False


class _Observer:
    """Observer of the arm after a fault: reported faults, largest forces and angles."""

    def __init__(self, loop: ClosedLoop):
        self._loop, self._mode = loop, loop.state.mode
        config = loop.config
        # Backlash and wind-up of a gear add to the limit of the motor.
        motor_rad = config.params.monitors.soft_limit_margin_rad
        self._margin = motor_rad + float(config.half_backlash_rad.max()) + WIND_UP_RAD
        self.found: list[str] = []
        self.responses: list[str] = []
        self.refused = False
        self.has_tracking_error = False
        """True if a motor was far from its set-point for long, which shows that the fault has an effect."""
        self._cycles_off = 0
        self.max_N = dict.fromkeys(("guarded", "free", "pressed", "hull"), 0.0)
        self.beyond_rad = -np.inf

    def note(self, record: CycleRecord) -> None:
        """Evaluate one cycle."""
        loop, state, arm = self._loop, self._loop.state, self._loop.config.arm
        for evr in record.outputs.evrs:
            self.found += [type(evr).__name__] if isinstance(evr, FaultEvr) else []
            self.responses += [evr.response] if isinstance(evr, FaultResponse) else []
            self.refused |= isinstance(evr, CommandRefused)
        self._mode = self._mode if state.mode is Mode.FAULTED else state.mode
        self._note_tracking_error()
        is_preload = self._mode is Mode.PRELOAD
        is_guarded = self._mode in (Mode.GUARDED, Mode.RETRACTING)
        kind = "pressed" if is_preload else "guarded" if is_guarded else "free"
        max_N = float(np.linalg.norm(tool_forces(loop.plant), axis=1).max())
        self.max_N[kind] = max(self.max_N[kind], max_N)
        self.max_N["hull"] = max(self.max_N["hull"], hull_force_N(loop.plant))
        output = loop.plant.output_rad()
        beyond = np.maximum(arm.soft_min_rad - output, output - arm.soft_max_rad).max() - self._margin
        self.beyond_rad = max(self.beyond_rad, float(beyond))

    def _note_tracking_error(self) -> None:
        """Count the cycles in which a driven motor is truly off its set-point by over twice the bound."""
        move, bounds = self._loop.state.move, self._loop.config.params.monitors
        driven = move is not None and move.phase is Phase.RUN and not move.plan.stopped
        off_rad = 0.0
        if move is not None and driven:
            apart = np.abs(self._loop.plant.motor_rad() - move.setpoint.motor_rad)
            off_rad = float(np.where(move.plan.active, apart, 0.0).max())
        self._cycles_off = self._cycles_off + 1 if off_rad > 2 * bounds.following_error_rad else 0
        self.has_tracking_error |= self._cycles_off > 2 * bounds.following_persistence


def _continue_run(loop: ClosedLoop, rest: tuple[Command, ...]) -> Iterator[CycleRecord]:
    """Complete the command in progress when the run was forked, and then run the remaining commands."""
    record = loop.cycle()
    yield record
    while record.outputs.joint.busy:
        record = loop.cycle()
        yield record
    yield from run_sequence(loop, rest)


def summary(cases: list[FaultOutcome]) -> Document:
    """Summarize outcomes, with the largest forces and angles."""
    unexpected = [asdict(case) for case in cases if case.end not in EXPECTED_ENDS]
    over = [
        asdict(c)
        for c in cases
        if c.guarded_N > 50 or c.free_N > 250 or c.pressed_N > 400 or c.hull_N > 0 or c.beyond_rad > 0
    ]
    return {
        "count": len(cases),
        "ends": dict(Counter(case.end for case in cases)),
        "unexpected_ends": unexpected,
        "max_guarded_N": max(case.guarded_N for case in cases),
        "max_free_N": max(case.free_N for case in cases),
        "max_pressed_N": max(case.pressed_N for case in cases),
        "max_hull_N": max(case.hull_N for case in cases),
        "max_beyond_limits_rad": max(case.beyond_rad for case in cases),
        "found": dict(Counter(case.found for case in cases)),
        "over": over,
        "in_bounds": not unexpected and not over,
    }


def campaign(context: Context, count: int = 1000, only: str = "") -> Document:
    """Inject this many faults into all scenarios, or into only one."""
    names = choose(only)
    counts = Counter(str(name) for name in np.random.default_rng([context.seed, 60]).choice(names, count))
    chunks = [
        (name, 100 * context.seed + k, min(CHUNK, counts[name] - CHUNK * k))
        for name in names
        for k in range(-(-counts[name] // CHUNK))
    ]
    return summary([case for found in context.each(inject_some, chunks, "chunks") for case in found])
