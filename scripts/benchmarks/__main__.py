"""Speed and memory, as ratios within one run: all that docs/notes/benchmarks.md reports.

    python -m scripts.benchmarks [--quick] [--only PART ...] [--json FILE] [--write-docs]

Parts: hierarchy, sampling, order, shadow, frame, instances, hybrid, translucent, strands, defocus, leave_out, blender.
What a part compares with (SciPy, VTK, the bpy package) must be installed in the running interpreter; where it is
missing, its rows have no value.
`--only frame` and `--only translucent` need NumPy and moderngl alone, and so run on a machine with a real GPU and no
Blender.
--write-docs replaces the figures of this interpreter's Blender in docs/notes/benchmarks.md.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import re
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs" / "notes" / "benchmarks.md"
Tables = dict[str, list[list[str]]]  # title to lines of cells, the head first


def plain(module: str) -> Callable[[bool], tuple[list[dict], Tables]]:
    """A part that has rows only."""
    return lambda quick: (importlib.import_module(module).run(quick), {})


def with_tables(module: str) -> Callable[[bool], tuple[list[dict], Tables]]:
    return lambda quick: importlib.import_module(module).run(quick)


PARTS = {
    "hierarchy": plain("scripts.benchmarks.hierarchy"),
    "sampling": plain("scripts.benchmarks.sampling"),
    "order": plain("scripts.benchmarks.order"),
    "shadow": plain("scripts.benchmarks.shadow"),
    "frame": with_tables("scripts.benchmarks.frame"),
    "instances": with_tables("scripts.benchmarks.instances"),
    "hybrid": with_tables("scripts.benchmarks.hybrid"),
    "translucent": plain("scripts.benchmarks.translucent"),
    "strands": plain("scripts.benchmarks.strands"),
    "defocus": plain("scripts.benchmarks.defocus"),
    "leave_out": with_tables("scripts.benchmarks.leave_out"),
    "blender": with_tables("scripts.benchmarks.blender"),
}


def met(row: dict) -> str:
    """Whether a row's value meets its target: yes, no, or nothing where either is missing."""
    target = row["target"]
    if row["value"] is None or target in ("", None):
        return ""
    # A bare number is the most that is allowed.
    sense, number = re.fullmatch(r"([<>]=?)?\s*([0-9.e+-]+)", str(target)).groups()  # type: ignore[union-attr]
    value, limit = float(row["value"]), float(number)
    return "yes" if {"<": value < limit, ">": value > limit, ">=": value >= limit}.get(sense, value <= limit) else "no"


def machine() -> str:
    """The processor, how many of its cores may be used, and the versions of all that matters."""
    model = platform.processor() or platform.machine()
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        found = re.search(r"model name\s*: (.*)", listed.read_text(encoding="utf-8", errors="replace"))
        model = found[1] if found else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    versions = [f"Python {platform.python_version()}"]
    for name in ("bpy", "numpy", "scipy", "vtk", "moderngl"):
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return f"{model}, {cores} cores in use; {platform.system()}; {', '.join(versions)}"


def busy() -> str:
    """How much else the machine had to do: a load well above what the benchmark itself makes spoils single times."""
    return f"load average {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""


def blender_name() -> str:
    try:
        return "Blender " + ".".join(version("bpy").split(".")[:2])
    except PackageNotFoundError:
        return "no Blender"


def value_text(row: dict) -> str:
    return "-" if row["value"] is None else f"{row['value']:.3g} {row['unit']}".strip()


def target_text(row: dict) -> str:
    target = row["target"]
    return f"<= {target}" if isinstance(target, int | float) else str(target)


def markdown(lines: list[list[str]]) -> str:
    cells = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    cells.insert(1, ["---"] + ["---"] * (len(cells[0]) - 1))
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def document(part: str, rows: list[dict], tables: Tables, quick: bool, load: str) -> str:
    """One part as Markdown."""
    text = [f"### {part.replace('_', ' ').capitalize()}", f"{machine()}; {load} at the start."]
    if quick:
        text.append("A `--quick` run: a tenth of the sizes, of no use for judging targets.")
    lines = [["what", "measured", "target", "met", "how"]]
    lines += [[r["name"], value_text(r), target_text(r), met(r), r["note"]] for r in rows]
    text.append(markdown(lines))
    for title, table in tables.items():
        text += [f"**{title}**", markdown(table)]
    return "\n\n".join(text)


def write_docs(part: str, text: str) -> None:
    """Replace what stands between the markers of this part with this Blender; add them where there are none."""
    name = blender_name()
    begin, end = f"<!-- figures: {name}, {part} -->", f"<!-- end of figures: {name}, {part} -->"
    before = DOCS.read_text(encoding="utf-8")
    block = f"{begin}\n\n{text}\n\n{end}"
    if begin in before:
        head, _, rest = before.partition(begin)
        after = head + block + rest.partition(end)[2]
    else:
        heading = f"## {name}"
        before = before if heading in before else f"{before.rstrip()}\n\n{heading}\n"
        head, _, rest = before.partition(heading)
        section, mark, others = rest.partition("\n## ")
        after = f"{head}{heading}{section.rstrip()}\n\n{block}\n{mark}{others}"
    DOCS.write_text(after, encoding="utf-8")


def show(part: str, rows: list[dict], tables: Tables) -> None:
    sys.stdout.write(f"\n{part}\n")
    for r in rows:
        sys.stdout.write(f"  {r['name']:72} {value_text(r):>14}  {target_text(r):8} {met(r):3}  {r['note']}\n")
    for title, table in tables.items():
        widths = [max(len(line[i]) for line in table) for i in range(len(table[0]))]
        sys.stdout.write(f"\n  {title}\n")
        for line in table:
            cells = [line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))]
            sys.stdout.write("    " + "  ".join(cells) + "\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the sizes: does it run at all?")
    parser.add_argument("--only", action="append", choices=PARTS, help="one part; may be given again")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--write-docs", action="store_true", help="replace the figures in docs/notes/benchmarks.md")
    options = parser.parse_args()
    load = busy()
    sys.stdout.write(f"{machine()}; {load}\n")
    found: dict[str, tuple[list[dict], Tables]] = {}
    for part in options.only or PARTS:
        if part == "hierarchy" and find_spec("scipy") is None:
            sys.stdout.write("\nhierarchy: SciPy is not installed\n")
            continue
        found[part] = PARTS[part](options.quick)
        show(part, *found[part])
        if options.write_docs:
            write_docs(part, document(part, *found[part], options.quick, load))
    if options.json:
        parts = {part: {"rows": [{**r, "met": met(r)} for r in rows], "tables": tables}
                 for part, (rows, tables) in found.items()}  # fmt: skip
        options.json.write_text(json.dumps({"machine": machine(), "load": load, "parts": parts}, indent=1) + "\n")


if __name__ == "__main__":
    main()
