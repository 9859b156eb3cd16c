"""Observers that are added and removed while the simulation runs, that end it, and that fail."""

import numpy as np
import pytest
from api.scenes import flying

import granflow as gf
from granflow.io.checkpoint import newest_checkpoint


def test_observers_are_added_changed_and_removed_during_a_run(taichi_f64):
    early = []
    late = []
    first = gf.on_interval("1 ms", lambda snapshot: early.append((snapshot.time, snapshot.contacts)))
    second = gf.on_interval("1 ms", lambda snapshot: late.append(snapshot.time))

    def exchange(snapshot):
        first.wants = ["contacts"]
        if snapshot.time > 4.5e-3 and first in simulation.observers:
            simulation.observers.remove(first)
            simulation.observers.append(second)

    with gf.Simulation(flying(), observers=[first, gf.on_interval(2.5e-3, exchange)]) as simulation:
        first.wants = ["totals"]
        simulation.run()
        assert (
            repr(simulation.observers) == "[exchange, <lambda>]" and "time step" in simulation._repr_html_()
        )
    np.testing.assert_allclose([time for time, _ in early], [0.0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3], atol=2e-5)
    assert early[0][1] is None and early[-1][1] is not None
    np.testing.assert_allclose(late, [6e-3, 7e-3, 8e-3, 9e-3, 10e-3], atol=2e-5)


def test_stop_run_ends_the_run_regularly_and_it_can_continue(tmp_path, taichi_f64):
    """All observers receive the snapshot at which the run ends."""
    times = []

    def stop_at_three(snapshot):
        if 2.5e-3 < snapshot.time < 3.5e-3:
            raise gf.StopRun

    observers = [
        gf.on_interval("1 ms", stop_at_three),
        gf.on_interval("1 ms", lambda snapshot: times.append(snapshot.time)),
    ]
    with gf.Simulation(flying(), out=tmp_path / "out", observers=observers) as simulation:
        simulation.step(3)
        assert not simulation.is_stopped
        simulation.run()
        assert simulation.is_stopped and simulation.time == pytest.approx(3e-3, abs=2e-5) == times[-1]
        simulation.run(until=6e-3)
        assert not simulation.is_stopped
    np.testing.assert_allclose(times, [0.0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3], atol=2e-5)
    assert (tmp_path / "out" / "result.json").exists()


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
