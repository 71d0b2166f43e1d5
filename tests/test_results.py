"""The page of results, the figures that other pages take from it, and the length of the manual."""

import importlib.util
import json
import re
import subprocess
import sys

import pytest
from helpers.wiring import REPOSITORY

SCRIPT = REPOSITORY / "scripts/results_page.py"
SPEC = importlib.util.spec_from_file_location("results_page", SCRIPT)
results_page = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(results_page)

LINK = re.compile(r"\[([^\]\[]+)\]\(([^)\s]*)results\.md#(\w+)\)")
"""A link to a table of results."""
FENCE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"`[^`\n]*`")
QUANTITY = re.compile(
    r"\d+\.\d+(?:,? (?:to|and|or|by|x|/) \d+\.\d+)* ?(?:m|mm|cm|s|ms|h|%|rad|[kMG]i?B|degrees?|seconds?)\b"
)
"""A number with a unit, or several."""
SCORE = re.compile(r"(?<![\d.])0\.\d{2,3}(?!\d)")
"""A score: a number below 1 with two or three decimals."""
PARAMETERS = {"parameter", "setting", "option", "field"}
"""First header cells of tables of parameters, whose values are no scores."""
LIMITS = {"README.md": 600, "CHANGELOG.md": 400, "docs/decisions.md": 1500}
MANUAL, PAGE = 50_000, 1200


def read(path):
    return path.read_text(encoding="utf-8")


def words(text):
    """Return the number of words; bars and rules of tables do not count."""
    return len(re.findall(r"[^\s|]*\w[^\s|]*", text))


def without_parameters(text):
    """Return the text without the tables whose first header cell is in `PARAMETERS`."""
    kept, inside = [], False
    for line in text.splitlines():
        if not line.startswith("|"):
            inside = False
        elif not inside and line.strip("|").partition("|")[0].strip().lower() in PARAMETERS:
            inside = True
        if not inside:
            kept.append(line)
    return "\n".join(kept)


def scores(text):
    """Return the scores of a page outside code, quantities, tables of parameters, and blocks and links of results."""
    for pattern in (results_page.BLOCK, FENCE, CODE, LINK, QUANTITY):
        text = pattern.sub("", text)
    return SCORE.findall(without_parameters(text))


@pytest.fixture(scope="module")
def tables():
    return results_page.read_tables()


def test_page_and_blocks_are_those_of_the_stored_results():
    done = subprocess.run([sys.executable, SCRIPT, "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_linked_figures_are_cells_of_the_table(tables):
    wrong = []
    for page in results_page.pages():
        for text, _, name in LINK.findall(FENCE.sub("", read(page))):
            cells = {cell for row in tables[name]["rows"] for cell in row} if name in tables else set()
            if name not in tables or (re.search(r"\d", text) and text not in cells):
                wrong.append((page.name, text, name))
    assert wrong == []


def git(*arguments):
    return subprocess.run(["git", "-C", REPOSITORY, *arguments], capture_output=True, text=True, check=False)


def test_commits_of_tables_and_pages_exist_and_have_the_scripts_that_are_gone(tables):
    if git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        pytest.skip("needs the history of the repository")
    wanted = {(table["commit"], name) for table in tables.values() for name in results_page.gone_scripts(table)}
    texts = [table["text"] for table in tables.values()] + [read(page) for page in results_page.pages()]
    named = re.findall(r"(?<![\w.])(?=[0-9a-f]*[a-f])(?=[0-9a-f]*\d)[0-9a-f]{8,9}(?![\w.])", " ".join(texts))
    wanted |= {(commit, "") for commit in [*named, *(table["commit"] for table in tables.values())]}
    assert [f"{commit}:{name}" for commit, name in wanted if git("cat-file", "-e", f"{commit}:{name}").returncode] == []


def test_pages_have_no_scores_of_their_own():
    docs = REPOSITORY / "docs"
    pages = [REPOSITORY / "README.md", docs / "tutorial.md", *docs.rglob("methods/**/*.md"), *docs.rglob("*_study.md")]
    own = {str(page.relative_to(REPOSITORY)): scores(read(page)) for page in pages}
    assert {page: found for page, found in own.items() if found} == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("an accuracy of 0.985", ["0.985"]),
        ("0.98, 0.74.", ["0.98", "0.74"]),
        ("voxels of 0.25 m, `0.25`, 0.1 and 12.55", []),
        ("edges of 0.05 and 0.10 m take 0.12 s", []),
        ("[0.86](../results.md#pool)", []),
        ("| parameter | default |\n|---|---|\n| `a` | 0.25 |\n\nF1 0.71", ["0.71"]),
        ("| method | F1 |\n|---|---|\n| `a` | 0.25 |", ["0.25"]),
        ("```\nscore 0.55\n```\n", []),
        ("<!-- results: pool -->\n| a | 0.71 |\n<!-- /results -->", []),
    ],
)
def test_scores_are_found(text, found):
    assert scores(text) == found


def test_words_are_counted():
    assert words("# A page\n\n|a|0.9|two words|\n|---|---|---|\n| `b` |  | - |\n") == 7


@pytest.mark.parametrize(("name", "limit"), LIMITS.items())
def test_page_is_short(name, limit):
    assert words(read(REPOSITORY / name)) <= limit


