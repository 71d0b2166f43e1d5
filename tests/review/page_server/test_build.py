"""The built client in the package: what the sources give, small, without addresses of the network."""

import hashlib
import json
import re
import shutil
import subprocess

import pytest
from helpers.wiring import REPOSITORY

SOURCES = REPOSITORY / "page"
STATIC = REPOSITORY / "src/mlsroad_pipeline/review/page_server/static"
NAMES = ("index.html", "package-lock.json", "tsconfig.json", "vite.config.ts")
REBUILD = "run `npm ci && npm run build` in page/ and commit the result"


def test_the_build_is_that_of_the_sources():
    names = sorted([*NAMES, *(f"src/{path.name}" for path in (SOURCES / "src").iterdir())])
    content = b"".join(name.encode() + b"\n" + (SOURCES / name).read_bytes() + b"\n" for name in names)
    assert (STATIC / "sources.sha256").read_text().strip() == hashlib.sha256(content).hexdigest(), REBUILD


def test_a_new_build_gives_the_same_files(tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node: the build of the page cannot be repeated (apt-get install nodejs npm)")
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    if tuple(map(int, version.lstrip("v").split(".")[:2])) < (20, 19):
        pytest.skip(f"Node {version} is too old to build the page: 20.19 or later is needed")
    vite = SOURCES / "node_modules/vite/bin/vite.js"
    if not vite.is_file():
        pytest.skip("the packages of the page are not installed: npm ci --prefix page")
    done = subprocess.run(
        [node, str(vite), "build", "--outDir", str(tmp_path / "new"), "--logLevel", "warn"],
        cwd=SOURCES, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    built = {path.name: path.read_bytes() for path in (tmp_path / "new").iterdir()}
    committed = {path.name: path.read_bytes() for path in STATIC.iterdir()}
    assert built.keys() == committed.keys(), REBUILD
    assert [name for name in built if built[name] != committed[name]] == [], REBUILD


def test_the_build_is_small_and_names_no_other_place():
    assert sum(path.stat().st_size for path in STATIC.iterdir()) < 1_500_000
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    assert "<style" not in page and not re.search(r"<script[^>]*>[^<]", page)  # nothing inline: the policy refuses it
    assert set(re.findall(r'(?:src|href)="([^"]+)"', page)) == {"data:,", "/static/page.js", "/static/page.css"}
    script = (STATIC / "page.js").read_text(encoding="utf-8")
    assert not re.search(r"""(?:import|fetch)\(["'`]https?:""", script)
    assert "three.js" in (STATIC / "NOTICE.txt").read_text(encoding="utf-8")


def test_the_lock_file_names_no_registry():
    lock = json.loads((SOURCES / "package-lock.json").read_text(encoding="utf-8"))
    assert [name for name, entry in lock["packages"].items() if "resolved" in entry] == []
    assert all("integrity" in entry for name, entry in lock["packages"].items() if name)


def test_no_source_of_the_page_imports_itself_through_others():
    sources = {path.stem: path.read_text(encoding="utf-8") for path in (SOURCES / "src").glob("*.ts")}
    needed = {name: {other for other in sources if f'from "./{other}"' in text} for name, text in sources.items()}
    while free := [name for name, others in needed.items() if not others]:
        needed = {name: others - set(free) for name, others in needed.items() if name not in free}
    assert not needed
