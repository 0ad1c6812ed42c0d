"""Names of what stands in Answers by number: verdicts, joints."""

from typing import Final

from fsw.dictionary.enums import Joint
from fsw.kinematics.ik import BranchVerdict

JOINTS: Final = tuple(joint.name.lower() for joint in Joint)
VERDICTS: Final = tuple(verdict.name.lower() for verdict in BranchVerdict)
