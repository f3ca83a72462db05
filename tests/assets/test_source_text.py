"""XML of any encoding is read, and none that asks for more than the limits."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbit_assets.options import ReadLimits, ReadOptions
from orbit_assets.source_text import parse_xml, read_xml
from orbit_core.interfaces.errors import AssetError

TEXT = '<robot name="Käfer"><link name="base"/></robot>'
LIMITS = ReadLimits()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "latin-1"])
@pytest.mark.parametrize("declared", [True, False])
def test_every_encoding_reads_the_same(tmp_path: Path, encoding: str, declared: bool) -> None:
    path = tmp_path / "robot.urdf"
    name = encoding.removesuffix("-sig")
    head = f'<?xml version="1.0" encoding="{name}"?>\n' if declared else ""
    path.write_bytes((head + TEXT).encode(encoding))
    root = read_xml(path, ReadOptions())
    assert (root.tag, root.get("name"), len(root)) == ("robot", "Käfer", 1)


def test_comments_blank_lines_and_undeclared_prefixes_do_no_harm() -> None:
    text = '\n <?xml version="1.0"?>\n<!-- <robot> --><robot xacro:k="1"><gazebo:x/></robot>'
    root = parse_xml(text, "robot.urdf", LIMITS)
    assert root.get("xacro:k") == "1"
    assert root[0].tag == "gazebo:x"


def test_bytes_of_another_encoding_than_declared_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    for declared in ("utf-8", "klingon"):
        path.write_bytes(f'<?xml version="1.0" encoding="{declared}"?>{TEXT}'.encode("latin-1"))
        with pytest.raises(AssetError, match=f"not in its encoding, {declared}"):
            read_xml(path, ReadOptions())


def test_entities_are_refused() -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "xxxxxxxxxx"><!ENTITY b "&a;&a;&a;">]><r>&b;</r>'
    outside = '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><r>&a;</r>'
    for text in (bomb, outside):
        with pytest.raises(AssetError, match=r"robot\.urdf declares the entity 'a'"):
            parse_xml(text, "robot.urdf", LIMITS)


def test_too_many_elements_and_too_deep_ones_are_refused() -> None:
    limits = ReadLimits(elements=10, nesting=5)
    with pytest.raises(AssetError, match="more than 10 elements"):
        parse_xml(f"<r>{'<a/>' * 10}</r>", "robot.urdf", limits)
    with pytest.raises(AssetError, match="nests <a> in 5 others"):
        parse_xml("<a>" * 6 + "</a>" * 6, "robot.urdf", limits)
    assert len(parse_xml(f"<r>{'<a/>' * 9}</r>", "robot.urdf", limits)) == 9


def test_text_that_is_no_xml_is_refused() -> None:
    for text in ("", "no XML", "<a>", "<a></b>"):
        with pytest.raises(AssetError, match="not well-formed"):
            parse_xml(text, "robot.urdf", LIMITS)
