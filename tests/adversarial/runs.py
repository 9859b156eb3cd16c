"""The run that faults are applied to, and its undisturbed reference."""

import functools
import signal
import subprocess
import tempfile
from pathlib import Path

from resume.faults import SCENE, assert_complete, wait_for

from adversarial.case import Case
from adversarial.sandbox import FinishedProcess, Sandbox


@functools.cache
def reference() -> Path:
    """Output of the undisturbed run of SCENE, computed once."""
    folder = Path(tempfile.mkdtemp(prefix="granflow-reference-"))
    (folder / "home").mkdir()
    sandbox = Sandbox(folder / "home")
    sandbox.write("beads.yaml", SCENE)
    finished = sandbox.run("run beads.yaml --out out")
    assert finished.code == 0, finished.err
    return folder / "home" / "out"


def write_scene(sandbox: Sandbox) -> None:
    """Writes the scene of 40 particles that fall on a vibrating floor, 20 frames."""
    sandbox.write("beads.yaml", SCENE)


def assert_undisturbed(sandbox: Sandbox, finished: FinishedProcess | None = None) -> None:
    """Asserts that the files of the run equal those of the undisturbed run bitwise."""
    assert_complete(sandbox.path("out"), reference())


IDENTICAL = "every file equals that of an undisturbed run"


def partial_run(sandbox: Sandbox, frame: int = 9, **options) -> subprocess.Popen:
    """Starts a run and waits until it has written the given frame."""
    running = sandbox.start("run beads.yaml --out out", **options)
    wait_for(sandbox.path(f"out/particles_{frame:04d}.vtu"), running)
    return running


def killed_run(sandbox: Sandbox) -> Path:
    """Output directory of a run killed by SIGKILL after half of its frames."""
    running = partial_run(sandbox)
    running.send_signal(signal.SIGKILL)
    sandbox.finish(running)
    return sandbox.path("out")


def case(group: str, name: str, text: str, act=None, code=0, patterns=(), **more) -> Case:
    return Case(group, name, text, act=act, code=code, patterns=patterns, **({"prepare": write_scene} | more))
