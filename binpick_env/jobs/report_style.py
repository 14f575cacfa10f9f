"""Style sheet and HTML elements of the reports, which load nothing from a network and run no scripts."""

import base64
from collections.abc import Sequence
from html import escape

from binpick_env.jobs.report_glossary import glossary

_COLOURS = """
:root { color-scheme: light dark; --ink: #1d2330; --soft: #667085; --paper: #f6f7f9; --card: #ffffff; --line: #e3e7ee;
  --good: #1a8f5c; --bad: #d1453b; --idle: #b7791f; --accent: #2f5fd0; --track: #edf0f5; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9f0; --soft: #98a2b3; --paper: #12151c; --card: #1b202a;
  --line: #2c3340; --good: #3fbf85; --bad: #f0756c; --idle: #e0b04a; --accent: #86a8ff; --track: #262d39; } }
"""
_CURVES = """svg { display: block; width: 100%; max-width: 460px; } svg text { fill: var(--soft); font-size: 12px; }
svg polyline { fill: none; stroke-width: 2; } svg .axis { stroke: var(--line); stroke-width: 1; }
.line-0 { stroke: var(--accent); } .line-1 { stroke: var(--good); } .line-2 { stroke: var(--idle); }
svg text.line-0 { fill: var(--accent); stroke: none; } svg text.line-1 { fill: var(--good); stroke: none; }
svg text.line-2 { fill: var(--idle); stroke: none; }
"""
CSS = (
    _COLOURS
    + """* { box-sizing: border-box; } a { color: var(--accent); }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 32px 24px 64px; } main.wide { max-width: 1800px; }
h1 { font-size: 26px; margin: 0; letter-spacing: -.01em; overflow-wrap: anywhere; }
@media (max-width: 600px) { main { padding: 20px 12px 48px; } .card { padding: 12px; } }
h2 { font-size: 18px; margin: 40px 0 12px; }
p, figcaption, .soft { color: var(--soft); } p { margin: 4px 0; max-width: 80ch; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 12px; padding: 16px 18px; }
.grid { display: grid; gap: 14px; }
.tiles { grid-template-columns: repeat(auto-fit, minmax(230px, 1fr)); margin-top: 20px; }
.two { grid-template-columns: repeat(auto-fit, minmax(min(420px, 100%), 1fr)); } .grid > * { min-width: 0; }
.tile b { display: block; font-size: 32px; font-weight: 650; letter-spacing: -.02em; line-height: 1.2; }
.tile span { color: var(--soft); font-size: 13px; display: block; }
.range { position: relative; height: 6px; border-radius: 3px; background: var(--track); margin: 8px 0 6px; }
.range i { position: absolute; top: 0; height: 6px; border-radius: 3px; background: var(--accent); opacity: .45; }
.range u { position: absolute; top: -3px; width: 3px; height: 12px; margin-left: -1px; background: var(--accent); }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--soft); }
th, td { padding: 5px 10px 5px 0; border-bottom: 1px solid var(--line); }
td.n, th.n { text-align: right; } tr:last-child td { border-bottom: 0; }
.bar { display: grid; grid-template-columns: minmax(90px, 38%) 1fr 92px; gap: 10px; align-items: center; padding: 3px 0;
  font-size: 13.5px; }
.bar div { background: var(--track); border-radius: 4px; height: 14px; overflow: hidden; }
.bar i { display: block; height: 14px; } .bar span { text-align: right; font-variant-numeric: tabular-nums; }
.good { background: var(--good); } .bad { background: var(--bad); } .idle { background: var(--idle); }
.tag { display: inline-block; border-radius: 999px; padding: 0 9px; font-size: 12px; color: #fff; }
figure { margin: 0; } figure img { width: 100%; display: block; border-radius: 8px; }
figcaption { font-size: 12.5px; margin-top: 5px; }
.gallery { grid-template-columns: repeat(auto-fill, minmax(200px, 1fr)); }
.four { grid-template-columns: repeat(auto-fit, minmax(260px, 1fr)); }
"""
    + _CURVES
    + """.zoom, .zoom button { display: block; position: static; width: 100%; height: auto; margin: 0; border: 0;
  padding: 0; background: none; color: inherit; font: inherit; } .zoom button { cursor: zoom-in; }
.zoom:popover-open { position: fixed; inset: 0; height: 100%; overflow: auto; background: rgb(0 0 0 / .86); }
.zoom:popover-open button { display: grid; place-items: center; min-height: 100%; cursor: zoom-out; }
.zoom:popover-open img { width: 96vw; height: 96vh; object-fit: contain; background: none; }
@media (max-width: 900px) { .zoom:popover-open button { width: max-content; min-width: 100%; }
  .zoom:popover-open img { width: auto; height: auto; min-width: 900px; max-width: none; } }
details { margin-top: 10px; } summary { cursor: pointer; color: var(--accent); font-size: 13.5px; }
.strip { display: flex; flex-wrap: wrap; gap: 3px; margin: 10px 0 2px; }
.strip i { width: 15px; height: 15px; border-radius: 4px; }
.scroll { overflow-x: auto; } code { font-size: 12.5px; overflow-wrap: anywhere; } .bin { margin-bottom: 14px; }
dt { font-weight: 600; } dd { margin: 0 0 8px; max-width: 80ch; }
h3 { font-size: 15px; margin: 16px 0 8px; } h3:first-child { margin-top: 0; }
.bin h3 { margin: 0 0 8px; font-size: 15px; } .bin h3 span { color: var(--soft); font-weight: 400; }
"""
)
_PICTURE = "<div class='zoom'><button>"  # opening tags of a picture until a page numbers it


