"""Exceptions of granflow; the command line shows their messages without a traceback."""

from collections.abc import Iterable


class GranflowError(Exception):
    """An error that the user can correct. The command line prints the message and exits with `exit_code`.

    Exit codes: 2 invalid input or request, 3 aborted run (RunError), 4 files that cannot be written
    (OutputError).

    >>> try:
    ...     gf.read_run("none")
    ... except gf.GranflowError as error:
    ...     print(error)
    none: there is no such directory; give the directory of a run, such as out/hopper.
    """

    exit_code = 2


class FileError(GranflowError):
    """An invalid file.

    problems:  all problems in the order of the file, each as `file:line: sentence`

    The message consists of all problems, one per line.
    """

    def __init__(self, problems: Iterable[str] | str) -> None:
        given = (problems,) if isinstance(problems, str) else problems
        self.problems: tuple[str, ...] = tuple(_without_repetition(each) for each in given)
        super().__init__("\n".join(self.problems))


def _without_repetition(problem: str) -> str:
    """A problem of data without a file, whose position is the key with which the sentence may begin."""
    key, _, sentence = problem.partition(": ")
    return sentence if sentence.startswith(f"{key} ") else problem


class SceneError(FileError):
    """An invalid scene; its problems have the form `file:line:column: sentence`.

    >>> try:
    ...     gf.Material(young_modulus="70 GPa", poisson_ratio=0.7, density=2500)
    ... except gf.SceneError as error:
    ...     print(error.problems[0])
    poisson_ratio is 0.7, but a Poisson ratio must be above -1 and at most 0.5.
    """


class UnstableTimeStepError(SceneError):
    """The time step of a scene is above its stability limit.

    reason:  the part of the message without its position and remedy
    """

    def __init__(self, where: str, reason: str, remedy: str) -> None:
        self.reason = reason
        super().__init__(f"{where}: {reason}. {remedy}")


class OutputError(GranflowError):
    """Files of a run could not be written; the message gives the file, the reason and the last checkpoint.

    >>> try:
    ...     gf.load_scene("two.yaml").save("none/two.yaml")
    ... except gf.OutputError as error:
    ...     print(error)
    none/two.yaml cannot be written: No such file or directory; give a file in an existing folder.
    """

    exit_code = 4


class RunError(GranflowError):
    """A run was aborted; the message gives position, time, probable cause and remedy.

    >>> issubclass(gf.RunError, gf.GranflowError), gf.RunError.exit_code
    (True, 3)
    """

    exit_code = 3


class StopRun(Exception):
    """An observer raises it to end the run at the present time; checkpoint and result are written as at the
    end.

    All observers that are due at this time receive the snapshot before the run ends. `Simulation.run` then
    returns normally, and the run can continue with the next call.

    >>> def stop_if_full(snapshot):
    ...     if snapshot.totals["particle_count"] >= 1000:
    ...         raise gf.StopRun
    """


class FunctionError(GranflowError):
    """A function from Python, such as that of an observer, failed; the message gives its name and the
    simulated time.

    The original exception is `__cause__`. For a force or a contact model that cannot be compiled, the message
    gives the function, its file and line, and the reason of the kernel language.

        try:
            simulation.run()
        except granflow.FunctionError as error:
            print(error, repr(error.__cause__))
    """
