"""Extreme geometry, motion and velocities: runs with checks of the particles."""

import struct
from pathlib import Path

import numpy as np
from geometry.meshes import sheet
from scene_builders import build_scene, particle_group

from adversarial.beads import beads, solid
from adversarial.case import Case


def as_stl(points, corners) -> bytes:
    """Binary STL of triangles."""
    triangles = np.asarray(points, np.float32)[np.asarray(corners)]
    records = np.zeros(len(triangles), [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    records["c"] = triangles
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + records.tobytes()


LATTICE = "{kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}"


def ran(name: str, text: str, build, verified: str, verify, code=0, patterns=(), files=None, **more) -> Case:
    """Case of a run of the scene built by `made`, with a check `verify(frames)` of its particles."""

    def prepare(sandbox):
        for file, content in (files or {}).items():
            sandbox.write(file, content)
        sandbox.write("beads.yaml", build() if isinstance(build(), str) else build().to_yaml())

    return Case(
        "physics",
        f"physics_{name}",
        text,
        ("run beads.yaml --out out",),
        code,
        patterns=patterns,
        prepare=prepare,
        verify=lambda sandbox, finished: verify(frames(sandbox.path("out"))),
        verified=verified,
        **more,
    )


def frames(out: Path) -> list[dict[str, np.ndarray]]:
    """Positions and arrays of the particles in every frame, ordered by id."""
    import meshio

    found = []
    for path in sorted(out.glob("particles_*.vtu")):
        mesh = meshio.read(path)
        order = np.argsort(mesh.point_data["id"]) if len(mesh.points) else slice(0)
        found.append(
            {"position": mesh.points[order]}
            | {name: values[order] for name, values in mesh.point_data.items()}
        )
    return found


def last(all_frames):
    """Positions (n, 3) [m] in the last frame, all finite."""
    position = all_frames[-1]["position"]
    assert np.isfinite(position).all()
    return position


FALL = {"gravity": [0.0, 0.0, -9.81], "run": {"duration": 0.1}, "output": {"interval": 0.02}}
HARD = {"restitution": 0.5, "friction": 0.3}


def corner():
    """A particle that moves into the corner of planes that enclose 45 degrees."""
    walls = {
        "floor": solid([0, 0, 0], [0, 0, 1]),
        "left": solid([0, 0, 0], [1, 0, 0]),
        "lid": solid([0, 0, 0], [0.7, 0, -0.7]),
        "back": solid([0, 0, 0], [0, 1, 0]),
    }
    ball = particle_group([[0.02, 0.006, 0.006]], velocity=[-1.0, -1.0, 0.0])
    return build_scene({"ball": ball}, walls, pair=HARD, **FALL)


def check_corner(run_frames):
    x, y, z = last(run_frames)[0]
    assert z > 0.0045 and y > 0.0045, (x, y, z)
    assert (x - z) / np.sqrt(2.0) > 0.0045, "the particle is behind the inclined plane"


def hole():
    """Two particles above a floor of triangles with a square hole of 6 cm in its center."""
    ball = particle_group([[0.0, 0.0, 0.02], [0.06, 0.06, 0.02]])
    floor = {"shape": "mesh", "file": "floor.stl", "material": "glass"}
    return build_scene({"ball": ball}, {"floor": floor}, pair=HARD, **(FALL | {"run": {"duration": 0.15}}))


def floor_with_hole() -> bytes:
    """Binary STL of a square of 20 cm, 10 x 10 cells, without the triangles within 3 cm of the middle."""
    points, corners = sheet(20, 0.2)
    middle = np.abs(points[corners].mean(axis=1)[:, :2]).max(axis=1)
    return as_stl(points, corners[middle > 0.03])


def check_hole(run_frames):
    """Free fall through the hole: z = z0 - g t^2 / 2; the other rests or bounces on the floor."""
    position = last(run_frames)
    assert position[0, 2] < 0.02 - 0.4 * 9.81 * 0.15**2, position
    assert 0.0045 < position[1, 2] < 0.02, position


def fixed_on_fixed():
    """Two overlapping fixed particles, and a free particle."""
    fixed = particle_group([[0.0, 0.0, 0.0], [0.004, 0.0, 0.0]]) | {"fixed": True}
    return build_scene({"fixed": fixed, "free": particle_group([[0.1, 0.0, 0.1]])}, pair=HARD, **FALL)


def check_fixed(run_frames):
    position = last(run_frames)
    assert np.allclose(position[:2], [[0.0, 0.0, 0.0], [0.004, 0.0, 0.0]], atol=1e-9)
    assert np.isclose(position[2, 2], 0.1 - 0.5 * 9.81 * 0.1**2, rtol=1e-3), position


def walls_cross():
    """A plane that moves through another plane and compresses a particle until a limit aborts the run."""
    down = {"kind": "translation", "velocity": [0, 0, -0.5]}
    walls = {
        "floor": solid([0, 0, 0], [0, 0, 1]),
        "lid": solid([0, 0, 0.02], [0, 0, -1]) | {"motion": [down]},
    }
    return build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.006]])},
        walls,
        pair=HARD,
        **(FALL | {"run": {"duration": 0.1, "velocity_max": 1.0}}),
    )


