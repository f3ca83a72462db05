"""Ways to spoil a file: what exporters, hands and ill will do to it. A seed repeats them."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

NUMBERS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"-0.0", b"1e308", b"1e-308", b"1e39", b"1e12", b"-1e12",
    b"2000000000", b"99999999999999999999", b"0x10", b"1,5", b"", b"one", b"1 2 3 4 5", b"3.14.15", b"1e",
    b"100000000", b"-2147483649",
)  # fmt: skip
PATHS = (
    b"missing.stl", b"../secret.obj", b"/etc/passwd", b"file:///etc/passwd", b"package://nowhere/a.stl",
    b"../secret.usda", b"../secret.usda:SDF_FORMAT_ARGS:a=b", b"`\"../secret.usda\"`",
    b"layer.usda:SDF_FORMAT_ARGS:a=b",
    b"..\\secret.obj", b"box.obj/../../secret.obj", b"package://robot/../secret.obj", b"../secret.xml", b"parts.xml",
    b"../secret.xacro", b"*.xacro", b"../*", b"../secret.yaml", b"sizes.yaml", b"rods.xacro",
    b"$(find robot)/rods.xacro",
    b"../secret.png", b"../secret.mtl",
    b"arm.urdf", b"", b".", b"..", b"/dev/zero", b"https://example.org/a.stl", b"a\x00b.stl",
    b"box.obj/../box.obj", b"x" * 5000, b"package:///box.obj", b"arm.xml", b"arm.usda",
)  # fmt: skip
WORDS = (
    b"", b"base", b"upper", b"shoulder", b"grip", b"world", b"fixed", b"planar", b"floating", b"ball",
    b"free", b"nonsense", b"\xff\xfe", b"Z", b"W", b"/", b"..", b"true", b"mesh", b"\xc3\xa4", b"a b", b"\n",
    b"${1/0}", b"${'a'*10**9}", b"$(find nowhere)",
)  # fmt: skip
EXPRESSIONS = (
    b"1/0", b"10**10**10", b"9**9**9", b"'a'*10**9", b"[0]*10**9", b"'%1000000000d' % 1", b"f'{1:1000000000}'",
    b"''.__class__", b"().__class__.__bases__[0].__subclasses__()", b"'{0.__class__}'.format(1)",
    b"(i for i in []).gi_frame",
    b"(lambda: 1).__code__", b"(lambda f: f(f))(lambda f: f(f))", b"xacro.load_yaml('/etc/passwd')", b"nan", b"-1",
    b"[]",
    b"xacro.load_yaml('../secret.yaml')", b"load_yaml('sizes.yaml')", b"xacro.arg('none')", b"open('/etc/passwd')",
    b"math",
    b"__import__('os').system('true')", b"python.vars(math)", b"[[0] * 999 for i in range(10 ** 6)]", b"inf - inf",
    b"'<a>'",
    b"[0 for i in range(999) for j in range(999)]", b"'x' * 900000", b"lambda: 1", b"(yield)", b"[" * 300,
    b"-" * 2000 + b"1",
    b"'\\ud800'", b"x" * 30000, b"name", b"None",
)  # fmt: skip
SUBSTITUTIONS = (
    b"$(env HOME)", b"$(optenv HOME 1)", b"$(find robot)", b"$(find ..)", b"$(eval 10**10**10)",
    b"$(eval ''.__class__)",
    b"$(arg none)", b"$(arg heavy)", b"$(cwd)", b"$(dirname)", b"$()", b"$(", b"${", b"$${x}", b"$(eval open('a'))",
)  # fmt: skip
HIDING = ((b"<!--", b"-->"), (b"<![CDATA[<!--]]>", b"<![CDATA[-->]]>"), (b"<?a <!-- ?>", b"<?a --> ?>"))
"""Beginnings and ends of what some parsers take for a comment and others do not."""
BOMB = (
    b'<!DOCTYPE bomb [<!ENTITY a "xxxxxxxxxx"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]>'
)
_NUMBER = re.compile(rb"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
_EXPRESSION = re.compile(rb"\$\{[^}]*\}")
_QUOTED = re.compile(rb'"([^"\n]*)"|(?<=>)([^<>\n]+)(?=<)')
_PATH = re.compile(
    rb'(?<=")[^"\n]+\.(?:obj|stl|dae|glb|mtl|png|usda|xacro|xml)(?=")|(?<=\')[^\'\n]+\.yaml(?=\')'
    rb"|(?<=@)[^@\n]+(?=@)|(?<=mtllib )\S+|(?<=>)[^<>\n]+\.obj(?=<)"
)

Mutation = Callable[[bytes, random.Random], bytes]


def number(data: bytes, rng: random.Random) -> bytes:
    """Another number, or none, where one stands."""
    return _replaced(data, rng, _NUMBER, NUMBERS)


def numbers(data: bytes, rng: random.Random) -> bytes:
    """The same, in several places."""
    for _ in range(rng.randint(2, 6)):
        data = number(data, rng)
    return data


def word(data: bytes, rng: random.Random) -> bytes:
    """Another value between quotes or tags."""
    return _replaced(data, rng, _QUOTED, tuple(b'"' + each + b'"' for each in WORDS))


def path(data: bytes, rng: random.Random) -> bytes:
    """Another file than the one named."""
    return _replaced(data, rng, _PATH, PATHS)


def expression(data: bytes, rng: random.Random) -> bytes:
    """Another expression of xacro, where one is or between quotes."""
    new = tuple(b"${" + each + b"}" for each in EXPRESSIONS) + SUBSTITUTIONS
    return _replaced(data, rng, _EXPRESSION if _EXPRESSION.search(data) and rng.random() < 0.7 else _QUOTED, new)


def hidden(data: bytes, rng: random.Random) -> bytes:
    """A file named within what looks like a comment to some parsers."""
    start, end = rng.choice(HIDING)
    named = rng.choice(
        (b'<include file="../secret.xml"/>', b'<asset><mesh name="s" file="../secret.obj"/></asset>',
         b'<xacro:include filename="../secret.xacro"/>', b"<include><uri>../secret.sdf</uri></include>")
    )  # fmt: skip
    position = data.find(b">\n", rng.randrange(len(data) + 1)) + 1
    return data[:position] + start + named + end + data[position:]


def value_moved(data: bytes, rng: random.Random) -> bytes:
    """A value of one place in another."""
    values = [match.group() for match in _QUOTED.finditer(data)]
    return _replaced(data, rng, _QUOTED, tuple(values) or (b'""',))


def line_dropped(data: bytes, rng: random.Random) -> bytes:
    """One to three lines left out."""
    lines = data.splitlines(keepends=True)
    first = rng.randrange(max(len(lines), 1))
    return b"".join(lines[:first] + lines[first + rng.randint(1, 3) :])


def line_repeated(data: bytes, rng: random.Random) -> bytes:
    """A line twice, or many times."""
    lines = data.splitlines(keepends=True)
    index = rng.randrange(max(len(lines), 1))
    return b"".join(lines[:index] + lines[index : index + 1] * rng.choice((2, 3, 2000)) + lines[index + 1 :])


def lines_swapped(data: bytes, rng: random.Random) -> bytes:
    """Two lines in each other's place."""
    lines = data.splitlines(keepends=True)
    if len(lines) > 1:
        first, second = rng.sample(range(len(lines)), 2)
        lines[first], lines[second] = lines[second], lines[first]
    return b"".join(lines)


