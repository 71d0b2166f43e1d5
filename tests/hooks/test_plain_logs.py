"""File names cannot move the cursor, colour a terminal or forge lines of a log."""

import logging
from pathlib import Path

from mlsroad_pipeline.commands.console import shown_path
from mlsroad_pipeline.hooks.plain_logs import PlainLogsHooks


def test_records_of_the_package_are_plain(caplog):
    PlainLogsHooks().after_context_created()
    PlainLogsHooks().after_context_created()
    caplog.set_level(logging.INFO)
    path = Path("/data/a\x1b[2J\nERROR forged.laz")
    logging.getLogger("mlsroad_pipeline.x").info("%s: %d points of %s", path, 7, f"{path}")
    logging.getLogger("mlsroad_pipeline.x").error("%s\n%s", "failed", "Traceback:\n  File \x1b[31m")
    logging.getLogger("another").info("%s", "\x1b[0m")
    assert caplog.messages == [
        "/data/a\\x1b[2J ERROR forged.laz: 7 points of /data/a\\x1b[2J\nERROR forged.laz",
        "failed\nTraceback:\nFile \\x1b[31m",
        "\x1b[0m",
    ]


def test_paths_of_results_are_plain():
    assert shown_path("/data/a\x1b[31m.laz") == "/data/a\\x1b[31m.laz"
