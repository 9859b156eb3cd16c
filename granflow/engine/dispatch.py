"""Loops on a GPU with at most as many threads as each device supports; in longer ones a thread has several tasks."""

from typing import Any

from granflow.kernel_language import ti

LARGEST_DISPATCH = 2**22
"""Largest number of threads of a loop. Vulkan guarantees 65 535 groups per dispatch, of 128 threads each."""


def thread_count(most_tasks: int) -> int:
    """Length of a loop over at most `most_tasks` tasks."""
    return min(most_tasks, LARGEST_DISPATCH)


def build_tasks_of_thread(body: Any, most_tasks: int) -> Any:
    """Device function (thread, count, argument): call `body` for each of the `count` tasks that the thread has.

    body:        device function (task, argument)
    most_tasks:  largest `count`
    """
    stride = thread_count(most_tasks)

    @ti.func
    def only_task(thread, count, argument):
        if thread < count:
            body(thread, argument)

    @ti.func
    def each_task(thread, count, argument):
        task = thread
        while task < count:
            body(task, argument)
            task += stride

    return only_task if most_tasks == stride else each_task
