"""Columns of a time series, and arithmetic expressions of them, such as `wall_displacement.lid / 0.1`."""

import ast
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.io.time_series import TIME, SeriesColumn, TimeSeriesTable
from granflow.scene.suggest import suggestion_sentence

OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip
"""Operators of an expression."""

FUNCTIONS: Mapping[str, Callable[[Any], Any]] = {"abs": np.abs, "sqrt": np.sqrt, "log": np.log, "exp": np.exp}
"""Functions of an expression."""

WORD = re.compile(r"(?<![\w.])[A-Za-z_][\w.]*")
"""Names in an expression: of functions, and of columns with the part after the dot."""


def quantity_of(series: TimeSeriesTable, text: str, source: str) -> SeriesColumn:
    """The column `text` of a series or, if there is none, the value of the expression `text`, which has no unit.

    `source`: file for messages. Angles are converted to degrees. Raises GranflowError for an unknown name or an
    expression that is not arithmetic.
    """
    columns = {TIME: SeriesColumn(TIME, "s", series.time)} | {each.name: each for each in series.columns}
    if text in columns:
        column = columns[text]
        if column.unit == "rad":
            with np.errstate(over="ignore"):
                return SeriesColumn(column.name, "deg", np.degrees(column.values))
        return column
    return SeriesColumn(text, "", _value(columns, text, source))


def _value(columns: Mapping[str, SeriesColumn], text: str, source: str) -> np.ndarray:
    """Value (n,) of an expression of columns in the units of the file."""
    # Column names contain dots and other characters that Python does not permit in a name: the longest come first.
    known = sorted(columns, key=len, reverse=True)
    pattern = re.compile("|".join(rf"(?<![\w.]){re.escape(name)}(?![\w.])" for name in known))
    for word in WORD.findall(pattern.sub(" ", text)):  # before the columns are replaced: `_0` is no name of the user
        if word not in FUNCTIONS:
            raise GranflowError(f"{source} has no column {word}. {suggestion_sentence(word, columns, 'columns')}")
    coded = pattern.sub(lambda found: f"_{known.index(found[0])}", text)
    try:
        if not coded.isascii():  # Python reads full-width letters as plain ones
            raise ValueError
        tree = ast.parse(coded.strip(), mode="eval").body
        with np.errstate(all="ignore"):
            found = _evaluated(tree, [columns[name].values for name in known])
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError):
        raise GranflowError(
            f"'{text}' is neither a column of {source} nor an arithmetic expression of its columns; "
            "write for example 'wall_displacement.lid / 0.1'."
        ) from None
    return np.broadcast_to(np.asarray(found, dtype=float), columns[TIME].values.shape)


def _evaluated(node: ast.expr, values: list[np.ndarray]) -> Any:
    """Value of a syntax tree; names are `_K` for the K-th of `values`. Raises ValueError for what is not arithmetic."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return np.float64(number)  # unlike float: x / 0 is infinite, and the root of a negative number is nan
        case ast.Name(id=name) if name not in FUNCTIONS:
            return values[int(name[1:])]
        case ast.UnaryOp(op=sign, operand=operand) if type(sign) in OPERATORS:
            return OPERATORS[type(sign)](_evaluated(operand, values))
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in OPERATORS:
            return OPERATORS[type(sign)](_evaluated(left, values), _evaluated(right, values))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](_evaluated(argument, values))
    raise ValueError
