"""A report's data to one self-contained HTML page: no script, nothing from the network."""

from __future__ import annotations

import jinja2

from wibam_core.report.data import ReportData
from wibam_core.report.page import build_page
from wibam_core.report.pictures import draw_pictures


def render(data: ReportData) -> str:
    """The page. The same data give the same bytes."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("wibam_core", "report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    return environment.get_template("report.html.j2").render(page=build_page(data, draw_pictures(data)))
