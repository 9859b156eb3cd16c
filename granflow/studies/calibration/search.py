"""The search: trials that several workers share through a journal in the folder of the calibration.

A `Search` proposes trials by a sampler of Optuna; the last ones are at the optimum of the fitted response
instead. The journal contains all trials with their attributes, so that a calibration continues where it was
stopped, and workers that are killed lose one trial each.
"""

import json
import os
import socket
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.io.files import replacing
from granflow.io.lock import locked
from granflow.studies.calibration.response import fit_response
from granflow.studies.calibration.schema import CalibrationInput, from_unit, to_unit

REFINED_SHARE = 0.3
"""Share of the trials, the last ones, that evaluate the optimum of the fitted response instead of a sampled
point."""
NEW_POINT = 1e-3
"""Smallest distance of a refined point from all trials, in the scaled parameters; a closer one would add
nothing."""
FIRST_RANDOM = 10
"""Trials with random parameters before the sampler learns from them."""


def require_optuna(method: str) -> Any:
    """The module optuna. Raises GranflowError if it, or a package that the method needs, is not installed."""
    try:
        import optuna
        import optuna.storages.journal
    except ImportError:
        raise GranflowError(
            "Calibration requires Optuna, which is not installed: pip install optuna cmaes"
        ) from None
    for name, package in (("cma_es", "cmaes"), ("gp", "torch")):
        if method == name:
            try:
                __import__(package)
            except ImportError:
                raise GranflowError(
                    f"search.method {name} requires {package}: pip install {package}"
                ) from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


