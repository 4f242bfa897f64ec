"""The verbs `report` and `view`: a result as a web page."""

import argparse
from pathlib import Path
from typing import Any

from pipeline.cli.options import SharedOptions
from pipeline.cli.terminal import show_notes, show_progress


def add_verbs(verbs: Any, shared: SharedOptions) -> None:
    """Add the verbs `report` and `view`."""
    folder = argparse.ArgumentParser(add_help=False)
    folder.add_argument("folder", metavar="FOLDER", type=Path, help="a result folder, such as outputs/bar")

    report = verbs.add_parser(
        "report", parents=[*shared, folder], help="write report.html, which shows a result folder on one page"
    )
    report.set_defaults(run=_report)

    view = verbs.add_parser(
        "view", parents=[*shared, folder], help="open report.html; write it first if it is missing or outdated"
    )
    view.add_argument("--no-open", action="store_true", help="print the path of the page and do not open it")
    view.set_defaults(run=_view)


def _report(options: argparse.Namespace) -> int:
    from pipeline.results.report import write_report

    with show_progress(options.quiet) as bar:
        path = write_report(options.folder, bar.show_reading)
    if not options.quiet:
        print(path)
    return 0


def _view(options: argparse.Namespace) -> int:
    import webbrowser

    from pipeline.results.report import REPORT, is_report_current, write_report

    path = options.folder / REPORT
    if not is_report_current(options.folder):
        with show_progress(options.quiet) as bar:
            write_report(options.folder, bar.show_reading)
    if not options.quiet:
        print(path)
    if not options.no_open and not webbrowser.open(path.absolute().as_uri()):
        show_notes([f"no browser could be started; open {path} yourself"])
    return 0
