"""Keep the tables of msg_docs/ equal to the definitions and to the tables of topics and services.

Each page has one part between two comment lines, which is written here, and prose around it, which is not touched.
With --check nothing is written, and the exit status is 1 where a page is out of date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from unifeed_ros.nodes.services import SERVICES, Service
from unifeed_ros.nodes.topics import SENSOR, STREAM, TOPICS, Topic, publisher_qos

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "msg_docs"
BEGIN, END = "<!-- tables: scripts/msg_docs.py -->", "<!-- end of tables -->"
SECTIONS = {"msg": ("",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
ROW = re.compile(r"(?P<type>[\w/\[\]<=]+) +(?P<name>\w+)(?:=(?P<value>\S+))?$")


@dataclass(frozen=True)
class Entry:
    """One field or constant of a definition."""

    type: str
    """Type as the definition writes it."""
    name: str
    """Name."""
    value: str
    """Value of a constant; empty for a field."""
    text: str
    """Comment above it."""

    @property
    def unit(self) -> str:
        """Units that the comment names in brackets, joined; a dash without any."""
        return ", ".join(dict.fromkeys(re.findall(r"\[([^\]]+)\]", self.text))) or "-"

    @property
    def meaning(self) -> str:
        """The comment without units and full stop."""
        return re.sub(r" \[[^\]]+\]", "", self.text).rstrip(".").replace("|", "\\|")


def read_definition(path: Path) -> tuple[str, list[list[Entry]]]:
    """Read a .msg, .srv or .action file.

    Args:
        path: The file.

    Returns:
        The first comment, and the entries of each section.
    """
    title, sections, comment = "", [[]], []
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            comment.append(line.lstrip("# "))
        elif line == "---":
            sections.append([])
        elif not line:
            title, comment = (title or " ".join(comment)), []
        else:
            row = ROW.match(line)
            if row is None:
                raise ValueError(f"{path.name}: cannot read {line!r}")
            sections[-1].append(Entry(row["type"], row["name"], row["value"] or "", " ".join(comment)))
            comment = []
    return title, sections


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lay a Markdown table out."""
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)] + [""]


def quality(topic: Topic) -> str:
    """Say the publisher's quality of service in words."""
    profile = publisher_qos(topic)
    kept = f"keep last {profile.depth}"
    durability = profile.durability.short_key.replace("_", " ")
    readers = "; nodes read best effort" if topic.qos in (SENSOR, STREAM) else ""
    return f"{profile.reliability.short_key}, {durability}, {kept}{readers}"


def topic_table(topics: Sequence[Topic], *, with_type: bool = False) -> list[str]:
    """Lay topics out; the recorder reads every topic and is not named."""
    head = ["topic", *(["type"] if with_type else []), "rate", "quality of service", "written by", "read by"]
    rows = [[f"`{t.name}`", *([f"`{t.type}`"] if with_type else []), f"{t.rate:g} Hz" if t.rate else "on change",
             quality(t), ", ".join(t.writer), ", ".join((*t.readers, "recorder"))] for t in topics]
    return table(head, [[cell.replace("recorder, recorder", "recorder") for cell in row] for row in rows])


def service_table(services: Sequence[Service], *, with_type: bool = False) -> list[str]:
    """Lay services and actions out."""
    head = ["name", "kind", *(["type"] if with_type else []), "offered by", "an empty request"]
    return table(head, [[f"`{s.name}`", "action" if s.is_action else "service",
                         *([f"`{s.type}`"] if with_type else []), s.node, s.empty] for s in services])


def interface_tables(path: Path) -> list[str]:
    """Write the tables of one interface."""
    kind = path.suffix[1:]
    full_name = f"unifeed_msgs/{kind}/{path.stem}"
    title, sections = read_definition(path)
    lines = [f"`{full_name}`: {title}", ""]
    topics = [t for t in TOPICS if t.type == full_name]
    services = [s for s in SERVICES if s.type == full_name]
    lines += topic_table(topics) if topics else []
    lines += service_table(services) if services else []
    if kind == "msg" and not topics:
        lines += ["Part of other messages; no topic of its own.", ""]
    for heading, entries in zip(SECTIONS[kind], sections, strict=True):
        lines += [f"## {heading}", ""] if heading else []
        constants = [e for e in entries if e.value]
        if constants:
            lines += table(["constant", "type", "value", "meaning"],
                           [[f"`{e.name}`", f"`{e.type}`", e.value, e.meaning] for e in constants])
        rows = [[f"`{e.name}`", f"`{e.type}`", e.unit, e.meaning] for e in entries if not e.value]
        lines += table(["field", "type", "unit", "meaning"], rows) if rows else ["Empty.", ""]
    return lines


def all_tables() -> dict[Path, list[str]]:
    """Write the tables of every page."""
    interfaces = sorted(p for kind in SECTIONS for p in (ROOT / "unifeed_msgs" / kind).glob(f"*.{kind}"))
    pages = {PAGES / f"{path.stem}.md": interface_tables(path) for path in interfaces}
    pages[PAGES / "topics.md"] = topic_table(TOPICS, with_type=True)
    pages[PAGES / "services.md"] = service_table(SERVICES, with_type=True)
    return pages


def updated(page: Path, lines: Sequence[str]) -> str:
    """Put fresh tables into a page, and begin the page where there is none."""
    body = page.read_text() if page.exists() else f"# {page.stem}\n\n{BEGIN}\n{END}\n"
    before, _, rest = body.partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        raise ValueError(f"{page.name} lacks the lines {BEGIN} and {END}")
    return before + "\n".join([BEGIN, "", *lines]) + END + after


def main(arguments: Sequence[str]) -> int:
    """Update or check every page."""
    stale = [page for page, lines in all_tables().items()
             if not page.exists() or page.read_text() != updated(page, lines)]
    for page in stale:
        if "--check" in arguments:
            print(f"{page.relative_to(ROOT)} is out of date: run scripts/msg_docs.py", file=sys.stderr)
        else:
            page.write_text(updated(page, all_tables()[page]))
            print(f"wrote {page.relative_to(ROOT)}")
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
