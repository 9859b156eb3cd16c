"""The verb `import`: scripts of LIGGGHTS and LAMMPS become scenes."""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import print_error, say
from granflow.errors import GranflowError, SceneError, UnstableTimeStepError

if TYPE_CHECKING:
    from granflow.importing.convert import Imported

INCOMPLETE = 3
"""Exit code of a script of which something has no counterpart."""


def import_(options: argparse.Namespace) -> int:
    """`granflow import`: translate a script, report each line, write the scene and check it.

    0 if the scene passes `granflow check`; 2 for errors of the script; 3 if something is not possible: then
    only --partial writes the scene. Raises GranflowError.
    """
    from granflow.importing.convert import convert

    out = options.out or Path(options.deck.name.removeprefix("in.").removesuffix(".in") + ".yaml")
    settings = dict(_setting(each) for each in options.settings)
    found = convert(options.deck, settings, options.code, options.after)
    is_written = bool(found.text) and (found.report.is_complete or options.partial)
    fault = ""
    if is_written:
        write(out, found, options.overwrite)
        try:
            fault = checked(out)
        except UnstableTimeStepError as error:
            found.make_step_automatic(error.reason)
            write(out, found, overwrite=True)
            fault = checked(out)
    if options.json:
        content = {
            "scene": str(out) if is_written else None,
            "code": found.code,
            **found.report.to_dict(),
            "check": fault or None,
        }
        say(json.dumps(content, indent=2))
    else:
        say(found.report.text())
        if is_written:
            say(f"Written to {out}")
    if fault:
        say(fault, file=sys.stderr)
        print_error(f"{out}: the scene does not pass granflow check.")
        return GranflowError.exit_code
    if found.report.is_complete:
        return 0
    if not found.text:
        print_error("nothing was written, because the lines that are not possible leave no scene.")
    elif not options.partial:
        print_error("nothing was written, because some lines have no counterpart; --partial writes the rest.")
    return INCOMPLETE


def _setting(text: str) -> tuple[str, str]:
    """The name and value of --set. Raises GranflowError."""
    name, found, value = text.partition("=")
    if not found or not name:
        raise GranflowError(f"--set {text}: give the name and value of a variable, such as --set dt=1e-5.")
    return name, value


def write(out: Path, found: "Imported", overwrite: bool) -> None:
    """Write the scene and its files. Raises GranflowError if a file exists with another content."""
    contents: Mapping[Path, bytes] = {
        out: found.text.encode(),
        **{out.parent / name: content for name, content in found.files.items()},
    }
    for path, content in contents.items():
        if path.exists() and not overwrite and path.read_bytes() != content:
            raise GranflowError(f"{path} exists: replace it with --overwrite, or give another --out.")
    out.parent.mkdir(parents=True, exist_ok=True)
    for path, content in contents.items():
        path.write_bytes(content)


def checked(out: Path) -> str:
    """Run `granflow check`; the problems as text, empty without one. Raises UnstableTimeStepError."""
    from granflow.cli.run import check

    options = argparse.Namespace(scene=out, overrides=[], mpi=False, allow_long=True, precision=None)
    try:
        check(options)
    except UnstableTimeStepError:
        raise
    except SceneError as error:
        return "\n".join(error.problems)
    except GranflowError as error:
        return str(error)
    return ""


def add_import(verbs: Any) -> None:
    """Add `granflow import` and its arguments."""
    summary = "translate an input script of LIGGGHTS or LAMMPS to a scene, with a report on each line"
    parser = verbs.add_parser("import", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.set_defaults(verb=import_)
    parser.add_argument("deck", metavar="DECK", type=Path, help="input script, such as in.conveyor")
    parser.add_argument(
        "--out", metavar="FILE.yaml", type=Path,
        help="scene file; meshes and particles are written beside it (default: the name of the script)",
    )  # fmt: skip
    parser.add_argument(
        "--code", choices=("liggghts", "lammps"), help="code of the script (default: recognized)"
    )
    parser.add_argument(
        "--set", dest="settings", metavar="VARIABLE=VALUE", action="append", default=[],
        help="value of a variable of the script, as -var of the codes; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--after", metavar="DECK", type=Path, action="append", default=[],
        help="script that writes the file of read_restart: both become stages of one scene; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--partial",
        action="store_true",
        help="write the scene also if lines of the script have no counterpart",
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--overwrite", action="store_true", help="replace files of an earlier import")
