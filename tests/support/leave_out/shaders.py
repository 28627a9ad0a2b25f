"""What the text of a shader uses: words, includes and defines, after its conditionals are resolved."""

from __future__ import annotations

import re

from pointsplat_addon.shading import sources
from pointsplat_addon.shading.interface import Interface

DIRECTIVE = re.compile(r"^\s*#\s*(ifdef|ifndef|if|elif|else|endif|define|undef)\b\s*(.*?)\s*(?://.*)?$")
WORD = re.compile(r"\w+")


def active(text: str, defines: dict[str, str]) -> str:
    """GLSL without comments and without what its conditionals leave out."""
    names, kept = dict(defines), []
    open_: list[tuple[bool, bool]] = []  # of each conditional: this branch is taken, some branch has been
    for line in text.splitlines():
        found = DIRECTIVE.match(line)
        on = all(taken for taken, _ in open_)
        if not found:
            if on:
                kept.append(line.split("//")[0])
            continue
        kind, rest = found.groups()
        if kind in ("ifdef", "ifndef", "if"):
            true = (rest.split()[0] in names) == (kind == "ifdef") if kind != "if" else _true(rest, names)
            open_.append((true, true))
        elif kind in ("elif", "else"):
            _, before = open_.pop()
            true = not before and (kind == "else" or _true(rest, names))
            open_.append((true, before or true))
        elif kind == "endif":
            open_.pop()
        elif on and kind == "define":
            name, _, value = rest.partition(" ")
            names[name] = value
            kept.append(value)
        elif on:
            names.pop(rest, None)
    return "\n".join(kept)


def _true(condition: str, names: dict[str, str]) -> bool:
    text = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda m: str(int(m[1] in names)), condition)
    text = re.sub(r"[A-Za-z_]\w*", lambda m: names.get(m[0]) or "0", text)
    return bool(eval(text.replace("&&", " and ").replace("||", " or ").replace("!", " not ")))


def stages(interface: Interface) -> list[str]:
    """The texts of a program, with their includes."""
    files = (interface.compute,) if interface.compute else (interface.vertex, interface.fragment)
    return [sources.load(file).text for file in files]


def words(interface: Interface) -> set[str]:
    """All words of the code that a program compiles."""
    return {word for text in stages(interface) for word in WORD.findall(active(text, dict(interface.defines)))}


def idle_defines(interface: Interface) -> set[str]:
    """Names that a program is told and that change nothing in it."""
    idle = set()
    for name, value in interface.defines:
        rest = {n: v for n, v in interface.defines if n != name}
        texts = [active(text, rest | {name: value}) for text in stages(interface)]
        same = texts == [active(text, rest) for text in stages(interface)]
        if same and not any(name in WORD.findall(text) for text in texts):
            idle.add(name)
    return idle
