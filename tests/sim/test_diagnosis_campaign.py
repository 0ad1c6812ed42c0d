"""Campaign of a diagnosis: its poses lie within the limits of every arm."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from sim.arms import arm_named
from sim.diagnosis_campaign import POSES, campaign_sessions


@pytest.mark.parametrize("name", ["nominal", "m2020"])
def test_every_pose_lies_within_the_soft_limits(name):
    params = arm_named(name).params
    least, most = np.transpose([(j.soft_min_rad, j.soft_max_rad) for j in params.joints.in_order()])
    for session in campaign_sessions(params):
        moves = [command for command in session.commands if hasattr(command, "angle_rad")]
        for pose in (session.start_rad, *(move.angle_rad for move in moves if np.size(move.angle_rad) == 5)):
            assert np.all((least <= pose) & (pose <= most)), session.name


def test_a_pose_beyond_a_limit_is_the_same_after_a_whole_turn():
    (nominal, other) = (campaign_sessions(arm_named(name).params)[0] for name in ("nominal", "m2020"))
    assert nominal.start_rad == tuple(np.radians(POSES[0][0]).tolist())
    turned = np.subtract(other.start_rad, nominal.start_rad)
    assert turned.tolist() == pytest.approx([0.0, 0.0, 0.0, 2.0 * np.pi, 0.0])
    (move,), (same,) = other.commands, nominal.commands
    assert np.subtract(move.angle_rad, same.angle_rad)[Joint.WRIST] == pytest.approx(2.0 * np.pi)
