"""Forecasts of a plan: the overlaps to expect, and probable mistakes that end a run or make it pointless.

`forecasts_of` lists all forecasts that need no particles; `granflow explain` shows them, and `granflow
check` and a run show their warnings. Each warning is a function that yields one sentence with the position
of the key and a remedy. Velocities of impacts are in `falls`, overlaps in `overlaps`, checks of the initial
particles in `initial_overlaps`.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from math import ceil, inf, pi, sqrt

import numpy as np

from granflow.contact import registry
from granflow.geometry.sphere import sphere_volume
from granflow.load import Scene
from granflow.particles.insertion import MAX_BATCHES
from granflow.plan.falls import forecast_velocity, path_velocity, velocity_warnings
from granflow.plan.overlaps import (
    HARDEST,
    bed_pressures,
    impact_forecast,
    mean_volume,
    pressure_words,
    region_warnings,
    solid_volume,
    static_forecasts,
    supported_forecast,
    supported_pairs,
    touching_pairs,
)
from granflow.plan.plan import Forecast, Plan
from granflow.plan.stages import StageTimes, nominal_times
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import PlannedWall, surface_speed
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.insertions import TimedInsertion
from granflow.scene.blocks.motions import TimedMotion, poses_at
from granflow.scene.blocks.output import unit_of
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.walls.wall import Wall


def forecasts_of(plan: Plan) -> Iterator[Forecast]:
    """All forecasts that need no particles; `plan`: that of the scene, without forecasts."""
    overlaps = list(_overlap_forecasts(plan))
    yield from overlaps
    yield from vibration_forecasts(plan.scene)
    for sentence in _warnings(plan, overlaps):
        yield Forecast("", "", sentence, sentence)


def _overlap_forecasts(plan: Plan) -> Iterator[Forecast]:
    """The largest overlap for each cause that occurs."""
    pairs = list(touching_pairs(plan))
    supported = list(supported_pairs(plan))
    hitting = [*pairs, *(pair for pair, _weight in supported)]
    expected = forecast_velocity(plan)
    impact = impact_forecast(plan, hitting, expected.value, expected.source)
    if impact is not None and impact.warning is not None:  # the paths over the walls take time
        expected = path_velocity(plan)
        impact = impact_forecast(plan, hitting, expected.value, expected.source)
    if impact is not None:
        yield impact
    yield from static_forecasts(plan, pairs, bed_pressures(plan))
    below = supported_forecast(plan, supported)
    if below is not None:
        yield below


def _key_and_place(scene: Scene, *path: str | int) -> str:
    """A key and its place in the scene file."""
    return f"{'.'.join(map(str, path))} ({scene.where(*path)})"


def _warnings(plan: Plan, overlaps: Sequence[Forecast]) -> Iterator[str]:
    """The sentences on probable mistakes; `overlaps`: those to expect."""
    scene = plan.scene
    times = nominal_times(plan.stages)
    static = max((each.overlap for each in overlaps if each.cause != "impact"), default=0.0)
    impact = max((each.overlap for each in overlaps if each.cause == "impact"), default=0.0)
    yield from file_warnings(scene.particles, static, impact)
    yield from size_warnings(scene)
    for name, group in scene.particles.items():
        yield from group.shape.warnings(partial(_key_and_place, scene, "particles", name))
    yield from wall_warnings(scene, plan.walls, times)
    yield from coincidence_warnings(scene, plan.walls)
    yield from region_warnings(plan, times)
    yield from servo_warnings(plan, times)
    yield from insertion_warnings(plan, times)
    yield from flow_warnings(plan)
    yield from interval_warnings(scene, times)
    yield from unit_warnings(scene)
    yield from velocity_warnings(plan)


# Particles from files that overlap by more than loading and impacts explain.

OVERLAP_TOLERANCE = 1.5
"""Overlap of a file over the forecast one above which a warning appears."""
FILE_ROUNDING = 1e-3
"""Overlap over the radius that is never reported: positions in VTU files resolve 1e-4 of the smallest
radius."""


def file_warnings(particles: Mapping[str, Group], static: float, impact: float) -> Iterator[str]:
    """A sentence for each group from a file whose particles overlap more than the state of a bed explains.

    Overlaps over the smaller radius: `static` under weight, walls and cohesion; `impact` at the maximum
    velocity, for files with moving particles. Touching particles of a settled bed overlap and cause no
    warning.
    """
    for name, group in particles.items():
        found = group.insert.summary
        if found is None or group.fixed:
            continue
        explained = max(static, impact) if found.speed_max > 0.0 else static
        if found.overlap_max > max(OVERLAP_TOLERANCE * explained, FILE_ROUNDING):
            reason = (
                f"loading and impacts explain {explained:.3g}" if explained > 0.0 else "no force explains it"
            )
            yield (
                f"particles.{name}: particles in {group.insert.source} overlap by up to "
                f"{found.overlap_max:.3g} of the smaller radius ({found.overlap_rows}), but {reason}: they "
                "separate abruptly. Check the file."
            )


# Walls and diameters that are far larger than the domain or an inlet: probably a wrong unit.

LARGE_DIAMETER = 10.0
"""Diameter over the longest side of the domain above which a unit is probably wrong; large spheres serve as
walls."""
LARGE_WALL = 20.0
"""Dimension of a wall over the longest side of the domain above which a unit is probably wrong; walls can be
larger than the domain."""
MILLI = 1e-3


def size_warnings(scene: Scene) -> Iterator[str]:
    """A sentence for each group with particles that are larger than the domain, and for each wall that is
    much larger.

    Particles of inlets are compared with the face. Domains that expand have no size. Meshes have notes of
    their own, and faces of boxes are compared with the domain by their positions.
    """
    for path, sentence in _oversizes(scene):
        yield f"{'.'.join(path)} ({scene.where(*path)}) {sentence}"


def size_problems(scene: Scene) -> Iterator[str]:
    """The sentences of `size_warnings` in the form of errors."""
    for path, sentence in _oversizes(scene):
        yield f"{scene.locate(*path)}: {'.'.join(path)} {sentence}"


def _oversizes(scene: Scene) -> Iterator[tuple[tuple[str, ...], str]]:
    """Path of the key and rest of the sentence of each length that is too large."""
    side = _longest_side(scene)
    domain = f"the longest side of the domain, {side:.3g} m"
    for name, group in scene.particles.items():
        diameter = group.outer_diameters[1]
        path = ("particles", name, "diameter")
        place = group.insert.place
        width = inf if place is None else place.opening
        if diameter > width:
            where = f"{group.insert.place_key} of the {group.insert.kind}"
            face = f"larger than the {where}, which is {width:.3g} m wide"
            yield path, f"is {diameter:.3g} m, {face}. {_likely_unit(diameter, width)}"
        elif diameter > LARGE_DIAMETER * side and scene.domain.on_exit != "expand":
            yield (
                path,
                f"is {diameter:.3g} m, {diameter / side:.0f} times {domain}. {_likely_unit(diameter, side)}",
            )
    for name, wall in scene.walls.items():
        if large := oversized(scene, name, wall):
            key, length = large
            rest = f"is {length:.3g} m, {length / side:.0f} times {domain}. {_likely_unit(length, side)}"
            yield ("walls", name, key), rest


def oversized(scene: Scene, name: str, wall: Wall) -> tuple[str, float] | None:
    """Key and length [m] of the largest dimension of a wall if it is much larger than the domain."""
    if scene.domain.on_exit == "expand" or "." in name:
        return None
    key, length = max(wall.dimensions(), key=lambda each: each[1], default=("", 0.0))
    return (key, length) if length > LARGE_WALL * _longest_side(scene) else None


def _longest_side(scene: Scene) -> float:
    return max(high - low for low, high in zip(scene.domain.min, scene.domain.max, strict=True))


def _likely_unit(length: float, limit: float) -> str:
    """Instruction for a length [m] above a limit [m]: the same number in mm, if that is below the limit."""
    if MILLI * length > limit:
        return "Check the units of both."
    return f"Check the unit: {length:.3g} mm is {MILLI * length:.3g} m."


# Walls that are far outside the domain, walls that leave it, and coincident walls.

POINTS_PER_AXIS = 13
"""Points along each axis of the domain at which the distance from a wall is computed."""
SAME_CORNER = 1e-6
"""Distance of corners over the size of a wall below which they are the same."""
TIMES_OF_RUN = 40
"""Times of the run at which the position of a moving wall is computed."""


def wall_warnings(scene: Scene, walls: Sequence[PlannedWall], times: StageTimes) -> Iterator[str]:
    """A sentence for each wall that no particle can touch, or that leaves the domain without an end of its
    motion.

    Domains that expand have no outside. Meshes outside the domain have notes of their own, and walls that are
    much larger than the domain are reported by `size_warnings`.
    """
    if scene.domain.on_exit == "expand":
        return
    for wall in walls:
        if oversized(scene, wall.name, wall.spec):
            continue
        endless = _is_endless(scene, wall)
        if wall.spec.has_notes and not endless:
            continue
        if _wall_gaps(scene, wall, times, 1)[0] <= 0.0 and not endless:
            continue
        gap = _wall_gaps(scene, wall, times, TIMES_OF_RUN if wall.motions else 1)
        if (gap > 0.0).all():
            yield _outside_text(scene, wall, float(gap.min()))
        elif gap[-1] > 0.0 and endless:
            yield _leaving_text(scene, wall, times, gap)


def _wall_gaps(scene: Scene, wall: PlannedWall, times: StageTimes, count: int) -> np.ndarray:
    """Lower bound of the gap [m] between the wall and the nearest particle in the domain, at `count` times of
    the run.

    The centers of particles are anywhere in the domain. Of points at a spacing h, one is within h sqrt(3)/2
    of the nearest center. The first time is that at which the wall appears, the last one the end of the run.
    """
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    axes = [np.linspace(*span, POINTS_PER_AXIS) for span in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = 0.5 * float(np.linalg.norm((high - low) / (POINTS_PER_AXIS - 1)))
    reach += 0.5 * max(group.outer_diameters[1] for group in scene.particles.values())
    end = max(stage_end for _, stage_end in times.values())
    poses = poses_at(
        [each.at(times) for each in wall.motions], np.linspace(present_from(wall, times), end, count)
    )
    gaps = []
    for offset, rotation in zip(poses.offset, poses.rotation, strict=True):
        local = (points - poses.pivot - offset) @ rotation + poses.pivot
        gaps.append(float(np.abs(wall.surface.distances(local, reach)).min()) - reach)
    return np.array(gaps)


def present_from(wall: PlannedWall, times: StageTimes) -> float:
    """Time [s] at which a wall appears; infinite if it never does."""
    started = [times[name][0] for name in wall.spec.stages or times if name in times]
    return max(wall.spec.start_time, min(started, default=np.inf))


def _outside_text(scene: Scene, wall: PlannedWall, gap: float) -> str:
    low, high = scene.domain.min, scene.domain.max
    size = " x ".join(f"{b - a:.3g}" for a, b in zip(low, high, strict=True))
    return (
        f"walls.{wall.name} ({scene.where('walls', wall.name)}) is at least {gap:.3g} m outside the domain "
        f"of {size} m: no particle can be in contact with it. Check the units of its lengths, or enlarge the "
        "domain."
    )


def _is_endless(scene: Scene, wall: PlannedWall) -> bool:
    """Whether a wall is present and translates until the run ends, without limits of its time."""
    return wall.spec.is_permanent and any(each.is_endless for each in wall.spec.motion)


def _leaving_text(scene: Scene, wall: PlannedWall, times: StageTimes, gap: np.ndarray) -> str:
    """Sentence on a wall that leaves the domain; `gap` (k,) [m] at times of the run."""
    end = max(stage_end for _, stage_end in times.values())
    last = int(np.flatnonzero(gap <= 0.0)[-1])
    left = np.linspace(present_from(wall, times), end, len(gap))[min(last + 1, len(gap) - 1)]
    return (
        f"walls.{wall.name} ({scene.where('walls', wall.name, 'motion')}) leaves the domain: after "
        f"{left:.3g} s of {end:.3g} s no particle can be in contact with it. If this is intended, give its "
        "motion an end or the wall vanishes_at."
    )


def coincidence_warnings(scene: Scene, walls: Sequence[PlannedWall]) -> Iterator[str]:
    """A sentence for each wall with the surface of another one that moves and is present like it.

    Particles are in contact with the first one only, see `engine.walls.JoinedWalls`.
    """
    for first, second in combinations(walls, 2):
        is_alike = first.motions == second.motions and all(
            getattr(first.spec, name) == getattr(second.spec, name)
            for name in ("stages", "start_time", "end_time")
        )
        if is_alike and first.surface.has_same_place(second.surface):
            yield (
                f"walls.{second.name} ({scene.where('walls', second.name)}) has the same surface as "
                f"walls.{first.name}: particles are in contact with walls.{first.name} only, and its "
                "material counts. Remove one of the two."
            )


# Servo walls that cannot reach the bed, and so their force, in the time of their motion.

LOOSEST = 0.45
"""Smallest solid fraction of a bed of clumps or of cohesive particles at rest."""
LOOSE = 0.55
"""Solid fraction of a random loose packing of spheres, without the last layer."""
SAMPLES_ALONG = 400
"""Points along the path of a servo at which its distance from other walls is computed."""
ALONG_GRAVITY = 1e-6
"""Largest deviation of the direction of a servo from that of gravity, as the cosine of their angle."""


def servo_warnings(plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for the first servo of each wall, if its travel is shorter than its distance from the bed.

        v t < L - V / (phi A) - d,     v = min(v_max, gain F)

    v: velocity of a servo without contacts; t: time of its motion; L: distance along its direction to the
    next wall or the end of the domain; V: volume of all particles, which fill at most the height V / (phi A)
    above that wall with a loose solid fraction phi over the area A of the servo; d: largest diameter, of
    particles on the surface of the bed. A bed beyond the edges of the servo is lower: the distance is a lower
    bound. Servos across gravity can touch the side of a bed, and other motions before a servo move its wall:
    neither has a forecast.
    """
    for name in dict.fromkeys(motion.name for motion in plan.controlled_motions):
        motions = [each for each in plan.controlled_motions if each.name == name]
        given = plan.scene.walls[name].motion
        area = plan.walls[motions[0].wall].surface.area
        if area is None or not all(each.follows_force for each in given):
            continue
        first = min(motions, key=lambda each: _servo_span(given[each.motion], times)[0])
        if not _is_along(plan.scene.gravity, first):
            continue
        distance = _distance_from_bed(plan, first, area)
        duration = _servo_span(given[first.motion], times)[1]
        velocity, limit = first.spec.approach(first.numbers, first.force)
        if velocity * duration < distance:
            yield (
                f"walls.{name}.motion ({first.source}): the {first.spec.kind} moves at most "
                f"{velocity * duration:.3g} m ({velocity:.3g} m/s, {limit}, for {duration:.3g} s), but the "
                f"bed is about {distance:.3g} m away: it does not reach {first.force:.3g} N. "
                f"{first.spec.remedy_of_distance(first.numbers, distance, duration)}"
            )


