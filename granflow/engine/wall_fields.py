"""Device fields of walls."""

from granflow.engine.backend import Backend
from granflow.engine.field_block import FieldBlock, Fields
from granflow.geometry.catalog import surface_code
from granflow.geometry.shape import PARAMETER_COUNT, Shape
from granflow.kernel_language import ti
from granflow.plan.capacities import WALL_BATCH
from granflow.plan.device_arrays import wall_dynamics_arrays
from granflow.plan.plan import Plan

NOT_MEASURED = -1
"""Impulse row of walls whose forces are not measured."""


class Walls:
    """Shapes at rest, materials, and poses for the next WALL_BATCH steps.

    kind:              code of the kind, see `catalog.surface_code`
    parameters:        of the shape, PARAMETER_COUNT numbers
    present:           1 for walls that are present
    pivot:             [m], point of the rotation at rest
    center, rotation:  [m], 3 x 3: pose after each step; None if no wall moves
    velocity:          [m/s] of the center at the middle of each step, and of one more
    angular_velocity:  [rad/s] likewise
    surface_velocity:  [m/s] of the surface along itself likewise, before the projection on a contact plane; None
                       without belts
    impulse_row:       row in `Control.impulses`, or NOT_MEASURED
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        count = plan.capacities.walls
        self.kind = block.scalar(ti.i32, count)
        self.parameters = block.vector(backend.position_real, count, count=PARAMETER_COUNT)
        self.material = block.scalar(ti.i32, count)
        self.present = block.scalar(ti.i32, count)
        self.pivot = block.vector(backend.position_real, count)
        self.joints = block.scalar(ti.i32, count) if plan.features.joined_walls else None
        moving = plan.features.moving_walls
        self.center = block.vector(backend.position_real, WALL_BATCH, count) if moving else None
        self.rotation = block.matrix(backend.position_real, WALL_BATCH, count) if moving else None
        self.velocity = block.vector(backend.real, WALL_BATCH + 1, count) if moving else None
        self.impulse_row = block.scalar(ti.i32, count) if plan.features.wall_forces else None
        self.angular_velocity = block.vector(backend.real, WALL_BATCH + 1, count) if moving else None
        has_belt = plan.features.surface_velocity
        self.surface_velocity = block.vector(backend.real, WALL_BATCH + 1, count) if has_belt else None

    def fill(self, plan: Plan) -> None:
        """Write the constant arrays."""
        for index, wall in enumerate(plan.walls):
            self.kind[index] = surface_code(wall.shape)
            self.material[index] = wall.material
            if isinstance(wall.shape, Shape):
                self.parameters[index] = wall.shape.parameters.tolist()
            if self.impulse_row is not None:
                measured = plan.measured_walls
                self.impulse_row[index] = measured.index(wall.name) if wall.name in measured else NOT_MEASURED
        self.fill_joints(plan)

    def fill_joints(self, plan: Plan) -> None:
        """Write which walls touch; it changes if a program changes the motion of a wall."""
        if self.joints is not None:
            for index, joints in enumerate(plan.wall_joints):
                self.joints[index] = joints


class WallDynamicsFields(Fields):
    """Force-controlled walls, an entry per motion, in float64 for every precision.

    offset:             displacement along the direction of the motion [m]
    offset_at_rebuild:  `offset` at the last neighbor-list rebuild [m]
    velocity:           [m/s], half a step behind
    active:             1 if the motion is active in the step that ends at a pose
    was_active:         1 if it was active in the previous step
    wall_force:         force of the particles along the direction, summed by each chunk, in units of `plan.sum_units`
    work_on_particles:  work on the particles [J]
    work:               work of all other forces on a free wall [J]
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(wall_dynamics_arrays(plan), backend))
