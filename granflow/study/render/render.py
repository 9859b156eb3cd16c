"""From the frames of a run to pictures: one look, one camera and one range of colours for all of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.observe import replacing
from granflow.scene import Scene, load
from granflow.study.render.camera import Camera, View, aspect_of, camera_for, view_of
from granflow.study.render.colors import Scale, scale_for, values_of
from granflow.study.render.frames import Chains, Frame, Grains, frames_of, read_chains, read_grains, read_walls
from granflow.study.render.margin import WIDTH, colors_of, strip
from granflow.study.render.painter import Painter, require_pyvista
from granflow.study.render.sight import domain_of, points_in_sight, sampled

HEIGHT = 1200
ASPECTS = (0.5, 1.9)
"""Narrowest and widest picture where no size is asked for."""

SAMPLED_FRAMES = 40
"""Most frames that are read for the range of colours."""

THICKEST, THINNEST = 0.5, 0.04
"""Radius of the tube of the largest force, over the mean radius of grains; those below the second are left out."""

CHAIN_COLOR = "normal_force"


@dataclass(frozen=True)
class Look:
    """What a picture shows and from where.

    `color`: an array of the grains; with `chains` the contacts are shown instead, by their normal force. `fit`: what
    is in sight, "all", "grains" or "domain". `cut`: without the half in front. `limits`: ends of the colour scale
    [SI]. `size`: (width, height) in pixels, the strip with the scale included.
    """

    color: str = "velocity"
    view: str = "iso"
    zoom: float = 1.0
    fit: str = "all"
    cut: bool = False
    chains: bool = False
    limits: tuple[float, float] | None = None
    size: tuple[int, int] | None = None

    @property
    def shown(self) -> str:
        """The array that gives the colour."""
        return CHAIN_COLOR if self.chains else self.color


@dataclass(frozen=True)
class Stage:
    """What all pictures of one run have in common."""

    look: Look
    scale: Scale
    camera: Camera
    size: tuple[int, int]
    domain: np.ndarray | None
    cut: tuple[np.ndarray, np.ndarray] | None
    decimals: int
    """Of the time in seconds, so that frames are told apart."""


def scene_as_run(directory: Path) -> Scene | None:
    """The scene of a run; none where it is gone or cannot be read any more."""
    try:
        return load(directory / "scene_as_run.yaml")
    except GranflowError:
        return None


def write_pictures(directory: Path, frames: Sequence[Frame], look: Look, out: Path | None = None) -> list[Path]:
    """Write a PNG of each frame into `pictures/` of the run, or the only one to `out`; returns their paths.

    Raises GranflowError where the extra `plot` is not installed, files cannot be read, or the look asks for what
    there is not.
    """
    require_pyvista()
    from PIL import Image

    paths = [out or directory / "pictures" / f"{name_of(look)}_{frame.number:04d}.png" for frame in frames]
    for path, picture in zip(paths, pictures(directory, frames, look), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            Image.fromarray(picture).save(temporary, format="PNG", optimize=True)
    return paths


def name_of(look: Look) -> str:
    """A file name that tells looks apart: the view and the colour."""
    view = look.view if look.view.isalpha() else "from_" + look.view.replace(",", "_")
    return "_".join(["picture", look.shown.replace(".", "_"), view, *(["cut"] if look.cut else [])])


def pictures(directory: Path, frames: Sequence[Frame], look: Look) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3), 0 to 255, of the frames, one after the other. Raises as `write_pictures` does."""
    require_pyvista()
    stage = stage_for(directory, frames, look)
    painter = Painter((stage.size[0] - _strip_width(stage.size[1]), stage.size[1]), stage.camera)
    try:
        for frame in frames:
            yield _picture(painter, stage, frame)
    finally:
        painter.close()


def stage_for(directory: Path, frames: Sequence[Frame], look: Look) -> Stage:
    """Camera, colour scale and size for all frames."""
    scene = scene_as_run(directory)
    view = view_of(look.view, None if scene is None else np.array(scene.gravity))
    whole = frames_of(directory)
    domain = domain_of(scene)
    points = points_in_sight(look.fit, scene, frames if look.fit == "grains" else whole, domain)
    size = look.size or _size(aspect_of(view, points))
    camera = camera_for(view, points, (size[0] - _strip_width(size[1])) / size[1], look.zoom)
    cut = _cut(view, points) if look.cut else None
    scale = _scale(look, scene, sampled(frames, SAMPLED_FRAMES))
    return Stage(look, scale, camera, size, domain, cut, decimals_of([frame.time for frame in whole]))


