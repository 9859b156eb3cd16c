"""Clumps in the engine: one sphere, threads, code path of a GPU, periodic box, outlets, energy budget.

All scenes but the periodic ones have one compiled structure. Clumps in mixed precision: `test_precisions`.
"""

from dataclasses import replace

import numpy as np
import pytest
from clumps import ROD, about, clump_group, falling_clumps
from scene_builders import box, build_scene, particle_group, plane, run_and_sample, run_to_end

from granflow.errors import GranflowError, SceneError
from granflow.geometry.clump import matrices
from granflow.geometry.coarse_grid import CoarseGrid, GaussianKernel
from granflow.load import Scene
from granflow.observers.coarse_graining import accumulate, of_bodies
from granflow.particles.insertion import initial_particles
from granflow.runs.read_run import read_run
from granflow.simulation import Simulation

NUMERICS = {"chunk_size": 16, "max_overlap": 0.2}
FRICTION = {"friction": 0.4, "restitution": 0.4}
OUT = {"out": {"box": {"min": [-1.0, -1.0, -1.0], "max": [1.0, 1.0, -0.1]}}}
TRIANGLE, RADII = [[0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [0.8e-3, 1.8e-3, 0.0]], [2e-3, 1.5e-3, 1.8e-3]


def clumps_in_a_box():
    """32 clumps of two kinds, 9 spheres and rain of clumps in a box: friction, rebuilds, several chunks."""
    return build_scene(
        falling_clumps(TRIANGLE, RADII), box(0.055), pair=FRICTION, outlets=OUT, gravity=[0.0, 0.0, -100.0],
        numerics=NUMERICS, output={"interval": 0.004, "energy_budget": True},
        run={"duration": 0.04, "velocity_max": 4.0, "time_step": 4e-6},
    )  # fmt: skip


def small_scene(groups, **parts):
    """A scene of the structure of `clumps_in_a_box`: walls that meet, outlet, budget, friction, two materials."""
    walls = {"floor": plane([0, 0, -0.9], [0, 0, 1]), "side": plane([-0.9, 0, 0], [1, 0, 0])}
    parts = {"pair": FRICTION, "outlets": OUT, "output": {"interval": 1.0, "energy_budget": True}} | parts
    return build_scene(groups, walls, numerics=NUMERICS, **parts)


def test_clumps_fall_as_rigid_bodies_and_their_energy_budget_closes(taichi_f64):
    """Distances within each clump are those of the given positions, although its spheres overlap by half."""
    snapshots = run_and_sample(clumps_in_a_box(), 0.004, contacts=True, threads=2)
    last = snapshots[-1]
    assert_fields_of_bodies(last, clumps_in_a_box())
    particles = last.particles
    expected = np.linalg.norm(np.diff(ROD, axis=0), axis=1)
    for clump in np.unique(particles["clump"])[1:17]:
        rows = np.flatnonzero(particles["clump"] == clump)
        assert particles["id"][rows].tolist() == list(range(rows[0], rows[0] + len(ROD)))
        position = particles["position"][rows]
        assert np.linalg.norm(np.diff(position, axis=0), axis=1) == pytest.approx(expected, rel=1e-12)
        rotation = matrices(particles["orientation"][rows[:1]])[0]
        arms = particles["clump_offset"][rows] @ rotation.T
        assert position == pytest.approx(particles["clump_position"][rows] + arms, abs=1e-15)
        assert np.ptp(particles["orientation"][rows], axis=0).max() == 0.0, "all spheres have the same copy"
    assert (particles["clump"] < 0).sum() == 9
    assert last.totals["inserted_count"] == 16 * 4 + 16 * 3 + 9 + 12 * 3
    assert last.totals["friction_dissipation"] > 0.0 and last.totals["plastic_dissipation"] > 0.0
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-3


def assert_fields_of_bodies(snapshot, scene):
    """Integrals of coarse-grained fields are sums over clumps and single spheres, with positions x and forces F.

    A contact between bodies has f b = -F_i x_i - F_j x_j with b = x_j - x_i; one with a wall ends at the contact
    point c: the integral of the contact stress is the sum of f c over walls minus that of F x over bodies. No
    cell of the grid is at the edge of the clumps, so that it contains all kernels.
    """
    particles = snapshot.particles
    grid = CoarseGrid((-0.04,) * 3, (0.1,) * 3, (3, 3, 3))
    shapes = [group.shape for group in scene.particles.values()]
    found = accumulate(
        of_bodies(particles, shapes), snapshot.contacts, grid, GaussianKernel(0.01, 3.0)
    ).arrays
    integral = {name: grid.cell_volume * values.sum(axis=0) for name, values in found.items()}
    in_clump = particles["clump"][:, None] >= 0
    position, velocity = (
        np.where(in_clump, particles[f"clump_{name}"], particles[name]) for name in ("position", "velocity")
    )
    momentum = particles["mass"][:, None] * velocity
    density = np.array([each.density for each in scene.materials.values()])[particles["material"]]
    volume = np.where(in_clump[:, 0], particles["mass"] / density, 4 / 3 * np.pi * particles["radius"] ** 3)
    weight = ~in_clump * particles["mass"][:, None] * [0.0, 0.0, -100.0]
    walls = snapshot.contacts["id_j"] < 0
    assert walls.any() and not walls.all()
    stress = snapshot.contacts["force"][walls].T @ snapshot.contacts["position_j"][walls]
    stress -= (particles["force"] - weight).T @ position
    expected = {
        "mass": particles["mass"].sum(), "volume": volume.sum(), "momentum": momentum.sum(axis=0),
        "momentum_flux": (momentum.T @ velocity).ravel(), "contact_stress": stress.ravel(),
    }  # fmt: skip
    for name, values in expected.items():
        assert integral[name] == pytest.approx(values, rel=1e-6, abs=1e-6 * np.abs(values).max()), name


def test_start_from_takes_clumps_with_their_orientation_and_motion(taichi_f64, tmp_path):
    """Rods and triangles that spin and fall freely; the next run begins with their spheres and velocities."""
    rng = np.random.default_rng(2)
    motion = {"velocity": rng.normal(0.0, 0.3, (2, 3)), "angular_velocity": rng.normal(0.0, 60.0, (2, 3))}
    sites = np.array([[0.0, 0.0, 0.1], [0.05, 0.0, 0.1]])
    groups = {
        "rods": clump_group(sites, orientation="random", **motion),
        "others": clump_group(sites + [0, 0.05, 0], TRIANGLE, RADII, "random", "steel", **motion),
    }
    everywhere = {"kind": "content", "region": {"min": [-1.0] * 3, "max": [1.0] * 3}}
    output = {"interval": 1.0, "energy_budget": True, "metrics": {"all": everywhere}}
    run = {"duration": 0.02, "velocity_max": 2.0}
    scene = small_scene(groups, gravity=[0.0, 0.0, -9.81], run=run, output=output)
    with Simulation(scene, threads=2, out=tmp_path / "first") as simulation:
        result = simulation.run()
        last = simulation.snapshot()
    volume = 2.0 * sum(group.shape.body.volume for group in scene.particles.values())
    assert result.numbers["content_volume.all"] == pytest.approx(volume, rel=1e-12), "overlaps count once"
    in_file = read_run(tmp_path / "first").frames[-1].particles
    for name in ("mass", "clump_mass", "clump_position", "clump_velocity"):
        values = last.particles[name]
        assert in_file[name] == pytest.approx(values, abs=1e-6 * np.abs(values).max()), "float32 in files"
    after = scene.to_dict() | {"start_from": str(tmp_path / "first")}
    with Simulation(Scene.from_dict(after), threads=2) as simulation:
        first = simulation.snapshot()
        assert simulation.engine.rest_state().unbalanced == pytest.approx(1.0), "no wall carries the weight"
    for name in ("position", "velocity", "angular_velocity", "clump_velocity", "clump_angular_momentum"):
        allowed = 1e-12 * np.abs(last.particles[name]).max()
        assert first.particles[name] == pytest.approx(last.particles[name], abs=allowed), name
    after["particles"]["rods"]["clump"]["spheres"] = after["particles"]["others"]["clump"]["spheres"]
    message = (
        "rods has clumps of 3 spheres, but start_from has other ones, clumps of 4 spheres; give the group"
    )
    with pytest.raises(SceneError, match=message):
        Simulation(Scene.from_dict(after), threads=2)


def test_fixed_clumps_act_as_fixed_spheres(taichi_f64):
    """A ball bounces on fixed rods, and on fixed spheres at their places, with the same motion."""
    sites = np.array([[0.0, 0.0, 0.0], [0.0, 0.005, 0.0]])
    single = particle_group([site + each for site in sites for each in np.array(ROD)], 0.004)
    ball = particle_group([[0.001, 0.002, 0.0085]], 0.01, velocity=[0.1, 0.0, -0.5])
    rod = clump_group([[0.02, 0.0, 0.3]], velocity=[0.0, 0.1, 0.0])
    run = {"duration": 0.02, "velocity_max": 2.0}
    clumps, others = (
        run_to_end(
            small_scene(
                {"ball": ball, "rod": rod, "base": base | {"fixed": True}}, gravity=[0, 0, -9.81], run=run
            ),
            threads=2,
        )[0]
        for base in (clump_group(sites), single)
    )
    base = clumps.particles["group"] == 2
    for name in ("velocity", "angular_velocity", "clump_velocity", "clump_angular_momentum"):
        assert not clumps.particles[name][base].any(), name
    assert clumps.totals["friction_dissipation"] > 1e-6
    for name in ("position", "velocity", "angular_velocity", "force"):
        found, expected = (each.particles[name][~base] for each in (clumps, others))
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12), name
    for name in ("kinetic_energy", "rotational_energy", "gravitational_energy", "friction_dissipation"):
        assert clumps.totals[name] == pytest.approx(others.totals[name], rel=1e-9), name