def page(title: str, body: str, wide: bool = False) -> str:
    """Return an HTML document that explains its terms at the end; ``wide`` gives rows of pictures more room."""
    head = f"<meta charset='utf-8'><meta name='viewport' content='width=device-width'><title>{escape(title)}</title>"
    head += f"<style>{CSS}</style>"
    main = f"<main{' class=wide' if wide else ''}>{body}{glossary(body)}</main>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{_numbered(main)}</body></html>\n"


def tile(name: str, value: str, note: str, bounds: tuple[float, float, float] | None = None) -> str:
    """Return a card with one number; ``bounds`` (low, high, estimate) in [0, 1] are drawn as a bar below it."""
    track = ""
    if bounds is not None:
        low, high, estimate = (100 * min(max(x, 0.0), 1.0) for x in bounds)
        span = f"<i style='left:{low:.2f}%;width:{high - low:.2f}%'></i>"
        track = f"<div class='range'>{span}<u style='left:{estimate:.2f}%'></u></div>"
    figures = f"<span>{escape(name)}</span><b>{escape(value)}</b>"
    return f"<div class='card tile'>{figures}{track}<span>{escape(note)}</span></div>"


def bars(rows: Sequence[tuple[str, int, str]], total: int) -> str:
    """Return horizontal bars, one for each (name, count, CSS class), whose full length is ``total``."""
    lines = []
    for name, count, kind in rows:
        share = count / total if total else 0.0
        fill = f"<i class='{kind}' style='width:{100 * share:.1f}%'></i>"
        lines.append(
            f"<div class='bar'>{escape(name)}<div>{fill}</div><span>{count} · {100 * share:.1f} %</span></div>"
        )
    return "".join(lines) or "<p>none</p>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[int] = (0,)) -> str:
    """Return a table of HTML cells; columns not in ``words`` hold numbers and are flush right."""

    def line(cells: Sequence[str], tag: str) -> str:
        marked = (f"<{tag}{'' if k in words else ' class=n'}>{cell}</{tag}>" for k, cell in enumerate(cells))
        return f"<tr>{''.join(marked)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f"<div class='scroll'><table>{line(list(map(escape, header)), 'th')}{body}</table></div>"


def tag(text: str, kind: str) -> str:
    """Return a coloured label."""
    return f"<span class='tag {kind}'>{escape(text)}</span>"


