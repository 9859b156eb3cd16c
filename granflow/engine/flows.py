"""Particle properties that equations integrate, and the sums over contacts that they read.

Only scenes whose contact models declare flows (`Law.flows`) compile these functions. The sums are fields of
the particles in f64, in every precision: a flow is rounded to a multiple of a unit of the plan, so that they
are exact and do not depend on the order of the contacts.
"""

from typing import Any

import numpy as np

from granflow.engine.codes import ABORT_FLOW, ABORT_RATE
from granflow.engine.pair import member, normal_time_step
from granflow.engine.state import State
from granflow.engine.sums import build_to_grid, carried, exact_totals, shares_rows, to_units
from granflow.engine.walls import Faces
from granflow.kernel_language import ti
from granflow.plan.arrays import FURTHER_GIVERS, giver_count
from granflow.plan.sum_units import CARRY_BITS, SUM_BITS


class Flows:
    """The sums of the flows, and the particle equations.

    The force phase clears the sums and adds each contact with an overlap, and each pair within the range of a
    model that acts at a distance. The integration takes one explicit step of the equations with them. What
    flows from walls is summed over the run: the force phase adds what will flow in the next step, which is
    ahead of the particles until then.

    A clump has one value of each property, of which each of its spheres has a copy. Each copy takes the same
    step with the flows to all spheres of the clump, in the order of their ids, as `ClumpMotion` does.

    A particle that is attached to a wall with a value of the property keeps that value, as a part of the
    wall; what flows to it flows to the wall.
    """

    def __init__(self, state: State) -> None:
        self.state = state
        self.particles = state.particles
        self.control = state.control
        self.walls = state.walls
        self.chunk_size = state.parameter("chunk_size")
        self.to_grid = build_to_grid(ti.f64)
        self.one_material = state.plan.features.one_material
        self.clumps = state.plan.features.clumps
        self.several_materials = len(state.plan.materials) > 1
        laws = state.plan.laws
        self.at_distance = laws.flows_at_distance
        self.sums = [(field, state.parameter(f"per_unit.{name}")) for name, field in self._fields(laws.flows)]
        flowing = [(slot, law) for slot, law in laws.by_slot.items() if law.flows]
        self.slots = [(n, slot, law.at_distance) for n, (slot, law) in enumerate(flowing)]
        self.laws = [  # each in a list of its own, for loops of one turn
            [(slot, law, self._fields(("radius", *law.particle_properties)))] for slot, law in flowing
        ]
        self.sums_of_law = [self._sums_of(law.flows) for _, law in flowing]
        self.radius_slot = laws.of_contact_radius
        self.radius_law = laws.by_slot[self.radius_slot]
        self.wall_of = state.built(Faces).wall_of
        self.wall_flows = state.control.wall_flows
        self.wall_flows_ahead = state.control.wall_flows_ahead
        self.wall_sums = [
            (k, state.parameter(f"per_unit.wall.{name}")) for k, name in enumerate(state.plan.wall_flows)
        ]
        self.high_word = len(self.wall_sums)
        self.sums_walls = bool(self.wall_sums)
        self.wall_term = {name: k for k, name in enumerate(state.plan.wall_flows)}
        self.shared = shares_rows(state)
        self.has_loss_heat = state.plan.features.loss_heat
        self.loss_law: Any = laws.of_losses
        self.loss_flow = self.loss_law.loss_flow if self.loss_law else ""
        self.loss_heat: Any = self.particles.loss_heat if self.has_loss_heat else None
        self.loss_heat_unit = state.parameter("loss_heat_unit") if self.has_loss_heat else None
        self.has_loss_ahead = state.plan.features.loss_heat_ahead
        self.loss_heat_ahead: Any = self.particles.loss_heat_ahead if self.has_loss_ahead else None
        self.longest_time_step = state.parameter("longest_time_step")
        self.rows = state.capacities.wall_rows
        self.wall_count = state.parameter("wall_count")
        self.wall_values = [
            (name, field)
            for key, (value, given) in state.walls.values.items()
            for name, field in ((key, value), (f"{key}_given", given))
        ]
        self.surroundings = state.capacities.walls
        self.source_place = state.capacities.walls + 1
        self.loss_place = state.capacities.walls + FURTHER_GIVERS
        self.sources = [
            (self.wall_term[flow], getattr(self.particles, source.name), *self._sums_of((flow,))[0][1:])
            for flow, source in state.plan.sources.items()
        ]
        self.has_sources = bool(self.sources)
        self.has_surroundings = laws.of_surroundings is not None
        self.surroundings_law: Any = None
        if laws.of_surroundings is not None:
            slot, self.surroundings_law = laws.of_surroundings
            law = self.surroundings_law
            keys = state.plan.law_constants(slot, state.plan.materials[0])
            self.surroundings_constants = [
                (key, state.parameter(f"{slot}.{key}"), key in keys) for key in (*keys, *law.parameters)
            ]
            self.surroundings_read = self._fields(("radius", *law.particle_properties))
            self.surroundings_sums = self._sums_of(law.flows)
        self.held = {
            equation.name: (state.walls.values[equation.name][1], self._sums_of(equation.flows))
            for equation in state.plan.scene.equations
            if equation.name in state.plan.held_values
        }
        self.equations = [
            (
                equation,
                getattr(state.particles, equation.name),
                self._fields(equation.flows),
                [(key, state.parameter(f"{equation.name}.{key}")) for key in equation.material_keys],
            )
            for equation in state.plan.scene.equations
        ]

    def _fields(self, names: Any) -> list[tuple[str, Any]]:
        """Fields of the particles with their names."""
        return [(name, getattr(self.particles, name)) for name in names]

    def _sums_of(self, names: Any) -> list[tuple[str, Any, Any]]:
        """Sums with their names, and the shifts that round their terms."""
        return [(name, field, self.state.parameter(f"shift.{name}")) for name, field in self._fields(names)]

    @ti.func
    def begin(self, chunk, i, time_step, dt):
        """Begin the sums of particle i with its sources, and with what its surroundings give.

        The losses of the step before have been taken, unless this evaluation follows no integration: then it
        counts again what belongs to the next half step.

        time_step:  as of a normal model [s]
        dt:         time step [s]; 0 in an evaluation without motion

        Reads:   radius, material, exposed_share, properties that the laws read
        Writes:  the sums, loss_heat, loss_heat_ahead, wall_flows, wall_flows_ahead
        """
        for field, _ in ti.static(self.sums):
            field[i] = 0.0
        if ti.static(self.has_loss_heat):
            if dt > 0.0:
                self.loss_heat[i] = ti.cast(0, ti.i64)
            elif ti.static(self.has_loss_ahead):
                self.loss_heat[i] = self.loss_heat[i] - self.loss_heat_ahead[i]
            if ti.static(self.has_loss_ahead):
                self.loss_heat_ahead[i] = ti.cast(0, ti.i64)
        for k, source, field, shift in ti.static(self.sources):
            flow = self.to_grid(source[i], shift())
            field[i] = field[i] + flow
            given = ti.cast(time_step, ti.f64) * flow
            self._add_to_wall(chunk, self.source_place, k, given, True)
        if ti.static(self.has_surroundings):
            self._add_surroundings(chunk, i, time_step)

    @ti.func
    def _add_surroundings(self, chunk, i, time_step):
        material = 0
        if ti.static(not self.one_material):
            material = self.particles.material[i]
        constants = ti.Struct(
            {
                key: self._constant(each, material, by_material)
                for key, each, by_material in ti.static(self.surroundings_constants)
            }
        )
        particle = ti.Struct({name: field[i] for name, field in ti.static(self.surroundings_read)})
        flows = self.surroundings_law.surroundings_flow(constants, particle)
        exposed = ti.cast(1.0, ti.f64)
        if ti.static(self.clumps):
            exposed = self.particles.exposed_share[i]
        for name, field, shift in ti.static(self.surroundings_sums):
            flow = self.to_grid(exposed * ti.cast(member(flows, name), ti.f64), shift())
            field[i] = field[i] + flow
            given = ti.cast(time_step, ti.f64) * flow
            self._add_to_wall(chunk, self.surroundings, self.wall_term[name], given, True)

    @ti.func
    def _constant(self, parameter: ti.template(), material, by_material: ti.template()):
        """Value of a parameter, or that for a material."""
        found = parameter()
        if ti.static(by_material and self.several_materials):
            return found[material]
        return found

    @ti.func
    def add(self, chunk, i, j, constants, contact, with_wall: ti.template()):
        """Add the flows of a contact to particle i, and to partner j if it is in the same chunk.

        constants, contact:  of all slots; as of a normal model, without overlap only for models that act at a
                             distance

        Reads:   properties that the laws read
        Writes:  the sums
        """
        contact_radius = 0.0 * contact.overlap
        if ti.static(not self.at_distance):
            contact_radius = self.radius_law.contact_radius(member(constants, self.radius_slot), contact)
        elif contact.overlap > 0.0:
            contact_radius = self.radius_law.contact_radius(member(constants, self.radius_slot), contact)
        touching = ti.Struct(
            radius_eff=contact.radius_eff,
            mass_eff=contact.mass_eff,
            time_step=contact.time_step,
            overlap=contact.overlap,
            overlap_rate=contact.overlap_rate,
            contact_radius=contact_radius,
        )
        for n, slot, at_distance in ti.static(self.slots):
            if ti.static(not self.at_distance):
                self._add_of_law(chunk, i, j, constants, touching, n, with_wall)
            else:
                reach = 0.0 * contact.overlap
                if ti.static(at_distance):
                    reach = member(constants, slot).range
                if contact.overlap > -reach:
                    self._add_of_law(chunk, i, j, constants, touching, n, with_wall)

    @ti.func
    def _add_of_law(self, chunk, i, j, constants, contact, n: ti.template(), with_wall: ti.template()):
        """Add the flows of law n; a law is no argument, because Quadrants would expand its fields."""
        for slot, law, read in ti.static(self.laws[n]):
            first = ti.Struct({name: field[i] for name, field in ti.static(read)})
            if ti.static(with_wall):
                wall = self._wall(self.wall_of(j))
                flows = law.wall_flow(member(constants, slot), contact, first, wall)
                self._add_flows(chunk, i, j, contact, flows, n, with_wall)
            else:
                partner = ti.Struct({name: field[j] for name, field in ti.static(read)})
                flows = law.flow(member(constants, slot), contact, first, partner)
                self._add_flows(chunk, i, j, contact, flows, n, with_wall)

    @ti.func
    def _add_flows(self, chunk, i, j, contact, flows, n: ti.template(), with_wall: ti.template()):
        begin = chunk * self.chunk_size()
        for name, field, shift in ti.static(self.sums_of_law[n]):
            flow = self.to_grid(ti.cast(member(flows, name), ti.f64), shift())
            field[i] = field[i] + flow
            if ti.static(with_wall and name in self.wall_term):
                given = ti.cast(contact.time_step, ti.f64) * flow
                self._add_to_wall(chunk, self.wall_of(j), self.wall_term[name], given, True)
            if j >= begin and j < begin + self.chunk_size():
                field[j] = field[j] - flow

    @ti.func
    def add_loss(self, chunk, i, j, energy, with_wall: ti.template()):
        """Add the energy [J] that a contact has lost in this step to the heat of its partners.

        Reads:   keys of walls
        Writes:  loss_heat, wall_flows
        """
        if ti.static(self.has_loss_heat):
            self._add_loss(chunk, i, j, ti.cast(energy, ti.f64), with_wall, False)

    @ti.func
    def add_viscous_loss(self, chunk, i, j, power, dt, with_wall: ti.template()):
        """As `add_loss`, the loss of a viscous force: its present power [W] during half a step before and
        half a step behind the present time, as `Accounting.add_viscous_loss` counts it.

        Reads:   keys of walls
        Writes:  loss_heat, loss_heat_ahead, wall_flows, wall_flows_ahead
        """
        if ti.static(self.has_loss_ahead):
            half = ti.cast(0.5 * dt, ti.f64)
            half_ahead = ti.cast(0.5 * normal_time_step(dt, self.longest_time_step()), ti.f64)
            self._add_loss(chunk, i, j, half * ti.cast(power, ti.f64), with_wall, False)
            self._add_loss(chunk, i, j, half_ahead * ti.cast(power, ti.f64), with_wall, True)

    @ti.func
    def _add_loss(self, chunk, i, j, lost, with_wall: ti.template(), ahead: ti.template()):
        """Add a loss; `ahead`: in the next half step."""
        if ti.static(with_wall):
            w = self.wall_of(j)
            share = self.loss_law.wall_share(self._wall(w))
            self._add_loss_heat(i, (1.0 - share) * lost, ahead)
            if ti.static(self.loss_flow in self.wall_term):
                place = w
                if ti.static(ahead):
                    place += ti.static(self.loss_place)
                self._add_to_wall(chunk, place, self.wall_term[self.loss_flow], -share * lost, ahead)
        else:
            self._add_loss_heat(i, 0.5 * lost, ahead)
            begin = chunk * self.chunk_size()
            if j >= begin and j < begin + self.chunk_size():
                self._add_loss_heat(j, 0.5 * lost, ahead)

    @ti.func
    def _add_loss_heat(self, i, energy, ahead: ti.template()):
        units = to_units(energy / self.loss_heat_unit())
        self.loss_heat[i] = self.loss_heat[i] + units
        if ti.static(ahead):
            self.loss_heat_ahead[i] = self.loss_heat_ahead[i] + units

    @ti.func
    def _wall(self, w):
        """Struct of the keys of a wall that laws read."""
        return ti.Struct({name: field[w] for name, field in ti.static(self.wall_values)})

    @ti.func
    def _flow(self, i, dt, name: ti.template(), field: ti.template()):
        """Sum of a flow, with the losses of the step that has ended."""
        found = field[i]
        if ti.static(self.has_loss_heat and name == self.loss_flow):
            found += ti.cast(self.loss_heat[i], ti.f64) * self.loss_heat_unit() / dt
        return found

    @ti.func
    def _flow_of_body(self, i, dt, name: ti.template(), field: ti.template()):
        """Sum of a flow to particle i, or to all spheres of its clump."""
        found = ti.cast(0.0, ti.f64)
        if ti.static(self.clumps):
            for member_index in range(self.particles.clump_size[i]):
                found += self._flow(self._sphere(i, member_index), dt, name, field)
        else:
            found = self._flow(i, dt, name, field)
        return found

    @ti.func
    def _sphere(self, i, member_index):
        """Index of a sphere of the clump of i; i itself if it is in no clump."""
        j = i
        if self.particles.clump[i] >= 0:
            j = self.particles.index_by_id[self.particles.clump_begin[i] + member_index]
        return j

    @ti.func
    def _body(self, i):
        """Radius [m] and mass [kg] of particle i, or of its clump, as `ParticleEquation.rate` has them."""
        radius = self.particles.radius[i]
        mass = self.particles.mass[i]
        if ti.static(self.clumps):
            mass = self.particles.clump_mass[i]
            for member_index in range(self.particles.clump_size[i]):
                radius = ti.max(radius, self.particles.radius[self._sphere(i, member_index)])
        return radius, mass

    @ti.func
    def integrate(self, i, dt):
        """One step of all particle equations; abort if a sum is not exact.

        Reads:   the sums, loss_heat, radius, mass, material, id; clump, clump_size, clump_begin, clump_mass,
                 index_by_id
        Writes:  the properties, abort, abort_particle
        """
        for field, per_unit in ti.static(self.sums):
            if not ti.abs(field[i]) * per_unit() <= 2.0**SUM_BITS:  # also if it is not a number
                ti.atomic_max(self.control.abort[0], ABORT_FLOW)
                ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])
        material = 0
        if ti.static(not self.one_material):
            material = self.particles.material[i]
        radius, mass = self._body(i)
        for equation, values, sums, keys in ti.static(self.equations):
            constants = ti.Struct(
                {key: self._of_material(parameter, material) for key, parameter in ti.static(keys)}
            )
            particle = ti.Struct(radius=radius, mass=mass, value=values[i])
            found = ti.Struct(
                {name: self._flow_of_body(i, dt, name, field) for name, field in ti.static(sums)}
            )
            change = ti.cast(dt * equation.rate(constants, particle, found), values.dtype)
            if ti.static(equation.name in self.held):
                if self._is_held(i, self.held[equation.name][0]):
                    change = 0.0 * change
            changed = values[i] + change
            values[i] = changed
            if not changed - changed == 0.0:  # infinite, or not a number
                ti.atomic_max(self.control.abort[0], ABORT_RATE)
                ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])

    @ti.func
    def _is_held(self, i, given: ti.template()):
        """Whether the wall to which particle i is attached has a value of a property."""
        w = self.particles.attached_to[i]
        return w >= 0 and given[ti.max(w, 0)] > 0.0

    @ti.func
    def give_to_wall(self, chunk, i, time_step):
        """Add what flows to a particle that is attached to a wall, and its losses, to those of the wall if it
        holds the property, after all contacts of the chunk.

        time_step:  as of a normal model [s]

        Reads:   attached_to, the sums
        Writes:  wall_flows, wall_flows_ahead, loss_heat, loss_heat_ahead
        """
        for given, sums in ti.static(list(self.held.values())):
            if self._is_held(i, given):
                w = self.particles.attached_to[i]
                for name, field, _ in ti.static(sums):
                    if ti.static(name in self.wall_term):
                        k = ti.static(self.wall_term[name])
                        self._add_to_wall(chunk, w, k, -ti.cast(time_step, ti.f64) * field[i], True)
                        if ti.static(self.has_loss_heat and name == self.loss_flow):
                            self._give_losses_to_wall(chunk, i, w, k)

    @ti.func
    def _give_losses_to_wall(self, chunk, i, w, k: ti.template()):
        unit = self.loss_heat_unit()
        if ti.static(self.has_loss_ahead):
            ahead = self.loss_heat_ahead[i]
            place = ti.static(self.loss_place) + w
            self._add_to_wall(chunk, place, k, -ti.cast(ahead, ti.f64) * unit, True)
            self.loss_heat[i] = self.loss_heat[i] - ahead
            self.loss_heat_ahead[i] = ti.cast(0, ti.i64)
        self._add_to_wall(chunk, w, k, -ti.cast(self.loss_heat[i], ti.f64) * unit, False)
        self.loss_heat[i] = ti.cast(0, ti.i64)

    @ti.func
    def _add_to_wall(self, chunk, w, k: ti.template(), amount, ahead: ti.template()):
        """Add an amount to the integral k of wall w; `ahead`: in the next step."""
        units = to_units(self.wall_sums[k][1]() * amount)
        high = units >> CARRY_BITS
        low = units - (high << CARRY_BITS)
        self._add_words(self.wall_flows, chunk, w, k, low, high)
        if ti.static(ahead):
            self._add_words(self.wall_flows_ahead, chunk, w, k, low, high)

    @ti.func
    def _add_words(self, field: ti.template(), chunk, w, k: ti.template(), low, high):
        if ti.static(self.shared):
            ti.atomic_add(field[chunk % self.rows, w][k], low)
            ti.atomic_add(field[chunk % self.rows, w][self.high_word + k], high)
        else:
            sums = field[chunk, w]
            sums[k] += low
            sums[self.high_word + k] += high
            field[chunk, w] = sums

    @ti.func
    def begin_step(self, chunk):
        """Move the carries of the integrals of walls; the step takes what was ahead. Not beside additions.

        Writes:  wall_flows, wall_flows_ahead
        """
        if ti.static(self.sums_walls):
            if chunk < self.rows:
                for w in range(self.wall_count()):
                    self._carry(chunk, w)
                if ti.static(self.has_surroundings):
                    self._carry(chunk, self.surroundings)
                if ti.static(self.has_sources):
                    self._carry(chunk, self.source_place)
                if ti.static(self.has_loss_ahead):
                    for w in range(self.wall_count()):
                        self._carry(chunk, ti.static(self.loss_place) + w)

    @ti.func
    def _carry(self, row, w):
        self.wall_flows[row, w] = carried(self.wall_flows[row, w], self.high_word)
        self.wall_flows_ahead[row, w] = ti.Vector.zero(ti.i64, ti.static(2 * self.high_word))

    @ti.func
    def _of_material(self, parameter: ti.template(), material):
        """Value of a parameter of all materials for one of them."""
        found = parameter()
        if ti.static(self.several_materials):
            return found[material]
        return found


