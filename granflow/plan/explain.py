"""Text of `granflow explain`: each decision of a plan with its reason.

The text is a table with one section per subject. Each section is a function that yields rows; `explain`
puts them together.
"""

import textwrap
from collections.abc import Iterable, Iterator
from math import ceil
from typing import Any, NamedTuple

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from granflow.arguments import refuse_other
from granflow.geometry.sphere import sphere_mass
from granflow.load import Scene
from granflow.plan.cost import (
    MemoryEstimate,
    estimate_memory,
    typical_rate,
    typical_run_time,
)
from granflow.plan.features import Reason
from granflow.plan.particle_equations import longest_step
from granflow.plan.plan import Plan
from granflow.plan.time_step import rayleigh_time
from granflow.scene.blocks.contact import LawSettings
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.run import Stage
from granflow.schema.quantities import unit_of

WIDTH = 100
"""Width of the text in columns."""
LABELS = {
    "one_material": "one particle material",
    "one_size": "one particle size",
    "rate_dependent": "viscous normal force",
}
"""Labels of features whose names do not describe them; the others are their names."""


class ExplainRow(NamedTuple):
    """One line: name, value, and origin of the value."""

    name: str
    value: str
    remark: str = ""


def explain(plan: Plan) -> str:
    """Report of a plan with reasons: features, settings, time step, sizes, memory, run time.

    Text of at most about WIDTH columns, one section per subject; quantities have units. Empty sections are
    omitted.

    >>> print(gf.explain(gf.plan_for(gf.load_scene("two.yaml"))).splitlines()[0])
    Two steel spheres (two.yaml)
    """
    refuse_other("plan", plan, Plan, "a plan of granflow.plan_for")
    memory = estimate_memory(plan, plan.scene.run.precision)
    sections = {
        "Features": [_feature_row(reason) for reason in plan.reasons],
        "Time step": _time_step_rows(plan),
        "Particles": _particle_rows(plan),
        "Force-controlled walls": _wall_control_rows(plan),
        "Deforming box": _deformation_rows(plan),
        "Tables of motions": _table_rows(plan),
        "Meshes": _mesh_rows(plan),
        "Forecast": _forecast_rows(plan),
        "Memory": _memory_rows(plan, memory),
        "Run": _run_rows(plan),
        "Optional settings": _setting_rows(plan.scene),
    }
    sections["Changes to the scene as written"] = [ExplainRow("", "", each) for each in plan.scene.remarks]
    title = f"{plan.scene.title} ({plan.scene.path})" if plan.scene.path.name else plan.scene.title
    tables = {head: list(_aligned(rows)) for head, rows in sections.items()}
    return "\n\n".join([title, *("\n".join([head, *lines]) for head, lines in tables.items() if lines)])


def _feature_row(reason: Reason) -> ExplainRow:
    return ExplainRow(feature_label(reason.feature), reason.setting, reason.why)


def feature_label(name: str) -> str:
    """Name of a feature in the text."""
    return LABELS.get(name, name.replace("_", " "))


