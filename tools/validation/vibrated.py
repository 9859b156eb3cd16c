"""Validation cases of a completely inelastic particle on a vibrating plate, against the event-driven map.

The plate has the height A sin(w t), Gamma = A w^2/g (Mehta & Luck 1990, doi 10.1103/PhysRevLett.65.393): the
particle rests on the plate until the plate accelerates downward by more than g, at sin(w t) = 1 / Gamma,
lands without rebound, and leaves again at once if it lands while the plate accelerates downward by more than
g.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from granflow import Scene, Simulation, Snapshot, on_interval
from validation.case import ValidationCase

GRAVITY, FREQUENCY, RADIUS = 9.81, 25.0, 0.0025
SOLID = {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 2500.0}
PERIODS, TRANSIENT = 120, 100
"""Periods of the plate per run, and periods whose flights do not count: near the period doubling, flights
converge to one duration slowly."""
GAMMAS = (0.95, 1.05, 1.5, 2.5, 3.2, 3.4, 3.6, 3.76, 3.8, 4.2)
"""Amplitudes. From sqrt(1 + pi^2) = 3.297, a flight lasts a whole period."""
DOUBLING, ABOVE = math.sqrt(4.0 + math.pi**2), (3.76, 3.8)
"""Amplitude above which flights of two durations alternate, and two amplitudes from which it is extrapolated.

