"""Plugin of pytest that records which test executes which lines and device functions of granflow.

    pip install coverage
    GRANFLOW_EXECUTED=FOLDER python -m pytest -n 2 -p executed_lines
    python tools/mutations.py run mutations.json results.jsonl --executed FOLDER -x

Python lines are those of coverage.py with the test as its context. Coverage does not see the functions of
kernels, because Taichi reads their source: here they are those that a kernel inlines when it is compiled, for
each test that launches the kernel. Each process writes one file; what subprocesses execute is not recorded.
"""

import json
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = Path(os.environ.get("GRANFLOW_EXECUTED", "executed"))


def inlined_functions(kernels: dict[int, set[str]]) -> dict[str, set[int]]:
    """Note the functions of each kernel in `kernels`, by its id; returns the ids of the kernels that each test
    launches."""
    from taichi.lang import kernel_impl

    launched: dict[str, set[int]] = defaultdict(set)
    call, materialize, launch = (
        kernel_impl.Func.__call__, kernel_impl.Kernel.materialize, kernel_impl.Kernel.launch_kernel
    )  # fmt: skip
    compiled: list[set[str]] = []
    kept = []  # a freed kernel would give its id to another one

    def noted_call(self: Any, *arguments: Any, **keys: Any) -> Any:
        if compiled:
            compiled[-1].add(place(self.func))
        return call(self, *arguments, **keys)

    def noted_materialize(self: Any, *arguments: Any, **keys: Any) -> Any:
        if id(self) not in kernels:
            kept.append(self)
            kernels[id(self)] = {place(self.func)}
        compiled.append(kernels[id(self)])
        try:
            return materialize(self, *arguments, **keys)
        finally:
            compiled.pop()

    def noted_launch(self: Any, *arguments: Any, **keys: Any) -> Any:
        launched[Recorder.test].add(id(self))
        return launch(self, *arguments, **keys)

    kernel_impl.Func.__call__, kernel_impl.Kernel.materialize, kernel_impl.Kernel.launch_kernel = (
        noted_call, noted_materialize, noted_launch
    )  # fmt: skip
    return launched


def place(function: Any) -> str:
    """File and first line of a function, with its decorators."""
    code = function.__code__
    return f"{code.co_filename.removeprefix(f'{ROOT}{os.sep}')}:{code.co_firstlineno}"


class Recorder:
    """Records what the tests of one process execute."""

    test = ""
    """Id of the running test; empty while modules are imported."""

    def __init__(self) -> None:
        self._coverage = coverage.Coverage(data_file=None, source=[str(ROOT / "granflow")], config_file=False)
        self._coverage.start()
        self._kernels: dict[int, set[str]] = {}
        self._launched = inlined_functions(self._kernels)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """See pytest."""
        Recorder.test = item.nodeid
        self._coverage.switch_context(item.nodeid)
        return (yield)

    def pytest_sessionfinish(self) -> None:
        """Write the tests of each line and of each device function."""
        self._coverage.stop()
        data = self._coverage.get_data()
        found: dict[str, list[str]] = {}
        for path in data.measured_files():
            name = Path(path).relative_to(ROOT).as_posix()
            found |= {f"{name}:{line}": tests for line, tests in data.contexts_by_lineno(path).items()}
        functions = defaultdict(set)
        for test, kernels in self._launched.items():
            for function in set().union(*(self._kernels.get(each, set()) for each in kernels)):
                functions[function].add(test)
        everything = {"lines": found, "functions": {key: sorted(tests) for key, tests in functions.items()}}
        FOLDER.mkdir(parents=True, exist_ok=True)
        (FOLDER / f"{os.getpid()}.json").write_text(json.dumps(everything), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Start in each process that runs tests."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        config.pluginmanager.register(Recorder())