def attribute_dropped(data: bytes, rng: random.Random) -> bytes:
    """An attribute of XML left out, or another assignment."""
    return _replaced(data, rng, re.compile(rb'\s[\w:]+\s*=\s*(?:"[^"]*"|[^\s]+)'), (b" ",))


def attribute_renamed(data: bytes, rng: random.Random) -> bytes:
    """An attribute's or element's name spoilt."""
    return _replaced(
        data,
        rng,
        re.compile(rb"(?<=[<\s])[A-Za-z_:]{3,}(?=[\s=>/])"),
        (b"nonsense", b"xacro:if", b"x:y", b"\xe4", b"include"),
    )


def cut(data: bytes, rng: random.Random) -> bytes:
    """The end missing, as after a full disk."""
    return data[: rng.randrange(len(data) + 1)]


def bytes_flipped(data: bytes, rng: random.Random) -> bytes:
    """One to eight bytes changed."""
    spoilt = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        if spoilt:
            spoilt[rng.randrange(len(spoilt))] = rng.randrange(256)
    return bytes(spoilt)


def words_written(data: bytes, rng: random.Random) -> bytes:
    """Four bytes that a decoder may take for a count, an index or a number, made extreme."""
    extreme = (
        b"\xff\xff\xff\xff",
        b"\xff\xff\xff\x7f",
        b"\0\0\0\x80",
        b"\0\0\xc0\x7f",
        b"\0\0\x80\x7f",
        b"\0\0\0\0",
        b"\0\0\0\x40",
    )
    position = rng.randrange(max(len(data) // 4, 1)) * 4 + rng.choice((0, 0, 0, 2))
    return data[:position] + rng.choice(extreme) + data[position + 4 :]


def recoded(data: bytes, rng: random.Random) -> bytes:
    """Another encoding than declared, or a mark of another."""
    text = data.decode("latin-1")
    return rng.choice(
        (
            text.encode("utf-16"),
            text.encode("utf-16-le"),
            text.encode("utf-32"),
            b"\xef\xbb\xbf" + data,
            b"\xff\xfe" + data,
            data + b"\xe4\xff",
            b"\n\n " + data,
        )
    )


def nested(data: bytes, rng: random.Random) -> bytes:
    """Very many elements within each other."""
    depth = rng.choice((50, 600, 5000, 100_000))
    position = data.find(b">", rng.randrange(len(data) + 1)) + 1
    return data[:position] + b"<body>" * depth + b"</body>" * depth + data[position:]


def bombed(data: bytes, rng: random.Random) -> bytes:
    """Entities that stand for much more than they say, or for a file."""
    position = data.find(b"?>") + 2 if b"?>" in data else 0
    outside = b'<!DOCTYPE x [<!ENTITY c SYSTEM "file:///etc/passwd">]>'
    head = data[:position] + rng.choice((BOMB, outside))
    return _replaced(head + data[position:], rng, _QUOTED, (b'"&c;"',))


def enlarged(data: bytes, rng: random.Random) -> bytes:
    """A count, in the formats' own words, that asks for more than a machine has."""
    huge = rng.choice((b"2000000000", b"100000000", b"4000000"))
    for pattern, form in (
        (rb"faceVertexCounts = \[[^]]*\]", b"faceVertexCounts = [" + huge + b"]"),
        (rb"faceVertexIndices = \[[^]]*\]", b"faceVertexIndices = [" + huge + b", 0, 1]"),
        (rb'count="\d+"', b'count="' + huge + b'"'),
        (rb'"count":\s*\d+', b'"count":' + huge),
        (rb"element (vertex|face) \d+", rb"element \1 " + huge),
        (rb'count="\d+"', b'count="-' + huge + b'"'),
        (rb"(?<=OFF\n)\d+ \d+", huge + b" " + huge),
    ):
        if rng.random() < 0.6:
            data = re.sub(pattern, form, data)
    return data


def replaced(data: bytes, rng: random.Random) -> bytes:
    """No such file at all: nothing, noise, or another format."""
    return rng.choice(
        (
            b"",
            b"\0" * 1000,
            rng.randbytes(300),
            b"PK\x03\x04" + data,
            b"#usda 1.0\n",
            b"<robot/>",
            b"<mujoco/>",
            b"<a>" * 3000,
            b"PXR-USDC" + rng.randbytes(200),
        )
    )


MUTATIONS: tuple[Mutation, ...] = (
    number, number, number, numbers, word, word, path, path, value_moved, expression, hidden, line_dropped,
    line_repeated,
    lines_swapped, attribute_dropped, attribute_renamed, cut, bytes_flipped, words_written, recoded, nested,
    bombed, enlarged, replaced,
)  # fmt: skip


def mutate(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """A file's data spoilt in one to three ways, and their names."""
    chosen = [rng.choice(MUTATIONS) for _ in range(rng.choice((1, 1, 1, 2, 3)))]
    for mutation in chosen:
        data = mutation(data, rng)
    return " ".join(mutation.__name__ for mutation in chosen), data


def _replaced(data: bytes, rng: random.Random, pattern: re.Pattern[bytes], by: tuple[bytes, ...]) -> bytes:
    matches = list(pattern.finditer(data))
    if not matches:
        return data
    match = rng.choice(matches)
    new = rng.choice(by)
    if not match.group().startswith(b'"') and new.startswith(b'"'):
        new = new.strip(b'"')
    return data[: match.start()] + new + data[match.end() :]
