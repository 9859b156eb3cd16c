"""Particles that are attached to a wall: they move with it, and their contacts push the wall.

A wall moves a point p of its frame at rest to x = R (p - pivot) + c (`walls.py`). An attached particle has
its point p, so that its position has no error of integration. Its velocity is that of the wall, at the half
step as the velocities of all particles:

    v(t - dt/2) = V + w x (x(t) - c - dt/2 (u - V)),   u = V + w x (x(t) - c)

Contacts have the infinite mass of fixed particles. The sum of their forces and torques on the particle acts
on the wall at the position of the particle: in force-controlled motions, wall forces and work. The weight of
the particle does not.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.engine.box import DeviceBox
from granflow.engine.contact import Accounting
from granflow.engine.state import State
from granflow.engine.wall_dynamics import controlled_displacements, synchronized_velocities
from granflow.engine.walls import Faces, WallGeometry
from granflow.geometry.surface import FAR_AWAY
from granflow.kernel_language import ti
from granflow.scene.blocks.motions import poses_at


class AttachedParticles:
    """Device functions of the attached particles; `attached_to` is the number of the wall.

    Reads:   position, attached_to, attached_position, attached_normal, force, torque, walls; as
             `WallGeometry`
    Writes:  position, position_at_rebuild, velocity, velocity_synchronized, angular_velocity,
             angular_velocity_synchronized, attached_position, attached_normal; as `Accounting.add_wall_force`
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.walls = state.walls
        self.features = state.plan.features
        self.periodic = state.plan.features.periodic != "none"
        self.real = state.backend.real
        self.geometry = state.built(WallGeometry)
        self.box = state.built(DeviceBox)
        self.accounting = state.built(Accounting)

    @ti.func
    def move(self, i, before, pose, dt):
        """Move particle i from the position `before` [m] to that of a pose; returns the displacement [m].

        In a periodic box the displacement since the rebuild is that of the unwrapped position.
        """
        w = self.particles.attached_to[i]
        after = self.geometry.in_space(w, pose, self.particles.attached_position[i])
        displacement = after - before
        if ti.static(self.periodic):
            after = self.box.wrap_position(after)
            displacement = self.box.minimum_image(after, before, pose)
            self.particles.position_at_rebuild[i] = self.particles.position_at_rebuild[i] + (
                after - before - displacement
            )
        self.particles.position[i] = after
        self.set_velocity(i, pose, dt)
        return ti.cast(displacement, self.real)

    @ti.func
    def set_velocity(self, i, pose, dt):
        """Set the velocities of particle i to those of its wall, half a step of `dt` [s] before the pose."""
        w = self.particles.attached_to[i]
        position = self.particles.position[i]
        velocity = self.geometry.velocity(w, pose, position)
        half = self.geometry.velocity_half(w, pose, position, ti.cast(velocity, self.real), dt)
        self.particles.velocity[i] = ti.cast(half, self.real)
        if ti.static(self.features.synchronized):
            self.particles.velocity_synchronized[i] = ti.cast(velocity, self.real)
        if ti.static(self.features.rotation and self.features.moving_walls):
            rotation = ti.cast(self.walls.angular_velocity[pose, w], self.real)
            self.particles.angular_velocity[i] = rotation
            if ti.static(self.features.viscous_cohesion):
                self.particles.angular_velocity_synchronized[i] = rotation

    @ti.func
    def add_to_wall(self, chunk, i, pose, dt):
        """Add the contact forces of particle i to those of its wall."""
        w = self.particles.attached_to[i]
        force = -self.particles.force[i]  # of the wall on the particles that touch this one
        torque = 0.0 * force
        if ti.static(self.features.rotation):
            torque = -self.particles.torque[i]
        normal = self.geometry.direction_in_space(w, pose, self.particles.attached_normal[i])
        on_others = ti.Struct(force=force, torque=torque)
        self.accounting.add_wall_force(chunk, i, -1 - w, pose, ti.cast(normal, self.real), on_others, dt)


# The host side


def build_attach(state: State) -> Any:
    """Kernel (count, pose, triangles): attach the particles to their walls at their present positions.

    triangles:  number of triangles of all meshes

    It follows each change of particles or walls, as the start of a run: a particle keeps its position, and
    has the present velocity of its wall.

    Reads:   position, radius, attached_to, walls, mesh
    Writes:  attached_position, attached_normal, and as `AttachedParticles.set_velocity`
    """
    particles = state.particles
    attached = state.built(AttachedParticles)
    geometry = attached.geometry
    faces = state.built(Faces)
    low = state.parameter("domain_low")
    high = state.parameter("domain_high")
    wall_count = state.parameter("wall_count")
    real = state.backend.real
    position_real = state.backend.position_real

    @ti.func
    def normal_at(w, pose, point, triangles):
        """Normal in space of the nearest face of a wall, toward the point."""
        gap = ti.cast(FAR_AWAY, position_real)
        normal = 0.0 * point
        for k in range(triangles + 1):
            face = w
            if k > 0:
                face = wall_count() + k - 1
            if faces.wall_of_face(face) == w:
                distance, direction = geometry.contact(face, pose, point)
                if distance < gap and direction.norm_sqr() > 0.0:  # 0 of a mesh as a whole
                    gap = distance
                    normal = direction
        return normal

    @ti.kernel
    def attach(count: ti.i32, pose: ti.i32, triangles: ti.i32):
        for i in range(count):
            if particles.attached_to[i] >= 0:
                w = particles.attached_to[i]
                point = particles.position[i]
                inward = (0.5 * (low() + high()) - point).normalized()
                shifted = point + NUDGE * ti.cast(particles.radius[i], position_real) * inward
                particles.attached_position[i] = geometry.to_wall_frame(w, pose, point)
                normal = normal_at(w, pose, shifted, triangles)
                particles.attached_normal[i] = geometry.direction_at_rest(w, pose, normal)
                attached.set_velocity(i, pose, ti.cast(0.0, real))

    return attach


NUDGE = 1e-3
"""Displacement toward the middle of the domain, over the radius, by which a particle whose center lies on a
thin wall is on one of its sides."""


def attach(state: State, pose: int) -> None:
    """Attach particles to their walls, see `build_attach`; nothing without the feature."""
    if state.plan.features.attached_particles:
        triangles = sum(each.triangle_count for each in state.plan.meshes.values())
        state.built(build_attach)(state.count, pose, triangles)


def attached_velocities(state: State, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Velocities (n, 3) [m/s] and angular velocities (n, 3) [rad/s] at the time of the positions.

    arrays:   position, attached_to, velocity and, if particles rotate, angular_velocity
    Returns:  the arrays that change, other particles as before; empty without attached particles
    """
    if "attached_to" not in arrays:
        return {}
    found = {name: arrays[name].copy() for name in ("velocity", "angular_velocity") if name in arrays}
    controlled = synchronized_velocities(state)
    for wall in np.unique(arrays["attached_to"][arrays["attached_to"] >= 0]):
        own = arrays["attached_to"] == wall
        pose = poses_at(state.wall_motions[wall], np.array([state.clock.time]))
        velocity = pose.velocity[0] + controlled[wall]
        center = pose.offset[0] + pose.pivot + controlled_displacements(state)[wall]
        arm = arrays["position"][own].astype(float) - center
        found["velocity"][own] = velocity + np.cross(pose.angular_velocity[0], arm)
        if "angular_velocity" in found:
            found["angular_velocity"][own] = pose.angular_velocity[0]
    return found
