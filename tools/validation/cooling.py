"""Validation cases of cooling gases: Haff's law against Enskog's theory, and viscoelastic spheres.

The gases are the periodic box of the shipped scene `verification/haff_periodic`, with more particles and with
random velocities. Their temperatures over time are compared with the kinetic theory of smooth rigid spheres.
Two corrections for soft spheres are computed from collisions of two particles (`softness`): oblique impacts
dissipate less, because the normal turns during the contact (Mueller & Poeschel 2012, doi
10.1007/s10035-012-0324-5), and contacts last for a share of the time between collisions.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow import Scene, Simulation, on_interval
from granflow.geometry.sphere import sphere_volume
from validation.case import ValidationCase, shipped_scene

# Kinetic theory of cooling gases of smooth hard spheres, in the approximation of Enskog.
#
# Temperature theta [m2/s2]: a third of the mean square velocity. With n particles of diameter s per volume
# and the pair correlation chi at contact, each particle has w collisions per second, and a collision with the
# normal velocity v dissipates m v^2 (1 - e^2) / 4:
#
#     w = 4 n s^2 chi sqrt(pi theta),   chi = (1 - phi/2) / (1 - phi)^3       (Carnahan & Starling)
#     d(theta)/dt = -w theta <u (1 - e(v)^2)> / 3,   v^2 = 4 theta u,   u exponentially distributed

Restitution = Callable[[np.ndarray], np.ndarray]
"""Coefficient of restitution over the normal velocity [m/s]."""
NODES, WEIGHTS = np.polynomial.laguerre.laggauss(24)
"""Quadrature over u."""
TIMES = 2000
"""Steps of the integration of the temperature."""


@dataclass(frozen=True)
class Gas:
    """Monodisperse gas: number of particles, diameter [m], volume [m3]."""

    count: int
    diameter: float
    volume: float

    @property
    def pair_correlation(self) -> float:
        """chi at contact."""
        phi = self.count * sphere_volume(0.5 * self.diameter) / self.volume
        return (1.0 - 0.5 * phi) / (1.0 - phi) ** 3

    def collision_rate(self, theta: float) -> float:
        """Collisions per particle and second at the temperature theta [m2/s2]."""
        density = self.count / self.volume
        return 4.0 * density * self.diameter**2 * self.pair_correlation * math.sqrt(math.pi * theta)


def kurtosis(e: float) -> float:
    """a_2 of the homogeneous cooling state with constant restitution (van Noije & Ernst 1998)."""
    return 16.0 * (1.0 - e) * (1.0 - 2.0 * e**2) / (81.0 - 17.0 * e + 30.0 * e**2 * (1.0 - e))


def haff_slope(gas: Gas, e: float, theta: float) -> float:
    """d(sqrt(theta_0 / theta))/dt [1/s] of Haff's law, (1 - e^2) w / 6, times 1 + 3 a_2 / 16; theta_0 =
    theta."""
    return (1.0 - e**2) * gas.collision_rate(theta) / 6.0 * (1.0 + 3.0 * kurtosis(e) / 16.0)


def loss_of(restitution: Restitution, theta: float) -> float:
    """<u (1 - e(v)^2)> over the normal velocities v = sqrt(4 theta u) of collisions at the temperature
    [m2/s2]."""
    return float(np.sum(WEIGHTS * NODES * (1.0 - restitution(np.sqrt(4.0 * theta * NODES)) ** 2)))


def cooling_curve(
    gas: Gas, restitution: Restitution, theta: float, end: float, factor: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] to `end` and temperatures (n,) [m2/s2] from theta, with the cooling rate times
    `factor`."""
    time = np.linspace(0.0, end, TIMES + 1)
    found = [theta]
    for step in np.diff(time):
        half = found[-1] + 0.5 * step * _rate(gas, restitution, found[-1], factor)
        found.append(found[-1] + step * _rate(gas, restitution, half, factor))
    return time, np.array(found)


def _rate(gas: Gas, restitution: Restitution, theta: float, factor: float) -> float:
    """d(theta)/dt [m2/s3]."""
    return -factor * gas.collision_rate(theta) * theta * loss_of(restitution, theta) / 3.0


