"""Forecasts of a plan: the overlaps to expect, and probable mistakes that end a run or make it pointless.

`forecasts_of` lists all forecasts that need no particles; `granflow explain` shows them, and `granflow
check` and a run show their warnings. Overlaps and checks of the initial particles are in `overlaps`. The
other warnings are rows (key, whether it is a mistake, sentence) of `value_rows`, or functions that yield the
key and the sentence where the condition takes a computation.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, combinations, product
from math import ceil, expm1, floor, inf, pi, sqrt

import numpy as np

from granflow.contact import registry
from granflow.geometry.mesh import Mesh
from granflow.geometry.periodic_box import AXES
from granflow.geometry.sphere import sphere_volume
from granflow.geometry.surface import Surface
from granflow.load import Scene
from granflow.particles.group import SceneGroup
from granflow.particles.insertion import DUE_TOLERANCE, MAX_BATCHES
from granflow.plan.overlaps import (
    HARDEST,
    mean_volume,
    overlap_forecasts,
    packing_stiffness,
    pressure_words,
    region_findings,
    region_of,
    section_of,
    solid_volume,
)
from granflow.plan.plan import Forecast, Plan
from granflow.plan.stages import StageTimes, nominal_times, spread_times
from granflow.plan.time_step import ImpactVelocity
from granflow.plan.wall_control import ControlledMotion, active_spans
from granflow.plan.walls import PlannedWall, surface_speed, wall_speeds
from granflow.scene.blocks.gravity import AnyGravity, ChangingGravity
from granflow.scene.blocks.insertions import TimedInsertion
from granflow.scene.blocks.motions import RockingRotation, SurfaceVelocity, TimedMotion, poses_at
from granflow.scene.blocks.output import unit_of
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.primitives import RotationStep
from granflow.scene.blocks.walls.wall import Wall
from granflow.visible_text import alternatives

Path = tuple[str | int, ...]
Finding = tuple[Path, str]
"""A key of the scene, and the rest of the sentence on it, which follows its place."""


def forecasts_of(plan: Plan) -> Iterator[Forecast]:
    """All forecasts that need no particles; `plan`: that of the scene, without forecasts."""
    scene = plan.scene
    times = nominal_times(plan.stages)
    overlaps = list(overlap_forecasts(plan, forecast_velocity(plan)))
    yield from overlaps
    rows = value_rows(plan, times, overlaps)
    findings = chain(
        ((path, rest) for path, is_mistake, rest in rows if is_mistake),
        oversizes(scene),
        drained_groups(scene),
        unreachable_walls(scene, plan.walls, times),
        turned_out_findings(plan, times),
        region_findings(plan, times),
        servo_findings(plan, times),
        servo_area_findings(plan),
        free_wall_findings(plan, times),
        sideways_findings(plan),
        backward_findings(plan),
        flow_findings(plan),
        fixed_findings(plan),
        wear_findings(plan),
        gap_findings(plan),
        gain_findings(plan),
        condition_findings(plan),
    )
    yield from conduction_areas(scene)
    sentences = [f"{_key_and_place(scene, *path)}{rest}" for path, rest in findings]
    for name, group in scene.particles.items():
        sentences += group.shape.warnings(partial(_key_and_place, scene, "particles", name))
    yield from (Forecast("", "", sentence, sentence) for sentence in sentences)
    end = max(end for _, end in times.values())
    if scene.output.interval > end:
        place = _key_and_place(scene, "output", "interval")
        sentence = (
            f"{place} is {scene.output.interval:g} s, but the run lasts at most {end:g} s: only the first "
            "and the last state are written. Choose a shorter interval."
        )
        yield Forecast("", "", sentence, sentence, of_files=True)


def conduction_areas(scene: Scene) -> Iterator[Forecast]:
    """The materials whose contact areas of conduction follow from a modulus that may be softened."""
    for name, material in scene.materials.items():
        conducts = scene.contact.name("heat") != "none" and bool(
            getattr(material, "thermal_conductivity", None)
        )
        if conducts and getattr(material, "true_young_modulus", None) is None:
            yield Forecast(
                "contact areas of heat",
                f"of {pressure_words(material.young_modulus)}",
                f"materials.{name} has no true_young_modulus: if its real modulus E is higher, areas are too "
                f"large by (E / {pressure_words(material.young_modulus)})^(1/3)",
                None,
            )


def _key_and_place(scene: Scene, *path: str | int) -> str:
    """A key and its place in the scene file."""
    return f"{'.'.join(map(str, path))} ({scene.where(*path)})"


def gain_findings(plan: Plan) -> Iterator[Finding]:
    """Given gains of a deforming box at which the pressure does not converge to its target.

        P(t + dt) - P0 = (1 - K g dt) (P(t) - P0),      |1 - K g dt| < 1  for  g < 2 / (K dt)

    with the stiffness K of the packing at the target. Above, the rate alternates between +- max_rate, and the
    pressure by K max_rate dt.
    """
    for path, each in plan.scene.deformations():
        targets = [axis.pressure for axis in each.by_axis.values() if axis.pressure is not None]
        if each.gain is None or each.max_rate is None or max(targets, default=0.0) <= 0.0:
            continue
        stiffness = packing_stiffness(plan, max(targets), len(targets))
        dt = plan.step.value
        if stiffness > 0.0 and each.gain * stiffness * dt > 2.0:
            amplitude = stiffness * each.max_rate * dt
            yield (
                (*path, "gain"),
                f" is {each.gain:g} 1/(Pa s), above the stability limit of about "
                f"{2.0 / (stiffness * dt):.2g} 1/(Pa s) of this packing at the time step {dt:.3g} s: the "
                f"pressure alternates by up to {pressure_words(amplitude)} in each step. Lower gain, or omit "
                "it.",
            )


NEVER_NEGATIVE = {
    *("particle_count", "inserted_count", "deleted_count", "queued_count", "contact_count"),
    *("deleted_mass", "outlet_count", "outlet_mass", "kinetic_energy", "rotational_energy", "elastic_energy"),
    *("overlap_mean", "overlap_largest", "coordination_number", "granular_temperature", "residing_mass"),
}
"""Columns that are 0 or more."""
SHARES = {"sliding_share", "rattler_share", "solid_fraction"}
"""Columns of metrics from 0 to 1."""


def condition_findings(plan: Plan) -> Iterator[Finding]:
    """Conditions of stages that no state of the particles can satisfy, so that the stage takes its longest
    duration; and stages that have no row of the time series, at which conditions are evaluated."""
    scene = plan.scene
    interval = scene.output.timeseries_interval or scene.output.interval
    for number, stage in enumerate(scene.stages):
        at_most = f"the stage lasts its max_duration, {stage.longest:g} s"
        if stage.until and interval > stage.longest:
            yield (
                ("stages", number, "until"),
                f" is evaluated at the rows of the time series, every {interval:g} s, of which the stage has "
                f"one or none in its max_duration, {stage.longest:g} s. Lower output.timeseries_interval.",
            )
        for index, condition in enumerate(stage.until):
            low, high, why = _range_of(plan, condition.quantity, number)
            path = ("stages", number, "until", index)
            if condition.above is not None and condition.above >= high:
                yield (
                    path,
                    f": {condition.quantity} is at most {high:.6g}{why}, never above {condition.above:.6g}; "
                    f"{at_most}. Give a lower value.",
                )
            if condition.below is not None and condition.below <= low:
                yield (
                    path,
                    f": {condition.quantity} is never below {condition.below:.6g}; {at_most}. Give a value "
                    "above 0.",
                )
        if stage.kinetic_energy_below == 0.0:
            yield (
                ("stages", number, "kinetic_energy_below"),
                f" is 0 J, and no energy is below; {at_most}. Give an energy above 0.",
            )


def _range_of(plan: Plan, name: str, stage: int) -> tuple[float, float, str]:
    """Lower and upper bound of a column up to the end of a stage, and words for the reason of the upper one;
    infinite where nothing is known."""
    quantity, _, part = name.partition(".")
    if quantity in SHARES:
        return 0.0, 1.0, ""
    low = 0.0 if quantity in NEVER_NEGATIVE else -inf
    entered = {each: _largest_count(plan, each, stage) for each in plan.scene.particles}
    if quantity == "inserted_count" and part:
        count, why = entered[part]
        return low, float(count), why
    counts = {each: count for each, (count, _) in entered.items()}
    bodies = {each: group.shape.sphere_count for each, group in plan.scene.particles.items()}
    if quantity in ("particle_count", "inserted_count", "deleted_count", "outlet_count"):
        total = sum(count * bodies[each] for each, count in counts.items())
        return low, float(total), ", the number of all particles until then"
    if quantity in ("deleted_mass", "outlet_mass"):
        mass = sum(counts[group.name] * _largest_mass(group) for group in plan.groups)
        return low, mass, " kg, the mass of all particles until then"
    return low, inf, ""


def _largest_mass(group: SceneGroup) -> float:
    """Mass [kg] of the largest particle of a group."""
    radius = 0.5 * group.spec.outer_diameters[1]
    return float(np.max(group.spec.shape.volume(np.array([radius])))) * group.density


def _largest_count(plan: Plan, name: str, stage: int) -> tuple[float, str]:
    """Largest number of particles of a group until the end of a stage, and words for the reason.

    Particles of a flow are due from the start on: 1 + rate t, or 1 + mass_flow t / m of the smallest.
    """
    scene = plan.scene
    group = scene.particles[name]
    insertion = group.insert
    if insertion.from_program:
        return inf, ""
    if isinstance(insertion, TimedInsertion):
        first, last = 0, len(scene.schedule) - 1
        if insertion.stages is not None:
            first, last = scene.stage_range(insertion.stages)
        duration = sum(each.longest for each in scene.schedule[first : min(last, stage) + 1])
        duration = max(duration - (0.0 if insertion.stages is not None else insertion.start), 0.0)
        rate = insertion.rate
        if rate is None and insertion.mass_flow is not None:
            smallest = 0.5 * group.outer_diameters[0]
            density = scene.materials[group.material].density
            rate = insertion.mass_flow / (density * float(group.shape.volume(np.array([smallest]))[0]))
        due = floor(rate * duration + DUE_TOLERANCE) + 1 if rate is not None else inf
        if due < group.count:
            return due, f" until the end of the stage at the rate of particles.{name}"
    return group.count, f", the count of particles.{name}"


def fixed_findings(plan: Plan) -> Iterator[Finding]:
    """Nothing flows through the contacts of fixed particles, which are not evaluated."""
    groups = plan.scene.particles
    if plan.laws.flows and all(group.fixed for group in groups.values()):
        yield (
            ("particles", next(iter(groups)), "fixed"),
            ": all particles are fixed, and fixed particles have no contacts with each other and with walls, "
            f"so that {alternatives(plan.laws.flows)} is 0. Leave out fixed: particles at rest can move.",
        )


def wear_findings(plan: Plan) -> Iterator[Finding]:
    """Particles that are attached to a wall with wear, which wear in its place."""
    for name, group in plan.scene.particles.items():
        wall = group.attached_to
        if wall is not None and plan.scene.walls[wall].wear is not None:
            yield (
                ("walls", wall, "wear"),
                f": the contacts of the particles {name}, which move with the wall, wear these particles, "
                "and do not count as wear of its surface. Give the roughness by the mesh of the wall to "
                "measure its wear.",
            )


def gap_findings(plan: Plan) -> Iterator[Finding]:
    """A smallest gap of the gas beyond its films, such as one without its unit: no path is as long."""
    gas = getattr(plan.laws.by_slot.get("heat"), "gas", None)
    if gas is not None and gas.is_present and gas.min_gap > gas.reach:
        yield (
            ("contact", "heat", "gas", "min_gap"),
            f" is {gas.min_gap:.3g} m, more than the thickness {gas.reach:.3g} m of the film of the largest "
            "particle, so that the gas hardly conducts heat. Give about the roughness of the surfaces, such "
            "as 1 um.",
        )


# The impact velocity of the forecasts: a fall from where particles start, or to where walls lift them.

LEVEL = 1e-6
"""Largest deviation of the normal of a plane from the vertical for a floor: on a steeper one, particles slide
on."""


def forecast_velocity(plan: Plan) -> ImpactVelocity:
    """Largest impact velocity if each particle starts at its insertion, is lifted by walls, and falls to the
    lowest wall.

        v = max sqrt(max(v0, u)^2 + 2 |g| h) + u,      at most the planned velocity

    v0: initial speed, h: drop height of a group, or that from where walls take particles (`lifted_height`);
    u: largest speed of walls and belts, at which particles may leave them. That of the plan if
    `run.velocity_max` is given, if images move, or if the drop height is not known. The time step keeps the
    velocity of the plan.
    """
    scene = plan.scene
    planned = plan.impact_velocity
    heights = drop_heights(plan)
    if scene.run.velocity_max is not None or scene.image_speed or not heights:
        return planned
    magnitude = float(np.linalg.norm(scene.usual_gravity))
    wall_speed = surface_speed(scene, plan.walls)
    name, height = max(
        heights.items(),
        key=lambda each: (
            2.0 * magnitude * each[1] + max(scene.particles[each[0]].initial_speed, wall_speed) ** 2
        ),
    )
    lifted, lifting = lifted_height(plan, max(heights.values()))
    height = max(height, lifted)
    initial = max(scene.particles[name].initial_speed, wall_speed)
    value = sqrt(initial**2 + 2.0 * magnitude * height) + wall_speed
    if not 0.0 < value < planned.value:
        return planned
    words = f"a fall of particles.{name} by {height:.3g} m"
    if lifting is not None and lifted == height:
        words = f"a fall by {height:.3g} m of particles that walls.{lifting} lifts"
    if initial:
        words += f" with the initial speed {initial:.3g} m/s"
    if wall_speed:
        words += f", plus the speed of the fastest wall, {wall_speed:.3g} m/s"
    return ImpactVelocity(value, f"estimated from {words}")


def lifted_height(plan: Plan, height: float) -> tuple[float, str | None]:
    """Drop height [m] of particles that start at a `height` [m] above the lowest level and that a wall lifts
    most, and the name of this wall; `height` and None if none does.

    Translations and vibrations lift by their travel, rotations, inclined belts and walls that are pushed up
    by forces to the top of the wall, which is the end of the domain for infinite walls and several motions.
    """
    scene = plan.scene
    magnitude = float(np.linalg.norm(scene.usual_gravity))
    up = -np.array(scene.usual_gravity) / magnitude
    speeds = wall_speeds(scene, plan.walls)
    low = _lowest_level(scene, plan.walls, up)
    assert low is not None
    end = max(float(corner @ up) for corner in scene.domain.corners)
    held = surface_speed(scene, plan.walls) ** 2 / magnitude
    largest: tuple[float, str | None] = (height, None)
    for wall in plan.walls:
        is_in_place = any(each.rotates for each in wall.motions) and not speeds[wall.name]
        drop = held if is_in_place else None
        lift = sum(each.lift(up, scene.longest_duration) for each in wall.motions)
        top = height + lift if lift < inf else _highest_point(wall, up, end, drop) - low
        if lift > 0.0 and top > largest[0]:
            largest = top, wall.name
    if scene.domain.on_exit != "expand" and largest[0] > end - low:
        largest = end - low, largest[1]
    return largest


def _highest_point(wall: PlannedWall, up: np.ndarray, end: float, drop: float | None) -> float:
    """Largest height [m] along `up` (3,) to which a wall takes particles, at most `end` [m].

    It is the highest point of the wall in full turns. A wall that rotates in place, such as the shell of a
    drum, holds particles above its axis only up to the height `drop` = u^2/|g| at its speed u, where gravity
    exceeds the centripetal acceleration (E. W. Davis, Trans. AIME 61 (1919) 250); None for other walls.
    """
    if len(wall.motions) != 1 or (wall.surface.area is None and drop is None):
        return end
    (motion,) = wall.motions
    is_bounded = wall.surface.area is not None
    if motion.rotates:
        point, axis = motion.point_and_axis
        points = wall.surface.enclosing_points() if is_bounded else point[None]
        along = np.outer((points - point) @ axis, axis)
        radii = np.linalg.norm(points - point - along, axis=1) if is_bounded else np.array([inf])
        above = radii if drop is None else np.minimum(radii, drop)
        across = float(np.linalg.norm(up - (up @ axis) * axis))
        return min(float(((point + along) @ up + across * above).max()), end)
    return end if motion.force_controlled else min(float((wall.surface.enclosing_points() @ up).max()), end)


def drop_heights(plan: Plan) -> dict[str, float]:
    """Height [m] of the highest particle of each mobile group above the lowest level, by name; empty if it is
    not known."""
    scene = plan.scene
    if scene.gravity_changes or not np.any(scene.usual_gravity):
        return {}
    up = -np.array(scene.usual_gravity) / np.linalg.norm(scene.usual_gravity)
    low = _lowest_level(scene, plan.walls, up)
    heights: dict[str, float] = {}
    for name, group in scene.particles.items():
        region = region_of(group)
        if group.fixed:
            continue
        if low is None or not (group.insert.points or region):
            return {}
        top = max(np.array(group.insert.points) @ up) if region is None else region.highest(up)
        heights[name] = max(float(top) - low, 0.0)
    return heights


def _lowest_level(scene: Scene, walls: tuple[PlannedWall, ...], up: np.ndarray) -> float | None:
    """Smallest height [m] along `up` (3,) at which particles hit a wall or another particle; None if not
    known.

    The highest permanent plane across `up`, otherwise the lowest point of the walls, or the end of the domain
    if it is higher or there are no walls. Not known along a periodic axis, or without walls in a domain that
    expands.
    """
    domain = scene.domain
    if any(abs(up[AXES.index(axis)]) > LEVEL for axis in domain.periodic):
        return None
    end = min(float(corner @ up) for corner in domain.corners)
    floors: list[float] = []
    lowest: list[float] = []
    for wall in walls:
        if wall.surface.plane is None:
            lowest.append(float((wall.surface.triangles(np.zeros(3), 0.0)[0] @ up).min()))
            continue
        point, normal = wall.surface.plane
        holds_all = wall.spec.is_permanent and wall.spec.groups is None
        is_floor = float(normal @ up) > 1.0 - LEVEL and holds_all
        (floors if is_floor else lowest).append(float(point @ up) if is_floor else end)
    if floors:
        return max(*floors, end)
    if domain.on_exit == "expand":
        return min(lowest, default=None)
    return max(min(lowest, default=end), end)


# Values of single keys.

SLOW = 0.1
"""Given velocity over that of a fall below which a unit is probably wrong: packed particles fall less."""
SLIDING = 0.01
"""Given velocity over that of a wall or a particle below which a unit is probably wrong: bodies that slide or
roll along each other, or fall onto a fast belt, move much faster than they approach."""
OVERLAP_TOLERANCE = 1.5
"""Overlap of a file over the forecast one above which a warning appears."""
FILE_ROUNDING = 1e-3
"""Overlap over the radius that is never reported: positions in VTU files resolve 1e-4 of the smallest
radius."""
LIGHTEST = 20.0
"""Density [kg/m3] of light foams. There is no upper limit: scaled densities are common."""
DIMENSIONLESS = 0.25
"""Diameter [m] of the smallest particle from which a low density is that of dimensionless numbers, such as
those of LAMMPS in units lj with diameters of about 1."""
MOST_FRICTION = 5.0
"""Coefficient of friction above that of all granular materials."""
FASTEST_SURFACE = 10.0
"""Surface speed of a wall [m/s] above that of drums, mixers and conveyors."""
COLDEST = 77.0
"""Temperature [K] below that of liquid nitrogen, probably in degrees Celsius."""
FULL_TURN = 2.0 * pi
"""Angle [rad] above which a rotation, phase or swing is probably in degrees."""
LEAST_ALONG = 0.99
"""Share of the velocity of a belt in its surface below which there is a warning."""
PERIOD_TOLERANCE = 0.01
"""Largest relative deviation of an interval from an odd multiple of half a period."""


def value_rows(
    plan: Plan, times: StageTimes, overlaps: Sequence[Forecast]
) -> Iterator[tuple[Path, bool, str]]:
    """Rows of keys: whether the value is probably a mistake, and the rest of the sentence.

    overlaps: those to expect, which explain the overlaps of particles from files
    """
    scene = plan.scene
    end = max(end for _, end in times.values())
    smallest = min(group.diameters[0] for group in scene.particles.values())

    for name, material in scene.materials.items():
        is_light = material.density < LIGHTEST and smallest < DIMENSIONLESS
        text = (
            f" is {material.density:.3g} kg/m3, less than light foams: check the unit (2.5 g/cm3 is 2500 "
            "kg/m3)."
        )
        yield ("materials", name, "density"), is_light, text
    # Walls and fixed particles can be rigid.
    for name in dict.fromkeys(group.material for group in scene.particles.values() if not group.fixed):
        modulus = scene.materials[name].young_modulus
        text = f" is {pressure_words(modulus)}, more than that of diamond: check the unit (1 N/mm2 is 1 MPa)."
        yield ("materials", name, "young_modulus"), modulus > HARDEST, text

    for name, pair in scene.pairs.items():
        text = (
            f" is {pair.friction:.3g}: it is a coefficient, the tangent of the friction angle, such as 0.5."
        )
        yield ("pairs", name, "friction"), pair.friction > MOST_FRICTION, text
    is_off = scene.contact.name("cohesion") == "none"
    for key in registry.pair_properties() if is_off else ():
        models = registry.models_with(key)
        for name in [name for name, pair in scene.pairs.items() if getattr(pair, key)][:1]:
            users = " or ".join(models.get("cohesion", ()))
            text = f" is not used, because contact.cohesion is none; {users} would use it."
            is_unused = "cohesion" in models and scene.contact.name("normal") not in models.get("normal", ())
            yield ("pairs", name, key), is_unused, text

    for turning in plan.walls:
        rotations = [each for each in turning.motions if hasattr(each, "angular_velocity")]
        reaches = [turning.surface.farthest_from(*each.point_and_axis) for each in rotations]
        speed = max(
            (
                each.top_speed(min(reach, 0.5 * scene.domain.diagonal))
                for each, reach in zip(rotations, reaches, strict=True)
            ),
            default=0.0,
        )
        text = (
            f": the rotation moves walls at up to {speed:.3g} m/s. Angular velocities without a unit are in "
            "rad/s: write 30 rpm or 180 deg/s."
        )
        yield ("walls", turning.name, "motion"), speed > FASTEST_SURFACE, text
    for path, motion in _wall_motions(scene):
        limit = getattr(motion, "velocity_max", 0.0)
        text = f" is {limit:.4g} m/s, faster than presses and lids move. Write 100 mm/s with the unit."
        yield (*path, "velocity_max"), limit > FASTEST_SURFACE, text
    for path, angle in _angles(scene):
        text = f" is {angle:.4g} rad, more than a full turn: angles are in rad. Write 90 deg with the unit."
        yield path, abs(angle) > FULL_TURN, text
    for path, temperature in _temperatures(scene):
        text = f" is {temperature:.4g} K, colder than liquid nitrogen: temperatures are in K. Write 20 degC."
        yield path, temperature < COLDEST, text
    for path, speed, along in _belts(plan):
        text = (
            f": the velocity has the magnitude {speed:.3g} m/s, but only its component along the surface, at "
            f"most {along:.3g} m/s, acts on particles. Give a velocity in the plane of the wall."
        )
        yield path, along < LEAST_ALONG * speed, text
    for path, motion in chain(_wall_motions(scene), scene.gravity_motions()):
        text = (
            f": the motion begins at {motion.start_time:.3g} s, but the run ends at {end:.3g} s: it has no "
            "effect. Start it earlier, or extend the run."
        )
        yield path, motion.start_time >= end, text
    for path, begin, table in _gravity_tables(scene, times):
        text = (
            f": the table begins at {begin + table[0]:.3g} s, but the run ends at {end:.3g} s: its first "
            "vector acts throughout. Start it earlier, or extend the run."
        )
        yield path, begin + table[0] >= end, text
    for first, second in combinations(plan.walls, 2):
        text = (
            f" has the same surface as walls.{first.name}: particles are in contact with walls.{first.name} "
            "only, and its material counts. Remove one of the two."
        )
        yield ("walls", second.name), _coincide(first, second), text

    heights = drop_heights(plan)
    static = max((each.overlap for each in overlaps if each.cause != "impact"), default=0.0)
    impact = max((each.overlap for each in overlaps if each.cause == "impact"), default=0.0)
    for name, group in scene.particles.items():
        if isinstance(group.insert, TimedInsertion):
            text = (
                f": the insertion starts at {group.insert.start:.3g} s, but the run ends at {end:.3g} s: no "
                "particle is inserted. Start earlier, or extend the run."
            )
            yield ("particles", name, "insert"), group.insert.start >= end, text
        if (found := group.insert.summary) is not None:
            explained = max(static, impact) if found.speed_max > 0.0 else static
            limit = max(OVERLAP_TOLERANCE * explained, FILE_ROUNDING)
            reason = f"loading and impacts explain {explained:.3g}" if explained else "no force explains it"
            text = (
                f": particles in {group.insert.source} overlap by up to {found.overlap_max:.3g} of the "
                f"smaller radius ({found.overlap_rows}), but {reason}: they separate abruptly. Check the "
                "file."
            )
            yield ("particles", name), found.overlap_max > limit and not group.fixed, text

    falling = [name for name in heights if region_of(scene.particles[name]) is not None]
    given = scene.run.velocity_max
    if falling and given is not None and not scene.damping and not scene.image_speed:
        name = max(falling, key=lambda each: heights[each])
        fall = sqrt(2.0 * float(np.linalg.norm(scene.usual_gravity)) * heights[name])
        text = (
            f" is {given:.3g} m/s, but particles.{name} can fall {heights[name]:.3g} m and reach {fall:.3g} "
            "m/s: time step and forecasts are those of slower impacts. Check the unit, or set it to "
            f"{fall:.2g} m/s."
        )
        yield ("run", "velocity_max"), given < SLOW * fall, text

    speeds = {f"walls.{name}": speed for name, speed in wall_speeds(scene, plan.walls).items()}
    speeds |= {f"particles.{name}": group.initial_speed for name, group in scene.particles.items()}
    name = max(speeds, key=lambda each: speeds[each])
    if given is not None:
        text = (
            f" is {given:.3g} m/s, but {name} moves at up to {speeds[name]:.3g} m/s: time step and forecasts "
            f"are those of slower impacts. Check the unit, or set it to {speeds[name]:.2g} m/s."
        )
        yield ("run", "velocity_max"), given < SLIDING * speeds[name], text

    for path, interval in _output_intervals(scene):
        text = (
            f" is {interval:g} s, shorter than the time step of {plan.time_step:.3g} s: the output is "
            "written after each step. Check the unit."
        )
        yield path, interval < plan.time_step, text
        for period, wall in _vibration_periods(scene).items():
            halves = round(2.0 * interval / period)
            is_odd = halves % 2 == 1 and abs(2.0 * interval / period / halves - 1.0) <= PERIOD_TOLERANCE
            text = (
                f" is {interval:.4g} s, {0.5 * halves:g} times the period {period:.4g} s of "
                f"{_key_and_place(scene, 'walls', wall, 'motion')}: the output shows this motion at two "
                "opposite phases only, which can be the same position of the wall. Set the interval to "
                f"{period / 8.0:.3g} s or less, 8 times per period, or to {period:.4g} s for one fixed phase."
            )
            yield path, is_odd, text
    for index, each in enumerate(scene.expect):
        bounds = [*(each.between or ()), each.below, each.above, each.equals]
        largest = max((abs(bound) for bound in bounds if bound is not None), default=0.0)
        text = (
            f": {each.quantity} is in rad, and the bound is {largest:.3g} rad. Write degrees with the unit, "
            "such as 25 deg."
        )
        yield ("expect", index), unit_of(each.quantity) == "rad" and largest > pi, text


def _coincide(first: PlannedWall, second: PlannedWall) -> bool:
    """Whether two walls have the same surface for the same groups, and move and are present alike: particles
    are in contact with the first one only, see `engine.walls.JoinedWalls`."""
    presence = [
        [each.spec.groups, each.spec.stages, each.spec.start_time, each.spec.end_time]
        for each in (first, second)
    ]
    is_alike = first.motions == second.motions and presence[0] == presence[1]
    return is_alike and first.surface.has_same_place(second.surface)


def _wall_motions(scene: Scene) -> Iterator[tuple[Path, TimedMotion]]:
    """Each motion of a wall with its key path."""
    for name, wall in scene.walls.items():
        for index, motion in enumerate(wall.motion):
            yield ("walls", name, "motion", index), motion


def _angles(scene: Scene) -> Iterator[tuple[Path, float]]:
    """Each angle [rad] that is not a long rotation, with its key path: of meshes, clumps and sinusoidal
    motions."""
    for name, wall in scene.walls.items():
        for index, rotation in enumerate(getattr(wall, "rotate", ())):
            yield ("walls", name, "rotate", index, "angle"), rotation.angle
    for name, group in scene.particles.items():
        orientation = getattr(group.clump, "orientation", None)
        if isinstance(orientation, RotationStep):
            yield ("particles", name, "clump", "orientation", "angle"), orientation.angle
        elif isinstance(orientation, tuple):
            for index, rotation in enumerate(orientation):
                yield ("particles", name, "clump", "orientation", index, "angle"), rotation.angle
    for path, motion in chain(_wall_motions(scene), scene.gravity_motions()):
        if isinstance(motion, RockingRotation):
            yield (*path, "amplitude"), motion.amplitude
        yield (*path, "phase"), getattr(motion, "phase", 0.0)


def _temperatures(scene: Scene) -> Iterator[tuple[Path, float]]:
    """Each temperature [K] with its key path."""
    places: list[tuple[Path, object]] = [(("walls", name), each) for name, each in scene.walls.items()]
    places += [(("particles", name), each) for name, each in scene.particles.items()]
    for index, stage in enumerate(scene.stages):
        places += [(("stages", index, "set", number), each) for number, each in enumerate(stage.set_)]
    for path, each in places:
        if (temperature := getattr(each, "temperature", None)) is not None:
            yield (*path, "temperature"), temperature
    surroundings = getattr(scene.contact.options("heat"), "surroundings", None)
    if surroundings is not None:
        yield ("contact", "heat", "surroundings"), surroundings


def _belts(plan: Plan) -> Iterator[tuple[Path, float, float]]:
    """Key path of each belt, the magnitude of its velocity [m/s], and its largest component along a face."""
    for wall in plan.walls:
        for index, motion in enumerate(wall.spec.motion):
            if isinstance(motion, SurfaceVelocity):
                velocity = np.array(motion.velocity)
                areas = _face_areas(wall.surface)
                across = np.abs(areas @ velocity / np.linalg.norm(areas, axis=1)).min()
                speed = float(np.linalg.norm(velocity))
                along = sqrt(max(speed**2 - across**2, 0.0))
                yield ("walls", wall.name, "motion", index), speed, along


def _face_areas(surface: Surface) -> np.ndarray:
    """Normals (k, 3) of the faces of a wall, of triangles for curved ones; their length is the area [m2],
    1 for a plane."""
    if surface.plane is not None:
        return np.array([surface.plane[1]])
    return _triangle_areas(surface)


def _triangle_areas(surface: Surface) -> np.ndarray:
    """Normals (k, 3) of the triangles of a wall at its initial pose; their length is the area [m2]."""
    points, corners = surface.triangles(np.zeros(3), 1.0)
    first, second, third = points[corners].transpose(1, 0, 2)
    return 0.5 * np.cross(second - first, third - first)


def _gravity_tables(scene: Scene, times: StageTimes) -> Iterator[tuple[Path, float, Sequence[float]]]:
    """Each table of gravity: key path, time [s] from which its times count, and these [s]."""
    places: list[tuple[Path, float, AnyGravity | None]] = [(("gravity",), 0.0, scene.gravity)]
    for index, stage in enumerate(scene.stages):
        places.append((("stages", index, "gravity"), times[stage.name][0], stage.gravity))
    for path, begin, gravity in places:
        if isinstance(gravity, ChangingGravity) and gravity.times:
            yield (*path, "times"), begin, gravity.times


def _vibration_periods(scene: Scene) -> dict[float, str]:
    """Each period [s] of the vibrations, with the name of the first wall."""
    found: dict[float, str] = {}
    for name, wall in scene.walls.items():
        for motion in wall.motion:
            if motion.oscillates:
                found.setdefault(motion.numeric(scene.usual_gravity).period, name)
    found.pop(inf, None)
    return found


def _output_intervals(scene: Scene) -> Iterator[tuple[Path, float]]:
    """Keys of the output intervals, and the intervals [s]; those that are not given are `interval`."""
    yield ("output", "interval"), scene.output.interval
    if scene.is_given("output", "timeseries_interval"):
        yield ("output", "timeseries_interval"), scene.output.timeseries_interval
    for name, grid in scene.output.fields.items():
        if grid.interval is not None:
            yield ("output", "fields", name, "interval"), grid.interval


# Walls and diameters that are far larger than the domain or an inlet: probably a wrong unit.

LARGE_DIAMETER = 10.0
"""Diameter over the longest side of the domain above which a unit is probably wrong; large spheres serve as
walls."""
LARGE_WALL = 20.0
"""Dimension of a wall over the longest side of the domain above which a unit is probably wrong; walls can be
larger than the domain."""


def oversizes(scene: Scene) -> Iterator[Finding]:
    """Lengths that are too large: particles that are larger than the domain, and walls that are much larger.

    Particles of inlets are compared with the face. Domains that expand have no size. Meshes have notes of
    their own, and faces of boxes are compared with the domain by their positions.
    """
    side = _longest_side(scene)
    for name, group in scene.particles.items():
        diameter = group.outer_diameters[1]
        width = inf if group.insert.place is None else group.insert.place.opening
        if diameter > width:
            where = f"{group.insert.place_key} of the {group.insert.kind}"
            face = f" is {diameter:.3g} m, larger than the {where}, which is {width:.3g} m wide. "
            yield ("particles", name, "diameter"), face + _likely_unit(diameter, width)
        elif diameter > LARGE_DIAMETER * side and scene.domain.on_exit != "expand":
            yield ("particles", name, "diameter"), _too_large(diameter, side)
    for name, wall in scene.walls.items():
        if large := oversized(scene, name, wall):
            yield ("walls", name, large[0]), _too_large(large[1], side)


def size_problems(scene: Scene) -> Iterator[str]:
    """The sentences on `oversizes` in the form of errors."""
    for path, rest in oversizes(scene):
        yield f"{scene.locate(*path)}: {'.'.join(map(str, path))}{rest}"


def oversized(scene: Scene, name: str, wall: Wall) -> tuple[str, float] | None:
    """Key and length [m] of the largest dimension of a wall if it is much larger than the domain."""
    if scene.domain.on_exit == "expand" or "." in name:
        return None
    key, length = max(wall.dimensions(), key=lambda each: each[1], default=("", 0.0))
    return (key, length) if length > LARGE_WALL * _longest_side(scene) else None


def _longest_side(scene: Scene) -> float:
    return max(high - low for low, high in zip(scene.domain.min, scene.domain.max, strict=True))


def _too_large(length: float, side: float) -> str:
    times = f"{length / side:.0f} times the longest side of the domain, {side:.3g} m"
    return f" is {length:.3g} m, {times}. {_likely_unit(length, side)}"


def _likely_unit(length: float, limit: float) -> str:
    """Instruction for a length [m] above a limit [m]: the same number in mm, if that is below the limit."""
    if 1e-3 * length > limit:
        return "Check the units of both."
    return f"Check the unit: {length:.3g} mm is {1e-3 * length:.3g} m."


# Walls that are far outside the domain, and walls that leave it.

POINTS_PER_AXIS = 13
"""Points along each axis of the domain at which the distance from a wall is computed."""
TIMES_OF_RUN = 40
"""Times of the run at which the position of a moving wall is computed."""


def drained_groups(scene: Scene) -> Iterator[Finding]:
    """Groups of which all positions are inside one outlet."""
    for name, group in scene.particles.items():
        place = group.insert.place
        points = np.array(group.insert.points if place is None else list(product(*place.extent())))
        for outlet, region in scene.outlets.items() if len(points) and not group.fixed else ():
            if region.depth(points).min() > 0.0:
                yield (
                    ("particles", name, "insert"),
                    f": all positions are inside outlets.{outlet}, which deletes the particles at once. "
                    "Check the normal or the corners of the outlet.",
                )


def unreachable_walls(scene: Scene, walls: Sequence[PlannedWall], times: StageTimes) -> Iterator[Finding]:
    """Walls that no particle can touch, or that leave the domain without an end of their motion.

    The centers of particles are anywhere in the domain. Of points at a spacing h, one is within h sqrt(3)/2
    of the nearest center. Domains that expand have no outside. Meshes outside the domain have notes of their
    own, and `oversizes` reports walls that are much larger than the domain.
    """
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    axes = [np.linspace(*span, POINTS_PER_AXIS) for span in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = 0.5 * float(np.linalg.norm((high - low) / (POINTS_PER_AXIS - 1)))
    reach += 0.5 * max(group.outer_diameters[1] for group in scene.particles.values())
    end = max(stage_end for _, stage_end in times.values())
    for wall in walls if scene.domain.on_exit != "expand" else ():
        is_endless = wall.spec.is_permanent and any(each.is_endless for each in wall.spec.motion)
        if oversized(scene, wall.name, wall.spec) or (wall.spec.has_notes and not is_endless):
            continue
        started = [times[name][0] for name in wall.spec.stages or times if name in times]
        appears = max(wall.spec.start_time, min(started, default=inf))
        moments = np.linspace(min(appears, end), end, TIMES_OF_RUN if wall.motions else 1)
        motions = [each.at(times) for each in wall.motions]
        gaps: list[float] = []
        for moment in moments:
            pose = poses_at(motions, np.array([moment]))
            local = (points - pose.pivot - pose.offset[0]) @ pose.rotation[0] + pose.pivot
            gaps.append(float(np.abs(wall.surface.distances(local, reach)).min()) - reach)
            if gaps[-1] <= 0.0 and not is_endless:
                break
        if min(gaps) > 0.0:
            size = " x ".join(f"{length:.3g}" for length in high - low)
            yield (
                ("walls", wall.name),
                f" is at least {min(gaps):.3g} m outside the domain of {size} m: no particle can be in "
                "contact with it. Check the units of its lengths, or enlarge the domain.",
            )
        elif gaps[-1] > 0.0:
            last = max(index for index, gap in enumerate(gaps) if gap <= 0.0)
            yield (
                ("walls", wall.name, "motion"),
                f" leaves the domain: after {moments[last + 1]:.3g} s of {end:.3g} s no particle can be in "
                f"contact with it, and at the end it is at least {gaps[-1]:.3g} m outside. If this is "
                "intended, give its motion an end or the wall vanishes_at.",
            )


TURN_SAMPLES = 500
"""Times of the run at which the place of a rotating wall is computed."""
OUTERMOST = np.array([each for each in product((-1.0, 0.0, 1.0), repeat=3) if any(each)])
"""Directions (26, 3) along which the outermost points of a wall represent it."""


def turned_out_findings(plan: Plan, times: StageTimes) -> Iterator[Finding]:
    """Walls that are in the domain at rest, and that a chain of motions with a rotation takes out of it by
    more than the largest diameter: with a wrong point or axis, or a translation that turns with the rotation
    before it."""
    scene = plan.scene
    end = max(stage_end for _, stage_end in times.values())
    diameter = max(group.outer_diameters[1] for group in scene.particles.values())
    bounded = [k for k, axis in enumerate(AXES) if axis not in scene.domain.periodic]
    low, high = np.array(scene.domain.min)[bounded], np.array(scene.domain.max)[bounded]
    moments = spread_times(TURN_SAMPLES, end)
    for wall in plan.walls if scene.domain.on_exit != "expand" and bounded else ():
        motions = [each.at(times) for each in wall.motions]
        turns = [index for index, each in enumerate(motions) if each.rotates]
        if not turns or wall.surface.area is None or any(each.force_controlled for each in motions):
            continue
        points = wall.surface.enclosing_points()
        points = points[np.unique((points @ OUTERMOST.T).argmax(axis=0))]
        pose = poses_at(motions, moments)
        places = np.einsum("kij,nj->kni", pose.rotation, points - pose.pivot)
        places = (places + (pose.pivot + pose.offset)[:, None])[:, :, bounded]
        outside = np.maximum(low - places, places - high).max(axis=(1, 2))
        at_rest = np.maximum(low - points[:, bounded], points[:, bounded] - high).max()
        if at_rest > 0.0 or outside.max() <= diameter:
            continue
        first = moments[np.flatnonzero(outside > diameter)[0]]
        carried = [
            index
            for index in range(turns[0] + 1, len(motions))
            if motions[index].travel(end) > 0.0 and not motions[index].rotates
        ]
        advice = "Check the point and the axis of the rotation, or enlarge the domain."
        ahead = poses_at(motions[: turns[0]], moments).offset[:, bounded] if turns[0] else np.zeros((1, 1))
        if np.abs(ahead).max() >= 0.5 * outside.max():
            advice = (
                f"The motions before the rotation, motion {turns[0]}, carry it by up to "
                f"{np.linalg.norm(ahead, axis=1).max():.3g} m: give them an end, or enlarge the domain."
            )
        elif carried:
            advice = (
                f"Motion {carried[0]} turns with the rotation before it, motion {turns[0]}: put it before "
                "the rotation if its direction is fixed in space."
            )
        yield (
            ("walls", wall.name, "motion"),
            f" takes parts of the wall out of the domain, first at {first:.3g} s, and by up to "
            f"{outside.max():.3g} m at {moments[outside.argmax()]:.3g} s. {advice}",
        )


# Servo walls that cannot reach the bed, and so their force, in the time of their motion.

LOOSEST = 0.45
"""Smallest solid fraction of a bed of clumps or of cohesive particles at rest."""
LOOSE = 0.55
"""Solid fraction of a random loose packing of spheres, without the last layer."""
SAMPLES_ALONG = 400
"""Points along the path of a servo at which its distance from other walls is computed."""


def servo_findings(plan: Plan, times: StageTimes) -> Iterator[Finding]:
    """The first servo of each wall, if its travel is shorter than its distance from the bed.

        v t < L - V / (phi A) - d,     v = min(v_max, gain F)

    v: velocity of a servo without contacts; t: time of its motion; L: distance along its direction to the
    next wall or the end of the domain; V: volume of all particles, which fill at most the height V / (phi A)
    above that wall with a loose solid fraction phi over the area A of the servo; d: largest diameter, of
    particles on the surface of the bed. A bed beyond the edges of the servo is lower: the distance is a lower
    bound. Servos across gravity can touch the side of a bed, and other motions before a servo move its wall:
    neither has a forecast. The area of a servo between walls is that of its section at the start.
    """
    scene = plan.scene
    for name, first, duration in _first_motions(plan, times):
        area = first.area_at(plan.walls)
        down = abs(float(np.dot(scene.usual_gravity, first.direction)))
        is_along = down >= (1.0 - LEVEL) * float(np.linalg.norm(scene.usual_gravity))
        if area is None or not is_along or not all(each.follows_force for each in scene.walls[name].motion):
            continue
        distance = _free_path(plan, first, 1.0)[0] - _bed_height(plan, area)
        velocity, limit = first.spec.approach(first.numbers, first.force)
        if velocity * duration < distance:
            yield (
                ("walls", name, "motion"),
                f": the {first.spec.kind} moves at most {velocity * duration:.3g} m ({velocity:.3g} m/s, "
                f"{limit}, for {duration:.3g} s), but the bed is about {distance:.3g} m away: it does not "
                f"reach {first.force:.3g} N. "
                f"{first.spec.remedy_of_distance(first.numbers, distance, duration)}",
            )


LARGEST_AREA = 1.5
"""Area of a servo over the section of the bed above which there is a warning."""


LEAST_PROJECTION = 0.95
"""Projected area of a servo over its area below which there is a warning."""


def servo_area_findings(plan: Plan) -> Iterator[Finding]:
    """Servos whose pressure refers to more than their area across the direction, such as a closed mesh.

    Then those that are much larger than the section of the bed at the start, such as those of a triaxial
    sample between walls that overlap; all of these in one finding.

    Groups with another insertion than a region or positions can fill the whole domain.
    """
    groups = [group for group in plan.scene.particles.values() if not group.fixed]
    found = []
    for motion in plan.controlled_motions:
        area = motion.area_at(plan.walls)
        pressure = getattr(motion.spec, "pressure", None)
        if pressure is None or motion.section is not None or area is None:
            continue
        direction = np.array(motion.direction)
        surface = plan.walls[motion.wall].surface
        bounded = surface.plane is None and not surface.is_curved
        if bounded and (across := _projected_area(surface, direction)) < LEAST_PROJECTION * area:
            yield (
                ("walls", motion.name, "motion"),
                f": {pressure_words(pressure)} times the area of all faces of the wall, {area:.3g} m2, is "
                f"{pressure * area:.3g} N, but the wall covers only {across:.3g} m2 across its direction, on "
                f"which it would be {pressure * across:.3g} N. Give force instead, or press with a flat wall "
                "across the direction.",
            )
            continue
        bed = max((section_of(plan.scene.domain, group, direction) for group in groups), default=area)
        if area > LARGEST_AREA * bed:
            found.append((motion.name, pressure, area, bed))
    if found:
        name, pressure, area, bed = found[0]
        others = list(dict.fromkeys(each[0] for each in found if each[0] != name))
        same = f" The same holds for walls.{', walls.'.join(others)}." if others else ""
        yield (
            ("walls", name, "motion"),
            f": {pressure_words(pressure)} is the pressure on the whole wall, {area:.3g} m2, but the bed "
            f"covers {bed:.3g} m2 at the start, on which it is {pressure_words(pressure * area / bed)}. "
            f"Give between, with the walls around the bed, or make the wall as large as the bed.{same}",
        )


def _projected_area(surface: Surface, direction: np.ndarray) -> float:
    """Area [m2] of a wall without overhangs projected along a unit vector; a closed one has two sides."""
    across = float(np.abs(_face_areas(surface) @ direction).sum())
    is_closed = isinstance(surface, Mesh) and surface.adjacency.open_count == 0
    return 0.5 * across if is_closed else across


def _first_motions(plan: Plan, times: StageTimes) -> Iterator[tuple[str, ControlledMotion, float]]:
    """Name of each wall that forces move, its first motion by forces, and the time [s] in which this is
    active."""
    end = max(end for _, end in times.values())

    def span(motion: ControlledMotion) -> tuple[float, float]:
        spans = active_spans(motion.spec, times)
        start = spans[0][0]
        return start, max(min(spans[-1][1], end) - start, 0.0)

    for name in dict.fromkeys(motion.name for motion in plan.controlled_motions):
        first = min((each for each in plan.controlled_motions if each.name == name), key=lambda m: span(m)[0])
        yield name, first, span(first)[1]


def _bed_height(plan: Plan, area: float) -> float:
    """Height [m] of a loose bed of all particles over an area [m2], with one layer on its surface."""
    groups = plan.scene.particles.values()
    is_loose = plan.laws.cohesion is not None or any(group.shape.packs_loosely for group in groups)
    height = solid_volume(plan.scene.particles) / ((LOOSEST if is_loose else LOOSE) * area)
    return height + max(group.outer_diameters[1] for group in groups)


LEAST_EXCESS = 1.1
"""Speed of the impact of a free wall over `run.velocity_max` above which there is a warning."""


def free_wall_findings(plan: Plan, times: StageTimes) -> Iterator[Finding]:
    """Free walls that hit the bed faster than the given `run.velocity_max`, and those that leave the domain.

    Without contacts a wall of mass M falls with M dv/dt = F - c v, with the weight in F. Along gravity it
    hits a loose bed of all particles before the next wall, as in `servo_findings`; against gravity, with no
    wall ahead, nothing stops a wall with a force that could lift all particles. Walls that have other
    motions, too, scenes without gravity and domains that expand have no forecast.
    """
    scene = plan.scene
    magnitude = float(np.linalg.norm(scene.usual_gravity))
    densest = max(scene.materials[group.material].density for group in scene.particles.values())
    weight = magnitude * densest * solid_volume(scene.particles)
    for name, first, duration in _first_motions(plan, times):
        area = first.area_at(plan.walls)
        is_alone = len(scene.walls[name].motion) == 1 and first.spec.is_body
        if area is None or not is_alone or not first.force or not magnitude:
            continue
        if scene.domain.on_exit == "expand":
            continue
        way = float(np.sign(first.force))
        along = way * float(np.dot(scene.usual_gravity, first.direction))
        length, ends_at_wall = _free_path(plan, first, way)
        if ends_at_wall and along >= (1.0 - LEVEL) * magnitude:
            speed, _ = _fall(first.numbers, max(length - _bed_height(plan, area), 0.0), duration)
            given = scene.run.velocity_max
            if given is not None and speed > LEAST_EXCESS * given:
                yield (
                    ("walls", name, "motion"),
                    f": the free wall hits the bed with about {speed:.3g} m/s, more than run.velocity_max "
                    f"{given:.3g} m/s, for which the time step is chosen. Place it closer to the bed, give "
                    f"it damping, or set run.velocity_max to {speed:.2g} m/s.",
                )
        elif not ends_at_wall and along < 0.0 and abs(first.force) > weight:
            _, fallen = _fall(first.numbers, length, duration)
            if fallen < duration:
                yield (
                    ("walls", name, "motion"),
                    ": nothing stops the free wall, which its force moves against gravity: without "
                    f"particles on it, it leaves the domain after {fallen:.3g} s. Give it a smaller "
                    "force, or its motion an end.",
                )


def _fall(numbers: Mapping[str, float], distance: float, duration: float) -> tuple[float, float]:
    """Speed [m/s] at the end of a distance [m] from rest, and the time [s] it takes; at most for a duration.

    With damping c, F = M a and u = F / c: v = u (1 - exp(-c t / M)), x = u t - v M / c.
    """
    force, mass, damping = abs(numbers["force"]), numbers["mass"], numbers["damping"]

    def state(time: float) -> tuple[float, float]:
        decay = damping * time / mass
        if decay < 1e-6:
            return force / mass * time, 0.5 * force / mass * time**2
        velocity = -force / damping * expm1(-decay)
        return velocity, force / damping * time - velocity * mass / damping

    low, high = 0.0, duration
    if state(duration)[1] <= distance:
        return state(duration)[0], duration
    while high - low > 1e-6 * duration:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if state(middle)[1] < distance else (low, middle)
    return state(high)[0], high


def sideways_findings(plan: Plan) -> Iterator[Finding]:
    """Servos whose force acts along the surface of their wall, to which no particles are attached."""
    scene = plan.scene
    held = {group.attached_to for group in scene.particles.values()}
    for motion in plan.controlled_motions:
        normals = _triangle_areas(plan.walls[motion.wall].surface)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        given = scene.walls[motion.name].motion[motion.motion]
        if (
            given.follows_force
            and motion.name not in held
            and np.abs(normals @ motion.direction).max() < LEVEL
        ):
            yield (
                ("walls", motion.name, "motion", motion.motion),
                ": its direction is along the surface of the wall, so that only friction can balance the "
                f"force of the servo. A direction across the surface is {_vector_text(normals[0])}.",
            )


def backward_findings(plan: Plan) -> Iterator[Finding]:
    """Servos whose force acts into the half space behind their plane, where no particles are: without
    adhesion, no contact balances it."""
    held = {group.attached_to for group in plan.scene.particles.values()}
    for motion in plan.controlled_motions:
        plane = plan.walls[motion.wall].surface.plane
        if (
            plane is not None
            and motion.spec.follows_force
            and motion.name not in held
            and not plan.laws.attracts
            and float(plane[1] @ motion.direction) <= -LEVEL
        ):
            yield (
                ("walls", motion.name, "motion", motion.motion),
                ": its direction is away from the particles, which are on the other side of the plane, so "
                f"that it never presses on them. The direction toward them is {_vector_text(plane[1])}.",
            )


def _free_path(plan: Plan, motion: ControlledMotion, way: float) -> tuple[float, bool]:
    """Distance [m] from the center of a wall that forces move, along its direction (`way` 1) or against it
    (-1), to the next wall or the end of the domain, and whether it is a wall."""
    direction = way * np.array(motion.direction)
    low, high = np.array(plan.scene.domain.min), np.array(plan.scene.domain.max)
    center = plan.walls[motion.wall].surface.triangles(0.5 * (low + high), 0.0)[0].mean(axis=0)
    ahead = np.where(direction > 0.0, high - center, low - center)
    length = float((ahead[direction != 0.0] / direction[direction != 0.0]).min())
    if length <= 0.0:
        return 0.0, False
    to_end = length
    steps = np.linspace(0.0, length, SAMPLES_ALONG)
    spacing = float(steps[1])
    for index, wall in enumerate(plan.walls):
        if index != motion.wall:
            gaps = np.abs(wall.surface.distances(center + steps[:, None] * direction, spacing))
            length = min(length, steps[gaps <= spacing].min(initial=inf))
    return float(length), length < to_end


# Insertions with a rate too high for a face or region, and inlets turned backward.

DENSEST_FLOW = 0.45
"""Solid fraction that the flow out of an inlet does not exceed.

