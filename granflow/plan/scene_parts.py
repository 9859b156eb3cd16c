"""Groups and stages of a scene in numeric form."""

from dataclasses import dataclass

from granflow.geometry.clump_shape import ClumpShape
from granflow.load import Scene
from granflow.plan.size_classes import diameter_range


@dataclass(frozen=True)
class PlannedGroup:
    """One group of particles: name, number of particles, name of the material, whether its particles are fixed.

    `diameters` [m]: smallest and largest, of spheres. `source`: position of its count in the scene file. `clump`: shape
    of its particles; None for spheres. `liquid_content`: initial volume of the film over that of the particle.
    """

    name: str
    count: int
    material: str
    fixed: bool
    diameters: tuple[float, float]
    source: str
    clump: ClumpShape | None = None
    liquid_content: float = 0.0

    @property
    def sphere_count(self) -> int:
        """Number of spheres."""
        return self.count * (1 if self.clump is None else len(self.clump))


@dataclass(frozen=True)
class StageCondition:
    """A condition that ends a stage: a quantity is above or below a value, one of which is None, during `hold` [s]."""

    quantity: str
    above: float | None
    below: float | None
    hold: float

    def is_met(self, value: float) -> bool:
        """Whether a value satisfies the condition; NaN does not."""
        return (self.above is not None and value > self.above) or (self.below is not None and value < self.below)


@dataclass(frozen=True)
class PlannedStage:
    """One stage of a run: name, and longest duration [s].

    `kinetic_energy_below` [J]: mean kinetic energy per particle at which it ends earlier, or None. `key`, `source`: key
    of the duration in the scene, and its position in the file. `until`: conditions, any of which ends the stage, from
    its `shortest` duration [s] on.
    """

    name: str
    longest: float
    kinetic_energy_below: float | None
    key: str
    source: str
    until: tuple[StageCondition, ...] = ()
    shortest: float = 0.0

    @property
    def has_condition(self) -> bool:
        """Whether the stage can end before its longest duration."""
        return self.kinetic_energy_below is not None or bool(self.until)


def planned_groups(scene: Scene) -> tuple[PlannedGroup, ...]:
    """The groups in the order of the scene."""
    return tuple(
        PlannedGroup(
            *(name, group.count, group.material, group.fixed, diameter_range(group)),
            scene.locate("particles", name, "count"),
            None if group.clump is None else group.clump.shape,
            group.liquid_content or 0.0,
        )
        for name, group in scene.particles.items()
    )


def planned_stages(scene: Scene) -> tuple[PlannedStage, ...]:
    """The stages in the order of the scene; a scene without stages has one, "run"."""
    stages = []
    for index, stage in enumerate(scene.schedule):
        key = "max_duration" if stage.duration is None else "duration"
        path = ("stages", index, key) if scene.stages else ("run", "duration")
        source = ".".join(map(str, path)), scene.locate(*path)
        until = tuple(StageCondition(each.quantity, each.above, each.below, each.hold) for each in stage.until)
        stages.append(
            PlannedStage(stage.name, stage.longest, stage.kinetic_energy_below, *source, until, stage.min_duration)
        )
    return tuple(stages)