def viscoelastic_restitution(e: float, velocity: float) -> Restitution:
    """Restitution of viscoelastic spheres that have e at a velocity [m/s], over the velocity.

    In units of the undamped collision, x'' = -x^(3/2) - g x^(1/2) x' with g ~ v^(1/5), until the force is
    zero (Schwager & Poeschel 2008, doi 10.1103/PhysRevE.78.051304).
    """
    g = np.linspace(0.0, 1.0, 41)
    table = np.array([_rebound(each) for each in g])
    g_reference = float(np.interp(-e, -table, g))

    def restitution(speed: np.ndarray) -> np.ndarray:
        return np.interp(g_reference * (speed / velocity) ** 0.2, g, table)

    return restitution


def _rebound(g: float) -> float:
    """Restitution of a collision with the dissipation g."""
    from scipy.integrate import solve_ivp

    def motion(_: float, state: np.ndarray) -> tuple[float, float]:
        x = max(state[0], 0.0)
        return state[1], -(x**1.5) - g * math.sqrt(x) * state[1]

    def force(_: float, state: np.ndarray) -> float:
        return float(state[0] + g * state[1])

    force.terminal = True  # type: ignore[attr-defined]
    force.direction = -1.0  # type: ignore[attr-defined]
    run = solve_ivp(motion, (0.0, 10.0), (1e-9, 1.0), events=force, rtol=1e-10, atol=1e-12)
    return float(-run.y_events[0][0][1])


# Runs of cooling gases, and collisions of two of their particles.

DIAMETER, DENSITY_OF_SCENE = 1e-3, 600 / 0.02**3
"""Diameter [m] and particles per volume [1/m3] of the shipped scene."""
THETA = 1.0 / 3.0
"""Initial temperature [m2/s2] of the shipped scene: all particles move at 1 m/s."""
RESTITUTION = 0.8
"""Restitution of the shipped scene, and of viscoelastic spheres at 1 m/s."""
START = 0.003
"""Start of the evaluation [s], about one collision per particle."""
FASTEST = 4.0
"""Largest relative velocity [m/s] for which the time step is chosen."""
FRACTION, PAIR_FRACTION = 0.1, 0.01
"""Time step over the shorter of loading and unloading time, of gases (0.1 % less loss) and of two
particles."""
SAMPLES = 100
"""Temperatures of each run."""
IMPACTS, SPEEDS = 16, 4
"""Impact parameters and relative velocities of the collisions of two particles."""


@dataclass(frozen=True)
class Softness:
    """Effect of soft contacts in a gas.

    oblique:   energy dissipated by collisions over that of rigid spheres
    duration:  mean duration of contacts [s]
    """

    oblique: float
    duration: float


def gas_of(count: int) -> Gas:
    """A gas with the density of the shipped scene."""
    return Gas(count, DIAMETER, count / DENSITY_OF_SCENE)


def gas_scene(count: int, modulus: float, normal: Any, end: float, seed: int = 1) -> Scene:
    """A gas like that of the shipped scene, with Young's modulus [Pa], normal contact model and duration
    [s]."""
    half = 0.5 * gas_of(count).volume ** (1.0 / 3.0)
    corners = {"min": [-half] * 3, "max": [half] * 3}
    pack = {"kind": "pack", "region": {"box": corners}}
    group = {
        "material": "ball",
        "count": count,
        "diameter": DIAMETER,
        "insert": pack,
        "thermal": {"velocity_rms": (3.0 * THETA) ** 0.5},
    }
    domain = corners | {"periodic": ["x", "y", "z"], "on_exit": "error"}
    return changed_scene(modulus, normal, end, {"gas": group}, domain, seed)


def changed_scene(
    modulus: float,
    normal: Any,
    end: float,
    groups: dict[str, Any],
    domain: dict[str, Any],
    seed: int = 1,
    time_step_fraction: float = FRACTION,
) -> Scene:
    """The shipped scene with other particles, Young's modulus [Pa], normal contact model, duration [s] and
    domain."""
    data = shipped_scene("verification/haff_periodic").to_dict()
    data["materials"]["ball"]["young_modulus"] = modulus
    data["contact"]["normal"] = normal
    data["numerics"] = {"time_step_fraction": time_step_fraction, "max_overlap": 0.5}
    return Scene.from_dict(
        {
            **data,
            "seed": seed,
            "particles": groups,
            "domain": domain,
            "expect": [],
            "output": {"interval": end},
            "run": {"duration": end, "velocity_max": FASTEST, "precision": "f64"},
        }
    )


