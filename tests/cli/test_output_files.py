"""Output files of commands: types, inputs that must not be replaced, links, and files that messages name."""

import errno
import os
import re
import time

import pytest
from scene_builders import build_scene, particle_group

import granflow as gf
from granflow.cli.main import main
from granflow.io.files import replacing
from granflow.io.tables import RowFile


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Directory of a short run of one ball, whose position is in a table with an unusual name."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "table.html").write_text("x,y,z,diameter\n0,0,0,0.01\n")
    scene = build_scene({"ball": particle_group([[0, 0, 0]])}, run={"duration": 1e-4, "velocity_max": 1.0})
    scene = scene.model_dump(exclude_none=True, by_alias=True)
    scene["particles"]["ball"] = {"material": "glass", "insert": {"kind": "file", "file": "table.html"}}
    with gf.Simulation(gf.Scene.from_dict(scene, folder), threads=2, out=folder / "run") as simulation:
        simulation.run()
    return folder / "run"


@pytest.mark.parametrize("verb", ["report", "render", "plot"])
@pytest.mark.parametrize(
    "name", ["scene_as_run.yaml", "timeseries.csv", "particles_0000.vtu", "run.log", "other"]
)
def test_files_of_other_types_are_not_replaced(taichi_f64, run, capsys, verb, name):
    target = run / name
    before = target.read_bytes() if target.exists() else None
    assert (
        main([verb, str(run), "--out", str(target), *(["--y", "particle_count"] if verb == "plot" else [])])
        == 2
    )
    assert f"--out {target} is not of a supported type; the name must end in ." in capsys.readouterr().err
    assert (target.read_bytes() if target.exists() else None) == before


def test_input_of_the_run_and_directories_are_not_replaced(taichi_f64, run, capsys):
    table = run / "table.html"
    before = table.read_text()
    assert main(["report", str(run), "--out", str(table), "--no-pictures"]) == 2
    assert "is particles.ball.insert.file of the run, which must not be replaced" in capsys.readouterr().err
    assert table.read_text() == before
    assert main(["report", str(run), "--out", str(run.parent)]) == 2
    assert capsys.readouterr().err.startswith(f"granflow: --out {run.parent} is a directory; give a file")


@pytest.mark.parametrize("ending", ["png", "svg", "pdf", "html"])
@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_a_plot_replaces_a_link(tmp_path, ending, link):
    """A figure or a page does not change the file to which an existing link leads, such as the time
    series."""
    pytest.importorskip("plotly" if ending == "html" else "matplotlib")
    series = tmp_path / "timeseries.csv"
    out = tmp_path / f"curve.{ending}"
    series.write_text("time [s],mass [kg]\n0,1\n1,2\n")
    link(series, out)
    assert main(["plot", str(series), "--y", "mass", "--out", str(out)]) == 0
    assert series.read_text() == "time [s],mass [kg]\n0,1\n1,2\n"
    assert not out.is_symlink() and out.stat().st_size > 1000
    assert sorted(tmp_path.iterdir()) == sorted([series, out])


def test_dangling_link_is_named(tmp_path, capsys):
    (tmp_path / "out").symlink_to(tmp_path / "nowhere")
    scene = build_scene({"ball": particle_group([[0, 0, 0]])}, run={"duration": 1e-4, "velocity_max": 1.0})
    scene.save(tmp_path / "scene.yaml")
    assert main(["run", str(tmp_path / "scene.yaml"), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert f"{tmp_path / 'out'}: this is a link to {tmp_path / 'nowhere'}, which does not exist" in message


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device without space")
def test_full_disk_names_the_file(tmp_path):
    with pytest.raises(OSError, match="No space left") as failed, replacing(tmp_path / "frame.vtu"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert failed.value.filename == str(tmp_path / "frame.vtu")
    with (
        pytest.raises(OSError, match="No such file") as failed,
        replacing(tmp_path / "none" / "a.html") as temporary,
    ):
        temporary.write_text("")
    assert failed.value.filename == str(tmp_path / "none" / "a.html"), "not the hidden file"


def test_rows_replace_links(tmp_path):
    """A resumed run shortens and extends a copy; the file outside, or a backup of hard links, stays as it
    is."""
    saved = None
    for name in ("symbolic", "hard"):
        outside = tmp_path / f"outside_{name}.csv"
        inside = tmp_path / f"{name}.csv"
        rows = RowFile(inside)
        rows.write(["a"])
        saved = rows.state_dict()
        rows.write(["b"])
        rows.close()
        os.rename(inside, outside)
        inside.symlink_to(outside) if name == "symbolic" else os.link(outside, inside)
        resumed = RowFile(inside)
        resumed.load_state_dict(saved)
        assert resumed.is_intact
        resumed.truncate()
        resumed.write(["c"])
        resumed.close()
        assert outside.read_text().split() == ["a", "b"]
        assert inside.read_text().split() == ["a", "c"]
        assert not inside.is_symlink()


def test_log_of_a_resumed_run_replaces_a_link(taichi_f64, run, tmp_path):
    for path in run.iterdir():
        os.link(path, tmp_path / path.name)
    outside = tmp_path / "outside"
    outside.mkdir()
    os.rename(tmp_path / "run.log", outside / "run.log")
    (tmp_path / "run.log").symlink_to(outside / "run.log")
    before = {path: path.read_bytes() for path in [*run.iterdir(), outside / "run.log"]}
    with gf.Simulation(gf.read_run(tmp_path).scene, threads=2, out=tmp_path, resume=tmp_path) as simulation:
        simulation.run(duration=1e-4)
    assert {path: path.read_bytes() for path in before} == before
    assert "resumed from" in (tmp_path / "run.log").read_text()


def test_run_completes_while_the_clock_stands_still(taichi_f64, run, tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as still:
        for name in ("perf_counter", "monotonic"):
            still.setattr(time, name, lambda: 0.0)
        still.setattr(time, "time", lambda: 1e9)
        arguments = ["run", str(run / "scene_as_run.yaml"), "--out", str(tmp_path / "out"), "--threads", "2"]
        assert main(arguments) == 0
    assert re.search(r"step count\s.*\d", capsys.readouterr().out)
