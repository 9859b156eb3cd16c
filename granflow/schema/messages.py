"""Error messages of the schema: one sentence each, with source position, remedy and suggestion.

A message has the form `file:line:column: key.path is VALUE, but REASON.` `problem_at` makes one of a fault,
`problems_of` makes those of the errors of pydantic. An error of pydantic has a location: a path of keys, and
of tags that tell which member of a union was tried. `model_at` finds the part of the schema there.

Suggestions for unknown names are renamed keys, names in other codes, and similar names (similarity of
difflib, Ratcliff and Obershelp).
"""

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    Tag,
)
from pydantic_core import ErrorDetails

from granflow.schema.document import Document, Node, Problem
from granflow.schema.faults import Fault, KeyPath, missing, whole
from granflow.visible_text import alternatives, plural

_CLOSE = 0.6  # similarity from which a name is suggested


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known name that a word probably means; None without one.

    In this order: the present name of a renamed key, a synonym, the longest name whose words the word has
    (rolling_friction in rolling_friction_coefficient), the name with the most similar letters.
    """
    names = list(known)
    words = _words(word)
    within = [name for name in names if len(name) > 1 and _words(name) <= words]
    matches = difflib.get_close_matches(word, names, n=1, cutoff=_CLOSE)
    return (
        renamed(word, names)
        or synonym(word, names)
        or max(within, key=lambda name: (len(name), name == word), default=None)
        or next(iter(matches), None)
    )


def _words(name: str) -> set[str]:
    """The words of a name, in lowercase letters."""
    return set(re.findall("[a-z0-9]+", name.lower())) or {name}


def suggestion_or_list(word: str, known: Iterable[str], kind: str) -> str:
    """Remedy for an unknown word: its new name, the closest known word, or a list of all known words.

    `kind`: plural noun for the list. The list is a sentence without a period.
    """
    names = list(known)
    if new := renamed(word, names):
        return f"{word} was renamed to {new}."
    match = nearest(word, names)
    if match and (conversion := CONVERSIONS.get((_plain(word), match))):
        return f"Give {match}{conversion}."
    if match:
        return f"Did you mean {match}?"
    return f"The {kind} are {', '.join(names)}" if names else f"There are no {kind}"


def suggestion_sentence(word: str, known: Iterable[str], kind: str) -> str:
    """As `suggestion_or_list`, with a period unless it is a question."""
    remedy = suggestion_or_list(word, known, kind)
    return remedy if remedy.endswith(("?", ".")) else f"{remedy}."


# Renamed keys

RENAMED_KEYS = {
    "adhesion": "cohesion",
    "any_size": "any_scale",
    "at_most": "max_duration",
    "beyond": "half_space",
    "by": "group_by",
    "energy": "energy_budget",
    "gradient_along": "gradient",
    "grow": "expand",
    "indices": "metrics",
    "leaving": "on_exit",
    "list": "positions",
    "loads": "wall_forces",
    "measure": "analyze",
    "meters": "flow_meters",
    "onset": "impact",
    "overlap_limit": "max_overlap",
    "peak": "max_overlap",
    "place": "insert",
    "restitution": "restitution_at",
    "shear": "lees_edwards",
    "size": "scale",
    "spin": "angular_velocity",
    "time_step_safety": "time_step_fraction",
    "velocity_along": "flow",
}
"""Keys and values of version 0.1, and their present names."""


def renamed(word: str, known: Iterable[str]) -> str | None:
    """The present name of a renamed key, if it is one of the known names; None otherwise."""
    new = RENAMED_KEYS.get(word)
    return new if new in list(known) else None


# Names in other codes

SYNONYMS: dict[str, tuple[str, ...]] = {
    "amount": ("count",),
    "ball": ("particles",),
    "belt": ("surface_velocity", "motion"),
    "block": ("box",),
    "boundary": ("domain", "periodic", "on_exit"),
    "bulkmodulus": ("young_modulus",),
    "circle": ("disc",),
    "coefficientfriction": ("friction",),
    "coefficientrestitution": ("restitution",),
    "coefficientrollingfriction": ("rolling_friction",),
    "cof": ("friction",),
    "cohesionenergydensity": ("cohesion_energy_density",),
    "conveyor": ("surface_velocity", "motion"),
    "cor": ("restitution",),
    "cube": ("box",),
    "d": ("diameter",),
    "dia": ("diameter",),
    "dist": ("distribution",),
    "dt": ("time_step",),
    "dump": ("output", "interval"),
    "e": ("young_modulus", "restitution"),
    "edinburgh": ("eepa",),
    "edinburghstiffness": ("eepa",),
    "elasticmodulus": ("young_modulus",),
    "emodulus": ("young_modulus",),
    "en": ("restitution",),
    "epsd2": ("epsd", "sds"),
    "facet": ("mesh",),
    "factory": ("rain",),
    "false": ("none",),
    "filename": ("file",),
    "fix": ("walls",),
    "fixmovemesh": ("motion",),
    "fixwallgran": ("walls", "plane"),
    "freeze": ("fixed",),
    "frustum": ("cone",),
    "g": ("gravity", "young_modulus"),
    "gaussian": ("normal",),
    "grain": ("particles",),
    "grains": ("particles",),
    "greaterthan": ("above",),
    "hertzmaterial": ("hertz",),
    "hertzmindlin": ("hertz", "mindlin"),
    "history": ("mindlin",),
    "hooke": ("linear",),
    "hookean": ("linear",),
    "hookehysteresis": ("luding",),
    "insertpack": ("pack",),
    "insertrateregion": ("rain",),
    "insertstream": ("inlet",),
    "jkr": ("cohesion",),
    "kfinnie": ("coefficient",),
    "lessthan": ("below",),
    "lsd": ("linear",),
    "mat": ("material",),
    "meshsurface": ("mesh",),
    "mindlindeltashear": ("mindlin",),
    "morethan": ("above",),
    "movemesh": ("motion",),
    "mu": ("friction",),
    "mur": ("rolling_friction",),
    "mus": ("friction",),
    "n": ("count",),
    "no": ("none",),
    "nu": ("poisson_ratio",),
    "num": ("count",),
    "number": ("count",),
    "numberofparticles": ("count",),
    "off": ("none",),
    "omega": ("angular_velocity",),
    "onleave": ("on_exit",),
    "oscillation": ("vibration",),
    "paircoeff": ("pairs",),
    "pairstyle": ("contact",),
    "path": ("file",),
    "pipe": ("cylinder",),
    "pour": ("rain",),
    "random": ("pack", "rain"),
    "rectangularwall": ("rectangle",),
    "rho": ("density",),
    "rollingresistance": ("rolling_friction",),
    "rotate": ("rotation",),
    "rpm": ("angular_velocity",),
    "saveinterval": ("interval",),
    "shearmodulus": ("young_modulus",),
    "simplifiedjkr": ("sjkr",),
    "sphere": ("particles",),
    "springdashpot": ("linear", "spring"),
    "stl": ("mesh",),
    "stream": ("inlet",),
    "surfaceenergy": ("work_of_adhesion",),
    "surfacevel": ("surface_velocity", "motion"),
    "surfacevelocity": ("surface_velocity", "motion"),
    "target": ("force", "pressure"),
    "thermo": ("output", "timeseries_interval"),
    "timeout": ("max_duration",),
    "timestep": ("time_step",),
    "tsuji": ("hertz",),
    "tube": ("cylinder",),
    "type": ("shape", "kind", "distribution"),
    "typec": ("sds",),
    "wallgran": ("walls", "plane"),
    "wiggle": ("vibration",),
    "xmu": ("friction",),
    "youngsmodulus": ("young_modulus",),
    "zplane": ("plane",),
}
"""Names in other codes (LIGGGHTS, LAMMPS, YADE, MercuryDPM, EDEM), in lowercase letters and digits only, and
names here for the same or the nearest feature, in the order of preference."""


CONVERSIONS = {
    ("bulkmodulus", "young_modulus"): ", 3 (1 - 2 poisson_ratio) times the bulk modulus",
    ("g", "young_modulus"): ", 2 (1 + poisson_ratio) times the shear modulus",
    ("kfinnie", "coefficient"): " and hardness, whose quotient is k_finnie",
    ("rpm", "angular_velocity"): " with its unit, such as 30 rpm",
    ("shearmodulus", "young_modulus"): ", 2 (1 + poisson_ratio) times the shear modulus",
}
"""What follows "Give KEY" for names in SYNONYMS whose number is another one than that of their key."""


def synonym(word: str, known: Iterable[str]) -> str | None:
    """The first known name for a name in another code; None if there is none."""
    names = list(known)
    return next((name for name in SYNONYMS.get(_plain(word), ()) if name in names), None)


def _plain(word: str) -> str:
    """The letters and digits of a word, in lowercase."""
    return "".join(letter for letter in word.lower() if letter.isalnum())


# Messages of faults


def unknown(path: KeyPath, name: str, known: Iterable[str], kind: str) -> Fault:
    """The fault of an unknown name, see `no_such`."""
    return Fault(path, no_such(name, known, kind))


def no_such(name: str, known: Iterable[str], kind: str) -> str:
    """What is wrong with an unknown name, with the closest known name or a list of all."""
    names = list(known)
    if suggestion := nearest(name, names):
        return f"there is no such {kind}. Did you mean {suggestion}?"
    kinds = plural(kind)
    known_names = f"the {kinds} are {', '.join(names)}" if names else f"the scene has no {kinds}"
    return f"there is no such {kind}; {known_names}"


def unknown_names(
    path: KeyPath, given: Iterable[str] | None, known: Iterable[str], kind: str
) -> Iterator[Fault]:
    """Faults of the items of a list that are not known names."""
    for index, name in enumerate(given or ()):
        if name not in known:
            yield unknown((*path, index), name, known, kind)


def dotted(path: Iterable[str | int]) -> str:
    """The path in the notation of messages and `--set`: walls.floor.normal.2."""
    return ".".join(str(key) for key in path)


def problem_at(document: Document, fault: Fault) -> Problem:
    """Error message for a fault, with the position of the value if it is shown, else of the key.

    The path may contain union tags. The sentence ends with a period or a question mark.
    """
    written = path_in_file(document, fault.path)
    name = dotted(written) or document.subject
    node = document.find(written)
    shown = node.shown() if node is not None else None
    if fault.whole:
        sentence = f"{name} {fault.reason}"
    else:
        sentence = f"{name} is {shown}, but {fault.reason}" if shown else f"{name}: {fault.reason}"
    position = document.key_position(written) if fault.whole else document.value_position(written)
    return Problem(position, sentence if sentence.endswith((".", "?")) else sentence + ".")


def path_in_file(document: Document, path: Iterable[str | int]) -> KeyPath:
    """The path in the file: without union tags, and without the index if a single item replaces a list.

    A face of a box has the path of the box.
    """
    node: Node | None = document.root
    written: list[str | int] = []
    for key in path:
        if isinstance(key, str) and key.startswith("<") and key.endswith(">"):
            continue
        if isinstance(key, int) and node is not None and node.items is None:
            continue
        in_file = node.written_key(key) if node is not None and node.entries is not None else None
        written.append(key if in_file is None else in_file)
        node = node.child(key) if node is not None else None
    return tuple(written)


# Messages of errors of pydantic

_MAX_ERRORS = 1000  # more errors take too long to report
_CONSEQUENCE = "default_factory_not_called"  # default copied from another value that is invalid


def problems_of(document: Document, errors: Sequence[ErrorDetails], schema: type[BaseModel]) -> list[Problem]:
    """The errors of the schema as problems, without consequences of other errors; at most 1000.

    `schema`: model of the whole document. Omitted: copied defaults of invalid values, and a missing key if an
    unknown key is probably a misspelling of it.
    """
    found = [
        _SchemaError(document, each, schema) for each in errors[:_MAX_ERRORS] if each["type"] != _CONSEQUENCE
    ]
    suggested = {error.suggested() for error in found if error.type == "extra_forbidden"}
    return [
        problem_at(document, error.fault())
        for error in found
        if not (error.type == "missing" and error.path in suggested)
    ]


_REASONS = {
    "dict_type": "at least one entry of the form name: {...} is expected",
    "tuple_type": "a list is expected, [ ... ]",
    "list_type": "a list is expected, [ ... ]",
    "string_type": "text is expected; put it in quotes",
}
"""Reasons of errors by the type that pydantic gives them; other errors have the reason as their message."""


class _SchemaError:
    """One pydantic error, with the part of the schema at its location.

    `loc`: as in pydantic, without the mark of keys; `path`: key path in the file.
    """

    def __init__(self, document: Document, details: ErrorDetails, schema: type[BaseModel]) -> None:
        self.document = document
        self.schema = schema
        self.type: str = details["type"]
        self.message: str = details["msg"]
        self.context: dict[str, Any] = details.get("ctx", {})
        loc = details["loc"]
        self.of_key = bool(loc) and loc[-1] == "[key]"
        self.loc: KeyPath = loc[:-1] if self.of_key else loc + tuple(self.context.get("at", ()))
        self.path = path_in_file(document, self.loc)
        if self.type == "extra_forbidden" and not self.of_key:
            # An unknown key such as "<>" looks like a mark of pydantic.
            self.path = (*path_in_file(document, self.loc[:-1]), self.loc[-1])

    def keys(self) -> list[str]:
        """The keys of the model that contains the location."""
        return _keys(model_at(self.schema, self.loc[:-1]))

    def suggested(self) -> KeyPath:
        """Path of the key that an unknown key probably means; its own path if none is similar."""
        return (*self.path[:-1], nearest(str(self.path[-1]), self.keys()) or self.path[-1])

    def fault(self) -> Fault:
        """The error with the path in the file; the kind of error determines the sentence."""
        if self.type == "missing":
            return missing(self.path, self._description())
        if self.type == "extra_forbidden" and self.keys() == ["law"]:
            return whole(self.path, "is not a known key: this contact model has no options")
        if self.type == "extra_forbidden":
            remedy = suggestion_or_list(str(self.path[-1]), self.keys(), "known keys")
            homes = blocks_with(self.schema, str(self.path[-1]))
            if 0 < len(homes) <= MOST_HOMES and nearest(str(self.path[-1]), self.keys()) is None:
                remedy = f"It is a key of {alternatives(homes)}. {remedy}"
            if str(self.path[-1]).isdecimal():
                remedy = f"Numbers have a decimal point, not a comma: such as 0.{self.path[-1]}."
            run_on = re.fullmatch(r"([\w-]+)[\s:=]+(.*)", str(self.path[-1]), re.DOTALL)
            if run_on and run_on[1] in self.keys():
                remedy = f"Write {run_on[1]}: {run_on[2] or 'VALUE'}, with a colon and a space after the key."
            return whole(self.path, f"is not a known key. {remedy}")
        if self.type == "choice":
            return self._choice()
        if self.type == "literal_error":
            return self._one_of(self.path, re.findall(r"'([^']*)'", str(self.context.get("expected"))))
        if self.type in ("model_type", "model_attributes_type"):
            keys = ", ".join(_keys(model_at(self.schema, self.loc)))
            return Fault(self.path, f"a mapping with the keys {keys} is expected")
        if self.of_key:
            return whole(self.path, f"is not valid here: {self.message}")
        return Fault(self.path, _REASONS.get(self.type, self.message), whole=self.type == "whole")

    def _description(self) -> str:
        """Description of the missing key from the schema."""
        model = model_at(self.schema, self.loc[:-1])
        for name, field in model.model_fields.items() if model else ():
            if self.loc[-1] in (name, field.alias):
                return field.description or "it is required"
        return "it is required"

    def _choice(self) -> Fault:
        """A union whose member is undetermined: the key is missing or has an unknown value.

        The message lists the values of the key, or the reason that the union gives.
        """
        node = self.document.find(self.path)
        if node is None:
            return Fault(self.path, self.context.get("reason", "it cannot be read"))
        names = [tag_of(member).strip("<>") for member in get_args(_annotation_at(self.schema, self.loc))]
        if "reason" in self.context:
            word = _word(node)
            known = [name.removeprefix("law ") for name in names]
            near = nearest(word, known) if word and word not in known else None
            if near:
                hint = f". Did you mean {near}?"
            else:
                hint = self._hint(word)
            return Fault(self.path, self.context["reason"] + hint)
        key = self.context["key"]
        names = [name for name in names if name not in ("number", "list", "none")]
        if node.entries is not None and key in node.entries:
            return self._one_of((*self.path, key), names)
        if node.entries is not None:
            if misnamed := next((each for each in node.entries if nearest(each, [key])), None):
                return whole((*self.path, misnamed), f"is not a known key. Did you mean {key}?")
            return missing((*self.path, key), f"one of {', '.join(names)}")
        if key == "law":
            return self._one_of(self.path, names)
        example = "{" + f"{key}: {names[0]}, ..." + "}"
        return Fault(self.path, f"a mapping is expected, {example}, with {key} one of {', '.join(names)}")

    def _one_of(self, path: KeyPath, allowed: list[str]) -> Fault:
        """A word that is not one of `allowed`: the message lists them and suggests the closest."""
        node = self.document.find(path)
        word = "" if node is None else _word(node)
        near = nearest(word, allowed) if word else None
        if near:
            hint = f". Did you mean {near}?"
        else:
            hint = self._hint(word)
        words = ", ".join(allowed)
        if len(allowed) > 1:
            words = f"one of {words}"
        return Fault(path, f"it must be {words}{hint}")

    def _hint(self, word: str) -> str:
        """What the model says about an unknown word of its key, see `Model.hint`."""
        hint = getattr(model_at(self.schema, self.loc[:-1]), "hint", None)
        return hint(str(self.loc[-1]), word) if hint else ""


def _keys(model: type[BaseModel] | None) -> list[str]:
    """The keys of a model as written in scenes; empty without a model."""
    return [field.alias or name for name, field in model.model_fields.items()] if model else []


def _word(node: Node) -> str:
    """A word as written, also that of `{law: WORD}`; empty for another mapping or a list."""
    law = node.child("law")
    return node.text if law is None else law.text


# Blocks that have a key

MOST_HOMES = 3
"""Largest number of blocks with a key that a message names; a key of more blocks has several meanings."""


def blocks_with(schema: type[BaseModel], key: str) -> tuple[str, ...]:
    """Key paths of the blocks that have a key, such as pairs.NAME, the outer ones first; "the first level"
    for the document itself."""
    found: dict[str, None] = {}
    seen = {schema}
    waiting: list[tuple[str, type[BaseModel]]] = [("", schema)]
    for path, model in waiting:
        for name, field in model.model_fields.items():
            if key == (field.alias or name):
                found[path or "the first level"] = None
            inner = f"{path}.{field.alias or name}".lstrip(".")
            for part, suffix in _models_in(field.annotation):
                if part not in seen:
                    seen.add(part)
                    waiting.append((inner + suffix, part))
    return tuple(found)


def _models_in(annotation: Any) -> Iterator[tuple[type[BaseModel], str]]:
    """The models in a type, each with ".NAME" if it is an entry of a mapping."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, ""
    is_mapping = get_origin(annotation) is dict
    for each in get_args(annotation):
        for model, suffix in _models_in(each):
            yield model, f".NAME{suffix}" if is_mapping else suffix