def picture(source: str, alt: str) -> str:
    """Return a picture that fills the window when it is clicked; another click or Escape puts it back.

    In a narrow window it is at least 900 px wide, and is scrolled. No script is needed: the picture is a popover, which
    `page` numbers, that is also shown while it is closed. Browsers before 2024 leave it small.

    Args:
        source: Data URI, or path of the file relative to the page.
        alt: Text for those who do not see the picture.
    """
    later = "" if source.startswith("data:") else " loading='lazy'"
    image = f"<img alt='{escape(alt, quote=True)}'{later} src='{source}'>"
    return f"{_PICTURE}{image}</button></div>"


def _numbered(body: str) -> str:
    """Return a page's contents with a popover of its own for each picture."""
    before, *pictures = body.split(_PICTURE)
    opening = "<div class='zoom' popover id='picture-{0}'><button popovertarget='picture-{0}'>"
    return before + "".join(opening.format(k) + rest for k, rest in enumerate(pictures))


def figure(source: str | None, caption: str, alt: str) -> str:
    """Return a figure with its caption in HTML, or a note if there is no ``source``; see `picture`."""
    shown = "<p>no picture</p>" if source is None else picture(source, alt)
    return f"<figure>{shown}<figcaption>{caption}</figcaption></figure>"


def inline_figure(data: bytes, kind: str, caption: str, alt: str = "") -> str:
    """Return an inline figure of an encoded picture, whose ``kind`` is ``jpeg``, ``webp`` or ``png``.

    The caption in HTML serves as alternative text unless another is given.
    """
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return figure(source, caption, alt or caption)


Curve = tuple[str, Sequence[tuple[float, float]]]  # name and points


def curves(lines: Sequence[Curve], across: str, up: str, right: float = 1.0) -> str:
    """Return an SVG plot of up to three named curves.

    Args:
        lines: Names of the curves, and their points (x, y) with x in [0, ``right``] and y in [0, 1].
        across: Name of the horizontal axis.
        up: Name of the vertical axis.
        right: Right end of the horizontal axis.
    """
    left, top, size = 44, 12, 340

    def at(x: float, y: float) -> str:
        return f"{left + size * x:.1f},{top + size * (1 - y):.1f}"

    drawn = []
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        for start, end in ((at(tick, 0), at(tick, 1)), (at(0, tick), at(1, tick))):
            drawn.append(f"<polyline class='axis' points='{start} {end}'/>")
        x, y = left + size * tick, top + size * (1 - tick)
        drawn.append(f"<text x='{x:.0f}' y='{top + size + 17}' text-anchor='middle'>{tick * right:g}</text>")
        drawn.append(f"<text x='{left - 7}' y='{y + 4:.0f}' text-anchor='end'>{tick:g}</text>")
    for k, (name, points) in enumerate(lines):
        drawn.append(f"<polyline class='line-{k}' points='{' '.join(at(x / right, y) for x, y in points)}'/>")
        drawn.append(f"<text class='line-{k}' x='{left + 10}' y='{top + size - 12 - 17 * k}'>{escape(name)}</text>")
    middle = left + size // 2
    drawn.append(f"<text x='{middle}' y='{top + size + 36}' text-anchor='middle'>{escape(across)}</text>")
    turned = f"transform='rotate(-90 12 {top + size // 2})'"
    drawn.append(f"<text x='12' y='{top + size // 2}' text-anchor='middle' {turned}>{escape(up)}</text>")
    label = escape(f"{up} against {across}", quote=True)
    box = f"0 0 {left + size + 16} {top + size + 44}"
    return f"<svg role='img' aria-label='{label}' viewBox='{box}'>{''.join(drawn)}</svg>"


def svg_file(plot: str) -> str:
    """Return a plot of :func:`curves` as the text of an SVG file, with the colours of the reports."""
    opening, rest = plot.split(">", 1)
    return f"{opening} xmlns='http://www.w3.org/2000/svg'><style>{_COLOURS}{_CURVES}</style>{rest}\n"
