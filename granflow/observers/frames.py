"""The observers that write frames for ParaView: particles, contacts, walls and coarse-grained fields.

Each kind of frames is a subclass of `Frames`, which turns a snapshot into a mesh; the series writes it as
`STEM_NNNN.vtu`, and lists it in `STEM.pvd`. Quantities, units and types of the arrays are those of
`granflow.fields`.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granflow.fields import (
    CONTACT_QUANTITIES,
    FIELD_QUANTITIES,
    PARTICLE_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_ARRAY_QUANTITIES,
    WEAR_ARRAYS,
    units,
)
from granflow.geometry.coarse_grid import CoarseGrid, GaussianKernel
from granflow.geometry.mesh import triangle_areas
from granflow.io.checkpoint import CheckpointError
from granflow.io.files import BackgroundWriter
from granflow.io.frames import FrameSeries, Piece, piece_path
from granflow.io.vtu import Compression, VtuMesh, write_vtu
from granflow.observers.coarse_graining import (
    CONTACT_FIELDS,
    AccumulatedFields,
    accumulate,
    fields_from,
    of_bodies,
)
from granflow.observers.observer import ScheduledObserver
from granflow.scene.blocks.particle_shapes.shape import ParticleShape
from granflow.snapshot import CONTACTS, PARTICLES, TOTALS, WALLS, Snapshot

if TYPE_CHECKING:
    from granflow.engine.engine import Engine


class Frames(ScheduledObserver):
    """Base class of frames: a schedule and a series of files.

    Subclasses define `stem`, the start of the file names, `wants`, and `mesh`.

    directory:            of the files
    interval, start:      [s], of the frames, in simulated time
    writer, compression:  see `FrameSeries`
    """

    stem = ""

    def __init__(
        self,
        directory: Path,
        interval: float,
        start: float = 0.0,
        writer: BackgroundWriter | None = None,
        compression: Compression = "zlib",
    ) -> None:
        super().__init__(interval, start)
        self.series = FrameSeries(directory, self.stem, writer, compression)

    def observe(self, snapshot: Snapshot) -> None:
        """Write one frame, due or not; a second snapshot of the same time has no effect."""
        if snapshot.time != self._schedule.last_time:
            self.write(snapshot)
            self._schedule.mark_done(snapshot.time)

    def write(self, snapshot: Snapshot) -> None:
        """Write one frame."""
        self.series.write(self.mesh(snapshot), snapshot.time)

    def sync(self) -> None:
        """Flush the frames to the disk."""
        self.series.sync()

    def state_dict(self) -> dict[str, Any]:
        """Wait until the frames are written; return their list and number."""
        series = self.series
        series.wait()
        return super().state_dict() | {"frames": list(series.frames), "frame_count": series.frame_count}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the list of frames; the next frame follows them."""
        super().load_state_dict(saved)
        self.series.frames = [(time, name) for time, name in saved["frames"]]
        self.series.frame_count = saved["frame_count"]

    def truncate(self) -> None:
        """Remove the frames after the restored state."""
        self.series.truncate()

    def mesh(self, snapshot: Snapshot) -> VtuMesh:
        """Return the mesh of one frame. Raises NotImplementedError in the base class."""
        raise NotImplementedError


# Particles

POSITION_TOLERANCE = 1e-4
"""Largest rounding error of float32 positions over the smallest radius; above it, files contain float64
positions."""


