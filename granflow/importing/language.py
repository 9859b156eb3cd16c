"""The language of LIGGGHTS and LAMMPS scripts: from a file to commands in the order of their execution.

`Interpreter.commands` reads lines (comments, quotes, continuation), substitutes variables, and executes the
commands of the language itself: variable, if, jump, label, next, include, print, quit and those like them.
All other commands are yielded as `Command`. Formulas are evaluated when a command needs their value; those
that need the state of a simulation raise `NotKnown`.
"""

import math
import operator
import random
import re
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from granflow.errors import GranflowError
from granflow.io.tables import is_number

MOST_COMMANDS = 100_000
"""Number of executed commands above which a script is taken for an endless loop."""
MOST_INCLUDES = 20
"""Depth of nested files above which they are taken to include each other."""
FOREIGN = ("shell", "python", "partition")
"""Commands that run another program."""
FILE_COMMANDS = (("mkdir",), ("rm",), ("rmdir",))
"""Words of shell that prepare folders for output."""
OWN = {*("variable", "include", "jump", "label", "echo", "log", "print", "info", "next", "quit"), *FOREIGN}
"""Commands of the language itself."""
FILES_ONLY = ("dump", "restart", "write_dump", "write_restart", "write_data", "log", "echo", "shell")
"""Commands whose names of files a scene does not need."""
USED = re.compile(r"\$\{(\w+)\}|\$(\w)|\bv_(\w+)")
"""A variable in a line."""
LOOPED = ("index", "loop", "string", "universe", "uloop", "world")
"""Styles of variables whose values are texts."""


@dataclass(frozen=True)
class Command:
    """One executed command after the substitution of variables.

    text:     the line as written, continuation lines joined
    """

    name: str
    words: tuple[str, ...]
    file: Path
    line: int
    text: str

    @property
    def where(self) -> str:
        """Position for messages."""
        return f"{self.file.name}:{self.line}"


class DeckError(GranflowError):
    """An error of a script; `command` is its position, as a command or as `Line`."""

    def __init__(self, command: "Command | Line", reason: str) -> None:
        super().__init__(f"{command.file.name}:{command.line}: {reason}")
        self.command = command
        self.reason = reason


class NotKnown(GranflowError):
    """A formula that needs the state of the simulation, or a variable that does not exist.

    is_result:  whether only the simulation gives the number
    """

    def __init__(self, reason: str, is_result: bool = False) -> None:
        super().__init__(reason)
        self.is_result = is_result


@dataclass(frozen=True)
class Line:
    """One line of a script, continuation lines joined and without its comment."""

    file: Path
    line: int
    text: str

    @property
    def head(self) -> str:
        """The first word; empty for an empty line."""
        return self.text.split(None, 1)[0] if self.text.strip() else ""


# Lines and words


def lines_of(text: str, file: Path) -> list[Line]:
    """The lines of a script. A line that ends with & continues in the next one, as does an open triple "
    "quote."""
    found: list[Line] = []
    parts: list[str] = []
    start = 1
    in_block = False
    for number, raw in enumerate(text.splitlines(), 1):
        if not parts:
            start = number
        if not in_block:
            raw = without_comment(raw, tuple(parts))
        in_block ^= raw.count('"""') % 2 == 1
        stripped = raw.rstrip()
        if in_block:
            parts.append(raw + "\n")
        elif stripped.endswith("&"):
            parts.append(stripped[:-1] + " ")
        else:
            found.append(Line(file, start, "".join([*parts, stripped])))
            parts = []
    if parts:
        found.append(Line(file, start, "".join(parts)))
    return found


def without_comment(text: str, before: tuple[str, ...] = ()) -> str:
    """The text up to the first # outside quotes; `before`: parts of the same command on earlier lines."""
    quote = _open_quote("".join(before))
    for index, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter == "#":
            return text[:index]
    return text


def _open_quote(text: str) -> str:
    """The quotation mark that is open at the end of a text; empty without one."""
    quote = ""
    for letter in text.replace('"""', ""):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
    return quote


def split_words(line: Line, text: str) -> list[str]:
    """The words of a command; quotes join words and are removed. Raises DeckError for an open quote."""
    words: list[str] = []
    index = 0
    while index < len(text):
        if text[index].isspace():
            index += 1
            continue
        for quote in ('"""', '"', "'"):
            if text.startswith(quote, index):
                end = text.find(quote, index + len(quote))
                if end < 0:
                    raise DeckError(line, f"the quotation mark {quote} is not closed.")
                words.append(text[index + len(quote) : end])
                index = end + len(quote)
                break
        else:
            end = index
            while end < len(text) and not text[end].isspace():
                end += 1
            words.append(text[index:end])
            index = end
    return words


