"""Given and simulated restitution of all material pairs of a scene, at its time step and precision.

`measure` is the study of `granflow restitution`: it simulates head-on collisions of all pairs in one run of
the collision bench, and `write_restitution` writes `restitution.csv` and `restitution.png`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from granflow import Scene, plan_for
from granflow.plan.restitution import impact_of, name_of, pairings
from granflow.studies.bench import CollisionBench
from granflow.studies.figures import COLORS, MARKERS, POINTS, draw_to, write_columns

# ---------------------------------------------------------------- on the device

VELOCITIES_PER_DECADE = 4
"""Velocities of the collisions per decade."""
DECADES = 3
"""Decades of velocity below the largest expected one."""
PHASES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Phases of first contact within a time step."""
TOLERANCE = 0.01
"""Relative difference that is marked in the table."""
HEIGHT = 5.2
"""Height of the figure [inch]."""


@dataclass(frozen=True)
class RestitutionRow:
    """One pair at one velocity [m/s]: given restitution, and smallest and largest simulated value over the
    phases."""

    pair: str
    velocity: float
    requested: float
    min_reached: float
    max_reached: float

    @property
    def reached(self) -> float:
        """Smallest or largest simulated value, whichever differs more from the given one."""
        return max(self.min_reached, self.max_reached, key=lambda e: abs(e - self.requested))

    @property
    def difference(self) -> float:
        """Relative difference of simulated and given value; infinite if 0 is given and not reached."""
        if self.requested == 0.0:
            return 0.0 if self.reached == 0.0 else np.inf
        return self.reached / self.requested - 1.0


def measure(scene: Scene, arch: str = "cpu") -> tuple[list[RestitutionRow], float]:
    """Simulate head-on collisions of all material pairs of a scene at velocities up to the largest expected
    one.

    All collisions are at the far side of the domain, where single precision is coarsest; each velocity is
    repeated for several phases of first contact. The velocities span DECADES decades. Also returns the time
    step [s].

    Raises SceneError if the scene has no valid plan.
    """
    plan = plan_for(scene)
    pairs = pairings(plan)
    count = DECADES * VELOCITIES_PER_DECADE + 1
    velocities = plan.impact_velocity.value * np.logspace(-DECADES, 0, count)
    described = scene.model_dump(by_alias=True, exclude_none=True)
    for pair in described["pairs"].values():
        pair["friction"] = 0.0
        pair.pop("rolling_friction", None)
    bench = CollisionBench(
        materials=described["materials"],
        pairs=described["pairs"],
        contact=described["contact"] | {"tangential": "none", "rolling": "none"},
        collisions=[
            replace(pair, velocity=float(velocity), first_contact=phase * plan.time_step)
            for pair in pairs
            for velocity in velocities
            for phase in PHASES
        ],
        run={"duration": 1.0, "velocity_max": plan.impact_velocity.value, "precision": scene.run.precision},
        numerics={key: value for key, value in described["numerics"].items() if key != "max_overlap"},
        contact_x=float(np.abs([scene.domain.min, scene.domain.max]).max()),
        arch=arch,
    )
    with bench:
        # The bench has more contacts than the scene, which would limit a time step given in its scene.
        bench.restart(bench.collisions, plan.time_step)
        reached = bench.rebound().reshape(len(pairs), count, len(PHASES)) / velocities[:, None]
    rows = []
    for pair, per_velocity in zip(pairs, reached, strict=True):
        for velocity, found in zip(velocities, per_velocity, strict=True):
            requested = impact_of(plan, pair, velocity).requested
            extremes = float(found.min()), float(found.max())
            rows.append(RestitutionRow(name_of(pair), float(velocity), requested, *extremes))
    return rows, plan.time_step


def restitution_rows(rows: Sequence[RestitutionRow]) -> list[tuple[str, str, str, str, str]]:
    """Table rows: pair, velocity [m/s], given restitution, simulated restitution, difference in percent."""
    found = []
    for before, row in zip([None, *rows], rows, strict=False):
        name = row.pair if before is None or before.pair != row.pair else ""
        difference = f"{100.0 * row.difference:+.3f}" + (" *" if abs(row.difference) > TOLERANCE else "")
        found.append((name, f"{row.velocity:.4g}", f"{row.requested:.5f}", f"{row.reached:.5f}", difference))
    return found


def write_restitution(out: Path, rows: Sequence[RestitutionRow], title: str) -> None:
    """Write `restitution.csv`, then `restitution.png`. Raises GranflowError if matplotlib is not
    installed."""
    out.mkdir(parents=True, exist_ok=True)
    names = ("pair", "velocity", "requested", "min_reached", "max_reached", "difference")
    write_columns(
        out / "restitution.csv", {name: np.array([getattr(row, name) for row in rows]) for name in names}
    )
    draw_to(out / "restitution.png", lambda figure: _draw(figure, rows, title), HEIGHT)


LEAST_RANGE = 0.05
"""Smallest range of the restitution coefficient in the figure: a constant one does not fill it with rounding
errors."""


def _draw(figure: Any, rows: Sequence[RestitutionRow], title: str) -> None:
    """Plot restitution (top) and difference in percent (bottom) against velocity; bars span the phases."""
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    below.axhspan(-100.0 * TOLERANCE, 100.0 * TOLERANCE, color="0.93", zorder=0)
    for number, name in enumerate(dict.fromkeys(row.pair for row in rows)):
        is_pair = [row for row in rows if row.pair == name]
        velocity, requested, min_reached, max_reached = (
            np.array([getattr(row, key) for row in is_pair])
            for key in ("velocity", "requested", "min_reached", "max_reached")
        )
        color = COLORS[number % len(COLORS)]
        middle = 0.5 * (min_reached + max_reached)
        half = 0.5 * (max_reached - min_reached)
        style = POINTS | {"marker": MARKERS[number % len(MARKERS)], "color": color}
        above.semilogx(velocity, requested, color=color)
        above.errorbar(velocity, middle, half, label=name, **style)
        known = requested > 0.0
        percent = 100.0 / requested[known]
        below.errorbar(velocity[known], (middle - requested)[known] * percent, half[known] * percent, **style)
    low, high = above.get_ylim()
    margin = max(0.0, 0.5 * (LEAST_RANGE - (high - low)))
    above.set_ylim(low - margin, high + margin)
    above.set(ylabel="restitution coefficient $e$", title=f"{title}: given (lines) and simulated (points)")
    above.legend(loc="best", title="bars: phases of the first step")
    below.set(xlabel="approach velocity $v$ [m/s]", ylabel="relative difference [%]")
