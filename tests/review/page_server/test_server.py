"""The server of the page: who may ask, which files it gives, and which decisions it takes."""

import os
import socket
import subprocess

import pytest
from helpers.page_output import COMMAND, EVIL, FILES, served, write_output

from mlsroad_pipeline.review.corrections import ACTIONS, open_corrections
from mlsroad_pipeline.review.page_server.connections import MOST_CONNECTIONS, REQUEST_TIME

PRIVATE = (
    "/api/survey",
    "/api/corrections",
    "/first.bin",
    "/tiles/index.json",
    "/files/photos/1.jpg",
    "/report",
    "/static/page.js",
    "/",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("served") / "out put"
    write_output(place)
    (place.parent / "secret.jpg").write_bytes(b"secret")
    (place / "link.jpg").symlink_to(place.parent / "secret.jpg")
    (place / ".hidden.jpg").write_bytes(b"secret")
    return place


@pytest.fixture(scope="module")
def page(folder):
    with served(folder) as server:
        for path in PRIVATE:  # before anybody has signed in
            status, headers, content = server.ask(path)
            assert (status, headers["content-type"]) == (401, "text/plain; charset=utf-8"), path
            assert b"mlsroad open" in content
        cookie = server.sign_in()
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        server.until_ready()
        yield server


def test_a_token_is_valid_once(page):
    path = page.address.partition(str(page.port))[2]
    assert page.ask(path, headers={"Cookie": None})[0] == 401
    assert page.ask("/?token=", headers={"Cookie": None})[0] == 401
    assert page.ask("/", headers={"Cookie": f"mlsroad_{page.port}=x"})[0] == 401
    assert page.ask("/")[0] == 200


def test_every_answer_has_a_strict_policy(page):
    for path in (*PRIVATE, "/nothing"):
        headers = page.ask(path)[1]
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe-eval" not in policy
        assert ("unsafe-inline" in policy) == (path == "/report")
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cross-origin-resource-policy"] == "same-origin"
    assert page.ask("/report")[1]["content-security-policy"].startswith("sandbox allow-scripts;")


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "localhost.evil.example:80"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_requests_of_other_pages_are_refused(page, headers):
    assert page.ask("/api/survey", headers=headers)[0] == 403
    assert page.post("/api/decide", {"action": "accept", "object_id": 1}, **headers)[0] == 403
    assert page.json("/api/corrections")["decisions"] == []


def test_a_change_needs_an_origin_json_and_a_known_method(page):
    body = {"action": "accept", "object_id": 1}
    assert page.post("/api/decide", body, Origin=None)[0] == 403
    assert page.post("/api/decide", body, **{"Content-Type": "text/plain"})[0] == 403
    assert page.post("/api/decide", {"x": "y" * 2_000_000})[0] == 403
    assert page.ask("/api/decide")[0] == 405
    assert page.ask("/api/survey", method="DELETE")[0] == 403
    assert page.post("/api/decide", [1])[0] == 400
    assert page.post("/api/decide", {"action": "explode", "object_id": 1}) == (
        409, {"error": f"correction: unknown action 'explode', known are {', '.join(ACTIONS)}"},
    )  # fmt: skip
    assert page.post("/api/decide", {"action": "accept", "object_id": 99})[0] == 409
    assert page.json("/api/corrections")["decisions"] == []


@pytest.mark.parametrize(
    "path",
    [
        "/files/../secret.jpg", "/files/photos/../../secret.jpg", "/files/%2e%2e/secret.jpg", "/files/..%2fsecret.jpg",
        "/files//etc/passwd", "/files/%00.jpg", "/files/link.jpg", "/files/.hidden.jpg", "/files/corrections.sqlite", "/files/report.html",
        "/files/.mlsroad/0123456789ab/run.json", "/static/../server.py", "/static/%2e%2e%2fserver.py", "/tiles/../lock", "/tiles/..%2f..%2flock",
        "/tiles/scratch.bin",
    ],
)  # fmt: skip
def test_no_file_outside_of_what_the_page_shows_is_given(page, path):
    status, _, content = page.ask(path)
    assert status == 404, content
    assert b"secret" not in content


def test_photos_and_ranges_of_tiles_are_given(page, folder):
    assert page.ask("/files/photos/1.jpg")[2] == (folder / "photos/1.jpg").read_bytes()
    whole = page.ask("/tiles/level0.bin")[2]
    for header, code, part in [
        ("bytes=0-9", 206, whole[:10]),
        ("bytes=-5", 206, whole[-5:]),
        ("bytes=20-", 206, whole[20:]),
        (f"bytes={len(whole)}-", 416, None),
        ("bytes=x-y", 400, None),
    ]:
        status, _, content = page.ask("/tiles/level0.bin", headers={"Range": header})
        assert status == code, header
        assert part is None or content == part


def test_the_survey_has_path_lines_and_objects_as_the_inventory_states_them(page):
    survey = page.json("/api/survey")
    kerb = [[495.0, 895.0, 12.0], [540.0, 895.5, 12.1], [590.0, 896.0, 12.2]]
    [line] = survey["lines"]
    assert (line["line_id"], line["kind"], line["vertices"], line["x"]) == (1, "kerb", kerb, 495.0)
    assert "sag" not in line and line["length"] == pytest.approx(95.0, abs=0.1)
    assert (len(survey["path"]), survey["path"][0], survey["path"][-1]) == (
        50,
        [495.0, 897.0, 14.0],
        [595.0, 897.0, 14.0],
    )
    columns = survey["objects"]["columns"]
    assert survey["objects"]["headings"]["x"] == "Easting [m]"
    rows = [dict(zip(columns, row, strict=True)) for row in survey["objects"]["rows"]]
    assert [(row["object_id"], row["kind"], row["score"], row["x"]) for row in rows][3] == (4, "tree", 0.95, 520.0)
    assert survey["photos"] == [1] and survey["n_points"] == 136_000


def test_names_are_data(page):
    survey = page.json("/api/survey")
    assert survey["name"] == "<i>survey.laz"
    assert survey["classes"]["5"] == EVIL
    assert [name for name, _, _ in survey["files"]] == list(FILES)
    assert page.ask("/api/survey")[1]["content-type"] == "application/json"


def test_a_second_page_of_the_same_output_is_refused(page, folder):
    done = subprocess.run(
        [COMMAND, "open", folder, "--no-browser"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert done.stderr == (
        f"Error: {folder} is open in the browser already: http://127.0.0.1:{page.port}/ of process {page.process.pid} on {os.uname().nodename}. "
        "Use that page, or end it (Ctrl-C) and try again\n"
    )


def test_decisions_are_written_with_their_user_and_undone(page, folder):
    status, answer = page.post("/api/decide", {"action": "other_kind", "object_id": 3, "kind": "pole"})
    assert status == 200
    assert page.json("/api/states")["states"]["3"]["status"] == "changed"
    assert 3 not in [item["object_id"] for item in page.json("/api/queue?number=9")]
    with open_corrections(folder) as store:
        assert [(d.who, d.correction.kind) for d in store.current()] == [("ann", "pole")]
    assert page.post("/api/undo", answer)[0] == 200
    assert page.json("/api/states")["states"] == {}
    assert page.post("/api/undo", answer)[0] == 409


def test_painted_points_are_rows_of_their_files(page, folder):
    place = [[55.0, 8.0, 3.0]]  # the first pole of the second file
    status, answer = page.post("/api/paint", {"places": place, "radius": 0.4, "class": "wire", "only": 64})
    assert status == 200
    with open_corrections(folder) as store:
        (stroke,) = store.current()
    assert (stroke.correction.payload["file"], stroke.correction.payload["class"]) == (FILES[1], "wire")
    assert [row - 68_000 for row in answer["rows"]] == stroke.correction.payload["points"]
    assert page.json("/api/corrections")["painted"][0]["rows"] == answer["rows"]
    for wrong in (
        {"places": [[1, 2]]},
        {"places": place, "radius": 99},
        {"places": [[None, 0, 0]]},
        {"places": place, "class": "tank"},
    ):
        assert page.post("/api/paint", {"radius": 0.4, "class": "wire", **wrong})[0] == 409
    page.post("/api/undo", answer)


def test_a_group_is_listed_marked_and_answered_once(page):
    group = page.json("/api/groups?number=1")[0]
    body = {"places": [group["place"]], "only": group["code"]}
    status, marked = page.post("/api/group", body)
    assert status == 200 and marked["rows"] != []
    _, answer = page.post("/api/paint", {**body, "group": True, "class": "wire"})
    assert answer["rows"] == marked["rows"]
    assert page.json("/api/groups?number=1")[0]["place"] != group["place"]
    page.post("/api/undo", answer)
    assert page.json("/api/groups?number=1")[0] == group
    assert page.json("/api/groups?number=0") == []


@pytest.mark.parametrize(
    ("path", "body", "code"),
    [
        ("/api/group", {"places": [[0, 0, 0]]}, 409),
        ("/api/group", {"places": [[0, None, 0]], "only": 1}, 409),
        ("/api/undo", {"ids": 5}, 409),
        ("/api/undo", {"ids": [10**30]}, 400),
        ("/api/undo", {"ids": ["1"]}, 409),
        ("/api/decide", {"action": "accept", "object_id": 10**30}, 409),
        ("/api/decide", {"action": "accept", "object_id": 1, "payload": 7}, 409),
        ("/api/paint", {"places": [[0, 0, 0]], "class": "wire", "radius": None}, 409),
        ("/api/deliver", {"formats": []}, 409),
        ("/api/deliver", {"formats": [".gpkg", "../x"]}, 409),
        ("/api/deliver", {"formats": ".gpkg"}, 409),
        ("/api/paint", {"places": [[0, 0, 0]], "class": "wire", "radius": 1, "only": "x"}, 409),
        ("/api/paint", {"places": [[0, 0, 0]], "class": ["wire"], "radius": 1}, 400),
    ],
)
def test_values_of_another_type_are_refused(page, path, body, code):
    status, answer = page.post(path, body)
    assert (status, list(answer)) == (code, ["error"])


def test_a_deep_request_is_refused(page):
    sent = {"Origin": f"http://127.0.0.1:{page.port}", "Content-Type": "application/json"}
    assert page.ask("/api/decide", method="POST", headers=sent, body="[" * 200_000)[0] == 400


def test_painted_points_can_be_painted_over(page):
    place = [[65.0, 8.0, 3.0]]  # the second pole of the second file
    stroke = {"places": place, "radius": 0.3}
    assert page.post("/api/paint", {"places": place, "cluster": True, "class": "wire"}) == (
        409, {"error": "a cluster needs the class of its points (only)"},
    )  # fmt: skip
    _, first = page.post("/api/paint", {**stroke, "class": "wire", "only": 64})
    assert page.post("/api/paint", {**stroke, "class": "road", "only": 64})[1]["rows"] == []
    _, second = page.post("/api/paint", {**stroke, "class": "road", "only": 14})
    assert second["rows"] == first["rows"] != []
    _, third = page.post("/api/paint", {"places": place, "cluster": True, "class": "pole", "only": 11})
    assert set(first["rows"]) <= set(third["rows"])
    for answer in (first, second, third):
        assert page.post("/api/undo", answer)[0] == 200


def test_several_decisions_are_undone_together_or_not_at_all(page, folder):
    ids = [page.post("/api/decide", {"action": "accept", "object_id": n})[1]["ids"][0] for n in (1, 2)]
    for wrong in ([*ids, 10**9], [ids[0], ids[0]], [-1, *ids]):
        assert page.post("/api/undo", {"ids": wrong})[0] == 409
        with open_corrections(folder) as store:
            assert [decision.identifier for decision in store.current()] == ids
    assert page.post("/api/undo", {"ids": ids}) == (200, {})
    with open_corrections(folder) as store:
        assert store.current() == []


JOINED = {
    **{"line": 1, "x": 495.0, "y": 895.0, "other": {"line": 2, "x": 1e308, "y": 895.0}},
    "parts": [[[495, 895, 12], [540, 895, 12]]],
}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            {"action": "accept", "object_id": 1, "payload": {"class": "\ud800"}},
            "class '\\ud800' is not a name of at most 200",
        ),
        ({"action": "accept", "object_id": 1, "payload": {"class": "wire\x00"}}, "is not a name"),
        ({"action": "reject", "object_id": 1, "payload": {"class": "x" * 300}}, "is not a name"),
        ({"action": "reject", "object_id": 1, "payload": {"class": "tank"}}, "unknown class 'tank': use one of"),
        ({"action": "other_kind", "object_id": 1, "kind": "role"}, "unknown kind 'role': use pole, sign"),
        ({"action": "other_kind", "object_id": 1, "kind": "kerb"}, "unknown kind 'kerb'"),
        ({"action": "other_kind", "object_id": 1, "kind": "\udfff"}, "is not a name"),
        ({"action": "add", "kind": "tank", "payload": {"x": 500, "y": 900, "z": 12}}, "unknown kind 'tank'"),
        ({"action": "add", "kind": "pole", "payload": {"x": 1e308, "y": 900, "z": 12}}, "more than 1e+08 m"),
        ({"action": "move_base", "object_id": 1, "payload": {"x": 1e308, "y": 900, "z": 12}}, "more than 1e+08 m"),
        ({"action": "move_base", "object_id": 1, "payload": {"x": 500, "y": 900, "z": -1e300}}, "more than 1e+08 m"),
        ({"action": "move_base", "object_id": 1, "payload": {"x": 530, "y": 900, "z": 12}}, "moved by 30 m"),
        ({"action": "split", "object_id": 1, "payload": {"bases": [[1, 2, 3], [1, 1e200, 3]]}}, "more than 1e+08 m"),
        ({"action": "reject_line", "kind": "pole", "payload": {"line": 1, "x": 1, "y": 2}}, "unknown kind 'pole'"),
        ({"action": "reject_line", "kind": "kerb", "payload": {"line": 1, "x": 1, "y": 1e99}}, "more than 1e+08 m"),
        (
            {"action": "kind_line", "kind": "kerb", "payload": {"line": 1, "x": 495, "y": 895}},
            "to must be the right kind",
        ),
        ({"action": "join_lines", "kind": "kerb", "payload": JOINED}, "more than 1e+08 m"),
    ],
)
def test_values_that_an_import_refuses_are_refused(page, folder, body, message):
    status, answer = page.post("/api/decide", body)
    assert status == 409 and message in answer["error"]
    with open_corrections(folder) as store:
        assert store.current() == []
    assert page.json("/api/corrections")["decisions"] == []


