"""Equal spheres of one material: radius and mass are two numbers of the plan (feature `one_size`)."""

import numpy as np
import pytest
from scene_builders import box, build_scene, moving_lattice, particle_group, run_to_end

from granflow.plan import features
from granflow.plan.build import plan_for


def gas(counts, normal, precision="f64"):
    """Equal spheres with random velocities in a box."""
    group = moving_lattice(counts, 0.004, 1.0)
    walls = box(0.0065 * (np.array(counts) + 0.5))
    return build_scene(
        {"gas": group | {"diameter": 0.006}},
        walls,
        pair={"friction": 0.3},
        normal=normal,
        run={"duration": 0.004, "precision": precision},
        output={"interval": 0.004, "energy_budget": True},
    )


@pytest.mark.parametrize(("counts", "normal", "precision"), [
    ((5, 5, 4), "zhou", "f64"),  # batches
    ((5, 5, 4), "hertz", "mixed"),  # batches with sums apart from the forces
    ((4, 3, 3), "zhou", "f64"),  # one contact at a time
])  # fmt: skip
def test_the_two_numbers_give_the_bits_of_the_arrays(counts, normal, precision, monkeypatch):
    scene = gas(counts, normal, precision)
    assert plan_for(scene).features.one_size
    with_numbers, simulation = run_to_end(scene)
    monkeypatch.setattr(features, "_one_size", lambda *_: (False, "switched off"))
    with_arrays, other = run_to_end(scene)
    assert simulation.plan.features.one_size and not other.plan.features.one_size
    assert with_numbers.totals["friction_dissipation"] > 0.0
    for name, values in with_arrays.particles.items():
        np.testing.assert_array_equal(with_numbers.particles[name], values, err_msg=name)
    assert with_numbers.totals == with_arrays.totals


def test_unequal_or_fixed_particles_have_arrays():
    places = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]
    pair = particle_group(places)
    single = particle_group([[0.04, 0.0, 0.0]])

    def setting(groups):
        return plan_for(build_scene(groups)).features.one_size

    assert setting({"pair": pair, "single": single})
    assert not setting({"pair": pair, "single": single | {"material": "steel"}})
    assert not setting({"pair": pair, "single": single | {"diameter": [0.011]}})
    assert not setting({"pair": pair | {"diameter": [0.01, 0.0100001]}})
    assert not setting({"pair": pair, "single": single | {"fixed": True}})
