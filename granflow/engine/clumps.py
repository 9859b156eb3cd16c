"""Clumps: rigid bodies whose spheres are particles.

Each sphere has a copy of the state of its clump: center of mass, velocity, angular momentum L in the frame of
the scene and orientation, a unit quaternion q. Each copy is integrated with the same operations, from the
forces on all spheres in the order of their ids, so that all copies have the same bits, and no sphere writes
to another one. With MPI, the rank that owns the center of mass has all spheres of a clump.

Leapfrog form of velocity Verlet, with the torque M about the center of mass and the principal moments I:

    v(t + dt/2) = v(t - dt/2) + dt F(t) / m          x(t + dt) = x(t) + dt v(t + dt/2)
    L(t + dt/2) = L(t - dt/2) + dt M(t)              q(t + dt): rotation with this angular momentum

The rotation is split into rotations about the principal axes e_k, each with an angular velocity L . e_k /
I_k, which it does not change (Dullweber, Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840), here in a
symmetric sequence z y x x y z of half steps. Half a step turns by 2 atan(dt L . e_k / (4 I_k)) instead of dt
L . e_k / (2 I_k): a function of L . e_k, so that the step remains symplectic and of second order, without
trigonometric functions. L is exact.

The host computes energies and the motion at the time of the positions from arrays with a row per sphere;
`clump` is the id of the first sphere of its clump, -1 for a single sphere.
"""

from collections.abc import Mapping

import numpy as np

from granflow.engine.box import DeviceBox, ParticleWrap
from granflow.engine.gravity import Gravity
from granflow.engine.neighbor.phases import Phase, granularity
from granflow.engine.particle_forces import Damping
from granflow.engine.state import State
from granflow.geometry.clump import matrices
from granflow.kernel_language import ti

# Integration on the device