def _is_along(gravity: Sequence[float], motion: ControlledMotion) -> bool:
    """Whether a servo moves along gravity, or there is none."""
    magnitude = float(np.linalg.norm(gravity))
    return abs(float(np.dot(gravity, motion.direction))) >= (1.0 - ALONG_GRAVITY) * magnitude


def _servo_span(given: TimedMotion, times: StageTimes) -> tuple[float, float]:
    """Start [s] of a servo, and the time [s] in which it is active."""
    end = max(end for _, end in times.values())
    if given.stages is not None:
        start = times[given.stages[0]][0]
        return start, times[given.stages[-1]][1] - start
    start = given.start or 0.0
    return start, max(min(given.end if given.end is not None else inf, end) - start, 0.0)


def _distance_from_bed(plan: Plan, motion: ControlledMotion, area: float) -> float:
    """Distance [m] of a servo with an area [m2] from the bed."""
    scene = plan.scene
    is_loose = plan.laws.cohesion is not None or any(
        group.shape.packs_loosely for group in scene.particles.values()
    )
    height = solid_volume(scene.particles) / ((LOOSEST if is_loose else LOOSE) * area)
    layer = max(group.outer_diameters[1] for group in scene.particles.values())
    return _free_path(scene.domain, plan.walls, motion) - height - layer


