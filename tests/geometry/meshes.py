"""Meshes for tests, and their files."""

import meshio
import numpy as np

from granflow.geometry.mesh import mesh_of
from granflow.geometry.mesh_file import RawTriangles


def sheet(count, size=1.0, bumps=0.0, seed=1):
    """Points and corners of a square from -size/2 to size/2 at z = 0: count x count cells of two triangles
    each.

    `bumps` is the standard deviation of random heights.
    """
    x = np.linspace(-0.5 * size, 0.5 * size, count + 1)
    positions = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    z = bumps * np.random.default_rng(seed).standard_normal((count + 1, count + 1, 1))
    i = np.arange(count * (count + 1)).reshape(count, count + 1)[:, :count].reshape(-1)
    lower, upper = [i, i + count + 1, i + count + 2], [i, i + count + 2, i + 1]
    corners = np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)])
    return np.concatenate([positions, z], axis=-1).reshape(-1, 3), corners


def cube():
    """Points and corners of the surface of the unit cube, twelve triangles."""
    points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    corners = [half for a, b, c, d in faces for half in ([a, b, c], [a, c, d])]
    return points, np.array(corners)


def tube(facets, radius=1.0, length=2.0, rings=1):
    """Points and corners of a tube about z from 0 to `length`; the centers of its facets are `radius` from
    the axis."""
    angle = 2 * np.pi * (np.arange(facets) + 0.5) / facets
    outer = radius / np.cos(np.pi / facets)
    levels = np.linspace(0.0, length, rings + 1)
    points = [[outer * np.cos(a), outer * np.sin(a), z] for z in levels for a in angle]
    i, j = np.arange(facets), (np.arange(facets) + 1) % facets
    halves = [np.stack([i, j, j + facets], axis=1), np.stack([i, j + facets, i + facets], axis=1)]
    corners = [half + ring * facets for ring in range(rings) for half in halves]
    return np.array(points), np.concatenate(corners)


def mesh(points, corners):
    """The mesh of points and corners."""
    return mesh_of(RawTriangles(np.asarray(points, float), np.asarray(corners)))


def write(path, points, corners):
    """Write a mesh file in the format of its suffix: stl, obj, ply, vtk or vtu."""
    data = meshio.Mesh(points, [("triangle", np.asarray(corners, np.int32))])
    kind = {".stl": "stl", ".obj": "obj", ".ply": "ply", ".vtk": "vtk", ".vtu": "vtu"}[path.suffix]
    meshio.write(path, data, file_format=kind)
    return path
