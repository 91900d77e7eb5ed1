"""Writers of a manual's pages: PDF with ReportLab, and one HTML file with a drawing (SVG) a page."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from roboassembly.manual.line_drawing import Polygon
from roboassembly.manual.page import HEIGHT, MM_PER_POINT, WIDTH, Ink, Outline, Page, Text, printable

if TYPE_CHECKING:
    from reportlab.pdfgen.canvas import Canvas

_POINTS = 1.0 / MM_PER_POINT
_EVEN_ODD = 0
"""ReportLab's number of the rule by which holes stay empty."""
_STYLE = """
body { background: #e9ebee; margin: 0; font-family: Helvetica, Arial, sans-serif; }
main { display: flex; flex-wrap: wrap; justify-content: center; gap: 16px; padding: 16px; }
svg { background: white; width: min(100%, 210mm); height: auto; box-shadow: 0 1px 4px #0004; }
@page { size: A4; margin: 0; }
@media print {
  body { background: white; }
  main { display: block; padding: 0; }
  svg { width: 210mm; height: 297mm; box-shadow: none; break-after: page; display: block; }
}
"""


def pdf(pages: Sequence[Page], title: str) -> bytes:
    """Return the pages as a PDF; the same pages give the same bytes.

    Args:
        pages: in their order.
        title: of the document.
    """
    from reportlab.pdfgen.canvas import Canvas

    out = io.BytesIO()
    canvas = Canvas(out, pagesize=(WIDTH * _POINTS, HEIGHT * _POINTS), pageCompression=1, invariant=1)
    canvas.setTitle(title)
    canvas.setSubject("Assembly manual")
    canvas.setCreator("RoboAssembly")
    for page in pages:
        canvas.scale(_POINTS, _POINTS)
        canvas.setLineJoin(1)
        canvas.setLineCap(1)
        canvas.bookmarkPage(page.title)
        canvas.addOutlineEntry(printable(page.title), page.title)
        for item in page.items:
            if isinstance(item, Text):
                canvas.setFillColorRGB(*item.ink)
                canvas.setFont("Helvetica-Bold" if item.bold else "Helvetica", item.size * MM_PER_POINT)
                canvas.drawString(item.box.left, item.y, printable(item.text))
            else:
                _draw_path(canvas, item)
        canvas.showPage()
    canvas.save()
    return out.getvalue()


def _draw_path(canvas: Canvas, item: Outline) -> None:
    path = canvas.beginPath()
    for line in item.lines:
        (x, y), *others = line.round(2).tolist()
        path.moveTo(x, y)
        for across, upward in others:
            path.lineTo(across, upward)
        if item.closed:
            path.close()
    if item.fill is not None:
        canvas.setFillColorRGB(*item.fill)
    if item.stroke is not None:
        canvas.setStrokeColorRGB(*item.stroke)
        canvas.setLineWidth(item.width)
    canvas.drawPath(path, int(item.stroke is not None), int(item.fill is not None), fillMode=_EVEN_ODD)


def html(pages: Sequence[Page], title: str) -> str:
    """Return the pages as one HTML file that needs no network.

    Args:
        pages: in their order.
        title: of the document.
    """
    root = ElementTree.Element("html", lang="en")
    head = ElementTree.SubElement(root, "head")
    ElementTree.SubElement(head, "meta", charset="utf-8")
    ElementTree.SubElement(head, "meta", name="viewport", content="width=device-width, initial-scale=1")
    ElementTree.SubElement(head, "title").text = title
    ElementTree.SubElement(head, "style").text = _STYLE
    main = ElementTree.SubElement(ElementTree.SubElement(root, "body"), "main")
    main.extend(svg(page) for page in pages)
    return "<!DOCTYPE html>\n" + ElementTree.tostring(root, encoding="unicode", method="html") + "\n"


def svg(page: Page) -> ElementTree.Element:
    """Return a page as an SVG element."""
    root = ElementTree.Element(
        "svg", xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}", role="img"
    )
    ElementTree.SubElement(root, "title").text = page.title
    for item in page.items:
        if isinstance(item, Text):
            size = item.size * MM_PER_POINT
            text = ElementTree.SubElement(
                root, "text", x=_number(item.box.left), y=_number(HEIGHT - item.y), fill=_color(item.ink)
            )
            if item.bold:
                text.set("font-weight", "bold")
            text.set("font-size", _number(size))
            text.set("font-family", "Helvetica, Arial, sans-serif")
            # Browsers without these fonts keep to the width for which there is room.
            text.set("textLength", _number(item.box.width))
            text.set("lengthAdjust", "spacingAndGlyphs")
            text.text = item.text
        else:
            path = ElementTree.SubElement(root, "path", d=" ".join(_outline(line, item) for line in item.lines))
            path.set("fill", _color(item.fill))
            path.set("fill-rule", "evenodd")
            if item.stroke is not None:
                path.set("stroke", _color(item.stroke))
                path.set("stroke-width", _number(item.width))
                path.set("stroke-linejoin", "round")
                path.set("stroke-linecap", "round")
    return root


def _outline(line: Polygon, item: Outline) -> str:
    points = " ".join(f"{_number(x)},{_number(HEIGHT - y)}" for x, y in line.tolist())
    return f"M{points}{'Z' if item.closed else ''}"


def _number(value: float) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _color(ink: Ink | None) -> str:
    return "none" if ink is None else "#" + "".join(f"{round(255 * c):02x}" for c in ink)
