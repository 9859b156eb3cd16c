"""`granflow explain` lists each derived value with its source."""

from pathlib import Path

from plan.scenes import scene_of
from subprocess_runner import each_in_subprocess

from granflow.plan.build import plan_for
from granflow.plan.cost import estimate_memory
from granflow.plan.explain import duration, explain, size


def test_derived_numbers_features_and_settings_are_listed_with_their_source(tmp_path):
    """The Rayleigh time of 10 MPa, 0.23, 2500 kg/m3 and 2 mm is pi R sqrt(rho / G) / 0.9141 = 0.1705 ms; 50 ms
    have 1112 steps of 45 us."""
    plan = plan_for(scene_of(tmp_path, "numerics.skin=0.5 mm", "run.time_step=4.5e-5"))
    rows = {line.strip().split("  ")[0]: line for line in explain(plan).splitlines()}
    memory = estimate_memory(plan, "f64")
    for name, *texts in (
        ("time step", "4.5e-05 s", "given in the scene"),
        ("stability limit", f"{plan.step.stable_below:.4g} s", "beads-beads"),
        ("Rayleigh time", "0.0001705 s"),
        ("impact velocity", "1 m/s", "run.velocity_max"),
        ("smallest restitution", f"{plan.step.least_restitution:.3g}"),
        ("skin", "0.0005 m"),
        ("radius", "0.002 m"),
        ("materials", "glass; not used: steel"),
        ("steps", "1 112"),
        ("run time", "about 1 s", "5 million particle-steps per second"),
        ("one contact", size(memory.per_neighbor), "maximum overlap, restitution coefficient"),
        ("total", size(memory.total)),
        ("friction", "off", "every pair has friction 0"),
        ("rotation", "off"),
        ("walls", "on", "floor"),
        ("moving walls", "off", "no wall has a motion"),
        ("one particle size", "on", "all particles have the diameter 0.004 m"),
        ("one particle material", "on"),
        ("viscous normal force", "off"),
        ("energy budget", "off"),
        ("numerics.chunk_size", "auto", "default"),
        ("materials.steel.density", "8030 kg/m3", "preset stainless_316"),
        ("contact.normal.restitution_at", "the restitution of every pair is a number"),
        ("output.timeseries_interval", "default: output.interval"),
        ("numerics.skin", "given (--set numerics.skin"),
    ):
        assert not [text for text in texts if text not in rows[name]], rows[name]
    assert "materials.glass.density" not in rows, "required settings are not listed"


def allocated(directory, overrides, precision):
    """Bytes of all fields of a State that scale with the scene, and the estimate of the plan."""
    import numpy as np

    from granflow.engine.state import State
    from granflow.engine.state_cache import start
    from granflow.plan.arrays import sum_arrays

    plan = plan_for(scene_of(Path(directory), *overrides))
    state = State(plan, start("cpu", precision, 1))
    groups = (state.particles, state.neighbors, state.cell_sort)
    fields = [field for group in groups for field in vars(group).values()]
    fields += [*state.neighbors.history.values(), *state.neighbors.saved.values()]
    fields += [getattr(state.control, array.name) for array in sum_arrays(plan)]
    arrays = [np.asarray(field.to_numpy()) for field in fields if hasattr(field, "to_numpy")]
    return sum(array.nbytes for array in arrays), estimate_memory(plan, precision).total


def test_memory_estimate_equals_the_allocated_memory(tmp_path):
    """One process for both precisions, each of which restarts Taichi."""
    many = ("particles.beads.count=3000", "particles.beads.diameter=0.5 mm")
    friction = (*many, "pairs.glass-glass.friction=0.4")
    calls = [(str(tmp_path), friction, "mixed"), (str(tmp_path), (*many, "contact.normal=hertz"), "f32")]
    for allocated_bytes, estimate in each_in_subprocess(allocated, calls):
        assert estimate == allocated_bytes


def test_duration_is_rounded_to_a_readable_unit():
    found = [duration(seconds) for seconds in (0.2, 59, 600, 7.3e3, 1e6)]
    assert found == ["1 s", "59 s", "10 minutes", "2 hours", "12 days"]
