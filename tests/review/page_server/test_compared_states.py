"""States of a compared register and of two surveys are checked in the page, kept, and delivered."""

import csv

import pandas as pd
import pytest
from helpers.corrected import write_inventory
from helpers.page_output import write_output
from helpers.page_tab import click_at, decide, entries, reload, settle
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.changes.objects import STATES as CHANGE_STATES
from mlsroad_pipeline.algorithms.inventory.register.states import STATES as REGISTER_STATES
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.review.compared_entries import COMPARED, KINDS, compared_entries
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.corrections.checked_states import with_checked
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
from mlsroad_pipeline.surveys.register_files import KINDS as REGISTERED

REGISTER = """id,kind,x,y,height,state,evidence,empty_share,points,rays,object_id,object_kind,object_height,distance
L1,pole,500.0,900.0,6.0,confirmed,object,,0,0,1,pole,6.0,0.1
L2,pole,503.0,900.0,6.0,moved,object,,0,0,2,pole,6.0,2.5
L3,sign,515.0,897.0,,not found,rays,1.0,0,840,0,,,
L3,sign,525.0,897.0,,not visible,rays,0.0,0,0,0,,,
,tree,520.0,905.0,,new,object,,0,0,4,tree,8.0,
"""
CHANGES = """key,state,kind,x,y,z,first_id,second_id,changes,reason
k1,unchanged,pole,500.0,900.0,12.0,1,1,,listed in both
k2,gone,pole,510.0,900.0,12.0,2,0,,300 rays crossed its place
k3,changed,pole,500.0,900.0,12.0,3,1,tilt by 2.1 degrees,
"""


def write_tables(folder, *, register=REGISTER, changes=CHANGES):
    for name, text in (("register", register), ("changes", changes)):
        path = folder / COMPARED[name].file
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("compared") / "out"
    write_output(place)
    write_tables(place)
    return place


@pytest.fixture
def survey(folder):
    write_tables(folder)
    shown = ServedSurvey(OutputFolder.find(folder), user="ann")
    with open_corrections(folder) as store:
        store.undo(*(decision.identifier for decision in store.current()))
    yield shown
    shown.close()
    write_tables(folder)


def check(listed, table="register", **other):
    payload = {name: listed[name] for name in ("state", "x", "y")} | {"entry": listed["name"], "table": table}
    return {"action": "check", "kind": listed["kind"], "payload": payload | {"checked": "right"} | other}


def test_states_and_kinds_are_those_of_compare():
    assert set(COMPARED["register"].states) == set(REGISTER_STATES)
    assert set(COMPARED["changes"].states) == set(CHANGE_STATES)
    assert tuple(REGISTERED) == KINDS


def test_the_page_gets_entries_with_names_reasons_and_whether_they_are_asked(survey):
    found = survey.survey()
    listed = [(e["name"], e["reason"], e["asks"]) for e in found["entries"]["register"]]
    assert listed == [
        ("L1", "object", False),
        ("L2", "pole 2 stands 2.5 m away", True),
        ("L3", "840 rays through its place", True),
        ("L3 (2)", "rays", False),
        ("object 4", "tree 4 has no entry", True),
    ]
    assert [(e["name"], e["reason"]) for e in found["entries"]["changes"]][1:] == [
        ("k2", "300 rays crossed its place"),
        ("k3", "tilt by 2.1 degrees"),
    ]
    assert found["left_out"] == []