# Variables


@dataclass
class Variable:
    """A variable of a script; `values` has one formula for the style equal, and texts for those of LOOPED."""

    style: str
    values: list[str]
    at: int = 0

    @property
    def text(self) -> str:
        """The current text or formula."""
        return self.values[self.at]


@dataclass
class Interpreter:
    """Executes a script and yields the commands that are not part of the language.

    given:      variables of the command line, which have priority over those of the script
    facts:      numbers that formulas know, such as step and dt; the translation of `run` updates them
    printed:    what the script has printed
    """

    given: dict[str, str] = field(default_factory=dict)
    facts: dict[str, float] = field(default_factory=lambda: {"step": 0.0, "elapsed": 0.0, "time": 0.0})
    variables: dict[str, Variable] = field(default_factory=dict)
    printed: list[str] = field(default_factory=list)
    unneeded: Container[str] = ()
    """Names of further commands that a scene does not need, and of fixes as `fix STYLE`."""
    on_executed: Callable[[Command, str], None] = lambda command, problem: None
    """Called with each executed command of the language, and why it has no counterpart (mostly empty)."""
    on_result: Callable[[tuple[str, int], str], bool | None] = lambda where, condition: None
    """Decides a condition on results that leaves a loop, by its file and line and its formula."""
    on_defined: Callable[[str, str], bool | None] = lambda category, name: None
    """Whether a fix, compute, region or group of this name exists; None if that is not known."""
    _executed: int = 0
    _seek: str | None = None
    """Label to which a jump goes."""
    _stopped: bool = False

    def __post_init__(self) -> None:
        self._random = random.Random(1)
        self._folder = Path()
        self.begin_script()

    def commands(self, path: Path, depth: int = 0, origin: "Line | None" = None) -> Iterator[Command]:
        """Commands of a file in the order of execution. Raises DeckError."""
        if depth == 0:
            self._folder = path.parent
        if depth > MOST_INCLUDES and origin is not None:
            raise DeckError(origin, f"{MOST_INCLUDES} files include each other; remove the circle.")
        lines = self._read(path, origin)
        index = 0
        while index < len(lines) and not self._stopped:
            line = lines[index]
            index += 1
            if not line.text.strip():
                continue
            for result in self._execute(line, path, depth):
                if isinstance(result, Command):
                    yield result
                else:  # a jump, within this file or to another one
                    if result != path:
                        path = result
                        lines = self._read(path, line)
                    index = 0 if self._seek is None else self._label(lines, line)
                    break

    def _file(self, name: str, near: Path) -> Path:
        """A file that a script names: from the folder of the script, where the codes are started, or else
        next to the file `near` that names it."""
        found = self._folder / name
        neighbor = near.parent / name
        return neighbor if neighbor.exists() and not found.exists() else found

    def begin_script(self) -> None:
        """Forget the variables of the script before, as another run of the code does."""
        self.variables = {name: Variable("index", text.split()) for name, text in self.given.items()}
        self._stopped = self._is_exhausted = False
        self._seek = None

    def _read(self, path: Path, origin: "Line | None") -> list[Line]:
        """The lines of a file. Raises DeckError, or GranflowError for the script itself."""
        try:
            return lines_of(path.read_text(encoding="utf-8", errors="replace"), path)
        except OSError as error:
            reason = f"{path} cannot be read: {error.strerror}."
            raise (GranflowError(reason) if origin is None else DeckError(origin, reason)) from None

    def _label(self, lines: Sequence[Line], line: Line) -> int:
        """Index of the line after the label of a jump."""
        for index, each in enumerate(lines):
            if each.text.split()[:2] == ["label", self._seek]:
                self._seek = None
                return index + 1
        raise DeckError(line, f"the script has no label {self._seek}.")

    def _execute(self, line: Line, path: Path, depth: int) -> Iterator[Command | Path]:
        """Execute one line: yield its command, those of an included file, or the path of a jump."""
        self._executed += 1
        if self._executed > MOST_COMMANDS:
            raise DeckError(
                line,
                f"{MOST_COMMANDS} commands were executed: the loop has no end, or is too long to import. "
                "Check next and if, or give its variable fewer values with --set.",
            )
        if line.head == "if":
            words = split_words(line, line.text)[1:]
            self.on_executed(
                Command("if", tuple(words), line.file, line.line, " ".join(line.text.split())), ""
            )
            try:
                decided = self._leaves_loop(line, words, path)
                if decided is not None:
                    words[0] = "1 == 1" if decided else "1 == 0"
                words = [self._substitute(each) for each in words]
            except NotKnown as error:
                raise DeckError(line, f"{error}; {self._remedy(line)}") from None
            except ValueError as error:
                raise DeckError(line, f"the bracket of {error} is not closed.") from None
            for chosen in self._branch(line, words):
                yield from self._execute(Line(line.file, line.line, chosen), path, depth)
            return
        try:
            # print substitutes variables inside quotes as well
            text = self._substitute(line.text) if line.head == "print" else self._outside(line.text)
        except NotKnown as error:
            words = line.text.split()
            name = f"fix {words[3]}" if line.head == "fix" and len(words) > 3 else line.head
            if name not in FILES_ONLY and name not in self.unneeded:
                yield from self._unknown(line, error)
                return
            text = " ".join(self._known_part(each) for each in line.text.split())
        except ValueError as error:
            raise DeckError(line, f"the bracket of {error} is not closed.") from None
        words = split_words(line, text)
        command = Command(words[0], tuple(words[1:]), line.file, line.line, " ".join(line.text.split()))
        yield from self._own(command, line, path, depth)

    def _unknown(self, line: Line, error: "NotKnown") -> Iterator[Command]:
        """A line with a number that only the simulation gives: it is printed, or kept by a variable.

        Raises DeckError for other commands, and for a variable that the script does not define.
        """
        words = line.text.split()
        command = Command(words[0], tuple(words[1:]), line.file, line.line, " ".join(words))
        if not error.is_result or line.head not in ("print", "variable") or len(words) < 2:
            raise DeckError(line, f"{error}; {self._remedy(line)}") from None
        if line.head == "variable" and words[1] not in self.given:
            self.variables[words[1]] = Variable("result", [str(error)])
        self.on_executed(command, "")
        yield from ()

    def _known_part(self, word: str) -> str:
        """A word with its variables substituted; the word itself if one is not known."""
        try:
            return self._substitute(word)
        except (NotKnown, ValueError):
            return word

    def _remedy(self, line: Line) -> str:
        """How to give variables: those of the line that are results of the simulation, or all that the file
        uses, but neither it nor a file before has defined."""
        results = dict.fromkeys(filter(self._is_result, map("".join, USED.findall(line.text))))
        if results:
            return f"give the value with --set {next(iter(results))}=VALUE."
        text = "\n".join(each.text for each in self._read(line.file, None))
        used = USED.findall(text)
        defined = {*re.findall(r"^\s*variable\s+(\w+)", text, re.MULTILINE), *self.variables}
        missing = [name for name in dict.fromkeys("".join(each) for each in used) if name not in defined]
        if len(missing) < 2:
            return "give it with --set NAME=VALUE."
        return f"give {', '.join(missing[:-1])} and {missing[-1]} with --set NAME=VALUE, once for each."

    def _is_result(self, name: str) -> bool:
        """Whether only the simulation gives the value of a variable."""
        try:
            self.text_of(name)
        except NotKnown as error:
            return error.is_result
        return False

    def _own(self, command: Command, line: Line, path: Path, depth: int) -> Iterator[Command | Path]:
        """Execute a command of the language, or yield it."""
        words = command.words
        if command.name in OWN:
            is_foreign = command.name in FOREIGN and words[:1] not in FILE_COMMANDS
            self.on_executed(command, f"{command.name} runs another program" if is_foreign else "")
        match command.name:
            case "variable":
                self._variable(command)
            case "include":
                self._need(command, 1, "include FILE")
                yield from self.commands(self._file(words[0], path), depth + 1, line)
            case "jump":
                self._need(command, 1, "jump FILE or jump SELF LABEL")
                if not self._is_exhausted:
                    self._seek = words[1] if len(words) > 1 else None
                    yield path if words[0] == "SELF" else self._file(words[0], path)
                self._is_exhausted = False
            case "label" | "echo" | "log" | "print" | "info":
                if command.name == "print":
                    self.printed.append(" ".join(words[:1]))
            case "next":
                self._next(command)
            case "quit":
                self._stopped = True
            case "shell" | "python" | "partition":
                pass  # reported above
            case "run" if "every" in words:
                yield from self._run_every(command, line, path, depth)
            case _:
                yield command

    def _run_every(self, command: Command, line: Line, path: Path, depth: int) -> Iterator[Command | Path]:
        """run N ... every M COMMANDS: parts of M steps, each followed by the commands; NULL for none."""
        words = command.words
        at = words.index("every")
        if len(words) < at + 3 or not all(is_number(each) for each in (words[0], words[at + 1])):
            raise DeckError(command, "the form is run N every M COMMAND ..., or NULL for no command.")
        total, part = int(float(words[0])), int(float(words[at + 1]))
        if part <= 0:
            raise DeckError(command, f"every is {part}; give a number of steps of at least 1.")
        given = [each for each in words[at + 2 :] if each != "NULL"]
        if all(each.split()[:1] in ([], ["print"], ["log"], ["echo"]) for each in given):
            yield replace(command, words=words[:at])
            return
        if "upto" in words[:at]:
            raise DeckError(command, "every cannot be combined with upto; give the number of steps.")
        for done in range(0, total, part):
            yield replace(command, words=(str(min(part, total - done)), *words[1:at]))
            for each in given:
                yield from self._execute(Line(line.file, line.line, each), path, depth)

    def _need(self, command: Command, count: int, form: str) -> None:
        if len(command.words) < count:
            raise DeckError(command, f"{command.name} has too few arguments; it is {form}.")

    def _branch(self, line: Line, words: list[str]) -> list[str]:
        """The commands of an `if` that are executed."""
        try:
            start = words.index("then") + 1
            if self.condition(words[0]):
                return _until_keyword(words, start)
            while "elif" in words:
                words = words[words.index("elif") + 1 :]
                if self.condition(words[0]):
                    return _until_keyword(words, 1)
            return _until_keyword(words, words.index("else") + 1) if "else" in words else []
        except NotKnown as error:
            raise DeckError(line, f"the condition cannot be decided before the simulation: {error}") from None
        except (ValueError, IndexError):
            raise DeckError(line, 'the form is if "CONDITION" then "COMMAND" else "COMMAND".') from None

    def condition(self, text: str) -> bool:
        """Truth of a condition of `if`: numbers or texts that are compared, and combinations."""
        if "(" not in text:
            for symbol, combined in (("||", any), ("&&", all)):
                if symbol in text:
                    return combined(self.condition(each) for each in text.split(symbol))
        for symbol in ("==", "!="):
            left, found, right = text.partition(symbol)
            if found and not any(each in text for each in ("&&", "||", "|^", "<", ">", "(")):
                first, second = left.strip(), right.strip()
                if not (is_number(first) and is_number(second)):
                    try:
                        return (self.evaluate(first) == self.evaluate(second)) == (symbol == "==")
                    except (NotKnown, ValueError):
                        return (first == second) == (symbol == "==")
        return self.evaluate(text) != 0.0

    def _leaves_loop(self, line: Line, words: list[str], path: Path) -> bool | None:
        """Whether a condition on results of the simulation, which leaves a loop, is true.

        None for other conditions, and for one that the translation cannot decide. Raises NotKnown.
        """
        jump = words[2].split() if len(words) == 3 and words[1] == "then" else []
        if jump[:1] != ["jump"] or len(jump) != 3 or jump[1] not in ("SELF", path.name):
            return None
        try:
            self.condition(self._substitute(words[0]))
        except NotKnown as error:
            labels = (each for each in self._read(path, line) if each.text.split() == ["label", jump[2]])
            if not error.is_result or not any(each.line > line.line for each in labels):
                return None
            return self.on_result((path.name, line.line), self._formulas(words[0]))
        return None

    def _formulas(self, text: str) -> str:
        """The text with variables replaced by their formulas, or by their numbers. Raises NotKnown."""

        def value(found: re.Match[str]) -> str:
            name = found[1] or found[2] or found[3]
            variable = self.variables.get(name)
            if variable is not None and variable.style == "equal":
                return f"({self._formulas(variable.text)})"
            return self.text_of(name)

        return USED.sub(value, text)

    # Variables

    def _variable(self, command: Command) -> None:
        """Define a variable; those of the command line and, as in the codes, index variables keep their "
        "value."""
        words = list(command.words)
        if len(words) == 2 and words[1] == "delete":
            self.variables.pop(words[0], None)
            return
        self._need(command, 3, "variable NAME STYLE VALUE")
        name, style, *values = words
        if name in self.given or (name in self.variables and style in ("index", "loop", "universe", "uloop")):
            return
        if style in ("loop", "uloop"):
            numbers = [int(float(each)) for each in values if is_number(each)]
            if not numbers:
                raise DeckError(
                    command, f"the end of the loop is {values[0]}; give a whole number, such as 5."
                )
            first, last = (numbers[0], numbers[1]) if len(numbers) > 1 else (1, numbers[0])
            width = len(str(last)) if "pad" in values else 1
            self.variables[name] = Variable("index", [str(n).zfill(width) for n in range(first, last + 1)])
        elif style in ("index", "string", "universe", "equal", "atom", "vector"):
            if style not in ("index", "universe"):
                values = [" ".join(values)]
            self.variables[name] = Variable(style, values)
        elif style == "internal":
            self.variables[name] = Variable("equal", values[:1])
        elif style == "world":  # one of several simulations at once: the first
            self.variables[name] = Variable("string", values[:1])
        elif style == "file":
            path = self._file(values[0], command.file)
            try:
                lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            except OSError as error:
                raise DeckError(command, f"{path} cannot be read: {error.strerror}.") from None
            found = [each.partition("#")[0].strip() for each in lines]
            self.variables[name] = Variable("index", [each for each in found if each] or [""])
        elif style == "getenv":
            raise DeckError(command, f"the environment is not read; give the value with --set {name}=VALUE.")
        elif style == "format":
            self.variables[name] = Variable("format", values)
        else:
            raise DeckError(
                command, f"variables of the style {style} are not supported; give --set {name}=VALUE."
            )

    def _next(self, command: Command) -> None:
        """Advance variables; the jump that follows is skipped when one is exhausted."""
        for name in command.words:
            if name not in self.variables:
                raise DeckError(command, f"there is no variable {name}.")
            variable = self.variables[name]
            if variable.style not in ("index", "universe"):
                raise DeckError(
                    command,
                    f"the variable {name} is of the style {variable.style}; next takes index and loop.",
                )
            variable.at += 1
            if variable.at >= len(variable.values):
                del self.variables[name]
                self._is_exhausted = True

    def text_of(self, name: str) -> str:
        """The value of a variable as a command receives it. Raises NotKnown."""
        if name not in self.variables:
            raise NotKnown(f"there is no variable {name}")
        variable = self.variables[name]
        if variable.style == "result":
            raise NotKnown(variable.text, is_result=True)
        if variable.style == "equal":
            return shortest(self.evaluate(variable.text))
        if variable.style == "format":
            value = self.evaluate(self.text_of(variable.values[0]))
            return variable.values[1] % value
        if variable.style in ("atom", "vector"):
            raise NotKnown(f"the variable {name} has one value per particle", is_result=True)
        return variable.text

    def _outside(self, text: str) -> str:
        """The text with variables substituted outside quotes only, as in the codes."""
        parts: list[str] = []
        index = 0
        while index < len(text):
            for quote in ('"""', '"', "'"):
                if text.startswith(quote, index):
                    end = text.find(quote, index + len(quote))
                    end = len(text) if end < 0 else end + len(quote)
                    parts.append(text[index:end])
                    index = end
                    break
            else:
                ends = [at for at in (text.find('"', index), text.find("'", index)) if at >= 0]
                end = min(ends, default=len(text))
                parts.append(self._substitute(text[index:end]))
                index = end
        return "".join(parts)

    def _substitute(self, text: str) -> str:
        """The text with $x, ${name} and $(formula) replaced. Raises NotKnown, ValueError."""
        parts: list[str] = []
        index = 0
        while index < len(text):
            if text[index] != "$":
                parts.append(text[index])
                index += 1
                continue
            value, index = self._dollar(text, index + 1)
            parts.append(value)
        return "".join(parts)

    def _dollar(self, text: str, index: int) -> tuple[str, int]:
        """The value after a $ and the index behind it."""
        if text.startswith("{", index):
            end = text.find("}", index)
            if end < 0:
                raise ValueError(text[index - 1 :])
            return self.text_of(text[index + 1 : end]), end + 1
        if text.startswith("(", index):
            end = _closing(text, index)
            formula, _, pattern = text[index + 1 : end].partition(":")
            value = self.evaluate(formula)
            return pattern % value if pattern else shortest(value), end + 1
        return self.text_of(text[index : index + 1]), index + 1

    # Formulas

    def evaluate(self, formula: str, **facts: float) -> float:
        """The value of a formula; `facts` replace numbers such as step. Raises NotKnown, ValueError."""
        return Formula(formula, self, {**self.facts, **facts}).value()

    def value_at(self, name: str, **facts: float) -> float:
        """The value of an equal-style variable with other numbers, such as a later step. Raises NotKnown."""
        if name not in self.variables:
            raise NotKnown(f"there is no variable {name}")
        return self.evaluate(self.variables[name].text, **facts)


