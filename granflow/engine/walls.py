"""Walls on the device: their poses, and the distance, direction and velocity of their surfaces at a point.

The host uploads the poses of prescribed motions for many steps in advance (`upload_poses`); force-controlled
motions are added to them (`wall_dynamics.py`). `WallGeometry` evaluates one face: a wall of one of
`plan.surface_kinds`, or a triangle of a mesh (`mesh.py`).

A contact with a surface made of several faces has one owner. Of the triangles of a mesh, `triangle_contact`
finds it; where several walls touch or overlap, `JoinedWalls`, which the contact kinematics call.
"""

from typing import Any

import numpy as np

from granflow.engine.box import DeviceBox, upload_offsets
from granflow.engine.gravity import upload_gravity
from granflow.engine.mesh import SAME_DIRECTION
from granflow.engine.state import State
from granflow.engine.wall_dynamics import ForceControlledWalls, upload_running
from granflow.geometry.surface import FAR_AWAY, reader_of_numbers
from granflow.kernel_language import ti
from granflow.plan.capacities import POSE_COUNT
from granflow.plan.joined_walls import ITSELF, OTHERS
from granflow.scene.blocks.motions import axis_points_at, poses_at

# Joined walls: the contact of a particle with one face, unless it is found on another face as well
#
# Where surfaces touch, one contact is found several times: two flush blocks have an edge in the surface of
# each other, patches can overlap, a plate can end on another wall. The distance of the particle from all
# surfaces together has one minimum there, and the nearest face has the contact. With the distances h >= h' of
# two faces from the center and the angle theta between the directions, the farther contact point is in the
# tangent plane of the nearer contact if
#
#     |h' - h cos(theta)| <= tolerance
#
# It is no contact of its own then: along the nearer surface, the distance decreases from there. Where the
# farther surface rises from that plane, as at a bend, it is left alone. Corners and grooves have contact
# points outside of both planes.

SAME_PLACE = 1e-4
"""Tolerance over the radius of the particle: above rounding in float32 and of mesh files, below usual
overlaps."""
SAME_DISTANCE = 1e-11
"""Distances of a particle from two faces are equal within this part of its radius: the face with the lower
number is the nearer one."""
LEAST_COSINE = 0.5
"""Cosine of the angle between two directions above which they can belong to one contact."""


