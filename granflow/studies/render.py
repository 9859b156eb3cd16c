"""Pictures and films of the frames of a run, with the same style, camera and color scale.

`setup_for` determines what all pictures of a run share, from all its frames: the camera and the color
`Scale`. `pictures` then draws frame by frame: the `Renderer` shows particles, walls and force chains
off-screen with pyvista, and `legend_strip` draws time, color scale and scale bar with matplotlib on the right
of it. `write_pictures` writes PNG files, `write_film` an MP4 file.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from granflow import Scene, plan_for, read_run
from granflow.errors import GranflowError
from granflow.fields import CONTACT_QUANTITIES, PARTICLE_QUANTITIES, WALL_ARRAY_QUANTITIES
from granflow.io.files import replacing
from granflow.schema.messages import nearest
from granflow.studies.figures import COLOR_NAMES, COLORS, styled_figure
from granflow.studies.frames import (
    COLORS_OF_WALLS,
    OPENING,
    Camera,
    ForceChains,
    Frame,
    FrameParticles,
    FrameWalls,
    View,
    aspect_of,
    bounding_points,
    camera_for,
    domain_of,
    drawn_boxes,
    frames_of,
    particle_points,
    read_force_chains,
    read_particles,
    read_walls,
    sampled,
    view_of,
)

# Pictures

CHAIN_COLOR = "normal_force"
"""Array of contacts that determines color and thickness of force chains."""


@dataclass(frozen=True)
class PictureStyle:
    """Content and view of a picture.

    `color`: an array of the particles; with `chains`, contacts are shown instead, colored by normal force;
    with `walls`, the walls alone, colored by one of their arrays. `fit`: shown region, "all", "particles" or
    "domain". `cut`: hide the front half. `limits`: limits of the color scale [SI]. `size`: (width, height) in
    pixels, including the legend strip.
    """

    color: str = "velocity"
    view: str = "iso"
    zoom: float = 1.0
    fit: str = "all"
    cut: bool = False
    chains: bool = False
    walls: str | None = None
    limits: tuple[float, float] | None = None
    size: tuple[int, int] | None = None

    @property
    def shown(self) -> str:
        """Array that determines the color."""
        return CHAIN_COLOR if self.chains else self.walls or self.color


def write_pictures(
    directory: Path, frames: Sequence[Frame], style: PictureStyle, out: Path | None = None
) -> list[Path]:
    """Write a PNG of each frame to `pictures/` of the run, or a single one to `out`; return the paths.

    Files are written atomically and replace earlier ones of the same name.

    Raises GranflowError if the extra `plot` is not installed, if files cannot be read, or if the style
    requires data that the run did not write.
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
    shown = [*(["walls"] if style.walls else []), style.shown.replace(".", "_")]
    return "_".join(["picture", *shown, view, *(["cut"] if style.cut else [])])


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


# What all pictures of a run share


