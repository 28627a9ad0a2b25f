"""Blender's window as the desktop tests see it: pictures of it, and what was found wrong."""

import os
import shutil
import subprocess

import bpy

problems = []


def say(text):
    print(f"desktop: {text}", flush=True)


def check(truth, fact):
    say(f"{'ok' if truth else 'WRONG'}: {fact}")
    if not truth:
        problems.append(fact)


def viewport():
    """(window, area, region, space) of the 3D viewport."""
    window = bpy.context.window_manager.windows[0]
    area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
    region = next(r for r in area.regions if r.type == "WINDOW")
    return window, area, region, area.spaces.active


def save_picture(path, area=None):
    """Save a picture of Blender's window: with ImageMagick and xdotool where they are, else with Blender's operator.

    Blender reads the front buffer, which is black on software OpenGL under X11.
    """
    if os.environ.get("DISPLAY") and shutil.which("import") and shutil.which("xdotool"):
        search = ["xdotool", "search", "--onlyvisible", "--class", "blender"]
        found = subprocess.run(search, capture_output=True, text=True, check=True).stdout.split()
        subprocess.run(["import", "-window", found[0], str(path)], check=True)
        return
    window = bpy.context.window_manager.windows[0]
    area = area or viewport()[1]
    region = next(r for r in area.regions if r.type == "WINDOW")
    with bpy.context.temp_override(window=window, screen=window.screen, area=area, region=region):
        bpy.ops.screen.screenshot(filepath=str(path), check_existing=False)


def shoot(folder, name):
    """Save a picture of the window and return the viewport's pixels as rows of RGB triples, every eighth of the window
    each way, without its rim: an area that was split and joined may be a pixel narrower."""
    region = viewport()[2]
    path = folder / f"{name}.png"
    save_picture(path)
    image = bpy.data.images.load(str(path))
    width = image.size[0]
    pixels = image.pixels[:]
    bpy.data.images.remove(image)
    if not any(pixels[i] for i in range(0, len(pixels), 4)):
        raise RuntimeError("pictures of the window are black here; install ImageMagick and xdotool")
    columns, rows = (
        range(8 * (start // 8 + 2), start + extent - 8, 8)
        for start, extent in ((region.x, region.width), (region.y, region.height))
    )
    return [[pixels[(y * width + x) * 4 : (y * width + x) * 4 + 3] for x in columns] for y in rows]


def difference(a, b):
    """Mean absolute difference of two such pictures, in display units from 0 to 1."""
    pairs = [(p, q) for row, other in zip(a, b, strict=False) for p, q in zip(row, other, strict=False)]
    return sum(abs(u - v) for p, q in pairs for u, v in zip(p, q, strict=True)) / (3 * len(pairs))
