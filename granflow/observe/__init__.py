"""Observers read snapshots and write files; they do not modify the state of a simulation.

Frames (VTU), time series (CSV), coarse-grained fields, metrics, checkpoints, `result.json` and the progress display.
All quantities are in SI units; `granflow.quantities` defines their names.
"""

from granflow.observe.build import observers_for, progress_for, time_series_for
from granflow.observe.checkpoint import (
    Checkpoint,
    CheckpointError,
    newest_checkpoint,
    read_checkpoint,
    remove_after,
    remove_old_checkpoints,
    write_checkpoint,
)
from granflow.observe.checkpoint_observers import check_observers, check_streams
from granflow.observe.every import PeriodicObserver, every
from granflow.observe.expectations import ExpectationResult, evaluate
from granflow.observe.files import remove_parts, replacing, write_text
from granflow.observe.flow_meters import FlowMeter
from granflow.observe.initial_from_run import particles_from_run
from granflow.observe.input_copies import copy_inputs
from granflow.observe.lock import locked
from granflow.observe.log import run_log, versions, write_scene_as_run
from granflow.observe.observer import Checkpointable, Observer
from granflow.observe.previous import (
    RESULT_FILES,
    refuse_inputs_inside,
    replaced_run,
    restore_previous_run,
    results_in,
)
from granflow.observe.progress import ProgressDisplay
from granflow.observe.report import Result, closing_table, write_result
from granflow.observe.resume import Change, CheckpointWriter, accepted_change, plan_fingerprint
from granflow.observe.schedule import Schedule
from granflow.observe.timeseries import TimeSeries
from granflow.observe.vtu import ContactFrames, ParticleFrames, WallFrames
from granflow.observe.wall_forces import WallForceMeter

__all__ = [
    "RESULT_FILES",
    "Change",
    "Checkpoint",
    "CheckpointError",
    "CheckpointWriter",
    "ContactFrames",
    "PeriodicObserver",
    "FlowMeter",
    "ExpectationResult",
    "Checkpointable",
    "WallForceMeter",
    "Observer",
    "ParticleFrames",
    "ProgressDisplay",
    "Result",
    "Schedule",
    "TimeSeries",
    "WallFrames",
    "accepted_change",
    "check_observers",
    "check_streams",
    "closing_table",
    "copy_inputs",
    "plan_fingerprint",
    "particles_from_run",
    "every",
    "evaluate",
    "remove_old_checkpoints",
    "locked",
    "newest_checkpoint",
    "observers_for",
    "progress_for",
    "read_checkpoint",
    "refuse_inputs_inside",
    "remove_after",
    "remove_parts",
    "replaced_run",
    "replacing",
    "restore_previous_run",
    "results_in",
    "run_log",
    "time_series_for",
    "versions",
    "write_checkpoint",
    "write_result",
    "write_scene_as_run",
    "write_text",
]
