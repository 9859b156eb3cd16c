"""What `granflow explain` shows: every decision of a plan with its reason, as plain text."""

import textwrap
from collections.abc import Iterable, Iterator
from math import ceil
from typing import Literal, NamedTuple

from granflow.plan.approach import fastest_approach
from granflow.plan.drive import described
from granflow.plan.features import Reason
from granflow.plan.memory import Memory, memory_of
from granflow.plan.plan import Plan, meetings_of
from granflow.plan.settings import settings_of
from granflow.plan.time_step import rayleigh_time

WIDTH = 100
"""Columns of the text."""

PARTICLE_STEPS_PER_SECOND = 5e6
"""Assumed for the run time on a CPU: settled grains with friction, two threads."""

STEPS_PER_SECOND = 2e5
"""Fewest particles do not make steps faster than this."""

Precision = Literal["f64", "f32", "mixed"]


class Row(NamedTuple):
    """One line: a name, its value, and where the value comes from."""

    name: str
    value: str
    remark: str = ""


def explain(plan: Plan) -> str:
    """Say what a plan computes and why: features, settings, time step, sizes, memory, run time."""
    width = plan.scene.run.precision
    memory = memory_of(plan, width)
    sections = {
        "Features: what is computed, and why": [_feature_row(reason) for reason in plan.reasons],
        "Time step": _time_step_rows(plan),
        "Particles": _particle_rows(plan),
        **({"Driven walls": _drive_rows(plan)} if plan.drives else {}),
        "Meshes": _mesh_rows(plan),
        "Memory": _memory_rows(plan, memory),
        "Run": _run_rows(plan, width),
        "Settings that a scene may leave out": [Row(s.key, s.value, s.origin) for s in settings_of(plan.scene)],
    }
    if plan.scene.remarks:
        sections["As made from what is written"] = [Row("", "", sentence) for sentence in plan.scene.remarks]
    title = f"{plan.scene.title} ({plan.scene.path})"
    tables = {head: list(_aligned(rows)) for head, rows in sections.items()}
    return "\n\n".join([title, *("\n".join([head, *lines]) for head, lines in tables.items() if lines)])


def _feature_row(reason: Reason) -> Row:
    return Row(reason.feature.replace("_", " "), reason.setting, reason.why)


def _time_step_rows(plan: Plan) -> Iterator[Row]:
    step, approach = plan.step, fastest_approach(plan.scene)
    slowest, name = min((rayleigh_time(each.solid, each.radius), each.name) for each in meetings_of(plan.scene))
    yield Row("time step", f"{step.value:.4g} s", step.limited_by)
    if plan.pace is not None:
        slow = f"{step.value:.3g} s at {approach.value:.3g} m/s to {plan.pace.longest:.3g} s at rest"
        yield Row("", "at first", f"then by the fastest approach there is: {slow}")
    yield Row("stable below", f"{step.stable_below:.4g} s", f"{step.stable_limit} at {approach.value:.3g} m/s")
    yield Row("Rayleigh time", f"{slowest:.4g} s", f"shortest: {name}; the step is {step.value / slowest:.3g} of it")
    yield Row("velocity max", f"{approach.value:.4g} m/s", approach.source)
    if plan.law.least_restitution is not None:
        yield Row("restitution", f"{step.least_restitution:.3g}", f"least it can reach at {approach.value:.3g} m/s")
    for sentence in step.warnings:
        yield Row("WARNING", "", sentence)


def _particle_rows(plan: Plan) -> Iterator[Row]:
    groups = ", ".join(f"{name} {count(group.count)}" for name, group in plan.scene.particles.items())
    yield Row("particles", count(plan.particle_capacity), groups)
    same = plan.radius_min == plan.radius_max
    largest = "" if same else f" to {plan.radius_max:.4g}"
    yield Row("radius", f"{plan.radius_min:.4g}{largest} m", "one size" if same else "smallest to largest")
    yield Row("materials", str(plan.material_count), _materials(plan))
    auto = plan.scene.numerics.skin == "auto"
    share = f"{plan.skin / plan.radius_min:.3g} of the smallest radius"
    yield Row("skin", f"{plan.skin:.4g} m", share + ("" if auto else f" ({plan.scene.where('numerics', 'skin')})"))


def _drive_rows(plan: Plan) -> Iterator[Row]:
    for drive in plan.drives:
        where = plan.scene.where("walls", drive.name, "motion", drive.motion)
        yield Row(
            drive.name, drive.kind, f"{', '.join(f'{name} {value}' for name, value in described(drive))} ({where})"
        )


