"""Particle properties that equations integrate, and the sums over contacts that they read.

Only scenes whose contact models declare sums (`Law.adds`) compile these functions. The sums are fields of the
particles in f64, in every precision: a flow is rounded to a multiple of a unit of the plan, so that they are
exact and do not depend on the order of the contacts. The force phase clears them (`build_clear_flows`) and
adds each contact with an overlap, to the partner as well if it is in the same chunk (`build_add_flows`). The
integration takes one explicit step with them (`build_integrate_properties`).
"""

from typing import Any

from granflow.contact.law import Law
from granflow.contact.particle_equation import ParticleEquation
from granflow.engine.codes import ABORT_FLOW
from granflow.engine.contact_structs import member
from granflow.engine.state import State
from granflow.engine.sums import build_to_grid
from granflow.kernel_language import ti
from granflow.plan.sum_units import SUM_BITS


def build_clear_flows(state: State) -> Any:
    """Device function (i): begin the sums of particle i.

    Writes:  the sums
    """
    sums = [getattr(state.particles, name) for name in state.plan.laws.adds]

    @ti.func
    def clear_flows(i):
        for each in ti.static(sums):
            each[i] = 0.0

    return clear_flows


def build_add_flows(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, j, constants, contact): add the flows of a contact to its particles.

    constants, contact:  of all slots; as of a normal model

    Reads:   properties that the laws read
    Writes:  the sums
    """
    chunk_size = state.parameter("chunk_size")
    laws = [
        (slot, _build_flows_of(state, law, with_wall), _build_add(state, law))
        for slot, law in state.plan.laws.by_slot.items()
        if law.adds
    ]

    @ti.func
    def add_flows(chunk, i, j, constants, contact):
        first = chunk * chunk_size()
        for slot, flows_of, add in ti.static(laws):
            flows = flows_of(i, j, member(constants, slot), contact)
            add(i, flows, 1.0)
            if j >= first and j < first + chunk_size():
                add(j, flows, -1.0)

    return add_flows


def _build_flows_of(state: State, law: Law, with_wall: bool) -> Any:
    """Device function (i, j, constants of the law, contact) -> struct of the flows from j to i."""
    read = [(name, getattr(state.particles, name)) for name in law.reads]

    @ti.func
    def flows_of(i, j, constants, contact):
        first = ti.Struct({name: field[i] for name, field in ti.static(read)})
        partner = first
        if ti.static(with_wall):
            partner = law.at_wall(constants, first)
        else:
            partner = ti.Struct({name: field[j] for name, field in ti.static(read)})
        return law.flows(constants, contact, first, partner)

    return flows_of


def _build_add(state: State, law: Law) -> Any:
    """Device function (i, flows, sign): add the rounded flows of a law to the sums of a particle.

    Writes:  the sums
    """
    to_grid = build_to_grid(ti.f64)
    sums = [(name, getattr(state.particles, name), state.parameter(f"shift.{name}")) for name in law.adds]

    @ti.func
    def add(i, flows, sign: ti.template()):
        for name, field, shift in ti.static(sums):
            field[i] = field[i] + sign * to_grid(ti.cast(member(flows, name), ti.f64), shift())

    return add


def build_integrate_properties(state: State) -> Any:
    """Device function (i, dt): one step of all particle equations; abort if a sum is not exact.

    Reads:   the sums, radius, mass, material
    Writes:  the properties, abort, abort_particle
    """
    steps = [_build_step(state, equation) for equation in state.plan.equations]
    sums = [
        (getattr(state.particles, name), state.parameter(f"per_unit.{name}")) for name in state.plan.laws.adds
    ]
    particles = state.particles
    control = state.control

    @ti.func
    def integrate_properties(i, dt):
        for field, per_unit in ti.static(sums):
            if not ti.abs(field[i]) * per_unit() <= 2.0**SUM_BITS:  # also if it is not a number
                ti.atomic_max(control.abort[0], ABORT_FLOW)
                ti.atomic_min(control.abort_particle[0], particles.id[i])
        for step in ti.static(steps):
            step(i, dt)

    return integrate_properties


def _build_step(state: State, equation: ParticleEquation) -> Any:
    """Device function (i, dt): one step of one equation."""
    particles = state.particles
    one_material = state.plan.features.one_material
    values = getattr(particles, equation.name)
    sums = [(name, getattr(particles, name)) for name in equation.reads]
    keys = [(key, state.parameter(f"{equation.name}.{key}")) for key in equation.material_keys]
    several = len(state.plan.materials) > 1

    @ti.func
    def value_of(parameter: ti.template(), material):
        found = parameter()
        if ti.static(several):
            return found[material]
        return found

    @ti.func
    def step(i, dt):
        material = 0
        if ti.static(not one_material):
            material = particles.material[i]
        constants = ti.Struct({key: value_of(parameter, material) for key, parameter in ti.static(keys)})
        particle = ti.Struct(radius=particles.radius[i], mass=particles.mass[i], value=values[i])
        found = ti.Struct({name: field[i] for name, field in ti.static(sums)})
        values[i] = values[i] + ti.cast(dt * equation.rate(constants, particle, found), values.dtype)

    return step
