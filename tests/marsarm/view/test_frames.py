"""Frames: what is drawn is where the plant was, and what flight software estimated."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import forward
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder, run_header
from marsarm.view.scene import build_scene
from marsarm.view.watched_run import compute_frames, watch_log
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params
from sim.effects.geometry import ToolOffset
from sim.effects.structure import StandInTurret
from sim.plant import Plant
from sim.setting import World
from sim.world import build
from simgap.common.errors import BadRequest
from tests.marsarm.view.lab import ARM, COMMANDS, TILTED, arm_at, records_of, start_loop
from tests.replay.remake import FOLDER
from tests.tools import TOOLS

AT_REST_M = 0.1e-3
MOVING_M = 1.5e-3
"""The springs of the drawn arm are in equilibrium; those of a moving arm swing."""


@pytest.mark.parametrize("seed", range(3))
def test_every_body_of_a_deflected_arm_is_drawn_where_mujoco_has_it(seed):
    rng = np.random.default_rng(seed)
    scene = build_scene(World(), default_arm())
    output_rad, strain = rng.uniform(-1.0, 1.0, (5, 1)), rng.uniform(-5e-3, 5e-3, (6, 6, 1))
    strain[:, 5] = 0.0  # the turret has no spring
    plant = Plant(build(World(), for_pictures=True).compile())
    plant.show(output_rad[:, 0], strain[..., 0])

    X_WB = scene.carrier_poses(forward(build_arm(nominal_params()), output_rad, strain))

    for number, name in enumerate(scene.carriers):
        body = plant.model.body(name).id
        assert X_WB.p[:, number, 0] == pytest.approx(plant.data.xpos[body], abs=1e-9), name
        assert X_WB.R[..., number, 0].ravel() == pytest.approx(plant.data.xmat[body], abs=1e-9), name


def test_every_visible_geom_is_in_the_scene():
    model = build(World(), for_pictures=True).compile()
    scene = build_scene(World(), default_arm())
    assert set(scene.carriers) == {
        model.body(model.body_weldid[body]).name
        for body, group in zip(model.geom_bodyid, model.geom_group, strict=True)
        if model.body_weldid[body] and group < 3
    }
    assert {part.carrier for part in scene.parts} == set(range(-1, len(scene.carriers)))


def test_the_true_tool_is_drawn_where_the_plant_recorded_it(run, log):
    samples, scene = run.frames.samples, run.scene
    truth = read_log(log)["/truth"]
    rows = np.round(samples.time_s * 64).astype(int)
    recorded_W_m = truth["p_RoTo_R_m"][rows, samples.tool] @ scene.X_WR.R.T + scene.X_WR.p
    drawn_W_m = run.frames.p_m[:, -1] + run.frames.true[:, -1, :3]
    error_m = np.linalg.norm(drawn_W_m - recorded_W_m, axis=1)
    assert error_m.max() < MOVING_M
    assert error_m[[0, -1]].max() < AT_REST_M
    assert run.frames.tool_error_m[-1] > 5e-3, "the arm differs from its parameters"


def test_the_believed_tool_is_where_flight_software_estimated_it(run, log):
    read = read_log(log)
    tool, scene = read["/tool"][-1], run.scene
    estimated_W_m = scene.X_WR.R @ tool["p_RoTo_R_m"] + scene.X_WR.p
    frame = np.searchsorted(run.frames.samples.time_s, read.ticks("/tool")[-1] / 64, side="right") - 1
    drawn_W_m = run.frames.p_m[frame, -1] + run.frames.believed[frame, -1, :3]
    assert drawn_W_m == pytest.approx(estimated_W_m, abs=1e-4)


def test_a_factor_magnifies_what_compliance_and_backlash_add(run):
    frames, time_s = run.frames, 1.1
    (p1, q1), (p10, q10) = (arm_at(frames, frames.true, time_s, factor) for factor in (1.0, 10.0))
    rigid_p, rigid_q = arm_at(frames, frames.true, time_s, 0.0)
    assert p10 - rigid_p == pytest.approx(10.0 * (p1 - rigid_p), abs=1e-9)
    turn = [(Rotation.from_quat(q) * Rotation.from_quat(rigid_q).inv()).as_rotvec() for q in (q1, q10)]
    assert turn[1] == pytest.approx(10.0 * turn[0], abs=1e-6)
    assert np.linalg.norm(p1[-1] - rigid_p[-1]) > 5e-3, "gravity bends the arm"


def test_quaternions_do_not_jump(run):
    assert (np.sum(run.frames.q[1:] * run.frames.q[:-1], axis=-1) > 0.9).all()


def test_the_rover_and_the_ground_of_a_tilted_world_are_drawn_with_gravity_down():
    scene = build_scene(TILTED, default_arm())
    down_W = scene.X_WR.R @ TILTED.gravity_N_m_s2
    assert down_W / np.linalg.norm(down_W) == pytest.approx([0, 0, -1], abs=1e-9)


def test_a_log_without_truth_or_world_shows_the_believed_arm_and_says_so():
    run = watch_log(FOLDER / "contact.mcap")
    assert run.frames.true is None
    assert any("no truth" in note for note in run.notes)
    assert any("where rock and ground were" in note for note in run.notes)


@pytest.fixture
def logged(tmp_path):
    """Return a function that records some cycles with another header, and prepares them for a view."""

    def prepare(arm, effects=(), changes=()):
        loop = start_loop(arm, TILTED)
        header = run_header(loop, arm.name, 0, {}, COMMANDS, effects, TILTED)
        with Recorder(tmp_path / "run.mcap", header | dict(changes), loop.config.params) as recorder:
            for record in islice(records_of(loop), 64):
                recorder.write(record)
        return watch_log(tmp_path / "run.mcap")

    return prepare


@pytest.mark.slow
def test_effects_of_a_log_are_those_of_the_tools_of_its_arm(logged):
    arm = arm_named("m2020")
    own = next(tool for tool in arm.params.tool_names if tool not in TOOLS)
    shown = arm.params.tool_names[0]
    run = logged(arm, (ToolOffset(own, "x", 0.05), ToolOffset(shown, "x", 0.05)))
    assert run.notes == ()
    without = logged(arm)
    offset_m = run.frames.true[:, -1, :3] - without.frames.true[:, -1, :3]
    assert np.linalg.norm(offset_m, axis=1) == pytest.approx(0.05, abs=1e-4)


def test_an_arm_that_this_machine_does_not_know_has_no_truth_and_the_view_says_so(logged):
    run = logged(ARM, changes={"arm": "spare-arm/as-built:3"})
    assert run.frames.true is None
    assert any("does not know the arm of the log, 'spare-arm/as-built:3'" in note for note in run.notes)


def test_a_drawing_that_changed_since_the_run_has_no_truth_and_the_view_says_so(logged):
    model = replace(ARM.params.model, sha256="0" * 64)
    run = logged(replace(ARM, params=replace(ARM.params, model=model)))
    assert run.frames.true is None
    assert any("The drawing has changed since the run" in note for note in run.notes)


def test_a_log_of_a_drawing_that_is_not_here_is_refused(logged):
    with pytest.raises(BadRequest, match="is of the drawing 'm2020', which 'spare-arm' does not name here"):
        logged(arm_named("m2020"), changes={"arm": "spare-arm"})


def test_a_tool_that_the_arm_lacks_is_refused(run):
    samples, arm = run.frames.samples, build_arm(nominal_params())
    beyond = replace(samples, tool=np.full_like(samples.tool, len(TOOLS)))
    with pytest.raises(BadRequest, match=f"has tool {len(TOOLS)}, and its parameters have the tools 0 to"):
        compute_frames(run.scene, beyond, arm, arm, None)


@pytest.mark.slow
def test_an_arm_without_its_turret_is_drawn_without_it(logged):
    whole, bare = (logged(ARM, effects).scene for effects in ((), (StandInTurret(0.0),)))
    assert whole.carriers == bare.carriers
    faces, kept = (
        [sum(len(p.triangles.faces) for p in one.parts if p.carrier == k) for k in range(len(one.carriers))]
        for one in (whole, bare)
    )
    assert kept[:-1] == faces[:-1]
    assert kept[-1] < 0.5 * faces[-1]


def test_cycles_without_finite_angles_are_left_out(run):
    samples = run.frames.samples
    broken = samples.believed_rad.copy()
    broken[2, :5] = np.nan
    arm, nothing = build_arm(nominal_params()), np.full_like(broken, np.nan)
    partly = compute_frames(run.scene, replace(samples, believed_rad=broken), arm, arm, None)
    assert len(partly.p_m) == len(run.frames.p_m) - 5
    with pytest.raises(BadRequest, match="no finite angles"):
        compute_frames(run.scene, replace(samples, believed_rad=nothing), arm, arm, None)