def _free_path(domain: Domain, walls: Sequence[PlannedWall], motion: ControlledMotion) -> float:
    """Distance [m] from the center of a servo wall along its direction to the next wall or the end of the
    domain."""
    direction = np.array(motion.direction)
    low, high = np.array(domain.min), np.array(domain.max)
    center = walls[motion.wall].surface.triangles(0.5 * (low + high), 0.0)[0].mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = np.where(direction > 0.0, (high - center) / direction, (low - center) / direction)
    length = float(np.min(exits[np.abs(direction) > 0.0], initial=np.inf))
    if not np.isfinite(length) or length <= 0.0:
        return 0.0
    steps = np.linspace(0.0, length, SAMPLES_ALONG)
    points = center + steps[:, None] * direction
    spacing = length / (SAMPLES_ALONG - 1)
    for index, wall in enumerate(walls):
        if index != motion.wall:
            near = np.flatnonzero(np.abs(wall.surface.distances(points, spacing)) <= spacing)
            length = min(length, float(steps[near[0]])) if len(near) else length
    return length


# Insertions: runs that are too short, rates too high for a face or region, inlets turned backward.

DENSEST_FLOW = 0.45
"""Solid fraction that the flow out of an inlet does not exceed.

Random sequential packings reach 0.38. Free fall from a disc of 10 diameters has 0.40, from one of 1.5
diameters 0.25.
"""
ALONG_FACE = 1e-3
"""Component along the normal over the magnitude below which a vector is parallel to a face: decimals are
rounded."""


