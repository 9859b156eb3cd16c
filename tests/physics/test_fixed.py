"""Fixed particles: zero velocity, contacts like those with a wall of their shape, energy budget and time
step."""

from math import pi, sqrt

import numpy as np
import pytest
from scene_builders import SOFT, box, build_scene, column, particle_group, run_and_sample, run_to_end

from granflow.plan.build import plan_for

RADIUS, FIXED_RADIUS, SPEED = 0.005, 0.008, 0.7
MASS = 4.0 / 3.0 * pi * RADIUS**3 * SOFT["density"]
HERTZ = 4.0 / 3.0 * SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
"""4/3 E* [Pa]: the Hertz stiffness without the square root of the effective radius."""


def head_on(**parts):
    """A particle hits a fixed particle of another size, which overlaps a second fixed particle behind it."""
    mobile = particle_group([[RADIUS + FIXED_RADIUS + 1e-4, 0, 0]], 2 * RADIUS, velocity=[[-SPEED, 0, 0]])
    rough = particle_group([[0, 0, 0], [-0.003, 0, 0]], 2 * FIXED_RADIUS) | {"fixed": True}
    return build_scene({"mobile": mobile, "rough": rough}, **parts)


def test_fixed_particle_acts_as_an_infinite_mass(taichi_f64):
    """Elastic impact: m v^2 / 2 = 2/5 k d^2.5 with the mass m of the mobile particle and 1/R = 1/R1 +
    1/R2."""
    k = HERTZ * sqrt(RADIUS * FIXED_RADIUS / (RADIUS + FIXED_RADIUS))
    overlap_max = (5.0 * MASS * SPEED**2 / (4.0 * k)) ** 0.4
    scene = head_on(
        pair={"restitution": 1.0}, run={"duration": 2e-3, "time_step": 1e-6, "velocity_max": 1.0},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 1e-6)
    position = column(snapshots, "position")
    velocity = column(snapshots, "velocity")
    overlap = RADIUS + FIXED_RADIUS - position[:, 0, 0]
    assert overlap.max() == pytest.approx(overlap_max, rel=1e-4)
    assert velocity[-1, 0, 0] == pytest.approx(SPEED, rel=1e-6)
    assert np.all(position[:, 1:] == position[0, 1:]) and not velocity[:, 1:].any()
    assert snapshots[0].totals["contact_count"] == 0.0, "overlapping fixed particles form no contact"
    assert snapshots[0].totals["kinetic_energy"] == pytest.approx(0.5 * MASS * SPEED**2)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-4
    assert snapshots[0].particles["fixed"].tolist() == [0, 1, 1]


def test_pair_cases_of_fixed_particles_use_the_mobile_mass():
    """The time step uses the mass of the mobile particle and both radii; fixed particles form no pair
    case."""
    scene = head_on()
    pair_cases = {pair.name: pair for pair in plan_for(scene).pair_cases}
    assert list(pair_cases) == ["mobile-mobile", "mobile-rough"]
    found = pair_cases["mobile-rough"]
    assert found.mass_eff == pytest.approx(MASS)
    assert found.radius_eff == pytest.approx(RADIUS * FIXED_RADIUS / (RADIUS + FIXED_RADIUS))
    reversed_order = build_scene(
        {name: head_on().particles[name].model_dump() for name in ("rough", "mobile")}
    )
    assert {pair.mass_eff for pair in plan_for(reversed_order).pair_cases} == {
        each.mass_eff for each in pair_cases.values()
    }
    assert plan_for(scene).features.fixed_particles


def rough_floor(**parts):
    """Rotating particles fall onto a floor of overlapping fixed particles that extends through the walls of a
    box."""
    rng = np.random.default_rng(2)
    positions = 0.0065 * (np.argwhere(np.ones((6, 6, 3))) + [0.75, 0.75, 1.5])
    rain = particle_group(
        positions,
        rng.uniform(0.004, 0.006, len(positions)),
        angular_velocity=rng.normal(0.0, 50.0, positions.shape),
    )
    floor = 0.004 * np.argwhere(np.ones((12, 12, 1))) + [-0.001, -0.001, 0.0]
    pair = {"friction": 0.5, "rolling_friction": 0.1, "restitution": 0.6}
    given = {
        "walls": {name: wall for name, wall in box(0.042).items() if name != "low_z"}, "pair": pair, "rolling": "epsd",
        "gravity": [0.0, 0.0, -9.81], "run": {"duration": 0.1, "velocity_max": 1.0, "time_step": 5e-6},
        "output": {"interval": 1.0, "energy_budget": True}, "numerics": {"chunk_size": 64},
    }  # fmt: skip
    return build_scene(
        {"rain": rain, "floor": particle_group(floor, 0.006) | {"fixed": True}}, **(given | parts)
    )


def test_rough_floor_carries_particles_and_the_energy_budget_closes(taichi_f64):
    """Chunk sizes 64 and 1 agree within rounding at first; later impacts amplify the difference."""
    first, early, *_, last = run_and_sample(rough_floor(), 0.02)
    rough = first.particles["fixed"] == 1
    assert rough.sum() == 144
    assert np.all(last.particles["position"][rough] == first.particles["position"][rough])
    assert not last.particles["velocity"][rough].any() and not last.particles["angular_velocity"][rough].any()
    assert last.totals["particle_count"] == 252.0 and last.particles["position"][~rough, 2].min() > 0.0
    assert last.totals["contact_count"] > 50.0
    assert last.totals["friction_dissipation"] > 0.0 and last.totals["rolling_dissipation"] > 0.0
    assert abs(last.totals["energy_error"]) < 2e-3
    weight = last.particles["mass"][~rough] @ -(last.particles["position"][~rough] @ [0.0, 0.0, -9.81])
    assert last.totals["gravitational_energy"] == pytest.approx(weight)
    mean = last.particles["coordination_number"][~rough].mean()
    assert last.totals["coordination_number"] == pytest.approx(mean)
    unchunked, _ = run_to_end(rough_floor(numerics={"chunk_size": 1}), 0.02)
    np.testing.assert_allclose(
        unchunked.particles["position"], early.particles["position"], rtol=0.0, atol=1e-9
    )
