"""`granflow report`: an HTML page that summarizes a run."""

from granflow.studies.report.record import read_record
from granflow.studies.report.report import write_report

__all__ = ["read_record", "write_report"]
