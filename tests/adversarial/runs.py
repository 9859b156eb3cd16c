"""The run that faults are applied to, and its undisturbed reference."""

import functools
import signal
import subprocess
import tempfile
from pathlib import Path

from adversarial.case import Case
from adversarial.sandbox import Done, Sandbox
from resume.faults import SCENE, assert_complete, wait_for


@functools.cache
def reference() -> Path:
    """The run of SCENE that no fault disturbs, kept for all cases."""
    folder = Path(tempfile.mkdtemp(prefix="granflow-reference-"))
    (folder / "home").mkdir()
    sandbox = Sandbox(folder / "home")
    sandbox.write("beads.yaml", SCENE)
    done = sandbox.run("run beads.yaml --out out")
    assert done.code == 0, done.err
    return folder / "home" / "out"


def rain(sandbox: Sandbox) -> None:
    """The scene of 40 particles that fall on a vibrating floor, 20 frames."""
    sandbox.write("beads.yaml", SCENE)


def as_undisturbed(sandbox: Sandbox, done: Done | None = None) -> None:
    """The files of the run are bit for bit those of the undisturbed one."""
    assert_complete(sandbox.path("out"), reference())


SAME = "every file equals that of an undisturbed run"


def half_way(sandbox: Sandbox, frame: int = 9, **options) -> subprocess.Popen:
    """A run that has written some of its frames."""
    running = sandbox.start("run beads.yaml --out out", **options)
    wait_for(sandbox.path(f"out/particles_{frame:04d}.vtu"), running)
    return running


def stopped(sandbox: Sandbox) -> Path:
    """A run killed by SIGKILL after half of its frames."""
    running = half_way(sandbox)
    running.send_signal(signal.SIGKILL)
    sandbox.finish(running)
    return sandbox.path("out")


def case(group: str, name: str, text: str, act=None, code=0, says=(), **more) -> Case:
    return Case(group, name, text, act=act, code=code, says=says, **({"prepare": rain} | more))
