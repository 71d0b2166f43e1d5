"""Scene stores and reports in an object store: a local S3 server. Needs the extra ``s3-test``."""

import json
import urllib.request

import pytest
from helpers.store import point_tasks, store_at, tree_digest

from mlsroad_pipeline.datasets.report_files import HtmlReportDataset
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset

moto = pytest.importorskip("moto.server", reason="moto is not installed (pip install mlsroad_pipeline[s3-test])")
s3fs = pytest.importorskip("s3fs", reason="s3fs is not installed (pip install mlsroad_pipeline[s3-test])")


@pytest.fixture
def bucket():
    """A bucket of a local server: the credentials of a dataset, and its file system."""
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    credentials = {"key": "a", "secret": "b", "client_kwargs": {"endpoint_url": f"http://{host}:{port}"}}
    try:
        files = s3fs.S3FileSystem(**credentials)
        files.mkdir("surveys")
        yield credentials, files
    finally:
        urllib.request.urlopen(urllib.request.Request(f"http://{host}:{port}/moto-api/reset", method="POST")).close()
        server.stop()


@pytest.mark.parametrize("backend", ["sequential", "loky"])
def test_a_store_on_s3_has_the_bytes_of_a_local_one(tmp_path, bucket, backend):
    credentials, files = bucket
    marks = tmp_path / "marks"
    marks.mkdir()
    local = store_at(tmp_path / "stage")
    local.save(point_tasks(marks))
    execution = {"backend": backend, "n_workers": 2, "progress": False}
    remote = SceneStoreDataset(filepath="s3://surveys/stage", credentials=credentials, execution=execution)
    remote.save(point_tasks(marks))
    files.get("surveys/stage", str(tmp_path / "copy"), recursive=True)
    assert tree_digest(tmp_path / "copy") == tree_digest(tmp_path / "stage")
    before = len(list(marks.iterdir()))
    files.rm("surveys/stage/s1/record.json")  # an interrupted run
    files.pipe_file("surveys/stage/manifest.json", b"")  # half of one
    remote.save(point_tasks(marks))
    assert len(list(marks.iterdir())) == before + 1
    assert remote.load()["s1"].load().xyz.tolist() == local.load()["s1"].load().xyz.tolist()
    assert json.loads(files.cat_file("surveys/stage/manifest.json"))["scenes"].keys() == {"s0", "s1", "s2"}
    assert not list(tmp_path.glob("**/s3:*"))


def test_a_report_on_s3(bucket):
    credentials, files = bucket
    HtmlReportDataset(filepath="s3://surveys/report.html", credentials=credentials).save("<!doctype html><p>done</p>")
    assert b"done" in files.cat_file("surveys/report.html")
