"""`marsarm arm`: the frames of an arm are those of its kinematics, and the picture names them."""

import json

import numpy as np
import pytest

from fsw.config import configure
from fsw.kinematics.chain import forward, tool_pose
from marsarm.arms.arm import layout_document, save_layout_picture, show_arm
from marsarm.arms.request import ArmRequest
from sim.arm_model.load import arm_names
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm


@pytest.mark.parametrize("name", arm_names())
def test_frames_are_where_the_kinematics_of_the_rigid_arm_place_them(name):
    layout = show_arm(ArmRequest(name))
    arm = configure(layout.model.params).arm
    frames = forward(arm, layout.output_rad[:, None])
    assert np.array_equal(layout.X_RF["arm6"].p, frames.X_RF.p[:, 5, 0])
    for tool in arm.X_FT:
        assert np.array_equal(layout.X_RF[tool].p, tool_pose(arm, frames, tool).p[:, 0])
    json.dumps(to_json(layout_document(layout)), allow_nan=False)


def test_the_picture_is_a_png_and_a_second_one_is_the_same(tmp_path):
    layout = show_arm(ArmRequest())
    for name in ("a.png", "b.png"):
        assert save_layout_picture(layout, tmp_path / name) is None
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_an_arm_that_is_not_there_is_named():
    with pytest.raises(BadRequest, match="viking"):
        show_arm(ArmRequest("viking"))


def test_the_command_prints_one_document(tmp_path):
    done = marsarm(tmp_path, "arm", "m2020", "--picture", "arm.png", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["name"] == "m2020"
    assert [path.name for path in tmp_path.iterdir()] == ["arm.png"]
