"""Hardstop initialisation of one joint or of all."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import CalibrateAll
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.executive.poses import homing_start_poses
from fsw.motion.homing import HomingStage
from marsarm.common.requests import fit_effects, make_world, parse_effects, select_arm
from marsarm.render.svg import save_figure
from marsarm.runs.request import HardstopRequest
from sim.arm_check import NoPlan, without_turret
from sim.arms import effects_of_run
from sim.effects.environment import default_ambient
from sim.initialisation import HomingSample, InitialisationResult, InitialisationRun, prepare_homing
from sim.loop import ClosedLoop, Setup
from sim.setting import WARM_C
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress

BEFORE_S: Final = 3.0
"""Time before the contact with the hardstop from which the figure begins."""
PAUSE_S: Final = 1.0
"""Shortest time between two homing attempts of a joint."""
BLUE, ORANGE, GREEN, RED, GREY = "#31688e", "#d95f02", "#2a9d8f", "#c1121f", "0.6"
COLOURS: Final = {
    HomingStage.FREE: "0.8",
    HomingStage.COARSE: GREY,
    HomingStage.RETREAT: GREEN,
    HomingStage.FINE: BLUE,
    HomingStage.RELEASE: ORANGE,
}
NAMES: Final = {
    HomingStage.FREE: "free: away from the hardstop",
    HomingStage.COARSE: "coarse: towards it until stall",
    HomingStage.RETREAT: "retreat",
    HomingStage.FINE: "fine: slowly towards it",
    HomingStage.RELEASE: "release: slowly away",
}
COLDEST_C, WARMEST_C = -130.0, 50.0
EXPECTED_S: Final = 1030.0
"""Approximate duration of the initialisation of all joints, for the progress bar."""


@dataclass(frozen=True, slots=True, eq=False)
class HardstopReport:
    """Run of a request."""

    request: HardstopRequest
    result: InitialisationResult
    poses_rad: tuple[tuple[float, ...], ...]
    """Pose in which each joint runs to its hardstop, in the order of Joint; its own angle is the first."""


def hardstop(request: HardstopRequest, progress: Progress = no_progress) -> HardstopReport:
    """Find hardstops; BadRequest if the request is wrong; nothing moved and nothing was written."""
    check_options(request)
    temperature_C = WARM_C if request.temperature_C is None else request.temperature_C
    if not COLDEST_C <= temperature_C <= WARMEST_C:
        raise BadRequest(
            f"temperature: {temperature_C} degC is not within {COLDEST_C:g} .. {WARMEST_C:g} degC"
        )
    world = make_world(request.scene, request.tilt_roll_deg, request.tilt_pitch_deg)
    arm = select_arm(request.arm, request.params, request.mismatch)
    effects = parse_effects(request.effects, arm.params.tool_names)
    arm = fit_effects(arm, effects)
    known = {joint.name.lower(): joint for joint in Joint}
    joint = None if request.joint is None else known.get(request.joint.lower())
    if joint is None and request.joint is not None:
        raise BadRequest(f"joint: {request.joint!r} is not known; there are {', '.join(known)}")
    try:
        arm = arm if request.turret else without_turret(arm, on_earth=request.scene == "earth")
    except NoPlan as error:
        raise BadRequest(f"hardstop: no poses for Earth without a turret: {error}") from error
    acting = (*default_ambient(effects, temperature_C), *effects_of_run(effects))
    if joint is None:
        setup = Setup(arm, world, arm.params.hardstop.start_rad, request.seed, effects=acting)
        run = InitialisationRun(ClosedLoop(setup), CalibrateAll())
    else:
        run = prepare_homing(arm, joint, world, request.seed, acting)
    result = _run_homing(run, joint, progress)
    poses = tuple(tuple(homing_start_poses(arm.params, joint)[-1]) for joint in Joint)
    return HardstopReport(request, result, poses)


def _run_homing(run: InitialisationRun, joint: Joint | None, progress: Progress) -> InitialisationResult:
    loop = run.loop
    if joint is not None:
        progress(0, 1, joint.name.lower())
    for record in run:
        if joint is None and record.tick % CYCLE_HZ == 0:
            homing = loop.state.move.homing if loop.state.move is not None else None
            activity = "moving" if homing is None else homing.joint.name.lower()
            progress(record.tick / CYCLE_HZ, EXPECTED_S, activity)
    if loop.failure is not None:
        raise loop.failure
    return run.result()


def save_hardstop_figure(run: InitialisationResult, path: Path) -> None:
    """Save the figure of each joint as PNG; BadOutput if that fails."""
    samples_by_joint = _samples_by_joint(run)
    rows = max(len(samples_by_joint), 1)

    def draw(figure: Any) -> None:
        figure.suptitle("Homing at the negative hardstop: motor current, speed and angle", fontsize=12)
        panels = figure.subplots(rows, 4, squeeze=False)
        for axes, (joint, samples) in zip(panels, samples_by_joint.items(), strict=False):
            _draw_joint(axes, joint, samples)
        legend = dict(zip(*reversed(panels[0][0].get_legend_handles_labels()), strict=True))
        if legend:
            figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=len(legend))

    save_figure(path, (15, 1.2 + 3.4 * rows), draw)


def _samples_by_joint(run: InitialisationResult) -> dict[Joint, list[HomingSample]]:
    """Select the last homing attempt of each joint, without most of the approach."""
    selected: dict[Joint, list[HomingSample]] = {}
    for joint in HARDSTOP_ORDER:
        samples = [s for s in run.samples if s.joint is joint]
        pauses = [k for k, (a, b) in enumerate(pairwise(samples), 1) if b.time_s - a.time_s > PAUSE_S]
        if samples := samples[pauses[-1] if pauses else 0 :]:
            at_stop = [s.time_s for s in samples if s.stage > HomingStage.COARSE]
            first_s = (at_stop[0] if at_stop else samples[-1].time_s) - BEFORE_S
            selected[joint] = [s for s in samples if s.time_s >= first_s]
    return selected


def _draw_joint(axes: Any, joint: Joint, samples: list[HomingSample]) -> None:
    current, speed, angle, press = axes
    zero_s, last = samples[0].time_s, samples[-1]
    name = joint.name.lower()
    for stage in HomingStage:
        part = [s for s in samples if s.stage is stage]
        if not part:
            continue
        time_s = np.array([s.time_s for s in part]) - zero_s
        angle_mrad = 1e3 * (np.array([s.angle_rad for s in part]) - last.angle_rad)
        current_A = np.array([s.current_A for s in part])
        style = {"color": COLOURS[stage], "linewidth": 0.9}
        current.plot(time_s, current_A, label=NAMES[stage], **style)
        speed.plot(time_s, 1e3 * np.array([s.speed_rad_s for s in part]), **style)
        angle.plot(time_s, angle_mrad, **style)
        if stage in (HomingStage.FINE, HomingStage.RELEASE):
            press.plot(angle_mrad, current_A, ".", markersize=2, color=COLOURS[stage])
    time_s = np.array([s.time_s for s in samples]) - zero_s
    limit_A = np.array([s.limit_A for s in samples])
    current.plot(time_s, limit_A, color=RED, linewidth=0.8, linestyle="--", label="current limit")
    current.plot(time_s, -limit_A, color=RED, linewidth=0.8, linestyle="--")
    for stall_s in _stall_times_s(samples):
        for panel in (current, speed, angle):
            panel.axvline(stall_s - zero_s, color="black", linewidth=0.8, linestyle=":", label="stall")
    current.set(title=f"{name}: current", xlabel="time [s]", ylabel="A")
    speed.set(title=f"{name}: motor speed", xlabel="time [s]", ylabel="mrad/s")
    angle.set(title=f"{name}: motor angle", xlabel="time [s]", ylabel="mrad, 0 at the end")
    press.set(title=f"{name}: current over angle", xlabel="mrad, 0 at the end", ylabel="A")


def _stall_times_s(samples: list[HomingSample]) -> list[float]:
    """Find the times of stalls, which end the stages that move towards the hardstop."""
    return [
        a.time_s
        for a, b in pairwise(samples)
        if a.stage is not b.stage and a.stage in (HomingStage.COARSE, HomingStage.FINE)
    ]