def _time_step_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the time step and of the quantities that limit it: stability, Rayleigh time, maximum impact
    velocity."""
    step = plan.step
    impact_velocity = plan.impact_velocity
    shortest, radius = min((rayleigh_time(each.solid, each.radius), each.radius) for each in plan.pair_cases)
    yield ExplainRow("time step", f"{step.value:.4g} s", step.limited_by)
    if plan.adaptive_time_step is not None:
        slow = (
            f"{step.value:.3g} s at {impact_velocity.value:.3g} m/s to {plan.adaptive_time_step.longest:.3g} "
            "s at rest"
        )
        yield ExplainRow("", "initially", f"then for the current maximum impact velocity: {slow}")
    yield ExplainRow(
        "stability limit",
        f"{step.stable_below:.4g} s",
        f"{step.stable_limit} at {impact_velocity.value:.3g} m/s",
    )
    if plan.laws.has_viscous_cohesion:
        limit, name = min((each.viscous_step, each.name) for each in plan.pair_cases)
        yield ExplainRow(
            "limit of viscous force",
            f"{limit:.4g} s",
            f"up to which that of the cohesion model is stable, {name}",
        )
    for equation in plan.scene.equations:
        yield ExplainRow(
            f"limit of {equation.name}",
            f"{longest_step(plan, equation):.4g} s",
            f"up to which the equation of the {equation.name} is stable",
        )
    yield ExplainRow(
        "Rayleigh time",
        f"{shortest:.4g} s",
        f"shortest, of a particle with radius {radius:.3g} m; the step is {step.value / shortest:.3g} of it",
    )
    yield ExplainRow("impact velocity", f"at most {impact_velocity.value:.4g} m/s", impact_velocity.source)
    yield from _bond_number_rows(plan)
    if plan.laws.normal.limits_restitution:
        yield ExplainRow(
            "smallest restitution",
            f"{step.least_restitution:.3g}",
            f"smallest value that this time step can reproduce at {impact_velocity.value:.3g} m/s",
        )
    for sentence in step.warnings:
        yield ExplainRow("WARNING", "", sentence)


MOST_BOND_NUMBERS = 8
"""Number of contacts with the largest Bond numbers that are listed."""


def _bond_number_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the Bond numbers, pull-off force over the weight of the particle; none without gravity or
    cohesion.

    Each kind of contact has one row, that of its smallest particle.
    """
    law = plan.laws.cohesion
    gravity = plan.scene.largest_gravity
    if law is None or not gravity:
        return
    rows: dict[str, tuple[float, str]] = {}
    for each in plan.pair_cases:
        force = law.pull_off_force(each.pair, each.radius_eff)
        if force:
            number = force / (sphere_mass(each.radius, each.solid.density) * gravity)
            remark = (
                f"pull-off force {force:.3g} N over weight, {each.name}, diameter {2.0 * each.radius:.3g} m"
            )
            rows[each.name] = max(rows.get(each.name, (0.0, "")), (number, remark))
    largest = sorted(rows.values(), reverse=True)[:MOST_BOND_NUMBERS]
    for index, (number, remark) in enumerate(largest):
        yield ExplainRow("" if index else "Bond number", f"{number:.3g}", remark)


def _end_of_flow(group: Group) -> str:
    """What ends a flow without a number of particles; empty for other groups."""
    if not group.flows_to_end:
        return ""
    stages = getattr(group.insert, "stages", None)
    return " until the run ends" if stages is None else f" in {' and '.join(stages)} at their longest"


def _particle_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the numbers and sizes of the particles, the materials, and the skin."""
    groups = ", ".join(
        f"{group.name} {count(group.spec.count)}{group.spec.shape.title}{_end_of_flow(group.spec)}"
        for group in plan.groups
    )
    yield ExplainRow("particles", count(plan.particle_capacity), groups)
    same = plan.radius_min == plan.radius_max
    largest = "" if same else f" to {plan.radius_max:.4g}"
    yield ExplainRow(
        "radius", f"{plan.radius_min:.4g}{largest} m", "one size" if same else "smallest to largest"
    )
    yield ExplainRow("materials", str(len(plan.materials)), _materials(plan))
    share = f"{plan.skin / plan.radius_min:.3g} of the smallest radius"
    given = "" if plan.scene.numerics.skin == "auto" else f" ({plan.scene.where('numerics', 'skin')})"
    yield ExplainRow("skin", f"{plan.skin:.4g} m", share + given)


def _wall_control_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the force-controlled walls with their parameters."""
    for controlled in plan.controlled_motions:
        numbers = controlled.spec.numbers_in_words(controlled.numbers)
        words = ", ".join(f"{name} {value}" for name, value in numbers)
        yield ExplainRow(controlled.name, controlled.spec.kind, f"{words} ({controlled.source})")


def _deformation_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Strain rate or pressure of each axis, and the gain of the pressures."""
    for path, each in plan.scene.deformations():
        where = plan.scene.where(*path)
        for axis, given in each.by_axis.items():
            name = f"{'.'.join(map(str, path))}.{axis}"
            if given.pressure is None:
                yield ExplainRow(name, f"{given.strain_rate:g} 1/s", f"strain rate, {where}")
            else:
                control = f"gain {plan.gain_of(each):.3g} 1/(Pa s), at most {each.max_rate:g} 1/s"
                yield ExplainRow(name, f"{given.pressure:g} Pa", f"pressure, {control}, {where}")


def _table_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the motions from tables: duration, largest velocity and acceleration."""
    for wall in plan.walls:
        for motion in wall.motions:
            described = motion.description()
            if described is not None:
                yield ExplainRow(wall.name, *described)


