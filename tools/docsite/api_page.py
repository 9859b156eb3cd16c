"""Reference pages of the Python interface: signatures and docstrings of the public names, one page per class."""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any

import granflow
from docsite.markdown import anchor, code, table
from docsite.scene_reference import page_of
from granflow.schema.model import Model

INTRODUCTION = """\
# Python interface

```python
import granflow as gf

scene = gf.load_scene("scenes/hopper.yaml", overrides=["particles.beads.count=500"])
report = gf.on_interval(0.05, lambda snapshot: print(snapshot.time, snapshot.totals["kinetic_energy"]))
simulation = gf.Simulation(scene, out="out/hopper", observers=[report])
simulation.run(until=0.2)
positions = simulation.snapshot().particles["position"]  # numpy array (n, 3) [m], ordered by particle id
table = gf.read_run("out/hopper").timeseries             # pandas
```

Names of the package `granflow`, imported as `gf` in the examples, in SI units. Arrays are numpy arrays with the shape
in parentheses. The [guide](../guides/scenes_in_python.md) builds a scene in Python, runs it and reads its results; the
[blocks of a scene](python_blocks.md) have a table of their own. In the examples, `two.yaml` is the
[first scene](../tutorials/first_scene.md) and `out/two` its run.
"""
BLOCKS_INTRODUCTION = """\
# Blocks of a scene in Python

Each block is a class with the keys of the scene file as arguments: numbers in SI units or text with units, lists, numpy
arrays, mappings, other blocks. `from` is `from_`, and a key that selects the kind of a block (`shape`, `kind`,
`distribution`) may be omitted. A block is validated where it is created, with the messages of the scene reader; `Scene`
joins the blocks and validates them together. Blocks are immutable.
"""
GROUPS: Mapping[str, Sequence[str]] = {
    "Scenes": (
        "load_scene",
        "Scene",
        "register_contact_model",
        "register_metric",
        "register_particle_equation",
    ),
    "Simulations": (
        "Simulation",
        "ParticleForce",
        "on_interval",
        "StopRun",
        "Snapshot",
        "ParticleData",
        "start",
    ),
    "Results": ("read_run", "Run", "Result", "analyze_snapshots", "steady_flow", "steady_flow_error"),
    "Studies": ("sweep", "calibrate"),
    "Plans": ("plan_for", "Plan", "explain", "estimate_memory"),
    "Errors": ("GranflowError", "SceneError", "RunError", "OutputError", "FunctionError"),
}
"""Names of the overview by topic; names without a topic follow."""
PARTS: Mapping[str, Mapping[str, Sequence[str]]] = {
    "Parts of a simulation": {
        "granflow.live.particles": ("LiveParticles", "ParticleArray"),
        "granflow.live.walls": ("LiveWalls", "LiveWall"),
        "granflow.live.forces": ("Forces", "ForceParameters"),
        "granflow.runs.observer_list": ("ObserverList",),
        "granflow.snapshot": ("WallPose",),
    },
    "Contact models of your own": {
        "granflow.contact.law": (
            "ContactModel",
            "Options",
            "PairProperties",
            "Remedy",
            "Law",
            "HistoryField",
            "ModelRequest",
            "NormalLaw",
            "CohesionLaw",
            "TangentialLaw",
            "RollingLaw",
            "TwistingLaw",
            "TorqueLaw",
            "Flow",
            "FlowCase",
        ),
        "granflow.contact.particle_equation": ("ParticleEquation", "MaterialProperties"),
        "granflow.contact.material": ("PairMaterial",),
        "granflow.schema.quantities": ("Number",),
    },
}
"""Classes that are not names of the package, by topic and module."""
LONGEST_SIGNATURE = 12
"""Parameters of the longest signature of a class; records with more are created by functions."""


def page() -> str:
    """The overview in Markdown, without blocks: functions, and a table of the classes of each topic.

    Raises ValueError for a public name without a docstring.
    """
    remaining = [name for name in granflow.__all__ if not is_block(name)]
    lines = [INTRODUCTION]
    for topic, names in GROUPS.items():
        lines += [f"## {topic}\n", *_topic({name: getattr(granflow, name) for name in names})]
        remaining = [name for name in remaining if name not in names]
    for topic, modules in PARTS.items():
        lines.append(f"## {topic}\n")
        for module, names in modules.items():
            introduction = inspect.getdoc(import_module(module)) or ""
            lines += [f"{introduction}\n"] * ("\n" in introduction)
            lines += _topic({name: getattr(import_module(module), name) for name in names})
    if remaining:
        lines += ["## Further names\n", *_topic({name: getattr(granflow, name) for name in remaining})]
    return "\n".join(lines)


def blocks_page() -> str:
    """The table of the blocks of a scene."""
    blocks = {name: getattr(granflow, name) for name in granflow.__all__ if is_block(name)}
    return "\n".join([BLOCKS_INTRODUCTION, *_topic(blocks)])


def class_pages() -> dict[str, str]:
    """The page of each class by its name: a public name of the package, or one in PARTS."""
    found = {
        name: class_page(name, getattr(granflow, name))
        for name in granflow.__all__
        if inspect.isclass(getattr(granflow, name))
    }
    for modules in PARTS.values():
        for module, names in modules.items():
            found |= {name: class_page(name, getattr(import_module(module), name), module) for name in names}
    return found


