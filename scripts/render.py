"""Render a .blend file with PointSplat, with nothing but the bpy package (or inside Blender itself).

    python scripts/render.py FILE.blend --output OUT.png|OUT.exr [--frame N | --frames A-B] [--size WxH]
        [--camera NAME] [--device auto|blender_gpu|opengl] [--set NAME=VALUE ...] [--threads N] [--report R.json]
        [--cache DIR [--prepare]] [--strict] [--require VERSION] [--part K/N | --join N] [--parts DIR]
    blender -b --python scripts/render.py -- FILE.blend --output OUT.png ...

--set writes scene.pointsplat.NAME. With --frames, the frame's number goes before the ending of OUT (out_0001.png) and
the report is a list. A picture is written under another name and renamed when it is whole.

A large picture may be drawn in parts, --part 1/8 to 8/8, by several processes into a folder (--parts, OUT.parts by
default), and joined by --join 8: it is the picture of one process to the bit.

For farms: --cache names the folder of hierarchies, shadows and light that machines share; what may change from frame
to frame is written there by the second process that needs it, with --prepare by this one. --strict takes a missing file
for an error, and --require asks for a version of PointSplat, perhaps with that of Blender ("0.1.0+1f2e3d4c Blender
5.2.3"; reports have it). Exit codes: 0 rendered, 1 the render failed, 2 a wrong argument, 3 this machine cannot render
it: there is nothing to draw with, another version, a file is missing, or the disk is full.
"""

import argparse
import errno
import json
import os
import re
import shutil
import sys
import threading
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # run as a file, also by Blender: neither knows the checkout

from scripts.common.process import run  # noqa: E402
from scripts.common.version import version_of  # noqa: E402

FORMATS = {".png": "PNG", ".exr": "OPEN_EXR"}
LARGEST_SIDE = 65536  # Blender's own limit of scene.render.resolution_x


class ArgumentError(Exception):
    """What was asked makes no sense; the message says what would."""


class MachineError(Exception):
    """This machine cannot render the file, another one may."""


# ---------------------------------------------------------------------------- arguments


def size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[xX](\d+)", text)
    if not match or not all(4 <= int(side) <= LARGEST_SIDE for side in match.groups()):
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 1280x720, with sides from 4 to {LARGEST_SIDE}")
    return int(match[1]), int(match[2])


def frames(text: str) -> range:
    match = re.fullmatch(r"(-?\d+)-(-?\d+)", text)
    if not match or int(match[1]) > int(match[2]):
        raise argparse.ArgumentTypeError(f"{text!r} is no range of frames such as 1-24")
    return range(int(match[1]), int(match[2]) + 1)


def assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name.strip(), value.strip()


def part(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise argparse.ArgumentTypeError(f"{text!r} is no part such as 3/8")
    return int(match[1]), int(match[2])


def output(text: str) -> Path:
    path = Path(text).resolve()
    if path.suffix.lower() not in FORMATS:
        raise argparse.ArgumentTypeError(f"{text!r} must end in {' or '.join(FORMATS)}")
    return path


def arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, metavar="FILE.blend")
    parser.add_argument("--output", type=output, required=True, metavar="OUT.png|OUT.exr")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", type=int, metavar="N", help="default: the file's current frame")
    which.add_argument("--frames", type=frames, metavar="A-B")
    parser.add_argument("--size", type=size, metavar="WxH", help="default: the file's")
    parser.add_argument("--camera", metavar="NAME", help="default: the scene's")
    parser.add_argument("--device", choices=["auto", "blender_gpu", "opengl"])
    parser.add_argument("--set", type=assignment, action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--threads", type=int, metavar="N", help="of drawing without a GPU, numpy and Blender")
    parser.add_argument("--report", type=Path, metavar="R.json")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="default: the extension's preferences")
    parser.add_argument("--prepare", action="store_true", help="keep there what other frames may need")
    piece = parser.add_mutually_exclusive_group()
    piece.add_argument("--part", type=part, metavar="K/N", help="draw the K-th of N parts of one picture")
    piece.add_argument("--join", type=int, metavar="N", help="join N parts, which stay")
    parser.add_argument("--parts", type=Path, metavar="DIR", help="folder of the parts (default: OUT.parts)")
    parser.add_argument("--strict", action="store_true", help="a file that the scene needs and that is missing ends it")
    parser.add_argument("--require", metavar="VERSION", help="end where PointSplat is of another version")
    parser.add_argument("--end-with-input", action="store_true", help="end when the standard input does")
    return parser.parse_args(argv)


# ---------------------------------------------------------------------------- Blender


def engine_class():
    """The registered engine; registers the checkout's where no installed extension has."""
    import bpy

    def registered():
        classes = bpy.types.RenderEngine.__subclasses__()
        return next((c for c in classes if getattr(c, "bl_idname", "") == "POINTSPLAT" and c.is_registered), None)

    if registered() is None:
        import pointsplat_addon

        pointsplat_addon.register()
    return registered()