class ClumpMotion:
    """Integration of the copy of its clump that a sphere has.

    Reads:   force, torque, position, clump_size, clump_begin, clump_offset, clump_mass, clump_inertia,
             index_by_id, orientation, image_offset, damping, force_clock
    Writes:  clump_position, clump_velocity, clump_angular_momentum, orientation, position, velocity,
             velocity_synchronized, angular_velocity, angular_velocity_synchronized, boundary_work, losses
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.features = state.plan.features
        self.periodic = self.features.periodic != "none"
        self.real = state.backend.real
        self.exact = state.backend.position_real
        self.gravity = state.built(Gravity)
        self.box = state.built(DeviceBox)
        self.particle_wrap = state.built(ParticleWrap)
        self.control = state.control
        self.damps = self.features.damping != "none"
        self.damping = state.built(Damping) if self.damps else None

    @ti.func
    def moves(self, i):
        """Whether sphere i is in a clump that is not fixed; those of a fixed one move as fixed spheres."""
        found = self.particles.clump[i] >= 0
        if ti.static(self.features.fixed_particles):
            found = found and self.particles.fixed[i] == 0
        return found

    @ti.func
    def move(self, chunk, i, pose, dt):
        """Kick and drift sphere i; returns its displacement [m].

        The velocity of a sphere is its displacement over the time step; its angular velocity is that of the
        clump at the half step. In a periodic box the center of mass is wrapped, but not yet the sphere.
        """
        exact_dt = ti.cast(dt, self.exact)
        offset = self.particles.clump_offset[i]
        q = self.particles.orientation[i]
        rotation = scaled_rotation(q)
        inertia = ti.cast(self.particles.clump_inertia[i], self.exact)
        gravity = self.gravity.before(pose)
        force, torque = self._sums(i, rotation)
        damping_force = ti.Vector.zero(self.exact, 3)
        damping_torque = ti.Vector.zero(self.exact, 3)
        if ti.static(self.damps):
            damping_force, damping_torque = self._damping(i, rotation, inertia, gravity, force, torque)
            force += damping_force
            torque += damping_torque
            if ti.static(self.features.energy_budget):
                self._add_loss(chunk, i, damping_force, damping_torque, dt)
        kick = exact_dt * self._acceleration(i, force, gravity)
        velocity = self.particles.clump_velocity[i] + kick
        momentum = self.particles.clump_angular_momentum[i] + exact_dt * torque
        q_half = half_turned(q, momentum, inertia, exact_dt, (2, 1, 0))
        q_new = half_turned(q_half, momentum, inertia, exact_dt, (0, 1, 2))
        rotation_half = scaled_rotation(q_half)
        rotation_new = scaled_rotation(q_new)
        arm = rotation_new @ offset
        displacement = exact_dt * velocity + (arm - rotation @ offset)
        self.particles.clump_velocity[i] = velocity
        if ti.static(self.features.changing_gravity):
            self.gravity.add_work(chunk, i, velocity, pose, dt)
        self.particles.clump_angular_momentum[i] = momentum
        self.particles.orientation[i] = q_new
        self.particles.velocity[i] = ti.cast(displacement / exact_dt, self.real)
        self.particles.angular_velocity[i] = ti.cast(
            angular_velocity_of(rotation_half, momentum, inertia), self.real
        )
        if ti.static(self.damps and self.features.energy_budget):
            self._add_loss(chunk, i, damping_force, damping_torque, dt)
        if ti.static(self.features.synchronized):
            spin = angular_velocity_of(rotation_new, momentum + 0.5 * exact_dt * torque, inertia)
            self.particles.velocity_synchronized[i] = ti.cast(
                velocity + 0.5 * kick + spin.cross(arm), self.real
            )
            if ti.static(self.features.viscous_cohesion):
                self.particles.angular_velocity_synchronized[i] = ti.cast(spin, self.real)
        self._set_position(chunk, i, exact_dt * velocity, arm, displacement, pose, dt)
        return displacement

    @ti.func
    def kick(self, i, time, pose):
        """Change velocity and angular momentum of the copy by the present forces during `time` [s].

        Damping acts in whole steps only, from half a step before the forces to half a step behind them, and
        so does its loss.
        """
        force, torque = self._sums(i, scaled_rotation(self.particles.orientation[i]))
        exact_time = ti.cast(time, self.exact)
        acceleration = self._acceleration(i, force, self.gravity.after(pose))
        self.particles.clump_velocity[i] = self.particles.clump_velocity[i] + exact_time * acceleration
        self.particles.clump_angular_momentum[i] = (
            self.particles.clump_angular_momentum[i] + exact_time * torque
        )

    @ti.func
    def _acceleration(self, i, force, gravity):
        """Acceleration [m/s2] of the clump by the contact forces of its spheres and by its weight."""
        return force / ti.cast(self.particles.clump_mass[i], self.exact) + ti.cast(gravity, self.exact)

    @ti.func
    def _sums(self, i, rotation):
        """Force [N] on the clump of sphere i and torque [N m] about its center of mass: sums over all
        spheres."""
        force_sum = ti.Vector.zero(self.exact, 3)
        torque_sum = ti.Vector.zero(self.exact, 3)
        for member in range(self.particles.clump_size[i]):
            j = self.particles.index_by_id[self.particles.clump_begin[i] + member]
            force = ti.cast(self.particles.force[j], self.exact)
            arm = rotation @ self.particles.clump_offset[j]
            force_sum += force
            torque_sum += ti.cast(self.particles.torque[j], self.exact) + arm.cross(force)
        return force_sum, torque_sum

    @ti.func
    def _damping(self, i, rotation, inertia, gravity, force, torque):
        """Damping force [N] and torque [N m] of the clump, as `Damping` has them for spheres.

        gravity:        present one [m/s2]
        force, torque:  sums over its spheres

        The weight is part of the force that Cundall damping reduces. With the angular momentum L(t - dt/2)
        and the torque M without damping:

            Mc = -a |M_k| sign(w_k)                                       with L = L(t - dt/2) + (dt/2) M
            Md = -g L,  L = (L(t - dt/2) + (dt/2) (M + Mc)) / (1 + g dt/2)
        """
        mass = ti.cast(self.particles.clump_mass[i], self.exact)
        total = force + mass * ti.cast(gravity, self.exact)
        damping_force = self.damping.of(total, self.particles.clump_velocity[i], mass)
        ratio = ti.cast(self.control.damping[0], self.exact)
        rate = ti.cast(self.control.damping[1], self.exact)
        lag = ti.cast(self.control.force_clock[3], self.exact)
        momentum = self.particles.clump_angular_momentum[i]
        spin = angular_velocity_of(rotation, momentum + lag * torque, inertia)
        damping_torque = 0.0 * torque
        for k in ti.static(range(3)):
            sign = ti.select(spin[k] > 0.0, 1.0, ti.select(spin[k] < 0.0, -1.0, 0.0))
            damping_torque[k] = -ratio * ti.abs(torque[k]) * ti.cast(sign, self.exact)
        damping_torque -= (rate / (1.0 + rate * lag)) * (momentum + lag * (torque + damping_torque))
        return damping_force, damping_torque

    @ti.func
    def _add_loss(self, chunk, i, force, torque, dt):
        """Add the loss of half a step by damping with the present velocities, once for each clump."""
        if self.particles.id[i] == self.particles.clump[i]:
            power = force.dot(self.particles.clump_velocity[i])
            power += torque.dot(ti.cast(self.particles.angular_velocity[i], self.exact))
            self.damping.add_power(chunk, ti.cast(power, ti.f64), dt)

    @ti.func
    def _set_position(self, chunk, i, center_displacement, arm, displacement, pose, dt):
        """Move the center of mass, and place the sphere at an arm [m] from it.

        displacement:  of the sphere [m]

        In a periodic box the sphere is placed at the image nearest to its displaced position.
        """
        center = self.particles.clump_position[i] + center_displacement
        if ti.static(self.periodic):
            expected = self.particles.position[i] + displacement
            self.particles.position[i] = expected - self.box.minimum_image(expected, center + arm, pose)
            wrapped = self.box.wrap_position(center)
            if ti.static(self.features.energy_budget):
                self.particle_wrap.add_energy_gain(
                    chunk, i, wrapped - center, 0.0 * self.particles.velocity[i], dt
                )
            center = wrapped
        else:
            self.particles.position[i] = center + arm
        self.particles.clump_position[i] = center


@ti.func
def half_turned(q, momentum, inertia, dt, axes: ti.template()):
    """A unit quaternion q after rotations of dt/2 about the principal axes in the given order."""
    found = q
    square = q.dot(q)
    quarter = 0.25 * dt / inertia
    for axis in ti.static(axes):
        tangent = quarter[axis] * principal_axis(found, axis).dot(momentum) / square
        found = turned(found, axis, tangent)
        square = square * (1.0 + tangent * tangent)
    return found / ti.sqrt(found.dot(found))


@ti.func
def turned(q, axis: ti.template(), tangent):
    """q after a rotation about a principal axis e by an angle with this tangent of its half: q (1 + tangent
    e).

    The result is sqrt(1 + tangent^2) times as long as q.
    """
    w = q[0]
    u = q[1 + axis]
    v = q[1 + (axis + 1) % 3]
    t = q[1 + (axis + 2) % 3]
    e = in_order(axis, u + tangent * w, v + tangent * t, t - tangent * v)
    return ti.Vector([w - tangent * u, e[0], e[1], e[2]])


@ti.func
def principal_axis(q, axis: ti.template()):
    """|q|^2 times a principal axis of a clump with the quaternion q = (w, x, y, z)."""
    w = q[0]
    u = q[1 + axis]
    v = q[1 + (axis + 1) % 3]
    t = q[1 + (axis + 2) % 3]
    return in_order(axis, w * w + u * u - v * v - t * t, 2.0 * (u * v + w * t), 2.0 * (u * t - w * v))


@ti.func
def in_order(axis: ti.template(), first, second, third):
    """Vector of the components along a principal axis and along the two that follow it."""
    components = ti.Vector([first, second, third])
    if ti.static(axis == 1):
        components = ti.Vector([third, first, second])
    elif ti.static(axis == 2):
        components = ti.Vector([second, third, first])
    return components


@ti.func
def scaled_rotation(q):
    """|q|^2 times the rotation matrix of a quaternion q; its columns are the principal axes."""
    return ti.Matrix.cols([principal_axis(q, 0), principal_axis(q, 1), principal_axis(q, 2)])


@ti.func
def angular_velocity_of(rotation, momentum, inertia):
    """Angular velocity [rad/s] in the frame of the scene of a clump with a rotation matrix R: R (R^T L /
    I)."""
    return rotation @ ((rotation.transpose() @ momentum) / inertia)


def index_phase(state: State) -> Phase:
    """Phase of a rebuild that writes the index of each id, by which a sphere finds the others of its clump.

    On MPI ranks the host writes these indices when particles migrate, see `places_of_spheres`.

    Reads:   id, clump, clump_position
    Writes:  index_by_id, clump_begin, clump_position_at_rebuild
    """
    particles = state.particles
    per_task, _ = granularity(state)
    has_ghosts = state.plan.has_ghosts

    @ti.func
    def write(task: ti.template(), rebuild: ti.template()):
        for i in range(task.begin, task.end):
            if ti.static(not has_ghosts):
                particles.index_by_id[particles.id[i]] = i
                particles.clump_begin[i] = particles.clump[i]
            particles.clump_position_at_rebuild[i] = particles.clump_position[i]

    return Phase(write, state.cell_sort.order.shape[0], per_task=per_task)


# Arrays on the host

CLUMP_MOTION = (
    "id",
    "clump",
    "clump_mass",
    "clump_inertia",
    "clump_offset",
    "clump_position",
    "clump_velocity",
    "clump_angular_momentum",
    "orientation",
)
"""Fields that determine motion and energy of clumps; absent without clumps."""
ROTATION_SHARE = "clump_rotation_share"
"""Array of `of_clumps`: share of a sphere in twice the rotational energy of its clump [J]."""
Arrays = dict[str, np.ndarray]


def places_of_spheres(ids: np.ndarray, clump: np.ndarray) -> Arrays:
    """The arrays (n,) `index_by_id` and `clump_begin` of the particles that an MPI rank owns.

    ids, clump:  (n,) in the order of the device, with all spheres of each clump
    """
    order = np.argsort(ids)
    return {"index_by_id": order, "clump_begin": np.searchsorted(ids[order], clump)}


def body_positions(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Positions (n, 3) [m] of the rigid bodies to which particles belong: the center of mass of the clump, or
    the center of a single sphere.

    arrays:  position, and with clumps clump and clump_position
    """
    if "clump" not in arrays:
        return arrays["position"]
    return np.where(arrays["clump"][:, None] >= 0, arrays["clump_position"], arrays["position"])