def is_block(name: str) -> bool:
    """Whether a public name is a block of a scene."""
    thing = getattr(granflow, name)
    return inspect.isclass(thing) and issubclass(thing, Model) and thing is not granflow.Scene


def _topic(things: Mapping[str, Any]) -> Iterator[str]:
    """A table of the classes among named things, with links to their pages, and a section for each function."""
    rows = [
        (f"[{code(name)}](python/{name}.md)", _first_sentence(thing))
        for name, thing in things.items()
        if inspect.isclass(thing)
    ]
    if rows:
        yield table(("class", "meaning"), rows)
    for name, thing in things.items():
        if not inspect.isclass(thing):
            yield "\n".join([f"### {name}\n", signature(name, thing), docstring(name, thing)])


def _first_sentence(thing: Any) -> str:
    """First sentence of the docstring of a class."""
    first = " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z`])", first)[0]


def class_page(name: str, thing: Any, module: str = "") -> str:
    """Signature and docstring of a class with its public members, or the keys of a block.

    `module`: of a class that is not a name of the package.
    """
    has_signature = not module or module.startswith("granflow.contact")
    lines = [f"# {name}\n", *([f"In `{module}`.\n"] if module else [])]
    lines += [signature(name, thing) if has_signature else "", docstring(name, thing)]
    if not module and is_block(name):
        lines.append(f"Keys: {', '.join(_key_link(name, key) for key in _keys(thing))}.\n")
    elif not issubclass(thing, Exception):
        for member, value in members(thing):
            lines += [f"## {name}.{member}\n", value]
    return "\n".join(lines)


def _keys(block: type[Model]) -> list[str]:
    """Keys of a block in scene files."""
    return [field.alias or key for key, field in block.model_fields.items()]


def _key_link(block: str, key: str) -> str:
    """Key with a link to its type, unit, range and default."""
    return f"[`{key}`](../{page_of(block)}.md#{anchor(f'{block} {key}')})"


def signature(name: str, thing: Any) -> str:
    """Signature as a block of Python; empty without one, and for parts of a scene, whose arguments are
    keys."""
    if inspect.isclass(thing) and issubclass(thing, Model):
        return ""
    try:
        text = str(inspect.signature(thing))
    except (TypeError, ValueError):
        return ""
    is_record = inspect.isclass(thing) and len(inspect.signature(thing).parameters) > LONGEST_SIGNATURE
    if is_record or (inspect.isclass(thing) and issubclass(thing, Exception)):
        return ""
    text = re.sub(r"\b(?:granflow|pathlib|collections\.abc|typing|numpy)(?:\.\w+)*\.(\w+)", r"\1", text)
    text = re.sub(r"<factory>", "...", text)
    return f"```python\n{wrapped(f'{name}{text}')}\n```\n"


def wrapped(text: str, width: int = 100) -> str:
    """A signature with one parameter per line if it is wide."""
    if len(text) <= width:
        return text
    head, _, rest = text.partition("(")
    inner, _, tail = rest.rpartition(")")
    depth = 0
    parameters = []
    current = ""
    for character in inner:
        depth += (character in "([{") - (character in ")]}")
        if character == "," and depth == 0:
            parameters.append(current.strip())
            current = ""
        else:
            current += character
    lines = "".join(f"    {each},\n" for each in [*parameters, current.strip()] if each)
    return f"{head}(\n{lines}){tail}"


def docstring(name: str, thing: Any) -> str:
    """Docstring as Markdown: aligned descriptions become lists. Raises ValueError without a docstring."""
    text = inspect.getdoc(thing)
    if not text or (inspect.isclass(thing) and thing.__doc__ is None):
        raise ValueError(f"granflow.{name} has no docstring")
    return "\n\n".join(map(_paragraph, re.split(r"\n\n+", text))) + "\n"


def _paragraph(text: str) -> str:
    """A paragraph; lines such as `name:  description` become a list, with their continuation lines."""
    if text.startswith(">>> "):
        return f"```pycon\n{text}\n```"
    if not re.match(r"[`\w, \[\]]+:  ?\S", text) or not re.match(r"`?\w+`?(, `?\w+`?)*:", text):
        return text
    items = re.sub(r"(?m)^(`?\w+`?(?:, `?\w+`?)*):  +", r"- \1: ", text)
    return re.sub(r"\n {4,}", " ", items) if items.startswith("- ") else text


def members(thing: type) -> Iterator[tuple[str, str]]:
    """Name and text of the public methods and properties that a class defines."""
    inherited = {"to_yaml": thing.to_yaml} if thing is granflow.Scene else {}
    for member, value in {**vars(thing), **inherited}.items():
        if member.startswith("_"):
            continue
        function: Callable[..., Any] | None = getattr(
            value, "__func__", value if inspect.isfunction(value) else None
        )
        if isinstance(value, property) and value.__doc__:
            yield member, docstring(member, value)
        elif function is not None and function.__doc__ and function.__module__.startswith("granflow"):
            yield member, signature(member, getattr(thing, member)) + "\n" + docstring(member, function)
