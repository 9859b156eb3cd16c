"""Aborts by an overlap name their cause, and a run that follows the advice passes."""

import re

import pytest
from scene_builders import build_scene, particle_group, plane

from granflow.engine.abort import Body, ContactPair, overlap_cause
from granflow.errors import RunError
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

UNITS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
DIAMETER, WIDTH = 0.004, 0.016
CORNER = {"floor": plane([0, 0, 0], [0, 0, 1]), "far": plane([-0.9, 0, 0], [1, 0, 0])}
"""Scenes with contact models for hertz have one compiled structure, that of `bed`."""


def soft(modulus):
    return {"glass": {"young_modulus": modulus, "poisson_ratio": 0.25, "density": 2500.0}}


def impact(modulus, velocity_max=2.0, **more):
    """A sphere hits a floor at 2 m/s."""
    ball = particle_group([[0.0, 0.0, 0.0051]], velocity=[0.0, 0.0, -2.0])
    return build_scene(
        {"ball": ball}, walls=CORNER, materials=soft(modulus), pair={"friction": 0.3}, numerics={"chunk_size": 16, "max_overlap": 0.1},
        normal="hertz", run={"duration": 0.02, "velocity_max": velocity_max}, **more,
    )  # fmt: skip


def bed(modulus, count=120, walls=None, contact=None, duration=0.3, height=0.095, max_overlap=0.1, **pair):
    """Spheres fall from a random packing into a square container and come to rest."""
    sides = {
        "floor": plane([0, 0, 0], [0, 0, 1]),
        "left": plane([0, 0, 0], [1, 0, 0]), "right": plane([WIDTH, 0, 0], [-1, 0, 0]),
        "front": plane([0, 0, 0], [0, 1, 0]), "back": plane([0, WIDTH, 0], [0, -1, 0]),
    }  # fmt: skip
    region = {"box": {"min": [0.0] * 3, "max": [WIDTH, WIDTH, height]}}
    group = {
        "material": "glass",
        "count": count,
        "diameter": DIAMETER,
        "insert": {"kind": "pack", "region": region},
    }
    usual = {"normal": "hertz", "tangential": "mindlin", "rolling": "none"}
    return build_scene(
        {"beads": group}, walls=sides | (walls or {}), materials=soft(modulus), gravity=[0.0, 0.0, -9.81],
        contact=usual | (contact or {}), pair={"restitution": 0.3, "friction": 0.3} | pair,
        domain={"min": [-0.001] * 3, "max": [WIDTH + 0.001, WIDTH + 0.001, 0.11], "on_exit": "delete"},
        run={"duration": duration, "velocity_max": 0.7},
        numerics={"time_step_fraction": 0.2, "max_overlap": max_overlap, "chunk_size": 16},
    )  # fmt: skip


def tower(modulus):
    """40 spheres on top of each other, without overlap at the start: the lowest contact carries the weight of
    all."""
    spheres = particle_group([[0.0, 0.0, (k + 0.5) * DIAMETER] for k in range(40)], DIAMETER)
    return build_scene(
        {"tower": spheres}, walls=CORNER, materials=soft(modulus), normal="hertz", gravity=[0.0, 0.0, -9.81],
        pair={"restitution": 0.3, "friction": 0.3}, numerics={"chunk_size": 16, "max_overlap": 0.1},
        run={"duration": 0.4, "velocity_max": 0.5},
    )  # fmt: skip


def under_lid(modulus):
    """A servo wall presses a bed that is almost at rest with 20 kPa; its weight is 0.1 kPa."""
    shape = {"shape": "rectangle", "corner": [0, 0, 0.036], "sides": [[WIDTH, 0, 0], [0, WIDTH, 0]]}
    motion = {"kind": "servo", "direction": [0, 0, -1], "pressure": 2e4, "velocity_max": 0.1}
    return bed(
        modulus, count=100, walls={"lid": shape | {"material": "glass", "motion": motion}}, height=0.034
    )


def cohesive(modulus):
    """Attraction and repulsion of particles balance at an overlap of half of (3 pi w / (2 E*))^2, 0.13 for 1
    MPa."""
    return bed(modulus, count=40, contact={"cohesion": "sjkr"}, height=0.05, cohesion_energy_density=4.1e4)


