"""Checks that the precision resolves positions at the largest distance from the origin."""

import numpy as np

from granflow.errors import SceneError
from granflow.load import Scene

COARSEST = 0.1
"""Largest spacing of positions over the smallest radius: above it contact forces are noise in any contact model."""


def position_type(precision: str) -> type[np.floating]:
    """Type of the positions for a precision: float32 for f32, float64 for f64 and mixed."""
    return np.float32 if precision == "f32" else np.float64


def spacing_at(precision: str, coordinate: float) -> float:
    """Spacing [m] of the representable positions at a coordinate [m]."""
    return float(np.spacing(position_type(precision)(abs(coordinate))))


def coordinate_limit(precision: str, radius_min: float) -> float:
    """Coordinate [m] below which the spacing is at most COARSEST of the smallest radius [m].

    With m fraction bits (23 in float32, 52 in float64), the spacing between 2^k and 2^(k + 1) is 2^(k - m).
    """
    bits = np.finfo(position_type(precision)).nmant
    return float(2.0 ** (np.floor(np.log2(COARSEST * radius_min)) + bits + 1))


def refuse_coarse(scene: Scene, radius_min: float) -> None:
    """Raise SceneError if positions at the farthest face of the domain are too coarse for the smallest particle.

    `radius_min` [m]. The message suggests mixed precision if that resolves the positions.
    """
    precision = scene.run.precision
    farthest = float(np.abs([scene.domain.min, scene.domain.max]).max())
    if farthest <= coordinate_limit(precision, radius_min):
        return
    better = (
        "Use --precision mixed, or move" if precision == "f32" and _mixed_resolves(farthest, radius_min) else "Move"
    )
    key = ("run", "precision") if scene.is_given("run", "precision") else ("domain",)
    raise SceneError(
        f"{scene.locate(*key)}: run.precision is {precision}, but it resolves positions only to "
        f"{spacing_at(precision, farthest):.3g} m at {farthest:.3g} m from the origin, at the end of the domain. The "
        f"required resolution is {COARSEST:g} of the smallest radius {radius_min:.3g} m. {better} the scene closer "
        "to the origin."
    )


def _mixed_resolves(farthest: float, radius_min: float) -> bool:
    return farthest <= coordinate_limit("mixed", radius_min)
