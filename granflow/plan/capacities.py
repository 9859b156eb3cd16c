"""Capacities of the device arrays, which are rounded up so that scenes of similar size share their machine
code.

Neighbor lists that are too short grow; all kernels are then compiled again.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from math import ceil, frexp, inf, log2

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.plan.time_step import PairCase

MIN_PARTICLES, MIN_CHUNKS, MIN_LIST_ENTRIES, MIN_CELLS = 2048, 64, 20_480, 8192
"""Smallest capacities for particles: all small scenes have the same arrays, of a few MB."""
MIN_SIZE_CLASSES, MIN_WALLS, MIN_PAIRS = 8, 8, 64
"""Smallest capacities for size classes, walls and pairs of materials."""
MIN_TRIANGLES = 1024
"""Smallest capacity for triangles, edges, vertices and cells of meshes."""
MIN_BATCH, MIN_CHUNK_PARTICLES = 1024, 512
"""Smallest capacities of a batch of contacts, those of several particles or of one with many neighbors, and
of the force sums of a chunk."""
WORKERS = 16
"""Number of CPU threads up to which all thread counts have the same arrays."""
GENEROUS_BELOW = 20_000
"""Number of particles below which memory is negligible and each particle gets `GENEROUS_NEIGHBORS` list
entries."""
GENEROUS_NEIGHBORS = 7.0
"""List entries per particle in small scenes."""
IN_CONTACT_NEIGHBORS, NEIGHBORS_PER_SKIN = 3.4, 10.0
"""Candidate pairs per particle in a settled bed: contacts, and an increase with skin over radius.

Measured in beds with friction 0.5 and 10 % size spread: 3.6 to 4.0 at a skin of 0.11 radii; the rest is
reserve.
"""
HISTORY_SHARE = 0.8
"""Share of the list entries that can hold a contact history at a neighbor-list rebuild."""
SAVED_CONTACTS = 3.1
"""Contacts per particle whose history can be saved in large scenes with one segment; packings without
friction have 3.

