"""What lets grains in while a run goes on."""

from collections import Counter
from collections.abc import Container, Iterator
from math import inf
from typing import Any

import numpy as np

from granflow.device.engine import Engine
from granflow.scene import Scene
from granflow.scene.generate import streams
from granflow.scene.schema import ClassSizes


class Feeds:
    """All streams of a scene but those of `groups_there`, whose grains came from an earlier run. Raises SceneError."""

    def __init__(self, scene: Scene, groups_there: Container[str]) -> None:
        self._scene = scene
        self._streams = tuple(each for each in streams(scene) if each.group_name not in groups_there)

    def next_time(self) -> float:
        """Simulated time [s] at which grains are due next; infinite once all have come."""
        return min((stream.next_time for stream in self._streams), default=inf)

    @property
    def over(self) -> bool:
        """Whether all grains have come."""
        return all(stream.remaining == 0 for stream in self._streams)

    def pour(self, engine: Engine) -> bool:
        """Let in what is due; returns whether anything came."""
        came = False
        for stream in self._streams:
            if engine.reached(stream.next_time):
                there = engine.transfer.taken(("position", "radius"))
                grains = stream.pour(engine.time + 0.5 * engine.time_step, there["position"], there["radius"])
                engine.insert(grains)
                came = came or len(grains) > 0
        self._tell(engine)
        return came

    def results(self) -> dict[str, dict[str, float]]:
        """Of every group that comes in: `came_count`, `came_mass` [kg] and `missing_count`."""
        return {
            stream.group_name: {
                "came_count": float(stream.came.sum()),
                "came_mass": float(stream.mass[stream.came].sum()),
                "missing_count": float(stream.remaining),
            }
            for stream in self._streams
        }

    def shortfalls(self) -> Iterator[str]:
        """A sentence for each group of which some found no room, or were not due before the end."""
        for stream in self._streams:
            if stream.remaining:
                waiting = len(stream.waiting)
                late = stream.remaining - waiting
                why = [f"{waiting} found no room"] * bool(waiting) + [f"{late} were not due yet"] * bool(late)
                asked = len(stream.radius)
                yield f"{stream.remaining} of {asked} {stream.group_name} have not come: {' and '.join(why)}."

    def shares(self) -> Iterator[str]:
        """A sentence for each group with size classes: how many came of each, and their share of the mass."""
        for stream in self._streams:
            if isinstance(self._scene.particles[stream.group_name].diameter, ClassSizes):
                radius, mass = stream.radius[stream.came], stream.mass[stream.came]
                parts = [
                    f"{count} of {2.0 * size:.6g} m ({mass[radius == size].sum() / mass.sum():.3%} of the mass)"
                    for size, count in sorted(Counter(radius.tolist()).items())
                ]
                yield f"{stream.group_name} came: {', '.join(parts) or 'none'}."

    def keep(self) -> dict[str, Any]:
        """What decides how each goes on, by group."""
        return {stream.group_name: stream.keep() for stream in self._streams}

    def put_back(self, kept: dict[str, Any], engine: Engine) -> None:
        """Go on from what was kept."""
        for stream in self._streams:
            stream.put_back(kept[stream.group_name])
        self._tell(engine)

    def _tell(self, engine: Engine) -> None:
        """Enter how many wait for room."""
        if self._streams:
            engine.books.waiting_count = int(np.sum([len(stream.waiting) for stream in self._streams]))
