"""Puts the repository's root on the path, so that tests import the package as it lies there."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
