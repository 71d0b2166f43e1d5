"""Run the project as a module: `python -m mlsroad_pipeline`, outside a project with the package's configuration."""

import os
import sys
from importlib.resources import files
from pathlib import Path

PACKAGE = "mlsroad_pipeline"
CONF_SOURCE = "--conf-source"


def main() -> None:
    """Run `kedro run` with the arguments of the command line."""
    arguments = sys.argv[1:]
    configuration = Path(str(files(PACKAGE) / "conf"))
    if not Path("conf").is_dir():
        os.environ.setdefault("KEDRO_LOGGING_CONFIG", str(configuration / "logging.yml"))
        os.environ.setdefault("DO_NOT_TRACK", "1")  # as in the file `.telemetry` of the project
        if not any(argument.split("=")[0] == CONF_SOURCE for argument in arguments):
            arguments = [f"{CONF_SOURCE}={configuration}", *arguments]
    from kedro.framework.cli.utils import find_run_command  # noqa: PLC0415  # Kedro configures the logging on import
    from kedro.framework.project import configure_project  # noqa: PLC0415

    configure_project(PACKAGE)
    find_run_command(PACKAGE)(args=arguments, standalone_mode=True)


if __name__ == "__main__":
    main()