Less than HISTORY_SHARE of the list entries. Segments of one chunk each need more: contacts are denser in some
of them.
"""
SPARE = 8
"""Entries per segment in addition to a share, for segments with few list entries."""
BOUNDS = 256
"""Number of parts of the particle list whose bounding boxes are computed in parallel at a rebuild."""
SUBPARTS = 64
"""Number of threads of a GPU for each of these parts."""
LARGE = 100_000
"""Capacity above which the steps between capacities are smaller."""
SHARED_ROWS = 64
"""Rows of the sums of wall forces if each particle is a chunk: few particles are at walls, and atomic
additions of integers are exact."""
SCAN_BLOCK = 1024
"""Number of cells summed by one task of the prefix sum."""
REACH_STEPS = 40
"""Number of steps at its velocity that a particle may move between rebuilds, in addition to half the skin."""
WALL_BATCH = 256
"""Number of steps whose wall poses are uploaded together."""
GROWTH_FACTOR = 1.3
"""Factor by which the capacity exceeds the needed list entries when a list grows."""
SHARE_AT_MESHES = 0.1
"""Share of the particles of a bed that are near a mesh wall."""


def near_triangles(edge: float, skin: float) -> float:
    """Candidate triangles of a sphere at a mesh with this edge length [m]: those within the skin of the
    contact.

        n = 2 (1 + 2 skin / edge)^2

    `skin` [m]. A real number, which enters the mean of all particles.
    """
    return 2.0 * (1.0 + 2.0 * skin / edge) ** 2


def neighbors_per_particle(particle_count: int, skin_over_radius: float) -> float:
    """List entries per particle, as a real number.

    Linear in `skin_over_radius`, at least GENEROUS_NEIGHBORS for fewer than GENEROUS_BELOW particles. Each
    pair within a chunk has one entry, each pair across two chunks has two.
    """
    neighbors = IN_CONTACT_NEIGHBORS + NEIGHBORS_PER_SKIN * skin_over_radius
    return max(neighbors, GENEROUS_NEIGHBORS) if particle_count < GENEROUS_BELOW else neighbors


def history_share(particle_count: int, segments: int, list_entries: int) -> float:
    """Initial share of `list_entries` that can be saved with a history, see HISTORY_SHARE and SAVED_CONTACTS.

    In whole hundredths, so that scenes of similar size and skin share their machine code.
    """
    if segments > 1 or particle_count < GENEROUS_BELOW:
        return HISTORY_SHARE
    return min(HISTORY_SHARE, ceil(100.0 * 2.0 * SAVED_CONTACTS * particle_count / list_entries) / 100.0)


@dataclass(frozen=True)
class Capacities:
    """Lengths of the device arrays, rounded by `rounded_capacity`, but for `segments` and `history_share`.

    segments:        equal parts of `list_entries`, one for each chunk, or 1 if each particle is a chunk; not
                     a length
    list_entries:    entries of all neighbor lists
    class_cells:     cells of the grids of all size classes; 0 without size classes
    measured_walls:  walls with measured forces; 0 without
    batch:           contacts of one batch on a CPU
    chunk_particles: particles of a chunk, whose force sums a CPU thread holds
    wall_rows:       rows of the sums of wall forces, one for each chunk or SHARED_ROWS
    energy_classes:  classes of collision energies, with those below and above the edges; 0 without
    history_share:   share of the list entries that can be saved with a history at a rebuild; not a length
    """

    particles: int
    segments: int
    chunks: int
    list_entries: int
    cells: int
    class_cells: int
    size_classes: int
    walls: int
    measured_walls: int
    pairs: int
    batch: int
    chunk_particles: int
    wall_rows: int
    energy_classes: int
    history_share: float

    @property
    def saved_entries(self) -> int:
        """History entries that a rebuild can save; fewer than list entries, because only contacts have a
        history."""
        return int(self.history_share * self.list_entries) + SPARE

    @property
    def list_entries_per_segment(self) -> int:
        """List entries of each segment."""
        return self.list_entries // self.segments

    @property
    def saved_entries_per_segment(self) -> int:
        """Saved history entries of each segment."""
        return self.saved_entries // self.segments

    def list_capacity_for(self, saved: int) -> int:
        """List entries per segment for which a rebuild can save this number of history entries."""
        return ceil((saved + 1) / self.history_share)

    def grown(self, needed: int, batch: int) -> "Capacities":
        """Capacities for at least GROWTH_FACTOR times `needed` list entries per segment, and `batch`
        contacts."""
        entries = self.segments * (int(GROWTH_FACTOR * needed) + SPARE)
        return replace(
            self,
            list_entries=rounded_capacity(entries, self.list_entries),
            batch=rounded_capacity(batch, self.batch),
        )


def rounded_capacity(needed: int, smallest: int) -> int:
    """The smallest capacity that holds `needed` entries: `smallest`, or one of the steps of 25 % above it.

    From LARGE on, steps are 6 %, because memory matters more than the compilation of a further size.
    """
    capacity = smallest
    while capacity < needed:
        capacity += max(capacity // (4 if capacity < LARGE else 16), 1)
    return capacity


# Quantities that each chunk of particles sums: terms of the energy budget, and impulses of walls.

LOSSES = (
    "plastic_dissipation",
    "friction_dissipation",
    "rolling_dissipation",
    "damping_dissipation",
    "wall_work",
)
"""Terms of the energy budget that each chunk sums [J], with the names of the totals."""
PLASTIC, FRICTION, ROLLING, DAMPING, WALL_WORK = range(len(LOSSES))
IMPULSE_SIZE = 7
"""Components that each chunk sums for a wall: time integrals of force (3), torque (3) and normal force
(1)."""


# Units of the sums over contacts: sums of integers are exact, and do not depend on the order of their
# terms.
#
# A contact rounds its force, torque, energy, ... to a multiple of a unit before it adds it. The bits of a
# run then depend neither on the order of the neighbor lists nor on skin, rebuilds, chunk size or number of
# threads.
#
# The largest force of a contact within the overlap limit L, with R the largest radius that the smaller of
# two particles in contact can have, and the overlap d = L R:
#
#     F = max[(4/3) E* sqrt(R) d^1.5,  k d + c v]        over all contacts that can occur, at least W
#
# with k and c the tangent stiffness during loading and the viscosity of the normal model at the planned
# velocity v, and W the weight of the heaviest sphere, which the sums contain: a large sphere among small
# ones is heavier than the largest force of a contact. With F rounded up to a power of two, the unit of a
# force is F / 2^45 = 3e-14 F: sums up to 2^7 F are exact in f64, and also exact if their terms are in f32,
# of which those above 2^-23 F are multiples of half a unit.

FORCE_BITS, ENERGY_BITS, IMPULSE_BITS, WALL_BITS = 45, 70, 53, 43
"""Binary digits of the largest force in units of a force, and so on: fewer, if more terms are added.

