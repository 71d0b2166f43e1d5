"""Commands `mlsroad corrections list|import|export`: decisions about a labelled survey, and those of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.commands.console import count_table, one_line_errors, output_console
from mlsroad_pipeline.commands.export import export
from mlsroad_pipeline.commands.options import Verbose, check_exist, expanded, login_name, results_folder

if TYPE_CHECKING:
    from mlsroad_pipeline.review.corrections import Correction, CorrectionStore, Decision

corrections = typer.Typer(no_args_is_help=True, help="List, import and export the corrections of a labelled survey.")

Out = Annotated[str, typer.Argument(metavar="OUT", help="Folder of results of label, or the labelled survey.")]


@corrections.command("list")
def list_corrections(out: Out, verbose: Verbose = False) -> None:
    """List the decisions about a labelled survey, and those that match no object any more."""
    from mlsroad_pipeline.review.corrections import has_corrections, open_corrections
    from mlsroad_pipeline.review.corrections.answers import files_of, unmatched_strokes
    from mlsroad_pipeline.review.corrections.checked_states import lost_checks
    from mlsroad_pipeline.review.corrections.line_decisions import lost_lines

    with one_line_errors(verbose=verbose):
        folder = results_folder(expanded([out])[0])
        check_exist([folder])
        console = output_console()
        if not has_corrections(folder):
            if not Path(folder, "inventory.gpkg").is_file():
                raise ReadError(f"{folder} holds no results of label: label the survey first (mlsroad label FILE)")
            console.print(f"{folder} has no corrections.", markup=False)
            return
        with open_corrections(folder, write=False) as store:
            decisions, states = store.current(), store.states()
        others = (*lost_lines(states.lines, Path(folder)), *lost_checks(states.checks, Path(folder)))
        lost = {decision.identifier for decision in (*states.unmatched, *others)}
        misplaced = {
            decision.identifier
            for decision in unmatched_strokes(states.painted, files_of(states.painted, Path(folder)))
        }
        missing = {decision.identifier for decision in states.added}
        rows = [_row(decision, decision.identifier in lost | misplaced, missing) for decision in decisions]
        console.print(count_table(rows, ("decision", "made", "who", "action", "object", "what", "matches")))
        console.print(f"\n{len(decisions)} decisions, {len(lost)} match no object, line or compared state.")
        n_missing = sum(row[-1] == ADDED for row in rows)
        if n_missing:
            console.print(f"{n_missing} are about objects that are not listed any more: they count as added.")
        if misplaced:
            console.print(f"{len(misplaced)} strokes are about files that are missing or have other points.")


ADDED = "added"  # an accepted or changed object that is not listed any more


def _row(decision: Decision, lost: bool, missing: set[int]) -> tuple[str, ...]:
    given = decision.correction
    of_file = f"{given.payload['file']}, " if given.action == "paint" else ""
    number = "" if given.object_id is None else str(given.object_id)
    what = f"{of_file}{given.described}"
    row = (decision.made[:19], decision.who, given.action, number, what)
    is_missing = given.action != "add" and decision.identifier in missing
    return (str(decision.identifier), *row, ADDED if is_missing else "no" if lost else "yes")


@corrections.command("import")
def import_corrections(
    edited: Annotated[str, typer.Argument(metavar="FILE", help="Edited inventory (.gpkg) or labelled file (.laz).")],
    out: Out,
    who: Annotated[str | None, typer.Option(help="Name of the user. Default: that of the account.")] = None,
    file: Annotated[
        str | None, typer.Option(metavar="NAME", help="Labelled file that FILE is a copy of. Default: of its name.")
    ] = None,
    many_deleted: Annotated[
        bool, typer.Option("--many-deleted", help="Reject missing objects or lines even if more than half are missing.")
    ] = False,
    verbose: Verbose = False,
) -> None:
    """Import corrections from an inventory or a labelled file that was edited in another program."""
    from mlsroad_pipeline.review.corrections import open_corrections
    from mlsroad_pipeline.review.corrections.edited_inventory import corrections_of_inventory, known_names, system_of
    from mlsroad_pipeline.review.corrections.edited_lines import corrections_of_lines

    with one_line_errors(verbose=verbose):
        path, folder = Path(expanded([edited])[0]), Path(results_folder(expanded([out])[0]))
        check_exist([str(path), str(folder)])
        with open_corrections(folder) as store:
            if path.suffix.lower() == ".gpkg":
                states = store.states()
                found, unread = corrections_of_inventory(
                    path,
                    store.objects(),
                    states.of_objects,
                    classes=known_names(folder),
                    system=system_of(folder),
                    many_deleted=many_deleted,
                    notes_before=states.notes,
                    left_out=_of_no_kind(folder, store),
                )
                system = system_of(folder)
                of_lines, further = corrections_of_lines(
                    path, folder, states.lines, system=system, many_deleted=many_deleted
                )
                found, matched = [*_new_ones(found, store), *of_lines], ""
                unread = list(dict.fromkeys([*unread, *further]))
            elif path.suffix.lower() in (".laz", ".las"):
                found, matched = _edited_points(path, folder, file, store)
                unread = []
            else:
                raise ParameterError(f"{path}: corrections are read from .gpkg, .laz and .las")
            store.add_all(found, who=login_name() if who is None else who)
        console = output_console()
        console.print(f"{len(found)} new corrections from {path}{matched}.", markup=False)
        if unread:
            console.print(f"Not compared, not as it stands, or far away ({len(unread)}):", markup=False)
        for note in unread:
            console.print(f"  {note}", markup=False)
        for action in dict.fromkeys(correction.action for correction in found):
            console.print(f"  {action:12} {sum(correction.action == action for correction in found)}", markup=False)


def _of_no_kind(folder: Path, store: CorrectionStore) -> set[int]:
    """Return the objects that have the class of no object, such as a wall, and are not delivered."""
    from mlsroad_pipeline.execution.run_identity import finished_record
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
    from mlsroad_pipeline.review.delivery.corrected_objects import kind_of, kinds_of_classes

    record = {"settings": {}, **(finished_record(folder) or {})}
    kinds, states = kinds_of_classes(LabelledOutput(folder, record).schemes), store.states().of_objects
    table = store.objects().table
    listed: dict[int, str] = dict(zip(table["object_id"].tolist(), table["kind"].tolist(), strict=True))
    return {n for n, state in states.items() if state["status"] == "changed" and not kind_of(state, listed[n], kinds)}


def _new_ones(found: list[Correction], store: CorrectionStore) -> list[Correction]:
    """Return corrections without the added objects that the store has already."""
    known = {_place_of(decision.correction) for decision in store.states().added}
    return [correction for correction in found if correction.action != "add" or _place_of(correction) not in known]


def _place_of(added: Correction) -> tuple[str, str | None, float, float]:
    return added.checked_class, added.kind, round(added.payload["x"], 2), round(added.payload["y"], 2)


def _edited_points(path: Path, folder: Path, file: str | None, store: CorrectionStore) -> tuple[list[Correction], str]:
    from mlsroad_pipeline.review.corrections.edited_points import corrections_of_points, names_of_codes, painted_before
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

    output = LabelledOutput.at(folder)
    clouds = output.clouds()
    named = [
        name for name in clouds if file in (name, Path(name).name) or (file is None and Path(name).stem == path.stem)
    ]
    if len(named) != 1:
        raise ParameterError(
            f"{path}: name the labelled file that it is a copy of with --file, one of {', '.join(clouds)}"
        )
    name = named[0]
    output.check_unedited([name])
    names = names_of_codes(clouds[name], output)
    painted = painted_before(name, store.states().painted, names, clouds[name])
    found, matched = corrections_of_points(path, clouds[name], name, names, painted)
    return found, f", points matched {matched}"


corrections.command("export")(export)
