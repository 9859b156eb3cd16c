"""Aborted runs: the last good state is a checkpoint, and the command in the message continues from it."""

import re
import shlex
from dataclasses import replace

import pytest
from resume.runs import balls, files_of

import granflow as gf
from granflow.cli.main import main
from granflow.io.checkpoint import newest_checkpoint

pytestmark = pytest.mark.usefixtures("taichi_f64")
LIMITS = 0.004, 0.3
"""Overlap limits: the first ball exceeds the lower one. Their units of the sums differ by far."""


def scene(max_overlap, positions=((0, 0, 0.006), (0.03, 0, 0.008))):
    """Two balls that fall on a floor from 1 mm and 3 mm: at 0.14 and at 0.24 m/s, after 14 and 25 ms."""
    run = {"duration": 0.03, "time_step": 1e-5, "velocity_max": 1.0}
    return balls([*positions], run=run, numerics={"max_overlap": max_overlap, "chunk_size": 4})


def aborted(scene, out, **options):
    """The message of a run that exceeds the limit."""
    with pytest.raises(gf.RunError) as stopped, gf.Simulation(scene, out=out, **options) as simulation:
        simulation.run()
    return str(stopped.value)


def test_command_of_an_abort_continues_with_the_bits_of_a_run_without_limit(
    tmp_path, frequent_copies, monkeypatch, capsys
):
    """From a state shortly before the abort. The units of the sums follow from the first limit in all runs.

    Without a change the run aborts again, at a time that the resumed run rounds otherwise.
    """
    low, high = LIMITS
    out = tmp_path / "run"
    message = aborted(scene(low), out)
    monkeypatch.undo()
    (command,) = re.findall(r"granflow (resume \S+ --set numerics.max_overlap=)\S+ continues from", message)
    assert newest_checkpoint(out)[0].time > 0.0
    accepted = float(message.partition(command)[2].split()[0])
    assert low < accepted <= high
    assert main(["resume", str(out), "--threads", "2"]) == gf.RunError.exit_code
    assert message.rpartition(", at ")[0] in capsys.readouterr().err

    plan = replace(gf.plan_for(scene(high)), saved_sum_units=gf.plan_for(scene(low)).sum_units)
    assert gf.plan_for(scene(high)).sum_units != plan.sum_units
    with gf.Simulation(scene(high), out=tmp_path / "whole", plan=plan) as simulation:
        simulation.run()
    assert main([*shlex.split(f"{command}{high}"), "--threads", "2"]) == 0
    assert "Continues from" in capsys.readouterr().out
    assert files_of(out) == files_of(tmp_path / "whole")


def test_an_exception_of_an_observer_at_the_abort_saves_the_last_good_state(tmp_path):
    """The observer receives the state of the abort; the checkpoint must not contain it."""

    def fails(snapshot):
        if snapshot.time > 0.0:
            raise ValueError("too much")

    message = aborted(scene(LIMITS[0]), tmp_path, observers=[gf.on_interval(1.0, fails)])
    assert "more than numerics.max_overlap" in message
    checkpoint, _ = newest_checkpoint(tmp_path)
    assert checkpoint.time < 0.014
    assert checkpoint.saved["engine"]["clock"]["step_count"] == 0


def test_abort_before_the_first_step_offers_a_run_with_another_limit(tmp_path, monkeypatch):
    """A ball overlaps the floor initially by 0.16 of its radius: there is no good state and no checkpoint."""
    monkeypatch.chdir(tmp_path)
    message = aborted(scene(0.01, [(0, 0, 0.0042)]), "out")
    assert "granflow resume" not in message and newest_checkpoint(tmp_path / "out")[0] is None
    (command,) = re.findall(r"granflow (run \S+ --out \S+ --set numerics.max_overlap=\S+) runs", message)
    assert 0.16 <= float(command.rpartition("=")[2]) <= 0.171
    assert main([*shlex.split(command), "--threads", "2"]) == 0
