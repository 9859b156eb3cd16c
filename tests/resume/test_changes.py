"""With what a run may go on and with what not, and runs that start from another's last state."""

import numpy as np
import pytest
from resume.runs import complex_scene
from scene_builders import build_scene, particle_group, plane

from granflow.errors import GranflowError, SceneError
from granflow.observe import accepted_change, newest_checkpoint, particles_from_run
from granflow.plan import plan_for
from granflow.scene.differences import differences, forbidden
from granflow.scene.generate import initial_particles
from granflow.scene.reader import scene_of
from granflow.simulation import Simulation


def changed(**overrides):
    """The busy scene as read from text, with values put in place by their key paths, written with two underscores."""
    before = scene_of(complex_scene().text(), "before")
    return before, scene_of(
        complex_scene().text(), "now", [f"{k.replace('__', '.')}={v}" for k, v in overrides.items()]
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"output__interval": "1 ms"}, "output.interval was 0.0028571428571428571 and is 0.001"),
        ({"walls__gate__stages": "[fill, shake]"}, "walls.gate.stages was [fill] and is [fill, shake]"),
        ({"walls__floor__motion__0__end": "1 s"}, "walls.floor.motion.0.end was not given and is 1.0"),
        ({"stages__2__duration": "1 s"}, "stages.2.duration was 0.006666666666666667 and is 1.0"),
        ({"numerics__max_overlap": "0.5"}, "numerics.max_overlap was 0.3 and is 0.5"),
        ({"output__checkpoint__keep": "5"}, "output.checkpoint.keep was 100 and is 5"),
        ({"expect": "[{quantity: particle_count, above: 3}]"}, "expect was [] and is not given"),
    ],
)
def test_what_may_change(override, message):
    before, now = changed(**override)
    assert not forbidden(before, now, stages_over=1)
    assert message.replace("0.0028571428571428571", repr(0.02 / 7.0)) in [
        str(each) for each in differences(before, now)
    ]


@pytest.mark.parametrize(
    "override",
    [
        {"particles__rain__count": "61"},
        {"gravity": "[0, 0, -9.8]"},
        {"seed": "2"},
        {"materials__glass__density": "2501"},
        {"pairs__glass-glass__restitution": "0.5"},
        {"contact__normal": "hertz"},
        {"walls__gate__material": "steel"},
        {"walls__floor__point": "[0, 0, 1 mm]"},
        {"run__precision": "f32"},
        {"domain__on_exit": "error"},
        {"stages__0__duration": "1 s"},
        {"output__energy_budget": "false"},
        {"output__flow_meters": "{}"},
    ],
)
def test_what_may_not_change_is_named(override):
    before, now = changed(**override)
    key = next(iter(override)).replace("__", ".")
    assert [each.key for each in forbidden(before, now, stages_over=1)][0].startswith(key)


def dropped(friction=0.3, lid_speed=0.1, gate_until=0.02, **parts):
    """Four balls that fall on a gate which goes after 20 ms, far below a lid that rises."""
    positions = [[0.0, 0.0, 0.0065], [0.02, 0.0, 0.0066], [0.0, 0.02, 0.0067], [0.02, 0.02, 0.0068]]
    rising = [{"kind": "translation", "velocity": [0, 0, lid_speed], "start": 0.0}]
    walls = {
        "gate": plane([0, 0, 0], [0, 0, 1], vanishes_at=gate_until),
        "lid": plane([0, 0, 0.5], [0, 0, -1], motion=rising),
    }
    given = {
        "gravity": [0.0, 0.0, -9.81], "pair": {"friction": friction}, "run": {"time_step": 1e-5, "velocity_max": 1.0},
        "stages": [{"name": "hold", "duration": 0.02}, {"name": "fall", "duration": 0.02}],
    }  # fmt: skip
    return build_scene({"balls": particle_group(positions)}, walls, **(given | parts))


@pytest.fixture(scope="module")
def held(tmp_path_factory, taichi_f64):
    """A checkpoint in the middle of the first stage."""
    out = tmp_path_factory.mktemp("held")
    simulation = Simulation(dropped(), out=out)
    simulation.run(until=0.015)
    simulation.free()
    checkpoint, _ = newest_checkpoint(out)
    assert checkpoint.time == pytest.approx(0.015, abs=1.1e-5)
    return checkpoint


