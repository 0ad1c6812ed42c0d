"""Start of a run: hardstop initialisation in the closed loop, or the reference that one without errors gives.

`start_loop` is for Python users: an arm by its name, effects by their texts, and defaults for the rest.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.commands import Calibrate, CalibrateAll
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.evrs import Evr, JointCalibrated
from fsw.dictionary.types import Joints5, joints5
from fsw.estimate.reference import Reference
from fsw.executive.poses import homing_start_poses
from fsw.kinematics.transforms import Array
from fsw.motion.homing import HomingStage
from sim.arms import BuiltArm, arm_named, effects_of_run
from sim.effects.effect import Effect, apply_effects, nominal_hardware
from sim.effects.environment import Ambient, CurrentNoise
from sim.effects.joints import GearFriction
from sim.loop import ClosedLoop, Setup
from sim.plant import JOINT_NAMES, Plant
from sim.record import CycleRecord
from sim.scenario.effects import parse_effect_text
from sim.sequence import Outcome, SequenceRun
from sim.setting import World
from sim.world import build

START_DISTANCE_RAD: Final = 0.05
"""Distance from the hardstop at the start of a homing that is only measured, to save time."""
RANDOM_TEMPERATURE_C = (-55.0, 10.0)
DAILY_FRICTION_SIGMA = 0.1
"""One sigma of the change of friction from day to day, log-normal."""
RANDOM_NOISE_A = (0.01, 0.04)
RANDOM_OFFSET_RAD = 0.05
RANDOM_DISTANCE_RAD = (0.02, 0.15)


@dataclass(frozen=True, slots=True)
class HardstopResult:
    """Result of the homing of one joint, compared with the plant."""

    joint: Joint
    zero_error_rad: float
    """Estimated less true motor angle, without the known part from a shifted hardstop."""
    uncorrected_error_rad: float
    """The same error without correction of wind-up: output = motor + b/2 at the stall."""
    half_backlash_error_rad: float
    load_Nm: float
    """Modelled torque at the hardstop."""


@dataclass(frozen=True, slots=True)
class HomingSample:
    """Homing joint in one cycle; angles and speeds are those of the motor, output side."""

    time_s: float
    joint: Joint
    stage: HomingStage
    angle_rad: float
    speed_rad_s: float
    current_A: float
    limit_A: float


@dataclass(frozen=True, slots=True, eq=False)
class InitialisationResult:
    """Outcome of a hardstop initialisation."""

    outcome: Outcome
    duration_s: float
    evrs: tuple[tuple[float, Evr], ...]
    """Time [s] and event."""
    stops: tuple[HardstopResult, ...]
    samples: tuple[HomingSample, ...]
    reference: Reference
    """Reference in the memory of flight software afterwards."""
    max_torque_Nm: Array
    """Maximum torque on each hardstop, shape (5,)."""
    max_current_ratio: Array
    """Maximum ratio of each current to its limit, shape (5,)."""
    failure: Exception | None
    """Exception that ended flight software, or None."""


class InitialisationRun(SequenceRun):
    """Hardstop initialisation in a closed loop; `result` is complete after the last cycle."""

    def __init__(self, loop: ClosedLoop, command: Calibrate | CalibrateAll):
        super().__init__(loop, (command,))
        self._stops: list[HardstopResult] = []
        self._samples: list[HomingSample] = []
        self._torque_Nm = np.zeros(len(Joint))
        self._current_share = np.zeros(len(Joint))

    def note(self, record: CycleRecord) -> None:
        """Measure the motors and the hardstop that was found."""
        plant, state, time_s = self.loop.plant, self.loop.state, record.tick / CYCLE_HZ
        self._torque_Nm = np.maximum(self._torque_Nm, plant.stop_torque_Nm())
        # the plant has just completed a cycle with the limits of this record
        share = np.abs(plant.motor_current_A()) / record.outputs.drive.current_limit_A
        self._current_share = np.maximum(self._current_share, share)
        for evr in record.outputs.evrs:
            if isinstance(evr, JointCalibrated):
                self._stops.append(self._hardstop_result(evr))
        if state.move is not None and state.move.homing is not None:
            homing = state.move.homing
            j = homing.joint
            self._samples.append(
                HomingSample(
                    time_s,
                    j,
                    homing.stage,
                    float(state.joints.motor_rad[j]),
                    float(state.joints.motor_rate_rad_s[j]),
                    float(record.sensors.current_A[j]),
                    float(record.outputs.drive.current_limit_A[j]),
                )
            )

    def _hardstop_result(self, evr: JointCalibrated) -> HardstopResult:
        plant, state, config, j = self.loop.plant, self.loop.state, self.loop.config, evr.joint
        drawn_rad = config.params.joints.in_order()[j].hardstop_rad
        zero_error = float((state.joints.motor_rad - plant.motor_rad() + plant.stop_rad())[j]) - drawn_rad
        stalled_rad = min(s.angle_rad for s in self._samples if s.joint is j and s.stage is HomingStage.FINE)
        uncorrected = drawn_rad - stalled_rad - float(config.half_backlash_rad[j])
        return HardstopResult(
            joint=j,
            zero_error_rad=zero_error,
            uncorrected_error_rad=zero_error + uncorrected - evr.moved_rad,
            half_backlash_error_rad=float(
                state.joints.reference.half_backlash_rad[j] - plant.half_backlash_rad[j]
            ),
            load_Nm=float(state.load.torque_Nm[j]),
        )

    def finish(self) -> InitialisationResult:
        """Run all cycles and return the result."""
        for _ in self:
            pass
        return self.result()

    def result(self) -> InitialisationResult:
        """Return the result; valid after the last cycle."""
        return InitialisationResult(
            outcome=self.outcome,
            duration_s=self.loop.plant.data.time,
            evrs=tuple(self.evrs),
            stops=tuple(self._stops),
            samples=tuple(self._samples),
            reference=self.loop.state.joints.reference,
            max_torque_Nm=self._torque_Nm,
            max_current_ratio=self._current_share,
            failure=self.loop.failure,
        )


def prepare_homing(
    arm: BuiltArm,
    joint: Joint,
    world: World,
    seed: int = 0,
    effects: tuple[Effect, ...] = (),
    reference: Reference | None = None,
    away_rad: Array | None = None,
    before_stop_rad: float = START_DISTANCE_RAD,
) -> InitialisationRun:
    """Prepare the homing of one joint near its hardstop.

    Args:
        effects: Effects beyond those of the arm.
        reference: Reference in the memory of flight software; None if no joint was homed.
        away_rad: Offset of the other joints from the homing pose, shape (5,); None for 0.
        before_stop_rad: Distance of the joint from its hardstop.
    """
    pose = homing_start_poses(arm.params, joint)[-1] + (0.0 if away_rad is None else away_rad)
    pose[joint] = arm.params.joints.in_order()[joint].hardstop_rad + before_stop_rad
    loop = ClosedLoop(Setup(arm, world, joints5(pose), seed, reference, effects))
    return InitialisationRun(loop, Calibrate(joint))


def initialise_joints(
    arm: BuiltArm, world: World | None = None, seed: int = 0
) -> Iterator[InitialisationResult]:
    """Home every joint from a start near its hardstop; stop after the first failure.

    The reference of each result includes the joints before it: encoders count without power too.
    """
    reference = None
    for joint in HARDSTOP_ORDER:
        result = prepare_homing(arm, joint, world or World(), seed, reference=reference).finish()
        yield result
        if result.outcome is not Outcome.DONE:
            return
        reference = result.reference


def initial_reference(arm: BuiltArm) -> Reference:
    """Home every joint; return the reference in memory. RuntimeError if a homing fails."""
    *_, last = initialise_joints(arm)
    if last.outcome is not Outcome.DONE:
        raise RuntimeError(f"{arm.name} was not initialised: {last.evrs[-1][1].message}")
    return last.reference


def true_reference(arm: BuiltArm) -> Reference:
    """Compute the reference of an initialisation without errors; shifts of the hardstops remain."""
    spec = build(World(), arm.model)
    hardware = apply_effects(arm.effects, spec, nominal_hardware(arm.model.description))
    plant = Plant(spec.compile())
    hardstop_error_rad = configure(arm.params).hardstop_rad - plant.stop_rad()
    return Reference(
        calibrated=np.ones(len(Joint), bool),
        known=np.ones(len(Joint), bool),
        zero_rad=hardware.counter_zero_rad + hardstop_error_rad,
        half_backlash_rad=plant.half_backlash_rad,
        resolver_bias_rad=hardware.resolver_bias_rad - hardstop_error_rad,
        friction_Nm=np.array([spec.joint(f"{name}_motor").frictionloss for name in JOINT_NAMES]),
    )


def prepare_random_homing(arm: BuiltArm, joint: Joint, world: World, seed: int) -> InitialisationRun:
    """Prepare the homing of one joint at a random temperature, friction, noise and pose."""
    rng = np.random.default_rng([seed, joint, 5])
    friction = tuple(
        GearFriction(j, float(np.exp(DAILY_FRICTION_SIGMA * rng.standard_normal()))) for j in Joint
    )
    effects = (
        Ambient(rng.uniform(*RANDOM_TEMPERATURE_C)),
        CurrentNoise(rng.uniform(*RANDOM_NOISE_A)),
        *friction,
    )
    return prepare_homing(
        arm,
        joint,
        world,
        seed,
        effects,
        away_rad=rng.uniform(-RANDOM_OFFSET_RAD, RANDOM_OFFSET_RAD, len(Joint)),
        before_stop_rad=rng.uniform(*RANDOM_DISTANCE_RAD),
    )


LEVEL_MARS: Final = World()


def start_loop(
    arm: BuiltArm | str = "nominal",
    world: World = LEVEL_MARS,
    effects: Iterable[Effect | str] = (),
    *,
    start_rad: Joints5 | None = None,
    reference: Reference | None = None,
    seed: int = 0,
    with_truth: bool = True,
) -> ClosedLoop:
    """Start a run of an arm that has found its hardstops.

    Args:
        arm: Arm or its name: nominal, as-built:SEED or calibrated:SEED; MODEL/ before it for another drawing,
            or a folder with an arm.toml.
        effects: Effects, or their texts as on the command line.
        start_rad: Output angles at the start; None for the stowed pose.
        reference: Reference in the memory of flight software; None for that of an initialisation without
            errors. `initial_reference` simulates the initialisation, which takes some seconds.
        seed: Seed of everything random but the arm.
        with_truth: True to record the state of the plant in every cycle.

    Raises:
        UnknownArm: there is no such arm.
        BadEffect: the text of an effect is wrong.
    """
    built = arm_named(arm) if isinstance(arm, str) else arm
    tools = built.params.tool_names
    added = tuple(parse_effect_text(one, tools) if isinstance(one, str) else one for one in effects)
    built = built.with_effects(added)
    start = built.params.poses.stowed_rad if start_rad is None else start_rad
    known = true_reference(built) if reference is None else reference
    return ClosedLoop(Setup(built, world, start, seed, known, effects_of_run(added)), with_truth)
