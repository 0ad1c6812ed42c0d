"""Units that look wrong: a factor of 57.3 or 1000 between quantities that belong together."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.audit.records import Remark, RemarkKind
from simgap.audit.samples import Samples, hold, joint_samples
from simgap.logs import Motion
from simgap.robot import ControlMode, Robot

FACTORS: Final = {180.0 / math.pi: "degrees", 1000.0: "thousandths"}
"""Factors of units that are mistaken for each other, and the name of the smaller unit."""
CLOSE: Final = 1.5
"""A ratio is near a factor within this factor: a servo follows its command to better than that."""
TURNS: Final = 2.0
"""Usual turns of a joint without limits: those of most such arms go from -360 to 360 degrees."""
FOLLOWS: Final = 0.8
"""Correlation from which two signals count as the same quantity."""


def audit_units(robot: Robot, motions: Sequence[Motion]) -> list[Remark]:
    """Return remarks about units that look wrong."""
    found: list[Remark] = []
    for joint in robot.joints:
        own = [motion for motion in motions if joint.name in motion.joints]
        samples = [joint_samples(motion.joints[joint.name]) for motion in own]
        names = tuple(motion.name for motion in own)
        if joint.mode is ControlMode.POSITION:
            ratio = _ratio((one.command, one.position) for one in samples)
            found += _remark(ratio, joint.name, names, "the position", "its command")
        ratio = _ratio(_velocities(own, samples, joint.name))
        found += _remark(ratio, joint.name, names, "the velocity", "the change of the position")
        found += _beyond_range(robot, joint.name, names, samples)
    return found


def _ratio(pairs: Iterator[tuple[Array, Array]]) -> float:
    """Return the ratio of the second signals to the first; NaN if they do not vary alike.

    It is below 0 if they run against each other in all motions: in a fast one a servo may lag by half a wave.
    """
    ratios: list[float] = []
    for first, second in pairs:
        use = np.isfinite(first) & np.isfinite(second)
        if use.sum() < 3:
            continue
        spread = float(np.std(first[use])), float(np.std(second[use]))
        if min(spread) == 0.0:
            continue
        correlation = float(np.corrcoef(first[use], second[use])[0, 1])
        if abs(correlation) > FOLLOWS:
            ratios.append(math.copysign(spread[1] / spread[0], correlation))
    ratios = [one for one in ratios if one > 0.0] or ratios
    return float(np.median(ratios)) if ratios else math.nan


def _velocities(
    motions: Sequence[Motion], samples: Sequence[Samples], joint: str
) -> Iterator[tuple[Array, Array]]:
    """Yield differences of position and logged velocities, each averaged over a tenth of a second."""
    for motion, one in zip(motions, samples, strict=True):
        velocity = motion.joints[joint].velocity
        if velocity is None or one.time_s.size < 3:
            continue
        width = max(1, round(0.1 / float(np.median(np.diff(one.time_s)))))
        cut = one.time_s.size // width * width
        if cut < 3 * width:
            continue
        mean_v = hold(velocity, one.time_s)[:cut].reshape(-1, width).mean(axis=1)
        mean_t = one.time_s[:cut].reshape(-1, width).mean(axis=1)
        mean_p = one.position[:cut].reshape(-1, width).mean(axis=1)
        yield np.gradient(mean_p, mean_t), mean_v


def _remark(ratio: float, joint: str, motions: tuple[str, ...], what: str, other: str) -> list[Remark]:
    if ratio < 0.0:
        text = f"{what} runs against {other}: is factor = -1 missing at one of them?"
        return [Remark(RemarkKind.UNIT, joint, motions, text, ratio)]
    for factor, unit in FACTORS.items():
        for signed, wrong, right in ((factor, what, other), (1.0 / factor, other, what)):
            if math.isfinite(ratio) and abs(math.log(ratio / signed)) < math.log(CLOSE):
                text = f"{what} is {ratio:.3g} times {other}: is {wrong} in {unit}, or is the unit "
                text += f"of {right} in the robot file wrong?"
                return [Remark(RemarkKind.UNIT, joint, motions, text, ratio)]
    return []


def _beyond_range(
    robot: Robot, joint: str, motions: tuple[str, ...], samples: Sequence[Samples]
) -> list[Remark]:
    """Remark positions far beyond the range of the model that would lie within it in another unit."""
    model, number = robot.model, robot.joint(joint).dof_index
    index = int(model.dof_jntid[number])
    if not samples:
        return []
    if not model.jnt_limited[index]:
        return _many_turns(joint, motions, samples)
    allowed = float(np.abs(model.jnt_range[index]).max())
    largest = max(float(np.abs(one.position).max(initial=0.0)) for one in samples)
    for factor, unit in FACTORS.items():
        if allowed * 3.0 < largest <= factor * allowed * CLOSE:
            text = (
                f"the position reaches {largest:.4g} rad, the model ends at {allowed:.4g} rad: "
                f"is the log in {unit}?"
            )
            return [Remark(RemarkKind.UNIT, joint, motions, text, largest / allowed)]
    return []


def _many_turns(joint: str, motions: tuple[str, ...], samples: Sequence[Samples]) -> list[Remark]:
    """Remark positions of a joint without limits that go over many turns, as degrees would."""
    positions = np.concatenate([one.position for one in samples])
    if np.ptp(positions) <= 2.0 * math.pi * TURNS:
        return []
    low, high = float(positions.min()), float(positions.max())
    text = f"the position goes from {low:.4g} to {high:.4g} rad, over many turns: is the log in degrees?"
    return [Remark(RemarkKind.TURNS, joint, motions, text, high - low, unit="rad")]