def after(scene, checkpoint, until):
    """Particles as they stand when a run has gone on to a time [s]."""
    simulation = Simulation(scene, resume=checkpoint)
    simulation.run(until)
    last = simulation.snapshot()
    simulation.free()
    return last


@pytest.fixture(scope="module")
def existing(held):
    """The particles of that checkpoint, velocities at the time of positions."""
    return after(dropped(), held, until=0.0).particles


def test_a_gate_opened_now_lets_the_balls_fall_on(held, existing):
    """They are about to land: with the gate open they go on with v t - 1/2 g t^2, which leapfrog meets exactly."""
    assert existing["position"][:, 2].min() > 0.005
    last = after(dropped(gate_until=0.01), held, until=None)
    time = last.time - held.time
    fallen = existing["velocity"][:, 2] * time - 0.5 * 9.81 * time**2
    np.testing.assert_allclose(last.particles["position"][:, 2] - existing["position"][:, 2], fallen, rtol=1e-9)


def test_a_wall_that_would_jump_is_refused_with_the_remedy(held):
    with pytest.raises(GranflowError, match=r"walls.lid.motion would displace the wall by 0.0015 m.*\(start:\)"):
        Simulation(dropped(lid_speed=0.2), resume=held)


def test_another_scene_is_refused_unless_told(held):
    other = dropped(domain={"min": [-1.0] * 3, "max": [1.5] * 3, "on_exit": "error"})
    with pytest.raises(GranflowError) as refused:
        Simulation(other, resume=held)
    sentence, remedy = str(refused.value).splitlines()
    difference = "domain.max was [1.0, 1.0, 1.0] and is [1.5, 1.5, 1.5]"
    assert sentence == f"{held.path}: {difference}, which cannot change when a run continues."
    assert remedy == "Run the scene from the start, or continue despite the change with --allow-changes."
    assert [each.key for each in accepted_change(held, plan_for(other), allow_changes=True).differences] == [
        "domain.max"
    ]


def test_another_time_step_is_refused_even_when_told(held):
    with pytest.raises(GranflowError, match="time_step was 1e-05 and would be 5e-06 with this scene"):
        Simulation(dropped(run={"time_step": 5e-6, "velocity_max": 1.0}), resume=held, allow_changes=True)


def test_friction_cannot_be_switched_off(held):
    with pytest.raises(GranflowError, match="friction was True and would be False with this scene"):
        Simulation(dropped(friction=0.0), resume=held)


def test_a_scene_starts_from_the_last_state_of_another(held, existing):
    """Positions, velocities at the same moment, sizes; groups that are new keep clear of those that came."""
    groups = {"fresh": particle_group([[0.0, 0.0, 0.3]], 0.02), "balls": particle_group([[0.0, 0.0, 0.1]] * 4)}
    scene = dropped(start_from=str(held.path.parent), particles=groups)
    start = initial_particles(scene, particles_from_run(scene))
    assert list(start.group) == [0, 1, 1, 1, 1]
    np.testing.assert_array_equal(start.position[1:], existing["position"])
    np.testing.assert_array_equal(start.radius[1:], existing["radius"])
    np.testing.assert_allclose(start.velocity[1:], existing["velocity"], rtol=1e-12, atol=1e-15)


def test_start_from_says_what_does_not_fit(held, tmp_path):
    with pytest.raises(SceneError, match="contains no usable checkpoint; give the directory"):
        Simulation(dropped(start_from=str(tmp_path)))
    small = build_scene({"balls": particle_group([[0, 0, 0.1]], 0.008)}, start_from=str(held.path.parent))
    with pytest.raises(SceneError) as misfit:
        Simulation(small)
    count, size = misfit.value.problems
    assert count.endswith("particles.balls.count is 1, but start_from has 4 particles.")
    assert size.endswith("diameter lies in [0.008, 0.008] m, but start_from has diameters in [0.01, 0.01] m.")
