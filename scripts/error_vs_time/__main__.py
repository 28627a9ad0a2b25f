"""`python -m scripts.error_vs_time`: see scripts/error_vs_time/measure.py."""

from scripts.common.process import run
from scripts.error_vs_time.measure import main

run(main)
