"""Each limit of a run, tested just below and just above it, in each code path that checks it."""

import numpy as np
import pytest
from geometry.meshes import sheet, write
from scene_builders import build_scene, particle_group, plane, prepared_simulation

from granflow.engine.codes import ABORT_REASONS, NO_PARTICLE
from granflow.scene.blocks.motions import FreeWall
from granflow.simulation import Simulation

NEAR = 1e-6
"""Relative distance from a limit, on either side."""

RADIUS, SMALLER = 0.005, 0.004
FLOOR, SHEET = -0.9, 0.0
"""Heights of the plane and of the mesh [m]."""

STEP, SKIN = 2e-5, 2e-4
"""Time step [s] and skin [m]."""

STEP_LIMIT = 0.2 * RADIUS
"""Displacement [m] in one step that a particle or a wall may not exceed."""

LOW, HIGH = np.array([-0.1, -0.2, -1.0]), np.array([0.4, 0.5, 0.6])
"""Corners of the domain [m]."""


def limit_exceeded(simulation, positions=None, velocities=None, steps=0):
    """Name of the limit that a state exceeds (None: none), positions and velocities by id; kernels are reused."""
    state = simulation.engine.state
    state.control.abort[0], state.control.abort_particle[0] = 0, NO_PARTICLE
    state.count = simulation.plan.particle_capacity  # a sort moves a particle outside the domain to the end
    for index, number in enumerate(state.particles.id.to_numpy()[: state.count]):
        if positions is not None:
            state.particles.position[index] = list(positions[number])
        if velocities is not None:
            state.particles.velocity[index] = list(velocities[number])
    simulation.engine.refresh()
    if steps:
        simulation.engine.advance(steps)
    return ABORT_REASONS.get(simulation.engine.stepper.abort_code)


def touching(pair=0.01, floor=0.01, mesh=0.01):
    """Positions of two particles in contact, one on a plane, one on a mesh; overlaps over the smaller radius."""
    return np.array([
        [0.0, 0.0, 0.3],
        [RADIUS + SMALLER * (1 - pair), 0.0, 0.3],
        [0.0, 0.0, FLOOR + RADIUS * (1 - floor)],
        [0.21, 0.13, SHEET + RADIUS * (1 - mesh)],
    ])  # fmt: skip


@pytest.fixture(scope="module", params=[1, 8], ids=["scalar", "batched"])
def contacts(request, taichi_f64, tmp_path_factory):
    """The four particles; chunks of one particle use the scalar path, larger chunks the batched path."""
    folder = tmp_path_factory.mktemp("mesh")
    write(folder / "sheet.ply", *sheet(3))
    radii = (RADIUS, SMALLER, RADIUS, RADIUS)
    groups = {
        f"g{n}": particle_group(at, 2 * radius)
        for n, (at, radius) in enumerate(zip(touching(), radii, strict=True))
    }
    mesh = {"shape": "mesh", "file": "sheet.ply", "material": "glass"}
    walls = {"floor": plane([0, 0, FLOOR], [0, 0, 1]), "sheet": mesh}
    domain = {"min": LOW.tolist(), "max": HIGH.tolist(), "on_exit": "error"}
    scene = build_scene(groups, walls, domain=domain, numerics={"chunk_size": request.param})
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        simulation = prepared_simulation(scene)
    assert (simulation.engine.state.batch is not None) == (request.param > 1)
    yield simulation
    simulation.free()


def test_the_overlap_limit_holds_for_each_kind_of_contact(contacts):
    """The limit is a fraction of the smaller radius."""
    limit = contacts.plan.scene.numerics.intended_overlap
    for contact in ("pair", "floor", "mesh"):
        assert limit_exceeded(contacts, touching(**{contact: limit * (1 - NEAR)})) is None
        assert limit_exceeded(contacts, touching(**{contact: limit * (1 + NEAR)})) == "overlap"


def test_a_center_outside_any_face_of_the_domain_aborts_the_run(contacts):
    """The corners of the domain are clear of the walls: the mesh extends from -0.5 m to 0.5 m; a center below the
    domain is below the floor."""
    middle = 0.5 * (LOW + HIGH)
    for side, axes in ((LOW, (None, 0, 1)), (HIGH, (None, 0, 1, 2))):
        for axis in axes:
            inside = np.array([1 - NEAR if axis != each else 1 + NEAR for each in range(3)])
            positions = touching()
            positions[0] = middle + inside * (side - middle)
            positions[0][2] = positions[0][2] if axis == 2 else middle[2]
            assert limit_exceeded(contacts, positions) == (None if axis is None else "left_domain"), axis


@pytest.fixture(scope="module")
def free_particle(taichi_f64):
    """One particle without contacts, and a free wall."""
    run = {"duration": 1.0, "time_step": STEP, "velocity_max": 1.0}
    lid = plane([0, 0, -0.5], [0, 0, 1], motion={"kind": "free", "direction": [0, 0, 1], "mass": 1.0})
    ball = {"ball": particle_group([0.0, 0.0, 0.0])}
    simulation = Simulation(build_scene(ball, {"lid": lid}, numerics={"skin": SKIN}, run=run))
    simulation.engine.set_walls([True], [[FreeWall(direction=[0, 0, 1], mass=1.0)]])
    simulation.engine.refresh()
    yield simulation
    simulation.free()


def after_one_step(free_particle, displacement, of_wall=False):
    """Limit that a step exceeds in which the particle or the wall moves by `displacement` [m], and whether the step
    requests a neighbor-list rebuild."""
    engine = free_particle.engine
    limit_exceeded(free_particle, np.zeros((1, 3)), np.zeros((1, 3)))  # the reach of a particle at rest
    if of_wall:
        engine.state.wall_dynamics.velocity[0] = displacement / STEP
    else:
        engine.state.particles.velocity[0] = [0.0, displacement / STEP, 0.0]
    rebuilds = engine.timing.rebuild_count
    engine.advance(1)
    engine.state.wall_dynamics.velocity[0] = 0.0
    return ABORT_REASONS.get(engine.stepper.abort_code), engine.timing.rebuild_count > rebuilds


@pytest.mark.parametrize("of_wall", [False, True])
def test_displacements_of_one_step_request_a_rebuild_and_abort_the_run(free_particle, of_wall):
    """If two particles approach by more than half a skin each, they can touch before the list contains them; a
    fifth of the radius aborts the run."""
    for displacement, expected in (
        (0.5 * SKIN * (1 - NEAR), (None, False)),
        (0.5 * SKIN * (1 + NEAR), (None, True)),
        (STEP_LIMIT * (1 - NEAR), (None, True)),
    ):
        assert after_one_step(free_particle, displacement, of_wall) == expected
    name = "wall" if of_wall else "displacement"
    assert after_one_step(free_particle, STEP_LIMIT * (1 + NEAR), of_wall)[0] == name


def test_a_position_that_is_not_finite_aborts_the_run(free_particle):
    for speed, limit in ((np.nan, "not_finite"), (-np.inf, "displacement"), (0.0, None)):
        assert after_one_step(free_particle, STEP * speed)[0] == limit
