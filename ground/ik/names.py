"""Names of what stands in Answers by number: verdicts, joints."""

from typing import Final

from fsw.dictionary.joints import Joint
from fsw.kinematics.answers import Verdict

JOINTS: Final = tuple(joint.name.lower() for joint in Joint)
VERDICTS: Final = tuple(verdict.name.lower() for verdict in Verdict)