A flight of a whole period starts at the phase p with cos p = pi / Gamma. A start that is late by q ends late
by (1 - Gamma sin p) q: the deviation changes its sign and grows if Gamma sin p exceeds 2."""
SAMPLES = 400
"""Samples per period."""
OVERLAP_TIME = 0.004
"""Share of a period by which flights end earlier: the contact forms one overlap, 30 micrometers, above the
plate."""


def landing_phase(gamma: float, start: float) -> float:
    """Phase p at which a flight that starts with the velocity of the plate ends; heights in g/w^2, phases in
    w t.

    gamma sin(p0) + gamma cos(p0) (p - p0) - (p - p0)^2 / 2 = gamma sin(p)
    """
    from scipy.optimize import brentq

    def height(phase: np.ndarray) -> np.ndarray:
        time = phase - start
        return np.asarray(gamma * (np.sin(start) - np.sin(phase) + np.cos(start) * time) - 0.5 * time**2)

    grid = start + np.linspace(1e-3, 4.0 * np.pi, 40000)
    first = int(np.argmax(height(grid) < 0.0))
    return float(brentq(height, grid[first - 1], grid[first], xtol=1e-12))


def flights_of_map(gamma: float) -> np.ndarray:
    """Durations of the flights after the transient, over the period, by the event-driven map; none below
    Gamma = 1."""
    if gamma < 1.0:
        return np.array([])
    release = np.arcsin(1.0 / gamma)
    cycle = 2.0 * np.pi
    flights = []
    start = release
    while start < cycle * PERIODS:
        landing = landing_phase(gamma, start)
        if start > cycle * TRANSIENT and landing < cycle * PERIODS:
            flights.append((landing - start) / cycle)
        rests = gamma * np.sin(landing) < 1.0
        start = release + cycle * np.ceil((landing - release) / cycle) if rests else landing
    return np.array(flights)


def plates_scene(gammas: Sequence[float]) -> Scene:
    """One particle at rest on a vibrating plate for each amplitude, with the restitution 0."""
    side = 4.0 * RADIUS
    walls = {
        f"plate_{number}": {
            "shape": "rectangle",
            "material": "glass",
            "corner": [(number - 0.5) * side, -0.5 * side, 0.0],
            "sides": [[side, 0.0, 0.0], [0.0, side, 0.0]],
            "motion": {"kind": "vibration", "direction": [0, 0, 1], "gamma": gamma, "frequency": FREQUENCY},
        }
        for number, gamma in enumerate(gammas)
    }
    positions = [[number * side, 0.0, RADIUS] for number in range(len(gammas))]
    group = {
        "material": "glass",
        "count": len(gammas),
        "diameter": 2.0 * RADIUS,
        "insert": {"kind": "positions", "positions": positions},
    }
    return Scene.from_dict(
        {
            "title": "Inelastic particles on vibrating plates",
            "gravity": [0.0, 0.0, -GRAVITY],
            "materials": {"glass": SOLID},
            "pairs": {"glass-glass": {"restitution": 0.0, "friction": 0.0}},
            "contact": {"normal": "zhou", "tangential": "none", "rolling": "none"},
            "particles": {"particles": group},
            "walls": walls,
            "domain": {"min": [-0.2] * 3, "max": [0.2] * 3, "on_exit": "error"},
            "run": {"duration": PERIODS / FREQUENCY, "velocity_max": 0.5, "precision": "f64"},
            "numerics": {"time_step_fraction": 0.2},
            "output": {"interval": 1.0},
        }
    )


def flights_of_run(gammas: Sequence[float], samples: int) -> list[np.ndarray]:
    """For each amplitude, durations of the flights after the transient, over the period; `samples` per
    period.

    A flight is a time without force that is longer than three samples.
    """
    snapshots: list[Snapshot] = []
    interval = 1.0 / (samples * FREQUENCY)
    start = (TRANSIENT - 1) / FREQUENCY
    observer = on_interval(interval, snapshots.append, ("particles", "contacts"), start)
    simulation = Simulation(plates_scene(gammas), observers=[observer])
    simulation.run()
    simulation.free()
    supported = np.zeros((len(snapshots), len(gammas)), dtype=bool)
    for row, snapshot in enumerate(snapshots):
        assert snapshot.contacts is not None
        has_force = np.linalg.norm(snapshot.contacts["force"], axis=1) > 0.0
        supported[row, snapshot.contacts["id_i"][has_force]] = True
    time = FREQUENCY * np.array([each.time for each in snapshots])
    return [_times_without_force(time, each, samples) for each in supported.T]


def _times_without_force(time: np.ndarray, supported: np.ndarray, samples: int) -> np.ndarray:
    """Durations of the flights that start after the transient and end before the last time."""
    ends = np.flatnonzero(supported[:-1] & ~supported[1:])
    begins = np.flatnonzero(~supported[:-1] & supported[1:])
    pairs = [(time[end], time[begins[begins > end][0]]) for end in ends if np.any(begins > end)]
    return np.array([b - a for a, b in pairs if a > TRANSIENT and b - a > 3.5 / samples])


def vibrated_cases(gammas: Sequence[float] = GAMMAS, samples: int = SAMPLES) -> list[ValidationCase]:
    """Shortest and longest flight for each amplitude; none below Gamma = 1."""
    flights = dict(zip(gammas, flights_of_run(gammas, samples), strict=True))
    cases = []
    for gamma, found in flights.items():
        cases += flight_cases(gamma, found, samples)
    return cases + ([doubling_case(flights, samples)] if set(ABOVE) <= set(gammas) else [])


def onset_of_doubling(flights: Mapping[float, np.ndarray]) -> tuple[float, float]:
    """Amplitude at which the difference of both durations vanishes, and its change with that difference.

    The square of the difference is proportional to the excess of the amplitude, to first order: a line
    through the amplitudes of ABOVE.
    """
    low, high = (float(np.ptp(flights[gamma])) for gamma in ABOVE)
    slope = (ABOVE[1] - ABOVE[0]) / (high**2 - low**2)
    return ABOVE[0] - slope * low**2, 2.0 * slope * low


def doubling_case(flights: Mapping[float, np.ndarray], samples: int) -> ValidationCase:
    """Amplitude of the period doubling, extrapolated from both durations above it."""
    exact, change = onset_of_doubling({gamma: flights_of_map(gamma) for gamma in ABOVE})
    return ValidationCase(
        "Inelastic particle on a vibrating plate",
        "Gamma of the period doubling",
        DOUBLING,
        "sqrt(4 + pi^2): deviations of a flight of one period change their sign and grow",
        onset_of_doubling(flights)[0],
        "1",
        (abs(exact - DOUBLING) + change / samples) / DOUBLING + OVERLAP_TIME * (math.pi / DOUBLING) ** 2,
        f"the same line through durations of the map, one sample of {samples} per period, and flights that "
        f"end one overlap early, {100 * OVERLAP_TIME:g} % of a period: Gamma^2 = 4 + (pi (1 - share))^2",
    )


def flight_cases(gamma: float, found: np.ndarray, samples: int) -> list[ValidationCase]:
    """Cases of one amplitude from the durations of the flights of a run, over the period."""
    source = "event-driven map (Mehta & Luck 1990, doi 10.1103/PhysRevLett.65.393)"
    expected = flights_of_map(gamma)
    if not len(expected):
        return [
            ValidationCase(
                "Inelastic particle on a vibrating plate",
                f"Gamma = {gamma:g}: number of flights",
                0.0,
                source,
                float(len(found)),
                "1",
                0.0,
                "no flight below Gamma = 1",
                scale=1.0,
            )
        ]
    reason = (
        f"flights end one overlap early, {100 * OVERLAP_TIME:g} % of a period, and one sample of {samples} "
        "per period"
    )
    return [
        ValidationCase(
            "Inelastic particle on a vibrating plate",
            f"Gamma = {gamma:g}: {name} flight over the period",
            float(chosen(expected)),
            source,
            float(chosen(found)) if len(found) else math.nan,
            "1",
            OVERLAP_TIME + 1.0 / samples,
            reason,
            scale=1.0,
            remark=(
                f"Periods {TRANSIENT} to {PERIODS}. A flight lasts one period from sqrt(1 + pi^2) = 3.297 "
                "on; flights of two durations alternate above sqrt(4 + pi^2) = 3.724 (period doubling)."
            ),
        )
        for name, chosen in (("shortest", np.min), ("longest", np.max))
    ]
