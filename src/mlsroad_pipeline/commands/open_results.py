"""Command `mlsroad open`: a labelled survey in the browser, to look at and to correct."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.commands.console import one_line_errors
from mlsroad_pipeline.commands.options import default_output, expanded, login_name

REPORTS = ("report.html", "inspection.html")
"""Reports of `label` and of `inspect`, the first that exists is opened."""


def open_results(
    results: Annotated[str, typer.Argument(metavar="FOLDER", help="Folder of results, or the labelled survey.")],
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="N", help="Port of the local server. Default: any free one.")
    ] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Start a browser.")] = True,
    report: Annotated[bool, typer.Option("--report", help="Open the report in place of the page.")] = False,
    export: Annotated[
        str | None,
        typer.Option(
            "--export",
            metavar="FILE.html",
            help="Write one self-contained HTML file, to look at only: at most a million points.",
        ),
    ] = None,
    background: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Orthophoto or tiles under the map: a GeoTIFF, .mbtiles or .pmtiles file."),
    ] = None,
    user: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name that is kept with decisions. Default: that of the login.")
    ] = None,
) -> None:
    """Look at a labelled survey in the browser, and correct it.

    Starts a server that only this computer reaches, and the browser. Decisions are kept in corrections.sqlite in the
    folder. A folder without labelled points has a report alone, which is opened.
    """
    with one_line_errors(verbose=False):
        place = Path(expanded([results])[0])
        folders = (place, default_output([str(place)]))
        under = None if background is None else Path(expanded([background])[0])
        if under is not None and report:
            raise ParameterError("--background is for the page: leave out --report")
        if report or not _show_page(folders, under, port=port, browser=browser, export=export, user=user):
            _show_report(place, folders, browser=browser)


def _show_page(
    folders: tuple[Path, Path], under: Path | None, *, port: int, browser: bool, export: str | None, user: str | None
) -> bool:
    """Serve or export the page of the first folder with labelled points; return whether there is one."""
    from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

    found = (OutputFolder.find(folder) for folder in folders)
    output = next((folder for folder in found if folder is not None and folder.cloud_names), None)
    if output is None and under is not None:
        raise ReadError(f"{folders[0]} holds no labelled points to show on a map: leave out --background")
    if output is None:
        return False
    background = None
    if under is not None:
        from mlsroad_pipeline.review.page_server.background import open_background

        background = open_background(under, output.path)
    if export is not None:
        from mlsroad_pipeline.review.page_server.export import export_page

        typer.echo(str(export_page(output, Path(expanded([export])[0]), background=background)))
        return True
    from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
    from mlsroad_pipeline.review.page_server.server import serve

    survey = ServedSurvey(output, user=user or login_name(), background=background)
    serve(survey, port=port, browser=browser, show=typer.echo)
    return True


def _show_report(place: Path, folders: tuple[Path, Path], *, browser: bool) -> None:
    found = next((folder / name for folder in folders for name in REPORTS if (folder / name).is_file()), None)
    if found is None:
        raise ReadError(f"{place} holds no {' or '.join(REPORTS)}: label the survey first (mlsroad label FILE)")
    typer.echo(str(found))
    if browser and not webbrowser.open(found.as_uri()):
        typer.echo("No browser was found: open this file in one.", err=True)
