"""Test of the picture of the collision shapes of arm and rover."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from marsarm.render.picture import PictureError
from marsarm.render.rover_scene import save_collision_picture
from sim.params import nominal_params

PARAMS = nominal_params()
READY = np.array(PARAMS.poses.ready_rad)


def test_the_shapes_of_arm_and_rover_are_in_the_picture(tmp_path: Path) -> None:
    drawn = save_collision_picture(PARAMS, READY, tmp_path / "shapes.png", size=(160, 90))
    image = np.asarray(PIL.Image.open(tmp_path / "shapes.png").convert("RGB")).astype(int)
    assert image.shape == (90, 160, 3)
    if drawn.renderer == "opengl":  # rays do not hit transparent geoms
        bluish = image[..., 2] > image[..., 0] + 30
        assert 0.005 < bluish.mean() < 0.5


def test_a_camera_that_there_is_not_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PictureError, match="there is no camera 'nowhere'"):
        save_collision_picture(PARAMS, READY, tmp_path / "shapes.png", "nowhere", (16, 9))