def decimals_of(times: Sequence[float]) -> int:
    """Digits behind the point that tell most of these times [s] apart."""
    apart = float(np.median(np.diff(times))) if len(times) > 1 else float(np.max(times))
    return max(0, -int(np.floor(np.log10(apart) + 1e-3))) if apart > 0.0 else 1


def _size(aspect: float) -> tuple[int, int]:
    """Even numbers of pixels, as films need."""
    width = HEIGHT * min(max(aspect, ASPECTS[0]), ASPECTS[1])
    return 2 * round(0.5 * width) + _strip_width(HEIGHT), HEIGHT


def _strip_width(height: int) -> int:
    return int(WIDTH * height)


def _cut(view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane (point, normal) through the middle, across the axis that points most to the viewer."""
    axis = int(np.argmax(np.abs(view.toward)))
    normal = np.zeros(3)
    normal[axis] = np.sign(view.toward[axis])
    return 0.5 * (points.min(axis=0) + points.max(axis=0)), normal


def _scale(look: Look, scene: Scene | None, frames: Sequence[Frame]) -> Scale:
    if look.chains:
        forces = [chains.normal_force for chains in map(read_chains, frames) if chains is not None]
        if not forces:
            raise GranflowError(
                "--chains: the run has no contacts_*.vtu; put output.contacts: true into its scene and run it again."
            )
        return scale_for(CHAIN_COLOR, forces, limits=look.limits)
    grains = [each for each in map(read_grains, frames) if len(each.radius)]
    is_vector = any(np.ndim(each.arrays.get(look.color, 0)) == 2 for each in grains)
    values = [values_of(each.arrays, look.color) for each in grains]
    return scale_for(look.color, values, is_vector, _names(scene), look.limits)


def _names(scene: Scene | None) -> dict[str, tuple[str, ...]]:
    """Names of materials and groups in the order of their numbers in the files."""
    if scene is None:
        return {}
    from granflow.plan import plan_for

    try:
        materials = plan_for(scene).materials
    except GranflowError:  # such as a mesh that has been moved since
        materials = ()
    return {"group": tuple(scene.particles), "material": materials}


def _picture(painter: Painter, stage: Stage, frame: Frame) -> np.ndarray:
    grains = _behind(read_grains(frame), stage.cut)
    painter.set_walls(read_walls(frame), stage.domain, stage.cut)
    if stage.look.chains:
        _draw_chains(painter, stage, read_chains(frame), grains)
    else:
        values = values_of(grains.arrays, stage.look.color) if len(grains.radius) else np.zeros(0)
        painter.set_grains(grains, colors_of(values, stage.scale))
    return np.concatenate(
        [painter.draw(), strip(stage.scale, f"{frame.time:.{stage.decimals}f} s", stage.size[1])], axis=1
    )


def _draw_chains(painter: Painter, stage: Stage, chains: Chains | None, grains: Grains) -> None:
    painter.set_grains(grains, np.zeros((len(grains.radius), 3), np.uint8), faint=True)
    chains = chains or Chains(np.zeros((0, 2, 3)), np.zeros(0))
    share = np.clip(chains.normal_force / stage.scale.limits[1], 0.0, 1.0)
    kept = share > THINNEST / THICKEST
    if stage.cut is not None:
        point, normal = stage.cut
        kept &= np.all((chains.ends - point) @ normal <= 0.0, axis=1)
    chains, share = Chains(chains.ends[kept], chains.normal_force[kept]), share[kept]
    mean_radius = float(np.mean(grains.radius)) if len(grains.radius) else 0.0
    painter.set_chains(chains, THICKEST * mean_radius * share, colors_of(chains.normal_force, stage.scale))


def _behind(grains: Grains, cut: tuple[np.ndarray, np.ndarray] | None) -> Grains:
    """Grains whose centre is behind the plane."""
    if cut is None:
        return grains
    point, normal = cut
    kept = (grains.position - point) @ normal <= 0.0
    arrays = {name: values[kept] for name, values in grains.arrays.items()}
    return Grains(grains.position[kept], grains.radius[kept], arrays)