def insertion_warnings(plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for each rain or inlet that begins when the run has ended; a run that ends earlier than the
    flow is normal."""
    end = max(end for _, end in times.values())
    for name, group in plan.scene.particles.items():
        if isinstance(group.insert, TimedInsertion) and group.insert.start >= end:
            yield (
                f"particles.{name}.insert ({plan.scene.where('particles', name, 'insert')}): the insertion "
                f"starts at {group.insert.start:.3g} s, but the run ends at {end:.3g} s: no particle is "
                "inserted. Start earlier, or extend the run."
            )


def flow_warnings(plan: Plan) -> Iterator[str]:
    """A sentence for each inlet through which, or rain from whose region, fewer particles than required can
    flow."""
    scene = plan.scene
    for name, group in scene.particles.items():
        insertion = group.insert
        if not isinstance(insertion, TimedInsertion):
            continue
        interval = _insertion_interval(plan, group, insertion)
        if insertion.one_way and (sentence := _wrong_direction(plan, name, insertion)):
            yield sentence
            continue
        largest, held = _largest_flow(scene, group, insertion, interval)
        key = f"particles.{name}.insert ({scene.where('particles', name, 'insert')})"
        place = insertion.place_key
        is_small = insertion.one_way or group.count * (1.0 - interval * largest) > held
        also = "" if insertion.one_way else f", which holds {held:.2g}"
        if is_small and 1.0 / interval > largest > 0.0:
            yield (
                f"{key}: {1.0 / interval:.3g} particles per second are required, but at most about "
                f"{largest:.2g} leave the {place} in a second{also}; the others are queued. Enlarge the "
                f"{place}, raise particles.{name}.velocity, or lower the "
                f"{insertion.flow_key}."
            )
        elif is_small and not largest and not insertion.one_way and _nothing_moves(plan, group):
            yield (
                f"{key}: {group.count} particles are required, but the region holds at most about "
                f"{held:.2g}, and neither gravity nor particles.{name}.velocity moves them out; the others "
                "are queued. Enlarge the region, or lower the count."
            )


def _insertion_interval(plan: Plan, group: Group, insertion: TimedInsertion) -> float:
    """Mean time [s] between two particles."""
    return insertion.interval(mean_volume(group) * plan.scene.materials[group.material].density)


def _nothing_moves(plan: Plan, group: Group) -> bool:
    """Whether neither walls nor a granular temperature move new particles without gravity and velocity."""
    return group.thermal is None and not any(wall.motions for wall in plan.walls)


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
    gravity = np.array(scene.gravity, float)
    gathered = ceil(group.count / MAX_BATCHES) * interval
    region = insertion.region_for(0.5 * group.outer_diameters[1], velocity, gathered)
    normal, depth, area, width = region.face(gravity if gravity.any() else velocity)
    initial = float(velocity @ normal)
    falling = float(gravity @ normal)
    if insertion.one_way:
        initial = max(initial, 0.0)
        falling = max(falling, 0.0)
    else:
        initial = abs(initial)
        falling = abs(falling)
    along = sqrt(initial**2 + 2.0 * falling * depth)
    slide = float(np.linalg.norm(gravity - (gravity @ normal) * normal))
    across = sqrt(float(np.sum((velocity - (velocity @ normal) * normal) ** 2)) + 2.0 * slide * width)
    outer = group.shape.outer_diameter
    volume = mean_volume(group) if outer is None else sphere_volume(0.5 * outer)
    flow = area * along + width * depth * across
    return DENSEST_FLOW * float(flow) / volume, DENSEST_FLOW * region.volume / volume


def _wrong_direction(plan: Plan, name: str, insertion: TimedInsertion) -> str:
    """A sentence on an inlet that new particles leave backward or not at all; empty if they move into the
    scene.

    The velocity decides, and gravity if the velocity has no component along the normal. The proposed velocity
    is the given one with the opposite component, or with the smallest one that is sufficient for the rate.
    """
    scene = plan.scene
    group = scene.particles[name]
    velocity = np.array(group.velocity, float)
    gravity = np.array(scene.gravity, float)
    region = insertion.region_for(0.5 * group.outer_diameters[1], np.zeros(3))
    normal, _, area, _ = region.face(velocity)
    through = _through(velocity, normal)
    along = _through(gravity, normal)
    if through > 0.0 or (through == 0.0 and along > 0.0):
        return ""
    is_still = not velocity.any()
    if along == 0.0 and through == 0.0 and group.thermal is not None:
        return ""
    if is_still and along == 0.0 and (gravity.any() or not _nothing_moves(plan, group)):
        return ""
    needed = mean_volume(group) / (_insertion_interval(plan, group, insertion) * DENSEST_FLOW * area)
    speed = float(f"{1.5 * needed:.1g}") if through == 0.0 else -2.0 * float(velocity @ normal)
    if through < 0.0:
        fault = "points against it, so that they leave backward through the face"
    elif along < 0.0:
        fault = "has no component along it, so that gravity moves them backward through the face"
    else:
        fault = "has no component along it, so that they do not leave the face along its normal"
    remedy = ""
    if insertion.place is not None and (through < 0.0 or along < 0.0):
        remedy = f", or {insertion.place.reversal}"
    key = f"particles.{name}.velocity ({scene.where('particles', name, 'velocity')})"
    return (
        f"{key} is {_velocity_text(velocity)} m/s, but particles enter through the face of the inlet along "
        f"{_velocity_text(normal)}: the velocity {fault}. Give a velocity such as "
        f"{_velocity_text(velocity + speed * normal)} m/s{remedy}."
    )


def _through(vector: np.ndarray, normal: np.ndarray) -> float:
    """Component of a vector along a normal; 0 for a vector that is parallel to the face within rounding."""
    component = float(vector @ normal)
    return 0.0 if abs(component) <= ALONG_FACE * float(np.linalg.norm(vector)) else component


def _velocity_text(values: np.ndarray) -> str:
    """Three numbers in the form of the scene."""
    return "[" + ", ".join(f"{each + 0.0:.3g}" for each in np.round(values, 12)) + "]"


# Output intervals that are longer than the run, or that show a vibration at two phases only.

PERIOD_TOLERANCE = 0.01
"""Largest relative deviation of an interval from an odd multiple of half a period."""
FRAMES_PER_PERIOD = 8
"""Number of frames per period that a message suggests."""
COARSE = 0.25
"""Interval over the period above which frames do not resolve a vibration."""


def interval_warnings(scene: Scene, times: StageTimes) -> Iterator[str]:
    """A sentence on an output interval above the duration of the run."""
    longest = max(end for _, end in times.values())
    if scene.output.interval > longest:
        yield (
            f"output.interval ({scene.where('output', 'interval')}) is {scene.output.interval:g} s, but the "
            f"run lasts at most {longest:g} s: only the first and the last state are written. Choose a "
            "shorter interval."
        )


def vibration_forecasts(scene: Scene) -> Iterator[Forecast]:
    """Frames per period of each vibration with less than four, and warnings on stroboscopic intervals.

        interval = (n + 1/2) T within 1 %:     sin(w t + phase) has the values +- sin(phase) only

    With the default phase of 0, the wall is at the same position in all frames. Multiples of the whole period
    are often intended, because they show the slow motion of a bed.
    """
    for period, name in _vibration_periods(scene).items():
        wall = f"walls.{name}.motion ({scene.where('walls', name, 'motion')})"
        for output, interval in _output_intervals(scene):
            ratio = interval / period
            if ratio <= COARSE * (1.0 + PERIOD_TOLERANCE):
                continue
            half_periods = round(2.0 * ratio)
            is_odd = half_periods % 2 == 1 and abs(2.0 * ratio / half_periods - 1.0) <= PERIOD_TOLERANCE
            warning = (
                f"{'.'.join(output)} ({scene.where(*output)}) is {interval:.4g} s, "
                f"{0.5 * half_periods:g} times the period {period:.4g} s of {wall}: the output shows "
                "this motion at two opposite phases only, which can be the same position of the wall. Set "
                f"the interval to {period / FRAMES_PER_PERIOD:.3g} s or less, {FRAMES_PER_PERIOD} times per "
                f"period, or to {period:.4g} s for one fixed phase."
            )
            remark = f"{'.'.join(output)}, of the period {period:.4g} s of {wall}"
            yield Forecast(
                "vibration in the output",
                f"{1.0 / ratio:.3g} per period",
                remark,
                warning if is_odd else None,
            )


def _vibration_periods(scene: Scene) -> dict[float, str]:
    """Each period [s] of the vibrations, with the name of the first wall."""
    found: dict[float, str] = {}
    for name, wall in scene.walls.items():
        for motion in wall.motion:
            if motion.oscillates:
                found.setdefault(motion.numeric(scene.gravity).period, name)
    found.pop(inf, None)
    return found


def _output_intervals(scene: Scene) -> Iterator[tuple[tuple[str, ...], float]]:
    """Paths of the keys of the output intervals, and the intervals [s]; those that are not given are
    `interval`."""
    yield ("output", "interval"), scene.output.interval
    if scene.is_given("output", "timeseries_interval"):
        yield ("output", "timeseries_interval"), scene.output.timeseries_interval
    for name, grid in scene.output.fields.items():
        if grid.interval is not None:
            yield ("output", "fields", name, "interval"), grid.interval


# Values that are possible, but probably have a wrong unit.

LIGHTEST = 20.0
"""Density [kg/m3] of light foams. There is no upper limit: scaled densities are common."""
MOST_FRICTION = 5.0
"""Coefficient of friction above that of all granular materials."""
FASTEST_SURFACE = 10.0
"""Surface speed of a wall [m/s] above that of drums, mixers and conveyors."""


def unit_warnings(scene: Scene) -> Iterator[str]:
    """A sentence for each density, friction, surface speed and expected angle that suggests another unit."""
    for name, material in scene.materials.items():
        if material.density < LIGHTEST:
            where = scene.where("materials", name, "density")
            yield (
                f"materials.{name}.density ({where}) is {material.density:.3g} kg/m3, less than light foams: "
                "check the unit (2.5 g/cm3 is 2500 kg/m3)."
            )
    yield from _too_hard(scene)
    yield from _unused_cohesion(scene)
    for name, pair in scene.pairs.items():
        if pair.friction > MOST_FRICTION:
            yield (
                f"pairs.{name}.friction ({scene.where('pairs', name, 'friction')}) is {pair.friction:.3g}: "
                "it is a coefficient, the tangent of the friction angle, such as 0.5."
            )
    yield from _speed_warnings(scene)
    for index, each in enumerate(scene.expect):
        bounds = [*(each.between or ()), each.below, each.above, each.equals]
        largest = max((abs(bound) for bound in bounds if bound is not None), default=0.0)
        if unit_of(each.quantity) == "rad" and largest > pi:
            yield (
                f"expect[{index}] ({scene.where('expect', str(index))}): {each.quantity} is in rad, and the "
                f"bound is {largest:.3g} rad. Write degrees with the unit, such as 25 deg."
            )


def _too_hard(scene: Scene) -> Iterator[str]:
    """A sentence for each material of mobile particles that is harder than diamond.

    Walls and fixed particles of such a material are rigid, which is often intended.
    """
    for name in dict.fromkeys(group.material for group in scene.particles.values() if not group.fixed):
        modulus = scene.materials[name].young_modulus
        if modulus > HARDEST:
            yield (
                f"materials.{name}.young_modulus ({scene.where('materials', name, 'young_modulus')}) is "
                f"{pressure_words(modulus)}, more than that of diamond: check the unit (1 N/mm2 is 1 MPa)."
            )


def _unused_cohesion(scene: Scene) -> Iterator[str]:
    """A sentence on the parameters of a cohesion that is switched off."""
    if scene.contact.name("cohesion") != "none":
        return
    for key in registry.pair_properties():
        models = registry.models_with(key)
        names = [name for name, pair in scene.pairs.items() if getattr(pair, key)]
        if list(models) == ["cohesion"] and names:
            yield (
                f"pairs.{names[0]}.{key} ({scene.where('pairs', names[0], key)}) is not used, "
                f"because contact.cohesion is none; {' or '.join(models['cohesion'])} would use it."
            )


def _speed_warnings(scene: Scene) -> Iterator[str]:
    """A sentence on the fastest wall, if angular velocities are probably not in rad/s."""
    rotating = [
        name
        for name, wall in scene.walls.items()
        if any(hasattr(each, "angular_velocity") for each in wall.motion)
    ]
    if rotating and (speed := surface_speed(scene)) > FASTEST_SURFACE:
        name = rotating[0]
        yield (
            f"walls.{name}.motion ({scene.where('walls', name, 'motion')}): walls move at up to {speed:.3g} "
            "m/s. Angular velocities are in rad/s: write 30 rpm or 180 deg/s with the unit."
        )