class JoinedWalls:
    """Contact of a particle with a face, counted once where walls are joined (see `plan.joined_walls`).

    Without the feature `joined_walls` it is that of the face alone, `WallGeometry.contact`.

    Reads:  position, radius, list_begin, list_walls_end, partner; kind and joints of walls; as `WallGeometry`
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.walls = state.walls
        self.geometry = state.built(WallGeometry)
        self.faces = state.built(Faces)
        self.real = state.backend.position_real
        self.force_range = state.parameter("force_range")
        self.joined = state.plan.features.joined_walls
        self.curved = [code for code, kind in enumerate(state.plan.surface_kinds) if kind.is_curved]

    @ti.func
    def contact(self, i, j, pose):
        """Gap [m] and direction of the contact of particle i with the face of partner j < 0.

        The gap is FAR_AWAY if a nearer face in the neighbor list of the particle has the same contact.
        """
        gap = 0.0 * self.particles.position[i][0]
        direction = 0.0 * self.particles.position[i]
        if ti.static(self.joined):
            gap, direction = self._contact_among_faces(i, j, pose)
        else:
            gap, direction = self.geometry.contact(-1 - j, pose, self.particles.position[i])
        return gap, direction

    @ti.func
    def _is_same(self, j, other, pose, point, radius, gap, direction, other_gap, other_direction):
        """Whether partner j at `gap` has the same contact as another one at `other_gap`, which keeps it."""
        unit = SAME_DISTANCE * radius
        same = False
        rank = ti.floor(gap / unit)
        other_rank = ti.floor(other_gap / unit)
        cosine = direction.dot(other_direction)
        if (other_rank < rank or (other_rank == rank and other > j)) and cosine > LEAST_COSINE:
            contact_point = point - gap * direction
            # A point that the farther surface would be nearer to, if it rose from the tangent plane.
            face = -1 - j
            probe = contact_point + gap * other_direction
            in_plane = ti.abs(other_gap - gap * cosine) <= SAME_PLACE * radius
            on_curve = False
            for code in ti.static(self.curved):
                if not in_plane and self.walls.kind[self.faces.wall_of(other)] == code:
                    on_curve = True
                    face = -1 - other
                    probe = contact_point
            if in_plane or on_curve:
                distance = self.geometry.distance(face, pose, probe)
                same = (in_plane and distance >= gap - SAME_PLACE * radius) or (
                    on_curve and distance <= SAME_PLACE * radius
                )
        return same

    @ti.func
    def _may_be_same(self, w, j, other):
        wanted = OTHERS
        if self.faces.wall_of(other) == w:
            wanted = ITSELF
        return other != j and (self.walls.joints[self.faces.wall_of(other)] & wanted) != 0

    @ti.func
    def _contact_among_faces(self, i, j, pose):
        point = self.particles.position[i]
        radius = ti.cast(self.particles.radius[i], self.real)
        w = self.faces.wall_of(j)
        gap = ti.cast(FAR_AWAY, self.real)
        direction = 0.0 * point
        first = True
        list_index = self.neighbors.list_begin[i]
        end = self.neighbors.list_walls_end[i]
        # This face, then the others: one loop, so that `contact` is compiled once.
        while first or list_index < end:
            other = j
            if not first:
                other = self.neighbors.partner[list_index]
                list_index += 1
            if first or self._may_be_same(w, j, other):
                # The distance without regard to shared edges is cheaper, and at most that of a contact.
                if first or self.geometry.distance(-1 - other, pose, point) <= gap + SAME_DISTANCE * radius:
                    other_gap, other_direction = self.geometry.contact(-1 - other, pose, point)
                    if first:
                        gap = other_gap
                        direction = other_direction
                        if self.walls.joints[w] == 0 or gap > radius + self.force_range():
                            end = list_index
                    elif self._is_same(
                        j, other, pose, point, radius, gap, direction, other_gap, other_direction
                    ):
                        gap = ti.cast(FAR_AWAY, self.real)
                        end = list_index
            first = False
        return gap, direction


# One face


class WallGeometry:
    """Device functions of a wall or triangle at a point, for the shapes of a plan.

    They contain the motion only if a wall moves. `contact` and `distance` are those of `Surface`
    (`geometry.surface`).

    Points are in m in the frame of the scene; in a periodic box they are wrapped into the box first. A face
    is a wall index, or wall count + index of a triangle, numbered over all meshes; the partner of a contact
    with it is -1 - face. `pose` is the index of the poses uploaded by `upload_poses`.

    Reads:  kind, parameters, pivot, center, rotation, velocity, angular_velocity and surface_velocity of
            walls; wall dynamics; mesh
    """

    def __init__(self, state: State) -> None:
        self.state = state
        self.walls = state.walls
        self.mesh = state.mesh
        self.features = state.plan.features
        self.wall_count = state.parameter("wall_count")
        self.faces = state.built(Faces)
        self.kinds = [
            (code, surface, reader_of_numbers(surface), range(surface.count()))
            for code, surface in enumerate(state.plan.surface_kinds)
        ]
        self.real = state.backend.position_real
        self.is_flat = all(wall.surface.plane is not None for wall in state.plan.walls)
        self.box = state.built(DeviceBox)
        self.image_count = 3 ** len(state.plan.periodic_box.axes)
        self.controlled_walls = state.built(ForceControlledWalls)

    @ti.func
    def to_wall_frame(self, w, pose, point):
        """The point in the frame of the wall at rest."""
        return self.image_in_wall_frame(w, pose, self.box.wrap_position(point))

    @ti.func
    def image_in_wall_frame(self, w, pose, point):
        """A point that may be outside of a periodic box, in the frame of the wall at rest."""
        local = point
        if ti.static(self.features.moving_walls):
            rotation = self.walls.rotation[pose, w]
            local = rotation.transpose() @ (local - self._center(w, pose)) + self.walls.pivot[w]
        return local

    @ti.func
    def in_space(self, w, pose, local):
        """The present position [m] of a point of the wall at rest; in a periodic box not wrapped."""
        point = local
        if ti.static(self.features.moving_walls):
            rotation = self.walls.rotation[pose, w]
            point = rotation @ (local - self.walls.pivot[w]) + self._center(w, pose)
        return point

    @ti.func
    def direction_in_space(self, w, pose, local):
        """The present direction of a vector of the wall at rest."""
        found = local
        if ti.static(self.features.moving_walls):
            found = self.walls.rotation[pose, w] @ local
        return found

    @ti.func
    def direction_at_rest(self, w, pose, direction):
        """A vector in the frame of the wall at rest."""
        found = direction
        if ti.static(self.features.moving_walls):
            found = self.walls.rotation[pose, w].transpose() @ direction
        return found

    @ti.func
    def wall_distance(self, w, pose, point):
        """Distance [m] to the surface of a wall that is not a mesh, for the neighbor list."""
        local = self.to_wall_frame(w, pose, point)
        parameters = self.walls.parameters[w]
        result = 0.0 * point[0] + FAR_AWAY
        for code, surface, numbers_by_name, indices in ti.static(self.kinds):
            if self.walls.kind[w] == code:
                numbers = numbers_by_name([parameters[k] for k in ti.static(indices)])
                result = surface.distance(local, numbers)
        return result

    @ti.func
    def contact(self, face, pose, point):
        """Distance [m] and normal of the contact with a face."""
        w = self.faces.wall_of_face(face)
        local = self.to_wall_frame(w, pose, point)
        parameters = self.walls.parameters[w]
        gap = 0.0 * point[0]
        normal = 0.0 * point
        for code, surface, numbers_by_name, indices in ti.static(self.kinds):
            if self.walls.kind[w] == code:
                numbers = numbers_by_name([parameters[k] for k in ti.static(indices)])
                gap, normal = surface.contact(local, numbers)
        if ti.static(self.features.mesh_walls):
            if face >= self.wall_count():
                gap, normal = self.mesh.triangle_contact(face - self.wall_count(), local)
        if ti.static(self.features.moving_walls):
            normal = self.walls.rotation[pose, w] @ normal
        return gap, normal

    @ti.func
    def normal_half(self, face, pose, point, velocity, normal, dt):
        """Normal p at the half step, p . n = 1, of a contact with a particle at the point.

        velocity:  of the particle at the half step [m/s]
        normal:    n, normal of the contact now

        It is the normal where the particle was half a step ago in the frame of the wall, turned back with the
        wall.
        """
        half = ti.cast(0.5 * dt, self.real)
        found = normal
        if ti.static(not self.is_flat):
            velocity_rel = ti.cast(velocity, self.real) - self.velocity(face, pose, point)
            found = self._normal_near(face, pose, point, point - half * velocity_rel, normal)
        if ti.static(self.features.moving_walls):
            angular_velocity = ti.cast(
                self.walls.angular_velocity[pose, self.faces.wall_of_face(face)], self.real
            )
            found -= half * angular_velocity.cross(found)
        return found + (1.0 - found.dot(normal)) * normal

    @ti.func
    def _normal_near(self, face, pose, point, point_half, normal):
        """Unit normal of a wall or triangle at `point_half`, near a contact at `point` with this normal.

        On the face it is that of the face, extended beyond its edges: another wall may have had the contact
        there, and the direction from the edge would be integrated as slip. Near an edge it is the direction
        from the wall.
        """
        w = self.faces.wall_of_face(face)
        local = self.to_wall_frame(w, pose, point)
        local_half = self.to_wall_frame(w, pose, point_half)
        found = normal
        if ti.static(self.features.moving_walls):
            found = self.walls.rotation[pose, w].transpose() @ normal
        if face < self.wall_count():
            parameters = self.walls.parameters[w]
            for code, surface, numbers_by_name, indices in ti.static(self.kinds):
                if self.walls.kind[w] == code:
                    numbers = numbers_by_name([parameters[k] for k in ti.static(indices)])
                    of_face = surface.face_normal(local, numbers)
                    if found.cross(of_face).norm_sqr() <= ti.static(SAME_DIRECTION * SAME_DIRECTION):
                        side = ti.select(found.dot(of_face) < 0.0, -1.0, 1.0)
                        found = side * surface.face_normal(local_half, numbers)
                    else:
                        _gap, found = surface.contact(local_half, numbers)
        elif ti.static(self.features.mesh_walls):
            found = self.mesh.normal_near(face - self.wall_count(), local_half, found)
        if ti.static(self.features.moving_walls):
            found = self.walls.rotation[pose, w] @ found
        return found

    @ti.func
    def velocity_half(self, face, pose, point, velocity, dt):
        """Velocity [m/s] of the wall at the half step, where a point was that now is at `point`.

        velocity:  of the point at the half step [m/s]

            V + w x (x - dt/2 v - (c - dt/2 V))        c: pivot of the wall, V: its velocity
        """
        found = self.velocity(face, pose, point)
        if ti.static(self.features.moving_walls):
            w = self.faces.wall_of_face(face)
            of_pivot = self.velocity(face, pose, self._center(w, pose))
            angular_velocity = ti.cast(self.walls.angular_velocity[pose, w], self.real)
            found -= ti.cast(0.5 * dt, self.real) * angular_velocity.cross(
                ti.cast(velocity, self.real) - of_pivot
            )
        return found

    @ti.func
    def distance(self, face, pose, point):
        """Distance [m] of a point from a face, without regard to shared edges.

        It is negative behind a half space.
        """
        w = self.faces.wall_of_face(face)
        result = self.wall_distance(w, pose, point)
        if ti.static(self.features.mesh_walls):
            if face >= self.wall_count():
                result = self.mesh.from_nearest(
                    face - self.wall_count(), self.to_wall_frame(w, pose, point)
                ).norm()
        return result

    @ti.func
    def from_nearest(self, face, pose, point):
        """Vector [m] to a point from the nearest point of a face, without regard to shared edges.

        In a periodic box, the nearest of the images of the point counts: an image is outside of the box by up
        to the distance from a boundary.
        """
        w = self.faces.wall_of_face(face)
        _, direction = self.contact(face, pose, point)
        found = self.wall_distance(w, pose, point) * direction
        if ti.static(self.features.mesh_walls):
            if face >= self.wall_count():
                wrapped = self.box.wrap_position(point)
                nearest = ti.cast(FAR_AWAY, self.real)
                for number in range(self.image_count):
                    image, is_near = self.box.near_image(wrapped, number, FAR_AWAY)
                    if is_near:
                        local = self.image_in_wall_frame(w, pose, image)
                        separation = self.mesh.from_nearest(face - self.wall_count(), local)
                        if separation.norm() < nearest:
                            nearest = separation.norm()
                            found = separation
                if ti.static(self.features.moving_walls):
                    found = self.walls.rotation[pose, w] @ found
        return found

    @ti.func
    def prescribed_velocity(self, face, pose, step, point):
        """Velocity [m/s] of the wall at the point by prescribed motions, without force-controlled motions.

        step:  index of the step at whose middle it is: `pose` for the one that ends at the pose, pose + 1 for
               the next
        """
        velocity = 0.0 * point
        if ti.static(self.features.moving_walls):
            w = self.faces.wall_of_face(face)
            arm = point - self._center(w, pose)
            velocity = self.walls.velocity[step, w] + self.walls.angular_velocity[step, w].cross(arm)
        return velocity

    @ti.func
    def velocity(self, face, pose, point):
        """Velocity [m/s] of the wall at the point."""
        return self.velocity_in_step(face, pose, pose, point)

    @ti.func
    def velocity_in_step(self, face, pose, step, point):
        """As `velocity`; `step`: as of `prescribed_velocity`."""
        velocity = self.prescribed_velocity(face, pose, step, point)
        if ti.static(self.features.force_controlled_walls):
            velocity += self.controlled_walls.sum_of(
                self.state.wall_dynamics.velocity, self.faces.wall_of_face(face)
            )
        return velocity

    @ti.func
    def surface_velocity(self, face, pose, normal):
        """Velocity [m/s] of the surface relative to the wall, in the contact plane with this normal.

            u = v - (v . n) n

        so that the normal force does no work.
        """
        velocity = 0.0 * normal
        if ti.static(self.features.surface_velocity):
            given = self.walls.surface_velocity[pose, self.faces.wall_of_face(face)]
            velocity = given - given.dot(normal) * normal
        return velocity

    @ti.func
    def _center(self, w, pose):
        """Position [m] of the pivot of a wall at a pose."""
        center = self.walls.center[pose, w]
        if ti.static(self.features.force_controlled_walls):
            center += self.controlled_walls.sum_of(self.state.wall_dynamics.offset, w)
        return center


# Faces and their numbers


class Faces:
    """Walls of faces and partners in device functions.

    Reads:  wall of the mesh triangles
    """

    def __init__(self, state: State) -> None:
        self.wall_count = state.parameter("wall_count")
        self.mesh = state.mesh
        self.has_mesh = state.mesh is not None

    @ti.func
    def wall_of(self, j):
        """The wall of a partner j < 0, whose face is -1 - j."""
        return self.wall_of_face(-1 - j)

    @ti.func
    def wall_of_face(self, face):
        """The wall of a face, see `WallGeometry`."""
        w = face
        if ti.static(self.has_mesh):
            if w >= self.wall_count():
                w = self.mesh.wall[w - self.wall_count()]
        return w


def walls_of(state: State, partner: np.ndarray) -> np.ndarray:
    """Wall index (n,) of each partner (n,) below 0; see `Faces.wall_of`."""
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


# Poses of the walls, and offsets of the images of a sheared box, on the device for POSE_COUNT steps in
# advance.


class WallPoses:
    """The poses on the device.

    `next`: index of the poses of the next step; POSE_COUNT if they must be uploaded, 0 without poses.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self.discard()

    def discard(self) -> None:
        """Upload the poses again before their next use, because motions or the time step have changed."""
        self.next = POSE_COUNT if self._state.plan.has_poses else 0
        self._first_step: int | None = None

    def index_at(self, step: int) -> int:
        """Index of the poses after step number `step`; uploads them unless they are on the device."""
        if not self._state.plan.has_poses:
            return 0
        first = self._first_step
        if first is None or not 0 <= step - first < POSE_COUNT:
            self._upload(step)
            self.next = 1
            first = step
        return step - first

    def prepare(self, step: int, steps_since_rebuild: int) -> int:
        """Upload the poses after step number `step` if necessary; returns how many steps they allow.

        If a wall may move too far in the next step, requests a rebuild: walls are not in the displacement
        check of the particles. The rebuild follows the integration of the next step, as all others: forces
        are not computed again for it.
        """
        if not self._state.plan.has_poses:
            return POSE_COUNT
        allowed = self._steps_to_displacement_limit(steps_since_rebuild)
        if allowed < 1:
            self._state.control.rebuild_requested[0] = 1
        if self.next == POSE_COUNT:
            self._upload(step + 1)
            self.next = 0
        return min(POSE_COUNT - self.next, max(allowed, 1))

    def advance(self, steps: int) -> None:
        """Continue after a number of completed steps."""
        if self._state.plan.has_poses:
            self.next += steps

    def _upload(self, step: int) -> None:
        """Upload the poses of walls and images, and gravity, from step number `step`."""
        self._first_step = step
        if self._state.plan.features.moving_walls:
            upload_poses(self._state, step)
        if self._state.plan.features.lees_edwards:
            upload_offsets(self._state, step)
        if self._state.plan.features.changing_gravity:
            upload_gravity(self._state, step)

    def _steps_to_displacement_limit(self, steps_since_rebuild: int) -> int:
        """Steps until the fastest wall may reach its limit between rebuilds, or an image the skin.

        Force-controlled walls request their rebuilds on the device. POSE_COUNT if nothing moves.
        """
        plan = self._state.plan
        displacement_limit, speed = (
            (plan.wall_displacement_limit, plan.wall_speed)
            if not plan.features.lees_edwards
            else (plan.skin, plan.scene.domain.image_speed)
        )
        if speed == 0.0:
            return POSE_COUNT
        return int(displacement_limit / (speed * plan.longest_time_step)) - steps_since_rebuild


