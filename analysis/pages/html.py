"""The few pieces of HTML that a report is made of. Text arrives escaped."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zoac.analysis.figures import style

CSS = """
:root { --ink: #1d2730; --muted: #66727d; --line: #dde2e7; --soft: #f5f7f9; --accent: #0072b2;
        --warm: #b3571f; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff; font: 16px/1.55 system-ui, sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 2.5rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .5rem; letter-spacing: -.01em; }
h2 { font-size: 1.35rem; margin: 3rem 0 .75rem; padding-bottom: .4rem;
     border-bottom: 2px solid var(--ink); }
h3 { font-size: 1.05rem; margin: 2rem 0 .5rem; }
h4 { font-size: .95rem; margin: 1.6rem 0 .4rem; }
p { max-width: 46rem; margin: .5rem 0; }
.muted { color: var(--muted); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: .75rem;
         margin: 1rem 0; }
.tile { background: var(--soft); border-radius: 8px; padding: .7rem .9rem; }
.tile b { display: block; font-size: 1.35rem; font-weight: 600; line-height: 1.3;
          font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.tile span { color: var(--muted); font-size: .82rem; }
.scroll { overflow-x: auto; margin: .75rem 0; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums;
        min-width: 100%; }
th, td { padding: .38rem .7rem .38rem 0; text-align: right; border-bottom: 1px solid var(--line);
         white-space: nowrap; }
th { color: var(--muted); font-weight: 500; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
.gallery { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 22rem), 1fr));
           gap: 1rem; margin: 1rem 0; }
