"""Runs functions of test modules in a separate Python process: other precisions, other thread counts, second
runs."""

import inspect
import json
import signal
import subprocess
import sys

PROGRAM = """
import importlib.util, json, sys
paths, file, name, calls = json.loads(sys.argv[1])
sys.path[:] = paths
spec = importlib.util.spec_from_file_location("in_subprocess", file)
module = importlib.util.module_from_spec(spec)
sys.modules["in_subprocess"] = module
spec.loader.exec_module(module)
results = [getattr(module, name)(*arguments) for arguments in calls]
print()
print(json.dumps(results))
"""


def in_subprocess(function, *arguments, seconds=200):
    """The result of a module-level function in a new process; arguments and result must be JSON values.

    Raises RuntimeError with the end of the subprocess's stderr if the function fails.
    """
    return each_in_subprocess(function, [arguments], seconds)[0]


def each_in_subprocess(function, calls, seconds=200):
    """The results of a function for each tuple of arguments, one after the other in one process; see
    in_subprocess.

    Runs with other numbers of threads or precisions restart Taichi; the process saves their imports.
    """
    call = json.dumps([sys.path, inspect.getfile(function), function.__name__, calls])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, call], capture_output=True, text=True, timeout=seconds
    )
    if done.returncode:
        raise RuntimeError(f"{function.__name__} failed in a subprocess:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def restore_interrupts():
    """A `preexec_fn`: background processes of a shell ignore SIGINT, those of nohup SIGHUP, and a run
    inherits that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
