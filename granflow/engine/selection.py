"""Choice of particles at the start of a stage, by groups and region, for settings and deletions."""

from collections.abc import Sequence

import numpy as np

from granflow.engine.clumps import body_positions
from granflow.engine.host import copy_to_host
from granflow.engine.state import State
from granflow.engine.totals import Accounting
from granflow.scene.blocks.deletions import Part
from granflow.scene.blocks.particle_regions import ParticleRegion
from granflow.snapshot import body_ids

FIELDS = ("id", "radius", "position", "clump", "clump_position")
"""Fields from which the choice follows."""


class PresentParticles:
    """The n particles of this process that are present when a stage begins.

    arrays:  FIELDS and `further` fields, in device order; of clumps only with clumps
    group:   number of the group (n,)
    body:    id of the first sphere of the clump (n,), or of a single sphere
    """

    def __init__(self, state: State, accounting: Accounting, further: Sequence[str] = ()) -> None:
        self.arrays = copy_to_host(state, (*FIELDS, *further))
        self.group = accounting.by_id("group", self.arrays["id"])
        self.body = body_ids(self.arrays)
        self._center = state.periodic_box.wrap(body_positions(self.arrays).astype(float))
        self._position = state.periodic_box.wrap(self.arrays["position"].astype(float))
        self._group_names = [group.name for group in state.plan.groups]
        self._ranks = state.ranks

    def chosen(
        self, groups: Sequence[str] | None, region: ParticleRegion | None, part: Part | None = None
    ) -> np.ndarray:
        """Whether each particle is chosen (n,); all spheres of a clump or none.

        groups:  None: all
        region:  None: everywhere
        part:    which part of a particle, or of the spheres of a clump, is in the region; None: the center
        """
        found = np.ones(len(self.group), bool)
        if groups is not None:
            found &= np.isin(self.group, [self._group_names.index(name) for name in groups])
        if region is None:
            return found
        if part in (None, "center"):
            return found & (region.distance(self._center) <= 0.0)
        distance = region.distance(self._position)
        if part == "any":
            return found & np.isin(self.body, self.body[distance <= self.arrays["radius"]])
        return found & ~np.isin(self.body, self.body[distance > -self.arrays["radius"]])

    def count_on_all_ranks(self, chosen: np.ndarray) -> int:
        """Number of chosen particles of all ranks. All ranks call this."""
        return int(self._ranks.total(np.array([[chosen.sum()]]))[0][0])
