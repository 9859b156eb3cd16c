"""What lets grains in while a run goes on."""

from collections.abc import Container
from math import inf
from typing import Any

from granflow.device.engine import Engine
from granflow.scene import Scene
from granflow.scene.generate import Rain, rains


class Feeds:
    """All rains of a scene but those of `groups_there`, whose grains came from an earlier run. Raises SceneError."""

    def __init__(self, scene: Scene, groups_there: Container[str]) -> None:
        self._rains: tuple[Rain, ...] = tuple(rain for rain in rains(scene) if rain.group_name not in groups_there)

    def next_time(self) -> float:
        """Simulated time [s] at which grains are due next; infinite once all have come."""
        return min((rain.next_time for rain in self._rains), default=inf)

    @property
    def over(self) -> bool:
        """Whether all grains have come."""
        return all(rain.remaining == 0 for rain in self._rains)

    def pour(self, engine: Engine) -> bool:
        """Let in what is due; returns whether anything came."""
        came = False
        for rain in self._rains:
            if engine.reached(rain.next_time):
                there = engine.transfer.taken(("position", "radius"))
                grains = rain.pour(engine.time + 0.5 * engine.time_step, there["position"], there["radius"])
                engine.insert(grains)
                came = came or len(grains) > 0
        return came

    def keep(self) -> dict[str, Any]:
        """What decides how each goes on, by group."""
        return {rain.group_name: rain.keep() for rain in self._rains}

    def put_back(self, kept: dict[str, Any]) -> None:
        """Go on from what was kept."""
        for rain in self._rains:
            rain.put_back(kept[rain.group_name])
