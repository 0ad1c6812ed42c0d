"""The paper's Figure 7: where joints fall to the other side of their gap, predictions without it are off.

Four groups of poses over the workspace, on Earth, with stand-in turrets of 8 and 19 kg, level and
rolled by 20 degrees, shoulder-out first and then 30 % shoulder-in. The drill's place is predicted from
the encoders after hardstop initialisation: once as if every joint still lay on the side of its gap where it
was pressed against its hardstop, once with the state that flight software believes.
"""

import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.enums import Tool
from fsw.estimate.reference import Reference
from fsw.kinematics.branches import BRANCHES
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle, settle_output
from ground.render.figures import save_figure
from sim.arms import BuiltArm, arm_named
from sim.effects.structure import StandInTurret
from sim.initialisation import initial_reference
from sim.pose_sequence import RestState, pose_in_workspace, visit_poses
from sim.world import World
from validation.options import campaign_parser

EXAMPLE = "example: python -m validation.shoulder_in --picture docs/shoulder-in.png"
GROUPS: Final = ((8.0, 0.0), (8.0, 20.0), (19.0, 0.0), (19.0, 20.0))
"""Mass of the stand-in turret [kg], roll of the rover [deg]."""
POSES: Final = 40
"""Of each group."""
SHOULDER_IN: Final = 0.3
MOST_LEFT: Final = 0.1
"""Of what the gaps do to a prediction, with the believed state."""
WITH_SHOULDER: Final = {
    shoulder: [name for name in BRANCHES if name.startswith(f"shoulder-{shoulder}")]
    for shoulder in ("out", "in")
}
SERIES: Final = (
    ("as_initialised_mm", "#c1121f", "gaps taken to be as at the hardstop"),
    ("with_state_mm", "#31688e", "with the believed state of the backlash"),
)


@dataclass(frozen=True, slots=True)
class Prediction:
    """How far the drill was from where it was predicted, and how many joints had fallen to the other side."""

    shoulder_in: bool
    as_initialised_mm: float
    with_state_mm: float
    fallen: int


def with_stand_in_turret(mass_kg: float) -> BuiltArm:
    """The nominal arm with a stand-in turret, which flight software knows."""
    turret, nominal = StandInTurret(mass_kg), arm_named("nominal")
    return replace(nominal, effects=(*nominal.effects, turret), params=turret.on_params(nominal.params))


def group(index: int, seed: int, poses: int, reference: Reference) -> list[Prediction]:
    """One group of poses, shoulder-out and then shoulder-in."""
    mass_kg, roll_deg = GROUPS[index]
    arm = with_stand_in_turret(mass_kg)
    world = World("earth", tilt_roll_rad=float(np.radians(roll_deg)))
    config = configure(arm.params)
    rng = np.random.default_rng([seed, index, 6])
    inside = round(SHOULDER_IN * poses)
    shoulders = ["out"] * (poses - inside) + ["in"] * inside
    goals = [pose_in_workspace(config, rng, Tool.DRILL, WITH_SHOULDER[shoulder]) for shoulder in shoulders]
    settled = visit_poses(arm, reference, world, goals, "off", seed)
    return [_predict(config, s, shoulder == "in") for s, shoulder in zip(settled, shoulders, strict=True)]


def predictions(
    seed: int, workers: int, poses: int = POSES, groups: int = len(GROUPS)
) -> list[list[Prediction]]:
    """The first groups, or all."""
    reference = initial_reference(arm_named("nominal"), seed)
    one_group = partial(group, seed=seed, poses=poses, reference=reference)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(one_group, range(groups)))


def _predict(config: Config, s: RestState, shoulder_in: bool) -> Prediction:
    pressed = settle(config.arm, s.motor_rad, config.half_gap_rad, s.gravity_R_m_s2)
    believed = settle_output(config.arm, s.motor_rad + s.believed_gear_rad, s.gravity_R_m_s2)
    off = [
        1e3 * float(np.linalg.norm(tool_pose(config.arm, pose.frames, Tool.DRILL).p - s.p_RoTo_R_m))
        for pose in (pressed, believed)
    ]
    return Prediction(shoulder_in, off[0], off[1], int(np.count_nonzero(s.true_side < 0)))


def document(groups: Sequence[Sequence[Prediction]]) -> dict[str, Any]:
    """The means that the picture shows."""
    every = [p for poses in groups for p in poses]
    found = {
        name: {
            "as_initialised_mm": _mean([p.as_initialised_mm for p in every if p.shoulder_in == inside]),
            "with_state_mm": _mean([p.with_state_mm for p in every if p.shoulder_in == inside]),
            "fallen_joints": _mean([p.fallen for p in every if p.shoulder_in == inside]),
        }
        for name, inside in (("shoulder_out", False), ("shoulder_in", True))
    }
    left = [one["with_state_mm"] <= MOST_LEFT * one["as_initialised_mm"] for one in found.values()]
    return {"poses": len(every), "in_bounds": all(left), **found}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def draw(groups: Sequence[Sequence[Prediction]], path: Path) -> None:
    """Both predictions over the poses, as in the paper's figure."""

    def on(figure: Any) -> None:
        axes = figure.subplots()
        every = [p for poses in groups for p in poses]
        number = np.arange(1, len(every) + 1)
        for k, poses in enumerate(groups):
            inside = sum(p.shoulder_in for p in poses)
            last = (k + 1) * len(poses) + 0.5
            axes.axvspan(last - inside, last, color="0.92", label="shoulder-in" if k == 0 else None)
            mass_kg, roll_deg = GROUPS[k]
            axes.text(
                k * len(poses) + 1,
                0.97,
                f"{mass_kg:g} kg, roll {roll_deg:g} deg",
                va="top",
                fontsize=8,
                transform=axes.get_xaxis_transform(),
            )
        for name, colour, label in SERIES:
            off_mm = [getattr(p, name) for p in every]
            axes.plot(number, off_mm, ".-", color=colour, linewidth=0.6, label=label)
        axes.set(
            xlabel="pose",
            ylabel="drill from its predicted place [mm]",
            xlim=(0, len(every) + 1),
            ylim=(0, None),
        )
        figure.legend(loc="outside lower center", ncols=3, fontsize=9)

    problem = save_figure(path, (11, 4.2), 110, on)
    if problem is not None:
        print(f"marsarm: {problem}", file=sys.stderr)


def main() -> int:
    """Print the means as JSON, and draw the picture; exit status 1 if the state hardly helps."""
    options = campaign_parser("shoulder_in", __doc__, EXAMPLE)
    options.add_argument("--picture", type=Path, help="where to draw it, .png")
    options.add_argument("--poses", type=int, default=POSES, help="of each group (default %(default)s)")
    options.add_argument("--groups", type=int, default=len(GROUPS), help="so many (default %(default)s)")
    asked = options.parse_args()
    if not 1 <= asked.groups <= len(GROUPS):
        options.error(f"groups: {asked.groups} is not within 1 .. {len(GROUPS)}")
    if asked.poses < 2 or asked.workers < 1 or asked.seed < 0:
        options.error("poses are 2 or more, workers 1 or more, the seed is not negative")
    groups = predictions(asked.seed, asked.workers, asked.poses, asked.groups)
    if asked.picture is not None:
        draw(groups, asked.picture)
    found = document(groups)
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
