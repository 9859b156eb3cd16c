"""One pair of partners in contact: its kinematics, its constants and its force.

A pair is a particle i and a partner j, which is another particle, or a wall or triangle if j < 0 (see
`walls.Faces.wall_of`). `Pair` reads in the state

    kinematics   overlap, normal, relative velocity and lever arms
    bodies       effective radius, mass and inertia
    constants    numbers of the contact models for the two materials

and `PairForce` turns these and the history of the contact into forces, torques, the new history and the
losses: it calls the normal and the cohesion model of the scene, then those that act on the surfaces in the
order of `contact.law.SLOTS`.

`sphere_kinematics` and `PairForce` are functions of values, which read and write no field, so that the
scalar contact loop (`contact.py`) and the batched one (`batch.py`) share them. If the partners are exchanged,
each of their results is bit-identical or has exactly the opposite sign.

Contact models read constants and histories by name, fields store rows of numbers: `ModelStructs` converts
them.
"""

from typing import Any

from granflow.contact.law import AT_LIMIT, SLOTS, in_contact_plane
from granflow.contact.registry import ContactLaws
from granflow.device_functions import at_compile_time
from granflow.engine.box import DeviceBox
from granflow.engine.state import State
from granflow.engine.walls import Faces, JoinedWalls, WallGeometry
from granflow.geometry.sphere import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.sum_units import LOSS_DAMPING, LOSSES

# Kinematics, bodies and constants