class ParticleFrames(Frames):
    """`particles_NNNN.vtu`: one vertex per particle, with the arrays of the snapshot.

    reach:   largest absolute coordinate [m] (from the domain), which determines whether float32 positions
             resolve POSITION_TOLERANCE; None: the positions of each frame determine it
    engine:  of MPI ranks, of which each writes its particles into a file of its own; a frame is then
             `particles_NNNN.pvtu`, and requires no snapshot of the particles. None: one file
    totals:  names of totals that are written as field data, such as the widths of a deforming box
    """

    stem = "particles"

    def __init__(
        self,
        directory: Path,
        interval: float,
        start: float = 0.0,
        writer: BackgroundWriter | None = None,
        reach: float | None = None,
        engine: "Engine | None" = None,
        compression: Compression = "zlib",
        totals: Sequence[str] = (),
    ) -> None:
        super().__init__(directory, interval, start, writer, compression)
        self._reach = reach
        self._engine = engine
        self._totals = totals
        self.wants = frozenset({PARTICLES} if engine is None else ()) | ({TOTALS} if totals else set())

    def write(self, snapshot: Snapshot) -> None:
        """Write one frame."""
        if self._engine is None:
            super().write(snapshot)
        else:
            self.series.write_pieces(partial(self._write_pieces, self._engine), snapshot.time)

    def _write_pieces(self, engine: "Engine", directory: Path, frame: str) -> Sequence[Piece]:
        """Let each MPI rank write its particles into `FRAME.RANK.vtu`. Raises OSError."""
        task = partial(_write_piece, directory=directory.absolute(), frame=frame, reach=self._reach)
        return engine.on_each_rank(task)

    def mesh(self, snapshot: Snapshot) -> VtuMesh:
        """Return the mesh of one frame, see `particle_mesh`."""
        position = snapshot.particles["position"]
        radius = snapshot.particles["radius"]
        reach = self._reach if self._reach is not None else np.abs(position).max(initial=0.0)
        mesh = particle_mesh(snapshot.particles, reach, radius.min(initial=np.inf))
        numbers = {name: snapshot.totals[name] for name in self._totals}
        stated = {name: TOTAL_QUANTITIES[name].unit for name in self._totals}
        return replace(mesh, numbers=numbers, units={**mesh.units, **stated})


def particle_mesh(particles: Mapping[str, np.ndarray], reach: float, radius_min: float) -> VtuMesh:
    """Return the mesh of particles, with `diameter` [m] and `kinetic_energy` [J] computed from other arrays.

    `reach` [m]: largest absolute coordinate; `radius_min` [m]: smallest radius of all particles of the frame.
    """
    particles = _with_derived(particles)
    resolved = 0.5 * np.spacing(np.float32(reach)) <= POSITION_TOLERANCE * radius_min
    arrays = {
        name: field.for_file(particles[name])
        for name, field in PARTICLE_QUANTITIES.items()
        if field.displayed and name in particles
    }
    points = particles["position"].astype(np.float32 if resolved else np.float64)
    return VtuMesh.of_points(points, arrays, units(PARTICLE_QUANTITIES))


