"""A table of texts, as Markdown and as HTML, alone or with others on one page."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from neuse.evaluation.report import page


@dataclass(frozen=True)
class Table:
    """The first column names the rows.    command: that makes the table."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    command: str

    def markdown(self) -> str:
        """The table as GitHub shows it."""
        lines = [self.columns, tuple("---" for _ in self.columns), *self.rows]
        table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"## {self.title}\n\n{self.note}\n\n{table}\n\n`{self.command}`\n"

    def html(self) -> str:
        """The table as part of a page."""
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in self.columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows
        )
        return (
            f"<h2>{html.escape(self.title)}</h2><p>{html.escape(self.note)}</p>"
            f"<table><tr>{head}</tr>{body}</table><p><code>{html.escape(self.command)}</code></p>"
        )


def write_page(tables: Sequence[Table], docs: Path | None, file: Path) -> None:
    """All tables as Markdown, if asked for, and as a page that needs no other file."""
    if docs is not None:
        docs.parent.mkdir(parents=True, exist_ok=True)
        docs.write_text("# Results\n\n" + "\n".join(table.markdown() for table in tables))
    body = "\n".join(table.html() for table in tables)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(page("Results", body))


def command(name: str, seeds: int) -> str:
    """The command that makes one table over so many seeds."""
    return f"python -m neuse.evaluation.tables --out out/evaluate --seeds {seeds} --tables {name}"
