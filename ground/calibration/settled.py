"""A campaign without the closed loop: arms that came to rest by the equations, in seconds.

For tests and trials. What flight software would believe is drawn: outputs were dragged to their places as
its moves end, or from either side; where friction just holds the load, they may lie anywhere in their gaps.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.estimate.gear import load_error
from fsw.kinematics.statics import settle, settle_output
from fsw.kinematics.transforms import Array
from fsw.motion.compensation import final_direction
from ground.calibration.campaign import CampaignPlan
from ground.calibration.data import Campaign
from ground.calibration.frames import FewTargets
from ground.calibration.poses import Group, branch_name, group_poses
from ground.calibration.survey import Row, campaign_from, surveyed
from sim.arms import BuiltArm
from sim.clearance import ClearanceModel
from sim.effects.effect import params_with_effects
from sim.effects.joints import HardstopAngle
from sim.plant import Plant
from sim.tracker import Tracker
from sim.world import World

SLIPS: Final = 0.4
"""A load that is so near the friction, as a share, lets an output slip from where it was dragged to."""


def settled_campaign(arm: BuiltArm, plan: CampaignPlan) -> Campaign:
    """Every pose of the plan that the tracker can see."""
    rows = []
    for k, group in enumerate(plan.groups):
        rng = np.random.default_rng([plan.seed, k, 2])
        goals = group_poses(arm.params, group, World("earth"), rng)
        scene = _scene(arm, plan, k)
        rows += [row for goal in goals if (row := _settled(scene, goal, rng)) is not None]
    return campaign_from(arm.name, rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What the poses of one group have in common."""

    k: int
    group: Group
    known: Config
    true: Config
    off_rad: Array
    """Of the hardstops, (5,)."""
    gravity_R_m_s2: Array
    plant: Plant
    """Shows the arm to the tracker."""
    tracker: Tracker


def _scene(arm: BuiltArm, plan: CampaignPlan, k: int) -> _Scene:
    group = plan.groups[k]
    known = group.params(arm.params)
    return _Scene(
        k=k,
        group=group,
        known=configure(known),
        true=configure(group.params(true_params(arm))),
        off_rad=stops_off(arm),
        gravity_R_m_s2=World("earth", tilt_roll_rad=group.roll_rad).gravity_N_m_s2,
        plant=ClearanceModel(known, World("earth")).plant,
        tracker=plan.tracker,
    )


def _settled(scene: _Scene, goal: Array, rng: np.random.Generator) -> Row | None:
    group, known, gravity = scene.group, scene.known, scene.gravity_R_m_s2
    load = settle_output(known.arm, goal, gravity).torque_Nm
    dragged = final_direction(known, load, gravity)
    held = known.output_friction_Nm * np.where(dragged == 0, rng.choice([-1.0, 1.0], len(Joint)), dragged)
    sure = np.abs(np.abs(load) - known.output_friction_Nm) > load_error(known, gravity)
    side = np.where(load > held, 1.0, -1.0)
    slips = ~sure & (np.abs(np.abs(load) / known.output_friction_Nm - 1.0) < SLIPS)
    lies = np.where(~slips, side, rng.uniform(-1.0, 1.0, len(Joint)))
    pulled = held / scene.true.arm.gear_stiffness_Nm_rad
    found = settle(scene.true.arm, goal, lies * scene.true.half_gap_rad - pulled, gravity)
    scene.plant.show(found.output_rad, found.strain)
    try:
        seen = surveyed(scene.tracker, scene.plant, group.roll_rad, found.frames.X_RF[5], rng)
    except FewTargets:
        return None
    return Row(
        group=scene.k,
        branch=branch_name(known, found.output_rad),
        motor_rad=goal - scene.off_rad,
        gap_rad=side * known.half_gap_rad,
        held_Nm=held,
        side=np.where(sure, side, 0.0),
        gravity_R_m_s2=gravity,
        turret_kg=np.nan if group.turret_kg is None else group.turret_kg,
        seen=seen,
    )


def true_params(arm: BuiltArm) -> Params:
    """The flight parameters that know every effect of the arm; not for flight software."""
    return params_with_effects(arm.effects, arm.params)


def stops_off(arm: BuiltArm) -> Array:
    """How far the arm's hardstops are from where they are drawn: its encoders read so much too little."""
    off = np.zeros(len(Joint))
    for effect in arm.effects:
        if isinstance(effect, HardstopAngle):
            off[effect.joint] += effect.shift_rad
    return off
