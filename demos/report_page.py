"""One self-contained HTML page of sections with pictures, tables and the commands behind them."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

__all__ = ["Section", "page", "printed_parts"]

STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #8881; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-top: 1px solid var(--line); padding-top: 1rem; }
img { width: 100%; max-width: 60rem; height: auto; background: white; border-radius: 6px; }
pre { background: var(--soft); padding: .6rem; overflow-x: auto; border-radius: 6px; font-size: .85rem; }
.table { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid var(--line); padding: .25rem .6rem; text-align: left; vertical-align: top; }
th, td { white-space: nowrap; } caption { text-align: left; font-style: italic; padding: .3rem .6rem; }
.failed { color: #c33; font-weight: 600; }
"""


@dataclass
class Section:
    """A part of the page: heading, prose, commands, pictures (files), tables (caption, then rows of text, the first the
    head), text that a command printed, and whether that command failed."""

    title: str
    prose: str = ""
    commands: Sequence[str] = ()
    pictures: Sequence[Path] = ()
    tables: list[tuple[str, list[list[str]]]] = field(default_factory=list)
    printed: str = ""
    failed: bool = False


def page(title: str, sections: Sequence[Section]) -> str:
    """The page's HTML, pictures included."""
    body = "\n".join([f"<h1>{html.escape(title)}</h1>", *map(_section, sections)])
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    head += f"<title>{html.escape(title)}</title>"
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n'
    )


def _section(section: Section) -> str:
    parts = [f"<section><h2>{html.escape(section.title)}</h2>"]
    if section.failed:
        parts.append('<p class="failed">This command failed; what it said last is below.</p>')
    if section.prose:
        parts.append(f"<p>{html.escape(section.prose)}</p>")
    parts += [f"<pre>{html.escape(command)}</pre>" for command in section.commands]
    for picture in section.pictures:
        data = base64.b64encode(picture.read_bytes()).decode()
        parts.append(f'<img alt="{html.escape(section.title)}" src="data:image/png;base64,{data}">')
    parts += [_table(rows, caption) for caption, rows in section.tables]
    parts.append(_printed(section.printed))
    return "\n".join([*parts, "</section>"])


def _table(rows: list[list[str]], caption: str = "") -> str:
    head, *rest = ([html.escape(cell) for cell in row] for row in rows)
    lines = ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rest]
    top = "".join(f"<th>{cell}</th>" for cell in head)
    label = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    inside = f"{label}<thead><tr>{top}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="table"><table>{inside}</table></div>'


def printed_parts(text: str) -> list[str | list[list[str]]]:
    """What a command printed: Markdown tables as rows of text, the first the head, and what stands between them."""
    parts: list[str | list[list[str]]] = []
    for is_table, lines in groupby(text.strip().splitlines(), key=lambda line: line.startswith("|")):
        if is_table:
            rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
            parts.append([row for row in rows if set("".join(row)) - set("-:")])
        elif kept := "\n".join(lines).strip():
            parts.append(kept)
    return parts


def _printed(text: str) -> str:
    parts = printed_parts(text)
    return "\n".join(f"<pre>{html.escape(p)}</pre>" if isinstance(p, str) else _table(p) for p in parts)