class Search:
    """Trials of a calibration.

    Methods may be called from several threads, and several processes share the journal.
    """

    def __init__(self, calibration: CalibrationInput, out: Path) -> None:
        self.optuna = require_optuna(calibration.search.method)
        self.calibration = calibration
        self._out = out
        self.worker = f"{socket.gethostname()}-{os.getpid()}"
        journal = self.optuna.storages.journal
        path = str(out / JOURNAL)
        # Not the default lock: with a relative path it waits for ever for the lock of a killed process.
        lock = journal.JournalFileOpenLock(path, LOCK_GRACE)
        backend = _journal_of(journal, path, lock)
        storage = self.optuna.storages.JournalStorage(backend)
        self.study = self.optuna.create_study(study_name="calibration", storage=storage, load_if_exists=True)
        self._refuse_other(calibration)
        self.study.sampler = self._sampler(len(self.study.get_trials(deepcopy=False)))

    @property
    def lock(self) -> Path:
        """Directory that is locked while this process works, so that others recognize its trials as alive."""
        return self._out / "workers" / self.worker

    def _refuse_other(self, calibration: CalibrationInput) -> None:
        """Raise GranflowError if the journal belongs to a calibration with other parameters, scenes or
        targets."""
        text = calibration.model_dump_json(by_alias=True, exclude={"search", "title", "description"})
        earlier = self.study.user_attrs.get("calibration")
        if earlier is None:
            self.study.set_user_attr("calibration", text)
        elif earlier != text:
            raise GranflowError(
                f"{self._out} contains trials of a calibration with other scenes, parameters or targets: "
                "give another directory with --out."
            )

    def refuse_changed(self, inputs: Mapping[str, str]) -> None:
        """Raise GranflowError if the trials in the journal belong to other contents of scenes or curves.

        `inputs`: digest of each, by its name in messages; that of the first worker is stored.
        """
        earlier = self.study.user_attrs.get("inputs")
        if earlier is None:
            self.study.set_user_attr("inputs", dict(inputs))
            return
        for name, digest in inputs.items():
            if earlier.get(name) != digest:
                raise GranflowError(
                    f"{self._out} contains trials with another content of {name}: it, a file that it reads, "
                    "or the version of granflow has changed. Restore it, or give another directory with "
                    "--out."
                )

    def _sampler(self, existing: int) -> Any:
        """The sampler of Optuna.

        `existing`: number of trials, so that a restart does not repeat random points.
        """
        samplers = self.optuna.samplers
        seed = self.calibration.search.seed + existing
        if self.calibration.search.method == "cma_es":
            return samplers.CmaEsSampler(seed=seed, n_startup_trials=1)
        if self.calibration.search.method == "gp":
            return samplers.GPSampler(seed=seed, n_startup_trials=FIRST_RANDOM)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # constant_liar and multivariate are marked as experimental
            return samplers.TPESampler(
                seed=seed, n_startup_trials=FIRST_RANDOM, multivariate=True, constant_liar=True
            )

    def release_lost(self) -> None:
        """End the trials whose process is gone, and put their parameters first in the queue."""
        states = self.optuna.trial.TrialState
        for trial in self.study.get_trials(deepcopy=False, states=(states.RUNNING,)):
            worker = trial.user_attrs.get("worker", "")
            try:
                with locked(self._out / "workers" / worker):
                    pass
            except GranflowError:
                continue  # its process is alive
            if worker != self.worker:
                self.study.tell(trial.number, state=states.FAIL)
                self.study.enqueue_trial(dict(trial.params))

    def next_trial(self) -> Any:
        """The next trial, or None if all have begun."""
        states = self.optuna.trial.TrialState
        begun = [
            t
            for t in self.study.get_trials(deepcopy=False)
            if t.state != states.WAITING and not self._is_lost(t)
        ]
        waiting = self.study.get_trials(deepcopy=False, states=(states.WAITING,))
        if len(begun) >= self.calibration.search.trials:
            return None
        if not waiting and len(begun) >= (1.0 - REFINED_SHARE) * self.calibration.search.trials:
            self._enqueue_refined()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            trial = self.study.ask(self._distributions())
        trial.set_user_attr("worker", self.worker)
        return trial

    def _is_lost(self, trial: Any) -> bool:
        """Whether the trial ended because its process was killed; its parameters are tried again."""
        return trial.state == self.optuna.trial.TrialState.FAIL and "reason" not in trial.user_attrs

    def _distributions(self) -> dict[str, Any]:
        """Distributions of the parameters by name."""
        found = self.calibration.parameters
        float_distribution = self.optuna.distributions.FloatDistribution
        return {
            name: float_distribution(each.start, each.stop, log=each.scale == "log")
            for name, each in found.items()
        }

    def completed(self) -> list[Any]:
        """All completed trials in order; their attributes contain the residuals."""
        states = self.optuna.trial.TrialState
        return list(self.study.get_trials(deepcopy=False, states=(states.COMPLETE,)))

    def scaled(self, trials: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (trials, d) scaled to [0, 1], and weighted residuals (trials, residuals) of
        completed trials."""
        return self._unit_parameters(trials), _by_target(trials, "residuals")

    def standard_errors(self, trials: Sequence[Any]) -> np.ndarray:
        """Standard errors (trials, residuals) of the weighted residuals, from the runs.

        They are 0 where the runs give none.
        """
        return _by_target(trials, "errors")

    def _unit_parameters(self, trials: Sequence[Any]) -> np.ndarray:
        """Parameters (trials, d) scaled to [0, 1]."""
        parameters = self.calibration.parameters
        u = [[to_unit(each, trial.params[name]) for name, each in parameters.items()] for trial in trials]
        return np.array(u).reshape(-1, len(parameters))

    def _enqueue_refined(self) -> None:
        """Enqueue the optimum of the response fitted to the trials near the best one, unless it was tried.

        A trial that was stopped early or failed does not change the fit: its point would be tried again
        without end.
        """
        trials = self.completed()
        if not trials:
            return
        u, residuals = self.scaled(trials)
        best = int(np.argmin([trial.value for trial in trials]))
        response = fit_response(u, residuals, best)
        if response is None:
            return
        found = response.optimum(u[best])
        tried = self._unit_parameters(
            [trial for trial in self.study.get_trials(deepcopy=False) if trial.params]
        )
        if np.abs(tried - found).max(axis=1).min() > NEW_POINT:
            named = zip(self.calibration.parameters.items(), found, strict=True)
            self.study.enqueue_trial({name: from_unit(each, share) for (name, each), share in named})


def _by_target(trials: Sequence[Any], attribute: str) -> np.ndarray:
    """Numbers of all targets (trials, residuals) in an attribute of completed trials."""
    names = list(trials[0].user_attrs["residuals"])
    return np.array(
        [np.concatenate([trial.user_attrs[attribute][name] for name in names]) for trial in trials]
    )


# The journal

JOURNAL = "trials.journal"
"""File with all trials."""
LOCK_GRACE = 10
"""Time [s] after which the lock of the journal is that of a killed process; others hold it for some
milliseconds."""
OPERATION = b'{"op_code"'
"""Start of a line of the journal."""


def _journal_of(journal: Any, path: str, lock: Any) -> Any:
    """The journal of Optuna in a file, without damaged lines; `journal`: its module, `lock`: of the file.

    A line that a full disk cuts off is removed before the next one is written: the operation has failed for
    the worker that wrote it, and no other worker has read it.
    """

    class Journal(journal.JournalFileBackend):
        def append_logs(self, logs: list[dict[str, Any]]) -> None:
            lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs).encode()
            lock.acquire()
            try:
                with open(path, "r+b", buffering=0) as file:
                    end = file.seek(0, os.SEEK_END)
                    file.seek(max(end - 1, 0))
                    if file.read(1) not in (b"", b"\n"):
                        file.seek(0)
                        end = file.read().rfind(b"\n") + 1
                        file.truncate(end)
                    file.seek(end)
                    try:
                        written = file.write(lines)
                        while written < len(lines):
                            written += file.write(lines[written:])
                        os.fsync(file.fileno())
                    except OSError:
                        file.truncate(end)
                        raise
            finally:
                lock.release()

    if os.path.exists(path):
        lock.acquire()
        try:
            _remove_damaged_lines(Path(path))
        finally:
            lock.release()
    return Journal(path, lock)


def _remove_damaged_lines(path: Path) -> None:
    """Remove the lines of a journal that are no operations.

    A whole operation behind a cut-off one is kept.
    """
    lines = path.read_bytes().splitlines(keepends=True)
    kept = []
    for line in lines:
        found = line
        while found and not _is_operation(found):
            start = found.find(OPERATION, 1)
            found = found[start:] if start > 0 else b""
        kept.append(found)
    if kept != lines:
        with replacing(path, durable=True) as temporary:
            temporary.write_bytes(b"".join(kept))


def _is_operation(line: bytes) -> bool:
    """Whether a line of the journal is complete."""
    try:
        content = json.loads(line)
    except ValueError:
        return False
    return line.endswith(b"\n") and isinstance(content, dict) and {"op_code", "worker_id"} <= content.keys()
