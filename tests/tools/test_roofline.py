"""Roofline estimate of a GPU: memory traffic counted by hand, and the smaller of two limits."""

import pytest
from benchmark.roofline import GPUS, bytes_per_particle_step, particle_steps_per_second
from scene_builders import build_scene, particle_group

from granflow.plan.build import plan_for
from granflow.plan.cost import estimate_memory


def gas_plan(**pair):
    """Plan of elastic frictionless particles without rotation, material and history."""
    pair = {"restitution": 1.0, "friction": 0.0} | pair
    return plan_for(
        build_scene({"balls": particle_group([[0, 0, 0], [0.02, 0, 0]])}, normal="hertz", pair=pair), True
    )


def test_traffic_of_elastic_spheres_is_that_counted_by_hand():
    """In f64: x, v, F, x at rebuild, reach, m, R read, x, v written; x, v, m, R read, F written; 3 + 9 x 2
    integers.

    A rebuild every 50 steps: all fields four times, 8 integers, 9 x 4 and 6 x 4 integers.
    """
    plan = gas_plan()
    integration = 24 * 4 + 8 * 3 + 24 * 2
    forces = 24 * 2 + 8 * 2 + 24
    lists = 4 * (3 + 9 * 2)
    rebuild_lists = 4 * (8 + 9 * 4 + 6 * 4)
    all_fields = estimate_memory(plan, "f64").per_particle - 4 * 4  # without list ranges and order
    expected = integration + forces + lists + (4 * all_fields + rebuild_lists) / 50
    assert bytes_per_particle_step(plan, "f64") == pytest.approx(expected)


def test_rate_is_limited_by_memory_or_arithmetic():
    plan, (_, _, gaming, _) = gas_plan(friction=0.5), GPUS
    assert particle_steps_per_second(plan, "f32", gaming) == gaming.bandwidth / bytes_per_particle_step(
        plan, "f32"
    )
    assert particle_steps_per_second(plan, "f64", gaming) < gaming.bandwidth / bytes_per_particle_step(
        plan, "f64"
    )