def test_outlets_delete_whole_clumps(taichi_f64):
    """A clump is deleted when its center of mass is in the outlet, with all its spheres and its mass.

    The energy of deleted particles is that half a step earlier: g dt / v of the kinetic energy is missing.
    """
    level = about([0, 1, 0], 90)
    groups = {
        "low": clump_group([[0.0, 0.0, 0.02]], orientation=level),
        "high": clump_group([[0.02, 0.0, 0.05]], orientation=level, material="steel"),
    }
    scene = small_scene(
        groups, gravity=[0.0, 0.0, -9.81], outlets={"out": {"box": {"min": [-1, -1, -1], "max": [1, 1, 0]}}},
        run={"duration": 0.08, "velocity_max": 2.0},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.002, threads=2)
    counts = [each.totals["particle_count"] for each in snapshots]
    assert sorted(set(counts), reverse=True) == [8.0, 4.0]
    last = snapshots[-1]
    assert last.totals["outlet_mass.out"] == pytest.approx(snapshots[0].particles["mass"][:4].sum())
    assert last.particles["id"].tolist() == [4, 5, 6, 7]
    step = snapshots[1].time / snapshots[1].step
    assert abs(last.totals["energy_error"]) < 9.81 * step / np.sqrt(2 * 9.81 * 0.02)


