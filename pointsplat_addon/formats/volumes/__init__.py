"""Formats of volumes: OpenVDB, and dense arrays as scanners write them."""
