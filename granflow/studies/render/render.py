"""Pictures of the frames of a run, with the same style, camera and color range."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow import Scene, read_run
from granflow.errors import GranflowError
from granflow.io.atomic_files import replacing
from granflow.studies.render.bounding_points import (
    bounding_points,
    domain_of,
    drawn_box,
    particle_points,
    planes_of,
    sampled,
)
from granflow.studies.render.camera import Camera, HalfSpace, View, aspect_of, camera_for, view_of
from granflow.studies.render.colors import Scale, scale_for, values_of
from granflow.studies.render.frames import (
    ForceChains,
    Frame,
    FrameParticles,
    frames_of,
    read_force_chains,
    read_particles,
    read_walls,
)
from granflow.studies.render.legend import WIDTH, colors_of, legend_strip
from granflow.studies.render.renderer import Renderer, require_pyvista

HEIGHT = 1200
"""Height of a picture without a given size [pixels]."""

FILM_HEIGHT = 900
"""Height of a film without a given size [pixels]."""

ASPECTS = (0.5, 1.9)
"""Minimum and maximum width over height of a picture without a given size."""

COLOR_FRAMES = 40
"""Maximum number of frames that determine the color range."""

THICKEST, THINNEST = 0.5, 0.04
"""Radius of the tube of the largest force over the mean particle radius, and the smallest radius that is shown."""

CHAIN_COLOR = "normal_force"
"""Array of contacts that determines color and thickness of force chains."""


@dataclass(frozen=True)
class PictureStyle:
    """Content and view of a picture.

    `color`: an array of the particles; with `chains`, contacts are shown instead, colored by normal force. `fit`:
    shown region, "all", "particles" or "domain". `cut`: hide the front half. `limits`: limits of the color scale [SI].
    `size`: (width, height) in pixels, including the legend strip.
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
        """Array that determines the color."""
        return CHAIN_COLOR if self.chains else self.color


@dataclass(frozen=True)
class PictureSetup:
    """Common properties of all pictures of a run.

    `size`: width and height [pixels], including the legend strip; `domain` (2, 3) [m] to which walls are clipped, or
    None; `particles` (k, 3) [m]: outermost points of the particles, around which planes are clipped; `cut`: outside
    this half space, nothing is drawn.
    """

    style: PictureStyle
    scene: Scene | None
    scale: Scale
    camera: Camera
    size: tuple[int, int]
    domain: np.ndarray | None
    particles: np.ndarray
    cut: HalfSpace | None
    decimals: int
    """Decimals of the time [s] that distinguish the frames."""
    speed: str = ""
    """Speed of a film relative to the simulated time, as text."""


