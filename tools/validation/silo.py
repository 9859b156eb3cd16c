"""Validation cases of silos: Janssen's law of the pressure in a narrow silo, Beverloo's law of discharge.

Janssen: where wall friction is fully mobilized, the vertical stress in a cylinder of the radius R saturates
over a length l = R / (2 mu K), with the ratio K of horizontal to vertical stress:

    F(h) = pi R^2 rho g l (1 - exp(-h / l))
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow import Scene, Simulation, Snapshot, on_interval
from validation.case import ValidationCase, shipped_scene

GRAVITY, DIAMETER, DENSITY = 9.81, 4e-3, 2500.0
FRICTION, INNER_FRICTION = 0.2, 0.5
"""Friction of the wall, and of the particles with each other, which prevents that they roll along the
wall."""
SILO_RADIUS = 5.0 * DIAMETER
COUNT, QUICK_COUNT = 2400, 1200
"""Particles in the silo; 2400 of them are about 27 diameters, 5.5 radii, high."""
FILL, LIFT, WALL_SPEED = 0.4, 0.3, 0.01
"""Durations [s] of filling and of lifting the wall, and velocity [m/s] of the wall."""
SAMPLES = 50
"""Samples in the second half of the lifting."""
BLOCKS = 5
"""Intervals of samples whose means give the standard error."""
JANSSEN = "Janssen 1895 (Sperl 2006, doi 10.1007/s10035-005-0224-z)"
FLOW_ORIFICES = {9e-3: 2.69, 10.5e-3: 1.6, 12e-3: 1.06, 14e-3: 0.69, 16e-3: 0.491}
"""Durations of the discharge [s] by radius of the orifice [m], those of `sweeps/silo_beverloo`."""
SEEDS = (1, 2, 3)
"""Seeds of the fillings of the silo; the flows of single runs scatter by about 3 %."""
NARROW, WIDE = 36e-3, 74e-3
"""Radii [m] of the shipped silo, and of one that is as wide as Beverloo's law requires for WIDE_ORIFICE."""
WIDE_ORIFICE = 14e-3
"""Radius [m] of the orifice of the wide silo."""
FLAT_COUNT = 4000
"""Particles of the shipped silo."""
BULK_DENSITY, C, K = 1450.0, 0.58, 1.4
"""Density of the bed [kg/m3], and published parameters of Beverloo's law for spheres."""
PARAMETER_ERROR = 0.1
"""Relative error of both parameters (scene `flat_silo`)."""
SMALLEST_ORIFICE, SILO_OVER_ORIFICE, SILO_MARGIN = 5.0, 2.5, 30.0
"""Range of the law: orifice in particle diameters, silo in orifices, difference of silo and orifice in
diameters."""
WIDTHS = "Mankoc et al. 2007, doi 10.1007/s10035-007-0062-2"
"""Source of the widths of the silo."""
BEVERLOO = "Beverloo, Leniger & van de Velde 1961, doi 10.1016/0009-2509(61)85030-6"


@dataclass(frozen=True)
class Discharge:
    """Mass flow rates [kg/s] (n,) through orifices of diameter (n,) [m]."""

    orifice: np.ndarray
    mass_flow: np.ndarray


