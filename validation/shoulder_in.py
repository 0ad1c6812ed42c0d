"""Campaign of Figure 7 of the paper: prediction errors in poses where joints change their backlash side.

There are four groups of poses over the workspace, on Earth, with stand-in turrets of 8 and 19 kg, level and
rolled by 20 degrees. In each group 70 % of the poses are shoulder-out, then 30 % are shoulder-in. The
position of the drill is predicted from the encoders after the hardstop initialisation. One prediction assumes
the backlash side at the hardstop for every joint, the other uses the estimate of flight software.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure
from fsw.estimate.reference import Reference
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.statics import settle, settle_output
from marsarm.calibration.campaign import PAPER_GROUPS, SHOULDER_IN_SHARE
from marsarm.render.svg import save_figure
from sim.arms import BuiltArm, arm_named
from sim.effects.structure import StandInTurret
from sim.initialisation import initial_reference
from sim.pose_sequence import RestState, pose_in_workspace, visit_poses
from sim.world import World
from simgap.common.errors import BadOutput, BadRequest
from validation.campaigns import Context, Document

POSES: Final = PAPER_GROUPS[0].count
"""Number of poses in each group."""
MOST_LEFT: Final = 0.1
"""Largest ratio of the prediction error with the estimated side to that with the side at the hardstop."""
WITH_SHOULDER: Final = {
    shoulder: [name for name in BRANCHES if name.startswith(f"shoulder-{shoulder}")]
    for shoulder in ("out", "in")
}
SERIES: Final = (
    ("as_initialised_mm", "#c1121f", "backlash taken to be as at the hardstop"),
    ("with_state_mm", "#31688e", "with the estimated side of the backlash"),
)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction errors of the drill in a pose."""

    shoulder_in: bool
    as_initialised_mm: float
    """Error with the side of the backlash at the hardstop."""
    with_state_mm: float
    """Error with the estimated side."""
    joints_on_other_side: int
    """Number of joints that have changed the side of their backlash."""


def with_stand_in_turret(mass_kg: float) -> BuiltArm:
    """Return the nominal arm with a stand-in turret that flight software knows."""
    turret, nominal = StandInTurret(mass_kg), arm_named("nominal")
    return replace(nominal, effects=(*nominal.effects, turret), params=turret.on_params(nominal.params))


def group(index: int, seed: int, poses: int, reference: Reference) -> list[Prediction]:
    """Predict one group of poses, shoulder-out and then shoulder-in."""
    mass_kg, roll_rad = _load(index)
    arm = with_stand_in_turret(mass_kg)
    world = World("earth", tilt_roll_rad=roll_rad)
    config = configure(arm.params)
    rng = np.random.default_rng([seed, index, 6])
    inside = round(SHOULDER_IN_SHARE * poses)
    shoulders = ["out"] * (poses - inside) + ["in"] * inside
    goals = [pose_in_workspace(config, rng, "drill", WITH_SHOULDER[shoulder]) for shoulder in shoulders]
    settled = visit_poses(arm, reference, world, goals, "off", seed)
    return [_predict(config, s, shoulder == "in") for s, shoulder in zip(settled, shoulders, strict=True)]


def _load(index: int) -> tuple[float, float]:
    """Return mass [kg] of the stand-in turret and roll [rad] of the rover of a group of the campaign."""
    group = PAPER_GROUPS[index]
    assert group.turret_kg is not None
    return group.turret_kg, group.roll_rad


def campaign(context: Context, poses: int = POSES, groups: int = len(PAPER_GROUPS)) -> Document:
    """Predict the first groups, or all, and draw the picture where one is wanted."""
    if not 1 <= groups <= len(PAPER_GROUPS) or poses < 2:
        raise BadRequest(f"set: groups are 1 .. {len(PAPER_GROUPS)}, poses 2 or more")
    reference = initial_reference(arm_named("nominal"), context.seed)
    one_group = partial(group, seed=context.seed, poses=poses, reference=reference)
    found = context.each(one_group, ((number,) for number in range(groups)), "groups")
    if context.out is not None:
        problem = save_figure(context.out, (11, 4.2), 110, partial(draw, found))
        if problem is not None:
            raise BadOutput(problem)
    return summary(found)


def _predict(config: Config, s: RestState, shoulder_in: bool) -> Prediction:
    pressed = settle(config.arm, s.motor_rad, config.half_backlash_rad, s.gravity_R_m_s2)
    believed = settle_output(config.arm, s.motor_rad + s.believed_gear_rad, s.gravity_R_m_s2)
    error_mm = [
        1e3 * float(np.linalg.norm(tool_pose(config.arm, pose.frames, "drill").p - s.p_RoTo_R_m))
        for pose in (pressed, believed)
    ]
    return Prediction(shoulder_in, error_mm[0], error_mm[1], int(np.count_nonzero(s.true_side < 0)))


def summary(groups: Sequence[Sequence[Prediction]]) -> Document:
    """Return the mean errors."""
    every = [p for poses in groups for p in poses]
    found = {
        name: {
            "as_initialised_mm": _mean([p.as_initialised_mm for p in every if p.shoulder_in == inside]),
            "with_state_mm": _mean([p.with_state_mm for p in every if p.shoulder_in == inside]),
            "joints_on_other_side": _mean([p.joints_on_other_side for p in every if p.shoulder_in == inside]),
        }
        for name, inside in (("shoulder_out", False), ("shoulder_in", True))
    }
    in_bounds = [one["with_state_mm"] <= MOST_LEFT * one["as_initialised_mm"] for one in found.values()]
    return {"poses": len(every), "in_bounds": all(in_bounds), **found}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def draw(groups: Sequence[Sequence[Prediction]], figure: Any) -> None:
    """Draw both prediction errors over the poses, as in the figure of the paper."""
    axes = figure.subplots()
    every = [p for poses in groups for p in poses]
    number = np.arange(1, len(every) + 1)
    for k, poses in enumerate(groups):
        inside = sum(p.shoulder_in for p in poses)
        last = (k + 1) * len(poses) + 0.5
        axes.axvspan(last - inside, last, color="0.92", label="shoulder-in" if k == 0 else None)
        mass_kg, roll_rad = _load(k)
        text, top = f"{mass_kg:g} kg, roll {np.degrees(roll_rad):.0f} deg", axes.get_xaxis_transform()
        axes.text(k * len(poses) + 1, 0.97, text, va="top", fontsize=8, transform=top)
    for name, colour, label in SERIES:
        axes.plot(number, [getattr(p, name) for p in every], ".-", color=colour, linewidth=0.6, label=label)
    axes.set(xlabel="pose", ylabel="position error of the drill [mm]")
    axes.set(xlim=(0, len(every) + 1), ylim=(0, None))
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)
