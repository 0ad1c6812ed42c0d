"""Commands of another motion are recognised, also where a weak servo hangs far below its command."""

import numpy as np
import pytest

from helpers.pendulum import motion, pendulum
from simgap.common.errors import RobotError
from simgap.diagnosis import check_motions, count_foreign_commands
from simgap.logs import Signal

TIME_s = np.arange(0.0, 8.0, 0.02)
COMMANDS = [0.5 * np.sin((1.0 + 0.4 * k) * TIME_s) for k in range(6)]


@pytest.mark.parametrize(("gain", "offset_rad"), [(1.0, 0.0), (0.3, -0.8), (1.2, 0.4)])
def test_a_shift_of_all_commands_is_counted_and_their_own_are_not(gain, offset_rad):
    random = np.random.default_rng(1)
    positions = [
        Signal(TIME_s, offset_rad + gain * one + random.normal(0.0, 0.01, one.size)) for one in COMMANDS
    ]
    own = [Signal(TIME_s, one) for one in COMMANDS]
    assert count_foreign_commands([*zip(positions, own, strict=True)]) == 0
    assert count_foreign_commands([*zip(positions, own[1:] + own[:1], strict=True)]) == 6


def test_a_command_that_is_too_short_is_no_rival():
    positions = [Signal(TIME_s, one) for one in COMMANDS[:2]]
    short = [Signal(TIME_s[:100], COMMANDS[1][:100]), Signal(TIME_s[:100], COMMANDS[0][:100])]
    assert count_foreign_commands([*zip(positions, short, strict=True)]) == 0


def test_a_motion_that_is_fitted_twice_is_refused():
    robot = pendulum()
    one = motion(np.arange(0.0, 1.0, 0.01), np.zeros(100), np.zeros(100))
    with pytest.raises(RobotError, match="motion m: is fitted twice"):
        check_motions(robot, [one, one], [])
