"""A conduction-like contact model and the equation of a temperature, registered by a program: sums that models
declare, and particle equations."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
import pytest
from pydantic import Field

from granflow import Scene, Simulation, register_contact_model, register_particle_equation
from granflow.contact.law import ContactModel, Flow, PairProperties
from granflow.contact.normal.hertz import Hertz
from granflow.contact.particle_equation import MaterialProperties, ParticleEquation
from granflow.device_functions import ti
from granflow.errors import GranflowError, RunError, SceneError
from granflow.plan.build import plan_for
from granflow.scene.registration import (
    unregister_contact_model,
    unregister_particle_equation,
)
from granflow.schema.quantities import NotNegative, Number

CONDUCTANCE, HEAT_CAPACITY, DENSITY, RADIUS = 2e-2, 0.5, 2500.0, 0.005
MASS = DENSITY * 4.0 / 3.0 * np.pi * RADIUS**3
TIME_STEP = 1e-5
HOT, COLD = 310.0, 290.0


@dataclass(frozen=True)
class Conducting(Hertz):
    """Hertz contacts of constant conductance."""

    name = "conducting"
    source = "this test, 2026"
    limits = "a conductance without dependence on the load"
    constant_names = (*Hertz.constant_names, "conductance")
    flows = {"heat_flow": Flow("W", "heat from the contacts")}
    particle_properties = ("temperature",)

    def pair_constants(self, pair):
        return *super().pair_constants(pair), pair.properties["conductance"]

    @ti.func
    def flow(self, constants, contact, first, partner):
        return ti.Struct(heat_flow=constants.conductance * (partner.temperature - first.temperature))

    def flow_bounds(self, name, case):
        low, high = case.values["temperature"]
        return case.pair.properties["conductance"] * (high - low), case.pair.properties["conductance"]


@dataclass(frozen=True)
class Heated(Conducting):
    """The same, with walls at 300 K, and a bound of the flow that is too low by a factor."""

    name = "heated"

    @ti.func
    def at_wall(self, constants, first):
        return ti.Struct(temperature=0.0 * first.temperature + 300.0)

    def flow_bounds(self, name, case):
        low, high = case.values["temperature"]
        conductance, share = (case.pair.properties[key] for key in ("conductance", "bound_share"))
        return share * conductance * (max(high, 300.0) - min(low, 300.0)), share * conductance


class ConductancePair(PairProperties):
    conductance: NotNegative = Field(description="conductance [W/K]", examples=["1e-3"])


class HeatedPair(ConductancePair):
    bound_share: NotNegative = Field(description="bound of the flow over its largest value", examples=["1"])


class Heat(MaterialProperties):
    heat_capacity: Annotated[float, Number(above=0)] = Field(description="specific heat capacity [J/(kg K)]")


class Temperature(ParticleEquation):
    """dT/dt = q / (m c)."""

    name = "temperature"
    symbol = "T"
    unit = "K"
    meaning = "temperature of the particle"
    initial = Number(above=0)
    flows = ("heat_flow",)
    material_properties = Heat

    @ti.func
    def rate(self, constants, particle, flows):
        return flows.heat_flow / (particle.mass * constants.heat_capacity)

    def longest_time_step(self, constants, radius, mass, slope):
        return mass * constants["heat_capacity"] / slope if slope else np.inf


MODELS = [
    ContactModel(law, "Hertz contacts that conduct", pair_properties=properties)
    for law, properties in ((Conducting, ConductancePair), (Heated, HeatedPair))
]
EQUATION = Temperature()


@pytest.fixture(autouse=True)
def registered():
    """Models and equation are registered during each test."""
    for model in MODELS:
        register_contact_model(model)
    register_particle_equation(EQUATION)
    yield
    unregister_particle_equation(EQUATION)
    for model in MODELS:
        unregister_contact_model(model)


FLOOR = {"shape": "plane", "point": [0, 0, -0.99 * RADIUS], "normal": [0, 0, 1], "material": "glass"}
GLASS = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": DENSITY, "heat_capacity": HEAT_CAPACITY}
USUAL = {
    "title": "Conduction",
    "gravity": [0, 0, -9.81],
    "materials": {"glass": GLASS},
    "walls": {"floor": FLOOR},
    "domain": {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error"},
    "run": {"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 1.0},
    "output": {"interval": 1.0},
}


def scene_of(positions, temperatures, chunk_size=1, law="conducting", pair=None, **parts):
    """A scene of spheres above a floor, one group per temperature; the first is fixed.

    The floor touches a sphere at the origin. All these scenes share their kernels, but for chunks and precision.
    """
    groups = {
        f"group_{number}": {
            "material": "glass",
            "diameter": 2.0 * RADIUS,
            "temperature": temperature,
            "fixed": number == 0,
            "insert": {"kind": "positions", "positions": np.atleast_2d(own).tolist()},
        }
        for number, (own, temperature) in enumerate(zip(positions, temperatures, strict=True))
    }
    given = {"restitution": 0.8, "friction": 0.0, "conductance": CONDUCTANCE} | (pair or {})
    return Scene.from_dict(
        USUAL
        | {
            "pairs": {"glass-glass": given},
            "contact": {"normal": law, "tangential": "none", "rolling": "none"},
            "particles": groups,
            "numerics": {"chunk_size": chunk_size, "max_overlap": 0.1},
        }
        | parts
    )


PAIR = [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 2.0 * RADIUS - 1.1e-5]]]
"""A sphere that rests on a fixed one."""


def check_exchange(chunk_size, precision):
    """Two spheres exchange heat until their temperatures are equal.

    T1 - T2 = D exp(-2 h t / (m c)), and T1 + T2 is constant.
    """
    scene = scene_of(PAIR, (HOT, COLD), chunk_size)
    with Simulation(scene, threads=2, precision=precision) as simulation:
        assert (simulation.engine.state.batch is not None) == (chunk_size > 1)
        samples = [simulation.snapshot().particles["temperature"].tolist()]
        for _ in range(8):
            simulation.step(50)
            samples.append(simulation.snapshot().particles["temperature"].tolist())
        particles = simulation.snapshot().particles
    assert particles["heat_flow"][0] == -particles["heat_flow"][1] != 0.0
    temperatures = np.array(samples)
    assert len(set(temperatures.sum(axis=1).tolist())) == 1
    decay = 2.0 * CONDUCTANCE * TIME_STEP / (MASS * HEAT_CAPACITY)
    steps = 50 * np.arange(9)
    explicit = (HOT - COLD) * (1.0 - decay) ** steps
    tolerance = 1e-12 if precision == "f64" else 1e-6
    difference = -np.diff(temperatures, axis=1)[:, 0]
    np.testing.assert_allclose(difference, explicit, rtol=tolerance)
    np.testing.assert_allclose(difference, (HOT - COLD) * np.exp(-decay * steps), rtol=decay)


def bed(chunk_size, **parts):
    """Touching spheres in motion above a floor, in four groups of different temperatures, and a fixed one."""
    positions = 1.99 * RADIUS * np.argwhere(np.ones((4, 4, 4)))
    rng = np.random.default_rng(2)
    groups = [positions[:1], *(positions[1 + k :: 4] for k in range(4))]
    scene = scene_of(groups, (300.0, HOT, COLD, 297.0, 306.0), chunk_size, **parts).to_dict()
    for group in scene["particles"].values():
        count = len(group["insert"]["positions"])
        group["velocity"] = rng.normal(0.0, 0.3, (count, 3)).tolist() if not group["fixed"] else [0, 0, 0]
    return Scene.from_dict(scene)


def state_of(simulation):
    """Lists of all arrays of the particles."""
    return {name: values.tolist() for name, values in simulation.snapshot().particles.items()}


def check_bed(chunk_sizes, precision):
    """A bed that touches the floor conserves its heat, with the same bits for chunks."""
    found = []
    for chunk_size in chunk_sizes:
        with Simulation(bed(chunk_size), threads=2, precision=precision) as simulation:
            before = simulation.snapshot().particles["temperature"].sum()
            simulation.step(300)
            found.append(state_of(simulation))
            flows = simulation.snapshot().particles["heat_flow"]
            assert simulation.snapshot().totals["wall_contact_count"] > 0
    assert all(each == found[0] for each in found[1:])
    assert np.count_nonzero(flows) > 10 and flows.sum() == 0.0
    temperature = np.array(found[0]["temperature"])
    assert temperature.sum() == pytest.approx(before, rel=1e-14 if precision == "f64" else 1e-8)
    assert temperature.std() > 0 and COLD <= temperature.min() and temperature.max() <= HOT


@pytest.mark.parametrize("chunk_size", [1, 16])
def test_two_spheres_exchange_heat_until_their_temperatures_are_equal(chunk_size):
    check_exchange(chunk_size, "f64")


def test_a_bed_has_the_same_bits_for_chunks_and_conserves_its_heat():
    check_bed((1, 16), "f64")


def test_walls_have_the_value_that_the_model_gives_them():
    """With a model that gives them none, the bed above, which touches the floor, conserves its heat."""
    pair = {"bound_share": 1.0, "conductance": CONDUCTANCE}
    scene = scene_of([[[0.5, 0.0, 0.0]], [[0.0, 0.0, 0.0]]], (HOT, HOT), law="heated", pair=pair)
    with Simulation(scene, threads=2) as simulation:
        simulation.step(5)
        found = simulation.snapshot().particles["temperature"][1]
    decay = CONDUCTANCE * TIME_STEP / (MASS * HEAT_CAPACITY)
    assert found == pytest.approx(300.0 + (HOT - 300.0) * (1.0 - decay) ** 5, rel=1e-9)


def test_a_flow_above_its_bound_is_an_error():
    pair = {"bound_share": 1e-9, "conductance": CONDUCTANCE}
    with (
        Simulation(scene_of(PAIR, (HOT, COLD), law="heated", pair=pair), threads=2) as simulation,
        pytest.raises(RunError, match=r"one of the flows to particle 0 .*heat_flow, is not a number or more"),
    ):
        simulation.step(2)


def test_missing_keys_and_a_long_time_step_are_errors():
    scene = scene_of(PAIR, (HOT, COLD)).to_dict()
    del scene["particles"]["group_0"]["temperature"], scene["materials"]["glass"]["heat_capacity"]
    with pytest.raises(SceneError) as error:
        plan_for(Scene.from_dict(scene))
    assert "particles.group_0.temperature is missing" in str(error.value)
    assert "materials.glass.heat_capacity is missing" in str(error.value)
    scene = scene_of(PAIR, (HOT, COLD)).to_dict()
    scene["materials"]["glass"]["heat_capacity"] = 1e-5
    with pytest.raises(SceneError, match=r"up to which the equation of the temperature is stable"):
        plan_for(Scene.from_dict(scene))
    with pytest.raises(SceneError, match=r"run.precision is f32, but the change of temperature in one step"):
        plan_for(scene_of(PAIR, (HOT, COLD)).with_precision("f32"))


def test_a_scene_without_the_model_has_no_sums():
    scene = scene_of(PAIR, (HOT, COLD)).to_dict()
    scene["contact"]["normal"] = "hertz"
    del scene["pairs"]["glass-glass"]["conductance"]
    with pytest.raises(SceneError, match=r"temperature has no effect: no contact model .* flow heat_flow"):
        Scene.from_dict(scene)
    for group in scene["particles"].values():
        del group["temperature"]
    plan = plan_for(Scene.from_dict(scene))
    assert plan.features.flows == plan.laws.flows == plan.scene.equations == ()
    assert not plan.flow_units and all(a != b for a, b in pairwise(plan.laws.names))


def test_a_normal_model_acts_without_the_values_of_its_properties():
    """A conductance of 0: the force is that of Hertz, the temperatures stay."""
    with Simulation(scene_of(PAIR, (HOT, COLD), pair={"conductance": 0.0}), threads=2) as simulation:
        simulation.step(10)
        particles = simulation.snapshot().particles
    assert particles["temperature"].tolist() == [HOT, COLD]
    assert particles["coordination_number"].tolist() == [1, 1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "count"}, "particle equation count: a key of particle groups has this name"),
        ({"name": "heat", "flows": "heat_flow"}, "flows is 'heat_flow', but must be a tuple of names"),
        ({}, "particle equation temperature: an equation of this name exists"),
    ],
)
def test_an_equation_that_is_not_valid_is_refused(changes, message):
    with pytest.raises(GranflowError, match=message):
        register_particle_equation(type("Other", (Temperature,), changes)())


def test_heat_is_exchanged_and_conserved_in_mixed_precision():
    """The last test of this file, because another precision restarts Taichi, which loses all compiled kernels."""
    check_exchange(16, "mixed")
    check_bed((16,), "mixed")