class Pair:
    """Particle i and partner j in the state.

    with_wall:  True for walls, False for particles; there are two objects, so that the loops contain no
                branch between the two kinds of partner

    Reads:  position, velocity, velocity_synchronized, angular_velocity, angular_velocity_synchronized,
            radius, mass, fixed, clump_mass, material of particles and walls, walls, image_offset,
            image_speed, pair_constants, law_parameters
    """

    def __init__(self, state: State, with_wall: bool) -> None:
        plan = state.plan
        self.particles = state.particles
        self.walls = state.walls
        self.control = state.control
        self.features = plan.features
        self.with_wall = with_wall
        self.has_walls = plan.features.walls
        self.acts_at_distance = plan.laws.acts_at_distance
        self.cohesion_at_distance = plan.laws.cohesion_at_distance
        self.real = state.backend.real
        self.kinematics = self._wall_kinematics if with_wall else self._particle_kinematics
        self.overlap_ratio = 1.0 - ROUNDING[state.backend.real]
        self.box = state.built(DeviceBox)
        self.geometry = state.built(WallGeometry)
        self.joined_walls = state.built(JoinedWalls)
        self.wall_of = state.built(Faces).wall_of
        self.mass = state.particles.clump_mass if plan.features.clumps else state.particles.mass
        self.structs = ModelStructs(plan.laws)
        self.material_count = state.parameter("material_count")
        self.equal_spheres = state.parameter("equal_spheres") if self.features.one_size else None

    @ti.func
    def _particle_kinematics(self, i, j, pose, dt):
        """`kinematics` of a candidate pair, as of `sphere_kinematics`.

        Without contact, the overlap is not above 0, and only models that act at a distance get its value, see
        `separated`.
        """
        radius = self.radius(i)
        found = no_contact(-radius, self.particles.velocity[i])
        branch = self.branch(self.particles.position[i], j, pose)
        if self.overlaps(branch.dot(branch), radius + self.radius(j)):
            found = self.spheres(i, j, branch, pose, dt)
        elif ti.static(self.acts_at_distance):
            found = self.separated(i, j, branch, pose)
        return found

    @ti.func
    def separated(self, i, j, branch, pose):
        """Kinematics of two particles without overlap, for models that act at a distance: minus the distance
        of the surfaces, the normal, for cohesion its rate at the half step, and for viscous forces the
        velocity now and the lever arms."""
        radius = self.radius(i)
        radius_partner = self.radius(j)
        found = no_contact(-radius, self.particles.velocity[i])
        distance = ti.sqrt(branch.dot(branch))
        found.overlap = ti.min(radius + radius_partner - distance, 0.0)
        found.normal = 1.0 / distance * branch
        if ti.static(self.cohesion_at_distance):
            velocity_rel_half, velocity_rel = self.relative_velocities(i, j, pose)
            found.overlap_rate = -velocity_rel_half.dot(found.normal)
            found.velocity_rel = velocity_rel
        if ti.static(self.features.viscous_cohesion):
            found.arm = radius - 0.5 * found.overlap
            found.arm_partner = radius_partner - 0.5 * found.overlap
        return found

    @ti.func
    def spheres(self, i, j, branch, pose, dt):
        """`sphere_kinematics` of two particles with this branch vector [m]."""
        velocity_rel_half, velocity_rel = self.relative_velocities(i, j, pose)
        return sphere_kinematics(
            self.radius(i),
            self.radius(j),
            branch,
            velocity_rel_half,
            velocity_rel,
            dt,
            self.features.rate_dependent,
        )

    @ti.func
    def branch(self, position, j, pose):
        """Branch vector [m] from the nearest image of particle j to the position of a particle."""
        return ti.cast(self.box.minimum_image(position, self.particles.position[j], pose), self.real)

    @ti.func
    def relative_velocities(self, i, j, pose):
        """Velocity [m/s] of i relative to the nearest image of particle j, at the half step and now."""
        image_velocity = self.box.image_velocity(i, j, pose)
        half = self.particles.velocity[i] - self.particles.velocity[j] - image_velocity
        now = half
        if ti.static(self.features.synchronized):
            now = (
                self.particles.velocity_synchronized[i]
                - self.particles.velocity_synchronized[j]
                - image_velocity
            )
        return half, now

    @ti.func
    def overlaps(self, distance_squared, contact_distance):
        """Whether the overlap is above rounding; from the squared distance [m2] and the sum of the radii [m].

        The field `in_contact` is another thing: the state of a neighbor-list entry, see `history.py`.
        """
        return distance_squared < self.overlap_ratio * (contact_distance * contact_distance)

    @ti.func
    def _wall_kinematics(self, i, j, pose, dt):
        """As `_particle_kinematics`, for a wall: the contact point halves the overlap; no lever arm of j.

        Velocities are those of the half step; normal_half and the velocity of the wall at the contact point
        are as well.
        """
        radius = self.radius(i)
        face = -1 - j
        gap, direction = self.joined_walls.contact(i, j, pose)
        found = no_contact(ti.cast(radius - gap, self.real), self.particles.velocity[i])
        found.arm = radius - 0.5 * found.overlap
        if ti.static(self.cohesion_at_distance):
            found.normal = ti.cast(direction, self.real)
        velocity_rel_to_wall = found.velocity_rel  # without the velocity of a belt
        if ti.static(self.features.viscous_cohesion or self.features.rate_dependent):
            if self.in_range(i, j, found.overlap):
                wall_velocity_now = self.geometry.velocity(
                    face, pose, self.particles.position[i] - found.arm * direction
                )
                velocity_rel_to_wall = self.particles.velocity_synchronized[i] - ti.cast(
                    wall_velocity_now, self.real
                )
                found.velocity_rel = velocity_rel_to_wall
                if ti.static(self.features.surface_velocity):
                    found.velocity_rel -= self.geometry.surface_velocity(face, pose, direction)
        if found.overlap > 0.0:
            position = self.particles.position[i]
            velocity = self.particles.velocity[i]
            normal_half = self.geometry.normal_half(face, pose, position, velocity, direction, dt)
            found.normal = ti.cast(direction, self.real)
            found.normal_half = ti.cast(normal_half, self.real)
            wall_velocity = self.geometry.velocity_half(
                face, pose, position - found.arm * normal_half, velocity, dt
            )
            found.velocity_rel_half = velocity - ti.cast(wall_velocity, self.real)
            found.overlap_rate_half = -found.velocity_rel_half.dot(found.normal_half)
            found.overlap_rate = -found.velocity_rel_half.dot(found.normal)
            if ti.static(self.features.rate_dependent):
                found.overlap_rate = -velocity_rel_to_wall.dot(found.normal)
            found.arm_half = found.arm + 0.25 * dt * found.overlap_rate_half
            if ti.static(self.features.surface_velocity):  # it does not turn the normal
                found.velocity_rel_half -= self.geometry.surface_velocity(face, pose, found.normal_half)
        elif ti.static(self.cohesion_at_distance):
            if self.in_range(i, j, found.overlap):
                wall_velocity = self.geometry.velocity(
                    face, pose, self.particles.position[i] - found.arm * direction
                )
                velocity_rel_half = self.particles.velocity[i] - ti.cast(wall_velocity, self.real)
                found.overlap_rate = -velocity_rel_half.dot(found.normal)
        return found

    @ti.func
    def angular_velocities(self, i, j, pose):
        """Struct of the angular velocities [rad/s] of i, `first`, and of its partner, at the half step; for a
        viscous force of the cohesion model also `first_now` and `partner_now`."""
        first = 0.0 * self.particles.velocity[i]
        partner = 0.0 * self.particles.velocity[i]
        if ti.static(self.features.rotation):
            first = self.particles.angular_velocity[i]
        if ti.static(self.features.rotation and not self.with_wall):
            partner = self.particles.angular_velocity[j]
        elif ti.static(self.features.rotation and self.features.moving_walls):
            partner = ti.cast(self.walls.angular_velocity[pose, self.wall_of(j)], self.real)
        first_now = first
        partner_now = partner
        if ti.static(self.features.viscous_cohesion):
            first_now = self.particles.angular_velocity_synchronized[i]
            if ti.static(not self.with_wall):
                partner_now = self.particles.angular_velocity_synchronized[j]
        return ti.Struct(first=first, partner=partner, first_now=first_now, partner_now=partner_now)

    @ti.func
    def bodies(self, i, j):
        """Struct of the effective radius [m], mass [kg] and inertia [kg m2].

        a b / (a + b) for two particles, the value of the particle for a wall.
        """
        radius = self.radius(i)
        mass = self.contact_mass(i)
        found = ti.Struct(radius_eff=radius, mass_eff=mass, inertia_eff=sphere_inertia(mass, radius))
        if ti.static(not self.with_wall):
            found = sphere_bodies(radius, mass, self.radius(j), self.contact_mass(j))
        return found

    @ti.func
    def radius(self, i):
        """Radius [m] of a particle: the number of the plan if all are equal, which saves a gather for each
        candidate pair."""
        if ti.static(self.features.one_size):
            return self.equal_spheres()[0]
        else:
            return self.particles.radius[i]

    @ti.func
    def contact_mass(self, i):
        """Mass [kg] of a particle in its contacts, FIXED_MASS_FACTOR times as large if it is fixed.

        A sphere of a clump has the mass of the clump, as in LIGGGHTS and MercuryDPM.
        """
        if ti.static(self.features.one_size):
            return self.equal_spheres()[1]
        else:
            mass = self.mass[i]
            if ti.static(self.features.fixed_particles):
                factor = ti.cast(FIXED_MASS_FACTOR, self.real)
                mass *= ti.select(self.particles.fixed[i] == 1, factor, ti.cast(1.0, self.real))
            return mass

    @ti.func
    def constants(self, i, j):
        """Struct of the constants of the contact models, for particles and walls alike."""
        return self.structs.constants(
            self.control.pair_constants[self.row(i, j)], self.control.law_parameters[0]
        )

    @ti.func
    def row(self, i, j):
        """Row of the pair constants: material of i * material count + material of j."""
        number = 0
        if ti.static(not self.features.one_material):
            number = self.particles.material[i] * self.material_count()
            if j >= 0:
                number += self.particles.material[j]
        if ti.static(self.has_walls):
            if j < 0:
                number += self.walls.material[self.wall_of(j)]
        return number

    @ti.func
    def in_range(self, i, j, overlap):
        """Whether the cohesion model acts at this overlap [m], which may be negative."""
        found = overlap > 0.0
        if ti.static(self.cohesion_at_distance):
            found = overlap > -self.constants(i, j).cohesion.range
        return found


