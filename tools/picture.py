"""Draw one moment of a finished run with PyVista, without a window:

python tools/picture.py out/hopper --time 0.9 --out hopper.png --from 1 -2 0.8
"""

import argparse
from pathlib import Path

import numpy as np
import pyvista

SPHERE_FACETS = 20
RIM_ANGLE = 25  # degrees between two facets, above which their edge is drawn
WALL = {"color": "lightsteelblue", "opacity": 0.15}
BAR = {"color": "black", "vertical": True, "position_x": 0.88, "position_y": 0.3, "height": 0.4, "width": 0.04}
TEXT = {"fmt": "%.2g", "n_labels": 3, "title_font_size": 24, "label_font_size": 22}


def main() -> None:
    """Read the frame nearest to the time asked and write the picture."""
    options = arguments()
    plotter = pyvista.Plotter(off_screen=True, window_size=options.size)
    plotter.set_background("white")
    add_walls(plotter, nearest(options.run / "walls.pvd", options.time), options.cut)
    add_particles(plotter, nearest(options.run / "particles.pvd", options.time), options)
    plotter.enable_anti_aliasing("ssaa")
    plotter.camera_position = [np.array(options.viewpoint), (0, 0, 0), (0, 0, 1)]
    plotter.reset_camera()
    plotter.camera.zoom(options.zoom)
    plotter.screenshot(options.out)


def nearest(series: Path, time: float) -> pyvista.DataSet:
    """The frame of a .pvd series that is nearest to a time [s]."""
    reader = pyvista.get_reader(series)
    reader.set_active_time_value(min(reader.time_values, key=lambda each: abs(each - time)))
    return reader.read()[0]


def add_walls(plotter: pyvista.Plotter, walls: pyvista.DataSet, cut: float | None) -> None:
    """Walls, see-through with their rims drawn; with `cut`, only what stands behind y = cut [m]."""
    surface = walls.extract_surface(algorithm="dataset_surface").clean()
    if cut is not None:
        surface = surface.clip("-y", origin=(0, cut, 0))
    plotter.add_mesh(surface, **WALL)
    plotter.add_mesh(surface.extract_feature_edges(RIM_ANGLE), color="slategray", line_width=2)


def add_particles(plotter: pyvista.Plotter, particles: pyvista.DataSet, options: argparse.Namespace) -> None:
    """Spheres of true size behind the cut, coloured by one quantity (a vector by its magnitude)."""
    color = options.color
    if options.cut is not None:
        particles = particles.extract_points(particles.points[:, 1] > options.cut, include_cells=False)
    values = particles.point_data[color]
    particles["shown"] = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
    sphere = pyvista.Sphere(radius=0.5, theta_resolution=SPHERE_FACETS, phi_resolution=SPHERE_FACETS)
    spheres = particles.glyph(scale="diameter", geom=sphere, orient=False)
    title = "speed [m/s]\n" if color == "velocity" else f"{color}\n"
    highest = options.limit or float(np.quantile(particles["shown"], 0.98)) or 1.0
    look = {"cmap": "viridis", "clim": (0, highest), "smooth_shading": True, "specular": 0.25, "ambient": 0.2}
    plotter.add_mesh(spheres, scalars="shown", scalar_bar_args=BAR | TEXT | {"title": title}, **look)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, help="directory of the run")
    parser.add_argument("--time", type=float, default=float("inf"), help="simulated time [s] (the last frame)")
    parser.add_argument("--out", type=Path, default=Path("picture.png"), help="the picture (picture.png)")
    parser.add_argument("--color", default="velocity", help="array that gives the colour (velocity)")
    parser.add_argument("--limit", type=float, help="value at the end of the colour scale")
    parser.add_argument(
        "--from", dest="viewpoint", type=float, nargs=3, default=(1.0, -2.0, 0.8), help="direction of view"
    )
    parser.add_argument("--cut", type=float, help="leave out what stands in front of this y [m]")
    parser.add_argument("--zoom", type=float, default=1.3, help="larger is nearer (1.3)")
    parser.add_argument("--size", type=int, nargs=2, default=(1200, 900), help="pixels (1200 900)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
