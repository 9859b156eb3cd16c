"""Scenes from files, from text and from Python: read, validated and resolved here, and nowhere else.

`load_scene` reads a file, `Scene.from_dict` a mapping, `scene_of` the text in a checkpoint. Each makes a
`SceneInput` (`granflow.scene.reader`) and resolves it to a `Scene`, in which all counts are known. Below are
the scene that a run saves, with copies of its input files, and the identity by which a run knows its scene.
"""

import hashlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path, PurePath
from typing import Any, get_args

from granflow.arguments import items_of, path_of, refuse_other, shown
from granflow.errors import GranflowError, OutputError, SceneError
from granflow.io.checkpoint import engine_digest
from granflow.io.files import file_digest, resolved, write_text
from granflow.io.log import version_of
from granflow.particles.resolve import resolved_input
from granflow.scene.blocks.run import Precision
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.reader import document_in, scene_in, scene_with
from granflow.schema.document import Document, DocumentError, document_of, parse
from granflow.schema.model import Model
from granflow.visible_text import html_table, numbered, visible_line

# The resolved scene


class Scene(SceneInput):
    """A validated and resolved scene, ready for a run: SI units, all counts known, at scale 1. Immutable.

    The arguments are the keys of a scene file. Values: numbers in SI units or text with units, lists, numpy
    arrays, mappings, and blocks such as `granflow.Material` or `granflow.Cylinder`. Paths in the scene are
    relative to `folder` (default: the working directory). `granflow.load_scene` reads a file. A copy with
    other values (`model_copy`) is neither validated nor resolved. Raises SceneError with all problems, each
    with its key path.

    >>> import granflow as gf
    >>> scene = gf.Scene(
    ...     title="Falling sphere",
    ...     gravity=[0, 0, -9.81],
    ...     materials={"glass": gf.Material(young_modulus="60 MPa", poisson_ratio=0.25, density=2500)},
    ...     pairs={"glass-glass": gf.MaterialPair(restitution=0.9, friction=0.5)},
    ...     contact=gf.Contact(normal="zhou", tangential="mindlin", rolling="none"),
    ...     walls={"floor": gf.Plane(material="glass", point=[0, 0, 0], normal=[0, 0, 1])},
    ...     particles={
    ...         "balls": gf.Group(
    ...             material="glass", diameter="4 mm", insert=gf.PositionsInsertion(positions=[[0, 0, 0.01]])
    ...         )
    ...     },
    ...     domain=gf.Domain(min=[-0.1, -0.1, -0.1], max=[0.1, 0.1, 0.1], on_exit="delete"),
    ...     run=gf.RunSettings(duration="50 ms"),
    ...     output=gf.Output(interval="5 ms"),
    ... )
    >>> scene
    <Scene "Falling sphere": 1 particle in 1 group, 1 wall, zhou contacts, at most 0.05 s>
    """

    def __init__(self, *, folder: str | os.PathLike[str] | None = None, **blocks: Any) -> None:
        # A resolved scene is a copy of a validated one, so that this instance takes over the contents.
        self.__setstate__(Scene.from_dict(blocks, folder).__getstate__())

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: str | os.PathLike[str] | None = None) -> "Scene":
        """The scene of a mapping with the keys of a scene file.

        Values: numbers in SI units or text with units, lists, numpy arrays, mappings. Paths in the scene are
        relative to `folder` (default: the working directory). Raises SceneError with all problems, each with
        its key path.
        """
        if not isinstance(data, Mapping):
            raise SceneError(
                f"scene: this is a {type(data).__name__}, but a scene is a mapping of keys to values, such "
                'as {"title": "My scene", ...}; granflow.load_scene reads a file.'
            )
        folder = Path() if folder is None else path_of("folder", folder)
        return cls.of(scene_in(document_of(data), folder=folder), read=True)

    @classmethod
    def of(cls, written: SceneInput, read: bool = True) -> "Scene":
        """The resolved form of a scene as written, whose parts are not checked against each other here.

        `read`: read particle files again even if the scene has their summary. Raises SceneError.
        """
        source = resolved_input(written, read)
        fields: dict[str, Any] = {name: _frozen(value) for name, value in source}
        scene = cls.model_construct(source.model_fields_set, **fields)
        for name in source.__private_attributes__:
            setattr(scene, name, getattr(source, name))
        if read and scene.start_from is not None:
            scene = scene.model_copy(update={"start_from": str(_earlier_run(scene))})
        return scene

    def with_values(self, values: Mapping[str, Any]) -> "Scene":
        """A copy of the scene with other values by key path; all others are those of the scene as written.

        Keys: paths in the scene as for `--set`, such as "particles.beads.count" or "stages.1.duration"; parts
        that the schema knows are created. Values: as for `from_dict`. The copy is validated and resolved, so
        that defaults and counts follow the new values. Raises SceneError with all problems.

        >>> import granflow as gf
        >>> scene = gf.load_scene("hopper.yaml")
        >>> scene.with_values({"particles.beads.count": 500, "run.velocity_max": "3 m/s"}).run.velocity_max
        3.0
        """
        if not isinstance(values, Mapping):
            raise GranflowError(
                f"values is {shown(values)}, but must be a mapping of key paths to values, such as "
                '{"run.duration": "2 s"}.'
            )
        written = scene_with(self._as_written(), values, self.folder)
        written._path = self.path
        return Scene.of(written, read=True)

    def _as_written(self) -> Document:
        """The document of the scene; that of its resolved values if these are not those of the document, as
        in a copy by `model_copy`."""
        if self._document is not None:
            read = Scene.of(scene_in(self._document, folder=self.folder), read=True)
            if read.to_dict() == self.to_dict():
                return self._document
        return document_of(self.to_dict())

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the scene as YAML with all defaults, in SI units; `load_scene` reads an equal scene from the
        file.

        Replaces an existing file. Mesh and particle files are not copied: their paths are relative to the
        folder of the scene. Returns the path. Raises OutputError if the file cannot be written, and
        GranflowError if an input file of the scene does not exist in the folder of `path`.

        >>> import granflow as gf
        >>> scene = gf.load_scene("hopper.yaml", ["particles.beads.count=500"])
        >>> gf.load_scene(scene.save("small.yaml")) == scene
        True
        """
        target = path_of("path", path)
        for key, name in self.input_names():
            if not (target.parent / name).is_file():
                raise GranflowError(
                    f"{target}: {key} is {name}, which does not exist in {target.parent}: copy it there from "
                    f"{self.folder}, or save the scene in that folder."
                )
        try:
            write_text(target, self.to_yaml())
        except OSError as error:
            raise OutputError(
                f"{target} cannot be written: {error.strerror}; give a file in an existing folder."
            ) from None
        return target

    def input_names(self) -> Iterator[tuple[str, str]]:
        """Yield key and path of each file of a mesh, motion, group, clump or sieve curve, relative to the
        folder of the scene."""
        for name, wall in self.walls.items():
            yield from ((f"walls.{name}.{key}", file) for key, file in wall.files())
        for name, group in self.particles.items():
            yield from ((f"particles.{name}.{key}", file) for key, file in group.files())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as YAML: another process reads and checks it again, without its particle files."""
        return _unpickled, (self.to_yaml(), str(self.folder), str(self.path))

    def __repr__(self) -> str:
        """One line: title, numbers of particles and walls, contact model, longest duration [s]."""
        return f'<Scene "{visible_line(self.title)}": {", ".join(text for _, text in self._summary())}>'

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Table of the scene for notebooks."""
        return html_table(self.title, self._summary())

    def _summary(self) -> list[tuple[str, str]]:
        """Rows of the displays of a scene: label and text."""
        count = sum(group.count for group in self.particles.values())
        longest = self.longest_duration
        stages = f" in {numbered(len(self.stages), 'stage')}" if self.stages else ""
        return [
            ("particles", f"{numbered(count, 'particle')} in {numbered(len(self.particles), 'group')}"),
            ("walls", numbered(len(self.walls), "wall")),
            ("contact", f"{self.contact.name('normal')} contacts"),
            ("duration", f"at most {longest:g} s{stages}"),
        ]

    def problems_without_program(self) -> list[str]:
        """One sentence for each group whose particles only a program adds.

        There is none if the particles come from an earlier run.
        """
        if self.start_from is not None:
            return []
        return [
            f"{self.locate('particles', name, 'insert', 'kind')}: particles.{name}.insert.kind is "
            f"{group.insert.kind}: a Python program adds these particles, and a command line has none. "
            "Choose another kind, such as lattice or file."
            for name, group in self.particles.items()
            if group.insert.from_program
        ]

    def refuse_program(self) -> None:
        """Raise SceneError for a group whose particles only a program adds."""
        if problems := self.problems_without_program():
            raise SceneError(problems)

    def with_precision(self, precision: Precision | None) -> "Scene":
        """The same scene with another floating-point precision, unless it is None."""
        if precision is None:
            return self
        if precision not in get_args(Precision):
            raise GranflowError(
                f"precision is {shown(precision)}; give one of {', '.join(get_args(Precision))}."
            )
        return self.model_copy(update={"run": self.run.model_copy(update={"precision": precision})})


def _earlier_run(scene: Scene) -> Path:
    """The directory in `start_from`, relative to the folder of the scene. Raises SceneError."""
    try:
        return resolved(scene.folder / str(scene.start_from))
    except OSError as error:
        reason = f"start_from is {scene.start_from}, which cannot be read: {error.strerror}"
        raise SceneError(f"{scene.locate('start_from')}: {reason}.") from None


class FrozenDict(dict[str, Any]):
    """A mapping that cannot be changed; its deep copies can."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError("A scene is immutable: use with_values or Scene.from_dict for another scene.")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type, tuple[dict[str, Any]]]:
        return dict, (dict(self),)


