"""Off-screen rendering of particles, walls and force chains with pyvista."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.studies.render.camera import OPENING, Camera, HalfSpace
from granflow.studies.render.frames import ForceChains, FrameParticles, FrameWalls

FINER = 2
"""Supersampling factor along each side, for antialiasing."""

WALL = {"color": "lightsteelblue", "opacity": 0.16, "lighting": False}
"""Style of walls in pyvista."""

PLANE = WALL | {"opacity": 0.08}
"""Style of unbounded planes."""

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
"""Ratio of radius to distance from the eye above which a sphere is drawn as triangles (a tenth of the height)."""

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

    `size`: width and height [pixels]. Raises GranflowError if pyvista is not installed. Call `close` after use.
    """

    def __init__(self, size: tuple[int, int], camera: Camera) -> None:
        self._pyvista = require_pyvista()
        self._plotter = self._pyvista.Plotter(off_screen=True, window_size=[FINER * side for side in size])
        self._plotter.set_background("white")
        self._plotter.ren_win.SetMultiSamples(0)  # multisampling would show the edges of transparent triangles
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
        """Show particles in `colors` (n, 3), 0 to 255, or transparent and gray; replaces those shown before."""
        colors = np.full_like(colors, GRAY) if faint else colors
        distance = np.linalg.norm(particles.position - self._plotter.camera.position, axis=1)
        is_near = particles.radius > NEAR * distance
        for name, chosen, add in (("particles", ~is_near, self._add_many), ("near particles", is_near, self._add_near)):
            self._plotter.remove_actor(name, render=False)
            if np.any(chosen):
                points = self._pyvista.PolyData(particles.position[chosen])
                points["radius"] = particles.radius[chosen].astype(np.float32)
                points["color"] = colors[chosen]
                add(points, name, FAINT if faint else 1.0)

    def _add_many(self, points: Any, name: str, opacity: float) -> None:
        """Add spheres that a shader computes per pixel: fast, but clipped if a sphere fills much of the picture."""
        from vtkmodules.vtkRenderingCore import vtkActor
        from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLSphereMapper

        mapper, actor = vtkOpenGLSphereMapper(), vtkActor()
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
    ) -> None:
        """Show transparent walls with their edges, clipped to `box` (2, 3) [m] and to the half space `cut`.

        `plane_boxes` (2, 3) [m]: boxes to which unbounded planes are clipped as well, by number. Walls that have not
        moved since the last frame are kept.
        """
        if walls is not None and walls.same_as(self._walls):
            return
        self._walls = walls
        for name in self._wall_actors:
            self._plotter.remove_actor(name, render=False)
        self._wall_actors = []
        if walls is None:
            return
        self._add_wall("walls", walls.selected([k for k in walls.numbers if k not in plane_boxes]), [box], cut, WALL)
        for number, plane_box in plane_boxes.items():
            self._add_wall(f"plane {number}", walls.selected([number]), [box, plane_box], cut, PLANE)

    def _add_wall(
        self,
        name: str,
        walls: FrameWalls,
        boxes: Sequence[np.ndarray | None],
        cut: HalfSpace | None,
        style: Mapping[str, Any],
    ) -> None:
        """Add walls and their edges, clipped to the boxes and the half space, as actors with a common `name`."""
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
        vtk_camera.position, vtk_camera.focal_point, vtk_camera.up = camera.eye, camera.focus, camera.view.up
        vtk_camera.view_angle = float(np.degrees(OPENING))
        vtk_camera.parallel_scale = camera.half_height
        vtk_camera.parallel_projection = not camera.view.perspective

    def _surface(self, walls: FrameWalls) -> Any:
        """Surface of the walls with merged points, so that edges between polygons are found."""
        faces = [np.column_stack([np.full(len(each), each.shape[1]), each]).ravel() for each in walls.polygons]
        return self._pyvista.PolyData(walls.points, np.concatenate(faces)).clean(
            lines_to_points=False, polys_to_lines=False
        )

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
