"""The adaptive time step: equal to the planned step at the present velocity, exact in free flight,
bit-identical."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane, run_to_end

from granflow.contact import theory
from granflow.plan.time_step import LEVELS_PER_DOUBLING, VELOCITY_MARGIN, choose_time_step
from granflow.scene.blocks.run import Numerics
from granflow.simulation import Simulation

RADIUS = 0.005
ADAPTIVE = {"duration": 0.01, "velocity_max": 4.0, "time_step": "adaptive"}


def pair_at(gap, velocity):
    """Two particles with a gap [m] that closes at `velocity` [m/s]; the planned velocity is 4 m/s."""
    sides = np.array([[-0.5], [0.5]]) * [1.0, 0.0, 0.0]
    group = particle_group((2.0 * RADIUS + gap) * sides, 2.0 * RADIUS, velocity=-velocity * sides)
    return build_scene({"balls": group}, run=ADAPTIVE)


def wall_at(gap, velocity):
    """As `pair_at`: a particle, and a wall that moves toward it twice as fast as the particle toward the wall."""
    motion = {"kind": "translation", "velocity": [-2.0 / 3.0 * velocity, 0.0, 0.0]}
    wall = plane([RADIUS + gap, 0.0, 0.0], [-1.0, 0.0, 0.0], motion=motion)
    group = particle_group([0.0] * 3, 2.0 * RADIUS, velocity=[velocity / 3.0, 0.0, 0.0])
    return build_scene({"balls": group}, {"wall": wall}, run=ADAPTIVE)


def adapted_step(scene, until=1e-9):
    with Simulation(scene) as simulation:
        simulation.run(until=until)
        return simulation.engine.time_step, simulation.plan


def planned_step(plan, velocity):
    numerics = Numerics()
    bounds = (numerics.time_step_fraction, numerics.rayleigh_fraction)
    return choose_time_step(None, plan.pair_cases, plan.laws.normal, velocity, *bounds).value


@pytest.mark.parametrize(
    ("scene_at", "velocity", "time"), [(pair_at, 0.05, 1e-6), (wall_at, 3.0, 6e-4), (wall_at, 3.0, 0.0)]
)
def test_step_equals_the_planned_step_for_the_present_velocity(taichi_f64, scene_at, velocity, time):
    """Within one level of the table, at the present velocity times the margin, shortly before the contact; also
    at the start, when walls begin to move."""
    step, plan = adapted_step(scene_at(velocity * time + 1e-5, velocity), time)
    fastest = VELOCITY_MARGIN * velocity
    lower = planned_step(plan, fastest * 2.0 ** (1.0 / LEVELS_PER_DOUBLING))
    assert lower <= step <= planned_step(plan, fastest)


def test_overlap_counts_as_the_impact_velocity_that_causes_it(taichi_f64):
    """At rest at the maximum overlap of an impact at 1 m/s (Zhou 2011, Eq. 5), the step equals that for 1
    m/s."""
    mass = 4.0 / 3.0 * np.pi * RADIUS**3 * SOFT["density"]
    k = theory.hertz_stiffness(
        SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2)), 0.5 * RADIUS
    )
    overlapping, _ = adapted_step(pair_at(-float(theory.overlap_max(k, 0.5 * mass, 1.001)), 0.0))
    approaching, _ = adapted_step(pair_at(1e-5, 1.001))
    assert overlapping == approaching


def test_step_grows_in_free_flight_and_the_parabola_stays_exact(taichi_f64):
    """The leapfrog is exact for a constant acceleration, also where the step changes."""
    start = np.array([0.0, 0.0, 0.4])
    throw = np.array([0.3, 0.0, 2.0])
    gravity = np.array([0.5, 0.0, -9.81])
    group = particle_group([start], 2.0 * RADIUS, velocity=throw)
    scene = build_scene(
        {"ball": group}, gravity=gravity.tolist(), run=ADAPTIVE | {"duration": 0.1},
    )  # fmt: skip
    last, simulation = run_to_end(scene)
    engine = simulation.engine
    assert engine.time_step > 1.2 * simulation.plan.time_step
    assert engine.mean_time_step == pytest.approx(last.time / engine.step_count)
    expected = start + throw * last.time + 0.5 * gravity * last.time**2
    np.testing.assert_allclose(last.particles["position"][0], expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        last.particles["velocity"][0], throw + gravity * last.time, rtol=0.0, atol=1e-11
    )


def test_collisions_with_a_changing_step_reach_their_restitution(taichi_f64):
    """A slow collision follows a fast one: the step grows in between, and both pairs rebound with e = 0.8."""
    positions = [[-2.0 * RADIUS, 0.02 * side, 0] for side in (0, 1)] + [
        [1e-5, 0.02 * side, 0] for side in (0, 1)
    ]
    velocity = [[3.0, 0, 0], [0.02, 0, 0], [0, 0, 0], [0, 0, 0]]
    scene = build_scene(
        {"balls": particle_group(positions, 2.0 * RADIUS, velocity=velocity)}, run=ADAPTIVE | {"duration": 0.004},
    )  # fmt: skip
    last, simulation = run_to_end(scene)
    assert simulation.engine.time_step > 1.5 * simulation.plan.time_step
    separation_velocity = last.particles["velocity"][2:, 0] - last.particles["velocity"][:2, 0]
    np.testing.assert_allclose(separation_velocity / [3.0, 0.02], 0.8, rtol=1e-3)