Random sequential packings reach 0.38. Free fall from a disc of 10 diameters has 0.40, from one of 1.5
diameters 0.25.
"""
ALONG_FACE = 1e-3
"""Component along the normal over the magnitude below which a vector is parallel to a face: decimals are
rounded."""


def flow_findings(plan: Plan) -> Iterator[Finding]:
    """Inlets through which, or rain from whose region, fewer particles than required can flow."""
    scene = plan.scene
    is_still = not any(wall.motions for wall in plan.walls)
    for name, group in scene.particles.items():
        insertion = group.insert
        if not isinstance(insertion, TimedInsertion):
            continue
        interval = insertion.interval(mean_volume(group) * scene.materials[group.material].density)
        if insertion.one_way and (sentence := _wrong_direction(scene, group, insertion, interval, is_still)):
            yield ("particles", name, "velocity"), sentence
            continue
        largest, held = _largest_flow(scene, group, insertion, interval)
        place = insertion.place_key
        is_small = insertion.one_way or group.count * (1.0 - interval * largest) > held
        also = "" if insertion.one_way else f", which holds {held:.2g}"
        if is_small and 1.0 / interval > largest > 0.0:
            yield (
                ("particles", name, "insert"),
                f": {1.0 / interval:.3g} particles per second are required, but at most about {largest:.2g} "
                f"leave the {place} in a second{also}; the others are queued. Enlarge the {place}, raise "
                f"particles.{name}.velocity, or lower the {insertion.flow_key}.",
            )
        elif is_small and not largest and not insertion.one_way and is_still:
            yield (
                ("particles", name, "insert"),
                f": {group.count} particles are required, but the region holds at most about {held:.2g}, and "
                f"neither gravity nor particles.{name}.velocity moves them out; the others are queued. "
                "Enlarge the region, or lower the count.",
            )


def _largest_flow(
    scene: Scene, group: Group, insertion: TimedInsertion, interval: float
) -> tuple[float, float]:
    """Upper bounds of the particles per second that leave the region of an insertion, and of those in the
    region.

        rate = phi (A v_n + W h v_t) / V,     v_n^2 = v0_n^2 + 2 g_n h,     v_t^2 = v0_t^2 + 2 g_t W

    A, W: area and width of a face; h: depth of the region; n, t: along the normal of the face and across it;
    phi: DENSEST_FLOW; V: mean volume of a particle, of a clump that of the sphere around it. Particles leave
    an inlet along the normal only, the region of rain at both ends. 0 if particles neither start with a
    velocity nor fall: walls can carry them away. `interval` [s]: mean time between particles.
    """
    velocity = np.array(group.velocity, float)
    gravity = np.array(scene.usual_gravity, float)
    gathered = ceil(group.count / MAX_BATCHES) * interval
    region = insertion.region_for(0.5 * group.outer_diameters[1], velocity, gathered)
    normal, depth, area, width = region.face(gravity if gravity.any() else velocity)
    parts = np.array([velocity @ normal, gravity @ normal])
    initial, falling = np.maximum(parts, 0.0) if insertion.one_way else np.abs(parts)
    along = sqrt(initial**2 + 2.0 * falling * depth)
    slide = float(np.linalg.norm(gravity - (gravity @ normal) * normal))
    across = sqrt(float(np.sum((velocity - (velocity @ normal) * normal) ** 2)) + 2.0 * slide * width)
    outer = group.shape.outer_diameter
    volume = mean_volume(group) if outer is None else sphere_volume(0.5 * outer)
    flow = area * along + width * depth * across
    return DENSEST_FLOW * float(flow) / volume, DENSEST_FLOW * region.volume / volume


def _wrong_direction(
    scene: Scene, group: Group, insertion: TimedInsertion, interval: float, is_still: bool
) -> str:
    """The rest of the sentence on an inlet that new particles leave backward or not at all; empty if they
    move into the scene.

    The velocity decides, and gravity if the velocity has no component along the normal. The proposed velocity
    is the given one with the opposite component, or with the smallest one that is sufficient for the rate.
    `is_still`: whether no wall moves, which can carry particles away.
    """
    velocity = np.array(group.velocity, float)
    gravity = np.array(scene.usual_gravity, float)
    normal, _, area, _ = insertion.region_for(0.5 * group.outer_diameters[1], np.zeros(3)).face(velocity)
    through, along = (
        0.0 if abs(each @ normal) <= ALONG_FACE * np.linalg.norm(each) else float(each @ normal)
        for each in (velocity, gravity)
    )
    is_carried = not velocity.any() and along == 0.0 and (gravity.any() or not is_still)
    if through > 0.0 or (through == 0.0 and along > 0.0) or is_carried:
        return ""
    needed = mean_volume(group) / (interval * DENSEST_FLOW * area)
    speed = float(f"{1.5 * needed:.1g}") if through == 0.0 else -2.0 * float(velocity @ normal)
    if through < 0.0:
        fault = "points against it, so that they leave backward through the face"
    elif along < 0.0:
        fault = "has no component along it, so that gravity moves them backward through the face"
    else:
        fault = "has no component along it, so that they do not leave the face along its normal"
    is_reversed = insertion.place is not None and (through < 0.0 or along < 0.0)
    remedy = f", or {insertion.place.reversal}" if is_reversed and insertion.place else ""
    return (
        f" is {_vector_text(velocity)} m/s, but particles enter through the face of the inlet along "
        f"{_vector_text(normal)}: the velocity {fault}. Give a velocity such as "
        f"{_vector_text(velocity + speed * normal)} m/s{remedy}."
    )


def _vector_text(values: np.ndarray) -> str:
    """Three numbers in the form of the scene."""
    return "[" + ", ".join(f"{each + 0.0:.3g}" for each in np.round(values, 12)) + "]"
