"""Runs in parts: steps, times, durations, and the files of a simulation in a with block."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from api.scenes import beads
from scene_builders import plane

import granflow as gf
from granflow.particles.insertion import initial_particles

OUTPUT = {"interval": 1e-3, "timeseries_interval": 5e-4, "energy_budget": True}


def falling(**more):
    """Two particles above a floor, one of which hits it within 2 ms."""
    parts = {"gravity": [0.0] * 3, "run": {"duration": 2e-3, "velocity_max": 1.0}, "output": OUTPUT}
    return beads([[0.0, 0.0, 0.0055], [0.02, 0.0, 0.02]], [0.0, 0.0, -1.0], **(parts | more))


@pytest.fixture(scope="module")
def whole(taichi_f64, tmp_path_factory):
    """Files of a run in one part."""
    out = tmp_path_factory.mktemp("runs") / "whole"
    with gf.Simulation(falling(), out=out) as simulation:
        simulation.run()
    found = files_of(out)
    assert "particles.pvd" in found and len(found) > 4
    return found


def files_of(folder):
    """Contents of the frames and of the time series."""
    return {
        path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".vtu", ".pvd", ".csv")
    }


def test_run_in_parts_writes_the_files_of_one_run(tmp_path, whole):
    with gf.Simulation(falling(), out=tmp_path) as simulation:
        simulation.step(7)
        simulation.run(until=0.7e-3)
        simulation.run(duration=0.5e-3)
        simulation.run()
    assert files_of(tmp_path) == whole
    assert (tmp_path / "result.json").exists()


@pytest.mark.parametrize("begin", [lambda s: s.run(until=0), lambda s: s.save()])
def test_a_run_that_ended_at_its_start_can_be_resumed(tmp_path, whole, begin):
    with gf.Simulation(falling(), out=tmp_path) as simulation:
        begin(simulation)
        assert simulation.time == 0.0
    with gf.Simulation(falling(), out=tmp_path, resume=tmp_path) as simulation:
        simulation.run()
    assert files_of(tmp_path) == whole


def test_a_result_between_two_rows_does_not_change_the_energy_error(tmp_path, taichi_f64):
    """The energy input is largest when the balls are lowest, at about 0.72 ms, between the rows at 0.5 and 1
    ms."""
    for name, parts in (("parts", [0.72e-3, None]), ("whole", [None])):
        with gf.Simulation(falling(gravity=[0.0, 0.0, -100.0]), out=tmp_path / name) as simulation:
            for until in parts:
                simulation.run(until=until)
    first, second = (files_of(tmp_path / name)["timeseries.csv"] for name in ("parts", "whole"))
    assert first == second


def test_a_run_ends_with_the_stages_or_continues_beyond_them(taichi_f64):
    times = []
    observer = gf.on_interval("1 ms", lambda snapshot: times.append(snapshot.time))
    with gf.Simulation(falling(), observers=[observer]) as simulation:
        simulation.run(until="1 ms")
        first = simulation.time
        assert 0.0 <= first - 1e-3 <= simulation.time_step
        simulation.run(until=5e-3, within_stages=True)
        assert simulation.time == pytest.approx(2e-3, abs=2 * simulation.time_step)
        simulation.run(duration="1 ms")
        assert simulation.time == pytest.approx(3e-3, abs=2 * simulation.time_step)
    np.testing.assert_allclose(times, [0.0, 1e-3, 2e-3, 3e-3], atol=2e-5)


def test_exception_of_the_script_leaves_a_checkpoint(tmp_path, taichi_f64):
    scene = falling(output=OUTPUT | {"interval": 1.0})
    with pytest.raises(ZeroDivisionError), gf.Simulation(scene, out=tmp_path / "out") as simulation:
        assert any(each.startswith("output.interval") for each in simulation.warnings)
        simulation.run(until=1e-3)
        raise ZeroDivisionError
    assert list((tmp_path / "out").glob("checkpoint_*.npz"))
    with (tmp_path / "out" / "timeseries.csv").open() as file:
        assert len(list(csv.reader(file))) == 4


def test_stages_begin_after_the_previous_ones_have_ended(taichi_f64):
    """The end of a part of a run is reached to rounding, within the stage."""
    stages = [{"name": name, "duration": 1e-3} for name in ("first", "second")]
    scene = falling(run={"velocity_max": 1.0}, stages=stages, output=OUTPUT | {"interval": 1.0})
    with gf.Simulation(scene) as simulation:
        assert not any("output.interval" in each for each in simulation.warnings)  # no files are written
        simulation.run(until=np.nextafter(3 * simulation.time_step, 1.0))
        assert simulation.step_count == 3 and simulation.stage == "first"
        simulation.run(until=1.5e-3)
        assert simulation.stage == "second"


def test_two_simulations_that_alternate_in_one_process_do_not_affect_each_other(taichi_f64):
    """Scenes with equal features share kernels; each run has the bits of a run without the other one."""
    starts = [[0.0, 0.0, -0.5], [0.1, 0.0, -1.0]]
    alone = []
    for start in starts:
        with gf.Simulation(falling()) as simulation:
            simulation.particles.velocity += start
            simulation.step(60)
            alone.append(simulation.particles.position[:])
    with gf.Simulation(falling()) as first, gf.Simulation(falling()) as second:
        for simulation, start in zip((first, second), starts, strict=True):
            simulation.particles.velocity += start
        for _ in range(6):
            first.step(10)
            second.step(10)
        for simulation, expected in zip((first, second), alone, strict=True):
            np.testing.assert_array_equal(simulation.particles.position, expected)
    assert not np.array_equal(*alone)


def test_particles_from_arrays_replace_those_of_the_scene(taichi_f64):
    given = initial_particles(falling())
    given = replace(given, position=given.position + [0.0, 0.0, 0.5])
    with gf.Simulation(falling(), particles=given) as simulation:
        np.testing.assert_array_equal(simulation.snapshot().particles["position"], given.position)
    with pytest.raises(gf.GranflowError, match="radius lies in"):
        gf.Simulation(falling(), particles=replace(given, radius=2.0 * given.radius))


def test_rain_avoids_a_wall_where_it_is_at_the_time(taichi_f64):
    """A floor moves down from z = 8 mm with 1 m/s and is at 3 mm when particles of radius 1 mm appear within
    40 us; their centers are at least 0.9 mm above it."""
    region = {"box": {"min": [0.0, 0.0, 0.0], "max": [0.02, 0.02, 0.01]}}
    rain = {"kind": "rain", "rate": 1e6, "start": 5e-3, "region": region}
    group = {"material": "glass", "count": 40, "diameter": 2e-3, "insert": rain}
    sinking = {"kind": "translation", "velocity": [0, 0, -1.0]}
    walls = {"floor": plane([0, 0, 8e-3], [0, 0, 1], motion=sinking), "side": plane([0.5, 0, 0], [-1, 0, 0])}
    run = {"duration": 5.045e-3, "velocity_max": 1.0}
    with gf.Simulation(beads(groups={"beads": group}, walls=walls, run=run)) as simulation:
        simulation.run()
        height = simulation.particles.position[:, 2]
        floor = simulation.walls["floor"].pose.offset[2] + 8e-3
    assert len(height) == 40 and floor == pytest.approx(3e-3, abs=0.05e-3)
    assert height.min() >= floor + 0.9e-3
    assert np.count_nonzero(height < 8e-3) > 10
