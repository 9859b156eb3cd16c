"""Input files from anywhere: a run keeps copies of them, from which it continues on another machine."""

import shutil

from geometry.meshes import cube, write
from plan.scenes import TEXT
from resume.runs import balls, files_of

import granflow as gf
from granflow.cli.main import main
from granflow.load import copied_scene, load_scene

INSERT = TEXT[TEXT.index("    count: 10\n") : TEXT.index("\ndomain:")]
FLOOR = "  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}"
WALLS = """\
  first: {shape: mesh, file: PARTS/box.stl, scale: 0.02, translate: [0, 0, -0.02], material: glass}
  second: {shape: mesh, file: box.stl, scale: 0.02, translate: [0.02, 0, -0.02], material: glass}
  lid:
    {shape: plane, point: [0, 0, 0.03], normal: [0, 0, -1], material: glass,
     motion: {kind: table, file: ../tables/lift.csv, direction: [0, 0, 1]}}"""
ROWS = "x,y,z,r\n" + "".join(
    f"{0.005 + 0.01 * k},{0.004 + 0.01 * j},0.0025,0.002\n" for k in range(2) for j in range(2)
)


def scene_with_inputs(folder):
    """A scene with two meshes of equal name, a table and particles, of which only a link is in its own
    folder."""
    for name in ("scenes", "parts", "tables", "filled"):
        (folder / name).mkdir(parents=True)
    for k, name in enumerate(("parts/box.stl", "parts/linked.stl")):
        points, corners = cube()
        write(folder / name, points * [1.0, 1.0, 1.0 + 0.01 * k], corners)
    (folder / "scenes" / "box.stl").symlink_to(folder / "parts" / "linked.stl")
    (folder / "tables" / "lift.csv").write_text("time [ms],displacement [mm]\n0,0\n20,-1\n")
    (folder / "filled" / "beads.csv").write_text(ROWS)
    text = TEXT.replace(INSERT, "    insert: {kind: file, file: ../filled/beads.csv}").replace(FLOOR, WALLS)
    text = text.replace("PARTS", str(folder / "parts")).replace("duration: 50 ms", "duration: 4 ms")
    path = folder / "scenes" / "beads.yaml"
    path.write_text(text.replace("interval: 10 ms", "interval: 1 ms"))
    return path


def test_run_continues_from_copies_of_input_files_outside_the_scene_folder(taichi_f64, tmp_path):
    scene = scene_with_inputs(tmp_path / "here")
    whole = tmp_path / "whole"
    out = tmp_path / "here" / "out"
    assert main(["run", str(scene), "--out", str(whole), "--threads", "2"]) == 0
    assert main(["run", str(scene), "--out", str(out), "--until", "2 ms", "--threads", "2"]) == 0
    meshes = {path.name: path.read_bytes() for path in (tmp_path / "here").glob("*/*.stl")}
    assert (out / "box.stl").read_bytes() == meshes["linked.stl"] and not (out / "box.stl").is_symlink()
    there = tmp_path / "there"
    shutil.move(out, there)
    shutil.rmtree(tmp_path / "here")
    written = load_scene(there / "scene_as_run.yaml")
    names = [name for _, name in written.input_names()]
    assert names == ["inputs/box.stl", "box.stl", "inputs/lift.csv", "inputs/beads.csv"]
    assert copied_scene(written) is written
    assert main(["resume", str(there), "--threads", "2"]) == 0
    assert files_of(there) == files_of(whole)


def test_copies_of_equal_names_are_numbered(tmp_path):
    """The third mesh has an equal name, too; its copy must not replace the first."""
    path = scene_with_inputs(tmp_path / "here")
    (tmp_path / "other").mkdir()
    shutil.copy(tmp_path / "here" / "parts" / "linked.stl", tmp_path / "other" / "box.stl")
    third = "{shape: mesh, file: OTHER/box.stl, scale: 0.02, material: glass}"
    scene = load_scene(path, [f"walls.third={third}".replace("OTHER", str(tmp_path / "other"))])
    names = [name for _, name in copied_scene(scene).input_names()]
    assert names[:2] == ["inputs/box.stl", "box.stl"] and "inputs/box_2.stl" in names


def test_copies_of_results_of_another_run_keep_clear_of_those_of_the_run(taichi_f64, tmp_path):
    """A frame of an earlier run, under its own name, through a link and through a folder."""
    first = tmp_path / "filled"
    with gf.Simulation(balls(), out=first) as simulation:
        simulation.step(1)
    (tmp_path / "particles_0000.vtu").symlink_to(first / "particles_0000.vtu")
    path = tmp_path / "next.yaml"
    path.write_text(TEXT.replace(INSERT, "    insert: {kind: file, file: particles_0000.vtu}"))
    for given in ("particles_0000.vtu", "filled/../particles_0000.vtu", str(first / "particles_0000.vtu")):
        scene = load_scene(path, [f"particles.beads.insert.file={given}"])
        assert [name for _, name in copied_scene(scene).input_names()] == ["inputs/particles_0000.vtu"]
        assert scene.particles["beads"].count == 4
