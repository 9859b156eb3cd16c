"""The remedies of overlaps that are too large: Young's moduli that keep them below the limit, derived from the law."""

from collections.abc import Callable, Mapping

from granflow.contact.material import Solid
from granflow.plan.forecast.contact import TouchingPair

LARGEST_FACTOR = 1e12
"""Largest factor on the moduli that is searched; no modulus helps a model whose stiffness is given as a number."""

HARDEST = 1.2e12
"""Young's modulus [Pa] of diamond: if more is required, a unit is probably wrong."""

MARGIN = 1.1
"""Recommended over required modulus: of rounding, and of several contacts at a time."""

STEPS = 60
"""Bisections of the factor."""

Overlap = Callable[[TouchingPair], float]
"""Function from a pair to its largest relative overlap."""


def modulus_factor(pair: TouchingPair, overlap: Overlap, limit: float) -> float | None:
    """Smallest factor on the effective modulus at which the overlap is at most `limit`; None if no factor suffices.

    For Hertz contacts it is (d/limit)^(5/2) for an impact, and (d/limit)^(3/2) for a static load, because
    d ~ E^(-2/5) at a given energy and d ~ E^(-2/3) at a given force. Solved by bisection for any contact model.
    """
    low, high = 1.0, LARGEST_FACTOR
    if overlap(pair.stiffer(high)) > limit:
        return None
    for _ in range(STEPS):
        if high < 1.001 * low:
            break
        middle = (low * high) ** 0.5
        low, high = (middle, high) if overlap(pair.stiffer(middle)) > limit else (low, middle)
    return high


def without_modulus(pair: TouchingPair, overlap: Overlap) -> str:
    """Instruction for an overlap that no modulus reduces enough: the stiffness is a number, or a unit is wrong."""
    if overlap(pair.stiffer(LARGEST_FACTOR)) > 0.99 * overlap(pair):
        return "raise the stiffness of contact.normal"
    return "check the units of densities, sizes, velocities and forces, because no Young's modulus is high enough"


def required_moduli(solids: Mapping[str, Solid], materials: tuple[str, str], factor: float) -> dict[str, float]:
    """Young's moduli [Pa] by material that raise the effective modulus of two materials by `factor`.

        1/E = (1 - nu1^2)/E1 + (1 - nu2^2)/E2

    Only the softer material changes if it stays softer than the other one; otherwise both get the same modulus. Rounded
    up to two digits, with MARGIN.
    """
    names = sorted(dict.fromkeys(materials), key=lambda name: solids[name].young_modulus)
    soft, hard = solids[names[0]], solids[names[-1]]
    of_soft, of_hard = (1.0 - each.poisson_ratio**2 for each in (soft, hard))
    target = (of_soft / soft.young_modulus + of_hard / hard.young_modulus) / (MARGIN * factor)
    both = (of_soft + of_hard) / target
    if both >= hard.young_modulus:
        return {name: rounded_up(both) for name in names}
    return {names[0]: rounded_up(of_soft / (target - of_hard / hard.young_modulus))}


def rounded_up(value: float) -> float:
    """A value rounded up to two digits."""
    text = f"{value:.1e}"
    return float(text) if float(text) >= value else float(f"{value * 1.05:.1e}")


def modulus_text(moduli: Mapping[str, float]) -> str:
    """Instruction that sets Young's moduli [Pa]: `set materials.rubber.young_modulus to 2.6e+07 Pa`."""
    if (highest := max(moduli.values(), default=0.0)) > HARDEST:
        words = pressure_words(highest)
        return f"check the units of lengths, velocities, densities and forces: a modulus of {words} would be required"
    parts = [f"materials.{name}.young_modulus to {pressure_words(value)}" for name, value in moduli.items()]
    return f"set {' and '.join(parts)}"


def pressure_words(value: float) -> str:
    """A pressure or modulus [Pa] in GPa, MPa, kPa or Pa."""
    for unit, size in (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.3g} Pa"
