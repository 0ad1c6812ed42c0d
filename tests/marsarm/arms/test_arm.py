"""`marsarm arm`: frames are those of the kinematics, and files that are stale are made anew."""

import json

import numpy as np
import pytest

from fsw.config import configure
from fsw.kinematics.chain import forward, tool_pose
from marsarm.arms.arm import (
    LINK_NAMES,
    build_arms,
    directions_away,
    layout_document,
    make_files,
    save_layout_picture,
    show_arm,
)
from marsarm.common.options import ArmRequest
from sim.arm_model.load import ARMS, arm_names, default_arm
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm_json


@pytest.mark.parametrize("name", arm_names())
def test_frames_are_where_the_kinematics_of_the_rigid_arm_place_them(name):
    layout = show_arm(ArmRequest(name))
    arm = configure(layout.model.params).arm
    frames = forward(arm, layout.output_rad[:, None])
    assert np.array_equal(layout.X_RF["arm6"].p, frames.X_RF.p[:, 5, 0])
    for tool in arm.X_FT:
        assert np.array_equal(layout.X_RF[tool].p, tool_pose(arm, frames, tool).p[:, 0])
    json.dumps(to_json(layout_document(layout)), allow_nan=False)


@pytest.mark.slow
def test_the_picture_is_a_png_and_a_second_one_is_the_same(tmp_path):
    layout = show_arm(ArmRequest())
    for name in ("a.png", "b.png"):
        assert save_layout_picture(layout, tmp_path / name) is None
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("vertical", [1, 2])
@pytest.mark.parametrize("name", arm_names())
def test_in_a_picture_the_name_of_a_frame_stands_nearest_to_its_own_origin(name, vertical):
    X_RF = show_arm(ArmRequest(name)).X_RF
    origins = np.array([X_RF[link].p for link in LINK_NAMES])[:, (0, vertical)]
    distinct = np.unique(origins, axis=0)
    for p, away in zip(origins, directions_away(origins), strict=True):
        distances = np.linalg.norm(distinct - (p + 0.1 * away), axis=1)
        np.testing.assert_array_equal(distinct[distances.argmin()], p)


def test_an_arm_that_is_not_there_is_named():
    with pytest.raises(BadRequest, match="viking"):
        show_arm(ArmRequest("viking"))


def test_the_command_prints_one_document(tmp_path):
    assert marsarm_json(tmp_path, "arm", "m2020", "--picture", "arm.png")["name"] == "m2020"
    assert [path.name for path in tmp_path.iterdir()] == ["arm.png"]


@pytest.mark.parametrize("name", arm_names())
def test_the_files_of_an_arm_are_what_its_description_says(name):
    """`marsarm arm --build` makes them."""
    assert make_files(name).stale == ()


@pytest.mark.slow
def test_a_file_that_is_not_text_is_stale_and_written_anew(tmp_path):
    (tmp_path / "arm.toml").write_bytes((ARMS / default_arm().name / "arm.toml").read_bytes())
    (tmp_path / "arm.xml").write_bytes(b"\xff\xfe")
    build_arms(ArmRequest(str(tmp_path)))
    assert (tmp_path / "arm.xml").read_text().startswith("<!-- Made from arm.toml")
    assert make_files(str(tmp_path)).stale == ()


def test_an_arm_that_mujoco_does_not_accept_is_not_built(tmp_path):
    (tmp_path / "arm.toml").write_bytes((ARMS / default_arm().name / "arm.toml").read_bytes())
    looks = "<visual><asset><material name='arm_titanium'/></asset><body name='link2'><geom/></body></visual>"
    (tmp_path / "visual.xml").write_text(looks)
    with pytest.raises(BadRequest, match="MuJoCo does not accept its plant"):
        build_arms(ArmRequest(str(tmp_path)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml", "visual.xml"]