@ti.func
def sphere_kinematics(
    radius, radius_partner, branch, velocity_rel_half, velocity_rel, dt, rate_dependent: ti.template()
):
    """Kinematics of two spheres in contact, relative to the first.

    Arguments: radii [m], `branch` vector b from the second to the first [m], relative velocity v at the half
    step and now [m/s], dt [s], and whether a model has a dashpot. Returns a struct of overlap [m]; normal n;
    normal_half p, see `contact/law.py`; relative velocity at the half step and now [m/s]; overlap rate at the
    half step and now [m/s] (positive if approaching); and the lever arms of both, now and at the half step
    [m]: the contact point halves the overlap.

        b(t - dt/2) = b - v dt/2    =>    p = n - dt/(2 |b|) (v - (v . n) n),    overlap rate  -v . p

    Without a dashpot the overlap rate of the normal models is -v . n, of which no model accumulates an error.
    """
    distance = ti.sqrt(branch.dot(branch))
    inverse = 1.0 / distance
    contact_distance = radius + radius_partner
    overlap = contact_distance - distance
    normal = inverse * branch
    approach = -velocity_rel_half.dot(normal)
    rate = approach
    if ti.static(rate_dependent):
        rate = -velocity_rel.dot(normal)
    normal_half = normal - (0.5 * dt * inverse) * (velocity_rel_half + approach * normal)
    arm = radius - 0.5 * overlap
    arm_partner = radius_partner - 0.5 * overlap
    growth = 0.25 * dt * approach  # half of the overlap grew by this in half a step
    return ti.Struct(
        overlap=overlap,
        normal=normal,
        normal_half=normal_half,
        velocity_rel_half=velocity_rel_half,
        velocity_rel=velocity_rel,
        overlap_rate_half=-velocity_rel_half.dot(normal_half),
        overlap_rate=rate,
        arm=arm,
        arm_partner=arm_partner,
        arm_half=arm + growth,
        arm_partner_half=arm_partner + growth,
    )


