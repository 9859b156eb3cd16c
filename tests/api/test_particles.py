"""Particles that are read and changed from Python while the simulation runs."""

import re

import numpy as np
import pytest
from api.scenes import beads, flying
from scene_builders import SOFT, build_scene, particle_group

import granflow as gf
from granflow.cli.main import main

GRAVITY = 9.81
START = [[0.0, 0.0, 0.1], [0.05, 0.0, 0.1], [0.1, 0.0, 0.1]]


@pytest.fixture
def simulation(taichi_f64):
    """Three particles of two groups in gravity, and a group of another material and size; friction, so that
    particles rotate; an outlet far away."""
    groups = {
        "feed": particle_group(START[:2]),
        "rest": particle_group(START[2:]),
        "other": particle_group([[0.3, 0.3, 0.3]], material="steel", diameter=0.02),
    }
    parts = {"gravity": [0.0, 0.0, -GRAVITY], "pair": {"friction": 0.3}, "run": {"duration": 0.1}}
    sink = {"sink": {"box": {"min": [-0.9] * 3, "max": [-0.8] * 3}}}
    scene = build_scene(groups, output={"interval": 0.1, "energy_budget": True}, outlets=sink, **parts)
    with gf.Simulation(scene) as simulation:
        yield simulation


def test_arrays_are_ordered_by_id_and_copies(simulation):
    particles = simulation.particles
    simulation.run(until=1e-3)
    np.testing.assert_array_equal(particles.id, [0, 1, 2, 3])
    np.testing.assert_array_equal(particles.group, ["feed", "feed", "rest", "other"])
    np.testing.assert_array_equal(particles.material == "glass", [True, True, True, False])
    np.testing.assert_allclose(particles.diameter, [0.01, 0.01, 0.01, 0.02])
    np.testing.assert_allclose(particles.force[:, 2], -GRAVITY * particles.mass)
    snapshot = simulation.snapshot()
    for name in ("position", "velocity", "angular_velocity", "mass"):
        np.testing.assert_array_equal(getattr(particles, name), snapshot.particles[name])
    particles.velocity[:][0] = 7.0
    assert np.abs(particles.velocity).max() < 1.0
    particles.group[0] = "rest"
    np.testing.assert_array_equal(particles.group, ["rest", "feed", "rest", "other"])


def test_velocities_written_before_the_start_and_during_the_run_give_the_parabola(simulation):
    """x(t) = x0 + v0 t - g t^2 / 2, which the leapfrog scheme integrates exactly."""
    particles = simulation.particles
    particles.velocity[particles.group == "feed"] = [1.0, 0.0, 0.0]
    simulation.run(until=0.01)
    time = simulation.time
    np.testing.assert_allclose(particles.velocity[0], [1.0, 0.0, -GRAVITY * time], rtol=1e-9)
    particles.velocity[particles.group == "feed"] *= 0.5
    particles.velocity[particles.rows([2]), 1] = 2.0
    changed_at = particles.position[0]
    simulation.run(duration=0.01)
    later = simulation.time - time
    fallen = [0.0, 0.0, 0.5 * GRAVITY * later**2]
    expected = changed_at + np.array([0.5, 0.0, -0.5 * GRAVITY * time]) * later - fallen
    np.testing.assert_allclose(particles.position[0], expected, rtol=1e-9)
    np.testing.assert_allclose(particles.position[2][1], 2.0 * later, rtol=1e-9)


def test_budget_closes_with_all_changes(simulation):
    particles = simulation.particles
    simulation.run(until=2e-3)
    particles.velocity *= 3.0
    particles.position[0] += [0.0, 0.0, 0.05]
    particles.angular_velocity[1] = [10.0, 0.0, 0.0]
    particles.diameter[:] = 0.011
    particles.add([[0.2, 0.0, 0.0]], diameter=0.012, group="feed", velocity=[0.0, 0.0, 1.0])
    particles.remove([2])
    particles.position[2] = [-0.85, -0.85, -0.85]  # into the outlet, which deletes it before the next step
    before = particles.id[:]
    simulation.run(duration=2e-3)
    totals = simulation.snapshot().totals
    assert abs(totals["energy_error"]) < 1e-9 and totals["particle_count"] == 3
    assert totals["inserted_count"] == 5 and totals["deleted_count"] == 2
    np.testing.assert_array_equal(before, [0, 1, 3, 4])
    energies = totals["kinetic_energy"] + totals["rotational_energy"] + totals["gravitational_energy"]
    assert energies == pytest.approx(-totals["removed_energy"], rel=1e-9)


def resting(count=1):
    """Particles at rest on a floor."""
    positions = [[0.02 * k, 0.0, 0.005 - 1e-6] for k in range(count)]
    return beads(positions, run={"duration": 1.0, "velocity_max": 1.0})


