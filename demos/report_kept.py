"""What a full run leaves in the repository: CSV files of the commands, of each run's effort and of every table printed, the
pictures, and a page that is written from these files alone."""

import csv
import shutil
from collections.abc import Sequence
from pathlib import Path

from demos.report_page import printed_parts
from demos.report_tables import effort, histories

__all__ = ["keep", "page", "read"]

HEAD = """# A full run
Written from the files in [full_run/](full_run) that `./run python3 demos/reproduce.py --full --keep docs/full_run` left: the
commands, what they printed, and the pictures they drew. Seconds are wall time on a machine of two cores with other work."""

Rows = list[list[str]]


def read(path: Path) -> Rows:
    """The rows of a CSV file, the head first."""
    with path.open(newline="") as file:
        return list(csv.reader(file))


def _write(path: Path, rows: Rows) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def keep(titles: dict[str, str], done: dict[str, dict], made: str, output: Path, folder: Path) -> None:
    """Write the files of the commands that are `done`, their titles by name, `made` with what, and the page beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in (path for name in titles for path in folder.glob(f"{name}.*")):
        old.unlink()
    commands = [["name", "title", "command", "status", "seconds"]]
    for name in (name for name in titles if name in done):
        it, mine = done[name], output / name
        commands.append([name, titles[name], it["command"], str(it["status"]), f"{it['seconds']:.0f}"])
        if histories(mine):
            _write(folder / f"{name}.effort.csv", effort(mine))
        for k, part in enumerate(printed_parts(it["said"])):
            if isinstance(part, str):
                (folder / f"{name}.{k}.txt").write_text(part + "\n")
            else:
                _write(folder / f"{name}.{k}.csv", part)
        for picture in sorted(mine.glob("figure*.png")):
            shutil.copy(picture, folder)
            (folder / f"{name}.picture.txt").write_text(f"{picture.name}\n")
    _write(folder / "commands.csv", commands)
    (folder / "made.txt").write_text(f"{made}\n")
    folder.with_suffix(".md").write_text(page(folder))


def page(folder: Path) -> str:
    """The page as Markdown, from the files alone."""
    out = [HEAD, (folder / "made.txt").read_text().strip()]
    for name, title, command, status, seconds in read(folder / "commands.csv")[1:]:
        missed = "" if status == "0" else f" It ended with the status {status}: something in it misses its tolerance."
        out += [f"## {title}", f"`{command}`: {seconds} s.{missed}"]
        if (shown := folder / f"{name}.picture.txt").exists():
            out.append(f"![{title}]({folder.name}/{shown.read_text().strip()})")
        if (path := folder / f"{name}.effort.csv").exists():
            out.append(_table(read(path)))
        said = [path for path in folder.glob(f"{name}.*.*") if path.name.split(".")[1].isdigit()]
        for path in sorted(said, key=lambda path: int(path.name.split(".")[1])):
            out.append(_table(read(path)) if path.suffix == ".csv" else f"```\n{path.read_text().strip()}\n```")
    return "\n\n".join(out) + "\n"


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *rest = rows
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rest))
