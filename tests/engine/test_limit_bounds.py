"""Each limit of a run, tested just below and just above it, in each code path that checks it."""

import numpy as np
import pytest
from geometry.meshes import sheet, write
from scene_builders import build_scene, particle_group, plane, prepared_simulation

from granflow.engine.codes import ABORT_REASONS, NO_PARTICLE
from granflow.plan.capacities import REACH_STEPS
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
    """Name of the limit that a state exceeds (None: none), positions and velocities by id; kernels are
    reused."""
    state = simulation.engine.state
    state.control.abort[0], state.control.abort_particle[0] = 0, NO_PARTICLE
    state.count = (
        simulation.plan.particle_capacity
    )  # the previous sort moved a particle outside the domain to the end
    for index, number in enumerate(state.particles.id.to_numpy()[: state.count]):
        if positions is not None:
            state.particles.position[index] = list(positions[number])
        if velocities is not None:
            state.particles.velocity[index] = list(velocities[number])
    simulation.engine.refresh()
    if steps:
        simulation.engine.advance(steps)
    return ABORT_REASONS.get(simulation.engine.stepper.abort_code)


# ---------------------------------------------------------------- contacts


def touching(pair=0.01, floor=0.01, mesh=0.01):
    """Positions of two particles in contact, one on a plane, one on a mesh; overlaps relative to the smaller
    radius."""
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
    walls = {
        "floor": plane([0, 0, FLOOR], [0, 0, 1]), "sheet": {"shape": "mesh", "file": "sheet.ply", "material": "glass"}
    }  # fmt: skip
    domain = {"min": LOW.tolist(), "max": HIGH.tolist(), "on_exit": "error"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        simulation = prepared_simulation(
            build_scene(groups, walls=walls, domain=domain, numerics={"chunk_size": request.param})
        )
    assert (simulation.engine.state.batch is not None) == (request.param > 1)
    yield simulation
    simulation.free()


@pytest.mark.parametrize("contact", ["pair", "floor", "mesh"])
def test_the_overlap_limit_holds_for_each_kind_of_contact(contacts, contact):
    """The limit is a fraction of the smaller radius."""
    limit = contacts.plan.scene.numerics.intended_overlap
    assert limit_exceeded(contacts, touching(**{contact: limit * (1 - NEAR)})) is None
    assert limit_exceeded(contacts, touching(**{contact: limit * (1 + NEAR)})) == "overlap"


@pytest.mark.parametrize("side", [LOW, HIGH], ids=["low", "high"])
def test_a_center_outside_any_face_of_the_domain_aborts_the_run(contacts, side):
    """The corners of the domain are clear of the walls: the mesh extends from -0.5 m to 0.5 m."""
    middle = 0.5 * (LOW + HIGH)
    positions = touching()
    for axis in (None, 0, 1, 2):
        inside = np.array([1 - NEAR if axis != each else 1 + NEAR for each in range(3)])
        positions[0] = middle + inside * (side - middle)
        positions[0][2] = middle[2] if axis != 2 else positions[0][2]
        if axis == 2 and side is LOW:
            continue  # below the floor
        assert limit_exceeded(contacts, positions) == (None if axis is None else "left_domain"), axis


# ---------------------------------------------------------------- displacement


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


def after_one_step(free_particle, displacement):
    """Limit that a step of `displacement` [m] exceeds, and whether the step requests a neighbor-list
    rebuild."""
    engine = free_particle.engine
    limit_exceeded(
        free_particle, np.zeros((1, 3)), np.zeros((1, 3))
    )  # the reach is that of a particle at rest
    engine.state.particles.velocity[0] = [0.0, displacement / STEP, 0.0]
    rebuilds = engine.timing.rebuild_count
    engine.advance(1)
    return ABORT_REASONS.get(engine.stepper.abort_code), engine.timing.rebuild_count > rebuilds


def test_a_displacement_of_half_a_skin_requests_a_rebuild(free_particle):
    """If two particles approach by more than half a skin each, they can touch before the list contains
    them."""
    assert after_one_step(free_particle, 0.5 * SKIN * (1 - NEAR)) == (None, False)
    assert after_one_step(free_particle, 0.5 * SKIN * (1 + NEAR)) == (None, True)


def test_the_reach_of_a_fast_particle_is_longer_by_a_number_of_steps(free_particle):
    """With d the displacement per step, a rebuild is due after n steps with n d > skin/2 + REACH_STEPS d."""
    engine = free_particle.engine
    displacement = SKIN / 9
    assert SKIN / 2 + REACH_STEPS * displacement < engine.plan.reach_max
    limit_exceeded(free_particle, np.zeros((1, 3)), [[0.0, displacement / STEP, 0.0]])
    rebuilds = engine.timing.rebuild_count
    engine.advance(REACH_STEPS + 4)
    assert engine.timing.rebuild_count == rebuilds
    engine.advance(1)
    assert engine.timing.rebuild_count == rebuilds + 1


def test_a_displacement_of_a_fifth_of_the_radius_in_one_step_aborts_the_run(free_particle):
    assert after_one_step(free_particle, STEP_LIMIT * (1 - NEAR)) == (None, True)
    assert after_one_step(free_particle, STEP_LIMIT * (1 + NEAR))[0] == "displacement"


@pytest.mark.parametrize(
    ("speed", "limit"),
    [(np.nan, "not_finite"), (np.inf, "displacement"), (-np.inf, "displacement"), (0.0, None)],
)
def test_a_position_that_is_not_finite_aborts_the_run(free_particle, speed, limit):
    assert after_one_step(free_particle, STEP * speed)[0] == limit


def test_the_displacement_of_a_free_wall_has_the_same_limits(free_particle):
    """A free wall without forces keeps its velocity, which is set before each step."""
    engine = free_particle.engine

    def after(displacement):
        engine.state.wall_dynamics.velocity[0] = displacement / STEP
        rebuilds = engine.timing.rebuild_count + 1  # that of the refresh
        still = np.zeros((1, 3))
        return limit_exceeded(free_particle, still, still, steps=1), engine.timing.rebuild_count > rebuilds

    assert after(0.5 * SKIN * (1 - NEAR)) == (None, False)
    assert after(0.5 * SKIN * (1 + NEAR)) == (None, True)
    assert after(STEP_LIMIT * (1 - NEAR)) == (None, True)
    assert after(STEP_LIMIT * (1 + NEAR))[0] == "wall"
    engine.state.wall_dynamics.velocity[0] = 0.0