# The part of the schema at the location of an error


def model_at(annotation: Any, loc: KeyPath) -> type[BaseModel] | None:
    """The model at the location of an error; None for a plain value.

    `annotation`: type at the root, such as SceneInput; `loc`: location as in pydantic, with union tags.
    """
    found = _annotation_at(annotation, loc)
    return found if isinstance(found, type) and issubclass(found, BaseModel) else None


def _annotation_at(annotation: Any, loc: KeyPath) -> Any:
    """The type at a location below a type; None if the location does not exist in the schema."""
    origin = get_origin(annotation)
    arguments = get_args(annotation)
    if origin is Annotated:
        return _annotation_at(arguments[0], loc)
    if origin in (Union, UnionType):
        members = [member for member in arguments if member is not NoneType]
        for member in members:
            if loc and tag_of(member) == loc[0]:
                return _annotation_at(member, loc[1:])
        if len(members) == 1:
            return _annotation_at(members[0], loc)
        return None if loc else annotation
    if not loc:
        return annotation
    if origin in (dict, tuple):
        return _annotation_at(arguments[1 if origin is dict else 0], loc[1:])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for name, field in annotation.model_fields.items():
            if loc[0] in (name, field.alias):
                return _annotation_at(field.annotation, loc[1:])
    return None


def tag_of(member: Any) -> str:
    """Tag of a member of a union in the locations of errors.

    The tag is a name in angle brackets, which distinguish it from keys: that of the pydantic `Tag` of the
    member, else the value of its key such as `kind`, else its first key; for plain values the only word,
    none, list or number.
    """
    if get_origin(member) is Annotated:
        explicit = [meta.tag for meta in get_args(member)[1:] if isinstance(meta, Tag)]
        return explicit[0] if explicit else tag_of(get_args(member)[0])
    if isinstance(member, type) and issubclass(member, BaseModel):
        words = selecting_keys(member).values()
        return f"<{next(iter(words), None) or next(iter(member.model_fields))}>"
    if member is NoneType:
        return "<none>"
    if get_origin(member) is Literal and len(get_args(member)) == 1:
        return f"<{get_args(member)[0]}>"
    return "<list>" if get_origin(member) is tuple else "<number>"


def selecting_keys(model: type[BaseModel]) -> dict[str, str]:
    """Keys of a model with only one allowed word, such as `shape` or `kind`, and that word."""
    literals = {
        name: get_args(each.annotation)
        for name, each in model.model_fields.items()
        if get_origin(each.annotation) is Literal
    }
    return {name: words[0] for name, words in literals.items() if len(words) == 1}
