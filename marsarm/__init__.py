"""Public names for Python users: flight software, the closed loop, and reading of logs.

Import everything else from `fsw`, `sim` and `ground`.
"""

from fsw.config import Config, configure
from fsw.cycle import step
from fsw.dictionary.enums import Joint
from fsw.kinematics.ik import inverse_kinematics
from fsw.messages import Outputs, Sensors
from fsw.state import State, boot
from ground.telemetry.read import Log, read_log
from sim.arms import BuiltArm, arm_named
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.world import Surface, World

__all__ = [
    "BuiltArm",
    "ClosedLoop",
    "Config",
    "CycleRecord",
    "Joint",
    "Log",
    "Outputs",
    "Sensors",
    "Setup",
    "State",
    "Surface",
    "Tool",
    "World",
    "arm_named",
    "boot",
    "configure",
    "inverse_kinematics",
    "read_log",
    "step",
]
