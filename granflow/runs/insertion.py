"""Particle insertion during a run."""

import logging
from collections import Counter
from collections.abc import Container, Iterator
from math import inf
from typing import Any

import numpy as np

from granflow.engine.engine import Engine
from granflow.engine.totals import wall_poses
from granflow.load import Scene
from granflow.particles.insertion import IsClear, inserters


def _clear_of_walls(engine: Engine, group: str) -> IsClear:
    """The function that says which spheres of a group are outside of the walls at their present positions, up
    to the overlap that is not reported."""
    plan = engine.plan
    walls = [each for each in plan.walls if each.spec.holds(group)]
    poses = wall_poses(engine.state) if walls else {}
    limit = plan.scene.numerics.intended_overlap

    def is_clear(centers: np.ndarray, radius: np.ndarray) -> np.ndarray:
        clear = np.ones(len(radius), dtype=bool)
        for wall in walls:
            pose = poses[wall.name]
            if pose.present and len(radius):
                local = (centers - pose.pivot - pose.offset) @ pose.rotation + pose.pivot
                clear &= 1.0 - wall.surface.distances(local, float(radius.max())) / radius <= limit
        return clear

    return is_clear


class ParticleInsertion:
    """The inserters of a scene.

    scene:            resolved scene
    existing_groups:  groups without inserter, because their particles come from an earlier run
    Raises:           SceneError if an inserter cannot be built
    """

    def __init__(self, scene: Scene, existing_groups: Container[str]) -> None:
        self._inserters = tuple(each for each in inserters(scene) if each.group_name not in existing_groups)

    def next_time(self) -> float:
        """Return the simulated time [s] of the next insertion; infinite after the last one."""
        return min((inserter.next_time for inserter in self._inserters), default=inf)

    @property
    def is_done(self) -> bool:
        """Whether all particles are inserted that can enter without a further stage."""
        return not any(inserter.is_pending for inserter in self._inserters)

    def begin_stage(self, name: str, time: float) -> None:
        """Begin and end the flows that are limited to stages; the stage begins at `time` [s]."""
        for inserter in self._inserters:
            inserter.begin_stage(name, time)

    @property
    def remaining(self) -> int:
        """Number of particles that are not inserted yet."""
        return sum(inserter.remaining for inserter in self._inserters)

    def insert_due(self, engine: Engine) -> bool:
        """Insert the particles that are due; return whether any were inserted.

        The inserters receive the positions (n, 3) [m] and radii (n,) [m] of the present particles, which new
        particles must not overlap; they avoid walls at their present positions as well. The number of queued
        particles in the accounting is updated.
        """
        inserted = False
        for inserter in self._inserters:
            if engine.reached(inserter.next_time):
                existing = engine.copied(("position", "radius"))
                new = inserter.insert_due(
                    engine.time + 0.5 * engine.time_step,
                    existing["position"],
                    existing["radius"],
                    _clear_of_walls(engine, inserter.group_name),
                )
                engine.insert(new)
                inserted = inserted or len(new) > 0
        self._update_queue(engine)
        return inserted

    def results(self) -> dict[str, dict[str, float]]:
        """Return the results of each inserted group by name.

        `inserted_count`, `inserted_mass` [kg] and `not_inserted_count`, as in INSERTION_QUANTITIES.
        """
        return {
            inserter.group_name: {
                "inserted_count": float(inserter.is_inserted.sum()),
                "inserted_mass": float(inserter.mass[inserter.is_inserted].sum()),
                "not_inserted_count": float(inserter.remaining),
            }
            for inserter in self._inserters
        }

    def log_end(self) -> None:
        """Log the size classes, and warn about queued particles."""
        log = logging.getLogger("granflow")
        for sentence in self.class_shares():
            log.info("%s", sentence)
        for sentence in self.shortfalls():
            log.warning("%s", sentence)

    def shortfalls(self) -> Iterator[str]:
        """Yield a sentence for each group with queued particles; a flow that the end of the run cuts off is
        normal."""
        for inserter in self._inserters:
            if queued := len(inserter.queued):
                yield (
                    f"{queued} of {inserter.due_count} {inserter.group_name} that were due were not inserted "
                    "for lack of space."
                )

    def class_shares(self) -> Iterator[str]:
        """Yield a sentence for each group with size classes: particles and mass share of each class."""
        for inserter in self._inserters:
            if inserter.group.spec.sizes.has_classes:
                radius = inserter.radius[inserter.is_inserted]
                mass = inserter.mass[inserter.is_inserted]
                parts = [
                    f"{count} of {2.0 * size:.6g} m ({mass[radius == size].sum() / mass.sum():.3%} of the "
                    "mass)"
                    for size, count in sorted(Counter(radius.tolist()).items())
                ]
                yield f"{inserter.group_name} inserted: {', '.join(parts) or 'none'}."

    def state_dict(self) -> dict[str, Any]:
        """Return the state of each inserter by group: numbers and numpy arrays."""
        return {inserter.group_name: inserter.state_dict() for inserter in self._inserters}

    def load_state_dict(self, saved: dict[str, Any], engine: Engine) -> None:
        """Restore the state of `state_dict`, and the number of queued particles of the engine."""
        for inserter in self._inserters:
            inserter.load_state_dict(saved[inserter.group_name])
        self._update_queue(engine)

    def _update_queue(self, engine: Engine) -> None:
        """Update the number of queued particles in the accounting."""
        if self._inserters:
            engine.accounting.queued_count = int(
                np.sum([len(inserter.queued) for inserter in self._inserters if not inserter.is_over])
            )
