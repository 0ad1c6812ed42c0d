"""What the verbs `gap blind ...` are asked, checked before anything is done."""

import os
from pathlib import Path

from ground.common.files import check_new_path
from ground.common.requests import BadRequest, check_seed
from ground.diagnosis.blind.folder import CAMPAIGN, PART
from ground.diagnosis.blind.truth import DIGEST

MOST_CASES = 1000


def check_make(cases: int, seed: int, out: Path, jobs: int) -> None:
    """BadRequest or BadOutput if there cannot be such cases there; nothing is written."""
    if not 1 <= cases <= MOST_CASES:
        raise BadRequest(f"cases: {cases} is not within 1 .. {MOST_CASES}")
    check_seed(seed)
    check_jobs(jobs)
    check_new_path(out, "out")
    if not os.path.exists(out):
        return
    if not os.path.isdir(out):
        raise BadRequest(f"out {out}: this is a file; name a new folder, or one of blind cases")
    there = set(os.listdir(out))
    if there and not there & {DIGEST, CAMPAIGN, CAMPAIGN + PART}:
        raise BadRequest(f"out {out}: holds something else; name a new folder, or one of blind cases")


def check_jobs(jobs: int) -> None:
    """BadRequest unless there is a process to work in."""
    if jobs < 1:
        raise BadRequest(f"jobs: {jobs} is not 1 or more")