def free_scene(**parts):
    """Two spinning rods, a steel one, and two spheres in free fall without contacts."""
    sites = np.array([[0.0, 0.0, 0.1], [0.05, 0.0, 0.1]])
    spin = [[30.0, -20.0, 50.0], [0.0, 40.0, 10.0]]
    groups = {
        "rods": clump_group(
            sites, orientation="random", velocity=[[0.1, 0.0, 0.2]] * 2, angular_velocity=spin
        ),
        "steel": clump_group([[0.1, 0.0, 0.1]], material="steel"),
        "balls": particle_group(sites + [0.0, 0.1, 0.0], 0.005),
    }
    return small_scene(
        groups, gravity=[0.0, 0.0, -9.81], run={"duration": 0.02, "velocity_max": 2.0, "time_step": 1e-5}, **parts
    )  # fmt: skip


def test_programs_remove_clumps_and_change_single_spheres(taichi_f64):
    """The clumps that remain continue their motion, and the energy budget has the change."""
    whole, _ = run_to_end(free_scene(), threads=2)
    with Simulation(free_scene(), threads=2) as simulation:
        simulation.run(until=0.01)
        particles = simulation.particles
        with pytest.raises(GranflowError, match="particles.velocity: particle 3 is a sphere of a clump, wh"):
            particles.velocity[3] = 1.0
        with pytest.raises(
            GranflowError, match="group is steel, whose particles are clumps, but particles.a"
        ):
            particles.add([0.0, 0.3, 0.3], group="steel")
        particles.remove([2])
        particles.velocity[particles.group == "balls"] += [0.0, 0.5, 0.0]
        assert np.asarray(particles.id).tolist() == [*range(4, 14)]
        simulation.run()
        last = simulation.snapshot()
    for name in ("position", "velocity", "angular_velocity", "clump_angular_momentum"):
        expected = whole.particles[name][4:12]
        assert last.particles[name][:8] == pytest.approx(expected, abs=1e-12 * np.abs(expected).max()), name
    assert last.particles["velocity"][8:, 1] == pytest.approx(0.5)
    assert last.totals["particle_count"] == 10 and last.totals["kinetic_energy"] > 0.0
    assert abs(last.totals["energy_error"]) < 1e-6


