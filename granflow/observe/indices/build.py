"""From a scene's `output.indices` to meters."""

from collections.abc import Mapping

import numpy as np

from granflow.observe.coarse.grid import Grid, grid_in
from granflow.observe.grains import chosen, free_grains
from granflow.observe.indices.meter import IndexMeter
from granflow.observe.indices.mixing import lacey_index
from granflow.observe.indices.repose import slope_of_cone, slope_of_plane
from granflow.observe.indices.structure import anisotropy, coordination, fabric_tensor
from granflow.observe.observer import CONTACTS, PARTICLES
from granflow.plan.sizes import diameter_range
from granflow.scene import Scene
from granflow.scene.analysis import ContentIndex, CoordinationIndex, FabricIndex, LaceyIndex, ReposeIndex
from granflow.scene.places import Box
from granflow.scene.rooms import frame_along
from granflow.snapshot import Snapshot

SUPPORTED = 2
"""Contacts from which on a grain belongs to a heap: one that rolls away on the floor has one."""

COLUMN = 2.0
"""Edge of the columns in which the surface of a heap is looked for, in largest diameters."""

OF_PARTICLES, OF_CONTACTS = frozenset({PARTICLES}), frozenset({CONTACTS})


def index_meters(scene: Scene) -> dict[str, IndexMeter]:
    """A meter for every index of the scene, by its name."""
    return {name: _meter(scene, asked) for name, asked in scene.output.indices.items()}


def _meter(
    scene: Scene, asked: LaceyIndex | ReposeIndex | FabricIndex | CoordinationIndex | ContentIndex
) -> IndexMeter:
    if isinstance(asked, LaceyIndex):
        return _lacey_meter(scene, asked)
    if isinstance(asked, ReposeIndex):
        return _repose_meter(scene, asked)
    if isinstance(asked, FabricIndex):
        return IndexMeter(lambda snapshot: _fabric(snapshot, asked.region), OF_CONTACTS)
    if isinstance(asked, ContentIndex):
        return IndexMeter(lambda snapshot: _content(snapshot, asked.region), OF_PARTICLES)
    return IndexMeter(lambda snapshot: _coordination(snapshot, asked.region), OF_PARTICLES)


def _lacey_meter(scene: Scene, asked: LaceyIndex) -> IndexMeter:
    grid: Grid = grid_in(scene.domain, asked)
    groups = [list(scene.particles).index(name) for name in asked.groups or ()]
    materials = [list(scene.materials).index(name) for name in asked.materials or ()]

    def measure(snapshot: Snapshot) -> dict[str, float]:
        grains = free_grains(snapshot.particles)
        of_kind = np.isin(grains["group"], groups) | np.isin(grains["material"], materials)
        if asked.smaller_than is not None:
            of_kind = 2.0 * grains["radius"] < asked.smaller_than
        return {"lacey_index": lacey_index(grains["position"], of_kind, grid, asked.at_least)}

    return IndexMeter(measure, OF_PARTICLES)


def _repose_meter(scene: Scene, asked: ReposeIndex) -> IndexMeter:
    upwards = -np.array(scene.gravity) / np.linalg.norm(scene.gravity)
    frame = frame_along(upwards)
    edge = COLUMN * max(diameter_range(group)[1] for group in scene.particles.values())
    axis = None if asked.axis is None else (frame @ np.array(asked.axis))[:2]

    def measure(snapshot: Snapshot) -> dict[str, float]:
        grains = free_grains(snapshot.particles)
        in_heap = (grains["coordination_number"] >= SUPPORTED) & _inside(grains["position"], asked.region)
        heap = chosen(grains, in_heap)
        points = heap["position"].astype(float) @ frame.T
        if asked.surface == "cone":
            slope = slope_of_cone(points, heap["radius"], edge, axis)
        else:
            slope = slope_of_plane(points, heap["radius"], edge)
        return {"angle_of_repose": slope.angle, "angle_of_repose_error": slope.error}

    return IndexMeter(measure, OF_PARTICLES)


def _fabric(snapshot: Snapshot, region: Box | None) -> Mapping[str, float]:
    contacts = snapshot.contacts or {}
    middle = 0.5 * (contacts["first_position"] + contacts["second_position"])
    tensor = fabric_tensor(chosen(contacts, _inside(middle, region)))
    parts = {f"fabric_{axis}{axis}": float(tensor[k, k]) for k, axis in enumerate("xyz")}
    return {"fabric_anisotropy": anisotropy(tensor)} | parts


def _coordination(snapshot: Snapshot, region: Box | None) -> Mapping[str, float]:
    grains = free_grains(snapshot.particles)
    return coordination(grains["coordination_number"][_inside(grains["position"], region)])


def _content(snapshot: Snapshot, region: Box) -> Mapping[str, float]:
    grains = free_grains(snapshot.particles)
    there = chosen(grains, _inside(grains["position"], region))
    volume = 4.0 / 3.0 * np.pi * float((there["radius"].astype(float) ** 3).sum())
    mass = float(there["mass"].astype(float).sum())
    return {"content_count": float(len(there["mass"])), "content_mass": mass, "content_volume": volume}


def _inside(points: np.ndarray, region: Box | None) -> np.ndarray:
    """Whether points (n, 3) lie in the region, or in none."""
    if region is None:
        return np.ones(len(points), bool)
    above, below = points >= np.array(region.min), points <= np.array(region.max)
    return np.asarray(np.logical_and(above, below).all(axis=1))