def _with_derived(particles: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays of a snapshot with `diameter` [m] and, given mass and velocity, `kinetic_energy` [J]
    (n,)."""
    arrays = dict(particles)
    arrays["diameter"] = 2 * arrays["radius"]
    if "mass" in arrays and "velocity" in arrays:
        arrays["kinetic_energy"] = 0.5 * arrays["mass"] * (arrays["velocity"] ** 2).sum(axis=1)
    return arrays


def _write_piece(engine: "Engine", rank: int, directory: Path, frame: str, reach: float | None) -> Piece:
    """On one MPI rank: write the file of its particles for a frame.

    reach:  [m], as in `ParticleFrames`; None: that of the particles of all ranks
    """
    particles = engine.own_particles()
    ranks = engine.state.ranks
    radius_min = -ranks.largest(-particles["radius"].min(initial=np.inf))
    if reach is None:
        reach = ranks.largest(np.abs(particles["position"]).max(initial=0.0))
    mesh = particle_mesh(particles, reach, radius_min)
    path = piece_path(directory, frame, rank)
    write_vtu(path, mesh, engine.plan.scene.output.compression)
    return Piece.of(path.name, mesh)


# Contacts

_CONTACT_POINTS = ("position_i", "position_j")
"""Arrays of contacts that become the points of the mesh."""


class ContactFrames(Frames):
    """`contacts_NNNN.vtu`: one line per contact from center to center (or to the contact point on a wall).

    `history_units`: units of the history fields of the contact models, by name.
    """

    wants = frozenset({CONTACTS})
    stem = "contacts"

    def __init__(
        self,
        directory: Path,
        interval: float,
        start: float = 0.0,
        writer: BackgroundWriter | None = None,
        history_units: Mapping[str, str] | None = None,
        compression: Compression = "zlib",
    ) -> None:
        super().__init__(directory, interval, start, writer, compression)
        self._units = {**(history_units or {}), **units(CONTACT_QUANTITIES)}

    def mesh(self, snapshot: Snapshot) -> VtuMesh:
        """Return the mesh of one frame: 2 k points (float64) and k lines for k contacts.

        Arrays: CONTACT_QUANTITIES, and history fields of contact models.
        """
        contacts = snapshot.contacts or {}
        ends = [
            np.asarray(contacts.get(name, np.zeros((0, 3))), dtype=np.float64) for name in _CONTACT_POINTS
        ]
        points = np.stack(ends, axis=1).reshape(-1, 3)
        lines = np.arange(len(points)).reshape(-1, 2)
        arrays = {
            name: quantity.for_file(contacts[name])
            for name, quantity in CONTACT_QUANTITIES.items()
            if name in contacts and name not in _CONTACT_POINTS
        }
        histories = {
            name: contacts[name].astype(np.float32) for name in contacts if name not in CONTACT_QUANTITIES
        }
        return VtuMesh.of_cells("line", points, lines, arrays | histories, self._units)


# Walls


class WallFrames(Frames):
    """`walls_NNNN.vtu`: the triangles of the present walls at their current position.

    triangles:  name -> (points at rest (m, 3) [m], corners (k, 3)), in the order of the scene; the cell array
                `wall` is the index of the wall in that order, and the field data `wall.NAME` has it for
                each name
    measured:   areas [m2] of the walls with measured forces, None for an infinite wall; the cell arrays
                `traction` and `pressure` [Pa] are their instantaneous values
    unbounded:  names of infinite walls, whose triangles remain in the domain
    has_belts:  write the cell array `surface_velocity` [m/s], which is 0 on walls without one
    wear_areas: areas (k,) [m2] of the rows of `Snapshot.wear` of each wall with wear, None for an infinite
                wall; the cell arrays are WEAR_ARRAYS
    temperatures:  [K] of the walls that have one; the cell array `temperature` is NaN on the others
    """

    stem = "walls"

    def __init__(
        self,
        directory: Path,
        interval: float,
        triangles: Mapping[str, tuple[np.ndarray, np.ndarray]],
        start: float = 0.0,
        writer: BackgroundWriter | None = None,
        measured: Mapping[str, float | None] | None = None,
        unbounded: Collection[str] = (),
        has_belts: bool = False,
        wear_areas: Mapping[str, np.ndarray | None] | None = None,
        temperatures: Mapping[str, float] | None = None,
        compression: Compression = "zlib",
    ) -> None:
        super().__init__(directory, interval, start, writer, compression)
        self._triangles = dict(triangles)
        self._measured = dict(measured or {})
        self._unbounded = frozenset(unbounded)
        self._has_belts = has_belts
        self._wear_areas = dict(wear_areas or {})
        self._temperatures = dict(temperatures or {})
        self._areas = {name: triangle_areas(*triangles[name]) for name in self._measured}
        self.wants = frozenset({WALLS, CONTACTS} if self._measured else {WALLS})

    def mesh(self, snapshot: Snapshot) -> VtuMesh:
        """Return the mesh of one frame: the triangles of all present walls, in the order of the scene.

        Walls that are absent in this stage have no triangles. `traction` (k, 3) and `pressure` (k,) [Pa] are
        float32.
        """
        points = [np.zeros((0, 3))]
        corners = [np.zeros((0, 3), np.int64)]
        walls = [np.zeros(0, np.int32)]
        tractions = [np.zeros((0, 3))]
        pressures = [np.zeros(0)]
        belts = [np.zeros((0, 3))]
        wear = [np.zeros((0, len(WEAR_ARRAYS)))]
        point_count = 0
        for index, (name, (rest_points, rest_corners)) in enumerate(self._triangles.items()):
            pose = snapshot.walls.get(name)
            if pose is None or not pose.present:
                continue
            moved = pose.moved(rest_points)
            points.append(_kept_in_place(moved, rest_points) if name in self._unbounded else moved)
            corners.append(rest_corners + point_count)
            walls.append(np.full(len(rest_corners), index, np.int32))
            traction, pressure = self._traction_and_pressure(snapshot, index, name, len(rest_corners))
            tractions.append(traction)
            pressures.append(pressure)
            belts.append(_along_faces(pose.surface_velocity, moved[rest_corners]))
            areas = self._wear_areas.get(name)
            wear.append(wear_per_area(snapshot.wear.get(name), areas, len(rest_corners)))
            point_count += len(rest_points)
        cell_data: dict[str, np.ndarray] = {"wall": np.concatenate(walls)}
        if self._measured:
            cell_data["traction"] = np.concatenate(tractions).astype(np.float32)
            cell_data["pressure"] = np.concatenate(pressures).astype(np.float32)
        if self._has_belts:
            cell_data["surface_velocity"] = np.concatenate(belts).astype(np.float32)
        if self._wear_areas:
            columns = np.concatenate(wear).astype(np.float32)
            cell_data |= {name: columns[:, k] for k, name in enumerate(WEAR_ARRAYS)}
        if self._temperatures:
            of_wall = np.array([self._temperatures.get(name, np.nan) for name in self._triangles])
            cell_data["temperature"] = of_wall[cell_data["wall"]].astype(np.float32)
        mesh = VtuMesh.of_cells(
            "triangle",
            np.concatenate(points),
            np.concatenate(corners),
            cell_data,
            units(WALL_ARRAY_QUANTITIES),
        )
        return replace(mesh, numbers={f"wall.{name}": index for index, name in enumerate(self._triangles)})

    def _traction_and_pressure(
        self, snapshot: Snapshot, index: int, name: str, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return traction (count, 3) and pressure (count,) [Pa] on a wall; NaN if its force is not
        measured."""
        if name not in self._measured:
            return np.full((count, 3), np.nan), np.full(count, np.nan)
        return traction_and_pressure(snapshot.contacts or {}, index, self._areas[name], self._measured[name])


def wear_per_area(wear: np.ndarray | None, areas: np.ndarray | None, count: int) -> np.ndarray:
    """Return depth [m] and works [J/m2] (count, 3) of the triangles of a wall.

    `wear`: rows of the wall in `Snapshot.wear`; `areas` (k,) [m2] of the rows. For a mesh, the values are
    those of each triangle; for another shape, the mean over the whole wall. NaN for an infinite wall, and
    for a wall without wear.
    """
    if wear is None or areas is None:
        return np.full((count, len(WEAR_ARRAYS)), np.nan)
    return np.broadcast_to(wear / areas[:, None], (count, len(WEAR_ARRAYS))).copy()


def traction_and_pressure(
    contacts: Mapping[str, np.ndarray], wall: int, areas: np.ndarray, area: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return force over area (k, 3) and normal force over area (k,) [Pa] of the particles on each triangle of
    a wall.

    `contacts`: as in a Snapshot, with `wall`, `force`, `normal_force` and `triangle`; `wall`: index of the
    wall in the scene; `areas` (k,) [m2] of its triangles; `area` [m2] of the whole wall, None if infinite.
    For a mesh, the values are those of each triangle; for another shape, the mean over the whole wall (NaN if
    infinite). The traction is that of the particles on the wall; the pressure is positive in compression.
    """
    on_wall = contacts["wall"] == wall
    force = -contacts["force"][on_wall]
    normal_force = contacts["normal_force"][on_wall]
    triangle = contacts["triangle"][on_wall]
    if len(triangle) == 0 or triangle[0] < 0:
        total_area = np.nan if area is None else area
        mean = force.sum(axis=0) / total_area
        pressure = normal_force.sum() / total_area
        return np.broadcast_to(mean, (len(areas), 3)).copy(), np.full(len(areas), pressure)
    traction = np.stack([np.bincount(triangle, component, len(areas)) for component in force.T], axis=1)
    return traction / areas[:, None], np.bincount(triangle, normal_force, len(areas)) / areas


def _along_faces(velocity: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Components (k, 3) [m/s] of a velocity (3,) in the planes of triangles (k, 3, 3) [m]."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    found: np.ndarray = velocity - (normals @ velocity)[:, None] * normals
    return found


def _kept_in_place(moved: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Points (n, 3) [m] of a part of an infinite plane after a motion, shifted back within the plane.

    rest:  the points at rest; a motion within the plane would move the part out of the domain
    """
    normal = np.cross(moved[1] - moved[0], moved[2] - moved[0])
    normal /= np.linalg.norm(normal)
    shift = moved.mean(axis=0) - rest.mean(axis=0)
    found: np.ndarray = moved - (shift - (shift @ normal) * normal)
    return found


# Coarse-grained fields


class FieldFrames(Frames):
    """`fields_NAME_NNNN.vtu`: hexahedra with the fields; at the end `fields_NAME_mean.vtu`.

    The mean weights all frames equally.

    interval:      [s], of the frames, in simulated time
    grid, kernel:  of the coarse graining
    quantities:    names in FIELD_QUANTITIES, which determine whether contacts are requested
    stages:        stages with frames; all if empty
    shapes:        of the particles of each group; empty without clumps
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        interval: float,
        grid: CoarseGrid,
        kernel: GaussianKernel,
        quantities: Sequence[str] = tuple(FIELD_QUANTITIES),
        stages: Sequence[str] = (),
        writer: BackgroundWriter | None = None,
        compression: Compression = "zlib",
        shapes: Sequence[ParticleShape] = (),
    ) -> None:
        self.stem = f"fields_{name}"
        super().__init__(directory, interval, writer=writer, compression=compression)
        needs_contacts = not set(CONTACT_FIELDS).isdisjoint(quantities)
        self.wants = frozenset({PARTICLES, CONTACTS} if needs_contacts else {PARTICLES})
        self.grid = grid
        self.kernel = kernel
        self._quantities = tuple(quantities)
        self._stages = tuple(stages)
        self._shapes = tuple(shapes)
        self._accumulated: AccumulatedFields | None = None
        self._count = 0

    def observe(self, snapshot: Snapshot) -> None:
        """Write one frame if the stage is one of `stages`; otherwise skip the due time."""
        if self._stages and snapshot.stage not in self._stages:
            self._schedule.mark_done(snapshot.time)
        else:
            super().observe(snapshot)

    def mesh(self, snapshot: Snapshot) -> VtuMesh:
        """Return the mesh of one frame and add it to the mean."""
        contacts = snapshot.contacts if CONTACTS in self.wants else None
        particles = of_bodies(snapshot.particles, self._shapes)
        accumulated = accumulate(particles, contacts, self.grid, self.kernel)
        self._accumulated = accumulated if self._accumulated is None else self._accumulated + accumulated
        self._count += 1
        return self._mesh_of(accumulated)

    def finish(self) -> None:
        """Write the mean over all frames."""
        if self._accumulated is not None:
            path = self.series.directory / f"{self.stem}_mean.vtu"
            write_vtu(path, self._mesh_of(self._accumulated / self._count), self.series.compression)

    def state_dict(self) -> dict[str, Any]:
        """Return the list of frames, the accumulated sums (cells, components) and the number of frames."""
        total = {} if self._accumulated is None else dict(self._accumulated.arrays)
        return super().state_dict() | {"total": total, "count": self._count}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state. Raises CheckpointError if the grid has another number of cells."""
        super().load_state_dict(saved)
        if any(len(accumulated) != self.grid.cell_count for accumulated in saved["total"].values()):
            raise CheckpointError(
                f"The checkpoint contains {self.stem} on a grid with another number of cells; remove it."
            )
        self._accumulated = AccumulatedFields(dict(saved["total"])) if saved["total"] else None
        self._count = saved["count"]

    def _mesh_of(self, accumulated: AccumulatedFields) -> VtuMesh:
        fields = fields_from(accumulated)
        arrays: dict[str, np.ndarray] = {
            name: FIELD_QUANTITIES[name].for_file(fields[name]) for name in self._quantities if name in fields
        }
        return self.grid.mesh(arrays)
