"""Exponent of the Beverloo law from a flat-bottomed silo with orifices of several diameters.

    python tools/beverloo.py                             scenes/flat_silo.yaml with five orifices, a few minutes
    python tools/beverloo.py --holes 18,24,32 --threads 2 --out out/beverloo

    W = C rho_b sqrt(g) (D - k d)^(5/2)        (Beverloo, Leniger & van de Velde 1961)

Prints the mass flow through each orifice, in total and in the first and second half of the time, the exponent at
k = 1.4 (spheres), and k and C at the exponent 5/2. Each run writes into a separate folder; existing runs are not
repeated. `granflow beverloo` reads the same folders.
"""

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow.studies.beverloo import Discharge, fit_beverloo

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "flat_silo.yaml"
HOLES = "18,21,24,28,32"
PARTICLE = 4.0
"""Mean particle diameter of the scene [mm]."""

OFFSET = 1.4
"""Beverloo's k for spheres."""

BULK_DENSITY = 1450.0
"""Bulk density of the closed bed [kg/m3]: a solid fraction of 0.58."""

FALLEN = 1200
"""Particles to discharge: less than a third of the bed, so that the fill height exceeds the orifice diameter."""

START = 0.1
"""Time until the flow is steady [s]."""

BLOCKS = 8
"""Equal time intervals from which the standard error of the mean flow is computed."""


@dataclass(frozen=True)
class Flow:
    """Steady mass flow [kg/s] through an orifice of diameter `hole` [mm], its standard error, and that of each half."""

    hole: float
    rate: float
    error: float
    halves: tuple[float, float]


def flow_of(hole: float, times: np.ndarray, masses: np.ndarray) -> Flow:
    """Mean flow from the discharged mass [kg] at times [s]; standard error from equal time intervals."""
    ends = np.linspace(times[0], times[-1], BLOCKS + 1)
    rates = np.diff(np.interp(ends, times, masses)) / np.diff(ends)
    error = float(rates.std(ddof=1) / np.sqrt(BLOCKS))
    half = BLOCKS // 2
    return Flow(hole, float(rates.mean()), error, (float(rates[:half].mean()), float(rates[half:].mean())))


def exponent(flows: list[Flow], particle_diameter: float = PARTICLE, offset: float = OFFSET) -> tuple[float, float]:
    """Exponent n of W ~ (D - k d)^n and its standard error: least squares of log W, weighted with the errors.

    The error follows from the errors of the flows or from the scatter about the line, whichever is larger.
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
    """Mass flow of a run from its timeseries.csv, from START after the orifice opens to the end."""
    with (folder / "timeseries.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["stage"] == "discharge"]
    times = np.array([float(row["time [s]"]) for row in rows])
    masses = np.array([float(row["flow_mass.outlet [kg]"]) for row in rows])
    steady = times >= times[0] + START
    return flow_of(hole, times[steady], masses[steady])


def overrides(hole: float) -> list[str]:
    """Overrides for an orifice of another diameter and a duration in which about FALLEN particles pass."""
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
    """Runs the scene with this orifice, unless its folder exists, and reads the flow."""
    from granflow import Simulation, load_scene

    if not (folder / "result.json").exists():
        simulation = Simulation(load_scene(SCENE, overrides(hole)), threads=threads, out=folder)
        simulation.run()
        simulation.free()
    return read_flow(folder, hole)


def report(flows: list[Flow]) -> str:
    """Table of the flows and the fitted parameters, as text."""
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
    """Runs the scenes, fits the law and prints the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--holes", default=HOLES, help=f"orifice diameters [mm] ({HOLES})")
    parser.add_argument("--threads", type=int, help="CPU threads (all)")
    parser.add_argument("--out", type=Path, default=Path("out/beverloo"), help="folder of the runs (out/beverloo)")
    options = parser.parse_args()
    holes = [float(each) for each in options.holes.split(",")]
    print(report([run(hole, options.out / f"hole_{hole:g}mm", options.threads) for hole in holes]))


if __name__ == "__main__":
    main()