def version(engine) -> str:
    """Of PointSplat and Blender, such as "0.1.0+1f2e3d4c Blender 5.2.3"."""
    import bpy

    package = Path(sys.modules[engine.__module__.rpartition(".host.")[0]].__file__ or "").parent
    return f"{version_of(package.parent)} Blender {bpy.app.version_string.split()[0]}"


def check_files() -> None:
    """MachineError: a file that the scene reads at the present frame is missing."""
    import bpy

    needed = [path for path in bpy.utils.blend_paths(absolute=True) if "<" not in path]  # those are tiles of an image
    missing = {path for path in needed if not Path(path).exists()}
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.object.type == "VOLUME" and not instance.object.data.grids.load():  # of sequences the frame's own
            missing.add(f"{instance.object.name}: {instance.object.data.grids.error_message}")
    if missing:
        raise MachineError(f"files that the scene reads are missing: {', '.join(sorted(missing))}")


def open_file(path: Path):
    """Open a .blend file; its active scene."""
    import bpy

    if not path.is_file():
        raise ArgumentError(f"there is no file {path}")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise ArgumentError(f"Blender cannot open {path}: {error}") from error
    return bpy.context.scene


def typed(settings, name: str, text: str):
    """The value that `text` says for a property of scene.pointsplat."""
    properties = {p.identifier: p for p in settings.bl_rna.properties if p.identifier not in ("rna_type", "name")}
    if name not in properties:
        raise ArgumentError(f"--set {name}: there is no such setting; there are {', '.join(sorted(properties))}")
    prop = properties[name]
    if prop.type == "ENUM":
        choices = [item.identifier for item in prop.enum_items]
        if text.upper() not in choices:
            raise ArgumentError(f"--set {name}={text}: choose one of {', '.join(choices)}")
        return text.upper()
    if prop.type == "BOOLEAN":
        if text.lower() not in ("true", "false", "1", "0", "yes", "no", "on", "off"):
            raise ArgumentError(f"--set {name}={text}: say true or false")
        return text.lower() in ("true", "1", "yes", "on")
    if prop.type in ("INT", "FLOAT"):
        try:
            value = int(text) if prop.type == "INT" else float(text)
        except ValueError:
            raise ArgumentError(f"--set {name}={text}: this is no {prop.type.lower()}") from None
        if not prop.hard_min <= value <= prop.hard_max:
            raise ArgumentError(f"--set {name}={text}: it must lie between {prop.hard_min:g} and {prop.hard_max:g}")
        return value
    return text


def prepare(scene, args: argparse.Namespace) -> None:
    """Put what the arguments ask for into the scene."""
    import bpy

    scene.render.engine = "POINTSPLAT"
    if args.camera is not None:
        cameras = sorted(o.name for o in scene.objects if o.type == "CAMERA")
        if args.camera not in cameras:
            there = f"there are {', '.join(cameras)}" if cameras else "the scene has none"
            raise ArgumentError(f"--camera {args.camera}: there is no such camera in the scene; {there}")
        scene.camera = bpy.data.objects[args.camera]
    if scene.camera is None:
        raise ArgumentError(f"the scene {scene.name!r} of {args.file} has no camera; name one with --camera")
    if args.size:
        scene.render.resolution_x, scene.render.resolution_y = args.size
        scene.render.resolution_percentage = 100
    if args.device:
        scene.pointsplat.device = args.device.upper()
    if args.threads:
        scene.render.threads_mode, scene.render.threads = "FIXED", args.threads
    for name, text in args.set:
        setattr(scene.pointsplat, name, typed(scene.pointsplat, name, text))

    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # since Blender 5.0 the format's kind comes first
        image.media_type = "IMAGE"
    image.file_format = FORMATS[args.output.suffix.lower()]
    image.color_mode = "RGBA" if scene.render.film_transparent or image.file_format == "OPEN_EXR" else "RGB"
    image.color_depth = "32" if image.file_format == "OPEN_EXR" else "8"
    scene.render.use_file_extension = False  # the name is written as it was given


