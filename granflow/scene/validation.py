"""Consistency checks within and between the parts of a scene.

Each check is a function from a `PartialScene` to faults. `_CHECKS` lists the sections that must be complete before a
check runs, so that one mistake does not cause consequential messages.
"""

from collections.abc import Callable, Iterator

from granflow.scene.checks import clumps, liquid, output, pairs, regions, stages
from granflow.scene.document import Problem
from granflow.scene.messages import problem_at
from granflow.scene.partial import PartialScene
from granflow.scene.schema.faults import Fault, whole

_MAX_ENTRIES = {
    "materials": 50, "pairs": 1275, "walls": 1000, "particles": 100, "outlets": 50, "stages": 1000, "expect": 1000
}  # fmt: skip
"""Largest number of entries of each section: the cost of some checks grows with its square."""

_CHECKS: tuple[tuple[tuple[str, ...], Callable[[PartialScene], Iterator[Fault]]], ...] = (
    ((), pairs.materials_exist),
    ((), pairs.names),
    (("particles",), pairs.possible_contacts_have_a_pair),
    (("contact",), pairs.pair_options),
    (("contact",), pairs.restitution),
    (("stages",), stages.names),
    (("stages", "run"), stages.duration),
    (("gravity",), stages.gamma_requires_gravity),
    (("run",), stages.force_controlled_walls),
    ((), regions.some_particles),
    (("domain",), regions.inside_domain),
    (("domain", "particles", "output"), regions.lees_edwards),
    (("domain", "run", "output"), clumps.unsupported),
    (("contact",), liquid.transfer),
    (("output", "stages", "domain"), output.field_grids),
    (("output", "gravity", "domain"), output.metrics),
    (("output", "expect", "stages"), output.expected_names),
    (("output", "expect", "stages"), output.expected_parts),
    (("output", "expect", "stages"), output.expected_metrics),
    (("output", "expect", "stages"), output.wall_forces),
    (("stages", "walls"), output.condition_columns),
)
"""Sections that must be complete, and the check that needs them."""


def consistency_problems(parts: PartialScene) -> list[Problem]:
    """All problems within and between the parts of a scene that may be incomplete, in no particular order.

    If a section has too many entries, checks between parts are omitted, because the time of some of them grows with the
    square of the number of entries.
    """
    faults, overfull = list(parts.faults()), list(_overfull_sections(parts))
    for needed, check in _CHECKS if not overfull else ():
        if parts.complete.issuperset(needed):
            faults += check(parts)
    return [problem_at(parts.document, fault) for fault in (*faults, *overfull)]


def _overfull_sections(parts: PartialScene) -> Iterator[Fault]:
    """Faults of sections with more entries than _MAX_ENTRIES."""
    for section, limit in _MAX_ENTRIES.items():
        node = parts.document.root.child(section)
        count = len(node.entries or node.items or ()) if node is not None else 0
        if count > limit:
            yield whole((section,), f"has {count} entries, but the limit is {limit}")
