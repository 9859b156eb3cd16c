"""Schema of a whole scene file: its blocks, which the other modules of this folder define.

`SceneInput` is a scene as written, in SI units: all keys are valid, but counts that follow from a mass or a
file are not known yet. Physical parameters have no hidden defaults: a scene must give all of them. Numerical
parameters have defaults, all in `RunSettings` and `Numerics`.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr

from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel
from granflow.contact.particle_equation import ParticleEquation
from granflow.geometry.periodic_box import AXES
from granflow.scene.blocks.contact import Contact
from granflow.scene.blocks.deformation import Deformation
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.gravity import (
    AnyGravity,
    Gravity,
    GravityCourse,
    bound_of,
    course_of,
    motions_of,
    vectors_of,
)
from granflow.scene.blocks.materials import Material, MaterialPair
from granflow.scene.blocks.motions import TimedMotion
from granflow.scene.blocks.outlets import Outlet
from granflow.scene.blocks.output import Expectation, Output
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.run import Damping, Numerics, RunSettings, Stage
from granflow.scene.blocks.walls.kinds import AnyWall, with_faces
from granflow.schema import quantities as q
from granflow.schema.document import Document, yaml_text
from granflow.schema.messages import path_in_file
from granflow.schema.model import FileName, ListOf, Model, Name, PairName, Text, WallName, optional
from granflow.schema.quantities import Number

Seed = Annotated[int, Number(noun="a seed", at_least=0, whole=True)]


class SceneInput(Model):
    """A complete scene as written, in SI units: validated, but not resolved; `granflow.load.Scene` is.

    Immutable. `to_yaml` writes it with all defaults. Methods `locate` and `where` give source positions for
    messages.
    """

    title: Text = Field(description="title of the scene, one line", examples=["Conical hopper"])
    description: Text | None = Field(
        None,
        description="description of the scene and its expected behavior",
        examples=["8000 glass beads discharge through the outlet."],
    )
    seed: Seed = Field(1, description="seed of all random numbers")
    scale: q.Positive = Field(
        1.0,
        description=(
            "factor of equipment lengths; particle counts scale with its cube, particle sizes do not change"
        ),
    )
    gravity: Gravity = Field(
        description=(
            "gravity [m/s2], such as [0, 0, -9.81], or how it changes with time: {vector: [0, 0, -9.81], "
            "motion: {kind: rotation, axis: [0, 1, 0], angular_velocity: 1 deg/s}}"
        ),
        examples=[[0, 0, -9.81], {"times": [0, "1 s"], "vectors": [[0, 0, 0], [0, 0, -9.81]]}],
    )
    materials: dict[Name, Material] = Field(description="materials by name")
    pairs: dict[PairName, MaterialPair] = Field(
        description="contact properties of material pairs; each key is two names joined by a hyphen"
    )
    contact: Contact = Field(
        description="contact models, such as {normal: zhou, tangential: mindlin, rolling: none}",
        examples=[{"normal": "zhou", "tangential": "mindlin", "rolling": "none"}],
    )
    damping: Damping | None = optional(
        "damping of all motion for settling, such as {cundall: 0.5, stages: [settle]}",
        "none",
        examples=[{"drag": "5 1/s", "stages": ["settle"]}],
    )
    walls: Annotated[dict[WallName, AnyWall], AfterValidator(with_faces)] = Field(
        {}, description="walls by name"
    )
    particles: dict[Name, Group] = Field(description="groups of particles by name")
    start_from: FileName | None = Field(
        None,
        description=(
            "directory of an earlier run; its last particles replace those of groups with the same name"
        ),
        examples=["out/hopper"],
    )
    outlets: dict[Name, Outlet] = Field(
        {}, description="outlets by name: regions in which particles are deleted and counted"
    )
    domain: Domain = Field(
        description="the simulated box",
        examples=[{"min": [0, 0, 0], "max": ["40 mm", "40 mm", "80 mm"], "on_exit": "error"}],
    )
    stages: Annotated[tuple[Stage, ...], ListOf()] = Field((), description="stages of the run, in order")
    run: RunSettings = Field(RunSettings.model_construct(), description="duration, time step and precision")
    numerics: Numerics = Field(
        Numerics.model_construct(), description="numerical parameters, all with defaults"
    )
    output: Output = Field(description="selection and intervals of the output")
    expect: Annotated[tuple[Expectation, ...], ListOf()] = Field(
        (),
        description=(
            "expectations for the results of the finished run: totals, their TOTAL_mean.STAGE and "
            "TOTAL_largest.STAGE, and NAME.PART for flow meters, walls, metrics and groups"
        ),
        examples=[[{"quantity": "particle_count", "equals": 8000, "tolerance": 0}]],
    )

    _path: Path = PrivateAttr(Path())
    _folder: Path = PrivateAttr(Path())
    _document: Document | None = PrivateAttr(None)
    _remarks: tuple[str, ...] = PrivateAttr(())

    def __eq__(self, other: object) -> bool:
        """Equality of the values; the source of the scenes does not matter."""
        return isinstance(other, SceneInput) and self.__dict__ == other.__dict__

    __hash__ = None  # type: ignore[assignment]

    @property
    def path(self) -> Path:
        """The file of this scene; an empty path without a file."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder to which paths in the scene are relative; without a file, the working directory."""
        return self._folder

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of the reader, one sentence each: a scale other than 1, overlaps in particle files,
        overrides of one of several keys of the same YAML anchor."""
        return self._remarks

    @property
    def schedule(self) -> tuple[Stage, ...]:
        """The stages; for a scene without stages, one stage "run" of `run.duration`."""
        return self.stages or (Stage(name="run", duration=self.run.duration),)

    @property
    def gravities(self) -> tuple[AnyGravity, ...]:
        """Gravity of the scene, and that of each stage that has its own."""
        return tuple(gravity for _, gravity in self.given_gravities())

    def given_gravities(self) -> Iterator[tuple[tuple[str | int, ...], AnyGravity]]:
        """Gravity of the scene, and that of each stage that has its own, with the key path."""
        yield ("gravity",), self.gravity
        for number, each in enumerate(self.stages):
            if each.gravity is not None:
                yield ("stages", number, "gravity"), each.gravity

    def gravity_motions(self) -> Iterator[tuple[tuple[str | int, ...], TimedMotion]]:
        """Each motion of gravity, also of stages, with its key path."""
        for path, gravity in self.given_gravities():
            for index, motion in enumerate(motions_of(gravity)):
                yield (*path, "motion", index), motion

    @property
    def gravity_changes(self) -> bool:
        """Whether gravity can change during the run."""
        return len(self.gravities) > 1 or bool(len(vectors_of(self.gravity)) > 1 or motions_of(self.gravity))

    @property
    def gravity_at_start(self) -> q.Vector3:
        """Gravity [m/s2] at the start, without motions: the potential energy refers to it."""
        return vectors_of(self.gravity)[0]

    @property
    def usual_gravity(self) -> q.Vector3:
        """The largest gravity [m/s2] that the scene gives, without motions; the first one of the largest.

        The vertical of estimates and metrics refers to it.
        """
        vectors = [vector for each in self.gravities for vector in vectors_of(each)]
        return max(vectors, key=lambda each: float(np.linalg.norm(each)))

    @property
    def largest_gravity(self) -> float:
        """Upper bound of the magnitude of gravity during the run [m/s2]."""
        return max(bound_of(each, lambda g: float(np.linalg.norm(g)), 1.0) for each in self.gravities)

    def gravity_along(self, direction: Sequence[float]) -> float:
        """Upper bound of |g . d| during the run [m/s2], for a vector d (3,)."""
        length = float(np.linalg.norm(direction))
        return max(
            bound_of(each, lambda g: abs(float(np.dot(g, direction))), length) for each in self.gravities
        )

    def drop_energy(self, size: np.ndarray) -> float:
        """Upper bound of |gx| Lx + |gy| Ly + |gz| Lz during the run [m2/s2], for lengths L (3,) [m]."""
        diagonal = float(np.linalg.norm(size))
        return max(bound_of(each, lambda g: float(np.abs(g) @ size), diagonal) for each in self.gravities)

    def gravity_course(self, stage_times: Mapping[str, tuple[float, float]]) -> GravityCourse:
        """Gravity as it acts now, given start and end [s] of the stages that have begun."""
        acting, since = self.gravity, 0.0
        for stage in self.stages:
            if stage.gravity is not None and stage.name in stage_times:
                acting, since = stage.gravity, stage_times[stage.name][0]
        return course_of(acting, since, stage_times)

    def deformations(self) -> Iterator[tuple[tuple[str | int, ...], Deformation]]:
        """Each deformation of the periodic box with its key path: that of the domain, and those of stages."""
        if self.domain.deformation is not None:
            yield ("domain", "deformation"), self.domain.deformation
        for number, stage in enumerate(self.stages):
            if stage.deformation is not None:
                yield ("stages", number, "deformation"), stage.deformation

    def deformation_in(self, name: str) -> tuple[tuple[str | int, ...], Deformation] | None:
        """The deformation of the periodic box in a stage, with its key path; None if no width has changed."""
        last = next((number for number, stage in enumerate(self.stages) if stage.name == name), 0)
        begun = [each for each in self.deformations() if each[0][0] == "domain" or int(each[0][1]) <= last]
        return begun[-1] if begun else None

    @property
    def image_speed(self) -> float:
        """Largest speed [m/s] of the images across a periodic boundary: shear rate, or strain rate of a
        deformation, times the width at the start."""
        widths = dict(zip(AXES, np.subtract(self.domain.max, self.domain.min), strict=True))
        speeds = [
            each.largest_rate(axis) * float(width)
            for _, each in self.deformations()
            for axis, width in widths.items()
        ]
        return max(self.domain.image_speed, *speeds, 0.0)

    def end_of_stage(self, name: str) -> tuple[str, str]:
        """Key of the longest duration of a stage, such as stages.0.max_duration, and its source position."""
        path: tuple[str | int, ...] = ("run", "duration")
        for index, stage in enumerate(self.stages):
            if stage.name == name:
                path = ("stages", index, "max_duration" if stage.duration is None else "duration")
        return ".".join(map(str, path)), self.locate(*path)

    @property
    def longest_duration(self) -> float:
        """Duration [s] if each stage takes its longest."""
        return sum(stage.longest for stage in self.schedule)

    @property
    def stage_names(self) -> list[str]:
        """Names of the stages; a scene without stages has the single stage "run"."""
        return [stage.name for stage in self.stages] or ["run"]

    def stage_range(self, names: Iterable[str]) -> tuple[int, int]:
        """Indices of the first and the last of the stages with these names."""
        indices = [self.stage_names.index(name) for name in names]
        return min(indices), max(indices)

    def flow_meter_parts(self, name: str) -> tuple[str, ...]:
        """Names of the materials or groups with separate counts in a flow meter; empty without `group_by`.

        Raises KeyError if the scene has no such flow meter.
        """
        group_by = self.output.flow_meters[name].group_by
        if group_by is None:
            return ()
        return tuple(self.materials if group_by == "material" else self.particles)

    @property
    def measured_walls(self) -> tuple[str, ...]:
        """Names of the walls with measured forces, in the order of the walls."""
        requested = self.output.wall_forces
        if isinstance(requested, bool):
            return tuple(self.walls) if requested else ()
        return tuple(name for name in self.walls if name in requested)

    @property
    def chosen_models(self) -> dict[str, ContactModel]:
        """The contact models of the block `contact`, by slot; slots without one are absent."""
        chosen = {slot: registry.models(slot).get(self.contact.name(slot)) for slot in SLOTS}
        return {slot: each for slot, each in chosen.items() if each}

    @property
    def active_models(self) -> dict[str, ContactModel]:
        """The chosen models that act, by slot, see `ContactModel.acts`."""
        pairs = self.pairs.values()
        return {slot: each for slot, each in self.chosen_models.items() if each.acts(pairs)}

    @property
    def equations(self) -> tuple[ParticleEquation, ...]:
        """The particle equations that act."""
        return registry.equations_of(self.active_models.values())

    def places_of(self, name: str) -> list[tuple[str | int, ...]]:
        """Key paths of the groups and settings of stages that give a property of the particles."""
        groups = [
            ("particles", group, name)
            for group, each in self.particles.items()
            if getattr(each, name) is not None
        ]
        settings = [
            ("stages", number, "set", index, name)
            for number, stage in enumerate(self.stages)
            for index, setting in enumerate(stage.set_)
            if name in setting.values
        ]
        return [*groups, *settings]

    def values_set(self, name: str) -> list[float]:
        """The values that settings of stages give to a property of the particles."""
        settings = (setting for stage in self.stages for setting in stage.set_)
        return [each.values[name] for each in settings if name in each.values]

    def pair(self, first: str, second: str) -> MaterialPair:
        """The pair of two materials in either order. Raises KeyError if the scene does not have it."""
        return self.pairs[self.pair_key(first, second)]

    def pair_key(self, first: str, second: str) -> str:
        """The key in `pairs` for two materials in either order; "second-first" if there is no such pair."""
        key = f"{first}-{second}"
        return key if key in self.pairs else f"{second}-{first}"

    def to_yaml(self) -> str:
        """The resolved scene as YAML with all defaults, in SI units; the text loads to an equal scene."""
        return yaml_text(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The resolved scene as nested dictionaries and lists with all defaults, in SI units; keys are those
        of a scene file.

        `granflow.Scene.from_dict` makes an equal scene of it.
        """
        # The serializer of this class: a subclass, which has the same fields, would build another one. It
        # warns of options that were validated before another contact model was registered, although it writes
        # them correctly.
        found = SceneInput.__pydantic_serializer__.to_python(
            self, by_alias=True, exclude_none=True, warnings=False
        )
        return cast("dict[str, Any]", _with_lists(found))

    def is_given(self, *key_path: str | int) -> bool:
        """Whether the file or an override gives this key; False for values from a default or a preset.

        `key_path`: keys and list indices, such as ("stages", 0, "duration"); the index 0 also for a single
        item in place of a list.
        """
        if self._document is None:
            return False
        return self._document.find(path_in_file(self._document, key_path)) is not None

    def locate(self, *key_path: str | int) -> str:
        """Source position of the value of a key, as `file:line:column`, for error messages.

        For a missing key, that of the nearest existing parent key; without a file, the name of the scene file
        or "scene".
        """
        if self._document is None:
            return self.path.name or "scene"
        return str(self._document.value_position(path_in_file(self._document, key_path)))

    def where(self, *key_path: str | int) -> str:
        """Source position of a key, as `file:line`; for a missing key, of the nearest existing parent key."""
        if self._document is None:
            return self.path.name or "scene"
        return self._document.where(path_in_file(self._document, key_path))


def _with_lists(value: Any) -> Any:
    """Plain data with lists in place of tuples, as JSON and YAML have them."""
    if isinstance(value, dict):
        return {key: _with_lists(each) for key, each in value.items()}
    return [_with_lists(each) for each in value] if isinstance(value, list | tuple) else value