def _until_keyword(words: list[str], start: int) -> list[str]:
    """The words from `start` up to the next elif or else."""
    found = []
    for word in words[start:]:
        if word in ("elif", "else"):
            break
        found.append(word)
    return found


def _closing(text: str, start: int) -> int:
    """Index of the bracket that closes the one at `start`. Raises ValueError."""
    depth = 0
    for index in range(start, len(text)):
        depth += (text[index] == "(") - (text[index] == ")")
        if depth == 0:
            return index
    raise ValueError(text)


def shortest(value: float) -> str:
    """A number as the codes print it in a substitution, with 15 digits."""
    return f"{value:.15g}"


# Formulas

CONSTANTS = {"PI": math.pi, "yes": 1.0, "on": 1.0, "true": 1.0, "no": 0.0, "off": 0.0, "false": 0.0}
"""Constants; `version` is that of the newest LAMMPS that this importer knows."""
CONSTANTS["version"] = 20250722.0

FUNCTIONS: dict[str, tuple[int, Callable[..., float]]] = {
    "sqrt": (1, math.sqrt),
    "exp": (1, math.exp),
    "ln": (1, math.log),
    "log": (1, math.log10),
    "abs": (1, abs),
    "sin": (1, math.sin),
    "cos": (1, math.cos),
    "tan": (1, math.tan),
    "asin": (1, math.asin),
    "acos": (1, math.acos),
    "atan": (1, math.atan),
    "atan2": (2, math.atan2),
    "ceil": (1, math.ceil),
    "floor": (1, math.floor),
    "round": (1, lambda x: math.floor(x + 0.5)),
    "ternary": (3, lambda test, yes, no: yes if test else no),
}
"""Functions of numbers, with their number of arguments. `log` has the base 10, as in the codes."""

