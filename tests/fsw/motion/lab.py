"""Reference for tests of motion: outputs at rest after motor turns, with backlash, wind-up and friction."""

import numpy as np

from fsw.config import Config
from fsw.estimate.gear import LIKELY, bound_gear, gear_after_motor_turn
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.statics import settle_output
from fsw.motion.plan import Plan
from tests.fsw.rig import MARS_R_m_s2, pose_of


def sampled(path, n=400):
    times = np.linspace(0.0, path.duration_s, n)
    setpoints = [path.at(t) for t in times]
    return times, np.array([s.motor_rad for s in setpoints]), np.array([s.rate_rad_s for s in setpoints])


def sample_closely(paths, poses: int = 200) -> np.ndarray:
    """Motor angles (5, n) along paths, so close to each other that nothing is missed in between."""
    return np.concatenate([sampled(path, poses)[1].T for path in paths], axis=1)


def likely(joints: JointEstimate) -> np.ndarray:
    return joints.gear_rad[:, LIKELY]


def gears_along(config: Config, gear_rad: np.ndarray, motor_rad: np.ndarray) -> np.ndarray:
    """Compute gear angles (n, 5) along motor angles (n, 5), from the gear angles at the first of them."""
    gears = np.tile(gear_rad, (len(motor_rad), 1))
    for _ in range(3):  # the loads depend on the outputs, which depend on the loads
        loads = settle_output(config.arm, (motor_rad + gears).T, MARS_R_m_s2).torque_Nm
        bounds = [bound_gear(config, config.half_backlash_rad, load[:, None]) for load in loads.T]
        turns = np.diff(motor_rad, axis=0, prepend=motor_rad[:1])
        gear, gears = gear_rad[:, None], np.empty_like(gears)
        for k, (turn, bound) in enumerate(zip(turns, bounds, strict=True)):
            gear = gear_after_motor_turn(gear, turn, bound)
            gears[k] = gear[:, 0]
    return gears


def gear_at_end(config: Config, joints: JointEstimate, plan: Plan, n: int = 400) -> np.ndarray:
    """Compute the gear angles at the end of a plan."""
    gear = likely(joints)
    for path in plan.paths:
        gear = gears_along(config, gear, sampled(path, n)[1])[-1]
    return gear


def along(config: Config, tool: str, path, gear_rad: np.ndarray, samples: int = 160) -> tuple:
    """Compute the tool poses along a path whose outputs follow the motors, and the gear angles at its end."""
    _, motor, _ = sampled(path, samples)
    gears = gears_along(config, gear_rad, motor)
    return pose_of(config.arm, (motor + gears).T, tool, MARS_R_m_s2), gears[-1]