def _materials(plan: Plan) -> str:
    unused = [name for name in plan.scene.materials if name not in plan.materials]
    used = f"of particles and walls: {', '.join(plan.materials)}"
    return f"{used}; not used: {', '.join(unused)}" if unused else used


def _mesh_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the notes on mesh walls; the name of a wall is shown in the first of its rows."""
    last = ""
    for note in plan.wall_notes:
        if note.wall != last:
            head, _, rest = note.sentence.partition(", ")
            yield ExplainRow(note.wall, head, rest)
        else:
            yield ExplainRow("", "WARNING" if note.warning else "", note.sentence)
        last = note.wall


def _forecast_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of the forecasts: overlaps over the smaller radius, and warnings."""
    for forecast in plan.forecasts:
        if forecast.name:
            yield ExplainRow(forecast.name, forecast.value, forecast.remark)
        if forecast.warning is not None:
            yield ExplainRow("WARNING", "", forecast.warning)


def _memory_rows(plan: Plan, memory: MemoryEstimate) -> Iterator[ExplainRow]:
    """Rows of the memory estimate by part, and the total."""
    list_entries = plan.capacities.list_entries
    capacity = plan.capacities.particles
    capacity_text = f"state, force and sorting arrays for up to {count(capacity)} particles"
    each = f"{size(memory.per_particle)} per particle: {capacity_text}"
    yield ExplainRow("particles", size(memory.particles), each)
    list_text = (
        f"{size(memory.neighbor_lists / capacity)} per particle: capacity for "
        f"{list_entries / capacity:.3g} candidate pairs"
    )
    yield ExplainRow("contacts", size(memory.neighbor_lists), f"{list_text}, increased if necessary")
    yield ExplainRow("one contact", size(memory.per_neighbor), f"stores {_history_text(plan)}")
    yield ExplainRow("cells", size(memory.cells), f"at most {count(plan.cell_capacity)} cells")
    if memory.meshes:
        yield ExplainRow("meshes", size(memory.meshes), "triangles, their edges and grids")
    if memory.sums:
        yield ExplainRow("sums", size(memory.sums), "energies and wall forces")
    yield ExplainRow(
        "total", size(memory.total), f"{size(memory.total / plan.particle_capacity)} per particle"
    )


def _history_text(plan: Plan) -> str:
    """Descriptions of the contact history fields of one neighbor-list entry."""
    texts = [each.description for fields in plan.laws.history.values() for each in fields]
    return ", ".join(texts) or "only the index of the other particle or wall"


def _run_rows(plan: Plan) -> Iterator[ExplainRow]:
    """Rows of precision, simulated time, numbers of steps and frames, and the estimated run time on a CPU."""
    longest = plan.scene.longest_duration
    steps = ceil(longest / plan.time_step)
    prefix = ""
    stages_at_most = ""
    if any(stage.has_condition for stage in plan.stages):
        prefix = "at most "
        stages_at_most = ", if every stage reaches its maximum duration"
    stages = ", ".join(f"{stage.name} {_end_text(stage)}" for stage in plan.stages)
    yield ExplainRow("precision", plan.scene.run.precision, "")
    yield ExplainRow("simulated time", f"{prefix}{longest:.4g} s", stages)
    yield ExplainRow("steps", f"{prefix}{count(steps)}", "")
    frames = int(longest / plan.scene.output.interval) + 1
    yield ExplainRow("frames", f"{prefix}{count(frames)}", f"every {plan.scene.output.interval:g} s")
    per_second, slowed = typical_rate(plan)
    causes = f" ({', '.join(slowed)})" if slowed else ""
    rate = f"{per_second / 1e6:.2g} million particle-steps per second on a CPU{causes}"
    yield ExplainRow("run time", f"about {duration(typical_run_time(plan))}", f"at {rate}{stages_at_most}")


def _end_text(stage: Stage) -> str:
    prefix = "at most " if stage.has_condition else ""
    return f"{prefix}{stage.longest:g}\N{NO-BREAK SPACE}s"


def _aligned(rows: Iterable[ExplainRow]) -> Iterator[str]:
    """Lines of a table with three columns; the last column is wrapped."""
    found = list(rows)
    names = max((len(row.name) for row in found), default=0)
    values = max((len(row.value) for row in found), default=0)
    wrapper = textwrap.TextWrapper(WIDTH, break_long_words=False, break_on_hyphens=False)
    for row in found:
        lead = f"  {row.name:<{names}}  {row.value:<{values}}  "
        wrapper.initial_indent = lead
        wrapper.subsequent_indent = " " * len(lead)
        wrapped = wrapper.fill(row.remark) if row.remark else lead
        yield wrapped.replace("\N{NO-BREAK SPACE}", " ").rstrip()


