"""The tables of docs/notes/leave_out.md: what each row of `rows` draws, sends and compiles.

python -m tests.support.leave_out.tables [--write-docs]
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from pathlib import Path

from pointsplat_addon.devices.null import NullDevice
from tests.support.leave_out.rows import ROWS, found

DOCS = Path(__file__).resolve().parents[3] / "docs" / "notes" / "leave_out.md"
BEGIN, END = "<!-- tables: tests/support/leave_out -->", "<!-- end of tables -->"


def _plain(name: str) -> str:
    return re.sub("^(ps|out|PS)_", "", name).replace("_", " ")


def _counted(names: list[str]) -> str:
    return ", ".join(name if n == 1 else f"{n} × {name}" for name, n in sorted(Counter(names).items()))


def drawn_textures(device: NullDevice) -> str:
    """Formats and numbers of the textures that shaders write, by what they hold."""
    names: dict[int, str] = {}
    for call in device.calls:
        if call.target is not None:
            for (_, output), texture in zip(call.interface.outputs, call.target.colors, strict=True):
                names.setdefault(id(texture), _plain(output))
        for image, texture in call.images.items():
            names.setdefault(id(texture), _plain(image))
    drawn = [f"{names[id(t)]} {t.format}" for t in device.textures if id(t) in names]
    return _counted([*drawn, *(["depth buffer"] * sum(target.depth for target in device.targets))])


def uploaded_textures(device: NullDevice) -> str:
    """Formats and numbers of the textures that are sent, by the names by which shaders read them."""
    names: dict[int, str] = {}
    for call in device.calls:
        for _, sampler in call.interface.samplers:
            names.setdefault(id(call.textures[sampler]), _plain(sampler))
    return _counted([f"{names[id(t)]} {t.format}" for t in device.textures if t.uploaded and id(t) in names])


def programs(device: NullDevice) -> str:
    """The programs that are compiled, with their variants."""
    said = []
    for interface in device.interfaces:
        kept = [f"{_plain(name).lower()}{'' if value == '1' else ' ' + value}" for name, value in interface.defines]
        said.append(f"{interface.name} ({', '.join(kept)})" if kept else interface.name)
    return "; ".join(said)


def tables() -> str:
    """All rows, as Markdown."""
    kinds = {
        "Passes": ("passes that run", lambda found: ", ".join(found.ran)),
        "Textures that are drawn into": ("textures", lambda found: drawn_textures(found.device)),
        "Tables and attributes that are sent": ("textures", lambda found: uploaded_textures(found.device)),
        "Programs": (
            "programs, and how they are told apart",
            lambda found: f"{len(found.device.interfaces)}: {programs(found.device)}",
        ),
    }
    text = [BEGIN, ""]
    for title, (head, of) in kinds.items():
        text += [f"## {title}", "", f"| scene | {head} |", "|---|---|"]
        text += [f"| {name} | {of(found(name))} |".replace("  |", " |") for name in ROWS]
        text.append("")
    return "\n".join([*text, END])


def with_tables(text: str) -> str:
    """The page with its tables as they are now."""
    return text[: text.index(BEGIN)] + tables() + text[text.index(END) + len(END) :]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write-docs", action="store_true", help="replace the tables in docs/notes/leave_out.md")
    if parser.parse_args().write_docs:
        DOCS.write_text(with_tables(DOCS.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        sys.stdout.write(tables() + "\n")


if __name__ == "__main__":
    main()