def test_lists_and_forces_follow_particles_that_are_moved_away_and_back_or_removed(taichi_f64):
    with gf.Simulation(resting(2)) as simulation:
        particles = simulation.particles
        simulation.run(until=1e-3)
        assert simulation.snapshot().totals["contact_count"] == 2
        particles.position[0] += [0.0, 0.0, 0.3]
        np.testing.assert_allclose(particles.force[0], [0.0, 0.0, -GRAVITY * particles.mass[0]])
        assert simulation.snapshot().totals["contact_count"] == 1
        particles.position[0] = particles.position[1] + [0.0, 0.00999, 0.0]
        simulation.step()
        assert simulation.snapshot().totals["contact_count"] == 3
        particles.remove(np.array([True, False]))
        simulation.step(3)
        np.testing.assert_array_equal(particles.id, [1])
        assert simulation.snapshot().totals["contact_count"] == 1
        particles.remove([0])
        simulation.step(3)
        assert len(particles) == simulation.snapshot().totals["particle_count"] == 0


def test_added_particles_exceed_the_capacity_and_collide(taichi_f64):
    """More particles than the arrays hold: the arrays grow, and particles and contacts remain."""
    with gf.Simulation(resting()) as simulation:
        simulation.run(until=1e-3)
        before = simulation.particles.position[0]
        axes = np.meshgrid(np.arange(1, 50), np.arange(50), [0.005 - 1e-6], indexing="ij")
        grid = np.stack(axes, -1).reshape(-1, 3)
        ids = simulation.particles.add(grid * [0.0101, 0.0101, 1.0] - [0.0, 0.3, 0.0], diameter=0.01)
        np.testing.assert_array_equal(ids, np.arange(1, 2451))
        np.testing.assert_array_equal(simulation.particles.position[0], before)
        simulation.run(duration=1e-4)
        totals = simulation.snapshot().totals
        assert totals["particle_count"] == totals["wall_contact_count"] == 2451


def setting(name, index, value):
    """Assigns a value to rows of an array."""
    return lambda p: getattr(p, name).__setitem__(index, value)


def adding(position=(0, 0, 0), **values):
    """Adds particles."""
    return lambda p: p.add(position, **values)


WRONG = {
    "velocity: values of the shape (1, 2) are given for (4, 3).": setting("velocity", slice(None), [[1.0, 2.0]]),
    "(3, 4) are given for (4, 3); give the transpose": lambda p: setattr(p, "velocity", np.zeros((3, 4))),
    "velocity contains nan; all values must be finite": setting("velocity", 0, np.nan),
    "outside the domain from [-1.0, -1.0, -1.0] to": setting("position", 0, [0.0, 0.0, 2.0]),
    "particles.diameter would lie in [0.01, 0.05] m": setting("diameter", 1, 0.05),
    "particles.group is 'food', but must be one of feed, rest, other": setting("group", 0, "food"),
    "the new group must have the same material": setting("group", 0, "other"),
    "material is 'steel', but the group feed is of glass": adding(material="steel", group="feed"),
    "group is missing: give one of feed, rest, other": adding(),
    "group is missing: feed, rest are of glass": adding(material="glass"),
    "diameter contains 0.5 m, but the diameters of the scene": adding(diameter=0.5, group="feed"),
    "particles.remove: ": lambda p: p.remove([7]),
    "particles.temperature: the particles have none": lambda p: p.temperature[0],
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG)
def test_invalid_changes_are_refused_in_one_sentence(simulation, message):
    position = simulation.particles.position[:]
    velocity = simulation.particles.velocity[:]
    with pytest.raises(gf.GranflowError) as error:
        WRONG[message](simulation.particles)
    assert message in str(error.value) and "\n" not in str(error.value)
    np.testing.assert_array_equal(simulation.particles.position, position)
    np.testing.assert_array_equal(simulation.particles.velocity, velocity)


def program_scene():
    """A scene whose particles a program adds, above a floor."""
    sizes = {"distribution": "uniform", "min": 0.008, "max": 0.01}
    group = {"material": "glass", "count": 3, "diameter": sizes, "insert": {"kind": "python"}}
    return beads(groups={"balls": group}, run={"duration": 1.0, "velocity_max": 1.0})


