"""Touches and presses of a campaign: where a tool touches, and how far it then goes into the surface.

At rest a tool stays where its pads hold it, whatever the joints do. So the way between the rest after a touch
and the rest in a press is force over stiffness of the pads. A tracker measures it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.kinematics.transforms import rotate
from marsarm.diagnosis.arm.features import CONDITIONS, TOUCH, TRANSLATION, Feature
from marsarm.diagnosis.arm.logs import Recording, find_touch
from marsarm.diagnosis.arm.rest_poses import TurningPoints, find_turning_points
from sim.arm_model.load import ArmModel
from sim.mujoco_settings import read_pad_springs
from sim.setting import World
from sim.world import build

TOUCHING_N: Final = 9.0
"""Force of a tool that rests after its touch."""
WAY_DOUBT: Final = 0.06
"""Share of the way that is in doubt: 5 % by the force, the rest by how the pads share the touch."""


@dataclass(frozen=True, slots=True, eq=False)
class TouchFeature:
    """Height of a tool over the surface, as the session describes it, at the moment of a touch."""

    turning_points: TurningPoints
    """Up to the touch, which stands for a rest."""
    tool: str
    feature: Feature


@dataclass(frozen=True, slots=True, eq=False)
class PressFeature:
    """Way of the pads into the surface between the rest after their touch and that in the press."""

    measured_m: float
    nominal_m: float
    """For pads as stiff as in the drawing."""
    feature: Feature


def list_touches(recordings: Sequence[Recording]) -> Iterator[TouchFeature]:
    """Yield the touches of surfaces that sessions describe."""
    for one in recordings:
        touch = find_touch(one)
        if touch is None or one.world.surface is None:
            continue
        switches = one.sensors["switch_closed"]
        closed = np.flatnonzero(switches[touch] & ~switches[0])
        tool = next(name for name, own in one.params.tool_switches.items() if {*own} & {*closed})
        feature = Feature(one, TOUCH, "surface", "touch", _still(one), "touch")
        yield TouchFeature(find_turning_points(one, touch), tool, feature)


def list_presses(touches: Sequence[TouchFeature]) -> Iterator[PressFeature]:
    """Yield the presses after touches, where a tracker measured both rests."""
    for touch in touches:
        one = touch.feature.recording
        seen, surface = one.tracker_poses, one.world.surface
        after = np.flatnonzero(seen.tick > touch.turning_points.tick[-1])
        if after.size < 2 or not one.press_N or surface is None:
            continue
        normal_R, ends = np.array(surface.normal_N), [seen.X_RF[k] for k in after[[0, -1]]]
        X_FT = configure(one.params).arm.X_FT[touch.tool]
        pads = [switch.p_m for switch in one.arm.description.switches.values() if switch.tool == touch.tool]
        begin_m, end_m = (
            normal_R @ (rotate((X_RF @ X_FT).R, np.transpose(pads)) + (X_RF @ X_FT).p[:, None])
            for X_RF in ends
        )
        # the lowest pad alone bears a touch if the tool leans
        nominal_m = (one.press_N - TOUCHING_N * len(pads)) * pad_compliance_m_N(one.arm, touch.tool)
        noise_m = [
            X_RF.R.T @ normal_R * seen.sigma[3:, k] for X_RF, k in zip(ends, after[[0, -1]], strict=True)
        ]
        sigma = float(np.linalg.norm([*np.ravel(noise_m), WAY_DOUBT * nominal_m]))
        feature = Feature(one, TRANSLATION, "surface", "press", _still(one), "press", sigma=sigma)
        yield PressFeature(float(begin_m.min() - end_m.mean()), nominal_m, feature)


def _still(recording: Recording) -> tuple[float, ...]:
    return (recording.temperature_C, *(0.0,) * (len(CONDITIONS) - 1))


@lru_cache(maxsize=8)
def pad_compliance_m_N(arm: ArmModel, tool: str) -> float:
    """Compute the compliance [m/N] of the pads of a tool side by side."""
    model = build(World(), arm).compile()
    springs, switches = read_pad_springs(model), arm.params.switches
    pads = [model.geom(f"{switches[k].name}_pad").id for k in arm.params.tool_switches[tool]]
    return 1.0 / float(sum(springs[pad][0] for pad in pads))
