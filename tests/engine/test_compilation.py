"""The first launch of each kernel runs in the context for compilation; the pool of threads is measured when
needed."""

from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from granflow import taichi_patches
from granflow.engine import threads as workers
from granflow.engine.backend import Backend


class Kernel:
    """Stands for a kernel; its id is used again after it is deleted."""


def test_each_kernel_is_compiled_once_in_the_context_also_if_an_id_is_used_again(monkeypatch):
    entered = []

    @contextmanager
    def around():
        entered.append(True)
        yield

    monkeypatch.setattr(taichi_patches, "around", around)
    compile_kernel = taichi_patches.guarded(lambda program, configuration, capabilities, kernel: None)
    for count in (1, 2, 3):
        kernel = Kernel()
        for _ in range(2):
            compile_kernel(None, None, None, kernel)
        assert len(entered) == count
        del kernel


def test_the_pool_is_measured_once_per_start_of_taichi_and_only_for_several_workers(monkeypatch):
    measured: list[Any] = []

    def measure(state):
        measured.append(state)
        return workers.ThreadPool(affinity=None, seconds_per_poll=1e-6)

    def backend(worker_count):
        return Backend("cpu", "f64", None, None, None, worker_count)

    def prepared(particle_count, used):
        state = SimpleNamespace(count=particle_count, backend=used, control=SimpleNamespace(patience=[0, 0]))
        workers.Workers(state).prepare()
        return state.control.patience

    monkeypatch.setattr(workers, "_measure_pool", measure)
    several = workers.SINGLE_WORKER_PARTICLES + 1
    first = backend(2)
    second = backend(2)
    assert prepared(several - 1, first) == prepared(several, backend(1)) == [0, 0]
    assert not measured
    assert all(prepared(several, first)) and all(prepared(several, first))
    assert len(measured) == 1
    assert all(prepared(several, second))
    assert len(measured) == 2
