"""Division of test files among processes."""

from xdist.scheduler import LoadFileScheduling

SHARING = ("tests/marsarm/calibration", "tests/marsarm/diagnosis", "tests/marsarm/view")
"""Folders whose files share runs that are made once in a process."""


class Scheduling(LoadFileScheduling):
    """Give each file, and each folder whose files share runs, to one process."""

    def _split_scope(self, nodeid):
        return next((one for one in SHARING if nodeid.startswith(f"{one}/")), super()._split_scope(nodeid))
