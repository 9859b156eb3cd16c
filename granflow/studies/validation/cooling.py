"""Validation cases of cooling gases: Haff's law against Enskog's theory, and viscoelastic spheres.

The spheres of the theory are rigid. Two corrections of soft spheres are computed from collisions of two
particles (`gas_runs.softness`): oblique impacts dissipate less, because the normal turns during the contact
(Mueller & Poeschel 2012, doi 10.1007/s10035-012-0324-5), and contacts last for a share of the time between
collisions.
"""

from collections.abc import Sequence

import numpy as np

from granflow.studies.validation.case import ValidationCase
from granflow.studies.validation.gas import Gas, cooling_curve, haff_slope, loss_of, viscoelastic_restitution
from granflow.studies.validation.gas_runs import (
    RESTITUTION,
    START,
    THETA,
    gas_of,
    gas_scene,
    softness,
    temperatures,
)

COUNT, QUICK_COUNT, SEEDS = 4000, 1000, (1, 2, 3)
"""Particles of each run and its seeds. The box of 4000 particles, 38 mm, is smaller than the wavelength above
which shear waves grow, about 18 mean free paths or 49 mm."""
HAFF_END, VISCOELASTIC_END = 0.06, 0.25
"""Durations [s]: about a fifth and a twelfth of the energy is left."""
MODULI = (5e6, 50e6, 500e6)
"""Young's moduli [Pa] of the scan of the stiffness; the shipped scene has 50 MPa."""
SIGMAS = 3.0
"""Allowed deviation over the standard deviation."""
HAFF = (
    "Haff 1983, doi 10.1017/S0022112083003419, with Enskog's collision rate and the Sonine correction of van "
    "Noije & Ernst 1998, doi 10.1007/s100350050009"
)


def six_directions() -> float:
    """Dissipation of a gas with one speed and six directions over that of a Maxwell gas of equal energy.

    The dissipation is proportional to the mean of g^3 over relative velocities g: for unit speed, g is 0, 2
    and sqrt(2) for 1, 1 and 4 of 6 pairs of directions; with Maxwell's distribution, the mean is 8 sqrt(2 /
    pi) (2 / 3)^(3/2).
    """
    return float((8.0 + 4.0 * 2.0**1.5) / 6.0 / (8.0 * np.sqrt(2.0 / np.pi) * (2.0 / 3.0) ** 1.5))


def scatter(gas: Gas, collisions: float) -> float:
    """Relative standard deviation of a cooling rate from `collisions` per particle.

    The number of collisions is random, and so is the energy of each, with an exponential distribution: sqrt(2
    / K).
    """
    return float(np.sqrt(2.0 / (0.5 * gas.count * collisions)))


def haff_cases(
    moduli: Sequence[float] = MODULI, count: int = COUNT, seeds: Sequence[int] = SEEDS
) -> list[ValidationCase]:
    """Cooling rate over that of rigid spheres for several stiffnesses, and its limit for rigid spheres."""
    cases = []
    points = []
    for modulus in moduli:
        ratio, sigma, typical = haff_ratio(modulus, count, seeds)
        soft = softness(modulus, "zhou", typical, lambda speed: np.full_like(speed, RESTITUTION))
        share = gas_of(count).collision_rate(typical) * soft.duration
        points.append((modulus**-0.4, ratio, sigma))
        cases.append(haff_case(modulus, ratio, sigma, soft.oblique, share))
    return cases + ([rigid_case(np.array(points))] if len(points) > 1 else [])


def haff_ratio(modulus: float, count: int, seeds: Sequence[int]) -> tuple[float, float, float]:
    """Cooling rate over Haff's law, its relative standard deviation, and a typical temperature [m2/s2].

    The means over several gases with Young's modulus [Pa], one for each seed.
    """
    gas = gas_of(count)
    ratios = []
    typical = []
    collisions = 0.0
    for seed in seeds:
        time, theta = temperatures(gas_scene(count, modulus, "zhou", HAFF_END, seed))
        line = np.sqrt(THETA / theta)
        ratios.append((line[-1] - line[0]) / (time[-1] - time[0]) / haff_slope(gas, RESTITUTION, THETA))
        typical.append(THETA / np.mean(line) ** 2)
        collisions += 3.0 / (1.0 - RESTITUTION**2) * float(np.log(theta[0] / theta[-1]))
    return float(np.mean(ratios)), scatter(gas, collisions), float(np.mean(typical))


def haff_case(modulus: float, ratio: float, sigma: float, oblique: float, share: float) -> ValidationCase:
    """Case of one stiffness from the cooling rate over that of rigid spheres and the two corrections."""
    return ValidationCase(
        "Gas of inelastic spheres",
        f"Haff's law, E = {1e-6 * modulus:g} MPa: cooling rate over that of rigid spheres",
        oblique * (1.0 - share),
        f"{HAFF}, times the loss in oblique soft impacts of two particles, "
        "minus the share of time in contact",
        ratio,
        "1",
        share + SIGMAS * sigma,
        "100 % of the correction for the contact time, and three standard deviations sqrt(2 / K) of K "
        "collisions",
        scale=1.0,
        remark=(
            f"Corrections: oblique impacts {100 * (oblique - 1):+.2g} %, contact time {-100 * share:+.2g} %. "
            "The gas starts with random velocities; six directions of equal speed, as in the shipped scene, "
            f"dissipate {100 * (six_directions() - 1):.2g} % until they are isotropic, after 3 of 60 ms"
        ),
    )