@ti.func
def no_contact(overlap, vector):
    """Kinematics of a pair without contact; `vector` has the type of the 3-vectors."""
    zero = 0.0 * vector
    nothing = 0.0 * overlap
    return ti.Struct(
        overlap=overlap,
        normal=zero,
        normal_half=zero,
        velocity_rel_half=zero,
        velocity_rel=zero,
        overlap_rate_half=nothing,
        overlap_rate=nothing,
        arm=nothing,
        arm_partner=nothing,
        arm_half=nothing,
        arm_partner_half=nothing,
    )


@ti.func
def sphere_bodies(radius, mass, radius_partner, mass_partner):
    """Struct `bodies` of two spheres."""
    inertia = sphere_inertia(mass, radius)
    inertia_partner = sphere_inertia(mass_partner, radius_partner)
    return ti.Struct(
        radius_eff=effective_value(radius, radius_partner),
        mass_eff=effective_value(mass, mass_partner),
        inertia_eff=effective_value(inertia, inertia_partner),
    )


@ti.func
def effective_value(one, other):
    """Effective radius, mass or inertia of a pair: a b / (a + b)."""
    return one * other / (one + other)


FIXED_MASS_FACTOR = 2.0**60
"""Mass factor of a fixed particle in contacts, as of an infinite mass: the term of its partner's mass is
below rounding, also in f64."""
ROUNDING = {ti.f64: 2.0**-50, ti.f32: 2.0**-21}
"""Eight units in the last place of 1: pairs with a relative overlap below this are not in contact; no overlap
is 0."""


# Force


