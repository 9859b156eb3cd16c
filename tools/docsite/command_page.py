"""Reference page of the command line: the help text of every command."""

import argparse
import os
from unittest import mock

from docsite.markdown import code, table
from granflow.cli.main import build_parser

INTRODUCTION = """\
# Commands

`granflow COMMAND --help` prints the same texts. In a clone, `python3 tools/dev.py run SCENE` is `granflow run SCENE`.
Exit codes: 0 success; 1 an expectation of the scene is not satisfied; 2 input error; 3 aborted by a limit, with a
diagnosis; 4 files cannot be written; 130 interrupted (Ctrl-C); 143 terminated; 141 the reader of stdout closed the
pipe.
"""
WIDTH = "100"
"""Columns of the help texts."""


def page() -> str:
    """The page in Markdown."""
    verbs = commands()
    rows = [(f"[{code(f'granflow {name}')}](#{name})", summary) for name, (summary, _) in verbs.items()]
    sections = [INTRODUCTION, table(("command", "purpose"), rows)]
    for name, (_, parser) in verbs.items():
        sections.append(f"## granflow {name} {{ #{name} }}\n\n```text\n{help_of(parser)}```\n")
    return "\n".join(sections)


def commands() -> dict[str, tuple[str, argparse.ArgumentParser]]:
    """Summary and parser of every command by name."""
    actions = build_parser()._actions
    subparsers = next(each for each in actions if isinstance(each, argparse._SubParsersAction))
    summaries = {each.dest: each.help or "" for each in subparsers._choices_actions}
    return {name: (summaries[name], parser) for name, parser in subparsers.choices.items()}


def help_of(parser: argparse.ArgumentParser) -> str:
    """Help text of a command, for any terminal."""
    with mock.patch.dict(os.environ, {"COLUMNS": WIDTH, "NO_COLOR": "1"}):
        return parser.format_help()
