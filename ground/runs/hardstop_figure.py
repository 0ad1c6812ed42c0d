"""Figure of joints at their hardstops: current, speed and angle over time, and current over angle."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.motion.homing import HomingStage
from ground.render.figures import save_figure
from sim.initialisation import HomingSample, InitialisationResult

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


def save_hardstop_figure(runs: Sequence[InitialisationResult], path: Path) -> str | None:
    """Save the figure of the first run of each joint as PNG.

    Returns:
        None, or the reason why there is no figure: matplotlib is missing.

    Raises:
        BadOutput: the file cannot be written.
    """
    samples_by_joint = _samples_by_joint(runs)
    rows = max(len(samples_by_joint), 1)

    def draw(figure: Any) -> None:
        figure.suptitle("Homing at the negative hardstop: motor current, speed and angle", fontsize=12)
        panels = figure.subplots(rows, 4, squeeze=False)
        for axes, (joint, samples) in zip(panels, samples_by_joint.items(), strict=False):
            _draw_joint(axes, joint, samples)
        legend = dict(zip(*reversed(panels[0][0].get_legend_handles_labels()), strict=True))
        if legend:
            figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=len(legend))

    return save_figure(path, (15, 1.2 + 3.4 * rows), 90, draw)


def _samples_by_joint(runs: Sequence[InitialisationResult]) -> dict[Joint, list[HomingSample]]:
    """Select the last homing attempt of each joint in its first run, without most of the approach."""
    selected: dict[Joint, list[HomingSample]] = {}
    for joint in HARDSTOP_ORDER:
        samples = next((found for found in (_last_attempt(run, joint) for run in runs) if found), None)
        if samples is not None:
            at_stop = [s.time_s for s in samples if s.stage > HomingStage.COARSE]
            first_s = (at_stop[0] if at_stop else samples[-1].time_s) - BEFORE_S
            selected[joint] = [s for s in samples if s.time_s >= first_s]
    return selected


def _last_attempt(run: InitialisationResult, joint: Joint) -> list[HomingSample]:
    samples = [s for s in run.samples if s.joint is joint]
    pauses = [k for k, (a, b) in enumerate(pairwise(samples), 1) if b.time_s - a.time_s > PAUSE_S]
    return samples[pauses[-1] :] if pauses else samples


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
