"""Snapshots do not change a run: none, one or two give the same bits afterwards."""

import numpy as np
import pytest
from resume.runs import complex_scene, files_of, last_state
from sheared_scenes import sheared_gas

from granflow.observers.observer import on_interval
from granflow.simulation import Simulation

ALL = frozenset({"particles", "contacts", "walls", "totals"})


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


@pytest.mark.parametrize("energy_budget", [True, False])
def test_run_with_additional_snapshots_is_bit_identical(taichi_f64, tmp_path, energy_budget):
    output = {
        "interval": 4e-3,
        "timeseries_interval": 1e-3,
        "energy_budget": energy_budget,
        "wall_forces": True,
    }
    scene = complex_scene(0.012, output=output)
    snapshots = []

    def twice(simulation):
        before = host_state(simulation.engine)
        snapshots[:] = [simulation.snapshot(contacts=True) for _ in range(2)]
        assert host_state(simulation.engine) == before
        assert_equal(*snapshots)

    without = run(scene, tmp_path / "without", lambda simulation: None)
    assert run(scene, tmp_path / "with", twice) == without
    assert snapshots


def test_sheared_run_with_additional_snapshots_is_bit_identical(taichi_f64, tmp_path):
    ends = []
    for times in (0, 2):
        simulation = Simulation(sheared_gas())
        for _ in range(8):
            simulation.run(simulation.time + 1e-3)
            for _ in range(times):
                simulation.engine.snapshot("", ALL)
        ends.append(simulation.snapshot(contacts=True))
        simulation.free()
    assert_equal(*ends)
