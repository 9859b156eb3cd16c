"""Snapshots: the state of a simulation at one time as read-only numpy arrays in SI units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from granflow.fields import (
    CONTACT_QUANTITIES,
    ENERGY_BUDGET_QUANTITIES,
    PARTICLE_QUANTITIES,
    quantity_of,
)
from granflow.visible_text import html_table, numbered, readable

PARTICLES = "particles"
CONTACTS = "contacts"
WALLS = "walls"
TOTALS = "totals"
PARTS = frozenset({PARTICLES, CONTACTS, WALLS, TOTALS})
"""Parts of a snapshot that an observer or a metric can request."""


@dataclass(frozen=True, eq=False)
class WallPose:
    """Pose of a wall: a point p at rest moves to `rotation @ (p - pivot) + pivot + offset`.

    present:           False before a wall appears and after it vanishes
    offset:            (3,) [m]
    rotation:          (3, 3)
    pivot:             (3,) [m]
    surface_velocity:  (3,) [m/s] of a belt, before the projection on a contact plane

    The arrays are read-only.
    """

    present: bool
    offset: np.ndarray
    rotation: np.ndarray
    pivot: np.ndarray
    surface_velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("offset", "rotation", "pivot", "surface_velocity"):
            object.__setattr__(self, name, _read_only(getattr(self, name)))

    @classmethod
    def at_rest(cls, present: bool = True) -> "WallPose":
        """Return the pose of a wall that has not moved."""
        return cls(present, np.zeros(3), np.eye(3), np.zeros(3))

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Return the current positions (n, 3) [m] of points at rest (n, 3) [m]."""
        return (points - self.pivot) @ self.rotation.T + self.pivot + self.offset

    def __reduce__(self) -> tuple[Any, ...]:
        # An array is writable when it is unpickled: the constructor makes it read-only.
        return WallPose, (self.present, self.offset, self.rotation, self.pivot, self.surface_velocity)


def body_ids(particles: Mapping[str, np.ndarray]) -> np.ndarray:
    """Id (n,) of the body of each sphere: of the first sphere of its clump, or its own."""
    own = particles["id"]
    clump = particles.get("clump", np.full(len(own), -1))
    return np.where(clump >= 0, clump, own)


