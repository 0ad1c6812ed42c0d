"""The arm without its turret, as it is calibrated on Earth."""

from dataclasses import replace

from sim.arm_check import POSE_NAMES, compute_hardstop_loads, equalise_loads, with_poses
from sim.arms import BuiltArm
from sim.effects.structure import StandInTurret
from sim.setting import World


def without_turret(arm: BuiltArm, on_earth: bool) -> BuiltArm:
    """Return the arm without its turret, which flight software knows.

    On Earth its poses have the torques of the whole arm in its own poses on Mars.
    """
    turret = StandInTurret(0.0)
    bare = replace(arm, effects=(*arm.effects, turret), params=turret.on_params(arm.params))
    if not on_earth:
        return bare
    wanted_Nm = compute_hardstop_loads(arm.params, World().gravity_N_m_s2).torque_Nm
    drawn = arm.model.description.poses
    poses = {name: getattr(drawn, f"bare_hardstop_{name}") for name in POSE_NAMES}
    guess = with_poses(bare.params, poses)
    return replace(bare, params=equalise_loads(guess, World("earth").gravity_N_m_s2, wanted_Nm))
