"""The layout of the package: every module in a contract, imports downward only, and a bounded number of them."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import grimp
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = "mlsroad_pipeline"
SCIENCE = f"{PACKAGE}.algorithms"
LIMITS = {PACKAGE: (20, 60), SCIENCE: (16, 45)}
"""Container to the largest numbers of entries and of arrows between them."""


class Layers(NamedTuple):
    """A contract on the children of one container: the rank of each (0 is the top), and those outside of it."""

    ranks: dict[str, int]
    ignored: set[str]


def _contract(**keys: object) -> dict[str, Any]:
    """Return the only contract with the values of some keys."""
    contracts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (contract,) = [c for c in contracts if all(c.get(name) == value for name, value in keys.items())]
    return contract


def _layers(container: str) -> Layers:
    contract = _contract(type="layers", containers=[container])
    assert contract["exhaustive"]
    ranks = {name.strip(): rank for rank, line in enumerate(contract["layers"]) for name in line.split("|")}
    return Layers(ranks, set(contract.get("exhaustive_ignores", ())))


def _child(module: str, container: str) -> str | None:
    """Return the child of a container in which a module lies; None for a module outside and for the container."""
    return module.removeprefix(f"{container}.").partition(".")[0] if module.startswith(f"{container}.") else None


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph(PACKAGE, cache_dir=None)


def _arrows(graph: grimp.ImportGraph, container: str) -> dict[tuple[str, str], str]:
    """Return one import, as text, for each pair of different children of a container."""
    found = {}
    for importer in sorted(graph.modules):
        for imported in sorted(graph.find_modules_directly_imported_by(importer)):
            pair = _child(importer, container), _child(imported, container)
            if None not in pair and pair[0] != pair[1]:
                found.setdefault(pair, f"{importer} imports {imported}")
    return found


@pytest.mark.parametrize("container", LIMITS)
def test_every_module_is_in_a_contract_and_every_name_in_a_contract_is_a_module(graph, container):
    ranks, ignored = _layers(container)
    children = {_child(module, container) for module in graph.modules} - {None}
    assert children - set(ranks) == ignored
    assert set(ranks) - children == set()


@pytest.mark.parametrize("name", ["simulation", "formats", "execution", "surveys", "reporting", "label", "papers"])
def test_packages_beside_the_science_are_in_the_contract(name):
    assert name in _layers(PACKAGE).ranks


def test_the_contract_of_the_simulator_names_all_other_algorithms(graph):
    contract = _contract(name="The simulator needs core and geometry alone")
    needed = {f"{SCIENCE}.core", f"{SCIENCE}.geometry"}
    assert set(contract["forbidden_modules"]) == graph.find_children(SCIENCE) - needed


@pytest.mark.parametrize("container", LIMITS)
def test_no_import_points_upward(graph, container):
    ranks = _layers(container).ranks
    arrows = _arrows(graph, container)
    assert [text for (start, end), text in arrows.items() if ranks[start] >= ranks[end]] == []


@pytest.mark.parametrize("container", LIMITS)
def test_the_import_graph_stays_small(graph, container):
    arrows = _arrows(graph, container)
    entries = {name for pair in arrows for name in pair}
    most_entries, most_arrows = LIMITS[container]
    assert len(entries) <= most_entries, sorted(entries)
    assert len(arrows) <= most_arrows, sorted(arrows)


def _named_modules(path: Path) -> Iterator[str]:
    """Yield the modules of this package that a source names in strings, such as those for `import_module`."""
    text = path.read_text(encoding="utf-8")
    if re.search(rf"[\"']{PACKAGE}\.", text) is None:  # parsing takes nearly all of the time
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            match = re.fullmatch(rf"({PACKAGE}(?:\.\w+)+)(?::\w+)?", node.value)
            if match:
                yield match[1]


def test_no_module_of_a_higher_layer_is_named_in_a_string():
    ranks, source = _layers(PACKAGE).ranks, REPOSITORY / "src" / PACKAGE
    upward = []
    for path in sorted(source.rglob("*.py")):
        own = path.relative_to(source).with_suffix("").parts[0]
        for name in _named_modules(path):
            if own in ranks and ranks.get(_child(name, PACKAGE), len(ranks)) < ranks[own]:
                upward.append(f"{path.relative_to(source)}: {name}")
    assert upward == []