def rigid_case(points: np.ndarray) -> ValidationCase:
    """Cooling rate in the limit of rigid spheres from rows (E^(-2/5), rate over theory, standard deviation).

    The overlap, which both corrections follow, is proportional to E^(-2/5).
    """
    softness_of, ratio, sigma = points.T
    design = np.stack([np.ones_like(softness_of), softness_of], axis=1) / sigma[:, None]
    covariance = np.linalg.inv(design.T @ design)
    limit = float((covariance @ design.T @ (ratio / sigma))[0])
    return ValidationCase(
        "Gas of inelastic spheres",
        "Haff's law: cooling rate over that of rigid spheres, limit of large E",
        1.0,
        HAFF,
        limit,
        "1",
        SIGMAS * float(np.sqrt(covariance[0, 0])),
        "three standard deviations of the extrapolation in E^(-2/5), from sqrt(2 / K) of each run",
        remark="Terms of second order in E^(-2/5) are not fitted.",
    )


def viscoelastic_gas_cases(count: int = COUNT, end: float = VISCOELASTIC_END) -> list[ValidationCase]:
    """Energy and exponent of a cooling gas of viscoelastic spheres (Brilliantov & Poeschel 2000)."""
    normal = {"law": "kuwabara_kono", "reference_velocity": 1.0}
    restitution = viscoelastic_restitution(RESTITUTION, 1.0)
    gas = gas_of(count)
    time, theta = temperatures(gas_scene(count, MODULI[1], normal, end))
    typical = float(np.sqrt(theta[0] * theta[-1]))
    soft = softness(MODULI[1], normal, typical, restitution)
    share = gas.collision_rate(typical) * soft.duration
    after, curve = cooling_curve(gas, restitution, theta[0], time[-1] - time[0], soft.oblique * (1.0 - share))
    middle = len(time) // 2
    collisions = [
        3.0 / loss_of(restitution, typical) * float(np.log(theta[i] / theta[j]))
        for i, j in ((0, middle), (middle, -1))
    ]
    sigma = scatter(gas, sum(collisions))
    halves = np.array([scatter(gas, each) for each in collisions])
    slope = abs(float((curve[-1] - curve[-2]) / (after[-1] - after[-2]) / curve[-1] * (time[-1] - time[0])))
    source = (
        "Brilliantov & Poeschel 2000, doi 10.1103/PhysRevE.61.5573: Enskog's theory with e(v), integrated"
    )
    exact = exponent(time - time[0], np.interp(time - time[0], after, curve))
    span = float(np.log(theta[0] / theta[-1])) / 2.0
    return [
        ValidationCase(
            "Gas of viscoelastic spheres",
            f"share of the energy at {1e3 * time[-1]:.0f} ms, {1e3 * START:g} ms = 1",
            float(curve[-1] / curve[0]),
            f"{source}, with the corrections for soft spheres",
            float(theta[-1] / theta[0]),
            "1",
            slope * (share + SIGMAS * sigma),
            "d ln T / d ln t times the correction for the contact time and three standard deviations sqrt(2 "
            "/ K)",
            remark=f"Corrections: oblique impacts {100 * (soft.oblique - 1):+.2g} %, contact time "
            f"{-100 * share:+.2g} %.",
        ),
        ValidationCase(
            "Gas of viscoelastic spheres",
            "exponent q in cooling rate ~ T^q",
            exact,
            source,
            exponent(time, theta),
            "1",
            SIGMAS * float(np.linalg.norm(halves)) / span,
            "three standard deviations sqrt(2 / K) of the cooling rates of both halves",
            scale=1.0,
            remark=(
                "T ~ t^(-1/q): leading order q = 3/5, t^(-5/3), for weak dissipation; constant restitution q "
                "= 1/2, t^(-2). Higher orders of e(v) lower q."
            ),
        ),
    ]


def exponent(time: np.ndarray, theta: np.ndarray) -> float:
    """q of -d(ln theta)/dt ~ theta^q from the mean rates in both halves of the times.

    For a power law, the increases of theta^(-q) in both halves have the ratio of the durations.
    """
    from scipy.optimize import brentq

    middle = len(time) // 2
    ratio = (time[-1] - time[middle]) / (time[middle] - time[0])

    def excess(q: float) -> float:
        first, second, third = theta[[0, middle, -1]] ** -q
        return float((third - second) / (second - first) - ratio)

    return float(brentq(excess, 0.05, 3.0))
