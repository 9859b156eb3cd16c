"""Functions of Taichi that granflow replaces; no other module replaces any.

Taichi 1.7 reads, formats and parses the source of every function again wherever it is inlined, which took
longer than all other work of a start; Quadrants also transforms each kernel twice. `shorten_front_end` and
`shorten_front_end_of_quadrants` are applied when `kernel_language` imports the module, because the former
also concerns decorators; `prepare_program` is applied once per process before the first kernel is compiled.

    replaced                                        reason and gain
    kernel_impl.getsourcelines                      a hundredth of the time: no tokenizer
    kernel_impl.textwrap.fill                       formats lines that need none
    kernel_impl.ast.parse, transform_tree           trees are used again; with the two above, half of the
                                                    time in which syntax trees are built
    kernel_impl._inside_class                       searches all modules for each decorator
    Kernel._try_load_fastcache of Quadrants         the first of two transformations of each kernel finds the
                                                    members of dataclasses that it reads: half of the time
                                                    in which syntax trees are built
    _func_base.get_source_info_and_src, textwrap    as getsourcelines and fill of Taichi
    unpack_ast_struct_expressions of Quadrants      walks all trees for members of dataclasses
    inspect.modulesbyfile                           all modules are searched for the one that executes an
                                                    import: 0.3 s per start
    Struct._register_members                        makes a class per struct instead of one per kind
    get_pos_info of ASTTransformerContext           formats the source of every node of every kernel, needed
                                                    or not: 0.5 s per start
    get_traceback of impl, matrix and snode         formats the call stack of each field, which reads some 60
                                                    source files
    Program.compile_kernel                          signals end the process while it compiles, see `around`
    FieldsBuilder._finalize, Program.create_ndarray show fields and arrays of the user's program, which a
                                                    restart of Taichi would destroy

`engine.fields` also changes the class of the fields of granflow, so that the host reads their memory.
"""

import ast
import inspect
import linecache
import sys
import textwrap
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache, partial
from pathlib import Path
from re import Pattern
from types import SimpleNamespace
from typing import Any
from weakref import WeakSet

# The front end of Taichi: source text and syntax trees.

# For each decorated function of a module, Taichi asks `inspect` for the module that executes the import,
# which is not found: without this entry, `inspect` searches all modules every time.
inspect.modulesbyfile.setdefault("<frozen importlib._bootstrap>", "_frozen_importlib")

PACKAGE = str(Path(__file__).parent)
"""Folder of the package."""


def shorten_front_end(kernel_impl: Any, struct: Any) -> None:
    """Make Taichi read and parse each function once.

    kernel_impl, struct:  modules of `taichi.lang`, of which names are replaced
    """
    struct.Struct._register_members = set_member_class
    trees = TreePool()
    kernel_impl.getsourcelines = source_lines
    kernel_impl._inside_class = partial(inside_class, kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES)
    kernel_impl.textwrap = SimpleNamespace(fill=filled, dedent=textwrap.dedent)
    kernel_impl.ast = SimpleNamespace(parse=trees.parse)
    kernel_impl.transform_tree = trees.returning(kernel_impl.transform_tree)


def shorten_front_end_of_quadrants(lang: Any) -> None:
    """Make Quadrants read the source of each function once, and transform kernels of granflow once.

    lang:  the package `quadrants.lang`, of whose modules names are replaced
    """
    kernel = lang.kernel_impl.Kernel  # the name `kernel` of the package is the decorator, not the module
    kernel._try_load_fastcache = without_first_pass(kernel._try_load_fastcache)
    read = lang._func_base.get_source_info_and_src
    lang._func_base.get_source_info_and_src = source_reader(read, lang._wrap_inspect.FunctionSourceInfo)
    lang._func_base.textwrap = SimpleNamespace(fill=filled, dedent=textwrap.dedent)
    dataclasses = lang._kernel_impl_dataclass
    dataclasses.unpack_ast_struct_expressions = if_any_member(dataclasses.unpack_ast_struct_expressions)


