"""SIGINT and SIGTERM end the packing, the compilation, and an import of a run within one second.

`resume` sends signals to the steps of a run.
"""

import os
import signal
import subprocess
import sys
import time

import pytest
from plan.scenes import TEXT
from subprocess_runner import restore_interrupts

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

LIMIT = 1.0
"""Seconds from the signal to the end of the process."""
COMPILING, PACKING = 10, 900_000
"""Numbers of particles with which compilation, or packing, takes several seconds."""


@pytest.mark.slow  # needs idle cores
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("count", "delay"), [(COMPILING, 0.3), (COMPILING, 1.0), (PACKING, 2.0)])
def test_signal_before_the_first_step_ends_the_run(tmp_path, number, count, delay):
    """With an empty cache, compilation begins when the output directory appears."""
    text = TEXT.replace("count: 10", f"count: {count}").replace(
        "max: [2 cm, 2 cm, 1 cm]", "max: [40 cm, 40 cm, 40 cm]"
    )
    (tmp_path / "beads.yaml").write_text(text.replace("max: [3 cm, 3 cm, 3 cm]", "max: [1, 1, 1]"))
    running = subprocess.Popen(
        [sys.executable, "-m", "granflow", "run", "beads.yaml", "--out", "out"], cwd=tmp_path, text=True,
        env=os.environ | {"GRANFLOW_CACHE": str(tmp_path / "cache")}, preexec_fn=restore_interrupts,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    while count == COMPILING and not (tmp_path / "out").exists() and running.poll() is None:
        time.sleep(0.01)
    time.sleep(delay)
    assert running.poll() is None, running.stderr.read()
    began = time.monotonic()
    running.send_signal(number)
    _, message = running.communicate(timeout=60)
    assert time.monotonic() - began < LIMIT
    assert running.returncode in (128 + number, -number)
    assert "Traceback" not in message


LIBRARY = """\
import signal
try:
    signal.raise_signal(signal.SIGTERM)
except BaseException as error:
    raise ImportError("the library cannot be loaded") from error
"""
"""A module that reports any exception of its import as an error of its own, as compiled ones do."""


def test_signal_during_an_import_ends_the_process(tmp_path, pytestconfig):
    (tmp_path / "library.py").write_text(LIBRARY)
    program = "from granflow.cli.process import stop_signals\nwith stop_signals():\n    import library"
    path = os.pathsep.join([str(pytestconfig.rootpath), str(tmp_path)])
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path},
        preexec_fn=restore_interrupts, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")
