"""From outputs along a way to motor paths that allow for how the gears lie on it."""

from dataclasses import replace

import numpy as np

from fsw.config import Config
from fsw.estimate.gear import STILL_RAD, bound_gear, gear_after_output_turn
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.motion.compensation import Compensation
from fsw.motion.paths import Path, Travel, joint_path, line_path
from fsw.motion.plan import Plan, Stand, standing


def plan_through(
    config: Config,
    joints: JointEstimate,
    output_rad: Array,
    load_Nm: Array,
    compensation: Compensation,
    travel: Travel,
) -> Plan:
    """Paths over equally spaced outputs (5, k) under their loads (5, k), from where the joints stand.

    Where a gear is to be crossed first, there is a joint move while the outputs stand still; so there is to
    the first outputs, where the joints stand elsewhere.
    """
    step = travel.length / (output_rad.shape[1] - 1)
    stiffness = config.arm.gear_stiffness_Nm_rad
    here = standing(joints)
    paths: list[Path] = []
    gear, knots = here.gear_rad, [here.motor_rad]
    unmade = np.zeros_like(here.gear_rad)
    first = output_rad[:, 0] - compensation.allowance(joints, gear)
    if np.abs(first - here.motor_rad).max() > STILL_RAD:
        paths.append(joint_path(config, here.motor_rad, first))
        knots = [first]
    for k, moved in enumerate(np.diff(output_rad).T, start=1):
        bounds = bound_gear(config, joints.reference.half_gap_rad, load_Nm[:, k])
        wound = (load_Nm[:, k] - load_Nm[:, k - 1]) / stiffness
        # many knots that are each too little to drag an output add up
        unmade = unmade + moved
        new_gear = gear_after_output_turn(gear + wound, unmade, bounds)
        unmade = np.where(np.abs(unmade) > STILL_RAD, 0.0, unmade)
        allowance = compensation.allowance(joints, new_gear)
        crossed = allowance - compensation.allowance(joints, gear + wound)
        if np.abs(crossed).max() > STILL_RAD:
            if len(knots) > 1:
                paths.append(_over(config, knots, step, travel))
            paths.append(joint_path(config, knots[-1], knots[-1] - crossed))
            knots = [knots[-1] - crossed]
        gear = new_gear
        knots.append(output_rad[:, k] - allowance)
    paths.append(_over(config, knots, step, travel))
    return Plan(tuple(paths), Stand(knots[-1], gear), compensation.gap(joints, gear))


def _over(config: Config, knots: list[Array], step: float, travel: Travel) -> Path:
    return line_path(config, np.array(knots), replace(travel, length=step * (len(knots) - 1)))
