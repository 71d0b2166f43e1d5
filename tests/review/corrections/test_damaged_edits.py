"""Damaged files that come back are imported or refused in one line, and what was imported can be delivered."""

import numpy as np
import pytest
from helpers.corrected import save_as_tables
from helpers.mutations import mutated_geopackage
from helpers.page_output import write_output
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections.store import NAME as STORE
from mlsroad_pipeline.review.delivery.files import Delivery


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labelled")
    write_output(folder / "out", crs="EPSG:25832")
    save_as_tables(folder / "out/inventory.gpkg", folder / "tables.gpkg")
    return folder


@pytest.mark.parametrize("edited", ["out/inventory.gpkg", "tables.gpkg"])
def test_damaged_geopackages(labelled, tmp_path, edited):
    sound, codes = (labelled / edited).read_bytes(), []
    for case in range(15):
        path = tmp_path / f"edited_{case}.gpkg"
        path.write_bytes(mutated_geopackage(sound, np.random.default_rng([case, len(edited)])))
        (labelled / "out" / STORE).unlink(missing_ok=True)
        done = CliRunner().invoke(app, ["corrections", "import", str(path), str(labelled / "out"), "--many-deleted"])
        assert done.exit_code == 0 or done.output.count("\n") == 1, f"{path}: {done.output}"
        assert "--verbose shows the traceback" not in done.output, f"{path}: {done.output}"
        assert len(Delivery(labelled / "out").corrected.objects) < 20
        codes.append(done.exit_code)
    assert {*codes} == {0, 1}
