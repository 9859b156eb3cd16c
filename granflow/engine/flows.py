"""Particle properties that equations integrate, and the sums over contacts that they read.

Only scenes whose contact models declare flows (`Law.flows`) compile these functions. The sums are fields of
the particles in f64, in every precision: a flow is rounded to a multiple of a unit of the plan, so that they
are exact and do not depend on the order of the contacts.
"""

from typing import Any

from granflow.engine.codes import ABORT_FLOW
from granflow.engine.pair import member
from granflow.engine.state import State
from granflow.engine.sums import build_to_grid
from granflow.engine.walls import Faces
from granflow.kernel_language import ti
from granflow.plan.sum_units import SUM_BITS


class Flows:
    """The sums of the flows, and the particle equations.

    The force phase clears the sums and adds each contact with an overlap. The integration takes one explicit
    step of the equations with them.
    """

    def __init__(self, state: State) -> None:
        self.state = state
        self.particles = state.particles
        self.control = state.control
        self.chunk_size = state.parameter("chunk_size")
        self.to_grid = build_to_grid(ti.f64)
        self.one_material = state.plan.features.one_material
        self.several_materials = len(state.plan.materials) > 1
        laws = state.plan.laws
        self.sums = [(field, state.parameter(f"per_unit.{name}")) for name, field in self._fields(laws.flows)]
        self.laws = [
            (slot, law, self._fields(law.particle_properties), self._sums_of(law.flows))
            for slot, law in laws.by_slot.items()
            if law.flows
        ]
        self.radius_slot = laws.of_contact_radius
        self.radius_law = laws.by_slot[self.radius_slot]
        self.wall_of = state.built(Faces).wall_of
        self.wall_values = [
            (name, field)
            for key, (value, given) in state.walls.values.items()
            for name, field in ((key, value), (f"{key}_given", given))
        ]
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
    def clear(self, i):
        """Begin the sums of particle i.

        Writes:  the sums
        """
        for field, _ in ti.static(self.sums):
            field[i] = 0.0

    @ti.func
    def add(self, chunk, i, j, constants, contact, with_wall: ti.template()):
        """Add the flows of a contact to particle i, and to partner j if it is in the same chunk.

        constants, contact:  of all slots; as of a normal model

        Reads:   properties that the laws read
        Writes:  the sums
        """
        begin = chunk * self.chunk_size()
        touching = ti.Struct(
            radius_eff=contact.radius_eff,
            mass_eff=contact.mass_eff,
            time_step=contact.time_step,
            overlap=contact.overlap,
            overlap_rate=contact.overlap_rate,
            contact_radius=self.radius_law.contact_radius(member(constants, self.radius_slot), contact),
        )
        for slot, law, read, sums in ti.static(self.laws):
            first = ti.Struct({name: field[i] for name, field in ti.static(read)})
            flows = self._flows(law, member(constants, slot), touching, first, j, read, with_wall)
            for name, field, shift in ti.static(sums):
                flow = self.to_grid(ti.cast(member(flows, name), ti.f64), shift())
                field[i] = field[i] + flow
                if j >= begin and j < begin + self.chunk_size():
                    field[j] = field[j] - flow

    @ti.func
    def _flows(
        self, law: ti.template(), constants, contact, first, j, read: ti.template(), with_wall: ti.template()
    ):
        """Struct of the flows of a law from partner j."""
        if ti.static(with_wall):
            w = self.wall_of(j)
            wall = ti.Struct({name: field[w] for name, field in ti.static(self.wall_values)})
            return law.wall_flow(constants, contact, first, wall)
        partner = ti.Struct({name: field[j] for name, field in ti.static(read)})
        return law.flow(constants, contact, first, partner)

    @ti.func
    def integrate(self, i, dt):
        """One step of all particle equations; abort if a sum is not exact.

        Reads:   the sums, radius, mass, material, id
        Writes:  the properties, abort, abort_particle
        """
        for field, per_unit in ti.static(self.sums):
            if not ti.abs(field[i]) * per_unit() <= 2.0**SUM_BITS:  # also if it is not a number
                ti.atomic_max(self.control.abort[0], ABORT_FLOW)
                ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])
        material = 0
        if ti.static(not self.one_material):
            material = self.particles.material[i]
        for equation, values, sums, keys in ti.static(self.equations):
            constants = ti.Struct(
                {key: self._of_material(parameter, material) for key, parameter in ti.static(keys)}
            )
            particle = ti.Struct(
                radius=self.particles.radius[i], mass=self.particles.mass[i], value=values[i]
            )
            found = ti.Struct({name: field[i] for name, field in ti.static(sums)})
            values[i] = values[i] + ti.cast(dt * equation.rate(constants, particle, found), values.dtype)

    @ti.func
    def _of_material(self, parameter: ti.template(), material):
        """Value of a parameter of all materials for one of them."""
        found = parameter()
        if ti.static(self.several_materials):
            return found[material]
        return found
