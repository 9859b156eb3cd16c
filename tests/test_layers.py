"""Structure of the package: imports between layers, layers that use Taichi."""

import ast
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "granflow"
LAYERS = (
    "errors", "arguments", "taichi_patches", "kernel_language", "device_functions", "visible_text", "units",
    "fields", "snapshot", "schema", "io", "geometry", "contact", "scene", "particles", "load", "plan",
    "engine", "parallel", "observers", "runs", "live", "simulation", "studies", "importing", "cli", "__main__"
)  # fmt: skip
"""From the lowest layer to the highest. The __init__ of the package re-exports names of all layers."""
TAICHI_LAYERS = {"device_functions", "contact", "geometry", "scene", "engine"}
VAGUE_NAMES = {"util", "utils", "core", "manager", "managers", "helpers", "misc", "common"}
TOP_LEVEL = {
    *("granflow", "scenes", "tests", "tools", "docs"),
    *("pyproject.toml", "constraints.txt", "README.md", "ARCHITECTURE.md", "LICENSE", "CHANGELOG.md"),
}
STUDIES_IMPORT = {
    "granflow", "granflow.arguments", "granflow.contact.material", "granflow.contact.registry",
    "granflow.contact.theory", "granflow.errors", "granflow.fields", "granflow.geometry.sphere",
    "granflow.load", "granflow.plan.cost", "granflow.runs.initial_particles", "granflow.scene.reader", "granflow.schema.document", "granflow.schema.faults", "granflow.schema.messages",
    "granflow.schema.model", "granflow.schema.quantities", "granflow.units", "granflow.visible_text"
}  # fmt: skip
"""Modules that studies may import, in addition to `granflow.studies`, `granflow.io` and
`granflow.scene.blocks`."""
FUNCTION_NODES = (ast.FunctionDef, ast.AsyncFunctionDef)
TAICHI_DECORATORS = {"func", "kernel", "real_func", "pyfunc"}


def module_name(path):
    """The dotted name of the module at a path."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules():
    """Every module of the package: its dotted name, path and syntax tree."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {module_name(path): (path, ast.parse(path.read_text(encoding="utf-8"))) for path in paths}


@cache
def imports(name):
    """The absolute dotted names of all imports in a module; submodules rather than their packages."""
    path, tree = modules()[name]
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolved(name, path, node)
            inner = [f"{base}.{alias.name}" for alias in node.names]
            found += [each if each in modules() else base for each in inner]
    return found


def resolved(name, path, node):
    """The absolute name of the module in a `from ... import`."""
    if not node.level:
        return node.module
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    stem = package[: len(package) - node.level + 1]
    return ".".join([*stem, *([node.module] if node.module else [])])


def layer(name):
    """The layer of a module of the package; None for the __init__ of the package and for other modules."""
    parts = name.split(".")
    return parts[1] if parts[0] == "granflow" and len(parts) > 1 else None


def functions():
    """Every function of the package, including nested functions: its location and its node."""
    for path, tree in modules().values():
        for node in ast.walk(tree):
            if isinstance(node, FUNCTION_NODES):
                yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node


def test_every_module_belongs_to_a_layer():
    assert not {name for name in modules() if layer(name) not in (None, *LAYERS)}


def test_modules_import_only_from_lower_layers():
    upward = [
        f"{name} imports {target}"
        for name in modules()
        for target in imports(name)
        if layer(name) and target.startswith("granflow")
        if layer(target) is None or LAYERS.index(layer(target)) > LAYERS.index(layer(name))
        if not (target == "granflow" and layer(name) in {"studies", "cli", "__main__"})
    ]
    assert not upward


def test_studies_import_only_the_public_interface():
    packages = ("granflow.studies", "granflow.io.", "granflow.scene.blocks.")
    internal = [
        f"{name} imports {target}"
        for name in modules()
        for target in imports(name)
        if layer(name) == "studies" and target.startswith("granflow")
        if target not in STUDIES_IMPORT and not target.startswith(packages)
    ]
    assert not internal


def test_imports_have_no_cycles():
    below = {name: {t for t in imports(name) if t in modules() and t != "granflow"} for name in modules()}
    below["granflow"] = set()
    while free := {name for name, targets in below.items() if not targets}:
        below = {name: targets - free for name, targets in below.items() if name not in free}
    assert not below


def test_one_module_imports_the_kernel_language():
    packages = {"taichi", "quadrants"}
    assert not [name for name in modules() if packages & {target.split(".")[0] for target in imports(name)}]
    users = {name for name in modules() if uses_kernel_language(name)}
    assert {layer(name) for name in users} == TAICHI_LAYERS


def uses_kernel_language(name):
    """True if a module imports `ti`, or reads it as an attribute of the module of the kernel language."""
    nodes = list(ast.walk(modules()[name][1]))
    sources = {"granflow.kernel_language", "granflow.device_functions"}
    froms = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module in sources]
    attributes = [ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)]
    return (
        any(alias.name == "ti" for node in froms for alias in node.names)
        or "kernel_language.ti" in attributes
    )


def test_taichi_modules_do_not_postpone_annotations():
    """`from __future__ import annotations` hides the types of a kernel from Taichi."""
    violations = [
        name
        for name in modules()
        if layer(name) in TAICHI_LAYERS and uses_kernel_language(name) and "__future__" in imports(name)
    ]
    assert not violations


def test_module_names_are_specific():
    assert not [name for name in modules() if VAGUE_NAMES & set(name.split("."))]


@pytest.mark.parametrize("name", [module_name(path) for path in sorted(PACKAGE.rglob("__init__.py"))])
def test_package_inits_only_re_export(name):
    def is_re_export(node):
        if isinstance(node, ast.Assign):
            return all(isinstance(t, ast.Name) and t.id in {"__all__", "_LOCATIONS"} for t in node.targets)
        if isinstance(node, ast.FunctionDef):
            return node.name in {"__getattr__", "__dir__"}
        if isinstance(node, ast.If):
            return ast.unparse(node.test) == "TYPE_CHECKING"
        if ast.unparse(node).startswith("os.environ.setdefault("):
            return name == "granflow"
        is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        return is_docstring or isinstance(node, (ast.Import, ast.ImportFrom))

    assert not [ast.unparse(node) for node in modules()[name][1].body if not is_re_export(node)]


def test_host_functions_of_the_taichi_layers_are_annotated():
    """The linter enforces annotations in the other layers; only functions compiled by Taichi may omit
    types."""

    def runs_in_taichi(node):
        return any(
            ast.unparse(d).split("(")[0].split(".")[-1] in TAICHI_DECORATORS for d in node.decorator_list
        )

    def is_annotated(node):
        named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        spread = [a for a in (node.args.vararg, node.args.kwarg) if a]
        missing = [a for a in [*named, *spread] if a.annotation is None and a.arg not in {"self", "cls"}]
        return not missing and (node.returns is not None or node.name == "__init__")

    positions = [str(Path("granflow", name)) for name in TAICHI_LAYERS]
    unannotated = [
        where
        for where, node in functions()
        if where.startswith(tuple(positions)) and not runs_in_taichi(node) and not is_annotated(node)
    ]
    assert not unannotated


def test_top_level_contains_only_listed_entries():
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listing.returncode:
        pytest.skip("not a git checkout")
    top = {name.split("/")[0] for name in listing.stdout.split("\0") if name}
    assert not {name for name in top if name not in TOP_LEVEL and not name.startswith(".")}
