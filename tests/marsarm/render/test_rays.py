"""Rays: every shape in its colour, and shadows."""

import mujoco
import numpy as np
import pytest

from marsarm.render.rays import RayCamera, Rays

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
