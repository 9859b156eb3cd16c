"""Observers that are added and removed while the simulation runs, that end it, and that fail."""

import numpy as np
import pytest
from api.scenes import flying

import granflow as gf
from granflow.io.checkpoint import newest_checkpoint


def test_observers_are_added_and_removed_during_a_run(taichi_f64):
    early = []
    late = []
    first = gf.on_interval("1 ms", lambda snapshot: early.append(snapshot.time))
    second = gf.on_interval("1 ms", lambda snapshot: late.append(snapshot.time))

    def exchange(snapshot):
        if snapshot.time > 4.5e-3 and first in simulation.observers:
            simulation.observers.remove(first)
            simulation.observers.append(second)

    with gf.Simulation(flying(), observers=[first, gf.on_interval(5e-3, exchange)]) as simulation:
        simulation.run()
    np.testing.assert_allclose(early, [0.0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3], atol=2e-5)
    np.testing.assert_allclose(late, [6e-3, 7e-3, 8e-3, 9e-3, 10e-3], atol=2e-5)
    with pytest.raises(gf.GranflowError, match="is not an observer"):
        simulation.observers.remove(first)


def test_stop_run_ends_the_run_regularly_and_it_can_continue(tmp_path, taichi_f64):
    def stop_at_three(snapshot):
        if 2.5e-3 < snapshot.time < 3.5e-3:
            raise gf.StopRun

    times = []
    observers = [
        gf.on_interval("1 ms", stop_at_three),
        gf.on_interval("1 ms", lambda s: times.append(s.time)),
    ]
    with gf.Simulation(flying(), out=tmp_path / "out", observers=observers) as simulation:
        result = simulation.run()
        assert simulation.time == pytest.approx(3e-3, abs=2e-5) and not result.expectations
        assert times[-1] == simulation.time, "all observers receive the snapshot at which the run ends"
        simulation.run(until=6e-3)
    np.testing.assert_allclose(times, [0.0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3], atol=2e-5)
    assert (tmp_path / "out" / "result.json").exists()
    alone = gf.Simulation(flying(), out=tmp_path / "alone", observers=[gf.on_interval("1 ms", stop_at_three)])
    alone.run()
    assert (tmp_path / "alone" / "result.json").exists()
    alone.free()


def fragile(snapshot):
    """Fails at 2 ms."""
    if snapshot.time > 1.5e-3:
        raise KeyError("speed")


def test_an_error_names_function_and_time_after_a_checkpoint_from_which_the_run_resumes(tmp_path, taichi_f64):
    out = tmp_path / "out"
    times = []
    message = r"The function fragile failed at 0.002\d* s: KeyError: 'speed'. The state"
    with pytest.raises(gf.FunctionError, match=message) as error:
        gf.Simulation(flying(), out=out, observers=[gf.on_interval("2 ms", fragile)]).run()
    assert isinstance(error.value.__cause__, KeyError) and str(out) in str(error.value)
    checkpoint, _ = newest_checkpoint(out)
    assert checkpoint.time == pytest.approx(2e-3, abs=2e-5)
    with pytest.raises(
        gf.GranflowError, match="observers from Python that this program does not register: fragile"
    ):
        gf.Simulation(flying(), out=out, resume=out)
    corrected = gf.on_interval("2 ms", lambda snapshot: times.append(snapshot.time))
    corrected.name = "fragile"
    with gf.Simulation(flying(), out=out, resume=checkpoint, observers=[corrected]) as simulation:
        simulation.run()
    np.testing.assert_allclose(times, [2e-3, 4e-3, 6e-3, 8e-3, 10e-3], atol=2e-5)


def test_representations_of_a_simulation_name_its_parts(taichi_f64):
    with gf.Simulation(flying(), observers=[gf.on_interval("1 ms", fragile)]) as simulation:
        simulation.step(3)
        assert repr(simulation.observers) == "[fragile]"
        assert all(text in simulation._repr_html_() for text in ("particles", "time step", "none"))
        assert all(text in simulation.snapshot()._repr_html_() for text in ("(2, 3)", "kinetic_energy"))
