"""The counts of the tutorial are those that its commands print."""

import re
import shlex

from helpers.wiring import REPOSITORY


def blocks(page):
    """Return the blocks of code of the section about a simulated street: the commands, and what `label` prints."""
    section = page[page.index("## 2. A simulated street") : page.index("## 3.")]
    return re.findall(r"```\w*\n(.*?)```", section, re.DOTALL), section


def counts(text):
    """Return the numbers of a table of objects by kind; those of lines are metres."""
    return {kind: int(number) for kind, number in re.findall(r"^(\w+) +(\d+)(?: m)?$", text, re.MULTILINE)}


def test_counts_of_points_and_objects_are_those_of_the_commands(run, tmp_path):
    (commands, printed, *_), section = blocks((REPOSITORY / "docs/tutorial.md").read_text(encoding="utf-8"))
    said = {}
    for line in commands.splitlines():
        words = shlex.split(line, comments=True)
        if words[1] == "open":  # a page that stays open
            continue
        done = run(*words[1:], cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        said[words[1]] = done.stdout
    shown, listed = counts(printed), counts(said["label"][said["label"].index("\nobject") :])
    assert shown.keys() == listed.keys() and len(shown) > 6
    for kind, number in shown.items():  # other processors round differently
        assert abs(number - listed[kind]) <= max(1, 0.05 * number), kind
    (points,) = re.findall(r"([\d,]+) points, a trajectory", section)
    assert said["label"].startswith(f"Labelled {points} points of 1 file in ")
    assert "recall" in said["score"]
