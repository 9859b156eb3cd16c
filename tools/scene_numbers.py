"""Computes the numbers of docs/pages/scenes.md that are not in the result tables of a run from its output
files.

python tools/scene_numbers.py column out/column_collapse     aspect ratio, run-out
python tools/scene_numbers.py drum out/drum                  particles per quadrant over time
python tools/scene_numbers.py ball out/penetration           height and penetration depth of the ball over
time python tools/scene_numbers.py silo out/silo_large_orifice    remaining particles over time, early and
late flow
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import granflow as gf

COVERED = 0.5
"""Share of the floor that particles cover at the edge of a deposit."""

TAIL = 0.02
"""Share of the particles above the top of a bed, since a few particles lie on its surface."""


@dataclass(frozen=True)
class Frame:
    """One frame of a run: time [s] and particle arrays."""

    time: float
    position: np.ndarray
    radius: np.ndarray
    group: np.ndarray


def frames(folder: Path) -> list[Frame]:
    """All frames of a run that contain particles, ordered by time."""
    return [
        Frame(each.time, each.particles["position"], each.particles["radius"], each.particles["group"])
        for each in gf.read_run(folder).frames
    ]


def top_of(frame: Frame) -> float:
    """Height [m] below which all particles except the share TAIL lie."""
    return float(np.quantile(frame.position[:, 2] + frame.radius, 1 - TAIL))


def edge_of(position: np.ndarray, radius: np.ndarray, covered: float = COVERED) -> float:
    """Radius [m] of a round deposit about the z axis at which the covered share of the floor falls below
    `covered`.

    The share is computed in rings of one mean diameter from the particles with centers in the ring, including
    particles above one another, and interpolated between the outer edges of the rings.
    """
    width = 2 * float(radius.mean())
    ring = (np.hypot(position[:, 0], position[:, 1]) / width).astype(int)
    covered_area = np.bincount(ring, np.pi * radius**2)
    share = covered_area / (np.pi * width**2 * (2 * np.arange(len(covered_area)) + 1))
    last = int(np.flatnonzero(share >= covered)[-1])
    following = share[last + 1] if last + 1 < len(share) else 0.0
    return float(width * (last + 1 + (share[last] - covered) / (share[last] - following)))


def column(folder: Path) -> str:
    """Aspect ratio before the collapse and run-out after it, of the last group of a scene."""
    all_frames = frames(folder)
    opening_time = opening(folder)
    before = [frame for frame in all_frames if frame.time <= opening_time][-1]
    start, end = (of_group(frame, int(frame.group.max())) for frame in (before, all_frames[-1]))
    r_start = float((np.hypot(start.position[:, 0], start.position[:, 1]) + start.radius).max())
    height = top_of(start) - float((start.position[:, 2] - start.radius).min())
    lines = [f"r0 {1e3 * r_start:.1f} mm, h0 {1e3 * height:.1f} mm, a = {height / r_start:.2f}"]
    for covered in (0.75, COVERED, 0.25):
        run_out = edge_of(end.position, end.radius, covered) / r_start - 1
        lines.append(f"(r - r0) / r0 = {run_out:.2f} where {covered:.0%} is covered")
    distant = np.hypot(end.position[:, 0], end.position[:, 1]) > r_start * (1 + run_out)
    lines.append(f"top {1e3 * top_of(end):.1f} mm, particles farther out {distant.sum()}")
    return "\n".join(lines)


def of_group(frame: Frame, group: int) -> Frame:
    """The particles of one group."""
    selected = frame.group == group
    return Frame(frame.time, frame.position[selected], frame.radius[selected], frame.group[selected])


def opening(folder: Path) -> float:
    """Start of the last stage [s]: time of the last row of the previous stage."""
    columns = gf.read_run(folder).timeseries_arrays
    return float(columns["time"][columns["stage"] != columns["stage"][-1]].max(initial=0.0))


def quadrants(position: np.ndarray) -> np.ndarray:
    """Particle counts (4,) in x < 0, z >= 0; x >= 0, z >= 0; x < 0, z < 0; x >= 0, z < 0."""
    right = position[:, 0] >= 0
    below = position[:, 2] < 0
    return np.bincount(2 * below + right, minlength=4)


def drum(folder: Path) -> str:
    """Particles of each group in each quadrant of the plane of rotation, over time."""
    all_frames = frames(folder)
    names = ("top left", "top right", "bottom left", "bottom right")
    lines = [f"{'time [s]':>8} {'group':>6} " + " ".join(f"{name:>12}" for name in names)]
    for frame in all_frames[:: max(len(all_frames) // 16, 1)]:
        for group in range(int(frame.group.max()) + 1):
            counts = quadrants(of_group(frame, group).position)
            lines.append(f"{frame.time:8.2f} {group:6d} " + " ".join(f"{count:12d}" for count in counts))
    return "\n".join(lines)


def ball(folder: Path) -> str:
    """Lowest point of the largest particle over time, and its depth below the initial surface of the bed."""
    lines = [f"{'time [s]':>8} {'lowest point [mm]':>18} {'depth [mm]':>11}"]
    surface = None
    depths = []
    for frame in frames(folder):
        largest = int(frame.radius.argmax())
        if frame.radius[largest] < 2 * np.median(frame.radius):
            continue
        others = np.arange(len(frame.radius)) != largest
        rest = Frame(frame.time, frame.position[others], frame.radius[others], frame.group[others])
        surface = top_of(rest) if surface is None else surface
        lowest = float(frame.position[largest, 2] - frame.radius[largest])
        depths.append(surface - lowest)
        lines.append(f"{frame.time:8.4f} {1e3 * lowest:18.2f} {1e3 * depths[-1]:11.2f}")
    return "\n".join([*lines, f"deepest {1e3 * max(depths):.2f} mm, at the end {1e3 * depths[-1]:.2f} mm"])


def silo(folder: Path) -> str:
    """Remaining particles over time, and the flow in both halves of the steady part of the discharge."""
    columns = gf.read_run(folder).timeseries_arrays
    discharge = columns["stage"] == "discharge"
    time, remaining, out = (
        columns[name][discharge] for name in ("time", "particle_count", "flow_count.outlet")
    )
    lines = [
        f"{time[i] - time[0]:6.2f} s: {remaining[i]:.0f} remaining"
        for i in range(0, len(time), max(len(time) // 12, 1))
    ]
    count = out[-1] - out[0]
    times = [float(np.interp(share * count, out - out[0], time)) for share in (0.1, 0.45, 0.8)]
    first, second = (0.35 * count / (end - start) for start, end in zip(times, times[1:], strict=False))
    lines.append(
        f"10 to 45 % of the discharge: {first:.0f} particles/s; 45 to 80 %: {second:.0f} particles/s, "
        f"{second / first - 1:+.1%}"
    )
    return "\n".join(lines)


KINDS: dict[str, Callable[[Path], str]] = {"column": column, "drum": drum, "ball": ball, "silo": silo}


def main() -> None:
    """Prints the numbers of one run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    print(KINDS[options.kind](options.folder))


if __name__ == "__main__":
    main()