def mass_shares(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Share (n,) of each sphere in the mass of its clump; 1 for single spheres."""
    if "clump" not in arrays:
        return np.ones(len(arrays["mass"]))
    return np.asarray(arrays["mass"] / arrays["clump_mass"].astype(float))


def of_clumps(arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """The arrays with position and velocity of the clump for its spheres, and ROTATION_SHARE; unchanged
    without clumps.

    The share of a sphere is its mass over that of the clump.
    """
    if "clump" not in arrays:
        return arrays
    in_clump = arrays["clump"][:, None] >= 0
    momentum = arrays["clump_angular_momentum"].astype(float)
    share = mass_shares(arrays)
    moving = {
        name: np.where(in_clump, arrays[f"clump_{name}"], arrays[name]) for name in ("position", "velocity")
    }
    return {**arrays, **moving, ROTATION_SHARE: share * np.sum(momentum * angular_velocity(arrays), axis=1)}


def angular_velocity(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Angular velocities (n, 3) [rad/s] of the clumps, in the frame of the scene: w = R (R^T L / I); 0
    without one."""
    rotation = matrices(arrays["orientation"].astype(float))
    along = np.einsum("nji,nj->ni", rotation, arrays["clump_angular_momentum"].astype(float))
    inertia = arrays["clump_inertia"].astype(float)
    along = np.divide(along, inertia, out=np.zeros_like(along), where=inertia > 0.0)
    return np.einsum("nij,nj->ni", rotation, along)


def angular_momentum(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Angular momenta (n, 3) [kg m2/s] of the clumps, in the frame of the scene: L = R I R^T w; 0 without
    one.

    arrays:  angular_velocity, orientation, clump_inertia
    """
    rotation = matrices(arrays["orientation"].astype(float))
    along = np.einsum("nji,nj->ni", rotation, arrays["angular_velocity"].astype(float))
    return np.einsum("nij,nj->ni", rotation, arrays["clump_inertia"].astype(float) * along)


def arms(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Centers (n, 3) [m] of the spheres relative to the centers of mass, in the frame of the scene."""
    rotation = matrices(arrays["orientation"].astype(float))
    return np.einsum("nij,nj->ni", rotation, arrays["clump_offset"].astype(float))


def synchronized_clumps(arrays: Mapping[str, np.ndarray], half: float, gravity: np.ndarray) -> Arrays:
    """Motion of clumps at the time of the positions, for their spheres; rows of single spheres are
    meaningless.

        v(t) = v(t - dt/2) + dt/2 (F / m + g),   L(t) = L(t - dt/2) + dt/2 M

    arrays:   CLUMP_MOTION, velocity, angular_velocity, force and torque, on the device half a step behind
    half:     dt/2 [s]
    gravity:  (3,) [m/s2]
    Returns:  velocity, angular_velocity, clump_velocity, clump_angular_momentum; no arrays without clumps
    """
    if "clump" not in arrays:
        return {}
    arm = arms(arrays)
    force = arrays["force"].astype(float)
    force_sum = _sums(arrays, force)
    torque_sum = _sums(arrays, arrays["torque"] + np.cross(arm, force))
    velocity = arrays["clump_velocity"] + half * (
        force_sum / arrays["clump_mass"].astype(float)[:, None] + gravity
    )
    momentum = arrays["clump_angular_momentum"] + half * torque_sum
    spin = angular_velocity({**arrays, "clump_angular_momentum": momentum})
    return {
        "velocity": velocity + np.cross(spin, arm),
        "angular_velocity": spin,
        "clump_velocity": velocity,
        "clump_angular_momentum": momentum,
    }


def forces_with_weight(arrays: Mapping[str, np.ndarray], gravity: np.ndarray) -> np.ndarray:
    """Forces (n, 3) [N]; on a sphere of a clump with its share of the weight, which `force` does not contain.

    arrays:   force, mass, and with clumps clump
    gravity:  (3,) [m/s2]
    """
    force = arrays["force"].astype(float)
    if "clump" not in arrays:
        return force
    weight = arrays["mass"].astype(float)[:, None] * gravity
    return np.where(arrays["clump"][:, None] >= 0, force + weight, force)


def _sums(arrays: Mapping[str, np.ndarray], vectors: np.ndarray) -> np.ndarray:
    """Sums (n, 3) of vectors (n, 3) over the spheres of the clump of each sphere, in the order of the ids."""
    if not len(vectors):
        return vectors
    order = np.lexsort((arrays["id"], arrays["clump"]))
    clump = arrays["clump"][order]
    first = np.flatnonzero(np.r_[True, clump[1:] != clump[:-1]])
    lengths = np.diff(np.r_[first, len(clump)])
    found = np.empty_like(vectors)
    found[order] = np.repeat(np.add.reduceat(vectors[order], first, axis=0), lengths, axis=0)
    return found
