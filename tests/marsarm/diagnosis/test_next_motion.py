"""The next motion of this arm: the choice by sensitivities, the file of a motion, and its sessions."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.diagnosis.arm.case import CaseDiagnosis
from marsarm.diagnosis.arm.next_motion import NextArmMotion, propose_motion, save_files
from marsarm.diagnosis.arm.record import list_motions, make_session, motion_text, read_motion
from marsarm.diagnosis.arm.request import NextRequest
from sim.arms import arm_named, nominal_params
from sim.diagnosis_campaign import run_session, start_session
from sim.initialisation import true_reference
from simgap.common.errors import RobotError
from simgap.common.page import Origin

BLOCKS = {f"motion {k}": f"words {k}" for k in range(15)}


def test_the_motion_in_which_rivals_differ_most_is_chosen(made, campaign, results):
    """All blocks but one are made blind; the one that is left has to be chosen."""
    blind = np.where(made.layout.block == "motion 6", 1.0, 1e6)
    layout = replace(made.layout, sigma=0.1 * blind * made.layout.sigma)
    rivals = results["undecided"].rivals
    proposal = propose_motion(campaign, rivals, replace(made, layout=layout), BLOCKS)
    assert proposal.rivals[0] == proposal.finding
    assert len(proposal.rivals) > 1
    assert proposal.motions[proposal.choice.motions[0]] == "words 6"
    assert proposal.curves


def test_a_motion_is_read_again_from_its_file(tmp_path):
    motions = [*list_motions({"elbow"})]
    assert {one.joint for one in motions} == {"elbow", "all"}
    (tmp_path / "next.toml").write_text(motion_text(motions[4]))
    assert read_motion(tmp_path / "next.toml") == motions[4]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("count = 2", "count = 0", "count"),
        ('joint = "elbow"', 'joint = "knee"', "joint"),
        ("speed_share = 1.0", "speed_share = 3.0", "speed_share"),
    ],
)
def test_a_wrong_motion_is_refused_with_its_key(tmp_path, old, new, words):
    text = motion_text(next(iter(list_motions({"elbow"}))))
    assert old in text
    (tmp_path / "next.toml").write_text(text.replace(old, new))
    with pytest.raises(RobotError, match=rf"next\.toml: {words}"):
        read_motion(tmp_path / "next.toml")


@pytest.mark.parametrize("arm", ["nominal", "m2020"])
def test_every_motion_begins_and_ends_within_the_limits_of_every_arm(arm):
    params = arm_named(arm).params
    joints = params.joints.in_order()
    low, high = np.array([(one.soft_min_rad, one.soft_max_rad) for one in joints]).T
    for motion in list_motions():
        start = np.array(make_session(motion, params).start_rad)
        assert np.all((start >= low - 1e-9) & (start <= high + 1e-9))


def test_the_arm_completes_a_proposed_motion():
    arm, motion = arm_named("nominal"), next(iter(list_motions({"wrist"})))
    session = make_session(motion, arm.params)
    cycles = [*run_session(start_session(session, arm, true_reference(arm), seed=1), session)]
    assert sum(one.rested for one in cycles) == 1 + len(session.commands)


def test_without_a_motion_that_tells_anything_apart_no_file_is_written(tmp_path, made, campaign, results):
    deaf = replace(made.layout, sigma=1e6 * made.layout.sigma)
    rivals = results["undecided"].rivals
    proposal = propose_motion(campaign, rivals, replace(made, layout=deaf), BLOCKS)
    request = NextRequest((tmp_path,), out=tmp_path / "next.toml")
    motion = next(iter(list_motions()))
    assert save_files(NextArmMotion(request, proposal, motion, Origin("", {}))) == []
    assert not (tmp_path / "next.toml").exists()


@pytest.fixture
def propose(tmp_path, monkeypatch, made, campaign, results):
    """Run the command with a given diagnosis and given sensitivities of the planned motions."""
    monkeypatch.chdir(tmp_path)
    recorded: list[str] = []

    def diagnose(request, progress):
        return CaseDiagnosis(results["undecided"], (), campaign, nominal_params())

    def record(folder, sessions, *_):
        recorded.extend(one.name for one in sessions)
        return [folder / f"{one.name}.mcap" for one in sessions]

    def compute(logs, kept_in, run, progress, kinds, steps_of, arm):
        assert set(kinds) <= {one.effect for one in made.hypotheses}
        block = np.array([recorded[int(one.split()[1])] for one in made.layout.block])
        layout = replace(made.layout, block=block, sigma=0.01 * made.layout.sigma)
        return replace(made, layout=layout)

    for name, stand_in in (("diagnose", diagnose), ("record_campaign", record)):
        monkeypatch.setattr(f"marsarm.diagnosis.arm.next_motion.{name}", stand_in)
    monkeypatch.setattr("marsarm.diagnosis.arm.next_motion.compute_sensitivities", compute)
    return lambda *words: CliRunner().invoke(app, ["gap", "next", "a.mcap", *words])


def test_the_command_writes_a_motion_that_gap_record_reads_and_a_page(propose, tmp_path):
    done = propose("--out", "next.toml", "--report", "next.html", "--json")
    said = json.loads(done.stdout)
    assert done.exit_code == 0
    assert read_motion(tmp_path / "next.toml").describe() == said["motions"][0]["motion"]
    assert "<polygon" in (tmp_path / "next.html").read_text()