def count(number: float) -> str:
    """A number with its digits in groups of three."""
    return f"{int(number):,}".replace(",", " ")


def size(number: float) -> str:
    """Bytes with a decimal prefix (1 kB is 1000 bytes) and three significant digits."""
    for unit in ("bytes", "kB", "MB"):
        if number < 1000.0:
            return f"{number:.3g} {unit}"
        number /= 1000.0
    return f"{number:.3g} GB"


def duration(seconds: float) -> str:
    """Duration, given in seconds, as text in seconds, minutes, hours or days, to two digits."""
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{max(seconds, 1.0):.2g} s"


# Optional settings: found by a walk through the models of the scene, so that no default acts unseen.

KeyPath = tuple[str | int, ...]
"""Keys and list indices from the root of a scene."""
_REASONS: dict[str | int, str] = {
    "timeseries_interval": "default: output.interval",
    "unloading_angle": "default: bound on sqrt(K/M) dt, where K is the unloading stiffness",
}
"""Origin of default values that are copied from other keys or need an explanation."""
_MANY_ROWS = 3
"""Lists with more entries are shown by their length."""


def _setting_rows(scene: Scene) -> Iterator[ExplainRow]:
    """Rows of all optional settings in the order of the schema, including values of presets.

    Each row has the key path with dots, the value with its unit, and its origin: given in a line, from a
    preset, or default. Optional parts that are absent (a motion, the radius of a meter) are not listed.
    """
    yield from _in_model(scene, scene, ())


def _in_model(scene: Scene, model: BaseModel, path: KeyPath) -> Iterator[ExplainRow]:
    """Optional settings of one part of the scene and of its parts; `path`: key path of the part."""
    for name, key_field in type(model).model_fields.items():
        key = (*path, key_field.alias or name)
        value = getattr(model, name)
        if not _is_leaf(value):
            yield from _in_value(scene, value, key)
        elif value is not None and (_has_default(key_field) or _is_preset(scene, model, key)):
            unit = "" if isinstance(value, str) else unit_of(key_field)
            text = f"{_as_written(value)} {unit}".rstrip()
            given = scene.is_given(*key)
            origin = f"given ({scene.where(*key)})" if given else _filled_in(scene, model, key)
            yield ExplainRow(".".join(map(str, key)), text, origin)


def _in_value(scene: Scene, value: Any, path: KeyPath) -> Iterator[ExplainRow]:
    """Optional settings in a value: a part, or a mapping or list of parts."""
    if isinstance(value, BaseModel):
        yield from _in_model(scene, value, path)
    elif isinstance(value, dict):
        for key, each in value.items():
            yield from _in_value(scene, each, (*path, key))
    elif isinstance(value, tuple):
        for index, each in enumerate(value):
            yield from _in_value(scene, each, (*path, index))


def _is_leaf(value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(_is_leaf(each) for each in value)
    return not isinstance(value, BaseModel | dict)


def _has_default(field: FieldInfo) -> bool:
    return field.default_factory is not None or (not field.is_required() and field.default is not None)


def _is_preset(scene: Scene, model: BaseModel, path: KeyPath) -> bool:
    return getattr(model, "preset", None) is not None and not scene.is_given(*path)


def _filled_in(scene: Scene, model: BaseModel, path: KeyPath) -> str:
    """Origin of a value that the file does not give."""
    if _is_preset(scene, model, path):
        return f"preset {getattr(model, 'preset', '')} ({scene.where(*path[:-1], 'preset')})"
    if (
        isinstance(model, LawSettings)
        and path[:2] == ("contact", "normal")
        and model.record.options.with_numbers.get(str(path[-1])) == getattr(model, str(path[-1]))
    ):
        return "the restitution of every pair is a number, independent of the velocity"
    return _REASONS.get(path[-1], "default")


def _as_written(value: Any) -> str:
    """A value in the notation of scenes: true, false, numbers with six digits, lists; long lists as their
    length."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple) and len(value) > _MANY_ROWS:
        return f"{len(value)} rows"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_as_written, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
