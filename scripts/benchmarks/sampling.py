"""Speed of core.sampling on one core, as ratios to sorting as many float32 values in the same run."""

from __future__ import annotations
