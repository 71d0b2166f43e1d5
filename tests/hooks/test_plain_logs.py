"""File names cannot move the cursor, colour a terminal or forge lines of a log."""

import logging
import warnings
from pathlib import Path

from mlsroad_pipeline.commands.console import shown_path
from mlsroad_pipeline.hooks.plain_logs import PlainLogsHooks, silence


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


def test_warnings_that_a_user_cannot_act_on_are_dropped_and_others_shown():
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        silence()
        warnings.warn("'crs' was not provided.  The output dataset will not have projection information", stacklevel=1)
        warnings.warn("another", stacklevel=1)
    assert [str(entry.message) for entry in shown] == ["another"]
