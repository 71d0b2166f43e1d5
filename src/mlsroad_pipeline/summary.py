"""What `make run` ends with: the scores, where the report lies, how to look at the runs."""

import sys
from pathlib import Path

import pandas as pd

REPORTING = Path("data/08_reporting")


def main() -> int:
    """Print the table of scores, the report's path and the MLflow command.

    Returns
    -------
    int
        0, or 1 if there are no scores.
    """
    table = REPORTING / "comparison.csv"
    if not table.is_file():
        sys.stderr.write(f"{table} is not there: run `kedro run` first\n")
        return 1
    found = [pd.read_csv(path) for path in (table, REPORTING / "detection_comparison.csv") if path.is_file()]
    lines = [
        *("\n" + part.to_string(index=False, float_format="{:.3f}".format) for part in found),
        "",
        f"report:  {(REPORTING / 'report.html').resolve()}",
        "MLflow:  .venv/bin/mlflow ui --backend-store-uri sqlite:///mlflow.db",
        "label:   .venv/bin/kedro run --pipeline=label --params=label.survey=FILE_OR_FOLDER,label.output=FOLDER",
        "",
    ]
    sys.stdout.write("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
