"""The pages of msg_docs/ say what the built interfaces, the topic table and the service table say."""

from __future__ import annotations

import re
import runpy
from importlib import import_module
from pathlib import Path

import pytest

from unifeed_ros.nodes.services import SERVICES
from unifeed_ros.nodes.topics import TOPICS, publisher_qos

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "msg_docs"
DEFINITIONS = sorted(p for kind in ("msg", "srv", "action") for p in (ROOT / "unifeed_msgs" / kind).iterdir())
PARTS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
UNITS = {"1", "N", "Nm", "bit", "m", "m/s", "nat", "rad", "rad/s^3", "s"}
PYTHON_TYPES = {"double": "float64", "float": "float32", "boolean": "bool"}


def tables(text: str, head: str) -> list[list[list[str]]]:
    """Give the rows of every table whose header begins with these words."""
    found = []
    for block in re.split(r"\n\n", text):
        lines = block.splitlines()
        if lines and lines[0].startswith(head):
            found.append([[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
                          for line in lines[2:] if line.startswith("|")])
    return found


def interface(path: Path) -> type:
    return getattr(import_module(f"unifeed_msgs.{path.suffix[1:]}"), path.stem)


def parts(path: Path) -> list[type]:
    """Give the classes of an interface's sections: itself, request and response, or goal, result and feedback."""
    kind = interface(path)
    return [getattr(kind, part.lstrip("_")) if part else kind for part in PARTS[path.suffix[1:]]]


def as_built(page_type: str) -> str:
    """Write a type as the built Python class does."""
    name, array, bound = re.fullmatch(r"([\w/]+)(\[(?:<=(\d+))?\])?", page_type).groups()
    name = {v: k for k, v in PYTHON_TYPES.items()}.get(name, name)
    if "/" not in name and name[0].isupper():
        name = f"unifeed_msgs/{name}"
    return (f"sequence<{name}, {bound}>" if bound else f"sequence<{name}>") if array else name


def test_every_interface_has_a_page_and_every_page_an_interface():
    assert {p.stem for p in DEFINITIONS} == {p.stem for p in PAGES.glob("*.md")} - {"README", "topics", "services"}


def test_pages_are_up_to_date():
    script = runpy.run_path(str(ROOT / "scripts" / "msg_docs.py"))
    assert script["main"](["--check"]) == 0, "run scripts/msg_docs.py"


@pytest.mark.parametrize("path", DEFINITIONS, ids=lambda p: p.stem)
def test_fields_and_types_are_those_of_the_built_class(path):
    rows = [row for table in tables((PAGES / f"{path.stem}.md").read_text(), "| field |") for row in table]
    on_page = [(row[0].strip("`"), as_built(row[1].strip("`"))) for row in rows]
    built = [(name, kind) for part in parts(path) for name, kind in part.get_fields_and_field_types().items()
             if name != "structure_needs_at_least_one_member"]
    assert on_page == built


@pytest.mark.parametrize("path", DEFINITIONS, ids=lambda p: p.stem)
def test_units_are_those_of_the_definition_and_known(path):
    comments = "".join(line for line in path.read_text().splitlines() if line.startswith("#"))
    rows = [row for table in tables((PAGES / f"{path.stem}.md").read_text(), "| field |") for row in table]
    on_page = [unit for row in rows for unit in row[2].split(", ") if unit != "-"]
    assert set(on_page) == set(re.findall(r"\[([^\]]+)\]", comments)) <= UNITS


@pytest.mark.parametrize("path", DEFINITIONS, ids=lambda p: p.stem)
def test_constants_are_those_of_the_built_class(path):
    rows = [row for table in tables((PAGES / f"{path.stem}.md").read_text(), "| constant |") for row in table]
    classes = parts(path)
    for name, _, value, meaning in rows:
        assert any(getattr(c, name.strip("`"), None) == int(value) for c in classes)
        assert meaning
    assert len(rows) == len(re.findall(r"^\w+ +[A-Z_]+=", path.read_text(), re.M))


@pytest.mark.parametrize("path", DEFINITIONS, ids=lambda p: p.stem)
def test_pages_have_prose_below_the_tables(path):
    prose = (PAGES / f"{path.stem}.md").read_text().partition("<!-- end of tables -->")[2]
    assert len(prose.split()) >= 15
    if path.suffix in {".srv", ".action"}:
        assert "    ros2 service call /" in prose or "    ros2 action send_goal" in prose


def test_topics_page_says_what_the_table_says():
    (rows,) = tables((PAGES / "topics.md").read_text(), "| topic |")
    assert [row[0].strip("`") for row in rows] == [t.name for t in TOPICS]
    for row, topic in zip(rows, TOPICS, strict=True):
        _, kind, rate, quality, writers, readers = row
        profile = publisher_qos(topic)
        assert kind.strip("`") == topic.type
        assert rate == (f"{topic.rate:g} Hz" if topic.rate else "on change")
        assert f"keep last {profile.depth}" in quality
        assert profile.reliability.short_key in quality
        assert profile.durability.short_key.replace("_", " ") in quality
        assert tuple(writers.split(", ")) == topic.writer
        assert set(readers.split(", ")) == {*topic.readers, "recorder"}


def test_own_messages_on_topics_show_their_topic():
    for topic in TOPICS:
        package, _, name = topic.type.split("/")
        if package == "unifeed_msgs":
            assert f"| `{topic.name}` |" in (PAGES / f"{name}.md").read_text()


def test_services_page_says_what_the_table_says():
    (rows,) = tables((PAGES / "services.md").read_text(), "| name |")
    assert [(r[0].strip("`"), r[1], r[2].strip("`"), r[3], r[4]) for r in rows] == [
        (s.name, "action" if s.is_action else "service", s.type, s.node, s.empty) for s in SERVICES]


def test_types_of_the_service_table_exist_and_names_are_unique():
    assert len({s.name for s in SERVICES}) == len(SERVICES)
    for service in SERVICES:
        package, kind, name = service.type.split("/")
        assert hasattr(import_module(f"{package}.{kind}"), name)
    own = {f"unifeed_msgs/{p.suffix[1:]}/{p.stem}" for p in DEFINITIONS if p.suffix != ".msg"}
    assert own == {s.type for s in SERVICES if s.type.startswith("unifeed_msgs/")}