def silo_scene(count: int) -> Scene:
    """A narrow silo that is filled, and whose wall then moves slowly upward, so that all of its friction
    carries."""
    height = 0.6 * count * DIAMETER**3 / SILO_RADIUS**2
    inside = {"from": [0, 0, 0], "to": [0, 0, height], "radius": SILO_RADIUS}
    lift = {"kind": "translation", "velocity": [0, 0, WALL_SPEED], "stages": ["lift"]}
    return Scene.from_dict(
        {
            "title": "Narrow silo",
            "gravity": [0, 0, -GRAVITY],
            "materials": dict.fromkeys(
                ("glass", "wall"), {"young_modulus": 5e6, "poisson_ratio": 0.2, "density": DENSITY}
            ),
            "pairs": {
                "glass-glass": {"restitution": 0.5, "friction": INNER_FRICTION},
                "glass-wall": {"restitution": 0.5, "friction": FRICTION},
            },
            "contact": {"normal": "hertz", "tangential": "mindlin", "rolling": "none"},
            "walls": {
                "floor": {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "glass"},
                "wall": inside
                | {"shape": "cylinder", "from": [0, 0, -0.1], "material": "wall", "motion": lift},
            },
            "particles": {
                "beads": {
                    "material": "glass",
                    "count": count,
                    "diameter": {"distribution": "uniform", "min": 0.95 * DIAMETER, "max": 1.05 * DIAMETER},
                    "insert": {"kind": "pack", "region": {"cylinder": inside}},
                }
            },
            "domain": {"min": [-0.1, -0.1, -0.1], "max": [0.1, 0.1, 2.0 * height], "on_exit": "error"},
            "stages": [{"name": "fill", "duration": FILL}, {"name": "lift", "duration": LIFT}],
            "run": {"velocity_max": 2.0, "precision": "f64"},
            "numerics": {"time_step_fraction": 0.12, "max_overlap": 0.3},
            "output": {"interval": 10.0},
        }
    )


def contact_forces(snapshot: Snapshot) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Force [N] on the floor, and heights [m], normal and vertical forces [N] (c,) of the particles on the
    wall."""
    contacts = snapshot.contacts
    assert contacts is not None
    of_floor = contacts["wall"] == 0
    of_wall = contacts["wall"] == 1
    forces = (
        contacts["position_j"][of_wall, 2],
        contacts["normal_force"][of_wall],
        contacts["force"][of_wall, 2],
    )
    return float(contacts["force"][of_floor, 2].sum()), *forces


def janssen_cases(count: int = COUNT) -> list[ValidationCase]:
    """Weight on the floor, balance of the weight, and mobilized friction of a narrow silo."""
    snapshots: list[Snapshot] = []
    start = FILL + 0.5 * LIFT
    observer = on_interval(0.5 * LIFT / SAMPLES, snapshots.append, ("particles", "contacts"), start)
    simulation = Simulation(silo_scene(count), observers=[observer])
    simulation.run()
    simulation.free()
    return evaluate_silo([each for each in snapshots if each.time > start])


def evaluate_silo(snapshots: Sequence[Snapshot]) -> list[ValidationCase]:
    """The cases from snapshots of the silo while its wall moves upward."""
    weight = GRAVITY * float(snapshots[0].particles["mass"].sum())
    height = float(np.mean([np.quantile(each.particles["position"][:, 2], 0.98) for each in snapshots]))
    forces = [contact_forces(each) for each in snapshots]
    floor = np.array([each[0] for each in forces]) / weight
    whole = floor + np.array([upward.sum() for *_, upward in forces]) / weight
    ratio, friction = middle_stresses(snapshots, forces, height)
    x = 2.0 * friction * ratio * height / SILO_RADIUS
    share = -math.expm1(-x) / x
    end = DIAMETER / height
    return [
        ValidationCase(
            "Narrow silo",
            "weight carried by floor and wall over the weight",
            1.0,
            "balance of forces",
            float(np.mean(whole)),
            "1",
            3.0 * block_error(whole) + WALL_SPEED / (GRAVITY * 0.5 * LIFT),
            "three standard errors of the mean of five intervals, and a change of the velocity of the bed by "
            "that of the wall, v / (g t)",
            scale=1.0,
        ),
        ValidationCase(
            "Narrow silo",
            f"share of the weight on the floor, height {height / SILO_RADIUS:.3g} R, K = {ratio:.3g}",
            share,
            JANSSEN,
            float(np.mean(floor)),
            "1",
            3.0 * block_error(floor) + 2.0 * end,
            "three standard errors of five intervals, and the weight of a layer of one diameter at each end, "
            "where the stresses are not those of the middle",
            scale=1.0,
            remark=(
                f"K and the share of the friction limit at the wall, {friction / FRICTION:.2g}, are measured "
                "in the middle third of the height; the law predicts the rest of the profile."
            ),
        ),
    ]


def block_error(values: np.ndarray) -> float:
    """Standard error of the mean from the means of BLOCKS intervals."""
    means = [each.mean() for each in np.array_split(values, BLOCKS)]
    return float(np.std(means) / math.sqrt(BLOCKS - 1))


def middle_stresses(
    snapshots: Sequence[Snapshot],
    forces: Sequence[tuple[float, np.ndarray, np.ndarray, np.ndarray]],
    height: float,
) -> tuple[float, float]:
    """Horizontal over vertical stress, and vertical over normal force of the wall, in the middle third of the
    height.

    The wall gives the horizontal stress; the vertical one is the weight above minus the force of the wall
    above.
    """
    low, high = height / 3.0, 2.0 * height / 3.0
    normal_sums = []
    vertical_sums = []
    vertical = []
    for snapshot, (_, z, normal, upward) in zip(snapshots, forces, strict=True):
        inside = (z > low) & (z < high)
        particles = snapshot.particles
        normal_sums.append(normal[inside].sum())
        vertical_sums.append(upward[inside].sum())
        for level in np.linspace(low, high, 9):
            above = GRAVITY * particles["mass"][particles["position"][:, 2] > level].sum()
            vertical.append(above - upward[z > level].sum())
    horizontal = np.mean(normal_sums) / (2.0 * math.pi * SILO_RADIUS * (high - low))
    ratio = horizontal / (np.mean(vertical) / (math.pi * SILO_RADIUS**2))
    return float(ratio), float(np.mean(vertical_sums) / np.mean(normal_sums))


def beverloo_flow(orifice: float) -> float:
    """Mass flow rate [kg/s] of Beverloo's law with the published parameters, through an orifice [m]."""
    return C * BULK_DENSITY * math.sqrt(GRAVITY) * (orifice - K * DIAMETER) ** 2.5


