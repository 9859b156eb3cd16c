"""Deletions of stages: particles that vanish when a stage begins."""

from collections.abc import Iterator
from typing import Annotated, Literal

from granflow.scene.blocks.particle_regions import ParticleRegion
from granflow.schema.faults import Fault, whole
from granflow.schema.model import GroupNames, Model, optional
from granflow.schema.quantities import Number

Share = Annotated[float, Number(noun="a fraction", above=0, at_most=1)]
Part = Literal["center", "any", "all"]
"""Part of a particle that is in a region."""


class StageDeletion(Model):
    """Particles that are deleted when a stage begins: of some groups or of all, in a region or everywhere.

    It applies to the particles that are present then, before walls appear and particles are inserted. Fixed
    particles are deleted too. Clumps are deleted as a whole: `center` is their center of mass.

    >>> gf.StageDeletion(groups=["beads"], fraction=0.5)
    StageDeletion(groups=('beads',), fraction=0.5)
    """

    groups: GroupNames | None = optional("groups whose particles are deleted", "all", examples=[["beads"]])
    region: ParticleRegion | None = optional(
        "region from which particles are deleted",
        "everywhere",
        examples=[{"half_space": {"point": [0, 0, 0.1], "normal": [0, 0, 1]}}],
    )
    part: Part | None = optional(
        "which part of a particle is in the region: its center, any point, or all of it",
        "center",
        examples=["any"],
    )
    fraction: Share | None = optional(
        "fraction of these particles that is deleted: each with this probability, by the seed of the scene",
        "all",
        examples=[0.1],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for a deletion without any key, and for a part of no region."""
        if self.groups is None and self.region is None and self.fraction is None:
            yield whole((), "would delete all particles; give groups, a region or a fraction")
        if self.part is not None and self.region is None:
            yield Fault(("part",), "it requires a region; remove part")
