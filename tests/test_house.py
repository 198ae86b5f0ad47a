"""The house's rules: one direction of imports, one name for one thing, and files that can be read in one sitting."""

import ast
import copy
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import grimp
import pytest
from importlinter.api import read_configuration
from importlinter.contracts.acyclic_siblings import AcyclicSiblingsContract
from importlinter.contracts.forbidden import ForbiddenContract
from importlinter.contracts.layers import LayersContract

ROOT = Path(__file__).parents[1]
CONTRACTS = {"layers": LayersContract, "forbidden": ForbiddenContract, "acyclic_siblings": AcyclicSiblingsContract}
# What stands above what, a module for each floor; those on one floor are in one tuple.
FLOORS = (
    ("trainer.main",),
    ("trainer.commands.train",),
    ("trainer.studies.conduct", "trainer.viewer.replay_files", "trainer.bench.measure", "trainer.conformance.checker"),
    ("trainer.runs.run",),
    ("trainer.players.opening", "trainer.learning.stages"),
    ("trainer.config",),
    ("trainer.errors",),
)
# The world is for these alone (and trainer.corridor, which has it for everybody).
KNOW_THE_WORLD = ("trainer.viewer.", "trainer.bench.", "trainer.conformance.contract", "trainer.studies.generalise")


def forbidden_imports() -> list[tuple[str, str]]:
    """Every pair (who, whom) of which the first may not import the second."""
    pairs = []
    for floor, lower in enumerate(FLOORS):
        for upper in FLOORS[:floor]:
            pairs += [(module, above) for module in lower for above in upper]
        pairs += [(one, other) for one in lower for other in lower if one != other]
    every = [module for floor in FLOORS for module in floor]
    insides = ("corridor.world", "player", "connection", "decision_timing", "simulations.simulation")
    for inside in (f"corridor_server.{each}" for each in insides):
        pairs += [(module, inside) for module in every if not module.startswith(KNOW_THE_WORLD)]
    pairs += [("corridor_server.protocol.wire", "corridor_server.corridor.world")]
    pairs += [("corridor_server.protocol.messages", "corridor_server.player")]
    pairs += [("corridor_server.shared.given", "corridor_server.protocol.wire")]
    pairs += [("corridor_server.corridor.world", "corridor_server.player")]
    pairs += [("corridor_server.protocol.wire", "corridor_server.simulations.simulation")]
    for above in ("player", "decision_timing", "connection", "corridor.areas"):
        pairs += [("corridor_server.simulations.simulation", f"corridor_server.{above}")]
    return pairs + [("corridor_server.corridor.areas", module) for module in every]


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    return grimp.build_graph("corridor_server", "trainer", cache_dir=None)


@pytest.fixture(scope="module")
def contracts() -> list[Any]:
    read = read_configuration(str(ROOT / "pyproject.toml"))
    options = read["contracts_options"]
    return [CONTRACTS[each["type"]](each["name"], read["session_options"], each) for each in options]


def broken(contracts: list[Any], graph: grimp.ImportGraph) -> list[str]:
    return [each.name for each in contracts if not each.check(copy.deepcopy(graph), verbose=False).kept]


def test_every_import_goes_the_houses_way(contracts, graph):
    assert len(contracts) == 5
    assert broken(contracts, graph) == []


@pytest.mark.parametrize(("importer", "imported"), forbidden_imports())
def test_any_one_forbidden_import_is_seen(contracts, graph, importer, imported):
    assert {importer, imported} <= graph.modules
    changed = copy.deepcopy(graph)
    changed.add_import(importer=importer, imported=imported)
    assert broken(contracts, changed)


def sources() -> list[Path]:
    return [path for package in ("corridor_server", "trainer") for path in (ROOT / package).rglob("*.py")]


def written_by_hand() -> list[Path]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    endings = {".py", ".ts", ".css", ".md", ".sh", ".toml", ".yaml"}
    return [ROOT / name for name in listed if Path(name).suffix in endings and (ROOT / name).is_file()]


def test_no_two_modules_have_one_name_and_none_is_a_stdlib_modules():
    # A command's options and run() stand in commands/<command>.py; both packages have their main.py.
    names = Counter(path.stem for path in sources() if path.stem not in ("__init__", "main"))
    assert [name for name, count in names.items() if count > 1] == []
    assert set(names) & set(sys.stdlib_module_names) == set()


def test_no_two_classes_have_one_name():
    names = Counter(
        node.name
        for path in sources()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_no_file_is_over_400_lines():
    long = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in written_by_hand()}
    assert {name: lines for name, lines in long.items() if lines > 400} == {}