def render_frame(scene, frame: int, path: Path, engine, strict: bool = False) -> dict:
    """Render one frame into a file and return the engine's report. A render that fails leaves no file behind.

    RuntimeError: the render failed, or Blender wrote nothing. MachineError: there is nothing to draw with, or no space,
    or, where `strict`, a file is missing.
    """
    import bpy

    from pointsplat_addon.formats.whole_image import is_whole

    print(f"Fra:{frame}", flush=True)
    scene.frame_set(frame)
    if strict:
        check_files()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    scene.render.filepath = str(part)
    reported = sys.modules[engine.__module__].last_report
    reported.clear()
    try:
        bpy.ops.render.render(write_still=True)
        # Blender takes a render for finished whatever became of it, and writes what there is: a black frame.
        if "technique" not in reported:
            raise RuntimeError("it was not rendered")
        if not part.is_file():
            raise RuntimeError(f"Blender wrote no picture to {path}")
        with part.open("rb+") as file:
            os.fsync(file.fileno())  # what the file system could not keep is an error now
        if not is_whole(part):
            raise MachineError(f"frame {frame}: the picture could not be written whole to {path.parent}; is it full?")
        os.replace(part, path)
    except (RuntimeError, OSError) as error:
        failed(frame, error, reported, path.parent)
    finally:
        part.unlink(missing_ok=True)
    print(f"Saved: '{path}'", flush=True)
    return {**reported, "version": version(engine)}


def render_parts(scene, args: argparse.Namespace, engine) -> dict:
    """Draw a part of one picture, or join its parts; the report.

    RuntimeError, MachineError: as of render_frame. ArgumentError: several frames are asked for."""
    import bpy

    if args.frames:
        raise ArgumentError("--part and --join are for one picture: name it with --frame")
    frame = scene.frame_current if args.frame is None else args.frame
    folder = (args.parts or args.output.with_suffix(".parts")).resolve()
    package = engine.__module__.rpartition(".")[0]
    asking = sys.modules[f"{package}.parts"]
    if args.join:
        asking.asked = asking.Parts(folder, args.join, None)
        return render_frame(scene, frame, args.output, engine, args.strict)
    index, count = args.part
    asking.asked = asking.Parts(folder, count, index - 1)
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.frame_set(frame)
    if args.strict:
        check_files()
    reported = sys.modules[engine.__module__].last_report
    reported.clear()
    try:
        bpy.ops.render.render()
        if "technique" not in reported:
            raise RuntimeError("it was not rendered")
    except RuntimeError as error:
        failed(frame, error, reported, folder)
    return {**reported, "version": version(engine)}


def failed(frame: int, error: Exception, reported: dict, folder: Path) -> NoReturn:
    """Raise MachineError where nothing draws or no space is left in a folder, else RuntimeError."""
    full = (isinstance(error, OSError) and error.errno == errno.ENOSPC) or "No space left" in str(error)
    if full or (folder.exists() and shutil.disk_usage(folder).free == 0):
        raise MachineError(f"frame {frame}: no space is left in {folder}") from error
    kind = MachineError if reported.get("failed") == "device" else RuntimeError
    raise kind(f"frame {frame}: {str(error).strip()}") from error


def numbered(path: Path, frame: int) -> Path:
    return path.with_name(f"{path.stem}_{frame:04d}{path.suffix}")


def render(args: argparse.Namespace) -> None:
    engine = engine_class()
    if args.require and not f"{(found := version(engine))} ".startswith(f"{args.require} "):
        raise MachineError(f"this machine has PointSplat {found}, and {args.require} is asked for")
    scene = open_file(args.file)
    prepare(scene, args)
    if args.part or args.join:
        report = render_parts(scene, args, engine)
    elif args.frames:
        report = [render_frame(scene, f, numbered(args.output, f), engine, args.strict) for f in args.frames]
    else:
        frame = scene.frame_current if args.frame is None else args.frame
        report = render_frame(scene, frame, args.output, engine, args.strict)
    if args.report:
        args.report.parent.mkdir(parents=True, exist_ok=True)
        args.report.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    for warning in [w for r in (report if isinstance(report, list) else [report]) for w in r.get("warnings", [])]:
        print(f"render: warning: {warning}")


def settle(args: argparse.Namespace) -> None:
    """What has to be known before Blender, numpy and the driver are loaded."""
    if args.threads:
        for name in ("LP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
            os.environ[name] = str(args.threads)
    if args.cache:
        os.environ["POINTSPLAT_CACHE"] = str(args.cache.resolve())
    if args.prepare:
        os.environ["POINTSPLAT_CACHE_AT_ONCE"] = "1"
    if args.end_with_input:

        def follow() -> None:
            sys.stdin.buffer.read()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def main() -> int:
    # Blender hands its own arguments on as well; the script's come after "--".
    argv = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    try:
        args = arguments(argv)
        settle(args)
        render(args)
    except SystemExit as stop:  # argparse's own, after --help or a wrong argument
        return int(stop.code or 0)
    except ArgumentError as error:
        print(f"render: {error}", file=sys.stderr)
        return 2
    except MachineError as error:
        print(f"render: {error}", file=sys.stderr)
        return 3
    except ModuleNotFoundError as error:
        if error.name != "bpy":
            raise
        print("render: this Python has no bpy; scripts/dev.py env makes one that has", file=sys.stderr)
        return 2
    except RuntimeError as error:  # how Blender hands on what an engine reports as an error
        print(f"render: {str(error).strip()}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    run(main)
