"""Validation cases of dense sheared flows: friction and solid fraction over the inertial number I.

    mu(I) = mu_1 + (mu_2 - mu_1) / (1 + I_0 / I),   I = shear rate d / sqrt(P / density)

with mu_1 = tan 20.9 deg, mu_2 = tan 32.76 deg, I_0 = 0.279 (Jop, Forterre & Pouliquen 2006), and the solid
fraction 0.6 - 0.1 I (Pouliquen, Cassar, Jop, Forterre & Nicolas 2006).
"""

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow import Scene, Simulation, read_run
from validation.case import ValidationCase, shipped_scene
from validation.silo import block_error

JOP = "Jop, Forterre & Pouliquen 2006, doi 10.1038/nature04801"
POULIQUEN = "Pouliquen, Cassar, Jop, Forterre & Nicolas 2006, doi 10.1088/1742-5468/2006/07/P07020"
ANGLES, I_0 = (20.9, 32.76), 0.279
"""Angles [deg] at I = 0 and of fast flows, and I_0, of glass beads."""
ANGLE_ERROR = 2.0
"""Differences [deg] between the angles of different glass beads and simulated spheres."""
FRACTION_ERROR = 0.03
"""Differences between solid fractions of glass beads and of simulated spheres with this friction."""
LARGEST_I = 0.3
"""Approximate limit of dense flows (GDR MiDi 2004, doi 10.1140/epje/i2003-10153-0)."""
SLOPE = np.tan(np.radians(25.0))
"""Ratio of shear to normal stress in steady flow down the slope of `sheared_layer`."""
GRAVITY, FRAME_INTERVAL = 9.81, 0.02
"""Gravity [m/s2], and interval [s] of the frames of `sheared_layer`."""
DIAMETER, DENSITY, RATE = 4e-3, 2500.0, 20.0
"""Diameter [m] and density [kg/m3] of the particles, and shear rate [1/s] of `shear_cell`."""
BULK = (14e-3, 44e-3)
"""Heights [m] of the layer that are compared, away from base and surface."""


@dataclass(frozen=True)
class Shear:
    """Means of a sheared flow: inertial number, shear over normal stress, and solid fraction."""

    inertial_number: float
    friction: float
    solid_fraction: float


def friction_at(inertial_number: float) -> float:
    """mu(I) of Jop, Forterre & Pouliquen (2006)."""
    low, high = np.tan(np.radians(ANGLES))
    return float(low + (high - low) / (1.0 + I_0 / inertial_number))


def frames_of(scene: Scene, name: str) -> list[dict[str, np.ndarray]]:
    """Frames of a coarse-grained field of a run: arrays (cells,) or (cells, k), with `position`."""
    with tempfile.TemporaryDirectory() as folder:
        simulation = Simulation(scene, out=Path(folder) / "run")
        simulation.run()
        simulation.free()
        return [dict(each) for each in read_run(Path(folder) / "run").fields[name]]