def without_first_pass(load: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `_try_load_fastcache`: the members of dataclasses that a kernel reads, None if they are unknown.

    Kernels of granflow have no dataclass among their arguments.
    """

    def used_members(kernel: Any, arguments: tuple, key: Any) -> set[str] | None:
        found = load(kernel, arguments, key)
        if found is not None or not kernel.func.__code__.co_filename.startswith(PACKAGE):
            return found
        return kernel.used_py_dataclass_parameters_by_key_enforcing.setdefault(key, set())

    return used_members


def source_reader(
    read: Callable[[Any], tuple[Any, list[str]]], place_of: Callable[..., Any]
) -> Callable[[Any], tuple[Any, list[str]]]:
    """Wraps `get_source_info_and_src` of Quadrants: place of a function, and its lines.

    place_of:  makes a place of its names and line numbers
    """
    known: dict[Any, tuple[Any, list[str]]] = {}

    def read_once(function: Any) -> tuple[Any, list[str]]:
        code = function.__code__
        if not code.co_filename.startswith(PACKAGE):
            return read(function)
        if code not in known:
            lines, first = source_lines(function)
            place = place_of(
                function_name=function.__name__,
                filepath=code.co_filename,
                start_lineno=first,
                end_lineno=first + len(lines) - 1,
            )
            known[code] = place, lines
        return known[code]

    return read_once


def if_any_member(unpack: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `unpack_ast_struct_expressions` (tree, members), which does nothing without members."""

    def unpacked(tree: Any, struct_locals: set[str]) -> Any:
        return unpack(tree, struct_locals) if struct_locals else tree

    return unpacked


def source_lines(function: Callable[..., Any]) -> tuple[list[str], int]:
    """Lines of a function with its decorators, and number of the first, as from `inspect.getsourcelines`.

    It takes a hundredth of the time: the indentation shows the end of a function, not the tokenizer.
    """
    code = inspect.unwrap(function).__code__
    if not code.co_filename.startswith(PACKAGE):  # a file may change during the process, or there is none
        return inspect.getsourcelines(function)
    lines = linecache.getlines(code.co_filename)
    first = code.co_firstlineno - 1
    return lines[first : end_of_function(lines, first)], code.co_firstlineno


def end_of_function(lines: Sequence[str], first: int) -> int:
    """Index after the last line of a function in formatted code: its body is indented further than its
    header.

    lines:  of the file
    first:  index of the first decorator, or of the header
    """
    indentation = _indentation(lines[first])
    is_header = True
    end = first + 1
    for k in range(first, len(lines)):
        text = lines[k].strip()
        if not is_header and text and _indentation(lines[k]) <= indentation and not text.startswith(")"):
            break
        is_header = is_header and not text.startswith("def ")
        end = k + 1 if text else end
    return end


def _indentation(line: str) -> int:
    """Number of blanks at the beginning of a line."""
    return len(line) - len(line.lstrip())


def set_member_class(struct: Any) -> None:
    """Give a struct properties for its members, as `_register_members` of Taichi, which makes a class per
    struct."""
    struct.__class__ = _member_class(struct.__class__, tuple(struct.keys))


@cache
def _member_class(base: Any, keys: tuple[str, ...]) -> type:
    """Class of structs with these members."""
    base._instance_count += 1
    members = {key: property(base._make_getter(key), base._make_setter(key)) for key in keys}
    return type(f"{base.__name__}{base._instance_count}", (base,), members)


def inside_class(patterns: Sequence[Pattern[str]], level_of_class_stackframe: int) -> bool:
    """Whether a decorator is applied in a class body, as `_inside_class` of Taichi, which searches all
    modules.

    patterns:                   of the statement that creates a class
    level_of_class_stackframe:  call frames from here to that statement
    """
    frame = sys._getframe(level_of_class_stackframe)
    statement = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    return any(pattern.match(statement) for pattern in patterns)


def filled(line: str, **options: Any) -> str:
    """The line as from `textwrap.fill` with a width above its length."""
    return textwrap.fill(line, **options) if "\t" in line or not line.isascii() else line.rstrip()


class TreePool:
    """Syntax trees of device functions that are not in use, with all their nodes, by source text."""

    def __init__(self) -> None:
        self._free: dict[str, list[list[Any]]] = {}
        self._used: dict[int, tuple[str, list[Any]]] = {}

    def parse(self, text: str) -> Any:
        """Syntax tree of a text; one of the pool, if possible."""
        free = self._free.setdefault(text, [])
        nodes = free.pop() if free else [*ast.walk(ast.parse(text))]
        self._used[id(nodes[0])] = text, nodes
        return nodes[0]

    def returning(self, transform: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Wraps `transform_tree` (tree, context), so that the tree of an inlined function returns to the
        pool.

        Trees of kernels and real functions lose their arguments in it; a failure ends with an exception.
        """

        def transform_and_return(tree: Any, context: Any) -> Any:
            text, nodes = self._used.pop(id(tree))
            found = transform(tree, context)
            if not (context.is_kernel or context.is_real_function):
                for node in nodes:  # the value of a node, and the object of a method call
                    node.__dict__.pop("ptr", None)
                    node.__dict__.pop("caller", None)
                self._free[text].append(nodes)
            return found

        return transform_and_return


# The program: positions in error messages, compilation, and fields of others.

around: Callable[[], AbstractContextManager[None]] = nullcontext
"""Context in which kernels are compiled. Compilation holds the interpreter lock for seconds, so that no
Python signal handler runs: the command line sets a context in which signals end the process without Python.
"""


def prepare_program(
    taichi: Any, is_quadrants: bool, on_fields: Callable[[Any], None], on_array: Callable[[], None]
) -> None:
    """Replace functions of the running part of the kernel language.

    taichi:     the module of the kernel language
    on_fields:  called with each builder whose fields are allocated
    on_array:   called for each array that is allocated
    """
    program = taichi._lib.core.Program
    contexts = taichi.lang.ast.ast_transformer_utils
    if is_quadrants:
        program.compile_kernel = in_context(program.compile_kernel)
        contexts.ASTTransformerFuncContext.memoized_get_pos_info = position_in_source
    else:
        program.compile_kernel = guarded(program.compile_kernel)
        contexts.ASTTransformerContext.get_pos_info = position_in_source
    for module in (taichi.lang.impl, taichi.lang.matrix, taichi.lang.snode):
        module.get_traceback = _no_traceback
    finalize = taichi.FieldsBuilder._finalize
    create_ndarray = program.create_ndarray

    def finalize_and_notify(builder: Any, *arguments: Any, **options: Any) -> Any:
        on_fields(builder)
        return finalize(builder, *arguments, **options)

    def create_and_notify(*arguments: Any, **options: Any) -> Any:
        on_array()
        return create_ndarray(*arguments, **options)

    taichi.FieldsBuilder._finalize = finalize_and_notify
    program.create_ndarray = create_and_notify


def position_in_source(context: Any, node: Any) -> str:
    """File and line of a syntax tree node for error messages."""
    number = node.lineno + context.lineno_offset
    line = f'File "{context.file}", line {number}, in {context.func.func.__name__}:\n'
    return line + context.src[node.lineno - 1] + "\n"


def _no_traceback(stacklevel: int = 1) -> str:
    return ""


def in_context(compile_kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `Program.compile_kernel` of Quadrants, which calls it once per kernel: every call is in
    `around`."""

    def compile_in_context(*arguments: Any) -> Any:
        with around():
            return compile_kernel(*arguments)

    return compile_in_context


def guarded(compile_kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `Program.compile_kernel` of Taichi, so that the first call per kernel runs in the context
    `around`.

    compile_kernel:  function (program, configuration, capabilities, kernel)
    Returns:         function with the same arguments and result

    Taichi calls the function at every launch; only the first call of a kernel compiles it.
    """
    compiled: WeakSet[Any] = WeakSet()  # not by id: the id of a deleted kernel is used again

    def compile_in_context(program: Any, configuration: Any, capabilities: Any, kernel: Any) -> Any:
        if kernel in compiled:
            return compile_kernel(program, configuration, capabilities, kernel)
        with around():
            done = compile_kernel(program, configuration, capabilities, kernel)
        compiled.add(kernel)
        return done

    return compile_in_context
