"""Forecasts of overlaps in particle files that are larger than loading and impacts explain."""

from collections.abc import Iterator, Mapping

from granflow.scene.schema.insertion import FileInsertion
from granflow.scene.schema.particles import Group

TOLERANCE = 1.5
"""Overlap of a file over the forecast one above which a warning appears."""

ROUNDING = 1e-3
"""Overlap over the radius that is never reported: positions in VTU files resolve 1e-4 of the smallest radius."""


def file_warnings(particles: Mapping[str, Group], static: float, impact: float) -> Iterator[str]:
    """A sentence for each group from a file whose particles overlap more than the state of a bed explains.

    Overlaps over the smaller radius: `static` under weight, walls and cohesion; `impact` at the maximum velocity, for
    files with moving particles. Touching particles of a settled bed overlap and cause no warning.
    """
    for name, group in particles.items():
        insertion = group.insert
        if not isinstance(insertion, FileInsertion) or insertion.found is None or group.fixed:
            continue
        found = insertion.found
        explained = max(static, impact) if found.speed_max > 0.0 else static
        if found.overlap_max > max(TOLERANCE * explained, ROUNDING):
            reason = f"loading and impacts explain {explained:.3g}" if explained > 0.0 else "no force explains it"
            yield (
                f"particles.{name}: particles in {insertion.file} overlap by up to {found.overlap_max:.3g} of the "
                f"smaller radius ({found.overlap_rows}), but {reason}: they separate abruptly. Check the file."
            )
