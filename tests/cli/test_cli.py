"""Arguments, exit codes, messages and tables of the command line; the functions behind it are replaced by
stubs."""

import json
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

import granflow.load
from granflow.cli.main import build_parser, main
from granflow.cli.run import prepare_output
from granflow.cli.studies import show_comparison
from granflow.errors import GranflowError, RunError, SceneError
from granflow.load import Scene
from granflow.runs.interrupts import Terminated
from granflow.runs.result import Result
from granflow.runs.run_directory import RESULT_FILES
from granflow.scene.blocks.insertions import FileInsertion
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.walls.mesh import MeshWall


@pytest.fixture
def stubs(monkeypatch, tmp_path):
    """Stubs of scene, simulation and collision that record their arguments; in an empty directory."""
    calls = types.SimpleNamespace(raises=None)

    class Simulation:
        time, is_complete = 0.25, False
        files = types.SimpleNamespace(checkpoint_time=0.25)

        def __init__(self, scene, **options):
            calls.simulation = options
            self.plan = types.SimpleNamespace()
            self.warnings = []

        def request_stop(self, error):
            raise error

        def close(self):
            return None

        def run(self, until=None, within_stages=False):
            calls.until = until
            if calls.raises:
                raise calls.raises
            return Result({"time_step": 1.25e-6}, {"forces": 3.0}, {"particle_count": 2.0})

    def load(path, overrides=()):
        calls.overrides = overrides
        if isinstance(calls.raises, SceneError):
            raise calls.raises
        return types.SimpleNamespace(
            refuse_program=lambda: None,
            **vars(empty_scene()) | dict(path=Path(path), title="Two [spheres]", expect=("one",)),
        )

    def collide(**options):
        calls.collide = options
        return {"restitution_asked": 0.7, "restitution": 0.70001, "duration": 4e-5, "duration_theory": 4.1e-5}

    monkeypatch.setattr(granflow.load, "load_scene", load)
    monkeypatch.setitem(sys.modules, "granflow.simulation", types.SimpleNamespace(Simulation=Simulation))
    monkeypatch.setattr(granflow.cli.run, "restitution_warnings", lambda plan: [])
    monkeypatch.setitem(sys.modules, "granflow.studies.collide", types.SimpleNamespace(collide=collide))
    monkeypatch.chdir(tmp_path)
    return calls


# ---------------------------------------------------------------- arguments


def test_module_and_command_are_equivalent():
    process = subprocess.run([sys.executable, "-m", "granflow", "--version"], capture_output=True, text=True)
    assert process.returncode == 0
    assert re.fullmatch(r"granflow \S+ \((taichi|quadrants) [\d.]+\)\n", process.stdout)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "required: COMMAND"),
        (["bake"], "invalid choice: 'bake'"),
        (["run"], "required: SCENE"),
        (["run", "a.yaml", "--threads", "0"], "0 is not a number of threads"),
        (["run", "a.yaml", "--until", "4 mm"], "argument --until: 4 mm: "),
        (["run", "a.yaml", "--until", "nan"], "nan is not finite"),
        (["run", "a.yaml", "--until=-1 s"], "argument --until: -1 s is negative"),
        (["run", "a.yaml", "--arch", "abacus"], "invalid choice: 'abacus'"),
        (["collide", "--material", "glass", "--diameter", "1 mm"], "required: --velocity"),
        (["collide", "--wall", "--diameter2", "1mm"], "not allowed with argument --wall"),
    ],
)
def test_invalid_arguments_are_rejected(arguments, message, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    assert exit_.value.code == 2
    assert message in capsys.readouterr().err


def test_arguments_accept_units():
    collide = "collide --material glass --diameter 25.4mm --velocity 0.5 --diameter2".split()
    options = build_parser().parse_args([*collide, "1 cm"])
    assert (options.diameter, options.velocity, options.diameter2) == (0.0254, 0.5, 0.01)
    assert build_parser().parse_args(["run", "a.yaml", "--until", "20 ms"]).until == 0.02


# ---------------------------------------------------------------- running


def test_run_passes_arguments_to_the_simulation(stubs, capsys):
    arguments = (
        "run a.yaml --set x.y=1 --set z=2 --arch cuda --precision f32 --threads 2 --until 1 --out here"
    )
    assert main(arguments.split()) == 0
    assert stubs.overrides == ["x.y=1", "z=2", "run.precision=f32"]
    given = {"arch": "cuda", "threads": 2, "out": Path("here"), "progress": True}
    unset = dict.fromkeys(("allow_long", "overwrite", "allow_changes"), False)
    assert stubs.simulation == given | unset | {"communicator": None, "resume": None}
    assert stubs.until == 1.0
    main(["run", "scenes/hopper.yaml"])
    assert stubs.simulation["out"] == Path("out/hopper") and stubs.simulation["threads"] is None
    output = capsys.readouterr().out
    assert "Two [spheres]" in output and "particle count" in output and "1.25e-06" in output


OUT = Path("out", "a")
STOPPED = (
    f"granflow: stopped at 0.25 s; granflow resume {OUT} continues. {OUT} contains the run up to this time.\n"
)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (GranflowError("There is no CUDA here."), 2, "granflow: There is no CUDA here.\n"),
        (RunError("Particle 7 left at 0.1 s."), 3, "granflow: Particle 7 left at 0.1 s.\n"),
        (KeyboardInterrupt(), 130, STOPPED),
        (Terminated(), 143, STOPPED),
        (PermissionError(13, "Permission denied", "out"), 2, "granflow: out: Permission denied.\n"),
        (FileExistsError(17, "File exists", "out"), 2, "granflow: out: this is a file, but a directory is needed;"),
        (SceneError(["a.yaml:1:1: A.", "a.yaml:2:1: B."]), 2, "a.yaml:1:1: A.\na.yaml:2:1: B.\n2 problems found.\n"),
        (SceneError("a.yaml:1:1: A."), 2, "a.yaml:1:1: A.\n1 problem found.\n"),
    ],
)  # fmt: skip
def test_errors_are_printed_without_traceback_and_faults_with_it(stubs, capsys, error, code, message):
    stubs.raises = error
    assert main(["run", "a.yaml"]) == code
    assert capsys.readouterr().err.startswith(message)
    stubs.raises = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        main(["run", "a.yaml"])


