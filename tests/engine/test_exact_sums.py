"""Exact sums of forces: rounding to a grid, totals of two words, range."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, run_to_end

from granflow.engine.sums import CARRY_BITS, build_to_grid, exact_sum, exact_totals
from granflow.errors import RunError
from granflow.kernel_language import ti
from granflow.plan import sum_units
from granflow.plan.build import plan_for


@pytest.mark.parametrize(("name", "bits"), [("f32", 45), ("f64", 50)])
def test_rounding_to_the_grid_is_odd_and_exact_in_half_units(taichi_f64, name, bits):
    """Numbers up to 2^bits units: of the two precisions, the one with the larger eps needs all branches."""
    numpy_type = getattr(np, name.replace("f", "float"))
    real = getattr(ti, name)
    unit = 2.0**-40
    to_grid = build_to_grid(real)
    external = ti.types.ndarray()

    @ti.kernel
    def round_all(values: external, rounded: external, by: real):
        for k in values:
            rounded[k] = to_grid(values[k], by)

    rng = np.random.default_rng(3)
    positive = unit * rng.uniform(1.0, 2.0, 20_000) * 2.0 ** rng.uniform(-5.0, bits - 1.0, 20_000)
    positive = positive.astype(numpy_type)
    rounded = np.zeros(40_000, numpy_type)
    round_all(np.concatenate([positive, -positive]), rounded, 1.5 * unit / np.finfo(numpy_type).eps)
    up, down = np.split(rounded.astype(float) / unit, 2)
    np.testing.assert_array_equal(down, -up)
    np.testing.assert_array_equal(2.0 * up, np.rint(2.0 * up))
    assert np.abs(up - positive.astype(float) / unit).max() <= 0.5


def test_sums_on_the_host_are_exact_in_any_order():
    rng = np.random.default_rng(1)
    values = rng.normal(size=1000) * 10.0 ** rng.integers(-6, 3, 1000)
    total = exact_sum(values)
    assert total == pytest.approx(values.sum(), rel=1e-13)
    assert all(exact_sum(rng.permutation(values)) == total for _ in range(20))
    assert exact_sum(np.zeros(0)) == 0.0
    low, high = np.array([[3, -5], [2**41, 7]]), np.array([[2**30, 0], [1, -(2**20)]])
    totals = exact_totals(np.concatenate([low, high], axis=1), 0.25)
    expected = [3 + 2**41 + (2**30 + 1) * 2**CARRY_BITS, 2 - 2**20 * 2**CARRY_BITS]
    assert totals.tolist() == [float(each) * 0.25 for each in expected]


def test_forces_above_the_range_of_the_sums_abort_the_run_but_not_a_large_weight(taichi_f64, monkeypatch):
    """A sphere of 10 cm weighs 13 N; the largest force of a contact with one of 0.1 mm is below 10 mN.

    Sums are exact up to 2^50 units. With 2^80 instead of FORCE_BITS, that is 1e-9 of the largest force. The first
    small sphere reaches the large one after 10 us.
    """

    def scene(duration, gravity):
        small = particle_group([[0, 0, 0.05006], [0, 0, 0.3]], 1e-4, velocity=[[0, 0, -1.0], [0, 0, 0]])
        groups = {"small": small, "large": particle_group([[0.0, 0.0, 0.0]], 0.1)}
        run = {"duration": duration, "velocity_max": 1.0}
        domain = {
            "min": [-1.0] * 3,
            "max": [1.0] * 3,
            "on_exit": "expand",
        }  # the structure of `test_neighbor_list`
        return build_scene(groups, gravity=[0.0, 0.0, gravity], run=run, domain=domain)

    falling = scene(2e-6, -9.81)
    assert plan_for(falling).sum_units.largest_force > 30.0 * 13.0
    last, _ = run_to_end(falling)
    expected = np.array([-1.0, 0.0, 0.0]) - 9.81 * last.time
    np.testing.assert_allclose(last.particles["velocity"][:, 2], expected, rtol=1e-12)
    monkeypatch.setattr(sum_units, "FORCE_BITS", 80)
    with pytest.raises(RunError, match=r"the contact force on particle \d \(glass, .* is above .* N"):
        run_to_end(scene(1e-4, 0.0))
