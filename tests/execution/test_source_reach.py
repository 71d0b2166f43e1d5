"""Source files reachable from a module: its imports, at module level or inside functions, and theirs."""

import ast
import subprocess
import sys

import pytest

from mlsroad_pipeline.execution import fingerprints
from mlsroad_pipeline.execution.fingerprints import PROJECT, all_sources, in_science, reachable_sources, source_of


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Project of nine files: a imports b inside a function, b imports c, d imports its package by name."""
    files = {
        "algorithms/__init__.py": "",
        "algorithms/a.py": "def f():\n    from mlsroad_pipeline.algorithms.b import g\n    return g",
        "algorithms/b.py": "from mlsroad_pipeline.algorithms import c\nimport numpy",
        "algorithms/c.py": "import os",
        "algorithms/own/__init__.py": "import mlsroad_pipeline.algorithms.c",
        "algorithms/own/d.py": "import importlib\ndef h(n):\n    return importlib.import_module(n)",
        "algorithms/own/e.py": "x = 1",
        "algorithms/own/below/f.py": "from mlsroad_pipeline.algorithms.own.e import x",
        "papers/g.py": "x = 1",
    }
    for name, text in files.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.setattr(fingerprints, "project_folder", lambda: tmp_path)
    return tmp_path


def reached(project, *names):
    found = reachable_sources([f"{PROJECT}.algorithms.{name}" for name in names])
    return [file.relative_to(project).as_posix().removeprefix("algorithms/") for file in found]


def test_imports_are_followed_also_those_inside_functions(project):
    assert reached(project, "a") == ["__init__.py", "a.py", "b.py", "c.py"]
    assert reached(project, "c") == ["__init__.py", "c.py"]


def test_the_package_of_a_module_is_imported_with_it(project):
    assert reached(project, "own.e") == ["__init__.py", "c.py", "own/__init__.py", "own/e.py"]


def test_a_module_that_imports_by_name_reaches_its_whole_package_and_the_papers(project):
    assert reached(project, "own.d") == [
        "__init__.py", "a.py", "b.py", "c.py", "own/__init__.py", "own/below/f.py", "own/d.py", "own/e.py",
        "papers/g.py",
    ]  # fmt: skip


def test_an_edited_source_is_read_again(project):
    assert "b.py" not in reached(project, "c")
    (project / "algorithms" / "c.py").write_text("from mlsroad_pipeline.algorithms import b")
    assert "b.py" in reached(project, "c")


def test_nothing_outside_counts(project):
    assert reached(project, "no.such.module") == []
    assert source_of("numpy") is None
    assert len(all_sources()) == 9


def test_what_a_running_program_imported_was_foreseen():
    name = f"{PROJECT}.papers.yu2016.visual_words.detector"
    script = f"import sys, {name}; print([m for m in sys.modules if m.startswith({PROJECT!r})])"
    printed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    loaded = [module for module in ast.literal_eval(printed) if in_science(module)]
    assert {source_of(module) for module in loaded} <= set(reachable_sources([name]))
    assert len(reachable_sources([name])) < len(all_sources())


WITHOUT_METHODS = (
    *(f"shared.detection.{name}" for name in ("scoring", "references", "outcomes", "parts", "thresholds")),
    "shared.recognition.object_set",
    "yu2016.visual_words.detector",
)


@pytest.mark.parametrize("name", WITHOUT_METHODS)
def test_scores_and_descriptions_of_objects_do_not_depend_on_the_methods(name):
    """A module that reaches `models.methods` has the whole of `algorithms` and `papers` among its sources."""
    sources = reachable_sources([f"{PROJECT}.papers.{name}"])
    assert source_of(f"{PROJECT}.algorithms.models.methods") not in sources
    assert len(sources) < len(all_sources()) / 2
