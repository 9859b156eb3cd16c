"""Observers: they read snapshots and write files, never touch the state of a simulation."""

from granflow.observe.build import observers_for, progress_for, time_series_for
from granflow.observe.every import Every, every
from granflow.observe.expect import Judgement, judge
from granflow.observe.files import replacing, write_text
from granflow.observe.log import run_log, versions, write_scene_as_run
from granflow.observe.meters import FlowMeter
from granflow.observe.observer import Observer
from granflow.observe.progress import ProgressDisplay
from granflow.observe.report import Result, closing_table, write_result
from granflow.observe.schedule import Schedule
from granflow.observe.timeseries import TimeSeries
from granflow.observe.vtu import ContactFrames, ParticleFrames, WallFrames

__all__ = [
    "ContactFrames",
    "Every",
    "FlowMeter",
    "Judgement",
    "Observer",
    "ParticleFrames",
    "ProgressDisplay",
    "Result",
    "Schedule",
    "TimeSeries",
    "WallFrames",
    "closing_table",
    "every",
    "judge",
    "observers_for",
    "progress_for",
    "replacing",
    "run_log",
    "time_series_for",
    "versions",
    "write_result",
    "write_scene_as_run",
    "write_text",
]