def write_pictures(
    directory: Path, frames: Sequence[Frame], style: PictureStyle, out: Path | None = None
) -> list[Path]:
    """Write a PNG of each frame to `pictures/` of the run, or a single one to `out`; return the paths.

    Files are written atomically and replace earlier ones of the same name.

    Raises GranflowError if the extra `plot` is not installed, if files cannot be read, or if the style requires data
    that the run did not write.
    """
    require_pyvista()
    from PIL import Image

    paths = [out or picture_path(directory, style, frame) for frame in frames]
    for path, picture in zip(paths, pictures(directory, frames, style), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            Image.fromarray(picture).save(temporary, format="PNG", optimize=True)
    return paths


def picture_path(directory: Path, style: PictureStyle, frame: Frame) -> Path:
    """File of a picture of a frame in `pictures/` of the run."""
    return directory / "pictures" / f"{name_of(style)}_{frame.number:04d}.png"


def name_of(style: PictureStyle) -> str:
    """File name of a style: color and view."""
    view = style.view if style.view.isalpha() else "from_" + style.view.replace(",", "_")
    return "_".join(["picture", style.shown.replace(".", "_"), view, *(["cut"] if style.cut else [])])


def pictures(
    directory: Path, frames: Sequence[Frame], style: PictureStyle, rate: float | None = None
) -> Iterator[np.ndarray]:
    """Yield pictures (height, width, 3), 0 to 255, of the frames.

    `rate`: pictures per second of a film, or None for single pictures. Raises the errors of `write_pictures`.
    """
    require_pyvista()
    setup = setup_for(directory, frames, style, rate)
    renderer = Renderer((setup.size[0] - _strip_width(setup.size[1]), setup.size[1]), setup.camera)
    try:
        for frame in frames:
            yield _picture(renderer, setup, frame)
    finally:
        renderer.close()


def setup_for(directory: Path, frames: Sequence[Frame], style: PictureStyle, rate: float | None = None) -> PictureSetup:
    """Camera, color scale and size for all frames, so that pictures of one run are comparable.

    `rate`: pictures per second of a film, or None.
    """
    run = read_run(directory)
    scene = None if run.scene_problem else run.scene
    view = view_of(style.view, None if scene is None else np.array(scene.gravity))
    whole = frames_of(directory)
    domain = domain_of(scene)
    shown = frames if style.fit == "particles" else whole
    particles = particle_points(shown)
    points = bounding_points(style.fit, scene, shown, domain, particles)
    size = style.size or _size(aspect_of(view, points), FILM_HEIGHT if rate else HEIGHT)
    camera = camera_for(view, points, (size[0] - _strip_width(size[1])) / size[1], style.zoom)
    cut = _cut(view, points) if style.cut else None
    scale = _scale(style, scene, sampled(frames, COLOR_FRAMES))
    decimals = decimals_of([frame.time for frame in whole])
    speed = speed_of([frame.time for frame in frames], rate) if rate else ""
    return PictureSetup(style, scene, scale, camera, size, domain, particles, cut, decimals, speed)


def speed_of(times: Sequence[float], rate: float) -> str:
    """Speed of a film of frames at these times [s] with `rate` pictures per second, as text: "4x slower"."""
    interval = (times[-1] - times[0]) / max(len(times) - 1, 1)
    if not interval > 0.0:
        return ""
    factor = f"{max(rate * interval, 1.0 / (rate * interval)):.3g}"
    return "real time" if factor == "1" else f"{factor}x {'faster' if rate * interval > 1.0 else 'slower'}"


def decimals_of(times: Sequence[float]) -> int:
    """Number of decimals that distinguish most of these times [s]."""
    spacing = float(np.median(np.diff(times))) if len(times) > 1 else float(np.max(times))
    return max(0, -int(np.floor(np.log10(spacing) + 1e-3))) if spacing > 0.0 else 1


def _size(aspect: float, height: int) -> tuple[int, int]:
    """Picture size in pixels; even numbers, as films require."""
    width = height * min(max(aspect, ASPECTS[0]), ASPECTS[1]) + _strip_width(height)
    return 2 * round(0.5 * width), height


def _strip_width(height: int) -> int:
    return int(WIDTH * height)


def _cut(view: View, points: np.ndarray) -> HalfSpace:
    """Half space behind the center, normal to the axis closest to the direction of the viewer."""
    axis = int(np.argmax(np.abs(view.toward)))
    return HalfSpace(0.5 * (points.min(axis=0) + points.max(axis=0)), np.sign(view.toward[axis]) * np.eye(3)[axis])


def _scale(style: PictureStyle, scene: Scene | None, frames: Sequence[Frame]) -> Scale:
    """Color scale of a style. Raises GranflowError for force chains if the run has no contacts."""
    if style.chains:
        forces = [chains.normal_force for chains in map(read_force_chains, frames) if chains is not None]
        if not forces:
            raise GranflowError(
                "--chains: the run has no contacts_*.vtu; set output.contacts: true in the scene and run it again."
            )
        return scale_for(CHAIN_COLOR, forces, limits=style.limits)
    particles = [each for each in map(read_particles, frames) if len(each.radius)]
    is_vector = any(np.ndim(each.arrays.get(style.color, 0)) == 2 for each in particles)
    values = [values_of(each.arrays, style.color) for each in particles]
    return scale_for(style.color, values, is_vector, _names(scene), style.limits)


def _names(scene: Scene | None) -> dict[str, tuple[str, ...]]:
    """Names of materials and groups, in the order of their numbers in the files."""
    if scene is None:
        return {}
    from granflow import plan_for

    try:
        materials = plan_for(scene).materials
    except GranflowError:  # such as a missing mesh file
        materials = ()
    return {"group": tuple(scene.particles), "material": materials}


def _picture(renderer: Renderer, setup: PictureSetup, frame: Frame) -> np.ndarray:
    """Picture (height, width, 3), 0 to 255, of one frame with its legend strip."""
    particles = read_particles(frame)
    if setup.cut is not None:
        particles = particles.selected(setup.cut.contains(particles.position))
    walls = read_walls(frame)
    planes = {k: walls.points_of([k]) for k in planes_of(walls, setup.scene)} if walls is not None else {}
    boxes = {number: drawn_box(plane, setup.particles) for number, plane in planes.items()}
    renderer.set_walls(walls, setup.domain, boxes, setup.cut)
    if setup.style.chains:
        _draw_chains(renderer, setup, read_force_chains(frame), particles)
    else:
        values = values_of(particles.arrays, setup.style.color) if len(particles.radius) else np.zeros(0)
        renderer.set_particles(particles, colors_of(values, setup.scale))
    time, shown_height = f"{frame.time:.{setup.decimals}f} s", setup.camera.shown_height
    strip = legend_strip(setup.scale, time, setup.size[1], shown_height, setup.speed)
    return np.concatenate([renderer.draw(), strip], axis=1)


def _draw_chains(
    renderer: Renderer, setup: PictureSetup, chains: ForceChains | None, particles: FrameParticles
) -> None:
    """Add the contacts as tubes with a radius proportional to the normal force, and the particles faintly."""
    renderer.set_particles(particles, np.zeros((len(particles.radius), 3), np.uint8), faint=True)
    chains = chains or ForceChains(np.zeros((0, 2, 3)), np.zeros(0))
    share = np.clip(chains.normal_force / setup.scale.limits[1], 0.0, 1.0)
    is_shown = share > THINNEST / THICKEST
    if setup.cut is not None:
        is_shown &= setup.cut.contains(chains.ends).all(axis=1)
    chains, share = ForceChains(chains.ends[is_shown], chains.normal_force[is_shown]), share[is_shown]
    mean_radius = float(np.mean(particles.radius)) if len(particles.radius) else 0.0
    renderer.set_chains(chains, THICKEST * mean_radius * share, colors_of(chains.normal_force, setup.scale))