@dataclass(frozen=True)
class HalfSpace:
    """Points behind a plane through `point` (3,) [m] with the outward `normal` (3,)."""

    point: np.ndarray
    normal: np.ndarray

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether points (..., 3) [m] are in the half space, (...)."""
        return (points - self.point) @ self.normal <= 0.0


HEIGHT = 1200
"""Height of a picture without a given size [pixels]."""
FILM_HEIGHT = 900
"""Height of a film without a given size [pixels]."""
ASPECTS = (0.5, 1.9)
"""Minimum and maximum width over height of a picture without a given size."""
COLOR_FRAMES = 40
"""Maximum number of frames that determine the color range."""


@dataclass(frozen=True)
class PictureSetup:
    """Common properties of all pictures of a run.

    `size`: width and height [pixels], including the legend strip; `domain` (2, 3) [m] to which walls are
    clipped, or None; `particles` (k, 3) [m]: outermost points of the particles, around which planes are
    clipped; `cut`: outside this half space, nothing is drawn.
    """

    style: PictureStyle
    scene: Scene | None
    scale: "Scale"
    camera: Camera
    size: tuple[int, int]
    domain: np.ndarray | None
    particles: np.ndarray
    cut: HalfSpace | None
    decimals: int
    """Decimals of the time [s] that distinguish the frames."""
    speed: str = ""
    """Speed of a film relative to the simulated time, as text."""


def setup_for(
    directory: Path, frames: Sequence[Frame], style: PictureStyle, rate: float | None = None
) -> PictureSetup:
    """Camera, color scale and size for all frames, so that pictures of one run are comparable.

    `rate`: pictures per second of a film, or None.
    """
    run = read_run(directory)
    scene = None if run.scene_problem else run.scene
    view = view_of(style.view, None if scene is None else np.array(scene.usual_gravity))
    whole = frames_of(directory)
    domain = domain_of(scene)
    shown = frames if style.fit == "particles" else whole
    particles = particle_points(shown)
    points = bounding_points(style.fit, scene, shown, domain, particles)
    size = style.size or _size(aspect_of(view, points), FILM_HEIGHT if rate else HEIGHT)
    camera = camera_for(view, points, (size[0] - _strip_width(size[1])) / size[1], style.zoom)
    cut = _cut(view, points) if style.cut else None
    scale = _scale(style, scene, sampled(frames, COLOR_FRAMES), view)
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
    return HalfSpace(
        0.5 * (points.min(axis=0) + points.max(axis=0)), np.sign(view.toward[axis]) * np.eye(3)[axis]
    )


def _scale(style: PictureStyle, scene: Scene | None, frames: Sequence[Frame], view: View) -> "Scale":
    """Color scale of a style. Raises GranflowError for force chains if the run has no contacts, and for an
    array that its walls do not have or whose walls are edge-on."""
    if style.chains:
        forces = [chains.normal_force for chains in map(read_force_chains, frames) if chains is not None]
        if not forces:
            raise GranflowError(
                "--chains: the run has no contacts_*.vtu; set output.contacts: true in the scene and run it "
                "again."
            )
        return scale_for(CHAIN_COLOR, forces, limits=style.limits)
    if style.walls is not None:
        return _scale_of_walls(style, frames, view)
    particles = [each for each in map(read_particles, frames) if len(each.radius)]
    is_vector = any(np.ndim(each.arrays.get(style.color, 0)) == 2 for each in particles)
    values = [values_of(each.arrays, style.color) for each in particles]
    return scale_for(style.color, values, is_vector, _names(scene), style.limits)


def _scale_of_walls(style: PictureStyle, frames: Sequence[Frame], view: View) -> "Scale":
    """Color scale of an array of the walls: all its values count, because few triangles can have most of
    them."""
    color = style.walls or ""
    walls = [each for each in map(read_walls, frames) if each is not None]
    if not walls:
        raise GranflowError(
            "--walls: the run has no walls_*.vtu; set output.walls: true in the scene and run it again."
        )
    values = [part for each in walls for part in wall_values_of(each, color)]
    found = np.concatenate([np.zeros(0), *values])
    if not np.isfinite(found).any():
        raise GranflowError(f"--walls {color}: no wall has a value of it.")
    if not any(_shows_values(each, color, view) for each in walls):
        raise GranflowError(
            f"--view {style.view}: all walls with {color} are edge-on; choose another view, such as iso."
        )
    is_vector = "." not in color and any(part.ndim == 2 for each in walls for part in each.arrays[color])
    return scale_for(color, values, is_vector, limits=style.limits, percentiles=(0.0, 100.0))


def _shows_values(walls: FrameWalls, color: str, view: View) -> bool:
    """Whether a polygon with a value of an array of the walls has an area in a picture; always in
    perspective."""
    for corners, values in zip(walls.polygons, wall_values_of(walls, color), strict=True):
        points = walls.points[corners[np.isfinite(values)]].astype(np.float64)
        normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        shares = np.abs(normals @ view.toward) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        if (shares > 1e-6).any() or (view.perspective and len(points)):
            return True
    return False


def wall_values_of(walls: FrameWalls, color: str) -> tuple[np.ndarray, ...]:
    """Values (k,) of an array of each kind of polygon, as `values_of`. Raises GranflowError without it."""
    if not walls.arrays:
        raise GranflowError(
            f"--walls {color}: the walls have no arrays. output.wall_forces gives pressure and traction, "
            "wear of a wall gives wear_depth, a belt surface_velocity, its temperature temperature."
        )
    kinds = range(len(walls.polygons))
    return tuple(
        values_of({name: values[kind] for name, values in walls.arrays.items()}, color, "--walls")
        for kind in kinds
    )


def _names(scene: Scene | None) -> dict[str, tuple[str, ...]]:
    """Names of materials and groups, in the order of their numbers in the files."""
    if scene is None:
        return {}
    try:
        materials = plan_for(scene).materials
    except GranflowError:  # such as a missing mesh file
        materials = ()
    return {"group": tuple(scene.particles), "material": materials}


# One picture

THICKEST = 0.5
"""Radius of the tube of the largest force over the mean particle radius."""
THINNEST = 0.04
"""Smallest radius of a tube that is shown, over the mean particle radius."""


def _picture(renderer: "Renderer", setup: PictureSetup, frame: Frame) -> np.ndarray:
    """Picture (height, width, 3), 0 to 255, of one frame with its legend strip."""
    particles = read_particles(frame)
    if setup.cut is not None:
        particles = particles.selected(setup.cut.contains(particles.position))
    walls = read_walls(frame)
    boxes = {} if walls is None else drawn_boxes(walls, setup.scene, setup.particles)
    colored: frozenset[int] = frozenset()
    if walls is not None and setup.style.walls is not None:
        walls, colored = _colored(walls, setup.style.walls, setup.scale)
    renderer.set_walls(walls, setup.domain, boxes, setup.cut, colored)
    if setup.style.chains:
        _draw_chains(renderer, setup, read_force_chains(frame), particles)
    elif setup.style.walls is None:  # particles, even if transparent, would change the colors of walls
        values = values_of(particles.arrays, setup.style.color) if len(particles.radius) else np.zeros(0)
        renderer.set_particles(particles, colors_of(values, setup.scale))
    time = f"{frame.time:.{setup.decimals}f} s"
    shown_height = setup.camera.shown_height
    strip = legend_strip(setup.scale, time, setup.size[1], shown_height, setup.speed)
    return np.concatenate([renderer.draw(), strip], axis=1)


def _colored(walls: FrameWalls, color: str, scale: "Scale") -> tuple[FrameWalls, frozenset[int]]:
    """The walls with colors, and the numbers of those that have values."""
    values = wall_values_of(walls, color)
    numbers = [wall[np.isfinite(each)] for wall, each in zip(walls.walls, values, strict=True)]
    colors = tuple(colors_of(each, scale) for each in values)
    with_colors = replace(walls, arrays={**walls.arrays, COLORS_OF_WALLS: colors})
    return with_colors, frozenset(np.concatenate([np.zeros(0, int), *numbers]).astype(int).tolist())


def _draw_chains(
    renderer: "Renderer", setup: PictureSetup, chains: ForceChains | None, particles: FrameParticles
) -> None:
    """Add the contacts as tubes with a radius proportional to the normal force, and the particles faintly."""
    renderer.set_particles(particles, np.zeros((len(particles.radius), 3), np.uint8), faint=True)
    chains = chains or ForceChains(np.zeros((0, 2, 3)), np.zeros(0))
    share = np.clip(chains.normal_force / setup.scale.limits[1], 0.0, 1.0)
    is_shown = share > THINNEST / THICKEST
    if setup.cut is not None:
        is_shown &= setup.cut.contains(chains.ends).all(axis=1)
    chains = ForceChains(chains.ends[is_shown], chains.normal_force[is_shown])
    share = share[is_shown]
    mean_radius = float(np.mean(particles.radius)) if len(particles.radius) else 0.0
    renderer.set_chains(chains, THICKEST * mean_radius * share, colors_of(chains.normal_force, setup.scale))


# The color scale: one for all frames of a run, so that colors are comparable

CATEGORIES = ("material", "group")
"""Arrays with one color per number instead of a continuous scale."""
SIGNED = "RdBu_r"
UNSIGNED = "viridis"
OF_CONTACTS = "YlOrRd"
"""Color maps of matplotlib: for values of both signs, for other values of particles, for contacts."""


@dataclass(frozen=True)
class Scale:
    """Color scale: array, title of one or two lines, `limits` [SI], displayed unit and its value in SI.

    `names` by number: materials or groups, with one color each; empty for a continuous scale.
    """

    color: str
    title: str
    unit: str
    factor: float
    limits: tuple[float, float]
    names: Mapping[int, str] | None = None
    out_of_range: tuple[bool, bool] = (False, False)

    @property
    def map_name(self) -> str:
        """Color map: blue to white to red for values of both signs, pale to red for contacts."""
        if self.color in CONTACT_QUANTITIES and self.color not in PARTICLE_QUANTITIES:
            return OF_CONTACTS
        return SIGNED if self.limits[0] < 0.0 < self.limits[1] else UNSIGNED

    @property
    def palette(self) -> tuple[str, ...]:
        """Colors of the categories, by number modulo their count: COLORS, in another order if a category has
        the name of one of them."""
        colors = list(COLORS)
        for number, name in (self.names or {}).items():
            wanted = COLOR_NAMES.get(name.lower())
            if wanted is not None and number < len(colors):
                place = colors.index(wanted)
                colors[number], colors[place] = wanted, colors[number]
        return tuple(colors)


PERCENTILES = (1.0, 99.0)
"""Percentiles of all values in all frames that limit the range; values beyond have the color of the limit."""
FROM_ZERO = 0.5
"""A range begins at 0 if its lower limit is below this fraction of the upper one, but not that of a size."""
SIZES = ("radius", "diameter")
"""Quantities whose range does not begin at 0, so that sizes are told apart."""


def scale_for(
    color: str,
    values: Iterable[np.ndarray],
    is_vector: bool = False,
    names: Mapping[str, Sequence[str]] | None = None,
    limits: tuple[float, float] | None = None,
    percentiles: tuple[float, float] = PERCENTILES,
) -> Scale:
    """Color scale of an array from all shown values, or from given `limits` [SI].

    `values`: arrays (n,) of the frames; values that are not finite are ignored. `names`: names of the
    materials and groups of the scene, by array name. `percentiles` of the values limit the range.
    """
    finite = np.concatenate([np.zeros(0), *values])
    finite = finite[np.isfinite(finite)]
    name, _, axis = color.partition(".")
    if name in CATEGORIES:
        return Scale(color, name, "", 1.0, (0.0, 1.0), _categories(name, finite, names or {}))
    low, high = limits or _range(finite, bool(axis), percentiles, 0.0 if name in SIZES else FROM_ZERO)
    known = (PARTICLE_QUANTITIES, CONTACT_QUANTITIES, WALL_ARRAY_QUANTITIES)
    quantity = next((each[name] for each in known if name in each), None)
    factor, unit = prefixed(
        "" if quantity is None or quantity.unit == "1" else quantity.unit, max(abs(low), abs(high))
    )
    title = name.replace("_", " ") + (f", {axis}" if axis else "\nmagnitude" if is_vector else "")
    out_of_range = (bool(np.any(finite < low)), bool(np.any(finite > high)))
    return Scale(color, title, unit, factor, (low, high), out_of_range=out_of_range)


def _categories(name: str, values: np.ndarray, names: Mapping[str, Sequence[str]]) -> dict[int, str]:
    """Names of the materials or groups that occur in the values, by number."""
    known = names.get(name, ())
    numbers = sorted({int(value) for value in values})
    return {number: known[number] if number < len(known) else f"{name} {number}" for number in numbers}


def _range(
    values: np.ndarray, signed: bool, percentiles: tuple[float, float], from_zero: float
) -> tuple[float, float]:
    """Range that contains the values between two percentiles.

    It is symmetric for components, and begins at 0 if the lower limit is below the fraction `from_zero` of
    the upper one. `values` (n,) [SI], all finite; (0, 1) without values.
    """
    if not len(values):
        return 0.0, 1.0
    low, high = (float(end) for end in np.percentile(values, percentiles))
    if signed:
        high = max(abs(low), abs(high)) or 1.0
        return -high, high
    if 0.0 <= low < from_zero * high:
        low = 0.0
    if low == high:
        return min(2.0 * high, 0.0), max(2.0 * high, 0.0) if high else 1.0
    return low, high


PREFIXES = {-9: "n", -6: "\N{MICRO SIGN}", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
"""Prefixes of units by power of ten."""


def prefixed(unit: str, largest: float) -> tuple[float, str]:
    """Value in SI of the unit with the prefix that suits the largest number, and that unit.

    Units with powers get no prefix. For example, 1e-3 and "mN" for "N" and 0.02.
    """
    if not largest > 0.0 or not unit or any(sign in unit for sign in "^0123456789"):
        return 1.0, unit
    grams = unit.startswith("kg")
    power = int(np.floor(np.log10(largest * (1000.0 if grams else 1.0)) / 3.0 + 1e-9)) * 3
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    if grams:
        return 10.0 ** (power - 3), f"{PREFIXES[power]}{unit[1:]}"
    return 10.0**power, f"{PREFIXES[power]}{unit}"


AXES = ("x", "y", "z")


def values_of(arrays: Mapping[str, np.ndarray], color: str, option: str = "--color") -> np.ndarray:
    """Values (n,) of an array, magnitude of a vector, or one component such as velocity.z.

    Raises GranflowError with the available names for an unknown one, given by an `option`.
    """
    name, _, axis = color.partition(".")
    if name not in arrays or (axis and (axis not in AXES or arrays[name].ndim != 2)):
        near = nearest(name, list(arrays))
        hint = f" Did you mean {near}?" if near and near != name else ""
        raise GranflowError(f"{option} {color}: no such array; the arrays are {', '.join(arrays)}.{hint}")
    values = np.asarray(arrays[name], dtype=np.float64)
    if values.ndim == 2:
        return values[:, AXES.index(axis)] if axis else np.linalg.norm(values, axis=1)
    return values


NO_VALUE = (0.6, 0.6, 0.6)
"""Color of nan (red, green, blue; 0 to 1)."""


def colors_of(values: np.ndarray, scale: Scale) -> np.ndarray:
    """Colors (n, 3) uint8 of values (n,) [SI]; gray for nan.

    Values outside the limits get the color of the limit.
    """
    from matplotlib import colormaps, colors

    if scale.names is not None:
        wheel = np.array([colors.to_rgb(color) for color in scale.palette])
        shown = wheel[values.astype(np.int64) % len(wheel)]
    else:
        low, high = scale.limits
        shown = colormaps[scale.map_name](np.clip((values - low) / (high - low), 0.0, 1.0))[:, :3]
        shown[~np.isfinite(values)] = NO_VALUE
    return np.round(255.0 * shown).astype(np.uint8)


# Off-screen rendering of particles, walls and force chains

FINER = 2
"""Supersampling factor along each side, for antialiasing."""
WALL = {"color": "lightsteelblue", "opacity": 0.16, "lighting": False}
"""Style of walls in pyvista."""
PLANE = WALL | {"opacity": 0.08}
"""Style of unbounded planes."""
COLORED_WALL = {"scalars": COLORS_OF_WALLS, "rgb": True, "ambient": 0.7, "diffuse": 0.3}
"""Style of walls with colors."""
EDGE_STYLE = {"color": "#5f7388", "line_width": 1.2 * FINER, "lighting": False}
"""Style of edges of walls in pyvista."""
EDGE_ANGLE = 25.0
"""Angle between two facets of a wall above which their edge is drawn [degrees]."""
SHADE = {"ambient": 0.22, "diffuse": 0.85, "specular": 0.18, "specular_power": 25.0}
"""Lighting coefficients of particles and force chains."""
FAINT = 0.05
"""Opacity of particles in pictures of force chains."""
TUBE_SIDES = 10
"""Sides of the tubes of force chains."""
GRAY = (205, 205, 205)
"""Color of particles in pictures of force chains (red, green, blue; 0 to 255)."""
NEAR = 0.02
"""Ratio of radius to distance from the eye above which a sphere is drawn as triangles (a tenth of the
height)."""
FACETS = 80
"""Number of facets of such a sphere, around the axis and from pole to pole."""


def require_pyvista() -> Any:
    """Import pyvista and return the module. Raises GranflowError if the extra `plot` is not installed."""
    try:
        import matplotlib  # noqa: F401
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger
    except ImportError as error:
        raise GranflowError(
            f"Pictures require {error.name}, which is not installed: pip install pyvista matplotlib"
        ) from None
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # no messages about missing displays
    return pyvista


class Renderer:
    """Renders frames with a fixed camera; spheres are exact to the pixel.

    `size`: width and height [pixels]. Raises GranflowError if pyvista is not installed. Call `close` after
    use.
    """

    def __init__(self, size: tuple[int, int], camera: Camera) -> None:
        self._pyvista = require_pyvista()
        self._plotter = self._pyvista.Plotter(off_screen=True, window_size=[FINER * side for side in size])
        self._plotter.set_background("white")
        self._plotter.ren_win.SetMultiSamples(
            0
        )  # multisampling would show the edges of transparent triangles
        self._walls: FrameWalls | None = None
        self._wall_actors: list[str] = []
        self._set_camera(camera)

    def draw(self) -> np.ndarray:
        """Picture (height, width, 3), 0 to 255."""
        from PIL import Image

        self._plotter.renderer.ResetCameraClippingRange()
        self._plotter.render()
        drawn = self._plotter.screenshot(return_img=True)
        return np.asarray(Image.fromarray(np.ascontiguousarray(drawn[:, :, :3])).reduce(FINER))

    def close(self) -> None:
        """Release the memory of the window."""
        self._plotter.close()

    def set_particles(self, particles: FrameParticles, colors: np.ndarray, faint: bool = False) -> None:
        """Show particles in `colors` (n, 3), 0 to 255, or transparent and gray.

        They replace those shown before.
        """
        colors = np.full_like(colors, GRAY) if faint else colors
        distance = np.linalg.norm(particles.position - self._plotter.camera.position, axis=1)
        is_near = particles.radius > NEAR * distance
        for name, chosen, add in (
            ("particles", ~is_near, self._add_many),
            ("near particles", is_near, self._add_near),
        ):
            self._plotter.remove_actor(name, render=False)
            if np.any(chosen):
                points = self._pyvista.PolyData(particles.position[chosen])
                points["radius"] = particles.radius[chosen].astype(np.float32)
                points["color"] = colors[chosen]
                add(points, name, FAINT if faint else 1.0)

    def _add_many(self, points: Any, name: str, opacity: float) -> None:
        """Add spheres that a shader computes per pixel: fast, but clipped if a sphere fills much of the
        picture."""
        from vtkmodules.vtkRenderingCore import vtkActor
        from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLSphereMapper

        mapper = vtkOpenGLSphereMapper()
        actor = vtkActor()
        mapper.SetInputData(points)
        mapper.SetScaleArray("radius")
        mapper.SetScalarModeToUsePointFieldData()
        mapper.SelectColorArray("color")
        mapper.SetColorModeToDirectScalars()
        actor.SetMapper(mapper)
        shade = actor.GetProperty()
        shade.SetAmbient(SHADE["ambient"])
        shade.SetDiffuse(SHADE["diffuse"])
        shade.SetSpecular(SHADE["specular"])
        shade.SetSpecularPower(SHADE["specular_power"])
        shade.SetOpacity(opacity)
        self._plotter.add_actor(actor, name=name, reset_camera=False, render=False)

    def _add_near(self, points: Any, name: str, opacity: float) -> None:
        """Add spheres of triangles, for the few that are large in the picture."""
        sphere = self._pyvista.Sphere(radius=1.0, theta_resolution=FACETS, phi_resolution=FACETS)
        spheres = points.glyph(scale="radius", geom=sphere, orient=False)
        mesh_style = {"scalars": "color", "rgb": True, "smooth_shading": True, "opacity": opacity, **SHADE}
        self._plotter.add_mesh(spheres, name=name, reset_camera=False, render=False, **mesh_style)

    def set_walls(
        self,
        walls: FrameWalls | None,
        box: np.ndarray | None,
        plane_boxes: Mapping[int, np.ndarray],
        cut: HalfSpace | None,
        colored: Collection[int] = (),
    ) -> None:
        """Show transparent walls with their edges, clipped to `box` (2, 3) [m] and to the half space `cut`.

        `plane_boxes` (2, 3) [m]: boxes to which unbounded planes are clipped as well, by number. The
        `colored` walls are opaque, in their colors. Walls that have not changed since the last frame are
        kept.
        """
        if walls is not None and walls.same_as(self._walls):
            return
        self._walls = walls
        for name in self._wall_actors:
            self._plotter.remove_actor(name, render=False)
        self._wall_actors = []
        if walls is None:
            return
        bounded = [k for k in walls.numbers if k not in plane_boxes]
        plain = walls.selected([k for k in bounded if k not in colored])
        self._add_wall("walls", plain, [box], cut, WALL)
        painted = walls.selected([k for k in bounded if k in colored])
        self._add_wall("colored walls", painted, [box], cut, COLORED_WALL)
        for number, plane_box in plane_boxes.items():
            look = COLORED_WALL if number in colored else PLANE
            self._add_wall(f"plane {number}", walls.selected([number]), [box, plane_box], cut, look)

    def _add_wall(
        self,
        name: str,
        walls: FrameWalls,
        boxes: Sequence[np.ndarray | None],
        cut: HalfSpace | None,
        style: Mapping[str, Any],
    ) -> None:
        """Add walls and their edges, clipped to the boxes and the half space, as actors with a common
        `name`."""
        if not walls.polygons:
            return
        surface = self._surface(walls)
        for box in boxes:
            surface = self._clipped(surface, box, cut)
        edges = surface.extract_feature_edges(EDGE_ANGLE) if surface.n_cells else surface
        for part, mesh, look in ((name, surface, style), (f"edges of {name}", edges, EDGE_STYLE)):
            if mesh.n_cells:
                self._plotter.add_mesh(mesh, name=part, reset_camera=False, render=False, **look)
                self._wall_actors.append(part)

    def set_chains(self, chains: ForceChains, thickness: np.ndarray, colors: np.ndarray) -> None:
        """Show contacts as tubes of radius `thickness` (k,) [m] in `colors` (k, 3), 0 to 255."""
        self._plotter.remove_actor("chains", render=False)
        if not len(chains.ends):
            return
        count = len(chains.ends)
        lines = np.column_stack([np.full(count, 2), np.arange(2 * count).reshape(-1, 2)])
        mesh = self._pyvista.PolyData(chains.ends.reshape(-1, 3), lines=lines.ravel())
        mesh["thickness"], mesh["color"] = np.repeat(thickness, 2), np.repeat(colors, 2, axis=0)
        tubes = mesh.tube(scalars="thickness", absolute=True, n_sides=TUBE_SIDES, capping=True)
        self._plotter.add_mesh(
            tubes, scalars="color", rgb=True, name="chains", reset_camera=False, render=False, **SHADE
        )

    def _set_camera(self, camera: Camera) -> None:
        vtk_camera = self._plotter.camera
        vtk_camera.position = camera.eye
        vtk_camera.focal_point = camera.focus
        vtk_camera.up = camera.view.up
        vtk_camera.view_angle = float(np.degrees(OPENING))
        vtk_camera.parallel_scale = camera.half_height
        vtk_camera.parallel_projection = not camera.view.perspective

    def _surface(self, walls: FrameWalls) -> Any:
        """Surface of the walls with merged points, so that edges between polygons are found."""
        faces = [
            np.column_stack([np.full(len(each), each.shape[1]), each]).ravel() for each in walls.polygons
        ]
        surface = self._pyvista.PolyData(walls.points, np.concatenate(faces))
        if COLORS_OF_WALLS in walls.arrays:
            surface.cell_data[COLORS_OF_WALLS] = np.concatenate(walls.arrays[COLORS_OF_WALLS])
        return surface.clean(lines_to_points=False, polys_to_lines=False)

    @staticmethod
    def _clipped(surface: Any, box: np.ndarray | None, cut: HalfSpace | None) -> Any:
        """Part of a surface in the box and the half space."""
        planes = [cut] if cut else []
        if box is not None:
            finite = np.isfinite(box).all(axis=0)
            low, high = np.where(finite, box, 0.0)
            margin = 1e-3 * (high - low)
            planes += [HalfSpace(low - margin, -axis) for axis in np.eye(3)[finite]]
            planes += [HalfSpace(high + margin, axis) for axis in np.eye(3)[finite]]
        for plane in planes:
            if surface.n_cells and not np.all(plane.contains(surface.points)):
                surface = surface.clip(normal=plane.normal, origin=plane.point)
        return surface


# The legend strip on the right of a picture: time, color scale and scale bar

DPI = 100
"""Dots per inch; font sizes are proportional to the height of the picture."""
WIDTH = 0.27
"""Width of the strip over the height of the picture; all lengths below are relative to that height as
well."""
LETTERS = 0.03
"""Font size over the height of the picture."""
TITLE_LETTERS = 13
"""Maximum number of characters in a line of the title."""
BAR = (0.12, 0.16, 0.17, 0.52)
"""Left, bottom, width and height of the color bar, relative to the strip."""
SCALE_BAR = (0.76, 0.055)
"""Largest length of the scale bar and its height above the bottom, relative to the strip."""


def legend_strip(scale: Scale, time: str, height: int, shown_height: float, speed: str = "") -> np.ndarray:
    """The strip as an image (height, width, 3), 0 to 255.

    `time`, `speed`: text at the top; `height` [pixels]; the width is WIDTH times the height. `shown_height`
    [m]: length that the height of the picture shows, for the scale bar.
    """
    letters = LETTERS * height * 72.0 / DPI
    size = (WIDTH * height / DPI, height / DPI)
    with styled_figure(size, {"font.size": letters}, dpi=DPI, facecolor="white") as figure:
        figure.text(BAR[0], 0.96, time, va="top", fontsize=1.15 * letters)
        figure.text(BAR[0], 0.91, speed, va="top", fontsize=0.9 * letters)
        _scale_bar(figure, shown_height, letters)
        title = "\n".join(_title_lines(scale))
        figure.text(BAR[0], BAR[1] + BAR[3] + 0.025, title, va="bottom", linespacing=1.15)
        _legend(figure, scale, letters) if scale.names is not None else _bar(figure, scale, letters)
        figure.canvas.draw()
        return np.asarray(figure.canvas.buffer_rgba())[:, :, :3].copy()


def _title_lines(scale: Scale) -> list[str]:
    lines = [part for line in scale.title.split("\n") for part in wrap(line, TITLE_LETTERS)]
    return [*lines, f"({scale.unit})"] if scale.unit else lines


def _bar(figure: Any, scale: Scale, letters: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high = (limit / scale.factor for limit in scale.limits)
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    bar = figure.colorbar(
        ScalarMappable(Normalize(low, high), scale.map_name),
        cax=figure.add_axes(BAR),
        extend=ends[scale.out_of_range],
    )
    bar.ax.locator_params(nbins=6)
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=letters, width=0.04 * letters, length=0.3 * letters, pad=0.25 * letters)
    bar.outline.set_linewidth(0.04 * letters)


def _scale_bar(figure: Any, shown_height: float, letters: float) -> None:
    """A horizontal bar of a round length with its label."""
    from matplotlib.lines import Line2D

    length = round_length(SCALE_BAR[0] * WIDTH * shown_height)
    factor, unit = prefixed("m", length)
    right = BAR[0] + length / (WIDTH * shown_height)
    bottom = SCALE_BAR[1]
    line: dict[str, Any] = {
        "color": "black",
        "linewidth": 0.09 * letters,
        "marker": "|",
        "markersize": 0.5 * letters,
    }
    figure.add_artist(Line2D([BAR[0], right], [bottom, bottom], **line))
    figure.text(BAR[0], bottom + 0.015, f"{length / factor:g} {unit}", va="bottom", fontsize=0.9 * letters)


def round_length(largest: float) -> float:
    """Largest of the lengths 1, 2 and 5 times a power of ten that is at most `largest` [m]."""
    power = 10.0 ** np.floor(np.log10(largest) + 1e-9)
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= largest * (1.0 + 1e-9)))


def _legend(figure: Any, scale: Scale, letters: float) -> None:
    """A colored dot and a name for each material or group, as many as fit."""
    line = 1.5 * letters / (72.0 * figure.get_figheight())
    for row, (number, name) in enumerate(list((scale.names or {}).items())[: int(BAR[3] / line)]):
        height = BAR[1] + BAR[3] - (row + 0.5) * line
        color = scale.palette[number % len(COLORS)]
        figure.text(BAR[0], height, "\N{BLACK CIRCLE}", color=color, va="center", family="DejaVu Sans")
        figure.text(BAR[0] + 0.13, height, name, va="center")


# Films: MP4 by the ffmpeg of the package imageio-ffmpeg

CONSTANT_RATE_FACTOR = 25
"""Quality of H.264, 0 (lossless) to 51: without visible block artifacts around particles."""
OUTPUT = ("-crf", str(CONSTANT_RATE_FACTOR), "-f", "mp4", "-movflags", "+faststart")
"""Quality; explicit format, because the temporary name has another suffix; the index first, for streaming."""


def missing_for_film() -> str | None:
    """Name of the package that films require if it is not installed, else None."""
    return "imageio-ffmpeg" if find_spec("imageio_ffmpeg") is None else None


def write_film(path: Path, pictures: Iterable[np.ndarray], rate: float) -> None:
    """Write one or more pictures (height, width, 3), 0 to 255, of one even size as MP4 with `rate` pictures
    per second.

    The file is replaced when it is complete. Raises ImportError without imageio-ffmpeg; see
    `missing_for_film`.
    """
    from imageio_ffmpeg import write_frames

    with replacing(path) as temporary:
        remaining = iter(pictures)
        first = next(remaining)
        writer = write_frames(
            str(temporary),
            first.shape[1::-1],
            fps=rate,
            quality=None,
            macro_block_size=2,
            output_params=list(OUTPUT),
            ffmpeg_log_level="error",
        )
        with closing(writer):
            writer.send(None)
            for picture in chain([first], remaining):
                writer.send(np.ascontiguousarray(picture))