def build_withdraw(state: State) -> Any:
    """Kernel (): take what is ahead from the integrals of walls, before forces that count it again.

    Writes:  wall_flows, wall_flows_ahead
    """
    control = state.control
    rows = state.capacities.wall_rows
    places = giver_count(state.plan)

    @ti.kernel
    def withdraw():
        for row in range(rows):
            for w in range(places):
                control.wall_flows[row, w] = control.wall_flows[row, w] - control.wall_flows_ahead[row, w]
                control.wall_flows_ahead[row, w] = 0 * control.wall_flows_ahead[row, w]

    return withdraw


def wall_flow_totals(state: State) -> dict[str, float]:
    """Integral of each flow since the start, of each wall that gives it, QUANTITY.WALL, of the surroundings
    and of sources; and the present rates of walls."""
    plan = state.plan
    if not plan.wall_flows:
        return {}
    control = state.control
    words_ahead = control.wall_flows_ahead.to_numpy()
    sums = state.ranks.total(control.wall_flows.to_numpy() - words_ahead)
    sums_ahead = state.ranks.total(words_ahead)
    units = np.array(list(plan.wall_flow_units.values()))
    found = {}
    for index, wall in enumerate(plan.walls):
        if all(values[index] is None for values in plan.wall_values.values()):
            continue
        of_wall = sums[:, index]
        if plan.features.loss_heat_ahead:
            of_wall = of_wall + sums[:, state.capacities.walls + FURTHER_GIVERS + index]
        totals = exact_totals(of_wall, units).tolist()
        for flow, total in zip(plan.wall_flows, totals, strict=True):
            found[f"{plan.laws.flows_from_walls[flow].name}.{wall.name}"] = total
        ahead = exact_totals(sums_ahead[:, index], units).tolist()
        for flow, amount in zip(plan.wall_flows, ahead, strict=True):
            if flow in plan.laws.rates_from_walls:
                rate = amount / state.clock.time_step_of_forces
                found[f"{plan.laws.rates_from_walls[flow].name}.{wall.name}"] = rate
    if plan.laws.of_surroundings is not None:
        totals = exact_totals(sums[:, state.capacities.walls], units).tolist()
        _, law = plan.laws.of_surroundings
        for flow, total in zip(plan.wall_flows, totals, strict=True):
            quantity = law.flows[flow].from_surroundings if flow in law.flows else None
            found |= {quantity.name: total} if quantity is not None else {}
    totals = exact_totals(sums[:, state.capacities.walls + 1], units).tolist()
    for flow, total in zip(plan.wall_flows, totals, strict=True):
        if flow in plan.sources:
            found[plan.sources[flow].total.name] = total
    return found
