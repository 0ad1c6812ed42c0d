"""Triangles of geoms: closed surfaces with their normals outward, and the volume of the shape."""

import mujoco
import numpy as np
import pytest

from marsarm.render.rays import triangulate

MODEL = """
<mujoco>
  <asset><mesh name="corner" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
  <worldbody>
    <geom name="sphere" size="0.2"/>
    <geom name="capsule" type="capsule" size="0.1 0.3"/>
    <geom name="cylinder" type="cylinder" size="0.1 0.3"/>
    <geom name="ellipsoid" type="ellipsoid" size="0.1 0.2 0.3"/>
    <geom name="box" type="box" size="0.1 0.2 0.3"/>
    <geom name="mesh" type="mesh" mesh="corner"/>
    <geom name="plane" type="plane" size="2 3 1"/>
  </worldbody>
</mujoco>
"""
VOLUMES = {
    "sphere": 4 / 3 * np.pi * 0.2**3,
    "capsule": 4 / 3 * np.pi * 0.1**3 + 0.6 * np.pi * 0.1**2,
    "cylinder": 0.6 * np.pi * 0.1**2,
    "ellipsoid": 4 / 3 * np.pi * 0.1 * 0.2 * 0.3,
    "box": 0.2 * 0.4 * 0.6,
    "mesh": 1 / 6,
}


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


@pytest.mark.parametrize("name", VOLUMES)
def test_the_triangles_of_a_solid_enclose_its_volume_and_face_outward(model, name):
    found = triangulate(model, model.geom(name).id)
    a, b, c = found.vertices_m.astype(float)[found.faces].transpose(1, 0, 2)
    volume = np.sum(a * np.cross(b, c)) / 6
    assert volume == pytest.approx(VOLUMES[name], rel=0.07)
    edges = np.sort(
        _same_place(found)[np.vstack([found.faces[:, [i, (i + 1) % 3]] for i in range(3)])], axis=1
    )
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all(), "each edge of a closed surface belongs to two triangles"


def test_a_plane_has_its_size_and_faces_up(model):
    found = triangulate(model, model.geom("plane").id)
    assert np.ptp(found.vertices_m, axis=0).tolist() == [4.0, 6.0, 0.0]
    a, b, c = found.vertices_m[found.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def _same_place(found):
    """Return a number for the place of each vertex; vertices at sharp edges are there twice."""
    return np.unique(found.vertices_m.round(6) + 0.0, axis=0, return_inverse=True)[1].ravel()