class PairForce:
    """Force and torques of one contact in a step, from values.

    rotation:     whether particles rotate
    is_prepared:  True if `NormalLaw.prepare` has been evaluated before

    In methods, constants and history are structs of slots, bodies and kinematics those of `Pair`, `contact`
    that of `normal_contact`; longest_time_step is that of the run [s].
    """

    def __init__(self, laws: ContactLaws, rotation: bool, is_prepared: bool) -> None:
        self.laws = laws
        self.rotation = rotation
        self.damping = PAIR_LOSSES.index(LOSS_DAMPING)
        self.prepares = laws.normal.prepares and not is_prepared
        self.surface_laws = [
            (slot, law, PAIR_LOSSES.index(LOSSES.index(SLOTS[slot].loss))) for slot, law in laws.on_surface
        ]

    @ti.func
    def evaluate(self, constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step):
        """Force and torques; angular_velocities: as of `Pair.angular_velocities`.

        Returns a struct of the force on the first [N], the torques on both [N m], the history, and the
        losses: a vector of the energies [J] dissipated in this step, in the order of PAIR_LOSSES. Further
        members are the power [W] that the viscous force of the cohesion model dissipates, and whether the
        surfaces slide (1 or 0): the relative motion of surfaces that stick is elastic.
        """
        contact = normal_contact(bodies, kinematics, normal_time_step(dt, longest_time_step))
        normal_force, load, viscous, history_new = self.normal_force(constants, contact, history)
        force = normal_force * kinematics.normal
        torque = 0.0 * force
        torque_partner = 0.0 * force
        losses = no_losses(0.0 * load)
        losses[self.damping] = viscous * kinematics.overlap_rate * dt
        viscous_power = 0.0 * load
        slides = 1
        if ti.static(self.laws.has_viscous_cohesion):
            liquid = self.viscous_force(constants, contact, history_new, kinematics, angular_velocities)
            force += liquid.force
            torque += liquid.torque
            torque_partner += liquid.torque_partner
            viscous_power = liquid.power
        if ti.static(self.rotation):
            surface = self._surface_contact(
                constants,
                contact,
                load,
                history_new,
                bodies,
                kinematics,
                angular_velocities,
                dt,
                longest_time_step,
            )
            for slot, law, loss in ti.static(self.surface_laws):
                found = law.act(member(constants, slot), surface, kinematics, member(history, slot))
                if ti.static("force" in found.keys):
                    force += found.force
                    if ti.static(law.sticks):
                        least = AT_LIMIT * law.limit(member(constants, slot), surface)
                        slides = ti.select(found.force.dot(found.force) >= least * least, 1, 0)
                torque += found.torque
                torque_partner += found.torque_partner
                losses[loss] += found.loss
                set_member(history_new, slot, found.history)
        return ti.Struct(
            force=force,
            torque=torque,
            torque_partner=torque_partner,
            history=history_new,
            losses=losses,
            viscous_power=viscous_power,
            slides=slides,
        )

    @ti.func
    def viscous_force(self, constants, contact, history, kinematics, angular_velocities):
        """Viscous force of the cohesion model, of surfaces that touch or are separated: a struct of force and
        torques as of `evaluate`, the normal component [N], and the dissipated power [W].

        contact:  as of the normal model
        history:  after the force of the cohesion model
        """
        normal = kinematics.normal
        rotation = (
            kinematics.arm * angular_velocities.first_now
            + kinematics.arm_partner * angular_velocities.partner_now
        )
        approach = -kinematics.velocity_rel.dot(normal)
        slip_rate = kinematics.velocity_rel + approach * normal - rotation.cross(normal)
        surfaces = ti.Struct(
            radius_eff=contact.radius_eff,
            mass_eff=contact.mass_eff,
            time_step=contact.time_step,
            overlap=contact.overlap,
            overlap_rate=approach,
            slip_rate=slip_rate,
        )
        normal_force, tangential_force = self.laws.cohesion.viscous_force(
            constants.cohesion, surfaces, history.cohesion
        )
        moment = normal.cross(tangential_force)
        return ti.Struct(
            force=normal_force * normal + tangential_force,
            torque=-kinematics.arm * moment,
            torque_partner=-kinematics.arm_partner * moment,
            normal_force=normal_force,
            power=normal_force * approach - tangential_force.dot(slip_rate),
        )

    @ti.func
    def normal_force(self, constants, contact, history):
        """Normal force [N] with cohesion, load [N] that presses the surfaces together, viscous force [N], and
        history."""
        history_new = history
        if ti.static(self.prepares):
            history_new.normal = self.laws.normal.prepare(constants.normal, contact, history.normal)
        force, viscous, normal_history = self.laws.normal.force(constants.normal, contact, history_new.normal)
        history_new.normal = normal_history
        attraction = 0.0 * force
        if ti.static(self.laws.has_cohesion):
            attraction, cohesion_history = self.laws.cohesion.force(
                constants.cohesion, contact, history.cohesion
            )
            history_new.cohesion = cohesion_history
            force -= attraction
        if ti.static(self.laws.normal.attracts):
            attraction += self.laws.normal.attraction(constants.normal, contact, normal_history)
        load = force
        if ti.static(self.laws.attracts):
            load += attraction
        return force, load, viscous, history_new

    @ti.func
    def _surface_contact(
        self, constants, contact, load, history, bodies, kinematics, angular_velocities, dt, longest_time_step
    ):
        """Struct `contact` of the surface models, see `contact/law.py`.

        The time step is 0 in a force evaluation without motion, so that displacements do not change.
        """
        ratio = 0.0 * contact.overlap + 1.0  # of the previous to the present stiffness
        if ti.static(self.laws.normal.tangential_stiffness_grows):
            overlap_before = contact.overlap - dt * kinematics.overlap_rate_half
            ratio = ti.sqrt(ti.max(overlap_before, 0.0) / contact.overlap)
        normal_damping = 0.0 * contact.overlap
        if ti.static(len(self.laws.damped_slots) > 0):
            normal_damping = self.laws.normal.damping(constants.normal, contact, history.normal)
        rotation = (
            kinematics.arm_half * angular_velocities.first
            + kinematics.arm_partner_half * angular_velocities.partner
        )
        surface_velocity = kinematics.velocity_rel_half - rotation.cross(kinematics.normal_half)
        slip_rate = in_contact_plane(surface_velocity, kinematics.normal, kinematics.normal_half)
        return ti.Struct(
            radius_eff=contact.radius_eff,
            mass_eff=contact.mass_eff,
            inertia_eff=bodies.inertia_eff,
            time_step=dt,
            longest_time_step=longest_time_step,
            overlap=contact.overlap,
            overlap_rate=contact.overlap_rate,
            normal=kinematics.normal,
            normal_half=kinematics.normal_half,
            normal_load=load,
            stiffness=self.laws.normal.tangential_stiffness(constants.normal, contact, history.normal),
            stiffness_ratio=ratio,
            normal_damping=normal_damping,
            slip=dt * slip_rate,
            slip_rate=slip_rate,
            turn=0.5 * dt * kinematics.normal_half.dot(angular_velocities.first + angular_velocities.partner),
            rolling_rate=angular_velocities.first - angular_velocities.partner,
        )


