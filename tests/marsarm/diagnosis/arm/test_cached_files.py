"""Cached files of a campaign and tables beside logs: an error names damage and remedy."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fsw.kinematics.transforms import IDENTITY, stack_poses
from marsarm.diagnosis.arm import diagnose_logs, logs, record
from marsarm.diagnosis.arm.logs import NotForDiagnosis, TrackerPoses, read_tracker_poses, write_tracker_poses
from marsarm.diagnosis.arm.request import RecordRequest
from sim.diagnosis_campaign import DiagnosisSession, SessionFailed
from simgap.common.errors import BadRequest, RobotError
from simgap.common.progress import no_progress

SEEN = TrackerPoses(np.array([7, 90]), stack_poses([IDENTITY, IDENTITY]), np.full((6, 2), 1e-5))


def test_poses_of_a_tracker_come_back(tmp_path):
    write_tracker_poses(tmp_path / "t.csv", SEEN)
    again = read_tracker_poses(tmp_path / "t.csv")
    assert again.tick.tolist() == SEEN.tick.tolist()
    np.testing.assert_array_equal(again.sigma, SEEN.sigma)


@pytest.mark.parametrize(
    ("pattern", "by", "said"),
    [
        (r",z_sigma_m", "", "z_sigma_m"),
        (r"\n7,", "\nseven,", "'seven'"),
        (r"\n7,", "\n7.5,", "ticks must be whole numbers"),
        (r"(\n7,.*\n)", r"\1\1", "each there once"),
    ],
)
def test_a_table_that_is_none_of_poses_is_refused(tmp_path, pattern, by, said):
    path = tmp_path / "t.csv"
    write_tracker_poses(path, SEEN)
    path.write_text(re.sub(pattern, by, path.read_text(), count=1))
    with pytest.raises(RobotError, match=said):
        read_tracker_poses(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"name": "cold"', "EOF|JSON"),
        ('{"temperature_C": NaN}', "temperature_C: .*finite"),
        ('{"world": {"tilt_pitch_rad": 2.9}}', "tilts the rover by 2.9 rad"),
    ],
)
def test_a_session_that_a_header_cannot_mean_is_refused(text, said):
    with pytest.raises(NotForDiagnosis, match=f"log a.mcap: session in its header: .*({said})"):
        logs._read_session(text, Path("a.mcap"))


@dataclass(frozen=True)
class Named:
    """Recording with name and block only."""

    name: str
    block: str


def test_a_session_is_given_once_and_a_repeat_of_what_is_fitted_is_not_held_out():
    first, again, other = Named("cold", "cold"), Named("cold-again", "cold"), Named("warm", "warm")

    def check(fitted: list[Named], *held_out: Named) -> None:
        paths = [Path(f"{letter}.mcap") for letter in "abc"[: len(fitted) + len(held_out)]]
        diagnose_logs._check_sessions(paths, fitted, held_out)  # type: ignore[arg-type]

    check([first], other)
    with pytest.raises(NotForDiagnosis, match="cold-again repeats the motion of cold, which is not held out"):
        check([first], other, again)
    with pytest.raises(NotForDiagnosis, match=r"b\.mcap: is session cold, and so is a\.mcap"):
        check([first], first)


def test_a_part_of_a_campaign_is_beside_all_of_it_on_the_sides_that_its_logs_have(tmp_path):
    held_out = tmp_path / record.HELD_OUT_FOLDER
    held_out.mkdir()
    (held_out / "cold.mcap").touch()
    (tmp_path / "warm.mcap").touch()
    (tmp_path / "tour.mcap").touch()

    def sides(fitted: str, *apart: str) -> list[list[str]]:
        cases = [[Named(name, name) for name in names] for names in ((fitted,), apart)]
        found = diagnose_logs._campaign_logs(tmp_path, *cases)  # type: ignore[arg-type]
        return [[path.stem for path in side] for side in found]

    assert sides("warm", "cold") == [["tour", "warm"], ["cold"]]
    assert sides("warm") == [["tour", "warm"], []]
    for case, said in ((("placed",), "session placed"), (("warm", "tour"), "session that is held out tour")):
        with pytest.raises(NotForDiagnosis, match=f"has no {said}"):
            sides(*case)


def test_a_session_that_does_not_complete_has_no_log_and_is_said(tmp_path, monkeypatch):
    """Without a log of any session there is no folder."""

    def stopped(path: Path, session: DiagnosisSession, *_: object) -> None:
        path.touch()
        if session.name not in completed:
            raise SessionFailed(session.name)

    completed = {"poses-level-2", "poses-level-5"}
    monkeypatch.setattr(record, "_record_session", stopped)
    request = RecordRequest(tmp_path / "logs", sessions="poses-level-[235]")
    found = record.record_logs(request, no_progress)
    assert [path.name for path in found.logs] == ["poses-level-2.mcap", "poses-level-5.mcap"]
    assert all(path.exists() for path in found.logs)
    assert found.left_out == ("poses-level-3",)
    completed.clear()
    with pytest.raises(BadRequest, match="completes no session; with smaller effects"):
        record.record_logs(replace(request, out=tmp_path / "none"), no_progress)
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]
