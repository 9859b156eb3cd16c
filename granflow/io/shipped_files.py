"""Paths of the scenes, sweeps and calibrations that are part of granflow."""

from pathlib import Path


def example_paths() -> dict[str, Path]:
    """Paths of the shipped scenes, sweeps and calibrations by name: in the package of a wheel, beside it in a clone."""
    package = Path(__file__).resolve().parents[1]
    folder = package / "scenes" if (package / "scenes").is_dir() else package.parent / "scenes"
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in sorted(folder.rglob("*.yaml"))}
