"""Facts of the contact models from the registry: source, limits, options, keys of pairs, constants and
history."""

from collections.abc import Iterator

from pydantic.fields import FieldInfo

from docsite.example_laws import example_law
from docsite.markdown import code, table
from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel
from granflow.schema.model import example_of

PICTURES = {
    "normal": (
        "Restitution and contact duration versus impact velocity. Lines: closed forms (durations of hertz "
        "and linear without damping). Circles: integration of the reference implementation with 400 steps "
        "per contact. Two spheres of stainless steel 316 of 25.4 mm diameter."
    ),
    "tangential": "Tangential force versus displacement at constant load: loading, reversal, and one full cycle.",
    "rolling": "Rolling torque at constant normal load.",
    "twisting": "Twisting torque at constant normal load: loading, reversal, and one full cycle.",
    "cohesion": "Hertz force with and without the attraction; particles of 2 mm diameter with E = 5 MPa.",
    "heat": "Conductance versus normal force: two spheres of steel (50 W/(m K)) of 10 mm diameter.",
}
"""Caption of the picture of a model, by slot."""
ALTERNATIVES = {
    "normal": "restitution and contact duration versus impact velocity",
    "tangential": "tangential force versus displacement",
    "rolling": "rolling torque",
    "twisting": "twisting torque versus twist angle",
    "cohesion": "force versus overlap",
    "heat": "conductance versus normal force",
}
"""Alternative text of the picture of a model, by slot."""
RESTITUTION = {
    "number or fit": "a number in [0, 1], or sigma and psi of Zhou (2011), Eq. 12",
    "positive number": "a number above 0",
    "nothing": "none: it follows from the materials",
}


def facts(name: str) -> str:
    """Source, limits, options, pair keys, constants and history of a model, and its picture."""
    slot, model = find(name)
    law = example_law(slot, name)
    caption = PICTURES[slot]
    lines = [f"**Source:** {law.source}.\n", f"**Limits:** {law.limits}.\n"]
    if slot == "normal":
        lines.append(f"**Restitution of a pair:** {RESTITUTION[model.restitution]}.\n")
    lines.append(f"![{name}: {ALTERNATIVES[slot]}](../assets/models/{name}.svg)\n\n*{caption}*\n")
    lines.append(_options(slot, model))
    if law.constant_names:
        lines.append(f"**Constants of a pair:** {', '.join(map(code, law.constant_names))}.\n")
    if law.history:
        rows = [(code(each.name), each.unit, each.description) for each in law.history]
        lines.append(
            "**Contact history**, kept from first contact to separation:\n\n"
            + table(("field", "unit", "meaning"), rows)
        )
    return "\n".join(lines)


def overview() -> str:
    """Table of all models by slot, with links to their pages."""
    rows = [
        (code(slot), f"[{code(name)}]({name}.md)", model.summary, model.law.source)
        for slot in SLOTS
        for name, model in registry.models(slot).items()
    ]
    return table(("key of `contact`", "model", "summary", "source"), rows)


def find(name: str) -> tuple[str, ContactModel]:
    """Slot and record of a model. Raises KeyError for an unknown name."""
    for slot in SLOTS:
        if name in registry.models(slot):
            return slot, registry.models(slot)[name]
    raise KeyError(f"there is no contact model {name}")


def names() -> Iterator[str]:
    """Names of all registered models."""
    for slot in SLOTS:
        yield from registry.models(slot)


def _options(slot: str, model: ContactModel) -> str:
    """Table of the keys of a model in `contact`, `pairs`, `materials` and `walls`; those of walls are
    optional."""
    rows = [
        (code(f"contact.{slot}.{key}"), *_facts(each)) for key, each in model.options.model_fields.items()
    ]
    rows += [
        (code(f"{block}.NAME.{key}"), *_facts(each))
        for block, keys in (
            ("pairs", model.pair_properties),
            ("materials", model.material_properties),
            ("walls", model.law.wall_properties),
        )
        for key, each in keys.model_fields.items()
    ]
    if not rows:
        return f"**Keys:** none besides {code(f'contact.{slot}: {model.name}')}.\n"
    keys = table(("key", "meaning", "default", "example"), rows)
    return f"**Keys** ([all scene keys](../reference/scene.md)):\n\n{keys}"


def _facts(field: FieldInfo) -> tuple[str, str, str]:
    """Meaning, default and example of a key."""
    default = "required" if field.is_required() else code(f"{field.default}")
    return field.description or "", default, code(f"{example_of(field)}")
