"""The exponent of Beverloo from a flat-bottomed silo with holes of several diameters.

    python tools/beverloo.py                             scenes/flat_silo.yaml with five holes, some minutes
    python tools/beverloo.py --holes 18,24,32 --threads 2 --out out/beverloo

    W = C rho_b sqrt(g) (D - k d)^(5/2)        (Beverloo, Leniger & van de Velde 1961)

Prints the flow through every hole, that of the first and of the second half of the time, the exponent at k = 1.4
(spheres), and k and C at the exponent 5/2. Each run writes its files into a folder of its own; those that are there are
not run again, and `granflow beverloo` reads them, too.
"""

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow.study.beverloo import Discharge, fit_beverloo

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "flat_silo.yaml"
HOLES = "18,21,24,28,32"
PARTICLE = 4.0
"""Mean diameter of the beads of the scene [mm]."""

OFFSET = 1.4
"""k of Beverloo for spheres."""

BULK_DENSITY = 1450.0
"""Of the bed before it is opened [kg/m3]: a solid fraction of 0.58."""

FALLEN = 1200
"""Beads to wait for: less than a third of them, so that the heap stays higher than the hole is wide."""

START = 0.1
"""How long a flow takes to become steady [s]."""

BLOCKS = 8
"""Parts of the time whose flows are compared for the error of their mean."""


@dataclass(frozen=True)
class Flow:
    """Steady flow [kg/s] through a hole of diameter `hole` [mm], with its standard error and that of both halves."""

    hole: float
    rate: float
    error: float
    halves: tuple[float, float]


def flow_of(hole: float, times: np.ndarray, masses: np.ndarray) -> Flow:
    """Mean flow from the mass [kg] that has passed at times [s]; error of the mean from equal parts of the time."""
    ends = np.linspace(times[0], times[-1], BLOCKS + 1)
    rates = np.diff(np.interp(ends, times, masses)) / np.diff(ends)
    error = float(rates.std(ddof=1) / np.sqrt(BLOCKS))
    half = BLOCKS // 2
    return Flow(hole, float(rates.mean()), error, (float(rates[:half].mean()), float(rates[half:].mean())))


def exponent(flows: list[Flow], particle_diameter: float = PARTICLE, offset: float = OFFSET) -> tuple[float, float]:
    """Exponent n of W ~ (D - k d)^n and its standard error: least squares of log W, weighted with the errors.

    The error is that of the flows, or that of the scatter about the line where that is larger.
    """
    x = np.log([flow.hole - offset * particle_diameter for flow in flows])
    y = np.log([flow.rate for flow in flows])
    weight = np.array([(flow.rate / flow.error) ** 2 for flow in flows])
    x_mean, y_mean = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = float((weight * (x - x_mean) ** 2).sum())
    slope = float((weight * (x - x_mean) * (y - y_mean)).sum()) / spread
    scatter = float((weight * (y - y_mean - slope * (x - x_mean)) ** 2).sum()) / (len(flows) - 2)
    return slope, float(np.sqrt(max(scatter, 1.0) / spread))


def read_flow(folder: Path, hole: float) -> Flow:
    """The flow of a run from its timeseries.csv, from START after the opening to the end."""
    with (folder / "timeseries.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["stage"] == "discharge"]
    times = np.array([float(row["time [s]"]) for row in rows])
    masses = np.array([float(row["flow_mass.outlet [kg]"]) for row in rows])
    steady = times >= times[0] + START
    return flow_of(hole, times[steady], masses[steady])


def overrides(hole: float) -> list[str]:
    """The scene with another hole, open until about FALLEN beads have passed."""
    width = max(hole - OFFSET * PARTICLE, PARTICLE) * 1e-3
    expected = 0.5 * BULK_DENSITY * np.sqrt(9.81) * width**2.5 / (2500 * np.pi / 6 * (PARTICLE * 1e-3) ** 3)
    places = ("walls.plug.radius", "walls.floor.hole_radius", "output.flow_meters.outlet.radius")
    return [
        *(f"{place}={hole / 2} mm" for place in places),
        f"stages.1.duration={START + FALLEN / expected:.3g} s",
        "output.interval=0.2 s",
        "output.timeseries_interval=5 ms",
        "expect=[{quantity: energy_error, between: [-5e-3, 5e-3]}]",
    ]


def run(hole: float, folder: Path, threads: int | None) -> Flow:
    """Run the scene with that hole, unless it was, and read the flow."""
    from granflow import Simulation, load_scene

    if not (folder / "result.json").exists():
        simulation = Simulation(load_scene(SCENE, overrides(hole)), threads=threads, out=folder)
        simulation.run()
        simulation.free()
    return read_flow(folder, hole)


def report(flows: list[Flow]) -> str:
    """What was found, as text."""
    lines = [f"{'D [mm]':>7} {'W [g/s]':>9} {'error':>7} {'1st half':>9} {'2nd half':>9}"]
    for flow in flows:
        rate, first, second = (1e3 * each for each in (flow.rate, *flow.halves))
        lines.append(f"{flow.hole:7.1f} {rate:9.2f} {flow.error / flow.rate:7.1%} {first:9.2f} {second:9.2f}")
    data = Discharge(*(np.array(each) for each in zip(*((1e-3 * flow.hole, flow.rate) for flow in flows), strict=True)))
    fit = fit_beverloo(data, 1e-3 * PARTICLE, BULK_DENSITY)
    lines += [
        "exponent at k = {:.1f}: {:.3f} +- {:.3f}".format(OFFSET, *exponent(flows)),
        f"at the exponent 5/2: k = {fit.k:.2f} +- {fit.k_error:.2f}, C = {fit.c:.3f} +- {fit.c_error:.3f}",
    ]
    changes = [second / first - 1 for first, second in (flow.halves for flow in flows)]
    lines.append(
        f"second half over first: {np.mean(changes):+.1%} on average, {min(changes):+.1%} to {max(changes):+.1%}"
    )
    return "\n".join(lines)


def main() -> None:
    """Run, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--holes", default=HOLES, help=f"diameters [mm] ({HOLES})")
    parser.add_argument("--threads", type=int, help="CPU threads (all)")
    parser.add_argument("--out", type=Path, default=Path("out/beverloo"), help="folder of the runs (out/beverloo)")
    options = parser.parse_args()
    holes = [float(each) for each in options.holes.split(",")]
    print(report([run(hole, options.out / f"hole_{hole:g}mm", options.threads) for hole in holes]))


if __name__ == "__main__":
    main()
