"""Numbers of a plan that kernels read at run time, so that plans with equal features share their machine code."""

from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np

from granflow.fields import DeviceType
from granflow.plan.capacities import Capacities
from granflow.plan.outlets import PlannedOutlet
from granflow.plan.plan import Plan
from granflow.plan.sum_units import CARRY_BITS, ENERGY, TORQUE
from granflow.plan.wall_control import ControlledMotion


@dataclass(frozen=True)
class Parameter:
    """A number or a vector, rounded to `dtype` when it is written to the device."""

    name: str
    dtype: DeviceType
    values: tuple[float, ...]


def parameters_of(plan: Plan, capacities: Capacities) -> Iterator[Parameter]:
    """All parameters of a plan and of its arrays; equal features give the same names and lengths. Units as in the plan.

    Squared limits have the precision of velocities, also those compared with positions.
    """
    yield from (_scalar(name, "i32", value) for name, value in _counts(plan, capacities).items())
    yield from (_scalar(name, "real", value) for name, value in _limits(plan).items())
    yield from (_scalar(name, "position", value) for name, value in _lengths(plan).items())
    yield from _of_sums(plan)
    if plan.features.liquid_transfer:
        yield _scalar("liquid_unit", "f64", plan.liquid_unit)
    yield _vector("gravity", "f64", plan.gravity)
    yield _vector("box_width", "position", plan.periodic_box.width)
    yield _vector("domain_low", "position", plan.domain_low)
    yield _vector("domain_high", "position", plan.domain_high)
    for index, outlet in enumerate(plan.outlets):
        yield from _of_outlet(f"outlet.{index}", outlet)
    for index, motion in enumerate(plan.controlled_motions):
        yield from _of_motion(f"motion.{index}", motion)


def _scalar(name: str, dtype: DeviceType, value: float) -> Parameter:
    return Parameter(name, dtype, (value,))


def _vector(name: str, dtype: DeviceType, values: np.ndarray | tuple[float, ...]) -> Parameter:
    return Parameter(name, dtype, tuple(float(value) for value in values))


def _counts(plan: Plan, capacities: Capacities) -> dict[str, int]:
    return {
        "chunk_size": plan.chunk_size,
        "wall_count": len(plan.walls),
        "material_count": plan.material_count,
        "class_count": len(plan.size_classes),
        "list_capacity": capacities.list_entries_per_segment,
        "saved_capacity": capacities.saved_entries_per_segment,
        "cell_capacity": plan.cell_capacity,
    }


def _limits(plan: Plan) -> dict[str, float]:
    """Limits [m], a squared limit [m2] of displacements, the relative overlap limit and the longest time step [s]."""
    return {
        "travel_limit_squared": plan.travel_limit**2,
        "max_overlap": plan.max_overlap,
        "longest_time_step": plan.longest_time_step,
        "wall_displacement_limit": plan.wall_displacement_limit,
        "wall_travel_limit": plan.wall_travel_limit,
    }


def _lengths(plan: Plan) -> dict[str, float]:
    """Lengths [m] of the neighbor search, and the largest coordinate."""
    return {
        "reach_max": plan.reach_max,
        "force_range": plan.laws.range,
        "coordinate_limit": plan.coordinate_limit,
    }


def _of_sums(plan: Plan) -> Iterator[Parameter]:
    """Reciprocal units in the order of `sum_units`, and the numbers that round forces and torques to their units.

    For energies, the reciprocal unit of the high word.

    A number is rounded to multiples of a unit by adding 3/2 unit / eps, see `engine.exact_sums.build_to_grid`.
    """
    units = np.array(astuple(plan.sum_units))
    eps = np.finfo(np.float64 if plan.precision == "f64" else np.float32).eps
    per_unit = 1.0 / units
    per_unit[ENERGY] /= 2.0**CARRY_BITS
    yield _vector("per_unit", "real", per_unit)
    yield _vector("shift", "real", 1.5 * units[: TORQUE + 1] / eps)


def _of_outlet(prefix: str, outlet: PlannedOutlet) -> Iterator[Parameter]:
    """Corners of a box; plane and, for a disc, radius of any other outlet."""
    if outlet.low is not None and outlet.high is not None:
        yield _vector(f"{prefix}.low", "position", outlet.low)
        yield _vector(f"{prefix}.high", "position", outlet.high)
        return
    yield _vector(f"{prefix}.point", "position", outlet.point)
    yield _vector(f"{prefix}.normal", "position", outlet.normal)
    if outlet.kind == "disc":
        yield _scalar(f"{prefix}.radius", "position", outlet.radius)


def _of_motion(prefix: str, motion: ControlledMotion) -> Iterator[Parameter]:
    """Wall, direction and constants of a force-controlled motion."""
    yield _scalar(f"{prefix}.wall", "i32", motion.wall)
    yield _vector(f"{prefix}.direction", "f64", motion.direction)
    for name in ("force", "gain", "lag", "velocity_max", "mass", "damping"):
        yield _scalar(f"{prefix}.{name}", "real", getattr(motion, name))
