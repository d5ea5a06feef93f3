"""All stages' outputs to one self-contained HTML page."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import REPORT
from wibam_core.config import ReportConfig
from wibam_core.report.assemble import assemble
from wibam_core.report.render import render
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.graph import STAGES


def run(context: StageContext, config: ReportConfig) -> Summary:
    """Write `REPORT`."""
    titles = {name: spec.title for name, spec in STAGES.items()}
    labels = context.assets.get("labels")
    context.progress(0.0, "Reading what the other stages found")
    data = assemble(context.site.name, context.inputs, labels, titles, config.examples)
    context.progress(0.4, "Drawing")
    page = render(data)
    context.write(REPORT, page)
    context.progress(1.0)
    return {"bytes": len(page.encode()), "examples": len(data.examples)}