def test_a_decision_is_kept_replaced_and_taken_back(survey):
    entry = survey.survey()["entries"]["register"][2]
    first = survey.decide(check(entry))["ids"]
    assert survey.corrections()["checked"] == {"register": {"L3": "right"}, "changes": {}}
    second = survey.decide(check(entry, checked="wrong"))["ids"]
    assert survey.corrections()["checked"]["register"] == {"L3": "wrong"}
    assert survey.corrections()["decisions"][-1]["what"] == "register L3 not found: wrong"
    survey.undo({"ids": second})
    assert survey.corrections()["checked"]["register"] == {"L3": "right"}
    survey.undo({"ids": first})
    assert survey.corrections()["checked"]["register"] == {}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"checked": "perhaps"}, "checked must be right or wrong"),
        ({"table": "other"}, "table must be one of register, changes"),
        ({"state": "gone"}, "unknown state 'gone' of register"),
        ({"state": "moved"}, "no sign L3 with the state 'moved'"),
        ({"entry": "L9"}, "no sign L9 with the state 'not found'"),
        ({"x": 530.0}, "no sign L3 with the state 'not found'"),
        ({"x": "far"}, "kind, x, y must be given"),
    ],
)
def test_a_decision_about_no_entry_is_refused(survey, wrong, message):
    entry = survey.survey()["entries"]["register"][2]
    with pytest.raises(ParameterError, match=message):
        survey.decide(check(entry, **wrong))
    assert survey.corrections()["decisions"] == []


@pytest.mark.parametrize(
    ("register", "message"),
    [
        ("name,size\nlamp,3\n", "has no column"),
        (REGISTER[:-20], "is damaged (its last line is cut)"),
        (REGISTER.replace(",new,", ",odd,"), "is damaged (line 6: unknown kind 'tree' or state 'odd')"),
        (REGISTER.replace("503.0,900.0", "nan,900.0"), "is damaged (line 3: no place 'nan', '900.0')"),
        (REGISTER.replace("L1,pole,", "L1,pole,7,"), "is damaged (line 2:"),
        ("", "has no column"),
    ],
)
def test_a_damaged_or_foreign_table_is_named_and_left_out(survey, folder, register, message):
    write_tables(folder, register=register)
    found = survey.survey()
    assert list(found["entries"]) == ["changes"]
    [line] = found["left_out"]
    assert str(folder / "register/register.csv") in line and message in line and "\n" not in line


def test_a_link_out_of_the_folder_is_left_out(tmp_path):
    (tmp_path / "far.csv").write_text(REGISTER, encoding="utf-8")
    (tmp_path / "out/register").mkdir(parents=True)
    (tmp_path / "out/register/register.csv").symlink_to(tmp_path / "far.csv")
    found, [line] = compared_entries(tmp_path / "out")
    assert found == {} and "is a link out of the folder" in line


def test_a_new_comparison_keeps_decisions_whose_state_is_unchanged(survey, folder):
    for entry in survey.survey()["entries"]["register"][1:3]:
        survey.decide(check(entry))
    table = pd.read_csv(folder / "register/register.csv")
    assert with_checked(table, "register", folder)["checked"].tolist() == ["", "right", "right", "", ""]
    again = table.assign(state=table["state"].replace("moved", "not found"), x=table["x"] + 0.3)
    assert with_checked(again, "register", folder)["checked"].tolist() == ["", "", "right", "", ""]
    far = table.assign(x=table["x"] + 30.0)  # another register with the same numbers
    assert with_checked(far, "register", folder)["checked"].tolist() == [""] * 5


def test_the_protocol_has_what_was_checked(survey, folder, tmp_path):
    found = survey.survey()["entries"]
    survey.decide(check(found["register"][1], checked="wrong"))
    survey.decide(check(found["changes"][1], "changes"))
    write_tables(folder, register=REGISTER.replace("L2,", "L8,"))  # its entry is gone
    done = CliRunner().invoke(app, ["export", str(folder), "-o", str(tmp_path / "check.html")])
    assert done.exit_code == 0, done.output
    with open(tmp_path / "check_changes.csv", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["checked"] for row in rows] == ["", "right", ""]
    assert rows[2]["changes"] == "tilt by 2.1 degrees" and rows[0]["first_id"] == "1"
    page = (tmp_path / "check.html").read_text(encoding="utf-8")
    assert "States of changes" in page and "States of register" in page
    listed = CliRunner().invoke(app, ["corrections", "list", str(folder)])
    assert "2 decisions, 1 match no object, line or compared state" in listed.output