def test_pages_of_the_manual_are_short():
    own_limit = {REPOSITORY / name for name in (*LIMITS, "docs/results.md")}  # results are tables, made by the script
    n_words = {path.name: words(read(path)) for path in {*(REPOSITORY / "docs").rglob("*.md")} - own_limit}
    assert {name: n for name, n in n_words.items() if n > PAGE} == {}


def test_manual_is_short():
    assert sum(words(read(path)) for path in (REPOSITORY / "docs").rglob("*.md")) <= MANUAL


# ---- the script

TABLE = {
    "id": "toy",
    "title": "Toy streets",
    "group": "points",
    "text": "One street.",
    "command": "make run",
    "data": "a street",
    "digest": None,
    "commit": "abc1234",
    "date": "2026-11-20",
    "seed": [1, 2],
    "columns": ["method", "overall accuracy", "mean F1"],
    "rows": [["a", "0.9", "0.8"], ["`b`", "0.7", "0.6"]],
}


def store(folder, **changes):
    table = {key: value for key, value in (TABLE | changes).items() if value != "removed"}
    (folder / "toy.json").write_text(json.dumps(table), encoding="utf-8")
    return results_page.read_tables(folder)


def test_page_has_anchor_table_and_provenance(tmp_path):
    text = results_page.results_page(store(tmp_path, digest="sha256:0123456789abcdef"))
    assert '<a id="toy"></a>' in text and "[Toy streets](#toy)" in text
    assert "|method|overall accuracy|mean F1|\n|---|---|---|\n|a|0.9|0.8|" in text
    assert "`make run`; a street; commit `abc1234`, 2026-11-20; seeds 1, 2; `sha256:0123456789ab`." in text


@pytest.mark.parametrize(("script", "mark"), [("benchmarks/gone.py", " ‡"), ("scripts/results_page.py", "")])
def test_page_marks_commands_whose_script_is_gone(tmp_path, script, mark):
    table = store(tmp_path, command=f"python {script} --all")
    assert f"`python {script} --all`{mark}; a street" in results_page.results_page(table)


@pytest.mark.parametrize(
    ("data", "origin"),
    [
        ("a simulated town", "Simulated"),
        ("Oakland 3-D, eleven blocks", "Recorded"),
        ("six streets, one scan of SemanticKITTI 00", "Simulated and recorded"),
    ],
)
def test_page_says_where_the_points_come_from(tmp_path, data, origin):
    assert f"\n**{origin}.** One street.\n" in results_page.results_page(store(tmp_path, data=data))


def test_page_says_which_version_of_a_method_a_row_has(tmp_path):
    names = ["jointnet_printed", "`jointnet`", "shot", "published: VoxNet", "a setting"]
    rows = [[name, "0.9", "0.8"] for name in names]
    text = results_page.results_page(store(tmp_path, group="methods", rows=rows))
    assert "|method|version|overall accuracy|mean F1|\n" in text
    found = re.findall(r"^\|[^|]+\|([^|]*)\|0\.9\|", text, re.MULTILINE)
    assert found == ["=", "+", "○", "†", ""]
    assert "version" not in results_page.results_page(store(tmp_path, rows=rows)).partition("<a id")[2]


def test_seeds_in_a_row_are_a_range(tmp_path):
    assert "; seeds 51–54." in results_page.results_page(store(tmp_path, seed=[51, 52, 53, 54]))
    assert "; seeds 1, 2, 4." in results_page.results_page(store(tmp_path, seed=[1, 2, 4]))


def test_block_takes_rows_and_columns(tmp_path):
    page = REPOSITORY / "docs/methods/toy.md"
    text = "before\n<!-- results: toy columns=mean F1 rows=b -->\nold\n<!-- /results -->\nafter"
    filled = results_page.refresh(text, store(tmp_path), page)
    assert "| method | mean F1 |\n|---|---|\n| `b` | 0.6 |\n\n[Protocol](../results.md#toy)\n" in filled
    assert filled.startswith("before\n<!-- results: toy columns") and filled.endswith("<!-- /results -->\nafter")
    assert results_page.refresh(filled, store(tmp_path), page) == filled


@pytest.mark.parametrize("block", ["toy columns=kappa", "toy rows=c", "other"])
def test_unknown_names_in_a_block_are_errors(tmp_path, block):
    with pytest.raises(ValueError, match=r"no (column or row|results/)"):
        results_page.refresh(f"<!-- results: {block} -->\n<!-- /results -->", store(tmp_path), REPOSITORY / "README.md")


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": "removed"},
        {"extra": 1},
        {"id": "other"},
        {"group": "none"},
        {"data": "three towns"},
        {"text": ""},
        {"commit": "HEAD"},
        {"date": "27.11.2026"},
        {"digest": "abc"},
        {"seed": "1"},
        {"rows": []},
        {"rows": [["a", "0.9"]]},
        {"rows": [["a", 0.9, "0.8"]]},
        {"columns": ["method", "F1", "F1"]},
    ],
    ids=str,
)
def test_faulty_tables_are_errors(tmp_path, changes):
    with pytest.raises(ValueError, match=r"toy\.json: "):
        store(tmp_path, **changes)