# ---------------------------------------------------------------- earlier runs


@pytest.mark.parametrize("pattern", RESULT_FILES)
def test_every_result_file_identifies_an_earlier_run(tmp_path, pattern):
    prepare_output(tmp_path, empty_scene(), overwrite=False)
    path = tmp_path / pattern.replace("*", "0003")
    path.parent.mkdir(exist_ok=True)
    path.touch()
    with pytest.raises(GranflowError, match="--overwrite"):
        prepare_output(tmp_path, empty_scene(), overwrite=False)


def empty_scene(folder=".", start_from=None, walls=(), particles=()):
    """The attributes of a scene that `prepare_output` reads."""
    scene = types.SimpleNamespace(
        folder=Path(folder), start_from=start_from, walls=dict(walls), particles=dict(particles)
    )
    scene.input_names = lambda: Scene.input_names(scene)
    return scene


@pytest.mark.parametrize("inside", ["start_from", "walls.bowl.file", "particles.beads.insert.file"])
def test_input_files_in_the_output_directory_are_rejected(tmp_path, inside):
    """Also through a symbolic link; inputs in another directory are accepted."""
    out = tmp_path / "out"
    out.mkdir()
    for name in ("timeseries.csv", "bowl.stl", "particles_0007.vtu"):
        (out / name).touch()
    (tmp_path / "link").symlink_to(out)
    bowl = MeshWall.model_construct(shape="mesh", file="link/bowl.stl")
    insertion = FileInsertion.model_construct(kind="file", file="link/particles_0007.vtu")
    beads = Group.model_construct(material="glass", insert=insertion)
    scene_with_input = {
        "start_from": empty_scene(start_from=str(tmp_path / "link")),
        "walls.bowl.file": empty_scene(tmp_path, walls={"bowl": bowl}),
        "particles.beads.insert.file": empty_scene(tmp_path, particles={"beads": beads}),
    }[inside]
    with pytest.raises(GranflowError, match=rf"^{inside} is .*, which is in the output directory .*--out\.$"):
        prepare_output(out, scene_with_input, overwrite=True)
    prepare_output(out, empty_scene(tmp_path, start_from=str(tmp_path / "other")), overwrite=True)


# ---------------------------------------------------------------- collide


def test_collide_passes_arguments_and_prints_json(stubs, capsys):
    options = "--diameter 4mm --velocity 1 --wall --restitution 0.7 --set damping_ratio=0 --json"
    assert main(["collide", "--material", "glass", *options.split()]) == 0
    assert json.loads(capsys.readouterr().out)["duration_theory"] == 4.1e-5
    given = {"material": "glass", "diameter": 0.004, "velocity": 1.0, "wall": True, "restitution": 0.7}
    assert stubs.collide.items() >= given.items() and stubs.collide["settings"] == ["damping_ratio=0"]


def test_collide_prints_a_table(capsys):
    show_comparison({"restitution_asked": 0.7, "restitution": 0.71, "time_step": 1e-6, "duration": 4e-5})
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["restitution", "0.71", "0.7"] in rows
    assert ["time", "step", "1e-06", "s"] in rows


def test_an_error_while_options_are_read_is_one_sentence(monkeypatch, capsys):
    """As of an invalid GRANFLOW_KERNELS, which `--version` reads."""

    def refuse(_):
        raise GranflowError("GRANFLOW_KERNELS is foo.")

    monkeypatch.setattr("granflow.io.log.version_of", refuse)
    assert main(["--version"]) == 2
    assert capsys.readouterr().err == "granflow: GRANFLOW_KERNELS is foo.\n"