def in_range(orifice: float, silo: float) -> bool:
    """Whether Beverloo's law holds for the diameters [m] of an orifice and a silo."""
    margin = orifice + SILO_MARGIN * DIAMETER
    return orifice >= SMALLEST_ORIFICE * DIAMETER and silo >= max(SILO_OVER_ORIFICE * orifice, margin)


def discharge(radius: float, silo: float) -> list[float]:
    """Steady mass flow rates [kg/s] through an orifice in a silo of these radii [m], one for each of
    SEEDS."""
    return [discharge_of(radius, silo, seed) for seed in SEEDS]


def discharge_of(radius: float, silo: float, seed: int) -> float:
    """Steady mass flow rate [kg/s] of the shipped silo with these radii [m], filled with a seed to the same
    height."""
    orifice = ("walls.plug.radius", "walls.floor.hole_radius", "output.flow_meters.outlet.radius")
    overrides = [
        *(f"{key}={radius}" for key in orifice),
        f"stages.1.duration={FLOW_ORIFICES[radius]}",
        f"seed={seed}",
    ]
    if silo != NARROW:
        side = silo + DIAMETER
        region = "particles.beads.insert.region.cylinder.radius"
        overrides += [f"{key}={silo}" for key in ("walls.floor.radius", "walls.bin.radius", region)]
        overrides += [f"domain.min=[{-side}, {-side}, -0.02]", f"domain.max=[{side}, {side}, 0.14]"]
        overrides.append(f"particles.beads.count={round(FLAT_COUNT * (silo / NARROW) ** 2)}")
    simulation = Simulation(shipped_scene("flat_silo", overrides))
    result = simulation.run()
    simulation.free()
    return float(result.flow_meters["outlet"]["mass_flow"])


def discharge_cases(
    radii: Sequence[float] = tuple(FLOW_ORIFICES),
    wide: bool = True,
    flows_of: Callable[[float, float], Sequence[float]] = discharge,
) -> list[ValidationCase]:
    """Flow through each orifice of the shipped silo, for three and more the fitted exponent and k; and a wide
    silo.

    flows_of:  flow rates [kg/s] of several fillings, by the radii [m] of orifice and silo
    """
    flows = [flows_of(each, NARROW) for each in radii]
    found = [
        discharge_case(2.0 * radius, 2.0 * NARROW, values)
        for radius, values in zip(radii, flows, strict=True)
    ]
    if wide:
        found.append(discharge_case(2.0 * WIDE_ORIFICE, 2.0 * WIDE, flows_of(WIDE_ORIFICE, WIDE)))
    means = np.mean(flows, axis=1)
    return found + (fitted_cases(Discharge(2.0 * np.array(radii), means)) if len(radii) > 3 else [])