An energy is added in two words, so that the contacts of small particles count in the presence of very large
ones.
"""
SUM_BITS = 50
"""Binary digits of the largest sum of forces on a particle in its unit, a quarter of what f64 represents
exactly in half units: partial sums can be larger than the sum."""
CARRY_BITS = 40
"""Binary digits of the low word of a sum over a run; a high word counts the rest."""
FORCE, TORQUE, ENERGY, IMPULSE, ANGULAR_IMPULSE, WALL_FORCE = range(6)
"""Order of the units in device arrays."""


@dataclass(frozen=True)
class SumUnits:
    """Units of the sums, powers of two.

    force:            force on a particle [N]
    torque:           torque on a particle [N m]
    energy:           dissipated energy and work [J]
    impulse:          time integral of a wall force [N s]
    angular_impulse:  time integral of a wall torque [N m s]
    wall_force:       force on a force-controlled wall [N]
    """

    force: float
    torque: float
    energy: float
    impulse: float
    angular_impulse: float
    wall_force: float

    @property
    def are_valid(self) -> bool:
        """Whether all units are powers of two."""
        return all(0.0 < unit < inf and frexp(unit)[0] == 0.5 for unit in astuple(self))

    @property
    def largest_force(self) -> float:
        """Largest contact force [N] on a particle: above it, the sums are not exact."""
        return self.force * 2.0**SUM_BITS


def sum_units(
    pair_cases: Sequence[PairCase],
    law: NormalLaw,
    velocity: float,
    max_overlap: float,
    radius: float,
    time_step: float,
    size: float,
    weight: float = 0.0,
) -> SumUnits:
    """Units of a scene.

    pair_cases:   contacts that can occur, and those that only limit the time step
    velocity:     maximum expected impact velocity [m/s]
    max_overlap:  overlap limit over the radius
    radius:       largest radius [m]
    time_step:    longest time step [s]
    size:         largest distance [m] of a particle from the pivot of a wall
    weight:       [N], of the heaviest sphere
    """
    force = weight
    energy = 0.0
    for case in [case for case in pair_cases if case.pair_key] or pair_cases:
        overlap = max_overlap * case.largest_radius
        arguments = (case.pair, case.radius_eff, case.mass_eff, velocity)
        hertz = 4.0 / 3.0 * case.pair.modulus_eff * np.sqrt(case.largest_radius) * overlap**1.5
        viscosity = law.viscosity(*case.dashpot_arguments, velocity)
        spring = law.loading_stiffness(*arguments) * overlap + viscosity * velocity
        force = max(force, hertz, spring)
        energy = max(energy, max(hertz, spring) * overlap)
    force_scale = _power_of_two(force)
    radius_scale = _power_of_two(radius)
    impulse = force_scale * _power_of_two(time_step) / 2.0**IMPULSE_BITS
    return SumUnits(
        force=force_scale / 2.0**FORCE_BITS,
        torque=force_scale * radius_scale / 2.0**FORCE_BITS,
        energy=_power_of_two(energy) / 2.0**ENERGY_BITS,
        impulse=impulse,
        angular_impulse=impulse * _power_of_two(size),
        wall_force=force_scale / 2.0**WALL_BITS,
    )


def _power_of_two(value: float) -> float:
    """Smallest power of two not below a positive value."""
    return 2.0 ** ceil(log2(value))
