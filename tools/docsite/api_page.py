"""Reference page of the Python interface: signatures and docstrings of the public names."""

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import granflow

INTRODUCTION = """\
# Python interface

```python
import granflow

scene = granflow.load_scene("scenes/hopper.yaml", overrides=["particles.beads.count=500"])
report = granflow.on_interval(0.05, lambda snapshot: print(snapshot.time, snapshot.totals["kinetic_energy"]))
simulation = granflow.Simulation(scene, observers=[report])
simulation.run(until=0.2)
positions = simulation.snapshot().particles["position"]  # numpy array (n, 3) [m], ordered by particle id
```

Names of the package `granflow`, in SI units. Arrays are numpy arrays with the shape in parentheses. A scene from a
dictionary with the same keys as a file: `Scene.from_dict`. Initial particles as arrays: `Simulation(scene,
particles=ParticleData(...))`. `register_contact_model` adds a contact model to the keys of scenes;
`tests/contact/test_external_models.py` defines two.
"""
LONGEST_SIGNATURE = 12
"""Parameters of the longest signature of a class; records with more are created by functions."""


def page() -> str:
    """The page in Markdown. Raises ValueError for a public name without a docstring."""
    return "\n".join([INTRODUCTION, *(section(name, getattr(granflow, name)) for name in granflow.__all__)])


def section(name: str, thing: Any) -> str:
    """Signature and docstring of a function or class, with the public members of a class."""
    lines = [f"## {name}\n", signature(name, thing), docstring(name, thing)]
    if inspect.isclass(thing) and not issubclass(thing, Exception):
        for member, value in members(thing):
            lines += [f"### {name}.{member}\n", value]
    return "\n".join(lines)


def signature(name: str, thing: Any) -> str:
    """Signature as a block of Python; empty without one."""
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
    depth, parameters, current = 0, [], ""
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
    if not re.match(r"[`\w, \[\]]+:  ?\S", text) or not re.match(r"`?\w+`?(, `?\w+`?)*:", text):
        return text
    items = re.sub(r"(?m)^(`?\w+`?(?:, `?\w+`?)*):  +", r"- \1: ", text)
    return re.sub(r"\n {4,}", " ", items) if items.startswith("- ") else text


def members(thing: type) -> Iterator[tuple[str, str]]:
    """Name and text of the public methods and properties that a class defines."""
    for member, value in vars(thing).items():
        if member.startswith("_"):
            continue
        function: Callable[..., Any] | None = getattr(value, "__func__", value if inspect.isfunction(value) else None)
        if isinstance(value, property) and value.__doc__:
            yield member, docstring(member, value)
        elif function is not None and function.__doc__:
            yield member, signature(member, getattr(thing, member)) + "\n" + docstring(member, function)