def torque_points(state: State, times: np.ndarray) -> np.ndarray:
    """Points (k, walls, 3) [m] to which measured torques refer, at `times` (k,) [s], in the precision of
    positions: those that walls give, otherwise those of their first rotation."""
    dtype = np.float32 if state.backend.precision == "f32" else np.float64
    found = np.zeros((len(times), state.plan.capacities.walls, 3), dtype)
    for index, wall in enumerate(state.plan.walls):
        given = wall.spec.torque_point
        found[:, index] = axis_points_at(state.wall_motions[index], times) if given is None else given
    return found


def upload_poses(state: State, step: int) -> None:
    """Upload the poses after POSE_COUNT steps from number `step`, with velocities at their middles.

    Velocities have one more row, for the work in the step that follows the last pose.

    Times follow from step numbers, so that they are bit-identical for any first step. Ends and middles
    of the steps are evaluated together, and a wall without motion once.

    Writes:  center, rotation, velocity, angular_velocity, surface_velocity, torque_point of walls; active
    """
    walls = state.walls
    clock = state.clock
    ends = np.asarray(clock.time_after(step + np.arange(POSE_COUNT + 1)))
    times = ends[:POSE_COUNT]
    middles = ends - 0.5 * clock.time_step
    at_rest = poses_at((), ends)
    both = [
        poses_at(motions, np.concatenate([times, middles])) if motions else at_rest
        for motions in state.wall_motions
    ]
    # Surface velocities are in the precision of particle velocities, positions in that of particle positions.
    real = np.float64 if state.backend.precision == "f64" else np.float32
    position_real = np.float32 if state.backend.precision == "f32" else np.float64

    def upload(field: Any, arrays: list[np.ndarray], dtype: Any) -> None:
        padded = np.zeros((len(arrays[0]), state.plan.capacities.walls, *arrays[0].shape[1:]), dtype)
        padded[:, : len(arrays)] = np.stack(arrays, axis=1)
        field.from_numpy(padded)

    if state.plan.features.wall_forces:
        walls.torque_point.from_numpy(torque_points(state, times))
    upload_running(state, middles[:POSE_COUNT])
    upload(walls.center, [p.offset[:POSE_COUNT] + p.pivot for p in both], position_real)
    upload(walls.rotation, [p.rotation[:POSE_COUNT] for p in both], position_real)
    upload(walls.velocity, [p.velocity[-len(middles) :] for p in both], real)
    upload(walls.angular_velocity, [p.angular_velocity[-len(middles) :] for p in both], real)
    if state.plan.features.surface_velocity:
        upload(walls.surface_velocity, [p.surface_velocity[-len(middles) :] for p in both], real)