@ti.func
def no_losses(nothing):
    """Vector `losses` of a contact without losses; `nothing`: 0 of the type of forces."""
    return ti.Vector([nothing for _ in ti.static(range(len(PAIR_LOSSES)))])


@ti.func
def normal_contact(bodies, kinematics, time_step):
    """Argument `contact` of the normal and cohesion models."""
    return ti.Struct(
        radius_eff=bodies.radius_eff,
        mass_eff=bodies.mass_eff,
        time_step=time_step,
        overlap=kinematics.overlap,
        overlap_rate=kinematics.overlap_rate,
    )


@ti.func
def normal_time_step(dt, longest_time_step):
    """Time step [s] of normal models: the longest of the run if that of this force evaluation is 0, without
    motion."""
    return ti.select(dt > 0.0, dt, longest_time_step)


PAIR_LOSSES = (
    *dict.fromkeys(LOSSES.index(slot.loss) for slot in SLOTS.values() if slot.on_surface),
    LOSS_DAMPING,
)
"""Terms of the energy budget that a pair force adds to, in the order of its vector `losses`."""


# Structs of the contact models from rows of numbers, and back


class ModelStructs:
    """Structs with a member for each slot (`contact.law.SLOTS`) from vectors of numbers, and back.

    A field has a row of numbers for a pair of materials, for the law parameters of the scene, and for the
    history of a contact in one slot. All names and indices are known when a kernel is compiled.
    """

    def __init__(self, laws: ContactLaws) -> None:
        self.slots = list(laws.by_slot)
        constants: dict[str, list[tuple[str, Any, int]]] = {slot: [] for slot in self.slots}
        for part, names_by_slot in ((_of_pair, laws.constant_names), (_of_law, laws.parameters)):
            names = [(slot, name) for slot, own in names_by_slot.items() for name in own]
            for k, (slot, name) in enumerate(names):
                constants[slot].append((name, part, k))
        self.constant_parts = list(constants.items())
        self.parts: dict[str, list[tuple[str, Any, int]]] = {slot: [] for slot in self.slots}
        self.components: dict[str, list[tuple[str, Any, int]]] = {slot: [] for slot in self.slots}
        for slot in self.slots:
            for each in laws.history[slot]:
                part, component = (number_at, _number_of) if each.size == 1 else (vector_at, _component_of)
                self.parts[slot].append((each.name, part, len(self.components[slot])))
                self.components[slot] += [(each.name, component, k) for k in range(each.size)]

    @ti.func
    def constants(self, pair, parameters):
        """Struct of slots, each of the pair constants and the parameters of its law by name.

        pair, parameters:  rows of both
        """
        return ti.Struct(
            {
                slot: ti.Struct({name: part(pair, parameters, k) for name, part, k in ti.static(own)})
                for slot, own in ti.static(self.constant_parts)
            }
        )

    @ti.func
    def histories(self, vector_at_slot: ti.template(), first, second):
        """Struct of slots, each of the history fields of its model; empty for a slot without history.

        vector_at_slot:  device function (slot, first, second) -> vector of components of a slot with history
        """
        return ti.Struct(
            {slot: self._read(vector_at_slot, slot, first, second) for slot in ti.static(self.slots)}
        )

    @ti.func
    def _read(self, vector_at_slot: ti.template(), slot: ti.template(), first, second):
        if ti.static(len(self.parts[slot]) > 0):
            return self.history(slot, vector_at_slot(slot, first, second))
        return self.history(slot, 0)

    @ti.func
    def history(self, slot: ti.template(), vector):
        """Struct of the history fields of a slot from its vector of components."""
        return ti.Struct({name: part(vector, k) for name, part, k in ti.static(self.parts[slot])})

    @ti.func
    def vector(self, slot: ti.template(), history):
        """Vector of components of a slot with history from the struct of its fields."""
        return ti.Vector(
            [component(history, name, k) for name, component, k in ti.static(self.components[slot])]
        )


@ti.func
def _of_pair(pair, parameters, k: ti.template()):
    return pair[k]


@ti.func
def _of_law(pair, parameters, k: ti.template()):
    return parameters[k]


@ti.func
def number_at(vector, k: ti.template()):
    """Entry k of a vector or field."""
    return vector[k]


@ti.func
def vector_at(vector, k: ti.template()):
    """Entries k to k + 2 of a vector or field, as a vector."""
    return ti.Vector([vector[k], vector[k + 1], vector[k + 2]])


@ti.func
def _number_of(history, name: ti.template(), k: ti.template()):
    return member(history, name)


@ti.func
def _component_of(history, name: ti.template(), k: ti.template()):
    return member(history, name)[k]


@at_compile_time
def set_member(struct: Any, name: str, value: Any) -> None:
    """Assign to a member of a struct by a name that is known when the kernel is compiled."""
    getattr(struct, name)._assign(value)


@at_compile_time
def member(struct: Any, name: str) -> Any:
    """Member of a struct by a name that is known when the kernel is compiled."""
    return getattr(struct, name)