def test_a_store_with_a_decision_about_a_state_opens_again(folder, survey):
    survey.decide(check(survey.survey()["entries"]["changes"][2], "changes"))
    with open_corrections(folder) as store:
        assert [d.correction for d in store.states().checks] == [
            Correction("check", None, "pole", check(survey.survey()["entries"]["changes"][2], "changes")["payload"])
        ]


def test_the_list_is_checked_by_keys_and_a_reload_keeps_it(tab, server, folder):
    def progress():
        return tab.js("document.querySelector('#progress').innerText.replace(/\\s+/g, ' ')")

    tab.js("document.querySelector('[data-list=register]').click()")
    assert [text.split(":")[0] for text in entries(tab)] == ["sign L3 not found", "pole L2 moved", "tree object 4 new"]
    assert progress().startswith("3 of 3 states left to check. 1 confirmed, 1 not visible.")
    tab.press("n")
    place = tab.js("page.model.placeOf(page.model.entry).slice(0, 2)")
    origin = tab.js("page.model.survey.origin")
    assert [a + b for a, b in zip(place, origin, strict=False)] == pytest.approx([515.0, 897.0])
    target, wanted = "page.cloud.target", "page.model.placeOf(page.model.entry)"
    tab.until(f"Math.hypot({target}[0] - {wanted}[0], {target}[1] - {wanted}[1]) < 0.5")
    assert tab.js("location.hash") == "#register=L3"
    decide(tab, "a")
    assert tab.js("page.model.entry.name") == "L2" and progress().startswith("2 of 3")
    decide(tab, "r")
    assert tab.js("page.model.entry.name") == "object 4" and progress().startswith("1 of 3")
    write_tables(folder, changes="key,size\nlamp,3\n")
    reload(tab, server)
    write_tables(folder)
    assert "changes.csv has no column 'changes'" in tab.js("document.querySelector('#saved').innerText")
    assert tab.js("document.querySelectorAll('[data-list=changes]').length") == 0
    tab.js("page.actions.showList('register')")
    assert progress().startswith("1 of 3")
    assert entries(tab)[1:] == [
        "sign L3 not found: 840 rays through its place right",
        "pole L2 moved: pole 2 stands 2.5 m away wrong",
    ]
    decide(tab, "u")
    assert tab.js("page.model.entry.name") == "L2" and progress().startswith("2 of 3")
    tab.js("document.querySelector('#rest').click()")
    assert len(entries(tab)) == 5


def test_decisions_about_objects_that_are_listed_no_more_are_marked(tmp_path):
    write_output(tmp_path)
    with open_corrections(tmp_path) as store:
        for number in (4, 5):
            store.add(Correction("reject", number), who="ann")
    inventory = read_geopackage(tmp_path / "inventory.gpkg")
    kept = inventory.objects[inventory.objects["object_id"] != 5]
    write_inventory(tmp_path, kept)
    shown = ServedSurvey(OutputFolder.find(tmp_path), user="ann")
    assert [(d["object_id"], d["lost"]) for d in shown.corrections()["decisions"]] == [(4, False), (5, True)]
    shown.close()


def test_the_map_draws_the_listed_entries_and_a_click_chooses_one(tab):
    tab.js("page.actions.showList('objects'); page.map.fit()")
    settle(tab)
    tab.js("window.before = page.map.element.querySelector('canvas').toDataURL()")
    tab.js("page.actions.showList('register')")
    settle(tab)
    assert tab.js("page.map.element.querySelector('canvas').toDataURL() !== window.before")
    assert tab.js("page.model.listedEntries().map((entry) => entry.name)") == ["L2", "L3", "object 4"]
    x, y = tab.js(
        "(() => { const [x, y] = page.map.plan(page.model.entriesOf('register')[2]);"
        "const b = page.map.element.getBoundingClientRect(); return [b.x + x, b.y + y]; })()"
    )
    click_at(tab, (x, y))
    assert tab.js("page.model.entry.name") == "L3"
    click_at(tab, (x, y + 40))  # nothing is there
    assert tab.js("page.model.entry.name") == "L3"