def discharge_case(orifice: float, silo: float, flows: Sequence[float]) -> ValidationCase:
    """Mean of the flows [kg/s] of several fillings through an orifice in a silo of these diameters [m].

    The reference is Beverloo's law with the published parameters.
    """
    share = 2.5 * K * DIAMETER / (orifice - K * DIAMETER)
    is_in_range = in_range(orifice, silo)
    reference = beverloo_flow(orifice)
    error = float(np.std(flows, ddof=1)) / math.sqrt(len(flows))
    beyond = (
        f". The law holds for silos wider than {SILO_OVER_ORIFICE:g} orifices and wider than the orifice "
        f"plus {SILO_MARGIN:g} diameters ({WIDTHS}): beyond the range"
    )
    return ValidationCase(
        "Discharge of a flat-bottomed silo",
        f"silo of {1e3 * silo:g} mm, flow through {1e3 * orifice:g} mm, {orifice / DIAMETER:.3g} diameters",
        reference,
        BEVERLOO,
        float(np.mean(flows)),
        "kg/s",
        3.0 * error / reference + PARAMETER_ERROR * math.hypot(1.0, share),
        f"three standard errors of the mean of {len(flows)} fillings, and 10 % of C and 10 % of k, "
        "independent of each other",
        remark=(
            "C = 0.58 and k = 1.4 are means over materials; C decreases with the friction of the particles "
            "(0.5). The bulk density, 1450 kg/m3, is the mean of the filled bed; with that in its middle, "
            "1500, flows are another 3 % below the law"
        )
        + ("" if is_in_range else beyond),
        in_range=is_in_range,
    )


def fitted_cases(data: Discharge) -> list[ValidationCase]:
    """k at the exponent 5/2, and the exponent at the published k."""
    k, k_error = fitted_k(data)
    exponent, error = exponent_at(data, K)
    shift = abs(exponent_at(data, (1.0 + PARAMETER_ERROR) * K)[0] - exponent)
    rows = (
        ("k at the exponent 5/2", K, k, 3.0 * k_error + PARAMETER_ERROR * K, "10 % of k"),
        (
            "exponent at k = 1.4",
            2.5,
            exponent,
            3.0 * error + shift,
            "the change of the exponent for 10 % of k",
        ),
    )
    return [
        ValidationCase(
            "Discharge of a flat-bottomed silo",
            name,
            reference,
            BEVERLOO,
            value,
            "1",
            allowed,
            f"three standard errors of the fit, and {published}",
            scale=1.0,
        )
        for name, reference, value, allowed, published in rows
    ]


def fitted_k(data: Discharge) -> tuple[float, float]:
    """k at the exponent 5/2, and its standard error, from a fit of

        ln W = ln(C rho sqrt(g) d^(5/2)) + 5/2 ln(D/d - k)

    in which small flows have the same weight as large ones.
    """
    from scipy.optimize import curve_fit

    def logarithm(ratio: np.ndarray, level: float, k: float) -> np.ndarray:
        return np.asarray(level + 2.5 * np.log(ratio - k))

    ratio = data.orifice / DIAMETER
    flow = np.log(data.mass_flow)
    start = (float(np.mean(flow - 2.5 * np.log(ratio - K))), K)
    bounds = ((-np.inf, -10.0), (np.inf, float(ratio.min())))
    values, covariance = curve_fit(logarithm, ratio, flow, start, bounds=bounds, xtol=1e-12)
    return float(values[1]), math.sqrt(covariance[1, 1])


def exponent_at(data: Discharge, k: float) -> tuple[float, float]:
    """Exponent of D - k d for a given k, and its standard error, from the slope of ln W over ln(D - k d)."""
    x, y = np.log(data.orifice - k * DIAMETER), np.log(data.mass_flow)
    slope, level = np.polyfit(x, y, 1)
    residual = float(np.sum((y - slope * x - level) ** 2))
    return float(slope), math.sqrt(residual / (len(x) - 2) / float(np.sum((x - x.mean()) ** 2)))