def walls_cross_empty():
    """The same two planes without a particle between them."""
    down = {"kind": "translation", "velocity": [0, 0, -0.5]}
    walls = {
        "floor": solid([0, 0, 0], [0, 0, 1]),
        "plate": {
            "shape": "rectangle",
            "corner": [-0.05, -0.05, 0.02],
            "sides": [[0.02, 0, 0], [0, 0.02, 0]],
            "material": "glass",
            "motion": [down],
        },
    }
    return build_scene({"ball": particle_group([[0.1, 0.0, 0.0049]])}, walls, pair=HARD, **FALL)


def check_rest(run_frames):
    assert 0.004 < last(run_frames)[0, 2] < 0.006


def narrow(width: float):
    """Four particles of 1 cm in a periodic box that is `width` wide along x and y."""
    domain = {"min": [0, 0, -0.05], "max": [width, width, 0.1], "periodic": ["x", "y"], "on_exit": "error"}
    positions = [[0.25 * width, 0.25 * width, 0.006 + 0.02 * k] for k in range(4)]
    return build_scene(
        {"ball": particle_group(positions)},
        {"floor": solid([0, 0, 0], [0, 0, 1])},
        pair=HARD,
        **(FALL | {"domain": domain}),
    )


def check_narrow(run_frames):
    """The column collapses; the minimum-image distance of each pair is at least 0.9 diameters."""
    position = last(run_frames)
    width = 0.025
    away = position[:, None] - position[None]
    away[..., :2] -= width * np.round(away[..., :2] / width)
    distance = np.sqrt((away**2).sum(axis=-1))[np.triu_indices(4, 1)]
    assert distance.min() > 0.009, distance
    assert position[:, 2].min() > 0.0045


def ratio():
    """Particles of 0.1 mm that fall on a particle of 10 cm: a radius ratio of 1000."""
    side = 1.5e-4 * np.argwhere(np.ones((5, 5, 1))) + [0.0, 0.0, 0.0502]
    groups = {
        "large": particle_group([[0.0, 0.0, 0.0]], 0.1) | {"fixed": True},
        "small": particle_group(side, 1e-4),
    }
    return build_scene(
        groups,
        pair=HARD,
        **(FALL | {"run": {"duration": 0.01, "velocity_max": 0.2}, "output": {"interval": 0.005}}),
    )


def check_ratio(run_frames):
    """No small particle overlaps the large one by more than a tenth of its radius."""
    distance = np.linalg.norm(last(run_frames)[1:], axis=1)
    assert distance.min() > 0.05 + 0.9 * 5e-5, distance.min()


def fast_motion():
    """A floor that vibrates with a period of 1 us, a tenth of the time step."""
    shake = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-9, "frequency": 1e6}
    return build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.006]])},
        {"floor": solid([0, 0, 0], [0, 0, 1]) | {"motion": [shake]}},
        pair=HARD,
        **(FALL | {"run": {"duration": 0.01, "time_step": 1e-5, "velocity_max": 1.0}}),
    )


def bullet(velocity: float, **numerics):
    """A particle of 2 mm that moves toward a thin rectangle at a distance of 5 cm."""
    plate = {
        "shape": "rectangle",
        "corner": [-0.1, -0.1, 0.0],
        "sides": [[0.2, 0, 0], [0, 0.2, 0]],
        "material": "glass",
    }
    ball = particle_group([[0.0, 0.0, 0.05]], 0.002, velocity=[0.0, 0.0, -velocity])
    return build_scene(
        {"ball": ball},
        {"plate": plate},
        pair={"restitution": 0.9, "friction": 0.0},
        numerics=numerics,
        run={"duration": 0.09 / velocity, "velocity_max": velocity / 4.0},
        output={"interval": 0.01 / velocity},
    )