def temperatures(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] from START and temperatures (n,) [m2/s2] of a gas."""
    rows: list[tuple[float, float]] = []

    def record(snapshot: Any) -> None:
        velocity = snapshot.particles["velocity"]
        rows.append(
            (snapshot.time, float(np.mean(np.sum((velocity - velocity.mean(axis=0)) ** 2, axis=1))) / 3.0)
        )

    observer = on_interval((scene.run.duration or 1.0) / SAMPLES, record, ("particles",))
    simulation = Simulation(scene, observers=[observer])
    simulation.run()
    simulation.free()
    time, theta = np.array(rows).T
    return time[time >= START], theta[time >= START]


def softness(modulus: float, normal: Any, theta: float, restitution: Restitution) -> Softness:
    """Collisions of two particles with all impact parameters, averaged over the collisions of a gas at theta
    [m2/s2].

    With g^2 = 4 theta u, collisions have the weight u exp(-u) du, and equal weight for equal intervals of
    b^2.
    """
    from scipy.special import roots_genlaguerre

    u, weight = roots_genlaguerre(SPEEDS, 1.0)
    cosine = np.sqrt((np.arange(IMPACTS) + 0.5) / IMPACTS)
    speed, cosine = (each.ravel() for each in np.meshgrid(np.sqrt(4.0 * theta * u), cosine, indexing="ij"))
    weight = np.repeat(weight / weight.sum(), IMPACTS) / IMPACTS
    mass, loss, duration = collide_pairs(modulus, normal, speed, cosine)
    rigid = 0.25 * mass * (speed * cosine) ** 2 * (1.0 - restitution(speed * cosine) ** 2)
    return Softness(float(weight @ loss / (weight @ rigid)), float(weight @ duration))


def collide_pairs(
    modulus: float, normal: Any, speed: np.ndarray, cosine: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass [kg], dissipated energies (n,) [J] and durations (n,) [s] of separate collisions of two equal
    particles.

    speed, cosine:  (n,) relative velocity [m/s], and cosine between it and the normal at first contact
    """
    count = len(speed)
    normals = np.stack([cosine, np.sqrt(1.0 - cosine**2), np.zeros(count)], axis=1)
    places = np.zeros((count, 3))
    places[:, 2] = 4.0 * DIAMETER * np.arange(count)
    approach = np.zeros((count, 3))
    approach[:, 0] = 0.5 * speed
    gap = 1.0 + 1e-9
    position = np.concatenate(
        [places - 0.5 * gap * DIAMETER * normals, places + 0.5 * gap * DIAMETER * normals]
    )
    group = {
        "material": "ball",
        "diameter": DIAMETER,
        "velocity": np.concatenate([approach, -approach]).tolist(),
        "insert": {"kind": "positions", "positions": position.tolist()},
    }
    reach = 20.0 * DIAMETER
    domain = {
        "min": [-reach, -reach, -reach],
        "max": [reach, reach, places[-1, 2] + reach],
        "on_exit": "error",
    }
    end = 40.0 * (5e7 / modulus) ** 0.4 * 5e-5 / min(1.0, float(speed.min())) ** 0.2
    times: list[float] = []
    rows: list[np.ndarray] = []

    def record(snapshot: Any) -> None:
        times.append(snapshot.time)
        rows.append(np.bincount(snapshot.contacts["id_i"] % count, minlength=count))

    observer = on_interval(end / 4000, record, ("contacts", "particles"))
    scene = changed_scene(modulus, normal, end, {"pairs": group}, domain, time_step_fraction=PAIR_FRACTION)
    simulation = Simulation(scene, observers=[observer])
    while not rows or rows[-1].any() or len(rows) < 20:
        simulation.run(duration=end / 40)
    particles = simulation.snapshot().particles
    simulation.free()
    mass = float(particles["mass"][0])
    after = particles["velocity"]
    relative = after[:count] - after[count:]
    return mass, 0.25 * mass * (speed**2 - np.sum(relative**2, axis=1)), np.gradient(times) @ np.array(rows)


# Cases.

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
