"""Small Kedro project with the hooks of tracking: one pipeline that works, one that fails and one that is not tracked."""

import subprocess
import sys
import textwrap
from pathlib import Path

import yaml
from helpers.yaml_files import read_yaml

REPOSITORY = Path(__file__).resolve().parents[2]
FILES = {
    "pyproject.toml": """
        [tool.kedro]
        package_name = "small_road"
        project_name = "small"
        kedro_init_version = "1.7.0"
        source_dir = "src"
    """,
    ".telemetry": "consent: false",
    "src/small_road/__init__.py": "",
    "src/small_road/settings.py": """
        from mlsroad_pipeline.hooks.mlflow_run import MlflowDetailsHooks

        HOOKS = (MlflowDetailsHooks(),)
        CONFIG_LOADER_ARGS = {
            "base_env": "base", "default_run_env": "local",
            "config_patterns": {"mlflow": ["mlflow*", "mlflow*/**", "**/mlflow*"]},
        }
    """,
    "src/small_road/pipeline_registry.py": """
        from dataclasses import dataclass

        import numpy as np
        from kedro.pipeline import Node, Pipeline
        from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
        from mlsroad_pipeline.algorithms.models.bundle import ModelBundle


        @dataclass(frozen=True)
        class Forest:
            n_trees: int = 200
            depth: int | None = None


        @dataclass
        class Source:
            path: str


        @dataclass
        class Task:
            inputs: dict


        def tasks(files: list, execution: dict) -> dict:
            return {"test.a.scene_00000": Task({"files": [Source(path) for path in files]})}


        def evaluate(tasks, forest: Forest, execution: dict, n_workers: int, note: str):
            assert forest == Forest(100) and execution["backend"] == "loky" and n_workers == 2 and len(note) == 7000
            table = labelling_scores(np.array([[8, 2], [0, 0]]), method="demo", split="test", classes=["road", "car"])
            return table, np.zeros((4, 4, 3), np.uint8), "<!DOCTYPE html><html></html>"


        def train(forest: Forest):
            metadata = {"classes": ["road", "car"]}
            return ModelBundle("demo", {"n": np.array([forest.n_trees])}, metadata)


        def fail(forest: Forest):
            raise RuntimeError("planted")


        def register_pipelines():
            execution = ["params:execution", "params:execution.n_workers"]
            good = Pipeline([
                Node(tasks, ["params:files", "params:execution"], "tasks"),
                Node(evaluate, ["tasks", "params:forest", *execution, "params:note"], ["scores", "picture", "report"]),
                Node(train, "params:forest", "model"),
            ])
            silent = Pipeline([Node(train, "params:forest", "unregistered")])
            return {"__default__": good, "bad": Pipeline([Node(fail, "params:forest", "nothing")]), "silent": silent}
    """,
    "conf/base/catalog.yml": """
        scores:
          type: mlsroad_pipeline.datasets.report_files.ScoresDataset
          filepath: data/scores/demo.csv
        picture:
          type: mlsroad_pipeline.datasets.report_files.FigureDataset
          filepath: data/demo_birds_eye.png
        report:
          type: mlsroad_pipeline.datasets.report_files.HtmlReportDataset
          filepath: data/report.html
        model:
          type: mlsroad_pipeline.datasets.model_registry_dataset.RegisteredModelDataset
          name: mlsroad-demo
    """,
    "run.py": """
        import sys
        from pathlib import Path
        from kedro.framework.session import KedroSession
        from kedro.framework.startup import bootstrap_project

        project = Path(__file__).parent
        bootstrap_project(project)
        for name in (["silent"], ["__default__"], ["bad"]):
            with KedroSession.create(project_path=project) as session:
                try:
                    session.run(pipeline_names=name)
                except RuntimeError as error:
                    assert str(error) == "planted", error
    """,
}


def write_and_run(root):
    """Write the project, run its pipelines from another folder, and return its root."""
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(textwrap.dedent(text))
    config = read_yaml(REPOSITORY / "conf" / "base" / "mlflow.yml")
    config["tracking"]["disable_tracking"]["pipelines"] = ["silent"]
    (root / "conf" / "local").mkdir()
    (root / "conf" / "base" / "mlflow.yml").write_text(yaml.safe_dump(config))
    raw = [root / "raw" / name for name in ("a.laz", "b.laz")]
    raw[0].parent.mkdir()
    for path in raw:
        path.write_text(path.name)
    parameters = {
        "forest": {"n_trees": 100}, "files": [str(path) for path in raw], "unused": 1,
        "execution": {"backend": "loky", "n_workers": 2}, "note": "x" * 7000,
    }  # fmt: skip
    (root / "conf" / "base" / "parameters.yml").write_text(yaml.safe_dump(parameters))
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@example.org", "-C", str(root)]
    subprocess.run([*git, "init", "-q"], check=True)
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "first"], check=True)
    elsewhere = root.parent / "elsewhere"
    elsewhere.mkdir()
    environment = {"PYTHONPATH": str(REPOSITORY / "src"), "PATH": "/usr/bin:/bin", "HOME": str(root.parent)}
    done = subprocess.run(
        [sys.executable, str(root / "run.py")],
        cwd=elsewhere,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert list(elsewhere.iterdir()) == []
    return root