RANKS: tuple[dict[str, Callable[[float, float], float]], ...] = (
    {"||": lambda a, b: float(bool(a) or bool(b)), "|^": lambda a, b: float(bool(a) != bool(b))},
    {"&&": lambda a, b: float(bool(a) and bool(b))},
    {"==": lambda a, b: float(a == b), "!=": lambda a, b: float(a != b)},
    {
        "<=": lambda a, b: float(a <= b),
        ">=": lambda a, b: float(a >= b),
        "<": lambda a, b: float(a < b),
        ">": lambda a, b: float(a > b),
    },
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul, "/": operator.truediv, "%": math.fmod},
)
"""Operators of two numbers, those that bind least first; ^ and the sign bind most."""


class Formula:
    """One formula: a parser of recursive descent that evaluates as it reads."""

    def __init__(self, text: str, interpreter: Interpreter, facts: dict[str, float]) -> None:
        self.text = text.strip()
        self.at = 0
        self.interpreter = interpreter
        self.facts = facts

    def value(self) -> float:
        """The value of the whole formula. Raises NotKnown, and ValueError for a text that is no formula."""
        try:
            found = self._rank(0)
        except (ArithmeticError, ValueError) as error:
            raise NotKnown(f"{self.text} has no value: {error}") from None
        if self.at < len(self.text):
            raise NotKnown(f"{self.text} is not a formula: {self.text[self.at :]} is left over")
        return float(found)

    def _skip(self) -> None:
        while self.at < len(self.text) and self.text[self.at].isspace():
            self.at += 1

    def _takes(self, *symbols: str) -> str:
        """Read one of the symbols, the first that is there; empty without one."""
        self._skip()
        for symbol in symbols:
            if self.text.startswith(symbol, self.at):
                self.at += len(symbol)
                return symbol
        return ""

    def _rank(self, rank: int) -> float:
        if rank == len(RANKS):
            return self._sign()
        found = self._rank(rank + 1)
        while symbol := self._takes(*RANKS[rank]):
            found = RANKS[rank][symbol](found, self._rank(rank + 1))
        return found

    def _sign(self) -> float:
        if self._takes("-"):
            return -self._sign()
        if self._takes("+"):
            return self._sign()
        self._skip()
        if self.text.startswith("!", self.at) and not self.text.startswith("!=", self.at):
            self.at += 1
            return float(not self._sign())
        base = self._atom()
        if self._takes("^"):
            return float(base ** self._sign())
        return base

    def _atom(self) -> float:
        if self._takes("("):
            found = self._rank(0)
            self._close()
            return found
        number = self._number()
        return self._name() if number is None else number

    def _close(self) -> None:
        if not self._takes(")"):
            raise NotKnown(f"{self.text} has an open bracket")

    def _number(self) -> float | None:
        """A number at this place; None without one."""
        end = self.at
        seen_exponent = False
        while end < len(self.text):
            letter = self.text[end]
            if letter in "eE" and end > self.at and not seen_exponent:
                seen_exponent = True
            elif letter in "+-" and end > self.at and self.text[end - 1] in "eE":
                pass
            elif not (letter.isdigit() or letter == "."):
                break
            end += 1
        if not is_number(self.text[self.at : end]):
            return None
        found = float(self.text[self.at : end])
        self.at = end
        return found

    def _name(self) -> float:
        """A constant, a keyword of thermo, a variable or a function."""
        end = self.at
        while end < len(self.text) and (self.text[end].isalnum() or self.text[end] in "_"):
            end += 1
        name = self.text[self.at : end]
        if not name:
            raise NotKnown(f"{self.text} is not a formula")
        self.at = end
        if self.text.startswith("(", self.at):
            self.at += 1
            return self._call(name)
        if name.startswith("v_"):
            return self._variable(name[2:])
        if name in CONSTANTS:
            return CONSTANTS[name]
        if name in self.facts:
            return self.facts[name]
        raise NotKnown(f"{name} is a result of the simulation", is_result=True)

    def _variable(self, name: str) -> float:
        variable = self.interpreter.variables.get(name)
        if variable is None:
            raise NotKnown(f"there is no variable {name}")
        if variable.style == "vector" or (variable.style == "atom" and "x" not in self.facts):
            raise NotKnown(f"the variable {name} has one value per particle", is_result=True)
        if variable.style == "result":
            raise NotKnown(variable.text, is_result=True)
        return self.interpreter.evaluate(variable.text, **self.facts)

    def _is_defined(self) -> float:
        """is_defined(CATEGORY, NAME), whose words are no formulas."""
        end = self.text.find(")", self.at)
        words = [each.strip() for each in self.text[self.at : max(end, self.at)].split(",")]
        self.at = max(end, self.at) + 1
        if end >= 0 and len(words) == 2:
            known = self.interpreter.variables
            found = (
                words[1] in known
                if words[0] == "variable"
                else self.interpreter.on_defined(words[0], words[1])
            )
            if found is not None:
                return float(found)
        raise NotKnown(f"is_defined({','.join(words)}) is not known; give a category and a name")

    def _call(self, name: str) -> float:
        if name == "is_defined":
            return self._is_defined()
        given: list[float] = []
        if not self._takes(")"):
            given.append(self._rank(0))
            while self._takes(","):
                given.append(self._rank(0))
            self._close()
        if name in FUNCTIONS and len(given) == FUNCTIONS[name][0]:
            return float(FUNCTIONS[name][1](*given))
        if name == "random" and len(given) == 3:
            return self.interpreter._random.uniform(given[0], given[1])
        if name == "normal" and len(given) == 3:
            return self.interpreter._random.gauss(given[0], given[1])
        elapsed = self.facts["elapsed"] * self.facts.get("dt", math.nan)
        if name == "vdisplace" and len(given) == 2:
            return given[0] + given[1] * elapsed
        if name == "swiggle" and len(given) == 3:
            return given[0] + given[1] * math.sin(2 * math.pi * elapsed / given[2])
        if name == "cwiggle" and len(given) == 3:
            return given[0] + given[1] * (1 - math.cos(2 * math.pi * elapsed / given[2]))
        if name == "ramp" and len(given) == 2 and "run_steps" in self.facts:
            return given[0] + (given[1] - given[0]) * self.facts["elapsed"] / self.facts["run_steps"]
        raise NotKnown(f"{name}({', '.join(map(shortest, given))}) is not a function of numbers")
