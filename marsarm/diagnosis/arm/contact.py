"""Touches and presses of a campaign: where a tool touches, how far it then goes into the surface or aside.

At rest a tool stays where its pads hold it, whatever the joints do. So the way between the rest after a touch
and the rest in a press is force over stiffness of the pads. On a tilted surface friction holds one of the
pads, about which the tool may turn, unless the tool slips. A tracker measures the ways.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import configure
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import ToolForce, settle_output
from fsw.kinematics.transforms import Array, Pose, rotate, rotate_back
from marsarm.diagnosis.arm.features import TOUCH, TRANSLATION, Feature, still
from marsarm.diagnosis.arm.logs import Recording, find_touch
from marsarm.diagnosis.arm.rest_poses import TurningPoints, find_turning_points
from sim.arm_model.load import ArmModel
from sim.effects.effect import Effect
from sim.effects.environment import ContactStiffness, Slip
from sim.frames import p_R_from_N
from sim.mujoco_settings import read_pad_springs
from sim.setting import World
from sim.world import build

TOUCHING_N: Final = 9.0
"""Force of a tool that rests after its touch."""
WAY_DOUBT: Final = 0.06
"""Share of the way that is in doubt: 5 % by the force, the rest by how the pads share the touch."""
LEAST_SINE: Final = 0.1
"""Sine of the angle between axis and normal from which on a press shows slip."""


@dataclass(frozen=True, slots=True, eq=False)
class TouchFeature:
    """Height of a tool over the surface, as the session describes it, at the moment of a touch."""

    turning_points: TurningPoints
    """Up to the touch, which stands for a rest."""
    tool: str
    feature: Feature

    def find_height(self, X_RT: Pose) -> float:
        """Return the height of the lowest pad over the surface [m], which a tool that leans touches first."""
        arm, surface = self.feature.recording.arm, self.feature.recording.world.surface
        assert surface is not None
        over_m = _place_pads(arm, self.tool, X_RT) - p_R_from_N(np.array(surface.p_N_m))[:, None]
        return float((np.array(surface.normal_N) @ over_m).min()) - _read_pads(arm, self.tool)[2]


@dataclass(frozen=True, slots=True, eq=False)
class PressFeature:
    """Way of the pads from the rest after their touch to that in the press: into the surface, or aside."""

    measured_m: float
    pushed_m: float
    """Way by the force, for pads as stiff as in the drawing, or aside without friction."""
    held_m: float
    """Part of a way aside that the friction of the drawing holds back; 0 for a way into the surface."""
    feature: Feature

    def predict(self, effects: Sequence[Effect]) -> float:
        """Compute the way [m] under effects."""
        if self.held_m:
            missing = sum(effect.share for effect in effects if isinstance(effect, Slip))
            return max(self.pushed_m - (1.0 - missing) * self.held_m, 0.0)
        return self.pushed_m / math.prod(one.factor for one in effects if isinstance(one, ContactStiffness))


def list_touches(recordings: Sequence[Recording]) -> Iterator[TouchFeature]:
    """Yield the touches of surfaces that sessions describe."""
    for one in recordings:
        touch = find_touch(one)
        if touch is None or one.world.surface is None:
            continue
        switches = one.sensors["switch_closed"]
        closed = np.flatnonzero(switches[touch] & ~switches[0])
        tool = next(name for name, own in one.params.tool_switches.items() if {*own} & {*closed})
        feature = Feature(one, TOUCH, "surface", "touch", still(one), "touch")
        yield TouchFeature(find_turning_points(one, touch), tool, feature)


def list_presses(touches: Sequence[TouchFeature]) -> Iterator[PressFeature]:
    """Yield the presses after touches, where a tracker measured both rests."""
    for touch in touches:
        one = touch.feature.recording
        seen, surface = one.tracker_poses, one.world.surface
        after = np.flatnonzero(seen.tick > touch.turning_points.tick[-1])
        if after.size < 2 or not one.press_N or surface is None:
            continue
        arm, normal_R = configure(one.params).arm, np.array(surface.normal_N)
        ends = [seen.X_RF[k] @ arm.X_FT[touch.tool] for k in after[[0, -1]]]
        begin_R_m, end_R_m = (_place_pads(one.arm, touch.tool, X_RT) for X_RT in ends)
        compliance_m_N, friction, _ = _read_pads(one.arm, touch.tool)
        axis_R = ends[0].R[:, 0]
        cosine = -float(normal_R @ axis_R)
        # the lowest pad alone bears a touch if the tool leans
        in_m = (one.press_N * cosine - TOUCHING_N * begin_R_m.shape[1]) * compliance_m_N
        if in_m <= 0.0:  # pressed no more than touched
            continue
        way_m = (normal_R @ begin_R_m).min() - (normal_R @ end_R_m).mean()
        yield PressFeature(float(way_m), in_m, 0.0, _make_feature(one, "press", normal_R, after, in_m))
        aside_R = axis_R + cosine * normal_R
        sine = float(np.linalg.norm(aside_R))
        if sine < LEAST_SINE:
            continue
        aside_R /= sine
        ways_m = aside_R @ (end_R_m - begin_R_m)
        ways_R = np.stack([normal_R, aside_R])
        bent_m_N = _bend(arm, one, touch.tool, ways_R)
        # The motors stand where a force of the press along the tool axis would hold the tool: it goes by the
        # compliance times the difference of that force and the surface's, to which the pads yield.
        press_N = one.press_N * (ways_R @ axis_R)
        surface_N = -(bent_m_N[0] @ press_N) / (bent_m_N[0, 0] + compliance_m_N)
        pushed_m = bent_m_N[1] @ press_N + bent_m_N[1, 0] * surface_N
        held_m = bent_m_N[1, 1] * friction * surface_N
        feature = _make_feature(one, "slide", aside_R, after)
        yield PressFeature(float(min(ways_m, key=abs)), float(pushed_m), float(held_m), feature)


def _place_pads(arm: ArmModel, tool: str, X_RT: Pose) -> Array:
    """Return the centres of the pads of a tool [m], (3, n)."""
    pads_T_m = [switch.p_m for switch in arm.description.switches.values() if switch.tool == tool]
    return np.asarray(rotate(X_RT.R, np.transpose(pads_T_m)) + X_RT.p[:, None])


def _make_feature(
    one: Recording, kind: str, way_R: Array, poses: NDArray[np.intp], doubted_m: float = 0.0
) -> Feature:
    """Make the feature of a way (3,) between the first and the last of the poses after a touch."""
    seen = one.tracker_poses
    noise_m = [rotate_back(seen.X_RF[k].R, way_R) * seen.sigma[3:, k] for k in poses[[0, -1]]]
    sigma = float(np.linalg.norm([*np.ravel(noise_m), WAY_DOUBT * doubted_m]))
    return Feature(one, TRANSLATION, "surface", kind, still(one), kind, sigma=sigma)


def _bend(arm: Arm, one: Recording, tool: str, ways_R: Array) -> Array:
    """Compute how far a tool goes along directions (n, 3) per newton along each [m/N], (n, n), at the end."""
    output_rad, gravity = one.motor_rad()[:, -1], one.world.gravity_N_m_s2
    free = settle_output(arm, output_rad, gravity)
    p_m = []
    for push in (ToolForce(tool, way_R) for way_R in ways_R):
        torque_Nm = settle_output(arm, output_rad, gravity, push).torque_Nm
        wound_rad = output_rad + (torque_Nm - free.torque_Nm) / arm.gear_stiffness_Nm_rad
        p_m.append(tool_pose(arm, settle_output(arm, wound_rad, gravity, push).frames, tool).p)
    return ways_R @ (np.transpose(p_m) - tool_pose(arm, free.frames, tool).p[:, None])


@lru_cache(maxsize=8)
def _read_pads(arm: ArmModel, tool: str) -> tuple[float, float, float]:
    """Read the compliance of the pads of a tool side by side [m/N], their friction, and their radius [m]."""
    model = build(World(), arm).compile()
    springs, switches = read_pad_springs(model), arm.params.switches
    pads = [model.geom(f"{switches[k].name}_pad").id for k in arm.params.tool_switches[tool]]
    friction, radius_m = float(model.geom_friction[pads[0], 0]), float(model.geom_size[pads[0], 0])
    return 1.0 / float(sum(springs[pad][0] for pad in pads)), friction, radius_m
