"""Functions of test modules run in a Python of their own: for other precisions, other thread counts, second runs."""

import inspect
import json
import subprocess
import sys

PROGRAM = """
import importlib.util, json, sys
paths, file, name, arguments = json.loads(sys.argv[1])
sys.path[:] = paths
spec = importlib.util.spec_from_file_location("in_child", file)
module = importlib.util.module_from_spec(spec)
sys.modules["in_child"] = module
spec.loader.exec_module(module)
answer = getattr(module, name)(*arguments)
print()
print(json.dumps(answer))
"""


def in_subprocess(function, *arguments, seconds=200):
    """What a module-level function returns in a fresh process; arguments and answer are what JSON can say.

    Raises RuntimeError with the end of the child's stderr where it fails.
    """
    order = json.dumps([sys.path, inspect.getfile(function), function.__name__, arguments])
    done = subprocess.run([sys.executable, "-c", PROGRAM, order], capture_output=True, text=True, timeout=seconds)
    if done.returncode:
        raise RuntimeError(f"{function.__name__} failed in its own process:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])