def bodies_of(particles: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """The same arrays (n, ...) of particles with one row for each clump, in the order of the ids.

    A clump has the id, group, material and insertion time of its first sphere, the radius of its largest one,
    the contacts of all of them, and its own mass and center of mass, with the velocity there.
    """
    if "clump" not in particles:
        return particles
    _, first, body = np.unique(body_ids(particles), return_index=True, return_inverse=True)
    found = selected(particles, first)
    if "radius" in found:
        np.maximum.at(found["radius"], body, particles["radius"])
    for name in ("coordination_number", "wall_contact_count"):
        if name in found:
            found[name] = np.bincount(body, particles[name], len(first)).astype(int)
    for name in ("mass", "position", "velocity"):
        if name in found:
            clump = found["clump"] >= 0
            found[name][clump] = found[f"clump_{name}"][clump]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """State of a simulation at one time. `granflow.fields` defines keys, shapes and units.

    time:       simulated time [s]
    step:       number of completed steps; 0 in a frame from a file, which does not contain it
    stage:      name of the stage
    particles:  requested arrays (n,) or (n, 3) of `PARTICLE_QUANTITIES`, ordered by id; empty if none are
                requested. `material` and `group` are indices into those of the scene
    contacts:   arrays (c,) or (c, 3) of `CONTACT_QUANTITIES`, one entry per contact, and one with a negative
                overlap per separated pair with a cohesive force; None if not requested
    walls:      pose by name, in the order of the scene; empty if not requested
    totals:     numbers of `TOTAL_QUANTITIES`
    impulses:   time integrals since the start for each measured wall (8,): force [N s], torque [N m s] and
                normal force [N s] of the particles on the wall, power [J] of the wall on the particles
    collisions: numbers of collisions since the start by energy class (classes + 2,), for contacts with a
                "particle" and a "wall"; empty without `output.collision_energies`
    wear:       worn volume [m3], normal and tangential work [J] since the start (k, 3) of each worn wall: of
                each triangle of a mesh; one row for a wall of another shape
    removed:    `id` (k,) of the particles that stages or a program have removed since the start, and their
                `position` (k, 3) [m] then

    All arrays and mappings are read-only; an unknown name raises KeyError with those that exist.

    >>> snapshot = gf.read_run("out/two").frames[-1]
    >>> snapshot.particles["position"].shape, snapshot.stage
    ((2, 3), 'run')
    """

    time: float
    step: int
    stage: str
    particles: Mapping[str, np.ndarray]
    contacts: Mapping[str, np.ndarray] | None
    walls: Mapping[str, WallPose]
    totals: Mapping[str, float]
    impulses: Mapping[str, np.ndarray] = field(default_factory=dict)
    collisions: Mapping[str, np.ndarray] = field(default_factory=dict)
    wear: Mapping[str, np.ndarray] = field(default_factory=dict)
    removed: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "particles", _read_only_arrays("particles", self.particles))
        if self.contacts is not None:
            object.__setattr__(self, "contacts", _read_only_arrays("contacts", self.contacts))
        object.__setattr__(self, "walls", _read_only_mapping("walls", self.walls))
        object.__setattr__(self, "totals", _read_only_mapping("totals", self.totals))
        object.__setattr__(self, "impulses", _read_only_arrays("impulses", self.impulses))
        object.__setattr__(self, "collisions", _read_only_arrays("collisions", self.collisions))
        object.__setattr__(self, "wear", _read_only_arrays("wear", self.wear))
        object.__setattr__(self, "removed", _read_only_arrays("removed", self.removed))

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite; in an aborted run they may not be."""
        arrays = [*self.particles.values(), *(self.contacts or {}).values(), *self.impulses.values()]
        return all(np.isfinite(each).all() for each in [*arrays, np.array(list(self.totals.values()))])

    def __repr__(self) -> str:
        """One line: time [s], step, stage, number of particles and their arrays, contacts, walls."""
        count = max((len(values) for values in self.particles.values()), default=0)
        arrays = f" with {', '.join(self.particles)}" if self.particles else ""
        contacts = (
            "" if self.contacts is None else f", {len(next(iter(self.contacts.values()), ()))} contacts"
        )
        walls = f", {len(self.walls)} walls" if self.walls else ""
        step = f", step {self.step}" if self.step else ""
        stage = f", stage {self.stage}" if self.stage else ""
        return f"<Snapshot at {self.time:.4g} s{step}{stage}: {count} particles{arrays}{contacts}{walls}>"

    def _repr_html_(self) -> str:
        """Table for notebooks: each array with its shape, range and unit, and the totals."""
        rows = [("time", f"{self.time:.6g} s"), ("step", readable(self.step)), ("stage", self.stage)]
        for kind, arrays, known in (
            ("particles", self.particles, PARTICLE_QUANTITIES),
            ("contacts", self.contacts or {}, CONTACT_QUANTITIES),
        ):
            for name, values in arrays.items():
                unit = known[name].unit if name in known else "1"
                rows.append(
                    (f"{kind}[{name!r}]", f"{values.shape}{_range(values)}{f' {unit}' * (unit != '1')}")
                )
        rows.append(("walls", ", ".join(self.walls) or "none"))
        for name, number in self.totals.items():
            quantity = quantity_of(name)
            unit = "1" if quantity is None else quantity.unit
            rows.append((f"totals[{name!r}]", f"{readable(number)}{f' {unit}' * (unit != '1')}"))
        count = max((len(values) for values in self.particles.values()), default=0)
        return html_table(f"Snapshot of {numbered(count, 'particle')}", rows)

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only mappings cannot be pickled; worker processes return snapshots with plain dictionaries.
        contacts = None if self.contacts is None else dict(self.contacts)
        sums = dict(self.impulses), dict(self.collisions), dict(self.wear)
        plain = (dict(self.particles), contacts, dict(self.walls), dict(self.totals), *sums)
        return Snapshot, (self.time, self.step, self.stage, *plain)


_T = TypeVar("_T")


class _UnknownNameError(KeyError):
    """KeyError whose message is a sentence."""

    def __str__(self) -> str:
        return str(self.args[0])


class _Named(dict[str, _T]):
    """Contents of one mapping of a snapshot, `kind`; an unknown name raises KeyError with the known ones."""

    def __init__(self, kind: str, contents: Mapping[str, _T]) -> None:
        super().__init__(contents)
        self._kind = kind

    def __missing__(self, name: str) -> _T:
        remedy = f"the names are {', '.join(self)}" if self else "it is empty"
        if self._kind == "totals" and name in ENERGY_BUDGET_QUANTITIES:
            remedy = "set output.energy_budget to true"
        raise _UnknownNameError(f"snapshot.{self._kind} has no {name}; {remedy}.")


def _read_only_mapping(kind: str, contents: Mapping[str, _T]) -> Mapping[str, _T]:
    return MappingProxyType(_Named(kind, contents))


def _read_only_arrays(kind: str, arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Read-only mapping of read-only views."""
    return _read_only_mapping(kind, {name: _read_only(values) for name, values in arrays.items()})


def _read_only(values: np.ndarray) -> np.ndarray:
    """Read-only view of an array."""
    # A view, so that the original array stays writable.
    view = np.asarray(values).view()
    view.flags.writeable = False
    return view


def _range(values: np.ndarray) -> str:
    """Smallest and largest number of an array; empty for an empty array or one of texts."""
    if not values.size or values.dtype.kind not in "fiu":
        return ""
    return f", {values.min():.4g} to {values.max():.4g}"


# Subsets of the arrays of a snapshot


def mobile_particles(particles: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Return the arrays without fixed particles, which count as walls; the same arrays if the scene has
    none."""
    return selected(particles, particles["fixed"] == 0) if "fixed" in particles else particles


def touching(contacts: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays of contacts without separated pairs, which have a cohesive force at a distance."""
    return selected(contacts, contacts["overlap"] > 0.0)


def selected(arrays: Mapping[str, np.ndarray], mask: np.ndarray) -> dict[str, np.ndarray]:
    """Return the entries of all arrays (n, ...) for which `mask` (n,) is True, or with the indices in it."""
    return {name: values[mask] for name, values in arrays.items()}
