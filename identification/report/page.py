"""A document as one HTML file: everything inside, nothing to fetch, no script.

Here: the rendering of value objects by a template that escapes every text by itself. Not here: what is said.
"""

from __future__ import annotations

from functools import lru_cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from identification.report.document import Document, Panel
from identification.report.panels import Sheets, draw_panel


def render(document: Document) -> str:
    """The document as HTML text, the same for the same document."""
    numbers, sheets = iter(range(1_000_000)), Sheets()
    style = Markup(_environment().get_template("report.css").render())

    def svg(panel: Panel) -> Markup:
        # Each drawing names its clip paths; one page must not hold a name twice.
        return Markup(draw_panel(panel, f"panel-{next(numbers)}", sheets))

    template = _environment().get_template("report.html")
    return template.render(document=document, style=style, svg=svg) + "\n"


@lru_cache(maxsize=1)
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("identification.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
