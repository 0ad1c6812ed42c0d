"""`marsarm arm --build`: files that differ from what arm.toml says are written anew, whatever they hold."""

from pathlib import Path

import pytest

from marsarm.arms.arm import build_arms
from marsarm.arms.request import ArmRequest
from sim.arm_model.load import ARMS, default_arm
from simgap.common.errors import BadRequest


def test_a_file_that_is_not_text_is_stale_and_written_anew(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_bytes((ARMS / default_arm().name / "arm.toml").read_bytes())
    (tmp_path / "arm.xml").write_bytes(b"\xff\xfe")
    with pytest.raises(BadRequest, match=r"arm\.xml: is not what arm\.toml says"):
        build_arms(ArmRequest(str(tmp_path), check=True))
    build_arms(ArmRequest(str(tmp_path)))
    assert (tmp_path / "arm.xml").read_text().startswith("<!-- Made from arm.toml")
    build_arms(ArmRequest(str(tmp_path), check=True))


def test_an_arm_that_mujoco_does_not_accept_is_not_built(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_bytes((ARMS / default_arm().name / "arm.toml").read_bytes())
    looks = "<visual><asset><material name='arm_titanium'/></asset><body name='link2'><geom/></body></visual>"
    (tmp_path / "visual.xml").write_text(looks)
    with pytest.raises(BadRequest, match="MuJoCo does not accept its plant"):
        build_arms(ArmRequest(str(tmp_path)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml", "visual.xml"]
