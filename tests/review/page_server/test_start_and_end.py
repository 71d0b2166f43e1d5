"""Start and end of a page: the browser, a survey or a store that is replaced meanwhile, a kill."""

import json
import os
import signal
import subprocess
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path
from urllib.parse import unquote

import pytest
from helpers.corrected import PLACES, object_rows, write_inventory
from helpers.page_output import COMMAND, Served, write_output

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.review.corrections import open_corrections
from mlsroad_pipeline.review.page_server.access import RedirectFile
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey


def test_the_browser_is_started_without_the_token_in_its_arguments(tmp_path):
    folder, browser, told = tmp_path / "out put", tmp_path / "browser", tmp_path / "told"
    write_output(folder)
    browser.write_text(f'#!/bin/sh\necho "$@" > "{told}.new"\nmv "{told}.new" "{told}"\nsleep 30\n', encoding="utf-8")
    browser.chmod(0o700)
    with subprocess.Popen(
        [COMMAND, "open", folder], stdout=subprocess.PIPE, text=True,
        env=os.environ | {"BROWSER": f"{browser} %s &", "PYTHONUNBUFFERED": "1"},
    ) as process:  # fmt: skip
        try:
            server = Served(process, process.stdout.readline())
            for _ in range(200):
                if told.exists():
                    break
                time.sleep(0.05)
            address = told.read_text(encoding="utf-8").strip()
            assert "token" not in address and address.startswith("file:///")
            file = Path(unquote(address.removeprefix("file://")))
            assert file.stat().st_mode & 0o777 == 0o600 and server.address in file.read_text(encoding="utf-8")
            assert server.ask("/?token=wrong")[0] == 401 and file.exists()
            foreign = {"Sec-Fetch-Site": "cross-site"}
            assert server.ask("/?token=wrong", headers=foreign)[0] == 403
            path = server.address.partition(str(server.port))[2]
            status, headers, content = server.ask(path, headers=foreign)  # as a browser says of a file
            assert status == 200 and b'content="0;url=/"' in content
            server.cookie = headers["set-cookie"].partition(";")[0]
            assert server.ask("/")[0] == 200 and server.ask(path, headers={"Cookie": None})[0] == 401
            assert "The address was used" in process.stdout.readline() + process.stdout.readline()
            assert not file.exists()
        finally:
            process.terminate()


def test_a_file_system_without_permissions_gets_no_address(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "mkstemp", lambda **given: _readable_by_all(tmp_path / "open.html"))
    with pytest.raises(ReadError, match="does not keep permissions"):
        RedirectFile("http://127.0.0.1:1/?token=x", tmp_path)
    assert not (tmp_path / "open.html").exists()


def _readable_by_all(path):
    path.touch()
    path.chmod(0o644)
    return os.open(path, os.O_RDWR), str(path)


def test_decisions_about_a_survey_that_was_labelled_again_are_refused(tmp_path):
    write_output(tmp_path)
    survey = ServedSurvey(OutputFolder.find(tmp_path), user="ann")
    accept = {"action": "accept", "object_id": 1}
    assert survey.decide(accept) == {"ids": [1]}
    write_inventory(tmp_path, object_rows(places=PLACES[::-1]))
    with pytest.raises(ReadError, match="labelled again since the page was opened"):
        survey.decide(accept)
    survey.close()


@pytest.mark.parametrize("how", ["deleted", "replaced", "empty"])
def test_a_store_that_was_replaced_is_noticed_and_no_decision_is_lost(tmp_path, how):
    write_output(tmp_path)
    survey = ServedSurvey(OutputFolder.find(tmp_path), user="ann")
    survey.decide({"action": "accept", "object_id": 1})
    path = tmp_path / "corrections.sqlite"
    other = tmp_path / "other.sqlite"
    other.write_bytes(path.read_bytes() if how == "replaced" else b"")
    if how == "deleted":
        path.unlink()
    else:
        os.replace(other, path)
    for ask in (
        lambda: survey.decide({"action": "reject", "object_id": 2}),
        lambda: survey.undo({"ids": [1]}),
        survey.status,
        survey.corrections,
    ):
        with pytest.raises(ReadError, match=r"was replaced or deleted while it was open: its decisions up to then are"):
            ask()
    survey.close()
    (kept,) = tmp_path.glob("corrections-kept-*.sqlite")
    os.replace(kept, path)
    for end in ("-wal", "-shm"):
        path.with_name(path.name + end).unlink(missing_ok=True)
    with open_corrections(tmp_path) as store:
        assert [(d.correction.action, d.correction.object_id) for d in store.current()] == [("accept", 1)]


def _serve(folder, port, address):
    """Serve in a process that is forked from this one, which has the libraries already."""
    from mlsroad_pipeline.review.page_server.server import serve

    serve(ServedSurvey(OutputFolder.find(folder), user="ann"), port=port, browser=False, show=address.send)


def test_no_answered_decision_is_lost_by_a_kill(tmp_path):
    folder = tmp_path / "out"
    write_output(folder)
    answered = []
    for moment in range(10):
        here, there = get_context("fork").Pipe(duplex=False)
        process = get_context("fork").Process(target=_serve, args=(folder, 0, there))
        process.start()
        there.close()
        server = Served(process, here.recv())
        server.sign_in()
        end = time.monotonic() + 0.01 + 0.02 * moment
        killed = False
        while not killed:
            status, answer = server.post("/api/decide", {"action": "accept", "object_id": 1 + len(answered) % 5})
            assert status == 200, answer
            answered += answer["ids"]
            if time.monotonic() > end:
                os.kill(process.pid, signal.SIGKILL)
                killed = True
        process.join()
        here.close()
    with open_corrections(folder) as store:
        assert {decision.identifier for decision in store.current()} >= set(answered)
    assert len(answered) >= 10
    assert json.loads((folder / ".mlsroad/0123456789ab/run.json").read_text(encoding="utf-8"))["state"] == "finished"
