"""Input files from anywhere: a run keeps copies of them, from which it continues on another machine."""

import shutil

import pytest
from geometry.meshes import cube, write
from plan.scenes import TEXT
from resume.runs import balls, files_of

import granflow as gf
from granflow.cli.main import main
from granflow.load import copied_scene, load_scene, scene_of
from granflow.runs.run_directory import RunDirectory

pytestmark = pytest.mark.usefixtures("taichi_f64")
INSERT = TEXT[TEXT.index("    count: 10\n") : TEXT.index("\ndomain:")]
LID = """\
  lid:
    {shape: plane, point: [0, 0, 0.03], normal: [0, 0, -1], material: glass,
     motion: {kind: table, file: ../tables/lift.csv, direction: [0, 0, 1]}}
particles:
"""
ROWS = "x,y,z,r\n" + "".join(
    f"{0.005 + 0.01 * k},{0.004 + 0.01 * j},0.0025,0.002\n" for k in range(2) for j in range(2)
)


@pytest.fixture
def scene(tmp_path):
    """A scene with a table and particles from outside of its own folder."""
    for name in ("scenes", "tables", "filled"):
        (tmp_path / "here" / name).mkdir(parents=True)
    (tmp_path / "here" / "tables" / "lift.csv").write_text("time [ms],displacement [mm]\n0,0\n20,-1\n")
    (tmp_path / "here" / "filled" / "beads.csv").write_text(ROWS)
    text = TEXT.replace(INSERT, "    insert: {kind: file, file: ../filled/beads.csv}")
    text = text.replace("particles:\n", LID).replace("duration: 50 ms", "duration: 4 ms")
    path = tmp_path / "here" / "scenes" / "beads.yaml"
    path.write_text(text.replace("interval: 10 ms", "interval: 1 ms"))
    return path


def test_run_continues_from_copies_of_input_files_outside_the_scene_folder(scene, tmp_path):
    whole, out, there = tmp_path / "whole", tmp_path / "here" / "out", tmp_path / "there"
    assert main(["run", str(scene), "--out", str(whole), "--threads", "2"]) == 0
    assert main(["run", str(scene), "--out", str(out), "--until", "2 ms", "--threads", "2"]) == 0
    shutil.move(out, there)
    shutil.rmtree(tmp_path / "here")
    written = load_scene(there / "scene_as_run.yaml")
    assert [name for _, name in written.input_names()] == ["inputs/lift.csv", "inputs/beads.csv"]
    assert copied_scene(written) is written
    assert main(["resume", str(there), "--threads", "2"]) == 0
    assert files_of(there) == files_of(whole)


def test_sieve_curve_is_copied_and_kept_without_its_file(tmp_path):
    (tmp_path / "sieves.csv").write_text("opening [mm],passing [%]\n3,0\n4,40\n5,100\n")
    (tmp_path / "scenes").mkdir()
    path = tmp_path / "scenes" / "sieved.yaml"
    path.write_text(TEXT)
    scene = load_scene(path, ["particles.beads.diameter={distribution: sieve, file: ../sieves.csv}"])
    written = copied_scene(scene)
    assert [name for _, name in written.input_names()] == ["inputs/sieves.csv"]
    elsewhere = scene_of(written.to_yaml(), str(tmp_path / "there" / "scene.yaml"))
    assert elsewhere.particles["beads"].size_spans() == [(0.003, 0.005)]


def test_copies_of_equal_names_are_numbered_and_links_are_followed(scene, tmp_path):
    """Three meshes box.stl: an absolute path, a link in the folder of the scene, and a relative path."""
    files = {"parts/box.stl": 1.0, "linked.stl": 1.01, "other/box.stl": 1.02}
    for name, height in files.items():
        points, corners = cube()
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write(tmp_path / name, points * [1.0, 1.0, height], corners)
    (scene.parent / "box.stl").symlink_to(tmp_path / "linked.stl")
    given = (str(tmp_path / "parts" / "box.stl"), "box.stl", "../../other/box.stl")
    meshes = [f"walls.w{k}={{shape: mesh, file: {name}, material: glass}}" for k, name in enumerate(given)]
    out = tmp_path / "out"
    directory = RunDirectory(out, load_scene(scene, meshes), None)
    directory.create()
    with directory.open([]):
        copies = ("inputs/box.stl", "box.stl", "inputs/box_2.stl")
        for copy, original in zip(copies, files, strict=True):
            assert (out / copy).read_bytes() == (tmp_path / original).read_bytes()
            assert not (out / copy).is_symlink()


def test_copies_of_results_of_another_run_keep_clear_of_those_of_the_run(tmp_path):
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