def test_particles_from_python_with_orientations_are_those_of_the_scene(taichi_f64):
    scene = free_scene()
    given = initial_particles(scene)
    with Simulation(scene, threads=2) as simulation:
        first = simulation.snapshot()
        simulation.run(until=0.001)
        simulation.restart(given)
        again = simulation.snapshot()
        for change, message in (
            ({"orientation": None}, r"particles.orientation is missing: rods has clumps; give unit"),
            ({"orientation": 2.0 * given.orientation}, "has quaternions of rods whose length is not 1"),
            (
                {"radius": np.where(given.group == 0, 1.1, 1.0) * given.radius},
                r"particles.radius of rods must be 0.005 m, that of the sphere",
            ),
        ):
            with pytest.raises(GranflowError, match=message):
                simulation.restart(replace(given, **change))
    for name in ("id", "position", "velocity", "orientation", "clump_angular_momentum"):
        assert np.array_equal(first.particles[name], again.particles[name]), name


def periodic_rods(positions, duration, **motion):
    """Rods in a periodic box of 24 mm, with dashpots."""
    domain = {"min": [0.0] * 3, "max": [0.024] * 3, "periodic": ["x", "y", "z"], "on_exit": "error"}
    run = {"duration": duration, "velocity_max": 5.0, "time_step": 4e-6}
    return build_scene(
        {"rods": clump_group(positions, **motion)}, pair={"friction": 0.3, "restitution": 0.9}, normal="hertz",
        gravity=[0.0, 0.0, -9.81], domain=domain, run=run, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


def test_clumps_cross_a_periodic_face_as_one_body(taichi_f64):
    """Rods fall through a periodic box: the gain of potential energy at the face is boundary work."""
    positions = 0.012 * (np.argwhere(np.ones((2, 2, 2))) + 0.5)
    rng = np.random.default_rng(1)
    motion = {"velocity": rng.normal(0.0, 0.5, (8, 3)), "angular_velocity": rng.normal(0.0, 100.0, (8, 3))}
    snapshots = run_and_sample(
        periodic_rods(positions, 0.06, orientation="random", **motion), 0.006, threads=2
    )
    last = snapshots[-1]
    assert abs(last.totals["boundary_work"]) > 1e-6 and last.totals["friction_dissipation"] > 0.0
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-3
    particles = last.particles
    arms = np.einsum("nij,nj->ni", matrices(particles["orientation"]), particles["clump_offset"])
    branch = particles["position"] - particles["clump_position"] - arms
    assert branch / 0.024 == pytest.approx(np.round(branch / 0.024), abs=1e-12)
    assert (np.abs(np.round(branch / 0.024)).max(axis=1) > 0).any(), "some rods lie across a face"


def test_rate_dependent_forces_see_spheres_of_clumps_at_the_time_of_the_positions(taichi_f64):
    """A free rod that spins: v = w x arm with the arm of the same time; one of the step before is 0.4 % off."""
    rate = [0.0, 0.0, 1000.0]
    scene = periodic_rods([[0.012] * 3], 1e-3, angular_velocity=[rate])
    with Simulation(scene.model_copy(update={"gravity": (0.0, 0.0, 0.0)}), threads=2) as simulation:
        simulation.run()
        last = simulation.snapshot().particles
        assert simulation.plan.features.rate_dependent
        particles = simulation.engine.state.particles
        found = particles.velocity_synchronized.to_numpy()[:4][np.argsort(particles.id.to_numpy()[:4])]
    assert found == pytest.approx(np.cross(rate, last["position"] - last["clump_position"]), abs=1e-9)