def aborted(scene):
    """Message of a run that aborts."""
    simulation = Simulation(scene)
    with pytest.raises(RunError) as stopped:
        simulation.run()
    simulation.free()
    return str(stopped.value)


def advised_modulus(message):
    value, unit = re.search(r"materials\.glass\.young_modulus to ([\d.e+]+) (\w+)", message).groups()
    return float(value) * UNITS[unit]


CASES = {
    "impact": (impact, 1e6, "results from an impact at"),
    "weight": (tower, 1e4, "a static load, such as the weight"),
    "servo": (under_lid, 3e5, "the static pressure of walls.lid"),
    "cohesion": (cohesive, 1e6, "Its cause is cohesion"),
}


@pytest.mark.parametrize(
    "case",
    ["impact", "weight", *(pytest.param(each, marks=pytest.mark.slow) for each in ("servo", "cohesion"))],
)
def test_abort_names_its_cause_and_a_run_with_the_advised_modulus_passes(taichi_f64, case):
    build, modulus, cause = CASES[case]
    message = aborted(build(modulus))
    assert cause in message, message
    advised = advised_modulus(message)
    assert modulus < advised < 1e4 * modulus
    simulation = Simulation(build(advised))
    simulation.run()
    assert 0.0 < simulation.snapshot().totals["overlap_largest"] < 0.1 or case == "impact"
    simulation.free()


@pytest.mark.slow
def test_contact_with_a_soft_spring_of_its_onset_advises_the_same_stiffness_for_all(taichi_f64):
    """With Eq. 19 at the planned velocity, the spring is 6.3 = (1/0.01)^(2/5) times as stiff as the
    softest."""
    onset = {"normal": {"law": "linear", "stiffness": "onset"}}
    message = aborted(bed(2e6, contact=onset))
    assert "because a contact that begins slowly gets a soft spring" in message
    velocity = float(re.search(r"stiffness to {reference_velocity: ([\d.]+) m/s}", message).group(1))
    simulation = Simulation(
        bed(2e6, contact={"normal": {"law": "linear", "stiffness": {"reference_velocity": velocity}}})
    )
    simulation.run()
    assert simulation.snapshot().totals["overlap_largest"] < 0.1
    simulation.free()


def test_impact_above_the_planned_velocity_advises_modulus_and_velocity(taichi_f64):
    """A higher velocity_max alone shortens the time step, but the overlap stays the same."""
    message = aborted(impact(1e6, velocity_max=0.5))
    velocity = float(re.search(r"set run.velocity_max to ([\d.]+) m/s", message).group(1))
    assert 2.0 < velocity < 2.6
    aborted(impact(1e6, velocity_max=velocity))
    simulation = Simulation(impact(advised_modulus(message), velocity_max=velocity))
    simulation.run()
    simulation.free()


@pytest.mark.parametrize(
    ("weight", "cause"),
    [(10.0, "other particles or a moving wall press on it"), (1e4, "a static load, such as")],
)
def test_weight_that_explains_less_than_half_of_the_overlap_is_not_named(weight, cause):
    """A contact almost at rest in a drum while particles land on the bed: 0.1 m/s of 1.1 m/s at an overlap of
    0.11.

    Under 10 Pa, spheres of 4 mm and 1 MPa overlap by 0.01 of the radius, under 10 kPa by more than 0.1.
    """
    plan = plan_for(bed(1e6))
    first = Body("particle 1", "glass", (0.0, 0.0, 0.1), (0.0, 0.0, 0.01))
    second = Body("particle 2", "glass", (0.0, 0.0, 0.0), (0.0, 0.0, 0.014))
    pair = ContactPair(first, second, 0.11, 0.1, 1.1, 1e-5, plan.pair_cases[0], weight)
    message = overlap_cause(pair, plan)
    assert message.startswith("The contact is almost at rest: ") and cause in message, message
    assert advised_modulus(message) > 1e6
    if weight == 10.0:
        explained = float(re.search(r"explain only an overlap of ([\d.]+) of the radius", message).group(1))
        assert 0.001 < explained < 0.055