def check_not_through(run_frames):
    assert all(frame["position"][:, 2].min() > -0.001 for frame in run_frames), [
        frame["position"][:, 2].min() for frame in run_frames
    ]


def speed_of_light():
    """Two particles that collide at 1e6 m/s with a time step for 1 m/s."""
    ball = particle_group([[-0.02, 0, 0], [0.02, 0, 0]], velocity=[[1e6, 0, 0], [-1e6, 0, 0]])
    return build_scene(
        {"ball": ball}, pair=HARD, run={"duration": 1e-4, "velocity_max": 1.0}, output={"interval": 1e-5}
    )


def abort_files(sandbox, finished):
    """An aborted run has finite values in all frames and no result.json."""
    for frame in frames(sandbox.path("out")):
        for name, values in frame.items():
            assert np.isfinite(values).all(), f"{name} is not finite"
    assert not sandbox.path("out/result.json").exists()


def physics() -> list[Case]:
    """Runs with checks of the particles."""
    return [
        ran(
            "corner",
            "a fast particle in the corner of planes that enclose 45 degrees",
            corner,
            "it stays inside",
            check_corner,
        ),
        ran(
            "mesh_hole",
            "a particle above a hole in a mesh and one above its triangles",
            hole,
            "one falls freely, one stays above the floor",
            check_hole,
            files={"floor.stl": floor_with_hole()},
        ),
        ran(
            "fixed_on_fixed",
            "overlapping fixed particles, and a free particle",
            fixed_on_fixed,
            "the fixed ones stay, the free one falls by g t^2 / 2",
            check_fixed,
        ),
        ran(
            "walls_cross_particle",
            "a plane that moves through another, a particle between them",
            walls_cross,
            "",
            lambda run_frames: None,
            code=3,
            patterns=("overlap",),
        ),
        ran(
            "walls_cross",
            "a rectangle that moves through a plane away from the particle",
            walls_cross_empty,
            "the particle stays at rest",
            check_rest,
            code=(0,),
        ),
        ran(
            "narrow_box",
            "a periodic box 2.5 diameters wide",
            lambda: narrow(0.025),
            "no pair overlaps by more than a tenth of the radius",
            check_narrow,
            code=0,
        ),
        ran(
            "narrower_box",
            "a periodic box of two diameters",
            lambda: narrow(0.02),
            "",
            lambda run_frames: None,
            code=2,
            patterns=("periodic|wide|images",),
        ),
        ran(
            "radius_ratio",
            "a radius ratio of 1000",
            ratio,
            "no small particle enters the large one",
            check_ratio,
        ),
        ran(
            "fast_motion",
            "a wall whose period of motion is a tenth of the time step",
            fast_motion,
            "",
            lambda run_frames: None,
            code=2,
            patterns=("period|frequency|vibration|motion",),
        ),
        ran(
            "bullet_skin",
            "a particle at 110 m/s with `skin: 3 mm` and a time step for 27 m/s, at a thin rectangle",
            lambda: bullet(110.0, skin=3e-3),
            "the particle does not pass",
            check_not_through,
            code=(0, 3),
        ),
        ran(
            "bullet",
            "a particle at 110 m/s with the default skin and a time step for 27 m/s, at a thin rectangle",
            lambda: bullet(110.0),
            "the particle does not pass",
            check_not_through,
            code=(0, 3),
        ),
        Case(
            "physics",
            "physics_abort_first",
            "a collision at 2000 km/s with a time step for 1 m/s",
            ("run beads.yaml --out out",),
            prepare=lambda s: s.write("beads.yaml", speed_of_light().to_yaml()),
            patterns=("above the limit of 0.001 m",),
        ),
        Case(
            "physics",
            "physics_inside_wall",
            "particles that begin behind a plane",
            ("run beads.yaml --out out",),
            (2, 3),
            patterns=("overlap|behind|inside",),
            verify=abort_files,
            prepare=beads(("point: [0, 0, 0], normal", "point: [0, 0, 2 cm], normal")),
        ),
        Case(
            "physics",
            "physics_same_position",
            "two particles at the same position",
            ("run beads.yaml --out out",),
            (2, 3),
            patterns=("overlap|same position|coincide",),
            verify=abort_files,
            prepare=beads(
                ("    count: 10\n", ""),
                (LATTICE, "{kind: positions, positions: [[0, 0, 1 cm], [0, 0, 1 cm]]}"),
            ),
        ),
    ]


CASES = physics()