def mean_of(frames: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Means over the frames."""
    return {key: np.mean([each[key] for each in frames], axis=0) for key in frames[0]}


def stress_of(fields: Mapping[str, np.ndarray]) -> np.ndarray:
    """Total stress (cells, 3, 3) [Pa], positive in tension."""
    return (fields["kinetic_stress"] + fields["contact_stress"]).reshape(-1, 3, 3)


def layer_shear(fields: Mapping[str, np.ndarray]) -> Shear:
    """Means over the bulk of the layer on the slope."""
    height = fields["position"][:, 2]
    stress = stress_of(fields)
    bulk = (height > BULK[0]) & (height < BULK[1])
    normal = -stress[:, 2, 2]
    rate = np.gradient(fields["velocity"][:, 0], height)
    inertial = rate[bulk] * DIAMETER / np.sqrt(normal[bulk] / DENSITY)
    friction = float(np.mean(stress[bulk, 0, 2] / normal[bulk]))
    return Shear(float(inertial.mean()), friction, float(fields["solid_fraction"][bulk].mean()))


def cell_shear(fields: Mapping[str, np.ndarray]) -> Shear:
    """Means of the Lees-Edwards box."""
    stress = stress_of(fields)[0]
    normal = -stress[2, 2]
    inertial = RATE * DIAMETER / np.sqrt(normal / DENSITY)
    return Shear(float(inertial), float(stress[0, 2] / normal), float(fields["solid_fraction"][0]))


def layer_balance(frames: Sequence[Mapping[str, np.ndarray]]) -> tuple[float, float, float]:
    """Shear over normal stress in the bulk of the layer from the balance of forces, from the stresses, and
    its error.

    The particles above a height have the mean acceleration a = (V_last - V_first) / T, where V is their mean
    velocity:
    shear over normal stress is tan 25 deg - a / (g cos 25 deg). The error is three standard errors of the
    stresses.
    """
    height = frames[0]["position"][:, 2]
    bulk = (height > BULK[0]) & (height < BULK[1])

    def above(frame: Mapping[str, np.ndarray]) -> np.ndarray:
        share = frame["solid_fraction"]
        momentum = np.nan_to_num(share * frame["velocity"][:, 0])
        with np.errstate(invalid="ignore"):  # no particle is above the surface
            return np.asarray(np.cumsum(momentum[::-1])[::-1] / np.cumsum(share[::-1])[::-1])

    change = above(frames[-1])[bulk] - above(frames[0])[bulk]
    acceleration = change / ((len(frames) - 1) * FRAME_INTERVAL)
    ratios = []
    for frame in frames:
        stress = stress_of(frame)[bulk]
        ratios.append(-stress[:, 0, 2] / stress[:, 2, 2])
    found = np.mean(ratios, axis=1)
    expected = SLOPE - float(np.mean(acceleration)) / (GRAVITY * math.cos(math.radians(25.0)))
    return expected, float(np.mean(found)), 3.0 * block_error(found)


def layer_cases(overrides: Sequence[str] = ()) -> list[ValidationCase]:
    """Layer that flows down a slope of 25 degrees."""
    frames = frames_of(shipped_scene("sheared_layer", overrides), "profile")
    expected, found, error = layer_balance(frames)
    balance = ValidationCase(
        "Sheared flows",
        "layer on a slope of 25 deg: shear over normal stress",
        expected,
        "balance of forces: tan 25 deg minus the measured acceleration over g cos 25 deg",
        found,
        "1",
        error / expected,
        "three standard errors of the stresses, from five intervals",
    )
    return [balance, *shear_cases("layer on a slope of 25 deg", layer_shear(mean_of(frames)))]


def cell_cases(overrides: Sequence[str] = ()) -> list[ValidationCase]:
    """Lees-Edwards box at 20 1/s, half filled: faster than the range of the laws."""
    fields = mean_of(frames_of(shipped_scene("shear_cell", overrides), "whole"))
    return shear_cases("Lees-Edwards box", cell_shear(fields))


def shear_cases(name: str, found: Shear) -> list[ValidationCase]:
    """Friction and solid fraction of a flow against the published laws at its inertial number."""
    number = found.inertial_number
    in_range = found.inertial_number <= LARGEST_I
    remark = "Laws of glass beads; the parameters depend on friction and size distribution"
    if not in_range:
        remark += f". Dense flows, for which they hold, have I below about {LARGEST_I:g}: beyond the range"
    low, middle, high = (
        np.tan(np.radians(np.degrees(np.arctan(friction_at(number))) + each)) for each in (-2, 0, 2)
    )
    return [
        ValidationCase(
            "Sheared flows",
            f"{name}, I = {number:.3g}: friction",
            friction_at(number),
            JOP,
            found.friction,
            "1",
            0.5 * float(high - low) / float(middle),
            f"{ANGLE_ERROR:g} deg between the angles of different spheres",
            remark=remark,
            in_range=in_range,
        ),
        ValidationCase(
            "Sheared flows",
            f"{name}, I = {number:.3g}: solid fraction",
            0.6 - 0.1 * number,
            POULIQUEN,
            found.solid_fraction,
            "1",
            FRACTION_ERROR,
            f"{FRACTION_ERROR:g} between random packings of 0.57 to 0.63 of different spheres",
            scale=1.0,
            remark=remark,
            in_range=in_range,
        ),
    ]
