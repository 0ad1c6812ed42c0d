import importlib.util
import signal
from pathlib import Path

import mujoco
import numpy as np
import PIL.Image
import pytest

from marsarm.render.picture import save_movie, save_picture
from marsarm.render.rays import RayCamera, Rays
from simgap.common.errors import BadRequest
from simgap.common.interruption import Interrupted
from tests.marsarm.command import largest_file

SCENE = """
<mujoco>
  <worldbody>
    <light directional="true" dir="0.3 0.2 -1"/>
    <camera name="front" pos="0 -3 1.2" xyaxes="1 0 0 0 0.35 0.94" fovy="45"/>
    <geom name="ground" type="plane" size="0 0 1" rgba="0.6 0.3 0.2 1"/>
    <geom type="box" size="0.2 0.2 0.2" pos="-1 0 0.2" rgba="0.9 0.1 0.1 1"/>
    <geom type="cylinder" size="0.15 0.3" pos="-0.5 0 0.3" rgba="0.1 0.9 0.1 1"/>
    <geom type="ellipsoid" size="0.1 0.2 0.3" pos="0.5 0 0.3" rgba="0.1 0.1 0.9 1"/>
    <geom type="capsule" size="0.1 0.2" pos="1 0 0.3" rgba="0.9 0.9 0.1 1"/>
    <geom name="hidden" type="sphere" size="0.3" pos="0 -1 0.5" group="3"/>
    <body name="ball" pos="0 0 0.2">
      <joint name="lift" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.02"/>
      <geom type="sphere" size="0.2" pos="0 0 0.4" rgba="0.9 0.1 0.9 1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""
SIZE = (160, 120)


@pytest.fixture
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def pixels(path: Path) -> np.ndarray:
    with PIL.Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def test_a_picture_has_its_size_and_many_colours(model, data, tmp_path):
    result = save_picture(model, data, "front", tmp_path / "scene.png", SIZE)
    assert (result.path, result.hint) == (tmp_path / "scene.png", None)
    image = pixels(result.path)
    assert image.shape == (120, 160, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100


def test_rays_show_every_shape_in_its_colour_and_nothing_hidden(model, data):
    image = RayCamera(model, 0, SIZE).take(data).astype(int)

    brightest = image.max(axis=2, keepdims=True) - image < 40
    colours = {tuple(colour) for colour in brightest.reshape(-1, 3)}
    red, green, blue = (True, False, False), (False, True, False), (False, False, True)
    assert {red, green, blue, (True, True, False), (True, False, True)} <= colours
    data.geom_xpos[model.geom("hidden").id] = (0, 0, 100)
    assert np.array_equal(image, RayCamera(model, 0, SIZE).take(data))


def test_rays_agree_with_single_rays_though_only_geoms_in_the_way_are_asked(model, data):
    rng = np.random.default_rng(1)
    eye = np.array([0.3, -2.0, 1.0])
    middle = np.array([0.0, 1.0, -0.3])
    direction = middle + rng.uniform(-0.5, 0.5, (500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)

    geom, distance, _ = Rays(model).cast(data, eye, direction)

    shown = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    for ray in range(len(direction)):
        hit = np.array([-1], np.int32)
        reach = mujoco.mj_ray(model, data, eye, direction[ray], shown, True, -1, hit)
        assert (geom[ray], distance[ray]) == (hit[0], pytest.approx(reach))


def test_shadow_is_darker_than_the_ground_beside_it(model, data):
    rays = Rays(model)
    up = np.array([[0.0, 0.0, 1.0]])
    sun = data.light_xdir[0]
    under_the_box = np.array([-1.0, 0.0, 0.4]) + sun * 0.4 / -sun[2] + [0.05, 0.0, 0.0]
    open_ground = np.array([0.0, -2.0, 0.0])

    shaded, _ = rays.brightness(data, under_the_box[None] * [1, 1, 0], up)
    lit, _ = rays.brightness(data, open_ground[None], up)

    assert np.all(shaded < 0.7 * lit)


def test_movie_has_a_frame_for_each_pose(model, tmp_path):
    poses = [np.array([height]) for height in np.linspace(0.0, 0.5, 6)]
    result = save_movie(model, poses, "front", tmp_path / "lift.gif", (80, 60))
    with PIL.Image.open(result.path) as movie:
        assert movie.n_frames == 6
        assert movie.size == (80, 60)


def test_unknown_camera_names_the_cameras_there_are(model, data, tmp_path):
    with pytest.raises(BadRequest, match="no camera 'back'; the model has: front"):
        save_picture(model, data, "back", tmp_path / "scene.png", SIZE)


def test_size_must_be_positive(model, data, tmp_path):
    with pytest.raises(BadRequest, match="size 0 x 10"):
        save_picture(model, data, "front", tmp_path / "scene.png", (0, 10))


@pytest.mark.parametrize(("name", "is_new"), [("scene.png", True), ("lift.gif", False)])
def test_a_picture_or_movie_is_written_whole_or_not_at_all(model, data, tmp_path, name, is_new):
    path = tmp_path / name
    if not is_new:
        path.write_bytes(b"before")
    with largest_file(1000):
        if name.endswith(".png"):
            result = save_picture(model, data, "front", path, SIZE)
        else:
            result = save_movie(model, np.linspace(0.0, 0.5, 6)[:, None], "front", path, SIZE)
    assert result.path is None
    assert f"{path} cannot be written (File too large)" in result.hint
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == ({} if is_new else {name: b"before"})


def test_an_interrupted_movie_leaves_the_one_before(model, tmp_path, monkeypatch):
    path = tmp_path / "lift.gif"
    path.write_bytes(b"before")

    def interrupt(self, file, *_, **__):
        Path(file).write_bytes(b"half")
        raise Interrupted(signal.SIGINT)

    monkeypatch.setattr(PIL.Image.Image, "save", interrupt)
    with pytest.raises(Interrupted):
        save_movie(model, np.linspace(0.0, 0.5, 3)[:, None], "front", path, SIZE)
    assert [one.read_bytes() for one in tmp_path.iterdir()] == [b"before"]


def test_movie_without_frames_is_refused(model, tmp_path):
    with pytest.raises(BadRequest, match="no frame"):
        save_movie(model, [], "front", tmp_path / "empty.gif", SIZE)


def test_missing_pillow_is_a_message(model, data, tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    result = save_picture(model, data, "front", tmp_path / "scene.png", SIZE)
    assert result.path is None
    assert result.hint == "no picture: Pillow is missing; pip install pillow"
    movie = save_movie(model, [], "front", tmp_path / "scene.gif", SIZE)
    assert movie.hint == "no movie: Pillow is missing; pip install pillow"
    assert list(tmp_path.iterdir()) == []
