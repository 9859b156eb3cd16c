"""Snapshots and outputs do not change a run. In a sheared box: `test_lees_edwards`."""

import numpy as np
import pytest
from resume.runs import complex_scene, files_of, last_state
from scene_builders import box, build_scene, moving_lattice

from granflow.observers.observer import on_interval
from granflow.simulation import Simulation


def run(scene, out, take):
    """Files, last checkpoint and warnings of a run; `take` is called with the simulation every 0.5 ms."""
    observer = on_interval(5e-4, lambda snapshot: take(simulation), {"walls"})
    simulation = Simulation(scene, out=out, observers=[observer])
    simulation.run()
    simulation.free()
    return files_of(out), last_state(out), simulation.engine.stability_monitor.warnings


def host_state(engine):
    """Largest energy input, and the state of the stability monitor."""
    monitor = vars(engine.stability_monitor)
    return engine.accounting.energy_put_in, monitor | {"warnings": dict(monitor["warnings"])}


def assert_equal(first, second):
    """All arrays and numbers of two snapshots are the same."""
    for part in ("particles", "contacts", "impulses"):
        assert getattr(first, part).keys() == getattr(second, part).keys()
        for name, values in getattr(first, part).items():
            np.testing.assert_array_equal(values, getattr(second, part)[name], err_msg=f"{part}.{name}")
    assert first.totals == second.totals


@pytest.mark.slow
def test_run_with_additional_snapshots_is_bit_identical(taichi_f64, tmp_path):
    scene = complex_scene(0.012)
    snapshots = []

    def twice(simulation):
        before = host_state(simulation.engine)
        snapshots[:] = [simulation.snapshot(contacts=True) for _ in range(2)]
        assert host_state(simulation.engine) == before
        assert_equal(*snapshots)

    without = run(scene, tmp_path / "without", lambda simulation: None)
    assert run(scene, tmp_path / "with", twice) == without
    assert snapshots


def test_outputs_do_not_change_the_motion(taichi_f64):
    """Energy budget, wall forces, collision energies and snapshots are extras; without them, no arrays exist."""
    lattice = moving_lattice((6, 6, 3), largest=0.006, speed=0.5)
    parts = {"walls": box(0.042), "pair": {"friction": 0.4, "restitution": 0.7}, "gravity": [0.0, 0.0, -9.81]}
    parts |= {"run": {"duration": 4e-3, "velocity_max": 4.0}, "numerics": {"chunk_size": 16}}
    outputs = {
        "none": {"interval": 1.0},
        "all": {
            "interval": 1e-3, "energy_budget": True, "wall_forces": True,
            "collision_energies": {"min": 1e-9, "max": 1e-2, "classes": 14},
        },
    }  # fmt: skip
    ends = {}
    for name, output in outputs.items():
        for times in (0, 2):
            with Simulation(build_scene({"gas": lattice}, output=output, **parts)) as simulation:
                for _ in range(4):
                    simulation.run(simulation.time + 1e-3)
                    for _ in range(times):
                        simulation.snapshot(contacts=True)
                ends[name, times] = simulation.snapshot(contacts=True)
                assert (simulation.engine.state.control.impulses is None) == (name == "none")
                assert simulation.engine.stability_monitor.warnings == {}
    plain, full = ends["none", 0], ends["all", 0]
    for name in outputs:
        assert_equal(ends[name, 0], ends[name, 2])
    assert plain.impulses == plain.collisions == {} and "energy_error" not in plain.totals
    assert full.collisions["particle"].sum() > 10 and abs(full.totals["energy_error"]) < 1e-3
    for name, values in plain.particles.items():
        np.testing.assert_array_equal(values, full.particles[name], err_msg=name)