def _materials(plan: Plan) -> str:
    unused = [name for name in plan.scene.materials if name not in plan.materials]
    listed = ", ".join(plan.materials)
    return f"{listed}; not used: {', '.join(unused)}" if unused else listed


def _mesh_rows(plan: Plan) -> Iterator[Row]:
    last = ""
    for note in plan.mesh_notes:
        head, _, rest = note.sentence.partition(", ")
        first = note.wall != last
        yield Row(note.wall, head, rest) if first else Row("", "WARNING" if note.warning else "", note.sentence)
        last = note.wall


def _memory_rows(plan: Plan, memory: Memory) -> Iterator[Row]:
    slots, particles = plan.chunk_capacity * plan.slots_per_chunk, plan.particle_capacity
    each = f"{size(memory.per_particle)} for each: state, force and what sorting needs"
    yield Row("particles", size(memory.particles), each)
    room = f"{size(memory.slots / particles)} for each particle: room for {slots / particles:.3g} near partners"
    yield Row("contacts", size(memory.slots), f"{room}, more when they are found")
    yield Row("one contact", size(memory.per_slot), f"remembers {_remembered(plan)}")
    yield Row("search cells", size(memory.cells), f"at most {count(plan.cell_capacity)} cells")
    if memory.meshes:
        yield Row("meshes", size(memory.meshes), "triangles, their edges and grids")
    yield Row("total", size(memory.total), "")


def _remembered(plan: Plan) -> str:
    rolling = "rolling spring" if plan.features.rolling == "epsd" else "rolling torque"
    names = {"normal": ", ".join(plan.law.history_names), "lateral": "tangential spring", "rolling": rolling}
    return ", ".join(names[name] for name in plan.history) or "nothing but its partner"


def _run_rows(plan: Plan, precision: Precision) -> Iterator[Row]:
    scene = plan.scene
    waits = any(stage.kinetic_energy_below is not None for stage in scene.schedule)
    longest = sum(stage.duration or stage.at_most or 0.0 for stage in scene.schedule)
    steps = ceil(longest / plan.time_step)
    at_most = "at most " if waits else ""
    stages = ", ".join(f"{stage.name} {_ends(stage.duration, stage.at_most)}" for stage in scene.schedule)
    yield Row("precision", precision, "")
    yield Row("simulated time", f"{at_most}{longest:.4g} s", stages)
    yield Row("steps", f"{at_most}{count(steps)}", "")
    frames = int(longest / scene.output.interval) + 1
    yield Row("frames", f"{at_most}{count(frames)}", f"one every {scene.output.interval:g} s")
    seconds = max(steps * plan.particle_capacity / PARTICLE_STEPS_PER_SECOND, steps / STEPS_PER_SECOND)
    assumed = f"{PARTICLE_STEPS_PER_SECOND / 1e6:g} million particle-steps a second on a CPU"
    yield Row("run time", f"{at_most or 'about '}{duration(seconds)}", f"an estimate that assumes {assumed}")


def _ends(fixed: float | None, at_most: float | None) -> str:
    return f"{fixed:g}\N{NO-BREAK SPACE}s" if fixed is not None else f"at most {at_most:g}\N{NO-BREAK SPACE}s"


def _aligned(rows: Iterable[Row]) -> Iterator[str]:
    """Lines of a table of three columns; the last one is wrapped."""
    found = list(rows)
    names, values = (max((len(row[column]) for row in found), default=0) for column in (0, 1))
    wrapper = textwrap.TextWrapper(WIDTH, break_long_words=False, break_on_hyphens=False)
    for row in found:
        lead = f"  {row.name:<{names}}  {row.value:<{values}}  "
        wrapper.initial_indent, wrapper.subsequent_indent = lead, " " * len(lead)
        wrapped = wrapper.fill(row.remark) if row.remark else lead
        yield wrapped.replace("\N{NO-BREAK SPACE}", " ").rstrip()


def count(number: float) -> str:
    """A count in groups of three digits."""
    return f"{int(number):,}".replace(",", " ")


def size(number: float) -> str:
    """Bytes with a prefix."""
    for unit in ("bytes", "kB", "MB"):
        if number < 1000.0:
            return f"{number:.3g} {unit}"
        number /= 1000.0
    return f"{number:.3g} GB"


def duration(seconds: float) -> str:
    """Seconds, minutes, hours or days, to two digits."""
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{max(seconds, 1.0):.2g} s"