def test_a_scene_without_particles_takes_arrays_and_resumes(taichi_f64, tmp_path):
    """The arrays grow beyond the `count` of the group; a resumed run has the added particles."""
    position = np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.1], [0.2, 0.0, 0.1], [0.3, 0.0, 0.1]])
    diameter = np.array([0.008, 0.01, 0.009, 0.01])
    velocity = np.arange(12.0).reshape(4, 3) / 100.0
    with gf.Simulation(program_scene(), out=tmp_path / "run") as simulation:
        assert len(simulation.particles) == 0 and simulation.particles.position.shape == (0, 3)
        simulation.step()
        ids = simulation.particles.add(position, diameter, "glass", velocity)
        np.testing.assert_array_equal(ids, [0, 1, 2, 3])
        simulation.run(until=0.01)
        moved = simulation.particles.position[:]
        np.testing.assert_allclose(simulation.particles.diameter, diameter, rtol=1e-12)
        expected = position[:, :2] + velocity[:, :2] * simulation.time
        np.testing.assert_allclose(moved[:, :2], expected, atol=1e-5)
    with gf.Simulation(program_scene(), out=tmp_path / "run", resume=tmp_path / "run") as simulation:
        np.testing.assert_array_equal(simulation.particles.position, moved)
        simulation.step()


def test_the_command_line_refuses_a_group_of_a_program(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    program_scene().save("scene.yaml")
    assert main(["check", "scene.yaml"]) == 0 and "a Python program adds" in capsys.readouterr().err
    assert main(["run", "scene.yaml"]) == 2
    error = capsys.readouterr().err
    assert re.match(r"scene\.yaml:\d+:\d+: particles\.balls\.insert\.kind is python: ", error), error
    assert not (tmp_path / "out").exists()


def test_particles_without_constants_of_their_contact_are_refused(taichi_f64):
    """One particle touches no other, so that its scene needs no pair; a second one would."""
    ball = particle_group([[0.0] * 3])
    scene = gf.Scene.from_dict(flying().to_dict() | {"particles": {"ball": ball}, "pairs": {}})
    with gf.Simulation(scene) as simulation:
        particles = simulation.particles
        with pytest.raises(gf.GranflowError, match="but the scene has no pair glass-glass; add it to pairs"):
            particles.add([0.1, 0.0, 0.0])
        simulation.step()
        assert len(particles) == 1
        particles.remove([0])
        particles.add([0.1, 0.0, 0.0])
        with pytest.raises(gf.GranflowError, match="no pair glass-glass"):
            particles.add([0.2, 0.0, 0.0])
        with pytest.raises(gf.GranflowError, match="angular_velocity is not 0, but"):
            particles.add([0.2, 0.0, 0.0], angular_velocity=[0.0, 0.0, 1.0])
        simulation.step()
        np.testing.assert_allclose(particles.position, [[0.1, 0.0, 0.0]])


def test_particles_without_torques_keep_their_angular_velocity(taichi_f64):
    """They have no friction, so that nothing changes it; its energy is 0.5 * 0.4 m r^2 w^2."""
    ball = particle_group([[0.0] * 3], angular_velocity=[1.0, 2.0, -2.0])
    with gf.Simulation(gf.Scene.from_dict(flying().to_dict() | {"particles": {"ball": ball}})) as simulation:
        simulation.step(3)
        np.testing.assert_array_equal(simulation.particles.angular_velocity, [[1.0, 2.0, -2.0]])
        totals = simulation.snapshot().totals
        energy = 0.2 * simulation.particles.mass[0] * 0.005**2 * 9.0
        assert totals["rotational_energy"] == pytest.approx(energy) and abs(totals["energy_error"]) < 1e-9


def test_snapshot_and_forces_before_the_first_step_contain_the_contacts(taichi_f64):
    """Hertz: F = 4/3 E* sqrt(R*) d^1.5 and U = 2/5 F d for an overlap of 0.1 mm. The run gives the same bits as
    without the snapshot."""
    modulus = SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
    force = 4.0 / 3.0 * modulus * np.sqrt(2.5e-3) * 1e-4**1.5
    run = {"duration": 1e-4, "velocity_max": 1.0}
    ends = []
    for looks in (True, False):
        with gf.Simulation(flying([[0.0] * 3, [9.9e-3, 0.0, 0.0]], [0.0] * 3, run=run)) as simulation:
            if looks:
                snapshot = simulation.snapshot(contacts=True)
                assert simulation.time == 0.0 and snapshot.totals["contact_count"] == 1
                assert snapshot.contacts["overlap"] == pytest.approx([1e-4], rel=1e-9)
                assert snapshot.contacts["normal_force"] == pytest.approx([force], rel=1e-6)
                assert snapshot.totals["elastic_energy"] == pytest.approx(0.4 * force * 1e-4, rel=1e-6)
                np.testing.assert_allclose(simulation.particles.force[:, 0], [-force, force], rtol=1e-6)
                np.testing.assert_allclose(simulation.particles.velocity, 0.0, atol=1e-15)
            simulation.run()
            ends.append(simulation.snapshot())
    np.testing.assert_array_equal(ends[0].particles["position"], ends[1].particles["position"])
    np.testing.assert_array_equal(ends[0].particles["velocity"], ends[1].particles["velocity"])
    assert ends[0].totals == ends[1].totals
