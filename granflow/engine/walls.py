"""Walls on the device: distance, normal and surface velocity at a point for the present pose."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from granflow.engine.mesh import build_mesh_geometry
from granflow.engine.periodic_box import build_wrap_position
from granflow.engine.state import State
from granflow.engine.wall_dynamics import build_wall_displacement, upload_running
from granflow.geometry.catalog import SHAPE_KINDS
from granflow.geometry.motion import pose
from granflow.geometry.shape import FAR_AWAY, Shape
from granflow.plan.capacities import WALL_BATCH


@dataclass(frozen=True)
class WallGeometry:
    """Device functions (face, pose, point); a face is a wall index, or wall count + triangle index.

    Points are in m in the frame of the scene; `pose` is the index of the poses uploaded by `upload_poses`.
    """

    to_wall_frame: Any
    """(wall, pose, point) -> the point in the frame of the wall at rest."""
    distance: Any
    """Distance [m] to the surface of a wall that is not a mesh, for the neighbor list."""
    closest: Any
    """(distance [m], normal) of the contact."""
    surface_velocity: Any
    """Surface velocity [m/s] of the wall at the point."""
    prescribed_velocity: Any
    """Part of the surface velocity [m/s] from motions prescribed in the scene, without force-controlled motions."""


def build_wall_geometry(state: State) -> WallGeometry:
    """Functions for the shapes in this plan, with motion only if a wall moves.

    In a periodic box the point is wrapped into the box first.

    Reads:  kind, parameters, pivot, center, rotation, velocity and angular_velocity of walls; wall dynamics; mesh
    """
    walls, moving, force_controlled = (
        state.walls,
        state.plan.features.moving_walls,
        state.plan.features.force_controlled_walls,
    )
    controlled_displacement, controlled_velocity = build_wall_displacement(state) if force_controlled else (None, None)
    wrap_position = build_wrap_position(state)
    used = sorted({SHAPE_KINDS.index(wall.shape.kind) for wall in state.plan.walls if isinstance(wall.shape, Shape)})
    mesh = build_mesh_geometry(state) if state.plan.features.mesh_walls else None
    wall_count, wall_of, has_mesh = len(state.plan.walls), build_wall_of(state), mesh is not None

    @ti.func
    def center(w, pose):
        """Position [m] of the pivot of a wall at a pose."""
        center_now = walls.center[pose, w]
        if ti.static(force_controlled):
            center_now += controlled_displacement(w)
        return center_now

    @ti.func
    def to_wall_frame(w, pose, point):
        local = wrap_position(point)
        if ti.static(moving):
            local = walls.rotation[pose, w].transpose() @ (local - center(w, pose)) + walls.pivot[w]
        return local

    @ti.func
    def distance(w, pose, point):
        local = to_wall_frame(w, pose, point)
        parameters = walls.parameters[w]
        result = 0.0 * point[0] + FAR_AWAY
        for code in ti.static(used):
            if walls.kind[w] == code:
                result = SHAPE_KINDS[code].surface_distance(local, parameters)
        return result

    @ti.func
    def closest(face, pose, point):
        w = wall_of(-1 - face)
        local = to_wall_frame(w, pose, point)
        parameters = walls.parameters[w]
        gap = 0.0 * point[0]
        normal = 0.0 * point
        for code in ti.static(used):
            if walls.kind[w] == code:
                gap, normal = SHAPE_KINDS[code].closest(local, parameters)
        if ti.static(has_mesh):
            if face >= wall_count:
                gap, normal = mesh.contact(face - wall_count, local)
        if ti.static(moving):
            normal = walls.rotation[pose, w] @ normal
        return gap, normal

    @ti.func
    def prescribed_velocity(face, pose, point):
        velocity = 0.0 * point
        if ti.static(moving):
            w = wall_of(-1 - face)
            velocity = walls.velocity[pose, w] + walls.angular_velocity[pose, w].cross(point - center(w, pose))
        return velocity

    @ti.func
    def surface_velocity(face, pose, point):
        velocity = prescribed_velocity(face, pose, point)
        if ti.static(force_controlled):
            velocity += controlled_velocity(wall_of(-1 - face))
        return velocity

    return WallGeometry(to_wall_frame, distance, closest, surface_velocity, prescribed_velocity)


def build_wall_of(state: State) -> Any:
    """Device function (j): the wall of a partner j < 0.

    Partner -1 - p is the wall p, or the triangle p - wall count, numbered over all meshes.

    Reads:  wall of the mesh triangles
    """
    wall_count, mesh, has_mesh = len(state.plan.walls), state.mesh, state.mesh is not None

    @ti.func
    def wall_of(j):
        w = -1 - j
        if ti.static(has_mesh):
            if w >= wall_count:
                w = mesh.wall[w - wall_count]
        return w

    return wall_of


def build_triangle_of(state: State) -> Any:
    """Device function (j): triangle of a partner j < 0, numbered over all meshes; negative for other walls."""
    wall_count = len(state.plan.walls)

    @ti.func
    def triangle_of(j):
        return -1 - j - wall_count

    return triangle_of


def walls_of(state: State, partner: np.ndarray) -> np.ndarray:
    """Wall index (n,) of each partner (n,) below 0; see `build_wall_of`."""
    walls = np.arange(len(state.plan.walls))
    if state.mesh is not None:
        walls = np.concatenate([walls, state.mesh.wall.to_numpy()])
    return walls[-1 - partner].astype(np.int64)


def triangles_of(state: State, partner: np.ndarray) -> np.ndarray:
    """Triangle index (n,) within its wall of each partner (n,) below 0; -1 if the wall is not a mesh."""
    plan = state.plan
    first = np.array([plan.first_triangle(index) for index in range(len(plan.walls))])
    triangle = -1 - partner - len(plan.walls)
    return np.where(triangle < 0, -1, triangle - first[walls_of(state, partner)])


def upload_poses(state: State, step: int) -> None:
    """Upload the poses after WALL_BATCH steps from number `step`, with the velocities at the middle of each step.

    Times follow from step numbers, so that they are bit-identical for any start of a batch.

    Writes:  center, rotation, velocity, angular_velocity of walls; active
    """
    walls, clock = state.walls, state.clock
    times = np.asarray(clock.time_after(step + np.arange(WALL_BATCH)))
    now = [pose(motions, times) for motions in state.wall_motions]
    middle = [pose(motions, times - 0.5 * clock.time_step) for motions in state.wall_motions]
    real = np.float64 if state.backend.precision == "f64" else np.float32
    position_real = np.float32 if state.backend.precision == "f32" else np.float64

    def upload(field: Any, arrays: list[np.ndarray], dtype: Any) -> None:
        field.from_numpy(np.ascontiguousarray(np.stack(arrays, axis=1), dtype=dtype))

    upload_running(state, times - 0.5 * clock.time_step)
    upload(walls.center, [p.offset + p.pivot for p in now], position_real)
    upload(walls.rotation, [p.rotation for p in now], position_real)
    upload(walls.velocity, [p.velocity for p in middle], real)
    upload(walls.angular_velocity, [p.angular_velocity for p in middle], real)