def _frozen(value: Any) -> Any:
    """The value with mappings that cannot be changed, at any depth of blocks and mappings."""
    if isinstance(value, dict):
        return FrozenDict({name: _frozen(each) for name, each in value.items()})
    if not isinstance(value, Model):
        return value
    changed = {name: part for name, each in value if (part := _frozen(each)) is not each}
    if not changed:
        return value
    copied = value.model_copy()
    copied.__dict__.update(changed)  # the names of the given fields remain
    return copied


def refuse_other_object(scene: object) -> None:
    """Raise GranflowError for an object that is not a scene."""
    if not isinstance(scene, Scene):
        remedy = "granflow.Scene.from_dict" if isinstance(scene, Mapping) else "granflow.load_scene"
        raise GranflowError(f"scene is of type {type(scene).__name__}; make a scene of it with {remedy}.")


# Readers


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Read the scene in a YAML file and resolve it.

    `path`: UTF-8 file of at most 4 MiB. The path in `start_from` is relative to the folder of the file. Each
    override, "key.path=value", replaces or adds a value (YAML) before validation. The result is immutable and
    in SI units.

    Raises SceneError with all problems in the order of the file, each with line and column, at most 100.

    >>> gf.load_scene("two.yaml", ["run.duration=5 ms"]).run.duration
    0.005
    """
    path = path_of("path", path)
    overrides = items_of("overrides", overrides, 'texts, such as "run.duration=5 ms"')
    for each in overrides:
        refuse_other("an override", each, str, 'a text, such as "run.duration=5 ms"')
    written = scene_in(document_in(path), overrides, path.parent)
    written._path = path
    return Scene.of(written, read=True)


def scene_of(text: str, source: str, overrides: Sequence[str] = ()) -> Scene:
    """Read a scene from text, such as that in a checkpoint; paths are relative to the folder of `source`.

    Particle files are not read again if the text contains their summary. Raises the errors of `load_scene`.
    """
    try:
        written = scene_in(parse(text, source), overrides, Path(source).parent)
    except DocumentError as error:
        raise SceneError(str(error.problem)) from None
    return Scene.of(written, read=False)


def _unpickled(text: str, folder: str, path: str) -> Scene:
    """The scene of the text of another process."""
    written = scene_in(parse(text, "the pickled scene"), (), Path(folder))
    written._path = Path(path)
    return Scene.of(written, read=False)


# The scene in an output directory, whose input files are copied there

COPIES = "inputs"
"""Folder in the output directory with the copies of input files that are not below the folder of the
scene."""
RESULTS = re.compile(r"(particles|contacts|walls)_\d+(\.\d+)?\.vtu|timeseries\.csv")
"""Names of result files, which the run writes itself: copies of input files with such a name are in
COPIES."""


def copied_scene(scene: Scene, taken: dict[str, Path] | None = None) -> Scene:
    """The scene for its output directory, in which each input file has the path of its copy.

    A path below the folder of the scene remains. Other files are copied to COPIES under their name, with a
    number if another file has it. `taken`: files by the path of their copy, in lowercase; extended, for
    several scenes with one output directory. The scene of an output directory is returned unchanged. Raises
    OSError for a path that cannot be followed.
    """
    taken = {} if taken is None else taken
    names = dict.fromkeys(name for _, name in scene.input_names())
    copies = {}
    for name in sorted(names, key=lambda name: not _stays(name)):
        wanted = PurePath(name) if _stays(name) else PurePath(COPIES, PurePath(name).name)
        copies[name] = _free(wanted, resolved(scene.folder / name), taken)
    if all(name == copy for name, copy in copies.items()):
        return scene
    walls = {name: wall.with_files(copies) for name, wall in scene.walls.items()}
    particles = {name: group.with_files(copies) for name, group in scene.particles.items()}
    return scene.model_copy(update={"walls": walls, "particles": particles})


def _stays(name: str) -> bool:
    """Whether the copy of an input file has the same path in the output directory."""
    path = PurePath(name)
    is_below = not path.is_absolute() and not path.drive and ".." not in path.parts
    return is_below and not RESULTS.fullmatch(name)


def _free(wanted: PurePath, source: Path, taken: dict[str, Path]) -> str:
    """The wanted path, with the first number if needed at which no other file has it; added to `taken`."""
    for number in count(1):
        path = wanted if number == 1 else wanted.with_name(f"{wanted.stem}_{number}{wanted.suffix}")
        # Some file systems do not distinguish upper and lower case.
        if taken.setdefault(path.as_posix().lower(), source) == source:
            return path.as_posix()
    raise AssertionError("count() has no end")


# Identity of a scene


def identity_of(scene: Scene) -> str:
    """SHA-256 of the program version, the resolved scene, and the contents of the files that it reads.

    Without the contents of the run in `start_from`. Raises OSError for a file that cannot be read.
    """
    digest = hashlib.sha256(f"{program_version()}\n{scene.to_yaml()}".encode())
    for key, name in scene.input_names():
        digest.update(f"\n{key} {file_digest(scene.folder / name)}".encode())
    return digest.hexdigest()


def program_version() -> str:
    """Version of granflow, and digest of its engine, which differs between commits of one version."""
    return f"granflow {version_of('granflow')} (engine {engine_digest()})"
