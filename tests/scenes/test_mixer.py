"""Mixer: the mesh of the stirrer from its script."""

import importlib.util
from collections import Counter
from pathlib import Path

import meshio
import numpy as np
import pytest
from scene_runner import SCENES

TOOL = Path(__file__).parents[2] / "tools" / "make_mixer.py"


def stirrer():
    """Points [mm] and triangles of the stirrer from the script."""
    spec = importlib.util.spec_from_file_location("make_mixer", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    mesh = module.stirrer(pitch=45.0)
    return mesh.points, mesh.cells_dict["triangle"]


def test_stirrer_is_closed_with_outward_normals():
    points, triangles = stirrer()
    vertex_pairs = (
        np.concatenate([triangles, np.roll(triangles, -1, axis=1)], axis=0).reshape(2, -1).T.tolist()
    )
    edges = Counter(map(tuple, vertex_pairs))
    assert all(count == 1 and edges[b, a] == 1 for (a, b), count in edges.items())
    a, b, c = (points[triangles[:, i]] for i in range(3))
    blades = 4 * 35.5 * 14.0 * 3.0  # [mm3]
    shaft = 28.5 * 12 / 2 * 5.0**2 * np.sin(np.pi / 6)  # prism with twelve sides [mm3]
    assert np.sum(a * np.cross(b, c)) / 6 == pytest.approx(blades + shaft, rel=1e-12)


def test_shipped_stirrer_equals_the_mesh_of_the_script():
    points, triangles = stirrer()
    shipped = meshio.read(SCENES / "meshes" / "stirrer.stl")
    corners = shipped.points[shipped.cells_dict["triangle"]]
    np.testing.assert_allclose(corners, points[triangles], atol=1e-5)  # STL has single precision [mm]
