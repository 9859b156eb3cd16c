"""Metrics and fields of a finished run, computed from its frames."""

from pathlib import Path

from granflow import Scene, analyze_snapshots, read_run


def analyze(directory: Path, scene: Scene, out: Path) -> list[dict[str, float | str]]:
    """Compute the metrics of `scene` for each frame of a run; write its fields and `metrics.csv` to `out`.

    `scene` is that of the run; its `output.metrics` and `output.fields` may differ. Returns the rows of
    metrics.csv by column name. Frames without particles are skipped. Raises the errors of
    `analyze_snapshots`, and GranflowError if files cannot be read.
    """
    run = read_run(directory)
    return analyze_snapshots(scene, map(run.snapshot, range(len(run.frames))), out, str(directory))
