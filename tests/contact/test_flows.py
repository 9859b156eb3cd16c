"""A contact model of electric conduction and the equation of a potential, registered by a program."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from pydantic import Field
from scene_builders import build_scene, particle_group, plane

from granflow import Scene, Simulation, register_contact_model, register_particle_equation
from granflow.contact import registry
from granflow.contact.law import ContactModel, Flow, PairProperties
from granflow.contact.normal.hertz import Hertz
from granflow.contact.particle_equation import MaterialProperties, ParticleEquation
from granflow.device_functions import ti
from granflow.errors import FunctionError, GranflowError, RunError
from granflow.scene.registration import unregister_contact_model, unregister_particle_equation
from granflow.schema.quantities import NotNegative, Number

CONDUCTANCE, CAPACITANCE, DENSITY, RADIUS = 2e-2, 0.5, 2500.0, 0.005
MASS = DENSITY * 4.0 / 3.0 * np.pi * RADIUS**3
TIME_STEP = 1e-5
HIGH, LOW = 310.0, 290.0


@dataclass(frozen=True)
class Conducting(Hertz):
    """Hertz contacts of constant conductance."""

    name = "conducting"
    source = "this test, 2026"
    limits = "a conductance without dependence on the load"
    constant_names = (*Hertz.constant_names, "conductance")
    flows = {"current": Flow("A", "current from the contacts")}
    particle_properties = ("potential",)

    def pair_constants(self, pair):
        return *super().pair_constants(pair), pair.properties["conductance"]

    @ti.func
    def flow(self, constants, contact, first, partner):
        return ti.Struct(current=constants.conductance * (partner.potential - first.potential))

    def flow_bounds(self, name, case):
        low, high = case.values["potential"]
        return case.pair.properties["conductance"] * (high - low), case.pair.properties["conductance"]


@dataclass(frozen=True)
class Grounded(Conducting):
    """The same, with walls at 300 V, and a bound of the flow that is too low by a factor."""

    name = "grounded"

    @ti.func
    def wall_flow(self, constants, contact, first, wall):
        return self.flow(constants, contact, first, ti.Struct(potential=0.0 * first.potential + 300.0))

    def flow_bounds(self, name, case):
        low, high = case.values["potential"]
        conductance, share = (case.pair.properties[key] for key in ("conductance", "bound_share"))
        return share * conductance * (max(high, 300.0) - min(low, 300.0)), share * conductance


class ConductancePair(PairProperties):
    conductance: NotNegative = Field(description="conductance [S]", examples=["1e-3"])


class GroundedPair(ConductancePair):
    bound_share: NotNegative = Field(description="bound of the flow over its largest value", examples=["1"])


class Capacitance(MaterialProperties):
    specific_capacitance: Annotated[float, Number(above=0)] = Field(description="specific capacitance [F/kg]")


class Potential(ParticleEquation):
    """dV/dt = I / (m c)."""

    name = "potential"
    symbol = "V"
    unit = "V"
    meaning = "potential of the particle"
    initial = Number(above=0)
    flows = ("current",)
    material_properties = Capacitance

    @ti.func
    def rate(self, constants, particle, flows):
        return flows.current / (particle.mass * constants.specific_capacitance)

    def longest_time_step(self, constants, radius, mass, slope):
        return mass * constants["specific_capacitance"] / slope if slope else np.inf


MODELS = [
    ContactModel(law, "Hertz contacts that conduct", pair_properties=properties)
    for law, properties in ((Conducting, ConductancePair), (Grounded, GroundedPair))
]
EQUATION = Potential()


@pytest.fixture(scope="module", autouse=True)
def registered():
    """Models and equation are registered during all tests: each registration builds the schema again."""
    for model in MODELS:
        register_contact_model(model)
    register_particle_equation(EQUATION)
    yield
    unregister_particle_equation(EQUATION)
    for model in MODELS:
        unregister_contact_model(model)


GLASS = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": DENSITY, "specific_capacitance": CAPACITANCE}


def scene_of(positions, potentials, chunk_size=1, law="conducting", pair=None):
    """A scene of spheres above a floor, one group per potential; the first is fixed.

    The floor touches a sphere at the origin. All these scenes share their kernels, but for chunks.
    """
    groups = {
        f"group_{number}": particle_group(own, 2.0 * RADIUS, potential=potential) | {"fixed": number == 0}
        for number, (own, potential) in enumerate(zip(positions, potentials, strict=True))
    }
    given = {"restitution": 0.8, "friction": 0.0, "conductance": CONDUCTANCE} | (pair or {})
    return build_scene(
        groups, {"floor": plane([0, 0, -0.99 * RADIUS], [0, 0, 1])}, given,
        materials={"glass": GLASS}, contact={"normal": law, "tangential": "none", "rolling": "none"},
        gravity=[0, 0, -9.81], numerics={"chunk_size": chunk_size, "max_overlap": 0.1},
        run={"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 1.0},
    )  # fmt: skip


PAIR = [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 2.0 * RADIUS - 1.1e-5]]]
"""A sphere that rests on a fixed one."""


def test_two_spheres_exchange_charge_until_their_potentials_are_equal():
    """V1 - V2 = D exp(-2 h t / (m c)), and V1 + V2 is constant."""
    with Simulation(scene_of(PAIR, (HIGH, LOW), chunk_size=16), threads=2) as simulation:
        assert simulation.engine.state.batch is not None
        samples = [simulation.snapshot().particles["potential"].tolist()]
        for _ in range(8):
            simulation.step(50)
            samples.append(simulation.snapshot().particles["potential"].tolist())
        particles = simulation.snapshot().particles
    assert particles["current"][0] == -particles["current"][1] != 0.0
    potentials = np.array(samples)
    assert len(set(potentials.sum(axis=1).tolist())) == 1
    decay = 2.0 * CONDUCTANCE * TIME_STEP / (MASS * CAPACITANCE)
    steps = 50 * np.arange(9)
    difference = -np.diff(potentials, axis=1)[:, 0]
    np.testing.assert_allclose(difference, (HIGH - LOW) * (1.0 - decay) ** steps, rtol=1e-12)
    np.testing.assert_allclose(difference, (HIGH - LOW) * np.exp(-decay * steps), rtol=decay)


def bed(chunk_size):
    """Touching spheres in motion above a floor, in four groups of different potentials, and a fixed one."""
    positions = 1.99 * RADIUS * np.argwhere(np.ones((4, 4, 4)))
    rng = np.random.default_rng(2)
    groups = [positions[:1], *(positions[1 + k :: 4] for k in range(4))]
    scene = scene_of(groups, (300.0, HIGH, LOW, 297.0, 306.0), chunk_size).to_dict()
    for group in scene["particles"].values():
        count = len(group["insert"]["positions"])
        group["velocity"] = rng.normal(0.0, 0.3, (count, 3)).tolist() if not group["fixed"] else [0, 0, 0]
    return Scene.from_dict(scene)


def test_a_bed_has_the_same_bits_for_chunks_and_conserves_its_charge():
    """With a model that gives walls no value, also where it touches the floor."""
    found = []
    for chunk_size in (8, 16):
        with Simulation(bed(chunk_size), threads=2) as simulation:
            before = simulation.snapshot().particles["potential"].sum()
            simulation.step(300)
            last = simulation.snapshot()
            found.append({name: values.tolist() for name, values in last.particles.items()})
    assert found[0] == found[1] and last.totals["wall_contact_count"] > 0
    flows, potential = last.particles["current"], last.particles["potential"]
    assert np.count_nonzero(flows) > 10 and flows.sum() == 0.0
    assert potential.sum() == pytest.approx(before, rel=1e-14)
    assert potential.std() > 0 and LOW <= potential.min() and potential.max() <= HIGH


def test_walls_have_the_value_that_the_model_gives_them_and_a_flow_above_its_bound_is_an_error():
    pair = {"bound_share": 1.0, "conductance": CONDUCTANCE}
    scene = scene_of([[[0.5, 0.0, 0.0]], [[0.0, 0.0, 0.0]]], (HIGH, HIGH), law="grounded", pair=pair)
    with Simulation(scene, threads=2) as simulation:
        simulation.step(5)
        found = simulation.snapshot().particles["potential"][1]
    decay = CONDUCTANCE * TIME_STEP / (MASS * CAPACITANCE)
    assert found == pytest.approx(300.0 + (HIGH - 300.0) * (1.0 - decay) ** 5, rel=1e-9)
    scene = scene_of(PAIR, (HIGH, LOW), law="grounded", pair=pair | {"bound_share": 1e-9})
    with (
        Simulation(scene, threads=2) as simulation,
        pytest.raises(RunError, match=r"one of the flows to particle 0 .*current, is not a number or more"),
    ):
        simulation.step(2)


def test_a_normal_model_acts_without_the_values_of_its_properties():
    """A conductance of 0: the force is that of Hertz, the potentials stay."""
    with Simulation(scene_of(PAIR, (HIGH, LOW), 16, pair={"conductance": 0.0}), threads=2) as simulation:
        simulation.step(10)
        particles = simulation.snapshot().particles
    assert particles["potential"].tolist() == [HIGH, LOW]
    assert particles["coordination_number"].tolist() == [1, 1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "count"}, "a key of particle groups has this name"),
        ({"name": "charge", "flows": "current"}, "but must be a tuple of names"),
        ({}, "particle equation potential: an equation of this name exists"),
    ],
)
def test_an_equation_that_is_not_valid_is_refused(changes, message):
    with pytest.raises(GranflowError, match=message):
        register_particle_equation(type("Other", (Potential,), changes)())


class VectorRate(Potential):
    @ti.func
    def rate(self, constants, particle, flows):
        return ti.Vector([flows.current, 0.0, 0.0])


class InfiniteRate(Potential):
    @ti.func
    def rate(self, constants, particle, flows):
        return particle.mass / (particle.value - particle.value)


@dataclass(frozen=True)
class OtherFlow(Conducting):
    @ti.func
    def flow(self, constants, contact, first, partner):
        return ti.Struct(charge=constants.conductance)


@pytest.mark.parametrize(
    ("equation", "law", "error", "message"),
    [
        (
            VectorRate(),
            Conducting,
            FunctionError,
            r"test_flows.py:\d+: rate must return one number \[V / s\]",
        ),
        (EQUATION, OtherFlow, FunctionError, r"flow must return a ti.Struct with its flows \(current\)"),
        (InfiniteRate(), Conducting, RunError, r"the potential of .* is not a finite number"),
    ],
)
def test_functions_that_return_something_else_are_reported(equation, law, error, message):
    registry.remove(MODELS[0])  # the schema stays, because names and keys are those of the module
    registry.remove_equation(EQUATION)
    model = ContactModel(law, "Hertz contacts that conduct", pair_properties=ConductancePair)
    registry.add(model)
    registry.add_equation(equation)
    try:
        with pytest.raises(error, match=message), Simulation(scene_of(PAIR, (HIGH, LOW)), threads=2) as run:
            run.step(2)
    finally:
        registry.remove_equation(equation)
        registry.remove(model)
        registry.add(MODELS[0])
        registry.add_equation(EQUATION)
