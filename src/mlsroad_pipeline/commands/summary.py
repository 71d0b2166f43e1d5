"""Summary printed at the end of `make run`: scores, path of the report, and three further commands."""

import sys
from pathlib import Path

import pandas as pd

REPORTING = Path("data/08_reporting")
TABLES = ("comparison.csv", "image_comparison.csv", "detection_comparison.csv", "recognition_comparison.csv")
NEXT = (
    ("label a survey of your own", ".venv/bin/mlsroad label FILE_OR_FOLDER"),
    ("look at runs and models", ".venv/bin/mlflow ui --backend-store-uri sqlite:///mlflow.db"),
    ("compare all methods on five streets", "make compare"),
)


def main() -> int:
    """Print the score tables, the path of the report and further commands; return the exit status."""
    tables = [pd.read_csv(REPORTING / name) for name in TABLES if (REPORTING / name).is_file()]
    if not tables:
        sys.stderr.write(f"{REPORTING / TABLES[0]} does not exist: run `kedro run` first\n")
        return 1
    lines = [
        *("\n" + table.to_string(index=False, float_format="{:.3f}".format) for table in tables),
        "",
        f"Report: {(REPORTING / 'report.html').resolve()}",
        "",
        "Next:",
        *(f"  {what}:\n    {command}" for what, command in NEXT),
        "",
    ]
    sys.stdout.write("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
