"""Builds the meters that `output.metrics` of a scene specifies."""

from collections.abc import Callable, Mapping

import numpy as np

from granflow.geometry.sphere import sphere_volume
from granflow.observers.base import CONTACTS, PARTICLES
from granflow.observers.coarse_graining.field_grid import CoarseGrid, grid_for
from granflow.observers.metrics.meter import MetricMeter
from granflow.observers.metrics.mixing import dropped_share, lacey_index
from granflow.observers.metrics.repose import slope_of_cone, slope_of_plane
from granflow.observers.metrics.segregation import random_intensity, segregation_intensity
from granflow.observers.metrics.structure import (
    MIN_CONTACTS,
    anisotropy,
    center_of_mass,
    coordination,
    fabric_tensor,
    sliding_share,
)
from granflow.observers.particle_selection import mobile_particles, selected, wall_contacts
from granflow.particles.regions import frame_along
from granflow.plan.plan import Plan
from granflow.scene.schema.analysis import (
    AnyMetric,
    CenterOfMassMetric,
    ContentMetric,
    FabricMetric,
    LaceyMetric,
    ProbeMetric,
    ReposeMetric,
    SegregationMetric,
    SlidingMetric,
    TwoComponentGrid,
)
from granflow.scene.schema.shapes import Box
from granflow.snapshot import Snapshot

COLUMN_WIDTH = 2.0
"""Edge of the columns in which the surface of a heap is determined, in largest diameters."""

DROPPED_SHARE = 0.1
"""Share of the particles of a component outside the cells of a Lacey index above which a remark reports it."""

NEEDS_PARTICLES, NEEDS_CONTACTS = frozenset({PARTICLES}), frozenset({CONTACTS})


def metric_meters(plan: Plan) -> dict[str, MetricMeter]:
    """Return a meter for each metric of the plan, by its name in `output.metrics`."""
    return {name: _metric_meter(plan, spec) for name, spec in plan.output.metrics.items()}


def _metric_meter(plan: Plan, spec: AnyMetric) -> MetricMeter:
    """Return the meter of one metric; the class of `spec` determines the kind."""
    if isinstance(spec, LaceyMetric):
        return _lacey_metric_meter(plan, spec)
    if isinstance(spec, SegregationMetric):
        return _segregation_meter(plan, spec)
    if isinstance(spec, ReposeMetric):
        return _repose_meter(plan, spec)
    if isinstance(spec, FabricMetric):
        return MetricMeter(lambda snapshot: _fabric(snapshot, spec.region), NEEDS_CONTACTS)
    if isinstance(spec, ContentMetric):
        return MetricMeter(lambda snapshot: _content(snapshot, spec.region), NEEDS_PARTICLES)
    if isinstance(spec, CenterOfMassMetric):
        return _center_of_mass_meter(plan, spec)
    if isinstance(spec, ProbeMetric):
        return MetricMeter(lambda snapshot: _probe(snapshot.particles, spec.id), NEEDS_PARTICLES)
    if isinstance(spec, SlidingMetric):
        names = [wall.name for wall in plan.walls]
        walls = None if spec.walls is None else [names.index(name) for name in spec.walls]
        return MetricMeter(lambda snapshot: sliding_share(snapshot.contacts or {}, walls), NEEDS_CONTACTS)
    return MetricMeter(lambda snapshot: _coordination(snapshot, spec.region), NEEDS_PARTICLES)


def _lacey_metric_meter(plan: Plan, spec: LaceyMetric) -> MetricMeter:
    """Return a meter of the Lacey index, with a remark if it excludes more than DROPPED_SHARE of a kind."""
    grid: CoarseGrid = grid_for(plan.domain, spec)
    is_kind_a = _first_component(plan, spec)
    dropped = 0.0

    def measure(snapshot: Snapshot) -> dict[str, float]:
        nonlocal dropped
        particles = mobile_particles(snapshot.particles)
        arguments = particles["position"], is_kind_a(particles), grid, spec.at_least
        dropped = dropped_share(*arguments)
        return {"lacey_index": lacey_index(*arguments)}

    def remark() -> str:
        if dropped <= DROPPED_SHARE:
            return ""
        return (
            f"the Lacey index excludes {dropped:.0%} of the particles of one component, because their cells contain "
            f"fewer than {spec.at_least} particles (at_least): increase cell, or use kind: segregation, which weights "
            "particles by volume and excludes no cell"
        )

    return MetricMeter(measure, NEEDS_PARTICLES, remark)


def _segregation_meter(plan: Plan, spec: SegregationMetric) -> MetricMeter:
    """Return a meter of the intensity of segregation."""
    grid: CoarseGrid = grid_for(plan.domain, spec)
    is_kind_a = _first_component(plan, spec)

    def measure(snapshot: Snapshot) -> dict[str, float]:
        particles = mobile_particles(snapshot.particles)
        volume = sphere_volume(particles["radius"].astype(float))
        arguments = particles["position"], volume, is_kind_a(particles), grid
        return {
            "segregation_intensity": segregation_intensity(*arguments),
            "segregation_intensity_random": random_intensity(*arguments),
        }

    return MetricMeter(measure, NEEDS_PARTICLES)


