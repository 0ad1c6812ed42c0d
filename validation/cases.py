"""Which arms the kinematics campaign tries, under which gravity, with which tools."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.kinematics.arm import Arm, build_arm, build_orthogonal_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, rotation_x, rotation_y, rotation_z
from sim.arms import arm_named
from sim.frames import gravity_in_rover
from sim.world import GRAVITY_M_S2

MAX_TILT_RAD: Final = np.radians(30.0)
CALIBRATED_SEEDS: Final = 50
SKEW_SEEDS: Final = 50
RIGID_M: Final = 1e-9
HANGING_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of arm under a kind of gravity."""

    name: str
    chunks: int
    """Of each round of chunks, how many are this case: close to singularities the rigid arm
    of the drawing is a hundred times cheaper than the others."""
    arm: str
    """nominal, calibrated or skew: the drawing with a tool whose boresight misses the turret axis."""
    gravity: str
    """none, mars (tilted up to 30 degrees) or earth (level)."""

    @property
    def tolerance_m(self) -> float:
        return RIGID_M if self.gravity == "none" else HANGING_M


CASES: Final = (
    Case("nominal rigid", 12, "nominal", "none"),
    Case("nominal on Mars", 2, "nominal", "mars"),
    Case("nominal on Earth", 1, "nominal", "earth"),
    Case("calibrated rigid", 2, "calibrated", "none"),
    Case("calibrated on Mars", 2, "calibrated", "mars"),
    Case("skew tool rigid", 1, "skew", "none"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One arm with one tool under one gravity: what a batch of targets is tried on."""

    arm_name: str
    arm: Arm
    tool: Tool
    gravity_R_m_s2: Array | None

    def tool_pose(self, output_rad: Array) -> Pose:
        """X_RT of the tool for output angles (5, ...): of the arm at rest under this gravity, or rigid."""
        if self.gravity_R_m_s2 is None:
            return tool_pose(self.arm, forward(self.arm, output_rad), self.tool)
        return tool_pose(self.arm, settle_output(self.arm, output_rad, self.gravity_R_m_s2).frames, self.tool)

    @property
    def is_drawing(self) -> bool:
        """Rigid and square with a radial tool: its double roots are where the drawing shows them."""
        return self.gravity_R_m_s2 is None and self.arm_name == "nominal"


def trials(case: Case, rng: np.random.Generator) -> Iterator[Trial]:
    """One for each tool, all of one arm under one gravity; but every skew tool is another one."""
    gravity = _gravity(case.gravity, rng)
    seed = int(rng.integers(CALIBRATED_SEEDS))
    for tool in Tool:
        name = {
            "nominal": "nominal",
            "calibrated": f"calibrated:{seed}",
            "skew": f"skew:{rng.integers(SKEW_SEEDS)}",
        }[case.arm]
        yield Trial(name, arm_of(name), tool, gravity)


@lru_cache(maxsize=256)
def arm_of(name: str) -> Arm:
    """nominal, calibrated:SEED, as-built:SEED or skew:SEED."""
    kind, _, seed = name.partition(":")
    return skew_tool(int(seed)) if kind == "skew" else build_arm(arm_named(name).params)


def skew_tool(seed: int, offset_m: float = 0.06, tilt_rad: float = 0.8) -> Arm:
    """The drawing with one tool that passes the turret axis at up to so much and leans up to so much."""
    rng = np.random.default_rng(seed)
    arm = arm_of("nominal")
    clock = rotation_z(rng.uniform(-np.pi, np.pi))
    lean = rotation_y(rng.uniform(-tilt_rad, tilt_rad)) @ rotation_x(rng.uniform(-3, 3))
    p_m = clock @ [rng.uniform(0.2, 0.4), rng.uniform(-offset_m, offset_m), rng.uniform(-0.15, 0.0)]
    X_FT = Pose(clock @ lean, p_m)
    shape = build_orthogonal_arm(arm.theta_rad, Pose(arm.X_CF.R, arm.X_CF.p + arm.p_LC_m), X_FT)
    return replace(arm, X_FT=(X_FT,) * len(Tool), orthogonal=(shape,) * len(Tool))


def _gravity(name: str, rng: np.random.Generator) -> Array | None:
    if name == "none":
        return None
    tilt = rng.uniform(0.0, MAX_TILT_RAD) if name == "mars" else 0.0
    heading = rng.uniform(-np.pi, np.pi)
    return gravity_in_rover(tilt * np.cos(heading), tilt * np.sin(heading), GRAVITY_M_S2[name])
