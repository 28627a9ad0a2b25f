"""Which optional graphics libraries are installed."""

from __future__ import annotations

import ctypes
import importlib.util
import sys


def has_moderngl() -> bool:
    """Whether moderngl is installed. Whether it can make a context is only known once the thread has tried."""
    return importlib.util.find_spec("moderngl") is not None


def lacks_egl() -> bool:
    """Whether this is Linux without any device for EGL: Blender crashes there where it needs a context and has no
    window."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return True
    egl.eglGetProcAddress.restype, egl.eglGetProcAddress.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    if not address:
        return False  # nobody knows
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int))(address)
    count = ctypes.c_int()
    return not query(0, None, ctypes.byref(count)) or count.value == 0
