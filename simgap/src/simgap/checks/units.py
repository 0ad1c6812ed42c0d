"""Units that look wrong: ratios between signals of one joint, and positions beyond the range of the model."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.checks.records import COARSE_RAD, Remark, RemarkKind, Samples, hold, is_short, joint_samples, span
from simgap.checks.signals import ROUND
from simgap.logs import Motion
from simgap.robot import ControlMode, Robot, RobotJoint
from simgap.units import COUNTS

FACTORS: Final = {180.0 / math.pi: "degrees", 1000.0: "thousandths"}
"""Factors of units that are mistaken for each other, and the name of the smaller unit."""
SLIDE_FACTORS: Final = {10.0: "cm", 1000.0: "mm"}
CLOSE: Final = 1.5
"""A ratio is near a factor within this factor: a servo follows its command to better than that."""
TURNS: Final = 2.0
"""Usual turns of a joint without limits: those of most such arms go from -360 to 360 degrees."""
FOLLOWS: Final = 0.8
"""Correlation from which two signals count as the same quantity."""


def audit_units(robot: Robot, motions: Sequence[Motion]) -> Iterator[Remark]:
    """Yield remarks about units that look wrong, those of the times among them."""
    speeds: dict[str, float] = {}
    for joint in robot.joints:
        own = [one for one in motions if joint.name in one.joints and not is_short(one.joints[joint.name])]
        names = tuple(motion.name for motion in own)
        samples = [joint_samples(motion.joints[joint.name]) for motion in own]
        speeds[joint.name] = speed_ratio(own, joint.name)
        is_told = joint.mode is ControlMode.POSITION
        ratio = _ratio((one.command, one.position) for one in samples) if is_told else math.nan
        wrong = [*_compare(ratio, joint, names, "the position", "its command")]
        if own and not wrong:
            wrong = [*_beyond_range(robot, joint, names, samples)]
        yield from wrong or (_beside_command(joint, names, samples) if ratio > 0.0 else ())
    yield from _compare_velocities(robot, speeds, tuple(motion.name for motion in motions))
    yield from _all_small(robot, motions)


def _all_small(robot: Robot, motions: Sequence[Motion]) -> Iterator[Remark]:
    """Remark positions in degrees that would be a turn or less if they were radians, at all hinges."""
    hinges = [joint.name for joint in robot.joints if not joint.is_slide]
    tables = {} if robot.file is None else robot.file.joints
    if not hinges or any(name not in tables or tables[name].position.unit != "deg" for name in hinges):
        return
    shown = [motion.joints[name] for name in hinges for motion in motions if name in motion.joints]
    moved = [joint_samples(log).position for log in shown]
    widest_deg = math.degrees(max(map(span, moved), default=math.inf))
    if widest_deg < math.tau:
        text = (
            f"no joint moves by more than {widest_deg:.2g} degrees in a motion: are the positions in radians?"
        )
        yield Remark(RemarkKind.STILL, "", tuple(motion.name for motion in motions), text, widest_deg)


def _compare_velocities(
    robot: Robot, ratios: Mapping[str, float], motions: tuple[str, ...]
) -> Iterator[Remark]:
    """Remark velocities that are not the change of the position; if all joints agree, the times are wrong."""
    known = {name: one for name, one in ratios.items() if math.isfinite(one)}
    wrong = {name: one for name, one in known.items() if not is_near(one, 1.0)}
    what, other = "the velocity", "the change of the position"
    found = [(robot.joint(name), ratio) for name, ratio in wrong.items()]
    by_unit = [remark for joint, ratio in found for remark in _compare(ratio, joint, motions, what, other)]
    yield from by_unit
    if by_unit or not wrong:
        return
    middle = float(np.median(list(known.values())))
    if len(wrong) == len(known) > 1 and all(is_near(one, middle) for one in wrong.values()):
        text = (
            f"the velocities of all joints are {middle:.3g} times the change of the positions: are the times "
            f"too {'long' if middle > 1.0 else 'short'} by {max(middle, 1.0 / middle):.3g}?"
        )
        yield Remark(RemarkKind.UNIT, "", motions, text, middle)
        return
    for name, ratio in wrong.items():
        text = f"{what} is {ratio:.3g} times {other}: is a unit or a factor wrong?"
        yield Remark(RemarkKind.UNIT, name, motions, text, ratio)


def is_near(ratio: float, factor: float) -> bool:
    """Return whether a ratio is a factor within CLOSE."""
    return ratio > 0.0 and abs(math.log(ratio / factor)) < math.log(CLOSE)


def speed_ratio(motions: Sequence[Motion], joint: str) -> float:
    """Return the ratio of the logged velocity of a joint to the change of its position; NaN if unknown."""
    samples = [joint_samples(motion.joints[joint]) for motion in motions]
    return _ratio(_velocities(motions, samples, joint))


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


def _compare(
    ratio: float, joint: RobotJoint, motions: tuple[str, ...], what: str, other: str
) -> Iterator[Remark]:
    """Remark a signal that runs against another, or is a factor of two units times it."""
    if ratio < 0.0:
        text = f"{what} runs against {other}: is factor = -1 missing at one of them?"
        yield Remark(RemarkKind.UNIT, joint.name, motions, text, ratio)
    for factor, unit in _factors(joint).items():
        for signed, wrong, right in ((factor, what, other), (1.0 / factor, other, what)):
            if is_near(ratio, signed):
                text = f"{what} is {ratio:.3g} times {other}: is {wrong} in {unit}, or is the unit "
                text += f"of {right} in the robot file wrong?"
                yield Remark(RemarkKind.UNIT, joint.name, motions, text, ratio)


def _beside_command(
    joint: RobotJoint, motions: tuple[str, ...], samples: Sequence[Samples]
) -> Iterator[Remark]:
    """Remark positions that follow a command, but farther beside it than it goes: another zero.

    Gravity holds a servo off its command by less than it moves, or nothing could be done with it.
    """
    command = np.concatenate([one.command for one in samples])
    error = np.concatenate([one.position for one in samples]) - command
    off = float(np.median(error[np.isfinite(error)]))  # there is some, as they vary alike
    if abs(off) > max(span(command), COARSE_RAD * joint.per_rad):
        text = f"the position lies {joint.show(off)} beside its command: is zero_rad missing at one of them?"
        yield Remark(RemarkKind.UNIT, joint.name, motions, text, off)


def _factors(joint: RobotJoint) -> dict[float, str]:
    return SLIDE_FACTORS if joint.is_slide else FACTORS


def _beyond_range(
    robot: Robot, joint: RobotJoint, motions: tuple[str, ...], samples: Sequence[Samples]
) -> Iterator[Remark]:
    """Remark positions far beyond the range of the model that would lie within it in another unit.

    Without limits, those of a hinge that go over many turns, as degrees would.
    """
    positions = np.concatenate([one.position for one in samples])
    low, high = float(positions.min(initial=math.inf)), float(positions.max(initial=-math.inf))
    range_rad = robot.range_rad(joint.name)
    if not math.isfinite(range_rad[1]):
        if not joint.is_slide and high - low > math.tau * TURNS:
            question = _ask_counts(robot, joint, (high - low) / math.tau) or "is the log in degrees?"
            text = f"the position goes from {low:.4g} to {high:.4g} rad, over many turns: {question}"
            yield Remark(RemarkKind.TURNS, joint.name, motions, text, high - low, unit="rad")
        return
    if turns := 0 if joint.is_slide else _turns_off(range_rad, positions):
        count = "a turn" if abs(turns) == 1 else f"{abs(turns)} turns"
        text = (
            f"the position lies {count} {'above' if turns > 0 else 'below'} the range of the model: add "
            f"zero_rad = {-turns * math.tau:.6g} to position and command"
        )
        yield Remark(RemarkKind.UNIT, joint.name, motions, text, float(turns))
        return
    allowed, largest = max(map(abs, range_rad)), max(-low, high)
    if largest <= 3.0 * allowed:
        return
    question = _ask_counts(robot, joint, largest / allowed) or _ask_unit(robot, joint, largest / allowed)
    if question:
        ends = f"the position reaches {joint.show(largest)}, the model ends at {joint.show(allowed)}"
        text = f"{ends}: {question}"
        yield Remark(RemarkKind.UNIT, joint.name, motions, text, largest / allowed)


def _ask_unit(robot: Robot, joint: RobotJoint, ratio: float) -> str:
    """Ask whether a log is in the unit in which positions that are too large would lie in the range."""
    for factor, unit in _factors(joint).items():
        if ratio <= factor * CLOSE:
            is_lost = unit == "degrees" and _looks_lost(robot)
            lost = ', or has the model lost angle="radian"?' if is_lost else ""
            return f"is the log in {unit}? That is a factor of {factor:.4g}{lost}"
    return ""


def _looks_lost(robot: Robot) -> bool:
    """Tell whether all hinges have ranges of a turn or less if the degrees of the model are radians.

    Those of a model that says so, or is in degrees, are larger: no arm moves each joint by 6.3 degrees alone.
    """
    ranges_rad = [robot.range_rad(one.name) for one in robot.joints if not one.is_slide]
    largest_rad = max((abs(end) for one in ranges_rad for end in one if math.isfinite(end)), default=math.inf)
    return math.degrees(largest_rad) < 1.01 * math.tau and 'angle="radian"' not in robot.model_xml


def _ask_counts(robot: Robot, joint: RobotJoint, ratio: float) -> str:
    """Ask for the counts of a turn where positions in counts are too large by a ratio; else nothing."""
    table = None if robot.file is None else robot.file.joints[joint.name]
    counts = table.position.counts_per_turn if table and table.position.unit in COUNTS else None
    if counts is None:
        return ""
    more = counts * 2 ** math.ceil(math.log2(ratio))
    return f"is counts_per_turn = {counts:g} right? With {more:g} or more it would fit"


def _turns_off(range_rad: tuple[float, float], positions: Array) -> int:
    """Return by how many whole turns all positions lie beyond the range of the model; 0 if by none."""
    if not positions.size:
        return 0
    low, high = np.quantile(positions, [0.01, 0.99])
    turns = round(((low + high) / 2.0 - math.fsum(range_rad) / 2.0) / math.tau)
    slack = ROUND * (range_rad[1] - range_rad[0])
    least, most = range_rad[0] - slack, range_rad[1] + slack
    is_inside = low - turns * math.tau > least and high - turns * math.tau < most
    return turns if is_inside and (low > most or high < least) else 0