def _first_component(plan: Plan, spec: TwoComponentGrid) -> Callable[[Mapping[str, np.ndarray]], np.ndarray]:
    """Return the function that selects particles (n,): given groups or materials, or diameters below `smaller_than`."""
    names = [group.name for group in plan.groups]
    groups = [names.index(name) for name in spec.groups or ()]
    materials = [list(plan.solids).index(name) for name in spec.materials or ()]

    def is_first(particles: Mapping[str, np.ndarray]) -> np.ndarray:
        if spec.smaller_than is not None:
            return np.asarray(2.0 * particles["radius"] < spec.smaller_than)
        return np.isin(particles["group"], groups) | np.isin(particles["material"], materials)

    return is_first


def _center_of_mass_meter(plan: Plan, spec: CenterOfMassMetric) -> MetricMeter:
    """Return a meter of the center of mass [m] of the mobile particles of the given groups, by default of all."""
    names = [group.name for group in plan.groups]
    groups = [names.index(name) for name in spec.groups or names]

    def measure(snapshot: Snapshot) -> dict[str, float]:
        particles = mobile_particles(snapshot.particles)
        own = np.isin(particles["group"], groups)
        return center_of_mass(particles["position"][own], particles["mass"][own])

    return MetricMeter(measure, NEEDS_PARTICLES)


def _repose_meter(plan: Plan, spec: ReposeMetric) -> MetricMeter:
    """Return a meter of the angle of repose [rad]; the vertical is opposite to gravity, also if gravity is inclined.

    Particles with fewer than MIN_CONTACTS contacts are not part of the heap: one that rolls away on the floor has one.
    """
    upwards = -np.array(plan.gravity) / np.linalg.norm(plan.gravity)
    frame = frame_along(upwards)
    edge = COLUMN_WIDTH * 2.0 * plan.radius_max
    axis = None if spec.axis is None else (frame @ np.array(spec.axis))[:2]
    reason = ""

    def measure(snapshot: Snapshot) -> dict[str, float]:
        nonlocal reason
        particles = mobile_particles(snapshot.particles)
        contacts = particles["coordination_number"] + wall_contacts(particles)
        heap = selected(particles, (contacts >= MIN_CONTACTS) & _inside(particles["position"], spec.region))
        points = heap["position"].astype(float) @ frame.T
        if spec.surface == "cone":
            slope = slope_of_cone(points, heap["radius"], edge, axis)
        else:
            slope = slope_of_plane(points, heap["radius"], edge)
        reason = slope.reason
        return {"angle_of_repose": slope.angle, "angle_of_repose_error": slope.error}

    return MetricMeter(measure, NEEDS_PARTICLES, lambda: reason and f"the angle of repose is NaN: {reason}")


def _fabric(snapshot: Snapshot, region: Box | None) -> Mapping[str, float]:
    """Return the anisotropy and the diagonal of the fabric tensor of contacts with midpoints inside the region."""
    contacts = snapshot.contacts or {}
    middle = 0.5 * (contacts["position_i"] + contacts["position_j"])
    tensor = fabric_tensor(selected(contacts, _inside(middle, region)))
    parts = {f"fabric_{axis}{axis}": float(tensor[k, k]) for k, axis in enumerate("xyz")}
    return {"fabric_anisotropy": anisotropy(tensor)} | parts


def _coordination(snapshot: Snapshot, region: Box | None) -> Mapping[str, float]:
    """Return the coordination numbers of the mobile particles with centers inside the region."""
    particles = mobile_particles(snapshot.particles)
    inside = _inside(particles["position"], region)
    return coordination(particles["coordination_number"][inside], wall_contacts(particles)[inside])


def _content(snapshot: Snapshot, region: Box) -> Mapping[str, float]:
    """Return number, mass [kg] and volume [m3] of the mobile particles with centers inside the region."""
    particles = mobile_particles(snapshot.particles)
    selected_particles = selected(particles, _inside(particles["position"], region))
    volume = float(sphere_volume(selected_particles["radius"].astype(float)).sum())
    mass = float(selected_particles["mass"].astype(float).sum())
    return {"content_count": float(len(selected_particles["mass"])), "content_mass": mass, "content_volume": volume}


def _probe(particles: Mapping[str, np.ndarray], particle_id: int) -> Mapping[str, float]:
    """Return position [m], velocity [m/s] and angular velocity [rad/s] of a particle; NaN if it does not exist.

    Without friction, particles do not rotate and have the angular velocity 0.
    """
    own = np.flatnonzero(particles["id"] == particle_id)
    found: dict[str, float] = {}
    for name in ("position", "velocity", "angular_velocity"):
        values = particles.get(name, np.zeros_like(particles["velocity"]))[own]
        vector = values[0] if len(own) else np.full(3, np.nan)
        found |= {f"{name}_{axis}": float(vector[k]) for k, axis in enumerate("xyz")}
    return found


def _inside(points: np.ndarray, region: Box | None) -> np.ndarray:
    """Return whether points (n, 3) [m] are inside the region; True without a region."""
    if region is None:
        return np.ones(len(points), bool)
    above, below = points >= np.array(region.min), points <= np.array(region.max)
    return np.asarray(np.logical_and(above, below).all(axis=1))
