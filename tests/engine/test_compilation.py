"""The first launch of each kernel runs in the context for compilation; the pool of threads is measured when needed."""

from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from granflow.engine import compilation
from granflow.engine.threads import workers


class Kernel:
    """Stands for a kernel; its id is used again after it is deleted."""


def test_each_kernel_is_compiled_once_in_the_context_also_if_an_id_is_used_again(monkeypatch):
    entered = []

    @contextmanager
    def around():
        entered.append(True)
        yield

    monkeypatch.setattr(compilation, "around", around)
    compile_kernel = compilation.guarded(lambda program, configuration, capabilities, kernel: None)
    for count in (1, 2, 3):
        kernel = Kernel()
        for _ in range(2):
            compile_kernel(None, None, None, kernel)
        assert len(entered) == count
        del kernel


def test_the_pool_is_measured_once_per_process_and_only_for_several_workers(monkeypatch):
    measured: list[Any] = []

    def measure(state):
        measured.append(state)
        return workers.ThreadPool(affinity=None, seconds_per_poll=1e-6)

    def prepared(particle_count, worker_count):
        state = SimpleNamespace(
            count=particle_count,
            backend=SimpleNamespace(worker_count=worker_count),
            control=SimpleNamespace(patience=[0, 0]),
        )
        workers.Workers(state).prepare()
        return state.control.patience

    monkeypatch.setattr(workers, "_pool", None)
    monkeypatch.setattr(workers, "_measure_pool", measure)
    several = workers.SINGLE_WORKER_PARTICLES + 1
    assert prepared(several - 1, 2) == prepared(several, 1) == [0, 0]
    assert not measured
    assert all(prepared(several, 2)) and all(prepared(several, 2))
    assert len(measured) == 1