figure { margin: 0; min-width: 0; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { color: var(--muted); font-size: .82rem; }
details { border: 1px solid var(--line); border-radius: 8px; margin: 1rem 0; padding: 0 1rem; }
details[open] { padding-bottom: 1rem; }
summary { cursor: pointer; padding: .7rem 0; font-weight: 600; }
details details { background: var(--soft); border: 0; }
pre { background: var(--soft); border-radius: 8px; padding: .8rem 1rem; overflow-x: auto;
      font: .82rem/1.5 ui-monospace, monospace; margin: .5rem 0; }
ul { padding-left: 1.2rem; margin: .5rem 0; } li { margin: .2rem 0; overflow-wrap: anywhere; }
.warning { color: var(--warm); }
tr.met td { background: #e8f5ec; } tr.unmet td { background: #fbe9e4; }
tr.met td:last-child { color: #1b7a3d; } tr.unmet td:last-child { color: #b3261e; }
.range { position: relative; height: 1.1rem; min-width: 9rem; }
.range i { position: absolute; }
.range .rail { left: 0; right: 0; top: .5rem; height: 3px; background: var(--line);
               border-radius: 2px; }
.range .before { width: 9px; height: 9px; top: .32rem; margin-left: -5px; border-radius: 50%;
                 border: 2px solid var(--warm); background: #fff; }
.range .after { width: 11px; height: 11px; top: .26rem; margin-left: -5px; border-radius: 50%;
                background: var(--accent); }
.range .nominal { width: 2px; height: 1rem; top: .05rem; margin-left: -1px;
                  background: var(--ink); }
.keys { display: flex; gap: 1.2rem; font-size: .85rem; color: var(--muted); }
.keys .range { display: inline-block; min-width: 0; width: 14px; margin-right: .2rem;
               vertical-align: -4px; }
.bar { display: flex; height: 1.2rem; border-radius: 4px; overflow: hidden; margin: .5rem 0; }
.bar span { min-width: 1px; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; font-size: .85rem; }
.legend i { display: inline-block; width: .8em; height: .8em; border-radius: 2px;
            margin-right: .4em; }
footer { margin-top: 3rem; color: var(--muted); font-size: .82rem; }
@media (max-width: 640px) { main { padding-top: 1.25rem; } h1 { font-size: 1.35rem; }
  .tile b { font-size: 1.1rem; } details { padding: 0 .7rem; } }
@media print { details { border: 0; padding: 0; } main { max-width: none; } }
"""


def page(title: str, sections: Sequence[str]) -> str:
    """Return a whole document."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{CSS}</style>\n</head>\n<body>\n<main>\n"
        f"<h1>{escape(title)}</h1>\n"
        + "\n".join(sections)
        + "\n<footer>Made by zoac.analysis.report from the files of the runs.</footer>\n"
        "</main>\n</body>\n</html>\n"
    )


def section(title: str, *body: str) -> str:
    """Return a section with a heading."""
    return f"<section>\n<h2>{escape(title)}</h2>\n{''.join(body)}</section>\n"


def subtitle(text: str) -> str:
    """Return a heading within a section."""
    return f"<h3>{escape(text)}</h3>\n"


def paragraph(text: str, css: str = "") -> str:
    """Return a paragraph."""
    return f'<p class="{css}">{text}</p>\n' if css else f"<p>{text}</p>\n"


def bullets(items: Sequence[str], css: str = "") -> str:
    """Return a list, or nothing if there are no items."""
    if not items:
        return ""
    lines = "".join(f"<li>{item}</li>\n" for item in items)
    return f'<ul class="{css}">\n{lines}</ul>\n'


def table(lines: Sequence[Sequence[str]], css: Sequence[str] = ()) -> str:
    """Return header and rows as a table that scrolls sideways where the screen is narrow.

    Args:
        lines: Header and rows.
        css: A class for each row; empty: none has one.
    """
    head = "".join(f"<th>{cell}</th>" for cell in lines[0])
    marks = [f' class="{name}"' if name else "" for name in css] or [""] * len(lines[1:])
    body = "".join(
        f"<tr{mark}>{''.join(f'<td>{c}</td>' for c in row)}</tr>\n"
        for mark, row in zip(marks, lines[1:], strict=True)
    )
    return (
        f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}</tbody>\n</table></div>\n"
    )


def keys(names: Sequence[str]) -> str:
    """Return a legend for the marks of `placed`."""
    marks = (f'<span class="range"><i class="{n}" style="left:6px"></i></span>{n}' for n in names)
    return f'<div class="keys">{"".join(f"<span>{mark}</span>" for mark in marks)}</div>\n'


def placed(places: Mapping[str, float]) -> str:
    """Return a rail with a mark for each named place, 0 to 1: before, after or nominal."""
    marks = "".join(
        f'<i class="{name}" style="left:{100 * place:.1f}%"></i>' for name, place in places.items()
    )
    return f'<div class="range"><i class="rail"></i>{marks}</div>'


def tiles(values: Sequence[tuple[str, str]]) -> str:
    """Return a row of numbers with their names."""
    cells = "".join(f'<div class="tile"><b>{v}</b><span>{what}</span></div>' for what, v in values)
    return f'<div class="tiles">{cells}</div>\n'


def fractions(parts: Sequence[tuple[str, float]]) -> str:
    """Return a bar divided into fractions of the total, with a legend."""
    total = sum(value for _, value in parts) or 1.0
    colours = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#c4ccd4")
    bar, legend = "", ""
    for (name, value), colour in zip(parts, colours, strict=False):
        part = 100 * value / total
        bar += f'<span style="width:{part:.2f}%;background:{colour}"></span>'
        legend += (
            f'<span><i style="background:{colour}"></i>{name} {value:,.1f} s ({part:.0f}%)</span>'
        )
    return f'<div class="bar">{bar}</div><div class="legend">{legend}</div>\n'


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


def figure(height: float = 2.7) -> tuple[Figure, Axes]:
    """Return a figure for `gallery`, and its axes."""
    made = Figure(figsize=(4.2, height), layout="constrained")
    return made, made.subplots()


def picture(made: Figure, name: str, label: str, caption: str = "") -> str:
    """Return a figure as inline SVG.

    Args:
        made: The figure.
        name: Unique name on the page, from which the ids in the SVG derive.
        label: Description for screen readers.
        caption: Text below the picture.
    """
    svg = style.image(made, "svg", salt=name).decode()
    svg = svg[svg.index("<svg") :]
    # Groups are numbered alike in every picture, and nothing refers to them.
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    # The width comes from the page, not from the file.
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1)
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{svg}{text}</figure>\n"
