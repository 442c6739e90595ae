"""The few pieces of HTML that a report is made of. Text arrives escaped."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files

from zoac.analysis.figures import style
from zoac.analysis.pages.formatting import NOTHING


def page(title: str, sections: Sequence[str]) -> str:
    """Return a whole document: a heading and what stands below."""
    css = files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n"
        f"<h1><small>Tuning report</small>{escape(title)}</h1>\n"
        + "\n".join(filter(None, sections))
        + "\n<footer>Made by zoac.analysis.report from the files of the runs.</footer>\n"
        "</main>\n</body>\n</html>\n"
    )


def part(title: str, *body: str, level: int = 3) -> str:
    """Return a part of the page with a heading, or nothing if there is nothing in it."""
    return f"<h{level}>{escape(title)}</h{level}>\n{''.join(body)}" if any(body) else ""


def paragraph(text: str, css: str = "") -> str:
    """Return a paragraph."""
    return f"<p{_class(css)}>{text}</p>\n"


def bullets(items: Sequence[str], css: str = "") -> str:
    """Return a list, or nothing if there are no items."""
    if not items:
        return ""
    lines = "".join(f"<li>{item}</li>\n" for item in items)
    return f'<ul class="{css}">\n{lines}</ul>\n'


def table(lines: Sequence[Sequence[str]], css: Sequence[str] = (), wide: Sequence[str] = ()) -> str:
    """Return header and rows as a table; on narrow screens each row becomes a card.

    Args:
        lines: Header and rows.
        css: A class for each row; empty: none has one.
        wide: Headers of columns that have a line of their own in a card.
    """
    header = lines[0]
    head = "".join(f"<th>{cell}</th>" for cell in header)
    body = ""
    for name, row in zip(css or [""] * len(lines[1:]), lines[1:], strict=True):
        cells = "".join(_cell(c, h, h in wide) for c, h in zip(row, header, strict=True))
        body += f"<tr{_class(name)}>{cells}</tr>\n"
    return (
        f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}</tbody>\n</table></div>\n"
    )


def _cell(cell: str, column: str, wide: bool) -> str:
    css = "none" if cell in ("", NOTHING) else "wide" if wide else ""
    label = f' data-label="{column}"' if column else ""
    return f"<td{_class(css)}{label}>{cell}</td>"


def _class(name: str) -> str:
    return f' class="{name}"' if name else ""


def verdict(text: str, met: bool | None) -> str:
    """Return a value with a mark, green where `met` and red where not; None: as it is."""
    if met is None:
        return text
    mark, css = ("✓", "met") if met else ("✗", "unmet")
    return f'<span class="{css}">{mark}</span> {text}'


def keys(names: Mapping[str, str]) -> str:
    """Return a legend for the marks of `placed`, mark -> text."""
    marks = (
        f'<span><span class="range"><i class="{mark}" style="left:7px"></i></span>{text}</span>'
        for mark, text in names.items()
    )
    return f'<div class="keys">{"".join(marks)}</div>\n'


def placed(places: Mapping[str, float], low: str, high: str) -> str:
    """Return a rail between two bounds, with a mark for each named place, 0 to 1."""
    marks = "".join(
        f'<i class="{name}" style="left:{100 * place:.1f}%"></i>' for name, place in places.items()
    )
    return (
        f'<div class="rail"><span>{low}</span>'
        f'<div class="range"><i class="line"></i>{marks}</div><span>{high}</span></div>'
    )


def tiles(values: Sequence[tuple[str, str]]) -> str:
    """Return a row of numbers with their names."""
    cells = "".join(f'<div class="tile"><b>{v}</b><span>{what}</span></div>' for what, v in values)
    return f'<div class="tiles">{cells}</div>\n'


def gallery(pictures: Sequence[str]) -> str:
    """Return pictures side by side, as many as there is room for."""
    return f'<div class="gallery">{"".join(pictures)}</div>\n' if pictures else ""


def folded(summary: str, body: str, opened: bool = False) -> str:
    """Return a part that opens on a click."""
    state = " open" if opened else ""
    return f"<details{state}>\n<summary>{summary}</summary>\n{body}</details>\n"


def code(text: str) -> str:
    """Return preformatted text, escaped here."""
    return f"<pre>{escape(text)}</pre>\n"


def figure(height: float = 2.7) -> tuple[style.Figure, style.Axes]:
    """Return a figure for `gallery`, and its axes."""
    made = style.blank(4.2, height)
    return made, made.subplots()


def picture(made: style.Figure, name: str, label: str, caption: str = "", columns: int = 0) -> str:
    """Return a figure as inline SVG.

    Args:
        made: The figure.
        name: Unique name on the page, from which the ids in the SVG derive.
        label: Description for screen readers.
        caption: Text below the picture.
        columns: At most, of a legend above the picture; 0: none is added.
    """
    if columns:
        style.legend_above(made, style.entries(made), columns)
    svg = style.image(made, "svg", salt=name).decode()
    svg = svg[svg.index("<svg") :]
    # Groups are numbered alike in every picture, and nothing refers to them.
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    # The size comes from the page, not from the file.
    svg = re.sub(r' (?:width|height)="[^"]*"', "", svg, count=2)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1)
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{svg}{text}</figure>\n"