def test_unfinished_requests_are_ended_and_stop_nobody(page):
    held = []
    for k in range(300):
        one = socket.create_connection(("127.0.0.1", page.port), timeout=30)
        one.sendall(b"" if k % 3 == 0 else b"GET / HTTP/1.1\r\nHost: x\r\nX: ")
        held.append(one)
    assert page.ask("/api/status")[0] == 200
    assert sum(_is_open(one) for one in held) <= MOST_CONNECTIONS
    last = held[-1]
    last.settimeout(REQUEST_TIME + 5)
    assert last.recv(100) == b""
    for one in held:
        one.close()
    body = socket.create_connection(("127.0.0.1", page.port), timeout=REQUEST_TIME + 5)
    body.sendall(
        f"POST /api/undo HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\nOrigin: http://127.0.0.1:{page.port}\r\n"
        f"Content-Type: application/json\r\nCookie: {page.cookie}\r\nContent-Length: 99\r\n\r\n{{".encode()
    )
    assert body.recv(100) == b""
    body.close()


def _is_open(one):
    one.setblocking(False)
    try:
        return one.recv(100) != b""
    except BlockingIOError:
        return True
    except ConnectionError:
        return False


def test_a_forwarded_port_is_told_what_to_do(page):
    status, _, content = page.ask("/", headers={"Host": "127.0.0.1:9999"})
    assert status == 403 and f"ssh -L {page.port}:127.0.0.1:{page.port}".encode() in content
