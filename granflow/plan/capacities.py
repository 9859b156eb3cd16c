"""Capacities: the lengths of the device arrays, which are estimated before a run.

Capacities are rounded up, so that scenes of similar size share their machine code. Neighbor lists that are
too short grow during the run; all kernels are then compiled again.
"""

from dataclasses import dataclass, replace
from math import ceil

MIN_PARTICLES, MIN_CHUNKS, MIN_LIST_ENTRIES, MIN_CELLS = 2048, 64, 20_480, 8192
"""Smallest capacities for particles: all small scenes have the same arrays, of a few MB."""
MIN_SIZE_CLASSES, MIN_WALLS, MIN_PAIRS = 8, 8, 64
"""Smallest capacities for size classes, walls and pairs of materials."""
MIN_TRIANGLES = 1024
"""Smallest capacity for triangles, edges, vertices and cells of meshes."""
MIN_BATCH, MIN_CHUNK_PARTICLES = 1024, 4096
"""Smallest capacities of a batch of contacts, those of several particles or of one with many neighbors, and
of the force sums of a chunk."""
WORKERS = 16
"""Number of CPU threads up to which all thread counts have the same arrays."""
BOUNDS = 256
"""Number of parts of the particle list whose bounding boxes are computed in parallel at a rebuild."""
SUBPARTS = 64
"""Number of threads of a GPU for each of these parts."""
SHARED_ROWS = 64
"""Rows of the sums of wall forces if each particle is a chunk: few particles are at walls, and atomic
additions of integers are exact."""
SCAN_BLOCK = 1024
"""Number of cells summed by one task of the prefix sum."""
REACH_STEPS = 40
"""Number of steps at its velocity that a particle may move between rebuilds, in addition to half the skin."""
POSE_COUNT = 256
"""Number of steps whose wall poses are uploaded together."""
GROWTH_FACTOR = 1.3
"""Factor by which the capacity exceeds the needed list entries when a list grows."""
SPARE = 8
"""Entries per segment in addition to a share, for segments with few list entries."""


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
    wear_rows:       rows of the sums of wear, one for each triangle or wall with wear; 0 without
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
    wear_rows: int
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


# Rounding.

LARGE = 100_000
"""Capacity above which the steps between capacities are smaller."""


def rounded_capacity(needed: int, smallest: int) -> int:
    """The smallest capacity that holds `needed` entries: `smallest`, or one of the steps of 25 % above it.

    From LARGE on, steps are 6 %, because memory matters more than the compilation of a further size.
    """
    capacity = smallest
    while capacity < needed:
        capacity += max(capacity // (4 if capacity < LARGE else 16), 1)
    return capacity


# Estimates of the length of the neighbor lists.

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


def neighbors_per_particle(particle_count: int, skin_over_radius: float) -> float:
    """List entries per particle, as a real number.

    Linear in `skin_over_radius`, at least GENEROUS_NEIGHBORS for fewer than GENEROUS_BELOW particles. Each
    pair within a chunk has one entry, each pair across two chunks has two.
    """
    neighbors = IN_CONTACT_NEIGHBORS + NEIGHBORS_PER_SKIN * skin_over_radius
    return max(neighbors, GENEROUS_NEIGHBORS) if particle_count < GENEROUS_BELOW else neighbors


HISTORY_SHARE = 0.8
"""Share of the list entries that can hold a contact history at a neighbor-list rebuild."""
SAVED_CONTACTS = 3.1
"""Contacts per particle whose history can be saved in large scenes with one segment; packings without
friction have 3.

Less than HISTORY_SHARE of the list entries. Segments of one chunk each need more: contacts are denser in some
of them.
"""


def history_share(particle_count: int, segments: int, list_entries: int) -> float:
    """Initial share of `list_entries` that can be saved with a history, see HISTORY_SHARE and SAVED_CONTACTS.

    In whole hundredths, so that scenes of similar size and skin share their machine code.
    """
    if segments > 1 or particle_count < GENEROUS_BELOW:
        return HISTORY_SHARE
    return min(HISTORY_SHARE, ceil(100.0 * 2.0 * SAVED_CONTACTS * particle_count / list_entries) / 100.0)


SHARE_AT_MESHES = 0.1
"""Share of the particles of a bed that are near a mesh wall."""


def near_triangles(edge: float, skin: float) -> float:
    """Candidate triangles of a sphere at a mesh with this edge length [m]: those within the skin of the
    contact.

        n = 2 (1 + 2 skin / edge)^2

    `skin` [m]. A real number, which enters the mean of all particles.
    """
    return 2.0 * (1.0 + 2.0 * skin / edge) ** 2
